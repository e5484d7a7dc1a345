"""The decorators of compiled kernels.

A kernel is a pure module-level function of scalars and arrays. `kernel` compiles it with numba: cached on disk
(`logs.kernel_cache`), IEEE arithmetic (no fastmath), division by zero gives inf or nan as in NumPy.
`NUMBA_DISABLE_JIT=1` runs the same source as plain Python.
"""

from __future__ import annotations

import gc
import multiprocessing
import sys
from collections.abc import Callable
from functools import cache
from typing import Any, ParamSpec, TypeVar, cast

import numba
from numba import njit
from numba.core import codegen, event

from logs.kernel_cache import KernelIndex
from logs.kernel_compiler import compile_less

PORTABLE = "x86-64-v3"
"""The target processor of kernels if the machine supports it and the user chose none (`NUMBA_CPU_NAME`).

Intel since Haswell (2013) and AMD since Excavator (2015) support it. Machine code for it can be shipped and gives the
same results on all of them.
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
compile_less()

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
    """Compile, and cache the machine code on disk if possible; `unlisted`: options that numba's type stubs lack."""
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
            "note: compiled kernels cannot be kept (no folder for them can be written, or the disk is full): each"
            " process compiles them anew, which takes about a minute; set NUMBA_CACHE_DIR to a folder with room\n"
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
