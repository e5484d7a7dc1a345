"""Makes lanes of a map's left and right boundaries, its candidates for neighbours, and its
markings.

Boundaries get the same number of points by relative arc length. A neighbour is in the same
direction only if its centre line runs the same way beside the middle of the lane: maps list
oncoming lanes as neighbours, too. Traffic drives on the left if more lanes have the oncoming lane
on their right than on their left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from replan.core.arrays import FloatArray, arc_lengths, foot_on
from replan.logs.polylines import paired
from replan.logs.road import NO_LINE, Lane

LARGEST_M = 1e7
"""A larger coordinate is not valid: UTM northings end at 1e7."""
SHORTEST_M, LONGEST_M = 0.01, 1e5
"""Limits of the length of a boundary; a shorter or longer line is not used."""
CAR_WIDTH_M = 2.0
"""Cars on two centre lines that come nearer than this would touch."""


@dataclass(frozen=True, eq=False)
class LaneStrip:
    """A lane as stored in a map."""

    id: int
    left: FloatArray  # left boundary `(n, 2)` in driving direction, m; `right` `(k, 2)` likewise
    right: FloatArray
    successors: tuple[int, ...]
    beside: tuple[int | None, int | None]  # ids of the lanes to the left and to the right, or None
    kind: str
    # Names of the left and the right marking ("DASH_SOLID_YELLOW"; "": unknown)
    marks: tuple[str, str] = ("", "")
    drivable: bool = True
    speed_limit: float = float("nan")
    group: int | None = None  # as in `Lane`; `line` likewise
    line: FloatArray = field(default_factory=lambda: NO_LINE)


def lanes_of(strips: Sequence[LaneStrip], notes: list[str]) -> tuple[dict[int, Lane], bool]:
    """Return the lanes by id, and whether traffic drives on the right."""
    lanes: dict[int, Lane] = {}
    for strip in strips:
        sides = []
        for points in (strip.left, strip.right):
            if points.ndim != 2 or len(points) < 2 or not (np.abs(points) < LARGEST_M).all():
                break
            points = points[np.r_[True, np.hypot(*np.diff(points, axis=0).T) > 1e-6]]
            if (
                len(points) < 2
                or not SHORTEST_M < np.hypot(*np.diff(points, axis=0).T).sum() < LONGEST_M
            ):
                break
            sides.append(points)
        if len(sides) < 2:
            continue
        first_side, second_side = paired(sides[0], sides[1])
        moved = np.r_[True, np.hypot(*np.diff(0.5 * (first_side + second_side), axis=0).T) > 1e-3]
        if moved.sum() < 2:
            continue
        lanes[strip.id] = Lane(
            strip.id,
            first_side[moved],
            second_side[moved],
            successors=tuple(i for i in strip.successors if i != strip.id),
            group=strip.group,
            line=strip.line,
            speed_limit=strip.speed_limit if 0.0 < strip.speed_limit < 100.0 else float("nan"),
            drivable=strip.drivable,
            left_crossable=crossable(strip.marks[0], left=True),
            right_crossable=crossable(strip.marks[1], left=False),
            kind=strip.kind,
        )
    if len(lanes) < len(strips):
        notes.append(
            f"{len(strips) - len(lanes)} of {len(strips)} lanes are left out: their boundaries are "
            "no strip."
        )
    by_id, balance = {}, 0
    for strip in strips:
        if strip.id not in lanes:
            continue
        lane = lanes[strip.id]
        left, right = (lanes.get(i) if i is not None else None for i in strip.beside)
        same = [
            lane_beside is not None and _same_way(lane, lane_beside)
            for lane_beside in (left, right)
        ]
        opposite = [
            lane_beside is not None and not is_same
            for lane_beside, is_same in zip((left, right), same, strict=True)
        ]
        balance += opposite[0] - opposite[1]
        by_id[lane.id] = replace(
            lane,
            left_neighbour=left.id if left is not None and same[0] else None,
            right_neighbour=right.id if right is not None and same[1] else None,
            left_opposite=opposite[0],
            right_opposite=opposite[1],
        )
    return by_id, balance >= 0


def crossable(mark: str, *, left: bool) -> bool:
    """Return whether a marking to the left or right may be crossed; for a double line, the near
    line decides.

    Names list the lines from left to right; a missing or unknown line may be crossed.
    """
    lines = [part for part in mark.split("_") if part in ("SOLID", "DASH", "DASHED")]
    return not lines or lines[-1 if left else 0] != "SOLID"


def _same_way(lane: Lane, other: Lane) -> bool:
    """Return whether two lanes have the same direction: the other one at its point nearest to this
    one's middle.
    """
    ahead = lane.center[len(lane.center) // 2] - lane.center[len(lane.center) // 2 - 1]
    middle = 0.5 * (lane.center[len(lane.center) // 2] + lane.center[len(lane.center) // 2 - 1])
    i, _ = foot_on(other.center, middle)
    return bool((other.center[i + 1] - other.center[i]) @ ahead > 0.0)


def dense(line: FloatArray, step: float) -> FloatArray:
    """Resample a polyline `(n, 2)` at equal arc lengths, with points at most `step` m apart."""
    length = arc_lengths(*line.T)[-1]
    return resampled(line, max(2, 1 + int(np.ceil(length / step))))


def resampled(line: FloatArray, count: int) -> FloatArray:
    """Resample a polyline `(n, 2)` at `count` points, equally spaced in arc length."""
    s = arc_lengths(*line.T)
    stations = np.linspace(0.0, s[-1], count)
    return np.column_stack([np.interp(stations, s, line[:, k]) for k in (0, 1)])
