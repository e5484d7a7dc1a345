"""Events of a planner that plans open loop over a log: where its plans differ from the recorded
drive, fall back, or flip, by the metrics of plans (`replan.metrics.accuracy`,
`replan.metrics.plans`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from replan.config import RunConfig
from replan.core.arrays import BoolArray, FloatArray
from replan.core.errors import PlannerError
from replan.logs.scenario import Scenario
from replan.logs.trace import EndReason, Trace
from replan.metrics.accuracy import MISS_M, fde, miss
from replan.metrics.metric import Series
from replan.metrics.plans import plan_change_lateral
from replan.mine.driven_log import DrivenLog, Event, runs
from replan.replay.loop.open_loop import run_open_loop

HORIZON_S = 3
FLIP_M = 1.0


@dataclass(frozen=True, slots=True)
class PlanKind:
    """A kind of event of a planner's plans; the fields as of `replan.mine.driven_log.EventKind`.

    Attributes:
        find: The events in the trace of an open loop over a scenario.
    """

    name: str
    find: Callable[[Trace, Scenario], Iterator[Event]]
    meaning: str
    measures: str = ""
    unit: str = ""
    source: str = ""
    doubted: str = ""


def plan_events(log: DrivenLog, planner: str, run: RunConfig) -> Iterator[tuple[PlanKind, Event]]:
    """The events of a planner over a log, each with its kind.

    Raises:
        ReplanError: The planner failed, or cannot be built.
    """
    keywords = run.planner_keywords(planner)
    trace = run_open_loop(
        log.scenario, planner, planner_config=keywords, config=run.drive_loop, keep_internals=False
    ).trace
    if trace.end is EndReason.PLANNER_FAILURE:
        raise PlannerError(trace.detail)
    for kind in PLAN_KINDS:
        for event in kind.find(trace, log.scenario):
            yield kind, event


def _differs(trace: Trace, scenario: Scenario) -> Iterator[Event]:
    part = f"{HORIZON_S}s"
    missed = miss.measured(trace, scenario).get(f"{miss.name}.{part}")
    error = fde.measured(trace, scenario).get(f"{fde.name}.{part}")
    if isinstance(missed, Series) and isinstance(error, Series):
        yield from _stretches(missed.t, missed.value > 0.5, error.value)


def _falls_back(trace: Trace, scenario: Scenario) -> Iterator[Event]:
    frames = trace.frames
    for first, last in runs(np.array([frame.plan.status.is_fallback for frame in frames])):
        plan = frames[first].plan
        reason = plan.reason or plan.status.value
        yield Event(float(frames[first].t), float(frames[last].t), np.nan, what=reason)


def _flips(trace: Trace, scenario: Scenario) -> Iterator[Event]:
    change = plan_change_lateral.measured(trace, scenario).get(plan_change_lateral.name)
    if isinstance(change, Series):
        yield from _stretches(change.t, change.value > FLIP_M, change.value)


def _stretches(t: FloatArray, marked: BoolArray, value: FloatArray) -> Iterator[Event]:
    """An event for each run of marked frames, with the greatest value in it."""
    for first, last in runs(marked, hole=2):
        greatest = float(np.nanmax(value[first : last + 1]))
        yield Event(float(t[first]), float(t[last]), greatest)


PLAN_KINDS = (
    PlanKind(
        "plan_differs",
        _differs,
        f"The plan is more than {MISS_M[HORIZON_S]:g} m from what was driven within {HORIZON_S} s.",
        f"greatest distance at {HORIZON_S} s",
        "m",
        "nuPlan, planner_miss_rate_within_bound",
    ),
    PlanKind("plan_falls_back", _falls_back, "The planner falls back; `what` is its reason."),
    PlanKind(
        "plan_flips",
        _flips,
        f"A plan is more than {FLIP_M:g} m to the side of the plan before it.",
        "greatest lateral distance",
        "m",
        "after Autoware's stability",
    ),
)
"""The kinds of a planner's plans, in the order of the page."""
