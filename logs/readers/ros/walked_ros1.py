"""ROS 1 bags whose index is missing or damaged, because their recorder was killed or they are cut
off.

Opening such a bag reads its chunks from front to back, and makes the index of them. Of the last
chunk, which a killed recorder leaves without its size, the whole messages are read if it is not
compressed.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from contextlib import ExitStack
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from rosbags.interfaces import Connection
from rosbags.rosbag1.reader import (
    ChunkInfo,
    Header,
    IndexData,
    Reader,
    ReaderError,
    RecordType,
    read_bytes,
    read_uint32,
)

from replan.core.errors import LogError
from replan.logs.mcap.container import COPY_AGAIN
from replan.logs.readers.ros.walked_mcap import describe_end

DECOMPRESSION = (OSError, RuntimeError, ValueError)
"""Exceptions of bz2 and lz4 on data that are cut off or damaged."""


class WalkedBag(Reader):
    """A bag read by its chunks, not by its index; `note` is what is lost at its end."""

    note = ""

    def open(self) -> None:
        """Read all chunks; LogError if one is damaged and others may follow."""
        file = Path(str(self.path))
        with ExitStack() as stack:
            self.bio = stack.enter_context(file.open("rb"))
            self._walk(self.bio, file)
            stack.pop_all()

    def _walk(self, stream: BinaryIO, file: Path) -> None:
        size, begin = file.stat().st_size, len(stream.readline())
        self.indexes = defaultdict(list)
        self._by_id: dict[int, Connection] = {}
        is_whole = True
        while begin < size and is_whole:
            try:
                stream.seek(begin)
                opcode = Header.read(stream).get_uint8("op")
                length = read_uint32(stream)
            except ReaderError:
                break
            end = stream.tell() + length
            is_whole = end <= size
            if opcode == RecordType.CHUNK:
                is_whole = is_whole and length > 0
                begin = self._take(stream, begin, None if is_whole else size)
            elif is_whole:
                begin = end
        self.indexes = {number: sorted(self.indexes[number]) for number in self._by_id}
        self.connections = [
            connection._replace(msgcount=len(self.indexes[number]))
            for number, connection in self._by_id.items()
        ]
        count = sum(map(len, self.indexes.values()))
        self.note = describe_end(file.name, count, len(self.chunks), size - begin)

    def _take(self, stream: BinaryIO, begin: int, end: int | None) -> int:
        """Add the whole messages of a chunk, which lasts up to `end` if its own size is not there:
        the byte after them. LogError if a chunk that is there is damaged.
        """
        stream.seek(begin)
        chunk = self.read_chunk()
        if end is not None:
            chunk = chunk._replace(datasize=end - chunk.datapos)
        stream.seek(chunk.datapos)
        packed = read_bytes(stream, chunk.datasize)
        try:
            inner = BytesIO(chunk.decompressor(packed))
        except DECOMPRESSION:
            inner = BytesIO()
        times, counts, place = list[int](), Counter[int](), 0
        while place < inner.getbuffer().nbytes:
            try:
                header = Header.read(inner)
                if header.get_uint8("op") == RecordType.CONNECTION:
                    inner.seek(place)
                    self.bio = inner
                    connection = self.read_connection()
                    self._by_id.setdefault(connection.id, connection)
                else:
                    read_bytes(inner, read_uint32(inner))
                    number, time = header.get_uint32("conn"), header.get_time("time")
                    self.indexes[number].append(IndexData(time, begin, place))
                    times.append(time)
                    counts[number] += 1
            except ReaderError:
                break
            finally:
                self.bio = stream
            place = inner.tell()
        if times:
            self.chunks[begin] = chunk
            self.chunk_infos.append(ChunkInfo(begin, min(times), max(times) + 1, dict(counts)))
        if end is None and not 0 < place == inner.getbuffer().nbytes:
            problem = f"the file is damaged in the chunk at byte {begin}"
            raise LogError(problem, file=str(self.path), remedy=COPY_AGAIN)
        return chunk.datapos + (len(packed) if end is None else place)
