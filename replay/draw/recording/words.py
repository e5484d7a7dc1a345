"""The page of a recording that does not change: scenario, planner, end, metrics, and how to read the pictures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from logs.names import counted
from logs.scenario import Scenario
from logs.trace import Graph, Trace
from replay.draw.recording.columns import Tape
from replay.draw.recording.text import MARKDOWN, cell, document, table

if TYPE_CHECKING:
    from pandas import DataFrame


def draw_summary(tape: Tape, lines: Iterable[str]) -> None:
    """The page that does not change."""
    tape.static("summary", rr.TextDocument(document(map(tape.short, lines)), media_type=MARKDOWN))


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
    counts = ", ".join(counted(kinds.count(kind), kind) for kind in dict.fromkeys(kinds)) or "none"
    span = scenario.ego.t[-1] - scenario.ego.t[0]
    ego = f"{len(scenario.ego)} states over {span:.1f} s" if len(scenario.ego) > 1 else "its start only"
    facts = [
        ("duration", f"{scenario.duration:.1f} s"),
        ("ego", ego),
        ("agents", counts),
        ("road", f"{counted(len(scenario.road.lanes), 'lane')} ({scenario.road.source.value})"),
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
        "- Thin lines from agents: their futures as the planner was shown them, the likelier the brighter",
        "- Boxes of teal lines: where the planner was shown an agent (through a sensor, or carried on after its log "
        "has ended); teal rim: how far the sensor sees; violet lines: ground that is hidden from it",
    ]
    graph = [
        "- Graphs: grid nodes from blue (cheapest of their column) to yellow, nodes that were not reached are not "
        "drawn; DP yellow, QP light blue, corridor green",
        "- Pink outlines in the S-T graph: where those in it then were, as they moved, without margin",
        "- Obstacles in the colour of the decision: stop and yield red, follow orange, overtake green, nudge violet, "
        "ignore grey",
    ]
    return ["## Legend", "", *scene, *(graph if graphs else []), ""]
