"""Which slower agents along the lane the path passes, and where.

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
an agent, the ego cannot turn back. Where an agent leaves too little room in the lane, the ego
passes it on the lane of the opposite direction (`oncoming_lane`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import atan2, cos, hypot, inf, isfinite, sin
from typing import NamedTuple

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.core.kernel import inner_kernel, kernel
from replan.logs.agents import AgentKind, among
from replan.logs.reference_line import line_project
from replan.planners.dp_qp.path.bounds import CorridorConfig, InTheWay, swing_span
from replan.planners.dp_qp.path.oncoming_lane import passed_by_oncoming_lane, widest_gaps
from replan.planners.frenet.path import interpolated
from replan.planners.frenet.profiles import STEP_S
from replan.planners.frenet.reference_path import CrossSections
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
ROAD_RIGHT = CrossSections._fields.index("road_right")  # Rows of `Scene.across`
ROAD_LEFT = CrossSections._fields.index("road_left")
ALONG_RAD = 0.4  # An agent whose heading differs more from the lane crosses it, rad
SLACK = 1.5  # Factor by which agents that the ego is passing may exceed `SLOW_MPS` and `ALONG_RAD`
GAIN_MPS2 = 1.2  # Assumed acceleration of an ego on a free road, m/s2
PLACE_M = 10.0  # The ego is back in its lane this far before a place where it may have to wait, m
REACH_M = 120.0  # Agents farther away are ignored, m
# Time before the end of the predictions by which the ego must be past agents that it begins to
# pass, s
SPARE_S = 1.0
SEARCH_M = 60.0  # An agent is searched on the line up to this far beyond the ego's last station, m


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


class _EgoPlace(NamedTuple):
    """The ego's position, m, and the station of its rear, m."""

    x: float
    y: float
    rear: float


def find_slow_agents(scene: Scene, passed: frozenset[str] = frozenset()) -> list[int]:
    """The agents ahead of the ego or beside it that walk or ride along the road in its direction.

    Agents that the ego is passing (`passed`) may be faster, or turn further aside, by the factor
    `SLACK`.
    """
    agents, ego = scene.frame.agents, scene.frame.ego
    may_be_passed = PASSED[agents.codes] & ~scene.standing
    if not may_be_passed.any() or not len(scene.frame.predictions.t):
        return []
    slack = np.array([SLACK if name in passed else 1.0 for name in agents.ids])
    place = _EgoPlace(ego.x, ego.y, scene.rear)
    along = _goes_along(
        may_be_passed, slack, scene.speed, scene.agents, scene.across, scene.bodies, place
    )
    return along.nonzero()[0].tolist()


@kernel
def _goes_along(
    may_be_passed: BoolArray,
    slack: FloatArray,
    speed: FloatArray,
    along: AgentsAlong,
    across: FloatArray,
    bodies: Bodies,
    ego: _EgoPlace,
) -> BoolArray:
    """Which of the agents `may_be_passed` `(n,)` move along the lane, each with its slack."""
    goes_along = np.zeros(len(may_be_passed), np.bool_)
    for i in range(len(may_be_passed)):
        is_near = hypot(bodies.x[i] - ego.x, bodies.y[i] - ego.y) < REACH_M
        half = 0.5 * bodies.length[i]
        is_slow = speed[i] <= slack[i] * SLOW_MPS
        if may_be_passed[i] and is_near and is_slow and along.s[i] + half > ego.rear:
            on_road = across[ROAD_RIGHT, i] - half < along.l[i] < across[ROAD_LEFT, i] + half
            turn = atan2(abs(along.v_l[i]), along.v_s[i])
            goes_along[i] = on_road and turn <= slack[i] * ALONG_RAD
    return goes_along


def pass_targets(
    scene: Scene, agents: Sequence[int], stations: FloatArray, passed: frozenset[str] = frozenset()
) -> tuple[PassTarget, ...]:
    """The boxes (2) of some agents, by index, for an ego at `stations` `(k,)` at the times of the
    predictions.

    Agents that the ego does not come beside, or does not pass before the last of these times, are
    left out; unless it is passing them already, it must be past them `SPARE_S` earlier.
    """
    all_agents, futures, car = scene.frame.agents, scene.futures, scene.vehicle
    line = _LaneLine(scene.reference.line.s, scene.reference.line.coef, scene.reference.line.yaw)
    t = np.arange(futures.t[0], futures.t[-1] + 1e-9, STEP_S)
    targets = []
    for i in agents:
        name = all_agents.ids[i]
        spare = 0.0 if name in passed else SPARE_S
        ego = Passer(t, stations, scene.s, car.axle_to_front, car.rear_overhang, spare)
        size = all_agents.length[i], all_agents.width[i]
        (s_from, s_to, l_from, l_to), (begin, end), places = _boxes_along(
            line, futures, i, size, ego
        )
        if isfinite(begin):
            # (2)
            box = Occupancy(name, s_from, s_to, l_from - ASIDE_M, l_to + ASIDE_M, aside=ASIDE_M)
            targets.append(PassTarget(i, box, begin, end, places))
    return tuple(sorted(targets, key=lambda target: (target.box.s_from, target.box.agent)))


class _LaneLine(NamedTuple):
    """A reference line for kernels: stations `(n,)`, m, coefficients, and headings `(n,)`, rad."""

    s: FloatArray
    coef: FloatArray
    yaw: FloatArray


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


class _Footprint(NamedTuple):
    """An agent at one time: its centre in the world and along the line, and half its extents along
    s and l, m.
    """

    x: float
    y: float
    s: float
    l: float
    half_s: float
    half_l: float


@inner_kernel
def _footprint(
    line: _LaneLine,
    futures: Futures,
    row: int,
    t: float,
    size: tuple[float, float],
    guess: float,
    reach: float,
) -> _Footprint:
    """An agent at time t of a prediction; its station is searched within `reach` of `guess`, m."""
    x, y = interpolated(t, futures.t, futures.x[row]), interpolated(t, futures.t, futures.y[row])
    s, l = line_project(line.s, line.coef, x, y, guess, reach)
    turn = interpolated(t, futures.t, futures.yaw[row]) - interpolated(s, line.s, line.yaw)
    c, d = abs(cos(turn)), abs(sin(turn))
    length, width = size
    return _Footprint(x, y, s, l, 0.5 * (c * length + d * width), 0.5 * (d * length + c * width))


@kernel
def _boxes_along(
    line: _LaneLine, futures: Futures, agent: int, size: tuple[float, float], ego: Passer
) -> tuple[tuple[float, float, float, float], tuple[float, float], FloatArray]:
    """(1) and (2) of an agent and its length and width, m.

    Returns:
        Least and greatest station and offset of the agent; first and last station of the ego beside
        it, infinite where the ego does not get there or is past it too late; the agent's positions
        then `(n, 2)`.
    """
    s_from, s_to = inf, -inf
    l_from, l_to = inf, -inf
    begin, end = inf, -inf
    places = np.empty((int((futures.agent == agent).sum()) * len(ego.t), 2))
    count = 0
    reach = interpolated(ego.t[-1], futures.t, ego.stations) - ego.start + SEARCH_M
    latest = ego.t[-1] - ego.spare - 0.5 * STEP_S
    for row in range(len(futures.agent)):
        if futures.agent[row] != agent or not futures.probability[row] > UNLIKELY:
            continue
        count_before, guess = count, ego.start
        first_axle, last_axle = inf, -inf
        now_from, now_to = 0.0, 0.0
        for k in range(len(ego.t)):
            body = _footprint(line, futures, row, ego.t[k], size, guess, reach)
            guess = body.s
            axle = interpolated(ego.t[k], futures.t, ego.stations)
            right, left = body.l - body.half_l, body.l + body.half_l
            if k == 0:
                now_from, now_to = right, left
            rear, front = body.s - body.half_s, body.s + body.half_s
            if axle + ego.front > rear - NEAR_M and axle - ego.rear < front:  # (1)
                if ego.t[k] > latest:
                    return (s_from, s_to, l_from, l_to), (inf, -inf), places[:0]
                s_from, s_to = min(s_from, rear), max(s_to, front)
                l_from, l_to = min(l_from, right), max(l_to, left)
                first_axle = axle if count == count_before else first_axle
                last_axle = axle
                places[count, 0], places[count, 1] = body.x, body.y
                count += 1
        if count == count_before:
            return (s_from, s_to, l_from, l_to), (inf, -inf), places[:0]
        l_from, l_to = min(l_from, now_from), max(l_to, now_to)
        begin, end = min(begin, first_axle), max(end, last_axle)
    return (s_from, s_to, l_from, l_to), (begin, end), places[:count]


def obstacles_to_pass(
    scene: Scene,
    targets: tuple[PassTarget, ...],
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
    for box in (target.box for target in targets):
        speed = 0.0 if box.agent in passed else scene.frame.ego.v
        begin, end = swing_span(box, speed, scene.vehicle)
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
    stations = np.empty(len(t))
    driven, speed_before = 0.0, v
    for k in range(len(t)):
        elapsed = t[k] - t[0]
        speed = min(max(limit, v - GAIN_MPS2 * elapsed), v + GAIN_MPS2 * elapsed)
        if k > 0:
            driven += 0.5 * (elapsed - (t[k - 1] - t[0])) * (speed + speed_before)
        stations[k] = s_ego + driven
        speed_before = speed
    return stations
