"""Comfort of the drive: accelerations, jerk, yaw rate; `proposals` has that of plans.

State signals, not filtered (in simulation they are free of noise), differentiated by one declared rule:
`metric.changed`, the backward difference over W = 0.1 s.

(1) a_lat = v^2 kappa,  at the rear axle
(2) lon_jerk_state = (a(t) - a(t - W)) / W,  lat_jerk_state the same of a_lat
(3) jerk_state = |A(t) - A(t - W)| / W,  A the acceleration vector (a, a_lat) turned into the world
(4) yaw_rate = (yaw(t) - yaw(t - W)) / W,  yaw_accel = (yaw(t) - 2 yaw(t - W) + yaw(t - 2 W)) / W^2

Beside them the filtered ones of nuPlan and UN R79 (`filters`), for logs with noise and for their publishers' scores.
nuPlan's Savitzky-Golay cascade spans 2.2 s: it sees 2.9 of a ramp of 6 m/s3, and 6.3 where the log is cut after it.

What a drive is judged by is the time out of bounds and the longest stretch of it: both are the same for one slam in
20 s and in 120 s; percentiles over the whole drive, which are shown too, are not.
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
from metrics import filters
from metrics.metric import (
    MAX,
    MAX_ABS,
    MIN,
    P95,
    P99,
    Measured,
    Metric,
    Reduction,
    Series,
    Unavailable,
    changed,
    out_of_bounds,
)

WINDOW_S = 0.1
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


def jerk(drive: Trajectory) -> FloatArray:
    """(3), `(n,)`, m/s3."""
    c, s, aside = np.cos(drive.yaw), np.sin(drive.yaw), lat_accel(drive)
    x, y = drive.a * c - aside * s, drive.a * s + aside * c
    return np.hypot(changed(drive.t, x, WINDOW_S), changed(drive.t, y, WINDOW_S))


def yaw_rate(drive: Trajectory) -> FloatArray:
    """(4), `(n,)`, rad/s."""
    return changed(drive.t, drive.yaw, WINDOW_S)


def yaw_accel(drive: Trajectory) -> FloatArray:
    """(4), `(n,)`, rad/s2; NaN in the first two windows."""
    before, start = (np.interp(drive.t - k * WINDOW_S, drive.t, drive.yaw) for k in (1, 2))
    known = drive.t - 2.0 * WINDOW_S >= drive.t[0] - 1e-9
    return np.where(known, (drive.yaw - 2.0 * before + start) / WINDOW_S**2, np.nan)


def _driven(signal: Signal, trace: Trace, scenario: Scenario) -> Measured:
    return Series(trace.ego.t, signal(trace.ego), missing=f"the drive is shorter than {WINDOW_S} s")


def _filtered(signal: Signal, step: float, least: float, trace: Trace, scenario: Scenario) -> Measured:
    """The signal of the drive resampled to `step` s."""
    if float(trace.ego.t[-1] - trace.ego.t[0]) < least - 1e-9:
        return Unavailable(f"the drive is shorter than {least} s")
    drive = filters.regular(trace.ego, step)
    return Series(drive.t, signal(drive))


_SPREAD = (MAX_ABS, P95, P99)
_NUPLAN = "bounds: nuPlan devkit e9241677, ego_is_comfortable"
_R79 = "bound: UN R79, there on a filtered signal"
_DRIVEN = f"a drive of {WINDOW_S} s"

# name, unit, low, high
NUPLAN_BOUNDS = {
    "lon_accel": ("m/s2", -4.05, 2.40),
    "lat_accel": ("m/s2", -4.89, 4.89),
    "lon_jerk": ("m/s3", -4.13, 4.13),
    "jerk": ("m/s3", -8.37, 8.37),
    "yaw_rate": ("rad/s", -0.95, 0.95),
    "yaw_accel": ("rad/s2", -1.93, 1.93),
}
R79_JERK_MPS3 = 5.0


def _bounds(low: float, high: float, unit: str) -> str:
    return f"bounds {low:g} to {high:g} {unit}" if low != -high else f"bound {high:g} {unit}"


def _metric(
    name: str, signal: Signal, bounds: tuple[str, float, float], meaning: str, formula: str,
    *, extra: tuple[Reduction, ...] = (), source: str = _NUPLAN,
) -> Metric:  # fmt: skip
    unit, low, high = bounds
    return Metric(
        name, unit, "lower", (Mode.CLOSED,), partial(_driven, signal), (*_SPREAD, *extra, *out_of_bounds(low, high)),
        meaning, source, 2, formula=formula, parameters=(_bounds(low, high, unit), f"W {WINDOW_S} s"), needs=_DRIVEN,
    )  # fmt: skip


def _nuplan_metric(kind: str, meaning: str) -> Metric:
    (unit, low, high), signal = NUPLAN_BOUNDS[kind], filters.NUPLAN[kind]
    return Metric(
        f"{kind}_nuplan", unit, "lower", (Mode.CLOSED,),
        partial(_filtered, signal, filters.NUPLAN_STEP_S, filters.NUPLAN_LEAST_S),
        (MAX_ABS, *out_of_bounds(low, high)), meaning,
        "nuPlan devkit e9241677, ego_is_comfortable; there at the ego's centre",
        formula=filters.NUPLAN_FORMULAE[kind], parameters=(_bounds(low, high, unit), f"step {filters.NUPLAN_STEP_S} s"),
        needs=f"a drive of {filters.NUPLAN_LEAST_S} s",
    )  # fmt: skip


LON_ACCEL = _metric(
    "lon_accel", lon_accel, NUPLAN_BOUNDS["lon_accel"],
    "Acceleration along the body; min is the hardest braking.", "a, the state's",
    extra=(replace(MIN, direction="higher"), MAX),
)  # fmt: skip
LAT_ACCEL = _metric(
    "lat_accel", lat_accel, NUPLAN_BOUNDS["lat_accel"], "Lateral acceleration at the rear axle.", "v^2 kappa"
)
LON_JERK_STATE = _metric(
    "lon_jerk_state", lon_jerk, NUPLAN_BOUNDS["lon_jerk"],
    "Backward difference of the state's acceleration.", "(a(t) - a(t - W)) / W",
)  # fmt: skip
LAT_JERK_STATE = _metric(
    "lat_jerk_state", lat_jerk, ("m/s3", -R79_JERK_MPS3, R79_JERK_MPS3),
    "Backward difference of the lateral acceleration.", "(v^2 kappa (t) - v^2 kappa (t - W)) / W", source=_R79,
)  # fmt: skip
JERK_STATE = _metric(
    "jerk_state", jerk, NUPLAN_BOUNDS["jerk"], "Size of the change of the acceleration vector in the world.",
    "|A(t) - A(t - W)| / W, A = a (cos yaw, sin yaw) + v^2 kappa (-sin yaw, cos yaw)",
    source=f"{_NUPLAN}, which takes d|A|/dt",
)  # fmt: skip
YAW_RATE = _metric(
    "yaw_rate", yaw_rate, NUPLAN_BOUNDS["yaw_rate"], "Backward difference of the heading.",
    "(yaw(t) - yaw(t - W)) / W",
)  # fmt: skip
YAW_ACCEL = _metric(
    "yaw_accel", yaw_accel, NUPLAN_BOUNDS["yaw_accel"], "Second backward difference of the heading.",
    "(yaw(t) - 2 yaw(t - W) + yaw(t - 2 W)) / W^2",
)  # fmt: skip
NUPLAN = (
    _nuplan_metric("lon_accel", "Acceleration along the body, as nuPlan filters it."),
    _nuplan_metric("lat_accel", "Lateral acceleration, as nuPlan filters it."),
    _nuplan_metric("lon_jerk", "Longitudinal jerk, as nuPlan filters it: a cascade of 2.2 s."),
    _nuplan_metric("jerk", "Rate of the size of the acceleration, as nuPlan filters it: turning it counts nothing."),
    _nuplan_metric("yaw_rate", "Yaw rate, as nuPlan filters it."),
    _nuplan_metric("yaw_accel", "Yaw acceleration, as nuPlan filters it."),
)
LAT_JERK_R79 = Metric(
    "lat_jerk_r79", "m/s3", "lower", (Mode.CLOSED,),
    partial(_filtered, filters.r79_jerk, filters.R79_STEP_S, filters.R79_MEAN_S),
    (MAX_ABS, *out_of_bounds(-R79_JERK_MPS3, R79_JERK_MPS3)),
    "Lateral jerk as UN R79 measures it: low-pass, derivative, moving mean.", "UN R79 (read at second hand)",
    formula="mean over 0.5 s of dB/dt = (B(t) - B(t - 0.5 s)) / 0.5 s, B = Butterworth low-pass of v^2 kappa",
    parameters=(f"bound {R79_JERK_MPS3:g} m/s3", "order 4", "cut-off 0.5 Hz", "rate 100 Hz"), needs="a drive of 0.5 s",
)  # fmt: skip
