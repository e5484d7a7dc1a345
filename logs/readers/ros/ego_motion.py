"""Completes the motion of the ego: speed, acceleration and curvature, logged or derived.

A topic of speeds or accelerations is used if it has no gap over `COVERS_S`; a pose gets its last
value. Motion is derived causally from the poses (`replan.logs.readers.ros.fits`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from replan.core.arrays import FloatArray, IntArray
from replan.logs.ego_columns import with_agreed_columns
from replan.logs.readers.recorded import held_curvature, stands
from replan.logs.readers.ros.bag import Topic
from replan.logs.readers.ros.ego import LEAST_POSES, EgoLog
from replan.logs.readers.ros.fits import rates
from replan.logs.readers.ros.frames import HELD, times_of
from replan.logs.readers.ros.part import BagPart
from replan.logs.readers.ros.schemas import ACCELERATIONS, SPEEDS, STAMP, twist_fields
from replan.logs.readers.ros.transforms import MAP_NAMES, moved, own_frames

COVERS_S = 0.5
"""Longest gap of a signal that covers the drive, s."""
WARM_UP_S = 0.3
"""Time of poses before the first state, s, from which its speed is derived without later poses."""
WINDOW_S, LEAST_INTERVALS = 0.6, 3.0
"""The window of the fits, s; the shortest one, in usual intervals."""
STANDS_MPS = 0.05
"""Slower cars stand, m/s: the localisation of a standing car moves at such speeds."""


@dataclass(frozen=True, eq=False)
class Signal:
    """A number over time: increasing times `(n,)` ns on the scenario's clock, and values."""

    topic: str
    t: IntArray
    values: FloatArray


def signal(part: BagPart, kinds: Mapping[str, str], role: str, ego: EgoLog) -> Signal | None:
    """Read the topic of a role as numbers; None if no topic has at least two messages.

    A twist or acceleration in the frame of a sensor becomes that of the ego's base where transforms
    lead there.
    """
    for topic in part.topics(kinds, role):
        if topic.count < LEAST_POSES and role not in part.settings.topics:
            continue
        log, stamps, values = _read_numbers(part, topic, kinds[topic.kind], ego)
        is_finite = np.isfinite(values)
        if not is_finite.any():
            continue
        log, stamps, values = log[is_finite], stamps[is_finite], values[is_finite]
        t, keep = times_of(topic.name, log, stamps, ego.clock, part.notes)
        if len(t):
            return Signal(topic.name, t, values[keep])
    return None


def _read_numbers(
    part: BagPart, topic: Topic, path: str, ego: EgoLog
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return log times and stamps, ns, and the numbers `(n,)` at `path` in a topic's messages; the
    first component of a vector at the ego's base.
    """
    stamp = STAMP if part.bag.has(topic, "header.stamp") else ("stamp.sec", "stamp.nanosec")
    vector = path.removesuffix("linear.x")
    if vector == path:
        log, stamps, rows = part.read(topic, (path,), stamp)
        return log, stamps, np.array([value for (value,) in rows], dtype=np.float64)
    log, stamps, rows = part.read(topic, ("header.frame_id", *twist_fields(vector)), stamp)
    if not rows:
        return log, stamps, np.empty(0)
    twist: FloatArray = np.array([numbers for _, *numbers in rows], dtype=np.float64)
    frame = rows[0][0].lstrip("/")
    own = own_frames(ego.frames, {ego.map, *MAP_NAMES})
    if frame != ego.base and frame in own.names and own.connects(frame, ego.base):
        twist = moved(twist, own.poses(frame, ego.base, log, HELD))
        part.notes.append(
            f"{topic.name} is of frame '{frame}': transforms of the bag move it to '{ego.base}'."
        )
    return log, stamps, twist[:, 0]


def at_poses(measured: Signal | None, t: IntArray, word: str, notes: list[str]) -> FloatArray:
    """Return the signal's last value at each pose `(n,)`.

    All NaN, with a note, if it does not cover all poses.
    """
    unknown = np.full(len(t), np.nan)
    if measured is None:
        return unknown
    before = np.searchsorted(measured.t, t, side="right") - 1
    age = np.where(before >= 0, (t - measured.t[np.maximum(before, 0)]) / 1e9, np.inf)
    if age.max() > COVERS_S:
        notes.append(
            f"{measured.topic} has no {word} for part of the drive and is not used for it."
        )
        return unknown
    notes.append(f"The ego's {word} is that of {measured.topic}.")
    return measured.values[before]


def logged_motion(part: BagPart, ego: EgoLog) -> tuple[FloatArray, FloatArray]:
    """Speed and acceleration at the poses `(n,)` as far as they are logged; else NaN."""
    v, notes = ego.v, part.notes
    if np.isfinite(v).all() and "speed" not in part.settings.topics:
        notes.append(f"The ego's speed is that of {ego.source}.")
    else:
        v = at_poses(signal(part, SPEEDS, "speed", ego), ego.poses.t, "speed", notes)
    measured = signal(part, ACCELERATIONS, "acceleration", ego)
    return v, at_poses(measured, ego.poses.t, "acceleration", notes)


def states(ego: EgoLog, v: FloatArray, a: FloatArray, notes: list[str]) -> dict[str, FloatArray]:
    """Return columns x, y, yaw, v, a, kappa `(n,)` of all poses; kappa is derived, and v and a
    where they are NaN.

    In the first `WARM_UP_S` of the log, a derived speed has too few poses: `begin_of` leaves them
    out.
    """
    t = (ego.poses.t - ego.poses.t[0]) / 1e9
    x, y, _ = ego.poses.p.T
    yaw = np.unwrap(ego.poses.yaw)
    unknown = np.full(len(x), np.nan)
    logged = {"t": t, "x": x, "y": y, "yaw": yaw, "v": v, "a": a, "kappa": unknown}
    logged = with_agreed_columns(logged, notes)
    v, a = logged["v"], logged["a"]
    usual = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    window_s = max(WINDOW_S, LEAST_INTERVALS * usual)
    derived_v, derived_a, yaw_rate = _derived(t, x, y, yaw, window_s)
    lacking = [
        word
        for word, column in (("speed", v), ("acceleration", a))
        if not np.isfinite(column).all()
    ]
    notes.append(
        f"The log has no ego {' and no ego '.join([*lacking, 'curvature'])}: derived from the "
        f"poses of the last {window_s:.2g} s (least squares, no later pose)."
    )
    v = np.where(np.isfinite(v), v, derived_v)
    a = np.where(np.isfinite(a), a, derived_a)
    return {"x": x, "y": y, "yaw": yaw, "v": v, "a": a, "kappa": held_curvature(yaw_rate, v)}


def _derived(
    t: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray, window_s: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return speed, acceleration and yaw rate `(n,)` by fits to the poses of the last `window_s`
    s.
    """
    values = np.array([x - x[0], y - y[0], yaw])
    first, window = np.zeros(len(t), np.int64), np.full(len(t), window_s)
    rate, change = rates(t, values, first, window, parabola=True)
    (vx, vy, yaw_rate), (ax, ay, _) = rate, change
    lone = 1 + np.flatnonzero(np.isnan(vx[1:]))  # the first after a gap: the way over the gap
    rate[:, lone] = (values[:, lone] - values[:, lone - 1]) / (t[lone] - t[lone - 1])
    change[:, lone] = 0.0
    cos, sin = np.cos(yaw), np.sin(yaw)
    v, a = vx * cos + vy * sin, ax * cos + ay * sin
    if len(t) > 1:
        v[0], a[0], yaw_rate[0] = v[1], 0.0, yaw_rate[1]
    is_still = (np.abs(v) < STANDS_MPS) | stands(t, x, y, yaw, v)
    return np.where(is_still, 0.0, v), np.where(is_still, 0.0, a), yaw_rate


def begin_of(ego: EgoLog, v: FloatArray) -> int:
    """Return the first pose that becomes a state: pose 0, or the first after `WARM_UP_S` if the
    speed is derived.
    """
    if np.isfinite(v).all():
        return 0
    t = ego.poses.t
    warm = int(np.searchsorted(t, t[0] + round(1e9 * WARM_UP_S)))
    return warm if len(t) - warm > len(t) // 2 else 0
