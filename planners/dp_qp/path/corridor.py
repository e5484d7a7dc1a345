"""The corridor of the path QP: the space that the road leaves the ego, as far as steering can keep
it.

The bounds hold for points of the ego's axis from the rear axle to the front bumper, each at its own
station, so that its corners stay in the bounds widened by half its width. They are built in these
steps:

(1) `within_lane`   lower <= l <= upper, the lane (or, beside an obstacle, the reachable road) less
        half the ego's
                    width, and 1 - kappa l >= MIN_REGULAR: short of the centre of a turn
(2) `_for_the_nose` wider where the ego's nose needs it in a sharp turn
(3) `_towards`      within the sides of the goal region, or as near to them as possible
(4) `_widen_bounds`      where the ego is outside the lane: holding a quintic from its state back
                         into it
(5) `loosen_bounds` to the reach of comfortable steering, where a bound asks for more; of hard
                    steering where comfort would leave the road's room by more than `FORCED_M` and
                    that leaves it by less

`bounds` narrows it beside obstacles. A bound beyond the reach of steering (steering_reach.py)
cannot be kept; it is loosened to the reach, so that a path is found; the S-T graph has the agents
that this path meets.

A point of the ego's axis `lead` m before the rear axle has the offset, from the reference line at s
+ lead,

(6) l + lead l' - swing,      swing = (sqrt(1 + (kappa_r lead)^2) - 1) / kappa_r
"""

from __future__ import annotations

from math import isfinite, sqrt
from typing import NamedTuple

import numpy as np

from replan.core.arrays import TIE, BoolArray, FloatArray, frozen
from replan.core.kernel import inner_kernel, kernel
from replan.planners.dp_qp.path.steering_reach import steering_bounds
from replan.planners.frenet.path import MIN_REGULAR, quintic
from replan.planners.frenet.reference_path import CrossSections, sections
from replan.planners.piecewise_jerk.problem import DDDX, DDX, DX, LEADS, X

KNOT, LIMIT, KAPPA = 0, 1, 2
"""Rows of `RoadAhead.along`: station of a knot, m.

Speed limit, m/s; curvature of the reference line, 1/m.
"""
S, SWING, LOWER, UPPER, LEAST, MOST = range(6)
"""Rows of `RoadAhead.points`: stations, m; how far the points swing out (6), m; bounds (1) to (4)
of their offsets, m; the same without (3), m."""
MAX_DL = 1.0  # Bound of l': 45 degrees off the reference line
# Hard steering is considered where comfortable steering would leave the lane by more than this, m
FORCED_M = 0.3
# Half the curvature by which the way of a point ahead differs from that of the rear axle, 1/m
BULGE = 0.03
NEARLY_M = 0.5  # A goal farther outside the corridor than this is not a goal of this lane, m
LEFT_M = 0.1  # Width that the corridor keeps where the goal is outside of it, m
NEAR_GOAL_M = 15.0
"""Where an agent stands within this of the goal, the ego passes it as usual and (3) does not apply,
m.
"""
HERE = np.empty(0)  # Argument `near` of `loosen_bounds`: the path is near the reference line
COMFORT = frozen(np.array([4.0, 3.0, 1.8]))
"""Lateral acceleration that a path may need, braking and acceleration of the expected speed, m/s2
...
"""
# ... and those where comfort would leave the lane by more than `FORCED_M`.
HARD = frozen(np.array([6.0, 5.0, 0.0]))
AHEAD = 1.0 / 3.0
"""The swing (6) is that of the curvature at s + lead / 3: exact to second order where the curvature
rises linearly.
"""


class EgoInLane(NamedTuple):
    """The ego and its start, in the lane."""

    start: FloatArray  # s, l, l', l'' and speed, m, 1, 1/m, m/s `(5,)`
    leads: FloatArray  # Distances of its points ahead of the rear axle `(k,)`, the first 0, m
    car: FloatArray  # The argument `car` of `steering_bounds` `(3,)`
    side: float  # Half its width plus the distance to keep to the lane's edge, m


class Borrowed(NamedTuple):
    """The road beside the lane that the ego may use.

    `spans` `(b, 3)`: station from, to, m, and 1 for the neighbouring lane, 2 for the facing one,
    too; which lanes are free.
    """

    spans: FloatArray
    left: bool
    right: bool


class RoadAhead(NamedTuple):
    """The road at the n knots of the path QP, for k points of the ego."""

    along: FloatArray  # Rows `KNOT`, `LIMIT`, `KAPPA` `(3, n)`
    points: FloatArray  # Rows `S` to `MOST` `(6, k, n)`
    # References of the path QP without obstacles `(2, n)` (`PiecewiseJerkProblem`)
    references: FloatArray
    rows: FloatArray  # Its lower and upper bounds `(2, 3 + k, n)`


@kernel
def road_ahead(
    line_s: FloatArray,
    table: FloatArray,
    ego: EgoInLane,
    step: float,
    n: int,
    middle: float,
    borrowed: Borrowed,
    sides: FloatArray,
    standing: FloatArray,
) -> RoadAhead:
    """(1) to (5) at n knots, `step` m apart, along a reference line's stations and a reference
    path's table.

    `sides` of the goal `(3, m)` are those of `GoalWindow.sides`; (3) is left out where an agent
    that stands (`standing`: stations from, to `(c, 2)`, m) is near the goal.
    """
    along, points = np.empty((3, n)), np.empty((6, len(ego.leads), n))
    for k in range(len(ego.leads)):
        lead, turning = ego.leads[k], np.empty(n)
        for i in range(n):
            along[KNOT, i] = ego.start[0] + step * i
            points[S, k, i], turning[i] = along[KNOT, i] + lead, along[KNOT, i] + AHEAD * lead
        road = sections(line_s, table, points[S, k])
        within_lane(road, points[S, k], borrowed, ego.side, points[LOWER, k], points[UPPER, k])
        turned = road.kappa if k == 0 else sections(line_s, table, turning).kappa
        for i in range(n):
            turn = turned[i] * lead
            # (6): m to the right in a left turn
            points[SWING, k, i] = lead * turn / (1.0 + sqrt(1.0 + turn**2))
            if k == 0:
                along[LIMIT, i], along[KAPPA, i] = road.limit[i], road.kappa[i]
    _for_the_nose(points)
    _towards(points, sides, standing)
    _widen_bounds(points[S], points[LOWER], points[UPPER], ego.start)
    _widen_bounds(points[S], points[LEAST], points[MOST], ego.start)
    references, rows = loosen_bounds(
        along, points, points[LOWER], points[UPPER], np.empty(0), ego, step, middle
    )
    return RoadAhead(along, points, references, rows)


@kernel
def lane_edges(
    line_s: FloatArray, table: FloatArray, s: FloatArray, borrowed: Borrowed, side: float
) -> FloatArray:
    """Lower and upper of (1) `(2, k)` at stations `(k,)`; `side` m are kept to each edge."""
    edges = np.empty((2, len(s)))
    within_lane(sections(line_s, table, s), s, borrowed, side, edges[0], edges[1])
    return edges


@inner_kernel
def within_lane(
    road: CrossSections,
    s: FloatArray,
    borrowed: Borrowed,
    side: float,
    lower: FloatArray,
    upper: FloatArray,
) -> None:
    """Write (1) `(k,)` at stations `(k,)`; `side` m are kept to each edge."""
    spans = borrowed.spans
    for j in range(len(s)):
        used = 0.0
        for b in range(len(spans)):
            if spans[b, 0] < s[j] < spans[b, 1]:
                used = max(used, spans[b, 2])
        low, high = road.lane_right[j], road.lane_left[j]
        if borrowed.right and used > 0.0:
            low = road.road_right[j] if used < 2.0 else road.facing_right[j]
        if borrowed.left and used > 0.0:
            high = road.road_left[j] if used < 2.0 else road.facing_left[j]
        low, high = low + side, high - side  # (1)
        middle, kappa = 0.5 * (low + high), road.kappa[j]
        center = (1.0 - MIN_REGULAR) / max(abs(kappa), 1e-6)
        if kappa < 0.0:
            low = max(low, -center)
        elif kappa > 0.0:
            high = min(high, center)
        if low > high - 0.1:
            low, high = middle - 0.05, middle + 0.05
        lower[j], upper[j] = low, high


@inner_kernel
def _for_the_nose(points: FloatArray) -> None:
    """Apply (2), and store the bounds so far as `LEAST` and `MOST`."""
    for i in range(points.shape[2]):
        least, most = -np.inf, np.inf
        for k in range(points.shape[1]):
            least = max(least, points[LOWER, k, i] + points[SWING, k, i])
            most = min(most, points[UPPER, k, i] + points[SWING, k, i])
        widening = 0.5 * max(least - most + 0.1, 0.0)  # (2)
        for k in range(points.shape[1]):
            points[LOWER, k, i] -= widening
            points[UPPER, k, i] += widening
            points[LEAST, k, i], points[MOST, k, i] = points[LOWER, k, i], points[UPPER, k, i]


@inner_kernel
def _towards(points: FloatArray, sides: FloatArray, standing: FloatArray) -> None:
    """Apply (3) where the sides are within reach and no agent stands near the goal."""
    if sides.shape[1] == 0:
        return
    s, lower, upper = points[S], points[LOWER], points[UPPER]
    within = np.empty((2, s.shape[0], s.shape[1]))
    begin, end = np.inf, -np.inf
    for k in range(s.shape[0]):
        for i in range(s.shape[1]):
            within[0, k, i], within[1, k, i] = (
                _at(s[k, i], sides[0], sides[1]),
                _at(s[k, i], sides[0], sides[2]),
            )
            if not sides[0, 0] <= s[k, i] <= sides[0, -1]:
                within[0, k, i] = np.nan
            elif isfinite(within[0, k, i]):
                begin, end = min(begin, s[k, i]), max(end, s[k, i])
    for b in range(len(standing)):
        if standing[b, 0] < end + NEAR_GOAL_M and standing[b, 1] > begin - NEAR_GOAL_M:
            return
    for k in range(s.shape[0]):
        for i in range(s.shape[1]):
            low, high = within[0, k, i], within[1, k, i]
            least, most = lower[k, i], upper[k, i]
            if isfinite(low) and low <= most + NEARLY_M and high >= least - NEARLY_M:
                lower[k, i] = min(max(low, least), max(most - LEFT_M, least))  # (3)
                upper[k, i] = min(max(high, min(least + LEFT_M, most)), most)


@inner_kernel
def _at(s: float, stations: FloatArray, values: FloatArray) -> float:
    """The value at a station, interpolated linearly; beyond the ends, that of the end."""
    j = int(np.searchsorted(stations, s, "right")) - 1
    if j < 0:
        return float(values[0])
    if j == len(stations) - 1 or s == stations[j]:
        return float(values[j])
    return float(
        (values[j + 1] - values[j]) / (stations[j + 1] - stations[j]) * (s - stations[j])
        + values[j]
    )


@inner_kernel
def _widen_bounds(s: FloatArray, lower: FloatArray, upper: FloatArray, start: FloatArray) -> None:
    """Apply (4) in place to bounds `(points, n)` at stations of that shape, for a start as in
    `EgoInLane`.
    """
    _, l0, dl0, ddl0, speed = start
    ahead = l0 + dl0 * min(5.0, 0.5 * speed)
    if lower[0, 0] <= l0 <= upper[0, 0] and lower[0, 0] <= ahead <= upper[0, 0]:
        return
    span = max(12.0, 2.5 * speed)
    target = min(max(l0, _at(s[0, 0] + span, s[0], lower[0])), _at(s[0, 0] + span, s[0], upper[0]))
    c3, c4, c5 = quintic(l0, dl0, ddl0, target, span)
    for p in range(s.shape[0]):
        for i in range(s.shape[1]):
            d = s[p, i] - s[0, 0]
            if d <= span:
                back = l0 + d * (dl0 + d * (0.5 * ddl0 + d * (c3 + d * (c4 + d * c5))))
                slack = 0.05 + BULGE * (s[p, i] - s[0, i]) ** 2
                # (4)
                lower[p, i], upper[p, i] = (
                    min(lower[p, i], back - slack),
                    max(upper[p, i], back + slack),
                )


@kernel
def loosen_bounds(
    along: FloatArray,
    points: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    near: FloatArray,
    ego: EgoInLane,
    step: float,
    middle: float,
) -> tuple[FloatArray, FloatArray]:
    """References and rows of the path QP (`RoadAhead`) for bounds `(points, n)`, loosened to what
    steering reaches (5).

    The bounds of the curvature hold at the offsets `near` `(n,)`; with `HERE`, at offsets as near
    to the reference line as the bounds permit. The references are `middle` times the sum of the
    bounds (`qp`, (1) and (5)).
    """
    n = lower.shape[1]
    references, rows = np.zeros((2, n)), np.zeros((2, 3 + len(ego.leads), n))
    offsets, least = np.empty(n), np.inf
    for i in range(n):
        offsets[i] = near[i] if len(near) > 0 else min(max(0.0, lower[0, i]), upper[0, i])
    for hard in range(2):
        bend, rate, left, right = steering_bounds(
            ego.start[1:],
            along[LIMIT],
            along[KAPPA],
            offsets,
            step,
            ego.car,
            HARD if hard else COMFORT,
        )
        reach = np.empty((2, len(ego.leads), n))
        forced = -np.inf
        for k in range(len(ego.leads)):
            for i in range(n):
                reach[0, k, i] = left[0, i] + ego.leads[k] * left[1, i] - points[SWING, k, i]
                reach[1, k, i] = right[0, i] + ego.leads[k] * right[1, i] - points[SWING, k, i]
                forced = max(
                    forced,
                    points[LEAST, k, i] - reach[0, k, i],
                    reach[1, k, i] - points[MOST, k, i],
                )
        if hard == 0 or forced < least:
            for k in range(len(ego.leads)):
                row = X if k == 0 else LEADS + k - 1
                for i in range(n):
                    # (5)
                    rows[0, row, i] = min(lower[k, i], reach[0, k, i]) + points[SWING, k, i]
                    rows[1, row, i] = max(upper[k, i], reach[1, k, i]) + points[SWING, k, i]
            for i in range(n):
                rows[0, DX, i], rows[1, DX, i] = min(-MAX_DL, left[1, i]), max(MAX_DL, right[1, i])
                rows[0, DDX, i], rows[1, DDX, i] = bend[0, i], bend[1, i]
                if i < n - 1:
                    rows[0, DDDX, i], rows[1, DDDX, i] = rate[0, i], rate[1, i]
        if forced <= FORCED_M:
            break
        least = forced
    for i in range(n):
        references[0, i] = middle * (rows[0, X, i] + rows[1, X, i])
    return references, rows


@kernel
def room_beside(
    s: FloatArray, lower: FloatArray, upper: FloatArray, boxes: FloatArray, gap: float
) -> FloatArray:
    """Greatest lower and least upper bound `(b, 2)` at the stations beside boxes `(b, 5)`; -inf,
    inf without any.

    Bounds `(points, n)` at stations of that shape; boxes as in `narrowed_beside`.
    """
    room = np.empty((len(boxes), 2))
    for b in range(len(boxes)):
        least, most = -np.inf, np.inf
        for k in range(s.shape[0]):
            for i in range(s.shape[1]):
                if _is_beside(s[k, i], boxes[b], gap):
                    least, most = max(least, lower[k, i]), min(most, upper[k, i])
        room[b, 0], room[b, 1] = least, most
    return room


@kernel
def narrowed_beside(
    s: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    boxes: FloatArray,
    gap: float,
    side: float,
    clearance: float,
    least: float,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Narrow bounds `(2, points, n)` so that they keep clear of boxes, one after the other.

    Boxes `(b, 5)`: station from, to, offset from, to, m; 1 to pass on the left, -1 on the right, 0
    not at all. `gap` is kept ahead of and behind a box, `clearance` beside it, or nearly all of the
    space if that is at least `least`, m; `side` is half the ego's width. Returns the bounds, the
    space beside the ego `(b,)`, m, and which boxes close them.
    """
    narrowed = np.empty((2, s.shape[0], s.shape[1]))
    narrowed[0], narrowed[1] = lower, upper
    room, closed = np.full(len(boxes), np.inf), np.zeros(len(boxes), np.bool_)
    for b in range(len(boxes)):
        box_right, box_left, passing = boxes[b, 2], boxes[b, 3], boxes[b, 4]
        if passing == 0.0:
            continue
        left = passing > 0.0
        low, high = room_beside(s, narrowed[0], narrowed[1], boxes[b : b + 1], gap)[0]
        room[b] = high - box_left - side if left else box_right - side - low
        distance = min(clearance, room[b] - 0.02)
        edge = box_left + side + distance if left else box_right - side - distance
        tried = narrowed.copy()
        closed[b] = room[b] < least
        for k in range(s.shape[0]):
            for i in range(s.shape[1]):
                if _is_beside(s[k, i], boxes[b], gap):
                    if left:
                        tried[0, k, i] = max(tried[0, k, i], edge)
                    else:
                        tried[1, k, i] = min(tried[1, k, i], edge)
                    closed[b] |= tried[0, k, i] > tried[1, k, i]
        if not closed[b]:
            narrowed = tried
    return narrowed, room, closed


@inner_kernel
def _is_beside(s: float, box: FloatArray, gap: float) -> bool:
    return box[0] - gap - TIE <= s <= box[1] + gap + TIE
