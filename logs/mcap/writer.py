"""Writes a Scenario as a native MCAP file.

The same scenario gives the same bytes. Messages are encoded one by one and wait in a spool file for
their turn, so that a long drive takes no more memory than a short one. Besides the native messages
a file may have protobuf messages for viewers on other topics (`replan.draw.foxglove`), which
readers ignore. The file is written under a temporary name in the same directory and renamed, so
that a killed writer leaves no partial log. Times become integer nanoseconds: reading returns the
identical scenario if its times are whole nanoseconds (and |t| is below 26 days). A repair is not
written if the tracks changed after it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, astuple
from itertools import chain, pairwise
from pathlib import Path
from tempfile import SpooledTemporaryFile
from typing import Any

import msgspec
import numpy as np
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import Message
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from replan.core.arrays import BoolArray, FloatArray
from replan.core.errors import LogError, in_file, writing
from replan.logs.codec import message_of, scalar_as_number
from replan.logs.mcap import native, plan_messages
from replan.logs.mcap.field_names import serialised
from replan.logs.repair.detections import Detections
from replan.logs.rules import Colour
from replan.logs.scenario import Scenario
from replan.logs.tracks import Tracks

PROFILE = "replan"
CHUNK_BYTES = 128 * 1024
SPOOL_BYTES = 16 * 2**20
"""The greatest number of bytes of messages in memory; more wait in a file."""
BLOCK = 100
"""Samples of a block: a second of a drive."""
COLUMNS = ("x", "y", "yaw", "vx", "vy")
"""The columns of samples of other road users."""
Entry = tuple[int, str, msgspec.Struct | Message]
"""Log time (ns), topic, message."""


def write_scenario(path: Path, scenario: Scenario, *, beside: Iterable[Entry] = ()) -> None:
    """Write a scenario as a native log, and messages `beside` it on other topics.

    Raises:
        LogError: A value is infinite, two samples fall on one nanosecond, or a log time is
            negative.
        OutputError: The file cannot be written.
    """
    with in_file(path):
        write_log(Path(path), scenario_records(scenario), chain(scenario_entries(scenario), beside))


def is_written_here(path: Path) -> bool:
    """Return whether a file is an MCAP file that replan wrote; OSError if it cannot be read."""
    profile = len(PROFILE).to_bytes(4, "little") + PROFILE.encode()
    with path.open("rb") as stream:
        return (
            stream.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC
            and stream.read(9 + len(profile))[9:] == profile
        )


def write_log(
    path: Path, records: Mapping[str, Mapping[str, str]], entries: Iterable[Entry]
) -> None:
    """Write metadata records and messages, in order of time, then of `native.TOPICS`, then of first
    occurrence.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        with (
            writing(path),
            part.open("wb") as file,
            SpooledTemporaryFile(SPOOL_BYTES, dir=str(path.parent)) as spool,
        ):
            writer: Any = Writer(file, CHUNK_BYTES, CompressionType.ZSTD, enable_data_crcs=True)
            writer.start(profile=PROFILE, library="replan")
            for name, record in records.items():
                writer.add_metadata(name, dict(record))
            encoder = msgspec.json.Encoder(enc_hook=scalar_as_number)
            kinds: dict[str, type[msgspec.Struct | Message]] = {}
            places, end = list[tuple[int, str, int, int]](), 0
            # Encoded messages wait in the spool until all are known
            for time, topic, message in entries:
                if isinstance(message, Message):
                    data = message.SerializeToString(deterministic=True)
                else:
                    data = encoder.encode(message)
                kinds.setdefault(topic, type(message))
                places.append((time, topic, end, len(data)))
                spool.write(data)
                end += len(data)
            rank = {
                topic: index for index, topic in enumerate(dict.fromkeys((*native.TOPICS, *kinds)))
            }
            schemas: dict[type[msgspec.Struct | Message], int] = {}
            channels: dict[str, int] = {}
            for topic in sorted(kinds, key=rank.__getitem__):
                kind = kinds[topic]
                if kind not in schemas:
                    schemas[kind] = writer.register_schema(*_schema(kind))
                encoding = "protobuf" if issubclass(kind, Message) else "json"
                channels[topic] = writer.register_channel(topic, encoding, schemas[kind])
            sequence = dict.fromkeys(channels, 0)
            for time, topic, begin, size in sorted(
                places, key=lambda place: (place[0], rank[place[1]])
            ):
                spool.seek(begin)
                writer.add_message(channels[topic], time, spool.read(size), time, sequence[topic])
                sequence[topic] += 1
            writer.finish()
        with writing(path):
            part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def _schema(kind: type[msgspec.Struct | Message]) -> tuple[str, str, bytes]:
    """Name, encoding and bytes of the schema of a kind of message."""
    if issubclass(kind, Message):
        return kind.DESCRIPTOR.full_name, "protobuf", descriptor_set(kind.DESCRIPTOR.file)
    return native.schema_name(kind), "jsonschema", msgspec.json.encode(native.json_schema(kind))


def descriptor_set(file: Any) -> bytes:
    """The descriptor of a protobuf file after those of all files that it imports, as MCAP stores
    them.
    """
    files: dict[str, Any] = {}

    def collect(descriptor: Any) -> None:
        if descriptor.name not in files:
            for other in descriptor.dependencies:
                collect(other)
            files[descriptor.name] = descriptor

    collect(file)
    described = FileDescriptorSet()
    for descriptor in files.values():
        descriptor.CopyToProto(described.file.add())
    return described.SerializeToString(deterministic=True)


def scenario_records(
    scenario: Scenario, *, version: int = native.WITHOUT_BLOCKS
) -> dict[str, dict[str, str]]:
    """The metadata records of a scenario."""
    if scenario.start_ns < 0:
        raise LogError("start_ns is negative", remedy="log times are nanoseconds since an epoch")
    encode = msgspec.json.encode
    record = {
        "format_version": str(version),
        "name": scenario.name,
        "source": scenario.source,
        "licence": scenario.licence,
        "tags": encode(scenario.tags).decode(),
        "notes": encode(scenario.notes).decode(),
        "start_ns": str(scenario.start_ns),
        "duration_s": repr(check_finite(scenario.duration, "duration")),
        "origin_x_m": repr(check_finite(scenario.origin[0], "origin")),
        "origin_y_m": repr(check_finite(scenario.origin[1], "origin")),
    }
    if scenario.traffic is not None:
        record["traffic_s"] = encode(scenario.traffic).decode()
    if scenario.driving is not None:
        record["driving_source"] = scenario.driving.source
        record["driving_latency_s"] = repr(check_finite(scenario.driving.latency_s, "latency"))
    if scenario.object_classes:
        record["object_classes"] = encode(scenario.object_classes).decode()
    free = dict(scenario.metadata)
    return {native.SCENARIO_RECORD: record, **({native.FREE_RECORD: free} if free else {})}


def scenario_entries(scenario: Scenario, *, blocks: bool = False) -> Iterator[Entry]:
    """The messages of a scenario, topic by topic; ego and controls in blocks if `blocks` is set."""
    start = scenario.start_ns
    vehicle = {
        name: _finite_all(value, f"vehicle {name}")
        for name, value in asdict(scenario.vehicle).items()
    }
    yield start, "/vehicle", native.Vehicle(**vehicle)
    if scenario.goal is not None:
        for goal in (scenario.goal, *scenario.goal.alternatives):
            for name in ("t", "v", "yaw"):
                _finite_all(getattr(goal, name) or (), f"goal {name}")
            for region in goal.regions:
                check_not_infinite(region[:, 0], "/goal", "x")
                check_not_infinite(region[:, 1], "/goal", "y")
        yield start, "/goal", message_of(native.Goal, scenario.goal)
    check_finite(scenario.road.default_speed_limit, "default speed limit")
    for lane in scenario.road.lanes.values():
        if np.isinf(lane.speed_limit):
            raise LogError(
                f"lane {lane.id}: the speed limit is infinite",
                topic="/road",
                remedy="use NaN for no limit",
            )
    yield start, "/road", message_of(native.Road, scenario.road)
    # For each time a message with the lights that change then
    shown: dict[int, tuple[list[int], list[Colour]]] = {}
    for light in scenario.lights:
        times = log_times(light.t, start, "/traffic_lights")
        if any(time <= before for before, time in pairwise(times)):
            raise LogError(
                f"light {light.id} changes twice on one nanosecond", topic="/traffic_lights"
            )
        for time, colour in zip(times, light.colours, strict=True):
            ids, colours = shown.setdefault(time, ([], []))
            ids.append(light.id)
            colours.append(colour)
    for time, columns in shown.items():
        yield time, "/traffic_lights", native.LightColumns(*columns)
    repair = (
        None
        if scenario.repair is None or scenario.repair.tracks is not scenario.tracks
        else scenario.repair
    )
    yield from _tracks(scenario.tracks, start, extended=None if repair is None else repair.extended)
    if repair is not None:
        changes = (
            list(column)
            for column in zip(*(astuple(change) for change in repair.changes), strict=True)
        )
        yield start, "/repair", native.Repair(*changes)
        yield from _tracks(repair.removed, start, ("/removed/table", "/removed", "/removed"))
    detections = scenario.detections if repair is None else repair.detections
    if detections is not None:
        yield from _detections(detections, start)
    yield from samples(scenario.ego, native.Ego, "/ego", start, blocks=blocks)
    if scenario.before is not None:
        yield from samples(scenario.before, native.Ego, "/ego/before", start, blocks=blocks)
    if scenario.driving is not None:
        modes = scenario.driving
        times = log_times(modes.t, start, "/driving")
        for time, mode in zip(times, modes.modes, strict=True):
            yield time, "/driving", native.Driving(mode)
    if scenario.controls is not None:
        yield from samples(scenario.controls, native.Controls, "/controls", start, blocks=blocks)
    times = log_times(np.array([plan.known for plan in scenario.onboard]), start, "/onboard")
    for time, plan in zip(times, scenario.onboard, strict=True):
        yield time, "/onboard", message_of(plan_messages.OnboardPlan, plan)


def log_times(t: FloatArray, start_ns: int, topic: str) -> list[int]:
    """Log times (ns) of seconds since the start `(n,)`; LogError if a time is not finite or before
    the epoch.
    """
    if not np.isfinite(t).all():
        raise LogError("a time is not finite", topic=topic)
    times = np.rint(t * 1e9).astype(np.int64) + start_ns
    if len(times) and times.min() < 0:
        raise LogError(
            "a sample is before log time 0", topic=topic, remedy="set start_ns to a later time"
        )
    return [int(time) for time in times]


def check_not_infinite(values: FloatArray, topic: str, name: str) -> None:
    """Raise LogError if a value is infinite; NaN means missing."""
    if np.isinf(values).any():
        where = int(np.flatnonzero(np.isinf(values))[0])
        raise LogError(
            f"{serialised(name)} is infinite at index {where}", topic=topic, remedy="use NaN"
        )


def column(values: FloatArray, topic: str, name: str) -> list[float]:
    """The values as a list; LogError as in `check_not_infinite`."""
    check_not_infinite(values, topic, name)
    numbers: list[float] = values.tolist()
    return numbers


def check_finite(value: float, name: str) -> float:
    """Return the number; LogError if it is not finite."""
    if not np.isfinite(value):
        raise LogError(f"{name} is {value}", remedy="leave out what is not known")
    return float(value)


def _finite_all(value: float | tuple[float, ...], name: str) -> float | tuple[float, ...]:
    """The number or numbers; LogError as in `check_finite`."""
    return (
        tuple(check_finite(item, name) for item in value)
        if isinstance(value, tuple)
        else check_finite(value, name)
    )


def samples(
    table: Any, kind: type[msgspec.Struct], topic: str, start_ns: int, *, blocks: bool = False
) -> Iterator[Entry]:
    """Messages of a struct of arrays: one per sample, or per `BLOCK`; LogError for infinities and
    equal times.
    """
    times, names = log_times(table.t, start_ns, topic), kind.__struct_fields__
    for name in names:
        check_not_infinite(getattr(table, name), topic, name)
    late = np.flatnonzero(np.diff(np.array(times, np.int64)) <= 0)
    if len(late):
        raise LogError(
            "two samples on one nanosecond, or out of order",
            topic=topic,
            time_ns=times[late[0] + 1],
        )
    for k in range(0, len(times), BLOCK):
        part = [getattr(table, name)[k : k + BLOCK].tolist() for name in names]
        if blocks:
            yield times[k], topic, native.BLOCKS[kind](times[k : k + BLOCK], *part)
        else:
            yield from (
                (time, topic, kind(*values))
                for time, *values in zip(times[k : k + BLOCK], *part, strict=True)
            )


def _tracks(
    tracks: Tracks,
    start_ns: int,
    topics: tuple[str, str, str] = ("/agents/table", "/obstacles", "/agents"),
    *,
    extended: BoolArray | None = None,
) -> Iterator[Entry]:
    """Tracks on three topics: agent table, obstacles, moving agents."""
    if not len(tracks):
        return
    table, still, moving = topics
    yield start_ns, table, agent_table(tracks)
    track = tracks.owner
    times = np.array(log_times(tracks.t, start_ns, moving), dtype=np.int64)
    if ((np.diff(times) <= 0) & (np.diff(track) == 0)).any():
        raise LogError("an agent has two samples on one nanosecond", topic=moving)
    for name in ("vx", "vy"):
        check_not_infinite(getattr(tracks, name), moving, name)
    for topic, chosen in ((still, tracks.static[track]), (moving, ~tracks.static[track])):
        where = np.flatnonzero(chosen)
        order = where[np.lexsort((track[where], times[where]))]
        for group in np.split(order, np.flatnonzero(np.diff(times[order])) + 1):
            if not len(group):
                continue
            names = [tracks.ids[i] for i in track[group].tolist()]
            columns: dict[str, Any] = {
                name: getattr(tracks, name)[group].tolist() for name in COLUMNS
            }
            message = native.AgentColumns(names, **columns)
            if extended is not None:
                message = native.RepairedColumns(
                    names, **columns, extended=extended[group].tolist()
                )
            yield int(times[group[0]]), topic, message


def _detections(found: Detections, start_ns: int) -> Iterator[Entry]:
    """The messages of detections, one per frame."""
    for name in ("length", "width", "vx", "vy", "score"):
        check_not_infinite(getattr(found, name), "/detections", name)
    times = log_times(found.frames, start_ns, "/detections")
    if (np.diff(np.array(times, np.int64)) <= 0).any():
        raise LogError("two frames of detections on one nanosecond", topic="/detections")
    ends = np.searchsorted(found.t, found.frames, side="right").tolist()
    kinds = found.kinds
    for time, first, end in zip(times, [0, *ends], ends, strict=False):
        part = slice(first, end)
        columns = (
            getattr(found, name)[part].tolist()
            for name in native.DetectionColumns.__struct_fields__[2:]
        )
        yield (
            time,
            "/detections",
            native.DetectionColumns(list(found.ids[part]), list(kinds[part]), *columns),
        )


def agent_table(tracks: Tracks) -> native.AgentTable:
    """The table of ids, kinds and sizes of tracks."""
    sizes = tracks.length.tolist(), tracks.width.tolist()
    return native.AgentTable(list(tracks.ids), list(tracks.kinds), *sizes, tracks.static.tolist())
