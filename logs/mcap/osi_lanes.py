"""The lanes of an OSI ground truth.

The road has the logical lanes if they have both boundaries, else the classic lanes: from their
boundaries, else from their centre line. A lane without boundaries reaches half-way to the listed
adjacent centre line `NEAREST_M` to `FARTHEST_M` beside it, else `HALF_WIDTH_M`. Listed adjacent and
paired lanes are candidates that the geometry must confirm: an adjacent lane lies beside the middle
of this one, a successor begins where this one ends (`MAX_GAP_M`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np

from replan.core.arrays import FloatArray, arc_lengths, foot_on, station_on
from replan.logs.mcap.osi_frames import OsiMap, enum_name
from replan.logs.polylines import paired
from replan.logs.road import Lane

HALF_WIDTH_M = 1.75  # Half the width of a lane with nothing but a centre line, m
MAX_GAP_M = 3.0  # Largest distance from the end of a lane to the begin of its successor, m
# Least distance of the centre lines of adjacent lanes; half of it for lanes with boundaries, m
NEAREST_M = 2.0
FARTHEST_M = 6.0  # Largest distance of the centre lines of adjacent lanes, m
SAME_POINT_M = 1e-6  # Points of a line that are nearer to each other are one, m
NOT_DRIVEN = {"unknown", "other", "sidewalk", "biking", "border", "curb", "median", "parking"}
CROSSABLE = {"TYPE_UNKNOWN", "TYPE_OTHER", "TYPE_NO_LINE", "TYPE_DASHED_LINE", "TYPE_BOTTS_DOTS"}


def lanes_of(osi: OsiMap, origin: FloatArray, notes: list[str]) -> tuple[dict[int, Lane], bool]:
    """The lanes, `origin` `(2,)` subtracted from all points, and whether traffic drives on the
    right.
    """
    lanes, adjacent = _logical(osi, origin)
    if not lanes:
        lanes, adjacent = _classic(osi, origin, notes)
    return _beside_each_other(lanes, adjacent)


def _points(messages: Iterable[Any], origin: FloatArray) -> FloatArray:
    """The finite points `(n, 2)`, without repetitions."""
    points = np.array([(p.x, p.y) for p in messages], dtype=np.float64).reshape(-1, 2) - origin
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return points
    return points[np.r_[True, np.hypot(*np.diff(points, axis=0).T) > SAME_POINT_M]]


def _logical(osi: OsiMap, origin: FloatArray) -> tuple[dict[int, Lane], dict[int, list[int]]]:
    """Lanes, and the ids that each lists as adjacent."""
    lanes, adjacent = {}, {}
    for key, message in osi.logical_lane.items():
        sides = []
        for ids in (message.left_boundary_id, message.right_boundary_id):
            boundaries = [
                osi.logical_lane_boundary[i.value]
                for i in ids
                if i.value in osi.logical_lane_boundary
            ]
            parts = [_points((p.position for p in b.boundary_line), origin) for b in boundaries]
            sides.append(np.vstack([np.empty((0, 2)), *parts]))
        if min(map(len, sides)) < 2:
            continue
        backward = enum_name(message, "move_direction") == "MOVE_DIRECTION_DECREASING_S"
        if backward:
            sides = [sides[1][::-1], sides[0][::-1]]
        left, right = paired(*sides)
        onward = message.predecessor_lane if backward else message.successor_lane
        kind = enum_name(message, "type").removeprefix("TYPE_").lower()
        successors = tuple(dict.fromkeys(lane.other_lane_id.value for lane in onward))
        lanes[key] = Lane(key, left, right, successors, drivable=kind not in NOT_DRIVEN, kind=kind)
        beside = (*message.left_adjacent_lane, *message.right_adjacent_lane)
        adjacent[key] = [other.other_lane_id.value for other in beside]
    return lanes, adjacent


def _classic(
    osi: OsiMap, origin: FloatArray, notes: list[str]
) -> tuple[dict[int, Lane], dict[int, list[int]]]:
    """Lanes, and the ids that each lists as adjacent."""
    centers = {}
    for key, message in osi.lane.items():
        known = message.classification
        center = _points(known.centerline, origin)
        turned = (
            known.HasField("centerline_is_driving_direction")
            and not known.centerline_is_driving_direction
        )
        if len(center) > 1:  # a line without a stated direction is not reversed
            centers[key] = center[::-1] if turned else center
    bounded = {key: _lane_between_boundaries(key, osi, centers[key], origin) for key in centers}
    lanes = {key: lane or _lane_around_center(key, osi, centers) for key, lane in bounded.items()}
    assumed = sum(lane is None for lane in bounded.values())
    if assumed:
        notes.append(
            f"{assumed} of {len(lanes)} lanes have a centre line only: their edges are assumed "
            f"half-way to the lane beside them, else {HALF_WIDTH_M} m from the centre."
        )
    candidates, adjacent = _paired_lanes(osi), {}
    for key, lane in lanes.items():
        known = osi.lane[key].classification
        beside = (*known.left_adjacent_lane_id, *known.right_adjacent_lane_id)
        adjacent[key] = [other.value for other in beside]
        onward = [
            other
            for other in dict.fromkeys(candidates.get(key, ()))
            if other in lanes and _continues(lane, lanes[other])
        ]
        lanes[key] = replace(lane, successors=tuple(onward))
    if lanes and len(lanes) < len(osi.lane):
        notes.append(
            f"{len(osi.lane) - len(lanes)} of {len(osi.lane)} lanes have no centre line and are "
            "left out."
        )
    return lanes, adjacent


def _paired_lanes(osi: OsiMap) -> dict[int, list[int]]:
    """The lanes that are paired with each lane, as predecessor or successor, by either of them."""
    paired_with: dict[int, list[int]] = {}
    for key, message in osi.lane.items():
        for pair in message.classification.lane_pairing:
            for name in ("successor_lane_id", "antecessor_lane_id"):
                if pair.HasField(name):
                    other = getattr(pair, name).value
                    paired_with.setdefault(key, []).append(other)
                    paired_with.setdefault(other, []).append(key)
    return paired_with


def _continues(lane: Lane, other: Lane) -> bool:
    """Whether the other lane begins where the lane ends, and does not end nearer to there."""
    begin, end = (float(np.hypot(*(other.center[k] - lane.center[-1]))) for k in (0, -1))
    return begin <= MAX_GAP_M and begin < end


def _facts(message: Any) -> dict[str, Any]:
    kind = enum_name(message.classification, "type").removeprefix("TYPE_").lower()
    subtype = ""
    if "subtype" in message.classification.DESCRIPTOR.fields_by_name:
        subtype = enum_name(message.classification, "subtype").removeprefix("SUBTYPE_").lower()
    word = subtype if subtype not in ("", "unknown", "other") else kind
    return {"drivable": kind in ("driving", "intersection"), "kind": word}


def _lane_between_boundaries(
    key: int, osi: OsiMap, center: FloatArray, origin: FloatArray
) -> Lane | None:
    known = osi.lane[key].classification
    lines, crossable = [], []
    for ids in (known.left_lane_boundary_id, known.right_lane_boundary_id):
        boundaries = [osi.lane_boundary[i.value] for i in ids if i.value in osi.lane_boundary]
        pieces = []  # with their station, in driving direction
        for boundary in boundaries:
            piece = _points((point.position for point in boundary.boundary_line), origin)
            if len(piece) > 1:
                first, last = station_on(center, piece[0]), station_on(center, piece[-1])
                pieces.append((min(first, last), piece[::-1] if last < first else piece))
        if not pieces:
            return None
        lines.append(np.vstack([piece for _, piece in sorted(pieces, key=itemgetter(0))]))
        types = {enum_name(boundary.classification, "type") for boundary in boundaries}
        crossable.append(types <= CROSSABLE)
    (left, _), (right, _) = (_lateral_offset(center, line) for line in lines)
    if left < 0.0 < right:  # the boundaries are exchanged
        lines, crossable = lines[::-1], crossable[::-1]
    left_crossable, right_crossable = crossable
    return Lane(
        key,
        *paired(*lines),
        left_crossable=left_crossable,
        right_crossable=right_crossable,
        **_facts(osi.lane[key]),
    )


def _lane_around_center(key: int, osi: OsiMap, centers: dict[int, FloatArray]) -> Lane:
    center, known = centers[key], osi.lane[key].classification
    to_left, to_right = list[float](), list[float]()
    for other in (*known.left_adjacent_lane_id, *known.right_adjacent_lane_id):
        if other.value in centers:
            offset, _ = _lateral_offset(center, centers[other.value])
            if NEAREST_M <= abs(offset) <= FARTHEST_M:
                (to_left if offset > 0.0 else to_right).append(0.5 * abs(offset))
    left = min(to_left or to_right, default=HALF_WIDTH_M)
    right = min(to_right or to_left, default=HALF_WIDTH_M)
    tangent = np.gradient(center, axis=0)
    length = np.maximum(np.hypot(*tangent.T), 1e-9)[:, None]
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]]) / length
    return Lane(key, center + left * normal, center - right * normal, **_facts(osi.lane[key]))


def _lateral_offset(line: FloatArray, other: FloatArray) -> tuple[float, bool]:
    """Lateral offset of `other` at the middle of `line`, positive to the left, and whether it runs
    the same way.

    NaN if the middle does not project onto `other`.
    """
    steps = np.diff(line, axis=0)
    stations = arc_lengths(*line.T)
    half = 0.5 * stations[-1]
    k = min(int(np.searchsorted(stations, half, side="right")) - 1, len(steps) - 1)
    tangent = steps[k] / np.hypot(*steps[k])
    point = line[k] + (half - stations[k]) * tangent
    i, foot = foot_on(other, point)
    away = foot - point
    if abs(away @ tangent) > 0.5:
        return float("nan"), True
    return float(tangent[0] * away[1] - tangent[1] * away[0]), bool(
        (other[i + 1] - other[i]) @ tangent > 0.0
    )


def _beside_each_other(
    lanes: dict[int, Lane], adjacent: dict[int, list[int]]
) -> tuple[dict[int, Lane], bool]:
    """The lanes with their neighbours, and whether traffic drives on the right: opposite lanes are
    mostly left.
    """
    linked, balance = {}, 0
    for key, lane in lanes.items():
        others = [lanes[other] for other in adjacent[key] if other in lanes]
        left, right = (_nearest(lane, others, side) for side in (1.0, -1.0))
        balance += left.is_opposite - right.is_opposite
        linked[key] = replace(
            lane,
            left_neighbour=None if left.is_opposite else left.id,
            right_neighbour=None if right.is_opposite else right.id,
            left_opposite=left.is_opposite,
            right_opposite=right.is_opposite,
        )
    return linked, balance >= 0


class Beside(NamedTuple):
    """The lane beside another one, and whether it leads the opposite way."""

    id: int | None = None
    is_opposite: bool = False


def _nearest(lane: Lane, others: list[Lane], side: float) -> Beside:
    """The nearest of lanes at a side (1: left, -1: right), the last one of equals."""
    nearest, least_m = Beside(), FARTHEST_M
    for other in others:
        offset, is_same_way = _lateral_offset(lane.center, other.center)
        if 0.5 * NEAREST_M <= side * offset <= least_m:
            nearest, least_m = Beside(other.id, not is_same_way), side * offset
    return nearest
