"""Arriving when and as fast as the goal says."""

from dataclasses import replace

import numpy as np
import pytest
from handmade import track, tracks
from hypothesis import given, strategies as st
from roads import along_x, lanes
from scenes import CAR, reference

from replan.core.arrays import FloatArray
from replan.logs.catalogue import CATALOGUE
from replan.logs.road import Goal, Road
from replan.logs.scenario import Scenario
from replan.logs.states import EgoState, Trajectory
from replan.logs.trace import EndReason, Trace
from replan.logs.tracks import Tracks
from replan.planners.dp_qp.goal_window import LEAST, GoalWindow, SpeedTarget
from replan.replay.loop.closed_loop import run_closed_loop

EGO = EgoState(0.0, 20.0, 0.0, 0.0, 10.0, 0.0, 0.0)
ROAD = lanes(along_x(0.0, 400.0))
COURSE = reference(ROAD, ego=EGO)
LIMIT = float(COURSE.limit[0])


def region(begin: float, end: float) -> np.ndarray:
    return np.array([[begin, -2.0], [end, -2.0], [end, 2.0], [begin, 2.0]])


def window(t: tuple[float, float] | None, v: tuple[float, float] | None = None) -> GoalWindow:
    return GoalWindow(Goal((region(200.0, 220.0),), t=t, v=v), COURSE, CAR)


def test_without_a_goal_or_its_time_there_is_no_target() -> None:
    for one in (GoalWindow(None, COURSE, CAR), window(None)):
        assert one.target(0.0, 20.0, 10.0) == SpeedTarget() and one.slow_zone is None


@given(st.floats(0.0, 60.0), st.floats(0.1, 5.0), st.floats(0.0, 180.0), st.floats(0.0, 20.0))
def test_the_target_is_never_too_slow_and_late_and_early_exclude_each_other(
    first: float, lasts: float, s: float, v: float
) -> None:
    found = window((first, first + lasts)).target(0.0, s, v)
    assert found.cap >= LEAST * LIMIT - 1e-9
    assert not (found.hurried and np.isfinite(found.cap))


@given(st.floats(0.1, 40.0), st.floats(0.0, 180.0), st.floats(0.0, 20.0))
def test_a_late_ego_hurries_and_lateness_grows_with_time(last: float, s: float, v: float) -> None:
    sooner, later = (window((0.0, last)).target(t, s, v) for t in (0.0, 0.5 * last))
    assert sooner.hurried or sooner.missed_s == 0.0
    if sooner.missed_s > 0.0:
        assert later.missed_s == pytest.approx(sooner.missed_s + 0.5 * last)


def sides(goal: Goal, stations: FloatArray) -> FloatArray:
    """Least and greatest offset at stations `(2, n)`, NaN where there are none."""
    at, *both = GoalWindow(goal, COURSE, CAR).sides(stations[0], stations[-1])
    return np.array([np.interp(stations, at, side, np.nan, np.nan) for side in both])


@given(st.floats(-3.0, 3.0), st.floats(0.2, 5.0), st.floats(-0.3, 0.3))
def test_the_goals_sides_hold_beside_its_region_only(y: float, width: float, turn: float) -> None:
    c, s = np.cos(turn), np.sin(turn)
    square = np.array([[-10.0, -0.5], [10.0, -0.5], [10.0, 0.5], [-10.0, 0.5]]) * (1.0, width)
    square = square @ np.array([[c, s], [-s, c]]) + (200.0, y)
    stations = np.array([COURSE.line.project(x, 0.0)[0] for x in (100.0, 200.0, 260.0)])
    low, high = sides(Goal((square,)), stations)
    assert not GoalWindow(Goal((square,)), COURSE, CAR).sides(stations[2], stations[2] + 100.0).size
    room = min(0.3, 0.25 * width / c)
    assert np.isnan(low[[0, 2]]).all() and np.isnan(high[[0, 2]]).all()
    assert (low[1], high[1]) == pytest.approx(
        (y - 0.5 * width / c + room, y + 0.5 * width / c - room), abs=1e-6
    )


@given(st.floats(0.0, 40.0), st.floats(0.0, 20.0))
def test_the_earlier_the_window_the_faster(first: float, more: float) -> None:
    sooner, later = (
        window((t, t + 2.0)).target(0.0, 20.0, 10.0).cap for t in (first, first + more)
    )
    assert later <= sooner


def drive_to(region: np.ndarray | None, t: tuple[float, float], road: Road, v: float) -> Trace:
    """A drive from the origin on an empty road."""
    ego = Trajectory(*(np.array([value]) for value in (0.0, 0.0, 0.0, 0.0, v, 0.0, 0.0)))
    scenario = Scenario(
        "goal",
        ego,
        Tracks.empty(),
        road,
        t[1],
        goal=Goal(() if region is None else (region,), t=t),
        vehicle=CAR,
    )
    return run_closed_loop(scenario, "dp_qp").trace


@pytest.mark.parametrize("at", [10.0, pytest.param(40.0, marks=pytest.mark.slow)])
def test_a_goal_with_a_time_and_no_place_keeps_the_ego_on_the_road(at: float) -> None:
    trace = drive_to(None, (at - 0.1, at), lanes(along_x(-20.0, 120.0)), 12.0)
    assert trace.end is EndReason.GOAL
    assert trace.ego.x[-1] + CAR.axle_to_front < 120.0


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_goal_beside_the_lanes_middle_is_met(side: float) -> None:
    """It lies from 0.5 to 1.5 m beside the middle of the lane, and 6 m along it."""
    y0, y1 = sorted((0.5 * side, 1.5 * side))
    square = np.array([[80.0, y0], [86.0, y0], [86.0, y1], [80.0, y1]])
    trace = drive_to(square, (0.0, 20.0), lanes(along_x(-20.0, 300.0)), 10.0)
    assert trace.end is EndReason.GOAL
    assert y0 <= trace.ego.y[-1] <= y1


def rectangle(x: float, y: float, length: float, width: float, turn: float = 0.0) -> np.ndarray:
    c, s = np.cos(turn), np.sin(turn)
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * (length, width)
    return corners @ np.array([[c, s], [-s, c]]) + (x, y)


def test_of_two_regions_that_in_the_lane_is_met() -> None:
    near, far = rectangle(83.0, 1.0, 6.0, 1.0), rectangle(403.0, 1.0, 6.0, 1.0)
    low, high = sides(
        Goal((far, near)), np.array([COURSE.line.project(x, 0.0)[0] for x in (83.0, 200.0, 343.0)])
    )
    assert (
        np.isfinite(low[0])
        and np.isfinite(high[0])
        and np.isnan(low[1:]).all()
        and np.isnan(high[1:]).all()
    )
    triangles = [
        np.array(corners)
        for corners in (((80, -1.7), (100, -1.7), (100, 1.7)), ((80, -1.7), (100, 1.7), (80, 1.7)))
    ]
    whole = rectangle(90.0, 0.0, 20.0, 3.4)
    stations = np.array([COURSE.line.project(x, 0.0)[0] for x in np.arange(81.0, 99.0)])
    np.testing.assert_allclose(
        sides(Goal(tuple(triangles)), stations), sides(Goal((whole,)), stations), atol=1e-6
    )


def driven(window: tuple[float, float], speeds: tuple[float, float]) -> Trace:
    """paper/free_road, whose ego drives 12 m/s, with a small goal 130 m away in its first straight
    and left turn.
    """
    scenario = CATALOGUE["paper/free_road"].scenario()
    ego = scenario.ego
    k = int(np.searchsorted(np.cumsum(np.hypot(np.diff(ego.x), np.diff(ego.y))), 60.0))
    x, y = ego.x[k], ego.y[k]
    square = np.array(
        [[x - 4.0, y - 4.0], [x + 4.0, y - 4.0], [x + 4.0, y + 4.0], [x - 4.0, y + 4.0]]
    )
    goal = Goal((square,), t=window, v=speeds)
    return run_closed_loop(replace(scenario, goal=goal), "dp_qp").trace


@pytest.mark.parametrize(
    ("window", "speeds"), [((8.0, 8.3), (0.0, 30.0)), ((5.0, 9.0), (0.0, 6.0))]
)
def test_the_ego_arrives_in_the_window_at_the_speed(
    window: tuple[float, float], speeds: tuple[float, float]
) -> None:
    """Driving on at 12 m/s it would be there after 5 s, too early or too fast."""
    trace = driven(window, speeds)
    assert trace.end is EndReason.GOAL
    assert window[0] - 0.01 <= trace.ego.t[-1] <= window[1] + 0.01
    assert trace.ego.v[-1] <= speeds[1]
    assert trace.ego.a.min() > -3.0


@pytest.mark.parametrize("last", [6.0, pytest.param(40.0, marks=pytest.mark.slow)])
def test_a_goal_in_the_next_lane_is_met_in_time_though_that_lane_is_slower(last: float) -> None:
    """Keeping the lane would be faster.

    The sooner the goal's time is over, the more a change is worth.
    """
    road = lanes(along_x(-100.0, 900.0), 2, limit=25.0)
    square = np.array([[-100.0, 1.75], [900.0, 1.75], [900.0, 5.25], [-100.0, 5.25]])
    t = np.arange(0.0, last + 0.05, 0.1)
    lead = track(
        "lead",
        t.tolist(),
        (45.0 + 17.0 * t).tolist(),
        np.full(len(t), 3.5).tolist(),
        yaw=0.0,
        vx=17.0,
        vy=0.0,
    )
    ego = Trajectory(*(np.array([value]) for value in (0.0, 0.0, 0.0, 0.0, 22.0, 0.0, 0.0)))
    scenario = Scenario(
        "goal", ego, tracks(lead), road, last, goal=Goal((square,), t=(0.0, last)), vehicle=CAR
    )
    assert run_closed_loop(scenario, "dp_qp").trace.end is EndReason.GOAL
