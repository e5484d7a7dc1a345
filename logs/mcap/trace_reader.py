"""A trace in: the drive that `write_trace` wrote, with its plans and as much of their inside as was kept.

What the file leaves out is not made up: grids that were not kept are None, and agents that were in a frame without
being predicted are not listed in it. The yaw of a prediction is not in the file: it is NaN.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from logs import trace as nouns
from logs.errors import LogError
from logs.frame import Predictions
from logs.kernel import FloatArray
from logs.mcap import native
from logs.mcap.container import MEND, Container, Stream, read_container
from logs.mcap.reader import controls_of, sampled, scenario_of, seconds, tracks_of
from logs.scenario import Scenario, Tracks
from logs.states import Trajectory


def read_trace(path: Path) -> tuple[nouns.Trace, Scenario]:
    """The drive in a file that `write_trace` wrote, and the scenario as it was driven (road, goal, vehicle, lights).

    Raises:
        LogError: The file is damaged, is no trace, or breaks the format; nothing else is raised.
    """
    container = read_container(Path(path))
    scenario = scenario_of(container)
    try:
        return _trace(container, scenario, _frames(container.streams, scenario.start_ns)), scenario
    except LogError as error:
        raise error.at(path) from None


def read_moment(path: Path, t: float) -> tuple[nouns.Trace, Scenario, tuple[nouns.PlanSummary, ...]]:
    """As `read_trace`, with only the plan that was the newest at `t` (s); and what each plan says. Four times faster.

    Raises:
        LogError: As `read_trace`, but for what is wrong with the other plans.
    """
    container = read_container(Path(path))
    scenario = scenario_of(container)
    try:
        streams, start = container.streams, scenario.start_ns
        said = tuple(_summaries(streams.get("/plan", _none("/plan")), start))
        newest = int(np.searchsorted([one.t for one in said], t + 1e-9, side="right")) - 1
        kept = {streams["/plan"].times[newest]} if newest >= 0 else set()
        some = {topic: _taken(stream, kept) for topic, stream in streams.items() if topic in ("/plan", "/predictions")}
        return _trace(container, scenario, _frames(some, start)), scenario, said
    except LogError as error:
        raise error.at(path) from None


def _taken(stream: Stream, times: set[int]) -> Stream:
    """The messages of a stream at some times."""
    kept = [i for i, time in enumerate(stream.times) if time in times]
    return replace(stream, times=[stream.times[i] for i in kept], payloads=[stream.payloads[i] for i in kept])


def _summaries(plans: Stream, start_ns: int) -> Iterator[nouns.PlanSummary]:
    plans.check_order(strictly=True)
    times = seconds(plans.times, start_ns).tolist()
    for time, t, message in zip(plans.times, times, plans.decoded(native.PlanSaid), strict=True):
        try:
            status = nouns.PlanStatus[message.status.upper()]
        except KeyError as error:
            raise LogError(str(error), topic="/plan", time_ns=time, remedy=MEND) from None
        decisions, lanes = _decided(message)
        yield nouns.PlanSummary(t, status, message.reason, (*decisions, *lanes))


def _trace(container: Container, scenario: Scenario, frames: Iterator[nouns.PlannedFrame]) -> nouns.Trace:
    record = container.metadata.get(native.TRACE_RECORD)
    if record is None:
        raise LogError("a log, and no drive of a planner", remedy="name a trace: open.mcap or closed.mcap of a result")
    streams, start = container.streams, scenario.start_ns
    try:
        mode, end = nouns.Mode(record["mode"]), nouns.EndReason[record["end"].upper()]
    except (KeyError, ValueError) as error:
        raise LogError(f"bad or missing {error}", topic=native.TRACE_RECORD, remedy=MEND) from None
    asked, done = (
        controls_of(streams[name], start) if name in streams else None for name in ("/command", "/actuation")
    )
    tracking = nouns.TrackingErrors(**sampled(streams["/tracking"], native.Tracking, start)) if done else None
    return nouns.Trace(
        scenario=record.get("scenario", scenario.name),
        planner=record.get("planner", ""),
        mode=mode,
        oracle=record.get("oracle") == "true",
        ego=scenario.ego,
        agents=scenario.tracks,
        frames=tuple(frames),
        end=end,
        detail=record.get("detail", ""),
        commands=asked,
        actuation=done,
        tracking=tracking,
        notes=scenario.notes,
        perceived=_perceived(streams, start),
    )


def _perceived(streams: dict[str, Stream], start_ns: int) -> Tracks | None:
    if "/perceived" not in streams:
        return None
    table = streams.get("/perceived/table", streams.get("/agents/table"))
    if table is None:  # there is no other: nothing was seen
        return Tracks.empty()
    seen = {"/agents/table": table, "/agents": streams["/perceived"]}
    return tracks_of(seen, start_ns, [])


def _none(topic: str) -> Stream:
    return Stream(topic, "json", "", "jsonschema", b"")


def _frames(streams: dict[str, Stream], start_ns: int) -> Iterator[nouns.PlannedFrame]:
    plans = streams.get("/plan", _none("/plan"))
    plans.check_order(strictly=True)
    expected = streams.get("/predictions", _none("/predictions"))
    predictions = dict(zip(expected.times, expected.decoded(native.Predictions), strict=True))
    for time, t, message in zip(
        plans.times, seconds(plans.times, start_ns).tolist(), plans.decoded(native.Plan), strict=True
    ):
        try:
            shown = predictions.get(time)
            agents, futures = ((), None) if shown is None else _predictions(shown)
            yield nouns.PlannedFrame(t, _plan(message), agents, futures)
        except (KeyError, ValueError) as error:
            raise LogError(str(error), topic="/plan", time_ns=time, remedy=MEND) from None


def _predictions(message: native.Predictions) -> tuple[tuple[str, ...], Predictions]:
    agents = tuple(dict.fromkeys(message.id))
    row = {name: i for i, name in enumerate(agents)}
    rows = np.array([row[name] for name in message.id], dtype=np.int64)
    shape = (len(rows), len(message.t))
    x, y = (np.array(some, np.float64).reshape(shape) for some in (message.x, message.y))
    t, probability = np.array(message.t, np.float64), np.array(message.probability, np.float64)
    return agents, Predictions(t, rows, probability, x, y, np.full(shape, np.nan), message.method)


def _plan(message: native.Plan) -> nouns.Plan:
    columns = (np.array(column, np.float64) for column in msgspec.structs.astuple(message.trajectory))
    return nouns.Plan(
        Trajectory(*columns),
        nouns.PlanStatus[message.status.upper()],
        message.reason,
        nouns.PlanStart[message.start.upper()],
        tuple(artefacts_of(message)),
    )


def artefacts_of(message: native.Plan) -> Iterator[nouns.Artefact]:
    """The inside of a plan, kind by kind."""
    decisions, lanes = _decided(message)
    yield from decisions
    for c in message.costs:
        yield nouns.CostTerms(c.stage, _terms(c.terms))
    for some in message.candidates:
        yield nouns.Candidates(some.stage, some.considered, tuple(some.rejected.items()))
    yield from lanes
    for s in message.solvers:
        residuals = (np.nan if value is None else value for value in (s.primal_residual, s.dual_residual))
        yield nouns.SolverReport(s.stage, s.solved, s.status, s.iterations, *residuals)
    for graph in message.graphs:
        yield _graph(graph)


def _decided(message: native.Plan | native.PlanSaid) -> tuple[list[nouns.Decision], list[nouns.LaneOption]]:
    decisions = [nouns.Decision(d.agent, d.kind, d.stage, d.reason) for d in message.decisions]
    return decisions, [nouns.LaneOption(lane.name, _terms(lane.terms), lane.against) for lane in message.lanes]


def _terms(terms: dict[str, float | None]) -> tuple[tuple[str, float], ...]:
    return tuple((name, np.nan if value is None else value) for name, value in terms.items())


def _graph(message: native.Graph) -> nouns.SlGraph | nouns.StGraph:
    kind = nouns.SlGraph if message.plane == "sl" else nouns.StGraph
    obstacles = tuple(nouns.GraphObstacle(o.agent, _points(o.outline), o.decision) for o in message.obstacles)
    grid, corridor = _grid(message.grid), _corridor(message.corridor)
    return kind(grid, corridor, _points(message.dp), _points(message.qp), obstacles)


def _grid(message: native.Grid | None) -> nouns.GridCost | None:
    if message is None:
        return None
    cost = _filled(message.cost, np.inf).reshape(len(message.first), len(message.second))
    chosen = np.array(message.chosen, dtype=np.int64)
    return nouns.GridCost(np.array(message.first), np.array(message.second), cost, chosen)


def _corridor(message: native.Corridor | None) -> nouns.Corridor | None:
    if message is None:
        return None
    return nouns.Corridor(np.array(message.first), _filled(message.lower, -np.inf), _filled(message.upper, np.inf))


def _filled(values: Sequence[Any], absent: float) -> FloatArray:
    """The values with `absent` in the place of null."""
    found = np.array(values, np.float64)
    return np.where(np.isnan(found), absent, found)


def _points(rows: Sequence[Sequence[float | None]]) -> FloatArray:
    return np.array(rows, np.float64).reshape(len(rows), 2)
