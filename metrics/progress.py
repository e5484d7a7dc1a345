"""Closed loop: did the ego get on, how fast, and did it arrive?

(1) distance(t) = length of the path of the rear axle driven since the start
(2) progress(t) = max(distance(t), 2 m) / max(distance of the log's ego(t), 2 m),  while the log's ego lasts

(2) has nuPlan's floor (2 m, as in its configuration), so that a log that stands still asks for nothing.
"""

from __future__ import annotations

import numpy as np

from logs.kernel import FloatArray
from logs.road import RoadSource
from logs.scenario import Scenario
from logs.states import Trajectory
from logs.trace import EndReason, Mode, Trace
from metrics.lanes import drivable_lanes, limits_at
from metrics.metric import FINAL, MAX, MEAN, Measured, Metric, Series, Unavailable, time_above
from metrics.others import ego_boxes

FLOOR_M = 2.0


def _driven(drive: Trajectory) -> FloatArray:
    return np.asarray(np.r_[0.0, np.cumsum(np.hypot(np.diff(drive.x), np.diff(drive.y)))])


def _distance(trace: Trace, scenario: Scenario) -> Measured:
    return Series(trace.ego.t, _driven(trace.ego))


def _progress(trace: Trace, scenario: Scenario) -> Measured:
    log = scenario.ego
    if len(log) < 2:
        return Unavailable("the log holds one ego state only: there is no drive to compare with")
    reference = np.interp(trace.ego.t, log.t, _driven(log))
    ratio = np.maximum(_driven(trace.ego), FLOOR_M) / np.maximum(reference, FLOOR_M)
    return Series(trace.ego.t, np.where(trace.ego.t <= log.t[-1] + 1e-6, ratio, np.nan))


def _speed(trace: Trace, scenario: Scenario) -> Measured:
    return Series(trace.ego.t, trace.ego.v)


def _excess(trace: Trace, scenario: Scenario) -> Measured:
    lanes = drivable_lanes(scenario.road)
    if scenario.road.source is RoadSource.DRIVEN_PATH or lanes is None or not np.isfinite(lanes.limit).any():
        return Unavailable("the log has no speed limits")
    x, y = ego_boxes(trace.ego, scenario)[:2]
    excess = np.maximum(np.abs(trace.ego.v) - limits_at(lanes, x, y), 0.0)
    return Series(trace.ego.t, excess, missing="the ego is never on a lane with a speed limit")


def _at_end(trace: Trace, *, good: bool) -> Series:
    label = ": ".join(filter(None, [trace.end.value, trace.detail]))
    return Series(trace.ego.t[-1:], np.array([float(good)]), (label,))


def _goal(trace: Trace, scenario: Scenario) -> Measured:
    if scenario.goal is None:
        return Unavailable("the log names no goal")
    return _at_end(trace, good=trace.end is EndReason.GOAL)


def _completed(trace: Trace, scenario: Scenario) -> Measured:
    return _at_end(trace, good=trace.end in (EndReason.GOAL, EndReason.END_OF_LOG))


_CLOSED = (Mode.CLOSED,)
DISTANCE = Metric("distance", "m", "none", _CLOSED, _distance, (FINAL,), "Distance driven by the rear axle.")
PROGRESS = Metric(
    "progress", "1", "higher", _CLOSED, _progress, (FINAL,),
    "Distance driven over the distance that the log's ego drove in the same time, both at least 2 m.",
    "nuPlan devkit e9241677, ego_progress_along_expert_route: its floor, without the route and the cap",
)  # fmt: skip
SPEED = Metric("speed", "m/s", "none", _CLOSED, _speed, (MEAN, MAX), "Speed of the rear axle, mean over the steps.")
SPEED_EXCESS = Metric(
    "speed_excess", "m/s", "lower", _CLOSED, _excess, (MAX, MEAN, time_above(1.0, "time_above_1mps")),
    "Speed above the limit of the lane under the ego's centre; the larger limit where lanes overlap.",
)  # fmt: skip
GOAL = Metric("goal", "1", "higher", _CLOSED, _goal, (FINAL,), "1 if the drive ended at the goal.")
COMPLETED = Metric(
    "completed", "1", "higher", _CLOSED, _completed, (FINAL,), "1 if the drive ended at the goal or the end of the log."
)
