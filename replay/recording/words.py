"""What a recording says in words: a summary, why each plan is what it is, and the events of the drive."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from logs.scenario import Scenario
from logs.trace import (
    Candidates,
    CostTerms,
    Decision,
    DecisionKind,
    EndReason,
    Graph,
    Plan,
    PlannedFrame,
    SolverReport,
    Trace,
)
from replay.recording import plots
from replay.recording.columns import Instants, Tape
from replay.recording.text import cell, document, plain, table

if TYPE_CHECKING:
    from pandas import DataFrame

MARKDOWN = "text/markdown"
MAX_DECISIONS = 15
"""More decisions than these are counted, not listed (those that are not "ignore" come first)."""


def draw_why(tape: Tape, frames: Sequence[PlannedFrame], instants: Instants) -> None:
    """A page per frame."""
    tape.static("why", rr.TextDocument.from_fields(media_type=MARKDOWN))
    pages = [document(why(frame)) for frame in frames]
    tape.rows("why", instants, rr.TextDocument.columns(text=pages))


def why(frame: PlannedFrame) -> list[str]:
    """The page of a frame: what is planned, the decisions with their reasons, solvers and costs."""
    plan = frame.plan
    headline = [plots.STATUS_WORDS[plan.status]]
    if any(isinstance(artefact, Decision) for artefact in plan.internals):
        headline += [plots.longitudinal(plan), plots.lateral(plan)]
    lines = [f"### t = {frame.t:.2f} s: {', '.join(headline)}"]
    if plan.status.is_fallback or plan.reason:
        lines += ["", f"**{cell(plan.status.value)}**" + (f": {cell(plan.reason)}" if plan.reason else "")]
    lines += ["", _course(frame.t, plan)]
    return [*lines, *_decisions(plan), *_candidates(plan), *_solvers(plan), *_costs(plan)]


def _course(t: float, plan: Plan) -> str:
    """In a sentence what the plan's trajectory does."""
    path = plan.trajectory
    slowest, hardest = int(np.argmin(path.v)), int(np.argmin(path.a))
    words = [f"Speed {path.v[0]:.1f} m/s, {path.v[-1]:.1f} m/s after {path.t[-1] - t:.1f} s"]
    if path.v[slowest] < min(path.v[0], path.v[-1]) - 0.05:
        words.append(f"slowest {path.v[slowest]:.1f} m/s at t = {path.t[slowest]:.1f} s")
    if path.a[hardest] < -0.3:
        words.append(f"hardest braking {path.a[hardest]:.1f} m/s² at t = {path.t[hardest]:.1f} s")
    return f"{'; '.join(words)}. Starts {plan.start.value}."


def _decisions(plan: Plan) -> list[str]:
    found = [artefact for artefact in plan.internals if isinstance(artefact, Decision)]
    found.sort(key=lambda decision: decision.kind is DecisionKind.IGNORE)
    if not found:
        return []
    lines = [
        f"- **{cell(d.agent)}: {d.kind.value}** ({cell(d.stage)}){f': {cell(d.reason)}' if d.reason else ''}"
        for d in found[:MAX_DECISIONS]
    ]
    more = [f"- and {len(found) - MAX_DECISIONS} more"] if len(found) > MAX_DECISIONS else []
    return ["", "#### Decisions", "", *lines, *more]


def _candidates(plan: Plan) -> list[str]:
    stages = [artefact for artefact in plan.internals if isinstance(artefact, Candidates)]
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
    stages = [artefact for artefact in plan.internals if isinstance(artefact, CostTerms)]
    lines = [
        f"- {cell(stage.stage)}: {', '.join(f'{cell(name)} {value:.3g}' for name, value in stage.terms)}"
        for stage in stages
    ]
    return ["", "#### Cost terms", "", *lines] if lines else []


def _short(value: float) -> str:
    return f"{value:.1e}" if np.isfinite(value) else "unknown"


def draw_summary(tape: Tape, lines: Iterable[str]) -> None:
    """The page that does not change."""
    tape.static("summary", rr.TextDocument(document(lines), media_type=MARKDOWN))


def summary(trace: Trace, scenario: Scenario, metrics: DataFrame | None) -> list[str]:
    """Scenario, planner, mode, end, notes, metrics, and how to read the pictures."""
    mode = f"{trace.mode.value} loop" + (", an oracle: it knows the log's future" if trace.oracle else "")
    lines = [f"# {cell(scenario.name)}", "", f"**{cell(trace.planner)}**, {mode}", ""]
    seconds = trace.ego.t[-1] - trace.ego.t[0]
    detail = f" ({cell(trace.detail)})" if trace.detail else ""
    lines += [f"End after {seconds:.2f} s: **{cell(trace.end.value)}**{detail}", ""]
    lines += [*_notes((*trace.notes, *scenario.notes)), *_metrics(metrics), *log_facts(scenario)]
    return lines + (legend(trace) if trace.frames else [])


def log_summary(scenario: Scenario) -> list[str]:
    """The page of a log by itself."""
    return [f"# {cell(scenario.name)}", "", *_notes(scenario.notes), *log_facts(scenario)]


def _notes(notes: Sequence[str]) -> list[str]:
    return ["## Notes", "", *(f"- {cell(note)}" for note in notes), ""] if notes else []


def _metrics(metrics: DataFrame | None) -> list[str]:
    if metrics is None or not len(metrics):
        return []
    rows = []
    for row in metrics.to_dict("records"):
        at = row.get("time_s", np.nan)
        value = f"{row['value']:.4g} {row['unit']}" if row["available"] else "not available"
        when = f"{at:.2f} s" if row["available"] and np.isfinite(at) else ""
        rows.append((row["metric"], value, when, row.get("reason", "") if not row["available"] else ""))
    return ["## Metrics", *table(("metric", "value", "when", "why not"), rows)]


def log_facts(scenario: Scenario) -> list[str]:
    """What the log holds."""
    kinds = [kind.value for kind in scenario.tracks.kinds]
    counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds)) or "none"
    span = scenario.ego.t[-1] - scenario.ego.t[0]
    ego = f"{len(scenario.ego)} states over {span:.1f} s" if len(scenario.ego) > 1 else "its start only"
    facts = [
        ("duration", f"{scenario.duration:.1f} s"),
        ("ego", ego),
        ("agents", counts),
        ("road", f"{len(scenario.road.lanes)} lanes ({scenario.road.source.value})"),
        ("tags", ", ".join(scenario.tags)),
        ("source", scenario.source),
        ("licence", scenario.licence),
    ]
    return ["## Log", *table(("what", "value"), [fact for fact in facts if fact[1]])]


def legend(trace: Trace) -> list[str]:
    """How to read the pictures."""
    graphs = any(isinstance(artefact, Graph) for frame in trace.frames for artefact in frame.plan.internals)
    scene = [
        "- Scene: ego blue, plan from red (standing) to green (fastest) with a dot per second, driven path blue",
        "- Agents: car orange, truck and bus dark orange, pedestrian pink, riders violet, objects grey; "
        "an arrow is the way of a second",
    ]
    graph = [
        "- Graphs: grid nodes from blue (cheapest of their column) to yellow, nodes that were not reached are not "
        "drawn; DP yellow, QP light blue, corridor green",
        "- Obstacles in the colour of the decision: stop and yield red, follow orange, overtake green, nudge violet, "
        "ignore grey",
    ]
    return ["## Legend", "", *scene, *(graph if graphs else []), ""]


@dataclass(frozen=True)
class Event:
    """Something that happened: when, how grave ("INFO", "WARN", "ERROR"), in words."""

    t: float
    level: str
    words: str


def events(trace: Trace) -> list[Event]:
    """Changes of status and of decisions, and the end."""
    found: list[Event] = []
    status, decided = None, dict[str, str]()
    for frame in trace.frames:
        plan = frame.plan
        if plan.status is not status and (status is not None or plan.status.is_fallback):
            level = "WARN" if plan.status.is_fallback else "INFO"
            found.append(Event(frame.t, level, f"{plan.status.value} {f'({plan.reason})' if plan.reason else ''}"))
        now = {
            artefact.agent: f"{artefact.kind.value} ({artefact.reason})"
            for artefact in plan.internals
            if isinstance(artefact, Decision) and artefact.kind is not DecisionKind.IGNORE
        }
        for agent in dict.fromkeys([*now, *decided]):
            before, after = decided.get(agent, "no decision ()"), now.get(agent, "no decision ()")
            if before.split(" (")[0] != after.split(" (")[0]:
                found.append(Event(frame.t, "INFO", f"{agent}: {after.removesuffix(' ()')}"))
        status, decided = plan.status, now
    grave = trace.end in (EndReason.COLLISION, EndReason.OFF_ROAD, EndReason.PLANNER_FAILURE)
    detail = f": {trace.detail}" if trace.detail else ""
    end = Event(float(trace.ego.t[-1]), "ERROR" if grave else "INFO", f"{trace.end.value}{detail}")
    return [*found, end]


def draw_events(tape: Tape, found: Sequence[Event], frames: Instants) -> None:
    """One line of the log view per event."""
    times = np.array([event.t for event in found])
    instants = Instants.among(times, frames.t)
    shown = rr.TextLog.columns(text=[plain(event.words) for event in found], level=[event.level for event in found])
    tape.rows("events", instants, shown)
