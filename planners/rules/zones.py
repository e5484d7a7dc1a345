"""The rules of the road along one reference: its stop lines, the zones where other road users go
first, and when.

A zone is the stretch of the reference line on which the ego's body would obstruct road users with
priority:

(1) crosswalk:       stations at which the ego's body, `SIDE_M` wider on each side, is over the
                     polygon
(2) priority lane:   stations at which the reference line is nearer than w / 2 + `HALF_CAR_M` +
                     `SIDE_M` to the middle of a lane that the ego's lane yields to

The ego waits before the first of several zones if it does not fit between them, and so not on a
crosswalk nor where lanes cross. Agents take a zone in time windows, which follow from their
positions and predictions.

Crosswalk: a pedestrian who is on it, or within `EDGE_M` of it and walks towards it, takes it while
one of their hypotheses is in the ego's half, widened by `KEPT_M` on each side. A pedestrian who
stands there takes it for an unknown
time: from when a hypothesis enters it, else as if they started now with `START_MPS` in the
direction that they face.

Priority lane: a vehicle on it or on a lane that leads to it, in its direction, takes the zone

(3) while the box of a hypothesis touches the zone, if all that do so have a probability of
    `UNLIKELY` together
(4) on the priority lane itself also from (p_in - front) / v to (p_out - rear) / v: it may be
    predicted to leave the lane, but stay on it; one that stands in the zone takes it until it has
    left

A vehicle that a red light holds on its way there takes no zone.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from math import hypot, inf

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, arc_lengths
from replan.core.kernel import kernel
from replan.logs.agents import AgentKind
from replan.logs.frame import Frame
from replan.logs.polylines import inside
from replan.logs.reference_line import ReferenceLine, line_project_many
from replan.logs.road import Lane, Road, predecessors
from replan.logs.rules import RED, Crosswalk, StopLine
from replan.logs.shapes import overlap, point_segment
from replan.logs.states import wrap
from replan.logs.vehicle import VehicleParameters
from replan.planners.frenet.reference_path import ReferencePath
from replan.planners.frenet.scene import STANDING_MPS, UNLIKELY

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
EDGE_M = 1.5  # A pedestrian who stands within this of a crosswalk may want to cross, m
# A pedestrian whose distance to it falls faster than this walks towards it; a slower one stands,
# m/s
TOWARDS_MPS = 0.3
KEPT_M = 0.3  # Width by which the ego's half of a crosswalk is extended on each side, m
# Speed with which a standing pedestrian sets off, m/s: that of the clearing times in RiLSA 2010
START_MPS = 1.2
ASKEW_RAD = 1.0  # A vehicle drives along a lane where its heading differs less than this, rad


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
    """A lane whose vehicles go first."""

    lane: Lane
    # Lanes that lead to it, itself included, each with the lights that hold its vehicles
    feeds: Mapping[int, tuple[int, ...]]
    p_in: float  # Station on its centre line where the zone begins, m; `p_out` where it ends
    p_out: float
    # The zone as boxes along the reference line: x, y, yaw, length, width `(k, 5)`
    boxes: FloatArray
    merges: bool  # Whether it ends where the ego's lane ends


@dataclass(frozen=True, eq=False, slots=True)
class Zone:
    """A stretch in which others may go first."""

    name: str  # Its name in reasons ("crosswalk 3", "lane 17")
    by: Walk | Priority  # The crosswalk or lane whose users go first
    s_in: float  # Station at which the front enters it, m; `s_out` at which the rear leaves it
    s_out: float
    # Stations that the front does not pass while it waits, in driving order; the first one ahead
    # applies
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
    line, half, zones = reference.line, 0.5 * vehicle.width + SIDE_M, list[Zone]()
    for crosswalk in road.crosswalks:
        polygon = crosswalk.polygon
        low, high = polygon.min(axis=0) - half - 1.0, polygon.max(axis=0) + half + 1.0
        close = np.flatnonzero(((line.xy >= low) & (line.xy <= high)).all(axis=1))
        if not len(close):
            continue
        s = np.arange(float(line.s[close[0]]) - 1.0, float(line.s[close[-1]]) + 1.0, 0.5 * STEP_M)
        x, y, yaw, _ = np.array([line.frame(station_m) for station_m in s]).T
        in_box = (low[0] <= x) & (x <= high[0]) & (low[1] <= y) & (y <= high[1])
        c, d = np.cos(yaw), np.sin(yaw)
        over = [
            s[k]
            for k in np.flatnonzero(in_box)
            if any(
                inside(x[k] - l * d[k], y[k] + l * c[k], polygon) for l in (0.0, half, -half)
            )  # (1)
        ]
        if over:
            middle = 0.5 * (over[0] + over[-1])
            edges = reference.lane_right, reference.lane_left
            walk = Walk(crosswalk, *(float(np.interp(middle, line.s, edge)) for edge in edges))
            zones.append(Zone(f"crosswalk {crosswalk.id}", walk, float(over[0]), float(over[-1])))
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
        merged = replace(
            old, by=by, s_in=min(old.s_in, zone.s_in), s_out=max(old.s_out, zone.s_out)
        )
        zones[zones.index(old)] = merged
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


@dataclass(frozen=True, slots=True)
class ZoneTime:
    """An agent takes a zone from `begin` to `end`, s after the frame's time.

    Inf: the end is not known.
    """

    begin: float
    end: float
    agent: int  # Index into the frame's agents; `speed` of it, m/s
    speed: float
    # Whether it is a pedestrian who stands at the crosswalk and may begin to cross
    waits: bool = False


def windows(zone: Zone, line: ReferenceLine, road: Road, frame: Frame) -> tuple[ZoneTime, ...]:
    """The windows in which agents take a zone, in order of their begin."""
    spans = (
        _walking(zone, zone.by, line, frame)
        if isinstance(zone.by, Walk)
        else _driving(zone.by, road, frame)
    )
    return tuple(sorted(spans, key=lambda window: (window.begin, window.end, window.agent)))


def _walking(zone: Zone, walk: Walk, line: ReferenceLine, frame: Frame) -> Iterator[ZoneTime]:
    """Windows of the pedestrians who are on a crosswalk, or near it and do not walk along or away
    from it.
    """
    futures, agents = frame.predictions, frame.agents
    polygon, ahead = walk.crosswalk.polygon, frame.predictions.t - frame.t
    low, high = polygon.min(axis=0) - EDGE_M, polygon.max(axis=0) + EDGE_M
    near = (agents.x > low[0]) & (agents.x < high[0]) & (agents.y > low[1]) & (agents.y < high[1])
    edge = np.vstack([polygon, polygon[:1]])
    for i in np.flatnonzero(near).tolist():
        if agents.kinds[i] is not AgentKind.PEDESTRIAN:
            continue
        x, y, stands = float(agents.x[i]), float(agents.y[i]), agents.speed[i] < TOWARDS_MPS
        now, soon = distances(
            np.array([[x, y], [x + 0.1 * agents.vx[i], y + 0.1 * agents.vy[i]]]), edge
        )
        comes = now - soon > 0.1 * TOWARDS_MPS or stands
        if not (inside(x, y, polygon) or (now < EDGE_M and comes)):
            continue
        rows, yaw, walked = np.flatnonzero(futures.agent == i), agents.yaw[i], START_MPS * ahead
        spans = [
            window
            for row in rows
            for window in _span(
                _on_half(zone, walk, line, futures.x[row], futures.y[row]), ahead, i, frame
            )
        ]
        if stands and not spans:
            taken = _on_half(
                zone,
                walk,
                line,
                agents.x[i] + walked * np.cos(yaw),
                agents.y[i] + walked * np.sin(yaw),
            )
            spans = list(_span(taken, ahead, i, frame))
        yield from (replace(window, end=inf, waits=True) if stands else window for window in spans)


def _on_half(
    zone: Zone, walk: Walk, line: ReferenceLine, x: FloatArray, y: FloatArray
) -> BoolArray:
    """Which points `(k,)` of a way lie on the ego's half of a crosswalk."""
    frenet = line_project_many(line.s, line.coef, x, y, zone.s_in, 30.0)
    s, l = frenet[:, 0], frenet[:, 1]
    along = (s > zone.s_in - EDGE_M) & (s < zone.s_out + EDGE_M)
    return np.asarray(along & (l > walk.right - KEPT_M) & (l < walk.left + KEPT_M))


def _driving(priority: Priority, road: Road, frame: Frame) -> Iterator[ZoneTime]:
    """Windows of the vehicles that may take the zone, by the lane that they are on.

    The priority lane comes first.
    """
    agents, futures = frame.agents, frame.predictions
    taken: set[int] = set()
    for lane_id, lights in priority.feeds.items():
        if any(frame.lights.get(light) in RED for light in lights):
            continue
        lane = road.lanes[lane_id]
        low, high = lane.polygon.min(axis=0), lane.polygon.max(axis=0)
        near = (
            (agents.x >= low[0])
            & (agents.x <= high[0])
            & (agents.y >= low[1])
            & (agents.y <= high[1])
        )
        for i in np.flatnonzero(near).tolist():
            x, y = float(agents.x[i]), float(agents.y[i])
            drives = agents.kinds[i] not in (AgentKind.PEDESTRIAN, AgentKind.OBJECT)
            if i in taken or not drives or not inside(x, y, lane.polygon):
                continue
            if turned(lane, x, y, float(agents.yaw[i])) >= ASKEW_RAD:
                continue
            taken.add(i)
            if lane_id == priority.lane.id:
                yield from _passage(priority, i, frame)
            rows, size = (
                np.flatnonzero(futures.agent == i),
                np.array([agents.length[i], agents.width[i]]),
            )
            touches = _boxes_touched(
                priority.boxes, futures.x[rows], futures.y[rows], futures.yaw[rows], size
            )
            if futures.probability[rows][touches.any(axis=1)].sum() >= UNLIKELY:  # (3)
                for touched in touches:
                    yield from _span(touched, futures.t - frame.t, i, frame)


def _passage(priority: Priority, i: int, frame: Frame) -> Iterator[ZoneTime]:
    """The window (4) of a vehicle on the priority lane."""
    agents, center = frame.agents, priority.lane.center
    x, y, step = float(agents.x[i]), float(agents.y[i]), np.diff(center, axis=0)
    length = np.hypot(*step.T)
    u = ((x - center[:-1, 0]) * step[:, 0] + (y - center[:-1, 1]) * step[:, 1]) / np.maximum(
        length, 1e-9
    ) ** 2
    u = np.clip(u, 0.0, 1.0)
    away = np.hypot(center[:-1, 0] + u * step[:, 0] - x, center[:-1, 1] + u * step[:, 1] - y)
    k = int(np.argmin(away))
    p = float(length[:k].sum() + u[k] * length[k])  # along the lane, to the point nearest to it
    v, half = float(agents.speed[i]), 0.5 * float(agents.length[i])
    if p - half > priority.p_out:
        return
    if v >= STANDING_MPS:
        # (4)
        yield ZoneTime(
            max(priority.p_in - p - half, 0.0) / v, (priority.p_out - p + half) / v, i, v
        )
    elif p + half > priority.p_in:
        yield ZoneTime(0.0, inf, i, v)


def _span(taken: BoolArray, ahead: FloatArray, i: int, frame: Frame) -> Iterator[ZoneTime]:
    """The window from the first to the last taken time.

    It has no end if that is the last time of the predictions.
    """
    samples = np.flatnonzero(taken)
    if len(samples):
        end = inf if samples[-1] == len(ahead) - 1 else float(ahead[samples[-1]])
        yield ZoneTime(float(ahead[samples[0]]), end, i, float(frame.agents.speed[i]))


@kernel
def _boxes_touched(
    boxes: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray, size: FloatArray
) -> BoolArray:
    """Which boxes at `(n, k)` poses of one size (length, width) overlap any of the `boxes`
    `(m, 5)`.
    """
    touched = np.zeros(x.shape, np.bool_)
    for i in range(x.shape[0]):
        for k in range(x.shape[1]):
            for j in range(len(boxes)):
                if overlap(
                    boxes[j, 0],
                    boxes[j, 1],
                    boxes[j, 2],
                    boxes[j, 3],
                    boxes[j, 4],
                    x[i, k],
                    y[i, k],
                    yaw[i, k],
                    size[0],
                    size[1],
                ):
                    touched[i, k] = True
                    break
    return touched
