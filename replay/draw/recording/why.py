"""Why a plan is what it is: a page per frame, in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
import rerun as rr

from logs.names import counted
from logs.scenario import Scenario
from logs.trace import (
    Candidates,
    CostTerms,
    Decision,
    DecisionKind,
    Plan,
    PlannedFrame,
    PlanStatus,
    SolverReport,
    Trace,
)
from replay.draw.recording import states
from replay.draw.recording.columns import Instants, Tape
from replay.draw.recording.lane_choice import Change, changes_under_way, lanes_driven, listed, options
from replay.draw.recording.others import unseen
from replay.draw.recording.text import MARKDOWN, cell, document
from replay.explain import Account, Course, accounts, sentences
from replay.explain.alternatives import telling
from replay.explain.course import BRAKES_MPS2

A = TypeVar("A")

MAX_DECISIONS = 15
"""More decisions than these are counted, not listed (those that are not "ignore" come first)."""
MAX_MISSING = 6
PASS = "pass: "
"""So a planner begins what speaks against passing, among its candidates."""
SAME_MPS = 0.05
QUIET = (states.FREE_DRIVE, states.KEEP)


def draw_why(tape: Tape, trace: Trace, scenario: Scenario, instants: Instants) -> None:
    """A page per frame; a second one, that is read rarely, with what the solvers say."""
    for page in ("why", "numbers"):
        tape.static(page, rr.TextDocument.from_fields(media_type=MARKDOWN))
    changes = changes_under_way(trace.frames, lanes_driven(trace, scenario.road))
    pages = [
        document(map(tape.short, why(frame, account, unseen(trace, frame.t), change)))
        for frame, account, change in zip(trace.frames, accounts(trace, scenario), changes, strict=True)
    ]
    tape.rows("why", instants, rr.TextDocument.columns(text=pages))
    inside = [document(map(tape.short, numbers(frame))) for frame in trace.frames]
    tape.rows("numbers", instants, rr.TextDocument.columns(text=inside))


def why(
    frame: PlannedFrame, account: Account, missing: Sequence[tuple[str, float]] = (), change: Change | None = None
) -> list[str]:
    """The page of a frame: what is planned and because of what, then decisions, lanes and candidates.

    Args:
        frame: The plan.
        account: Why it slows down or stands.
        missing: Who is near but was not shown to the planner, and how far away, m.
        change: The change of lane that is under way.
    """
    plan = frame.plan
    lines = [f"### t = {frame.t:.2f} s: {_headline(plan, account.course)}"]
    if plan.reason and not plan.status.is_fallback:
        lines += ["", f"**Reason: {cell(plan.reason)}**"]
    if change is not None:
        lines += ["", f"**Changes lane to the {change.name}** since t = {change.t:.2f} s: {cell(change.reason)}"]
    for sentence in sentences(account):
        first, colon, rest = sentence.partition(": ")
        lines += ["", f"**{cell(first)}**{colon}{cell(rest)}"]
    lines += _not_passed(plan)
    lines += ["", _course(frame.t, plan, account.course)]
    lines += _missing(missing)
    return [*lines, *_decisions(plan), *_lanes(plan), *_candidates(plan)]


def numbers(frame: PlannedFrame) -> list[str]:
    """The page of a frame that is read when a plan is odd: cost terms, and what the solvers say of themselves."""
    plan = frame.plan
    found = [*_costs(plan), *_solvers(plan)]
    return [f"### t = {frame.t:.2f} s", *(found or ["", "The planner tells neither costs nor solvers."])]


def _headline(plan: Plan, course: Course) -> str:
    """What the car does within the next second, and the decisions in a word each."""
    words = [] if plan.status is PlanStatus.PLANNED else [states.STATUS_WORDS[plan.status]]
    if any(isinstance(artefact, Decision) for artefact in plan.internals):
        words += [word for word in (states.longitudinal(plan), states.lateral(plan)) if word not in QUIET]
    return ": ".join([course.action.value, ", ".join(words)]) if words else course.action.value


def _of(plan: Plan, kind: type[A]) -> list[A]:
    return [artefact for artefact in plan.internals if isinstance(artefact, kind)]


def _course(t: float, plan: Plan, course: Course) -> str:
    """In a sentence what the plan's trajectory does."""
    words = [f"Speed {course.v_start:.1f} m/s, {course.v_end:.1f} m/s after {course.duration:.1f} s"]
    if course.v_least < min(course.v_start, course.v_end) - SAME_MPS:
        words.append(f"slowest {course.v_least:.1f} m/s at t = {t + course.t_least:.1f} s")
    if course.a_least < BRAKES_MPS2:
        words.append(f"hardest braking {course.a_least:.1f} m/s² at t = {t + course.t_hardest:.1f} s")
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


def _not_passed(plan: Plan) -> list[str]:
    """Why whoever is followed is not passed, in the planner's words, where it compared passing with staying behind."""
    followed = [d.agent for d in _of(plan, Decision) if d.kind is DecisionKind.FOLLOW]
    against = [
        reason.removeprefix(PASS)
        for stage in _of(plan, Candidates)
        if stage.stage == "passing"
        for reason, _ in stage.rejected
        if reason.startswith(PASS)
    ]
    named = ", ".join(cell(name) for name in dict.fromkeys(followed))
    return ["", f"**Not passed ({named or 'those ahead'}):** {cell('; '.join(against))}"] if against else []


def _candidates(plan: Plan) -> list[str]:
    stages = _of(plan, Candidates)
    lines = [
        f"- {cell(stage.stage)}: {stage.considered}; not taken: "
        + (", ".join(f"{count} {cell(reason)}" for reason, count in stage.rejected) or "none")
        for stage in stages
    ]
    return ["", "#### Candidates", "", *lines] if lines else []


def _solvers(plan: Plan) -> list[str]:
    reports = _of(plan, SolverReport)
    lines = [
        f"- {cell(r.stage)}: {'' if r.solved else '**not solved**: '}{cell(r.status)},"
        f" {counted(r.iterations, 'iteration')}, residuals {_short(r.primal_residual)}, {_short(r.dual_residual)}"
        for r in reports
    ]
    return ["", "#### Solvers (primal, dual residual)", "", *lines] if lines else []


def _costs(plan: Plan) -> list[str]:
    stages = _of(plan, CostTerms)
    lines = [
        f"- {cell(stage.stage)}: {', '.join(f'{cell(name)} {value:.3g}' for name, value in telling(stage.terms)) or 0}"
        for stage in stages
    ]
    return ["", "#### Cost terms", "", *lines] if lines else []


def _short(value: float) -> str:
    return f"{value:.1e}" if np.isfinite(value) else "unknown"
