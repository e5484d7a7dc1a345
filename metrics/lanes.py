"""The drivable lanes under the points of a drive: distance off the lanes, speed limit, direction.

The end of the map is not the end of the road: a lane without a successor in the map is extended
straight by 10 m (two cars' lengths), and a lane without a predecessor is extended backwards
likewise.
"""

from __future__ import annotations

from math import cos, hypot, inf, nan, pi, sin
from typing import NamedTuple

import numpy as np

from replan.core.arrays import FloatArray, frozen
from replan.core.kernel import inner_kernel, kernel
from replan.core.once import once
from replan.logs.lane_arrays import (
    SURE_M,
    X_HI,
    X_LO,
    Y_HI,
    Y_LO,
    LaneArrays,
    box_gap,
    edge_distance,
    lane_arrays,
    lane_contains,
)
from replan.logs.road import Road, RoadSource
from replan.logs.shapes import point_segment
from replan.metrics.metric import Unavailable

NO_LANES = Unavailable("the log has no lanes")
BEYOND_M = 10.0
CROSSING = cos(30.0 / 180.0 * pi)
"""Lanes cross where the cosine of the angle between their directions, in either sense, is less."""


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
    lanes = lane_arrays(road, beyond=BEYOND_M)
    return lanes if len(lanes.limit) else None


def keeps_lane(road: Road, x: float, y: float, corners: FloatArray) -> bool:
    """Return whether a box with centre (x, y) is in one lane, and not where lanes cross or fork.

    Successors and predecessors continue the lane: a car between one lane and the next along the
    road keeps its lane.
    """
    lanes = [lane for lane in road.lanes_at(x, y) if lane.drivable]
    if len(lanes) != 1:
        return False
    own = lanes[0]
    before = (other.id for other in road.lanes.values() if own.id in other.successors)
    strip = {own.id, *own.successors, *before}
    return all(
        any(lane.id in strip for lane in road.lanes_at(*corner)) for corner in corners.tolist()
    )


class Under(NamedTuple):
    """The lanes under points of a drive, `(k,)` each; NaN without a lane; at crossings `along` and
    `left` are NaN.

    Attributes:
        along: Cosine of the angle between heading and lane; of several lanes, the best aligned one.
            -1: against the lane.
        left: Distance from the nearest centre line of a lane there, m, positive to the left of the
            lane.
        half: Half of that lane's width there, m.
    """

    along: FloatArray
    left: FloatArray
    half: FloatArray


class CenterFoot(NamedTuple):
    """The place of a point beside a lane's centre line.

    Attributes:
        cos: Cosine of the lane's direction at the foot; `sin` the sine. Both are 0 if the lane has
            no direction.
        left: Distance from the centre line, m, positive to the left.
        half: Half of the lane's width at the foot, m.
    """

    cos: float
    sin: float
    left: float
    half: float


@inner_kernel
def _center_foot(lanes: LaneArrays, lane: int, x: float, y: float) -> CenterFoot:
    """Return the place of a point beside the centre line of a lane."""
    first = lanes.first[lane]
    center, boxes = lanes.center[first : lanes.first[lane + 1]], lanes.center_boxes
    nearest = CenterFoot(0.0, 0.0, 0.0, 0.0)
    nearest_m = inf
    bound = inf  # upper bound: the farthest corner of each box
    for g in range(boxes.first[lane], boxes.first[lane + 1]):
        x_reach = max(x - boxes.box[g, X_LO], boxes.box[g, X_HI] - x)
        y_reach = max(y - boxes.box[g, Y_LO], boxes.box[g, Y_HI] - y)
        bound = min(bound, hypot(x_reach, y_reach))
    for g in range(boxes.first[lane], boxes.first[lane + 1]):
        if box_gap(boxes.box, g, x, y) > min(nearest_m, bound) + SURE_M:
            continue
        for k in range(boxes.edges[g, 0], boxes.edges[g, 1]):
            ax, ay = center[k, 0], center[k, 1]
            bx, by = center[k + 1, 0], center[k + 1, 1]
            length = hypot(bx - ax, by - ay)
            distance = point_segment(x, y, ax, ay, bx, by)
            if length > 0.0 and distance < nearest_m:
                nearest_m = distance
                c, s = (bx - ax) / length, (by - ay) / length
                is_left = c * (y - ay) - s * (x - ax) >= 0.0
                border = 2 * first + k
                border_x, border_y = lanes.outline[border, 0], lanes.outline[border, 1]
                nearest = CenterFoot(
                    c, s, distance if is_left else -distance, hypot(border_x - ax, border_y - ay)
                )
    return nearest


@kernel
def under(lanes: LaneArrays, x: FloatArray, y: FloatArray, yaw: FloatArray) -> Under:
    """The lanes under points `(k,)` with a heading."""
    along, left, half = np.full(len(x), nan), np.full(len(x), nan), np.full(len(x), nan)
    for k in range(len(x)):
        first = CenterFoot(0.0, 0.0, 0.0, 0.0)
        crossing = False
        for lane in range(len(lanes.box)):
            if box_gap(lanes.box, lane, x[k], y[k]) > 0.0:
                continue
            if not lane_contains(lanes, lane, x[k], y[k]):
                continue
            foot = _center_foot(lanes, lane, x[k], y[k])
            aligned = foot.cos * cos(yaw[k]) + foot.sin * sin(yaw[k])
            if not np.isfinite(along[k]):
                first = foot
                along[k], left[k], half[k] = aligned, foot.left, foot.half
                continue
            crossing = crossing or abs(first.cos * foot.cos + first.sin * foot.sin) < CROSSING
            along[k] = max(along[k], aligned)
            if abs(foot.left) < abs(left[k]):
                left[k], half[k] = foot.left, foot.half
        if crossing:
            along[k], left[k] = nan, nan
    return Under(along, left, half)


@kernel
def off_lanes(lanes: LaneArrays, x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the exact distance `(k,)` of points `(k,)` to the nearest drivable lane, m; 0 on a
    lane.

    Lanes whose bounding box is not nearer than the best distance are skipped; the previous nearest
    lane is tried first.
    """
    count, distances, nearest = len(lanes.box), np.empty(len(x)), 0
    for k in range(len(x)):
        best, start = inf, nearest
        for turn in range(count):
            lane = (start + turn) % count
            if box_gap(lanes.box, lane, x[k], y[k]) >= best:
                continue
            if lane_contains(lanes, lane, x[k], y[k]):
                best, nearest = 0.0, lane
                break
            distance = edge_distance(lanes, lane, x[k], y[k], best)
            if distance < best:
                best, nearest = distance, lane
        distances[k] = best
    return distances


@kernel
def limits_at(lanes: LaneArrays, x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the log's speed limit `(k,)` at points, m/s: the largest of overlapping lanes; NaN if
    no lane has one.
    """
    limits = np.full(len(x), nan)
    for k in range(len(x)):
        for lane in range(len(lanes.box)):
            limit = lanes.limit[lane]
            if box_gap(lanes.box, lane, x[k], y[k]) > 0.0 or limit <= limits[k]:
                continue
            if np.isfinite(limit) and lane_contains(lanes, lane, x[k], y[k]):
                limits[k] = limit
    return limits


@kernel
def lane_distances(lanes: LaneArrays, x: FloatArray, y: FloatArray, reach: float) -> FloatArray:
    """Return the distance of points `(k,)` to each lane `(n, k)`, m: 0 inside, inf beyond
    `reach`.
    """
    distances = np.full((len(lanes.box), len(x)), inf)
    for lane in range(len(lanes.box)):
        x_lo, y_lo, x_hi, y_hi = lanes.box[lane]
        for k in range(len(x)):
            gap = hypot(max(x_lo - x[k], 0.0, x[k] - x_hi), max(y_lo - y[k], 0.0, y[k] - y_hi))
            if gap > reach:
                continue
            if gap == 0.0 and lane_contains(lanes, lane, x[k], y[k]):
                distances[lane, k] = 0.0
            else:
                distance = edge_distance(lanes, lane, x[k], y[k], reach)
                distances[lane, k] = distance if distance < reach else inf
    return distances
