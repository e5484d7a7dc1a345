"""A trace as a log: what was driven, what was planned, asked and done; readable again by `read_scenario`.

Ego and agents are those of the trace; road, goal and vehicle those of the scenario. `internals` says how much of the
plans is kept: "none" (status, and trajectory at `KEPT_STEP_S`), "summary" (the whole trajectory, decisions, cost terms,
candidates, compared lanes, solver reports, graphs without the grids of costs, predictions every `SUMMARY_STEP_S`),
"full" (and the grids, and all predictions that the trace has). In graphs null stands for "not reached" and "free". What
a sensor showed of the others is always kept. `read_trace` gives the drive back.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Literal

import numpy as np

from logs import trace as nouns
from logs.errors import LogError
from logs.frame import Predictions
from logs.frame_store import light
from logs.kernel import FloatArray
from logs.mcap import native
from logs.mcap.writer import Entry, column, log_times, samples, scenario_entries, scenario_records, table_of, write_log
from logs.scenario import Scenario, Tracks
from logs.states import TRAJECTORY_COLUMNS

Internals = Literal["none", "summary", "full"]
SUMMARY_STEP_S = 2.0
"""Between two samples of a prediction in a summary: enough to see where two runs expected an agent elsewhere."""


def write_trace(
    path: Path,
    trace: nouns.Trace,
    scenario: Scenario,
    *,
    internals: Internals = "summary",
    beside: Iterable[Entry] = (),
) -> None:
    """Write a trace as a native log, and messages `beside` it on other topics.

    Raises:
        LogError: As `write_scenario`.
    """
    try:
        driven = driven_scenario(trace, scenario)
        records = {
            **scenario_records(driven, version=native.FORMAT_VERSION),
            native.TRACE_RECORD: trace_record(trace, internals),
        }
        entries = scenario_entries(driven, blocks=True), _trace_entries(trace, scenario.start_ns, internals)
        write_log(Path(path), records, chain(*entries, beside))
    except LogError as error:
        raise error.at(path) from None


def driven_scenario(trace: nouns.Trace, scenario: Scenario) -> Scenario:
    """The scenario as it was driven; it lasts until the ego's last state. What it was repaired from is in the log."""
    return replace(
        scenario,
        ego=trace.ego,
        tracks=trace.agents,
        duration=float(trace.ego.t[-1]),
        controls=None,
        repair=None,
        traffic=scenario.traffic_spans,
        notes=tuple(dict.fromkeys((*scenario.notes, *trace.notes))),
    )


def trace_record(trace: nouns.Trace, internals: Internals) -> dict[str, str]:
    """The metadata record of a trace."""
    return {
        "scenario": trace.scenario,
        "planner": trace.planner,
        "mode": trace.mode.value,
        "oracle": str(trace.oracle).lower(),
        "end": trace.end.name.lower(),
        "end_sentence": trace.end.value,
        "detail": trace.detail,
        "internals": internals,
    }


def _trace_entries(trace: nouns.Trace, start_ns: int, internals: Internals) -> Iterator[Entry]:
    times = log_times(np.array([frame.t for frame in light(trace.frames)]), start_ns, "/plan")
    for time, frame in zip(times, trace.frames, strict=True):
        yield time, "/plan", plan_message(frame.plan, internals)
        if internals != "none" and frame.predictions is not None:
            yield time, "/predictions", _predictions(frame, frame.predictions, full=internals == "full")
    if trace.perceived is not None:
        if not _who(trace.perceived).items() <= _who(trace.agents).items():
            yield start_ns, "/perceived/table", table_of(trace.perceived)
        yield from _perceived(trace.perceived, times, start_ns)
    for topic, kind, table in (
        ("/command", native.Controls, trace.commands),
        ("/actuation", native.Controls, trace.actuation),
        ("/tracking", native.Tracking, trace.tracking),
    ):
        if table is not None:
            yield from samples(table, kind, topic, start_ns, blocks=True)


def _who(tracks: Tracks) -> dict[str, tuple[object, ...]]:
    """Kind and size of each."""
    columns = zip(tracks.kinds, tracks.length.tolist(), tracks.width.tolist(), strict=True)
    return dict(zip(tracks.ids, columns, strict=True))


def _perceived(shown: Tracks, frames: list[int], start_ns: int) -> Iterator[Entry]:
    """A message a frame, empty where nobody was seen."""
    times = np.array(log_times(shown.t, start_ns, "/perceived"), dtype=np.int64)
    track = np.repeat(np.arange(len(shown)), np.diff(shown.offsets))
    order = np.lexsort((track, times))
    ordered = times[order]
    for time in frames:
        at = order[np.searchsorted(ordered, time) : np.searchsorted(ordered, time, side="right")]
        columns = (getattr(shown, name)[at].tolist() for name in ("x", "y", "yaw", "vx", "vy"))
        yield time, "/perceived", native.AgentColumns([shown.ids[i] for i in track[at]], *columns)


def _predictions(frame: nouns.PlannedFrame, some: Predictions, *, full: bool) -> native.Predictions:
    ids = [frame.agents[i] for i in some.agent]
    probability = column(some.probability, "/predictions", "probability")
    kept = slice(None) if full else nouns.kept_samples(some.t, SUMMARY_STEP_S)
    x, y = ([column(row[kept], "/predictions", name) for row in getattr(some, name)] for name in ("x", "y"))
    return native.Predictions(some.method, some.t[kept].tolist(), ids, probability, x, y)


def plan_message(plan: nouns.Plan, internals: Internals) -> native.Plan:
    """A plan with as much of its inside as is asked for."""
    planned = plan.trajectory
    kept = nouns.kept_samples(planned.t) if internals == "none" else slice(None)
    columns = [getattr(planned, name)[kept].tolist() for name in TRAJECTORY_COLUMNS]
    message = native.Plan(
        plan.status.name.lower(), plan.reason, plan.start.name.lower(), native.TrajectoryColumns(*columns)
    )
    if internals == "none":
        return message
    for artefact in plan.internals:
        if isinstance(artefact, nouns.Decision):
            message.decisions.append(
                native.Decision(artefact.agent, artefact.kind, artefact.stage, artefact.reason),
            )
        elif isinstance(artefact, nouns.CostTerms):
            message.costs.append(native.CostTerms(artefact.stage, dict(artefact.terms)))
        elif isinstance(artefact, nouns.Candidates):
            message.candidates.append(
                native.Candidates(artefact.stage, artefact.considered, dict(artefact.rejected)),
            )
        elif isinstance(artefact, nouns.LaneOption):
            message.lanes.append(native.LaneOption(artefact.name, dict(artefact.terms), artefact.against))
        elif isinstance(artefact, nouns.SolverReport):
            message.solvers.append(_solver(artefact))
        else:
            message.graphs.append(_graph(artefact, full=internals == "full"))
    return message


def _solver(report: nouns.SolverReport) -> native.SolverReport:
    return native.SolverReport(
        report.stage, report.solved, report.status, report.iterations, report.primal_residual, report.dual_residual
    )


def _graph(graph: nouns.SlGraph | nouns.StGraph, *, full: bool) -> native.Graph:
    return native.Graph(
        plane="sl" if isinstance(graph, nouns.SlGraph) else "st",
        grid=_grid(graph.grid) if full else None,
        corridor=_corridor(graph.corridor),
        dp=_rows(graph.dp),
        qp=_rows(graph.qp),
        obstacles=[native.GraphObstacle(o.agent, _rows(o.outline), o.decision) for o in graph.obstacles],
    )


def _grid(grid: nouns.GridCost | None) -> native.Grid | None:
    if grid is None:
        return None
    chosen = [int(index) for index in grid.chosen]
    return native.Grid(grid.first.tolist(), grid.second.tolist(), _rows(grid.cost), chosen)


def _corridor(corridor: nouns.Corridor | None) -> native.Corridor | None:
    if corridor is None:
        return None
    return native.Corridor(corridor.first.tolist(), corridor.lower.tolist(), corridor.upper.tolist())


def _rows(points: FloatArray) -> list[list[float | None]]:
    rows: list[list[float | None]] = points.tolist()
    return rows
