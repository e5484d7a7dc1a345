"""Events of a drive: what its plans changed, and how it ended."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from replan.explain.causes import KEEP
from replan.explain.explanation import describe_choice, lane_options, taken_option
from replan.logs.plan import Decision, DecisionKind, PlanSummary
from replan.logs.trace import EndReason, Trace

GRAVE = (
    EndReason.COLLISION,
    EndReason.REPLAY_CONTACT,
    EndReason.OFF_ROAD,
    EndReason.PLANNER_FAILURE,
)
"""Ends that are errors."""


@dataclass(frozen=True)
class TimedEvent:
    """Something that happened at a time, s; the level is "INFO", "WARN" or "ERROR"."""

    t: float
    level: str
    words: str


def events(trace: Trace, plans: Sequence[PlanSummary] | None = None) -> list[TimedEvent]:
    """Changes of the status, of decisions, of the lane and of the planner's reason, and the end.

    Args:
        trace: The drive.
        plans: The summaries of all plans, if the trace does not hold all frames.
    """
    changes: list[TimedEvent] = []
    status, gist, decided = None, "", dict[str, str]()
    for plan in [frame.summary for frame in trace.frames] if plans is None else plans:
        # The same reason with other numbers is not an event
        before, gist = gist, re.sub(r"[\d.]+", "#", plan.reason)
        if plan.status is not status and (status is not None or plan.status.is_fallback):
            level = "WARN" if plan.status.is_fallback else "INFO"
            changes.append(
                TimedEvent(
                    plan.t,
                    level,
                    f"{plan.status.value} {f'({plan.reason})' if plan.reason else ''}",
                )
            )
        elif not plan.status.is_fallback and plan.reason and gist != before:
            changes.append(TimedEvent(plan.t, "INFO", plan.reason))
        options = lane_options(plan)
        if (lane := taken_option(options)) != KEEP:
            changes.append(
                TimedEvent(
                    plan.t, "INFO", f"changes lane to the {lane}: {describe_choice(options)}"
                )
            )
        now = {
            artefact.agent: f"{artefact.kind.value} ({artefact.reason})"
            for artefact in plan.internals
            if isinstance(artefact, Decision) and artefact.kind is not DecisionKind.IGNORE
        }
        for agent in dict.fromkeys([*now, *decided]):
            old, new = decided.get(agent, "no decision ()"), now.get(agent, "no decision ()")
            if old.split(" (")[0] != new.split(" (")[0]:
                changes.append(TimedEvent(plan.t, "INFO", f"{agent}: {new.removesuffix(' ()')}"))
        status, decided = plan.status, now
    detail = f": {trace.detail}" if trace.detail else ""
    level = "ERROR" if trace.end in GRAVE else "INFO"
    return [*changes, TimedEvent(float(trace.ego.t[-1]), level, f"{trace.end.value}{detail}")]
