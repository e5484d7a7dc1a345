"""Smooths joined detections, joins pieces of one road user, and finds its kind, size and front by
votes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.logs.agents import AgentKind
from replan.logs.repair.detected_boxes import (
    CLUSTER,
    DENSITY,
    FAST,
    NOISE,
    PERSON,
    SLIDES,
    SLOW,
    STILL,
    VEHICLE,
    Boxes,
)
from replan.logs.repair.tracker import smoothed
from replan.logs.states import Trajectory

SMOOTH_DENSITY = 0.45 * DENSITY
"""Density for smoothing: errors of moving speeds are a fifth smaller than with `DENSITY`
(tests/support/track_score.py)."""
LEAST_NOISE_M, DRIFT, NOISE_COUNT = 0.05, 3.0, 8
"""Noise of a track: `DRIFT` times the jitter of its boxes about the line between their neighbours,
because slow drift, which this does not show, is three times the jitter (0.30 m to 0.09 m). The
group's noise is the upper bound, and the noise of tracks with fewer than `NOISE_COUNT` boxes."""
OUTLIER, OUTLIER_WEIGHT = 2.5, 2.0
"""A box farther off the smooth path than `OUTLIER` standard deviations gets a standard deviation
larger in proportion."""
STAND_S, SPREAD = 1.0, 1.3
"""Shortest stand, s: over shorter times, the drift of a box looks like motion. Nine in ten boxes of
a standing object lie within `SPREAD` times `STILL`."""
STITCH_S, STITCH_STILL_S, STANDS_S = 3.0, 8.0, 0.6
"""Longest gap between two pieces of one road user, s; the same for two standing pieces. For
standing pieces, the allowed miss grows for `STANDS_S` only: beyond, it would reach the next car in
a queue."""
MEET, TURN = (
    np.array([(1.0, 0.8), (0.7, 0.5), (0.7, 0.3)]),
    np.array([(3.0, 2.0), (1.5, 1.0), (1.5, 0.5)]),
)
"""By group: two pieces are one if they meet within this distance in the middle of their gap, m,
plus m per second of gap, and if their velocities differ by less than this, m/s, plus m/s per second
of gap."""
STITCH_GROWTH, CHANGE_MPS, GAP_WORTH = 0.8, 0.3, 0.1
"""Sizes agree within a factor of e^0.8. Costs of 1 m/s and of 1 s; the whole allowed miss, or a
factor of e, costs 1."""
FEW = 4
"""A piece of fewer detections has no reliable velocity."""
FAR_M = 20.0
"""Distance at which a vote has half the weight of one close by, m."""
RIDES_MPS, RIDES_M = 3.3, 8.0
"""A "pedestrian" with a faster median speed over more than this is a rider: joggers run 2.5 to 3
m/s.
"""
REVERSE_MPS, HEADINGS_AGREE = 4.0, 0.9
"""Vehicles reverse no faster, m/s.

If a smaller share of a slow vehicle's headings agrees, it moves forward.
"""
YAW_S, YAW_OFF = 0.4, 0.6
"""Headings are averaged over this, s.

A heading farther from the vehicle's course is ignored, rad.
"""
_KINDS = tuple(AgentKind)


@dataclass(frozen=True, eq=False)
class Piece:
    """A road user's motion on every frame from the first to the last detection, `(k,)`."""

    # its boxes, in order of time; `seen` are the indices of their frames, `group` is their group by
    # votes
    rows: IntArray
    seen: IntArray
    group: int
    t: FloatArray  # times of the frames, s
    z: FloatArray  # detected centres `(k, 2)`, m, NaN between detections; `variance` of each, m2
    variance: FloatArray
    path: FloatArray  # smooth x, y, vx, vy `(k, 4)`
    scale: float  # standard deviation of a centre as a share of the group's
    net: float  # distance between its mean places in the first and in the last third, m
    still: bool  # whether it never moves

    def standing(self) -> FloatArray:
        """Return the path `(k, 4)`, standing where it is slow for at least `STAND_S`."""
        stands = np.hypot(self.path[:, 2], self.path[:, 3]) < SLOW[self.group] * self.scale
        ends = np.flatnonzero(np.diff(np.r_[False, stands, False]))
        for a, b in zip(ends[::2], ends[1::2], strict=True):
            stands[a:b] = self.t[b - 1] - self.t[a] >= STAND_S
        if not stands.any():
            return self.path
        path = smoothed(self.t, self.z, self.variance, SMOOTH_DENSITY[self.group], stands)
        path[stands, 2:] = 0.0
        return path


def fitted(rows: IntArray, boxes: Boxes, frames: FloatArray) -> Piece:
    """Estimate the motion of the boxes `rows`, which are in order of time."""
    weight = boxes.weight[rows]
    group = int(np.bincount(boxes.group[rows], weight, len(NOISE)).argmax())
    first, last = boxes.frame[rows[0]], boxes.frame[rows[-1]]
    t, seen = frames[first : last + 1], boxes.frame[rows] - first
    xy = np.column_stack([boxes.x[rows], boxes.y[rows]])
    noise = NOISE[group]
    if len(rows) >= NOISE_COUNT:  # from the median distance to the line between their neighbours
        times = t[seen]
        share = ((times[1:-1] - times[:-2]) / (times[2:] - times[:-2]))[:, None]
        bent = xy[1:-1] - xy[:-2] - share * (xy[2:] - xy[:-2])
        # sum of two squares of normal variables of variance r (1 + share^2 + (1 - share)^2): median
        # 2 ln 2 of it
        squares = (bent**2).sum(axis=1) / (1.0 + share**2 + (1.0 - share) ** 2)[:, 0]
        noise = float(
            np.clip(DRIFT * np.sqrt(np.median(squares) / (2.0 * np.log(2.0))), LEAST_NOISE_M, noise)
        )
    z, variance = np.full((len(t), 2), np.nan), np.full(len(t), noise**2)
    trust, moving = boxes.noise[rows] / NOISE[boxes.group[rows]], np.zeros(len(t), np.bool_)
    z[seen], variance[seen] = xy, (noise * trust) ** 2
    for _ in range(2):
        path = smoothed(t, z, variance, SMOOTH_DENSITY[group], moving)
        off = np.hypot(*(xy - path[seen, :2]).T) / noise
        variance[seen] = (
            noise * np.maximum(trust, np.where(off > OUTLIER, OUTLIER_WEIGHT * off / OUTLIER, 1.0))
        ) ** 2
    scale, third = noise / NOISE[group], max(1, len(xy) // 3)
    early, late, middle = (
        np.average(xy[part], 0, weight[part]) for part in (np.s_[:third], np.s_[-third:], np.s_[:])
    )
    net = float(np.hypot(*(late - early)))
    spread = np.percentile(np.hypot(*(xy - middle).T), 90)
    most, slow = STILL[group] * scale, SLOW[group] * scale * max(t[-1] - t[0], 0.5)
    if group == CLUSTER:
        most = slow = max(most, SLIDES * float(np.median(boxes.length[rows])))
    still = net < min(most, slow) and spread < SPREAD * most
    return Piece(rows, seen, group, t, z, variance, path, scale, net, bool(still))


def stitched(pieces: Sequence[Piece], boxes: Boxes, frames: FloatArray) -> list[Piece]:
    """Join the pieces whose ends meet if both are extrapolated to the middle of the gap."""
    if len(pieces) < 2:
        return list(pieces)
    begin, end = (
        np.array([[piece.t[row], *piece.path[row]] for piece in pieces]) for row in (0, -1)
    )
    group, still = (
        np.array([piece.group for piece in pieces]),
        np.array([piece.still for piece in pieces]),
    )
    sides = [(boxes.length[piece.rows], boxes.width[piece.rows]) for piece in pieces]
    size = np.log([(np.median(np.maximum(*part)), np.median(np.minimum(*part))) for part in sides])
    gaps = begin[:, 0] - end[:, :1]
    # Piece i ends before piece j begins
    i, j = np.nonzero((gaps > 1e-6) & (gaps <= STITCH_STILL_S))
    gap, few = gaps[i, j], np.array([len(piece.rows) < FEW for piece in pieces])
    before, after = (np.where(still[:, None], 0.0, part[:, 3:]) for part in (end, begin))
    leaving = np.where((few[i] & ~few[j])[:, None], after[j], before[i])
    back = np.where((few[j] & ~few[i])[:, None], before[i], after[j])
    off = end[i, 1:3] - begin[j, 1:3] + 0.5 * gap[:, None] * (leaving + back)
    miss, change, growth = (
        np.hypot(*off.T),
        np.hypot(*(leaving - back).T),
        np.abs(size[i] - size[j]).max(axis=1),
    )
    (meet, growing), (turn, turning) = MEET[group[i]].T, TURN[group[i]].T
    most = meet + growing * np.minimum(gap, np.where(still[i] & still[j], STANDS_S, STITCH_S))
    fits = (miss < most) & (change < turn + turning * gap) & (growth < STITCH_GROWTH)
    fits &= (group[i] == group[j]) | ((group[i] != VEHICLE) & (group[j] != VEHICLE))
    fits &= (gap <= STITCH_S) | (still[i] & still[j])
    cost = (miss / most + CHANGE_MPS * change + growth + GAP_WORTH * gap)[fits]
    best = np.argsort(cost, kind="stable")
    following: dict[int, int] = {}
    for first, second in zip(i[fits][best].tolist(), j[fits][best].tolist(), strict=True):
        if first not in following and second not in following.values():
            following[first] = second
    whole = []
    for k in sorted(set(range(len(pieces))) - set(following.values())):
        chain = [k]
        while chain[-1] in following:
            chain.append(following[chain[-1]])
        rows = np.concatenate([pieces[part].rows for part in chain])
        whole.append(pieces[k] if len(chain) == 1 else fitted(rows, boxes, frames))
    return whole


@dataclass(frozen=True, eq=False)
class User:
    """A road user over the frames `(k,)` in which it is present."""

    piece: Piece  # its detections and smoothed motion
    kind: AgentKind  # its kind; `label` is the kind of most detections
    label: AgentKind
    length: float  # length of its box, m; `width` likewise
    width: float
    way: FloatArray  # rows t (s), x, y, yaw of the box, vx, vy `(6, k)`
    turned: int  # number of detections with exchanged front and back
    extended: BoolArray  # whether a sample is before the first or after the last detection `(k,)`

    @property
    def t(self) -> FloatArray:
        """Times, s."""
        return self.way[0]

    @cached_property
    def poses(self) -> FloatArray:
        """Boxes `(k, 5)`: x, y, yaw, length, width."""
        _, x, y, yaw, *_ = self.way
        sizes = np.outer([self.length, self.width], np.ones(len(self.t)))
        return np.column_stack([x, y, yaw, *sizes])


def user_of(piece: Piece, boxes: Boxes, ego: Trajectory) -> User:
    """Make the road user of a piece; votes are weighted by score and by distance from the ego."""
    rows = piece.rows
    t, codes = boxes.t[rows], boxes.codes[rows]
    dx = boxes.x[rows] - np.interp(t, ego.t, ego.x)
    dy = boxes.y[rows] - np.interp(t, ego.t, ego.y)
    far = np.hypot(dx, dy)
    weight = boxes.weight[rows] / (1.0 + (far / FAR_M) ** 2)
    code = int(np.bincount(codes, np.where(boxes.group[rows] == piece.group, weight, 0.0)).argmax())
    sides = []
    # Weighted medians of the detections of this kind
    for values in (boxes.length[rows], boxes.width[rows]):
        order, same = np.argsort(values), np.where(codes == code, weight, 0.0)
        sides.append(
            float(values[order[np.searchsorted(np.cumsum(same[order]), 0.5 * same.sum())]])
        )
    path = piece.standing()
    if piece.still:
        path = np.zeros_like(path)
        path[:, :2] = np.average(piece.z[piece.seen], 0, weight)
    yaw, turned = _headings(piece, path, boxes.yaw[rows], weight)
    label, speed = _KINDS[code], np.median(np.hypot(path[:, 2], path[:, 3]))
    rides = label is AgentKind.PEDESTRIAN and piece.net > RIDES_M and speed > RIDES_MPS
    columns = np.array([piece.t, path[:, 0], path[:, 1], yaw, path[:, 2], path[:, 3]])
    kind = AgentKind.BICYCLE if rides else label
    return User(
        piece, kind, label, sides[0], sides[1], columns, turned, np.zeros(len(piece.t), np.bool_)
    )


def _headings(
    piece: Piece, path: FloatArray, yaw: FloatArray, weight: FloatArray
) -> tuple[FloatArray, int]:
    """Return the heading at each time `(k,)`, and the number of detected headings `yaw` with front
    and back exchanged.

    The axis is that of the boxes. The front is the direction of motion; without motion, that of
    most headings. A person's heading is the direction of motion, as headings of their boxes are
    inexact (16 to 33 degrees); so is that of a cluster that rides: the box fitted to its points is
    more than 10 degrees off in 30 % of its samples.
    """
    speed = np.hypot(path[:, 2], path[:, 3])
    fast = np.flatnonzero(speed > FAST[piece.group])
    middle = 0.5 * np.angle(np.sum(weight * np.exp(2j * yaw)))
    if not len(fast):
        front = middle if np.sum(weight * np.cos(yaw - middle)) >= 0.0 else middle + np.pi
        return np.full(len(path), front), int((np.cos(yaw - front) < 0.0).sum())
    nearest = np.abs(np.arange(len(path))[:, None] - fast).argmin(axis=1)
    goes = np.unwrap(np.arctan2(path[fast, 3], path[fast, 2]))[nearest]
    if piece.group == PERSON:
        return goes, 0
    rides = piece.group == CLUSTER and np.median(speed[fast]) > RIDES_MPS
    # the front is the same end of the box at all times, although the object may reverse
    axis = (
        np.unwrap(goes, period=np.pi)
        if rides or piece.group == VEHICLE
        else np.full(len(path), middle)
    )
    ahead = np.cos(axis[fast] - goes[fast]).sum() >= 0.0
    agree = float(np.average(np.cos(yaw - axis[piece.seen]) >= 0.0, weights=weight))
    if speed.max() < REVERSE_MPS and max(agree, 1.0 - agree) >= HEADINGS_AGREE:
        ahead = agree >= 0.5
    if not ahead:
        axis = axis + np.pi
    if rides:
        return axis, 0
    off = yaw - axis[piece.seen]
    turned = int((np.cos(off) < 0.0).sum())
    off -= np.pi * np.round(off / np.pi)
    counts = weight * (np.abs(off) < YAW_OFF) if piece.group == VEHICLE else weight
    near = np.exp(-0.5 * ((piece.t[:, None] - piece.t[piece.seen]) / YAW_S) ** 2) * counts
    share = near.sum(axis=1)
    # the offsets from the axis are averaged about the detections' own axis, as both turn in a curve
    measured = axis[piece.seen] + off - axis[:, None]
    mean = np.divide(
        (near * measured).sum(axis=1), share, out=np.zeros(len(path)), where=share > 1e-9
    )
    return axis + mean, turned
