"""The one decorator of compiled kernels.

A kernel is a pure module-level function of scalars and arrays. `kernel` compiles it with numba: cached on
disk, IEEE arithmetic (no fastmath), division by zero gives inf or nan as in NumPy. `NUMBA_DISABLE_JIT=1` runs
the same source as plain Python.

Where the machine code is: `NUMBA_CACHE_DIR`, else `__pycache__` beside the sources, else the user's cache folder; and a
wheel may bring some, in `__pycache__` (`./dev wheel`). It belongs to a kernel's code and all that goes into it
(`logs.kernel_stamp`), the line where it begins, versions of Python and numba, and a processor (`PORTABLE`).
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba
import numpy as np
from numba import njit
from numba.core import caching, codegen, event
from numpy.typing import NDArray

from logs.kernel_stamp import KernelIndex

FloatArray = NDArray[np.floating[Any]]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Points = np.ndarray[tuple[int, int], np.dtype[np.floating[Any]]]
"""Points `(n, 2)`: x and y in each row."""

TIE = 1e-6
"""Lengths (m), times (s), angles, ratios and costs that differ by less are equal where something is decided.

Far above rounding and far below what anybody measures. Round figures are common in maps and scenarios, so decisions
must not have their edges on them: comparisons lean by this to the side that their code states.
"""

PORTABLE = "x86-64-v3"
"""The processor that kernels are compiled for where the machine has it and the user chose none (`NUMBA_CPU_NAME`).

Intel since Haswell (2013), AMD since Excavator (2015). Their machine code may be shipped, and is the same on each.
"""
PORTABLE_HAS = frozenset({"+avx2", "+bmi", "+bmi2", "+f16c", "+fma", "+lzcnt", "+movbe", "+xsave"})
"""What it has beyond x86-64-v2, in LLVM's words (x86-64 psABI 1.0, table 3.1)."""

P = ParamSpec("P")
R = TypeVar("R")

_STORED: list[Any] = []
"""Numba's dispatchers of all kernels that are imported and have a place on disk."""


def _choose_processor() -> None:
    """`PORTABLE`, where it may be."""
    chosen = cast("Any", numba.config)
    if chosen.CPU_NAME is None and chosen.CPU_FEATURES is None:
        has = codegen.get_host_cpu_features().split(",")  # type: ignore[no-untyped-call]
        if PORTABLE_HAS.issubset(has):
            chosen.CPU_NAME, chosen.CPU_FEATURES = PORTABLE, ""


_choose_processor()


class _Brought(caching.InTreeCacheLocator):
    """Beside the source, to be read: the last of all places, where none can be written and a wheel brought kernels."""

    def ensure_cache_path(self) -> None:
        if next(Path(self.get_cache_path()).glob("*.nbi"), None) is None:  # type: ignore[no-untyped-call]
            raise FileNotFoundError


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` when it is first called; types as in its annotations."""
    return _compiled(function)


def inner_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """A kernel that only kernels call: compiled without the code that takes Python's objects apart.

    For a small one whose arguments are named tuples, that is most of what there is to compile.
    """
    return _compiled(function, no_cpython_wrapper=True, no_cfunc_wrapper=True)


def _compiled(function: Callable[P, R], **unlisted: Any) -> Callable[P, R]:
    """With its machine code on disk where it can be kept; `unlisted`: numba knows them, its types do not."""
    options: Any = {"error_model": "numpy", **unlisted}
    try:
        compiled = njit(cache=True, **options)(function)
    except RuntimeError:  # no folder for it that can be written
        say_not_kept()
        return cast("Callable[P, R]", njit(**options)(function))
    store = getattr(compiled, "_cache", None)  # not there with NUMBA_DISABLE_JIT
    if store is not None:
        store._cache_file = KernelIndex(compiled)
        store.save_overload = _forgiving(store.save_overload)
        _STORED.append(compiled)
    return cast("Callable[P, R]", compiled)


def _forgiving(save: Callable[..., None]) -> Callable[..., None]:
    """Keeps machine code where it can: a full disk costs another compilation, and not the drive."""

    def saved(*arguments: Any) -> None:
        try:
            save(*arguments)
        except OSError:
            say_not_kept()

    return saved


@cache
def say_not_kept() -> None:
    """Say once, and not in workers, that kernels are compiled anew in each process."""
    if multiprocessing.parent_process() is None:
        sys.stderr.write(
            "note: compiled kernels cannot be kept (no folder for them can be written, or the disk is full): each"
            " process compiles them anew, which takes about a minute; set NUMBA_CACHE_DIR to a folder with room\n"
        )


class _Uncollected(event.Listener):
    """No garbage is collected while a kernel is compiled: looking for it took 8 to 18 % of the time."""

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


cast("Any", event).register("numba:compile", _Uncollected())


@cache
def _usable(folder: str) -> None:
    """Make sure of a folder for machine code; OSError if it is of no use.

    It must be one that can be written, but for a `NUMBA_CACHE_DIR` with kernels: of that, reading is enough (an image
    whose file system is read-only).
    """
    chosen = cast("Any", numba.config).CACHE_DIR
    if chosen and Path(folder).is_relative_to(chosen) and next(Path(folder).glob("*.nbi"), None) is not None:
        return
    Path(folder).mkdir(parents=True, exist_ok=True)
    tempfile.TemporaryFile(dir=folder).close()


cast("Any", caching)._CacheLocator.ensure_cache_path = lambda self: _usable(self.get_cache_path())
"""As numba has it, but once a folder and not once a kernel."""
cast("Any", caching).CacheImpl._locator_classes.append(_Brought)


def cold() -> bool:
    """Whether the disk has no machine code for this processor of any kernel that is imported."""
    return bool(_STORED) and not any(
        each._cache._cache_file.holds(each.targetctx.codegen().magic_tuple()) for each in _STORED
    )


def compiled_here() -> int:
    """How many kernels this process compiled, one that was compiled for two kinds of arguments as two."""
    return sum(sum(compiled.stats.cache_misses.values()) for compiled in _STORED)


def cache_folder() -> Path | None:
    """The folder with all machine code of the kernels that are imported; None: it is not kept."""
    return Path(os.path.commonpath([compiled.stats.cache_path for compiled in _STORED])) if _STORED else None


@inner_kernel
def interpolated(x: float, xp: FloatArray, fp: FloatArray) -> float:
    """`np.interp` of one number, to the bit: `fp` `(n,)` over increasing `xp`, the ends held outside."""
    last = len(xp) - 1
    if x >= xp[last]:
        return fp[last]
    if x < xp[0]:
        return fp[0]
    k = np.searchsorted(xp, x, side="right") - 1
    return (fp[k + 1] - fp[k]) / (xp[k + 1] - xp[k]) * (x - xp[k]) + fp[k]


def frozen(values: object, dtype: Any = np.float64) -> NDArray[Any]:
    """A contiguous array of `values` over an immutable buffer (bytes): a private copy unless it is one already.

    `flags.writeable` of such an array cannot be set again, so that what is handed to a planner stays as it is.
    """
    array: NDArray[Any] = np.ascontiguousarray(values, dtype=dtype)
    if not _immutable(array):
        array = np.frombuffer(array.tobytes(), array.dtype).reshape(array.shape)
    return array


def _immutable(array: NDArray[Any]) -> bool:
    """Whether the memory of an array belongs to a bytes object."""
    base: object = array
    while isinstance(base, np.ndarray):
        base = base.base
    return isinstance(base, bytes)
