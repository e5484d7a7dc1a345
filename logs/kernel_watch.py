"""What this process knows of the kernels' machine code: how much is on disk, how much was compiled, and where it is."""

from __future__ import annotations

import os
from itertools import islice
from math import ceil
from pathlib import Path
from typing import Any

from logs.kernel import STORED

COLD = 0.1
"""Share of the imported kernels below which the cache counts as cold; the smallest runs need more."""


def _is_stored(kernel: Any) -> bool:
    """Return whether machine code of a kernel for this processor is on disk."""
    return bool(kernel._cache._cache_file.holds(kernel.targetctx.codegen().magic_tuple()))


def is_cache_cold() -> bool:
    """Return whether the disk holds so little machine code that a run begins with compiling."""
    enough = ceil(COLD * len(STORED))
    return sum(1 for _ in islice(filter(_is_stored, STORED), enough)) < enough


class KernelWatch:
    """Counts the imported kernels that are on disk, as this and other processes compile them.

    Attributes:
        known: The number of imported kernels; a run needs a part of them.
    """

    def __init__(self) -> None:
        self.known, self._missing = 0, list[Any]()
        self.look()

    @property
    def stored(self) -> int:
        """The number of those whose machine code was on disk at the last look."""
        return self.known - len(self._missing)

    def look(self) -> int:
        """Count again, and return how many of the kernels that were missing have been compiled since the last look."""
        before, self.known = self.known, len(STORED)
        left = [each for each in self._missing if not _is_stored(each)]
        compiled = len(self._missing) - len(left)
        self._missing = left + [each for each in STORED[before : self.known] if not _is_stored(each)]
        return compiled


def compiled_count() -> int:
    """Return the number of compilations in this process: one per kernel and argument types."""
    return sum(sum(compiled.stats.cache_misses.values()) for compiled in STORED)


def cache_folder() -> Path | None:
    """Return the folder with the machine code of all imported kernels; None if it is not stored."""
    return Path(os.path.commonpath([compiled.stats.cache_path for compiled in STORED])) if STORED else None
