"""Reference path: the reference line of a route, with the free width and the speed limit along it.

The centre lines of the route are joined (a lane change is blended over its length) and smoothed by
a QP over points p_i, equally spaced on the raw line r_i:

(1) minimise  w sum |p_{i-1} - 2 p_i + p_{i+1}|^2 + sum |p_i - r_i|^2
        subject to |p_i - r_i| <= MAX_SHIFT_M
(2) p_i = r_i + l_i n_i + t_i m_i,   |l_i| <= ACROSS MAX_SHIFT_M,
        |t_i| <= sqrt(1 - ACROSS^2) MAX_SHIFT_M

(discrete bending energy: the FEM-position-deviation smoother of Apollo's reference lines) with the
normal n_i and the tangent m_i of the raw line: bounds (2) keep the norm in (1), and rotate and
mirror with the world, which bounds on x and y do not. The shift is larger where the line would
otherwise bend more than the car can steer. The lateral extents of the lanes are where their
boundaries cross the normals of the smoothed line.

Candidate lanes: the ego's lane and its neighbours, each with its own reference line (paper, section
II-F).

A lane sequence is a lane with the lanes that continue it without a lane change, chosen so that the
goal stays near. Its value for the route follows from the cost to go of its lanes
(`route.costs_to_go`):

(3) changes(sequence)  = lane changes between it and the goal
(4) change_by(sequence) = station at which its last lane ends from which the first of these changes
        is possible
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import cos, floor, sin, sqrt
from typing import NamedTuple

import numpy as np
from scipy import sparse

from replan.core.arrays import TIE, FloatArray, arc_lengths, frozen
from replan.core.kernel import inner_kernel, kernel
from replan.core.once import once
from replan.logs.frame import PlannerContext
from replan.logs.polylines import nearest, thinned
from replan.logs.reference_line import ReferenceLine
from replan.logs.road import Lane, Road, predecessors
from replan.logs.route import CostToGo, costs_to_go, start_lanes, straight_on
from replan.logs.states import EgoState
from replan.logs.vehicle import VehicleParameters
from replan.planners.solver import QuadraticProgram

SPACING_M = 2.0  # Spacing of the points of (1), m
BENDING_WEIGHT = 50.0  # w of (1)
MAX_SHIFT_M = 0.3
"""Largest shift, m: about the mean over all headings that bounds of 0.25 m on x and y permit across
a line (0.32).
"""
BEND = np.array([1.0, -2.0, 1.0])  # Coefficients of three points in the bending term of (1)
# Share of the shift that a point may make across the line; the rest is along it, as a sharp corner
# needs
ACROSS = 0.97
HARDER = ((0.5, 200.0), (0.75, 1000.0), (1.0, 1000.0), (1.5, 3000.0))
"""Shift (m) and bending weight of further attempts, where the line bends more than a car can
steer.
"""
LOCK_SHARE = 0.9  # Share of the steering lock that a reference line may need
EDGE_M = 0.1  # Distance of the car to the lane's edge that a shift keeps, m
BEYOND_M = 300.0  # Length of the line after the route, m; a plan of 8 s at 130 km/h is shorter
# Half the width of a lane without a width in the map, m; the least half width is half of that
HALF_LANE_M = 1.75
REACH_M = 16.0  # Lane edges farther beside the line than this are ignored, m: about four lanes
JOINT_M = 0.6  # Boundaries nearer than this are one marking, m


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


@dataclass(frozen=True, eq=False)
class ReferencePath:
    """A reference line and the road along it.

    Arrays `(n,)` over `line.s`, offsets l in m, positive left.
    """

    line: ReferenceLine  # The line; it continues straight beyond its ends
    # Left edge of the route's own lane (of both lanes during a lane change); `lane_right` < 0
    # likewise
    lane_left: FloatArray
    lane_right: FloatArray
    # Left edge of the same-direction lanes that can be reached from there; `road_right` likewise
    road_left: FloatArray
    road_right: FloatArray
    limit: FloatArray  # Speed limit, m/s
    lanes: tuple[int, ...] = ()  # The lanes that it leads along, in driving order
    # Left edge of the lane of the opposite direction that adjoins `road_left` where the marking may
    # be crossed, else `road_left`; `facing_right` likewise; None without such a lane
    facing_left: FloatArray | None = None
    facing_right: FloatArray | None = None
    # Stations before which traffic may have to wait: where lanes part or meet, m
    waits: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for name in ("facing_left", "facing_right"):
            if getattr(self, name) is None:
                object.__setattr__(self, name, getattr(self, name.replace("facing", "road")))
        for name in (
            "lane_left",
            "lane_right",
            "road_left",
            "road_right",
            "limit",
            "facing_left",
            "facing_right",
        ):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @cached_property
    def table(self) -> FloatArray:
        """The columns of `CrossSections` `(n, 8)` over `line.s`."""
        columns = [getattr(self, name) for name in CrossSections._fields if name != "kappa"]
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
    own = [(road.lanes[i], left, right) for i, (left, right) in extents.items()]
    to_left = [
        (right, left, lane.right_crossable, lane.left_crossable) for lane, left, right in own
    ]
    to_right = [
        (-left, -right, lane.left_crossable, lane.right_crossable) for lane, left, right in own
    ]
    road_left, road_right = lane_left, -lane_right
    for _ in range(3):
        road_left, road_right = (
            _one_lane_further(road_left, to_left),
            _one_lane_further(road_right, to_right),
        )
    against = [
        (road.lanes[i], *edges) for i, edges in _lane_extents(road, line, opposite=True).items()
    ]
    to_left += [
        (left, right, lane.left_crossable, lane.right_crossable) for lane, left, right in against
    ]
    to_right += [
        (-right, -left, lane.right_crossable, lane.left_crossable) for lane, left, right in against
    ]
    facing_left, facing_right = (
        _one_lane_further(road_left, to_left),
        -_one_lane_further(road_right, to_right),
    )
    drivable = [lane for lane in road.lanes.values() if lane.drivable]
    into = Counter(successor for lane in drivable for successor in lane.successors)
    waits, s = list[float](), 0.0
    for now, then in pairwise(lanes):
        onward = road.lanes[now].successors
        if then in onward:
            x, y = road.lanes[now].center[-1]
            s = line.project(x, y, s + road.lanes[now].length, 50.0)[0]
            if len(onward) > 1 or into[then] > 1:  # lanes part or meet here
                waits.append(s)
    edges = lane_left, lane_right, road_left, -road_right
    return ReferencePath(line, *edges, limit, lanes, facing_left, facing_right, tuple(waits))


def make_line(
    road: Road, route: tuple[int, ...], ego: EgoState, car: VehicleParameters | None = None
) -> tuple[tuple[int, ...], ReferenceLine]:
    """The lanes of a route, extended straight on for `BEYOND_M` or to the end of the map, and the
    line along them.

    The line is smoothed more where the car could not follow it and the lanes are wide enough.
    """
    lanes, beyond = list(route), 0.0
    while beyond < BEYOND_M:
        onward = straight_on(road, lanes[-1])
        if onward is None or onward in lanes[len(route) :]:
            break
        lanes.append(onward)
        beyond += road.lanes[onward].length
    groups: list[list[Lane]] = []  # each of lanes side by side
    for previous, now in zip((None, *lanes), lanes, strict=False):
        if previous is not None and now in (
            road.lanes[previous].left_neighbour,
            road.lanes[previous].right_neighbour,
        ):
            groups[-1].append(road.lanes[now])
        else:
            groups.append([road.lanes[now]])
    points = thinned(
        np.vstack(
            [_blend_centers(group, ego if i == 0 else None) for i, group in enumerate(groups)]
        ),
        1.0,
    )
    across = (road.lanes[lane].left - road.lanes[lane].right for lane in lanes)
    width = min(float(np.median(np.hypot(*edge.T))) for edge in across)
    line = ReferenceLine.through(smooth_points(points))
    room = 0.5 * (width - car.width) - EDGE_M if car is not None else 0.0
    for shift, weight in HARDER:
        if car is None or _sharpest(line) <= LOCK_SHARE * car.max_kappa or room <= MAX_SHIFT_M:
            break
        line = min(
            line,
            ReferenceLine.through(smooth_points(points, min(shift, room), weight)),
            key=_sharpest,
        )
    return tuple(lanes), line


def _sharpest(line: ReferenceLine) -> float:
    return float(np.abs(line.kappa).max())


def smooth_points(
    points: FloatArray, max_shift: float = MAX_SHIFT_M, weight: float = BENDING_WEIGHT
) -> FloatArray:
    """The polyline `(n, 2)`, equally spaced and smoothed by (1).

    Unchanged if it is too short or the QP fails.
    """
    chord = arc_lengths(*points.T)
    count = floor(chord[-1] / SPACING_M + 0.5 - TIE) + 1
    if count < 4:
        return points
    stations = np.linspace(0.0, chord[-1], count)
    raw = np.column_stack([np.interp(stations, chord, points[:, k]) for k in (0, 1)])
    tangent = np.gradient(raw, axis=0)
    tangent /= np.maximum(np.hypot(*tangent.T)[:, None], 1e-9)
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    three = np.arange(count - 2)[:, None] + np.arange(3)
    places = np.hstack([three, three + count]).ravel(), np.arange(0, 6 * count - 11, 6)
    bends = [
        sparse.csr_matrix(
            (np.hstack([BEND * axis[three, k] for axis in (normal, tangent)]).ravel(), *places)
        )
        for k in (0, 1)
    ]
    # (1)
    P = (weight * (bends[0].T @ bends[0] + bends[1].T @ bends[1]) + sparse.eye(2 * count)).tocsc()
    solver = QuadraticProgram("reference line", P, sparse.eye(2 * count, format="csc"))
    shift = np.full(count, max_shift)
    shift[[0, -1]] = 0.0
    bent = raw[:-2] - 2.0 * raw[1:-1] + raw[2:]
    gradient = weight * (bends[0].T @ bent[:, 0] + bends[1].T @ bent[:, 1])
    most = np.r_[ACROSS * shift, sqrt(1.0 - ACROSS**2) * shift]  # (2)
    move = solver.solve(gradient, -most, most, fresh=True)
    if not move.report.solved:
        return raw
    across, along = move.x.reshape(2, count, 1)
    return raw + across * normal + along * tangent


def _blend_centers(group: list[Lane], ego: EgoState | None) -> FloatArray:
    """The centre line of lanes side by side: from the first to the last lane, over the rest of
    their length.
    """
    if len(group) == 1:
        return group[0].center
    u = np.linspace(0.0, 1.0, max(2, floor(group[0].length + TIE) + 1))
    resampled = []
    for points in (group[0].center, group[-1].center):
        chord = arc_lengths(*points.T)
        resampled.append(
            np.column_stack([np.interp(u * chord[-1], chord, points[:, k]) for k in (0, 1)])
        )
    first, last = resampled
    begin = 0.0
    if ego is not None:
        begin = float(u[nearest(first, ego.x, ego.y)])
    share = (3.0 * max(ego.v if ego else 0.0, 5.0) * (len(group) - 1) + 10.0) / group[0].length
    end = min(1.0, begin + max(share, 1e-3))
    w = np.clip((u - begin) / max(end - begin, 1e-9), 0.0, 1.0)
    w = w * w * w * (10.0 - 15.0 * w + 6.0 * w * w)
    return (1.0 - w)[:, None] * first + w[:, None] * last


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


def _one_lane_further(
    edge: FloatArray, beside: list[tuple[FloatArray, FloatArray, bool, bool]]
) -> FloatArray:
    """The edge `(n,)` moved out over the adjoining lanes, where both lanes permit crossing their
    common marking.

    `beside` has the inner and outer edge `(n,)` of each lane, and whether each may be crossed.
    """
    closed = np.zeros(len(edge), np.bool_)
    for _, outer, _, crossable in beside:
        closed |= (np.abs(outer - edge) < JOINT_M) & (not crossable)
    moved = edge
    for inner, outer, crossable, _ in beside:
        adjoins = (np.abs(inner - edge) < JOINT_M) & ~closed & crossable
        moved = np.where(adjoins, np.fmax(moved, outer), moved)
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


# Length of a sequence behind the lane that it was made for, m, so that it contains agents that
# follow
BEHIND_M = 60.0


@dataclass(frozen=True, eq=False, slots=True)
class LaneSequence:
    """A candidate lane."""

    lanes: tuple[int, ...]  # Its lanes in driving order, including a stretch behind
    reference: ReferencePath
    # (3); 0 if it leads to the goal or there is no goal, None if the goal cannot be reached from it
    changes: int | None
    change_by: float  # (4), m; inf where no change is needed


class LaneSequences:
    """The lane sequences of one scenario, each made when it is first needed."""

    def __init__(self, context: PlannerContext) -> None:
        self._road = context.road
        self._to_go = costs_to_go(context.road, context.goal)
        self._before = predecessors(
            {i: lane for i, lane in context.road.lanes.items() if lane.drivable}
        )
        self._sequences: dict[int, LaneSequence] = {}
        self._start, self._car = context.start, context.vehicle

    def start(self, ego: EgoState) -> LaneSequence:
        """The first sequence: that of the lane nearest to the goal among the lanes under the
        ego.
        """
        under = start_lanes(self._road, ego)[: None if self._to_go else 1]
        best = min(under, key=lambda lane: (*_rank(self._to_go.get(lane)), under.index(lane)))
        return self.of(best)

    def of(self, lane: int) -> LaneSequence:
        """The sequence that a lane belongs to."""
        if lane not in self._sequences:
            sequence = self._make_sequence(lane)
            for ahead in sequence.lanes[sequence.lanes.index(lane) :]:
                self._sequences.setdefault(ahead, sequence)
        return self._sequences[lane]

    def beside(
        self, sequence: LaneSequence, station: float
    ) -> tuple[tuple[str, LaneSequence], ...]:
        """The neighbours ("left" or "right") of a sequence at a station whose marking may be
        crossed.
        """
        ends = np.cumsum([self._road.lanes[lane].length for lane in sequence.lanes])
        position = min(int(np.searchsorted(ends, station + TIE)), len(sequence.lanes) - 1)
        lane = self._road.lanes[sequence.lanes[position]]
        sides = (
            ("left", lane.left_neighbour, lane.left_crossable),
            ("right", lane.right_neighbour, lane.right_crossable),
        )
        ordered = sides if self._road.drives_on_right else sides[::-1]
        return tuple(
            (side, self.of(other))
            for side, other, crossable in ordered
            if other is not None
            and crossable
            and other in self._road.lanes
            and self._road.lanes[other].drivable
        )

    def _make_sequence(self, lane: int) -> LaneSequence:
        """The sequence of a lane: on towards the goal, straight on if no successor leads there, and
        back behind it.
        """
        onward, length = [lane], 0.0
        while length < BEYOND_M:
            leading = [i for i in self._road.lanes[onward[-1]].successors if i in self._to_go]
            nearest = min(leading, key=lambda i: (*_rank(self._to_go[i]), i), default=None)
            after = nearest if nearest is not None else straight_on(self._road, onward[-1])
            if after is None or after in onward:
                break
            onward.append(after)
            length += self._road.lanes[after].length
        behind: list[int] = []
        length = 0.0
        while length < BEHIND_M:
            first = (behind or onward)[0]
            before = min(
                (i for i in self._before.get(first, ()) if straight_on(self._road, i) == first),
                default=None,
            )
            if before is None or before in behind or before in onward:
                break
            behind.insert(0, before)
            length += self._road.lanes[before].length
        lanes = (*behind, *onward)
        reference = make_reference_path(self._road, lanes, self._start, self._car)
        if not self._to_go:
            return LaneSequence(lanes, reference, 0, np.inf)
        needs = [
            self._to_go[lane_id].changes if lane_id in self._to_go else None for lane_id in lanes
        ]
        known_needs = [
            (need, i) for i, need in enumerate(needs) if need is not None and i >= len(behind)
        ]
        fewest = min((need for need, _ in known_needs), default=None)
        if not fewest:
            return LaneSequence(lanes, reference, fewest, np.inf)
        ends = np.cumsum([self._road.lanes[lane_id].length for lane_id in lanes])
        due = float(ends[max(i for need, i in known_needs if need == fewest)])
        return LaneSequence(lanes, reference, fewest, due)  # (3), (4)


def _rank(to_go: CostToGo | None) -> tuple[float, float]:
    return (np.inf, np.inf) if to_go is None else (float(to_go.changes), to_go.cost)
