"""Arrival: when a drive is at its goal, how much of the log it covers then, and whether the goal
can be driven to.

A goal is a place and the way to it: on a ring, a drive passes the place where it ends before it
ends there.

(1) arrived = the state satisfies the goal, and gain >= way
        (gain (c) and way (d) of `replan.metrics.progress`)
(2) The log names no goal: the place where its drive ended is the goal if its driver's gain L
        is 10 m or more.
    way = min(`NEARLY` L, L - 5 m), and at least (d)
(3) goal_route = 0 if the goal cannot be driven to (`replan.logs.route.GoalFault`)
        and the drive did not drive to it, else 1
"""

from __future__ import annotations

from dataclasses import replace
from math import cos, sin

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.road import GOAL_LENGTH_M, Goal
from replan.logs.route import GoalFault, goal_fault, visits
from replan.logs.scenario import Scenario
from replan.logs.states import TRAJECTORY_COLUMNS, Trajectory
from replan.logs.trace import EndReason, Mode, Trace
from replan.metrics import metric
from replan.metrics.metric import Measured, Metric, Series, Unavailable
from replan.metrics.progress import (
    FLOOR_M,
    LEAST_COVERED,
    ProgressLine,
    gain_along,
    route_of,
    way_of,
)

SHORTEST_DRIVE_M = 10.0
"""The end of a drive becomes the goal only if the log's driver gains at least this along the
route.
"""
NEARLY = 0.9
"""Share of the log's gain from which on the end of its drive counts as the goal: a drive that cuts
corners, or whose position jumps, gains a little less than the log's driver."""
NO_GOAL_NOTE = "the log names no goal: the place where its drive ended is the goal"


def goal_of(scenario: Scenario) -> tuple[Goal | None, str]:
    """Return the scenario's goal with its way, or the place where its drive ended (2) and a
    note.
    """
    route, goal = route_of(scenario), scenario.goal
    if goal is not None:
        return goal if goal.way == route.way else replace(goal, way=route.way), ""
    gained = float(gain_along(route, scenario.ego).metres[-1])
    if gained < SHORTEST_DRIVE_M:
        return None, ""
    last, ahead = scenario.ego.state(len(scenario.ego) - 1), scenario.vehicle.axle_to_center
    place = Goal.around(*last.ahead(ahead), last.yaw)
    way = max(
        way_of(place, scenario.ego, route, ahead), min(NEARLY * gained, gained - GOAL_LENGTH_M)
    )
    return replace(place, way=way), NO_GOAL_NOTE


def fault_of(scenario: Scenario) -> GoalFault | None:
    """Return why the goal that the log names cannot be driven to; None if it can, or if there is
    none.
    """
    if scenario.goal is None:
        return None
    return goal_fault(scenario.road, scenario.ego, scenario.goal, scenario.vehicle.axle_to_center)


def passed_early(scenario: Scenario) -> tuple[float, float] | None:
    """Return when the log's driver passes the goal that the log names, s, and the share of the log
    that ends there.

    None if there is no such goal, or if the share is at least `LEAST_COVERED`.
    """
    goal, log, start = scenario.goal, scenario.ego, float(scenario.ego.t[0])
    stays = [] if goal is None else visits(goal, log, scenario.vehicle.axle_to_center)
    gain = gain_along(route_of(scenario), log).metres
    if len(stays) != 1 or gain[-1] < FLOOR_M:
        return None
    first = stays[0][0]
    time = (float(log.t[first]) - start) / max(scenario.duration - start, 1e-9)
    share = max(time, float(gain[first] / gain[-1]))
    return (float(log.t[first]), share) if share < LEAST_COVERED else None


class Arrival:
    """Tests the states of one drive, in order, for arrival (1).

    `scenario`: the scenario, for its route and its vehicle. `goal`: the goal, with its way.
    """

    def __init__(self, scenario: Scenario, goal: Goal) -> None:
        self._goal, self._ahead = goal, scenario.vehicle.axle_to_center
        self._route: ProgressLine | None = route_of(scenario) if goal.way > 0.0 else None
        self._row, self._station, self._gain = 0, 0.0, 0.0

    def at(self, rows: FloatArray, k: int) -> bool:
        """Return whether the drive has arrived at row `k`.

        Columns of the rows: `TRAJECTORY_COLUMNS` first.
        """
        t, x, y, yaw, v = rows[k, :5].tolist()
        if not self._goal.reached(
            t, x + self._ahead * cos(yaw), y + self._ahead * sin(yaw), yaw, v
        ):
            return False
        if self._route is None:
            return True
        new = Trajectory(*rows[self._row : k + 1, : len(TRAJECTORY_COLUMNS)].T)
        found = gain_along(self._route, new, self._station)
        self._row, self._station, self._gain = (
            k,
            found.station,
            self._gain + float(found.metres[-1]),
        )
        return self._gain >= self._goal.way


def _goal_route(trace: Trace, scenario: Scenario) -> Measured:
    if scenario.goal is None:
        return Unavailable("the log names no goal")
    fault = fault_of(scenario)
    there = fault is None or (trace.end is EndReason.GOAL and fault is not GoalFault.AT_START)
    return Series(
        trace.ego.t[-1:], np.array([float(there)]), ("" if fault is None else fault.value,)
    )


GOAL_ROUTE = Metric(
    "goal_route",
    "1",
    "higher",
    (Mode.CLOSED,),
    _goal_route,
    (metric.FINAL,),
    "1 if lanes lead from the ego's start to the goal that the log names, or if the drive arrived "
    "there; 0 if not, or"
    " if the drive begins at the goal.",
    formula="1 if there is a way to drive, else 0",
    needs="a log that names a goal",
)
