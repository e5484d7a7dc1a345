"""The one decorator of compiled kernels.

A kernel is a pure module-level function of scalars and arrays. `kernel` compiles it with numba: cached on
disk, IEEE arithmetic (no fastmath), division by zero gives inf or nan as in NumPy. `NUMBA_DISABLE_JIT=1` runs
the same source as plain Python.
"""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Callable
from functools import cache
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.floating[Any]]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

TIE = 1e-6
"""Lengths (m), times (s), angles, ratios and costs that differ by less are equal where something is decided.

Far above rounding and far below what anybody measures. Round figures are common in maps and scenarios, so decisions
must not have their edges on them: comparisons lean by this to the side that their code states.
"""

P = ParamSpec("P")
R = TypeVar("R")


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
        store.save_overload = _forgiving(store.save_overload)
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
