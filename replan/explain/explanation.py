"""A plan in words: the causes of slowing down, the decisions about agents, the alternatives, the
costs.

`replan explain`, the page "why" of a recording and the HTML report show the same `Explanation`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from math import isfinite
from typing import Any, NamedTuple, TypeVar

import numpy as np

from replan.core.names import counted
from replan.explain.broken_gates import ahead, broken_gates
from replan.explain.causes import FELT_MPS2, KEEP, Account, CauseKind, accounts, not_passed
from replan.explain.contradictions import LEAST_FRAMES, describe_contradictions
from replan.explain.plan_alternatives import describe_alternatives
from replan.explain.sentences import brief, sentences
from replan.logs.plan import (
    Candidates,
    CostTerms,
    Decision,
    DecisionKind,
    Graph,
    LaneOption,
    Plan,
    PlanStatus,
    PlanSummary,
    SolverReport,
    StGraph,
)
from replan.logs.scenario import Scenario
from replan.logs.trace import PlannedFrame, Trace
from replan.replay.loop_config import LoopConfig
from replan.results.load import StoredDrive

A = TypeVar("A")

MOST_LINES = 5
"""Largest number of lines of a section; the number of further lines is given."""
LONGITUDINAL = (DecisionKind.STOP, DecisionKind.YIELD, DecisionKind.FOLLOW, DecisionKind.OVERTAKE)
"""Decisions about the speed, the strongest first."""
FREE_DRIVE, NO_NUDGE, BOTH = "drive on", "keep", "nudge left and right"
STATUS_WORDS = {
    PlanStatus.PLANNED: "planned",
    PlanStatus.CORRECTED: "plan corrected",
    PlanStatus.PREVIOUS: "previous plan",
    PlanStatus.COMFORTABLE_STOP: "comfortable stop",
    PlanStatus.HARD_STOP: "hard stop",
    PlanStatus.REFUSED: "plan refused",
}
"""The statuses in one or two words; their values are sentences."""
TOUCH_M = 0.1
"""A solution nearer to a bound than this touches it."""
NOISE = 1e-6
"""A smaller cost is within the tolerance of a solver."""
SHOWS = 1e-3
"""A term with a smaller share does not show in the three digits of the sum."""
BOUND_M = 6.0
"""Largest distance at which an obstacle bounds a solution, because planners keep a gap to
obstacles.
"""


@dataclass(frozen=True, slots=True)
class Touch:
    """A bound that a solution touches.

    Attributes:
        plane: "S-T" or "S-L".
        bound: "upper" or "lower".
        agent: The agent whose outline lies beyond it; empty if there is none.
        first, last: Start and end of the stretch, s from the frame (S-T) or station, m (S-L).
        at: The solution in the middle of the stretch, m.
    """

    plane: str
    bound: str
    agent: str
    first: float
    last: float
    at: float


class Section(NamedTuple):
    """Lines under a title, each a name (may be empty) and a statement about it."""

    title: str
    lines: list[tuple[str, str]]


@dataclass(frozen=True, slots=True)
class Explanation:
    """A plan in words and numbers.

    Attributes:
        does: The action of the plan within the next second.
        fallback: Whether the planner failed; then `reason` is part of `because`.
        reason: The planner's own sentence.
        decisions: One for each agent, kind and stage; ignored agents last.
        costs: Costs of the plan, by stage and term.
        lanes: The lanes that the planner compared: cost by term, and the reason against each.
        candidates: How many candidates there were, and why the others were not taken.
        alternatives: The trajectories among which the planner chose, each a name and a statement.
        active: The bounds that the solution touches.
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
    alternatives: tuple[tuple[str, str], ...] = ()

    @classmethod
    def of(cls, frame: PlannedFrame, account: Account, *, bounds: bool = True) -> Explanation:
        """The explanation of a frame's plan; `bounds=False` skips the search for active bounds,
        which takes time.
        """
        plan, because = frame.plan, sentences(account)
        decisions = list(
            {(d.agent, d.kind, d.stage): d for d in reversed(_artefacts(plan, Decision))}.values()
        )[::-1]
        decisions.sort(key=_is_ignored)
        followed = dict.fromkeys(d.agent for d in decisions if d.kind is DecisionKind.FOLLOW)
        if followed and not account.not_passed and (against := not_passed(plan)):
            because.append(f"{', '.join(followed)} is not passed: {'; '.join(against)}.")
        return cls(
            frame.t,
            account.course.action.value,
            tuple(because),
            account,
            plan.status.is_fallback,
            plan.reason,
            tuple(decisions),
            tuple(_artefacts(plan, CostTerms)),
            tuple(_artefacts(plan, LaneOption)),
            tuple(_artefacts(plan, Candidates)),
            tuple(touched(plan)) if bounds else (),
            tuple(_artefacts(plan, SolverReport)),
        )

    def with_alternatives(
        self, trace: Trace, scenario: Scenario, frame: PlannedFrame
    ) -> Explanation:
        """The explanation with the alternatives of the frame's plan, judged in this drive."""
        described = tuple(describe_alternatives(trace, scenario, frame))
        return replace(self, alternatives=described)

    def sections(self) -> Iterator[Section]:
        """All decisions, alternatives, costs and solver reports, as lines of plain text.

        Empty sections are omitted.
        """
        decided = [
            (
                f"{d.agent}: {d.kind.value}",
                f" ({d.stage}): {d.reason}" if d.reason else f" ({d.stage})",
            )
            for d in self.decisions
        ]
        taken = [
            (each.name, f": {format_option(each)}; {each.against or 'taken'}")
            for each in self.lanes
        ]
        candidates = [
            (
                "",
                f"{each.stage}: {each.considered}{f', {each.chosen} taken' * bool(each.chosen)}; "
                "not taken: " + (", ".join(f"{n} {why}" for why, n in each.rejected) or "none"),
            )
            for each in self.candidates
        ]
        active = []
        for one in self.active:
            unit, agent = "s" if one.plane == "S-T" else "m", f" ({one.agent})" if one.agent else ""
            span = f"from {one.first:.1f} {unit} to {one.last:.1f} {unit}"
            active.append(("", f"{one.plane} {one.bound} bound{agent} {span}, at {one.at:.1f} m"))
        costs = [("", f"{each.stage}: {format_terms(each.terms)}") for each in self.costs]
        solvers = [
            (
                "" if r.solved else f"{r.stage}: not solved",
                f"{f'{r.stage}: ' if r.solved else ', '}{r.status}, "
                f"{counted(r.iterations, 'iteration')}, residuals {_residual(r.primal_residual)} "
                f"(primal), {_residual(r.dual_residual)} (dual)",
            )
            for r in self.solvers
        ]
        for title, lines in (
            ("decisions", decided),
            ("lanes", taken),
            ("candidates", candidates),
            ("alternatives", list(self.alternatives)),
            ("active bounds", active),
            ("costs", costs),
            ("solvers", solvers),
        ):
            if lines:
                yield Section(title, lines)


def explained(drive: StoredDrive, at: float | None = None) -> list[Explanation]:
    """Explain the plan at a time, or each plan that differs from the one before it as `changes`.

    Raises:
        ConfigError: There is no plan at that time.
        LogError: The trace is damaged.
    """
    loop = drive.result.run.drive_loop
    if at is None:
        return list(changes(drive.trace, drive.scenario, loop))
    wanted = drive.frame(at).t
    pairs = zip(drive.trace.frames, accounts(drive.trace, drive.scenario, loop), strict=True)
    return [
        Explanation.of(frame, account).with_alternatives(drive.trace, drive.scenario, frame)
        for frame, account in pairs
        if frame.t == wanted
    ]


def changes(
    trace: Trace, scenario: Scenario, loop: LoopConfig | None = None
) -> Iterator[Explanation]:
    """The frames at which the status, lane, a decision or the first cause changes.

    Arguments as `accounts`.
    """
    before: Any = None
    for frame, account in zip(trace.frames, accounts(trace, scenario, loop), strict=True):
        first = account.causes[0] if account.causes else None
        decisions = frozenset(
            (d.agent, d.kind) for d in _artefacts(frame.plan, Decision) if not _is_ignored(d)
        )
        now = (
            frame.plan.status,
            taken_option(lane_options(frame.plan)),
            decisions,
            account.course.action,
            first and (first.kind, first.who),
        )
        if now != before:
            yield Explanation.of(frame, account)
        before = now


MOST_PHASES = 8
"""Largest number of phases of a summary."""


def summary(drive: StoredDrive) -> list[str]:
    """What contradicts itself, which gates fail and why, and the phases with fallbacks and the
    hardest planned braking, in the order of time.

    A phase is consecutive plans with the same first cause, or without any with the same action; a
    plan that only eases a braking belongs to the phase before it. Errors as `explained`.
    """
    all_accounts = list(accounts(drive.trace, drive.scenario, drive.result.run.drive_loop))
    alarms = chain.from_iterable(account.alarms for account in all_accounts)
    return [
        *describe_contradictions(alarms, least=LEAST_FRAMES),
        *broken_gates(drive),
        *_describe_phases(all_accounts),
    ]


def _describe_phases(all_accounts: Sequence[Account]) -> list[str]:
    phases: list[list[Account]] = []
    before: Any = None
    for account in all_accounts:
        first = account.causes[0] if account.causes else None
        now = (first.kind, first.who) if first else account.course.action
        eases = first is not None and first.kind is CauseKind.BEGUN
        if now != before and not (eases and phases and phases[-1][-1].causes):
            phases.append([])
            before = now
        phases[-1].append(account)

    def braking_mps2(account: Account) -> float:
        return account.course.a_least if account.causes else 0.0

    hardest = [min(phase, key=braking_mps2) for phase in phases]

    def weight(k: int) -> tuple[bool, bool, float, int]:
        kind = hardest[k].causes[0].kind if hardest[k].causes else None
        weak = kind is CauseKind.NONE and braking_mps2(hardest[k]) > -FELT_MPS2
        return kind is not CauseKind.FALLBACK, weak, braking_mps2(hardest[k]), k

    shown = sorted(sorted(range(len(phases)), key=weight)[:MOST_PHASES])
    lines = []
    for k in shown:
        account_of_phase, (begin, end) = hardest[k], (phases[k][0].t, phases[k][-1].t)
        course, braking = account_of_phase.course, ""
        if account_of_phase.causes and course.a_least < 0.0:
            braking = f", plans {course.a_least:.1f} m/s²{ahead(course)}"
        why = f", {brief(account_of_phase)}" if account_of_phase.causes else ""
        lines.append(f"{begin:.2f} to {end:.2f} s: {course.action.value}{braking}{why}")
    left = len(phases) - len(shown)
    return [*lines, f"and {counted(left, 'phase')} with less braking"] if left else lines


def lines_of(one: Explanation) -> Iterator[str]:
    """An explanation as text, with only those solvers that failed."""
    yield f"t = {one.t:.2f} s: {one.does}"
    yield from (f"  {sentence}" for sentence in one.because)
    if one.reason and not one.fallback:
        yield f"  The planner's reason: {one.reason}."
    failed = tuple(report for report in one.solvers if not report.solved)
    for title, lines in replace(one, solvers=failed).sections():
        for i, line in enumerate(lines[:MOST_LINES]):
            yield f"    {title if i == 0 else '':<13} {''.join(line)}"
        if len(lines) > MOST_LINES:
            yield f"    {'':<13} and {len(lines) - MOST_LINES} more"


def _artefacts(plan: Plan, kind: type[A]) -> list[A]:
    return [artefact for artefact in plan.internals if isinstance(artefact, kind)]


def _is_ignored(decision: Decision) -> bool:
    return decision.kind is DecisionKind.IGNORE


def _residual(value: float) -> str:
    return f"{value:.1e}" if np.isfinite(value) else "unknown"


# decisions and lanes in a word --------------------------------------------------------------------


def longitudinal(plan: Plan) -> str:
    """The strongest decision of a plan about the speed; `FREE_DRIVE` if there is none."""
    kinds = {decision.kind for decision in _artefacts(plan, Decision)}
    return next((kind.value for kind in LONGITUDINAL if kind in kinds), FREE_DRIVE)


def lateral(plan: Plan) -> str:
    """The decisions of a plan about the side on which obstacles are passed; `NO_NUDGE` if there is
    none.
    """
    kinds = {decision.kind for decision in _artefacts(plan, Decision)}
    left, right = DecisionKind.NUDGE_LEFT in kinds, DecisionKind.NUDGE_RIGHT in kinds
    if left and right:
        return BOTH
    if left:
        return DecisionKind.NUDGE_LEFT.value
    return DecisionKind.NUDGE_RIGHT.value if right else NO_NUDGE


def lane_options(plan: Plan | PlanSummary) -> tuple[LaneOption, ...]:
    """The lanes that a plan compared; empty if it compared none."""
    return tuple(artefact for artefact in plan.internals if isinstance(artefact, LaneOption))


def taken_option(some: Sequence[LaneOption]) -> str:
    """The name of the option that was taken; `KEEP` if there is none."""
    return next((option.name for option in some if not option.against), KEEP)


def describe_choice(some: Sequence[LaneOption]) -> str:
    """The reason for the option that was taken: its cost, and the cost of each other option."""
    name = taken_option(some)
    chosen = next(option for option in some if option.name == name)
    others = "; ".join(
        f"{option.name} {format_option(option)}" for option in some if option is not chosen
    )
    return f"costs {format_option(chosen)} instead of {others}"


def format_option(option: LaneOption) -> str:
    """The cost of an option, and the terms that matter."""
    terms = ", ".join(f"{name} {value:.1f}" for name, value in option.terms if abs(value) >= 0.05)
    return f"{option.cost:.1f} s" + (f" ({terms})" if terms else "")


# costs and bounds ---------------------------------------------------------------------------------


def format_terms(terms: Sequence[tuple[str, float]]) -> str:
    """A cost as the sum of its terms: "4.8 = reference 1.25 + obstacle 3.5"."""
    if not terms:
        return "no terms"
    shown, total = main_terms(terms), sum(value for _, value in terms)
    return (
        f"{total:.3g} = " + " + ".join(f"{name} {value:.3g}" for name, value in shown)
        if shown
        else "0"
    )


def main_terms(terms: Sequence[tuple[str, float]]) -> list[tuple[str, float]]:
    """The terms that show in their sum, without numerical noise.

    Values that are not finite are kept.
    """
    least = max(NOISE, SHOWS * sum(abs(value) for _, value in terms if isfinite(value)))
    return [(name, value) for name, value in terms if abs(value) > least or not isfinite(value)]


def touched(plan: Plan) -> Iterator[Touch]:
    """The stretches in which the solutions of a plan's graphs touch a bound.

    Their given start is ignored.
    """
    for graph in plan.internals:
        if not isinstance(graph, Graph) or graph.corridor is None or len(graph.qp) < 2:
            continue
        abscissas, values = graph.qp.T
        corridor, plane = graph.corridor, "S-T" if isinstance(graph, StGraph) else "S-L"
        for bound in ("upper", "lower"):
            edge = np.interp(
                abscissas, corridor.first, np.clip(getattr(corridor, bound), -1e6, 1e6)
            )
            inside = (
                (abscissas >= corridor.first[0])
                & (abscissas <= corridor.first[-1])
                & (np.arange(len(abscissas)) > 0)
            )
            marks = np.diff(
                np.r_[False, inside & (np.abs(values - edge) < TOUCH_M), False].astype(np.int64)
            )
            for begin, end in zip(
                np.flatnonzero(marks > 0), np.flatnonzero(marks < 0) - 1, strict=True
            ):
                middle = (begin + end) // 2
                agent = _beyond(
                    graph, float(abscissas[middle]), float(edge[middle]), up=bound == "upper"
                )
                if agent or plane == "S-L" or values[end] > values[0] + TOUCH_M:
                    first, last = float(abscissas[begin]), float(abscissas[end])
                    yield Touch(plane, bound, agent, first, last, float(values[middle]))


def _beyond(graph: Graph, abscissa: float, edge: float, *, up: bool) -> str:
    """The obstacle whose outline is nearest beyond an edge."""
    least, nearest = BOUND_M, ""
    for obstacle in graph.obstacles:
        points = obstacle.outline
        if (
            not len(points)
            or not points[:, 0].min() - TOUCH_M <= abscissa <= points[:, 0].max() + TOUCH_M
        ):
            continue
        near = points[
            np.abs(points[:, 0] - abscissa) <= np.abs(points[:, 0] - abscissa).min() + TOUCH_M
        ]
        distance = float(near[:, 1].min() - edge if up else edge - near[:, 1].max())
        if -TOUCH_M <= distance < least:
            least, nearest = distance, obstacle.agent
    return nearest
