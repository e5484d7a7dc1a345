"""What the drive cost: pedals, steering, solver iterations, fallbacks.

Pedals are judged as commanded (the actuators' lags let one pedal rise while the other falls).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from logs.scenario import Scenario
from logs.states import Controls
from logs.trace import Mode, SolverReport, Trace
from metrics.comfort import WINDOW_S
from metrics.metric import COUNT, MAX, MAX_ABS, MEAN, P95, RATE, Measured, Metric, Series, Unavailable, changed
from metrics.plans import frame_times

PRESSED = 1e-6
"""A pedal command above this is pressed."""
_NO_COMMANDS = Unavailable("the drive has no commands")
_NO_REPORTS = Unavailable("the plans hold no solver reports")


def _pedal(column: str, trace: Trace, scenario: Scenario) -> Measured:
    if trace.commands is None or not len(trace.commands):
        return _NO_COMMANDS
    return Series(trace.commands.t, getattr(trace.commands, column))


def _together(trace: Trace, scenario: Scenario) -> Measured:
    commands = trace.commands
    if commands is None or not len(commands):
        return _NO_COMMANDS
    known = np.isfinite(commands.throttle) & np.isfinite(commands.brake)
    both = (commands.throttle > PRESSED) & (commands.brake > PRESSED)
    return Series(commands.t, np.where(known, both.astype(np.float64), np.nan))


def _switches(trace: Trace, scenario: Scenario) -> Measured:
    """1 at each step that presses the other pedal than the one pressed last; coasting between does not count."""
    commands = trace.commands
    if commands is None or not len(commands):
        return _NO_COMMANDS
    pedal = np.where(commands.brake > PRESSED, -1, np.where(commands.throttle > PRESSED, 1, 0))
    pressed = np.flatnonzero(pedal)
    switches = np.zeros(len(commands))
    switches[pressed[1:]] = pedal[pressed[1:]] != pedal[pressed[:-1]]
    return Series(commands.t, switches)


def _steer_rate(trace: Trace, scenario: Scenario) -> Measured:
    controls = _best_known(trace)
    if controls is None or not len(controls):
        return _NO_COMMANDS
    rate = changed(controls.t, controls.steer, WINDOW_S)
    return Series(controls.t, rate, missing=f"the drive is shorter than {WINDOW_S} s")


def _best_known(trace: Trace) -> Controls | None:
    return trace.actuation if trace.actuation is not None else trace.commands


def _reports(trace: Trace) -> list[tuple[SolverReport, ...]]:
    """The solver reports of each frame; with repeated stages (several candidate lanes) all of them."""
    return [tuple(item for item in f.plan.internals if isinstance(item, SolverReport)) for f in trace.frames]


def _iterations(trace: Trace, scenario: Scenario) -> Unavailable | Mapping[str, Measured]:
    frames = _reports(trace)
    stages = sorted({report.stage for reports in frames for report in reports})
    if not stages:
        return _NO_REPORTS
    t, out = frame_times(trace), {}
    for stage in stages:
        counts = [[report.iterations for report in reports if report.stage == stage] for reports in frames]
        out[stage] = Series(t, np.array([float(max(count)) if count else np.nan for count in counts]))
    return out


def _unsolved(trace: Trace, scenario: Scenario) -> Measured:
    frames = _reports(trace)
    if not any(frames):
        return _NO_REPORTS
    failures = [[f"{r.stage}: {r.status}" for r in reports if not r.solved] for reports in frames]
    counts = np.array([float(len(failed)) for failed in failures])
    return Series(frame_times(trace), counts, tuple("; ".join(failed) for failed in failures))


def _fallback(trace: Trace, scenario: Scenario) -> Measured:
    if not trace.frames:
        return Unavailable("the drive has no plans")
    plans = [frame.plan for frame in trace.frames]
    labels = [f"{p.status.value}: {p.reason}" if p.status.is_fallback else "" for p in plans]
    return Series(frame_times(trace), np.array([float(p.status.is_fallback) for p in plans]), tuple(labels))


_CLOSED, _BOTH = (Mode.CLOSED,), (Mode.OPEN, Mode.CLOSED)
_COMMANDS, _REPORTS = "commands of a controller", "solver reports in the plans"
_PRESSED = (f"pressed above {PRESSED:g}",)
THROTTLE = Metric(
    "throttle", "1", "none", _CLOSED, partial(_pedal, "throttle"), (MEAN, MAX), "Commanded throttle.",
    formula="throttle", needs=_COMMANDS,
)  # fmt: skip
BRAKE = Metric(
    "brake", "1", "none", _CLOSED, partial(_pedal, "brake"), (MEAN, MAX), "Commanded brake.",
    formula="brake", needs=_COMMANDS,
)  # fmt: skip
PEDALS_TOGETHER = Metric(
    "pedals_together", "count", "lower", _CLOSED, _together, (COUNT,), "Steps that command throttle and brake at once.",
    formula="sum of 1 where both are pressed", parameters=_PRESSED, needs=_COMMANDS,
)  # fmt: skip
PEDAL_SWITCHES = Metric(
    "pedal_switches", "count", "lower", _CLOSED, _switches, (COUNT,), "Changes from throttle to brake or back.",
    formula="sum of 1 where the other pedal than the last one is pressed", parameters=_PRESSED, needs=_COMMANDS,
)  # fmt: skip
STEER_RATE = Metric(
    "steer_rate", "rad/s", "lower", _CLOSED, _steer_rate, (MAX_ABS, P95),
    "Backward difference of the front wheel angle over 0.1 s, as actuated, else as commanded.",
    formula="(steer(t) - steer(t - W)) / W", parameters=(f"W {WINDOW_S} s",), needs=_COMMANDS,
)  # fmt: skip
QP_ITERATIONS = Metric(
    "qp_iterations", "count", "lower", _BOTH, _iterations, (MEAN, P95, MAX),
    "Solver iterations per frame and stage, the largest where a stage solves several times.", parts=("*",),
    formula="max over a frame's calls of a stage", needs=_REPORTS,
)  # fmt: skip
SOLVER_UNSOLVED = Metric(
    "solver_unsolved", "count", "lower", _BOTH, _unsolved, (COUNT,), "Solver calls that did not end solved.",
    formula="sum of calls that are not solved", needs=_REPORTS,
)  # fmt: skip
FALLBACK = Metric(
    "fallback", "1", "lower", _BOTH, _fallback, (RATE,), "Share of the frames whose plan is a fallback.",
    formula="1 where the status is a fallback, else 0", needs="plans",
)  # fmt: skip
