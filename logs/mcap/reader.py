"""Reads a native or OSI file as a Scenario, or raises one LogError that names file, topic and time.

Coordinates of a native log are relative to the origin in its metadata; the reader keeps the origin
and subtracts nothing. `complete.py` fills in what the log leaves out, with a note.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.core.errors import LogError, in_file, reading
from replan.core.names import counted
from replan.logs import road as nouns
from replan.logs.agents import ObjectClass, codes_of
from replan.logs.codec import noun_of
from replan.logs.complete import completed, road_along
from replan.logs.driving import DrivingModes
from replan.logs.mcap import native, osi, plan_messages
from replan.logs.mcap.container import (
    CONVERT,
    LAST_TIME_NS,
    MEND,
    Container,
    Stream,
    read_container,
)
from replan.logs.mcap.field_names import serialised
from replan.logs.mcap.osi_frames import SCHEMAS
from replan.logs.observed import of_stream
from replan.logs.repair.detections import Detections, Repair, TrackChange
from replan.logs.rules import Colour, TrafficLight
from replan.logs.scenario import Scenario
from replan.logs.states import Controls, OnboardPlan, Trajectory
from replan.logs.tracks import Tracks
from replan.logs.vehicle import VEHICLE_ASSUMED, VehicleParameters

T = TypeVar("T")

UNSEEN = "agents have no sample and are left out."
"""End of the note on agents that are only in the table."""


def read_scenario(path: Path, ego: str = "") -> Scenario:
    """Read a native or OSI log; `ego` selects an object of OSI other than the host; LogError for
    any other file.
    """
    return scenario_of(read_container(Path(path)), ego)


def scenario_of(container: Container, ego: str = "") -> Scenario:
    """The scenario in a container; LogError as in `read_scenario`."""
    container.whole()
    # The checks below refuse absurd numbers
    with in_file(container.path), np.errstate(all="ignore"):
        if native.SCENARIO_RECORD in container.metadata:
            if ego:
                raise LogError(
                    f"ego {ego} is asked for, but a native log has its ego", remedy="leave ego out"
                )
            return _native(container)
        stream = container.of_schema(*SCHEMAS)
        if stream is not None:
            return osi.scenario_of(stream, container.path.stem, ego)
    held = ", ".join(
        sorted({s.schema or f"{s.encoding} without schema" for s in container.streams.values()})
    )
    problem = f"neither a native nor an OSI log; it holds {held}"
    if any(s.schema.startswith("replan.") for s in container.streams.values()):
        problem = f"a native log without its metadata record {native.SCENARIO_RECORD}"
    raise LogError(problem, file=container.path, remedy=CONVERT)


def _native(container: Container) -> Scenario:
    record, streams = container.metadata[native.SCENARIO_RECORD], container.streams
    version = record.get("format_version", "")
    if not (version.isdecimal() and len(version) < 9):
        raise LogError(
            f"format_version is {version!r}",
            topic=native.SCENARIO_RECORD,
            remedy="expected a whole number",
        )
    if int(version) > native.FORMAT_VERSION:
        problem = (
            f"format version {version} is newer than {native.FORMAT_VERSION}, the newest that "
            "this replan reads"
        )
        raise LogError(problem, topic=native.SCENARIO_RECORD, remedy="update replan")
    if not len(streams.get("/ego", ())):
        raise LogError("the log has no ego states", topic="/ego", remedy="a log needs at least one")
    notes: list[str] = []
    start_ns = _from_record(record, "start_ns", int, streams["/ego"].times[0])
    if not 0 <= start_ns <= LAST_TIME_NS:
        raise LogError(
            f"start_ns is {start_ns}",
            topic=native.SCENARIO_RECORD,
            remedy="a log time, nanoseconds",
        )
    with reading(topic="/ego", remedy=MEND):
        ego = completed(sampled(streams["/ego"], native.Ego, start_ns), notes)
    history = streams.get("/ego/before")
    before = None
    if history:
        with reading(topic="/ego/before", remedy=MEND):
            before = Trajectory(**sampled(history, native.Ego, start_ns))
    tracks, extended = marked_tracks(streams, start_ns, notes)
    detections, repair = _detections(streams, start_ns, tracks, extended)
    road = _road(_one(streams, "/road", native.Road), ego, notes)
    lights = _lights(streams.get("/traffic_lights"), start_ns)
    shown = {light.id for light in lights}
    lost = sum(line.light is not None and line.light not in shown for line in road.stop_lines)
    if lost:  # the stop lines are kept all the same
        notes.append(
            f"The log does not show the lights of {lost} of {len(road.stop_lines)} stop lines: not "
            "known is off."
        )
    parameters = _one(streams, "/vehicle", native.Vehicle)
    if parameters is None:
        notes.append(f"{VEHICLE_ASSUMED}.")
    with reading(topic="/vehicle"):
        vehicle = (
            VehicleParameters(**msgspec.structs.asdict(parameters))
            if parameters
            else VehicleParameters()
        )
    controls, agents = streams.get("/controls", streams.get("/actuation")), streams.get("/agents")
    traffic = _from_record(record, "traffic_s", tuple[tuple[float, float], ...], None)
    if (
        traffic is None
        and agents
        and not all(message.id for message in agents.decoded(native.AgentColumns))
    ):
        traffic = of_stream(seconds(agents.times, start_ns))  # including empty messages
    noted = _from_record(record, "notes", list[str], [])
    free = container.metadata.get(native.FREE_RECORD, {})
    driven = {
        f"trace_{key}": value
        for key, value in container.metadata.get(native.TRACE_RECORD, {}).items()
    }
    with reading():
        return Scenario(
            name=record.get("name", container.path.stem),
            ego=ego,
            before=before,
            tracks=tracks,
            road=road,
            duration=_from_record(record, "duration_s", float, float(ego.t[-1])),
            goal=_goal(_one(streams, "/goal", native.Goal)),
            vehicle=vehicle,
            controls=Controls(**sampled(controls, native.Controls, start_ns)) if controls else None,
            tags=tuple(_from_record(record, "tags", list[str], [])),
            source=record.get("source", ""),
            licence=record.get("licence", ""),
            origin=(
                _from_record(record, "origin_x_m", float, 0.0),
                _from_record(record, "origin_y_m", float, 0.0),
            ),
            start_ns=start_ns,
            metadata={**free, **driven},
            notes=(*noted, *(note for note in notes if note not in noted)),
            lights=lights,
            onboard=_onboard(streams.get("/onboard"), start_ns),
            traffic=traffic,
            detections=detections,
            repair=repair,
            driving=_driving(streams.get("/driving"), record, start_ns),
            object_classes=_from_record(record, "object_classes", dict[str, ObjectClass], {}),
        )


def _from_record(record: dict[str, str], key: str, kind: type[T], default: T) -> T:
    """A value of the metadata record; values that are not words are JSON texts."""
    if key not in record:
        return default
    try:
        return msgspec.json.decode(record[key], type=kind)
    except (msgspec.MsgspecError, RecursionError) as error:
        problem = f"{key} is {record[key][:200]!r}: {error}".replace("`", "")
        raise LogError(problem, topic=native.SCENARIO_RECORD, remedy=MEND) from None


def _one(streams: dict[str, Stream], topic: str, kind: type[T]) -> T | None:
    """The message of a topic that has one message or none."""
    if topic not in streams or not len(streams[topic]):
        return None
    if len(streams[topic]) > 1:
        problem = f"{counted(len(streams[topic]), 'message')}, expected one"
        raise LogError(
            problem, topic=topic, time_ns=streams[topic].times[1], remedy="keep one of them"
        )
    return streams[topic].decoded(kind)[0]


def seconds(times: Sequence[int], start_ns: int) -> FloatArray:
    """Seconds since the start.

    The difference is taken in integers, so whole nanoseconds survive.
    """
    return (np.array(times, dtype=np.int64) - start_ns) / 1e9


def sampled(stream: Stream, kind: type[msgspec.Struct], start_ns: int) -> dict[str, FloatArray]:
    """Column t and the columns of a kind, from messages of one sample or from blocks."""
    block = native.BLOCKS[kind]
    if stream.schema != native.schema_name(block):
        stream.check_order(strictly=True)
        messages, columns = stream.decoded(kind), {"t": seconds(stream.times, start_ns)}
        for name in kind.__struct_fields__:
            columns[name] = np.array(
                [getattr(message, name) for message in messages], dtype=np.float64
            )
        return columns
    blocks = stream.decoded(block)
    for time, message in zip(stream.times, blocks, strict=True):
        _equal_lengths(message, stream.topic, time)
    joined = _join_columns(blocks, block)
    times = joined.pop("log_time")
    if not times:
        raise LogError("the blocks hold no sample", topic=stream.topic, remedy=MEND)
    if not 0 <= min(times) <= max(times) <= LAST_TIME_NS:
        raise LogError("a log time is beyond any clock", topic=stream.topic, remedy=MEND)
    replace(stream, times=times).check_order(strictly=True)
    return {
        "t": seconds(times, start_ns),
        **{name: np.array(messages, np.float64) for name, messages in joined.items()},
    }


AGENTS = ("/agents/table", "/obstacles", "/agents")
REMOVED = ("/removed/table", "/removed", "/removed")


def marked_tracks(
    streams: dict[str, Stream], start_ns: int, notes: list[str], topics: tuple[str, ...] = AGENTS
) -> tuple[Tracks, BoolArray]:
    """Tracks from a table and columns of samples, and which of the samples are marked as
    extended.
    """
    table_topic = topics[0]
    table = _one(streams, table_topic, native.AgentTable)
    moving = [
        streams[topic] for topic in dict.fromkeys(topics[:0:-1]) if len(streams.get(topic, ()))
    ]
    if table is None:
        if moving:
            problem, remedy = (
                "there are agents, but no table of them",
                "name each with its kind, length and width",
            )
            raise LogError(problem, topic=table_topic, remedy=remedy)
        return Tracks.empty(), np.empty(0, np.bool_)
    _equal_lengths(table, table_topic, streams[table_topic].times[0])
    rows = {name: row for row, name in enumerate(table.id)}
    row, times, columns = _samples(moving, rows, table_topic)
    order = np.lexsort((times, row))
    row, times = row[order], times[order]
    if len(rows) < len(table.id):
        raise LogError(
            "two agents have the same id", topic=table_topic, remedy="ids are unique in a log"
        )
    twice = np.flatnonzero((np.diff(row) == 0) & (np.diff(times) == 0))
    if len(twice):
        problem = f"agent '{table.id[row[twice[0]]]}' has two samples at one time"
        raise LogError(
            problem, topic=topics[-1], time_ns=int(times[twice[0]]), remedy="keep one of them"
        )
    with_samples = np.unique(row)
    if len(with_samples) < len(rows):
        notes.append(f"{len(rows) - len(with_samples)} of {len(rows)} {UNSEEN}")
    offsets = np.r_[0, np.cumsum(np.bincount(row, minlength=len(rows))[with_samples])]
    *values, extended = (np.array(column, dtype=np.float64)[order] for column in columns)
    with reading(topic=table_topic, remedy=MEND):
        tracks = Tracks(
            tuple(table.id[i] for i in with_samples),
            tuple(table.kind[i] for i in with_samples),
            np.array(table.length)[with_samples],
            np.array(table.width)[with_samples],
            np.array(table.static, dtype=np.bool_)[with_samples],
            offsets,
            (times - start_ns) / 1e9,
            *values,
        )
    return tracks, extended.astype(np.bool_)


def _samples(
    moving: list[Stream], rows: dict[str, int], who: str
) -> tuple[IntArray, IntArray, list[list[float | None]]]:
    """All samples of all topics: row in the table, time in ns, and columns x, y, yaw, vx, vy,
    extended.
    """
    row: list[int] = []
    times: list[int] = []
    columns: list[list[float | None]] = [[], [], [], [], [], []]
    for stream in moving:
        stream.check_order(strictly=False)
        for time, message in zip(stream.times, stream.decoded(native.RepairedColumns), strict=True):
            message.extended = message.extended or [False] * len(message.id)
            _equal_lengths(message, stream.topic, time)
            try:
                row.extend([rows[name] for name in message.id])
            except KeyError as error:
                problem = f"agent {error} is not in {who}"
                raise LogError(
                    problem, topic=stream.topic, time_ns=time, remedy="add it there"
                ) from None
            times.extend([time] * len(message.id))
            for column, name in zip(columns, ("x", "y", "yaw", "vx", "vy"), strict=False):
                column.extend(getattr(message, name) or [None] * len(message.id))
            columns[-1].extend(message.extended)
    return np.array(row, dtype=np.int64), np.array(times, dtype=np.int64), columns


def _detections(
    streams: dict[str, Stream], start_ns: int, tracks: Tracks, extended: BoolArray
) -> tuple[Detections | None, Repair | None]:
    """Detections that are not yet tracks, or the report of the tracks made of them; None if the log
    has neither.
    """
    stream, detections = streams.get("/detections"), None
    if stream is not None:
        stream.check_order(strictly=True)
        messages = stream.decoded(native.DetectionColumns)
        for time, message in zip(stream.times, messages, strict=True):
            _equal_lengths(message, stream.topic, time)
        frames = seconds(stream.times, start_ns)
        joined = _join_columns(messages, native.DetectionColumns)
        ids, kinds = joined.pop("id"), joined.pop("kind")
        t = np.repeat(frames, [len(message.id) for message in messages])
        columns = {name: np.array(values, np.float64) for name, values in joined.items()}
        with reading(topic=stream.topic, remedy=MEND):
            detections = Detections(
                t=t, frames=frames, ids=tuple(ids), codes=codes_of(tuple(kinds)), **columns
            )
    report = _one(streams, "/repair", native.Repair)
    if report is None:
        return detections, None
    if detections is None:
        problem = "the tracks are marked as repaired, but there are no detections"
        raise LogError(problem, topic="/repair", remedy="keep /detections, or leave /repair out")
    _equal_lengths(report, "/repair", streams["/repair"].times[0])
    *rows, sources = msgspec.structs.astuple(report)
    changes = tuple(TrackChange(*row) for row in zip(*rows, map(tuple, sources), strict=True))
    return None, Repair(
        detections, marked_tracks(streams, start_ns, [], REMOVED)[0], extended, changes, tracks
    )


def _join_columns(
    messages: Sequence[msgspec.Struct], kind: type[msgspec.Struct]
) -> dict[str, list[Any]]:
    return {
        name: list(chain.from_iterable(getattr(message, name) for message in messages))
        for name in kind.__struct_fields__
    }


def _equal_lengths(message: msgspec.Struct, topic: str, time: int) -> None:
    lengths = {len(column) for column in msgspec.structs.astuple(message) if column is not None}
    if len(lengths) > 1:
        columns = {
            serialised(n): len(c)
            for n, c in msgspec.structs.asdict(message).items()
            if c is not None
        }
        problem = "columns differ in length: " + ", ".join(
            f"{name} {count}" for name, count in columns.items()
        )
        raise LogError(
            problem, topic=topic, time_ns=time, remedy="an entry for each in every column"
        )


def _road(message: native.Road | None, ego: Trajectory, notes: list[str]) -> nouns.Road:
    if message is None or not message.lanes:
        return road_along(ego, notes)
    if not message.default_speed_limit > 0.0:
        raise LogError("default_speed_limit_mps must be positive", topic="/road", remedy=MEND)
    if len({lane.id for lane in message.lanes}) < len(message.lanes):
        raise LogError(
            "two lanes have the same id", topic="/road", remedy="ids are unique in a road"
        )
    with reading(topic="/road", remedy=MEND):
        return noun_of(nouns.Road, message)


def _lights(stream: Stream | None, start_ns: int) -> tuple[TrafficLight, ...]:
    """The lights over time; the colour of a light before its first message is unknown."""
    if stream is None:
        return ()
    stream.check_order(strictly=False)
    shown: dict[int, dict[int, Colour]] = {}
    for time, message in zip(stream.times, stream.decoded(native.LightColumns), strict=True):
        _equal_lengths(message, stream.topic, time)
        for light, colour in zip(message.id, message.colour, strict=True):
            if time in shown.setdefault(light, {}):
                problem = f"light {light} has two colours at one time"
                raise LogError(problem, topic=stream.topic, time_ns=time, remedy="keep one of them")
            shown[light][time] = colour
    return tuple(
        TrafficLight(i, seconds(list(c), start_ns), tuple(c.values()))
        for i, c in sorted(shown.items())
    )


def _onboard(stream: Stream | None, start_ns: int) -> tuple[OnboardPlan, ...]:
    if stream is None:
        return ()
    stream.check_order(strictly=True)
    known = seconds(stream.times, start_ns).tolist()
    plans = []
    for known_at, time, message in zip(
        known, stream.times, stream.decoded(plan_messages.OnboardPlan), strict=True
    ):
        _equal_lengths(message.trajectory, stream.topic, time)
        with reading(topic=stream.topic, time_ns=time, remedy=MEND):
            plans.append(noun_of(OnboardPlan, message, known=known_at))
    return tuple(plans)


def _driving(stream: Stream | None, record: dict[str, str], start_ns: int) -> DrivingModes | None:
    if stream is None:
        return None
    stream.check_order(strictly=True)
    modes = [message.mode for message in stream.decoded(native.Driving)]
    latency_s = _from_record(record, "driving_latency_s", float, 0.0)
    source = record.get("driving_source", "")
    return DrivingModes.of_samples(seconds(stream.times, start_ns), modes, source, latency_s)


def _goal(message: native.Goal | None) -> nouns.Goal | None:
    if message is None:
        return None
    for region in chain(
        message.regions, *(alternative.regions for alternative in message.alternatives)
    ):
        if len(region.x) != len(region.y) or len(region.x) < 3:
            raise LogError(
                "a region needs as many x_m as y_m, three or more", topic="/goal", remedy=MEND
            )
    return noun_of(nouns.Goal, message)
