"""Events of the ego alone: its motion, and its behaviour at elements of the map and at lights.

The lane that the ego is on at a step contains its box centre and leads its way
(`replan.logs.route.on_lane`). If several lanes do, the ego stays on its lane, then takes a
successor of it, then a neighbour, always the one that fits for longest.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.core.once import once
from replan.logs.agents import AgentKind
from replan.logs.polylines import inside
from replan.logs.road import Lane, Road, RoadSource, predecessors
from replan.logs.route import on_lane
from replan.logs.rules import RED, StopLine
from replan.logs.states import wrap
from replan.metrics.metric import Unavailable
from replan.mine.driven_log import JUMPS, DrivenLog, Event, EventKind, runs, steps

HARD_MPS2, HARD_S = 3.0, 0.3
CHANGE_S, STAYS_S = 2.0, 1.0
TURN_RAD, TURN_KAPPA, TURN_GAP_M = np.pi / 4.0, 1.0 / 40.0, 5.0
LIGHT_BEFORE_M, ASIDE_M = 40.0, 2.5
MERGE_S, MERGE_M, MERGE_RAD = 3.0, 40.0, np.pi / 3.0
ROUNDABOUT_M, ROUND = 250.0, 0.25
STOP_BEFORE_M = 20.0
CROSSING_RAD = np.pi / 6.0
WALKER_M = 3.0
NO_LANES = Unavailable("the log has no lanes")


@dataclass(frozen=True, slots=True)
class Stay:
    """The ego on one lane, from the first to the last step."""

    lane: Lane
    first: int
    last: int


@once
def stays(log: DrivenLog) -> tuple[Stay, ...]:
    """The lanes that the ego drove, in order of time; steps outside of all lanes are in no stay."""
    road, (x, y, yaw) = log.scenario.road, log.boxes[:3]
    box = np.array([x.min(), y.min(), x.max(), y.max()])
    on: dict[int, BoolArray] = {}
    for lane in road.lanes.values():
        low, high = lane.polygon.min(axis=0), lane.polygon.max(axis=0)
        if lane.drivable and (low <= box[2:]).all() and (high >= box[:2]).all():
            flags = on_lane(lane, x, y, yaw)
            if flags.any():
                on[lane.id] = flags
    until = {i: np.full(len(x), -1) for i in on}
    for i, flags in on.items():
        for first, last in runs(flags):
            until[i][first : last + 1] = last
    driven: list[Stay] = []
    k, lane_id = 0, -1
    while k < len(x):
        ends = {i: int(until[i][k]) for i in on if until[i][k] >= k}
        if not ends:
            k += 1
            continue
        successors = road.lanes[lane_id].successors if lane_id in road.lanes else ()
        beside = _neighbours(road, lane_id)
        rank = {i: 2 * (i in successors) + (i in beside) for i in ends}
        lane_id = max(ends, key=lambda i: (rank[i], ends[i], -i))
        driven.append(Stay(road.lanes[lane_id], k, ends[lane_id]))
        k = ends[lane_id] + 1
    return tuple(driven)


def _neighbours(road: Road, lane: int) -> set[int]:
    """The lanes beside a lane in the same direction."""
    if lane not in road.lanes:
        return set()
    pair = road.lanes[lane].left_neighbour, road.lanes[lane].right_neighbour
    return {i for i in pair if i is not None and i in road.lanes}


def crosses_others(road: Road, x: float, y: float) -> bool:
    """Whether lanes cross at a point: drivable lanes of directions that differ by 30 to 150
    degrees.
    """
    headings = [_heading_at(lane, x, y) for lane in road.lanes_at(x, y) if lane.drivable]
    bends = [abs(wrap(a - b)) for i, a in enumerate(headings) for b in headings[:i]]
    return any(CROSSING_RAD < bend < np.pi - CROSSING_RAD for bend in bends)


def _heading_at(lane: Lane, x: float, y: float) -> float:
    middle = 0.5 * (lane.center[1:] + lane.center[:-1])
    nearest = int(np.argmin(np.hypot(middle[:, 0] - x, middle[:, 1] - y)))
    dx, dy = lane.center[nearest + 1] - lane.center[nearest]
    return float(np.arctan2(dy, dx))


def in_roundabout(road: Road, lane: Lane) -> bool:
    """Whether a lane is part of a circle of lanes: no longer than `ROUNDABOUT_M`, and round within
    `ROUND`.
    """
    waiting: list[tuple[int, float, tuple[int, ...]]] = [(lane.id, 0.0, ())]
    visited: set[int] = set()
    while waiting:
        i, length, circle = waiting.pop()
        length, circle = length + road.lanes[i].length, (*circle, i)
        if length > ROUNDABOUT_M:
            continue
        for successor in road.lanes[i].successors:
            if successor == lane.id:
                points = np.vstack([road.lanes[j].center for j in circle])
                away = np.hypot(*(points - points.mean(axis=0)).T)
                if away.std() < ROUND * away.mean():
                    return True
            elif successor in road.lanes and successor not in visited:
                visited.add(successor)
                waiting.append((successor, length, circle))
    return False


def _has_map(log: DrivenLog) -> bool:
    return log.scenario.road.source is RoadSource.LANES


def _span(log: DrivenLog, first: int, last: int) -> tuple[float, float]:
    """Times of two steps, which may lie beyond the log."""
    return float(log.t[max(first, 0)]), float(log.t[min(last, len(log.t) - 1)])


def _hard_braking(log: DrivenLog) -> Iterator[Event]:
    for first, last in runs(log.accel <= -HARD_MPS2, least=steps(HARD_S), hole=steps(0.5)):
        least, doubt = (
            float(log.accel[first : last + 1].min()),
            JUMPS if log.jumps[first : last + 1].any() else "",
        )
        yield Event(*_span(log, first, last), least, doubt=doubt)


def _lane_change(log: DrivenLog) -> Iterable[Event] | Unavailable:
    if not _has_map(log):
        return NO_LANES
    events, road, lanes = [], log.scenario.road, stays(log)
    for before, now in pairwise(lanes):
        ahead = {before.lane.id, *before.lane.successors}
        beside = {i for lane_id in ahead for i in _neighbours(road, lane_id)}
        beside |= {
            i for other in _neighbours(road, before.lane.id) for i in road.lanes[other].successors
        }
        short = now.last - now.first < steps(STAYS_S) and now.last < len(log.t) - 1
        if (
            now.lane.id in ahead
            or now.lane.id not in beside
            or now.first > before.last + steps(1.0)
            or short
        ):
            continue
        k, last = now.first, max(now.first - steps(CHANGE_S), 0)
        dx, dy = log.boxes[0, k] - log.boxes[0, last], log.boxes[1, k] - log.boxes[1, last]
        heading = _heading_at(now.lane, float(log.boxes[0, k]), float(log.boxes[1, k]))
        side = "left" if dy * np.cos(heading) - dx * np.sin(heading) > 0.0 else "right"
        around = _span(log, k - steps(CHANGE_S), k + steps(CHANGE_S))
        events.append(Event(*around, float(log.ego.v[k]), what=side))
    return events


def _turns(log: DrivenLog) -> Iterator[tuple[float, float, float]]:
    """Stretches of the path that turn by `TURN_RAD` or more to one side: first station, last
    station, and angle.
    """
    s, kappa = log.path.s, log.path.kappa
    for sign in (1.0, -1.0):
        bent = sign * kappa > TURN_KAPPA
        spans = [(float(s[first]), float(s[last])) for first, last in runs(bent)]
        joined: list[tuple[float, float]] = []
        for first, last in spans:
            if joined and first - joined[-1][1] < TURN_GAP_M:
                joined[-1] = joined[-1][0], last
            else:
                joined.append((first, last))
        for first, last in joined:
            angle = float(np.interp(last, s, log.path.yaw) - np.interp(first, s, log.path.yaw))
            if abs(angle) >= TURN_RAD:
                yield first, last, angle


def _lines_on_way(log: DrivenLog) -> Iterator[tuple[StopLine, float]]:
    """The stop lines across the path, each with its station."""
    for line in log.scenario.road.stop_lines:
        x, y = line.points.mean(axis=0).tolist()
        s, l = log.path.project(x, y)
        lane = log.scenario.road.lanes[line.lane]
        bend = wrap(_heading_at(lane, x, y) - log.path.frame(s)[2])
        if (
            abs(l) <= ASIDE_M
            and abs(bend) < np.pi / 4.0
            and -1.0 < s < float(log.front.max()) + LIGHT_BEFORE_M
        ):
            yield line, s


def _unprotected_turn(log: DrivenLog) -> Iterable[Event] | Unavailable:
    if not _has_map(log):
        return NO_LANES
    road, events = log.scenario.road, []
    lights = [s for line, s in _lines_on_way(log) if line.light is not None]
    across = "left" if road.drives_on_right else "right"
    for first, last, angle in _turns(log):
        points = [log.path.frame(s)[:2] for s in np.linspace(first, last, 5)]
        lit = any(first - LIGHT_BEFORE_M < s < last for s in lights)
        if lit or not any(crosses_others(road, *point) for point in points):
            continue
        steps_in_turn = np.flatnonzero((log.front >= first) & (log.back <= last))
        if len(steps_in_turn):
            side = "left" if angle > 0.0 else "right"
            words = f"{side}, across oncoming traffic" if side == across else side
            ends = _span(log, int(steps_in_turn[0]), int(steps_in_turn[-1]))
            events.append(Event(*ends, angle, what=words))
    return events


def _merge(log: DrivenLog) -> Iterable[Event] | Unavailable:
    if not _has_map(log):
        return NO_LANES
    road, events = log.scenario.road, []
    into = predecessors({i: lane for i, lane in road.lanes.items() if lane.drivable})
    lanes = stays(log)
    for before, now in pairwise(lanes):
        if now.lane.id not in before.lane.successors:
            continue
        heading = _heading_at(before.lane, *before.lane.center[-1])
        others = [
            lane
            for lane in map(road.lanes.__getitem__, into[now.lane.id])
            if lane.id != before.lane.id
            and abs(wrap(_heading_at(lane, *lane.center[-1]) - heading)) < MERGE_RAD
        ]
        met: dict[str, float] = {}
        for user in log.neighbours if others else ():
            if user.kind in (AgentKind.PEDESTRIAN, AgentKind.OBJECT):
                continue
            x, y, yaw = user.pose[:3]
            away = np.hypot(x - log.boxes[0, user.k], y - log.boxes[1, user.k])
            near = (
                (np.abs(user.k - now.first) <= steps(MERGE_S))
                & (away <= MERGE_M)
                & (user.speed > 0.5)
            )
            if near.any() and any(
                on_lane(lane, x[near], y[near], yaw[near]).any() for lane in others
            ):
                met[user.id] = float(away[near].min())
        if met:
            around = _span(log, now.first - steps(MERGE_S), now.first + steps(MERGE_S))
            nearest = sorted(met, key=lambda name: (met[name], name))
            events.append(Event(*around, met[nearest[0]], tuple(nearest)))
    return events


def _roundabout(log: DrivenLog) -> Iterable[Event] | Unavailable:
    if not _has_map(log):
        return NO_LANES
    flags = np.zeros(len(log.t), np.bool_)
    for stay in stays(log):
        if in_roundabout(log.scenario.road, stay.lane):
            flags[stay.first : stay.last + 1] = True
    return [
        Event(*_span(log, a, b), float(log.ego.v[a : b + 1].mean()))
        for a, b in runs(flags, least=steps(1.0))
    ]


def _red_light(log: DrivenLog) -> Iterable[Event] | Unavailable:
    lights = {light.id: light for light in log.scenario.lights}
    lines = [(line, s) for line, s in _lines_on_way(log) if line.light in lights]
    if not lights:
        return Unavailable("the log has no traffic light")
    events = []
    for line, s in lines:
        assert line.light is not None
        light = lights[line.light]
        red = np.array([light.at(t) in RED for t in log.t.tolist()])
        ahead = s - log.front
        for first, last in runs(red & (ahead > -0.5) & (ahead < LIGHT_BEFORE_M), least=steps(0.5)):
            slowest = float(np.abs(log.ego.v[first : last + 1]).min())
            events.append(Event(*_span(log, first, last), slowest, what=f"stop line {line.id}"))
    return events


def _stop_sign(log: DrivenLog) -> Iterable[Event] | Unavailable:
    if not any(line.must_stop for line in log.scenario.road.stop_lines):
        return Unavailable("the log's map has no stop sign")
    events = []
    for line, s in _lines_on_way(log):
        ahead = s - log.front
        near = (ahead > -0.5) & (ahead < STOP_BEFORE_M)
        for first, last in runs(near) if line.must_stop else ():
            slowest = float(np.abs(log.ego.v[first : last + 1]).min())
            events.append(Event(*_span(log, first, last), slowest, what=f"stop line {line.id}"))
    return events


def _crosswalk(log: DrivenLog) -> Iterable[Event] | Unavailable:
    if not log.scenario.road.crosswalks:
        return Unavailable("the log's map has no crosswalk")
    s = np.arange(0.0, log.path.length + 1e-9, 0.5)
    path: FloatArray = np.array([log.path.frame(station)[:2] for station in s.tolist()])
    events = []
    for crosswalk in log.scenario.road.crosswalks:
        low, high = crosswalk.polygon.min(axis=0), crosswalk.polygon.max(axis=0)
        if not ((path >= low) & (path <= high)).all(axis=1).any():
            continue
        on = np.array([inside(float(x), float(y), crosswalk.polygon) for x, y in path])
        for a, b in runs(on):
            for first, last in runs((log.front >= s[a]) & (log.back <= s[b])):
                around = []
                for user in log.neighbours:
                    xy = user.pose[:2, (user.k >= first) & (user.k <= last)].T
                    near = ((xy >= low - WALKER_M) & (xy <= high + WALKER_M)).all(axis=1).any()
                    if user.kind is AgentKind.PEDESTRIAN and near:
                        around.append(user.id)
                v = float(log.ego.v[first])
                events.append(
                    Event(*_span(log, first, last), v, tuple(around), f"crosswalk {crosswalk.id}")
                )
    return events


EGO_AND_ROAD = (
    EventKind(
        name="hard_braking",
        find=_hard_braking,
        meaning=(
            f"The ego's speed falls by {HARD_MPS2:g} m/s2 or more (mean over 0.5 s) for {HARD_S} s."
        ),
        measures="least acceleration",
        unit="m/s2",
        source="between nuPlan's comfort bound (-4.05 m/s2) and usual braking (-2 m/s2)",
        doubted=JUMPS,
    ),
    EventKind(
        name="lane_change",
        find=_lane_change,
        meaning=(
            "The ego's box centre comes from a lane to its neighbour and stays there for "
            f"{STAYS_S:g} s. From {CHANGE_S:g} s before to {CHANGE_S:g} s after; `what` is the "
            "side."
        ),
        measures="speed",
        unit="m/s",
        source="nuPlan's scenario tags (changing_lane)",
    ),
    EventKind(
        name="unprotected_turn",
        find=_unprotected_turn,
        meaning=(
            f"The ego turns by 45 degrees or more, tighter than {1.0 / TURN_KAPPA:g} m, where "
            f"lanes cross, and no stop line with a light lies on its way from {LIGHT_BEFORE_M:g} m "
            "before the turn. While its box is in the turn; `what` is the side."
        ),
        measures="angle, positive to the left",
        unit="rad",
        source=(
            "nuPlan's scenario tags (starting_unprotected_cross_turn, "
            "starting_unprotected_noncross_turn)"
        ),
    ),
    EventKind(
        name="merge",
        find=_merge,
        meaning=(
            "The ego comes to a lane into which another lane leads from about the same direction, "
            f"and a vehicle is on that other lane within {MERGE_S:g} s and {MERGE_M:g} m."
        ),
        measures="least distance of the centres",
        unit="m",
    ),
    EventKind(
        name="roundabout",
        find=_roundabout,
        meaning=(
            f"The ego is on a lane that is part of a circle of lanes of at most {ROUNDABOUT_M:g} m."
        ),
        measures="mean speed",
        unit="m/s",
    ),
    EventKind(
        name="red_light",
        find=_red_light,
        meaning=(
            f"A stop line with a red light lies up to {LIGHT_BEFORE_M:g} m ahead on the ego's "
            "path, for 0.5 s; `what` is the line."
        ),
        measures="least speed",
        unit="m/s",
        source="nuPlan's scenario tags (on_stopline_traffic_light)",
    ),
    EventKind(
        name="stop_sign",
        find=_stop_sign,
        meaning=(
            f"A stop line with a stop sign lies up to {STOP_BEFORE_M:g} m ahead on the ego's path; "
            "`what` is the line."
        ),
        measures="least speed",
        unit="m/s",
        source="nuPlan's scenario tags (on_stopline_stop_sign)",
    ),
    EventKind(
        name="crosswalk",
        find=_crosswalk,
        meaning=(
            "The ego's box is on a crosswalk; the agents are the pedestrians within 3 m of it; "
            "`what` is the crosswalk."
        ),
        measures="speed when it comes there",
        unit="m/s",
        source="nuPlan's scenario tags (traversing_crosswalk)",
    ),
)
