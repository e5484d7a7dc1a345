"""The route along which progress is measured, and how far a drive came on it.

(1) route = the path of the log's driver, then the lanes from its end towards the goal, else straight on; a smooth line.
    A log of one state has no path: its route begins with the lanes.
(2) station(t) = foot of the rear axle on the route, sought within 30 m of the foot before
(3) gain(t) = sum over the steps of station_k - station_(k-1); one above reach + 0.1 m counts as reach,
    reach = 2 max(|v_k|, |v_(k-1)|) dt

Circles and ways back gain nothing, a car that is set forward gains no more than it could have driven. The factor 2 is
for the inside of bends (station' = v / (1 - kappa l), kappa l up to 0.5: a lane aside at a radius of 7 m), the 0.1 m
for noise of recorded positions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from math import cos, sin

import numpy as np

from logs.kernel import FloatArray
from logs.road import Goal, ReferenceLine, Road, inside, line_project_many, thinned
from logs.route import find_route, straight_on
from logs.scenario import Scenario
from logs.states import EgoState, Trajectory

SPACING_M, WINDOW_M = 1.0, 30.0
STRETCH, SLACK_M = 2.0, 0.1
JOIN_M = 10.0
"""From the path's end, the lanes are joined after this."""
BEYOND_M = 200.0
"""So far the lanes are followed behind the path or the goal; the line goes on straight after them."""
SHORTEST_M = 10.0
"""A shorter drive is none that a route could be read from."""


@dataclass(frozen=True, eq=False)
class Route:
    """The line (1) of a scenario.

    Attributes:
        line: From the first state on.
        length: From the start to where the line enters the goal, else to the end of the log's drive, m; NaN where the
            log has neither.
    """

    line: ReferenceLine
    length: float


@dataclass(frozen=True, eq=False)
class Gain:
    """How far a drive came (3).

    Attributes:
        metres: `(n,)` at the steps of the drive, m; negative where it went back.
        cut: What was not counted, m.
    """

    metres: FloatArray
    cut: float


@lru_cache(maxsize=1)
def route_of(scenario: Scenario) -> Route:
    """The route of a scenario; the last one is kept, since several metrics ask for it one after the other."""
    log = scenario.ego
    path = thinned(np.column_stack([log.x, log.y]), SPACING_M)
    ahead = _onward(scenario.road, log.state(len(log) - 1), scenario.goal)
    line = ReferenceLine.through(np.vstack([path, ahead]), SPACING_M)
    driven = float(np.hypot(*np.diff(path, axis=0).T).sum())
    entered = _entered(line, scenario.goal)
    if np.isfinite(entered):
        return Route(line, max(entered - scenario.vehicle.axle_to_center, SPACING_M))
    return Route(line, driven if driven >= SHORTEST_M else np.nan)


def gained(route: Route, drive: Trajectory) -> Gain:
    """How far a drive came on a route (3)."""
    station = line_project_many(route.line.s, route.line.coef, drive.x, drive.y, 0.0, WINDOW_M)[:, 0]  # (2)
    step = np.diff(station)
    reach = STRETCH * np.maximum(np.abs(drive.v[1:]), np.abs(drive.v[:-1])) * np.diff(drive.t)
    counted = np.where(step > reach + SLACK_M, reach, step)
    return Gain(np.r_[0.0, np.cumsum(counted)], float((step - counted).sum()))


def _onward(road: Road, end: EgoState, goal: Goal | None) -> FloatArray:
    """Points `(k, 2)`, k >= 1, from `JOIN_M` ahead of a state on, along the centre lines of the route from there."""
    straight = np.array([[end.x + JOIN_M * cos(end.yaw), end.y + JOIN_M * sin(end.yaw)]])
    if not road.lanes:
        return straight
    lanes = find_route(road, end, goal).lanes
    lanes = (*(now for now, after in pairwise(lanes) if after in road.lanes[now].successors), lanes[-1])
    points = road.lanes[lanes[0]].center
    start = int(np.argmin(np.hypot(points[:, 0] - end.x, points[:, 1] - end.y)))
    points = np.vstack([points[start:], *(road.lanes[lane].center for lane in lanes[1:])])
    last, beyond = lanes[-1], 0.0
    while beyond < BEYOND_M and (after := straight_on(road, last)) is not None:
        points, last = np.vstack([points, road.lanes[after].center]), after
        beyond += max(road.lanes[after].length, SPACING_M)
    far = (points[:, 0] - end.x) * cos(end.yaw) + (points[:, 1] - end.y) * sin(end.yaw) > JOIN_M
    first = int(np.argmax(far)) if far.any() else len(points)
    return thinned(points[first:], SPACING_M) if first < len(points) else straight


def _entered(line: ReferenceLine, goal: Goal | None) -> float:
    """The first station of the line inside of a goal region, behind its first metre; NaN where it enters none."""
    regions = goal.regions if goal is not None else ()
    if not regions:
        return float("nan")
    for s, (x, y) in zip(line.s[1:].tolist(), line.xy[1:].tolist(), strict=True):
        if any(inside(x, y, region) for region in regions):
            return float(s)
    return float("nan")
