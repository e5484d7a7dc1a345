"""Tracking errors, closed loop: deviations of the vehicle from the plan (`Trace.tracking`)."""

from __future__ import annotations

from functools import partial

from replan.logs.scenario import Scenario
from replan.logs.trace import Trace
from replan.metrics.metric import Measured, Series, Unavailable, metric, where_followed
from replan.metrics.reductions import MAX_ABS, P95, RMS

_tracking_metric = partial(
    metric, better="lower", reductions=(RMS, MAX_ABS, P95), needs="a controller in the drive"
)


@where_followed
def _error(column: str, trace: Trace, scenario: Scenario) -> Measured:
    if trace.tracking is None or not len(trace.tracking.t):
        return Unavailable("the drive has no tracking errors: no controller was in it")
    return Series(trace.tracking.t, getattr(trace.tracking, column))


@_tracking_metric(unit="m")
def tracking_lateral(trace: Trace, scenario: Scenario) -> Measured:
    """Distance of the ego from the plan's path, positive to the left.

    Formula: (p - foot) . n
    """
    return _error("lateral", trace, scenario)


@_tracking_metric(unit="rad")
def tracking_heading(trace: Trace, scenario: Scenario) -> Measured:
    """Heading of the ego minus that of the plan's path, principal value.

    Formula: wrap(yaw - yaw_path)
    """
    return _error("heading", trace, scenario)


@_tracking_metric(unit="m/s")
def tracking_speed(trace: Trace, scenario: Scenario) -> Measured:
    """Speed of the ego minus the plan's at the same time.

    Formula: v - v_plan(t)
    """
    return _error("speed", trace, scenario)


@_tracking_metric(unit="m")
def tracking_station(trace: Trace, scenario: Scenario) -> Measured:
    """Station of the ego minus the plan's at the same time, along the path.

    Formula: s - s_plan(t)
    """
    return _error("station", trace, scenario)
