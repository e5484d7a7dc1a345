"""Bare ASAM OSI traces, `.osi`: little-endian length and message, again and again, of GroundTruth or SensorView.

The file does not say which message it holds: by OSI's naming convention its name has `_gt_` or `_sv_`; else it holds
SensorViews if there is ground truth in it when it is read as such. The messages are read by ASAM's own package
(`osi-python`), then as those in an MCAP file (`logs.mcap.osi`).
"""

from __future__ import annotations

import struct
from pathlib import Path

from logs.errors import LogError
from logs.mcap.container import Stream
from logs.readers.base import Contents, LogSettings, Reader, TopicSummary
from logs.scenario import Scenario

LENGTH = 4
"""Bytes of a message's length."""
MOST_BYTES = 2**28
"""A message larger than this is none."""
GROUND_TRUTH, SENSOR_VIEW = "osi3.GroundTruth", "osi3.SensorView"
NAMED = {"_gt_": GROUND_TRUTH, "_sv_": SENSOR_VIEW}
"""Message by the part of the file's name."""


def trace_of(path: Path) -> Stream:
    """The messages of a trace as a topic; their log times are their numbers, since OSI has a timestamp inside.

    Raises:
        LogError: The file cannot be read, or is no sequence of messages.
    """
    from logs.mcap.container import COPY_AGAIN, content_of

    raw, payloads, at = content_of(path), list[bytes](), 0
    while at < len(raw):
        size = struct.unpack_from("<I", raw, at)[0] if at + LENGTH <= len(raw) else MOST_BYTES
        if size > min(MOST_BYTES, len(raw) - at - LENGTH):
            what = f"message {len(payloads)} is cut off or no message, at byte {at}"
            raise LogError(what, topic=path.name, remedy=COPY_AGAIN)
        payloads.append(raw[at + LENGTH : at + LENGTH + size])
        at += LENGTH + size
    if not payloads:
        raise LogError("the file is empty", remedy=COPY_AGAIN)
    schema = _schema(path, payloads[0])
    times = list(range(len(payloads)))
    return Stream(path.name, "protobuf", schema, "protobuf", _descriptor(), times, payloads)


def _schema(path: Path, first: bytes) -> str:
    from google.protobuf.message import DecodeError
    from osi3.osi_sensorview_pb2 import SensorView

    name = next((schema for part, schema in NAMED.items() if part in path.name.lower()), None)
    if name is not None:
        return name
    try:
        view = SensorView.FromString(first)
    except DecodeError:
        return GROUND_TRUTH
    return SENSOR_VIEW if view.HasField("global_ground_truth") else GROUND_TRUTH


def _descriptor() -> bytes:
    """The files that define both messages, as a FileDescriptorSet."""
    from google.protobuf.descriptor_pb2 import FileDescriptorSet
    from osi3 import osi_sensorview_pb2

    found, open_files = FileDescriptorSet(), [osi_sensorview_pb2.DESCRIPTOR]
    seen: set[str] = set()
    while open_files:
        file = open_files.pop()
        if file.name not in seen:
            seen.add(file.name)
            file.CopyToProto(found.file.add())
            open_files += file.dependencies
    return found.SerializeToString(deterministic=True)


def _claims(path: Path) -> bool:
    return path.suffix.lower() == ".osi" and path.is_file()


def _read(path: Path, settings: LogSettings) -> Scenario:
    from logs.mcap.osi import scenario_of

    return scenario_of(trace_of(path), path.stem, settings.ego)


def _contents(path: Path) -> Contents:
    try:
        trace = trace_of(path)
    except LogError:
        return Contents()
    topic = TopicSummary(path.name, trace.schema, "protobuf", "protobuf", len(trace), None, None)
    return Contents("ASAM OSI trace", (topic,))


READER = Reader(
    "osi", "ASAM OSI traces of ground truth or sensor views", "*.osi", (".osi",), _claims, _read,
    contents=_contents, settings=("ego",),
)  # fmt: skip
