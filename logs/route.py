"""Route: the cheapest sequence of lanes from the ego to the goal; and a rule for whether a car is on a lane.

Dynamic programming over the lane graph (paper, section II-F: "DP for global planning"), in Dijkstra's order, from the
goal backwards:

(1) cost(lane) = 0 if the lane contains the goal, else  min over steps: price(step) + cost(lane after it)

A step goes to a successor (its price is the length of the lane driven) or to a same-direction neighbour
(`LANE_CHANGE_M`). If costs are equal (within `TIE`), fewer lane changes decide, then the lower id. The route starts
at the lane under the ego with the least cost to go; if costs are equal, at the best aligned one.

`on_lane` is the rule that metrics and traffic share: a point with a heading is on a lane, and drives along it, if it
lies in the lane's outline and its heading is within
`ASKEW_RAD` of the piece of the centre line whose middle is nearest.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from math import atan2, cos, hypot, inf, pi, sin

import numpy as np

from logs.kernel import TIE, BoolArray, FloatArray, kernel
from logs.road import Goal, Lane, Road, inside, nearest
from logs.shapes import point_segment
from logs.states import EgoState, wrap

LANE_CHANGE_M = 50.0
"""Cost of a lane change, in metres of detour."""


@dataclass(frozen=True, slots=True)
class Route:
    """Lanes in driving order; between two neighbours, the route changes lanes.

    Attributes:
        lanes: Ids of at least one lane.
        reaches_goal: Whether the last lane contains the goal.
        cost: Cost (1), m.
    """

    lanes: tuple[int, ...]
    reaches_goal: bool
    cost: float


def start_lanes(road: Road, ego: EgoState) -> tuple[int, ...]:
    """Return the drivable lanes under the ego, the best aligned first; else one lane that is near and aligned.

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
        distance = float(np.hypot(*(lane.center[nearest(lane.center, ego.x, ego.y)] - (ego.x, ego.y))))
        return _level(distance + 5.0 * abs(_turn(lane, ego)))

    return (min(drivable, key=lambda lane: (away(lane), lane.id)).id,)


def find_route(road: Road, ego: EgoState, goal: Goal | None) -> Route:
    """Return the route to the goal (1); without a goal, or a way to it, only the lane under the ego."""
    starts, to_go = start_lanes(road, ego), costs_to_go(road, goal)
    leading = [lane for lane in starts if lane in to_go]
    if not leading:
        return Route(starts[:1], False, 0.0)
    lanes = [min(leading, key=lambda lane: _level(to_go[lane].cost))]
    while (after := to_go[lanes[-1]].next) is not None:
        lanes.append(after)
    return Route(tuple(lanes), True, to_go[lanes[0]].cost)


@dataclass(frozen=True, slots=True)
class CostToGo:
    """The cost from a lane's start to the goal.

    Attributes:
        cost: Cost (1), m.
        changes: Number of lane changes on the way.
        next: The next lane of the way; None if the lane contains the goal.
    """

    cost: float
    changes: int
    next: int | None


def costs_to_go(road: Road, goal: Goal | None) -> dict[int, CostToGo]:
    """Return the cost to go (1) of every lane from which the goal can be reached; {} without a goal."""
    into: dict[int, list[tuple[int, float]]] = {}
    for lane in road.lanes.values():
        onward = [(i, lane.length) for i in lane.successors]
        beside = [(lane.left_neighbour, lane.left_crossable), (lane.right_neighbour, lane.right_crossable)]
        sideways = [(i, LANE_CHANGE_M) for i, crossable in beside if i is not None and crossable]
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
            heapq.heappush(queue, (_level(cost + price), changes + changed, before, lane_id, cost + price))  # (1)
    return best


def goal_lanes(road: Road, goal: Goal | None) -> frozenset[int]:
    """Return the lanes whose centre line meets a goal region; if no line meets a region, the lanes at its middle."""
    found: set[int] = set()
    for region in goal.regions if goal is not None else ():
        through = []  # lanes whose centre line, sampled every 1 m, has a point inside the region, not on its edge
        for lane in road.lanes.values():
            near = (lane.polygon.max(axis=0) >= region.min(axis=0)) & (lane.polygon.min(axis=0) <= region.max(axis=0))
            if lane.drivable and near.all():
                chord = np.r_[0.0, np.cumsum(np.hypot(*np.diff(lane.center, axis=0).T))]
                at = np.union1d(chord, np.arange(0.0, chord[-1], 1.0))
                x, y = (np.interp(at, chord, lane.center[:, k]) for k in (0, 1))
                through += [lane.id] if _any_within(x, y, region) else []
        middle = road.lanes_at(*region.mean(axis=0))
        found.update(through or [lane.id for lane in middle if lane.drivable])
    return frozenset(found)


@kernel
def _any_within(x: FloatArray, y: FloatArray, polygon: FloatArray) -> bool:
    """Return whether one of the points `(n,)` lies in a polygon `(k, 2)`, farther than `TIE` from its edge.

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
    """Return the successor that turns least, or None if the lane has no drivable successor in the map."""
    lane = road.lanes[lane_id]
    onward = [road.lanes[i] for i in lane.successors if i in road.lanes and road.lanes[i].drivable]
    if not onward:
        return None
    heading = _heading(lane, -2)
    return min(onward, key=lambda after: (_level(abs(wrap(_heading(after, -2) - heading))), after.id)).id


def _level(value: float) -> float:
    """Round the value to a multiple of `TIE`, so that values that differ only by rounding are equal."""
    return TIE * round(value / TIE)


def _heading(lane: Lane, i: int) -> float:
    """Return the direction of the piece of the centre line that begins at point `i`, rad."""
    start, end = lane.center[i], lane.center[i + 1]
    return atan2(end[1] - start[1], end[0] - start[0])


def _turn(lane: Lane, ego: EgoState) -> float:
    """Heading of the lane at the ego, relative to the ego's, rad."""
    i = min(nearest(lane.center, ego.x, ego.y), len(lane.center) - 2)
    return wrap(_heading(lane, i) - ego.yaw)


ASKEW_RAD = 0.25 * pi
"""Largest angle between a lane and the heading of a car that drives along it, rad."""
ASIDE_M = 0.5
"""A path that passes a stop line this far beside its ends still crosses it, m."""
BEHIND_M = 40.0
"""Length of the way after a stop line that decides whether the line applies to that way, m."""


def on_lane(lane: Lane, x: FloatArray, y: FloatArray, yaw: FloatArray) -> BoolArray:
    """Return which points `(k,)` with a heading are on a lane and drive along it (module docstring)."""
    return _on_lane(lane.center, lane.polygon, *(np.ascontiguousarray(column, np.float64) for column in (x, y, yaw)))


@kernel
def _on_lane(center: FloatArray, polygon: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray) -> BoolArray:
    out = np.zeros(len(x), np.bool_)
    low_x, high_x = polygon[:, 0].min(), polygon[:, 0].max()
    low_y, high_y = polygon[:, 1].min(), polygon[:, 1].max()
    for k in range(len(x)):
        if not (low_x <= x[k] <= high_x and low_y <= y[k] <= high_y) or not inside(x[k], y[k], polygon):
            continue
        nearest, heading = inf, 0.0
        for i in range(len(center) - 1):
            middle_x, middle_y = 0.5 * (center[i + 1, 0] + center[i, 0]), 0.5 * (center[i + 1, 1] + center[i, 1])
            away = hypot(middle_x - x[k], middle_y - y[k])
            if away < nearest:
                nearest, heading = away, atan2(center[i + 1, 1] - center[i, 1], center[i + 1, 0] - center[i, 0])
        out[k] = abs(wrap(yaw[k] - heading)) < ASKEW_RAD
    return out
