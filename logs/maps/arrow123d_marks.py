"""The markings of lanes in a 123D map.

If the road lines are the boundaries of the lanes themselves, as in Argoverse 2, a boundary has the
type of its line; else the type of the road lines within `MARK_M` of it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.arrow_tables import array_of
from replan.logs.maps.arrow123d_objects import ROAD_LINE, MapObject, MapObjects, is_near
from replan.logs.maps.strips import LARGEST_M, LONGEST_M, dense

MARKS = (
    "NONE",
    "UNKNOWN",
    "DASH_SOLID_YELLOW",
    "DASH_SOLID_WHITE",
    "DASHED_WHITE",
    "DASHED_YELLOW",
    "DOUBLE_SOLID_YELLOW",
    "DOUBLE_SOLID_WHITE",
    "DOUBLE_DASH_YELLOW",
    "DOUBLE_DASH_WHITE",
    "SOLID_YELLOW",
    "SOLID_WHITE",
    "SOLID_DASH_WHITE",
    "SOLID_DASH_YELLOW",
    "SOLID_BLUE",
)
"""Types of road lines; the index is their number."""
MARK_M = 0.35  # Largest distance of a boundary from the road lines that mark it, m
STEP_M = 0.5  # Distance of the points at which boundaries and road lines are compared, m
Side = tuple[int, str]
"""The boundary of a lane: its id, and "left" or "right"."""


def marks_of(
    objects: MapObjects, lanes: Sequence[MapObject], places: FloatArray | None, notes: list[str]
) -> Mapping[Side, str]:
    """Return the marking by lane and side: that of the boundary's own line, else the commonest
    along most of it.
    """
    lines = _road_lines(objects, places)
    if not lines:
        notes.append(
            "The map has no road lines: all markings are taken as such that may be crossed."
        )
        return {}
    edges = {
        (lane.id, side): np.ascontiguousarray(array_of(lane.features[f"{side}_boundary"])[:, :2])
        for lane in lanes
        for side in ("left", "right")
    }
    own: dict[bytes, int] = {}
    for line, kind in lines:
        key = line.tobytes()
        own[key] = max(own.get(key, 0), kind)
    known = {side: edge.tobytes() for side, edge in edges.items() if edge.tobytes() in own}
    if len({*known.values()}) >= 0.5 * len(own):
        return {side: MARKS[own[key]] for side, key in known.items()}
    notes.append(
        f"Lanes have the markings of the map's road lines within {MARK_M} m of their edges."
    )
    return _nearest_marks(lines, edges)


def _nearest_marks(
    lines: Sequence[tuple[FloatArray, int]], edges: Mapping[Side, FloatArray]
) -> dict[Side, str]:
    """Return the commonest type of the lines near each edge, if they are near most of it."""
    from scipy.spatial import cKDTree

    close = [(dense(line, STEP_M), kind) for line, kind in lines]
    tree = cKDTree(np.vstack([line for line, _ in close]))
    kinds = np.concatenate([np.full(len(line), kind) for line, kind in close])
    marks = {}
    for side, edge in edges.items():
        if not _is_line(edge):
            continue
        points = dense(edge, STEP_M)
        away, nearest = tree.query(points, distance_upper_bound=MARK_M)
        beside = kinds[np.asarray(nearest)[np.isfinite(away)]]
        if 2 * len(beside) >= len(points):
            ((kind, _),) = Counter(beside.tolist()).most_common(1)
            marks[side] = MARKS[kind]
    return marks


def _road_lines(objects: MapObjects, places: FloatArray | None) -> list[tuple[FloatArray, int]]:
    """Return the valid road lines near places, each with its type."""
    lines = [
        (line_of_wkb(item.geometry), int(item.features.get("road_line_type") or 0))
        for item in objects.of(ROAD_LINE)
    ]
    return [
        (line, kind)
        for line, kind in lines
        if _is_line(line) and 0 <= kind < len(MARKS) and is_near(line, places)
    ]


def line_of_wkb(geometry: bytes) -> FloatArray:
    """Return the points `(n, 2)` of a little-endian EWKB line, 2D or 3D."""
    kind, count = (int.from_bytes(geometry[offset : offset + 4], "little") for offset in (1, 5))
    if geometry[:1] != b"\x01" or kind not in (2, 0x80000002):
        raise ValueError(f"a road line has the geometry type {kind:#x}")
    size = 2 if kind == 2 else 3
    return np.frombuffer(geometry, "<f8", count * size, offset=9).reshape(count, size)[:, :2].copy()


def _is_line(points: FloatArray) -> bool:
    if len(points) < 2 or not (np.abs(points) < LARGEST_M).all():
        return False
    return bool(np.hypot(*np.diff(points, axis=0).T).sum() < LONGEST_M)
