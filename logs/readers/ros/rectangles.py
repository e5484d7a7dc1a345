"""Boxes of outlines: the smallest rectangle around a point set, one side of which lies along an edge of its hull."""

from __future__ import annotations

import numpy as np

from logs.kernel import FloatArray

_ROWS = 2000


def smallest_rectangles(outlines: list[list[tuple[float, float]]]) -> FloatArray:
    """Rows (centre x, y, yaw, length, width) of the smallest rectangles around `n` outlines `(n, 5)`.

    `length >= width`; yaw within a half turn. An outline is a convex polygon of two points or more; for others the
    rectangles along its edges are compared, of which one is near the smallest.
    """
    most = max(map(len, outlines), default=0)
    points = np.array([outline + [outline[-1]] * (most - len(outline)) for outline in outlines]).reshape(-1, most, 2)
    parts = [_rectangles(points[k : k + _ROWS]) for k in range(0, len(points), _ROWS)]
    return np.vstack(parts) if parts else np.empty((0, 5))


def _rectangles(points: FloatArray) -> FloatArray:
    middle = points.mean(axis=1, keepdims=True)
    around = points - middle
    edges = np.roll(around, -1, axis=1) - around
    angle = np.arctan2(edges[..., 1], edges[..., 0])
    cos, sin = np.cos(angle)[..., None], np.sin(angle)[..., None]
    along = cos * around[:, None, :, 0] + sin * around[:, None, :, 1]
    across = cos * around[:, None, :, 1] - sin * around[:, None, :, 0]
    low = np.stack([along.min(axis=2), across.min(axis=2)], axis=-1)
    high = np.stack([along.max(axis=2), across.max(axis=2)], axis=-1)
    size = high - low
    rows = np.arange(len(points))
    best = np.argmin(size[..., 0] * size[..., 1] + 1e-9 * size.sum(axis=-1), axis=1)
    size, centre, yaw = size[rows, best], 0.5 * (low + high)[rows, best], angle[rows, best]
    c, s = np.cos(yaw), np.sin(yaw)
    x = middle[:, 0, 0] + c * centre[:, 0] - s * centre[:, 1]
    y = middle[:, 0, 1] + s * centre[:, 0] + c * centre[:, 1]
    wide = size[:, 1] > size[:, 0]
    yaw = yaw + np.where(wide, 0.5 * np.pi, 0.0)
    return np.column_stack([x, y, yaw, size.max(axis=1), size.min(axis=1)])
