"""Reads the on-board plans of a bag, each known from the time of its message on.

Plans whose points have no times (Autoware leaves `time_from_start` at 0) are timed by their speeds:

(1) t_(i+1) = t_i + 2 d_i / (v_i + v_(i+1)),
        d_i the distance of two points; where the mean of both speeds is below `STANDS_MPS` the plan
        stands. The time of the point nearest to the ego is that of the message
"""

from __future__ import annotations

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.logs.complete import derived_acceleration, derived_curvature
from replan.logs.readers.recorded import unit_or_identity
from replan.logs.readers.ros import schemas
from replan.logs.readers.ros.ego import EgoLog
from replan.logs.readers.ros.frames import HELD, Poses, describe_timing, times_of
from replan.logs.readers.ros.part import BagPart
from replan.logs.readers.ros.schemas import POSITION
from replan.logs.states import OnboardPlan, Trajectory

STANDS_MPS = 0.05
"""Slower plans stand: the time over a distance is not known, m/s."""
USUAL_TOPICS = ("/scenario_planning/trajectory", "/planning/trajectory")
"""Ends of the names of Autoware's topics of the final plan: they go before others."""
PLAN_POINT = (
    "time_from_start.sec",
    "time_from_start.nanosec",
    *(f"pose.{name}" for name in POSITION),
    "longitudinal_velocity_mps",
    "acceleration_mps2",
)
"""The fields of a point of an on-board plan."""


def read_onboard_plans(
    part: BagPart, ego: EgoLog, t0: int, origin: FloatArray
) -> tuple[OnboardPlan, ...]:
    """Read the on-board plans, each known from the time of its message on."""
    topics, notes = part.topics(schemas.PLANS, "plan"), part.notes
    if not topics:
        return ()
    usual = [topic for topic in topics if topic.name.endswith(USUAL_TOPICS)]
    topic = usual[0] if usual and "plan" not in part.settings.topics else topics[0]
    log, stamps, rows = part.read(topic, ("header.frame_id", ("points", PLAN_POINT)))
    t, keep = times_of(topic.name, log, stamps, ego.clock, notes)
    known = np.maximum(ego.clock(log[keep]), t) if len(keep) else t
    plans: dict[int, OnboardPlan] = {}
    for time, when, k in zip(t.tolist(), known.tolist(), keep.tolist(), strict=True):
        planned = _plan(rows[k], time, t0, ego, origin)
        if planned is not None:
            plans[when] = OnboardPlan((when - t0) / 1e9, planned)
    notes += describe_timing(topic.name, log, stamps, int(log[0])) if len(log) else []
    if rows:
        several = f" (of {len(topics)} such topics)" if len(topics) > 1 else ""
        _, points = rows[0]
        has_times = any(sec or nanosec for sec, nanosec, *_ in points)
        timed = "by their own times" if has_times else "by their speeds"
        notes.append(
            f"{len(plans)} on-board plans are those of {topic.name}{several}, timed {timed}."
        )
    return tuple(plans[when] for when in sorted(plans))


def _plan(
    row: tuple[object, ...], time: int, t0: int, ego: EgoLog, origin: FloatArray
) -> Trajectory | None:
    """The plan of a message of a time, ns; None if it has no point that can be used."""
    frame, points = row
    assert isinstance(points, list)
    values = np.array(points, dtype=np.float64).reshape(-1, len(PLAN_POINT))
    values = values[np.isfinite(values).all(axis=1)]
    if not len(values):
        return None
    after, p, q, motion = np.hsplit(values, [2, 5, 9])  # as in `PLAN_POINT`
    pose = ego.in_map(Poses(np.full(len(values), time), p, unit_or_identity(q)), str(frame))
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
