"""The one decorator of compiled kernels.

A kernel is a pure module-level function of scalars and arrays. `kernel` compiles it with numba: cached on
disk, IEEE arithmetic (no fastmath), division by zero gives inf or nan as in NumPy. `NUMBA_DISABLE_JIT=1` runs
the same source as plain Python.
"""

from __future__ import annotations

from collections.abc import Callable
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
    return cast("Callable[P, R]", njit(cache=True, error_model="numpy")(function))


def inner_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """A kernel that only kernels call: compiled without the code that takes Python's objects apart.

    For a small one whose arguments are named tuples, that is most of what there is to compile.
    """
    unlisted: Any = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}  # numba knows them, its types do not
    return cast("Callable[P, R]", njit(cache=True, error_model="numpy", **unlisted)(function))


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
