"""Comfort of the drive, and effort of its control: accelerations, jerk, yaw rate; `proposals` has
that of plans.

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

Effort of the control: pedals, steering, solver iterations and fallbacks of a drive, and its
tracking errors.

Pedals are measured as commanded (actuator lags let one pedal rise while the other falls). Tracking
errors are `Trace.tracking`: deviations of the vehicle from the plan.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.plan import SolverReport
from replan.logs.scenario import Scenario
from replan.logs.states import Controls, Trajectory
from replan.logs.trace import Mode, Trace
from replan.metrics import metric
from replan.metrics.boxes import phantoms
from replan.metrics.metric import (
    Direction,
    Measured,
    Metric,
    Reduction,
    Series,
    Unavailable,
    where_followed,
)
from replan.metrics.plans import NO_PLANS, frame_times
from replan.metrics.safety import TTC

WINDOW_S = 0.1
# Labels name the road user of the least TTC in the last CAUSE_S, if below CAUSE_TTC_S
CAUSE_S, CAUSE_TTC_S = 2.0, 4.0
# With fewer than 5 samples, nuPlan's polynomials are undefined
NUPLAN_STEP_S, NUPLAN_LEAST_S = 0.1, 0.4
NUPLAN_AHEAD_S = 0.7  # Half of the longest of nuPlan's windows
R79_STEP_S, R79_MEAN_S, R79_CUT_HZ, R79_ORDER = 0.01, 0.5, 0.5, 4
R79_BOUNDS = ("m/s3", -5.0, 5.0)
NUPLAN_BOUNDS = {
    "lon_accel": ("m/s2", -4.05, 2.40),
    "lat_accel": ("m/s2", -4.89, 4.89),
    "lon_jerk": ("m/s3", -4.13, 4.13),
    "jerk": ("m/s3", -8.37, 8.37),
    "yaw_rate": ("rad/s", -0.95, 0.95),
    "yaw_accel": ("rad/s2", -1.93, 1.93),
}
"""Unit, least and greatest value of each signal."""
Signal = Callable[[Trajectory], FloatArray]


def lat_accel(drive: Trajectory) -> FloatArray:
    """Return (1), `(n,)`, m/s2, positive to the left."""
    return np.asarray(drive.v**2 * drive.kappa)


def jerk(drive: Trajectory) -> FloatArray:
    """Return (3), `(n,)`, m/s3."""
    c, s, aside = np.cos(drive.yaw), np.sin(drive.yaw), lat_accel(drive)
    x, y = drive.a * c - aside * s, drive.a * s + aside * c
    return np.hypot(
        metric.rate_of_change(drive.t, x, WINDOW_S), metric.rate_of_change(drive.t, y, WINDOW_S)
    )


def yaw_accel(drive: Trajectory) -> FloatArray:
    """Return yaw_accel (4), `(n,)`, rad/s2; NaN in the first two windows."""
    before, start = (np.interp(drive.t - k * WINDOW_S, drive.t, drive.yaw) for k in (1, 2))
    known = drive.t - 2.0 * WINDOW_S >= drive.t[0] - 1e-9
    return np.where(known, (drive.yaw - 2.0 * before + start) / WINDOW_S**2, np.nan)


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


def r79_jerk(drive: Trajectory) -> FloatArray:
    """Return (9) of a drive with steps of `R79_STEP_S`; NaN in the first 0.5 s."""
    from scipy.signal import butter, sosfilt, sosfilt_zi

    lateral, sections = (
        lat_accel(drive),
        butter(R79_ORDER, R79_CUT_HZ, fs=1.0 / R79_STEP_S, output="sos"),
    )
    low, _ = sosfilt(sections, lateral, zi=sosfilt_zi(sections) * lateral[0])  # (8)
    return metric.rate_of_change(drive.t, np.asarray(low), R79_MEAN_S)  # (9)


def _driven_signal(signal: Signal, trace: Trace, scenario: Scenario) -> Measured:
    return Series(trace.ego.t, signal(trace.ego), missing=f"the drive is shorter than {WINDOW_S} s")


def _with_cause(
    measure: Callable[[Trace, Scenario], Measured],
    bounds: tuple[str, float, float],
    ahead: float,
    trace: Trace,
    scenario: Scenario,
) -> Measured:
    """Measure; label steps out of bounds with the road user of the least TTC from `CAUSE_S` before
    to `ahead` s later.

    `ahead` is how far a filter sees ahead, s: a signal that is filtered so changes before its
    cause.
    """
    found, ttc = measure(trace, scenario), TTC.found(trace, scenario)
    if not isinstance(found, Series) or not isinstance(ttc, Series):
        return found
    labels, times = [""] * len(found.t), np.where(ttc.value <= CAUSE_TTC_S, ttc.value, np.inf)
    for k in np.flatnonzero((found.value < bounds[1]) | (found.value > bounds[2])).tolist():
        first, end = np.searchsorted(
            ttc.t, found.t[k] + np.array([-CAUSE_S, ahead + 1e-9])
        ).tolist()
        least = first + int(np.argmin(times[first : max(end, first + 1)]))
        labels[k] = ttc.labels[least] if np.isfinite(times[least]) else ""
    return replace(found, labels=tuple(labels))


def _filtered_signal(
    signal: Signal, step: float, least: float, trace: Trace, scenario: Scenario
) -> Measured:
    """Measure a signal of the drive, resampled linearly every `step` s from its start."""
    length = float(trace.ego.t[-1] - trace.ego.t[0])
    if length < least - 1e-9:
        return Unavailable(f"the drive is shorter than {least} s")
    drive = trace.ego.resampled(trace.ego.t[0] + step * np.arange(int((length + 1e-9) / step) + 1))
    return Series(drive.t, signal(drive))


def _as_text(bounds: tuple[str, float, float]) -> str:
    """Write the bounds as a parameter of the metric."""
    unit, low, high = bounds
    return f"bounds {low:g} to {high:g} {unit}" if low != -high else f"bound {high:g} {unit}"


def _outside(bounds: tuple[str, float, float], *more: Reduction) -> tuple[Reduction, ...]:
    """Return the reductions of a signal: greatest absolute value, `more`, time and longest stretch
    out of bounds.
    """
    _, low, high = bounds
    outside = metric.time_outside(low, high, "time_out_of_bounds"), metric.worst_episode(low, high)
    return metric.MAX_ABS, *more, *outside


def _state_metric(
    name: str,
    signal: Signal,
    bounds: tuple[str, float, float],
    meaning: str,
    formula: str,
    source: str = "bounds: nuPlan devkit e9241677, ego_is_comfortable",
    more: tuple[Reduction, ...] = (),
    *,
    caused: bool = False,
) -> Metric:
    driven = partial(_driven_signal, signal)
    measure = partial(_with_cause, driven, bounds, 0.0) if caused else driven
    return Metric(
        name,
        bounds[0],
        "lower",
        (Mode.CLOSED,),
        measure,
        _outside(bounds, metric.P95, metric.P99, *more),
        meaning,
        source,
        2,
        formula=formula,
        parameters=(_as_text(bounds), f"W {WINDOW_S} s"),
        needs=f"a drive of {WINDOW_S} s",
    )


LON_ACCEL = _state_metric(
    "lon_accel",
    lambda drive: drive.a,
    NUPLAN_BOUNDS["lon_accel"],
    "Acceleration along the body; min is the hardest braking.",
    "a, the state's",
    more=(replace(metric.MIN, direction="higher"), metric.MAX),
    caused=True,
)
LAT_ACCEL = _state_metric(
    "lat_accel",
    lat_accel,
    NUPLAN_BOUNDS["lat_accel"],
    "Lateral acceleration at the rear axle.",
    "v^2 kappa",
)
LON_JERK_STATE = _state_metric(
    "lon_jerk_state",
    lambda drive: metric.rate_of_change(drive.t, drive.a, WINDOW_S),
    NUPLAN_BOUNDS["lon_jerk"],
    "Backward difference of the state's acceleration.",
    "(a(t) - a(t - W)) / W",
    caused=True,
)
LAT_JERK_STATE = _state_metric(
    "lat_jerk_state",
    lambda drive: metric.rate_of_change(drive.t, lat_accel(drive), WINDOW_S),
    R79_BOUNDS,
    "Backward difference of the lateral acceleration.",
    "(v^2 kappa (t) - v^2 kappa (t - W)) / W",
    "bound: UN R79, there on a filtered signal",
)
JERK_STATE = _state_metric(
    "jerk_state",
    jerk,
    NUPLAN_BOUNDS["jerk"],
    "Size of the change of the acceleration vector in the world.",
    "|A(t) - A(t - W)| / W, A = a (cos yaw, sin yaw) + v^2 kappa (-sin yaw, cos yaw)",
    "bounds: nuPlan devkit e9241677, ego_is_comfortable, which takes d|A|/dt",
)
YAW_RATE = _state_metric(
    "yaw_rate",
    lambda drive: metric.rate_of_change(drive.t, drive.yaw, WINDOW_S),
    NUPLAN_BOUNDS["yaw_rate"],
    "Backward difference of the heading.",
    "(yaw(t) - yaw(t - W)) / W",
)
YAW_ACCEL = _state_metric(
    "yaw_accel",
    yaw_accel,
    NUPLAN_BOUNDS["yaw_accel"],
    "Second backward difference of the heading.",
    "(yaw(t) - 2 yaw(t - W) + yaw(t - 2 W)) / W^2",
)
NUPLAN = tuple(
    Metric(
        f"{kind}_nuplan",
        NUPLAN_BOUNDS[kind][0],
        "lower",
        (Mode.CLOSED,),
        partial(
            _with_cause,
            partial(_filtered_signal, signal, NUPLAN_STEP_S, NUPLAN_LEAST_S),
            NUPLAN_BOUNDS[kind],
            NUPLAN_AHEAD_S,
        ),
        _outside(NUPLAN_BOUNDS[kind]),
        f"{what}, as nuPlan filters it{aside}.",
        "nuPlan devkit e9241677, ego_is_comfortable; there at the ego's centre",
        formula=formula,
        parameters=(_as_text(NUPLAN_BOUNDS[kind]), f"step {NUPLAN_STEP_S} s"),
        needs=f"a drive of {NUPLAN_LEAST_S} s",
    )
    for kind, what, aside, signal, formula in (
        (
            "lon_accel",
            "Acceleration along the body",
            "",
            lambda drive: savgol(drive.a, 8, 2),
            "SG(8, 2) of a",
        ),
        (
            "lat_accel",
            "Lateral acceleration",
            "",
            lambda drive: savgol(lat_accel(drive), 8, 2),
            "SG(8, 2) of v^2 kappa",
        ),
        (
            "lon_jerk",
            "Longitudinal jerk",
            ": a cascade of 2.2 s",
            lambda drive: _derivative(savgol(drive.a, 8, 2), 15, 2, 1, drive),
            "SG'(15, 2) of SG(8, 2) of a",
        ),
        (
            "jerk",
            "Rate of the size of the acceleration",
            ": turning it counts nothing",
            lambda drive: _derivative(
                savgol(np.hypot(drive.a, lat_accel(drive)), 8, 2), 15, 2, 1, drive
            ),
            "SG'(15, 2) of SG(8, 2) of hypot(a, v^2 kappa)",
        ),
        (
            "yaw_rate",
            "Yaw rate",
            "",
            lambda drive: _derivative(drive.yaw, 5, 2, 1, drive),
            "SG'(5, 2) of yaw",
        ),
        (
            "yaw_accel",
            "Yaw acceleration",
            "",
            lambda drive: _derivative(drive.yaw, 5, 3, 2, drive),
            "SG''(5, 3) of yaw",
        ),
    )
)
LAT_JERK_R79 = Metric(
    "lat_jerk_r79",
    "m/s3",
    "lower",
    (Mode.CLOSED,),
    partial(_filtered_signal, r79_jerk, R79_STEP_S, R79_MEAN_S),
    _outside(R79_BOUNDS),
    "Lateral jerk as UN R79 measures it: low-pass, derivative, moving mean.",
    "UN R79 (read at second hand)",
    formula=(
        "mean over 0.5 s of dB/dt = (B(t) - B(t - 0.5 s)) / 0.5 s, B = Butterworth low-pass of "
        "v^2 kappa"
    ),
    parameters=(_as_text(R79_BOUNDS), "order 4", "cut-off 0.5 Hz", "rate 100 Hz"),
    needs="a drive of 0.5 s",
)


PRESSED = 1e-6  # A pedal is pressed if its command exceeds this
_BOTH = (Mode.OPEN, Mode.CLOSED)


def _both_pressed(commands: Controls) -> FloatArray:
    less = np.minimum(commands.throttle, commands.brake)
    return np.where(np.isfinite(less), less > PRESSED, np.nan)


def _switches(commands: Controls) -> FloatArray:
    """Mark with 1 each step that presses another pedal than the one pressed last, also after
    coasting.
    """
    pedal = np.where(commands.brake > PRESSED, -1, np.where(commands.throttle > PRESSED, 1, 0))
    pressed = np.flatnonzero(pedal)
    switches = np.zeros(len(commands))
    switches[pressed[1:]] = pedal[pressed[1:]] != pedal[pressed[:-1]]
    return switches


def _of_commands(
    value: Callable[[Controls], FloatArray], trace: Trace, scenario: Scenario
) -> Measured:
    if trace.commands is None or not len(trace.commands):
        return Unavailable("the drive has no commands")
    return Series(trace.commands.t, value(trace.commands))


def _steer_rate(trace: Trace, scenario: Scenario) -> Measured:
    controls = trace.actuation if trace.actuation is not None else trace.commands
    if controls is None or not len(controls):
        return Unavailable("the drive has no commands")
    rate = metric.rate_of_change(controls.t, controls.steer, WINDOW_S)
    return Series(controls.t, rate, missing=f"the drive is shorter than {WINDOW_S} s")


def _reports(trace: Trace) -> list[tuple[SolverReport, ...]]:
    """All solver reports of each frame."""
    return [
        tuple(item for item in f.plan.internals if isinstance(item, SolverReport))
        for f in trace.frames
    ]


def _iterations(trace: Trace, scenario: Scenario) -> Unavailable | Mapping[str, Measured]:
    frames, found = _reports(trace), {}
    for stage in sorted({report.stage for reports in frames for report in reports}):
        counts = [
            [report.iterations for report in reports if report.stage == stage] for reports in frames
        ]
        values = np.array([float(max(count)) if count else np.nan for count in counts])
        found[stage] = Series(frame_times(trace), values)
    return found or Unavailable("the plans hold no solver reports")


def _unsolved_frames(trace: Trace, scenario: Scenario) -> Measured:
    frames = _reports(trace)
    if not any(frames):
        return Unavailable("the plans hold no solver reports")
    failures = [[f"{r.stage}: {r.status}" for r in reports if not r.solved] for reports in frames]
    counts = np.array([float(len(failed)) for failed in failures])
    return Series(frame_times(trace), counts, tuple("; ".join(failed) for failed in failures))


@where_followed
def _fallback(trace: Trace, scenario: Scenario) -> Measured:
    if not trace.frames:
        return NO_PLANS
    t, plans = frame_times(trace), [frame.plan for frame in trace.frames]
    labels = [f"{p.status.value}: {p.reason}" if p.status.is_fallback else "" for p in plans]
    fallbacks = np.array([float(p.status.is_fallback) for p in plans])
    for phantom in phantoms(scenario):
        fallbacks[(fallbacks > 0.0) & (phantom.t_from < t) & (t < phantom.t_to)] = np.nan
    return Series(t, fallbacks, tuple(labels), "the log shows a phantom at each fallback")


@where_followed
def _tracking_error(column: str, trace: Trace, scenario: Scenario) -> Measured:
    if trace.tracking is None or not len(trace.tracking.t):
        return Unavailable("the drive has no tracking errors: no controller was in it")
    return Series(trace.tracking.t, getattr(trace.tracking, column))


def _pedals(
    name: str,
    value: Callable[[Controls], FloatArray],
    unit: str,
    direction: Direction,
    reductions: tuple[Reduction, ...],
    meaning: str,
    formula: str,
) -> Metric:
    return Metric(
        name,
        unit,
        direction,
        (Mode.CLOSED,),
        partial(_of_commands, value),
        reductions,
        meaning,
        formula=formula,
        parameters=(f"pressed above {PRESSED:g}",) if unit == "count" else (),
        needs="commands of a controller",
    )


_USED = (metric.MEAN, metric.MAX)
EFFORT = (
    _pedals(
        "throttle",
        lambda commands: commands.throttle,
        "1",
        "none",
        _USED,
        "Commanded throttle.",
        "throttle",
    ),
    _pedals(
        "brake", lambda commands: commands.brake, "1", "none", _USED, "Commanded brake.", "brake"
    ),
    _pedals(
        "pedals_together",
        _both_pressed,
        "count",
        "lower",
        (metric.COUNT,),
        "Steps that command throttle and brake at once.",
        "sum of 1 where both are pressed",
    ),
    _pedals(
        "pedal_switches",
        _switches,
        "count",
        "lower",
        (metric.COUNT,),
        "Changes from throttle to brake or back.",
        "sum of 1 where the other pedal than the last one is pressed",
    ),
    Metric(
        "steer_rate",
        "rad/s",
        "lower",
        (Mode.CLOSED,),
        _steer_rate,
        (metric.MAX_ABS, metric.P95),
        "Backward difference of the front wheel angle over 0.1 s, as actuated, else as commanded.",
        formula="(steer(t) - steer(t - W)) / W",
        parameters=(f"W {WINDOW_S} s",),
        needs="commands of a controller",
    ),
    Metric(
        "qp_iterations",
        "count",
        "lower",
        _BOTH,
        _iterations,
        (metric.MEAN, metric.P95, metric.MAX),
        "Solver iterations per frame and stage, the largest where a stage solves several times.",
        parts=("*",),
        formula="max over a frame's calls of a stage",
        needs="solver reports in the plans",
    ),
    Metric(
        "solver_unsolved",
        "count",
        "lower",
        _BOTH,
        _unsolved_frames,
        (metric.COUNT,),
        "Solver calls that did not end solved.",
        formula="sum of calls that are not solved",
        needs="solver reports in the plans",
    ),
    Metric(
        "fallback",
        "1",
        "lower",
        _BOTH,
        _fallback,
        (replace(metric.RATE, empty=None),),
        "Share of the frames whose plan is a fallback; fallbacks while the log shows a phantom do "
        "not count.",
        formula="1 where the status is a fallback, else 0",
        needs="plans, and lanes or a path that the vehicle can follow",
    ),
)
TRACKING = tuple(
    Metric(
        f"tracking_{column}",
        unit,
        "lower",
        (Mode.CLOSED,),
        partial(_tracking_error, column),
        (metric.RMS, metric.MAX_ABS, metric.P95),
        f"{meaning}.",
        formula=formula,
        needs="a controller in the drive",
    )
    for column, unit, meaning, formula in (
        (
            "lateral",
            "m",
            "Distance of the ego from the plan's path, positive to the left",
            "(p - foot) . n",
        ),
        (
            "heading",
            "rad",
            "Heading of the ego minus that of the plan's path, principal value",
            "wrap(yaw - yaw_path)",
        ),
        ("speed", "m/s", "Speed of the ego minus the plan's at the same time", "v - v_plan(t)"),
        (
            "station",
            "m",
            "Station of the ego minus the plan's at the same time, along the path",
            "s - s_plan(t)",
        ),
    )
)
