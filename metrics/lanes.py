"""A road's lanes as flat arrays, and what the metrics ask of them: how far off, which speed limit, which direction.

The end of the map is not the end of the road: a lane that leads on to no lane of the map goes on straight for 10 m
(two cars' lengths), and so does, backwards, one that no lane leads to.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, hypot, inf, nan, pi, sin

import numpy as np

from logs.kernel import FloatArray, IntArray, frozen, kernel
from logs.road import Lane, Road, inside
from logs.shapes import point_segment

BEYOND_M = 10.0
CROSSING = cos(30.0 / 180.0 * pi)
"""Lanes that lie over each other cross where their directions differ by more than 30 degrees, either way round."""


@dataclass(frozen=True, eq=False, slots=True)
class LaneArrays:
    """The drivable lanes of a road.

    Attributes:
        points: Outlines of all lanes one after the other `(m, 2)`, m.
        offsets: `(n + 1,)`: lane i owns the points `offsets[i] : offsets[i + 1]`.
        box: `(n, 4)`: least x, y, greatest x, y.
        limit: `(n,)` the log's speed limit, m/s; NaN where it has none.
    """

    points: FloatArray
    offsets: IntArray
    box: FloatArray
    limit: FloatArray


def drivable_lanes(road: Road) -> LaneArrays | None:
    """The lanes that a car may drive on; None where there is none."""
    lanes = [lane for lane in road.lanes.values() if lane.drivable]
    if not lanes:
        return None
    entered = {after for lane in road.lanes.values() for after in lane.successors}
    outlines = [
        _outline(lane, leads_on=not road.lanes.keys().isdisjoint(lane.successors), entered=lane.id in entered)
        for lane in lanes
    ]
    limits = [lane.speed_limit for lane in lanes]
    box = [(*outline.min(axis=0), *outline.max(axis=0)) for outline in outlines]
    offsets = np.r_[0, np.cumsum([len(outline) for outline in outlines])]
    return LaneArrays(frozen(np.vstack(outlines)), frozen(offsets, np.int64), frozen(box), frozen(limits))


def _outline(lane: Lane, *, leads_on: bool, entered: bool) -> FloatArray:
    """The lane's polygon, lengthened where the map ends."""
    forth = np.zeros((1, 2)) if leads_on else _ahead(lane.center[-1] - lane.center[-2])
    back = np.zeros((1, 2)) if entered else _ahead(lane.center[0] - lane.center[1])
    sides = [np.vstack([side[:1] + back, side, side[-1:] + forth]) for side in (lane.left, lane.right)]
    return np.vstack([sides[0], sides[1][::-1]])


def _ahead(direction: FloatArray) -> FloatArray:
    length = float(np.hypot(*direction))
    return (BEYOND_M / length if length > 0.0 else 0.0) * direction[None]


def keeps_lane(road: Road, x: float, y: float, corners: FloatArray) -> bool:
    """Whether a box with centre (x, y) is in one lane, and not where lanes cross or fork.

    The lane's successors and predecessors count as its continuation: a car over a seam along the road keeps its lane.
    """
    under = [lane for lane in road.lanes_at(x, y) if lane.drivable]
    if len(under) != 1:
        return False
    strip = _continued(road, under[0])
    return all(any(lane.id in strip for lane in road.lanes_at(*corner)) for corner in corners.tolist())


def _continued(road: Road, lane: Lane) -> frozenset[int]:
    before = (other.id for other in road.lanes.values() if lane.id in other.successors)
    return frozenset((lane.id, *lane.successors, *before))


def off_lanes(lanes: LaneArrays, x: FloatArray, y: FloatArray) -> FloatArray:
    """Distance `(k,)` of points `(k,)` to the nearest drivable lane, 0 on one, m. Exact."""
    return _off_lanes(lanes.points, lanes.offsets, lanes.box, x, y)


def limits_at(lanes: LaneArrays, x: FloatArray, y: FloatArray) -> FloatArray:
    """The log's speed limit `(k,)` at points, m/s: the largest where lanes overlap; NaN where no lane has one."""
    return _limits_at(lanes.points, lanes.offsets, lanes.box, lanes.limit, x, y)


@dataclass(frozen=True, eq=False, slots=True)
class Under:
    """What lies under points of a drive, `(k,)` each; NaN where no lane does, and where lanes cross.

    Attributes:
        along: Cosine of the angle between heading and lane; of several lanes the one best aligned. -1: against it.
        left: Distance from the nearest centre line of a lane there, m, positive to the left of the lane.
    """

    along: FloatArray
    left: FloatArray


def under(lanes: LaneArrays, x: FloatArray, y: FloatArray, yaw: FloatArray) -> Under:
    """The lanes under points with a heading."""
    return Under(*_under(lanes.points, lanes.offsets, lanes.box, x, y, yaw))


@kernel
def _on_center(outline: FloatArray, x: float, y: float) -> tuple[float, float, float]:
    """Unit direction of the centre line at its point nearest to (x, y), and the distance left of it, m.

    An outline is the left boundary there and the right one back, so that points i and 2n - 1 - i face each other.
    """
    last, best, cx, cy, left = len(outline) - 1, inf, 0.0, 0.0, 0.0
    for i in range(len(outline) // 2 - 1):
        ax, ay = 0.5 * (outline[i, 0] + outline[last - i, 0]), 0.5 * (outline[i, 1] + outline[last - i, 1])
        bx, by = (
            0.5 * (outline[i + 1, 0] + outline[last - i - 1, 0]),
            0.5 * (outline[i + 1, 1] + outline[last - i - 1, 1]),
        )
        length, found = hypot(bx - ax, by - ay), point_segment(x, y, ax, ay, bx, by)
        if length > 0.0 and found < best:
            best, cx, cy = found, (bx - ax) / length, (by - ay) / length
            left = found if cx * (y - ay) - cy * (x - ax) >= 0.0 else -found
    return cx, cy, left


@kernel
def _under(
    points: FloatArray, offsets: IntArray, box: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray
) -> tuple[FloatArray, FloatArray]:
    along, left = np.full(len(x), nan), np.full(len(x), nan)
    for k in range(len(x)):
        first_x, first_y, crossing = 0.0, 0.0, False
        for i in range(len(box)):
            if not (box[i, 0] <= x[k] <= box[i, 2] and box[i, 1] <= y[k] <= box[i, 3]):
                continue
            outline = points[offsets[i] : offsets[i + 1]]
            if not inside(x[k], y[k], outline):
                continue
            cx, cy, aside = _on_center(outline, x[k], y[k])
            if not np.isfinite(along[k]):
                first_x, first_y, along[k], left[k] = cx, cy, cx * cos(yaw[k]) + cy * sin(yaw[k]), aside
                continue
            crossing = crossing or abs(first_x * cx + first_y * cy) < CROSSING
            along[k] = max(along[k], cx * cos(yaw[k]) + cy * sin(yaw[k]))
            if abs(aside) < abs(left[k]):
                left[k] = aside
        if crossing:
            along[k], left[k] = nan, nan
    return along, left


@kernel
def _edge_distance(polygon: FloatArray, x: float, y: float) -> float:
    best, j = inf, len(polygon) - 1
    for i in range(len(polygon)):
        best = min(best, point_segment(x, y, polygon[j, 0], polygon[j, 1], polygon[i, 0], polygon[i, 1]))
        j = i
    return best


@kernel
def _off_lanes(points: FloatArray, offsets: IntArray, box: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """Lanes whose bounding box is not nearer than the best so far are skipped; the last nearest one is tried first."""
    n, out, recent = len(box), np.empty(len(x)), 0
    for k in range(len(x)):
        best, start = inf, recent
        for turn in range(n):
            i = (start + turn) % n
            gap_x = max(box[i, 0] - x[k], 0.0, x[k] - box[i, 2])
            gap_y = max(box[i, 1] - y[k], 0.0, y[k] - box[i, 3])
            if hypot(gap_x, gap_y) >= best:
                continue
            polygon = points[offsets[i] : offsets[i + 1]]
            found = 0.0 if inside(x[k], y[k], polygon) else _edge_distance(polygon, x[k], y[k])
            if found < best:
                best, recent = found, i
            if best == 0.0:
                break
        out[k] = best
    return out


@kernel
def _limits_at(
    points: FloatArray, offsets: IntArray, box: FloatArray, limit: FloatArray, x: FloatArray, y: FloatArray
) -> FloatArray:
    out = np.full(len(x), nan)
    for k in range(len(x)):
        for i in range(len(box)):
            if not (box[i, 0] <= x[k] <= box[i, 2] and box[i, 1] <= y[k] <= box[i, 3]) or limit[i] <= out[k]:
                continue
            if inside(x[k], y[k], points[offsets[i] : offsets[i + 1]]) and np.isfinite(limit[i]):
                out[k] = limit[i]
    return out
