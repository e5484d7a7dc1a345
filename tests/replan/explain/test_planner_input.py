"""The true boxes of agents in the S-L graph of a plan."""

from dataclasses import replace
from functools import cache

import numpy as np
import sample_drive
from hypothesis import given, settings, strategies as st

from replan.explain.planner_input import BEYOND_M, true_boxes
from replan.logs.states import Trajectory
from replan.logs.trace import Mode, Trace

STATIONS = np.linspace(0.0, 40.0, 81)


@cache
def drive() -> Trace:
    return sample_drive.drive(Mode.CLOSED)[0].trace


def boxes_on(path: np.ndarray, yaw: np.ndarray, line: np.ndarray, t: float) -> list[np.ndarray]:
    """The boxes of the sample drive's agents, on another path `(n, 2)`."""
    frame = next(frame for frame in drive().frames if frame.t >= t)
    zero = np.zeros(len(path))
    times = frame.t + np.linspace(0.0, 8.0, len(path))
    plan = replace(frame.plan, trajectory=Trajectory(times, *path.T, yaw, zero + 5.0, zero, zero))
    return list(true_boxes(drive(), replace(frame, plan=plan), line))


@settings(max_examples=60, deadline=None)
@given(
    st.floats(-1.0 / 30.0, 1.0 / 30.0),
    st.floats(-np.pi, np.pi),
    st.floats(0.0, 500.0),
    st.tuples(st.floats(-3.0, 3.0), st.floats(-1.0, 1.0)),
    st.floats(8.0, 35.0),
    st.floats(-4.0, 4.0),
)
def test_a_true_box_has_the_station_and_offset_of_the_agent_on_any_reference_line(
    curvature: float,
    yaw: float,
    begin: float,
    wave: tuple[float, float],
    ahead: float,
    offset: float,
) -> None:
    """The path swings about a circular reference line, which is laid so that an agent has these."""

    def point(s: np.ndarray, l: np.ndarray) -> np.ndarray:
        turned = yaw + curvature * s
        line = np.cumsum(np.r_[0.0, np.full(4000, 0.01)])
        angle = yaw + curvature * (line - 0.005)
        x, y = (np.r_[0.0, np.cumsum(0.01 * f(angle[1:]))] for f in (np.cos, np.sin))
        feet = np.column_stack([np.interp(s, line, x), np.interp(s, line, y)])
        return feet + l[:, None] * np.column_stack([-np.sin(turned), np.cos(turned)])

    t = drive().frames[0].t
    agents = drive().agents.truth(t)
    swing = wave[0] + wave[1] * np.sin(STATIONS / 8.0)
    rate = wave[1] * np.cos(STATIONS / 8.0) / 8.0
    path = point(STATIONS, swing)
    path += [agents.x[0], agents.y[0]] - point(np.array([ahead]), np.array([offset]))
    delta = np.arctan2(rate, 1.0 - curvature * swing)
    line = np.column_stack([begin + STATIONS, swing])
    drawn = boxes_on(path, yaw + curvature * STATIONS + delta, line, t)
    station, lateral = drawn[0].mean(axis=0)
    half = 0.5 * np.hypot(agents.length[0], agents.width[0])
    bent = half**2 * abs(curvature)  # corners of a box on a bent line are not around its centre
    assert abs(station - begin - ahead) < 0.15 + bent
    assert abs(lateral - offset) < 0.15 + bent


def test_boxes_far_beyond_the_end_of_the_path_are_left_out() -> None:
    t = drive().frames[0].t
    agents = drive().agents.truth(t)
    behind = np.array([agents.x[0] - 2.0 * BEYOND_M - STATIONS[-1], agents.y[0]])
    path = behind + np.column_stack([STATIONS, 0.0 * STATIONS])
    line = np.column_stack([STATIONS, 0.0 * STATIONS])
    near = path + np.array([1.5 * BEYOND_M, 0.0])
    is_near = [len(boxes_on(points, 0.0 * STATIONS, line, t)) for points in (path, near)]
    assert is_near[0] < is_near[1]
