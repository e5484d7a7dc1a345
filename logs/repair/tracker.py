"""Joins detections to tracks frame by frame, with a filter; a causal tracker makes road users for
planners of them.

A constant-velocity Kalman filter joins, tracks and smooths. Per axis, with the covariance C = (pp,
pv, vv) of position m and velocity m/s, white acceleration of density q, m2/s3:
(1) pp += 2 d pv + d^2 vv + q d^3/3,  pv += d vv + q d^2/2,  vv += q d;  d s between samples
(2) update by a position with variance r: gains kp = pp / (pp + r), kv = pv / (pp + r);
        C -= k k' (pp + r)
(3) update by a stand: (2) for the velocity 0 with variance `STAND_MPS`^2, with vv and pp exchanged
(4) backward pass: G = C F' C-^-1,  x += G (x_next - x-_next)
        (Rauch, Tung, Striebel, AIAA Journal 3, 1965)

The noise of positions and of acceleration is the same on both axes of a box; only the uncertainty
of the first velocity differs: a vehicle moves along its axis. Along the axes of the first box, the
two coordinates are therefore independent, with one covariance each, and no matrix is inverted.

Assignment:

(5) m = e' S^-1 e with the detection's offset e from the predicted place of the track
        and its covariance S; a detection beyond `GATE`, or farther away than the `REACH` of the
        groups, is another object
(6) cost = m + ln det S + `OTHER_GROUP` if the group differs + `OTHER_SIZE` |ln
        of the sizes' ratio|: the frame's detections are assigned to the tracks with the least sum
        (Hungarian method)

Only frames up to the present one are used; the offline repair joins detections in this way, too.

Tracker:

(7) a track is reported once it has the evidence that its group requires (`BIRTH_TIME`,
    `BIRTH_COUNT`, `BIRTH_SCORE`), until it was not seen for `KEEP_STILL_S` (standing), `KEEP_S`
    (moving), or `KEEP_YOUNG_S` (moving, with at most `FEW` detections)
(8) it stands if a line fitted to its detections of the last `WINDOW_S` has a speed below `SLOW`,
    and the filter's speed is below `FILTER_SLOW` times that: over shorter times, the drift of boxes
    looks like motion
(9) kind, length and width: votes of its detections, by score; axis of the box: averaged with
    `YAW_MEMORY`; front: the direction of motion, or of most headings
(10) between frames, and while it is not seen, it is extrapolated with its velocity, whose deviation
     grows
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from replan.core.arrays import BoolArray, FloatArray, IntArray, frozen
from replan.core.kernel import inner_kernel, kernel
from replan.logs.agents import NUMBERS, OLDEST_S, AgentKind, Agents
from replan.logs.repair.detected_boxes import (
    CLUSTER,
    DENSITY,
    FAST,
    NOISE,
    PERSON,
    SLIDES,
    SLOW,
    VEHICLE,
    Boxes,
    stronger_twins,
)

STAND_MPS, FIRST_MPS = 0.02, 10.0
"""Standard deviations of the velocity of a standing agent, and of the first sample of a smoothed
track.
"""
X, Y, VX = 0, 1, 2
VY, COS, SIN = 3, 4, 5
ALONG, ACROSS, WIDTH = 6, 9, 12
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
def smoothed(
    t: FloatArray, z: FloatArray, r: FloatArray, q: float, stands: BoolArray
) -> FloatArray:
    """Smooth positions z `(n, 2)` (NaN: not seen) with variances r `(n,)` at t `(n,)`; return x, y,
    vx, vy `(n, 4)`.

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
            ep, ev = (
                after[i + 1, axis] - before[i + 1, axis],
                after[i + 1, 2 + axis] - before[i + 1, 2 + axis],
            )
            after[i, axis] += g00 * ep + g01 * ev
            after[i, 2 + axis] += g10 * ep + g11 * ev
    return after


# Assignment

FIRST_ALONG, FIRST_ACROSS = frozen([10.0, 2.5, 3.0]), frozen([1.5, 2.5, 3.0])
"""Standard deviations of the speed at the first detection along and across the box, m/s: without
them, 29 % of the vehicle tracks began with a step above 2.5 m, 18 % sideways."""
REACH = frozen([4.0, 1.5, 1.5])
"""A detection farther from a track's predicted place is another object, m; Autoware's gates are 2
m.
"""
GATE = 13.8
"""The 99.9 % quantile of chi squared with 2 degrees of freedom."""
OTHER_GROUP, OTHER_SIZE = 6.0, 2.0
MOST_GROWTH, SIZE_MEMORY = 1.2, 0.8
"""A cluster may become a person and a person a cluster; a vehicle stays a vehicle.

Sizes may differ by a factor of up to e^`MOST_GROWTH`.
"""
AGE_S, YOUNG_AGE_S, YOUNG = 2.0, 0.35, 3
"""A track ends when it is not seen for `AGE_S`, or for `YOUNG_AGE_S` if it has at most `YOUNG`
detections. A track that was detected in the previous frame does not end."""
_NEVER = 1e6
_TRACK = np.dtype(
    [
        ("state", np.float64, WIDTH),
        ("group", np.int64),
        ("size", np.float64, 2),
        ("name", np.int64),
        ("last", np.float64),
        ("hits", np.int64),
        ("missed", np.int64),
    ]
)
"""Filter, group, size (shorter side first), number in order of birth, last time seen, detections,
frames missed since."""


@dataclass
class Association:
    """The state between two frames: the known `tracks` `(n,)`, the last frame's time, s, and the
    number of names.
    """

    tracks: NDArray[np.void] = field(default_factory=lambda: np.zeros(0, _TRACK))
    time: float = 0.0
    count: int = 0

    def steps(self, boxes: Boxes, frames: FloatArray) -> Iterator[tuple[float, slice, IntArray]]:
        """Yield for each frame its time, s, its detections among the boxes, and the names of their
        tracks.
        """
        ends = np.searchsorted(boxes.frame, np.arange(len(frames) + 1))
        for k, t in enumerate(frames.tolist()):
            rows = slice(int(ends[k]), int(ends[k + 1]))
            most = np.where(self.tracks["hits"] > YOUNG, AGE_S, YOUNG_AGE_S)
            tracks = self.tracks[
                (t - self.tracks["last"] <= most + 1e-9) | (self.tracks["missed"] < 1)
            ]
            predict_all(tracks["state"], t - self.time, DENSITY[tracks["group"]])
            # each detection may begin a track
            new_tracks, group, variance = (
                np.zeros(rows.stop - rows.start, _TRACK),
                boxes.group[rows],
                boxes.noise[rows] ** 2,
            )
            state = new_tracks["state"]
            place = state[:, :ALONG]
            state[:, X], state[:, Y] = boxes.x[rows], boxes.y[rows]
            state[:, COS], state[:, SIN] = np.cos(boxes.yaw[rows]), np.sin(boxes.yaw[rows])
            state[:, ALONG] = state[:, ACROSS] = variance
            state[:, ALONG + 2], state[:, ACROSS + 2] = (
                FIRST_ALONG[group] ** 2,
                FIRST_ACROSS[group] ** 2,
            )
            new_tracks["size"] = np.sort(np.column_stack([boxes.length[rows], boxes.width[rows]]))
            new_tracks["group"], new_tracks["last"], new_tracks["hits"] = group, t, 1
            cost = _costs(
                tracks["state"],
                tracks["group"],
                tracks["size"],
                place,
                group,
                new_tracks["size"],
                variance,
            )
            from scipy.optimize import linear_sum_assignment  # here: it takes long to load

            old, new = linear_sum_assignment(cost)
            good = cost[old, new] < _NEVER
            old, new = old[good], new[good]
            tracks["missed"] += 1
            for j, i in zip(old, new, strict=True):
                update_one(tracks["state"][j], place[i, X], place[i, Y], variance[i])
            tracks["size"][old] = (
                SIZE_MEMORY * tracks["size"][old] + (1.0 - SIZE_MEMORY) * new_tracks["size"][new]
            )
            tracks["missed"][old], tracks["last"][old] = 0, t
            tracks["hits"][old] += 1
            born = np.setdiff1d(np.arange(len(new_tracks)), new)
            new_tracks["name"][new], new_tracks["name"][born] = (
                tracks["name"][old],
                self.count + np.arange(len(born)),
            )
            self.tracks, self.time, self.count = (
                np.concatenate([tracks, new_tracks[born]]),
                t,
                self.count + len(born),
            )
            yield t, rows, new_tracks["name"]


@kernel
def _costs(
    states: FloatArray,
    known: IntArray,
    sizes: FloatArray,
    place: FloatArray,
    seen: IntArray,
    seen_sizes: FloatArray,
    variance: FloatArray,
) -> FloatArray:
    """Return the cost (6) of each pair of track and detection `(n, k)`; `_NEVER` if they are
    different objects.

    Tracks: `states`, their groups `known`, `sizes`; detections: `place`, their groups `seen`,
    `seen_sizes`, `variance`.
    """
    costs = np.full((len(states), len(place)), _NEVER)
    for i in range(len(states)):
        for j in range(len(place)):
            ex, ey = place[j, X] - states[i, X], place[j, Y] - states[i, Y]
            other = known[i] != seen[j]
            most = max(REACH[known[i]], REACH[seen[j]])
            if ex * ex + ey * ey > most * most or (
                other and (known[i] == VEHICLE or seen[j] == VEHICLE)
            ):
                continue
            along, across = (
                states[i, COS] * ex + states[i, SIN] * ey,
                states[i, COS] * ey - states[i, SIN] * ex,
            )
            sa, sc = states[i, ALONG] + variance[j], states[i, ACROSS] + variance[j]
            m = along * along / sa + across * across / sc
            growth = max(
                abs(np.log(sizes[i, 0] / seen_sizes[j, 0])),
                abs(np.log(sizes[i, 1] / seen_sizes[j, 1])),
            )
            if m <= GATE and growth <= MOST_GROWTH:
                costs[i, j] = m + np.log(sa * sc) + OTHER_GROUP * other + OTHER_SIZE * growth
    return costs


# Tracker

BIRTH_TIME, BIRTH_COUNT, BIRTH_SCORE = (
    frozen([0.15, 0.15, 0.8]),
    frozen([3, 3, 6]),
    frozen([1.2, 1.2, 0.0]),
)
"""Evidence (7) by group: time s, detections, sum of scores; later births give
fewer ghosts (tests/support/track_score.py)."""
KEEP_STILL_S, KEEP_S, KEEP_YOUNG_S = 2.0, 0.8, 0.35
FEW = 10
WINDOW_S, WINDOW_LEAST_S, FILTER_SLOW = 1.5, 0.8, 2.5
YAW_MEMORY = 0.8
"""Share of the old heading that remains with each new detection."""
_KINDS = tuple(AgentKind)


@dataclass
class _Track:
    """Data of one track besides its filter; `late`: it was first seen after the first frame."""

    first: float
    late: bool
    yaw: float
    fronts: float = 0.0
    score: float = 0.0
    count: int = 0
    votes: FloatArray = field(default_factory=lambda: np.zeros(len(_KINDS)))
    size: FloatArray = field(default_factory=lambda: np.zeros((len(_KINDS), 2)))
    window: deque[tuple[float, float, float]] = field(default_factory=deque)

    def see(self, boxes: Boxes, i: int) -> None:  # (9)
        weight, code, t = float(boxes.weight[i]), int(boxes.codes[i]), float(boxes.t[i])
        self.count += 1
        self.score += weight
        self.votes[code] += weight
        self.size[code] += weight * np.array([boxes.length[i], boxes.width[i]])
        off = float(boxes.yaw[i]) - self.yaw
        half = np.pi * round(off / np.pi)
        self.fronts += weight * np.cos(half)
        self.yaw += (1.0 - YAW_MEMORY) * (off - half)
        self.window.append((t, float(boxes.x[i]), float(boxes.y[i])))
        while t - self.window[0][0] > WINDOW_S + 1e-9:
            self.window.popleft()

    def front(self, group: int, vx: float, vy: float) -> float:  # (9)
        ahead = self.fronts
        if np.hypot(vx, vy) > FAST[group]:
            if group == PERSON:
                return float(np.arctan2(vy, vx))
            ahead = np.cos(self.yaw) * vx + np.sin(self.yaw) * vy
            self.fronts += ahead
        return self.yaw if ahead >= 0.0 else self.yaw + np.pi

    def stands(self, group: int, speed: float, length: float) -> bool:  # (8)
        slow = max(SLOW[group], SLIDES * length / WINDOW_S) if group == CLUSTER else SLOW[group]
        t, x, y = np.array(self.window).T
        if t[-1] - t[0] < WINDOW_LEAST_S or speed > FILTER_SLOW * slow:
            return False
        t = t - t.mean()
        return bool(np.hypot(t @ x, t @ y) < slow * (t @ t))


@dataclass(frozen=True, eq=False)
class Tracked:
    """The road users known after each frame: `agents[k]` at `frames[k]` s, not extrapolated.

    `growth[k]` `(n,)`: growth rate of the variance of their velocities, m2/s3; `patience[k]`
    `(n,)`: time for which they are reported without a detection, s.
    """

    frames: tuple[float, ...]
    agents: tuple[Agents, ...]
    growth: tuple[FloatArray, ...]
    patience: tuple[FloatArray, ...]

    def at(self, t: float) -> Agents:
        """Return the road users as known at t, s: those of the last frame not later than t,
        extrapolated (10).
        """
        k = bisect_right(self.frames, t + 1e-9) - 1
        if k < 0:
            return _agents([], [], [])
        known, since = self.agents[k], max(t - self.frames[k], 0.0)
        carried = replace(
            known,
            x=known.x + since * known.vx,
            y=known.y + since * known.vy,
            unseen=known.unseen + since,
            age=np.minimum(known.age + since, OLDEST_S),
            velocity_sigma=np.sqrt(known.velocity_sigma**2 + since * self.growth[k]),
        )
        return carried.some(np.flatnonzero(carried.unseen <= self.patience[k] + 1e-9))


def tracked(every: Boxes, frames: FloatArray) -> Tracked:
    """Track detected boxes: return the road users known after each of the `frames`, s, without
    later frames.
    """
    boxes = every.taken(np.flatnonzero(stronger_twins(every) < 0))
    joining, tracks, by_frame = Association(), dict[int, _Track](), []
    for t, rows, names in joining.steps(boxes, frames):
        for name, i in zip(names.tolist(), range(rows.start, rows.stop), strict=True):
            if name not in tracks:
                tracks[name] = _Track(t, t > frames[0], float(boxes.yaw[i]))
            tracks[name].see(boxes, i)
        tracks = {name: tracks[name] for name in joining.tracks["name"].tolist()}
        # Of the tracks reported at t (7)
        ids, codes, columns = [], [], []
        growth, patience = [], []
        for (name, track), row in zip(tracks.items(), joining.tracks, strict=True):
            state, group = row["state"], int(row["group"])
            early = t - track.first < BIRTH_TIME[group] - 1e-9
            if early or track.count < BIRTH_COUNT[group] or track.score < BIRTH_SCORE[group]:
                continue
            code = int(track.votes.argmax())
            length, width = (track.size[code] / track.votes[code]).tolist()
            vx, vy = float(state[VX]), float(state[VY])
            sigma, most = float(np.sqrt(0.5 * (state[ALONG + 2] + state[ACROSS + 2]))), KEEP_S
            if track.stands(group, float(np.hypot(vx, vy)), length):
                vx, vy = 0.0, 0.0
                sigma, most = float(NOISE[group]) / WINDOW_S, KEEP_STILL_S
            elif track.count <= FEW:
                most = KEEP_YOUNG_S
            unseen = t - float(row["last"])
            if unseen > most + 1e-9:
                continue
            age = min(t - track.first, OLDEST_S) if track.late else np.nan
            pose = state[X], state[Y], track.front(group, vx, vy)
            ids.append(str(name + 1))
            codes.append(code)
            columns.append((length, width, *pose, vx, vy, 0.0, 0.0, age, unseen, sigma))
            growth.append(float(DENSITY[group]))
            patience.append(most)
        by_frame.append((_agents(ids, codes, columns), np.array(growth), np.array(patience)))
    agents, growths, patiences = zip(*by_frame, strict=True) if by_frame else ((), (), ())
    return Tracked(tuple(frames.tolist()), agents, growths, patiences)


def _agents(
    ids: Sequence[str], codes: Sequence[int], columns: Sequence[tuple[float, ...]]
) -> Agents:
    numbers = np.array(columns).reshape(-1, len(NUMBERS)).T
    return Agents.of_rows(
        tuple(ids), tuple(_KINDS[code] for code in codes), numbers, frozen(codes, np.int64)
    )
