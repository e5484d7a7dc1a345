"""Makes ego states from recorded poses, tracks from recorded boxes, and computes with rotations.

Boxes. A track's size is the median of its boxes. An object (cone, barrier, sign) whose boxes stay
within `STAYS_M` of their median for `SEEN_S` or longer is static, at that median. Vehicles and
people are never static: while the ego drives past a parked car, it cannot know that the car will
stay parked.

Poses. If the log has no speed, it is derived. Recorded poses jitter by centimetres at 100 Hz and
more, so differences of neighbours are useless. At each state, a parabola is fitted to the poses of
the `WINDOW_S` before it, and to no later pose:

(1) min over c of  sum_i |p_i - c_0 - c_1 tau_i - c_2 tau_i^2|^2,
        tau_i = t_i - t_k in [-WINDOW_S, 0]
    v = c_1 . h,  a = 2 c_2 . h,  yaw rate w = c_1 of the heading,
        h the unit vector of the heading
(2) with fewer than `ENOUGH` poses, or poses that span less than `SPAN_S`: a straight line,
        and a = 0
(3) an ego that moved less than `STILL_M` in the last `STILL_S`, or opposite to v, stands: v = a = 0
(4) kappa = w / v; below `ROLLING_MPS` the previous value, initially 0

Rotations are quaternions q = (x, y, z, w) of unit length, rows of `(n, 4)`:

(5) heading of the rotated x axis = atan2(2 (w z + x y), 1 - 2 (y^2 + z^2))
(6) rotated vector = q p q* = p + 2 w u x p + 2 u x (u x p),   u = (x, y, z)
(7) product q r: first r, then q
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from replan.core.arrays import BoolArray, Columns, FloatArray, IntArray
from replan.logs.agents import USUAL_SIZE_M, AgentKind, ObjectClass
from replan.logs.complete import completed
from replan.logs.edit.cut import HISTORY_S
from replan.logs.heights import on_the_way
from replan.logs.states import Trajectory
from replan.logs.tracks import Tracks

ROUNDED = 0.01
"""Tolerance of the length of a stored quaternion, which should be 1."""


def is_unit(q: FloatArray) -> BoolArray:
    """Return which quaternions `(n, 4)` have unit length, within `ROUNDED`."""
    return np.asarray(np.abs(np.sqrt((q * q).sum(axis=1)) - 1.0) < ROUNDED)


def unit_of_wxyz(q: FloatArray) -> FloatArray:
    """Convert quaternions (w, x, y, z) to unit ones (x, y, z, w), `(n, 4)`; ValueError beyond
    `ROUNDED`.
    """
    if not is_unit(q).all():
        raise ValueError("an orientation is not a quaternion of unit length")
    return np.roll(q / np.sqrt((q * q).sum(axis=1, keepdims=True)), -1, axis=1)


def unit_or_identity(q: FloatArray) -> FloatArray:
    """Normalise quaternions `(n, 4)`.

    Those of length 0, which senders leave empty, become the identity.
    """
    size = np.linalg.norm(q, axis=1, keepdims=True)
    return np.where(
        size > 1e-9, q / np.where(size > 1e-9, size, 1.0), np.array([0.0, 0.0, 0.0, 1.0])
    )


def heading(q: FloatArray) -> FloatArray:
    """Return the heading (5) of the rotated x axis `(n,)`, rad."""
    x, y, z, w = q.T
    return np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def rotated(q: FloatArray, p: FloatArray) -> FloatArray:
    """Rotate the vectors p `(n, 3)` by q (6)."""
    u, w = q[:, :3], q[:, 3:]
    twice = 2.0 * np.cross(u, p)
    return np.asarray(p + w * twice + np.cross(u, twice))


def product(q: FloatArray, r: FloatArray) -> FloatArray:
    """Return the products q r (7)."""
    ax, ay, az, aw = q.T
    bx, by, bz, bw = r.T
    columns = (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )
    return np.column_stack(columns)


# Boxes

STAYS_M = 0.5
SEEN_S = 1.0
SOONEST_S = 1e-3
"""A second sample of a track within this time is a repetition, s."""


@dataclass(frozen=True, eq=False)
class RecordedBoxes(Columns):
    """All boxes of a log, `(m,)` each: time s, owner (index into `names`), centre m, rad, m, m/s,
    and the centre's height and the box's, m (NaN: unknown).
    """

    names: tuple[str, ...]
    kinds: tuple[AgentKind, ...]
    t: FloatArray
    owner: IntArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    length: FloatArray
    width: FloatArray
    vx: FloatArray
    vy: FloatArray
    z: FloatArray
    height: FloatArray
    object_classes: Mapping[str, ObjectClass] = field(default_factory=dict)

    @classmethod
    def empty(cls) -> RecordedBoxes:
        """No boxes."""
        none = np.empty(0)
        return cls((), (), none, np.empty(0, np.int64), *(none,) * 9)


def ordered(boxes: RecordedBoxes, notes: list[str]) -> RecordedBoxes:
    """Sort boxes by track and time, and leave out unusable boxes, with notes."""
    finite = np.logical_and.reduce(
        [np.isfinite(getattr(boxes, name)) for name in ("t", "x", "y", "yaw")]
    )
    if not finite.all():
        notes.append(
            f"{(~finite).sum()} of {len(finite)} boxes have a pose that is not finite and are left "
            "out."
        )
    boxes = boxes.taken(finite)
    boxes = boxes.taken(np.lexsort((boxes.t, boxes.owner)))
    if not len(boxes.t):
        return boxes
    again = np.r_[False, (np.diff(boxes.owner) == 0) & (np.diff(boxes.t) < SOONEST_S)]
    if again.any():
        notes.append(
            f"{again.sum()} boxes have the id of another one at the same time and are left out."
        )
    return boxes.taken(~again)


def on_level(boxes: RecordedBoxes, places: FloatArray, notes: list[str]) -> RecordedBoxes:
    """Leave out boxes above or below the ego's places `(n, 3)`, with a note
    (`replan.logs.heights`).
    """
    centres = np.column_stack([boxes.x, boxes.y, boxes.z])
    names = [boxes.names[i] for i in boxes.owner]
    return boxes.taken(on_the_way(places, centres, boxes.yaw, boxes.height, names, notes))


def tracks_of(boxes: RecordedBoxes, notes: list[str]) -> Tracks:
    """Make tracks from `ordered` boxes."""
    if not len(boxes.t):
        return Tracks.empty()
    owners, first = np.unique(boxes.owner, return_index=True)
    ends = np.r_[first[1:], len(boxes.t)]
    kinds = tuple(boxes.kinds[i] for i in owners)
    sizes, static, rows = np.full((len(owners), 2), np.nan), np.zeros(len(owners), np.bool_), []
    for k, (a, b) in enumerate(zip(first, ends, strict=True)):
        x, y = boxes.x[a:b], boxes.y[a:b]
        length, width = boxes.length[a:b], boxes.width[a:b]
        good = np.isfinite(length) & np.isfinite(width) & (length > 0.0) & (width > 0.0)
        if good.any():
            sizes[k] = np.median(length[good]), np.median(width[good])
        away = np.hypot(x - np.median(x), y - np.median(y))
        lasts = boxes.t[b - 1] - boxes.t[a] >= SEEN_S
        static[k] = kinds[k] is AgentKind.OBJECT and lasts and away.max() <= STAYS_M
        rows.append(np.array([a + int(np.argmin(away))]) if static[k] else np.arange(a, b))
    boxes, ends = boxes.taken(np.concatenate(rows)), np.cumsum([len(part) for part in rows])
    unsized = ~np.isfinite(sizes).all(axis=1)
    if unsized.any():
        notes.append(
            f"{unsized.sum()} of {len(owners)} road users have no size: that usual for their kind "
            "is assumed."
        )
        sizes[unsized] = [
            USUAL_SIZE_M[kind] for kind, lacks in zip(kinds, unsized, strict=True) if lacks
        ]
    if static.any():
        notes.append(
            f"{static.sum()} objects (cones, barriers, signs) stay within {STAYS_M} m and are "
            "taken as standing there."
        )
    pose = (boxes.t, boxes.x, boxes.y, boxes.yaw, boxes.vx, boxes.vy)
    offsets = np.r_[0, ends]
    return Tracks(
        tuple(boxes.names[i] for i in owners),
        kinds,
        sizes[:, 0],
        sizes[:, 1],
        static,
        offsets,
        *pose,
    )


# Poses

WINDOW_S = 0.5
"""Window of the fit, s: in shorter ones acceleration is noise (Argoverse 2: 99 % below 8.6 m/s2 at
0.1 s, 3.1 at 0.5)."""
ENOUGH = 5
SPAN_S = 0.3
ROLLING_MPS = 0.5
STILL_M, STILL_S = 0.05, 0.3
"""Bounds of a stand (3): after a stop the parabola overshoots, to -0.3 m/s after braking with 3
m/s2.
"""
STATE_S = 0.1
"""Ego states are kept at the frames of the boxes and, if those are twice this time apart or more,
at this interval, s."""
APART_S = 0.03
"""Least time between two states, s."""


def fitted(t: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return first and second derivative (1) of `values` `(n, c)` at each time `(n,)`, s, from
    samples up to it.

    The second is NaN where (2) applies; both are NaN at the first sample.
    """
    n, c = values.shape
    moments, sums = np.zeros((5, n)), np.zeros((3, n, c))
    span = np.zeros(n)
    for back in range(n):
        rows = np.arange(back, n)
        tau = (t[rows - back] - t[rows]) / WINDOW_S
        used = (tau >= -1.0 - 1e-9) | (back == 1)
        if not used.any():
            break
        rows, tau = rows[used], tau[used]
        span[rows] = np.maximum(span[rows], -tau * WINDOW_S)
        away = values[rows - back] - values[rows]
        for k in range(5):
            moments[k, rows] += tau**k
        for k in range(3):
            sums[k, rows] += (tau**k)[:, None] * away
    first, second = np.full((n, c), np.nan), np.full((n, c), np.nan)
    curved = (moments[0] >= ENOUGH) & (span >= SPAN_S)
    line = ~curved & (moments[0] >= 2)
    for chosen, size in ((curved, 3), (line, 2)):
        if chosen.any():
            matrix = np.array(
                [[moments[i + j, chosen] for j in range(size)] for i in range(size)]
            ).transpose(2, 0, 1)
            solution = np.linalg.solve(matrix, sums[:size, chosen].transpose(1, 0, 2))
            first[chosen] = solution[:, 1] / WINDOW_S
            if size == 3:
                second[chosen] = 2.0 * solution[:, 2] / WINDOW_S**2
    return first, second


def nearest(times: Any, wanted: Any) -> IntArray:
    """Return the row of increasing `times` `(n,)` nearest to each of `wanted` `(k,)`.

    Of two, the later one.
    """
    after = np.clip(np.searchsorted(times, wanted), 0, len(times) - 1)
    earlier = np.maximum(after - 1, 0)
    return np.where(np.abs(times[earlier] - wanted) < np.abs(times[after] - wanted), earlier, after)


def kept(times: FloatArray, frames: FloatArray) -> IntArray:
    """Return the states to keep: the nearest to each frame (s), and between frames one every
    `STATE_S`.

    Without frames, it is one every `STATE_S`.
    """
    if not len(frames):
        frames = times[[0, -1]]
    rows: list[int] = []
    for i in sorted(set(nearest(times, frames).tolist())):
        while rows and times[i] - times[rows[-1]] >= 2.0 * STATE_S - 1e-6:
            j = int(np.searchsorted(times, times[rows[-1]] + STATE_S - 1e-6))
            if j >= i or times[i] - times[j] < 0.5 * STATE_S:
                break
            rows.append(j)
        if not rows or times[i] - times[rows[-1]] >= APART_S:
            rows.append(i)
    return np.array(rows, dtype=np.int64)


def from_second(
    index: IntArray, times: FloatArray, first: FloatArray, notes: list[str]
) -> IntArray:
    """Return the states after the first frame; `first` holds its time, s, and is empty without
    frames.
    """
    begin = int(np.argmin(np.abs(times[index] - first[0]))) + 1 if len(first) else 1
    if begin + 1 >= len(index):
        return index
    notes.append(
        "The scenario begins at the second frame: velocities are derived from what was before."
    )
    return index[begin:]


class FromStart(NamedTuple):
    """A recording with the time and the origin of its first state: its states, those before them,
    its boxes, and the origin `(2,)`, m.
    """

    ego: Trajectory
    before: Trajectory | None
    boxes: RecordedBoxes
    origin: FloatArray


def from_start(whole: Trajectory, index: IntArray, boxes: RecordedBoxes) -> FromStart:
    """Shift time and origin to the first state of `index`; the states before it are the past.

    Times are rounded to whole nanoseconds, as in logs.
    """
    first = whole.state(int(index[0]))
    start, origin = first.t, np.round([first.x, first.y])

    def shifted(ego: Trajectory) -> Trajectory:
        t = np.rint(1e9 * (ego.t - start)) / 1e9
        return replace(ego, t=t, x=ego.x - origin[0], y=ego.y - origin[1])

    is_past = (whole.t < start) & (whole.t >= start - HISTORY_S)
    before = shifted(whole.taken(is_past)) if is_past.any() else None
    boxes_t = np.asarray(np.rint(1e9 * (boxes.t - start)) / 1e9)
    boxes = replace(boxes, t=boxes_t, x=boxes.x - origin[0], y=boxes.y - origin[1])
    return FromStart(shifted(whole.taken(index)), before, boxes, origin)


def held_curvature(rate: FloatArray, v: FloatArray) -> FloatArray:
    """Return the curvature (4) of yaw rates and speeds `(n,)`, 1/m."""
    rolling = (np.abs(v) >= ROLLING_MPS) & np.isfinite(rate)
    kappa = np.divide(rate, v, out=np.zeros(len(v)), where=rolling)
    held = np.maximum.accumulate(np.where(rolling, np.arange(len(v)), -1))
    return np.where(held >= 0, kappa[held], 0.0)


def stands(
    t: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray, v: FloatArray
) -> BoolArray:
    """Return which of the states `(n,)` with derived speeds v stand (3)."""
    earlier = np.maximum(np.searchsorted(t, t - STILL_S + 1e-6, side="right") - 1, 0)
    moved = (x - x[earlier]) * np.cos(yaw) + (y - y[earlier]) * np.sin(yaw)
    return (t - t[earlier] >= STILL_S - 1e-6) & ((np.abs(moved) < STILL_M) | (moved * v < 0.0))


def driven(
    t: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray, notes: list[str]
) -> Trajectory:
    """Derive the trajectory through poses `(n,)` by (1) to (4); times increase strictly."""
    yaw = np.unwrap(yaw)
    first, second = fitted(t, np.column_stack([x, y, yaw]))
    ahead = np.column_stack([np.cos(yaw), np.sin(yaw)])
    v, a = (first[:, :2] * ahead).sum(axis=1), (second[:, :2] * ahead).sum(axis=1)
    v[0] = v[1] if len(v) > 1 else 0.0
    notes.append(
        "The ego's speed, acceleration and curvature are derived: parabolas fitted to the poses "
        f"of the {WINDOW_S} s before each state."
    )
    columns = {
        "t": t,
        "x": x,
        "y": y,
        "yaw": yaw,
        "v": v,
        "a": a,
        "kappa": held_curvature(first[:, 2], v),
    }
    if np.isfinite(a).any():
        still = stands(t, x, y, yaw, v)
        columns["v"] = np.where(still, 0.0, v)
        columns["a"] = np.where(still | np.isnan(a), 0.0, a)
    return completed(columns, notes)
