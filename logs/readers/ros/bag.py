"""The one door to rosbags: a bag of ROS 1 or ROS 2 as topics, and the wanted fields of their messages by time.

A folder with `metadata.yaml` is one bag, split over its files; `.mcap` and `.db3` alone are bags of ROS 2, `.bag` of
ROS 1. Message definitions come from the file; where it has none, from `definitions.msg` (Autoware and other packages)
and the distribution's own that rosbags knows. With an index in the file only the chunks of a time and topic are read.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from zstandard import ZstdError, frame_content_size

from logs.errors import LogError
from logs.kernel import IntArray
from logs.readers.ros.fields import SIMPLIFY, Types, Wanted, decoder, has_field

COPY_AGAIN = "copy or record it again"
LAST_TIME_NS = 2**63 - 1
MAX_CHUNK_BYTES = 1 << 30
"""What a chunk of a bag may hold when it is decompressed: rosbag2 writes 768 KiB, the largest seen are 100 MiB."""
LARGEST_DEFINITION = 1 << 18
"""Limit of the text of a message definition: Autoware's largest have some 20,000 characters."""
_CHUNK_HEAD_BYTES, _FRAME_HEAD_BYTES = 9 + 40, 18
"""Of an MCAP chunk record before its data, but for the compression's name; of a zstd frame, at most."""
TIMES: Types = {
    f"builtin_interfaces/msg/{name}": ([], [("sec", (1, ("int32", 0))), ("nanosec", (1, ("uint32", 0)))])
    for name in ("Time", "Duration")
}
"""Primitive types of ROS 1, messages in ROS 2."""
DAMAGE = (Exception,)
"""What rosbags and the decompressors raise on damaged bytes: a family without a root, AssertionError and KeyError
among them."""


@dataclass(frozen=True)
class Topic:
    """A topic: `kind` is its message type as ROS 2 names it (pkg/msg/Type), `count` its messages."""

    name: str
    kind: str
    count: int
    encoding: str
    connections: tuple[Any, ...] = ()


@dataclass
class Bag:
    """An open bag.

    Attributes:
        topics: In order of their names.
        start_ns: Log time of the first message; `end_ns` of the last.
        is_ros2: Whether its messages are CDR.
    """

    topics: tuple[Topic, ...]
    start_ns: int
    end_ns: int
    is_ros2: bool
    _messages: Callable[..., Iterator[tuple[Any, int, bytes]]]
    _types: dict[str, Types] = field(default_factory=dict)

    def types_of(self, topic: Topic) -> Types:
        """The definitions of a topic's type and of those that it holds, by their names.

        Raises:
            LogError: The file has none, and neither has replan.
        """
        if topic.name not in self._types:
            own = next((c.msgdef for c in topic.connections if c.msgdef.data), None)
            self._types[topic.name] = _parsed(own, topic) if own is not None else _known(self.is_ros2)
        types = self._types[topic.name]
        if topic.kind not in types:
            what = f"the log does not define its message type {topic.kind}, and replan does not know it"
            raise LogError(what, topic=topic.name, remedy="record as MCAP, which holds the definitions")
        return types

    def has(self, topic: Topic, path: str) -> bool:
        """Whether the topic's messages have a field, by its dotted name."""
        return has_field(self.types_of(topic), topic.kind, path)

    def read(
        self, topic: Topic, wanted: Wanted, begin: int | None = None, end: int | None = None
    ) -> tuple[IntArray, list[tuple[Any, ...]]]:
        """Log times `(n,)` ns, rising, and the wanted fields of the messages from `begin` to `end` (ns, inclusive).

        Raises:
            LogError: The file is damaged, or a message is not what its definition says.
        """
        try:
            walk = decoder(self.types_of(topic), topic.kind, wanted, cdr=self.is_ros2)
        except LogError as error:
            raise LogError(error.what, topic=topic.name, remedy=error.remedy) from None
        times: list[int] = []
        rows: list[tuple[Any, ...]] = []
        for time, raw in self.raw(topic, begin, end):
            try:
                rows.append(walk(raw))
            except (struct.error, ValueError, IndexError) as error:
                what = f"a message does not fit its type {topic.kind}: {error}"
                raise LogError(what, topic=topic.name, time_ns=time, remedy=COPY_AGAIN) from None
            times.append(time)
        order = np.argsort(np.array(times, dtype=np.int64), kind="stable")
        return np.array(times, dtype=np.int64)[order], [rows[i] for i in order]

    def raw(self, topic: Topic, begin: int | None = None, end: int | None = None) -> Iterator[tuple[int, bytes]]:
        """Log time and bytes of the messages from `begin` to `end`, ns, inclusive; LogError where it is damaged."""
        last: int | None = None
        try:
            for _, time, raw in self._messages(topic.connections, begin, None if end is None else end + 1):
                if not 0 <= time <= LAST_TIME_NS:
                    raise LogError(f"log time {time} ns is beyond any clock", topic=topic.name, remedy=COPY_AGAIN)
                last = time
                yield time, raw
        except LogError:
            raise
        except DAMAGE as error:
            what = f"the file is damaged{'' if last is None else ' after this time'} ({_describe(error)})"
            raise LogError(what, topic=topic.name, time_ns=last, remedy=COPY_AGAIN) from None


@contextmanager
def opened(path: Path) -> Iterator[Bag]:
    """The bag at a path, open; LogError where it cannot be opened."""
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

    is_ros2 = path.suffix.lower() != ".bag" or path.is_dir()
    try:
        reader: Any = Reader2(path) if is_ros2 else Reader1(path)
        reader.open()
    except DAMAGE as error:
        raise LogError(f"the bag cannot be opened ({_describe(error)})", file=path, remedy=COPY_AGAIN) from None
    try:
        _check_chunks(reader, path)
        yield Bag(_topics(reader.connections), reader.start_time, reader.end_time - 1, is_ros2, reader.messages)
    finally:
        reader.close()


def _topics(connections: Sequence[Any]) -> tuple[Topic, ...]:
    """Connections of one topic and type are one topic; of one topic and several types, the type with most messages."""
    found: dict[tuple[str, str], list[Any]] = {}
    for each in connections:
        found.setdefault((each.topic, each.msgtype), []).append(each)
    topics = [
        Topic(
            name, kind, sum(c.msgcount for c in group), getattr(group[0].ext, "serialization_format", "ros1"), (*group,)
        )
        for (name, kind), group in found.items()
    ]
    most: dict[str, Topic] = {}
    for topic in sorted(topics, key=lambda each: (each.count, each.kind)):
        most[topic.name] = topic
    return tuple(most[name] for name in sorted(most))


def _check_chunks(reader: Any, path: Path) -> None:
    """Refuse chunks that say that they inflate beyond all measure, before they are inflated."""
    storage = getattr(reader, "storage", None)
    for part in getattr(storage, "storages", [storage]):
        for chunk in getattr(part, "chunks", ()):
            size = max(chunk.uncompressed_size, _inflated(part, chunk))
            if size > MAX_CHUNK_BYTES:
                what = f"a chunk of {chunk.compressed_size} bytes would become {size}"
                raise LogError(what, file=path, time_ns=chunk.message_start_time, remedy=COPY_AGAIN)


def _inflated(part: Any, chunk: Any) -> int:
    """How many bytes the zstd frame of a chunk says that it holds, whatever the index says; 0: it does not."""
    if chunk.compression != "zstd":
        return 0
    begin = chunk.chunk_start_offset + _CHUNK_HEAD_BYTES + len(chunk.compression)
    try:
        return max(0, frame_content_size(os.pread(part.bio.fileno(), _FRAME_HEAD_BYTES, begin)))
    except (ZstdError, OSError, OverflowError):
        return 0  # reading it says what is wrong


def _parsed(definition: Any, topic: Topic) -> Types:
    from rosbags.typesys import get_types_from_idl, get_types_from_msg

    if len(definition.data) > LARGEST_DEFINITION:
        what = f"the definition of {topic.kind} has {len(definition.data)} characters, at most {LARGEST_DEFINITION} are"
        raise LogError(f"{what} read", topic=topic.name, remedy=SIMPLIFY)
    try:
        if definition.format.name == "MSG":
            return {**TIMES, **get_types_from_msg(definition.data, topic.kind)}
        parts = [part.partition("\n")[2] for part in definition.data.split("=" * 80 + "\n") if part.startswith("IDL: ")]
        out: dict[str, Any] = dict(TIMES)
        for part in parts or [definition.data]:
            out |= get_types_from_idl(part)
        return out
    except DAMAGE as error:
        what = f"the definition of {topic.kind} in the file cannot be used ({_describe(error)})"
        raise LogError(what, topic=topic.name, remedy=COPY_AGAIN) from None


def _known(is_ros2: bool) -> Types:
    """What rosbags and replan know without a file."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    types: dict[str, Any] = dict(get_typestore(Stores.ROS2_HUMBLE if is_ros2 else Stores.ROS1_NOETIC).fielddefs)
    text = files("logs.readers.ros").joinpath("definitions.msg").read_text()
    for part in text.split("=" * 20 + "\n")[1:]:
        name, _, body = part.partition("\n")
        types |= get_types_from_msg(body, name.removeprefix("MSG: ").strip())
    return types


def _describe(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:300]
