"""Which moving or blocking agents the path passes, where, and on which lane.

Pedestrians and cyclists along the lane, slower than the ego: their position while the ego passes
    depends on the ego's speed, and the permitted speed (`caps.passing_caps`) depends on the room
    that the path leaves. Path and speed are therefore planned in turns (`choice`). With s(t) the
    stations of the ego's rear axle, as of the last plan,

(1) beside   = the times at which the ego's front is past their rear, less `NEAR_M`,
        and its rear not past their front
(2) box      = the stations and offsets at which they are predicted while the ego is beside them,
        and their offset now; `ASIDE_M` wider on both sides

The ego follows an agent that it cannot pass before the predictions end, or could pass only near a
place where lanes part or meet, where it may have to wait, or where others cross. Once it is beside
an agent, the ego cannot turn back.

An agent that blocks the lane and leaves no room on either side of the road, and is in no queue, is
passed on the lane of the opposite direction where the marking between may be crossed and, for the
whole stretch from where the ego leaves its lane to where it is back,

(3) no agent is predicted on the oncoming lane there until the ego is back, and `facing_margin_s`
    more; and no standing agent there leaves too little room for the ego, because more agents may be
    behind it,
(4) (BACK_M behind the obstacle - s) / max(v, PASSING_MPS) + facing_margin_s <= horizon
        of the predictions.

Otherwise the ego waits `WAIT_M` before it, from where it can still steer round it. For an agent
along the lane, (4) takes the time at which the plan reaches the place, and the sensor must

(5) see the oncoming lane far enough that a vehicle beyond it, at the speed limit, cannot violate
    (3) (StVO, 5 (2)).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import atan2, cos, hypot, inf, isfinite, sin
from typing import NamedTuple

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.core.kernel import kernel
from replan.logs.agents import AgentKind, among
from replan.logs.reference_line import line_project, line_project_many
from replan.logs.vehicle import VehicleParameters
from replan.planners.dp_qp.path.bounds import (
    CorridorConfig,
    InTheWay,
    PathBounds,
    side_gaps,
    swing_span,
)
from replan.planners.frenet.path import interpolated
from replan.planners.frenet.profiles import STEP_S
from replan.planners.frenet.reference_path import CrossSections, ReferencePath
from replan.planners.frenet.scene import UNLIKELY, AgentsAlong, Bodies, Futures, Occupancy, Scene

PASSED = among(AgentKind.PEDESTRIAN, AgentKind.BICYCLE)
"""The kinds of agents that the ego passes while they move, by code."""
SLOW_MPS = 7.0  # The ego follows faster agents, m/s
NEAR_M = 2.0  # Distance behind an agent from which the ego counts as beside it (1), m
ASIDE_M = 0.9
"""Space on both sides of an agent (2), m: with the path's clearance 1.5 m, as German law requires
in towns (StVO, 5 (4)); where there is less space, 1.15 m.

A plan that passes keeps this space. If the ego keeps its lane, only `caps.passing_caps` limits its
speed.
"""
ROAD_RIGHT, ROAD_LEFT = (
    CrossSections._fields.index("road_right"),
    CrossSections._fields.index("road_left"),
)
"""Rows of `Scene.across`."""
ALONG_RAD = 0.4  # An agent whose heading differs more from the lane crosses it, rad
SLACK = 1.5  # Factor by which agents that the ego is passing may exceed `SLOW_MPS` and `ALONG_RAD`
GAIN_MPS2 = 1.2  # Assumed acceleration of an ego on a free road, m/s2
PLACE_M = 10.0  # The ego is back in its lane this far before a place where it may have to wait, m
REACH_M = 120.0  # Agents farther away are ignored, m
# Time before the end of the predictions by which the ego must be past agents that it begins to
# pass, s
SPARE_S = 1.0
PASSING_MPS = 5.0  # Least assumed speed while passing (4), m/s
BACK_M = 10.0  # The ego is back in its lane this far behind the obstacle (4), m
WAIT_M = 9.0  # Gap between the waiting ego's front and the obstacle, m; enough to steer round it
NEARLY_M = 1.0  # A gap that is wider than the ego by less than this may be blocked, m
SIGHT_M = 5.0  # Distance between two points of the oncoming lane that must be visible, m
QUEUE_M = 25.0  # An obstacle nearer than this to another one in the lane stands in a queue, m
ROOM_M = 0.5  # The ego waits for the oncoming lane only if that leaves this much space beside it, m


@dataclass(frozen=True, eq=False, slots=True)
class PassTarget:
    """A road user along the lane, slower than the ego, that the ego passes: its index, and its
    positions meanwhile.

    `box` is the part of the lane that it takes while the ego is beside it; `begin` and `end` are
    the first and last station of the ego's rear axle then, m; `places` its positions `(n, 2)`, m.
    """

    agent: int
    box: Occupancy
    begin: float
    end: float
    places: FloatArray


def find_slow_agents(scene: Scene, passed: frozenset[str] = frozenset()) -> list[int]:
    """The agents ahead of the ego or beside it that walk or ride along the road in its direction.

    Agents that the ego is passing (`passed`) may be faster, or turn further aside, by the factor
    `SLACK`.
    """
    agents, ego = scene.frame.agents, scene.frame.ego
    may = PASSED[agents.codes] & ~scene.standing
    if not may.any() or not len(scene.frame.predictions.t):
        return []
    slack = (
        np.array([SLACK if name in passed else 1.0 for name in agents.ids])
        if passed
        else np.ones(len(may))
    )
    place = ego.x, ego.y, scene.rear
    return (
        _goes_along(may, slack, scene.speed, scene.agents, scene.across, scene.bodies, place)
        .nonzero()[0]
        .tolist()
    )


@kernel
def _goes_along(
    may: BoolArray,
    slack: FloatArray,
    speed: FloatArray,
    along: AgentsAlong,
    across: FloatArray,
    bodies: Bodies,
    ego: tuple[float, float, float],
) -> BoolArray:
    """Which of the agents `may` `(n,)` move along the lane, each with its slack; `ego` is x, y,
    station of the rear.
    """
    out = np.zeros(len(may), np.bool_)
    for i in range(len(may)):
        near, half = (
            hypot(bodies.x[i] - ego[0], bodies.y[i] - ego[1]) < REACH_M,
            0.5 * bodies.length[i],
        )
        if may[i] and near and speed[i] <= slack[i] * SLOW_MPS and along.s[i] + half > ego[2]:
            on_road = across[ROAD_RIGHT, i] - half < along.l[i] < across[ROAD_LEFT, i] + half
            out[i] = on_road and atan2(abs(along.v_l[i]), along.v_s[i]) <= slack[i] * ALONG_RAD
    return out


def pass_targets(
    scene: Scene, who: Sequence[int], stations: FloatArray, passed: frozenset[str] = frozenset()
) -> tuple[PassTarget, ...]:
    """The boxes (2) of the agents `who`, for an ego at `stations` `(k,)` at the times of the
    predictions.

    Agents that the ego does not come beside, or does not pass before the last of these times, are
    left out; unless it is passing them already, it must be past them `SPARE_S` earlier.
    """
    agents, futures, line, car, found = (
        scene.frame.agents,
        scene.futures,
        scene.reference.line,
        scene.vehicle,
        [],
    )
    t = np.arange(futures.t[0], futures.t[-1] + 1e-9, STEP_S)
    for i in who:
        spare = 0.0 if agents.ids[i] in passed else SPARE_S
        ego = Passer(t, stations, scene.s, car.axle_to_front, car.rear_overhang, spare)
        (s_from, s_to, l_from, l_to), (begin, end), places = _boxes_along(
            line.s, line.coef, line.yaw, futures, i, (agents.length[i], agents.width[i]), ego
        )
        if isfinite(begin):
            # (2)
            box = Occupancy(
                agents.ids[i], s_from, s_to, l_from - ASIDE_M, l_to + ASIDE_M, aside=ASIDE_M
            )
            found.append(PassTarget(i, box, begin, end, places))
    return tuple(sorted(found, key=lambda one: (one.box.s_from, one.box.agent)))


class Passer(NamedTuple):
    """The ego that passes: the times to evaluate `(m,)`, s, and its stations at the times of the
    predictions, m.

    Its station now, the distances from its rear axle to its front and to its rear, m; the time
    before the last one by which it must be past the agents, s.
    """

    t: FloatArray
    stations: FloatArray
    start: float
    front: float
    rear: float
    spare: float


@kernel
def _boxes_along(
    knots: FloatArray,
    coef: FloatArray,
    line_yaw: FloatArray,
    futures: Futures,
    agent: int,
    size: tuple[float, float],
    ego: Passer,
) -> tuple[tuple[float, float, float, float], tuple[float, float], FloatArray]:
    """(1) and (2) of an agent and its length and width, m, along a reference line's `knots`, `coef`
    and headings.

    Returns:
        Least and greatest station and offset of the agent; first and last station of the ego beside
        it, infinite where the ego does not get there or is past it too late; the agent's positions
        then `(n, 2)`.
    """
    s_from, s_to, l_from, l_to, begin, end = inf, -inf, inf, -inf, inf, -inf
    t, stations, (length, width) = ego.t, ego.stations, size
    m, n, times = len(t), 0, futures.t
    places = np.empty((int((futures.agent == agent).sum()) * m, 2))
    reach = interpolated(t[m - 1], times, stations) - ego.start + 60.0
    for row in range(len(futures.agent)):
        if futures.agent[row] != agent or not futures.probability[row] > UNLIKELY:
            continue
        foot, before, first, last, now_from, now_to = ego.start, n, inf, -inf, 0.0, 0.0
        for k in range(m):
            at = t[k]
            px, py = (
                interpolated(at, times, futures.x[row]),
                interpolated(at, times, futures.y[row]),
            )
            axle = interpolated(at, times, stations)
            foot, offset = line_project(knots, coef, px, py, foot, reach)
            turn = interpolated(at, times, futures.yaw[row]) - interpolated(foot, knots, line_yaw)
            c, s = abs(cos(turn)), abs(sin(turn))
            half_s, half_l = 0.5 * (c * length + s * width), 0.5 * (s * length + c * width)
            if k == 0:  # the present position
                now_from, now_to = offset - half_l, offset + half_l
            if axle + ego.front > foot - half_s - NEAR_M and axle - ego.rear < foot + half_s:  # (1)
                if at > t[m - 1] - ego.spare - 0.5 * STEP_S:
                    return (s_from, s_to, l_from, l_to), (inf, -inf), places[:0]
                s_from, s_to = min(s_from, foot - half_s), max(s_to, foot + half_s)
                l_from, l_to = min(l_from, offset - half_l), max(l_to, offset + half_l)
                first, last = axle if n == before else first, axle
                places[n, 0], places[n, 1] = px, py
                n += 1
        if n == before:
            return (s_from, s_to, l_from, l_to), (inf, -inf), places[:0]
        l_from, l_to, begin, end = (
            min(l_from, now_from),
            max(l_to, now_to),
            min(begin, first),
            max(end, last),
        )
    return (s_from, s_to, l_from, l_to), (begin, end), places[:n]


def obstacles_to_pass(
    scene: Scene,
    found: tuple[PassTarget, ...],
    stations: FloatArray,
    sides: tuple[bool, bool],
    config: CorridorConfig,
    places: tuple[float, ...],
    passed: frozenset[str] = frozenset(),
) -> InTheWay:
    """The input of the path stage, for an ego as in `pass_targets`.

    Agents that the ego would pass too near to one of the `places`, m, are left out; for an agent
    that it is passing already, the ego may be back in its lane nearer to one. `sides`: whether the
    ego may borrow the road left and right.
    """
    boxes = []
    for box in (one.box for one in found):
        begin, end = swing_span(
            box, 0.0 if box.agent in passed else scene.frame.ego.v, scene.vehicle
        )
        too_late = scene.front > box.s_from  # to turn back: the ego is beside the agent
        if too_late or not any(begin < place < end + PLACE_M for place in places):
            boxes.append(box)
    room = scene.vehicle.width + 2.0 * config.min_clearance_m
    gaps = zip(boxes, widest_gaps(scene.reference, boxes), strict=True)
    narrow = tuple(box for box, gap in gaps if gap < room)
    return InTheWay(tuple(boxes), *sides, passed_by_oncoming_lane(scene, narrow, config, stations))


@kernel
def free_stations(t: FloatArray, s_ego: float, v: float, limit: float) -> FloatArray:
    """Stations at times `(k,)` from the first on of an ego that reaches a limit with `GAIN_MPS2`
    and keeps it.
    """
    out, total, before = np.empty(len(t)), 0.0, v
    for k in range(len(t)):
        at = t[k] - t[0]
        speed = min(max(limit, v - GAIN_MPS2 * at), v + GAIN_MPS2 * at)
        if k > 0:
            total += 0.5 * (at - (t[k - 1] - t[0])) * (speed + before)
        out[k], before = s_ego + total, speed
    return out


def widest_gaps(
    reference: ReferencePath, boxes: Sequence[Occupancy], *, oncoming: bool = False
) -> list[float]:
    """The gap between each box and the road's edge at the box's middle, on the wider side, m."""
    if not boxes:
        return []
    road = reference.at(np.array([box.s_middle for box in boxes]))
    left, right = (
        (road.facing_left, road.facing_right) if oncoming else (road.road_left, road.road_right)
    )
    edges = zip(boxes, left.tolist(), right.tolist(), strict=True)
    return [max(most - box.l_to, box.l_from - least) for box, most, least in edges]


def may_block(scene: Scene, obstacles: Sequence[Occupancy]) -> bool:
    """Whether an agent leaves less than the ego's width on both sides of the road, or nearly."""
    return (
        min(widest_gaps(scene.reference, obstacles), default=np.inf)
        < scene.vehicle.width + NEARLY_M
    )


def find_blocking(
    obstacles: tuple[Occupancy, ...],
    space: PathBounds,
    vehicle: VehicleParameters,
    config: CorridorConfig,
) -> tuple[Occupancy, ...]:
    """The obstacles that leave the ego no room on either side of the road, without those in a
    queue.
    """
    found = []
    for box, (lower, upper) in zip(obstacles, space.room(obstacles, vehicle, config), strict=True):
        touches = (
            lower < box.l_to + 0.5 * vehicle.width and upper > box.l_from - 0.5 * vehicle.width
        )
        queue = any(
            other is not box
            and max(other.s_from - box.s_to, box.s_from - other.s_to) < QUEUE_M
            and other.l_from < upper
            and other.l_to > lower
            for other in obstacles
        )
        if (
            touches
            and max(side_gaps(box, lower, upper, vehicle)) < config.min_clearance_m
            and not queue
        ):
            found.append(box)
    return tuple(found)


def passed_by_oncoming_lane(
    scene: Scene,
    blocked: tuple[Occupancy, ...],
    config: CorridorConfig,
    stations: FloatArray | None = None,
) -> frozenset[str]:
    """The agents that the ego may pass on the oncoming lane: it stays free until the ego is back,
    and some time more.

    The time is that of an ego at `stations` `(k,)` at the times of the predictions; None: of one
    that drives at least `PASSING_MPS`. It must not be longer than the predictions. An ego beside
    the obstacle can no longer turn back.
    """
    if not blocked:
        return frozenset()
    frame, car, line = scene.frame, scene.vehicle, scene.reference.line
    futures, v = frame.predictions, max(frame.ego.v, PASSING_MPS)
    names, agents = {box.agent for box in blocked}, frame.agents
    others, widest = (
        np.array([name not in names for name in agents.ids], bool),
        float(agents.width.max(initial=2.0)),
    )
    found = []
    for box in blocked:
        begin, end = swing_span(box, frame.ego.v, car)
        place = box.s_to + car.rear_overhang + BACK_M
        lasts = (place - scene.s) / v  # (4)
        if stations is not None:
            is_reached = len(futures.t) > 0 and stations[-1] >= place
            lasts = (
                float(futures.t[np.argmax(stations >= place)] - frame.t) if is_reached else np.inf
            )
        back = frame.t + lasts + config.facing_margin_s
        if scene.front < box.s_from:
            if not len(futures.t) or back > futures.t[-1]:
                continue
            aside = np.abs(scene.agents.l - 0.5 * (box.l_from + box.l_to)) - 0.5 * (
                box.l_to - box.l_from
            )
            fits = scene.standing & (
                aside - 0.5 * agents.width > car.width + 2.0 * config.min_clearance_m
            )
            now, rows = futures.t <= back, (others & ~fits)[futures.agent]
            x, y = futures.x[rows][:, now].ravel(), futures.y[rows][:, now].ravel()
            near = np.hypot(x - frame.ego.x, y - frame.ego.y) < end - scene.s + 30.0
            s, l = line_project_many(line.s, line.coef, x[near], y[near], scene.s, 250.0).T
            road, side = scene.reference.at(s), 0.5 * widest
            on_left = (
                (road.facing_left > road.road_left)
                & (l > road.road_left - side)
                & (l < road.facing_left)
            )
            on_right = (
                (road.facing_right < road.road_right)
                & (l < road.road_right + side)
                & (l > road.facing_right)
            )
            on_way = (s > min(scene.s, begin) - widest) & (s < end + 10.0)
            if ((on_left | on_right) & on_way).any():  # (3)
                continue
            if stations is not None and not _in_sight(scene, place, back - frame.t):  # (5)
                continue
        found.append(box.agent)
    return frozenset(found)


def _in_sight(scene: Scene, place: float, lasts: float) -> bool:
    """Whether (5) holds for an ego that is back in its lane at a place (m) and safe after `lasts`
    s.
    """
    view, reference = scene.frame.visibility, scene.reference
    if view is None:
        return True
    limit = float(np.interp(place, reference.line.s, reference.limit))
    s = np.arange(scene.s + SIGHT_M, place + limit * lasts, SIGHT_M)
    s = s[s < reference.line.s[-1]]
    road = reference.at(s)
    by_left = road.facing_left > road.road_left
    middle = (
        np.where(by_left, road.road_left + road.facing_left, road.road_right + road.facing_right)
        / 2.0
    )
    points = [
        reference.line.point(float(at), float(aside)) for at, aside in zip(s, middle, strict=True)
    ]
    return not view.hides(np.reshape(points, (-1, 2))).any()


def waiting_place(scene: Scene, blocked: tuple[Occupancy, ...], passed: frozenset[str]) -> float:
    """Station of the rear axle to wait at for the oncoming lane, m.

    Inf if there is none or no need to wait.
    """
    car, waits = scene.vehicle, [box for box in blocked if box.agent not in passed]
    gaps = widest_gaps(scene.reference, waits, oncoming=True)
    places = [
        box.s_from - car.axle_to_front - WAIT_M
        for box, gap in zip(waits, gaps, strict=True)
        if gap > car.width + ROOM_M
    ]
    return min(places, default=np.inf)
