"""Why a plan is what it is: a page per frame, in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
import rerun as rr

from logs.road import Road
from logs.trace import (
    Candidates,
    CostTerms,
    Decision,
    DecisionKind,
    Plan,
    PlannedFrame,
    PlanStatus,
    SolverReport,
    StGraph,
    Trace,
)
from replay.recording import plots
from replay.recording.axes import finite
from replay.recording.columns import Instants, Tape
from replay.recording.lane_choice import Change, changes_under_way, lanes_driven, listed, options
from replay.recording.others import unseen
from replay.recording.text import MARKDOWN, cell, document

A = TypeVar("A")

MAX_DECISIONS = 15
"""More decisions than these are counted, not listed (those that are not "ignore" come first)."""
MAX_MISSING = 6
BRAKING_MPS2, STANDING_MPS = -0.3, 0.1
QUIET = (plots.FREE_DRIVE, plots.KEEP)
STAYS_BEHIND = (DecisionKind.STOP, DecisionKind.YIELD, DecisionKind.FOLLOW)


def draw_why(tape: Tape, trace: Trace, road: Road, instants: Instants) -> None:
    """A page per frame."""
    tape.static("why", rr.TextDocument.from_fields(media_type=MARKDOWN))
    changes = changes_under_way(trace.frames, lanes_driven(trace, road))
    pages = [
        document(why(frame, unseen(trace, frame.t), change))
        for frame, change in zip(trace.frames, changes, strict=True)
    ]
    tape.rows("why", instants, rr.TextDocument.columns(text=pages))


def why(frame: PlannedFrame, missing: Sequence[tuple[str, float]] = (), change: Change | None = None) -> list[str]:
    """The page of a frame: what is planned and because of whom, then decisions, lanes, solvers and costs.

    Args:
        frame: The plan.
        missing: Who is near but was not shown to the planner, and how far away, m.
        change: The change of lane that is under way.
    """
    plan = frame.plan
    lines = [f"### t = {frame.t:.2f} s: {_headline(plan)}"]
    if plan.status.is_fallback:
        lines += ["", f"**{cell(plan.status.value)}**" + (f": {cell(plan.reason)}" if plan.reason else "")]
    elif plan.reason:
        lines += ["", f"**Reason: {cell(plan.reason)}**"]
    if change is not None:
        lines += ["", f"**Changes lane to the {change.name}** since t = {change.t:.2f} s: {cell(change.reason)}"]
    lines += ["", *_cause(plan), _course(frame.t, plan)]
    lines += _missing(missing)
    return [*lines, *_decisions(plan), *_lanes(plan), *_candidates(plan), *_solvers(plan), *_costs(plan)]


def _headline(plan: Plan) -> str:
    """What the car does within the next second, and the decisions in a word each."""
    path = plan.trajectory
    ahead = min(float(path.t[0]) + 1.0, float(path.t[-1]))
    change = (float(np.interp(ahead, path.t, path.v)) - float(path.v[0])) / max(ahead - float(path.t[0]), 1e-9)
    if max(float(path.v[0]), float(np.interp(ahead, path.t, path.v))) < STANDING_MPS:
        does = "stands"
    else:
        does = "brakes" if change < BRAKING_MPS2 else "accelerates" if change > -BRAKING_MPS2 else "keeps its speed"
    words = [] if plan.status is PlanStatus.PLANNED else [plots.STATUS_WORDS[plan.status]]
    if any(isinstance(artefact, Decision) for artefact in plan.internals):
        words += [word for word in (plots.longitudinal(plan), plots.lateral(plan)) if word not in QUIET]
    return ": ".join([does, ", ".join(words)]) if words else does


def _cause(plan: Plan) -> list[str]:
    """For whom the plan brakes or stands: of those whom the ego stays behind the one that it comes nearest to."""
    path = plan.trajectory
    if float(path.a.min()) > BRAKING_MPS2 and float(path.v.max()) > STANDING_MPS:
        return []
    decided = {d.agent: d for d in _of(plan, Decision) if d.kind in STAYS_BEHIND}
    if not decided:
        return ["Nobody is in the way: it slows down for the road (speed limit, curve, end) or the goal.", ""]
    found = nearest(plan)
    decision = decided.get(found[0], next(iter(decided.values()))) if found else next(iter(decided.values()))
    room = f" Nearest in {found[2]:.1f} s: {max(found[1], 0.0):.1f} m are left." if found else ""
    because = f"**Slows down for {cell(decision.agent)} ({decision.kind.value})**"
    return [f"{because}: {cell(decision.reason)}.{room}" if decision.reason else f"{because}.{room}", ""]


def nearest(plan: Plan) -> tuple[str, float, float] | None:
    """Of the obstacles in the S-T graph behind which the plan stays: which it comes nearest to, m, and when, s."""
    found: list[tuple[float, float, str]] = []
    for graph in _of(plan, StGraph):
        line = finite(graph.qp)
        for obstacle in graph.obstacles if len(line) else ():
            outline = finite(obstacle.outline)
            if obstacle.decision in STAYS_BEHIND and len(outline):
                gap = outline[:, 1] - np.interp(outline[:, 0], line[:, 0], line[:, 1])
                i = int(np.argmin(gap))
                found.append((float(gap[i]), float(outline[i, 0]), obstacle.agent))
    gap_t_agent = min(found, default=None)
    return (gap_t_agent[2], gap_t_agent[0], gap_t_agent[1]) if gap_t_agent else None


def _of(plan: Plan, kind: type[A]) -> list[A]:
    return [artefact for artefact in plan.internals if isinstance(artefact, kind)]


def _course(t: float, plan: Plan) -> str:
    """In a sentence what the plan's trajectory does."""
    path = plan.trajectory
    slowest, hardest = int(np.argmin(path.v)), int(np.argmin(path.a))
    words = [f"Speed {path.v[0]:.1f} m/s, {path.v[-1]:.1f} m/s after {path.t[-1] - t:.1f} s"]
    if path.v[slowest] < min(path.v[0], path.v[-1]) - 0.05:
        words.append(f"slowest {path.v[slowest]:.1f} m/s at t = {path.t[slowest]:.1f} s")
    if path.a[hardest] < BRAKING_MPS2:
        words.append(f"hardest braking {path.a[hardest]:.1f} m/s² at t = {path.t[hardest]:.1f} s")
    return f"{'; '.join(words)}. Starts {plan.start.value}."


def _missing(agents: Sequence[tuple[str, float]]) -> list[str]:
    if not agents:
        return []
    named = ", ".join(f"{cell(name)} ({away:.0f} m)" for name, away in agents[:MAX_MISSING])
    more = f" and {len(agents) - MAX_MISSING} more" if len(agents) > MAX_MISSING else ""
    return ["", f"**Not seen by the sensor:** {named}{more}"]


def _lanes(plan: Plan) -> list[str]:
    """The lanes that were compared, what each would cost, and why not."""
    some = options(plan)
    if not some:
        return []
    lines = [f"- **{cell(name)}**: {cell(cost)}; {cell(verdict)}" for name, cost, verdict in listed(some)]
    return ["", "#### Lanes", "", *lines]


def _decisions(plan: Plan) -> list[str]:
    """A line each, those about several futures of one agent once; the heading says how to read their numbers."""
    found = list({(d.agent, d.kind, d.stage): d for d in reversed(_of(plan, Decision))}.values())[::-1]
    found.sort(key=lambda decision: decision.kind is DecisionKind.IGNORE)
    if not found:
        return []
    lines = [
        f"- **{cell(d.agent)}: {d.kind.value}** ({cell(d.stage)}){f': {cell(d.reason)}' if d.reason else ''}"
        for d in found[:MAX_DECISIONS]
    ]
    more = [f"- and {len(found) - MAX_DECISIONS} more"] if len(found) > MAX_DECISIONS else []
    return ["", "#### Decisions (s from now, m along the path)", "", *lines, *more]


def _candidates(plan: Plan) -> list[str]:
    stages = _of(plan, Candidates)
    lines = [
        f"- {cell(stage.stage)}: {stage.considered}; not taken: "
        + (", ".join(f"{count} {cell(reason)}" for reason, count in stage.rejected) or "none")
        for stage in stages
    ]
    return ["", "#### Candidates", "", *lines] if lines else []


def _solvers(plan: Plan) -> list[str]:
    reports = [artefact for artefact in plan.internals if isinstance(artefact, SolverReport)]
    lines = [
        f"- {cell(r.stage)}: {'' if r.solved else '**not solved**: '}{cell(r.status)}, {r.iterations} iterations,"
        f" residuals {_short(r.primal_residual)}, {_short(r.dual_residual)}"
        for r in reports
    ]
    return ["", "#### Solvers (primal, dual residual)", "", *lines] if lines else []


def _costs(plan: Plan) -> list[str]:
    stages = _of(plan, CostTerms)
    lines = [
        f"- {cell(stage.stage)}: {', '.join(f'{cell(name)} {value:.3g}' for name, value in stage.terms)}"
        for stage in stages
    ]
    return ["", "#### Cost terms", "", *lines] if lines else []


def _short(value: float) -> str:
    return f"{value:.1e}" if np.isfinite(value) else "unknown"
