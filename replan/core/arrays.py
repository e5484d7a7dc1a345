"""Types of arrays, read-only arrays, columns, lengths and nearest points of polylines, the
tolerance of comparisons.
"""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating[Any]]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Points = np.ndarray[tuple[int, int], np.dtype[np.floating[Any]]]
"""Points `(n, 2)`: x and y in each row."""

TIE = 1e-6
"""Decisions treat lengths (m), times (s), angles, ratios and costs that differ by less as equal.

It is far above rounding and far below any measurement. Round figures are common in maps and
scenarios, so thresholds must not lie exactly on them: each comparison is shifted by this, in the
direction that its code shows.
"""


class Columns:
    """A data class of columns with a row per sample, arrays and lists `(n,)`.

    Its other fields hold for all rows.
    """

    def taken(self, rows: Any) -> Self:
        """Return the rows that an array of indices, or of booleans for arrays only, selects."""
        columns, lists = {}, {}
        for field in fields(self):  # type: ignore[arg-type]
            column = getattr(self, field.name)
            if isinstance(column, np.ndarray):
                columns[field.name] = column[rows]
            elif isinstance(column, list):
                lists[field.name] = [column[i] for i in rows]
        return replace(self, **columns, **lists)  # type: ignore[type-var]


def arc_lengths(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the length of a polyline from its first point to each of its points `(n,)`, m."""
    return np.r_[0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y)))]


def foot_on(line: FloatArray, point: FloatArray) -> tuple[int, FloatArray]:
    """Return the segment of a polyline `(n, 2)` that is nearest to a point `(2,)`, and the nearest
    point on it.
    """
    steps = np.diff(line, axis=0)
    squares = np.maximum(np.einsum("ij,ij->i", steps, steps), 1e-18)
    along = np.clip(np.einsum("ij,ij->i", point - line[:-1], steps) / squares, 0.0, 1.0)
    feet = line[:-1] + along[:, None] * steps
    i = int(np.argmin(np.hypot(*(feet - point).T)))
    return i, feet[i]


def station_on(line: FloatArray, point: FloatArray) -> float:
    """Return the length of a polyline `(n, 2)` up to its point that is nearest to a point `(2,)`,
    m.
    """
    i, foot = foot_on(line, point)
    return float(np.hypot(*np.diff(line[: i + 1], axis=0).T).sum() + np.hypot(*(foot - line[i])))


def frozen(values: object, dtype: Any = np.float64) -> NDArray[Any]:
    """Return a contiguous array of `values` over an immutable buffer (bytes): a copy unless it is
    such an array.

    `flags.writeable` of such an array cannot be set again, so that a planner cannot change its
    inputs.
    """
    array: NDArray[Any] = np.ascontiguousarray(values, dtype=dtype)
    owner: object = array
    while isinstance(owner, np.ndarray):
        owner = owner.base
    if not isinstance(owner, bytes):
        array = np.frombuffer(array.tobytes(), array.dtype).reshape(array.shape)
    return array
