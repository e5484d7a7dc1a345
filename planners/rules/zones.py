"""What the rules of the road hold along one reference: its stop lines, and the zones where others may go first.

A zone is the stretch of the reference line on which the ego's body would be in the way of those who go first:

(1) crosswalk:       stations at which the ego's body, `SIDE_M` wider on each side, is over the polygon
(2) priority lane:   stations at which the reference line is nearer than w / 2 + `HALF_CAR_M` + `SIDE_M` to the middle
                     of a lane that the ego's lane yields to

Zones with less room between them than the ego is long are waited for together, before the first: not on a crosswalk,
not where lanes cross.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from math import hypot

import numpy as np

from logs.kernel import FloatArray, kernel
from logs.road import Lane, ReferenceLine, Road, inside
from logs.rules import Crosswalk, StopLine
from logs.shapes import point_segment
from logs.states import wrap
from logs.vehicle import VehicleParameters
from planners.frenet.reference_path import ReferencePath

SIDE_M = 0.3
"""Room beside the ego's body that (1) and (2) count, m."""
HALF_CAR_M = 1.0
"""Half the width of those who go first in (2), m."""
STEP_M = 0.5
"""Spacing of the stations that are tried, m."""
ROOM_M = 1.0
"""Room that an ego that waits leaves before and behind it, to a zone and to the one ahead, m."""
LINE_BEFORE_M = 15.0
"""A stop line nearer than this before a zone is where one waits for it, m."""
FEED_M = 100.0
"""Who is nearer than this to a priority lane, on lanes that lead to it, may claim it, m."""
ASIDE_M = 1.0
"""A stop line counts where the reference line runs within this of it, m."""
MERGED_M = 1.5
"""Two lanes whose ends are nearer than this merge, m."""


@dataclass(frozen=True, slots=True)
class Line:
    """A stop line that counts for the reference path, at the station `s` that the front must not pass, m."""

    id: int
    s: float
    light: int | None
    must_stop: bool


@dataclass(frozen=True, eq=False, slots=True)
class Walk:
    """A crosswalk; the ego's half is what lies between the offsets `right` and `left` of its lane, m."""

    crosswalk: Crosswalk
    right: float
    left: float


@dataclass(frozen=True, eq=False, slots=True)
class Priority:
    """A lane that goes first.

    Attributes:
        lane: The lane.
        feeds: Lanes from which it is reached, itself included, and the lights that hold who is on them.
        p_in: Station on its centre line where the zone begins, m; `p_out` where it ends.
        boxes: The zone as boxes along the reference line: x, y, yaw, length, width `(k, 5)`.
        merges: Whether it goes on as the ego's lane does.
    """

    lane: Lane
    feeds: Mapping[int, tuple[int, ...]]
    p_in: float
    p_out: float
    boxes: FloatArray
    merges: bool


@dataclass(frozen=True, eq=False, slots=True)
class Zone:
    """A stretch in which others may go first.

    Attributes:
        name: As reasons name it ("crosswalk 3", "lane 17").
        by: The road user with priority.
        s_in: Station that the front reaches it at, m; `s_out` that the rear leaves it at.
        holds: Stations that the front does not pass while it waits, in driving order: the first that is ahead counts.
    """

    name: str
    by: Walk | Priority
    s_in: float
    s_out: float
    holds: tuple[float, ...] = ()


def lines_along(road: Road, reference: ReferencePath, width: float) -> tuple[Line, ...]:
    """The stop lines of a reference path that lights or stop signs may make the ego stop at, in driving order."""
    found = [(mark, _station(mark, reference.line, width)) for mark in _marks(road, reference.lanes)]
    binding = [
        Line(mark.id, s, mark.light, mark.must_stop)
        for mark, s in found
        if s is not None and (mark.light is not None or mark.must_stop)
    ]
    return tuple(sorted(binding, key=lambda line: (line.s, line.id)))


def zones_along(road: Road, reference: ReferencePath, vehicle: VehicleParameters) -> tuple[Zone, ...]:
    """The zones of a reference path in driving order."""
    zones = [
        *_walks(road, reference, vehicle.width),
        *_joined(_priorities(road, reference, vehicle.width), vehicle.length),
    ]
    if not zones:
        return ()
    waiting = [
        station
        for mark in _marks(road, reference.lanes)
        if mark.light is None and (station := _station(mark, reference.line, vehicle.width)) is not None
    ]
    return _held(sorted(zones, key=lambda zone: (zone.s_in, zone.name)), waiting, vehicle.length)


def _held(zones: list[Zone], waiting: list[float], length: float) -> tuple[Zone, ...]:
    """The zones with their `holds`: a stop line before the group, the begin of the group, the zone itself."""
    held, begin, end = [], -np.inf, -np.inf
    for zone in zones:
        if zone.s_in - end > length + 2.0 * ROOM_M:
            begin = zone.s_in
        end = max(end, zone.s_out)
        lines = [s for s in waiting if begin - LINE_BEFORE_M < s <= begin]
        holds = {*lines, begin, zone.s_in}
        held.append(replace(zone, holds=tuple(sorted(holds))))
    return tuple(held)


def _marks(road: Road, lanes: tuple[int, ...]) -> Iterator[StopLine]:
    """The stop lines across the lanes of a sequence, as far as they count for the way that it takes."""
    order = {lane: i for i, lane in enumerate(lanes)}
    for mark in road.stop_lines:
        if mark.lane not in order:
            continue
        after = [i for i in road.lanes[mark.lane].successors if order.get(i, -1) > order[mark.lane]]
        if not mark.towards or not set(after).isdisjoint(mark.towards):
            yield mark


def _station(mark: StopLine, line: ReferenceLine, width: float) -> float | None:
    """The station at which a front `width` m wide first comes over a stop line; None where it passes beside it."""
    x, y = mark.points.mean(axis=0)
    middle, _ = line.project(x, y)
    (s0, l0), (s1, l1) = (line.project(x, y, middle, 10.0) for x, y in mark.points)
    if not min(l0, l1) - ASIDE_M <= 0.0 <= max(l0, l1) + ASIDE_M or abs(l1 - l0) < 0.1:
        return None
    slope = (s1 - s0) / (l1 - l0)
    return s0 - slope * l0 - abs(slope) * 0.5 * width


def _walks(road: Road, reference: ReferencePath, width: float) -> Iterator[Zone]:
    line, half = reference.line, 0.5 * width + SIDE_M
    for crosswalk in road.crosswalks:
        polygon = crosswalk.polygon
        s = np.arange(*_near(line, polygon, half), 0.5 * STEP_M)
        over = [at for at in s if any(inside(*line.point(at, l), polygon) for l in (0.0, half, -half))]  # (1)  # noqa: E741
        if over:
            middle = 0.5 * (over[0] + over[-1])
            right, left = (
                float(np.interp(middle, line.s, edge)) for edge in (reference.lane_right, reference.lane_left)
            )
            yield Zone(f"crosswalk {crosswalk.id}", Walk(crosswalk, right, left), float(over[0]), float(over[-1]))


def _near(line: ReferenceLine, polygon: FloatArray, half: float) -> tuple[float, float]:
    """The stations between which a line, `half` m to each side, may be over a polygon; equal where it cannot."""
    low, high = polygon.min(axis=0) - half - 1.0, polygon.max(axis=0) + half + 1.0
    close = np.flatnonzero(((line.xy >= low) & (line.xy <= high)).all(axis=1))
    if not len(close):
        return 0.0, 0.0
    return float(line.s[close[0]]) - 1.0, float(line.s[close[-1]]) + 1.0


def _priorities(road: Road, reference: ReferencePath, width: float) -> Iterator[Zone]:
    yielding = [road.lanes[i] for i in reference.lanes if road.lanes[i].yields_to]
    before: dict[int, list[int]] = {}
    for lane in road.lanes.values() if yielding else ():
        for after in lane.successors:
            before.setdefault(after, []).append(lane.id)
    for lane in yielding:
        for other in lane.yields_to:
            if other in road.lanes and other not in reference.lanes:
                zone = _conflict(reference.line, lane, road.lanes[other], width)
                if zone is not None:
                    feeds = _feeds(road, other, before, reference.lanes)
                    assert isinstance(zone.by, Priority)
                    yield replace(zone, by=replace(zone.by, feeds=feeds))


def _joined(zones: Iterable[Zone], length: float) -> list[Zone]:
    """The zones with one per priority lane, where two lanes of the ego meet it one after the other."""
    found: list[Zone] = []
    for zone in zones:
        same = [old for old in found if old.name == zone.name and zone.s_in - old.s_out < length]
        if not same:
            found.append(zone)
            continue
        old = same[0]
        assert isinstance(old.by, Priority) and isinstance(zone.by, Priority)
        by = replace(
            old.by,
            p_in=min(old.by.p_in, zone.by.p_in),
            p_out=max(old.by.p_out, zone.by.p_out),
            boxes=np.vstack([old.by.boxes, zone.by.boxes]),
            merges=old.by.merges or zone.by.merges,
        )
        whole = replace(old, by=by, s_in=min(old.s_in, zone.s_in), s_out=max(old.s_out, zone.s_out))
        found[found.index(old)] = whole
    return found


def _conflict(line: ReferenceLine, lane: Lane, other: Lane, width: float) -> Zone | None:
    """The zone (2) of the ego's lane with a lane that goes first; None where they do not meet."""
    (x0, y0), (x1, y1) = lane.center[0], lane.center[-1]
    first, _ = line.project(x0, y0)
    last, _ = line.project(x1, y1, first + lane.length)
    s = np.arange(first, max(last, first + STEP_M), STEP_M)
    frames = np.array([line.frame(at) for at in s])
    reach = 0.5 * width + HALF_CAR_M + SIDE_M
    met = np.flatnonzero(distances(frames[:, :2], other.center) < reach)  # (2)
    if not len(met):
        return None
    first, last = int(met[0]), int(met[-1])
    chord = np.r_[0.0, np.cumsum(np.hypot(*np.diff(other.center, axis=0).T))]
    p = np.arange(0.0, chord[-1] + STEP_M, STEP_M)
    points = np.column_stack([np.interp(p, chord, other.center[:, k]) for k in (0, 1)])
    theirs = np.flatnonzero(distances(points, np.ascontiguousarray(frames[first : last + 1, :2])) < reach)
    kept = frames[np.unique(np.r_[np.arange(first, last, 4), last])]
    boxes = np.column_stack([kept[:, :3], np.full(len(kept), 4.0 * STEP_M), np.full(len(kept), width + 2.0 * SIDE_M)])
    merges = hypot(*(lane.center[-1] - other.center[-1])) < MERGED_M
    ends = (float(p[theirs[0]]), float(p[theirs[-1]])) if len(theirs) else (0.0, float(chord[-1]))
    return Zone(f"lane {other.id}", Priority(other, {}, *ends, boxes, merges), float(s[first]), float(s[last]))


def _feeds(road: Road, lane: int, before: Mapping[int, list[int]], own: Iterable[int]) -> dict[int, tuple[int, ...]]:
    """The lanes that lead to a lane within `FEED_M`, but not the ego's own, with the lights on the way to it."""
    found: dict[int, tuple[int, ...]] = {lane: ()}
    queue, taken = [(lane, 0.0)], set(own)
    while queue:
        at, length = queue.pop(0)
        for previous in before.get(at, ()):
            if previous in found or previous in taken or length >= FEED_M:
                continue
            lights = (
                mark.light
                for mark in road.stop_lines
                if mark.lane == previous and mark.light is not None and (not mark.towards or at in mark.towards)
            )
            found[previous] = (*found[at], *lights)
            queue.append((previous, length + road.lanes[previous].length))
    return found


def turned(lane: Lane, x: float, y: float, yaw: float) -> float:
    """By how much a heading differs from the lane's at the centre point nearest to (x, y), rad, not negative."""
    i = min(int(np.argmin((lane.center[:, 0] - x) ** 2 + (lane.center[:, 1] - y) ** 2)), len(lane.center) - 2)
    dx, dy = lane.center[i + 1] - lane.center[i]
    return abs(wrap(yaw - float(np.arctan2(dy, dx))))


@kernel
def distances(points: FloatArray, line: FloatArray) -> FloatArray:
    """Distance `(n,)` of each point `(n, 2)` from a polyline `(k, 2)`, m; of one point from that."""
    out = np.empty(len(points))
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        out[i] = hypot(x - line[0, 0], y - line[0, 1])
        for k in range(1, len(line)):
            out[i] = min(out[i], point_segment(x, y, line[k - 1, 0], line[k - 1, 1], line[k, 0], line[k, 1]))
    return out
