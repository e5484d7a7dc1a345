"""Reference path: the reference line of a route (route_line.py), with the free width and the speed
limit along it.

The lateral extents of the lanes are where their boundaries cross the normals of the smoothed line.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import cos, sin
from typing import NamedTuple

import numpy as np

from replan.core.arrays import TIE, FloatArray, frozen
from replan.core.kernel import inner_kernel, kernel
from replan.core.once import once
from replan.logs.reference_line import ReferenceLine
from replan.logs.road import Road
from replan.logs.states import EgoState
from replan.logs.vehicle import VehicleParameters
from replan.planners.frenet.route_line import make_line

# Half the width of a lane without a width in the map, m; the least half width is half of that
HALF_LANE_M = 1.75
REACH_M = 16.0  # Lane edges farther beside the line than this are ignored, m: about four lanes
JOINT_M = 0.6  # Boundaries nearer than this are one marking, m
LANES_BESIDE = 3  # Lanes at each side that may be reached


class CrossSections(NamedTuple):
    """The road across stations `(k,)`: edges as in `ReferencePath`, speed limit (m/s), curvature of
    the line (1/m).
    """

    lane_right: FloatArray
    road_right: FloatArray
    facing_right: FloatArray
    lane_left: FloatArray
    road_left: FloatArray
    facing_left: FloatArray
    limit: FloatArray
    kappa: FloatArray


_EDGES_AND_LIMIT = tuple(name for name in CrossSections._fields if name != "kappa")


@dataclass(frozen=True, eq=False)
class ReferencePath:
    """A reference line and the road along it.

    Arrays `(n,)` over `line.s`, offsets l in m, positive left.

    Attributes:
        line: The line; it continues straight beyond its ends.
        lane_left: Left edge of the route's own lane (of both lanes during a lane change);
            `lane_right` < 0 likewise.
        road_left: Left edge of the same-direction lanes that can be reached from there;
            `road_right` likewise.
        limit: Speed limit, m/s.
        lanes: The lanes that it leads along, in driving order.
        facing_left: Left edge of the lane of the opposite direction that adjoins `road_left` where
            the marking may be crossed, else `road_left`; `facing_right` likewise; None without such
            a lane.
        waits: Stations before which traffic may have to wait: where lanes part or meet, m.
    """

    line: ReferenceLine
    lane_left: FloatArray
    lane_right: FloatArray
    road_left: FloatArray
    road_right: FloatArray
    limit: FloatArray
    lanes: tuple[int, ...] = ()
    facing_left: FloatArray | None = None
    facing_right: FloatArray | None = None
    waits: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.facing_left is None:
            object.__setattr__(self, "facing_left", self.road_left)
        if self.facing_right is None:
            object.__setattr__(self, "facing_right", self.road_right)
        for name in _EDGES_AND_LIMIT:
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @cached_property
    def table(self) -> FloatArray:
        """The columns of `CrossSections` `(n, 8)` over `line.s`."""
        columns = [getattr(self, name) for name in _EDGES_AND_LIMIT]
        return frozen(np.column_stack([*columns, self.line.kappa]))

    def at(self, s: FloatArray) -> CrossSections:
        """The road at stations `(k,)`; beyond the ends as at the ends, without curvature."""
        return sections(self.line.s, self.table, s)


@kernel
def sections(knots: FloatArray, table: FloatArray, s: FloatArray) -> CrossSections:
    """`ReferencePath.at` for other kernels: its `line.s`, its `table`, stations `(k,)`."""
    rows = np.empty((table.shape[1], len(s)))
    write_sections(knots, table, s, rows)
    lane_left, lane_right, road_left, road_right, limit, facing_left, facing_right, kappa = rows
    return CrossSections(
        lane_left, lane_right, road_left, road_right, limit, facing_left, facing_right, kappa
    )


@inner_kernel
def write_sections(knots: FloatArray, table: FloatArray, s: FloatArray, out: FloatArray) -> None:
    """Write the rows `(8, k)` of a `CrossSections` at stations `(k,)`."""
    columns, last = table.shape[1], len(knots) - 1
    h = knots[1] - knots[0]
    for j in range(len(s)):
        u = min(max((s[j] - knots[0]) / h, 0.0), float(last))
        i = min(int(u), last - 1)
        u -= i
        for k in range(columns):
            out[k, j] = table[i, k] + u * (table[i + 1, k] - table[i, k])
        if not knots[0] <= s[j] <= knots[last]:
            out[columns - 1, j] = 0.0


class LaneEdge(NamedTuple):
    """The edge of a lane: its offsets `(n,)`, m, and whether it may be crossed."""

    l: FloatArray
    crossable: bool


Across = tuple[LaneEdge, LaneEdge]
"""The edges of a lane, in the order in which one meets them from right to left."""


@once  # planners and reference drives of one log follow the same route
def make_reference_path(
    road: Road, route: tuple[int, ...], ego: EgoState, car: VehicleParameters | None = None
) -> ReferencePath:
    """The reference path of a route for an ego at its start.

    A `car` can follow it if the lanes are wide enough.
    """
    lanes, line = make_line(road, route, ego, car)
    extents = _lane_extents(road, line)
    lane_left, lane_right, limit = _own_lane(road, line, lanes, extents)
    own, against = list[Across](), list[Across]()
    for number, (left, right) in extents.items():
        lane = road.lanes[number]
        own.append((LaneEdge(right, lane.right_crossable), LaneEdge(left, lane.left_crossable)))
    for number, (left, right) in _lane_extents(road, line, opposite=True).items():
        lane = road.lanes[number]
        against.append((LaneEdge(left, lane.left_crossable), LaneEdge(right, lane.right_crossable)))
    road_left, road_right = lane_left, -lane_right
    for _ in range(LANES_BESIDE):
        road_left = _one_lane_further(road_left, own)
        road_right = _one_lane_further(road_right, _mirrored(own))
    facing_left = _one_lane_further(road_left, own + against)
    facing_right = -_one_lane_further(road_right, _mirrored(own + against))
    edges = lane_left, lane_right, road_left, -road_right
    waits = tuple(_waits(road, line, lanes))
    return ReferencePath(line, *edges, limit, lanes, facing_left, facing_right, waits)


def _waits(road: Road, line: ReferenceLine, lanes: tuple[int, ...]) -> Iterator[float]:
    """The stations at which a lane of the route ends where lanes part or meet, m."""
    drivable = [lane for lane in road.lanes.values() if lane.drivable]
    into, s = Counter(successor for lane in drivable for successor in lane.successors), 0.0
    for now, then in pairwise(lanes):
        lane = road.lanes[now]
        if then in lane.successors:
            x, y = lane.center[-1]
            s = line.project(x, y, s + lane.length, 50.0)[0]
            if len(lane.successors) > 1 or into[then] > 1:
                yield s


@kernel
def _crossings(xy: FloatArray, yaw: FloatArray, boundary: FloatArray, reach: float) -> FloatArray:
    """Offsets l `(n,)` at which the normals at points cross a polyline, each the nearest.

    Nan beyond `reach`.
    """
    offsets = np.full(len(yaw), np.nan)
    low_x, high_x = boundary[:, 0].min() - reach - 1.0, boundary[:, 0].max() + reach + 1.0
    low_y, high_y = boundary[:, 1].min() - reach - 1.0, boundary[:, 1].max() + reach + 1.0
    for k in range(len(yaw)):
        x, y = xy[k, 0], xy[k, 1]
        if not (low_x <= x <= high_x and low_y <= y <= high_y):
            continue
        c, s = cos(yaw[k]), sin(yaw[k])
        best = np.nan
        along = (boundary[0, 0] - x) * c + (boundary[0, 1] - y) * s
        left = (boundary[0, 1] - y) * c - (boundary[0, 0] - x) * s
        for i in range(1, len(boundary)):
            along_next = (boundary[i, 0] - x) * c + (boundary[i, 1] - y) * s
            left_next = (boundary[i, 1] - y) * c - (boundary[i, 0] - x) * s
            # Its end, too
            crosses = min(along, along_next) <= TIE and max(along, along_next) >= -TIE
            if crosses and abs(along - along_next) > TIE:
                offset = left + (left_next - left) * along / (along - along_next)
                if abs(offset) <= reach and not abs(offset) >= abs(best):
                    best = offset
            along, left = along_next, left_next
        offsets[k] = best
    return offsets


def _lane_extents(
    road: Road, line: ReferenceLine, *, opposite: bool = False
) -> dict[int, tuple[FloatArray, FloatArray]]:
    """Per drivable lane near the line: offsets `(n,)` of its left and right boundary, NaN where it
    is not beside.

    Lanes of the line's direction or of the `opposite` one, whose left boundary lies to the right.
    """
    low, high = line.xy.min(axis=0) - REACH_M, line.xy.max(axis=0) + REACH_M
    extents = {}
    for lane in road.lanes_near(low, high):
        if not lane.drivable:
            continue
        left, right = (
            _crossings(line.xy, line.yaw, side, REACH_M) for side in (lane.left, lane.right)
        )
        asked = left < right if opposite else left > right
        if asked.any():
            extents[lane.id] = np.where(asked, left, np.nan), np.where(asked, right, np.nan)
    return extents


def _own_lane(
    road: Road,
    line: ReferenceLine,
    lanes: tuple[int, ...],
    extents: dict[int, tuple[FloatArray, FloatArray]],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Left and right edge and speed limit `(n,)` of the route's lanes that contain the line."""
    count = len(line.s)
    left, right, limit = np.full(count, np.nan), np.full(count, np.nan), np.full(count, np.nan)
    for lane in dict.fromkeys(lanes):
        if lane not in extents:
            continue
        lane_left, lane_right = extents[lane]
        under = (lane_left > -JOINT_M) & (lane_right < JOINT_M)
        left = np.where(under, np.fmax(left, lane_left), left)
        right = np.where(under, np.fmin(right, lane_right), right)
        limit = np.where(under, np.fmin(limit, road.limit(lane)), limit)
    floor = 0.5 * HALF_LANE_M
    return (
        np.maximum(_fill_nan(left, HALF_LANE_M), floor),
        np.minimum(_fill_nan(right, -HALF_LANE_M), -floor),
        _fill_nan(limit, road.default_speed_limit),
    )


def _mirrored(lanes: list[Across]) -> list[Across]:
    """The lanes as they are from left to right, with offsets positive to the right."""
    return [
        (LaneEdge(-last.l, last.crossable), LaneEdge(-first.l, first.crossable))
        for first, last in lanes
    ]


def _one_lane_further(edge: FloatArray, lanes: list[Across]) -> FloatArray:
    """The edge `(n,)` moved out over the adjoining lanes, where both lanes permit crossing their
    common marking.
    """
    closed = np.zeros(len(edge), np.bool_)
    for _, outer in lanes:
        closed |= (np.abs(outer.l - edge) < JOINT_M) & (not outer.crossable)
    moved = edge
    for inner, outer in lanes:
        adjoins = (np.abs(inner.l - edge) < JOINT_M) & ~closed & inner.crossable
        moved = np.where(adjoins, np.fmax(moved, outer.l), moved)
    return moved


def _fill_nan(values: FloatArray, default: float) -> FloatArray:
    """Replace NaN by linear interpolation, beyond the ends by the nearest value.

    All NaN: by the default.
    """
    is_known = np.isfinite(values)
    if not is_known.any():
        return np.full(len(values), default)
    index = np.arange(len(values))
    return np.interp(index, index[is_known], values[is_known])
