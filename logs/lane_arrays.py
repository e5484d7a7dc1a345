"""The lanes of a road as flat arrays: the one form in which kernels and metrics search lanes.

A lane is an index. Its centre line, borders, bounding box, speed limit, successors and neighbours
are rows of arrays; polylines have bounding boxes of stretches, so that a query looks only at the
edges of near stretches.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence, Sized
from dataclasses import replace
from itertools import chain, pairwise
from math import ceil, sqrt
from typing import NamedTuple

import numpy as np

from replan.core.arrays import FloatArray, IntArray, arc_lengths, frozen
from replan.core.kernel import inner_kernel, kernel
from replan.core.once import once
from replan.logs.polylines import bounds
from replan.logs.road import Lane, Road
from replan.logs.shapes import point_segment

SURE_M = 1e-6
"""Tolerance of the test that skips boxes, m: rounding must not change results."""
FEWEST_EDGES = 16
"""Least number of edges per box, except the last box of a polyline."""
X_LO, Y_LO, X_HI, Y_HI = range(4)
"""Columns of boxes."""


class EdgeBoxes(NamedTuple):
    """Bounding boxes of stretches of polylines.

    Attributes:
        first: `(n + 1,)`: polyline i owns the boxes `first[i] : first[i + 1]`.
        box: `(g, 4)`: least x, y, greatest x, y of the edges in it.
        edges: `(g, 2)`: the first edge of its polyline in it, and the edge after the last.
    """

    first: IntArray
    box: FloatArray
    edges: IntArray


class LaneArrays(NamedTuple):
    """`n` lanes with `m` points on their centre lines, world, m.

    Attributes:
        first: `(n + 1,)`: lane i owns the rows `first[i] : first[i + 1]` of `center` and `station`,
            and the rows `2 * first[i] : 2 * first[i + 1]` of `outline`.
        center: Centre lines `(m, 2)`; edge k leads from point k on.
        station: Arc length of the centre line from the lane's start `(m,)`.
        outline: `(2m, 2)`: the left border forwards, then the right border backwards; edge k leads
            from point k - 1 to point k.
        box: `(n, 4)`: least x, y, greatest x, y of the outline.
        limit: `(n,)` the lane's own speed limit, m/s; NaN where it has none.
        next_first: `(n + 1,)`: lane i continues in the lanes
            `following[next_first[i] : next_first[i + 1]]`.
        following: Indices of lanes.
        beside: `(n, 2)` index of the lane to the left and to the right in the same direction, -1:
            none.
        center_boxes: Boxes of the centre lines.
        outline_boxes: Boxes of the outlines.
    """

    first: IntArray
    center: FloatArray
    station: FloatArray
    outline: FloatArray
    box: FloatArray
    limit: FloatArray
    next_first: IntArray
    following: IntArray
    beside: IntArray
    center_boxes: EdgeBoxes
    outline_boxes: EdgeBoxes

    def borders(self, lane: int) -> tuple[FloatArray, FloatArray]:
        """Return the left and the right border `(k, 2)` of a lane, both forwards."""
        first, end = self.first[lane], self.first[lane + 1]
        left, backwards = np.split(self.outline[2 * first : 2 * end], 2)
        return left, backwards[::-1]

    def successors(self) -> tuple[tuple[int, ...], ...]:
        """Return the indices of the lanes that continue each lane."""
        bounds = pairwise(self.next_first.tolist())
        return tuple(tuple(self.following[begin:end].tolist()) for begin, end in bounds)


@once
def lane_arrays(road: Road, *, beyond: float = 0.0, shortest: float = 0.0) -> LaneArrays:
    """Return the lanes that a car may drive on, in the road's order.

    Args:
        road: The road; made once for each.
        beyond: Lanes are this much longer, straight, where the map begins or ends, m.
        shortest: Shorter lanes are left out, m.
    """
    lanes = [lane for lane in road.lanes.values() if lane.drivable and lane.length >= shortest]
    if beyond > 0.0:
        entered = {after for lane in road.lanes.values() for after in lane.successors}
        lanes = [
            _extended(
                lane,
                before=0.0 if lane.id in entered else beyond,
                after=beyond if road.lanes.keys().isdisjoint(lane.successors) else 0.0,
            )
            for lane in lanes
        ]
    index: dict[int | None, int] = {lane.id: i for i, lane in enumerate(lanes)}
    following = [[index[after] for after in lane.successors if after in index] for lane in lanes]
    beside = [
        (index.get(lane.left_neighbour, -1), index.get(lane.right_neighbour, -1)) for lane in lanes
    ]
    centers = [lane.center for lane in lanes]
    outlines = [lane.polygon for lane in lanes]
    return LaneArrays(
        first=_offsets(centers),
        center=_stacked(centers),
        station=frozen(np.concatenate([[], *(arc_lengths(*center.T) for center in centers)])),
        outline=_stacked(outlines),
        box=frozen(np.array([lane.box for lane in lanes]).reshape(-1, 4)),
        limit=frozen([lane.speed_limit for lane in lanes]),
        next_first=_offsets(following),
        following=frozen(list(chain.from_iterable(following)), np.int64),
        beside=frozen(np.array(beside).reshape(-1, 2), np.int64),
        center_boxes=_edge_boxes(centers),
        outline_boxes=_edge_boxes([np.vstack([ring[-1], ring]) for ring in outlines]),
    )


def _extended(lane: Lane, *, before: float, after: float) -> Lane:
    """Return a lane that begins `before` m earlier and ends `after` m later, straight."""
    left, right = lane.left, lane.right
    if before > 0.0:
        step = _straight_step(lane.center[1], lane.center[0], before)
        left, right = np.vstack([left[0] + step, left]), np.vstack([right[0] + step, right])
    if after > 0.0:
        step = _straight_step(lane.center[-2], lane.center[-1], after)
        left, right = np.vstack([left, left[-1] + step]), np.vstack([right, right[-1] + step])
    return replace(lane, left=left, right=right)


def _straight_step(point: FloatArray, end: FloatArray, length: float) -> FloatArray:
    """Return the vector `(2,)` of `length` m in the direction from a point to a line's end; 0 if
    they are one point.
    """
    step = end - point
    distance = float(np.hypot(*step))
    return np.asarray(step * (length / distance if distance > 0.0 else 0.0))


def _edge_boxes(lines: Sequence[FloatArray]) -> EdgeBoxes:
    """Return boxes of the edges of polylines `(k + 1, 2)`: sqrt(k) edges per box, at least
    `FEWEST_EDGES`.
    """
    boxes, stretches = [], []
    for line in lines:
        count = len(line) - 1
        length = max(FEWEST_EDGES, ceil(sqrt(count)))
        edges = [(k, min(k + length, count)) for k in range(0, count, length)]
        boxes += [bounds(line[begin : end + 1]) for begin, end in edges]
        stretches.append(edges)
    rows = np.array([*chain.from_iterable(stretches)])
    return EdgeBoxes(
        _offsets(stretches),
        frozen(np.array(boxes).reshape(-1, 4)),
        frozen(rows.reshape(-1, 2), np.int64),
    )


def _offsets(rows: Iterable[Sized]) -> IntArray:
    """Return where each row begins if they stand one after the other, and where the last ends."""
    return frozen(np.cumsum([0, *map(len, rows)]), np.int64)


def _stacked(lines: Iterable[FloatArray]) -> FloatArray:
    return frozen(np.vstack([np.empty((0, 2)), *lines]))


@kernel
def box_gap(boxes: FloatArray, row: int, x: float, y: float) -> float:
    """Return the distance of a point from one of boxes `(n, 4)`, m; 0 inside it."""
    dx = max(boxes[row, X_LO] - x, 0.0, x - boxes[row, X_HI])
    dy = max(boxes[row, Y_LO] - y, 0.0, y - boxes[row, Y_HI])
    return sqrt(dx * dx + dy * dy)


@kernel
def lane_contains(lanes: LaneArrays, lane: int, x: float, y: float) -> bool:
    """Return whether a point lies in a lane: `replan.logs.polylines.inside` with only the edges
    that a ray from it could cross.
    """
    outline = lanes.outline[2 * lanes.first[lane] : 2 * lanes.first[lane + 1]]
    boxes = lanes.outline_boxes
    contains = False
    for g in range(boxes.first[lane], boxes.first[lane + 1]):
        if y < boxes.box[g, Y_LO] or y > boxes.box[g, Y_HI] or x > boxes.box[g, X_HI] + SURE_M:
            continue
        for k in range(boxes.edges[g, 0], boxes.edges[g, 1]):
            xi, yi = outline[k, 0], outline[k, 1]
            xj, yj = outline[k - 1, 0], outline[k - 1, 1]
            if (yi > y) != (yj > y) and x < (xj - xi) * (y - yi) / (yj - yi) + xi:
                contains = not contains
    return contains


@inner_kernel
def edge_distance(lanes: LaneArrays, lane: int, x: float, y: float, best: float) -> float:
    """Return the distance of a point from a lane's outline, m, or `best` if that is smaller."""
    outline = lanes.outline[2 * lanes.first[lane] : 2 * lanes.first[lane + 1]]
    boxes = lanes.outline_boxes
    for g in range(boxes.first[lane], boxes.first[lane + 1]):
        if box_gap(boxes.box, g, x, y) > best + SURE_M:
            continue
        for k in range(boxes.edges[g, 0], boxes.edges[g, 1]):
            ax, ay = outline[k - 1, 0], outline[k - 1, 1]
            bx, by = outline[k, 0], outline[k, 1]
            best = min(best, point_segment(x, y, ax, ay, bx, by))
    return best
