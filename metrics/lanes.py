"""A road's lanes as flat arrays, for the queries of metrics: distance off the lanes, speed limit, direction.

The end of the map is not the end of the road: a lane without a successor in the map is extended straight by 10 m (two
cars' lengths), and a lane without a predecessor is extended backwards likewise.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, cos, hypot, inf, nan, pi, sin, sqrt
from typing import NamedTuple

import numpy as np

from logs.arrays import BoolArray, FloatArray, IntArray, frozen
from logs.kernel import inner_kernel, kernel
from logs.once import once
from logs.road import Road, RoadSource, inside
from logs.shapes import point_segment

BEYOND_M = 10.0
SURE_M = 1e-6  # Tolerance of the test that skips boxes, m: rounding must not change results
FEW = 16  # Least number of edges per box (except the last of a polyline)
CROSSING = cos(30.0 / 180.0 * pi)  # Lanes cross where their directions differ by more than this, in either sense


class EdgeBoxes(NamedTuple):
    """Bounding boxes of stretches of polylines: a query looks only at the edges in near boxes.

    Attributes:
        first: `(n + 1,)`: polyline i owns the boxes `first[i] : first[i + 1]`.
        box: `(g, 4)`: least x, y, greatest x, y of its edges.
        edges: `(g, 2)`: its first edge, and the edge after its last.
    """

    first: IntArray
    box: FloatArray
    edges: IntArray


class LaneArrays(NamedTuple):
    """The drivable lanes of a road.

    Attributes:
        points: Outlines of all lanes one after the other `(m, 2)`, m; edge k of one leads from its point k - 1 to k.
        offsets: `(n + 1,)`: lane i owns the points `offsets[i] : offsets[i + 1]`.
        center: Their centre lines `(m / 2, 2)`, m; lane i owns the halves of `offsets`; edge k leads from point k on.
        box: `(n, 4)`: least x, y, greatest x, y.
        limit: `(n,)` the log's speed limit, m/s; NaN where it has none.
        outline: Boxes of the outlines; `middle` of the centre lines.
    """

    points: FloatArray
    offsets: IntArray
    center: FloatArray
    box: FloatArray
    limit: FloatArray
    outline: EdgeBoxes
    middle: EdgeBoxes


def points_inside(polygon: FloatArray, x: FloatArray, y: FloatArray) -> BoolArray:
    """Return which points `(n,)` lie in a polygon `(k, 2)`; its bounding box excludes most points early."""
    (x_lo, y_lo), (x_hi, y_hi) = polygon.min(axis=0), polygon.max(axis=0)
    found = (x >= x_lo) & (x <= x_hi) & (y >= y_lo) & (y <= y_hi)
    found[found] = [inside(*point, polygon) for point in zip(x[found].tolist(), y[found].tolist(), strict=True)]
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
    """Return the lanes that a car may drive on, extended where the map ends; None if there are none."""
    return lane_arrays(road, BEYOND_M)


@once
def lane_arrays(road: Road, beyond: float) -> LaneArrays | None:
    """Return the lanes that a car may drive on, `beyond` m longer where the map ends; None if there are none."""
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
        sides = [np.vstack([side[:1] + back, side, side[-1:] + forth]) for side in (lane.left, lane.right)]
        outlines.append(np.vstack([sides[0], sides[1][::-1]]))
    box = [(*outline.min(axis=0), *outline.max(axis=0)) for outline in outlines]
    offsets = np.r_[0, np.cumsum([len(outline) for outline in outlines])]
    centers = [0.5 * (outline[: len(outline) // 2] + outline[: len(outline) // 2 - 1 : -1]) for outline in outlines]
    edges = [np.hstack([np.roll(outline, 1, axis=0), outline]) for outline in outlines]
    pieces = [np.hstack([center[:-1], center[1:]]) for center in centers]
    return LaneArrays(
        frozen(np.vstack(outlines)), frozen(offsets, np.int64), frozen(np.vstack(centers)), frozen(box),
        frozen([lane.speed_limit for lane in lanes]), _boxes(edges), _boxes(pieces),
    )  # fmt: skip


def _boxes(polylines: Sequence[FloatArray]) -> EdgeBoxes:
    """Return boxes of the edges of polylines, each `(n, 4)` (start and end): sqrt(n) edges per box, at least `FEW`."""
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

    Successors and predecessors continue the lane: a car between one lane and the next along the road keeps its lane.
    """
    under = [lane for lane in road.lanes_at(x, y) if lane.drivable]
    if len(under) != 1:
        return False
    before = (other.id for other in road.lanes.values() if under[0].id in other.successors)
    strip = {under[0].id, *under[0].successors, *before}
    return all(any(lane.id in strip for lane in road.lanes_at(*corner)) for corner in corners.tolist())


class Under(NamedTuple):
    """The lanes under points of a drive, `(k,)` each; NaN without a lane; at crossings `along` and `left` are NaN.

    Attributes:
        along: Cosine of the angle between heading and lane; of several lanes, the best aligned one. -1: against the
            lane.
        left: Distance from the nearest centre line of a lane there, m, positive to the left of the lane.
        half: Half of that lane's width there, m.
    """

    along: FloatArray
    left: FloatArray
    half: FloatArray


@kernel
def _gap(box: FloatArray, g: int, x: float, y: float) -> float:
    """Return the distance of a point from box g (least x, y, greatest x, y), 0 inside it."""
    dx, dy = max(box[g, 0] - x, 0.0, x - box[g, 2]), max(box[g, 1] - y, 0.0, y - box[g, 3])
    return sqrt(dx * dx + dy * dy)


@kernel
def on_lane(lanes: LaneArrays, i: int, x: float, y: float) -> bool:
    """Return whether a point lies in lane i: `logs.road.inside` with only the edges that a ray from it could cross."""
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
    """Return lane i's unit direction nearest to (x, y), the distance to its left, and half of its width there, m."""
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
                first_x, first_y, along[k], left[k] = cx, cy, cx * cos(yaw[k]) + cy * sin(yaw[k]), aside
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
            best = min(best, point_segment(x, y, polygon[j, 0], polygon[j, 1], polygon[k, 0], polygon[k, 1]))
    return best


@kernel
def off_lanes(lanes: LaneArrays, x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the exact distance `(k,)` of points `(k,)` to the nearest drivable lane, m; 0 on a lane.

    Lanes whose bounding box is not nearer than the best distance are skipped; the previous nearest lane is tried first.
    """
    n, out, recent = len(lanes.box), np.empty(len(x)), 0
    for k in range(len(x)):
        best, start = inf, recent
        for turn in range(n):
            i = (start + turn) % n
            if _gap(lanes.box, i, x[k], y[k]) >= best:
                continue
            found = 0.0 if on_lane(lanes, i, x[k], y[k]) else edge_distance(lanes, i, x[k], y[k], best)
            if found < best:
                best, recent = found, i
            if best == 0.0:
                break
        out[k] = best
    return out


@kernel
def limits_at(lanes: LaneArrays, x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the log's speed limit `(k,)` at points, m/s: the largest of overlapping lanes; NaN if no lane has one."""
    out = np.full(len(x), nan)
    for k in range(len(x)):
        for i in range(len(lanes.box)):
            if _gap(lanes.box, i, x[k], y[k]) > 0.0 or lanes.limit[i] <= out[k]:
                continue
            if np.isfinite(lanes.limit[i]) and on_lane(lanes, i, x[k], y[k]):
                out[k] = lanes.limit[i]
    return out
