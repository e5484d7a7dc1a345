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
from math import cos, sin

import numpy as np

from logs.kernel import FloatArray
from logs.road import Goal, ReferenceLine, Road, inside, line_project_many, thinned
from logs.route import find_route, straight_on
from logs.scenario import Scenario
from logs.states import EgoState, Trajectory
from metrics.once import last

SPACING_M, WINDOW_M = 1.0, 30.0
STRETCH, SLACK_M = 2.0, 0.1
JOIN_M, CHANGE_M = 10.0, 20.0
"""Within the first the line goes over from the path's end to a lane, within the second from a lane to one beside."""
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


def route_of(scenario: Scenario) -> Route:
    """The route of a scenario."""
    return _route(scenario.road, scenario.ego, scenario.goal, scenario.vehicle.axle_to_center)


@last(2)  # a scenario is made anew with each entry of its metadata, of the same road
def _route(road: Road, log: Trajectory, goal: Goal | None, axle_to_center: float) -> Route:
    path = thinned(np.column_stack([log.x, log.y]), SPACING_M)
    ahead = _onward(road, log.state(len(log) - 1), goal)
    line = ReferenceLine.through(np.vstack([path, ahead]), SPACING_M)
    driven = float(np.hypot(*np.diff(path, axis=0).T).sum())
    entered = _entered(line, goal)
    if np.isfinite(entered):
        return Route(line, max(entered - axle_to_center, SPACING_M))
    return Route(line, driven if driven >= SHORTEST_M else np.nan)


@last(2)  # the log's drive and the one that is judged
def gained(route: Route, drive: Trajectory) -> Gain:
    """How far a drive came on a route (3)."""
    station = line_project_many(route.line.s, route.line.coef, drive.x, drive.y, 0.0, WINDOW_M)[:, 0]  # (2)
    step = np.diff(station)
    reach = STRETCH * np.maximum(np.abs(drive.v[1:]), np.abs(drive.v[:-1])) * np.diff(drive.t)
    counted = np.where(step > reach + SLACK_M, reach, step)
    return Gain(np.r_[0.0, np.cumsum(counted)], float((step - counted).sum()))


def _onward(road: Road, end: EgoState, goal: Goal | None) -> FloatArray:
    """Points `(k, 2)`, k >= 1, from `JOIN_M` behind a state on, along the centre lines of the route from there."""
    straight = np.array([[end.x + JOIN_M * cos(end.yaw), end.y + JOIN_M * sin(end.yaw)]])
    if not road.lanes:
        return straight
    lanes = list(find_route(road, end, goal).lanes)
    beyond = 0.0
    while beyond < BEYOND_M and (after := straight_on(road, lanes[-1])) is not None:
        beyond += max(road.lanes[after].length, SPACING_M)
        lanes.append(after)
    points, skipped, begun = np.empty((0, 2)), JOIN_M, False
    for k, lane in enumerate(lanes):
        center = road.lanes[lane].center
        if k + 1 < len(lanes) and lanes[k + 1] not in road.lanes[lane].successors:  # a lane change: beside each other
            skipped = CHANGE_M
            continue
        if not begun:
            center = center[int(np.argmin(np.hypot(center[:, 0] - end.x, center[:, 1] - end.y))) :]
        chord, begun = np.r_[0.0, np.cumsum(np.hypot(*np.diff(center, axis=0).T))], True
        points, skipped = np.vstack([points, center[chord >= skipped]]), max(skipped - float(chord[-1]), 0.0)
    return thinned(points, SPACING_M) if len(points) else straight


def _entered(line: ReferenceLine, goal: Goal | None) -> float:
    """The first station of the line inside of a goal region, behind its first metre; NaN where it enters none."""
    regions = goal.regions if goal is not None else ()
    if not regions:
        return float("nan")
    for s, (x, y) in zip(line.s[1:].tolist(), line.xy[1:].tolist(), strict=True):
        if any(inside(x, y, region) for region in regions):
            return float(s)
    return float("nan")
