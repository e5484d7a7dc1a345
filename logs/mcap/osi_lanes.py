"""Lanes of ASAM OSI ground truth -> Road.

Logical lanes are taken where they have both boundaries, else the classic lanes: from their boundaries, else from their
centre line. A lane without boundaries reaches half-way to the listed adjacent centre line 2 to 6 m beside it, else
`HALF_WIDTH`. Lists of adjacent and paired lanes are taken as candidates and held against the geometry: an adjacent lane
lies beside the middle of this one, a successor begins where this one ends (`MAX_GAP`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from logs.kernel import FloatArray
from logs.road import Lane

HALF_WIDTH = 1.75
MAX_GAP = 3.0
BESIDE = (2.0, 6.0)
NOT_DRIVEN = {"unknown", "other", "sidewalk", "biking", "border", "curb", "median", "parking"}
CROSSABLE = {"TYPE_UNKNOWN", "TYPE_OTHER", "TYPE_NO_LINE", "TYPE_DASHED_LINE", "TYPE_BOTTS_DOTS"}


def enum_name(message: Any, name: str) -> str:
    """The name of an enum field's value, as in the file's own descriptor."""
    kind = message.DESCRIPTOR.fields_by_name[name].enum_type
    value = kind.values_by_number.get(getattr(message, name))
    return value.name if value is not None else ""


@dataclass
class OsiMap:
    """Messages by id, from all frames; the first of an id counts."""

    lanes: dict[int, Any] = field(default_factory=dict)
    boundaries: dict[int, Any] = field(default_factory=dict)
    logical_lanes: dict[int, Any] = field(default_factory=dict)
    logical_boundaries: dict[int, Any] = field(default_factory=dict)

    def add(self, truth: Any) -> None:
        """Add the road of a ground truth; older descriptors lack the logical lanes."""
        for known, name in (
            (self.lanes, "lane"), (self.boundaries, "lane_boundary"), (self.logical_lanes, "logical_lane"),
            (self.logical_boundaries, "logical_lane_boundary"),
        ):  # fmt: skip
            for message in getattr(truth, name, ()):
                known.setdefault(message.id.value, message)


def lanes_of(osi: OsiMap, origin: FloatArray, notes: list[str]) -> tuple[dict[int, Lane], bool]:
    """The lanes, relative to `origin`, and whether one drives on the right; no lanes where none can be used."""
    lanes, adjacent = _logical(osi, origin)
    if not lanes:
        lanes, adjacent = _classic(osi, origin, notes)
        unused = len(osi.lanes) - len(lanes)
        if lanes and unused:
            notes.append(f"{unused} of {len(osi.lanes)} lanes have no centre line and are left out.")
    return _beside_each_other(lanes, adjacent)


def _points(messages: Iterable[Any], origin: FloatArray) -> FloatArray:
    """Points `(n, 2)` without repetitions; the finite ones."""
    points = np.array([(p.x, p.y) for p in messages], dtype=np.float64).reshape(-1, 2) - origin
    points = points[np.isfinite(points).all(axis=1)]
    return points[np.r_[True, np.hypot(*np.diff(points, axis=0).T) > 1e-6]] if len(points) else points


def paired(left: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Both lines at the union of their relative arc lengths, so that no corner is lost and point faces point."""
    ways = [np.r_[0.0, np.cumsum(np.hypot(*np.diff(line, axis=0).T))] for line in (left, right)]
    parts = [way / way[-1] for way in ways]
    both = np.union1d(np.round(parts[0], 9), np.round(parts[1], 9))
    out = [
        np.column_stack([np.interp(both, part, line[:, i]) for i in (0, 1)])
        for part, line in zip(parts, (left, right), strict=True)
    ]
    return out[0], out[1]


# Logical lanes


def _logical(osi: OsiMap, origin: FloatArray) -> tuple[dict[int, Lane], dict[int, list[int]]]:
    """Lanes, and the ids that each lists as adjacent."""
    lanes, adjacent = {}, {}
    for key, message in osi.logical_lanes.items():
        sides = []
        for ids in (message.left_boundary_id, message.right_boundary_id):
            found = [osi.logical_boundaries[i.value] for i in ids if i.value in osi.logical_boundaries]
            parts = [_points((p.position for p in b.boundary_line), origin) for b in found]
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


# Classic lanes


def _classic(osi: OsiMap, origin: FloatArray, notes: list[str]) -> tuple[dict[int, Lane], dict[int, list[int]]]:
    """Lanes, and the ids that each lists as adjacent."""
    centers = {}
    for key, message in osi.lanes.items():
        known = message.classification
        center = _points(known.centerline, origin)
        turned = known.HasField("centerline_is_driving_direction") and not known.centerline_is_driving_direction
        if len(center) > 1:  # a line whose direction is not given stays as it is
            centers[key] = center[::-1] if turned else center
    lanes, assumed = {}, 0
    for key, center in centers.items():
        lane = _bounded(key, osi, center, origin)
        if lane is None:
            lane, assumed = _widened(key, osi, centers), assumed + 1
        lanes[key] = lane
    if assumed:
        notes.append(
            f"{assumed} of {len(lanes)} lanes have a centre line only: their edges are assumed half-way to the lane"
            f" beside them, else {HALF_WIDTH} m from the centre."
        )
    pairs, adjacent = _pairings(osi), {}
    for key, lane in lanes.items():
        known = osi.lanes[key].classification
        adjacent[key] = [i.value for i in (*known.left_adjacent_lane_id, *known.right_adjacent_lane_id)]
        onward = tuple(i for i in pairs.get(key, ()) if i in lanes and _goes_on(lane, lanes[i]))
        lanes[key] = replace(lane, successors=onward)
    return lanes, adjacent


def _facts(message: Any) -> dict[str, Any]:
    kind = enum_name(message.classification, "type").removeprefix("TYPE_").lower()
    subtype = ""
    if "subtype" in message.classification.DESCRIPTOR.fields_by_name:
        subtype = enum_name(message.classification, "subtype").removeprefix("SUBTYPE_").lower()
    word = subtype if subtype not in ("", "unknown", "other") else kind
    return {"drivable": kind in ("driving", "intersection"), "kind": word}


def _bounded(key: int, osi: OsiMap, center: FloatArray, origin: FloatArray) -> Lane | None:
    """The lane between its boundaries, or None where one is missing."""
    known = osi.lanes[key].classification
    lines, crossable = [], []
    for ids in (known.left_lane_boundary_id, known.right_lane_boundary_id):
        found = [osi.boundaries[i.value] for i in ids if i.value in osi.boundaries]
        line = _along([_points((p.position for p in b.boundary_line), origin) for b in found], center)
        if len(line) < 2:
            return None
        lines.append(line)
        crossable.append(all(enum_name(b.classification, "type") in CROSSABLE for b in found))
    if _beside(center, lines[0])[0] < 0.0 < _beside(center, lines[1])[0]:
        lines, crossable = lines[::-1], crossable[::-1]
    left, right = paired(*lines)
    return Lane(key, left, right, left_crossable=crossable[0], right_crossable=crossable[1], **_facts(osi.lanes[key]))


def _along(parts: list[FloatArray], center: FloatArray) -> FloatArray:
    """Boundary pieces in driving direction, one after the other."""
    placed = []
    for part in (part for part in parts if len(part) > 1):
        first, last = _station(part[0], center), _station(part[-1], center)
        placed.append((min(first, last), part[::-1] if last < first else part))
    ordered = [part for _, part in sorted(placed, key=lambda item: item[0])]
    return np.vstack(ordered) if ordered else np.empty((0, 2))


def _widened(key: int, osi: OsiMap, centers: dict[int, FloatArray]) -> Lane:
    """The lane around its centre line."""
    center, known = centers[key], osi.lanes[key].classification
    near: dict[bool, list[float]] = {True: [], False: []}
    for ids in (known.left_adjacent_lane_id, known.right_adjacent_lane_id):
        for other in (centers[i.value] for i in ids if i.value in centers):
            offset, _ = _beside(center, other)
            if BESIDE[0] <= abs(offset) <= BESIDE[1]:
                near[offset > 0.0].append(0.5 * abs(offset))
    half = [min(near[side], default=min(near[not side], default=HALF_WIDTH)) for side in (True, False)]
    tangent = np.gradient(center, axis=0)
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]]) / np.maximum(np.hypot(*tangent.T), 1e-9)[:, None]
    return Lane(key, center + half[0] * normal, center - half[1] * normal, **_facts(osi.lanes[key]))


def _pairings(osi: OsiMap) -> dict[int, list[int]]:
    """Per lane, the lanes that any pairing names together with it."""
    out: dict[int, list[int]] = {}
    for key, message in osi.lanes.items():
        for pair in message.classification.lane_pairing:
            for name in ("successor_lane_id", "antecessor_lane_id"):
                if pair.HasField(name):
                    other = getattr(pair, name).value
                    out.setdefault(key, []).append(other)
                    out.setdefault(other, []).append(key)
    return {key: list(dict.fromkeys(others)) for key, others in out.items()}


# Geometry


def _goes_on(lane: Lane, other: Lane) -> bool:
    """Whether `other` begins, and does not end, where `lane` ends."""
    begin, end = (float(np.hypot(*(other.center[i] - lane.center[-1]))) for i in (0, -1))
    return begin <= MAX_GAP and begin < end


def _beside(line: FloatArray, other: FloatArray) -> tuple[float, bool]:
    """Lateral offset of `other` at the middle of `line`, positive to the left, and whether it runs the same way.

    NaN where the middle has no foot on `other`.
    """
    steps = np.diff(line, axis=0)
    way = np.r_[0.0, np.cumsum(np.hypot(*steps.T))]
    half = 0.5 * way[-1]
    k = min(int(np.searchsorted(way, half, side="right")) - 1, len(steps) - 1)
    tangent = steps[k] / np.hypot(*steps[k])
    point = line[k] + (half - way[k]) * tangent
    i, foot = _foot(point, other)
    away = foot - point
    if abs(away @ tangent) > 0.5:
        return float("nan"), True
    return float(tangent[0] * away[1] - tangent[1] * away[0]), bool((other[i + 1] - other[i]) @ tangent > 0.0)


def _foot(point: FloatArray, line: FloatArray) -> tuple[int, FloatArray]:
    """The nearest point of a polyline without repeated points, and its segment."""
    steps = np.diff(line, axis=0)
    along = np.clip(np.einsum("ij,ij->i", point - line[:-1], steps) / np.einsum("ij,ij->i", steps, steps), 0.0, 1.0)
    feet = line[:-1] + along[:, None] * steps
    i = int(np.argmin(np.hypot(*(feet - point).T)))
    return i, feet[i]


def _station(point: FloatArray, line: FloatArray) -> float:
    """Arc length of the foot of a point, m."""
    i, foot = _foot(point, line)
    return float(np.hypot(*np.diff(line[: i + 1], axis=0).T).sum() + np.hypot(*(foot - line[i])))


def _beside_each_other(lanes: dict[int, Lane], adjacent: dict[int, list[int]]) -> tuple[dict[int, Lane], bool]:
    """The lanes with their neighbours; one drives on the left where opposite traffic is to the right more often."""
    out, balance = {}, 0
    for key, lane in lanes.items():
        sides = _sides(lane, [lanes[i] for i in adjacent[key] if i in lanes])
        (left, left_same), (right, right_same) = sides[True], sides[False]
        left_opposite, right_opposite = left is not None and not left_same, right is not None and not right_same
        balance += left_opposite - right_opposite
        beside: dict[str, Any] = {
            "left_neighbour": left if left_same else None,
            "right_neighbour": right if right_same else None,
        }
        out[key] = replace(lane, **beside, left_opposite=left_opposite, right_opposite=right_opposite)
    return out, balance >= 0


def _sides(lane: Lane, others: list[Lane]) -> dict[bool, tuple[int | None, bool]]:
    """Nearest lane to the left (True) and right (False) of the middle, and whether it runs the same way."""
    nearest: dict[bool, tuple[int | None, bool]] = {True: (None, False), False: (None, False)}
    distance = {True: BESIDE[1], False: BESIDE[1]}
    for other in others:
        offset, same = _beside(lane.center, other.center)
        left = offset > 0.0
        if 0.5 * BESIDE[0] <= abs(offset) <= distance[left]:
            nearest[left], distance[left] = (other.id, same), abs(offset)
    return nearest
