"""The route that planners are shown, for every log: lanes in driving order, each a successor or
neighbour of the one before, but for (3) where the lanes under the drive do not lead on.

(1) through the lanes that the log names (`Road.route`), as far as they lead on from the ego
(2) else to the goal (`replan.logs.route.find_route`)
(3) else along the log's drive, which no planner could know: it is marked
(4) and at last straight on for `BEYOND_M`, since the routes of nuPlan do not end with a log
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from enum import Enum

import numpy as np

from replan.logs.polylines import thinned
from replan.logs.road import Goal, Road
from replan.logs.route import find_route, goal_lanes, start_lanes, straight_on
from replan.logs.states import EgoState, Trajectory

BEYOND_M = 250.0
"""A route goes on for this length: more than 8 s at 110 km/h."""


SPACING_M = 1.0
"""Distance between the points of a drive whose lanes are looked for."""


class RouteSource(Enum):
    """What a route follows."""

    LOG = "log"
    GOAL = "goal"
    DRIVE = "drive"


@dataclass(frozen=True, slots=True)
class LaneRoute:
    """The lanes of a route in driving order, and what it follows; empty for built-in planners."""

    lanes: tuple[int, ...] = ()
    source: RouteSource = RouteSource.GOAL


def lane_route(road: Road, start: EgoState, goal: Goal | None, drive: Trajectory) -> LaneRoute:
    """Return the route of a drive (module docstring)."""
    if named := _through(road, start, set(road.route)):
        return LaneRoute(_extended(road, named), RouteSource.LOG)
    to_goal = find_route(road, start, goal)
    if goal is not None and to_goal[-1] in goal_lanes(road, goal):
        return LaneRoute(_extended(road, to_goal), RouteSource.GOAL)
    return LaneRoute(_extended(road, _driven(road, start, drive)), RouteSource.DRIVE)


def _through(road: Road, start: EgoState, allowed: Collection[int]) -> tuple[int, ...]:
    """Return the longest way from the ego through some lanes, without a way back; () if the ego is
    on none of them.
    """
    first = next((lane for lane in start_lanes(road, start) if lane in allowed), None)
    if first is None:
        return ()
    before: dict[int, int | None] = {first: None}
    queue = [first]
    for lane in queue:  # the list grows
        steps = (*road.lanes[lane].successors, *road.lanes[lane].sideways)
        for step in steps:
            if step in allowed and step in road.lanes and step not in before:
                before[step] = lane
                queue.append(step)
    order = {lane: place for place, lane in enumerate(road.route)}
    last: int | None = max(before, key=lambda lane: order[lane])
    way: list[int] = []
    while last is not None:
        way.append(last)
        last = before[last]
    return tuple(reversed(way))


def _driven(road: Road, start: EgoState, drive: Trajectory) -> tuple[int, ...]:
    """Return the lanes under a drive: the one before as long as it is under the ego, then one that
    it leads to, then any.
    """
    lanes = [start_lanes(road, start)[0]]
    for x, y in thinned(np.column_stack([drive.x, drive.y]), SPACING_M).tolist():
        under = [lane.id for lane in road.lanes_at(x, y) if lane.drivable]
        last = road.lanes[lanes[-1]]
        if under and last.id not in under:
            onward = [lane for lane in under if lane in (*last.successors, *last.sideways)]
            lanes.append((onward or under)[0])
    return tuple(lanes)


def _extended(road: Road, lanes: tuple[int, ...]) -> tuple[int, ...]:
    """Return the route and the lanes straight on from its end (4)."""
    route, beyond = list(lanes), 0.0
    while beyond < BEYOND_M:
        after = straight_on(road, route[-1])
        if after is None or after in route:
            break
        route.append(after)
        beyond += road.lanes[after].length
    return tuple(route)
