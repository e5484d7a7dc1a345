"""Fewer points for the same picture: lines without points that do not move them, and without the
parts outside of a plot area.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray

# The largest distance of a simplified line from the exact one: less than half a pixel is invisible
KEPT_PX = 0.4
# Outlines and lines are cut this far outside of a plot area, so that their cut edges are not seen
AROUND_PX = 12.0


def runs(mask: BoolArray) -> Iterator[tuple[int, int]]:
    """First index and end of each run of true values of a mask `(n,)`."""
    steps = np.diff(np.r_[False, mask, False].astype(np.int64))
    return zip(np.flatnonzero(steps > 0).tolist(), np.flatnonzero(steps < 0).tolist(), strict=True)


def simplified(points: FloatArray) -> IntArray:
    """Which points of a line `(n, 2)` draw it within `KEPT_PX` (Douglas and Peucker 1973).

    All pieces of a level are split at once, each at its farthest point from the chord between its
    ends, the first of several, until no point is farther than `KEPT_PX`.
    """
    ends = np.array([0, len(points) - 1] if len(points) > 1 else [0])
    levels, begin, end = [ends], ends[:-1], ends[1:]
    while True:
        has_inner = end - begin > 1
        begin, end = begin[has_inner], end[has_inner]
        if not len(begin):
            return np.sort(np.concatenate(levels))
        # The inner points of all pieces, one after the other: the piece and the index of each
        count = end - begin - 1
        first_row = np.cumsum(count) - count
        piece = np.repeat(np.arange(len(begin)), count)
        index = np.arange(len(piece)) + (begin + 1 - first_row)[piece]
        origin = points[begin][piece]
        from_begin, chord = points[index] - origin, points[end][piece] - origin
        length = np.hypot(chord[:, 0], chord[:, 1])
        across = np.abs(chord[:, 0] * from_begin[:, 1] - chord[:, 1] * from_begin[:, 0])
        distance = np.hypot(from_begin[:, 0], from_begin[:, 1])  # where begin and end coincide
        np.divide(across, length, out=distance, where=length > 0.0)
        farthest = np.maximum.reduceat(distance, first_row)
        farthest_rows = np.flatnonzero(distance == farthest[piece])
        split = index[farthest_rows[np.searchsorted(farthest_rows, first_row)]]
        is_split = farthest > KEPT_PX
        levels.append(split[is_split])
        begin, end = (
            np.r_[begin[is_split], split[is_split]],
            np.r_[split[is_split], end[is_split]],
        )


def cut_line(points: FloatArray, width: float, height: float) -> list[FloatArray]:
    """The parts of a line `(n, 2)` whose segments come near a plot area."""
    low, high = np.minimum(points[:-1], points[1:]), np.maximum(points[:-1], points[1:])
    farthest = width + AROUND_PX, height + AROUND_PX
    near = (high >= -AROUND_PX) & (low <= farthest)
    return [points[begin : end + 1] for begin, end in runs(near[:, 0] & near[:, 1])]


def cut_outline(points: FloatArray, width: float, height: float) -> FloatArray:
    """An outline `(n, 2)` cut at a plot area and a little around it, side by side (Sutherland and
    Hodgman 1974).
    """
    for axis, size in enumerate((width, height)):
        points = _cut_side(points, points[:, axis] + AROUND_PX)
        points = _cut_side(points, size + AROUND_PX - points[:, axis])
    return points


def _cut_side(points: FloatArray, depth: FloatArray) -> FloatArray:
    """The part of an outline `(n, 2)` at one side of a line; `depth`: how far each point is inside,
    negative beyond the line.
    """
    inside = depth >= 0.0
    if inside.all():
        return points
    after, depth_after = np.roll(points, -1, axis=0), np.roll(depth, -1)
    crosses = inside != (depth_after >= 0.0)
    share = np.divide(depth, depth - depth_after, out=np.zeros(len(points)), where=crosses)
    crossings = points + share[:, None] * (after - points)
    both = np.stack([points, crossings], axis=1).reshape(-1, 2)
    return both[np.column_stack([inside, crosses]).ravel()]
