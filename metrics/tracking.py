"""Closed loop: how well the controller and the vehicle kept to the plan (`Trace.tracking`)."""

from __future__ import annotations

from functools import partial

from logs.scenario import Scenario
from logs.trace import Mode, Trace
from metrics.metric import MAX_ABS, P95, RMS, Measured, Metric, Series, Unavailable


def _error(column: str, trace: Trace, scenario: Scenario) -> Measured:
    if trace.tracking is None or not len(trace.tracking.t):
        return Unavailable("the drive has no tracking errors: no controller was in it")
    return Series(trace.tracking.t, getattr(trace.tracking, column))


def _metric(column: str, unit: str, meaning: str, formula: str) -> Metric:
    return Metric(
        f"tracking_{column}", unit, "lower", (Mode.CLOSED,), partial(_error, column), (RMS, MAX_ABS, P95), meaning,
        formula=formula, needs="a controller in the drive",
    )  # fmt: skip


LATERAL = _metric("lateral", "m", "Distance of the ego from the plan's path, positive to the left.", "(p - foot) . n")
HEADING = _metric(
    "heading", "rad", "Heading of the ego minus that of the plan's path, principal value.", "wrap(yaw - yaw_path)"
)
SPEED = _metric("speed", "m/s", "Speed of the ego minus the plan's at the same time.", "v - v_plan(t)")
STATION = _metric(
    "station", "m", "Station of the ego minus the plan's at the same time, along the path.", "s - s_plan(t)"
)
