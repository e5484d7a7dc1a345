"""The contract of metrics."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from math import inf, isfinite
from typing import Any

import numpy as np

from replan.contract.breaches import LOOP, Findings, call, difference, leaves, scenarios_or_default
from replan.core.errors import PlannerError, raised
from replan.logs.frame import Frame
from replan.logs.plan import Plan
from replan.logs.road import RoadSource
from replan.logs.scenario import Scenario
from replan.logs.trace import Mode, Trace
from replan.logs.tracks import Tracks
from replan.metrics import load_metric
from replan.metrics.metric import Metric, Series, Unavailable
from replan.replay.drive import Drive
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.open_loop import run_open_loop
from replan.replay.loop.planning import Planning, Seat

METRIC_RULES: Mapping[str, str] = {
    "answer": "return a Series, Unavailable, or a mapping from parts to these",
    "modes": "declare only the modes in which it is defined",
    "parts": "return the parts that the metric declares",
    "reason": "say in Unavailable(reason) or Series(missing=) why there is no value",
    "needs": "name in `needs` what the log or drive must contain",
    "times": "give each step a time of the drive, in increasing order",
    "finite": "return Unavailable, or NaN for a step, where there is no value",
    "inputs": "copy arrays of the trace and the scenario before changing them",
    "pure": "use no clock, no random numbers, and no memory of other drives",
}
"""The rules for metrics: what a breach of each means, by the rule's name."""

ROUNDING_S = 1e-6
"""A time outside of the drive by less is rounding, s."""

MetricDrive = tuple[Trace, Scenario]
Loop = Callable[..., Drive]


def check_metric(metric: Metric | str, *, scenarios: Iterable[Scenario] | None = None) -> None:
    """Check the contract of a metric: on drives in its modes, among them some that hardly are any.

    The rules are those of `replan.contract.METRIC_RULES`.

    Args:
        metric: The metric, its name, or "module:NAME".
        scenarios: The scenarios to drive in; None: some of the catalogue.

    Raises:
        ContractError: A rule is broken.
        ConfigError: The metric cannot be loaded.
    """
    check_metric_on(
        load_metric(metric) if isinstance(metric, str) else metric,
        metric_drives(scenarios_or_default(scenarios)),
    )


def metric_drives(scenarios: Iterable[Scenario]) -> list[MetricDrive]:
    """Return drives of `constant_speed` in both modes: whole ones, and ones that lack what a metric
    may need.
    """
    drives: list[MetricDrive] = []
    for k, scenario in enumerate(scenarios):
        bare = replace(scenario, tracks=Tracks.empty(), goal=None, lights=())
        path = replace(bare, road=replace(bare.road, source=RoadSource.DRIVEN_PATH))
        for run in (run_open_loop, run_closed_loop):
            drives.append(_drive(run, scenario))
            if k == 0:
                drives.append(_drive(run, path, until_s=1.0))
                drives.append(_drive(run, scenario, _failing(0.0)))  # no plan
                drives.append(_drive(run, scenario, _failing(0.1)))  # one plan
    return drives


def _drive(
    run: Loop, scenario: Scenario, seat: Seat = Planning, until_s: float = inf
) -> MetricDrive:
    """Return a drive through a copy of a scenario, so that a metric that writes into it does not
    reach the caller's.
    """
    copy = replace(scenario)
    return run(copy, "constant_speed", config=LOOP, seat=seat, until_s=until_s).trace, copy


def _failing(at_s: float) -> Seat:
    """Return the seat of a planner that fails at a time."""

    class Failing(Planning):
        """Raises from `at_s` on."""

        def plan(self, frame: Frame) -> Plan:
            """As `Planning.plan`."""
            if frame.t >= at_s - ROUNDING_S:
                raise PlannerError("the planner failed")
            return super().plan(frame)

    return Failing


def check_metric_on(metric: Metric, drives: Sequence[MetricDrive]) -> None:
    """Check a metric on drives, and once more in reverse order on copies.

    Raises:
        ContractError: A rule is broken.
    """
    findings = Findings(METRIC_RULES)
    judged = [(trace, scenario) for trace, scenario in drives if trace.mode in metric.modes]
    results, failed = list[object](), dict[Mode, dict[str, str]]()
    for trace, scenario in judged:
        where = f"{scenario.name}, {trace.mode.value} loop, {len(trace.frames)} plans"
        before = [*leaves((trace, scenario))]
        try:
            measured = metric.measure(trace, scenario)
        except (Exception, SystemExit) as error:
            failed.setdefault(trace.mode, {})[where] = (
                f"it raised {raised(error, of=metric.measure)}"
            )
            measured = None
        else:
            _check_measured(metric, measured, trace, where, findings)
        if before != [*leaves((trace, scenario))]:
            findings.add("inputs", where, "it changed the trace or the scenario")
        results.append(measured)
    for mode, places in failed.items():
        # A metric that fails in all drives of one mode, and in no drive of another, is not defined
        # in that mode; otherwise it fails in some situation
        fails_always = len(places) == sum(trace.mode is mode for trace, _ in judged)
        is_undefined = fails_always and len(failed) < len(metric.modes)
        findings.add("modes" if is_undefined else "answer", *next(iter(places.items())))
    if not {"answer", "modes", "inputs"} & findings.breaches.keys():
        for (trace, scenario), first in zip(reversed(judged), reversed(results), strict=True):
            where = f"{scenario.name}, {trace.mode.value} loop"
            again = call(findings, "pure", where, metric.measure, replace(trace), replace(scenario))
            differs = difference(first, again)
            if differs:
                findings.add("pure", where, f"measured twice, it differs in {differs}")
    findings.report(f"metric {metric.name}")


def _check_measured(
    metric: Metric, measured: object, trace: Trace, where: str, findings: Findings
) -> None:
    parts: Mapping[Any, object] = measured if isinstance(measured, Mapping) else {"": measured}
    strange = set(parts) - set(metric.parts) if metric.parts != ("*",) else set()
    if isinstance(measured, Mapping) and strange:
        findings.add("parts", where, f"it returned the part {min(map(repr, strange))}")
    if isinstance(measured, Series) and metric.parts:
        findings.add("parts", where, "it returned one series")
    for part, answer in parts.items():
        which = f"{where}, part {part}" if part else where
        if isinstance(answer, Series):
            _check_series(metric, answer, trace, which, findings)
        elif not isinstance(answer, Unavailable):
            findings.add("answer", which, f"it returned {type(answer).__name__}")
        elif not isinstance(answer.reason, str) or not answer.reason.strip():
            findings.add("reason", which, "it is unavailable without a reason")
        elif not metric.needs:
            findings.add("needs", which, f"it is unavailable: {answer.reason}")


def _check_series(
    metric: Metric, series: Series, trace: Trace, where: str, findings: Findings
) -> None:
    first, last = float(trace.ego.t[0]), float(trace.ego.t[-1])
    within = first - ROUNDING_S <= series.t[0] and series.t[-1] <= last + ROUNDING_S
    if not within or (np.diff(series.t) <= 0.0).any():
        findings.add(
            "times",
            where,
            f"its times are {series.t[0]:.2f} to {series.t[-1]:.2f} s, the drive's {first:.2f} to "
            f"{last:.2f} s",
        )
    if not series.known.any():
        if not series.missing.strip():
            findings.add("reason", where, "no step has a value, and `missing` is empty")
        elif not metric.needs and any(reduction.empty is None for reduction in metric.reductions):
            findings.add("needs", where, f"it is unavailable: {series.missing}")
        return
    for reduction in metric.reductions:
        reduced = call(findings, "answer", f"{where}, {reduction.name}", reduction.reduce, series)
        if reduced is not None:
            value, step = reduced
            if not isfinite(value) or not -1 <= step < len(series.t):
                findings.add("finite", where, f"{reduction.name} is {value} at step {step}")
