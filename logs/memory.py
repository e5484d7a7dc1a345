"""Memory that is free goes back to the system.

The C library keeps what a stage freed, in pieces between what is still held, and Arrow keeps a pool: of a drive of an
hour that is 100 to 200 MB, on top of which the next stage takes its own.
"""

from __future__ import annotations

import ctypes
from functools import cache

import pyarrow as pa


def give_back() -> None:
    """Give it back, where the system can (glibc)."""
    pa.default_memory_pool().release_unused()
    trim = _trim()
    if trim is not None:
        trim(0)


@cache
def _trim() -> ctypes._NamedFuncPointer | None:
    try:
        return ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):
        return None
