"""Joined detections as smooth motion; pieces of motion that are one road user's put together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from logs.kernel import BoolArray, FloatArray, IntArray, kernel
from logs.repair.groups import CLUSTER, GROUPS, SLIDES, SMOOTH_DENSITY, STAND_S, VEHICLE, Boxes
from logs.repair.kalman import smoothed

LEAST_NOISE_M, DRIFT, NOISE_COUNT = 0.05, 3.0, 8
"""Noise of a track: so many times what its boxes jitter about the line between their neighbours, as slow drift, which
none sees, is three times the jitter (0.30 m to 0.09 m); its group's noise at most, and where it has fewer boxes."""
OUTLIER, OUTLIER_WEIGHT = 2.5, 2.0
"""A box that is more deviations off the smooth path counts as so much less exact."""
STITCH_S, STITCH_STILL_S = 3.0, 8.0
"""Gaps between two pieces that can be one road user's; between two that stand."""
FEW = 4
"""A piece of fewer detections has no velocity of its own."""
STITCH_GROWTH, CHANGE_MPS, SIZE_WORTH, GAP_WORTH = 0.8, 0.3, 1.0, 0.1
"""Sizes within a factor of e^0.8; what 1 m/s, a factor of e, and 1 s cost against a miss by all that is allowed."""
SPREAD = 1.3
"""Of what stands nine in ten boxes are within so many times `Group.still`."""
ROUNDS = 3
_LIMITS = np.array([(group.meet, group.meet_growth, group.turn, group.turn_growth) for group in GROUPS])


@dataclass(frozen=True, eq=False)
class Piece:
    """A road user's motion on every frame from the first to the last detection, `(k,)`.

    Attributes:
        rows: Boxes, in order of time; `seen` their places among the frames.
        group: Place in `GROUPS`.
        t: Times of the frames, s.
        z: Detected centres `(k, 2)`, NaN between detections; `variance` of each, m2.
        path: Smooth x, y, vx, vy `(k, 4)`.
        noise: Standard deviation of a centre, m; `scale` the same as a share of the group's.
        net: From where it was in the first third to where in the last, m.
        still: Whether it never moves.
    """

    rows: IntArray
    seen: IntArray
    group: int
    t: FloatArray
    z: FloatArray
    variance: FloatArray
    path: FloatArray
    noise: float
    scale: float
    net: float
    still: bool

    @property
    def span(self) -> float:
        """From the first to the last detection, s."""
        return float(self.t[-1] - self.t[0])

    def standing(self) -> FloatArray:
        """The path `(k, 4)`, where it is slow for `STAND_S` held at a stand."""
        slow = np.hypot(self.path[:, 2], self.path[:, 3]) < GROUPS[self.group].slow * self.scale
        ends = np.flatnonzero(np.diff(np.r_[False, slow, False]))
        runs = [(a, b) for a, b in zip(ends[::2], ends[1::2], strict=True) if self.t[b - 1] - self.t[a] >= STAND_S]
        stands = np.zeros(len(slow), np.bool_)
        for a, b in runs:
            stands[a:b] = True
        if not stands.any():
            return self.path
        path = smoothed(self.t, self.z, self.variance, float(SMOOTH_DENSITY[self.group]), stands)
        path[stands, 2:] = 0.0
        return path


def fitted(rows: IntArray, boxes: Boxes, frames: FloatArray) -> Piece:
    """The motion that the boxes `rows`, in order of time, show."""
    group = int(np.bincount(boxes.group[rows], boxes.weight[rows], len(GROUPS)).argmax())
    first, last = boxes.frame[rows[0]], boxes.frame[rows[-1]]
    t, seen = frames[first : last + 1], boxes.frame[rows] - first
    xy = np.column_stack([boxes.x[rows], boxes.y[rows]])
    noise = _noise(t[seen], xy, GROUPS[group].noise)
    z, variance = np.full((len(t), 2), np.nan), np.full(len(t), noise**2)
    z[seen] = xy
    trust = boxes.noise[rows] / np.array([each.noise for each in GROUPS])[boxes.group[rows]]
    stands = np.zeros(len(t), np.bool_)
    variance[seen] = (noise * trust) ** 2
    for _ in range(2):
        path = smoothed(t, z, variance, float(SMOOTH_DENSITY[group]), stands)
        off = np.hypot(*(xy - path[seen, :2]).T) / noise
        variance[seen] = (noise * np.maximum(trust, np.where(off > OUTLIER, OUTLIER_WEIGHT * off / OUTLIER, 1.0))) ** 2
    scale = noise / GROUPS[group].noise
    third = max(1, len(xy) // 3)
    net = float(
        np.hypot(*(centre(xy[-third:], boxes.weight[rows[-third:]]) - centre(xy[:third], boxes.weight[rows[:third]])))
    )
    spread = np.percentile(np.hypot(*(xy - centre(xy, boxes.weight[rows])).T), 90)
    most, slow = GROUPS[group].still * scale, GROUPS[group].slow * scale * max(t[-1] - t[0], 0.5)
    if group == CLUSTER:
        most = slow = max(most, SLIDES * float(np.median(boxes.length[rows])))
    still = net < min(most, slow) and spread < SPREAD * most
    return Piece(rows, seen, group, t, z, variance, path, noise, scale, net, bool(still))


def _noise(t: FloatArray, xy: FloatArray, most: float) -> float:
    """Noise of positions `(k, 2)` at t: from their median distance to the line between their neighbours."""
    if len(t) < NOISE_COUNT:
        return most
    share = ((t[1:-1] - t[:-2]) / (t[2:] - t[:-2]))[:, None]
    off = xy[1:-1] - xy[:-2] - share * (xy[2:] - xy[:-2])
    # sum of two squares of normal variables of variance r (1 + share^2 + (1 - share)^2): median 2 ln 2 of it
    squares = (off**2).sum(axis=1) / (1.0 + share**2 + (1.0 - share) ** 2)[:, 0]
    return float(np.clip(DRIFT * np.sqrt(np.median(squares) / (2.0 * np.log(2.0))), LEAST_NOISE_M, most))


def centre(xy: FloatArray, weight: FloatArray) -> FloatArray:
    """The middle `(2,)` of positions `(k, 2)`, those far from it weighted down: a mean that turns with them."""
    middle = np.average(xy, axis=0, weights=weight)
    for _ in range(ROUNDS):
        off = np.hypot(*(xy - middle).T)
        usual = max(float(np.median(off)), LEAST_NOISE_M)
        middle = np.average(xy, axis=0, weights=weight / np.maximum(1.0, off / usual))
    return np.asarray(middle)


def stitched(pieces: Sequence[Piece], boxes: Boxes, frames: FloatArray) -> list[Piece]:
    """The pieces with those put together whose ends meet when both are carried on to the middle of the gap."""
    out = list(pieces)
    for _ in range(ROUNDS):
        if len(out) < 2:
            return out
        ends = _ends(out, boxes)
        one, two, cost = _fits(ends)
        best = np.argsort(cost, kind="stable")
        following: dict[int, int] = {}
        begun: set[int] = set()
        for i, j in zip(ends.order[one[best]].tolist(), ends.order[two[best]].tolist(), strict=True):
            if i not in following and j not in begun:
                following[i] = j
                begun.add(j)
        if not following:
            return out
        chains = [_chain(k, following) for k in range(len(out)) if k not in begun]
        out = [
            out[chain[0]] if len(chain) == 1 else fitted(np.concatenate([out[k].rows for k in chain]), boxes, frames)
            for chain in chains
        ]
    return out


def _chain(first: int, following: dict[int, int]) -> list[int]:
    chain = [first]
    while chain[-1] in following:
        chain.append(following[chain[-1]])
    return chain


class _Ends(NamedTuple):
    """First and last t, x, y, vx, vy of pieces `(n, 5)`, ordered by their begin; group, size, whether few, still."""

    order: IntArray
    begin: FloatArray
    end: FloatArray
    group: IntArray
    size: FloatArray
    few: BoolArray
    still: BoolArray
    limits: FloatArray


def _ends(pieces: Sequence[Piece], boxes: Boxes) -> _Ends:
    order = np.argsort([piece.t[0] for piece in pieces], kind="stable")
    some = [pieces[i] for i in order]
    moves = np.array([not piece.still for piece in some], np.float64)[:, None]
    ends = [np.array([[piece.t[at], *piece.path[at]] for piece in some]) for at in (0, -1)]
    begin, end = (np.hstack([each[:, :3], each[:, 3:] * moves]) for each in ends)
    sides = [(boxes.length[piece.rows], boxes.width[piece.rows]) for piece in some]
    size = np.array([(np.median(np.maximum(*each)), np.median(np.minimum(*each))) for each in sides])
    return _Ends(
        order, begin, end, np.array([piece.group for piece in some]), size,
        np.array([len(piece.rows) < FEW for piece in some]), np.array([piece.still for piece in some]), _LIMITS,
    )  # fmt: skip


@kernel
def _fits(ends: _Ends) -> tuple[IntArray, IntArray, FloatArray]:
    """Pieces i and j, one ending before the other begins, that can be one, and how badly they fit."""
    one, two, costs = [0 for _ in range(0)], [0 for _ in range(0)], [0.0 for _ in range(0)]
    for i in range(len(ends.begin)):
        last = ends.end[i]
        j = np.searchsorted(ends.begin[:, 0], last[0] + 1e-6, side="right")
        while j < len(ends.begin) and ends.begin[j, 0] - last[0] <= STITCH_STILL_S:
            first, gap = ends.begin[j], ends.begin[j, 0] - last[0]
            alike = ends.group[i] == ends.group[j] or (ends.group[i] != VEHICLE and ends.group[j] != VEHICLE)
            if alike and (gap <= STITCH_S or (ends.still[i] and ends.still[j])):
                meet, meet_growth, turn, turn_growth = ends.limits[ends.group[i]]
                out_x, out_y, in_x, in_y = last[3], last[4], first[3], first[4]
                if ends.few[i] and not ends.few[j]:
                    out_x, out_y = in_x, in_y
                elif ends.few[j] and not ends.few[i]:
                    in_x, in_y = out_x, out_y
                miss = np.hypot(
                    last[1] + 0.5 * gap * out_x - first[1] + 0.5 * gap * in_x,
                    last[2] + 0.5 * gap * out_y - first[2] + 0.5 * gap * in_y,
                )
                change = np.hypot(out_x - in_x, out_y - in_y)
                growth = max(
                    abs(np.log(ends.size[i, 0] / ends.size[j, 0])), abs(np.log(ends.size[i, 1] / ends.size[j, 1]))
                )
                most = meet + meet_growth * min(gap, STITCH_S)
                if miss < most and change < turn + turn_growth * gap and growth < STITCH_GROWTH:
                    one.append(i)
                    two.append(j)
                    costs.append(miss / most + CHANGE_MPS * change + SIZE_WORTH * growth + GAP_WORTH * gap)
            j += 1
    return np.array(one, np.int64), np.array(two, np.int64), np.array(costs)
