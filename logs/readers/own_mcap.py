"""replan's own MCAP, ASAM OSI ground truth in MCAP, and bare ASAM OSI traces.

The native reader is tried last and claims every .mcap file: its errors name what the file lacks.

A bare OSI trace (`.osi`) is a sequence of messages, each a little-endian length and a GroundTruth
or SensorView. By the naming convention of OSI, the file name contains `_gt_` or `_sv_`. Without
either, the messages are SensorViews if the first one, parsed as a SensorView, contains ground
truth. ASAM's own package (`osi-python`) reads the messages.
"""

from __future__ import annotations

import struct
from pathlib import Path

from replan.core.errors import LogError
from replan.logs.mcap import native, osi
from replan.logs.mcap.container import COPY_AGAIN, Stream, content_of, read_container
from replan.logs.mcap.osi_frames import SCHEMAS
from replan.logs.mcap.reader import read_scenario
from replan.logs.mcap.writer import descriptor_set
from replan.logs.readers.base import LogContents, Reader, TopicSummary, files_named


def _contents(path: Path) -> LogContents:
    container = read_container(path)
    topics = []
    for stream in container.streams.values():
        first, last = (stream.times[0], stream.times[-1]) if len(stream) else (None, None)
        summary = (
            stream.topic,
            stream.schema,
            stream.encoding,
            stream.schema_encoding,
            len(stream),
        )
        topics.append(TopicSummary(*summary, first, last))
    profile = "not a log that replan reads" if container.streams else "no log"
    of_osi = container.of_schema(*SCHEMAS)
    if of_osi is not None:
        profile = f"ASAM OSI log, {of_osi.schema}"
    if native.SCENARIO_RECORD in container.metadata:
        version = container.metadata[native.SCENARIO_RECORD].get("format_version", "?")
        what_it_is = (
            "trace of a drive" if native.TRACE_RECORD in container.metadata else "scenario log"
        )
        profile = f"{what_it_is}, native format {version}"
    return LogContents(profile, tuple(topics))


READER = Reader(
    "native",
    "replan's own MCAP, traces included; ASAM OSI ground truth in MCAP",
    "*.mcap",
    (".mcap",),
    files_named(".mcap"),
    lambda path, settings: read_scenario(path, settings.ego),
    contents=_contents,
    settings=("ego",),
)


LENGTH = 4
"""Size of a message's length field, bytes."""
MOST_BYTES = 2**28
"""Largest size of a message, bytes."""
GROUND_TRUTH, SENSOR_VIEW = "osi3.GroundTruth", "osi3.SensorView"
NAMED = {"_gt_": GROUND_TRUTH, "_sv_": SENSOR_VIEW}
"""Message type by a part of the file name."""


def trace_of(path: Path) -> Stream:
    """Return the messages of a trace as a topic, timed by their numbers; LogError if it is no such
    sequence.
    """
    from google.protobuf.message import DecodeError
    from osi3 import osi_sensorview_pb2
    from osi3.osi_sensorview_pb2 import SensorView

    raw, payloads, position = content_of(path), list[bytes](), 0
    while position < len(raw):
        size = (
            struct.unpack_from("<I", raw, position)[0]
            if position + LENGTH <= len(raw)
            else MOST_BYTES
        )
        if size > min(MOST_BYTES, len(raw) - position - LENGTH):
            problem = f"message {len(payloads)} is cut off or no message, at byte {position}"
            raise LogError(problem, topic=path.name, remedy=COPY_AGAIN)
        payloads.append(raw[position + LENGTH : position + LENGTH + size])
        position += LENGTH + size
    if not payloads:
        raise LogError("the file is empty", remedy=COPY_AGAIN)
    schema = next((schema for part, schema in NAMED.items() if part in path.name.lower()), "")
    if not schema:
        try:
            is_view = SensorView.FromString(payloads[0]).HasField("global_ground_truth")
        except DecodeError:
            is_view = False
        schema = SENSOR_VIEW if is_view else GROUND_TRUTH
    # Defines both
    times, descriptor = list(range(len(payloads))), descriptor_set(osi_sensorview_pb2.DESCRIPTOR)
    return Stream(path.name, "protobuf", schema, "protobuf", descriptor, times, payloads)


def _contents_osi(path: Path) -> LogContents:
    try:
        trace = trace_of(path)
    except LogError:
        return LogContents()
    topic = TopicSummary(path.name, trace.schema, "protobuf", "protobuf", len(trace), None, None)
    return LogContents("ASAM OSI trace", (topic,))


OSI_READER = Reader(
    "osi",
    "ASAM OSI traces of ground truth or sensor views",
    "*.osi",
    (".osi",),
    files_named(".osi"),
    lambda path, settings: osi.scenario_of(trace_of(path), path.stem, settings.ego),
    contents=_contents_osi,
    settings=("ego",),
)
