"""A road's lanes as flat arrays, for the queries of metrics: distance off the lanes, speed limit,
direction.

The end of the map is not the end of the road: a lane without a successor in the map is extended
straight by 10 m (two cars' lengths), and a lane without a predecessor is extended backwards
likewise.

`DrivableLanes` is the map as the devkits of nuPlan and NAVSIM ask it: lanes, connectors,
roadblocks, intersections, routes.

A connector is a lane in a junction: the log calls it "intersection" (`Lane.kind`), or, in a log
that calls none so, it crosses another lane. The other drivable lanes are lanes. A roadblock is a
set of lanes, or of connectors, that are neighbours in one direction. The intersections are the
areas of the connectors. Lanes end where they end: none is extended beyond the map.

A lane is an index into `DrivableLanes.lanes`. The route of poses is, at each, the lane or
connectors under it (`route`): those of the pose before, their successors if there was one only,
else a new search: the first lane, else all connectors. A pose that leaves a connector for an
unrelated one stays with connectors nearer than `NEAR_M`. At last, of several connectors those
remain that lead on to the next pose's.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from math import ceil, cos, hypot, inf, nan, pi, sin, sqrt
from typing import NamedTuple

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray, Points, frozen
from replan.core.kernel import inner_kernel, kernel
from replan.core.once import once
from replan.logs.road import IN_JUNCTION, Lane, Road, RoadSource, inside
from replan.logs.shapes import point_segment
from replan.metrics.metric import Unavailable

NO_LANES = Unavailable("the log has no lanes")
BEYOND_M = 10.0
SURE_M = 1e-6  # Tolerance of the test that skips boxes, m: rounding must not change results
FEW = 16  # Least number of edges per box (except the last of a polyline)
# Lanes cross where their directions differ by more than this, in either sense
CROSSING = cos(30.0 / 180.0 * pi)


class EdgeBoxes(NamedTuple):
    """Bounding boxes of stretches of polylines: a query looks only at the edges in near boxes."""

    first: IntArray  # `(n + 1,)`: polyline i owns the boxes `first[i] : first[i + 1]`
    box: FloatArray  # `(g, 4)`: least x, y, greatest x, y of its edges
    edges: IntArray  # `(g, 2)`: its first edge, and the edge after its last


class LaneArrays(NamedTuple):
    """The drivable lanes of a road."""

    # Outlines of all lanes one after the other `(m, 2)`, m; edge k of one leads from its point k -
    # 1 to k
    points: FloatArray
    offsets: IntArray  # `(n + 1,)`: lane i owns the points `offsets[i] : offsets[i + 1]`
    # Their centre lines `(m / 2, 2)`, m; lane i owns the halves of `offsets`; edge k leads from
    # point k on
    center: FloatArray
    box: FloatArray  # `(n, 4)`: least x, y, greatest x, y
    limit: FloatArray  # `(n,)` the log's speed limit, m/s; NaN where it has none
    outline: EdgeBoxes  # Boxes of the outlines; `middle` of the centre lines
    middle: EdgeBoxes


def points_inside(polygon: FloatArray, x: FloatArray, y: FloatArray) -> BoolArray:
    """Return which points `(n,)` lie in a polygon `(k, 2)`.

    Its bounding box excludes most points early.
    """
    (x_lo, y_lo), (x_hi, y_hi) = polygon.min(axis=0), polygon.max(axis=0)
    found = (x >= x_lo) & (x <= x_hi) & (y >= y_lo) & (y <= y_hi)
    found[found] = [
        inside(*point, polygon) for point in zip(x[found].tolist(), y[found].tolist(), strict=True)
    ]
    return np.asarray(found)


def mapped_lanes(road: Road) -> LaneArrays | None:
    """Return the lanes of the log's own map that a car may drive on; None if it has none."""
    return None if road.source is RoadSource.DRIVEN_PATH else drivable_lanes(road)


@once
def stated_lanes(road: Road) -> LaneArrays | None:
    """Return `mapped_lanes` with only the speed limits that the log states."""
    if (lanes := mapped_lanes(road)) is None:
        return None
    stated = [road.stated_limit(lane.id) for lane in road.lanes.values() if lane.drivable]
    return lanes._replace(limit=frozen(stated))


def drivable_lanes(road: Road) -> LaneArrays | None:
    """Return the lanes that a car may drive on, extended where the map ends; None if there are
    none.
    """
    return lane_arrays(road, BEYOND_M)


@once
def lane_arrays(road: Road, beyond: float) -> LaneArrays | None:
    """Return the lanes that a car may drive on, `beyond` m longer where the map ends; None if there
    are none.
    """
    lanes = [lane for lane in road.lanes.values() if lane.drivable]
    if not lanes:
        return None
    entered = {after for lane in road.lanes.values() for after in lane.successors}
    outlines = []
    for lane in lanes:  # the polygon, extended where the map ends or begins
        forth, back = lane.center[-1:] - lane.center[-2:-1], lane.center[:1] - lane.center[1:2]
        ends, begins = road.lanes.keys().isdisjoint(lane.successors), lane.id not in entered
        for longer, way in ((ends, forth), (begins, back)):
            length = float(np.hypot(*way[0]))
            way *= beyond / length if longer and length > 0.0 else 0.0
        sides = [
            np.vstack([side[:1] + back, side, side[-1:] + forth])
            for side in (lane.left, lane.right)
        ]
        outlines.append(np.vstack([sides[0], sides[1][::-1]]))
    box = [(*outline.min(axis=0), *outline.max(axis=0)) for outline in outlines]
    offsets = np.r_[0, np.cumsum([len(outline) for outline in outlines])]
    centers = [
        0.5 * (outline[: len(outline) // 2] + outline[: len(outline) // 2 - 1 : -1])
        for outline in outlines
    ]
    edges = [np.hstack([np.roll(outline, 1, axis=0), outline]) for outline in outlines]
    pieces = [np.hstack([center[:-1], center[1:]]) for center in centers]
    return LaneArrays(
        frozen(np.vstack(outlines)),
        frozen(offsets, np.int64),
        frozen(np.vstack(centers)),
        frozen(box),
        frozen([lane.speed_limit for lane in lanes]),
        _boxes(edges),
        _boxes(pieces),
    )


def _boxes(polylines: Sequence[FloatArray]) -> EdgeBoxes:
    """Return boxes of the edges of polylines, each `(n, 4)` (start and end): sqrt(n) edges per box,
    at least `FEW`.
    """
    first, box, rows = [0], [], []
    for edges in polylines:
        step = max(FEW, ceil(sqrt(len(edges))))
        for k in range(0, len(edges), step):
            points = edges[k : k + step].reshape(-1, 2)
            box.append((*points.min(axis=0), *points.max(axis=0)))
            rows.append((k, min(k + step, len(edges))))
        first.append(len(box))
    return EdgeBoxes(frozen(first, np.int64), frozen(box), frozen(rows, np.int64))


def keeps_lane(road: Road, x: float, y: float, corners: FloatArray) -> bool:
    """Return whether a box with centre (x, y) is in one lane, and not where lanes cross or fork.

    Successors and predecessors continue the lane: a car between one lane and the next along the
    road keeps its lane.
    """
    under = [lane for lane in road.lanes_at(x, y) if lane.drivable]
    if len(under) != 1:
        return False
    before = (other.id for other in road.lanes.values() if under[0].id in other.successors)
    strip = {under[0].id, *under[0].successors, *before}
    return all(
        any(lane.id in strip for lane in road.lanes_at(*corner)) for corner in corners.tolist()
    )


class Under(NamedTuple):
    """The lanes under points of a drive, `(k,)` each; NaN without a lane; at crossings `along` and
    `left` are NaN.
    """

    # Cosine of the angle between heading and lane; of several lanes, the best aligned one. -1:
    # against the lane.
    along: FloatArray
    # Distance from the nearest centre line of a lane there, m, positive to the left of the lane
    left: FloatArray
    half: FloatArray  # Half of that lane's width there, m


@kernel
def _gap(box: FloatArray, g: int, x: float, y: float) -> float:
    """Return the distance of a point from box g (least x, y, greatest x, y), 0 inside it."""
    dx, dy = max(box[g, 0] - x, 0.0, x - box[g, 2]), max(box[g, 1] - y, 0.0, y - box[g, 3])
    return sqrt(dx * dx + dy * dy)


@kernel
def on_lane(lanes: LaneArrays, i: int, x: float, y: float) -> bool:
    """Return whether a point lies in lane i: `replan.logs.road.inside` with only the edges that a
    ray from it could cross.
    """
    polygon, boxes = lanes.points[lanes.offsets[i] : lanes.offsets[i + 1]], lanes.outline
    found = False
    for g in range(boxes.first[i], boxes.first[i + 1]):
        if y < boxes.box[g, 1] or y > boxes.box[g, 3] or x > boxes.box[g, 2] + SURE_M:
            continue
        for k in range(boxes.edges[g, 0], boxes.edges[g, 1]):
            xi, yi, xj, yj = polygon[k, 0], polygon[k, 1], polygon[k - 1, 0], polygon[k - 1, 1]
            if (yi > y) != (yj > y) and x < (xj - xi) * (y - yi) / (yj - yi) + xi:
                found = not found
    return found


@inner_kernel
def _on_center(lanes: LaneArrays, i: int, x: float, y: float) -> tuple[float, float, float, float]:
    """Return lane i's unit direction nearest to (x, y), the distance to its left, and half of its
    width there, m.
    """
    center = lanes.center[lanes.offsets[i] // 2 : lanes.offsets[i + 1] // 2]
    best, cx, cy, left, half, boxes = inf, 0.0, 0.0, 0.0, 0.0, lanes.middle
    bound = inf  # upper bound: the farthest corner of each box
    for g in range(boxes.first[i], boxes.first[i + 1]):
        box = boxes.box[g]
        bound = min(bound, hypot(max(x - box[0], box[2] - x), max(y - box[1], box[3] - y)))
    for g in range(boxes.first[i], boxes.first[i + 1]):
        if _gap(boxes.box, g, x, y) > min(best, bound) + SURE_M:
            continue
        for k in range(boxes.edges[g, 0], boxes.edges[g, 1]):
            ax, ay, bx, by = center[k, 0], center[k, 1], center[k + 1, 0], center[k + 1, 1]
            length, found = hypot(bx - ax, by - ay), point_segment(x, y, ax, ay, bx, by)
            if length > 0.0 and found < best:
                best, cx, cy = found, (bx - ax) / length, (by - ay) / length
                left = found if cx * (y - ay) - cy * (x - ax) >= 0.0 else -found
                begin = lanes.points[lanes.offsets[i] + k]
                half = hypot(begin[0] - ax, begin[1] - ay)
    return cx, cy, left, half


@kernel
def under(lanes: LaneArrays, x: FloatArray, y: FloatArray, yaw: FloatArray) -> Under:
    """The lanes under points `(k,)` with a heading."""
    along, left, half = np.full(len(x), nan), np.full(len(x), nan), np.full(len(x), nan)
    for k in range(len(x)):
        first_x, first_y, crossing = 0.0, 0.0, False
        for i in range(len(lanes.box)):
            if _gap(lanes.box, i, x[k], y[k]) > 0.0 or not on_lane(lanes, i, x[k], y[k]):
                continue
            cx, cy, aside, wide = _on_center(lanes, i, x[k], y[k])
            if not np.isfinite(along[k]):
                first_x, first_y, along[k], left[k] = (
                    cx,
                    cy,
                    cx * cos(yaw[k]) + cy * sin(yaw[k]),
                    aside,
                )
                half[k] = wide
                continue
            crossing = crossing or abs(first_x * cx + first_y * cy) < CROSSING
            along[k] = max(along[k], cx * cos(yaw[k]) + cy * sin(yaw[k]))
            if abs(aside) < abs(left[k]):
                left[k], half[k] = aside, wide
        if crossing:
            along[k], left[k] = nan, nan
    return Under(along, left, half)


@inner_kernel
def edge_distance(lanes: LaneArrays, i: int, x: float, y: float, best: float) -> float:
    """Return the distance of a point from lane i's outline, m, or `best` if that is smaller."""
    polygon, boxes = lanes.points[lanes.offsets[i] : lanes.offsets[i + 1]], lanes.outline
    for g in range(boxes.first[i], boxes.first[i + 1]):
        if _gap(boxes.box, g, x, y) > best + SURE_M:
            continue
        for k in range(boxes.edges[g, 0], boxes.edges[g, 1]):
            j = k - 1
            best = min(
                best,
                point_segment(x, y, polygon[j, 0], polygon[j, 1], polygon[k, 0], polygon[k, 1]),
            )
    return best


@kernel
def off_lanes(lanes: LaneArrays, x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the exact distance `(k,)` of points `(k,)` to the nearest drivable lane, m; 0 on a
    lane.

    Lanes whose bounding box is not nearer than the best distance are skipped; the previous nearest
    lane is tried first.
    """
    n, out, recent = len(lanes.box), np.empty(len(x)), 0
    for k in range(len(x)):
        best, start = inf, recent
        for turn in range(n):
            i = (start + turn) % n
            if _gap(lanes.box, i, x[k], y[k]) >= best:
                continue
            found = (
                0.0 if on_lane(lanes, i, x[k], y[k]) else edge_distance(lanes, i, x[k], y[k], best)
            )
            if found < best:
                best, recent = found, i
            if best == 0.0:
                break
        out[k] = best
    return out


@kernel
def limits_at(lanes: LaneArrays, x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the log's speed limit `(k,)` at points, m/s: the largest of overlapping lanes; NaN if
    no lane has one.
    """
    out = np.full(len(x), nan)
    for k in range(len(x)):
        for i in range(len(lanes.box)):
            if _gap(lanes.box, i, x[k], y[k]) > 0.0 or lanes.limit[i] <= out[k]:
                continue
            if np.isfinite(lanes.limit[i]) and on_lane(lanes, i, x[k], y[k]):
                out[k] = lanes.limit[i]
    return out


NEAR_M = 5.0
Route = list[tuple[int, ...]]


@kernel
def lane_distances(lanes: LaneArrays, x: FloatArray, y: FloatArray, reach: float) -> FloatArray:
    """Return the distance of points `(k,)` to each lane `(n, k)`, m: 0 inside, inf beyond
    `reach`.
    """
    out = np.full((len(lanes.box), len(x)), inf)
    for i in range(len(lanes.box)):
        box = lanes.box[i]
        for k in range(len(x)):
            gap = hypot(
                max(box[0] - x[k], 0.0, x[k] - box[2]), max(box[1] - y[k], 0.0, y[k] - box[3])
            )
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
    """Return the station of the nearest point of a polyline `(n, 2)` to each point `(k,)`, and the
    distance, m.
    """
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
    """The drivable lanes of a road."""

    lanes: tuple[Lane, ...]  # The lanes; an index in this tuple names a lane
    arrays: LaneArrays  # Their outlines
    block: tuple[int, ...]  # The roadblock of each lane, a number
    after: tuple[tuple[int, ...], ...]  # The successors of each lane; `before` the predecessors
    before: tuple[tuple[int, ...], ...]
    connector: tuple[bool, ...]  # Whether each lane is a connector
    areas: tuple[Points, ...] = ()  # Other drivable ground, polygons `(k, 2)`

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
            away = np.minimum(
                away, np.where(points_inside(area, x, y), 0.0, along_line(ring, x, y)[1])
            )
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
        """Return which of the last lanes are still under a point.

        If none is, of a single one its successors.
        """
        still = tuple(i for i in last if under[i])
        return still or (
            tuple(i for i in self.after[last[0]] if under[i]) if len(last) == 1 else ()
        )

    def route(self, x: FloatArray, y: FloatArray) -> Route:
        """Return the lane or connectors of each of the points `(k,)` of a drive (module
        docstring).
        """
        away = lane_distances(self.arrays, x, y, NEAR_M)
        out: Route = []
        now: tuple[int, ...] = ()
        for k in range(len(x)):
            under = away[:, k] == 0.0
            now = self.continued(now, under) if now else ()
            if not now:
                now = self.search(under)
                if (
                    k > 1
                    and out[-1]
                    and self.connector[out[-1][0]]
                    and now
                    and self.connector[now[0]]
                ):
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
        """Return whether four corners (front left, rear left, rear right, front right) share a lane
        or joined lanes.
        """
        if not all(corners):
            return False
        fl, rl, rr, fr = (set(one) for one in corners)
        if fl & rl & rr & fr:
            return True
        right, left = rr | self._of(self.after, rr), rl | self._of(self.after, rl)
        if not (rl & right or rr & left):
            return False
        return bool(
            (fl | self._of(self.before, fl)) & right & (fr | self._of(self.before, fr)) & left
        )

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
    before = tuple(
        tuple(i for i, those in enumerate(after) if j in those) for j in range(len(lanes))
    )
    beside = [
        [index[j] for j in (lane.left_neighbour, lane.right_neighbour) if j in index]
        for lane in lanes
    ]
    block = list(range(len(lanes)))
    while (
        joined := [
            min(block[i], *(block[j] for j in those)) if those else block[i]
            for i, those in enumerate(beside)
        ]
    ) != block:
        block = joined
    return DrivableLanes(lanes, arrays, tuple(block), after, before, _connectors(lanes), road.areas)


def _connectors(lanes: Sequence[Lane]) -> tuple[bool, ...]:
    """Return which lanes are in a junction, as the log says.

    Else those whose centre line crosses another's.
    """
    marked = tuple(IN_JUNCTION in lane.kind.split("+") for lane in lanes)
    if any(marked):
        return marked
    found = [False] * len(lanes)
    for i, j in combinations(range(len(lanes)), 2):
        (a, b), (c, d) = ((lane.center[:-1], lane.center[1:]) for lane in (lanes[i], lanes[j]))
        low, high = (
            np.maximum(a.min(axis=0), c.min(axis=0)),
            np.minimum(b.max(axis=0), d.max(axis=0)),
        )
        if not (
            (low <= np.maximum(high, np.minimum(a.max(axis=0), c.max(axis=0)))).all()
            and _cross(a, b, c, d)
        ):
            continue
        found[i] = found[j] = True
    return tuple(found)


def _cross(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> bool:
    """Return whether one of the segments a to b `(n, 2)` properly crosses one of the segments c to
    d `(m, 2)`.
    """

    def side(p: FloatArray, q: FloatArray, r: FloatArray) -> FloatArray:
        (px, py), (qx, qy), (rx, ry) = p.T, q.T, r.T
        return np.asarray(
            (qx - px)[:, None] * (ry - py[:, None]) - (qy - py)[:, None] * (rx - px[:, None])
        )

    apart = side(a, b, c) * side(a, b, d) < 0.0
    return bool((apart & (side(c, d, a) * side(c, d, b) < 0.0).T).any())
