"""MCAP files record by record: the intact part of a damaged one (`salvage`), a part of a remote one
(`write_part`).

Salvage writes every intact chunk into a new file, and reports what was lost. At bytes that are not
a record (a cut, changed bytes), it searches for the next chunk that inflates to its stated size and
checksum and has only messages of its stated times. It keeps and counts chunks without a checksum
(rosbags writes them). Messages outside of chunks have no checksum of their own: it keeps them up to
the first damage. Schemas and channels come from the chunks and from the summary at the file's end
if that is intact; the profile (which identifies a ROS 2 bag) from the header, else from the
schemas.

From a native MCAP file at a URL, only the data that a part of it by time needs is fetched. The
summary at the file's end has the begin and end of each chunk, and its topics. Besides summary and
metadata, these chunks are fetched: those

(1) that overlap [begin - `HISTORY_S`, end + `HISTORY_S`] of the log, `DETECTED_S` where it has
    detections,
(2) of each topic the last before and the first after that: a message may have samples around it
    (blocks),
(3) with any topic but `PERIODIC`: road, vehicle and goal, lights that changed long ago,
(4) the first, which has the log's first ego state.

They are written as a file, whose scenario after the cut (`replan.logs.edit.cut`) equals that of the
whole file after the cut. Its table of agents is that of the whole file without the agents that have
no sample in the part.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from io import BytesIO
from mmap import mmap
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from replan.core.errors import LogError, writing
from replan.core.names import counted
from replan.logs.edit.cut import DETECTED_S, HISTORY_S
from replan.logs.mcap import native
from replan.logs.mcap.container import COMPRESSIONS, DAMAGE, content_of, opened
from replan.logs.mcap.reader import UNSEEN, read_scenario
from replan.logs.mcap.writer import write_scenario

BEGIN = 8
"""Bytes of the magic."""
HEAD = 9
"""Bytes of a record's opcode and length."""
CHUNK_BYTES = 1024 * 1024
CRC = slice(HEAD + 24, HEAD + 28)
"""Where a chunk's checksum is in its record; 0: none."""
SALVAGED = "replan salvage"
"""What the header of a salvaged file names as its writer."""
ROS2_SCHEMAS = frozenset({"ros2msg", "ros2idl"})
PERIODIC = ("/ego", "/agents", "/controls", "/actuation", "/detections", "/removed")
TAIL_BYTES = 16 * 1024
"""Bytes at the end that are fetched first: they have the summary of a log of some minutes."""
FOOTER_BYTES = 1 + 8 + 20 + len(MCAP0_MAGIC)
Ranged = Callable[[int, int], bytes]
"""Returns the bytes of a file from the first position up to the second."""
R = TypeVar("R", bound=McapRecord)


@dataclass(frozen=True)
class Lost:
    """A part that was lost: bytes from `at`, messages between two log times (ns; None: the file's
    begin, end).

    The times are those of the last message before it and the first one after it.
    """

    at: int
    size: int
    after_ns: int | None
    before_ns: int | None

    def __str__(self) -> str:
        begin = "the begin" if self.after_ns is None else f"{self.after_ns / 1e9:.3f} s"
        end = "the end" if self.before_ns is None else f"{self.before_ns / 1e9:.3f} s"
        return f"lost between {begin} and {end}: {self.size} bytes from byte {self.at}"


@dataclass
class Salvage:
    """What was kept and what was lost.

    `nameless` counts intact messages whose channel was lost, `unchecked` chunks without a checksum.
    """

    messages: int = 0
    chunks: int = 0
    unchecked: int = 0
    nameless: int = 0
    lost: list[Lost] = field(default_factory=list)

    def lines(self) -> list[str]:
        """The report, one line each."""
        summary = (
            f"kept {counted(self.messages, 'message')} in {counted(self.chunks, 'intact chunk')}"
        )
        nameless = (
            [f"left out {counted(self.nameless, 'message')} whose channel was lost"]
            if self.nameless
            else []
        )
        unsure = (
            f"{self.unchecked} of the chunks have no checksum: bytes that changed in their "
            "messages are not seen"
        )
        unchecked = [unsure] if self.unchecked else []
        if not self.lost:
            return [f"{summary}; nothing was lost", *unchecked]
        return [summary, *map(str, self.lost), *nameless, *unchecked]


def is_salvaged(path: Path) -> bool:
    """Return whether `salvage` wrote an MCAP file; OSError if it cannot be read."""
    with path.open("rb") as stream:
        return SALVAGED.encode() in stream.read(4096)


def salvage(source: Path, target: Path) -> Salvage:
    """Write what is intact in `source` to `target`, an MCAP file with the same schemas, channels
    and metadata.

    Raises:
        LogError: The source cannot be read, is not an MCAP file, or has no intact message; then no
            file is written.
    """
    raw = content_of(source)
    report, copy = Salvage(), Catalogue()
    messages: list[Message] = []
    for piece in pieces(raw):
        if isinstance(piece, Lost):
            report.lost.append(piece)
            continue
        for record in piece.records:
            copy.take(record)
        messages += piece.messages
        report.chunks += piece.is_chunk
        checksum = raw[piece.begin + CRC.start : piece.begin + CRC.stop]
        report.unchecked += piece.is_chunk and not any(checksum)
    copy.take_summary(raw)
    named = [message for message in messages if message.channel_id in copy.channels]
    report.nameless, report.messages = len(messages) - len(named), len(named)
    if not report.messages:
        raise LogError("no intact message is left", file=source, remedy="copy or record it again")
    part = target.with_name(f".{target.name}.part")
    try:
        with writing(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            copy.write(part, named)
            part.replace(target)
    finally:
        part.unlink(missing_ok=True)
    return report


@dataclass(frozen=True)
class Intact:
    """An intact record of a file, from byte `begin`: what it holds, or itself."""

    begin: int
    opcode: int
    records: list[McapRecord]

    @property
    def is_chunk(self) -> bool:
        """Whether the records are those of a chunk."""
        return self.opcode == Opcode.CHUNK

    @property
    def messages(self) -> list[Message]:
        """The messages, in the order of the file."""
        return [record for record in self.records if isinstance(record, Message)]


def pieces(raw: bytes | mmap) -> Iterator[Intact | Lost]:
    """Yield what is intact in a file up to its end of data, which is the last piece, and what is
    lost between.
    """
    place, damaged = BEGIN, False
    last, broken = None, None
    while place < len(raw):
        records = _record_at(raw, place, in_step=broken is None, undamaged=not damaged)
        if records is None:
            broken, damaged = place if broken is None else broken, True
            place = _next_chunk(raw, place + 1)
            continue
        size, held = records
        piece = Intact(place, raw[place], held)
        times = [message.log_time for message in piece.messages]
        if broken is not None and times:
            yield Lost(broken, place - broken, last, times[0])
            broken = None
        yield piece
        if broken is None and piece.opcode == Opcode.DATA_END:
            return
        last = times[-1] if times else last
        place += HEAD + size
    if broken is not None:
        yield Lost(broken, len(raw) - broken, last, None)


@dataclass
class Catalogue:
    """What describes the messages of a file; `statistics` as the file states them."""

    profile: str = ""
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: list[Metadata] = field(default_factory=list)
    statistics: Statistics | None = None

    def take(self, record: McapRecord) -> None:
        """Add a record, if it is one of these; the first of an id counts."""
        if isinstance(record, Header):
            self.profile = record.profile
        elif isinstance(record, Schema):
            self.schemas.setdefault(record.id, record)
        elif isinstance(record, Channel):
            self.channels.setdefault(record.id, record)
        elif isinstance(record, Statistics):
            self.statistics = record
        elif isinstance(record, Metadata) and record not in self.metadata:
            self.metadata.append(record)

    def take_summary(self, raw: bytes | mmap) -> None:
        """Add what the summary at a file's end describes, as far as it is intact."""
        footer = len(raw) - BEGIN - HEAD - 20
        if footer < BEGIN or raw[footer] != Opcode.FOOTER:
            return
        place, offsets = struct.unpack_from("<QQ", raw, footer + HEAD)
        end = min(offsets or footer, footer)
        while BEGIN <= place < end:
            size = struct.unpack_from("<Q", raw, place + 1)[0] if place + HEAD <= end else end
            if place + HEAD + size > end:
                return
            if raw[place] in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS):
                record = _record_at(raw, place, in_step=True)
                if record is None:
                    return
                self.take(record[1][0])
            place += HEAD + size

    def write(self, path: Path, messages: Sequence[Message]) -> None:
        """Write messages of known channels as an MCAP file."""
        with path.open("wb") as file:
            writer: Any = Writer(file, CHUNK_BYTES, CompressionType.ZSTD, enable_data_crcs=True)
            encodings = {schema.encoding for schema in self.schemas.values()}
            writer.start(
                self.profile or ("ros2" if encodings & ROS2_SCHEMAS else ""), library=SALVAGED
            )
            for record in self.metadata:
                writer.add_metadata(record.name, record.metadata)
            schemas, channels = {0: 0}, {}
            for old, schema in sorted(self.schemas.items()):
                schemas[old] = writer.register_schema(schema.name, schema.encoding, schema.data)
            for old, channel in sorted(self.channels.items()):
                schema_id = schemas.get(channel.schema_id, 0)
                channels[old] = writer.register_channel(
                    channel.topic, channel.message_encoding, schema_id, channel.metadata
                )
            for message in messages:
                sent = message.log_time, message.data, message.publish_time
                writer.add_message(channels[message.channel_id], *sent, message.sequence)
            writer.finish()


def _record_at(
    raw: bytes | mmap, at: int, *, in_step: bool = False, undamaged: bool = False
) -> tuple[int, list[McapRecord]] | None:
    """Length of the record at a byte, and the records in it; None if there is no intact record.

    After damage (not `in_step`) only chunks are accepted; messages outside of chunks only while all
    is `undamaged`.
    """
    if at + HEAD > len(raw):
        return None
    code, size = raw[at], struct.unpack_from("<Q", raw, at + 1)[0]
    if size > len(raw) - at - HEAD:
        return None
    body = ReadDataStream(BytesIO(raw[at + HEAD : at + HEAD + size]))
    try:
        if code == Opcode.CHUNK:
            chunk = Chunk.read(body)
            records = opened(chunk)
            begin, end = chunk.message_start_time, chunk.message_end_time
            if any(
                not begin <= record.log_time <= end
                for record in records
                if isinstance(record, Message)
            ):
                return None  # the stated times are not those of its messages
            return size, records
        if not in_step or (code == Opcode.MESSAGE and not undamaged):
            return None
        if code in _PASSED:
            return size, []
        return size, [_KNOWN[code](body, size)]
    except (LogError, KeyError, *DAMAGE):
        return None


def messages_at(raw: bytes | mmap, begin: int) -> list[Message]:
    """Return the messages of the intact record at a byte."""
    held = _record_at(raw, begin, in_step=True, undamaged=True)
    return [] if held is None else [message for message in held[1] if isinstance(message, Message)]


_KNOWN: dict[int, Any] = {
    Opcode.HEADER: lambda stream, size: Header.read(stream),
    Opcode.SCHEMA: lambda stream, size: Schema.read(stream),
    Opcode.CHANNEL: lambda stream, size: Channel.read(stream),
    Opcode.METADATA: lambda stream, size: Metadata.read(stream),
    Opcode.MESSAGE: Message.read,
    Opcode.STATISTICS: lambda stream, size: Statistics.read(stream),
}
"""Records outside of chunks that are kept, or compared with what is kept."""
_PASSED = frozenset(Opcode) - frozenset(_KNOWN) - {Opcode.CHUNK}
"""Records that are skipped: indexes, attachments, the summary, the footer."""


def _next_chunk(raw: bytes | mmap, position: int) -> int:
    """The next byte at which an intact chunk begins; the file's length if there is none."""
    names = {name.encode() for name in COMPRESSIONS}
    position = raw.find(bytes([Opcode.CHUNK]), position)
    while 0 <= position <= len(raw) - HEAD - 32:
        # Of its compression's name, which is cheap to check before the chunk is opened
        place = position + HEAD + 32
        (size,) = struct.unpack_from("<I", raw, place - 4)
        if (
            size <= 4
            and raw[place : place + size] in names
            and _record_at(raw, position) is not None
        ):
            return position
        position = raw.find(bytes([Opcode.CHUNK]), position + 1)
    return len(raw)


def write_part(ranged: Ranged, size: int, begin: float, end: float, path: Path) -> bool:
    """Write the chunks that [begin, end] (s after the log's start) needs to `path`; False: the
    whole file is needed.

    That is so if the file is not a native log, has no index, is damaged, or leaves out data that
    the reader derives from the whole log (a road along the drive, speeds; the reader notes that).
    """
    try:
        tail_begin = max(0, size - TAIL_BYTES)
        tail = ranged(tail_begin, size)
        footer = next(iter(_records(tail[-FOOTER_BYTES:])))
        if not isinstance(footer, Footer) or not footer.summary_start:
            return False
        if footer.summary_start < tail_begin:
            tail, tail_begin = ranged(footer.summary_start, tail_begin) + tail, footer.summary_start
        summary = list(_records(tail[footer.summary_start - tail_begin :]))
        index = next(
            index
            for index in _records_of_kind(summary, MetadataIndex)
            if index.name == native.SCENARIO_RECORD
        )
        first_record = next(iter(_records(ranged(index.offset, index.offset + index.length))))
        record = first_record.metadata if isinstance(first_record, Metadata) else {}
        if "start_ns" not in record:
            return False
        start_ns = msgspec.json.decode(record["start_ns"], type=int)
        detected = any(
            channel.topic == "/detections" for channel in _records_of_kind(summary, Channel)
        )
        around = DETECTED_S if detected else HISTORY_S
        chunks = _chosen(
            summary, start_ns + 1e9 * (begin - around), start_ns + 1e9 * (end + around)
        )
        if not chunks:
            return False
        path.write_bytes(b"".join(_pieces(ranged, summary, chunks)))
        noted = msgspec.json.decode(record.get("notes", "[]"), type=tuple[str, ...])
        scenario = read_scenario(path)
        made_up = [note for note in scenario.notes[len(noted) :] if not note.endswith(UNSEEN)]
        if not made_up and scenario.notes != noted:
            write_scenario(path, replace(scenario, notes=noted))
        return not made_up
    except (*DAMAGE, LogError, StopIteration):
        return False


def _records(raw: bytes) -> Iterable[McapRecord]:
    return StreamReader(BytesIO(raw), skip_magic=True).records


def _records_of_kind(summary: Sequence[McapRecord], kind: type[R]) -> list[R]:
    return [record for record in summary if isinstance(record, kind)]


def _chosen(summary: Sequence[McapRecord], first_ns: float, last_ns: float) -> list[ChunkIndex]:
    chunks = sorted(
        _records_of_kind(summary, ChunkIndex), key=lambda chunk: chunk.chunk_start_offset
    )
    rare = {
        channel.id
        for channel in _records_of_kind(summary, Channel)
        if channel.topic not in PERIODIC
    }
    chosen = set(range(len(chunks[:1])))  # (4)
    for k, chunk in enumerate(chunks):
        if chunk.message_start_time <= last_ns and first_ns <= chunk.message_end_time:
            chosen.add(k)  # (1)
    for channel in {number for chunk in chunks for number in chunk.message_index_offsets}:
        having = [k for k, chunk in enumerate(chunks) if channel in chunk.message_index_offsets]
        chosen |= set([k for k in having if chunks[k].message_end_time < first_ns][-1:])  # (2)
        chosen |= set([k for k in having if chunks[k].message_start_time > last_ns][:1])
        chosen |= set(having) if channel in rare else set()  # (3)
    return [chunks[k] for k in sorted(chosen)]


def _pieces(
    ranged: Ranged, summary: Sequence[McapRecord], chunks: Sequence[ChunkIndex]
) -> Iterator[bytes]:
    """The pieces of a file without index: head, metadata, schemas and channels, the chunks
    unchanged, its end.
    """
    indices = _records_of_kind(summary, MetadataIndex)
    first = min(
        [index.offset for index in indices] + [chunk.chunk_start_offset for chunk in chunks]
    )
    yield ranged(0, first)
    for index in indices:
        yield ranged(index.offset, index.offset + index.length)
    yield _written([*_records_of_kind(summary, Schema), *_records_of_kind(summary, Channel)])
    # Neighbours are one request, with the indices between
    runs, behind = list[tuple[int, int]](), -1
    for chunk in chunks:
        begin = chunk.chunk_start_offset
        end = begin + chunk.chunk_length
        if begin == behind:
            begin = runs.pop()[0]
        runs.append((begin, end))
        behind = end + chunk.message_index_length
    for begin, end in runs:
        yield ranged(begin, end)
    yield _written(
        [
            DataEnd(data_section_crc=0),
            Footer(summary_start=0, summary_offset_start=0, summary_crc=0),
        ]
    )
    yield MCAP0_MAGIC


def _written(records: Sequence[Any]) -> bytes:
    builder: Any = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())
