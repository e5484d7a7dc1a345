"""Who drives over time, and take-overs: `replan.logs.driving`."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from differences import differences
from drives import along, grid, world
from hypothesis import given, strategies as st

from replan.core.errors import LogError
from replan.logs.driving import (
    LASTS_S,
    DrivingMode,
    DrivingModes,
    Flicker,
    Takeover,
    TakeoverKind,
    takeovers,
)
from replan.logs.edit.cut import cut
from replan.logs.mcap import read_scenario, write_scenario
from replan.logs.readers.table import from_frames
from replan.logs.states import Controls, Trajectory

AUTO, MANUAL, STEERED, PACED, GIVEN_UP, UNKNOWN = DrivingMode
EGO = along(grid(20.0, 0.1), 10.0)
Spans = Sequence[tuple[float, DrivingMode]]


def modes(*spans: tuple[float, DrivingMode], latency_s: float = 0.05) -> DrivingModes:
    t, names = zip(*spans, strict=True)
    return DrivingModes(np.array(t), tuple(names), "/mode", latency_s)


def found(
    *spans: tuple[float, DrivingMode], ego: Trajectory = EGO, controls: Controls | None = None
) -> tuple[list[Takeover], list[Flicker]]:
    return takeovers(modes(*spans), ego, controls)


samples = st.lists(st.sampled_from(DrivingMode), min_size=1, max_size=30)


@given(samples=samples)
def test_changes_say_the_same_as_the_samples(samples: list[DrivingMode]) -> None:
    t = 0.1 * np.arange(len(samples))
    column = DrivingModes.of_samples(t, samples, "/mode")
    assert [column.at(time) for time in t.tolist()] == samples
    assert column.at(-0.05) is UNKNOWN
    spans = column.spans(0.0, float(t[-1]) + 0.1)
    assert [mode for *_, mode in spans] == list(column.modes)
    assert spans[0][0] == 0.0


@given(samples=samples, begin=st.floats(0.0, 3.0))
def test_a_cut_says_the_same_from_its_begin_on(samples: list[DrivingMode], begin: float) -> None:
    t = 0.1 * np.arange(len(samples))
    column = DrivingModes.of_samples(t, samples, "/mode")
    part = column.between(begin, 10.0)
    assert part is not None
    for time in np.arange(begin, 4.0, 0.05).tolist():
        assert part.at(time) is column.at(time)


@given(samples=samples)
def test_nobody_drives_steadily_for_a_moment_only(samples: list[DrivingMode]) -> None:
    column = DrivingModes.of_samples(0.1 * np.arange(len(samples)), samples, "/mode").steady()
    lasting = np.diff(column.t)
    for n in range(1, len(column.modes) - 1):
        if column.modes[n - 1] is column.modes[n + 1]:
            assert lasting[n] >= LASTS_S - 1e-6


def test_spans_are_in_words_without_flickers_which_are_counted() -> None:
    column = modes((0.0, AUTO), (4.0, MANUAL), (4.2, AUTO), (6.0, MANUAL))
    words = "autonomous from 0.0 to 6.0 s, manual from 6.0 to 9.0 s; 1 flicker of less than 0.5 s"
    assert column.described(0.0, 9.0) == words


def test_a_take_over_is_the_loss_of_an_axis_for_half_a_second() -> None:
    (event,), flickers = found((0.0, AUTO), (4.0, MANUAL))
    assert (event.t, event.changed, event.until) == pytest.approx((3.95, 4.0, 20.0))
    assert (event.axis, event.kind, event.input, event.episode) == (
        "both",
        TakeoverKind.DRIVER,
        "",
        1,
    )
    assert not flickers
    assert found((0.0, AUTO), (4.0, MANUAL), (4.2, AUTO)) == (
        [],
        [Flicker(4.0, pytest.approx(0.2))],
    )


@pytest.mark.parametrize(
    "spans",
    [
        ((0.0, AUTO),),  # to the end of the recording
        ((0.0, MANUAL),),
        ((0.0, MANUAL), (5.0, AUTO)),
        ((0.0, AUTO), (4.0, UNKNOWN), (6.0, AUTO)),
        ((0.0, UNKNOWN), (4.0, MANUAL)),
    ],
)
def test_these_are_no_take_overs(spans: Spans) -> None:
    assert found(*spans) == ([], [])


@pytest.mark.parametrize(
    ("after", "axis", "kind"),
    [
        (PACED, "lateral", TakeoverKind.DRIVER),
        (STEERED, "longitudinal", TakeoverKind.DRIVER),
        (GIVEN_UP, "both", TakeoverKind.STACK),
    ],
)
def test_axis_and_kind_are_those_of_the_mode(
    after: DrivingMode, axis: str, kind: TakeoverKind
) -> None:
    (event,), _ = found((0.0, AUTO), (4.0, after))
    assert (event.axis, event.kind) == (axis, kind)


def test_near_take_overs_are_one_episode() -> None:
    events, _ = found(
        (0.0, AUTO), (4.0, MANUAL), (5.2, AUTO), (6.5, MANUAL), (8.0, AUTO), (17.0, MANUAL)
    )
    assert [event.episode for event in events] == [1, 1, 2]
    assert [event.until for event in events] == [5.2, 8.0, 20.0]


def test_a_take_over_of_a_standing_car_is_planned() -> None:
    t = grid(20.0, 0.1)
    stops = along(t, np.where(t < 8.0, 10.0, 0.0))
    (event,), _ = found((0.0, AUTO), (9.5, MANUAL), ego=stops)
    assert event.kind is TakeoverKind.PLANNED


@pytest.mark.parametrize(("begin", "seen"), [(3.7, True), (2.5, False), (4.3, False)])
def test_a_take_over_begins_with_the_drivers_first_input(begin: float, seen: bool) -> None:
    t = grid(20.0, 0.1)
    brake = np.where(t >= begin - 1e-6, 0.3, 0.0)
    controls = Controls(t, np.zeros(len(t)), np.zeros(len(t)), brake)
    (event,), _ = found((0.0, AUTO), (4.0, MANUAL), controls=controls)
    assert (event.t, event.input) == ((pytest.approx(begin), "brake") if seen else (3.95, ""))


def test_a_written_log_keeps_who_drives(tmp_path: Path) -> None:
    driving = modes((0.0, AUTO), (1.0, UNKNOWN), (1.5, PACED), (2.0, MANUAL))
    log = replace(world(5.0), driving=driving)
    write_scenario(tmp_path / "log.mcap", log)
    again = read_scenario(tmp_path / "log.mcap").driving
    assert again is not None and not differences(again, driving)
    part = cut(log, 1.2).driving
    assert part is not None
    assert [part.at(t) for t in (0.0, 0.5, 1.0)] == [UNKNOWN, PACED, MANUAL]


def table(words: Sequence[object]) -> pd.DataFrame:
    t = 0.1 * np.arange(len(words))
    return pd.DataFrame({"t": t, "x": 5.0 * t, "y": 0.0 * t, "yaw": 0.0 * t, "driver": words})


@pytest.mark.parametrize(
    ("words", "driver"),
    [
        (["auto"] * 6 + ["manual"] * 9, {}),
        ([1] * 6 + [0] * 9, {}),
        ([True] * 6 + [False] * 9, {}),
        (["pilot"] * 6 + ["Eve"] * 9, {"pilot": "autonomous", "Eve": "manual"}),
    ],
)
def test_a_column_of_a_table_says_who_drives(words: list[object], driver: dict[str, str]) -> None:
    driving = from_frames(table(words), driver=driver).driving
    assert driving is not None and driving.modes == (AUTO, MANUAL)
    assert driving.t.tolist() == pytest.approx([0.0, 0.6])
    assert driving.latency_s == pytest.approx(0.1)


def test_words_that_are_not_known_are_named_with_the_remedy() -> None:
    with pytest.raises(LogError, match="who drives is 'eve'") as refused:
        from_frames(table(["auto"] * 6 + ["Eve"] * 9))
    assert "driver = {" in str(refused.value)
