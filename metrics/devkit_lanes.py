"""The lanes of a road as the devkits of nuPlan and NAVSIM ask for them: lanes, connectors,
roadblocks, intersections, routes.

A connector is a lane in a junction (`replan.logs.lane_groups`). The other drivable lanes are lanes.
A roadblock is a set of lanes, or of connectors, that are neighbours in one direction. The
intersections are the areas of the connectors. Lanes end where they end: none is extended beyond the
map.

A lane is an index into `DevkitLanes.lanes`. The route of poses is, at each, the lane or connectors
under it (`route`): those of the pose before, their successors if there was one only, else a new
search: the first lane, else all connectors. A pose that leaves a connector for an unrelated one
stays with connectors nearer than `NEAR_M`. At last, of several connectors those remain that lead on
to the next pose's.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, Points
from replan.core.once import once
from replan.logs.lane_arrays import LaneArrays, lane_arrays
from replan.logs.lane_groups import connectors
from replan.logs.polylines import along_line, points_inside
from replan.logs.road import Lane, Road
from replan.metrics.lanes import lane_distances

NEAR_M = 5.0
Route = list[tuple[int, ...]]


@dataclass(frozen=True, eq=False)
class DevkitLanes:
    """The drivable lanes of a road.

    Attributes:
        lanes: The lanes; an index in this tuple names a lane.
        arrays: The same lanes as arrays.
        block: The roadblock of each lane, a number.
        after: The successors of each lane.
        before: The predecessors of each lane.
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

    def in_intersection(self, x: FloatArray, y: FloatArray) -> BoolArray:
        """Return which points `(k,)` are in an intersection."""
        return np.asarray(self.under(x, y)[np.array(self.connector)].any(axis=0))

    def in_area(self, x: FloatArray, y: FloatArray) -> BoolArray:
        """Return which points `(k,)` are on drivable ground beside the lanes."""
        covered = np.zeros(len(x), np.bool_)
        for area in self.areas:
            covered |= points_inside(area, x, y)
        return covered

    def off_road(self, x: FloatArray, y: FloatArray, reach: float) -> FloatArray:
        """Return the distance of points `(k,)` to the lanes and areas, m; inf beyond `reach`."""
        distance = lane_distances(self.arrays, x, y, reach).min(axis=0)
        for area in self.areas:
            _, to_edge = along_line(np.vstack([area, area[:1]]), x, y)
            distance = np.minimum(distance, np.where(points_inside(area, x, y), 0.0, to_edge))
        return np.where(distance < reach, distance, np.inf)

    def under(self, x: FloatArray, y: FloatArray) -> BoolArray:
        """Return which lanes are under points `(n, k)`."""
        return np.asarray(lane_distances(self.arrays, x, y, 0.0) == 0.0)

    def search(self, under: BoolArray) -> tuple[int, ...]:
        """Return the first lane under a point, else all connectors, of `under` `(n,)`."""
        indices = np.flatnonzero(under).tolist()
        lanes = [i for i in indices if not self.connector[i]]
        return tuple(lanes[:1] or indices)

    def continued(self, last: Sequence[int], under: BoolArray) -> tuple[int, ...]:
        """Return which of the last lanes are still under a point.

        If none is, of a single one its successors.
        """
        still = tuple(i for i in last if under[i])
        if still or len(last) != 1:
            return still
        return tuple(i for i in self.after[last[0]] if under[i])

    def route(self, x: FloatArray, y: FloatArray) -> Route:
        """Return the lane or connectors of each of the points `(k,)` of a drive (module
        docstring).
        """
        distance = lane_distances(self.arrays, x, y, NEAR_M)
        route: Route = []
        for k in range(len(x)):
            under = distance[:, k] == 0.0
            previous = route[-1] if route else ()
            lanes = self.continued(previous, under)
            if not lanes:
                lanes = self.search(under)
                if k > 1 and self._on_connector(previous) and self._on_connector(lanes):
                    lanes = tuple(i for i in previous if distance[i, k] < NEAR_M) or lanes
            route.append(lanes)
        for k in range(len(route) - 2, -1, -1):
            lanes, following = route[k], route[k + 1]
            if len(lanes) <= 1:
                continue
            if len(lanes) > len(following) and set(following) <= set(lanes):
                route[k] = following
            if following and not self.connector[following[0]]:
                leading = tuple(i for i in lanes if i in self.before[following[0]])
                route[k] = leading or route[k]
        return route

    def _on_connector(self, lanes: Sequence[int]) -> bool:
        return bool(lanes) and self.connector[lanes[0]]

    def corner_routes(self, x: FloatArray, y: FloatArray) -> list[list[tuple[int, ...]]]:
        """Return the lanes of corners `(4, k)`: for each step four tuples."""
        under_corners = [self.under(*points) for points in zip(x, y, strict=True)]
        routes: list[list[tuple[int, ...]]] = []
        candidates: list[int] = []
        for k in range(x.shape[1]):
            corner_lanes: list[tuple[int, ...]] = []
            for under in under_corners:
                lanes = self.continued(candidates, under[:, k])
                if not lanes:
                    lanes = self.search(under[:, k])
                    if k == 1:
                        candidates += [i for i in lanes if i not in candidates]
                corner_lanes.append(lanes)
            candidates = list(dict.fromkeys(i for lanes in corner_lanes for i in lanes))
            routes.append(corner_lanes)
        return routes

    def in_one(self, corners: Sequence[tuple[int, ...]]) -> bool:
        """Return whether four corners (front left, rear left, rear right, front right) share a lane
        or joined lanes.
        """
        if not all(corners):
            return False
        front_left, rear_left, rear_right, front_right = map(set, corners)
        if front_left & rear_left & rear_right & front_right:
            return True
        right = rear_right | _joined(self.after, rear_right)
        left = rear_left | _joined(self.after, rear_left)
        if not (rear_left & right or rear_right & left):
            return False
        from_left = front_left | _joined(self.before, front_left)
        from_right = front_right | _joined(self.before, front_right)
        return bool(from_left & right & from_right & left)


def _joined(links: Sequence[tuple[int, ...]], lanes: Iterable[int]) -> set[int]:
    return {linked for lane in lanes for linked in links[lane]}


@once
def devkit_lanes(road: Road) -> DevkitLanes | None:
    """Return the lanes of a road; None if it has no drivable lane."""
    lanes = tuple(lane for lane in road.lanes.values() if lane.drivable)
    if not lanes:
        return None
    arrays = lane_arrays(road)
    after = arrays.successors()
    before = tuple(
        tuple(i for i, successors in enumerate(after) if lane in successors)
        for lane in range(len(lanes))
    )
    block = np.arange(len(lanes))
    while True:
        beside = np.where(arrays.beside >= 0, block[arrays.beside], len(lanes))
        joined = np.minimum(block, beside.min(axis=1))
        if np.array_equal(joined, block):
            break
        block = joined
    blocks = tuple(block.tolist())
    return DevkitLanes(lanes, arrays, blocks, after, before, connectors(lanes), road.open_ground)
