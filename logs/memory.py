"""Return free memory to the operating system.

After a stage of a run the C library keeps fragmented free memory, and Arrow keeps a pool. For a drive of an hour that
is 100 to 200 MB, on top of which the next stage allocates its own.
"""

from __future__ import annotations

import ctypes
from contextlib import suppress

import pyarrow as pa


def trim_memory() -> None:
    """Return free memory to the system, where the system can take it (glibc)."""
    pa.default_memory_pool().release_unused()
    with suppress(AttributeError, OSError, TypeError):  # another C library
        ctypes.CDLL(None).malloc_trim(0)
