"""Comfort of the drive: accelerations, jerk, yaw rate, closed loop; `proposals` has that of plans.

Unfiltered state signals (in simulation they are free of noise), with `metric.rate_of_change` over W
= 0.1 s:

(1) a_lat = v^2 kappa,  at the rear axle
(2) lon_jerk_state = (a(t) - a(t - W)) / W,  lat_jerk_state the same of a_lat
(3) jerk_state = |A(t) - A(t - W)| / W,  A the acceleration vector (a, a_lat) in the world frame
(4) yaw_rate = (yaw(t) - yaw(t - W)) / W,  yaw_accel = (yaw(t) - 2 yaw(t - W) + yaw(t - 2 W)) / W^2

Filtered signals, for logs with noise and for the scores of nuPlan (devkit e9241677,
state_extractors.py); the drive is sampled every 0.1 s. SG(w, p) is the Savitzky-Golay filter over w
samples with polynomials of degree p, SG' and SG'' the derivatives of its polynomials
(`scipy.signal.savgol_filter`); a window longer than the drive is shortened to it.

(5) lon_accel = SG(8, 2) of a,  lat_accel = SG(8, 2) of a_lat
(6) lon_jerk = SG'(15, 2) of SG(8, 2) of a,  jerk = SG'(15, 2) of SG(8, 2) of hypot(a, a_lat)
(7) yaw_rate = SG'(5, 2) of yaw,  yaw_accel = SG''(5, 3) of yaw

The even window shifts the signal by half a sample, and (6) is d|a|/dt, not |da/dt|; both as in
nuPlan. The cascade (6) spans 2.2 s: for a ramp of 6 m/s3 it returns 2.9 m/s3, and 6.3 m/s3 if the
log is cut after the ramp.

UN R79 (lateral jerk of automated lane changes), the drive sampled every 0.01 s:

(8) B = a_lat through a causal Butterworth low-pass of 4th order at 0.5 Hz,
        initialised with its first value
(9) lat_jerk = mean of dB/dt over 0.5 s = (B(t) - B(t - 0.5 s)) / 0.5 s

A drive is judged by its time out of bounds and by the longest such stretch: neither depends on the
drive's length. Each bound applies to the signal that its source filters: (6) along, (9) across. The
drive of a recorded human jitters, and (2) is beyond the bounds for seconds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from typing import NamedTuple

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.trace import Trace
from replan.metrics.metric import (
    Measured,
    Metric,
    Reduction,
    Series,
    Unavailable,
    metric,
    rate_of_change,
)
from replan.metrics.reductions import MAX, MAX_ABS, MIN, P95, P99, time_outside, worst_episode
from replan.metrics.time_to_collision import ttc

WINDOW_S = 0.1
# Labels name the road user of the least TTC in the last CAUSE_S, if below CAUSE_TTC_S
CAUSE_S, CAUSE_TTC_S = 2.0, 4.0
# With fewer than 5 samples, nuPlan's polynomials are undefined
NUPLAN_STEP_S, NUPLAN_LEAST_S = 0.1, 0.4
NUPLAN_AHEAD_S = 0.7  # Half of the longest of nuPlan's windows
R79_STEP_S, R79_MEAN_S = 0.01, 0.5
R79_CUT_HZ, R79_ORDER = 0.5, 4


class Bounds(NamedTuple):
    """Unit of a signal, and the least and the greatest value that are comfortable."""

    unit: str
    low: float
    high: float

    def __str__(self) -> str:
        if self.low == -self.high:
            return f"bound {self.high:g} {self.unit}"
        return f"bounds {self.low:g} to {self.high:g} {self.unit}"


R79_BOUNDS = Bounds("m/s3", -5.0, 5.0)
NUPLAN_BOUNDS = {
    "lon_accel": Bounds("m/s2", -4.05, 2.40),
    "lat_accel": Bounds("m/s2", -4.89, 4.89),
    "lon_jerk": Bounds("m/s3", -4.13, 4.13),
    "jerk": Bounds("m/s3", -8.37, 8.37),
    "yaw_rate": Bounds("rad/s", -0.95, 0.95),
    "yaw_accel": Bounds("rad/s2", -1.93, 1.93),
}
Signal = Callable[[Trajectory], FloatArray]


def lateral_acceleration(drive: Trajectory) -> FloatArray:
    """Return (1), `(n,)`, m/s2, positive to the left."""
    return np.asarray(drive.v**2 * drive.kappa)


def savgol(
    value: FloatArray, window: int, degree: int, order: int = 0, step: float = 1.0
) -> FloatArray:
    """Return SG, SG' or SG'' (`order` 0, 1, 2) of samples `step` s apart."""
    # Imported here: it takes longer to import than all metrics
    from scipy.signal import savgol_filter

    return np.asarray(
        savgol_filter(value, min(window, len(value)), degree, deriv=order, delta=step)
    )


def _derivative(
    value: FloatArray, window: int, degree: int, order: int, drive: Trajectory
) -> FloatArray:
    """Return SG' or SG'' of a signal of a drive."""
    return savgol(value, window, degree, order, float(np.mean(np.diff(drive.t))))


def _with_cause(
    measured: Measured, bounds: Bounds, ahead: float, trace: Trace, scenario: Scenario
) -> Measured:
    """Label steps out of bounds with the road user of the least TTC from `CAUSE_S` before to
    `ahead` s later.

    `ahead` is how far a filter sees ahead, s: a signal that is filtered so changes before its
    cause.
    """
    contact_times = ttc(trace, scenario)
    if not isinstance(measured, Series) or not isinstance(contact_times, Series):
        return measured
    labels, times = [""] * len(measured.t), contact_times.value
    times = np.where(times <= CAUSE_TTC_S, times, np.inf)
    outside = (measured.value < bounds.low) | (measured.value > bounds.high)
    for k in np.flatnonzero(outside).tolist():
        window = measured.t[k] + np.array([-CAUSE_S, ahead + 1e-9])
        first, end = np.searchsorted(contact_times.t, window).tolist()
        least = first + int(np.argmin(times[first : max(end, first + 1)]))
        labels[k] = contact_times.labels[least] if np.isfinite(times[least]) else ""
    return replace(measured, labels=tuple(labels))


def _outside(bounds: Bounds, *more: Reduction) -> tuple[Reduction, ...]:
    """Return the reductions of a signal: greatest absolute value, `more`, time and longest stretch
    out of bounds.
    """
    return (
        MAX_ABS,
        *more,
        time_outside(bounds.low, bounds.high, "time_out_of_bounds"),
        worst_episode(bounds.low, bounds.high),
    )


def _state_metric(
    bounds: Bounds,
    source: str = "bounds: nuPlan devkit e9241677, ego_is_comfortable",
    more: tuple[Reduction, ...] = (),
    *,
    caused: bool = False,
) -> Callable[[Signal], Metric]:
    """Make a metric of an unfiltered signal; `caused`: with the road user that is its cause."""

    def decorate(signal: Signal) -> Metric:
        @wraps(signal)
        def measure(trace: Trace, scenario: Scenario) -> Measured:
            missing = f"the drive is shorter than {WINDOW_S} s"
            series = Series(trace.ego.t, signal(trace.ego), missing=missing)
            return _with_cause(series, bounds, 0.0, trace, scenario) if caused else series

        return metric(
            unit=bounds.unit,
            better="lower",
            reductions=_outside(bounds, P95, P99, *more),
            parameters=(str(bounds), f"W {WINDOW_S} s"),
            needs=f"a drive of {WINDOW_S} s",
            source=source,
            version=2,
        )(measure)

    return decorate


@_state_metric(
    NUPLAN_BOUNDS["lon_accel"], more=(replace(MIN, direction="higher"), MAX), caused=True
)
def lon_accel(drive: Trajectory) -> FloatArray:
    """Acceleration along the body; min is the hardest braking.

    Formula: a, the state's
    """
    return drive.a


@_state_metric(NUPLAN_BOUNDS["lat_accel"])
def lat_accel(drive: Trajectory) -> FloatArray:
    """Lateral acceleration at the rear axle.

    Formula: v^2 kappa
    """
    return lateral_acceleration(drive)


@_state_metric(NUPLAN_BOUNDS["lon_jerk"], caused=True)
def lon_jerk_state(drive: Trajectory) -> FloatArray:
    """Backward difference of the state's acceleration.

    Formula: (a(t) - a(t - W)) / W
    """
    return rate_of_change(drive.t, drive.a, WINDOW_S)


@_state_metric(R79_BOUNDS, "bound: UN R79, there on a filtered signal")
def lat_jerk_state(drive: Trajectory) -> FloatArray:
    """Backward difference of the lateral acceleration.

    Formula: (v^2 kappa (t) - v^2 kappa (t - W)) / W
    """
    return rate_of_change(drive.t, lateral_acceleration(drive), WINDOW_S)


@_state_metric(
    NUPLAN_BOUNDS["jerk"], "bounds: nuPlan devkit e9241677, ego_is_comfortable, which takes d|A|/dt"
)
def jerk_state(drive: Trajectory) -> FloatArray:
    """Size of the change of the acceleration vector in the world.

    Formula: |A(t) - A(t - W)| / W, A = a (cos yaw, sin yaw) + v^2 kappa (-sin yaw, cos yaw)
    """
    c, s, aside = np.cos(drive.yaw), np.sin(drive.yaw), lateral_acceleration(drive)
    x, y = drive.a * c - aside * s, drive.a * s + aside * c
    return np.hypot(rate_of_change(drive.t, x, WINDOW_S), rate_of_change(drive.t, y, WINDOW_S))


@_state_metric(NUPLAN_BOUNDS["yaw_rate"])
def yaw_rate(drive: Trajectory) -> FloatArray:
    """Backward difference of the heading.

    Formula: (yaw(t) - yaw(t - W)) / W
    """
    return rate_of_change(drive.t, drive.yaw, WINDOW_S)


@_state_metric(NUPLAN_BOUNDS["yaw_accel"])
def yaw_accel(drive: Trajectory) -> FloatArray:
    """Second backward difference of the heading.

    Formula: (yaw(t) - 2 yaw(t - W) + yaw(t - 2 W)) / W^2
    """
    before, start = (np.interp(drive.t - k * WINDOW_S, drive.t, drive.yaw) for k in (1, 2))
    known = drive.t - 2.0 * WINDOW_S >= drive.t[0] - 1e-9
    return np.where(known, (drive.yaw - 2.0 * before + start) / WINDOW_S**2, np.nan)


def _nuplan_metric(bounds: Bounds) -> Callable[[Signal], Metric]:
    """Make a metric of a signal as nuPlan filters it."""

    def decorate(signal: Signal) -> Metric:
        @wraps(signal)
        def measure(trace: Trace, scenario: Scenario) -> Measured:
            series = _filtered_signal(signal, NUPLAN_STEP_S, NUPLAN_LEAST_S, trace)
            return _with_cause(series, bounds, NUPLAN_AHEAD_S, trace, scenario)

        return metric(
            unit=bounds.unit,
            better="lower",
            reductions=_outside(bounds),
            parameters=(str(bounds), f"step {NUPLAN_STEP_S} s"),
            needs=f"a drive of {NUPLAN_LEAST_S} s",
            source="nuPlan devkit e9241677, ego_is_comfortable; there at the ego's centre",
        )(measure)

    return decorate


def _filtered_signal(signal: Signal, step: float, least: float, trace: Trace) -> Measured:
    """Measure a signal of the drive, resampled linearly every `step` s from its start."""
    length = float(trace.ego.t[-1] - trace.ego.t[0])
    if length < least - 1e-9:
        return Unavailable(f"the drive is shorter than {least} s")
    drive = trace.ego.resampled(trace.ego.t[0] + step * np.arange(int((length + 1e-9) / step) + 1))
    return Series(drive.t, signal(drive))


@_nuplan_metric(NUPLAN_BOUNDS["lon_accel"])
def lon_accel_nuplan(drive: Trajectory) -> FloatArray:
    """Acceleration along the body, as nuPlan filters it.

    Formula: SG(8, 2) of a
    """
    return savgol(drive.a, 8, 2)


@_nuplan_metric(NUPLAN_BOUNDS["lat_accel"])
def lat_accel_nuplan(drive: Trajectory) -> FloatArray:
    """Lateral acceleration, as nuPlan filters it.

    Formula: SG(8, 2) of v^2 kappa
    """
    return savgol(lateral_acceleration(drive), 8, 2)


@_nuplan_metric(NUPLAN_BOUNDS["lon_jerk"])
def lon_jerk_nuplan(drive: Trajectory) -> FloatArray:
    """Longitudinal jerk, as nuPlan filters it: a cascade of 2.2 s.

    Formula: SG'(15, 2) of SG(8, 2) of a
    """
    return _derivative(savgol(drive.a, 8, 2), 15, 2, 1, drive)


@_nuplan_metric(NUPLAN_BOUNDS["jerk"])
def jerk_nuplan(drive: Trajectory) -> FloatArray:
    """Rate of the size of the acceleration, as nuPlan filters it: turning it counts nothing.

    Formula: SG'(15, 2) of SG(8, 2) of hypot(a, v^2 kappa)
    """
    size = savgol(np.hypot(drive.a, lateral_acceleration(drive)), 8, 2)
    return _derivative(size, 15, 2, 1, drive)


@_nuplan_metric(NUPLAN_BOUNDS["yaw_rate"])
def yaw_rate_nuplan(drive: Trajectory) -> FloatArray:
    """Yaw rate, as nuPlan filters it.

    Formula: SG'(5, 2) of yaw
    """
    return _derivative(drive.yaw, 5, 2, 1, drive)


@_nuplan_metric(NUPLAN_BOUNDS["yaw_accel"])
def yaw_accel_nuplan(drive: Trajectory) -> FloatArray:
    """Yaw acceleration, as nuPlan filters it.

    Formula: SG''(5, 3) of yaw
    """
    return _derivative(drive.yaw, 5, 3, 2, drive)


@metric(
    unit="m/s3",
    better="lower",
    reductions=_outside(R79_BOUNDS),
    parameters=(str(R79_BOUNDS), "order 4", "cut-off 0.5 Hz", "rate 100 Hz"),
    needs="a drive of 0.5 s",
    source="UN R79 (read at second hand)",
)
def lat_jerk_r79(trace: Trace, scenario: Scenario) -> Measured:
    """Lateral jerk as UN R79 measures it: low-pass, derivative, moving mean.

    Formula: mean over 0.5 s of dB/dt = (B(t) - B(t - 0.5 s)) / 0.5 s, B = Butterworth low-pass of
    v^2 kappa
    """
    return _filtered_signal(r79_jerk, R79_STEP_S, R79_MEAN_S, trace)


def r79_jerk(drive: Trajectory) -> FloatArray:
    """Return (9) of a drive with steps of `R79_STEP_S`; NaN in the first 0.5 s."""
    from scipy.signal import butter, sosfilt, sosfilt_zi

    lateral = lateral_acceleration(drive)
    sections = butter(R79_ORDER, R79_CUT_HZ, fs=1.0 / R79_STEP_S, output="sos")
    low, _ = sosfilt(sections, lateral, zi=sosfilt_zi(sections) * lateral[0])  # (8)
    return rate_of_change(drive.t, np.asarray(low), R79_MEAN_S)  # (9)
