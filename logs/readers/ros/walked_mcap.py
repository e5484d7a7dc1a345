"""MCAP files of ROS 2 that are read from front to back, as `replan salvage` reads them.

So are those whose index does not account for all of their messages, and those that have no summary,
another profile than `ros2`, or no end, because their recorder was killed. Opening such a file reads
all of it once, with its checksums; then only the chunks that have a topic at the wanted times.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from itertools import islice
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any, NamedTuple

from mcap.records import Channel

from replan.core.errors import LogError
from replan.core.names import counted
from replan.logs.mcap.container import SALVAGE
from replan.logs.mcap.records import ROS2_SCHEMAS, Catalogue, Lost, messages_at, pieces

MAGIC = b"\x89MCAP0\r\n"
CDR = "cdr"
_HEADER = b"\x01"
_LOOKED_AT = 1000
"""Records among which the first channels of a file must be."""
_ROS2, _NATIVE = b"\x04\0\0\0ros2", b"\x06\0\0\0replan"


def is_ros2_mcap(path: Path, begin: bytes) -> bool:
    """Whether an MCAP file, of which `begin` are the first bytes, is one of ROS 2.

    By the profile in its header, else by the channels in its summary, else by the first ones in it.
    """
    place = len(MAGIC)
    if begin[place : place + 1] != _HEADER:
        return False
    profile = begin[place + 9 :]
    if profile.startswith((_ROS2, _NATIVE)):
        return profile.startswith(_ROS2)
    catalogue = Catalogue()
    with path.open("rb") as stream, mmap(stream.fileno(), 0, access=ACCESS_READ) as raw:
        catalogue.take_summary(raw)
        for piece in () if catalogue.channels else islice(pieces(raw), _LOOKED_AT):
            for record in () if isinstance(piece, Lost) else piece.records:
                catalogue.take(record)
            if catalogue.channels:
                break
    encodings = {
        catalogue.schemas[channel.schema_id].encoding
        for channel in catalogue.channels.values()
        if channel.message_encoding == CDR and channel.schema_id in catalogue.schemas
    }
    return not encodings.isdisjoint(ROS2_SCHEMAS)


class _Place(NamedTuple):
    """Where messages are: the record that holds them, their times (ns), and their channels."""

    begin: int
    first_ns: int
    last_ns: int
    channels: frozenset[int]


class WalkedMcap:
    """The messages in a file, by the methods of rosbags' storages that a bag needs.

    `note` is what is lost or missing at its end; LogError if chunks are damaged and others after
    them are whole.
    """

    def __init__(self, path: Path) -> None:
        with path.open("rb") as stream:
            self._raw = mmap(stream.fileno(), 0, access=ACCESS_READ)
        self._places: list[_Place] = []
        catalogue, counts, chunks = Catalogue(), Counter[int](), 0
        shared: dict[frozenset[int], frozenset[int]] = {}  # one in memory, not one a message
        lost = None
        for piece in pieces(self._raw):
            if isinstance(piece, Lost):
                lost = piece
                continue
            if lost is not None:
                break
            for record in piece.records:
                catalogue.take(record)
            chunks += piece.is_chunk
            held = Counter(message.channel_id for message in piece.messages)
            counts += held
            if held:
                times = [message.log_time for message in piece.messages]
                channels = shared.setdefault(frozenset(held), frozenset(held))
                self._places.append(_Place(piece.begin, min(times), max(times), channels))
        closed = self._raw[-len(MAGIC) :] == MAGIC
        if lost is not None and (closed or lost.before_ns is not None):
            raise LogError(f"the file is damaged: {lost}", file=path, remedy=SALVAGE)
        catalogue.take_summary(self._raw)
        stated = catalogue.statistics
        self.count = counts.total()
        self.stated = self.count if stated is None else stated.message_count
        self.start_ns = min((place.first_ns for place in self._places), default=0)
        self.end_ns = max((place.last_ns for place in self._places), default=0)
        self.connections = tuple(
            self._connection(channel, catalogue, counts[channel.id])
            for channel in catalogue.channels.values()
            if channel.message_encoding == CDR
        )
        lost_bytes = 0 if lost is None else lost.size
        self.note = "" if closed else describe_end(path.name, self.count, chunks, lost_bytes)

    def _connection(self, channel: Channel, catalogue: Catalogue, count: int) -> Any:
        """A channel as rosbags describes it."""
        from rosbags.interfaces import (
            Connection,
            ConnectionExtRosbag2,
            MessageDefinition,
            MessageDefinitionFormat,
        )

        schema = catalogue.schemas.get(channel.schema_id)
        form, text = MessageDefinitionFormat.NONE, ""
        if schema is not None and schema.encoding:
            is_msg = schema.encoding == "ros2msg"
            form = MessageDefinitionFormat.MSG if is_msg else MessageDefinitionFormat.IDL
            text = schema.data.decode(errors="replace")
        return Connection(
            channel.id,
            channel.topic,
            "" if schema is None else schema.name,
            MessageDefinition(form, text),
            "",
            count,
            ConnectionExtRosbag2(channel.message_encoding, []),
            self,
        )

    def messages(
        self, connections: Collection[Any], begin: int | None = None, end: int | None = None
    ) -> Iterator[tuple[Any, int, bytes]]:
        """Yield connection, log time and bytes of messages from `begin` to before `end`, ns, in the
        order of the file.
        """
        wanted = {connection.id: connection for connection in connections}
        for place in self._places:
            is_early = begin is not None and place.last_ns < begin
            is_late = end is not None and place.first_ns >= end
            if is_early or is_late or place.channels.isdisjoint(wanted):
                continue
            for message in messages_at(self._raw, place.begin):
                time = message.log_time
                is_within = (begin is None or time >= begin) and (end is None or time < end)
                if message.channel_id in wanted and is_within:
                    yield wanted[message.channel_id], time, message.data

    def close(self) -> None:
        """Close the file."""
        self._raw.close()


def describe_end(name: str, messages: int, chunks: int, lost_bytes: int) -> str:
    """A note on a file without its end: what is read, and what is lost."""
    held = f"{counted(messages, 'message')} of {counted(chunks, 'chunk')} are read"
    end = f", and the last {lost_bytes} bytes, which are damaged, are lost" if lost_bytes else ""
    return f"{name} was not closed: its recorder was killed, or the file is cut off. {held}{end}."
