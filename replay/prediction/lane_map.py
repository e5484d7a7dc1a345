"""The lanes of a road as flat arrays, made once per scenario, and the kernels that query them.

A lane's centre line is resampled to about `SPACING_M`; a point at station s and offset l (to the
left) of a lane is

(1) p = r(s) + l n(s)
        r and the heading of its tangent interpolated linearly between samples, n turned left of it
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, inf, pi, sin, sqrt
from typing import NamedTuple

import numpy as np

from replan.core.arrays import TIE, FloatArray, IntArray, arc_lengths, frozen
from replan.core.kernel import kernel
from replan.core.once import once
from replan.logs.road import Road
from replan.logs.states import wrap

SPACING_M = 1.0
BEND_M = 5.0
"""Curvatures are means over this distance to both sides, m, because bends in maps have corners."""
SHORTEST_M = 0.1
"""Shorter lanes have no direction and are left out."""
BESIDE_M = 0.3
"""A vehicle is still on a lane if the centre of its box is at most this far outside, m ..."""
ASKEW_RAD = 0.25 * pi
"""... and its heading differs from the lane's by at most this."""

ROAD_STEP_M = 0.25
OUTSIDE = 100.0
"""Additional misfit of a lane that does not contain the box's centre: it is used only if no lane
contains it.
"""


class LaneSamples(NamedTuple):
    """`n` lanes with `m` samples in all; lane i owns the samples `first[i] : first[i + 1]`.

    Attributes:
        first: `(n + 1,)`.
        step: `(n,)` m between two samples; the samples of a lane are equally spaced.
        tightest: `(n,)` greatest curvature, 1/m, not negative; `widest` half of the greatest width,
            m.
        pose: Rows x, y, yaw (continuous within a lane), kappa, half of the lane's width `(5, m)`.
        box: `(n, 4)` least x, y, greatest x, y of the centre line widened by half of the lane's
            width.
        next_first: `(n + 1,)`: lane i continues in the lanes
            `following[next_first[i] : next_first[i + 1]]`.
        following: Indices of lanes.
        beside: `(n, 2)` index of the lane to the left and to the right in the same direction, -1:
            none.
    """

    first: IntArray
    step: FloatArray
    tightest: FloatArray
    widest: FloatArray
    pose: FloatArray
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
        return cls(_arrays(road))

    @classmethod
    def unknown(cls) -> LaneMap:
        """Return a map without lanes: no vehicle follows one."""
        return cls.of(Road({}))

    def __len__(self) -> int:
        return len(self.arrays.step)


@once
def _arrays(road: Road) -> LaneSamples:
    lanes = [lane for lane in road.lanes.values() if lane.drivable and lane.length >= SHORTEST_M]
    index = {lane.id: i for i, lane in enumerate(lanes)}
    # Rows x, y, yaw, kappa, half width `(5, k)` of each centre line at equal steps, and the step, m
    sampled = []
    for lane in lanes:
        chord = arc_lengths(*lane.center.T)
        keep = np.r_[True, np.diff(chord) > 1e-9]
        count = max(1, round(chord[-1] / SPACING_M)) + 1
        s, step = np.linspace(0.0, chord[-1], count, retstep=True)
        half = 0.5 * np.hypot(*(lane.left - lane.right).T)
        x, y, width = (np.interp(s, chord[keep], column[keep]) for column in (*lane.center.T, half))
        along = np.unwrap(np.arctan2(np.diff(y), np.diff(x)))
        yaw = (
            np.r_[along[0], 0.5 * (along[1:] + along[:-1]), along[-1]]
            if count > 2
            else np.repeat(along, 2)
        )
        behind, ahead = np.maximum(s - BEND_M, 0.0), np.minimum(s + BEND_M, s[-1])
        kappa = (np.interp(ahead, s, yaw) - np.interp(behind, s, yaw)) / (ahead - behind)
        sampled.append((np.vstack([x, y, yaw, kappa, width]), float(step)))
    follow = [[index[k] for k in lane.successors if k in index] for lane in lanes]
    beside = [
        [
            index.get(k, -1) if k is not None else -1
            for k in (lane.left_neighbour, lane.right_neighbour)
        ]
        for lane in lanes
    ]
    pose = np.hstack([np.empty((5, 0)), *(pose for pose, _ in sampled)])
    reach = [np.r_[(p[:2] - p[4]).min(axis=1), (p[:2] + p[4]).max(axis=1)] for p, _ in sampled]
    return LaneSamples(
        frozen(np.cumsum([0, *(pose.shape[1] for pose, _ in sampled)]), np.int64),
        frozen([step for _, step in sampled]),
        frozen([np.abs(pose[3]).max() for pose, _ in sampled]),
        frozen([pose[4].max() for pose, _ in sampled]),
        frozen(pose),
        frozen(np.array(reach).reshape(-1, 4)),
        frozen(np.cumsum([0, *map(len, follow)]), np.int64),
        frozen([k for some in follow for k in some], np.int64),
        frozen(np.array(beside).reshape(-1, 2), np.int64),
    )


@kernel
def lane_point(map_: LaneSamples, lane: int, s: float) -> tuple[float, float, float, float]:
    """Return x, y, yaw, kappa of a lane's centre line at station `s`.

    It is straight beyond its ends.
    """
    first, last = map_.first[lane], map_.first[lane + 1] - 1
    u = s / map_.step[lane]
    i = min(max(int(u), 0), last - first - 1)
    inner = min(max(u - i, 0.0), 1.0)
    k = first + i
    yaw = map_.pose[2, k] + inner * (map_.pose[2, k + 1] - map_.pose[2, k])
    x = map_.pose[0, k] + inner * (map_.pose[0, k + 1] - map_.pose[0, k])
    y = map_.pose[1, k] + inner * (map_.pose[1, k + 1] - map_.pose[1, k])
    beyond = (u - i - inner) * map_.step[lane]
    if beyond != 0.0:
        return x + beyond * cos(yaw), y + beyond * sin(yaw), yaw, 0.0
    return x, y, yaw, map_.pose[3, k] + inner * (map_.pose[3, k + 1] - map_.pose[3, k])


@kernel
def lane_project(
    map_: LaneSamples, lane: int, x: float, y: float, within: float
) -> tuple[float, float, float]:
    """Return station, offset to the left and half of the lane's width (m) at the foot of a point.

    The foot is the nearest point of the polyline; beyond the lane's ends the station is outside of
    [0, length]. If the polyline is farther away than `within` m, the offset is inf. The search
    skips samples that cannot be nearer than the best one or `within`, since neighbours are at most
    one step apart.
    """
    first, last, step = map_.first[lane], map_.first[lane + 1] - 1, map_.step[lane]
    best, nearest, i = first, within + step, first
    while i <= last:
        dx, dy = map_.pose[0, i] - x, map_.pose[1, i] - y
        away = sqrt(dx * dx + dy * dy)
        if away < nearest:
            best, nearest = i, away
        i += max(1, int((away - nearest) / step))
    if nearest >= within + step:
        return 0.0, inf, 0.0
    s, left, miss = 0.0, 0.0, 1e300
    for k in range(max(best - 1, first), min(best, last - 1) + 1):
        ax, ay = map_.pose[0, k], map_.pose[1, k]
        dx, dy = (map_.pose[0, k + 1] - ax) / step, (map_.pose[1, k + 1] - ay) / step
        square = dx * dx + dy * dy
        along = ((x - ax) * dx + (y - ay) * dy) / square if square > 0.0 else 0.0
        low = -1e300 if k == first else 0.0
        high = 1e300 if k == last - 1 else step
        along = min(max(along, low), high)
        off_x, off_y = x - ax - along * dx, y - ay - along * dy
        off = sqrt(off_x * off_x + off_y * off_y)
        if off < miss:
            miss = off
            s = (k - first) * step + along
            left = off if dx * off_y - dy * off_x >= 0.0 else -off
    inner = min(max(s / step, 0.0), float(last - first))
    k = first + min(int(inner), last - first - 1)
    u = inner - (k - first)
    return s, left, map_.pose[4, k] + u * (map_.pose[4, k + 1] - map_.pose[4, k])


@kernel
def matches(
    map_: LaneSamples, x: float, y: float, yaw: float, lanes: IntArray, found: FloatArray
) -> int:
    """Find the lanes that a vehicle may be driving on, by misfit; of equal lanes (on a marking),
    the first comes first.

    Args:
        map_: The lanes.
        x: Box centre, m.
        y: m.
        yaw: Heading.
        lanes: Out `(k,)`: their indices.
        found: Out `(k, 4)`: station, offset, half of the lane's width, and misfit: (l / half)^2 +
            (heading difference / 0.3 rad)^2, plus `OUTSIDE` if the lane does not contain the point.

    Returns:
        The number of lanes found, at most k.
    """
    count = 0
    for lane in range(len(map_.step)):
        box = map_.box[lane]
        if (
            x < box[0] - BESIDE_M
            or y < box[1] - BESIDE_M
            or x > box[2] + BESIDE_M
            or y > box[3] + BESIDE_M
        ):
            continue
        s, left, half = lane_project(map_, lane, x, y, map_.widest[lane] + BESIDE_M)
        length = map_.step[lane] * (map_.first[lane + 1] - map_.first[lane] - 1)
        if abs(left) > half + BESIDE_M + TIE or s < -0.5 - TIE or s > length + 0.5 + TIE:
            continue
        turn = abs(wrap(yaw - lane_point(map_, lane, s)[2]))
        if turn > ASKEW_RAD:
            continue
        misfit = (
            (left / half) ** 2 + (turn / 0.3) ** 2 + (OUTSIDE if abs(left) > half + TIE else 0.0)
        )
        at = min(count, len(lanes) - 1)
        if count == len(lanes) and misfit >= found[at, 3] - TIE:
            continue
        while at > 0 and found[at - 1, 3] > misfit + TIE:
            lanes[at], found[at] = lanes[at - 1], found[at - 1]
            at -= 1
        lanes[at] = lane
        found[at, 0], found[at, 1], found[at, 2], found[at, 3] = s, left, half, misfit
        count = min(count + 1, len(lanes))
    while count > 1 and found[0, 3] < OUTSIDE <= found[count - 1, 3]:
        count -= 1
    return count


@kernel
def road_ahead(
    map_: LaneSamples, x: float, y: float, toward_x: float, toward_y: float, reach: float
) -> float:
    """Return the distance to the first lane in a direction (unit vector), m: 0 on a lane, inf if
    none within reach.
    """
    steps = int(reach / ROAD_STEP_M) + 1
    for k in range(steps):
        px, py = x + k * ROAD_STEP_M * toward_x, y + k * ROAD_STEP_M * toward_y
        for lane in range(len(map_.step)):
            box = map_.box[lane]
            if px < box[0] or py < box[1] or px > box[2] or py > box[3]:
                continue
            s, left, half = lane_project(map_, lane, px, py, map_.widest[lane])
            length = map_.step[lane] * (map_.first[lane + 1] - map_.first[lane] - 1)
            if abs(left) <= half + TIE and -TIE <= s <= length + TIE:
                return k * ROAD_STEP_M
    return inf
