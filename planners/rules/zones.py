"""The rules of the road along one reference: its stop lines, and the zones where other road users
go first (when they do so: zone_times.py).

A zone is the stretch of the reference line on which the ego's body would obstruct road users with
priority:

(1) crosswalk:       stations at which the ego's body, `SIDE_M` wider on each side, is over the
                     polygon
(2) priority lane:   stations at which the reference line is nearer than w / 2 + `HALF_CAR_M` +
                     `SIDE_M` to the middle of a lane that the ego's lane yields to

The ego waits before the first of several zones if it does not fit between them, and so not on a
crosswalk nor where lanes cross.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from math import hypot

import numpy as np

from replan.core.arrays import FloatArray, arc_lengths
from replan.core.kernel import kernel
from replan.logs.polylines import inside
from replan.logs.reference_line import ReferenceLine
from replan.logs.road import Lane, Road, predecessors
from replan.logs.rules import Crosswalk, StopLine
from replan.logs.shapes import point_segment
from replan.logs.states import wrap
from replan.logs.vehicle import VehicleParameters
from replan.planners.frenet.reference_path import ReferencePath

SIDE_M = 0.3  # Space beside the ego's body in (1) and (2), m
HALF_CAR_M = 1.0  # Half the width of agents that go first in (2), m
STEP_M = 0.5  # Spacing of the stations that are tried, m
# Space that a waiting ego keeps before and behind itself, to zones and to the agent ahead, m
ROOM_M = 1.0
# The ego waits for a zone at a stop line that is nearer than this before it, m
LINE_BEFORE_M = 15.0
# An agent nearer than this to a priority lane, on lanes that lead to it, may claim it, m
FEED_M = 100.0
ASIDE_M = 1.0  # A stop line applies where the reference line runs within this of it, m
MERGED_M = 1.5  # Two lanes whose ends are nearer than this merge, m


@dataclass(frozen=True, slots=True)
class StopLineAhead:
    """A stop line that applies to the reference path, at the station `s` that the front must not
    pass, m.
    """

    id: int
    s: float
    light: int | None
    must_stop: bool


@dataclass(frozen=True, eq=False, slots=True)
class Walk:
    """A crosswalk; the ego's half lies between the offsets `right` and `left` of its lane, m."""

    crosswalk: Crosswalk
    right: float
    left: float


@dataclass(frozen=True, eq=False, slots=True)
class Priority:
    """A lane whose vehicles go first.

    Attributes:
        lane: The lane.
        feeds: Lanes that lead to it, itself included, each with the lights that hold its vehicles.
        p_in: Station on its centre line where the zone begins, m.
        p_out: Station where it ends, m.
        boxes: The zone as boxes along the reference line: x, y, yaw, length, width `(k, 5)`.
        merges: Whether it ends where the ego's lane ends.
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
        name: Its name in reasons ("crosswalk 3", "lane 17").
        by: The crosswalk or lane whose users go first.
        s_in: Station at which the front enters it, m.
        s_out: Station at which the rear leaves it, m.
        holds: Stations that the front does not pass while it waits, in driving order, m; the first
            one ahead applies.
    """

    name: str
    by: Walk | Priority
    s_in: float
    s_out: float
    holds: tuple[float, ...] = ()


def lines_along(road: Road, reference: ReferencePath, width: float) -> tuple[StopLineAhead, ...]:
    """The stop lines of a reference path that lights or stop signs may make the ego stop at, in
    driving order.
    """
    lines = [
        (mark, _stop_station(mark, reference.line, width)) for mark in _marks(road, reference.lanes)
    ]
    binding = [
        StopLineAhead(mark.id, s, mark.light, mark.must_stop)
        for mark, s in lines
        if s is not None and (mark.light is not None or mark.must_stop)
    ]
    return tuple(sorted(binding, key=lambda line: (line.s, line.id)))


def zones_along(
    road: Road, reference: ReferencePath, vehicle: VehicleParameters
) -> tuple[Zone, ...]:
    """The zones of a reference path in driving order, with their `holds`.

    These are the stop lines before the group of zones, the begin of the group, and that of the
    zone.
    """
    line = reference.line
    crossed = (_crosswalk_zone(crosswalk, reference, vehicle) for crosswalk in road.crosswalks)
    zones = [zone for zone in crossed if zone is not None]
    zones += _priorities(road, reference, vehicle)
    if not zones:
        return ()
    waiting = [
        station
        for mark in _marks(road, reference.lanes)
        if mark.light is None and (station := _stop_station(mark, line, vehicle.width)) is not None
    ]
    held, begin, end = [], -np.inf, -np.inf
    for zone in sorted(zones, key=lambda zone: (zone.s_in, zone.name)):
        if zone.s_in - end > vehicle.length + 2.0 * ROOM_M:
            begin = zone.s_in
        end = max(end, zone.s_out)
        lines = [s for s in waiting if begin - LINE_BEFORE_M < s <= begin]
        held.append(replace(zone, holds=tuple(sorted({*lines, begin, zone.s_in}))))
    return tuple(held)


def _crosswalk_zone(
    crosswalk: Crosswalk, reference: ReferencePath, vehicle: VehicleParameters
) -> Zone | None:
    """The zone (1) of a crosswalk; None where the reference path does not cross it."""
    line, half, polygon = reference.line, 0.5 * vehicle.width + SIDE_M, crosswalk.polygon
    low, high = polygon.min(axis=0) - half - 1.0, polygon.max(axis=0) + half + 1.0
    close = line.s[((line.xy >= low) & (line.xy <= high)).all(axis=1)]
    if not len(close):
        return None
    s = np.arange(float(close[0]) - 1.0, float(close[-1]) + 1.0, 0.5 * STEP_M)
    x, y, yaw, _ = np.array([line.frame(station_m) for station_m in s]).T
    in_box = (low[0] <= x) & (x <= high[0]) & (low[1] <= y) & (y <= high[1])
    to_left_x, to_left_y = -np.sin(yaw), np.cos(yaw)
    over = [
        s[k]
        for k in np.flatnonzero(in_box)
        if any(
            inside(x[k] + l * to_left_x[k], y[k] + l * to_left_y[k], polygon)
            for l in (0.0, half, -half)
        )
    ]
    if not over:
        return None
    middle = 0.5 * (over[0] + over[-1])
    edges = reference.lane_right, reference.lane_left
    walk = Walk(crosswalk, *(float(np.interp(middle, line.s, edge)) for edge in edges))
    return Zone(f"crosswalk {crosswalk.id}", walk, float(over[0]), float(over[-1]))


def _marks(road: Road, lanes: tuple[int, ...]) -> Iterator[StopLine]:
    """The stop lines across the lanes of a sequence, that apply to the way that it takes."""
    order = {lane: i for i, lane in enumerate(lanes)}
    for mark in road.stop_lines:
        if mark.lane not in order:
            continue
        after = [i for i in road.lanes[mark.lane].successors if order.get(i, -1) > order[mark.lane]]
        if not mark.towards or not set(after).isdisjoint(mark.towards):
            yield mark


def _stop_station(mark: StopLine, line: ReferenceLine, width: float) -> float | None:
    """The station at which a front `width` m wide first comes over a stop line; None where it
    passes beside it.
    """
    x, y = mark.points.mean(axis=0)
    middle, _ = line.project(x, y)
    (s0, l0), (s1, l1) = (line.project(x, y, middle, 10.0) for x, y in mark.points)
    if not min(l0, l1) - ASIDE_M <= 0.0 <= max(l0, l1) + ASIDE_M or abs(l1 - l0) < 0.1:
        return None
    slope = (s1 - s0) / (l1 - l0)
    return s0 - slope * l0 - abs(slope) * 0.5 * width


def _priorities(road: Road, reference: ReferencePath, vehicle: VehicleParameters) -> list[Zone]:
    """The zones (2); one per priority lane, even where two consecutive lanes of the ego meet it."""
    yielding = [road.lanes[i] for i in reference.lanes if road.lanes[i].yields_to]
    predecessors_of = predecessors(road.lanes) if yielding else {}
    zones: list[Zone] = []
    for own, first in [(lane, other) for lane in yielding for other in lane.yields_to]:
        if first not in road.lanes or first in reference.lanes:
            continue
        zone = _conflict(reference.line, own, road.lanes[first], vehicle.width)
        if zone is None:
            continue
        assert isinstance(zone.by, Priority)
        zone = replace(
            zone, by=replace(zone.by, feeds=_feeds(road, first, predecessors_of, reference.lanes))
        )
        same = [
            old for old in zones if old.name == zone.name and zone.s_in - old.s_out < vehicle.length
        ]
        if not same:
            zones.append(zone)
            continue
        old = same[0]
        assert isinstance(old.by, Priority) and isinstance(zone.by, Priority)
        p_in, p_out = min(old.by.p_in, zone.by.p_in), max(old.by.p_out, zone.by.p_out)
        boxes, merges = np.vstack([old.by.boxes, zone.by.boxes]), old.by.merges or zone.by.merges
        by = replace(old.by, p_in=p_in, p_out=p_out, boxes=boxes, merges=merges)
        s_in, s_out = min(old.s_in, zone.s_in), max(old.s_out, zone.s_out)
        zones[zones.index(old)] = replace(old, by=by, s_in=s_in, s_out=s_out)
    return zones


def _conflict(line: ReferenceLine, lane: Lane, other: Lane, width: float) -> Zone | None:
    """The zone (2) of the ego's lane with a lane that goes first; None where they do not meet."""
    (x0, y0), (x1, y1) = lane.center[0], lane.center[-1]
    first, _ = line.project(x0, y0)
    last, _ = line.project(x1, y1, first + lane.length)
    s = np.arange(first, max(last, first + STEP_M), STEP_M)
    frames = np.array([line.frame(station) for station in s])
    reach = 0.5 * width + HALF_CAR_M + SIDE_M
    touching = np.flatnonzero(distances(frames[:, :2], other.center) < reach)  # (2)
    if not len(touching):
        return None
    first, last = int(touching[0]), int(touching[-1])
    chord = arc_lengths(*other.center.T)
    p = np.arange(0.0, chord[-1] + STEP_M, STEP_M)
    points = np.column_stack([np.interp(p, chord, other.center[:, k]) for k in (0, 1)])
    other_points = np.flatnonzero(
        distances(points, np.ascontiguousarray(frames[first : last + 1, :2])) < reach
    )
    outline = frames[np.unique(np.r_[np.arange(first, last, 4), last])]
    boxes = np.column_stack(
        [
            outline[:, :3],
            np.full(len(outline), 4.0 * STEP_M),
            np.full(len(outline), width + 2.0 * SIDE_M),
        ]
    )
    merges = hypot(*(lane.center[-1] - other.center[-1])) < MERGED_M
    ends = (
        (float(p[other_points[0]]), float(p[other_points[-1]]))
        if len(other_points)
        else (0.0, float(chord[-1]))
    )
    return Zone(
        f"lane {other.id}",
        Priority(other, {}, *ends, boxes, merges),
        float(s[first]),
        float(s[last]),
    )


def _feeds(
    road: Road, lane: int, predecessors_of: Mapping[int, list[int]], own: Iterable[int]
) -> dict[int, tuple[int, ...]]:
    """The lanes that lead to a lane within `FEED_M`, but not the ego's own, with the lights on the
    way to it.
    """
    ways_to_lane: dict[int, tuple[int, ...]] = {lane: ()}
    queue, taken = [(lane, 0.0)], set(own)
    while queue:
        lane_id, length = queue.pop(0)
        for previous in predecessors_of.get(lane_id, ()):
            if previous in ways_to_lane or previous in taken or length >= FEED_M:
                continue
            lights = (
                mark.light
                for mark in road.stop_lines
                if mark.lane == previous
                and mark.light is not None
                and (not mark.towards or lane_id in mark.towards)
            )
            ways_to_lane[previous] = (*ways_to_lane[lane_id], *lights)
            queue.append((previous, length + road.lanes[previous].length))
    return ways_to_lane


def turned(lane: Lane, x: float, y: float, yaw: float) -> float:
    """Angle between a heading and the lane's at the centre point nearest to (x, y), rad, not
    negative.
    """
    i = min(
        int(np.argmin((lane.center[:, 0] - x) ** 2 + (lane.center[:, 1] - y) ** 2)),
        len(lane.center) - 2,
    )
    dx, dy = lane.center[i + 1] - lane.center[i]
    return abs(wrap(yaw - float(np.arctan2(dy, dx))))


@kernel
def distances(points: FloatArray, line: FloatArray) -> FloatArray:
    """Distance `(n,)` of each point `(n, 2)` from a polyline `(k, 2)`, m, which may be one
    point.
    """
    nearest = np.empty(len(points))
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        nearest[i] = hypot(x - line[0, 0], y - line[0, 1])
        for k in range(1, len(line)):
            nearest[i] = min(
                nearest[i],
                point_segment(x, y, line[k - 1, 0], line[k - 1, 1], line[k, 0], line[k, 1]),
            )
    return nearest
