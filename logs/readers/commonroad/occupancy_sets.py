"""Covers the occupancy sets of CommonRoad obstacles with boxes.

A set is the area that a road user may occupy at a step: growing polygons, not a pose. Tracks have
boxes of one size, so each set becomes boxes of its own, which stand from its time until that of the
next set (or over its interval). They are objects: replayed by time, never reacting, with no speed.
The initial state is the first set.

A polygon is covered from outside, so that a vehicle that touches the set touches a box:

(1) box = the smallest rectangle along one of the edges
        of the polygon's convex hull (one of these has the least area)
(2) excess = (area of the box - area of the polygon) / length of the box, m:
        how much wider than the polygon it is
(3) where that exceeds `EXCESS_M` and the box is longer than `SHORTEST_M`, the polygon is cut across
    its middle
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.readers.commonroad.document_records import OccupiedSet

EXCESS_M = 0.1
"""A box may be this much wider than the set on average, m."""
SHORTEST_M = 1.0
"""A shorter box is not cut, m."""
DEEPEST = 6
"""A polygon is cut at most this many times: into 64 boxes."""


class Box(NamedTuple):
    """A rectangle: its centre, m, heading, rad, and size, m."""

    x: float
    y: float
    yaw: float
    length: float
    width: float


def covering(outline: FloatArray, cuts: int = DEEPEST) -> Iterator[Box]:
    """Boxes that cover a polygon `(k, 2)` (1) to (3); none for a polygon without an area."""
    box, (x, y) = smallest_box(outline), outline.T
    area = 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
    if not min(box.length, box.width, area) > 1e-6:
        return
    if (
        (box.length * box.width - area) / box.length <= EXCESS_M
        or box.length <= SHORTEST_M
        or not cuts
    ):
        yield box
        return
    along = np.array([np.cos(box.yaw), np.sin(box.yaw)])
    middle = float(along @ (box.x, box.y))
    for half in (1.0, -1.0):  # each half: Sutherland and Hodgman 1974
        side, part = outline @ (half * along) - half * middle, []
        for i in range(len(outline)):
            before, after = side[i - 1], side[i]
            if (before >= 0.0) != (after >= 0.0):
                part.append(
                    outline[i - 1] + (outline[i] - outline[i - 1]) * before / (before - after)
                )
            if after >= 0.0:
                part.append(outline[i])
        if len(part) >= 3:
            yield from covering(np.array(part), cuts - 1)


def standing(sets: Sequence[OccupiedSet]) -> Iterator[tuple[str, float, float, Box]]:
    """Name within its road user, first and last time step, and box of each part of its sets (module
    docstring).
    """
    steps = sorted({occupied.first for occupied in sets})
    usual = steps[-1] - steps[-2] if len(steps) > 1 else 1.0
    until = dict(zip(steps, [*steps[1:], steps[-1] + usual], strict=True))
    for k, occupied in enumerate(sets):
        boxes = [box for outline in occupied.outlines for box in covering(outline)]
        last = occupied.last if occupied.last > occupied.first else until[occupied.first]
        yield from ((f"set {k} part {i}", occupied.first, last, box) for i, box in enumerate(boxes))


def smallest_box(points: FloatArray) -> Box:
    """The smallest rectangle around points `(k, 2)`, k >= 3 (1); its length is the longer side."""
    ordered, chains = np.unique(points, axis=0).tolist(), []
    # The convex hull, counter-clockwise (Andrew's monotone chain)
    for sequence in (ordered, ordered[::-1]):
        chain: list[list[float]] = []
        for x, y in sequence:
            while len(chain) > 1:
                (ax, ay), (bx, by) = chain[-2:]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0.0:
                    break
                chain.pop()
            chain.append([x, y])
        chains.append(chain[:-1])
    hull = np.array(chains[0] + chains[1]).reshape(-1, 2)
    edges = np.diff(np.vstack([hull, hull[:1]]), axis=0)
    best: Box | None = None
    for yaw in np.unique(
        np.round(np.arctan2(edges[:, 1], edges[:, 0]) % (0.5 * np.pi), 12)
    ).tolist():
        axes = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
        low, high = (hull @ axes.T).min(axis=0), (hull @ axes.T).max(axis=0)
        (length, width), (x, y) = (high - low).tolist(), (0.5 * (low + high) @ axes).tolist()
        box = (
            Box(x, y, yaw, length, width)
            if length >= width
            else Box(x, y, yaw + 0.5 * np.pi, width, length)
        )
        if best is None or length * width < best.length * best.width - 1e-9:
            best = box
    assert best is not None
    return best
