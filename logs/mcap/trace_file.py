"""A trace as a log: driven states, plans, commands and actuation; `read_scenario` reads it again.

Ego and agents are those of the trace; road, goal and vehicle those of the scenario. `internals`
selects the data of plans: "none" (status, and trajectory at `KEPT_STEP_S`), "summary" (the whole
trajectory, decisions, cost terms, candidates, compared lanes, solver reports, graphs without the
grids of costs, predictions every `SUMMARY_STEP_S`), "full" (and the grids, and all predictions that
the trace has). In graphs null stands for "not reached" and "free". The agents as a sensor showed
them are always written.

`read_trace` returns the drive. It does not make up what the file leaves out: grids that were not
written are None, and a frame does not list agents without a prediction. The yaw of a prediction is
not written: it is NaN.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from replan.core.errors import LogError, in_file, reading
from replan.logs import plan as nouns
from replan.logs.codec import message_of, noun_of
from replan.logs.frame import Predictions
from replan.logs.frame_store import light
from replan.logs.mcap import native, plan_messages
from replan.logs.mcap.container import MEND, Container, Stream, read_container
from replan.logs.mcap.reader import marked_tracks, sampled, scenario_of, seconds
from replan.logs.mcap.writer import (
    COLUMNS,
    Entry,
    agent_table,
    column,
    log_times,
    samples,
    scenario_entries,
    scenario_records,
    write_log,
)
from replan.logs.scenario import Scenario
from replan.logs.states import TRAJECTORY_COLUMNS, Controls
from replan.logs.trace import EndReason, Mode, PlannedFrame, Trace, TrackingErrors, kept_samples
from replan.logs.tracks import Tracks

Internals = Literal["none", "summary", "full"]
SUMMARY_STEP_S = 2.0
"""Time between two samples of a prediction in a summary, which shows where the predictions of two
runs differ, s.
"""


def write_trace(
    path: Path,
    trace: Trace,
    scenario: Scenario,
    *,
    internals: Internals = "summary",
    beside: Iterable[Entry] = (),
) -> None:
    """Write a trace as a native log, and messages `beside` it on other topics; LogError as in
    `write_scenario`.
    """
    with in_file(path):
        driven = driven_scenario(trace, scenario)
        records = {
            **scenario_records(driven, version=native.FORMAT_VERSION),
            native.TRACE_RECORD: trace_record(trace, internals),
        }
        entries = (
            scenario_entries(driven, blocks=True),
            _trace_entries(trace, scenario.start_ns, internals),
        )
        write_log(Path(path), records, chain(*entries, beside))


def driven_scenario(trace: Trace, scenario: Scenario) -> Scenario:
    """The scenario as it was driven, until the ego's last state.

    The data before its repair stays in the log.
    """
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


def trace_record(trace: Trace, internals: Internals) -> dict[str, str]:
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


def _trace_entries(trace: Trace, start_ns: int, internals: Internals) -> Iterator[Entry]:
    times = log_times(np.array([frame.t for frame in light(trace.frames)]), start_ns, "/plan")
    for time, frame in zip(times, trace.frames, strict=True):
        yield time, "/plan", plan_message(frame.plan, internals)
        if internals != "none" and frame.predictions is not None:
            futures = frame.predictions
            ids = [frame.agents[i] for i in futures.agent]
            probability = column(futures.probability, "/predictions", "probability")
            within = slice(None) if internals == "full" else kept_samples(futures.t, SUMMARY_STEP_S)
            x, y = (
                [column(row[within], "/predictions", name) for row in getattr(futures, name)]
                for name in ("x", "y")
            )
            message = plan_messages.Predictions(
                futures.method, futures.t[within].tolist(), ids, probability, x, y
            )
            yield time, "/predictions", message
    if trace.perceived is not None:
        if not _who(trace.perceived).items() <= _who(trace.agents).items():
            yield start_ns, "/perceived/table", agent_table(trace.perceived)
        shown = trace.perceived
        at_ns = np.array(log_times(shown.t, start_ns, "/perceived"), dtype=np.int64)
        order = np.lexsort((shown.owner, at_ns))
        ordered = at_ns[order]
        for time in times:  # an empty message where no agent was seen
            rows = order[
                np.searchsorted(ordered, time) : np.searchsorted(ordered, time, side="right")
            ]
            columns = (getattr(shown, name)[rows].tolist() for name in COLUMNS)
            yield (
                time,
                "/perceived",
                native.AgentColumns([shown.ids[i] for i in shown.owner[rows]], *columns),
            )
    for topic, kind, table in (
        ("/command", native.Controls, trace.commands),
        ("/actuation", native.Controls, trace.actuation),
        ("/tracking", native.Tracking, trace.tracking),
    ):
        if table is not None:
            yield from samples(table, kind, topic, start_ns, blocks=True)


def _who(tracks: Tracks) -> dict[str, tuple[object, ...]]:
    columns = zip(tracks.kinds, tracks.length.tolist(), tracks.width.tolist(), strict=True)
    return dict(zip(tracks.ids, columns, strict=True))


def plan_message(plan: nouns.Plan, internals: Internals) -> plan_messages.Plan:
    """The message of a plan, with the part of its internals that `internals` selects."""
    planned = plan.trajectory
    shown = kept_samples(planned.t) if internals == "none" else slice(None)
    columns = plan_messages.TrajectoryColumns(
        *(getattr(planned, name)[shown].tolist() for name in TRAJECTORY_COLUMNS)
    )
    if internals == "none":
        return message_of(plan_messages.Plan, plan, trajectory=columns, alternatives=[])
    inside = inside_of(plan.internals, full=internals == "full")
    return message_of(plan_messages.Plan, plan, trajectory=columns, **inside)


_INSIDE: dict[str, tuple[type[msgspec.Struct], tuple[type[nouns.Artefact], ...]]] = {
    "decisions": (plan_messages.Decision, (nouns.Decision,)),
    "costs": (plan_messages.CostTerms, (nouns.CostTerms,)),
    "candidates": (plan_messages.Candidates, (nouns.Candidates,)),
    "lanes": (plan_messages.LaneOption, (nouns.LaneOption,)),
    "solvers": (plan_messages.SolverReport, (nouns.SolverReport,)),
    "graphs": (plan_messages.Graph, (nouns.SlGraph, nouns.StGraph)),
}
"""Name and message type of each kind of artefact of a plan, in the order in which they are read."""
_PLACE = {
    noun: (name, kind) for name, (kind, nouns_of_kind) in _INSIDE.items() for noun in nouns_of_kind
}


def inside_of(internals: Iterable[nouns.Artefact], *, full: bool = True) -> dict[str, Any]:
    """The artefacts of a plan as lists of messages, by the name of the list.

    Graphs without grids unless `full`.
    """
    artefacts: dict[str, Any] = {}
    for artefact in internals:
        name, kind = _PLACE[type(artefact)]
        left_out = {} if full or name != "graphs" else {"grid": None}
        artefacts.setdefault(name, []).append(message_of(kind, artefact, **left_out))
    return artefacts


def artefacts_of(message: msgspec.Struct) -> Iterator[nouns.Artefact]:
    """The artefacts in the lists of a message, which may have only some of the lists."""
    for name, (_, kinds) in _INSIDE.items():
        for artefact in getattr(message, name, ()):
            kind: Any = kinds[name == "graphs" and artefact.plane == "st"]
            noun = noun_of(kind, artefact)
            yield _with_choice(noun) if isinstance(noun, nouns.Candidates) else noun


def _with_choice(candidates: nouns.Candidates) -> nouns.Candidates:
    """The candidates of a former trace, in which the reason of the stage "passing" began with the
    name of the rejected candidate.
    """
    names = {"pass: ": "keep", "keep: ": "pass"}
    if candidates.chosen or candidates.stage != "passing" or not candidates.rejected:
        return candidates
    ((reason, count),) = candidates.rejected
    for prefix, chosen in names.items():
        if reason.startswith(prefix):
            reasons = ((reason.removeprefix(prefix), count),)
            return replace(candidates, rejected=reasons, chosen=chosen)
    return candidates


def read_trace(path: Path) -> tuple[Trace, Scenario]:
    """The drive in a file that `write_trace` wrote, and the scenario as it was driven (road, goal,
    vehicle, lights).

    Raises:
        LogError: The file is damaged, is not a trace, or breaks the format; no other error is
            raised.
    """
    container = read_container(Path(path))
    scenario = scenario_of(container)
    with in_file(path):
        return _trace(container, scenario, _frames(container.streams, scenario.start_ns)), scenario


def read_moment(path: Path, t: float) -> tuple[Trace, Scenario, tuple[nouns.PlanSummary, ...]]:
    """As `read_trace`, with only the newest plan at `t` (s), and a summary of each plan; four times
    faster.

    Raises:
        LogError: As in `read_trace`, except for errors in the other plans.
    """
    container = read_container(Path(path))
    scenario = scenario_of(container)
    with in_file(path):
        streams, start = container.streams, scenario.start_ns
        plans, summaries = streams.get("/plan", _none("/plan")), list[nouns.PlanSummary]()
        plans.check_order(strictly=True)
        times = seconds(plans.times, start).tolist()
        for time, known_at, message in zip(
            plans.times, times, plans.decoded(plan_messages.PlanHead), strict=True
        ):
            with reading((KeyError,), topic="/plan", time_ns=time, remedy=MEND):
                summaries.append(
                    noun_of(
                        nouns.PlanSummary,
                        message,
                        t=known_at,
                        internals=tuple(artefacts_of(message)),
                    )
                )
        newest = (
            int(np.searchsorted([summary.t for summary in summaries], t + 1e-9, side="right")) - 1
        )
        newest_streams = {}
        for topic in ("/plan", "/predictions") if newest >= 0 else ():
            stream, time = streams.get(topic, _none(topic)), plans.times[newest]
            entries = [i for i, stamp in enumerate(stream.times) if stamp == time]
            newest_streams[topic] = replace(
                stream, times=[time] * len(entries), payloads=[stream.payloads[i] for i in entries]
            )
        return (
            _trace(container, scenario, _frames(newest_streams, start)),
            scenario,
            tuple(summaries),
        )


def _trace(container: Container, scenario: Scenario, frames: Iterator[PlannedFrame]) -> Trace:
    record = container.metadata.get(native.TRACE_RECORD)
    if record is None:
        raise LogError(
            "a log, and no drive of a planner",
            remedy="name a trace: open.mcap or closed.mcap of a result",
        )
    streams, start = container.streams, scenario.start_ns
    try:
        mode, end = Mode(record["mode"]), EndReason[record["end"].upper()]
    except (KeyError, ValueError) as error:
        raise LogError(f"bad or missing {error}", topic=native.TRACE_RECORD, remedy=MEND) from None
    asked, actuation = (
        Controls(**sampled(streams[name], native.Controls, start)) if name in streams else None
        for name in ("/command", "/actuation")
    )
    tracking = (
        TrackingErrors(**sampled(streams["/tracking"], native.Tracking, start))
        if actuation
        else None
    )
    perceived = Tracks.empty() if "/perceived" in streams else None
    table = streams.get("/perceived/table", streams.get("/agents/table"))
    if "/perceived" in streams and table is not None:
        perceived, _ = marked_tracks(
            {"/agents/table": table, "/agents": streams["/perceived"]}, start, []
        )
    return Trace(
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
        actuation=actuation,
        tracking=tracking,
        notes=scenario.notes,
        perceived=perceived,
    )


def _none(topic: str) -> Stream:
    return Stream(topic, "json", "", "jsonschema", b"")


def _frames(streams: dict[str, Stream], start_ns: int) -> Iterator[PlannedFrame]:
    plans = streams.get("/plan", _none("/plan"))
    plans.check_order(strictly=True)
    expected = streams.get("/predictions", _none("/predictions"))
    predictions = dict(
        zip(expected.times, expected.decoded(plan_messages.Predictions), strict=True)
    )
    for time, t, message in zip(
        plans.times,
        seconds(plans.times, start_ns).tolist(),
        plans.decoded(plan_messages.Plan),
        strict=True,
    ):
        with reading((KeyError, ValueError), topic="/plan", time_ns=time, remedy=MEND):
            shown, agents, futures = predictions.get(time), tuple[str, ...](), None
            if shown is not None:
                agents = tuple(dict.fromkeys(shown.id))
                row = {name: i for i, name in enumerate(agents)}
                rows = np.array([row[name] for name in shown.id], dtype=np.int64)
                shape = (len(rows), len(shown.t))
                x, y = (
                    np.array(coordinates, np.float64).reshape(shape)
                    for coordinates in (shown.x, shown.y)
                )
                futures = noun_of(
                    Predictions, shown, agent=rows, x=x, y=y, yaw=np.full(shape, np.nan)
                )
            plan = noun_of(nouns.Plan, message, internals=tuple(artefacts_of(message)))
            yield PlannedFrame(t, plan, agents, futures)
