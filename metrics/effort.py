"""Control effort: pedals, steering, solver iterations and fallbacks of a drive, and its tracking errors.

Pedals are measured as commanded (actuator lags let one pedal rise while the other falls). Tracking errors are
`Trace.tracking`: deviations of the vehicle from the plan.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from logs.arrays import FloatArray
from logs.plan import SolverReport
from logs.scenario import Scenario
from logs.states import Controls
from logs.trace import Mode, Trace
from metrics import metric
from metrics.boxes import phantoms
from metrics.comfort import WINDOW_S
from metrics.metric import Direction, Measured, Metric, Reduction, Series, Unavailable, where_followed
from metrics.plans import NO_PLANS, frame_times

PRESSED = 1e-6  # A pedal is pressed if its command exceeds this
_BOTH = (Mode.OPEN, Mode.CLOSED)


def _both_pressed(commands: Controls) -> FloatArray:
    less = np.minimum(commands.throttle, commands.brake)
    return np.where(np.isfinite(less), less > PRESSED, np.nan)


def _switches(commands: Controls) -> FloatArray:
    """Mark with 1 each step that presses another pedal than the one pressed last, also after coasting."""
    pedal = np.where(commands.brake > PRESSED, -1, np.where(commands.throttle > PRESSED, 1, 0))
    pressed = np.flatnonzero(pedal)
    switches = np.zeros(len(commands))
    switches[pressed[1:]] = pedal[pressed[1:]] != pedal[pressed[:-1]]
    return switches


def _of_commands(value: Callable[[Controls], FloatArray], trace: Trace, scenario: Scenario) -> Measured:
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
    return [tuple(item for item in f.plan.internals if isinstance(item, SolverReport)) for f in trace.frames]


def _iterations(trace: Trace, scenario: Scenario) -> Unavailable | Mapping[str, Measured]:
    frames, found = _reports(trace), {}
    for stage in sorted({report.stage for reports in frames for report in reports}):
        counts = [[report.iterations for report in reports if report.stage == stage] for reports in frames]
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
    name: str, value: Callable[[Controls], FloatArray], unit: str, direction: Direction,
    reductions: tuple[Reduction, ...], meaning: str, formula: str,
) -> Metric:  # fmt: skip
    return Metric(
        name, unit, direction, (Mode.CLOSED,), partial(_of_commands, value), reductions, meaning, formula=formula,
        parameters=(f"pressed above {PRESSED:g}",) if unit == "count" else (), needs="commands of a controller",
    )  # fmt: skip


_USED = (metric.MEAN, metric.MAX)
EFFORT = (
    _pedals("throttle", lambda commands: commands.throttle, "1", "none", _USED, "Commanded throttle.", "throttle"),
    _pedals("brake", lambda commands: commands.brake, "1", "none", _USED, "Commanded brake.", "brake"),
    _pedals(
        "pedals_together", _both_pressed, "count", "lower", (metric.COUNT,),
        "Steps that command throttle and brake at once.", "sum of 1 where both are pressed",
    ),
    _pedals(
        "pedal_switches", _switches, "count", "lower", (metric.COUNT,), "Changes from throttle to brake or back.",
        "sum of 1 where the other pedal than the last one is pressed",
    ),
    Metric(
        "steer_rate", "rad/s", "lower", (Mode.CLOSED,), _steer_rate, (metric.MAX_ABS, metric.P95),
        "Backward difference of the front wheel angle over 0.1 s, as actuated, else as commanded.",
        formula="(steer(t) - steer(t - W)) / W", parameters=(f"W {WINDOW_S} s",), needs="commands of a controller",
    ),
    Metric(
        "qp_iterations", "count", "lower", _BOTH, _iterations, (metric.MEAN, metric.P95, metric.MAX),
        "Solver iterations per frame and stage, the largest where a stage solves several times.", parts=("*",),
        formula="max over a frame's calls of a stage", needs="solver reports in the plans",
    ),
    Metric(
        "solver_unsolved", "count", "lower", _BOTH, _unsolved_frames, (metric.COUNT,),
        "Solver calls that did not end solved.",
        formula="sum of calls that are not solved", needs="solver reports in the plans",
    ),
    Metric(
        "fallback", "1", "lower", _BOTH, _fallback, (replace(metric.RATE, empty=None),),
        "Share of the frames whose plan is a fallback; fallbacks while the log shows a phantom do not count.",
        formula="1 where the status is a fallback, else 0",
        needs="plans, and lanes or a path that the vehicle can follow",
    ),
)  # fmt: skip
TRACKING = tuple(
    Metric(
        f"tracking_{column}", unit, "lower", (Mode.CLOSED,), partial(_tracking_error, column),
        (metric.RMS, metric.MAX_ABS, metric.P95), f"{meaning}.", formula=formula, needs="a controller in the drive",
    )
    for column, unit, meaning, formula in (
        ("lateral", "m", "Distance of the ego from the plan's path, positive to the left", "(p - foot) . n"),
        ("heading", "rad", "Heading of the ego minus that of the plan's path, principal value", "wrap(yaw - yaw_path)"),
        ("speed", "m/s", "Speed of the ego minus the plan's at the same time", "v - v_plan(t)"),
        ("station", "m", "Station of the ego minus the plan's at the same time, along the path", "s - s_plan(t)"),
    )
)  # fmt: skip
