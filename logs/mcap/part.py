"""Of a native MCAP file somewhere else: what a part of it by time needs, found by its index and no more fetched.

The summary at the file's end says when each chunk begins and ends, and which topics are in it. Fetched are, besides the
summary and the metadata, the chunks

(1) that overlap [begin - `HISTORY_S`, end + `HISTORY_S`] of the log, `DETECTED_S` where it has detections,
(2) of each topic the last before and the first behind that: a message may stand for samples around it (blocks),
(3) with anything but the samples of `PERIODIC`: road, vehicle and goal, lights that changed long ago,
(4) the first, in which the log's first ego state is.

They are written as a file of their own, whose scenario, cut (`logs.readers.cut`), is that of the whole file, cut. Its
table of agents is that of the whole, too: where some have no sample in the part, they are left out of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, ChunkIndex, DataEnd, Footer, McapRecord, Metadata, MetadataIndex, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC

from logs.errors import LogError
from logs.mcap import native
from logs.mcap.container import DAMAGE
from logs.mcap.reader import UNSEEN, read_scenario
from logs.mcap.writer import write_scenario
from logs.readers.cut import DETECTED_S, HISTORY_S

PERIODIC = ("/ego", "/agents", "/controls", "/actuation", "/detections", "/removed")
TAIL_BYTES = 16 * 1024
"""Fetched first, from the end: the summary of a log of some minutes."""
FOOTER_BYTES = 1 + 8 + 20 + len(MCAP0_MAGIC)
Ranged = Callable[[int, int], bytes]
"""The bytes of a file from the first place up to the second."""
R = TypeVar("R", bound=McapRecord)


def write_part(ranged: Ranged, size: int, begin: float, end: float, path: Path) -> bool:
    """Write what [begin, end] (s after the log's start) needs to `path`; False: the whole file is needed.

    It is where the file is not replan's own, has no index, is damaged, or leaves out what is made up from all of it as
    it is read (a road along the drive, speeds; the reader notes that).
    """
    try:
        summary = _summary(ranged, size)
        record = _scenario_record(ranged, summary)
        if record is None or "start_ns" not in record:
            return False
        start_ns = msgspec.json.decode(record["start_ns"], type=int)
        detected = any(channel.topic == "/detections" for channel in _of(summary, Channel))
        around = DETECTED_S if detected else HISTORY_S
        chunks = _chosen(summary, start_ns + 1e9 * (begin - around), start_ns + 1e9 * (end + around))
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


def _summary(ranged: Ranged, size: int) -> list[McapRecord]:
    """The records of the summary; none where there is no such section."""
    at = max(0, size - TAIL_BYTES)
    tail = ranged(at, size)
    footer = next(iter(StreamReader(BytesIO(tail[-FOOTER_BYTES:]), skip_magic=True).records))
    if not isinstance(footer, Footer) or not footer.summary_start:
        return []
    if footer.summary_start < at:
        tail, at = ranged(footer.summary_start, at) + tail, footer.summary_start
    return list(StreamReader(BytesIO(tail[footer.summary_start - at :]), skip_magic=True).records)


def _of(summary: Sequence[McapRecord], kind: type[R]) -> list[R]:
    return [record for record in summary if isinstance(record, kind)]


def _scenario_record(ranged: Ranged, summary: Sequence[McapRecord]) -> dict[str, str] | None:
    """The metadata of a native log; None if the file is not one."""
    for index in _of(summary, MetadataIndex):
        if index.name == native.SCENARIO_RECORD:
            raw = ranged(index.offset, index.offset + index.length)
            record = next(iter(StreamReader(BytesIO(raw), skip_magic=True).records))
            return record.metadata if isinstance(record, Metadata) else None
    return None


def _chosen(summary: Sequence[McapRecord], first_ns: float, last_ns: float) -> list[ChunkIndex]:
    """The chunks (1) to (4), in the order of the file."""
    chunks = sorted(_of(summary, ChunkIndex), key=lambda chunk: chunk.chunk_start_offset)
    rare = {channel.id for channel in _of(summary, Channel) if channel.topic not in PERIODIC}
    kept = set(range(len(chunks[:1])))  # (4)
    for k, chunk in enumerate(chunks):
        if chunk.message_start_time <= last_ns and first_ns <= chunk.message_end_time:
            kept.add(k)  # (1)
    for channel in {number for chunk in chunks for number in chunk.message_index_offsets}:
        having = [k for k, chunk in enumerate(chunks) if channel in chunk.message_index_offsets]
        kept |= set([k for k in having if chunks[k].message_end_time < first_ns][-1:])  # (2)
        kept |= set([k for k in having if chunks[k].message_start_time > last_ns][:1])
        kept |= set(having) if channel in rare else set()  # (3)
    return [chunks[k] for k in sorted(kept)]


def _pieces(ranged: Ranged, summary: Sequence[McapRecord], chunks: Sequence[ChunkIndex]) -> Iterator[bytes]:
    """A file without index: head, metadata, schemas and channels, the chunks as they are, its end."""
    indices = _of(summary, MetadataIndex)
    first = min([index.offset for index in indices] + [chunk.chunk_start_offset for chunk in chunks])
    yield ranged(0, first)
    for index in indices:
        yield ranged(index.offset, index.offset + index.length)
    yield _written([*_of(summary, Schema), *_of(summary, Channel)])
    for begin, end in _runs(chunks):
        yield ranged(begin, end)
    yield _written([DataEnd(data_section_crc=0), Footer(summary_start=0, summary_offset_start=0, summary_crc=0)])
    yield MCAP0_MAGIC


def _runs(chunks: Sequence[ChunkIndex]) -> list[tuple[int, int]]:
    """From where to where chunks lie; neighbours are one, with the indices between: a request costs more than those."""
    runs: list[tuple[int, int]] = []
    behind = -1
    for chunk in chunks:
        begin = chunk.chunk_start_offset
        end = begin + chunk.chunk_length
        if begin == behind:
            begin = runs.pop()[0]
        runs.append((begin, end))
        behind = end + chunk.message_index_length
    return runs


def _written(records: Sequence[Any]) -> bytes:
    builder: Any = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())
