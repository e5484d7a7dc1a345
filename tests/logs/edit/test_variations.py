"""Variations of a log: what stays, what changes, and which scenarios there are not."""

from dataclasses import replace
from math import isfinite
from pathlib import Path

import numpy as np
import pytest
from handmade import drive, lanes_along, s_curve, scenario, square, straight, track, tracks
from hypothesis import assume, given, strategies as st

from replan.core.arrays import FloatArray
from replan.core.errors import ConfigError, LogError
from replan.logs.agents import AgentKind
from replan.logs.catalogue import CATALOGUE
from replan.logs.edit.agent_changes import driven_line
from replan.logs.edit.variations import VARIATIONS, varied
from replan.logs.mcap import read_scenario, write_scenario
from replan.logs.road import Goal
from replan.logs.scenario import Scenario

STEP = 0.1
T = np.arange(0.0, 8.05, STEP)


def walked(t: FloatArray) -> FloatArray:
    """Stands for 2 s, then goes 1.5 m/s."""
    return -6.0 + 1.5 * np.maximum(t - 2.0, 0.0)


def log(**more: object) -> Scenario:
    """8 s at 8 m/s; a walker from the right 40 m ahead, a car at 6 m/s in front."""
    ego = drive(straight, 8.0, 8.0)
    people = tracks(
        track(
            "walker",
            T,
            0.0 * T + 40.0,
            walked(T),
            yaw=0.5 * np.pi,
            kind=AgentKind.PEDESTRIAN,
            vx=0.0 * T,
            vy=np.where(T > 2.0, 1.5, 0.0),
            length=0.5,
            width=0.5,
        ),
        track("car", T, 25.0 + 6.0 * T, 0.0 * T, vx=0.0 * T + 6.0, vy=0.0 * T),
        track("wall", [0.0], [100.0], [6.0], static=True),
    )
    made = scenario(ego, agents=people, road=lanes_along(ego), goal=Goal((square(60.0, 0.0, 4.0),)))
    return replace(made, tags=("recorded", "test"), metadata={}, **more)  # type: ignore[arg-type]


LOG = log()


def rows(made: Scenario, agent: str) -> FloatArray:
    """t, x, y of one."""
    mine = made.tracks.samples(made.tracks.ids.index(agent))
    return np.column_stack([made.tracks.t[mine], made.tracks.x[mine], made.tracks.y[mine]])


def at(made: Scenario, agent: str, times: FloatArray) -> FloatArray:
    """Where one is at some times, `(n, 2)`."""
    t, x, y = rows(made, agent).T
    return np.column_stack([np.interp(times, t, x), np.interp(times, t, y)])


@pytest.mark.parametrize(
    "name", [name for name, one in VARIATIONS.items() if isfinite(one.neutral)]
)
def test_the_neutral_value_is_the_same_scenario(name: str) -> None:
    assert VARIATIONS[name](LOG, ("walker",), VARIATIONS[name].neutral) is LOG


@given(st.sampled_from(["time", "side"]), st.floats(-9.0, 9.0), st.floats(-9.0, 9.0))
def test_shifts_add_up(name: str, a: float, b: float) -> None:
    vary, who = VARIATIONS[name], ("walker",)
    twice, once = vary(vary(LOG, who, a), who, b), vary(LOG, who, a + b)
    np.testing.assert_allclose(rows(twice, "walker"), rows(once, "walker"), atol=1e-9)


@given(st.floats(0.5, 1.7), st.floats(0.5, 1.7))
def test_factors_multiply(a: float, b: float) -> None:
    vary, who = VARIATIONS["speed"], ("car",)
    twice, once = vary(vary(LOG, who, a), who, b), vary(LOG, who, a * b)
    np.testing.assert_allclose(at(twice, "car", T), at(once, "car", T), atol=1e-6)
    faster = VARIATIONS["ego_speed"](VARIATIONS["ego_speed"](LOG, (), a), (), b).ego.v[0]
    assert faster == pytest.approx(VARIATIONS["ego_speed"](LOG, (), a * b).ego.v[0])


@given(st.floats(0.2, 5.0))
def test_another_speed_keeps_path_and_standing_time(factor: float) -> None:
    s = np.cumsum(np.r_[0.0, np.full(40, 0.5)])
    bend = tracks(
        track("17", STEP * np.arange(41), 20.0 * np.cos(s / 20.0), 20.0 * np.sin(s / 20.0))
    )
    turned = VARIATIONS["speed"](replace(LOG, tracks=bend), ("17",), factor)
    t, x, y = rows(turned, "17").T
    before = np.column_stack([bend.x, bend.y])
    ends = before[[0, -1]]
    np.testing.assert_allclose(np.column_stack([x, y])[[0, -1]], ends, atol=1e-12)
    assert t[-1] == pytest.approx(4.0 / factor)
    for point in np.column_stack([x, y]):  # on one of the recorded pieces
        along = np.clip(
            ((point - before[:-1]) * np.diff(before, axis=0)).sum(axis=1) / 0.25, 0.0, 1.0
        )
        feet = before[:-1] + along[:, None] * np.diff(before, axis=0)
        assert np.hypot(*(feet - point).T).min() < 1e-3
    assert np.diff(t).max() <= STEP * (1.0 + 1e-9)
    walker = rows(VARIATIONS["speed"](LOG, ("walker",), factor), "walker")
    begins = walker[np.argmax(walker[:, 2] > -5.0), 0]
    assert begins == pytest.approx(2.0 + (1.0 / 1.5) / factor, abs=0.15 + 0.2 / factor)


def test_velocities_are_those_of_the_new_motion() -> None:
    made = VARIATIONS["speed"](LOG, ("car",), 1.5)
    mine = made.tracks.samples(made.tracks.ids.index("car"))
    np.testing.assert_allclose(made.tracks.vx[mine], 9.0, rtol=1e-3)
    np.testing.assert_allclose(
        np.diff(made.tracks.x[mine]) / np.diff(made.tracks.t[mine]), 9.0, rtol=1e-6
    )


def test_tracks_in_pieces_stay_joined() -> None:
    first, second = T[:40], T[40:]
    pieces = tracks(
        track("a", first, 3.0 * first, 0.0 * first), track("b", second, 3.0 * second, 0.0 * second)
    )
    made = VARIATIONS["speed"](replace(LOG, tracks=pieces), ("a", "b"), 2.0)
    end, begin = rows(made, "a")[-1], rows(made, "b")[0]
    assert begin[0] - end[0] == pytest.approx(0.5 * STEP)
    assert begin[1] - end[1] == pytest.approx(3.0 * STEP)


@given(st.floats(-20.0, 20.0))
def test_sideways_is_across_the_course_and_moves_nobody_else(value: float) -> None:
    made = VARIATIONS["side"](LOG, ("walker",), value)
    np.testing.assert_allclose(
        rows(made, "walker") - rows(LOG, "walker"), [[0.0, -value, 0.0]] * len(T), atol=1e-9
    )
    assert np.array_equal(rows(made, "car"), rows(LOG, "car"))
    beside = VARIATIONS["side"](LOG, ("wall",), value)  # who stands: across the box
    np.testing.assert_allclose(rows(beside, "wall"), [[0.0, 100.0, 6.0 + value]])


@given(st.floats(-6.0, 3.0))
def test_agents_present_throughout_stay_present(value: float) -> None:
    made = varied(LOG, ("car", "walker"), {"time": value})
    covered = np.arange(0.0, 8.0, 0.5)
    for agent in ("car", "walker"):
        t = rows(made, agent)[:, 0]
        assert t[0] <= 0.0 and t[-1] >= 8.0 - 1e-9 and np.diff(t).max() <= 2.0 * STEP
    expected = np.column_stack([25.0 + 6.0 * (covered - value), 0.0 * covered])
    np.testing.assert_allclose(at(made, "car", covered), expected, atol=0.05)
    assert at(made, "walker", np.array([0.0]))[0, 1] >= -6.0  # who stood before, stands


def test_a_varied_log_is_marked_and_holds_no_drive(tmp_path: Path) -> None:
    made = varied(LOG, ("walker",), {"time": -1.5, "speed": 2.0})
    assert made.name == "handmade~speed=2,time=-1.5"
    assert made.tags == ("test", "varied") and not made.is_recorded and len(made.ego) == 1
    assert made.metadata["varied.time"] == "-1.5" and made.metadata["varied.agents"] == '["walker"]'
    assert any("time -1.5 s of walker" in note for note in made.notes)
    write_scenario(tmp_path / "varied.mcap", made)
    read = read_scenario(tmp_path / "varied.mcap")
    assert (read.name, read.tags, read.notes, dict(read.metadata)) == (
        made.name,
        made.tags,
        made.notes,
        dict(made.metadata),
    )
    np.testing.assert_allclose(rows(read, "walker"), rows(made, "walker"), atol=1e-8)
    names = {varied(LOG, ("walker",), {"time": value}).name for value in np.linspace(-2.0, 2.0, 65)}
    assert len(names) == 65


@pytest.mark.parametrize(
    "family", ["paper/crossing_pedestrian", "everyday/cut_in", "paper/free_road"]
)
def test_the_start_without_changes_is_that_of_the_log(family: str) -> None:
    log = CATALOGUE[family].scenario()
    made = varied(log, (), {"ego_start": 0.0})
    assert made.ego.state(0) == log.ego.state(0)
    assert made.road is log.road and made.goal is log.goal and made.duration == log.duration
    assert "expected_decisions" not in made.metadata


@given(st.floats(0.0, 40.0), st.floats(0.0, 1.0))
def test_the_ego_starts_on_its_path(way: float, factor: float) -> None:
    ego = drive(s_curve, 8.0, 12.0)
    curved = scenario(ego, road=lanes_along(ego))
    start = varied(curved, (), {"ego_start": way, "ego_speed": factor}).ego.state(0)
    s, l = driven_line(curved).project(start.x, start.y)
    assert (s, l) == pytest.approx((way, 0.0), abs=1e-6)
    assert start.v == pytest.approx(8.0 * factor)
    assert abs(start.yaw - np.interp(way, 8.0 * ego.t, ego.yaw)) < 0.02


@pytest.mark.parametrize(
    ("who", "values", "said"),
    [
        ((), {"ego_start": -30.0}, "off the road"),
        (("walker",), {"side": 40.0}, "in the ego"),
        ((), {"ego_start": 26.0}, "car would stand in the ego"),
    ],
)
def test_no_sensible_start_is_no_scenario(
    who: tuple[str, ...], values: dict[str, float], said: str
) -> None:
    people = tracks(
        track(
            "walker", T, 0.0 * T + 42.0, -0.5 + 0.2 * T, yaw=0.5 * np.pi, kind=AgentKind.PEDESTRIAN
        ),
        track("car", T, 28.0 + 6.0 * T, 0.0 * T),
    )
    with pytest.raises(LogError, match=said):
        varied(replace(LOG, tracks=people), who, values)


def test_too_fast_for_the_curve_is_no_scenario() -> None:
    ego = drive(s_curve, 8.0, 12.0)
    with pytest.raises(LogError, match="curve of 50 m"):
        varied(scenario(ego, road=lanes_along(ego)), (), {"ego_start": 50.0, "ego_speed": 3.0})


@given(st.floats(10.0, 60.0))
def test_an_inserted_walker_meets_an_ego_that_keeps_its_speed(ahead: float) -> None:
    made = varied(LOG, (), {"pedestrian": ahead})
    when = (ahead - LOG.vehicle.axle_to_front) / 8.0
    place = at(made, "inserted pedestrian", np.array([when]))[0]
    assert place == pytest.approx((ahead, 0.0), abs=0.1)
    later = varied(LOG, (), {"pedestrian": ahead, "time": 1.0})
    assert at(later, "inserted pedestrian", np.array([when + 1.0]))[0] == pytest.approx(
        (ahead, 0.0), abs=0.1
    )


def test_copies_follow_and_removed_ones_are_gone() -> None:
    made = varied(LOG, ("car",), {"copy": 3.0})
    times = np.array([4.0, 6.0, 8.0])
    np.testing.assert_allclose(
        at(made, "copy of car", times), at(LOG, "car", times - 3.0), atol=1e-6
    )
    assert rows(made, "copy of car")[0, 0] <= 0.0
    assert varied(LOG, ("car", "wall"), {"remove": 1.0, "time": 1.0}).tracks.ids == ("walker",)
    with pytest.raises(LogError, match="already"):
        VARIATIONS["copy"](made, ("car",), 3.0)


@given(st.sampled_from(list(VARIATIONS)), st.floats(-1e3, 1e3))
def test_values_out_of_range_are_refused(name: str, value: float) -> None:
    assume(not VARIATIONS[name].low <= value <= VARIATIONS[name].high)
    with pytest.raises(ConfigError, match=name):
        varied(LOG, ("walker",), {name: value})


def test_unknown_names_are_refused() -> None:
    with pytest.raises(ConfigError, match="did you mean 'speed'"):
        varied(LOG, ("walker",), {"sped": 1.0})
    with pytest.raises(ConfigError, match="no agent is called 'nobody'"):
        varied(LOG, ("nobody",), {"time": 1.0})
    with pytest.raises(ConfigError, match="no agent is named"):
        varied(LOG, (), {"time": 1.0})
