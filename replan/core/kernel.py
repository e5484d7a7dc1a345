"""The decorators of compiled kernels; how much of their machine code is on disk, was compiled, and
where it is.

A kernel is a pure module-level function of scalars and arrays. `kernel` compiles it with numba:
cached on disk (`replan.core.kernel_cache`), IEEE arithmetic (no fastmath), division by zero
gives inf or nan as in NumPy. `NUMBA_DISABLE_JIT=1` runs the same source as plain Python.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import sys
from collections.abc import Callable
from functools import cache
from itertools import islice
from math import ceil
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba
from numba import njit
from numba.core import codegen, event

from replan.core.kernel_cache import KernelIndex

PORTABLE = "x86-64-v3"
"""The target processor of kernels if the machine supports it and the user chose none
(`NUMBA_CPU_NAME`).

Intel since Haswell (2013) and AMD since Excavator (2015) support it. Machine code for it can be
shipped and gives the same results on all of them.
"""
PORTABLE_HAS = frozenset({"+avx2", "+bmi", "+bmi2", "+f16c", "+fma", "+lzcnt", "+movbe", "+xsave"})
"""Its features beyond x86-64-v2, by LLVM's names (x86-64 psABI 1.0, table 3.1)."""

P = ParamSpec("P")
R = TypeVar("R")

_CONFIG = cast("Any", numba.config)
if (
    _CONFIG.CPU_NAME is None
    and _CONFIG.CPU_FEATURES is None
    and PORTABLE_HAS.issubset(codegen.get_host_cpu_features().split(","))  # type: ignore[no-untyped-call]
):
    _CONFIG.CPU_NAME, _CONFIG.CPU_FEATURES = PORTABLE, ""

STORED: list[Any] = []
"""Numba's dispatchers of all imported kernels that have a cache on disk."""


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` on its first call, for the types of the arguments."""
    return _compile_kernel(function)


def inner_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """A kernel that only kernels call: compiled without the code that unpacks Python objects.

    For a small kernel with named tuples as arguments, that code takes most of the compilation.
    """
    return _compile_kernel(function, no_cpython_wrapper=True, no_cfunc_wrapper=True)


def _compile_kernel(function: Callable[P, R], **unlisted: Any) -> Callable[P, R]:
    """Compile, and cache the machine code on disk if possible; `unlisted`: options that numba's
    type stubs lack.
    """
    options: Any = {"error_model": "numpy", **unlisted}
    try:
        compiled = njit(cache=True, **options)(function)
    except RuntimeError:  # no folder is writable
        warn_not_kept()
        return cast("Callable[P, R]", njit(**options)(function))
    store = getattr(compiled, "_cache", None)  # missing with NUMBA_DISABLE_JIT
    if store is not None:
        store._cache_file, save = KernelIndex(compiled), store.save_overload

        def save_if_possible(*arguments: Any) -> None:
            try:
                save(*arguments)
            except OSError:  # a full disk must not end the drive: the next process compiles again
                warn_not_kept()

        store.save_overload = save_if_possible
        STORED.append(compiled)
    return cast("Callable[P, R]", compiled)


@cache
def warn_not_kept() -> None:
    """Warn once, and not in workers, that each process compiles the kernels again."""
    if multiprocessing.parent_process() is None:
        sys.stderr.write(
            "note: compiled kernels cannot be kept (no folder for them can be written, or the disk "
            "is full): each process compiles them anew, which takes about a minute; set "
            "NUMBA_CACHE_DIR to a folder with room\n"
        )


class _NoCollection(event.Listener):
    """Disables garbage collection while a kernel is compiled: it took 8 to 18 % of the time."""

    def __init__(self) -> None:
        self.depth, self.enabled = 0, False

    def on_start(self, _: Any) -> None:
        if self.depth == 0:
            self.enabled = gc.isenabled()
            gc.disable()
        self.depth += 1

    def on_end(self, _: Any) -> None:
        self.depth -= 1
        if self.depth == 0 and self.enabled:
            gc.enable()


cast("Any", event).register("numba:compile", _NoCollection())


# Machine code on disk

COLD = 0.1
"""Share of the imported kernels below which the cache counts as cold.

The smallest runs need more.
"""


def _is_stored(kernel: Any) -> bool:
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
        """Count again, and return how many of the kernels that were missing have been compiled
        since the last look.
        """
        before, self.known = self.known, len(STORED)
        missing = [kernel for kernel in self._missing if not _is_stored(kernel)]
        compiled = len(self._missing) - len(missing)
        imported = STORED[before : self.known]
        self._missing = missing + [kernel for kernel in imported if not _is_stored(kernel)]
        return compiled


def compiled_count() -> int:
    """Return the number of compilations in this process: one per kernel and argument types."""
    return sum(sum(compiled.stats.cache_misses.values()) for compiled in STORED)


def cache_folder() -> Path | None:
    """Return the folder with the machine code of all imported kernels; None if it is not stored."""
    return (
        Path(os.path.commonpath([compiled.stats.cache_path for compiled in STORED]))
        if STORED
        else None
    )
