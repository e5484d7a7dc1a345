"""Limits the memory of a process: an unnamed file for data that are rarely read, and the return of
free memory.

After a stage of a run, the C library keeps fragmented free memory, and Arrow keeps a pool. For a
drive of an hour both take 100 to 200 MB, in addition to the memory of the next stage.
"""

from __future__ import annotations

import ctypes
import tempfile
import weakref
from contextlib import suppress
from typing import IO


def _closed(file: IO[bytes]) -> None:
    with suppress(OSError):  # the disk is full, and the content is no longer needed
        file.close()


class Scratch:
    """An unnamed temporary file, removed together with this object."""

    def __init__(self) -> None:
        self._file: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  `close` removes it
        self.close = weakref.finalize(self, _closed, self._file)
        self._end, self._reads = 0, False

    def put(self, data: bytes) -> int:
        """Append data and return their offset; OSError where the disk is full."""
        begin = self._end
        if self._reads:
            self._file.seek(begin)
        self._file.write(data)
        self._file.flush()  # a full disk raises here, not when the data are read
        self._end, self._reads = begin + len(data), False
        return begin

    def get(self, begin: int, size: int) -> bytes:
        """Return `size` bytes from the offset `begin`."""
        self._file.seek(begin)
        self._reads = True
        return self._file.read(size)


def trim_memory() -> None:
    """Return free memory to the system, where the system can take it (glibc)."""
    import pyarrow as pa  # imported late: reading a trace does not need Arrow

    pa.default_memory_pool().release_unused()
    with suppress(AttributeError, OSError, TypeError):  # another C library
        ctypes.CDLL(None).malloc_trim(0)
