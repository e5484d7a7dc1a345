"""Arriving when and as fast as the goal says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from worlds import CAR, along_x, lanes

from logs import EgoState, Goal
from logs.catalogue import CATALOGUE
from logs.trace import EndReason, Trace
from planners.dp_qp.appointment import LEAST, Appointment, Pace
from planners.dp_qp.reference_line import make_course
from planners.dp_qp.route import find_route
from replay.closed_loop import run_closed_loop

EGO = EgoState(0.0, 20.0, 0.0, 0.0, 10.0, 0.0, 0.0)
ROAD = lanes(along_x(0.0, 400.0))
COURSE = make_course(ROAD, find_route(ROAD, EGO, None), EGO, CAR)
LIMIT = float(COURSE.limit[0])


def region(begin: float, end: float) -> np.ndarray:
    return np.array([[begin, -2.0], [end, -2.0], [end, 2.0], [begin, 2.0]])


def appointment(t: tuple[float, float] | None, v: tuple[float, float] | None = None) -> Appointment:
    return Appointment(Goal((region(200.0, 220.0),), t=t, v=v), COURSE, CAR)


def test_without_goal_or_time_nobody_is_expected() -> None:
    for one in (Appointment(None, COURSE, CAR), appointment(None)):
        assert one.pace(0.0, 20.0, 10.0) == Pace()
        np.testing.assert_array_equal(one.limit(COURSE.line.s, COURSE.limit, Pace()), COURSE.limit)


@given(st.floats(0.0, 60.0), st.floats(0.1, 5.0), st.floats(0.0, 180.0), st.floats(0.0, 20.0))
def test_the_pace_is_never_too_slow_and_late_and_early_exclude_each_other(
    first: float, lasts: float, s: float, v: float
) -> None:
    pace = appointment((first, first + lasts)).pace(0.0, s, v)
    assert pace.cap >= LEAST * LIMIT - 1e-9
    assert not (pace.hurried and np.isfinite(pace.cap))


@given(st.floats(0.0, 40.0), st.floats(0.0, 20.0))
def test_the_earlier_the_window_the_faster(first: float, more: float) -> None:
    sooner, later = (appointment((t, t + 2.0)).pace(0.0, 20.0, 10.0).cap for t in (first, first + more))
    assert later <= sooner


def test_the_goals_speed_holds_in_its_region() -> None:
    limit = appointment(None, (0.0, 5.0)).limit(COURSE.line.s, COURSE.limit, Pace())
    slow = COURSE.line.s[limit < 5.0]
    assert 200.0 - CAR.axle_to_center - 1.0 <= slow.min() and slow.max() <= 220.0 - CAR.axle_to_center + 1.0


def driven(window: tuple[float, float], speeds: tuple[float, float]) -> Trace:
    """paper/free_road, whose ego drives 12 m/s, with a small goal 130 m away in its first straight and left turn."""
    scenario = CATALOGUE["paper/free_road"].scenario()
    ego = scenario.ego
    k = int(np.searchsorted(np.cumsum(np.hypot(np.diff(ego.x), np.diff(ego.y))), 60.0))
    x, y = ego.x[k], ego.y[k]
    square = np.array([[x - 4.0, y - 4.0], [x + 4.0, y - 4.0], [x + 4.0, y + 4.0], [x - 4.0, y + 4.0]])
    goal = Goal((square,), t=window, v=speeds)
    return run_closed_loop(replace(scenario, goal=goal), "dp_qp").trace


@pytest.mark.parametrize(("window", "speeds"), [((8.0, 8.3), (0.0, 30.0)), ((5.0, 9.0), (0.0, 6.0))])
def test_the_ego_arrives_in_the_window_at_the_speed(window: tuple[float, float], speeds: tuple[float, float]) -> None:
    """Driving on at 12 m/s it would be there after 5 s, too early or too fast."""
    trace = driven(window, speeds)
    assert trace.end is EndReason.GOAL
    assert window[0] - 0.01 <= trace.ego.t[-1] <= window[1] + 0.01
    assert trace.ego.v[-1] <= speeds[1]
    assert trace.ego.a.min() > -3.0
