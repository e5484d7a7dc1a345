"""Assigns the detections of a frame to known tracks, for the offline repair and the tracker; the filter of a track.

A constant-velocity Kalman filter joins, tracks and smooths. Per axis, with the covariance C = (pp, pv, vv) of position
m and velocity m/s, white acceleration of density q, m2/s3:
(1) pp += 2 d pv + d^2 vv + q d^3/3,  pv += d vv + q d^2/2,  vv += q d;  d s between samples
(2) update by a position with variance r: gains kp = pp / (pp + r), kv = pv / (pp + r);  C -= k k' (pp + r)
(3) update by a stand: (2) for the velocity 0 with variance `STAND_MPS`^2, with vv and pp exchanged
(4) backward pass: G = C F' C-^-1,  x += G (x_next - x-_next)  (Rauch, Tung, Striebel, AIAA Journal 3, 1965)

The noise of positions and of acceleration is the same on both axes of a box; only the uncertainty of the first velocity
differs: a vehicle moves along its axis. Along the axes of the first box, the two coordinates are therefore independent,
with one covariance each, and no matrix is inverted.

Assignment:

(5) m = e' S^-1 e with the detection's offset e from the predicted place of the track and its covariance S; a detection
    beyond `GATE`, or farther away than the `REACH` of the groups, is another object
(6) cost = m + ln det S + `OTHER_GROUP` if the group differs + `OTHER_SIZE` |ln of the sizes' ratio|: the frame's
    detections are assigned to the tracks with the least sum (Hungarian method)

Only frames up to the present one are used.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from logs.arrays import BoolArray, FloatArray, IntArray, frozen
from logs.kernel import inner_kernel, kernel
from logs.repair.detected_boxes import DENSITY, VEHICLE, Boxes

STAND_MPS, FIRST_MPS = 0.02, 10.0
"""Standard deviations of the velocity of a standing agent, and of the first sample of a smoothed track."""
X, Y, VX, VY, COS, SIN, ALONG, ACROSS, WIDTH = 0, 1, 2, 3, 4, 5, 6, 9, 12
"""Columns of states `(n, WIDTH)`; three each from `ALONG` and from `ACROSS` hold C."""


@inner_kernel
def _predict(cov: FloatArray, d: float, q: float) -> None:
    """Predict the covariance (1), in place."""
    cov[0] += d * (2.0 * cov[1] + d * cov[2]) + q * d**3 / 3.0
    cov[1] += d * cov[2] + 0.5 * q * d * d
    cov[2] += q * d


@inner_kernel
def _update(cov: FloatArray, r: float) -> tuple[float, float]:
    """Update the covariance (2) in place, and return the gains."""
    s = cov[0] + r
    kp, kv = cov[0] / s, cov[1] / s
    cov[2] -= kv * cov[1]
    cov[0] *= r / s
    cov[1] *= r / s
    return kp, kv


@kernel
def predict_all(states: FloatArray, d: float, q: FloatArray) -> None:
    """Predict each state `(n, WIDTH)` (1), in place; q `(n,)`."""
    for i in range(len(states)):
        states[i, X] += d * states[i, VX]
        states[i, Y] += d * states[i, VY]
        _predict(states[i, ALONG : ALONG + 3], d, q[i])
        _predict(states[i, ACROSS : ACROSS + 3], d, q[i])


@kernel
def update_one(state: FloatArray, x: float, y: float, r: float) -> None:
    """Update one state `(WIDTH,)` (2), in place, by a detection at x, y with variance r."""
    c, s = state[COS], state[SIN]
    ex, ey = x - state[X], y - state[Y]
    along, across = c * ex + s * ey, c * ey - s * ex
    pa, va = _update(state[ALONG : ALONG + 3], r)
    pc, vc = _update(state[ACROSS : ACROSS + 3], r)
    state[X] += c * pa * along - s * pc * across
    state[Y] += s * pa * along + c * pc * across
    state[VX] += c * va * along - s * vc * across
    state[VY] += s * va * along + c * vc * across


@kernel
def smoothed(t: FloatArray, z: FloatArray, r: FloatArray, q: float, stands: BoolArray) -> FloatArray:
    """Smooth positions z `(n, 2)` (NaN: not seen) with variances r `(n,)` at t `(n,)`; return x, y, vx, vy `(n, 4)`.

    `stands` `(n,)` marks times at which the velocity is 0. The first row of z must be a position.
    """
    n = len(t)
    after, before = np.empty((n, 4)), np.empty((n, 4))
    covs, carried = np.empty((n, 3)), np.empty((n, 3))
    state, cov = np.array([z[0, 0], z[0, 1], 0.0, 0.0]), np.array([r[0], 0.0, FIRST_MPS**2])
    for i in range(n):
        if i > 0:
            d = t[i] - t[i - 1]
            state[:2] += d * state[2:]
            _predict(cov, d, q)
        before[i], carried[i] = state, cov
        if np.isfinite(z[i, 0]):
            kp, kv = _update(cov, r[i])
            for axis in range(2):
                e = z[i, axis] - state[axis]
                state[axis] += kp * e
                state[2 + axis] += kv * e
        if stands[i]:
            kv, kp = _update(cov[::-1], STAND_MPS * STAND_MPS)  # (3)
            state[:2] -= kp * state[2:]
            state[2:] -= kv * state[2:]
        after[i], covs[i] = state, cov
    for i in range(n - 2, -1, -1):  # (4)
        d = t[i + 1] - t[i]
        pp, pv, vv = carried[i + 1]
        det = pp * vv - pv * pv
        fp0, fp1 = covs[i, 0] + d * covs[i, 1], covs[i, 1]
        fv0, fv1 = covs[i, 1] + d * covs[i, 2], covs[i, 2]
        g00, g01 = (fp0 * vv - fp1 * pv) / det, (fp1 * pp - fp0 * pv) / det
        g10, g11 = (fv0 * vv - fv1 * pv) / det, (fv1 * pp - fv0 * pv) / det
        for axis in range(2):
            ep, ev = after[i + 1, axis] - before[i + 1, axis], after[i + 1, 2 + axis] - before[i + 1, 2 + axis]
            after[i, axis] += g00 * ep + g01 * ev
            after[i, 2 + axis] += g10 * ep + g11 * ev
    return after


# Assignment

FIRST_ALONG, FIRST_ACROSS = frozen([10.0, 2.5, 3.0]), frozen([1.5, 2.5, 3.0])
"""Standard deviations of the speed at the first detection along and across the box, m/s: without
them, 29 % of the vehicle tracks began with a step above 2.5 m, 18 % sideways."""
REACH = frozen([4.0, 1.5, 1.5])
"""A detection farther from a track's predicted place is another object, m; Autoware's gates are 2 m."""
GATE = 13.8
"""The 99.9 % quantile of chi squared with 2 degrees of freedom."""
OTHER_GROUP, OTHER_SIZE, MOST_GROWTH, SIZE_MEMORY = 6.0, 2.0, 1.2, 0.8
"""A cluster may become a person and a person a cluster; a vehicle stays a vehicle.

Sizes may differ by a factor of up to e^`MOST_GROWTH`.
"""
AGE_S, YOUNG_AGE_S, YOUNG = 2.0, 0.35, 3
"""A track ends when it is not seen for `AGE_S`, or for `YOUNG_AGE_S` if it has at most `YOUNG` detections. A track that
was detected in the previous frame does not end."""
_NEVER = 1e6
_TRACK = np.dtype(
    [("state", np.float64, WIDTH), ("group", np.int64), ("size", np.float64, 2), ("name", np.int64),
     ("last", np.float64), ("hits", np.int64), ("missed", np.int64)]
)  # fmt: skip
"""Filter, group, size (shorter side first), number in order of birth, last time seen, detections, frames missed
since."""


@dataclass
class Association:
    """The state between two frames: the known `tracks` `(n,)`, the last frame's time, s, and the number of names."""

    tracks: NDArray[np.void] = field(default_factory=lambda: np.zeros(0, _TRACK))
    time: float = 0.0
    count: int = 0

    def steps(self, boxes: Boxes, frames: FloatArray) -> Iterator[tuple[float, slice, IntArray]]:
        """Yield for each frame its time, s, its detections among the boxes, and the names of their tracks."""
        ends = np.searchsorted(boxes.frame, np.arange(len(frames) + 1))
        for k, t in enumerate(frames.tolist()):
            rows = slice(int(ends[k]), int(ends[k + 1]))
            most = np.where(self.tracks["hits"] > YOUNG, AGE_S, YOUNG_AGE_S)
            tracks = self.tracks[(t - self.tracks["last"] <= most + 1e-9) | (self.tracks["missed"] < 1)]
            predict_all(tracks["state"], t - self.time, DENSITY[tracks["group"]])
            # each detection may begin a track
            found, group, variance = np.zeros(rows.stop - rows.start, _TRACK), boxes.group[rows], boxes.noise[rows] ** 2
            state = found["state"]
            place = state[:, :ALONG]
            state[:, X], state[:, Y] = boxes.x[rows], boxes.y[rows]
            state[:, COS], state[:, SIN] = np.cos(boxes.yaw[rows]), np.sin(boxes.yaw[rows])
            state[:, ALONG] = state[:, ACROSS] = variance
            state[:, ALONG + 2], state[:, ACROSS + 2] = FIRST_ALONG[group] ** 2, FIRST_ACROSS[group] ** 2
            found["size"] = np.sort(np.column_stack([boxes.length[rows], boxes.width[rows]]))
            found["group"], found["last"], found["hits"] = group, t, 1
            cost = _costs(tracks["state"], tracks["group"], tracks["size"], place, group, found["size"], variance)
            from scipy.optimize import linear_sum_assignment  # here: it takes long to load

            old, new = linear_sum_assignment(cost)
            good = cost[old, new] < _NEVER
            old, new = old[good], new[good]
            tracks["missed"] += 1
            for j, i in zip(old, new, strict=True):
                update_one(tracks["state"][j], place[i, X], place[i, Y], variance[i])
            tracks["size"][old] = SIZE_MEMORY * tracks["size"][old] + (1.0 - SIZE_MEMORY) * found["size"][new]
            tracks["missed"][old], tracks["last"][old] = 0, t
            tracks["hits"][old] += 1
            born = np.setdiff1d(np.arange(len(found)), new)
            found["name"][new], found["name"][born] = tracks["name"][old], self.count + np.arange(len(born))
            self.tracks, self.time, self.count = np.concatenate([tracks, found[born]]), t, self.count + len(born)
            yield t, rows, found["name"]


@kernel
def _costs(
    states: FloatArray, known: IntArray, sizes: FloatArray,
    place: FloatArray, seen: IntArray, seen_sizes: FloatArray, variance: FloatArray,
) -> FloatArray:  # fmt: skip
    """Return the cost (6) of each pair of track and detection `(n, k)`; `_NEVER` if they are different objects.

    Tracks: `states`, their groups `known`, `sizes`; detections: `place`, their groups `seen`, `seen_sizes`, `variance`.
    """
    out = np.full((len(states), len(place)), _NEVER)
    for i in range(len(states)):
        for j in range(len(place)):
            ex, ey = place[j, X] - states[i, X], place[j, Y] - states[i, Y]
            other = known[i] != seen[j]
            most = max(REACH[known[i]], REACH[seen[j]])
            if ex * ex + ey * ey > most * most or (other and (known[i] == VEHICLE or seen[j] == VEHICLE)):
                continue
            along, across = states[i, COS] * ex + states[i, SIN] * ey, states[i, COS] * ey - states[i, SIN] * ex
            sa, sc = states[i, ALONG] + variance[j], states[i, ACROSS] + variance[j]
            m = along * along / sa + across * across / sc
            growth = max(abs(np.log(sizes[i, 0] / seen_sizes[j, 0])), abs(np.log(sizes[i, 1] / seen_sizes[j, 1])))
            if m <= GATE and growth <= MOST_GROWTH:
                out[i, j] = m + np.log(sa * sc) + OTHER_GROUP * other + OTHER_SIZE * growth
    return out
