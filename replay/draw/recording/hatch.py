"""Filled outlines as strokes: the viewer's 2D views draw lines, not areas.

An outline is cut by vertical lines of equal distance; between two crossings that follow each other the line is inside
(even-odd rule). All outlines of a recording are cut at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.kernel import FloatArray, IntArray


@dataclass(frozen=True)
class Window:
    """The visible part of a plane, in its own units."""

    x: tuple[float, float]
    y: tuple[float, float]


def _edges(points: FloatArray, lengths: IntArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Both ends `(m, 2)` of the edges of closed outlines, and the outline `(m,)` that each belongs to."""
    owner = np.repeat(np.arange(len(lengths)), lengths)
    last = np.cumsum(lengths) - 1
    after = np.arange(len(points)) + 1
    after[last] = last - lengths + 1
    return points, points[after], owner


def strokes(points: FloatArray, lengths: IntArray, window: Window, spacing: float) -> tuple[FloatArray, IntArray]:
    """The vertical strokes that fill closed outlines inside a window.

    Args:
        points: `(m, 2)` corners, outline after outline.
        lengths: `(n,)` corners of each outline, at least 1.
        window: What is visible; strokes lie on its vertical lines and end at its borders.
        spacing: Distance of the lines, in units of x.

    Returns:
        The strokes `(k, 2, 2)` from bottom to top, and the outline `(k,)` of each, sorted by outline, then x, then y.
    """
    start, end, owner = _edges(points, lengths)
    columns = max(1, round((window.x[1] - window.x[0]) / spacing))
    low, high = np.minimum(start[:, 0], end[:, 0]), np.maximum(start[:, 0], end[:, 0])
    first, stop = (
        np.clip(np.ceil((x - window.x[0]) / spacing - 0.5), 0, columns).astype(np.int64) for x in (low, high)
    )
    crossings = np.maximum(stop - first, 0)
    edge = np.repeat(np.arange(len(start)), crossings)
    column = np.arange(len(edge)) - np.repeat(np.cumsum(crossings) - crossings, crossings) + first[edge]
    x = window.x[0] + (column + 0.5) * spacing
    u = (x - start[edge, 0]) / (end[edge, 0] - start[edge, 0])
    y = start[edge, 1] + u * (end[edge, 1] - start[edge, 1])
    order = np.lexsort((y, column, owner[edge]))
    x, y, owner = x[order], np.clip(y[order], *window.y), owner[edge][order]
    pairs = np.stack([np.column_stack([x[0::2], y[0::2]]), np.column_stack([x[1::2], y[1::2]])], axis=1)
    inside = pairs[:, 1, 1] > pairs[:, 0, 1]
    return pairs[inside], owner[0::2][inside]


def outline_segments(points: FloatArray, lengths: IntArray, window: Window) -> tuple[FloatArray, IntArray]:
    """The edges of closed outlines cut to a window (Liang and Barsky, 1984): `(k, 2, 2)`, and the outline of each."""
    start, end, owner = _edges(points, lengths)
    delta = end - start
    enter, leave = np.zeros(len(start)), np.ones(len(start))
    outside = np.zeros(len(start), dtype=bool)
    for axis, (low, high) in ((0, window.x), (1, window.y)):
        moving = np.abs(delta[:, axis]) > 1e-9  # a step too small to divide by stands still
        outside |= ~moving & ((start[:, axis] < low) | (start[:, axis] > high))
        step = np.where(moving, delta[:, axis], 1.0)
        at = np.sort(np.stack([(low - start[:, axis]) / step, (high - start[:, axis]) / step]), axis=0)
        enter = np.where(moving, np.maximum(enter, at[0]), enter)
        leave = np.where(moving, np.minimum(leave, at[1]), leave)
    kept = ~outside & (enter < leave)
    cut = [start[kept] + u[kept, None] * delta[kept] for u in (enter, leave)]
    return np.stack(cut, axis=1), owner[kept]
