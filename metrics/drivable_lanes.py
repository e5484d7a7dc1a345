"""The map as the devkits of nuPlan and NAVSIM ask it: lanes, lane connectors, roadblocks, intersections, routes.

A connector is a lane in a junction: the log calls it "intersection" (`Lane.kind`), or, in a log that calls none so, it
crosses another lane. The other drivable lanes are lanes. A roadblock is a set of lanes, or of connectors, that are
neighbours in one direction. The intersections are the areas of the connectors. Lanes end where they end: none is
extended beyond the map.

A lane is an index into `DrivableLanes.lanes`. The route of poses is, at each, the lane or connectors under it
(`route`): those of the pose before, their successors if there was one only, else a new search: the first lane, else all
connectors. A pose that leaves a connector for an unrelated one stays with connectors nearer than `NEAR_M`. At last, of
several connectors those remain that lead on to the next pose's.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from math import hypot, inf

import numpy as np

from logs.arrays import BoolArray, FloatArray, Points
from logs.kernel import kernel
from logs.once import once
from logs.road import IN_JUNCTION, Lane, Road
from logs.shapes import point_segment
from metrics.lanes import LaneArrays, edge_distance, lane_arrays, on_lane, points_inside

NEAR_M = 5.0
Route = list[tuple[int, ...]]


@kernel
def lane_distances(lanes: LaneArrays, x: FloatArray, y: FloatArray, reach: float) -> FloatArray:
    """Return the distance of points `(k,)` to each lane `(n, k)`, m: 0 inside, inf beyond `reach`."""
    out = np.full((len(lanes.box), len(x)), inf)
    for i in range(len(lanes.box)):
        box = lanes.box[i]
        for k in range(len(x)):
            gap = hypot(max(box[0] - x[k], 0.0, x[k] - box[2]), max(box[1] - y[k], 0.0, y[k] - box[3]))
            if gap > reach:
                continue
            if gap == 0.0 and on_lane(lanes, i, x[k], y[k]):
                out[i, k] = 0.0
            else:
                found = edge_distance(lanes, i, x[k], y[k], reach)
                out[i, k] = found if found < reach else inf
    return out


@kernel
def along_line(line: FloatArray, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the station of the nearest point of a polyline `(n, 2)` to each point `(k,)`, and the distance, m."""
    station, away = np.zeros(len(x)), np.full(len(x), inf)
    for k in range(len(x)):
        begin = 0.0
        for j in range(len(line) - 1):
            ax, ay, bx, by = line[j, 0], line[j, 1], line[j + 1, 0], line[j + 1, 1]
            length = hypot(bx - ax, by - ay)
            found = point_segment(x[k], y[k], ax, ay, bx, by)
            if found < away[k] and length > 0.0:
                along = ((x[k] - ax) * (bx - ax) + (y[k] - ay) * (by - ay)) / length
                away[k], station[k] = found, begin + min(max(along, 0.0), length)
            begin += length
    return station, away


@dataclass(frozen=True, eq=False)
class DrivableLanes:
    """The drivable lanes of a road.

    Attributes:
        lanes: The lanes; an index in this tuple names a lane.
        arrays: Their outlines.
        block: The roadblock of each lane, a number.
        after: The successors of each lane; `before` the predecessors.
        connector: Whether each lane is a connector.
        areas: Other drivable ground, polygons `(k, 2)`.
    """

    lanes: tuple[Lane, ...]
    arrays: LaneArrays
    block: tuple[int, ...]
    after: tuple[tuple[int, ...], ...]
    before: tuple[tuple[int, ...], ...]
    connector: tuple[bool, ...]
    areas: tuple[Points, ...] = ()

    @cached_property
    def crossing(self) -> BoolArray:
        """Which lanes are connectors `(n,)`."""
        return np.array(self.connector, np.bool_)

    def in_intersection(self, x: FloatArray, y: FloatArray) -> BoolArray:
        """Return which points `(k,)` are in an intersection."""
        return np.asarray(self.under(x, y)[self.crossing].any(axis=0))

    def in_area(self, x: FloatArray, y: FloatArray) -> BoolArray:
        """Return which points `(k,)` are on drivable ground beside the lanes."""
        found = np.zeros(len(x), np.bool_)
        for area in self.areas:
            found |= points_inside(area, x, y)
        return found

    def off_road(self, x: FloatArray, y: FloatArray, reach: float) -> FloatArray:
        """Return the distance of points `(k,)` to the lanes and areas, m; inf beyond `reach`."""
        away = lane_distances(self.arrays, x, y, reach).min(axis=0)
        for area in self.areas:
            ring = np.vstack([area, area[:1]])
            away = np.minimum(away, np.where(points_inside(area, x, y), 0.0, along_line(ring, x, y)[1]))
        return np.where(away < reach, away, inf)

    def under(self, x: FloatArray, y: FloatArray) -> BoolArray:
        """Return which lanes are under points `(n, k)`."""
        return np.asarray(lane_distances(self.arrays, x, y, 0.0) == 0.0)

    def search(self, under: BoolArray) -> tuple[int, ...]:
        """Return the first lane under a point, else all connectors, of `under` `(n,)`."""
        found = np.flatnonzero(under).tolist()
        lanes = [i for i in found if not self.connector[i]]
        return (lanes[0],) if lanes else tuple(found)

    def continued(self, last: Sequence[int], under: BoolArray) -> tuple[int, ...]:
        """Return which of the last lanes are still under a point; if none is, of a single one its successors."""
        still = tuple(i for i in last if under[i])
        return still or (tuple(i for i in self.after[last[0]] if under[i]) if len(last) == 1 else ())

    def route(self, x: FloatArray, y: FloatArray) -> Route:
        """Return the lane or connectors of each of the points `(k,)` of a drive (module docstring)."""
        away = lane_distances(self.arrays, x, y, NEAR_M)
        out: Route = []
        now: tuple[int, ...] = ()
        for k in range(len(x)):
            under = away[:, k] == 0.0
            now = self.continued(now, under) if now else ()
            if not now:
                now = self.search(under)
                if k > 1 and out[-1] and self.connector[out[-1][0]] and now and self.connector[now[0]]:
                    now = tuple(i for i in out[-1] if away[i, k] < NEAR_M) or now
            out.append(now)
        for k in range(len(out) - 2, -1, -1):
            here, then = out[k], out[k + 1]
            if len(here) <= 1:
                continue
            if len(here) > len(then) and set(then) <= set(here):
                out[k] = then
            if then and not self.connector[then[0]]:
                out[k] = tuple(i for i in here if i in self.before[then[0]]) or out[k]
        return out

    def corner_routes(self, x: FloatArray, y: FloatArray) -> list[list[tuple[int, ...]]]:
        """Return the lanes of corners `(4, k)`: for each step four tuples."""
        known, out = [self.under(*row) for row in zip(x, y, strict=True)], []
        candidates: list[int] = []
        for k in range(x.shape[1]):
            found, following = [], []
            for corner in range(4):
                under = known[corner][:, k]
                here = self.continued(candidates, under) if candidates else ()
                if not here:
                    here = self.search(under)
                    if k == 1:
                        candidates += [i for i in here if i not in candidates]
                following += [i for i in here if i not in following]
                found.append(here)
            candidates = following
            out.append(found)
        return out

    def in_one(self, corners: Sequence[tuple[int, ...]]) -> bool:
        """Return whether four corners (front left, rear left, rear right, front right) share a lane or joined lanes."""
        if not all(corners):
            return False
        fl, rl, rr, fr = (set(one) for one in corners)
        if fl & rl & rr & fr:
            return True
        right, left = rr | self._of(self.after, rr), rl | self._of(self.after, rl)
        if not (rl & right or rr & left):
            return False
        return bool((fl | self._of(self.before, fl)) & right & (fr | self._of(self.before, fr)) & left)

    @staticmethod
    def _of(table: Sequence[tuple[int, ...]], lanes: Iterable[int]) -> set[int]:
        return {j for i in lanes for j in table[i]}


@once
def lane_map(road: Road) -> DrivableLanes | None:
    """Return the map of a road; None if it has no drivable lane."""
    if (arrays := lane_arrays(road, 0.0)) is None:
        return None
    lanes = tuple(lane for lane in road.lanes.values() if lane.drivable)
    index = {lane.id: i for i, lane in enumerate(lanes)}
    after = tuple(tuple(index[j] for j in lane.successors if j in index) for lane in lanes)
    before = tuple(tuple(i for i, those in enumerate(after) if j in those) for j in range(len(lanes)))
    beside = [[index[j] for j in (lane.left_neighbour, lane.right_neighbour) if j in index] for lane in lanes]
    block = list(range(len(lanes)))
    while (joined := [min(block[i], *(block[j] for j in those)) if those else block[i]
                      for i, those in enumerate(beside)]) != block:  # fmt: skip
        block = joined
    return DrivableLanes(lanes, arrays, tuple(block), after, before, _connectors(lanes), road.areas)


def _connectors(lanes: Sequence[Lane]) -> tuple[bool, ...]:
    """Return which lanes are in a junction, as the log says; else those whose centre line crosses another's."""
    marked = tuple(IN_JUNCTION in lane.kind.split("+") for lane in lanes)
    if any(marked):
        return marked
    found = [False] * len(lanes)
    for i, j in combinations(range(len(lanes)), 2):
        (a, b), (c, d) = ((lane.center[:-1], lane.center[1:]) for lane in (lanes[i], lanes[j]))
        low, high = np.maximum(a.min(axis=0), c.min(axis=0)), np.minimum(b.max(axis=0), d.max(axis=0))
        if not ((low <= np.maximum(high, np.minimum(a.max(axis=0), c.max(axis=0)))).all() and _cross(a, b, c, d)):
            continue
        found[i] = found[j] = True
    return tuple(found)


def _cross(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> bool:
    """Return whether one of the segments a to b `(n, 2)` properly crosses one of the segments c to d `(m, 2)`."""

    def side(p: FloatArray, q: FloatArray, r: FloatArray) -> FloatArray:
        (px, py), (qx, qy), (rx, ry) = p.T, q.T, r.T
        return np.asarray((qx - px)[:, None] * (ry - py[:, None]) - (qy - py)[:, None] * (rx - px[:, None]))

    apart = side(a, b, c) * side(a, b, d) < 0.0
    return bool((apart & (side(c, d, a) * side(c, d, b) < 0.0).T).any())
