"""Comfort: accelerations, jerk, yaw rate; of the drive in closed loop, of the plans in open loop.

State signals, not filtered (in simulation they are free of noise), differentiated by one declared rule:
`metric.changed`, the backward difference over W = 0.1 s.

(1) a_lat = v^2 kappa,  at the rear axle
(2) lon_jerk_state = (a(t) - a(t - W)) / W,  lat_jerk_state the same of a_lat
(3) yaw_rate = (yaw(t) - yaw(t - W)) / W

nuPlan's Savitzky-Golay cascade spans 2.2 s: it sees 2.9 of a ramp of 6 m/s3, and 6.3 where the log is cut after it.

Bounds of the times above: a_lon -4.05 to 2.40 m/s2, |a_lat| 4.89 m/s2, |lon_jerk| 4.13 m/s3, |yaw rate| 0.95 rad/s
(nuPlan devkit e9241677, ego_is_comfortable); |lat_jerk| 5 m/s3 (UN R79, there on a filtered signal).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from logs.kernel import FloatArray
from logs.scenario import Scenario
from logs.states import Trajectory
from logs.trace import Mode, Trace
from metrics.metric import (
    MAX,
    MAX_ABS,
    MEAN,
    MIN,
    P95,
    P99,
    Measured,
    Metric,
    Reduction,
    Series,
    Unavailable,
    changed,
    time_above,
    time_outside,
)
from metrics.plans import frame_times

WINDOW_S = 0.1
PLAN_HORIZON_S = 5.0
Signal = Callable[[Trajectory], FloatArray]


def lon_accel(drive: Trajectory) -> FloatArray:
    """State acceleration `(n,)`, m/s2."""
    return drive.a


def lat_accel(drive: Trajectory) -> FloatArray:
    """(1), `(n,)`, m/s2, positive to the left."""
    return np.asarray(drive.v**2 * drive.kappa)


def lon_jerk(drive: Trajectory) -> FloatArray:
    """(2), `(n,)`, m/s3; NaN in the first window."""
    return changed(drive.t, drive.a, WINDOW_S)


def lat_jerk(drive: Trajectory) -> FloatArray:
    """(2) of the lateral acceleration, `(n,)`, m/s3."""
    return changed(drive.t, lat_accel(drive), WINDOW_S)


def yaw_rate(drive: Trajectory) -> FloatArray:
    """(3), `(n,)`, rad/s."""
    return changed(drive.t, drive.yaw, WINDOW_S)


def _driven(signal: Signal, trace: Trace, scenario: Scenario) -> Measured:
    return Series(trace.ego.t, signal(trace.ego), missing=f"the drive is shorter than {WINDOW_S} s")


def _planned(signal: Signal, trace: Trace, scenario: Scenario) -> Measured:
    """Per frame the signal of largest size in the plan's first 5 s."""
    if not trace.frames:
        return Unavailable("the drive has no plans")
    worst = np.full(len(trace.frames), np.nan)
    for i, frame in enumerate(trace.frames):
        values = np.abs(signal(frame.plan.trajectory))[frame.plan.trajectory.t <= frame.t + PLAN_HORIZON_S + 1e-9]
        if np.isfinite(values).any():
            worst[i] = np.nanmax(values)
    return Series(frame_times(trace), worst, missing=f"the plans are shorter than {WINDOW_S} s")


_SPREAD = (MAX_ABS, P95, P99)


def _metric(name: str, unit: str, signal: Signal, reductions: tuple[Reduction, ...], meaning: str) -> Metric:
    return Metric(name, unit, "lower", (Mode.CLOSED,), partial(_driven, signal), reductions, meaning, "bounds: nuPlan")


def _plan_metric(name: str, unit: str, signal: Signal, meaning: str) -> Metric:
    return Metric(name, unit, "lower", (Mode.OPEN,), partial(_planned, signal), (MEAN, P95, MAX), meaning)


LON_ACCEL = _metric(
    "lon_accel", "m/s2", lon_accel,
    (*_SPREAD, replace(MIN, direction="higher"), MAX, time_outside(-4.05, 2.40, "time_out_of_bounds")),
    "Acceleration along the body; min is the hardest braking, out of bounds below -4.05 or above 2.40 m/s2.",
)  # fmt: skip
LAT_ACCEL = _metric(
    "lat_accel", "m/s2", lat_accel, (*_SPREAD, time_above(4.89, "time_out_of_bounds")),
    "Lateral acceleration v^2 kappa at the rear axle, out of bounds above 4.89 m/s2.",
)  # fmt: skip
LON_JERK_STATE = _metric(
    "lon_jerk_state", "m/s3", lon_jerk, (*_SPREAD, time_above(4.13, "time_out_of_bounds")),
    "Backward difference of the state's acceleration over 0.1 s, out of bounds above 4.13 m/s3.",
)  # fmt: skip
LAT_JERK_STATE = _metric(
    "lat_jerk_state", "m/s3", lat_jerk, (*_SPREAD, time_above(5.0, "time_out_of_bounds")),
    "Backward difference of the lateral acceleration over 0.1 s, out of bounds above 5 m/s3.",
)  # fmt: skip
YAW_RATE = _metric(
    "yaw_rate", "rad/s", yaw_rate, (*_SPREAD, time_above(0.95, "time_out_of_bounds")),
    "Backward difference of the heading over 0.1 s, out of bounds above 0.95 rad/s.",
)  # fmt: skip
PLAN_LON_ACCEL = _plan_metric(
    "plan_lon_accel", "m/s2", lon_accel, "Largest planned acceleration or braking within 5 s of the frame."
)
PLAN_LAT_ACCEL = _plan_metric(
    "plan_lat_accel", "m/s2", lat_accel, "Largest planned lateral acceleration within 5 s of the frame."
)
PLAN_LON_JERK = _plan_metric(
    "plan_lon_jerk", "m/s3", lon_jerk, "Largest planned longitudinal jerk within 5 s of the frame, over 0.1 s."
)
