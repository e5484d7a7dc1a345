"""What every log has to pass after it was read: clocks, magnitudes, names."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from rich_scenario import rich_scenario

from replan.core.errors import LogError
from replan.core.names import visible_name
from replan.logs.log_checks import passed
from replan.logs.mcap import write_scenario
from replan.logs.readers import LogSettings, read_log
from replan.logs.readers.admission import CHECKS, LIMITS, check_clocks, check_road, printable
from replan.logs.scenario import Scenario
from replan.logs.vehicle import VehicleParameters

LOG = rich_scenario(20)


def at(table: Any, name: str, value: float, k: int = 5) -> Any:
    """A table with one value of a column replaced."""
    column = getattr(table, name).copy()
    column[k] = value
    return replace(table, **{name: column})


@pytest.mark.parametrize("name", LIMITS["ego"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_ego_beyond_a_limit_is_refused_with_topic_and_time(name: str, sign: float) -> None:
    for value in (1.01 * LIMITS["ego"][name].most, 1e8):
        wild = replace(LOG, ego=at(LOG.ego, name, sign * value)) if name != "yaw" else None
        if wild is None:  # else it is unwrapped
            wild = replace(LOG, ego=replace(LOG.ego, yaw=LOG.ego.yaw + sign * value))
        with pytest.raises(
            LogError, match=rf"topic ego, time [0-9.]+ s: ({name} is|the position jumps)"
        ):
            passed(wild, CHECKS)
    assert passed(LOG, CHECKS) is LOG


REFUSED: dict[str, tuple[Callable[[Scenario], Scenario], str]] = {
    "jump": (lambda s: replace(s, ego=at(s.ego, "x", 3000.0)), "topic ego.*the position jumps by"),
    "gap": (
        lambda s: replace(
            s,
            ego=replace(s.ego, t=np.where(s.ego.t > 1.0, s.ego.t + 90.0, s.ego.t)),
            duration=100.0,
        ),
        "topic ego.*no state for 9[0-9.]+ s, longer than 60 s",
    ),
    "vehicle": (
        lambda s: replace(s, vehicle=VehicleParameters(mass=1e308)),
        "topic vehicle: mass is 1e",
    ),
    "agents' clock": (
        lambda s: replace(s, tracks=s.tracks.shifted(1e6)),
        "topic agents: times from .*do not overlap",
    ),
    "controls' clock": (
        lambda s: replace(
            s, controls=None if s.controls is None else replace(s.controls, t=s.controls.t - 1e5)
        ),
        "topic controls: times from .*do not overlap",
    ),
    "all agents": (
        lambda s: replace(s, tracks=replace(s.tracks, x=s.tracks.x + 1e8)),
        "topic agents: no pose",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_driven_is_refused_on_reading(case: str, tmp_path: Path) -> None:
    spoil, said = REFUSED[case]
    write_scenario(tmp_path / "log.mcap", spoil(LOG))
    with pytest.raises(LogError, match=rf"log\.mcap, {said}"):
        read_log(tmp_path / "log.mcap")


@given(
    st.integers(0, 10**6),
    st.sampled_from([1e7, 1e300, -1e300]),
    st.sampled_from(["x", "y", "yaw", "vx", "length"]),
)
def test_what_is_wrong_of_an_agent_is_left_out_and_noted(
    seed: int, value: float, name: str
) -> None:
    tracks = LOG.tracks
    values = getattr(tracks, name).copy()
    value *= 1e290 if name == "yaw" and value == 1e7 else 1.0  # 1e7 rad is still an angle
    k = seed % len(values)
    values[k] = abs(value) if name == "length" else value
    wild = passed(replace(LOG, tracks=replace(tracks, **{name: values})), CHECKS)
    whose = k if name == "length" else int(np.searchsorted(tracks.offsets, k, side="right")) - 1
    assert set(tracks.ids) - set(wild.tracks.ids) <= {tracks.ids[whose]}
    (note,) = wild.notes[len(LOG.notes) :]
    assert visible_name(tracks.ids[whose]) in note
    lost = len(tracks.t) - len(wild.tracks.t)
    assert lost == (1 if name in ("x", "y", "yaw") else 0)
    for column in ("x", "y", "yaw", "length", "width"):
        assert np.abs(getattr(wild.tracks, column)).max() <= 1e6


def test_one_agent_on_another_clock_is_noted() -> None:
    tracks = LOG.tracks
    assert check_clocks(LOG) is LOG
    late = tracks.t.copy()
    moving = int(np.flatnonzero(~tracks.static)[0])
    late[tracks.samples(moving)] += 1e5
    (note,) = check_clocks(replace(LOG, tracks=replace(tracks, t=late))).notes[len(LOG.notes) :]
    assert f"1 road user ({tracks.ids[moving]}) have no sample within 60 s of the ego's log" in note


def test_a_part_without_agents_is_a_part(tmp_path: Path) -> None:
    write_scenario(tmp_path / "log.mcap", LOG)
    begin = float(LOG.ego.t[-1]) - 0.2
    assert read_log(tmp_path / "log.mcap", LogSettings(begin=begin)).duration == pytest.approx(
        LOG.duration - begin
    )


@given(
    st.lists(
        st.text(max_size=300), min_size=len(LOG.tracks), max_size=len(LOG.tracks), unique=True
    ),
    st.text(),
)
def test_names_are_cleaned_at_one_door(ids: list[str], name: str) -> None:
    found = printable(
        replace(LOG, name=name, tracks=replace(LOG.tracks, ids=tuple(ids)), metadata={name: name})
    )
    texts = [*found.tracks.ids, found.name, *found.metadata, *found.metadata.values()]
    assert not any(
        ord(c) < 32 or 0x7F <= ord(c) < 0xA0 or c in "\u2028\u202e" for text in texts for c in text
    )
    assert all(text.encode() is not None for text in texts) and len(set(found.tracks.ids)) == len(
        ids
    )
    changed = (name, *ids) != (found.name, *found.tracks.ids) or dict(found.metadata) != {
        name: name
    }
    assert any("Control characters in" in note for note in found.notes) is changed
    assert printable(found) is found


def test_a_road_beyond_a_limit_is_refused() -> None:
    lane = next(iter(LOG.road.lanes.values()))
    for wild in (replace(lane, left=lane.left + 1e8), replace(lane, speed_limit=1e308)):
        road = replace(LOG.road, lanes={**LOG.road.lanes, lane.id: wild})
        with pytest.raises(LogError, match=f"topic road, lane {lane.id}: "):
            check_road(replace(LOG, road=road))
    assert check_road(LOG) is LOG
