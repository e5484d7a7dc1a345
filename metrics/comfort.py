"""Comfort: accelerations, jerk, yaw rate; of the drive in closed loop, of the plans in open loop.

State signals, not filtered (in simulation they are free of noise), differentiated by one declared rule:
`metric.changed`, the backward difference over W = 0.1 s.

(1) a_lat = v^2 kappa,  at the rear axle
(2) lon_jerk_state = (a(t) - a(t - W)) / W,  lat_jerk_state the same of a_lat
(3) jerk_state = |A(t) - A(t - W)| / W,  A the acceleration vector (a, a_lat) turned into the world
(4) yaw_rate = (yaw(t) - yaw(t - W)) / W,  yaw_accel = (yaw(t) - 2 yaw(t - W) + yaw(t - 2 W)) / W^2

Beside them the filtered signals of nuPlan and UN R79, for logs with noise and for their publishers' scores. SG(w, p) is
the smoothing filter of Savitzky and Golay over w samples with polynomials of degree p, SG' and SG'' the derivatives of
its polynomials (`scipy.signal.savgol_filter`); a window longer than the drive is cut to it.

nuPlan (devkit e9241677, state_extractors.py), the drive sampled every 0.1 s:

(5) lon_accel = SG(8, 2) of a,  lat_accel = SG(8, 2) of a_lat
(6) lon_jerk = SG'(15, 2) of SG(8, 2) of a,  jerk = SG'(15, 2) of SG(8, 2) of hypot(a, a_lat)
(7) yaw_rate = SG'(5, 2) of yaw,  yaw_accel = SG''(5, 3) of yaw

The even window shifts the signal by half a sample; (6) is d|a|/dt and not |da/dt|. Both are nuPlan's. The cascade (6)
spans 2.2 s: it sees 2.9 of a ramp of 6 m/s3, and 6.3 where the log is cut after it.

UN R79 (lateral jerk of automated lane changes), the drive sampled every 0.01 s:

(8) B = a_lat through a causal Butterworth low-pass of 4th order at 0.5 Hz, at rest on its first value
(9) lat_jerk = mean of dB/dt over 0.5 s = (B(t) - B(t - 0.5 s)) / 0.5 s

A drive is judged by its time out of bounds and the longest stretch of it: both are the same for one slam in 20 s and in
120 s; percentiles over the whole drive, which are shown too, are not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from logs.frame_store import loaded
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
    Measure,
    Measured,
    Metric,
    Reduction,
    Series,
    Unavailable,
    changed,
    out_of_bounds,
)
from metrics.plans import frame_times

WINDOW_S = 0.1
PLAN_HORIZON_S = 5.0
NUPLAN_STEP_S, NUPLAN_LEAST_S = 0.1, 0.4
"""Below 5 samples nuPlan's polynomials are not defined."""
R79_STEP_S, R79_MEAN_S, R79_CUT_HZ, R79_ORDER = 0.01, 0.5, 0.5, 4
_R79_BOUNDS = ("m/s3", -5.0, 5.0)
NUPLAN_BOUNDS = {
    "lon_accel": ("m/s2", -4.05, 2.40),
    "lat_accel": ("m/s2", -4.89, 4.89),
    "lon_jerk": ("m/s3", -4.13, 4.13),
    "jerk": ("m/s3", -8.37, 8.37),
    "yaw_rate": ("rad/s", -0.95, 0.95),
    "yaw_accel": ("rad/s2", -1.93, 1.93),
}
"""Unit, least and greatest value."""
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


def _savgol(value: FloatArray, window: int, degree: int, order: int = 0, step: float = 1.0) -> FloatArray:
    """SG, SG' or SG'' (`order` 0, 1, 2) of samples `step` s apart."""
    from scipy.signal import savgol_filter  # here: its import takes longer than that of all metrics

    return np.asarray(savgol_filter(value, min(window, len(value)), degree, deriv=order, delta=step))


def _nuplan_jerk(value: Signal, drive: Trajectory) -> FloatArray:
    """(6) of an acceleration."""
    return _savgol(_savgol(value(drive), 8, 2), 15, 2, 1, float(np.mean(np.diff(drive.t))))


def _nuplan_yaw(degree: int, order: int, drive: Trajectory) -> FloatArray:
    """(7)."""
    return _savgol(drive.yaw, 5, degree, order, float(np.mean(np.diff(drive.t))))


def r79_jerk(drive: Trajectory) -> FloatArray:
    """(9) of a drive with steps of `R79_STEP_S`; NaN in the first 0.5 s."""
    from scipy.signal import butter, sosfilt, sosfilt_zi

    sections = butter(R79_ORDER, R79_CUT_HZ, fs=1.0 / R79_STEP_S, output="sos")
    lateral = lat_accel(drive)
    low, _ = sosfilt(sections, lateral, zi=sosfilt_zi(sections) * lateral[0])  # (8)
    return changed(drive.t, np.asarray(low), R79_MEAN_S)  # (9)


def _driven(signal: Signal, trace: Trace, scenario: Scenario) -> Measured:
    return Series(trace.ego.t, signal(trace.ego), missing=f"the drive is shorter than {WINDOW_S} s")


def _filtered(signal: Signal, step: float, least: float, trace: Trace, scenario: Scenario) -> Measured:
    """The signal of the drive resampled to `step` s from its start, linear between its samples."""
    first, length = trace.ego.t[0], float(trace.ego.t[-1] - trace.ego.t[0])
    if length < least - 1e-9:
        return Unavailable(f"the drive is shorter than {least} s")
    drive = trace.ego.resampled(first + step * np.arange(int((length + 1e-9) / step) + 1))
    return Series(drive.t, signal(drive))


def _planned(signal: Signal, trace: Trace, scenario: Scenario) -> Measured:
    """Per frame the signal of largest size in the plan's first 5 s."""
    if not trace.frames:
        return Unavailable("the drive has no plans")
    worst = np.full(len(trace.frames), np.nan)
    for i, frame in enumerate(trace.frames):
        path = loaded(frame.plan.trajectory)
        values = np.abs(signal(path))[path.t <= frame.t + PLAN_HORIZON_S + 1e-9]
        if np.isfinite(values).any():
            worst[i] = np.nanmax(values)
    return Series(frame_times(trace), worst, missing=f"the plans are shorter than {WINDOW_S} s")


def _bounded(
    name: str, measure: Measure, bounds: tuple[str, float, float], more: tuple[Reduction, ...], meaning: str,
    formula: str, source: str, parameters: tuple[str, ...], needs: str, version: int = 1,
) -> Metric:  # fmt: skip
    """A signal of the drive with its time out of bounds."""
    unit, low, high = bounds
    asked = f"bounds {low:g} to {high:g} {unit}" if low != -high else f"bound {high:g} {unit}"
    return Metric(
        name, unit, "lower", (Mode.CLOSED,), measure, (MAX_ABS, *more, *out_of_bounds(low, high)), meaning, source,
        version, formula=formula, parameters=(asked, *parameters), needs=needs,
    )  # fmt: skip


def _plan_metric(name: str, unit: str, signal: Signal, meaning: str, formula: str) -> Metric:
    return Metric(
        name, unit, "lower", (Mode.OPEN,), partial(_planned, signal), (MEAN, P95, MAX), meaning,
        formula=formula, parameters=(f"horizon {PLAN_HORIZON_S:g} s",), needs="plans",
    )  # fmt: skip


_DEVKIT = "nuPlan devkit e9241677, ego_is_comfortable"
LON_ACCEL, LAT_ACCEL, LON_JERK_STATE, LAT_JERK_STATE, JERK_STATE, YAW_RATE, YAW_ACCEL = (
    _bounded(
        name, partial(_driven, signal), NUPLAN_BOUNDS.get(name.removesuffix("_state"), _R79_BOUNDS), (P95, P99, *more),
        meaning, formula, source or f"bounds: {_DEVKIT}", (f"W {WINDOW_S} s",), f"a drive of {WINDOW_S} s", 2,
    )
    for name, signal, meaning, formula, source, *more in (
        (
            "lon_accel", lon_accel, "Acceleration along the body; min is the hardest braking.", "a, the state's", "",
            replace(MIN, direction="higher"), MAX,
        ),
        ("lat_accel", lat_accel, "Lateral acceleration at the rear axle.", "v^2 kappa", ""),
        (
            "lon_jerk_state", lon_jerk, "Backward difference of the state's acceleration.", "(a(t) - a(t - W)) / W", "",
        ),
        (
            "lat_jerk_state", lat_jerk, "Backward difference of the lateral acceleration.",
            "(v^2 kappa (t) - v^2 kappa (t - W)) / W", "bound: UN R79, there on a filtered signal",
        ),
        (
            "jerk_state", jerk, "Size of the change of the acceleration vector in the world.",
            "|A(t) - A(t - W)| / W, A = a (cos yaw, sin yaw) + v^2 kappa (-sin yaw, cos yaw)",
            f"bounds: {_DEVKIT}, which takes d|A|/dt",
        ),
        ("yaw_rate", yaw_rate, "Backward difference of the heading.", "(yaw(t) - yaw(t - W)) / W", ""),
        (
            "yaw_accel", yaw_accel, "Second backward difference of the heading.",
            "(yaw(t) - 2 yaw(t - W) + yaw(t - 2 W)) / W^2", "",
        ),
    )
)  # fmt: skip
NUPLAN = tuple(
    _bounded(
        f"{kind}_nuplan", partial(_filtered, signal, NUPLAN_STEP_S, NUPLAN_LEAST_S), NUPLAN_BOUNDS[kind], (),
        f"{what}, as nuPlan filters it{aside}.", formula,
        f"{_DEVKIT}; there at the ego's centre", (f"step {NUPLAN_STEP_S} s",),
        f"a drive of {NUPLAN_LEAST_S} s",
    )
    for kind, what, aside, signal, formula in (
        ("lon_accel", "Acceleration along the body", "", lambda drive: _savgol(drive.a, 8, 2), "SG(8, 2) of a"),
        (
            "lat_accel", "Lateral acceleration", "", lambda drive: _savgol(lat_accel(drive), 8, 2),
            "SG(8, 2) of v^2 kappa",
        ),
        (
            "lon_jerk", "Longitudinal jerk", ": a cascade of 2.2 s", partial(_nuplan_jerk, lon_accel),
            "SG'(15, 2) of SG(8, 2) of a",
        ),
        (
            "jerk", "Rate of the size of the acceleration", ": turning it counts nothing",
            partial(_nuplan_jerk, lambda drive: np.hypot(drive.a, lat_accel(drive))),
            "SG'(15, 2) of SG(8, 2) of hypot(a, v^2 kappa)",
        ),
        ("yaw_rate", "Yaw rate", "", partial(_nuplan_yaw, 2, 1), "SG'(5, 2) of yaw"),
        ("yaw_accel", "Yaw acceleration", "", partial(_nuplan_yaw, 3, 2), "SG''(5, 3) of yaw"),
    )
)  # fmt: skip
LAT_JERK_R79 = _bounded(
    "lat_jerk_r79", partial(_filtered, r79_jerk, R79_STEP_S, R79_MEAN_S), _R79_BOUNDS, (),
    "Lateral jerk as UN R79 measures it: low-pass, derivative, moving mean.",
    "mean over 0.5 s of dB/dt = (B(t) - B(t - 0.5 s)) / 0.5 s, B = Butterworth low-pass of v^2 kappa",
    "UN R79 (read at second hand)", ("order 4", "cut-off 0.5 Hz", "rate 100 Hz"), "a drive of 0.5 s",
)  # fmt: skip
PLAN_LON_ACCEL = _plan_metric(
    "plan_lon_accel", "m/s2", lon_accel, "Largest planned acceleration or braking within 5 s of the frame.", "max |a|"
)
PLAN_LAT_ACCEL = _plan_metric(
    "plan_lat_accel", "m/s2", lat_accel, "Largest planned lateral acceleration within 5 s of the frame.",
    "max |v^2 kappa|",
)  # fmt: skip
PLAN_LON_JERK = _plan_metric(
    "plan_lon_jerk", "m/s3", lon_jerk, "Largest planned longitudinal jerk within 5 s of the frame, over 0.1 s.",
    "max |a(t) - a(t - W)| / W",
)  # fmt: skip
