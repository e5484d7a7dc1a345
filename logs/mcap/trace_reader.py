"""A trace in: the drive that `write_trace` wrote, with its plans and as much of their inside as was kept.

What the file leaves out is not made up: grids that were not kept are None, and agents that were in a frame without
being predicted are not listed in it. The yaw of a prediction is not in the file: it is NaN.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

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

T = TypeVar("T")


def read_trace(path: Path, whole_at: Sequence[float] | None = None) -> tuple[nouns.Trace, Scenario]:
    """The drive in a file that `write_trace` wrote, and the scenario as it was driven (road, goal, vehicle, lights).

    Args:
        path: The file.
        whole_at: None: everything is read. Else times, s: only the plans that were the newest then have all of their
            inside and the predictions; the others have decisions and compared lanes (three times faster).

    Raises:
        LogError: The file is damaged, is no trace, or breaks the format; nothing else is raised.
    """
    container = read_container(Path(path))
    scenario = scenario_of(container)
    try:
        return _trace(container, scenario, whole_at), scenario
    except LogError as error:
        raise error.at(path) from None


def _trace(container: Container, scenario: Scenario, whole_at: Sequence[float] | None) -> nouns.Trace:
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
        frames=tuple(_frames(streams, start, whole_at)),
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
    return tracks_of({**streams, "/agents": streams["/perceived"], "/obstacles": _none("/obstacles")}, start_ns, [])


def _none(topic: str) -> Stream:
    return Stream(topic, "json", "", "jsonschema", b"")


def _frames(
    streams: dict[str, Stream], start_ns: int, whole_at: Sequence[float] | None
) -> Iterator[nouns.PlannedFrame]:
    plans = streams.get("/plan", _none("/plan"))
    plans.check_order(strictly=True)
    expected = streams.get("/predictions", _none("/predictions"))
    times = seconds(plans.times, start_ns)
    whole = np.full(len(times), whole_at is None)
    if whole_at is not None:
        newest = np.searchsorted(times, np.asarray(whole_at, np.float64) + 1e-9, side="right") - 1
        whole[newest[newest >= 0]] = True
    kept = {time for time, is_whole in zip(plans.times, whole, strict=True) if is_whole}
    shown = dict(zip(*_decoded(expected, kept, native.Predictions), strict=True))
    inside = dict(zip(*_decoded(plans, kept, native.Plan), strict=True))
    outlines = dict(zip(*_decoded(plans, set(plans.times) - kept, native.PlanOutline), strict=True))
    for time, t in zip(plans.times, times.tolist(), strict=True):
        try:
            agents, futures = _predictions(shown[time]) if time in shown else ((), None)
            plan = _plan(inside[time]) if time in inside else _plan(outlines[time])
            yield nouns.PlannedFrame(t, plan, agents, futures)
        except (KeyError, ValueError) as error:
            raise LogError(str(error), topic="/plan", time_ns=time, remedy=MEND) from None


def _decoded(stream: Stream, times: set[int], kind: type[T]) -> tuple[list[int], list[T]]:
    """Times and messages of a stream at some of its times."""
    kept = [i for i, time in enumerate(stream.times) if time in times]
    some = replace(stream, times=[stream.times[i] for i in kept], payloads=[stream.payloads[i] for i in kept])
    return some.times, some.decoded(kind)


def _predictions(message: native.Predictions) -> tuple[tuple[str, ...], Predictions]:
    agents = tuple(dict.fromkeys(message.id))
    rows = np.array([agents.index(name) for name in message.id], dtype=np.int64)
    shape = (len(rows), len(message.t))
    x, y = (np.array(some, np.float64).reshape(shape) for some in (message.x, message.y))
    t, probability = np.array(message.t, np.float64), np.array(message.probability, np.float64)
    return agents, Predictions(t, rows, probability, x, y, np.full(shape, np.nan), message.method)


def _plan(message: native.Plan | native.PlanOutline) -> nouns.Plan:
    columns = (np.array(column, np.float64) for column in msgspec.structs.astuple(message.trajectory))
    return nouns.Plan(
        Trajectory(*columns),
        nouns.PlanStatus[message.status.upper()],
        message.reason,
        nouns.PlanStart[message.start.upper()],
        tuple(artefacts_of(message)),
    )


def artefacts_of(message: native.Plan | native.PlanOutline) -> Iterator[nouns.Artefact]:
    """The inside of a plan, kind by kind."""
    whole = message if isinstance(message, native.Plan) else None
    for d in message.decisions:
        yield nouns.Decision(d.agent, d.kind, d.stage, d.reason)
    for c in whole.costs if whole else ():
        yield nouns.CostTerms(c.stage, _terms(c.terms))
    for some in whole.candidates if whole else ():
        yield nouns.Candidates(some.stage, some.considered, tuple(some.rejected.items()))
    for lane in message.lanes:
        yield nouns.LaneOption(lane.name, _terms(lane.terms), lane.against)
    if whole is None:
        return
    for s in whole.solvers:
        residuals = (np.nan if value is None else value for value in (s.primal_residual, s.dual_residual))
        yield nouns.SolverReport(s.stage, s.solved, s.status, s.iterations, *residuals)
    for graph in whole.graphs:
        yield _graph(graph)


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
