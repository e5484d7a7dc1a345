"""An MCAP file as topics of messages, or one sentence that states what is wrong with it.

The file is read from front to back with every checksum verified (chunk and data section), never
through its index: a changed byte is found, or lies where nothing is read. Messages before the
damage are kept, for `replan inspect`.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

import msgspec
from lz4.frame import LZ4FrameDecompressor
from mcap.exceptions import EndOfFile, InvalidMagic, McapError, RecordLengthLimitExceeded
from mcap.records import Channel, Chunk, DataEnd, McapRecord, Message, Metadata, Schema, Statistics
from mcap.stream_reader import CRCValidationError, StreamReader, breakup_chunk
from zstandard import ZstdDecompressor, ZstdError

from replan.core.errors import LogError
from replan.core.files import check_regular

T = TypeVar("T")

COPY_AGAIN = "copy or record it again"
SALVAGE = "copy it again, or keep what is whole with `replan salvage`"
CONVERT = "`replan convert --formats` lists what replan reads and how a format is added"
MOST_CHUNK_BYTES = 256 * 2**20
"""Greatest inflated size of a chunk: writers make chunks of about 1 MiB, some 10 MiB for point
clouds.
"""
MOST_BYTES = 4 * 2**30
"""Greatest inflated size of all chunks of a file, which are held in memory."""
SPLIT = "write smaller chunks, or take a part of the log"
RECORD_HEAD = struct.Struct("<BQ")  # type and size
LAST_KIND = 0x0F  # the greatest type of the specification; 0 is none, others are private
MOST_UNKNOWN = 10_000
"""Most private records of a file, and of a chunk: each takes the time of a message, and millions of
empty ones fit into kilobytes.
"""
TOO_MANY = f"more than {MOST_UNKNOWN} records of types that MCAP does not define"
COMPRESSIONS = ("", "zstd", "lz4")
LAST_TIME_NS = 2**63 - 1

DAMAGE = (McapError, ZstdError, struct.error, ValueError, RuntimeError, OverflowError, MemoryError)
"""The exceptions that the libraries raise on damaged bytes (checksums: ValueError, lz4:
RuntimeError).
"""


@dataclass(frozen=True)
class Stream:
    """The messages of one topic, in the order of the file: log times (ns) and payloads."""

    topic: str
    encoding: str
    schema: str
    schema_encoding: str
    schema_data: bytes
    times: list[int] = field(default_factory=list)
    payloads: list[bytes] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.times)

    def decoded(self, kind: type[T]) -> list[T]:
        """The messages as Structs; LogError, which names the field, if one does not fit."""
        if self.encoding != "json":
            raise LogError(
                f"messages are encoded as {self.encoding!r}, expected 'json'", topic=self.topic
            )
        decoder, messages = msgspec.json.Decoder(kind), []
        for time, payload in zip(self.times, self.payloads, strict=True):
            try:
                messages.append(decoder.decode(payload))
            except (msgspec.MsgspecError, UnicodeError, RecursionError) as error:
                problem = f"message does not fit: {error}".replace("`", "")
                malformed = isinstance(error, msgspec.DecodeError) and not isinstance(
                    error, msgspec.ValidationError
                )
                bare = next((word for word in (b"NaN", b"Infinity") if word in payload), b"")
                if malformed and bare:
                    name = (
                        payload.partition(bare)[0]
                        .rpartition(b'":')[0]
                        .rpartition(b'"')[2]
                        .decode(errors="replace")
                    )
                    problem = (
                        f"{name} is {bare.decode()}, which is not JSON: a missing value is null"
                    )
                raise LogError(problem, topic=self.topic, time_ns=time, remedy=MEND) from None
        return messages

    def check_order(self, *, strictly: bool) -> None:
        """Raise LogError if times go backwards, or, if `strictly`, two are equal."""
        for before, time in pairwise(self.times):
            if time < before:
                problem = f"time goes backwards, from {before / 1e9:.3f} s"
                raise LogError(
                    problem,
                    topic=self.topic,
                    time_ns=time,
                    remedy="write the messages in order of time",
                )
            if strictly and time == before:
                problem = "two messages have the same time"
                raise LogError(problem, topic=self.topic, time_ns=time, remedy="keep one of them")


MEND = "write the field as its schema in the file says"


@dataclass(frozen=True)
class Container:
    """The content of an MCAP file; `error` is the damage at which reading ended, or None."""

    path: Path
    size: int
    streams: dict[str, Stream]
    metadata: dict[str, dict[str, str]]
    error: LogError | None

    def whole(self) -> Container:
        """Return this container if it is undamaged and has messages; LogError if it is damaged, or
        has no messages.
        """
        if self.error is not None:
            raise self.error
        if not any(map(len, self.streams.values())):
            raise LogError("the file holds no messages", file=self.path, remedy=COPY_AGAIN)
        return self

    def of_schema(self, *names: str) -> Stream | None:
        """The first topic that has messages of one of these schemas."""
        return next((s for s in self.streams.values() if s.schema in names and len(s)), None)


def read_container(path: Path) -> Container:
    """Read the file up to its end or its damage; it raises nothing."""
    streams: dict[str, Stream] = {}
    metadata: dict[str, dict[str, str]] = {}
    schemas: dict[int, Schema] = {}
    channels: dict[int, Stream] = {}
    error, raw, ended = None, b"", False
    try:
        raw = content_of(path)
        if not raw:
            raise LogError("the file is empty", remedy=COPY_AGAIN)
        for record in _records(raw, streams):
            if isinstance(record, DataEnd):
                ended = True
            if isinstance(record, Statistics):
                held = sum(map(len, streams.values()))
                if held < record.message_count:
                    problem = f"it holds {held} messages, and its statistics state"
                    raise LogError(f"{problem} {record.message_count}", remedy=SALVAGE)
            if ended:
                continue  # the records after it repeat schemas and channels
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                topic, schema = record.topic, schemas.get(record.schema_id)
                if schema is None and record.schema_id != 0:
                    raise LogError(
                        f"schema {record.schema_id} is not in the file",
                        topic=topic,
                        remedy=COPY_AGAIN,
                    )
                parts = (schema.name, schema.encoding, schema.data) if schema else ("", "", b"")
                stream = streams.setdefault(topic, Stream(topic, record.message_encoding, *parts))
                if (stream.encoding, stream.schema) != (record.message_encoding, parts[0]):
                    problem = f"two channels with different schemas, {stream.schema} and {parts[0]}"
                    raise LogError(problem, topic=topic, remedy="keep one of them")
                channels[record.id] = stream
            elif isinstance(record, Metadata):
                metadata[record.name] = record.metadata
            elif isinstance(record, Message):
                if record.channel_id not in channels:
                    raise LogError(
                        f"channel {record.channel_id} is not in the file", remedy=COPY_AGAIN
                    )
                stream = channels[record.channel_id]
                if record.log_time > LAST_TIME_NS:
                    problem = f"log time {record.log_time} ns is beyond any clock"
                    raise LogError(problem, topic=stream.topic, remedy=COPY_AGAIN)
                stream.times.append(record.log_time)
                stream.payloads.append(record.data)
        if not ended:
            raise LogError("the file has no end of data record", remedy=SALVAGE)
    except LogError as damage:
        error = damage.at(path)
    return Container(path, len(raw), streams, metadata, error)


def content_of(path: Path) -> bytes:
    """All bytes of a file; LogError if it cannot be read."""
    check_regular(path)
    try:
        return path.read_bytes()
    except OSError as error:
        raise LogError(f"cannot be read: {error.strerror or error}", file=path) from None


def _records(raw: bytes, streams: dict[str, Stream]) -> Iterator[McapRecord]:
    """The records, those of chunks included; damage becomes a LogError."""
    buffer, total = BytesIO(raw), 0
    reader = _Reader(buffer, emit_chunks=True, validate_crcs=True, record_size_limit=len(raw))
    try:
        for record in reader.records:
            if isinstance(record, Chunk):
                total += record.uncompressed_size
                if total > MOST_BYTES:
                    problem = f"its chunks inflate to more than {MOST_BYTES / 2**30:.0f} GiB"
                    raise LogError(problem, time_ns=record.message_start_time, remedy=SPLIT)
                yield from opened(record)
            else:
                yield record
    except DAMAGE as error:
        position, last = (
            buffer.tell(),
            max(((s.times[-1], s.topic) for s in streams.values() if len(s)), default=None),
        )
        time, topic = last if last is not None else (None, None)
        if isinstance(error, InvalidMagic) and position <= 8:
            raise LogError("not an MCAP file (wrong magic)", remedy=CONVERT) from None
        problem = f"the file is damaged near byte {position} ({_name(error)})"
        if isinstance(
            error, (EndOfFile, RecordLengthLimitExceeded, InvalidMagic)
        ) or position >= len(raw):
            problem = "the file is cut off or damaged" + (
                ": these are the last messages before it" if last else ""
            )
        raise LogError(problem, topic=topic, time_ns=time, remedy=SALVAGE) from None


def opened(chunk: Chunk) -> list[McapRecord]:
    """The records of a chunk, checked by its checksum; LogError if it is damaged or larger than
    `MOST_CHUNK_BYTES`.

    At most the size that the chunk states is inflated.
    """
    time, remedy = chunk.message_start_time, SALVAGE
    if chunk.compression not in COMPRESSIONS:
        remedy = "compress with zstd or lz4, or not at all"
        raise LogError(
            f"a chunk has the unknown compression {chunk.compression!r}",
            time_ns=time,
            remedy=remedy,
        )
    if chunk.uncompressed_size > MOST_CHUNK_BYTES:
        problem = (
            f"a chunk of {len(chunk.data)} bytes would inflate to "
            f"{chunk.uncompressed_size / 2**20:.0f} MiB"
        )
        raise LogError(
            problem,
            time_ns=time,
            remedy=f"the bound is {MOST_CHUNK_BYTES / 2**20:.0f} MiB; {SPLIT}",
        )
    size = chunk.uncompressed_size
    try:
        if chunk.compression == "zstd":
            data: bytes = (
                ZstdDecompressor()
                .stream_reader(BytesIO(chunk.data), read_across_frames=True)
                .read(size + 1)
            )
        elif chunk.compression == "lz4":
            data = LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
        else:
            data = chunk.data
        if len(data) != size:
            raise ValueError(
                f"it states {size} bytes and holds {'more' if len(data) > size else len(data)}"
            )
        _check_known(data)
        return breakup_chunk(replace(chunk, compression="", data=data), validate_crc=True)
    except DAMAGE as error:
        problem = f"the chunk that begins there is damaged ({_name(error)})"
        raise LogError(problem, time_ns=time, remedy=remedy) from None


class _Reader(StreamReader):
    """A reader that ends at more than `MOST_UNKNOWN` records of types that MCAP does not define."""

    _unknown = 0

    def _read_record(self, opcode: int, length: int) -> McapRecord | None:
        self._unknown += not 0 < opcode <= LAST_KIND
        if self._unknown > MOST_UNKNOWN:
            raise ValueError(TOO_MANY)
        return super()._read_record(opcode, length)


def _check_known(records: bytes) -> None:
    """Raise ValueError if records of a chunk have what `_Reader` refuses."""
    unknown, place = 0, 0
    while place + RECORD_HEAD.size <= len(records):
        kind, size = RECORD_HEAD.unpack_from(records, place)
        unknown += not 0 < kind <= LAST_KIND
        if unknown > MOST_UNKNOWN:
            raise ValueError(TOO_MANY)
        place += RECORD_HEAD.size + size


def _name(error: BaseException) -> str:
    if isinstance(error, CRCValidationError):
        return "checksum does not match"
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
