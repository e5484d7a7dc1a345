"""The pages of a recording: the reasons for each plan, its costs, recent events, and a summary of
the drive.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from replan.core.names import counted, listed
from replan.draw.recording.moving import unseen
from replan.draw.recording.state_rows import LaneChange, changes_under_way, lanes_driven
from replan.draw.recording.tape import MARKDOWN, Instants, Tape, cell, document, plain, table
from replan.explain import Explanation, accounts
from replan.explain.course import BRAKES_MPS2
from replan.explain.drive_events import TimedEvent
from replan.explain.explanation import FREE_DRIVE, NO_NUDGE, STATUS_WORDS, lateral, longitudinal
from replan.logs.plan import Decision, Graph, PlanStatus
from replan.logs.scenario import Scenario
from replan.logs.trace import PlannedFrame, Trace

if TYPE_CHECKING:
    from pandas import DataFrame

MAX_LINES = 15  # Largest number of lines of a section; the page gives the number of further lines
MAX_MISSING = 6
SAME_MPS = 0.05
HEADINGS = {"decisions": "Decisions (s from now, m along the path)", "costs": "Cost terms"}
"""Headings of sections whose heading differs from their title."""
# Sections of the second page, which is only needed if a plan looks odd
NUMBERS = ("costs", "solvers")
MOST_RECENT = 6  # Rows of the page of recent events: all visible in a window of usual size


def draw_why(tape: Tape, trace: Trace, scenario: Scenario, instants: Instants) -> None:
    """The pages "why" and "numbers" of each frame."""
    changes = changes_under_way(trace.frames, lanes_driven(trace, scenario.road))
    pages: dict[str, list[str]] = {"why": [], "numbers": []}
    for frame, account, change in zip(
        trace.frames, accounts(trace, scenario), changes, strict=True
    ):
        explained = Explanation.of(frame, account, bounds=False)
        explained = explained.with_alternatives(trace, scenario, frame)
        pages["why"].append(
            document(map(tape.short, why(frame, explained, unseen(trace, frame.t), change)))
        )
        pages["numbers"].append(document(map(tape.short, numbers(explained))))
    for page, texts in pages.items():
        tape.static(page, rr.TextDocument.from_fields(media_type=MARKDOWN))
        tape.rows(page, instants, rr.TextDocument.columns(text=texts))


def why(
    frame: PlannedFrame,
    explained: Explanation,
    missing: Sequence[tuple[str, float]] = (),
    change: LaneChange | None = None,
) -> list[str]:
    """The page of a frame: the plan and its causes, then decisions, lanes and candidates.

    `missing`: agents that are near but were not shown to the planner, and their distances, m.
    """
    plan, course = frame.plan, explained.account.course
    words = [] if plan.status is PlanStatus.PLANNED else [STATUS_WORDS[plan.status]]
    if any(isinstance(artefact, Decision) for artefact in plan.internals):
        words += [
            word
            for word in (longitudinal(plan), lateral(plan))
            if word not in (FREE_DRIVE, NO_NUDGE)
        ]
    headline = ": ".join([explained.does, ", ".join(words)]) if words else explained.does
    lines = [f"### t = {explained.t:.2f} s: {headline}"]
    if explained.reason and not explained.fallback:
        lines += ["", f"**Reason: {cell(explained.reason)}**"]
    if change is not None:
        lines += [
            "",
            f"**Changes lane to the {change.name}** since t = {change.t:.2f} s: "
            f"{cell(change.reason)}",
        ]
    for sentence in explained.because:
        first, colon, rest = sentence.partition(": ")
        lines += ["", f"**{cell(first)}**{colon}{cell(rest)}"]
    moves = [
        f"Speed {course.v_start:.1f} m/s, {course.v_end:.1f} m/s after {course.duration:.1f} s"
    ]
    if course.v_least < min(course.v_start, course.v_end) - SAME_MPS:
        moves.append(
            f"slowest {course.v_least:.1f} m/s at t = {explained.t + course.t_least:.1f} s"
        )
    if course.a_least < BRAKES_MPS2:
        moves.append(
            f"hardest braking {course.a_least:.1f} m/s² at t = "
            f"{explained.t + course.t_hardest:.1f} s"
        )
    lines += ["", f"{'; '.join(moves)}. Starts {plan.start.value}."]
    if missing:
        named = listed([f"{cell(name)} ({away:.0f} m)" for name, away in missing], MAX_MISSING)
        lines += ["", f"**Not seen by the sensor:** {named}"]
    return lines + _sections(explained, numbers=False)


def numbers(explained: Explanation) -> list[str]:
    """The second page of a frame: cost terms and the reports of the solvers."""
    lines = _sections(explained, numbers=True)
    return [
        f"### t = {explained.t:.2f} s",
        *(lines or ["", "The planner reports neither costs nor solvers."]),
    ]


def _sections(explained: Explanation, *, numbers: bool) -> list[str]:
    lines = []
    for title, rows in explained.sections():
        if (title in NUMBERS) is not numbers:
            continue
        lines += ["", f"#### {HEADINGS.get(title, title.capitalize())}", ""]
        for name, rest in rows[:MAX_LINES]:
            space = " " if rest.startswith(" ") else ""  # `cell` removes it
            lines.append(f"- **{cell(name)}**{space}{cell(rest)}" if name else f"- {cell(rest)}")
        lines += [f"- and {len(rows) - MAX_LINES} more"] if len(rows) > MAX_LINES else []
    return lines


def draw_events(tape: Tape, occurred: Sequence[TimedEvent], frames: Instants) -> None:
    """Draw one line of the log view per event, and at the time of each event a page of recent
    events.

    A page has the newest event first; grave events are bold.
    """
    occurred = [replace(event, words=tape.short(event.words)) for event in occurred]
    tape.static("recent", rr.TextDocument.from_fields(media_type=MARKDOWN))
    changes, pages = np.unique([*frames.t[:1], *(event.t for event in occurred)]), []
    for t in changes:
        past = [event for event in occurred if event.t <= t + 1e-9]
        rows = []
        for event in past[::-1][:MOST_RECENT]:
            bold = "" if event.level == "INFO" else "**"
            rows.append(f"- **{event.t:.1f} s** {bold}{cell(event.words)}{bold}")
        pages.append(document(rows or ["nothing yet"]))
    tape.rows("recent", Instants.among(changes, frames.t), rr.TextDocument.columns(text=pages))
    instants = Instants.among(np.array([event.t for event in occurred]), frames.t)
    shown = rr.TextLog.columns(
        text=[plain(event.words) for event in occurred], level=[event.level for event in occurred]
    )
    tape.rows("events", instants, shown)


# the summary --------------------------------------------------------------------------------------


def draw_summary(tape: Tape, lines: Iterable[str]) -> None:
    """Write the summary, which is the same at all times."""
    tape.static("summary", rr.TextDocument(document(map(tape.short, lines)), media_type=MARKDOWN))


def summary(trace: Trace, scenario: Scenario, metrics: DataFrame | None) -> list[str]:
    """Scenario, planner, mode, end, notes, metrics, and a legend of the pictures."""
    mode = f"{trace.mode.value} loop" + (
        ", an oracle: it knows the log's future" if trace.oracle else ""
    )
    seconds = trace.ego.t[-1] - trace.ego.t[0]
    detail = f" ({cell(trace.detail)})" if trace.detail else ""
    lines = [
        f"# {cell(scenario.name)}",
        "",
        f"**{cell(trace.planner)}**, {mode}",
        "",
        f"End after {seconds:.2f} s: **{cell(trace.end.value)}**{detail}",
        "",
        *_notes((*trace.notes, *scenario.notes)),
    ]
    if metrics is not None and len(metrics):
        rows = []
        for row in metrics.to_dict("records"):
            time_s, available = row.get("time_s", np.nan), row["available"]
            value = f"{row['value']:.4g} {row['unit']}" if available else "not available"
            time = f"{time_s:.2f} s" if available and np.isfinite(time_s) else ""
            rows.append((row["metric"], value, time, "" if available else row.get("reason", "")))
        lines += ["## Metrics", *table(("metric", "value", "when", "why not"), rows)]
    return [*lines, *log_facts(scenario), *(legend(trace) if trace.frames else [])]


def log_summary(scenario: Scenario) -> list[str]:
    """The summary of a log by itself."""
    return [f"# {cell(scenario.name)}", "", *_notes(scenario.notes), *log_facts(scenario)]


def _notes(notes: Sequence[str]) -> list[str]:
    return ["## Notes", "", *(f"- {cell(note)}" for note in notes), ""] if notes else []


def log_facts(scenario: Scenario) -> list[str]:
    """The contents of the log."""
    kinds = [kind.value for kind in scenario.tracks.kinds]
    counts = ", ".join(counted(kinds.count(kind), kind) for kind in dict.fromkeys(kinds)) or "none"
    span = scenario.ego.t[-1] - scenario.ego.t[0]
    facts = [
        ("duration", f"{scenario.duration:.1f} s"),
        (
            "ego",
            f"{len(scenario.ego)} states over {span:.1f} s"
            if len(scenario.ego) > 1
            else "its start only",
        ),
        ("agents", counts),
        ("road", f"{counted(len(scenario.road.lanes), 'lane')} ({scenario.road.source.value})"),
        ("tags", ", ".join(scenario.tags)),
        ("source", scenario.source),
        ("licence", scenario.licence),
    ]
    return ["## Log", *table(("what", "value"), [fact for fact in facts if fact[1]])]


def legend(trace: Trace) -> list[str]:
    """The lines that explain the pictures."""
    graphs = any(
        isinstance(artefact, Graph) for frame in trace.frames for artefact in frame.plan.internals
    )
    scene = [
        "- Scene: the ego and its driven path are blue; the plan is red (standing) to green "
        "(fastest), with a dot per second",
        "- Agents: cars are orange, trucks and buses dark orange, pedestrians pink, riders violet, "
        "objects grey; an arrow shows the displacement in one second",
        "- Thin lines from agents: their predictions as shown to the planner, likelier ones "
        "brighter",
        "- Teal boxes: agents where the planner saw them (through a sensor model, or carried on "
        "after the end of their "
        "log); teal rim: the range of the sensor; violet lines: hidden ground",
    ]
    graph = [
        "- Graphs: the nodes of the grid are blue (cheapest of their column) to yellow, without "
        "those that were not reached; DP yellow, QP light blue, corridor green",
        "- Pink outlines in the S-T graph: where its agents really drove, without margin",
        "- Obstacles have the colour of the decision: stop and yield red, follow orange, overtake "
        "green, nudge violet, ignore grey",
    ]
    return ["## Legend", "", *scene, *(graph if graphs else []), ""]
