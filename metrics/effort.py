"""Effort of the control: pedals and steering of a drive, iterations of solvers, and fallbacks.

Pedals are measured as commanded (actuator lags let one pedal rise while the other falls).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from math import nan

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.plan import SolverReport
from replan.logs.scenario import Scenario
from replan.logs.states import Controls
from replan.logs.trace import Trace
from replan.metrics.boxes import phantoms
from replan.metrics.comfort import WINDOW_S
from replan.metrics.metric import (
    BOTH_LOOPS,
    Direction,
    Measured,
    Metric,
    Parts,
    Reduction,
    Series,
    Unavailable,
    metric,
    rate_of_change,
    where_followed,
)
from replan.metrics.plans import NO_PLANS, frame_times
from replan.metrics.reductions import COUNT, MAX, MAX_ABS, MEAN, P95, RATE

PRESSED = 1e-6  # A pedal is pressed if its command exceeds this
_NO_COMMANDS = Unavailable("the drive has no commands")
_NO_REPORTS = Unavailable("the plans hold no solver reports")


def _pedal_metric(
    unit: str, better: Direction, *reductions: Reduction
) -> Callable[[Callable[[Controls], FloatArray]], Metric]:
    """Make a metric of a value of the commands."""

    def decorate(value: Callable[[Controls], FloatArray]) -> Metric:
        @wraps(value)
        def measure(trace: Trace, scenario: Scenario) -> Measured:
            if trace.commands is None or not len(trace.commands):
                return _NO_COMMANDS
            return Series(trace.commands.t, value(trace.commands))

        return metric(
            unit=unit,
            better=better,
            reductions=reductions,
            parameters=(f"pressed above {PRESSED:g}",) if unit == "count" else (),
            needs="commands of a controller",
        )(measure)

    return decorate


@_pedal_metric("1", "none", MEAN, MAX)
def throttle(commands: Controls) -> FloatArray:
    """Commanded throttle.

    Formula: throttle
    """
    return commands.throttle


@_pedal_metric("1", "none", MEAN, MAX)
def brake(commands: Controls) -> FloatArray:
    """Commanded brake.

    Formula: brake
    """
    return commands.brake


@_pedal_metric("count", "lower", COUNT)
def pedals_together(commands: Controls) -> FloatArray:
    """Steps that command throttle and brake at once.

    Formula: sum of 1 where both are pressed
    """
    less = np.minimum(commands.throttle, commands.brake)
    return np.where(np.isfinite(less), less > PRESSED, np.nan)


@_pedal_metric("count", "lower", COUNT)
def pedal_switches(commands: Controls) -> FloatArray:
    """Changes from throttle to brake or back.

    Formula: sum of 1 where the other pedal than the last one is pressed

    Also after coasting.
    """
    pedal = np.where(commands.brake > PRESSED, -1, np.where(commands.throttle > PRESSED, 1, 0))
    pressed = np.flatnonzero(pedal)
    switches = np.zeros(len(commands))
    switches[pressed[1:]] = pedal[pressed[1:]] != pedal[pressed[:-1]]
    return switches


@metric(
    unit="rad/s",
    better="lower",
    reductions=(MAX_ABS, P95),
    parameters=(f"W {WINDOW_S} s",),
    needs="commands of a controller",
)
def steer_rate(trace: Trace, scenario: Scenario) -> Measured:
    """Backward difference of the front wheel angle over 0.1 s, as actuated, else as commanded.

    Formula: (steer(t) - steer(t - W)) / W
    """
    controls = trace.actuation if trace.actuation is not None else trace.commands
    if controls is None or not len(controls):
        return _NO_COMMANDS
    rate = rate_of_change(controls.t, controls.steer, WINDOW_S)
    return Series(controls.t, rate, missing=f"the drive is shorter than {WINDOW_S} s")


def _reports(trace: Trace) -> list[tuple[SolverReport, ...]]:
    """All solver reports of each frame."""
    return [
        tuple(item for item in f.plan.internals if isinstance(item, SolverReport))
        for f in trace.frames
    ]


@metric(
    unit="count",
    better="lower",
    modes=BOTH_LOOPS,
    reductions=(MEAN, P95, MAX),
    parts=("*",),
    needs="solver reports in the plans",
)
def qp_iterations(trace: Trace, scenario: Scenario) -> Unavailable | Parts:
    """Solver iterations per frame and stage, the largest where a stage solves several times.

    Formula: max over a frame's calls of a stage
    """
    frames, t = _reports(trace), frame_times(trace)
    iterations = {}
    for stage in sorted({report.stage for reports in frames for report in reports}):
        of_stage = [
            [report.iterations for report in reports if report.stage == stage] for reports in frames
        ]
        most = [float(max(counts)) if counts else nan for counts in of_stage]
        iterations[stage] = Series(t, np.array(most))
    return iterations or _NO_REPORTS


@metric(
    unit="count",
    better="lower",
    modes=BOTH_LOOPS,
    reductions=(COUNT,),
    needs="solver reports in the plans",
)
def solver_unsolved(trace: Trace, scenario: Scenario) -> Measured:
    """Solver calls that did not end solved.

    Formula: sum of calls that are not solved
    """
    frames = _reports(trace)
    if not any(frames):
        return _NO_REPORTS
    failures = [
        [f"{report.stage}: {report.status}" for report in reports if not report.solved]
        for reports in frames
    ]
    counts = np.array([float(len(failed)) for failed in failures])
    return Series(frame_times(trace), counts, tuple("; ".join(failed) for failed in failures))


@metric(
    unit="1",
    better="lower",
    modes=BOTH_LOOPS,
    reductions=(replace(RATE, empty=None),),
    needs="plans, and lanes or a path that the vehicle can follow",
)
@where_followed
def fallback(trace: Trace, scenario: Scenario) -> Measured:
    """Share of the frames whose plan is a fallback; fallbacks while the log shows a phantom do not
    count.

    Formula: 1 where the status is a fallback, else 0
    """
    if not trace.frames:
        return NO_PLANS
    t, plans = frame_times(trace), [frame.plan for frame in trace.frames]
    labels = [
        f"{plan.status.value}: {plan.reason}" if plan.status.is_fallback else "" for plan in plans
    ]
    fallbacks = np.array([float(plan.status.is_fallback) for plan in plans])
    for phantom in phantoms(scenario):
        fallbacks[(fallbacks > 0.0) & (phantom.t_from < t) & (t < phantom.t_to)] = np.nan
    return Series(t, fallbacks, tuple(labels), "the log shows a phantom at each fallback")
