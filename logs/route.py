"""Route: the cheapest sequence of lanes from the ego to the goal; why none leads there; when a car
is on a lane.

Dynamic programming over the lane graph (paper, section II-F: "DP for global planning"), in
Dijkstra's order, from the goal backwards:

(1) cost(lane) = 0 if the lane contains the goal, else
        min over steps: price(step) + cost(lane after it)

A step goes to a successor (its price is the length of the lane driven) or to a same-direction
neighbour (`LANE_CHANGE_M`). If costs are equal (within `TIE`), fewer lane changes decide, then the
lower id. The route starts at the lane under the ego with the least cost to go; if costs are equal,
at the best aligned one.

`on_lane` is the rule that metrics and traffic share: a point with a heading is on a lane, and
drives along it, if it lies in the lane's outline and its heading is within `ASKEW_RAD` of the piece
of the centre line whose middle is nearest.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise
from math import atan2, cos, hypot, inf, pi, sin

import numpy as np

from replan.core.arrays import TIE, BoolArray, FloatArray, frozen
from replan.core.kernel import kernel
from replan.logs.polylines import first_nearest, inside, nearest, points_inside, sampled
from replan.logs.road import Goal, Lane, Road
from replan.logs.shapes import point_segment
from replan.logs.states import EgoState, Trajectory, wrap

LANE_CHANGE_M = 50.0
"""Cost of a lane change, in metres of detour."""


def start_lanes(road: Road, ego: EgoState) -> tuple[int, ...]:
    """Return the drivable lanes under the ego, the best aligned first; else one lane that is near
    and aligned.

    An ego at the point where one lane ends and the next begins is on the next.
    """
    x, y = ego.x + TIE * cos(ego.yaw), ego.y + TIE * sin(ego.yaw)
    under = [lane for lane in road.lanes_at(x, y) if lane.drivable]
    if under:
        ranked = sorted(under, key=lambda lane: (_level(abs(_turn(lane, ego))), lane.id))
        aligned = [lane.id for lane in ranked if abs(_turn(lane, ego)) < 1.0]
        return tuple(aligned) or (ranked[0].id,)
    drivable = [lane for lane in road.lanes.values() if lane.drivable] or list(road.lanes.values())

    def away(lane: Lane) -> float:
        distance = float(
            np.hypot(*(lane.center[nearest(lane.center, ego.x, ego.y)] - (ego.x, ego.y)))
        )
        return _level(distance + 5.0 * abs(_turn(lane, ego)))

    return (min(drivable, key=lambda lane: (away(lane), lane.id)).id,)


def find_route(road: Road, ego: EgoState, goal: Goal | None) -> tuple[int, ...]:
    """Return the lanes to the goal (1), in driving order; without a goal, or a way to it, only the
    lane under the ego.

    Between two neighbours, the route changes lanes.
    """
    starts, to_go = start_lanes(road, ego), costs_to_go(road, goal)
    leading = [lane for lane in starts if lane in to_go]
    if not leading:
        return starts[:1]
    lanes = [min(leading, key=lambda lane: _level(to_go[lane].cost))]
    while (after := to_go[lanes[-1]].next) is not None:
        lanes.append(after)
    return tuple(lanes)


@dataclass(frozen=True, slots=True)
class CostToGo:
    """The cost from a lane's start to the goal."""

    cost: float  # cost (1), m
    changes: int  # number of lane changes on the way
    next: int | None  # the next lane of the way; None if the lane contains the goal


def costs_to_go(road: Road, goal: Goal | None) -> dict[int, CostToGo]:
    """Return the cost to go (1) of every lane from which the goal can be reached; {} without a
    goal.
    """
    into: dict[int, list[tuple[int, float]]] = {}
    for lane in road.lanes.values():
        onward = [(i, lane.length) for i in lane.successors]
        sideways = [(i, LANE_CHANGE_M) for i in lane.sideways]
        for step, price in onward + sideways if lane.drivable else ():
            if step in road.lanes and road.lanes[step].drivable:
                into.setdefault(step, []).append((lane.id, price))
    best: dict[int, CostToGo] = {}
    queue: list[tuple[float, int, int, int, float]]
    queue = [(0.0, 0, lane, lane, 0.0) for lane in sorted(goal_lanes(road, goal))]
    while queue:
        _, changes, lane_id, after, cost = heapq.heappop(queue)
        if lane_id in best:
            continue
        best[lane_id] = CostToGo(cost, changes, None if after == lane_id else after)
        for before, price in into.get(lane_id, ()):
            changed = lane_id not in road.lanes[before].successors
            # (1)
            heapq.heappush(
                queue, (_level(cost + price), changes + changed, before, lane_id, cost + price)
            )
    return best


def goal_lanes(road: Road, goal: Goal | None) -> frozenset[int]:
    """Return the lanes whose centre line meets a goal region.

    If no line meets a region, the lanes at its middle.
    """
    lanes: set[int] = set()
    for region in goal.regions if goal is not None else ():
        # Lanes whose centre line, sampled every 1 m, has a point inside the region, not on its edge
        through = [
            lane.id
            for lane in road.lanes_near(region.min(axis=0), region.max(axis=0))
            if lane.drivable and _meets(sampled(lane.center), (region,))
        ]
        middle = road.lanes_at(*region.mean(axis=0))
        lanes.update(through or [lane.id for lane in middle if lane.drivable])
    return frozenset(lanes)


AWAY_M = 5.0
"""A driver who leaves the goal by less than this and comes back has not been away, m."""


class GoalFault(Enum):
    """Why no drive shows whether a planner reaches a goal.

    The value is the sentence that the user reads.
    """

    AT_START = "nothing is to be driven: the ego is at the goal when the drive begins"
    BEHIND = "no route leads to the goal: it lies behind the ego, and no lanes lead back to it"
    NO_LANE = "no route leads to the goal: it is on no lane"
    NO_ROUTE = "no route leads to the goal: no lanes lead from the ego to it"


def goal_fault(road: Road, drive: Trajectory, goal: Goal, ahead: float) -> GoalFault | None:
    """Return why a goal cannot be driven to from the first state of a log's drive; None if it can.

    A drive that comes to the goal again counts from then on; `ahead` is the distance from the rear
    axle to the middle of the ego's box, m.
    """
    ego, regions = drive.state(0), goal.regions
    x, y = ego.ahead(ahead)
    asks = bool(regions) or any(bound is not None for bound in (goal.t, goal.v, goal.yaw))
    returns = goal.way > 0.0 or counting_stay(goal, drive, ahead) is not None
    if asks and not returns and goal.reached(ego.t, x, y, ego.yaw, ego.v):
        return GoalFault.AT_START
    if not regions or returns or goal.holds_place(x, y):
        return None
    beside, onward = list(start_lanes(road, ego)), set[int]()
    # The list grows: lanes that are side by side with the ego's
    for lane in (road.lanes[i] for i in beside):
        reachable = [i for i in lane.sideways if i in road.lanes and i not in beside]
        beside += [i for i in reachable if road.lanes[i].drivable]
        onward |= set(lane.successors)
    lanes = goal_lanes(road, goal)
    if onward & costs_to_go(road, goal).keys():
        return None
    for line in (sampled(road.lanes[i].center) for i in beside if i in lanes):
        ego_point = first_nearest(line, x, y)
        if _meets(line[ego_point:], regions) or any(
            nearest(line, *region.mean(axis=0)) > ego_point for region in regions
        ):
            return None
    corners = np.vstack(regions) - (ego.x, ego.y)
    if lanes & set(beside) or (corners @ (cos(ego.yaw), sin(ego.yaw))).max() < 0.0:
        return GoalFault.BEHIND
    return GoalFault.NO_ROUTE if lanes else GoalFault.NO_LANE


Stay = tuple[int, int, frozenset[int]]
"""First and last sample of a stay at a goal, and the indices of the regions that hold the ego in
it.
"""


def visits(goal: Goal, drive: Trajectory, ahead: float) -> list[Stay]:
    """Return the stays of a drive at a goal: in its place, all its bounds met once. A goal without
    a place has none.

    Two stays in a region are one if the drive is never `AWAY_M` away between them.
    """
    x, y = drive.x + ahead * np.cos(drive.yaw), drive.y + ahead * np.sin(drive.yaw)
    stays = list[Stay]()
    for i, region in enumerate(goal.regions):
        within = np.flatnonzero(points_inside(region, x, y)).tolist()
        was_away = [
            np.hypot(x[a:b] - x[a], y[a:b] - y[a]).max() >= AWAY_M for a, b in pairwise(within)
        ]
        cuts = [0, *(k + 1 for k, away in enumerate(was_away) if away), len(within)]
        states = [drive.t, x, y, drive.yaw, drive.v]
        for begin, end in pairwise(cuts):
            samples = within[begin:end]
            if any(goal.reached(*(float(column[k]) for column in states)) for k in samples):
                stays.append((samples[0], samples[-1], frozenset({i})))
    merged = list[Stay]()
    for first, last, held in sorted(stays, key=lambda stay: stay[:2]):
        if merged and first <= merged[-1][1] + 1:
            merged[-1] = merged[-1][0], max(last, merged[-1][1]), merged[-1][2] | held
        else:
            merged.append((first, last, held))
    return merged


def counting_stay(goal: Goal, drive: Trajectory, ahead: float) -> tuple[int, int] | None:
    """Return when a drive leaves a goal without having arrived, and when it comes to it then: two
    samples.

    This is before its last stay in a region where it has been before, else after the stay in which
    it begins. None: its first stay counts, or it has none.
    """
    stays = visits(goal, drive, ahead)
    again = [
        k
        for k, (_, _, regions) in enumerate(stays)
        if any(regions & earlier for _, _, earlier in stays[:k])
    ]
    begins = [1] if len(stays) > 1 and stays[0][0] == 0 else []
    k = max((*again, *begins), default=0)
    return (stays[k - 1][1], stays[k][0]) if k else None


def _meets(line: FloatArray, regions: tuple[FloatArray, ...]) -> bool:
    """Return whether a point of a line `(n, 2)` lies in one of the regions, not on its edge."""
    x, y = np.ascontiguousarray(line.T)
    return any(_any_within(x, y, region) for region in regions)


@kernel
def _any_within(x: FloatArray, y: FloatArray, polygon: FloatArray) -> bool:
    """Return whether one of the points `(n,)` lies in a polygon `(k, 2)`, farther than `TIE` from
    its edge.

    The edge is excluded because lanes that end at a goal region touch its edge.
    """
    for i in range(len(x)):
        apart = inside(x[i], y[i], polygon)
        for k in range(len(polygon)):
            a, b = polygon[k - 1], polygon[k]
            apart = apart and point_segment(x[i], y[i], a[0], a[1], b[0], b[1]) > TIE
        if apart:
            return True
    return False


def straight_on(road: Road, lane_id: int) -> int | None:
    """Return the successor that turns least, or None if the lane has no drivable successor in the
    map.
    """
    lane = road.lanes[lane_id]
    onward = [road.lanes[i] for i in lane.successors if i in road.lanes and road.lanes[i].drivable]
    if not onward:
        return None
    heading = _heading(lane, -2)
    return min(
        onward, key=lambda after: (_level(abs(wrap(_heading(after, -2) - heading))), after.id)
    ).id


def _level(value: float) -> float:
    """Round the value to a multiple of `TIE`, so that values that differ only by rounding are
    equal.
    """
    return TIE * round(value / TIE)


def _heading(lane: Lane, i: int) -> float:
    """Return the direction of the piece of the centre line that begins at point `i`, rad."""
    start, end = lane.center[i], lane.center[i + 1]
    return atan2(end[1] - start[1], end[0] - start[0])


def _turn(lane: Lane, ego: EgoState) -> float:
    i = min(nearest(lane.center, ego.x, ego.y), len(lane.center) - 2)
    return wrap(_heading(lane, i) - ego.yaw)


ASKEW_RAD = 0.25 * pi
"""Largest angle between a lane and the heading of a car that drives along it, rad."""
ASIDE_M = 0.5
"""A path that passes a stop line this far beside its ends still crosses it, m."""
BEHIND_M = 40.0
"""Length of the way after a stop line that decides whether the line applies to that way, m."""


def on_lane(lane: Lane, x: FloatArray, y: FloatArray, yaw: FloatArray) -> BoolArray:
    """Return which points `(k,)` with a heading are on a lane and drive along it (module
    docstring).
    """
    return _on_lane(lane.center, lane.polygon, *map(frozen, (x, y, yaw)))


@kernel
def _on_lane(
    center: FloatArray, polygon: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray
) -> BoolArray:
    is_on = np.zeros(len(x), np.bool_)
    low_x, high_x = polygon[:, 0].min(), polygon[:, 0].max()
    low_y, high_y = polygon[:, 1].min(), polygon[:, 1].max()
    for k in range(len(x)):
        if not (low_x <= x[k] <= high_x and low_y <= y[k] <= high_y) or not inside(
            x[k], y[k], polygon
        ):
            continue
        nearest, heading = inf, 0.0
        for i in range(len(center) - 1):
            ax, ay = center[i, 0], center[i, 1]
            bx, by = center[i + 1, 0], center[i + 1, 1]
            distance = hypot(0.5 * (bx + ax) - x[k], 0.5 * (by + ay) - y[k])
            if distance < nearest:
                nearest, heading = distance, atan2(by - ay, bx - ax)
        is_on[k] = abs(wrap(yaw[k] - heading)) < ASKEW_RAD
    return is_on
