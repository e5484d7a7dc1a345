"""Arrival: when a drive is at its goal, how much of the log it covers then, and whether the goal
can be driven to.

A goal is a place and the way to it: on a ring, a drive passes the place where it ends before it
ends there.

(1) arrived = the state satisfies the goal, and gain >= way
        (gain (c) and way (d) of `replan.metrics.route_gain`)
(2) The log names no goal: the place where its drive ended is the goal if its driver's gain L
        is 10 m or more.
    way = min(`NEARLY` L, L - 5 m), and at least (d)
(3) goal_route = 0 if the goal cannot be driven to (`replan.logs.route.GoalFault`)
        and the drive did not drive to it, else 1
(4) a goal is unreachable if it is farther than a vehicle drives in the time, accelerating at 9.81
    m/s2 up to 70 m/s
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from math import cos, sin

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.road import GOAL_LENGTH_M, Goal
from replan.logs.route import GoalFault, goal_fault, visits
from replan.logs.scenario import Scenario
from replan.logs.shapes import point_segment
from replan.logs.states import TRAJECTORY_COLUMNS, Trajectory
from replan.logs.trace import EndReason, Trace
from replan.metrics.boxes import ego_boxes
from replan.metrics.metric import Measured, Series, Unavailable, metric
from replan.metrics.progress import FLOOR_M, LEAST_COVERED, is_time_only
from replan.metrics.reductions import FINAL
from replan.metrics.route_gain import ProgressLine, gain_along, route_of, way_of

SHORTEST_DRIVE_M = 10.0
"""The end of a drive becomes the goal only if the log's driver gains at least this along the
route.
"""
NEARLY = 0.9
"""Share of the log's gain from which on the end of its drive counts as the goal: a drive that cuts
corners, or whose position jumps, gains a little less than the log's driver."""
NO_GOAL_NOTE = "the log names no goal: the place where its drive ended is the goal"
MISSED_STEPS = 500  # Steps of a drive that are looked at for what it missed
REACH_MPS2, REACH_MPS = 9.81, 70.0  # No road vehicle exceeds these (adhesion of 1 g)


def goal_of(scenario: Scenario) -> tuple[Goal | None, str]:
    """Return the scenario's goal with its way, or the place where its drive ended (2) and a
    note.
    """
    route, goal = route_of(scenario), scenario.goal
    if goal is not None:
        return goal if goal.way == route.goal_gain else replace(goal, way=route.goal_gain), ""
    gained = float(gain_along(route, scenario.ego).metres[-1])
    if gained < SHORTEST_DRIVE_M:
        return None, ""
    last, ahead = scenario.ego.state(len(scenario.ego) - 1), scenario.vehicle.axle_to_center
    place = Goal.around(*last.ahead(ahead), last.yaw)
    least_gain = max(
        way_of(place, scenario.ego, route, ahead), min(NEARLY * gained, gained - GOAL_LENGTH_M)
    )
    return replace(place, way=least_gain), NO_GOAL_NOTE


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

    def at(self, columns: Mapping[str, FloatArray], k: int) -> bool:
        """Return whether the drive has arrived at sample `k` of its `TRAJECTORY_COLUMNS`."""
        t, x, y, yaw, v = (float(columns[name][k]) for name in ("t", "x", "y", "yaw", "v"))
        if not self._goal.reached(
            t, x + self._ahead * cos(yaw), y + self._ahead * sin(yaw), yaw, v
        ):
            return False
        if self._route is None:
            return True
        new = Trajectory(*(columns[name][self._row : k + 1] for name in TRAJECTORY_COLUMNS))
        gain = gain_along(self._route, new, self._station)
        self._row, self._station, self._gain = (
            k,
            gain.station,
            self._gain + float(gain.metres[-1]),
        )
        return self._gain >= self._goal.way


_arrival_metric = partial(metric, unit="1", better="higher", reductions=(FINAL,))


@_arrival_metric(needs="a log that names a goal")
def goal_route(trace: Trace, scenario: Scenario) -> Measured:
    """1 if lanes lead from the ego's start to the goal that the log names, or if the drive arrived
    there; 0 if not, or if the drive begins at the goal.

    Formula: 1 if there is a way to drive, else 0
    """
    if scenario.goal is None:
        return _NO_GOAL
    fault = fault_of(scenario)
    arrived = trace.end is EndReason.GOAL and fault is not GoalFault.AT_START
    label = "" if fault is None else fault.value
    return _at_end(trace, float(fault is None or arrived), label)


@_arrival_metric(
    parameters=(f"reach {REACH_MPS2} m/s2 up to {REACH_MPS:g} m/s",),
    needs="a goal that is a place, and that a vehicle can reach in the time",
    version=2,
)
def goal(trace: Trace, scenario: Scenario) -> Measured:
    """1 if the drive ended at the goal.

    Formula: 1 if it ended there, else 0
    """
    place = scenario.goal
    if place is None:
        return _NO_GOAL
    if is_time_only(place):
        return Unavailable("the goal is a time only: progress along the route is asked instead")
    if trace.end is EndReason.GOAL:
        return _at_end(trace, 1.0, _end_of(trace))
    if place.t and place.t[0] > scenario.duration:
        return Unavailable(
            f"the log ends at {scenario.duration:.1f} s, and the goal begins at {place.t[0]:.1f} s"
        )
    return _too_far(scenario, place) or _missed(trace, scenario, place)


@_arrival_metric()
def completed(trace: Trace, scenario: Scenario) -> Measured:
    """1 if the drive ended at the goal or the log's end.

    Formula: 1 if it ended so, else 0
    """
    ended = trace.end in (EndReason.GOAL, EndReason.END_OF_LOG)
    return _at_end(trace, float(ended), _end_of(trace))


_NO_GOAL = Unavailable("the log names no goal")


def _at_end(trace: Trace, value: float, label: str) -> Series:
    return Series(trace.ego.t[-1:], np.array([value]), (label,))


def _end_of(trace: Trace) -> str:
    return ": ".join(filter(None, [trace.end.value, trace.detail]))


def _too_far(scenario: Scenario, place: Goal) -> Unavailable | None:
    """Return why no vehicle reaches a goal in its time (4); None if one may."""
    start, first = scenario.ego.state(0), float(scenario.ego.t[0])
    x, y = start.ahead(scenario.vehicle.axle_to_center)
    if not place.regions or place.holds_place(x, y):
        return None
    edges = [
        (corner, following)
        for region in place.regions
        for corner, following in zip(region, np.roll(region, -1, axis=0), strict=True)
    ]
    away = min(point_segment(x, y, *corner, *following) for corner, following in edges)
    last = min(scenario.duration, place.t[1] if place.t else scenario.duration)
    top, time = max(start.v, REACH_MPS), last - first
    faster = min(time, (top - start.v) / REACH_MPS2)
    reach = start.v * faster + 0.5 * REACH_MPS2 * faster**2 + top * (time - faster)
    if away <= reach:
        return None
    return Unavailable(
        f"no vehicle reaches the goal: {away:.0f} m in {time:.1f} s from {start.v:.1f} m/s"
    )


def _missed(trace: Trace, scenario: Scenario, goal: Goal) -> Series:
    """Return 0, and what the drive missed of the goal at the step at which it missed the fewest
    conditions.
    """
    x, y = ego_boxes(trace.ego, scenario)[:2]
    steps = np.unique(np.linspace(0, len(x) - 1, MISSED_STEPS).round().astype(int))
    states = np.stack([trace.ego.t, x, y, trace.ego.yaw, trace.ego.v], axis=1)[steps]
    unmet = [goal.unmet(*state) for state in states.tolist()]
    fewest = min(map(len, unmet))
    candidates = [names for names in unmet if len(names) == fewest]
    missed = next((names for names in candidates if "place" not in names), candidates[0])
    label = f"{trace.end.value}: {' and '.join(missed) or 'the way to it'} of the goal missed"
    return Series(trace.ego.t[-1:], np.zeros(1), (label,))
