"""Events of a planner over a log, open loop: where its plans differ from what was driven, fall back, or flip.

By the metrics of plans (`metrics.plans`): a frame differs where its plan misses what was driven within 3 s (`miss.3s`),
and flips where it is more than `FLIP_M` to the side of the plan before it (`plan_change_lateral`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType

import numpy as np

from logs.errors import PlannerError
from logs.trace import EndReason
from metrics.metric import Series
from metrics.plans import FDE, MISS, MISS_M, PLAN_CHANGE_LATERAL
from replay.config import RunConfig
from replay.loop.open_loop import run_open_loop
from replay.mine.driven_log import DrivenLog, runs
from replay.mine.events import Event, EventKind

HORIZON_S = 3
FLIP_M = 1.0


def _of_planners(log: DrivenLog) -> tuple[Event, ...]:
    """These are found by `plan_events`, which needs a planner."""
    return ()


PLAN_KINDS: Mapping[str, EventKind] = MappingProxyType({
    kind.name: kind
    for kind in (
        EventKind(
            "plan_differs", _of_planners,
            f"The plan is more than {MISS_M[HORIZON_S]:g} m from what was driven within {HORIZON_S} s.",
            f"greatest distance at {HORIZON_S} s", "m", "nuPlan, planner_miss_rate_within_bound",
        ),
        EventKind("plan_falls_back", _of_planners, "The planner falls back; `what` is its reason."),
        EventKind(
            "plan_flips", _of_planners, f"A plan is more than {FLIP_M:g} m to the side of the plan before it.",
            "greatest lateral distance", "m", "after Autoware's stability",
        ),
    )
})  # fmt: skip


def plan_events(log: DrivenLog, planner: str, run: RunConfig) -> Iterator[tuple[str, Event]]:
    """The kinds and events of a planner over a log.

    Raises:
        PlannerError: The planner failed.
    """
    keywords = run.planner.get(planner, {})
    drive = run_open_loop(log.scenario, planner, planner_config=keywords, config=run.drive_loop, keep_internals=False)
    trace = drive.trace
    if trace.end is EndReason.PLANNER_FAILURE:
        raise PlannerError(trace.detail)
    t = np.array([frame.t for frame in trace.frames])
    fallback = np.array([frame.plan.status.is_fallback for frame in trace.frames])
    for first, last in runs(fallback):
        reason = trace.frames[first].plan.reason or trace.frames[first].plan.status.value
        yield "plan_falls_back", Event(float(t[first]), float(t[last]), np.nan, what=reason)
    for name, metric, part, bound in (
        ("plan_differs", MISS, f"{HORIZON_S}s", 0.5), ("plan_flips", PLAN_CHANGE_LATERAL, "", FLIP_M),
    ):  # fmt: skip
        found = metric.measured(trace, log.scenario).get(f"{metric.name}.{part}" if part else metric.name)
        value = FDE.measured(trace, log.scenario).get(f"fde.{part}") if part else found
        if isinstance(found, Series) and isinstance(value, Series):
            for first, last in runs(found.value > bound, hole=2):
                most = float(np.nanmax(value.value[first : last + 1]))
                yield name, Event(float(found.t[first]), float(found.t[last]), most)
