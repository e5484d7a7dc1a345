"""Quaternions, and the ego's states from recorded poses.

(1) yaw = atan2(2 (qw qz + qx qy), 1 - 2 (qy^2 + qz^2))              q = (qw, qx, qy, qz) of unit length
(2) world point of a body point b: p + q b q*                        world orientation of a part r: q r

Speed and acceleration where the log has none. Recorded poses wander by centimetres, at 100 Hz and more: differences of
neighbours are useless. So at each state a parabola is fitted to the poses of the `WINDOW_S` before it, none after it:

(3) min over c of  sum_i |p_i - c_0 - c_1 tau_i - c_2 tau_i^2|^2,    tau_i = t_i - t_k in [-WINDOW_S, 0]
    v = c_1 . h,  a = 2 c_2 . h,  yaw rate w = c_1 of the heading,   h the heading's unit vector
(4) where there are fewer than `ENOUGH` poses or they span less than `SPAN_S`: a straight line, and a = 0
(5) who moved less than `STILL_M` in the last `STILL_S`, or against v, stands: v = a = 0
(6) kappa = w / v; below `ROLLING_MPS` the value before, at first 0
"""

from __future__ import annotations

import numpy as np

from logs.kernel import BoolArray, FloatArray, IntArray
from logs.mcap.complete import completed
from logs.states import Trajectory

WINDOW_S = 0.5
"""With less the acceleration is noise (Argoverse 2: 99th percentile 8.6 m/s2 at 0.1 s, 3.1 at 0.5 s, as driven)."""
ENOUGH = 5
ROUNDED = 0.01
"""Unit quaternions may be off by so much."""
SPAN_S = 0.3
ROLLING_MPS = 0.5
STILL_M, STILL_S = 0.05, 0.3
"""The parabola of a stop swings through 0: 0.3 m/s backwards after braking with 3 m/s2."""
STATE_S = 0.1
"""Ego states are kept at the frames of the boxes and, where these are at half of this rate or less, so often."""
SOONEST_S = 0.03
"""Two states are not nearer than this."""


def is_unit(q: FloatArray) -> BoolArray:
    """Which quaternions `(n, 4)` have unit length, but for rounding."""
    return np.asarray(np.abs(np.sqrt((q * q).sum(axis=1)) - 1.0) < ROUNDED)


def unit(q: FloatArray) -> FloatArray:
    """Quaternions `(n, 4)` of unit length exactly; ValueError where one is farther from it than by rounding."""
    if not is_unit(q).all():
        raise ValueError("an orientation is no quaternion of unit length")
    return q / np.sqrt((q * q).sum(axis=1, keepdims=True))


def yaw_of(q: FloatArray) -> FloatArray:
    """Heading (1) `(n,)` of unit quaternions `(n, 4)`, rad."""
    w, x, y, z = q.T
    return np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def rotated(q: FloatArray, b: FloatArray) -> FloatArray:
    """Body vectors `(n, 3)` in the world (2) by unit quaternions `(n, 4)`."""
    w, axis = q[:, :1], q[:, 1:]
    twice = 2.0 * np.cross(axis, b)
    return b + w * twice + np.cross(axis, twice)


def composed(q: FloatArray, r: FloatArray) -> FloatArray:
    """Products q r (2) of quaternions `(n, 4)`."""
    w, x, y, z = q.T
    a, b, c, d = r.T
    columns = (
        w * a - x * b - y * c - z * d,
        w * b + x * a + y * d - z * c,
        w * c - x * d + y * a + z * b,
        w * d + x * c - y * b + z * a,
    )
    return np.column_stack(columns)


def fitted(t: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """First and second derivative (3) of `values` `(n, c)` at each time `(n,)`, s, from the samples up to it.

    The second is NaN where (4) holds; both are NaN at the first sample.
    """
    n, c = values.shape
    moments, sums = np.zeros((5, n)), np.zeros((3, n, c))
    span = np.zeros(n)
    for back in range(n):
        at = np.arange(back, n)
        tau = (t[at - back] - t[at]) / WINDOW_S
        used = (tau >= -1.0 - 1e-9) | (back == 1)
        if not used.any():
            break
        at, tau = at[used], tau[used]
        span[at] = np.maximum(span[at], -tau * WINDOW_S)
        away = values[at - back] - values[at]
        for k in range(5):
            moments[k, at] += tau**k
        for k in range(3):
            sums[k, at] += (tau**k)[:, None] * away
    first, second = np.full((n, c), np.nan), np.full((n, c), np.nan)
    curved = (moments[0] >= ENOUGH) & (span >= SPAN_S)
    line = ~curved & (moments[0] >= 2)
    for chosen, size in ((curved, 3), (line, 2)):
        if chosen.any():
            matrix = np.array([[moments[i + j, chosen] for j in range(size)] for i in range(size)]).transpose(2, 0, 1)
            found = np.linalg.solve(matrix, sums[:size, chosen].transpose(1, 0, 2))
            first[chosen] = found[:, 1] / WINDOW_S
            if size == 3:
                second[chosen] = 2.0 * found[:, 2] / WINDOW_S**2
    return first, second


def kept(times: FloatArray, frames: FloatArray) -> IntArray:
    """Which states to keep, from the first frame (s) to the last: the nearest to each, others every `STATE_S` between.

    Without frames: one every `STATE_S`.
    """
    if not len(frames):
        frames = times[[0, -1]]
    after = np.clip(np.searchsorted(times, frames), 0, len(times) - 1)
    earlier = np.maximum(after - 1, 0)
    nearer = np.abs(times[earlier] - frames) < np.abs(times[after] - frames)
    chosen = set(np.where(nearer, earlier, after).tolist())
    out: list[int] = []
    for i in sorted(chosen):
        while out and times[i] - times[out[-1]] >= 2.0 * STATE_S - 1e-6:
            j = int(np.searchsorted(times, times[out[-1]] + STATE_S - 1e-6))
            if j >= i or times[i] - times[j] < 0.5 * STATE_S:
                break
            out.append(j)
        if not out or times[i] - times[out[-1]] >= SOONEST_S:
            out.append(i)
    return np.array(out, dtype=np.int64)


def from_second(index: IntArray, times: FloatArray, first: FloatArray, notes: list[str]) -> IntArray:
    """The states after the first frame: `first` is its time, s, or nothing where there are no frames."""
    begin = int(np.argmin(np.abs(times[index] - first[0]))) + 1 if len(first) else 1
    if begin + 1 >= len(index):
        return index
    notes.append("The scenario begins at the second frame: velocities are derived from what was before.")
    return index[begin:]


def since(start: float, t: FloatArray) -> FloatArray:
    """Times since `start`, s, in whole nanoseconds, as logs keep them."""
    return np.asarray(np.rint(1e9 * (t - start)) / 1e9)


def held_curvature(rate: FloatArray, v: FloatArray) -> FloatArray:
    """(6) of yaw rates and speeds `(n,)`, 1/m."""
    rolling = (np.abs(v) >= ROLLING_MPS) & np.isfinite(rate)
    kappa = np.divide(rate, v, out=np.zeros(len(v)), where=rolling)
    held = np.maximum.accumulate(np.where(rolling, np.arange(len(v)), -1))
    return np.where(held >= 0, kappa[held], 0.0)


def stands(t: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray, v: FloatArray) -> BoolArray:
    """(5): which of the states `(n,)` with derived speeds v stand."""
    earlier = np.maximum(np.searchsorted(t, t - STILL_S + 1e-6, side="right") - 1, 0)
    moved = (x - x[earlier]) * np.cos(yaw) + (y - y[earlier]) * np.sin(yaw)
    return (t - t[earlier] >= STILL_S - 1e-6) & ((np.abs(moved) < STILL_M) | (moved * v < 0.0))


def driven(t: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray, notes: list[str]) -> Trajectory:
    """The trajectory through poses `(n,)` by (3) to (6); times increase strictly.

    Raises:
        ValueError: As `Trajectory`.
    """
    yaw = np.unwrap(yaw)
    first, second = fitted(t, np.column_stack([x, y, yaw]))
    ahead = np.column_stack([np.cos(yaw), np.sin(yaw)])
    v, a = (first[:, :2] * ahead).sum(axis=1), (second[:, :2] * ahead).sum(axis=1)
    v[0] = v[1] if len(v) > 1 else 0.0
    notes.append(
        f"The ego's speed, acceleration and curvature are derived: parabolas fitted to the poses of the {WINDOW_S} s"
        " before each state."
    )
    columns = {"t": t, "x": x, "y": y, "yaw": yaw, "v": v, "a": a, "kappa": held_curvature(first[:, 2], v)}
    if np.isfinite(a).any():
        still = stands(t, x, y, yaw, v)
        columns["v"] = np.where(still, 0.0, v)
        columns["a"] = np.where(still | np.isnan(a), 0.0, a)
    return completed(columns, notes)


def states_at(whole: Trajectory, index: IntArray) -> Trajectory:
    """The states at `index`."""
    names = ("t", "x", "y", "yaw", "v", "a", "kappa")
    return Trajectory(*(getattr(whole, name)[index] for name in names))
