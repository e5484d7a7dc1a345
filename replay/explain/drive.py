"""A drive in words: what was decided about which agent, what it cost and what else there was; `replan explain`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from logs.scenario import Scenario
from logs.trace import (
    Candidates,
    CostTerms,
    Decision,
    DecisionKind,
    LaneOption,
    Plan,
    PlannedFrame,
    SolverReport,
    Trace,
)
from replay.config import LoopConfig
from replay.explain import Account, accounts, sentences
from replay.explain.alternatives import KEEP, Touch, telling, touched
from replay.results.load import DriveResult

MOST_LINES = 5
"""Of a list longer than this the rest is counted."""


@dataclass(frozen=True, slots=True)
class Explanation:
    """A plan in words and numbers.

    Attributes:
        t: Of the frame, s.
        does: Within the next second, in a word.
        because: Sentences of `replay.explain`.
        account: What they are made of.
        fallback: Whether the planner failed; `reason` is its own sentence.
        reason: See there.
        decisions: What was decided, about which agent, why, and in which stage.
        costs: Of what was chosen, by stage and term.
        lanes: That were compared: cost by term, and why not.
        candidates: How many there were, and why the others were not taken.
        active: Bounds that the solution touches.
        solvers: Reports.
    """

    t: float
    does: str
    because: tuple[str, ...]
    account: Account
    fallback: bool
    reason: str
    decisions: tuple[Decision, ...]
    costs: tuple[CostTerms, ...]
    lanes: tuple[LaneOption, ...]
    candidates: tuple[Candidates, ...]
    active: tuple[Touch, ...]
    solvers: tuple[SolverReport, ...]


def explained(drive: DriveResult, at: float | None = None) -> list[Explanation]:
    """The plan at a time, or each that decides otherwise than the one before it.

    Raises:
        ConfigError: There is no plan at that time.
        LogError: The trace is damaged.
    """
    loop = drive.result.run.drive_loop
    if at is None:
        return list(changes(drive.trace, drive.scenario, loop))
    wanted = drive.frame(at).t
    pairs = zip(drive.trace.frames, accounts(drive.trace, drive.scenario, loop), strict=True)
    return [explanation(frame, account) for frame, account in pairs if frame.t == wanted]


def changes(trace: Trace, scenario: Scenario, loop: LoopConfig | None = None) -> Iterator[Explanation]:
    """The frames at which status, lane, a decision or the first cause changes; arguments as `accounts`."""
    before: Any = None
    for frame, account in zip(trace.frames, accounts(trace, scenario, loop), strict=True):
        first = account.causes[0] if account.causes else None
        gist = (_gist(frame.plan), account.course.action, first and (first.kind, first.who))
        if gist != before:
            yield explanation(frame, account)
        before = gist


def _gist(plan: Plan) -> Any:
    """What a plan decides, without numbers."""
    lane = next((each.name for each in _of(plan, LaneOption) if not each.against), KEEP)
    return plan.status, lane, frozenset((d.agent, d.kind) for d in _of(plan, Decision) if not _is_ignored(d))


def _is_ignored(decision: Decision) -> bool:
    return decision.kind is DecisionKind.IGNORE


def explanation(frame: PlannedFrame, account: Account) -> Explanation:
    """A frame's plan, and why it is so."""
    plan = frame.plan
    decisions = {(d.agent, d.kind, d.stage): d for d in reversed(_of(plan, Decision))}
    return Explanation(
        frame.t, account.course.action.value, tuple(sentences(account)), account, plan.status.is_fallback, plan.reason,
        tuple(reversed(decisions.values())), tuple(_of(plan, CostTerms)), tuple(_of(plan, LaneOption)),
        tuple(_of(plan, Candidates)), tuple(touched(plan)), tuple(_of(plan, SolverReport)),
    )  # fmt: skip


def _of(plan: Plan, kind: type[Any]) -> list[Any]:
    return [artefact for artefact in plan.internals if isinstance(artefact, kind)]


def lines_of(one: Explanation) -> Iterator[str]:
    """An explanation as text."""
    yield f"t = {one.t:.2f} s: {one.does}"
    yield from (f"  {sentence}" for sentence in one.because)
    if one.reason and not one.fallback:
        yield f"  The planner says: {one.reason}."
    decided = sorted(one.decisions, key=_is_ignored)
    yield from _some("decided", [f"{d.agent}: {d.kind.value} ({d.stage}): {d.reason}" for d in decided])
    lanes = [f"{each.name}: {_terms(each.terms)}; {each.against or 'taken'}" for each in one.lanes]
    counts = [
        f"{each.stage}: {each.considered}; not taken: {', '.join(f'{n} {why}' for why, n in each.rejected) or 'none'}"
        for each in one.candidates
    ]
    yield from _some("alternatives", [*lanes, *counts] or ["the planner names none"])
    yield from _some("active", [_touch(each) for each in one.active])
    yield from _some("costs", [f"{each.stage}: {_terms(each.terms)}" for each in one.costs])
    failed = [f"{each.stage}: not solved: {each.status}" for each in one.solvers if not each.solved]
    yield from _some("solvers", failed)


def _some(what: str, lines: Sequence[str]) -> Iterator[str]:
    """A heading with the first lines under it; nothing where there are none."""
    for i, line in enumerate(lines[:MOST_LINES]):
        yield f"    {what if i == 0 else '':<13} {line}"
    if len(lines) > MOST_LINES:
        yield f"    {'':<13} and {len(lines) - MOST_LINES} more"


def _terms(terms: Sequence[tuple[str, float]]) -> str:
    if not terms:
        return "no terms"
    shown, total = telling(terms), sum(value for _, value in terms)
    return f"{total:.3g} = " + " + ".join(f"{name} {value:.3g}" for name, value in shown) if shown else "0"


def _touch(one: Touch) -> str:
    unit = "s" if one.plane == "S-T" else "m"
    of_whom = f" ({one.agent})" if one.agent else ""
    span = f"from {one.first:.1f} {unit} to {one.last:.1f} {unit}"
    return f"{one.plane} {one.bound} bound{of_whom} {span}, at {one.at:.1f} m"
