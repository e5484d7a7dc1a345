"""The lanes of a road sampled at equal steps, made once per road, and the kernels that query them.

A lane's centre line is resampled to about `SPACING_M`; a point at station s and offset l (to the
left) of a lane is

(1) p = r(s) + l n(s)
        r and the heading of its tangent interpolated linearly between samples, n turned left of it
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import cos, inf, pi, sin, sqrt
from typing import NamedTuple

import numpy as np

from replan.core.arrays import TIE, FloatArray, IntArray, frozen
from replan.core.kernel import inner_kernel, kernel
from replan.core.once import once
from replan.logs.lane_arrays import lane_arrays
from replan.logs.road import Road
from replan.logs.states import wrap

SPACING_M = 1.0
BEND_M = 5.0
"""Curvatures are means over this distance to both sides, m, because bends in maps have corners."""
SHORTEST_M = 0.1
"""Shorter lanes have no direction and are left out."""
BESIDE_M = 0.3
"""A vehicle is still on a lane if the centre of its box is at most this far outside, m ..."""
PAST_END_M = 0.5
"""... at most this far before its start or after its end, m, ..."""
ASKEW_RAD = 0.25 * pi
"""... and its heading differs from the lane's by at most this."""
SPREAD_RAD = 0.3
"""The difference of headings that adds 1 to the misfit of a lane."""
OUTSIDE = 100.0
"""Additional misfit of a lane that does not contain the box's centre: it is used only if no lane
contains it.
"""
STATION, LEFT, HALF_WIDTH, MISFIT = range(4)
"""Columns of the lanes that match a vehicle (`matches`)."""
ROAD_STEP_M = 0.25


class LaneSamples(NamedTuple):
    """`n` lanes with `m` samples in all; lane i owns the samples `first[i] : first[i + 1]`.

    Attributes:
        first: `(n + 1,)`.
        step: `(n,)` m between two samples; the samples of a lane are equally spaced.
        tightest: `(n,)` greatest curvature, 1/m, not negative.
        widest: `(n,)` half of the greatest width, m.
        x: Centre line `(m,)`; `y` likewise.
        y: m.
        yaw: Direction of the centre line `(m,)`, continuous within a lane.
        kappa: Its curvature `(m,)`.
        half_width: Half of the lane's width `(m,)`.
        box: `(n, 4)` least x, y, greatest x, y of the centre line widened by half of the lane's
            width.
        next_first: As in `LaneArrays`; `following` and `beside` likewise.
        following: Indices of lanes.
        beside: `(n, 2)`.
    """

    first: IntArray
    step: FloatArray
    tightest: FloatArray
    widest: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    kappa: FloatArray
    half_width: FloatArray
    box: FloatArray
    next_first: IntArray
    following: IntArray
    beside: IntArray


@dataclass(frozen=True, eq=False)
class LaneMap:
    """The lanes along which vehicles are predicted.

    Attributes:
        arrays: The drivable lanes; empty if the road is unknown.
    """

    arrays: LaneSamples

    @classmethod
    def of(cls, road: Road) -> LaneMap:
        """Return the drivable lanes of a road.

        Made once and shared by perception and traffic of all its drives.
        """
        return cls(_lane_samples(road))

    @classmethod
    def unknown(cls) -> LaneMap:
        """Return a map without lanes: no vehicle follows one."""
        return cls.of(Road({}))

    def __len__(self) -> int:
        return len(self.arrays.step)


@once
def _lane_samples(road: Road) -> LaneSamples:
    lanes = lane_arrays(road, shortest=SHORTEST_M)
    poses: list[FloatArray] = [np.empty((5, 0))]
    steps: list[float] = []
    for lane, (begin, end) in enumerate(pairwise(lanes.first.tolist())):
        left, right = lanes.borders(lane)
        half_width = 0.5 * np.hypot(*(left - right).T)
        pose, step = _resample(lanes.center[begin:end], lanes.station[begin:end], half_width)
        poses.append(pose)
        steps.append(step)
    first = np.cumsum([pose.shape[1] for pose in poses])
    x, y, yaw, kappa, half_width = map(frozen, np.hstack(poses))
    least = [np.minimum.reduceat(axis - half_width, first[:-1]) for axis in (x, y)]
    greatest = [np.maximum.reduceat(axis + half_width, first[:-1]) for axis in (x, y)]
    return LaneSamples(
        first=frozen(first, np.int64),
        step=frozen(steps),
        tightest=frozen(np.maximum.reduceat(np.abs(kappa), first[:-1])),
        widest=frozen(np.maximum.reduceat(half_width, first[:-1])),
        x=x,
        y=y,
        yaw=yaw,
        kappa=kappa,
        half_width=half_width,
        box=frozen(np.column_stack([*least, *greatest])),
        next_first=lanes.next_first,
        following=lanes.following,
        beside=lanes.beside,
    )


def _resample(
    center: FloatArray, station: FloatArray, half_width: FloatArray
) -> tuple[FloatArray, float]:
    """Return rows x, y, yaw, kappa, half of the width `(5, k)` of a centre line at equal steps, and
    the step, m.
    """
    distinct = np.r_[True, np.diff(station) > 1e-9]
    count = max(1, round(station[-1] / SPACING_M)) + 1
    s, step = np.linspace(0.0, station[-1], count, retstep=True)
    x, y, half = (
        np.interp(s, station[distinct], column[distinct]) for column in (*center.T, half_width)
    )
    headings = np.unwrap(np.arctan2(np.diff(y), np.diff(x)))
    yaw = np.r_[headings[0], 0.5 * (headings[1:] + headings[:-1]), headings[-1]]
    behind, ahead = np.maximum(s - BEND_M, 0.0), np.minimum(s + BEND_M, s[-1])
    kappa = (np.interp(ahead, s, yaw) - np.interp(behind, s, yaw)) / (ahead - behind)
    return np.vstack([x, y, yaw, kappa, half]), float(step)


@inner_kernel
def lane_length(lanes: LaneSamples, lane: int) -> float:
    """Return the length of a lane's centre line, m."""
    return lanes.step[lane] * (lanes.first[lane + 1] - lanes.first[lane] - 1)


@inner_kernel
def _between(column: FloatArray, k: int, share: float) -> float:
    """Return the value of a column `(m,)` between samples k and k + 1."""
    return column[k] + share * (column[k + 1] - column[k])


@kernel
def lane_point(lanes: LaneSamples, lane: int, s: float) -> tuple[float, float, float, float]:
    """Return x, y, yaw, kappa of a lane's centre line at station `s`.

    It is straight beyond its ends.
    """
    first, last = lanes.first[lane], lanes.first[lane + 1] - 1
    u = s / lanes.step[lane]
    i = min(max(int(u), 0), last - first - 1)
    share = min(max(u - i, 0.0), 1.0)
    x, y = _between(lanes.x, first + i, share), _between(lanes.y, first + i, share)
    yaw = _between(lanes.yaw, first + i, share)
    beyond = (u - i - share) * lanes.step[lane]
    if beyond != 0.0:
        return x + beyond * cos(yaw), y + beyond * sin(yaw), yaw, 0.0
    return x, y, yaw, _between(lanes.kappa, first + i, share)


@kernel
def lane_project(
    lanes: LaneSamples, lane: int, x: float, y: float, within: float
) -> tuple[float, float, float]:
    """Return station, offset to the left and half of the lane's width (m) at the foot of a point.

    The foot is the nearest point of the polyline; beyond the lane's ends the station is outside of
    [0, length]. If the polyline is farther away than `within` m, the offset is inf. The search
    skips samples that cannot be nearer than the best one or `within`, since neighbours are at most
    one step apart.
    """
    first, last, step = lanes.first[lane], lanes.first[lane + 1] - 1, lanes.step[lane]
    best, nearest, i = first, within + step, first
    while i <= last:
        dx, dy = lanes.x[i] - x, lanes.y[i] - y
        distance = sqrt(dx * dx + dy * dy)
        if distance < nearest:
            best, nearest = i, distance
        i += max(1, int((distance - nearest) / step))
    if nearest >= within + step:
        return 0.0, inf, 0.0
    s, left, nearest = 0.0, 0.0, inf
    for k in range(max(best - 1, first), min(best, last - 1) + 1):
        ax, ay = lanes.x[k], lanes.y[k]
        dx, dy = (lanes.x[k + 1] - ax) / step, (lanes.y[k + 1] - ay) / step
        square = dx * dx + dy * dy
        along = ((x - ax) * dx + (y - ay) * dy) / square if square > 0.0 else 0.0
        if k > first:
            along = max(along, 0.0)
        if k < last - 1:
            along = min(along, step)
        off_x, off_y = x - ax - along * dx, y - ay - along * dy
        distance = sqrt(off_x * off_x + off_y * off_y)
        if distance < nearest:
            nearest = distance
            s = (k - first) * step + along
            left = distance if dx * off_y - dy * off_x >= 0.0 else -distance
    u = min(max(s / step, 0.0), float(last - first))
    i = min(int(u), last - first - 1)
    return s, left, _between(lanes.half_width, first + i, u - i)


@inner_kernel
def _outside(boxes: FloatArray, lane: int, x: float, y: float, margin: float) -> bool:
    """Return whether a point is more than `margin` m outside a lane's box, along x or along y."""
    x_lo, y_lo, x_hi, y_hi = boxes[lane]
    return x < x_lo - margin or y < y_lo - margin or x > x_hi + margin or y > y_hi + margin


@kernel
def matches(
    lanes: LaneSamples, x: float, y: float, yaw: float, indices: IntArray, matched: FloatArray
) -> int:
    """Find the lanes that a vehicle may be driving on, by misfit; of equal lanes (on a marking),
    the first comes first.

    Args:
        lanes: The lanes.
        x: Box centre, m.
        y: m.
        yaw: Heading.
        indices: Out `(k,)`: the lanes that match.
        matched: Out `(k, 4)`, columns `STATION`, `LEFT`, `HALF_WIDTH` and `MISFIT`: (l / half)^2 +
            (heading difference / `SPREAD_RAD`)^2, plus `OUTSIDE` if the lane does not contain the
            point.

    Returns:
        The number of lanes that match, at most k.
    """
    count, room, misfits = 0, len(indices), matched[:, MISFIT]
    for lane in range(len(lanes.step)):
        if _outside(lanes.box, lane, x, y, BESIDE_M):
            continue
        s, left, half = lane_project(lanes, lane, x, y, lanes.widest[lane] + BESIDE_M)
        before_m, after_m = -s, s - lane_length(lanes, lane)
        if abs(left) > half + BESIDE_M + TIE or max(before_m, after_m) > PAST_END_M + TIE:
            continue
        turn = abs(wrap(yaw - lane_point(lanes, lane, s)[2]))
        if turn > ASKEW_RAD:
            continue
        misfit = (left / half) ** 2 + (turn / SPREAD_RAD) ** 2
        misfit += OUTSIDE if abs(left) > half + TIE else 0.0
        if count == room and misfit >= misfits[room - 1] - TIE:
            continue
        rank = min(count, room - 1)
        while rank > 0 and misfits[rank - 1] > misfit + TIE:
            indices[rank], matched[rank] = indices[rank - 1], matched[rank - 1]
            rank -= 1
        indices[rank] = lane
        matched[rank, STATION] = s
        matched[rank, LEFT] = left
        matched[rank, HALF_WIDTH] = half
        misfits[rank] = misfit
        count = min(count + 1, room)
    while count > 1 and misfits[0] < OUTSIDE <= misfits[count - 1]:
        count -= 1
    return count


@kernel
def road_ahead(
    lanes: LaneSamples, x: float, y: float, toward_x: float, toward_y: float, reach: float
) -> float:
    """Return the distance to the first lane in a direction (unit vector), m: 0 on a lane, inf if
    none within reach.
    """
    steps = int(reach / ROAD_STEP_M) + 1
    for k in range(steps):
        ahead = k * ROAD_STEP_M
        px, py = x + ahead * toward_x, y + ahead * toward_y
        for lane in range(len(lanes.step)):
            if _outside(lanes.box, lane, px, py, 0.0):
                continue
            s, left, half = lane_project(lanes, lane, px, py, lanes.widest[lane])
            if abs(left) <= half + TIE and -TIE <= s <= lane_length(lanes, lane) + TIE:
                return ahead
    return inf
