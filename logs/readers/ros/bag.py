"""Opens bags with rosbags: their topics, and selected fields of their messages by time."""

from __future__ import annotations

import os
import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from shutil import copyfile
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from zstandard import ZstdError, frame_content_size

from replan.core.arrays import IntArray
from replan.core.errors import LogError
from replan.logs.readers.ros.fields import SIMPLIFY, Types, Wanted, decoder, has_field

MAGIC = {".bag": b"#ROSBAG V", ".db3": b"SQLite format 3\0", ".mcap": b"\x89MCAP0\r\n"}
METADATA = "metadata.yaml"
JOURNALS = ("-wal", "-journal")
"""Suffixes of the files beside a SQLite file that hold what was not yet written into it."""
BAG = b"rosbag2_bagfile_information"
LISTED_BYTES = 1 << 28
"""Largest bag for which `contents` gives times, bytes: the index does not contain them."""
COPY_AGAIN = "copy or record it again"
LAST_TIME_NS = 2**63 - 1
MAX_CHUNK_BYTES = 1 << 30
"""Largest decompressed chunk of a bag, bytes: rosbag2 writes 768 KiB, the largest known are 100
MiB.
"""
LARGEST_DEFINITION = 1 << 18
"""Longest text of a message definition: Autoware's longest have some 20,000 characters."""
_CHUNK_HEAD_BYTES, _FRAME_HEAD_BYTES = 9 + 40, 18
"""Size of an MCAP chunk's head without the name of the compression, and greatest size of a zstd
frame's head.
"""
TIMES: Types = {
    f"builtin_interfaces/msg/{name}": (
        [],
        [("sec", (1, ("int32", 0))), ("nanosec", (1, ("uint32", 0)))],
    )
    for name in ("Time", "Duration")
}
"""Definitions of times: primitive types in ROS 1, messages in ROS 2."""
DAMAGE = (Exception,)
"""Exceptions of rosbags and the decompressors on damaged bytes; they have no common base
(AssertionError, KeyError ...)."""


@dataclass(frozen=True)
class Topic:
    """A topic: `kind` is its message type in ROS 2 form (pkg/msg/Type), `count` its number of
    messages.
    """

    name: str
    kind: str
    count: int
    encoding: str
    connections: tuple[Any, ...] = ()


@dataclass
class Bag:
    """An open bag."""

    topics: tuple[Topic, ...]  # its topics, sorted by name
    start_ns: int  # log time of the first message; `end_ns` of the last
    end_ns: int
    is_ros2: bool  # whether its messages are CDR
    _messages: Callable[..., Iterator[tuple[Any, int, bytes]]]
    notes: tuple[str, ...] = ()  # how it was opened, one sentence each
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
            what = (
                f"the definition of {topic.kind} has {len(own.data)} characters, at most "
                f"{LARGEST_DEFINITION} are"
            )
            raise LogError(f"{what} read", topic=topic.name, remedy=SIMPLIFY)
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
                what = (
                    f"the definition of {topic.kind} in the file cannot be used "
                    f"({_describe(error)})"
                )
                raise LogError(what, topic=topic.name, remedy=COPY_AGAIN) from None
        if topic.kind not in types:
            what = (
                f"the log does not define its message type {topic.kind}, and replan does not "
                "know it"
            )
            raise LogError(
                what, topic=topic.name, remedy="record as MCAP, which holds the definitions"
            )
        self._types[topic.name] = types
        return types

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
                what = f"a message does not fit its type {topic.kind}: {error}"
                raise LogError(what, topic=topic.name, time_ns=time, remedy=COPY_AGAIN) from None
            times.append(time)
        order = np.argsort(np.array(times, dtype=np.int64), kind="stable")
        return np.array(times, dtype=np.int64)[order], [rows[i] for i in order]

    def raw(
        self, topic: Topic, begin: int | None = None, end: int | None = None
    ) -> Iterator[tuple[int, bytes]]:
        """Yield log time and bytes of the messages from `begin` to `end`, ns, inclusive; LogError
        if damaged.
        """
        last: int | None = None
        try:
            for _, time, raw in self._messages(
                topic.connections, begin, None if end is None else end + 1
            ):
                if not 0 <= time <= LAST_TIME_NS:
                    raise LogError(
                        f"log time {time} ns is beyond any clock",
                        topic=topic.name,
                        remedy=COPY_AGAIN,
                    )
                last = time
                yield time, raw
        except LogError:
            raise
        except DAMAGE as error:
            what = (
                f"the file is damaged{'' if last is None else ' after this time'} "
                f"({_describe(error)})"
            )
            raise LogError(what, topic=topic.name, time_ns=last, remedy=COPY_AGAIN) from None


@contextmanager
def opened(path: Path) -> Iterator[Bag]:
    """Open the bag at a path; LogError if it cannot be opened."""
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

    is_ros2 = path.suffix.lower() != ".bag" or path.is_dir()
    scratch = ExitStack()
    try:
        unclosed = _unclosed(path)
        near = (
            _closed_copy(path, unclosed, Path(scratch.enter_context(TemporaryDirectory())))
            if unclosed
            else path
        )
        reader: Any = Reader2(near) if is_ros2 else Reader1(near)
        reader.open()
    except DAMAGE as error:
        scratch.close()
        raise LogError(
            f"the bag cannot be opened ({_describe(error)})", file=path, remedy=COPY_AGAIN
        ) from None
    try:
        storage = getattr(reader, "storage", None)
        for part in getattr(storage, "storages", [storage]):
            for chunk in getattr(part, "chunks", ()):
                size = chunk.uncompressed_size
                # The frame states how many bytes it holds, whatever the index states
                if chunk.compression == "zstd":
                    begin = chunk.chunk_start_offset + _CHUNK_HEAD_BYTES + len(chunk.compression)
                    # Reading it says what is wrong
                    with suppress(ZstdError, OSError, OverflowError):
                        size = max(
                            size,
                            frame_content_size(
                                os.pread(part.bio.fileno(), _FRAME_HEAD_BYTES, begin)
                            ),
                        )
                if size > MAX_CHUNK_BYTES:  # refused before decompression
                    what = f"a chunk of {chunk.compressed_size} bytes would become {size}"
                    raise LogError(
                        what, file=path, time_ns=chunk.message_start_time, remedy=COPY_AGAIN
                    )
        connections: dict[tuple[str, str], list[Any]] = {}
        for each in reader.connections:
            connections.setdefault((each.topic, each.msgtype), []).append(each)
        topics = []
        for (name, kind), some in connections.items():
            encoding = getattr(some[0].ext, "serialization_format", "ros1")
            topics.append(
                Topic(name, kind, sum(each.msgcount for each in some), encoding, tuple(some))
            )
        # of one topic and several types, the type with most messages
        most = {
            topic.name: topic for topic in sorted(topics, key=lambda each: (each.count, each.kind))
        }
        sorted_topics = tuple(most[name] for name in sorted(most))
        notes = tuple(
            f"{file.name} was not closed: its journal beside it is read too, in a copy."
            for file in unclosed
        )
        yield Bag(
            sorted_topics, reader.start_time, reader.end_time - 1, is_ros2, reader.messages, notes
        )
    finally:
        with scratch:
            reader.close()


def _unclosed(path: Path) -> tuple[Path, ...]:
    """Return the SQLite files of a bag that have a journal beside them which is not empty."""
    journals = ((file, Path(f"{file}{suffix}")) for file in bag_files(path) for suffix in JOURNALS)
    return tuple(file for file, beside in journals if beside.is_file() and beside.stat().st_size)


def _closed_copy(path: Path, unclosed: tuple[Path, ...], folder: Path) -> Path:
    """Copy a bag into a folder, and write the journals of its SQLite files into them."""
    for file in bag_files(path):
        near = folder / file.name
        if file not in unclosed:
            near.symlink_to(file.absolute())
            continue
        for suffix in ("", *JOURNALS):
            if Path(f"{file}{suffix}").is_file():
                copyfile(f"{file}{suffix}", f"{near}{suffix}")
        with closing(sqlite3.connect(near)) as database:
            # Reads the journal, and leaves one file
            database.execute("PRAGMA journal_mode = DELETE")
    return folder if path.is_dir() else folder / path.name


def _describe(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:300]


def bag_files(path: Path) -> tuple[Path, ...]:
    """Return the files of a bag: the file itself, or a folder's metadata and all its bag files."""
    kinds = (".mcap", ".db3", ".zstd", *(f".db3{suffix}" for suffix in JOURNALS))
    if path.is_dir():
        return (path / METADATA, *sorted(each for each in path.iterdir() if each.suffix in kinds))
    return (path, *(beside for suffix in JOURNALS if (beside := Path(f"{path}{suffix}")).is_file()))
