"""Free memory goes back to the system.

The C library keeps what a stage of a run freed, in pieces between what is still in use, and Arrow keeps a pool. For a
drive of an hour that is 100 to 200 MB, to which the next stage adds its own.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import pyarrow as pa


def trim_memory() -> None:
    """Return free memory to the system, where the system can take it (glibc)."""
    pa.default_memory_pool().release_unused()
    trim = _malloc_trim()
    if trim is not None:
        trim(0)


@cache
def _malloc_trim() -> Any:
    try:
        return ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):
        return None
