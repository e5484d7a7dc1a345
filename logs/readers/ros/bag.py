"""A bag as topics: selected fields of their messages by time."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from zstandard import ZstdDecompressor

from replan.core.arrays import IntArray
from replan.core.errors import LogError
from replan.logs.mcap.container import COPY_AGAIN
from replan.logs.readers.ros.fields import SIMPLIFY, Types, Wanted, decoder, has_field
from replan.logs.readers.ros.storage import DAMAGE, ROS1, ZSTD, BagFile, describe, opened_parts

LISTED_BYTES = 256 * 1024**2
"""Largest bag for which `contents` gives times, bytes: the index does not contain them."""
LAST_TIME_NS = 2**63 - 1
LARGEST_DEFINITION = 1 << 18
"""Longest text of a message definition: Autoware's longest have some 20,000 characters."""
TIMES: Types = {
    f"builtin_interfaces/msg/{name}": (
        [],
        [("sec", (1, ("int32", 0))), ("nanosec", (1, ("uint32", 0)))],
    )
    for name in ("Time", "Duration")
}
"""Definitions of times: primitive types in ROS 1, messages in ROS 2."""


@dataclass(frozen=True)
class Topic:
    """A topic: `kind` is its message type in ROS 2 form (pkg/msg/Type), `count` its number of
    messages.
    """

    name: str
    kind: str
    count: int
    connections: tuple[Any, ...] = ()


@dataclass
class Bag:
    """An open bag."""

    topics: tuple[Topic, ...]  # its topics, sorted by name
    start_ns: int  # log time of the first message; `end_ns` of the last
    end_ns: int
    is_ros2: bool  # whether its messages are CDR
    parts: tuple[BagFile, ...]
    notes: tuple[str, ...] = ()  # how it was opened, and what is lost, one sentence each
    _types: dict[str, Types] = field(default_factory=dict)

    def types_of(self, topic: Topic) -> Types:
        """Return the definitions of a topic's type and the types in it, by name; LogError if none
        can be used.
        """
        from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

        if topic.name in self._types:
            return self._types[topic.name]
        types: dict[str, Any] = dict(TIMES)
        own = next((c.msgdef for c in topic.connections if c.msgdef.data), None)
        if own is None:  # what rosbags and replan know
            types = dict(
                get_typestore(Stores.ROS2_HUMBLE if self.is_ros2 else Stores.ROS1_NOETIC).fielddefs
            )
            text = files("replan.logs.readers.ros").joinpath("definitions.msg").read_text()
            for part in text.split("=" * 20 + "\n")[1:]:
                name, _, body = part.partition("\n")
                types |= get_types_from_msg(body, name.removeprefix("MSG: ").strip())
        elif len(own.data) > LARGEST_DEFINITION:
            problem = (
                f"the definition of {topic.kind} has {len(own.data)} characters, at most "
                f"{LARGEST_DEFINITION} are"
            )
            raise LogError(f"{problem} read", topic=topic.name, remedy=SIMPLIFY)
        else:
            try:
                if own.format.name == "MSG":
                    types |= get_types_from_msg(own.data, topic.kind)
                else:
                    idl = [
                        part for part in own.data.split("=" * 80 + "\n") if part.startswith("IDL: ")
                    ]
                    for part in [part.partition("\n")[2] for part in idl] or [own.data]:
                        types |= get_types_from_idl(part)
            except DAMAGE as error:
                problem = (
                    f"the definition of {topic.kind} in the file cannot be used ({describe(error)})"
                )
                raise LogError(problem, topic=topic.name, remedy=COPY_AGAIN) from None
        if topic.kind not in types:
            problem = (
                f"the log does not define its message type {topic.kind}, and replan does not "
                "know it"
            )
            raise LogError(
                problem, topic=topic.name, remedy="record as MCAP, which holds the definitions"
            )
        self._types[topic.name] = types
        return types

    def defines(self, topic: Topic) -> bool:
        """Return whether the file itself defines the topic's type."""
        return any(connection.msgdef.data for connection in topic.connections)

    def knows(self, topic: Topic) -> bool:
        """Return whether the file defines the topic's type, or replan does."""
        if self.defines(topic):
            return True
        try:
            return bool(self.types_of(topic))
        except LogError:
            return False

    def has(self, topic: Topic, path: str) -> bool:
        """Return whether the topic's messages have a field, given by its dotted name."""
        return has_field(self.types_of(topic), topic.kind, path)

    def read(
        self, topic: Topic, wanted: Wanted, begin: int | None = None, end: int | None = None
    ) -> tuple[IntArray, list[tuple[Any, ...]]]:
        """Return log times `(n,)` ns, sorted, and wanted fields from `begin` to `end`, ns; LogError
        if damaged.
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
                problem = f"a message does not fit its type {topic.kind}: {error}"
                raise LogError(problem, topic=topic.name, time_ns=time, remedy=COPY_AGAIN) from None
            times.append(time)
        order = np.argsort(np.array(times, dtype=np.int64), kind="stable")
        return np.array(times, dtype=np.int64)[order], [rows[i] for i in order]

    def raw(
        self, topic: Topic, begin: int | None = None, end: int | None = None
    ) -> Iterator[tuple[int, bytes]]:
        """Yield log time and bytes of the messages from `begin` to `end`, ns, inclusive; LogError
        if damaged.
        """
        count = 0
        for part in self.parts:
            last: int | None = None
            try:
                for time, raw in _messages(part, topic, begin, end):
                    if not 0 <= time <= LAST_TIME_NS:
                        problem = f"log time {time} ns is beyond any clock"
                        raise LogError(problem, topic=topic.name, remedy=COPY_AGAIN)
                    last, count = time, count + 1
                    yield time, raw
            except LogError:
                raise
            except DAMAGE as error:
                where = "" if last is None else " after this time"
                problem = f"the file is damaged{where} ({describe(error)})"
                raised = LogError(problem, topic=topic.name, time_ns=last, remedy=part.remedy)
                raise raised.at(part.path) from None
        if begin is None and end is None and count < topic.count:
            problem = f"{count} of {topic.count} messages can be read"
            raise LogError(problem, topic=topic.name, remedy=self.parts[0].remedy)


def _messages(
    part: BagFile, topic: Topic, begin: int | None, end: int | None
) -> Iterator[tuple[int, bytes]]:
    """Log time and bytes of a topic's messages in a file, decompressed."""
    connections = [
        connection for connection in topic.connections if connection.owner is part.storage
    ]
    if not connections:
        return
    beyond = None if end is None else end + 1
    for _, time, raw in part.storage.messages(connections, begin, beyond):
        # No message of ROS 2 begins so: rosbag2 compressed it by itself
        is_compressed = part.magic != ROS1 and raw.startswith(ZSTD)
        yield time, ZstdDecompressor().decompressobj().decompress(raw) if is_compressed else raw


@contextmanager
def opened(path: Path) -> Iterator[Bag]:
    """Open the bag at a path; LogError if it cannot be opened."""
    with opened_parts(path) as (parts, notes):
        connections: dict[tuple[str, str], list[Any]] = {}
        for part in parts:
            for connection in part.storage.connections:
                key = connection.topic, connection.msgtype
                connections.setdefault(key, []).append(connection)
        topics = [
            Topic(name, kind, sum(connection.msgcount for connection in same), tuple(same))
            for (name, kind), same in connections.items()
        ]
        # of one topic and several types, the type with most messages
        most = {
            topic.name: topic for topic in sorted(topics, key=lambda each: (each.count, each.kind))
        }
        filled = [part for part in parts if part.count]
        yield Bag(
            tuple(most[name] for name in sorted(most)),
            min((part.start_ns for part in filled), default=0),
            max((part.end_ns for part in filled), default=0),
            all(part.magic != ROS1 for part in parts),
            tuple(parts),
            tuple(notes),
        )
