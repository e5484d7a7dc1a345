"""Types of arrays, read-only arrays, lengths along polylines, and the tolerance of comparisons."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating[Any]]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Points = np.ndarray[tuple[int, int], np.dtype[np.floating[Any]]]
"""Points `(n, 2)`: x and y in each row."""

TIE = 1e-6
"""Decisions treat lengths (m), times (s), angles, ratios and costs that differ by less as equal.

It is far above rounding and far below any measurement. Round figures are common in maps and scenarios, so thresholds
must not lie exactly on them: each comparison is shifted by this, in the direction that its code shows.
"""


def arc_lengths(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the length of a polyline from its first point to each of its points `(n,)`, m."""
    return np.r_[0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y)))]


def frozen(values: object, dtype: Any = np.float64) -> NDArray[Any]:
    """Return a contiguous array of `values` over an immutable buffer (bytes): a copy unless it is such an array.

    `flags.writeable` of such an array cannot be set again, so that a planner cannot change its inputs.
    """
    array: NDArray[Any] = np.ascontiguousarray(values, dtype=dtype)
    owner: object = array
    while isinstance(owner, np.ndarray):
        owner = owner.base
    if not isinstance(owner, bytes):
        array = np.frombuffer(array.tobytes(), array.dtype).reshape(array.shape)
    return array
