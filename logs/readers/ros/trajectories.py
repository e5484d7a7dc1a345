"""Makes trajectories of the points that Autoware's planners publish.

Points without times (Autoware leaves `time_from_start` at 0) are timed by their speeds:

(1) t_(i+1) = t_i + 2 d_i / (v_i + v_(i+1)),
        d_i the distance of two points; where the mean of both speeds is below `STANDS_MPS` the plan
        stands. The time of the point nearest to the ego is that of the message
"""

from __future__ import annotations

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.logs.complete import derived_acceleration, derived_curvature
from replan.logs.readers.recorded import unit_or_identity
from replan.logs.readers.ros.ego import EgoLog
from replan.logs.readers.ros.frames import HELD, Poses
from replan.logs.readers.ros.schemas import POSITION
from replan.logs.states import Trajectory

STANDS_MPS = 0.05
"""Slower plans stand: the time over a distance is not known, m/s."""
PLAN_POINT = (
    "time_from_start.sec",
    "time_from_start.nanosec",
    *(f"pose.{name}" for name in POSITION),
    "longitudinal_velocity_mps",
    "acceleration_mps2",
)
"""The fields of a point of an on-board plan."""


def trajectory_of(
    frame: str,
    points: list[tuple[float, ...]],
    time: int,
    t0: int,
    ego: EgoLog,
    origin: FloatArray,
) -> Trajectory | None:
    """Return the trajectory of points `PLAN_POINT` in a frame, of a message of a time, ns; None if
    no point can be used.
    """
    values = np.array(points, dtype=np.float64).reshape(-1, len(PLAN_POINT))
    values = values[np.isfinite(values).all(axis=1)]
    if not len(values):
        return None
    after, p, q, motion = np.hsplit(values, [2, 5, 9])  # as in `PLAN_POINT`
    pose = ego.in_map(Poses(np.full(len(values), time), p, unit_or_identity(q)), frame)
    x, y = (pose.p[:, :2] - origin).T
    yaw, (v, a) = np.unwrap(pose.yaw), motion.T
    t: FloatArray = np.asarray(after[:, 0] + 1e-9 * after[:, 1])
    if t.any():
        keep: BoolArray = np.r_[True, np.diff(np.maximum.accumulate(t)) > 0.0]
    else:
        now = ego.frames.poses(ego.map, ego.base, np.array([time]), HELD).p[0, :2] - origin
        t, keep = _timed_by_speed(x, y, v, now)
    if not keep.any():
        return None
    t, x, y, yaw, v, a = (np.asarray(column[keep]) for column in (t, x, y, yaw, v, a))
    if not a.any() and len(t) > 1:
        a = derived_acceleration(t, v)
    return Trajectory(t + (time - t0) / 1e9, x, y, yaw, v, a, derived_curvature(x, y, yaw, v))


def _timed_by_speed(
    x: FloatArray, y: FloatArray, v: FloatArray, now: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Times (1) of points `(n,)`, s, 0 at the point nearest to the ego's position `now` `(2,)`, and
    which points are kept.

    These are the nearest one and those after it, until the plan stands.
    """
    t = np.zeros(len(x))
    if len(x) > 1:
        mean, distance = 0.5 * np.abs(v[:-1] + v[1:]), np.hypot(np.diff(x), np.diff(y))
        unknown = np.full(len(distance), np.nan)
        step = np.divide(distance, mean, out=unknown, where=mean >= STANDS_MPS)
        step[step <= 0.0] = np.nan
        t = np.r_[0.0, np.cumsum(step)]
    nearest = int(np.argmin(np.hypot(x - now[0], y - now[1])))
    t = t - t[nearest]
    return t, (np.arange(len(t)) >= nearest) & np.isfinite(t)
