"""Pedestrians and cyclists along the lane, slower than the ego: where the path must pass them.

They move: where they are while the ego passes depends on its speed, and how fast it may pass (`caps.passing_caps`) on
the room that the path leaves them. So path and speed are found in turns (`lane.passing`). With s(t) the stations of the
ego's rear axle, as of the last plan,

(1) beside   = the times at which the ego's front is past their rear, less `NEAR_M`, and its rear not past their front
(2) box      = the stations and offsets at which they are predicted while the ego is beside them, and their offset now;
               `ASIDE_M` wider on both sides

Who cannot be passed within the predictions, or only near a place where lanes part or meet, the ego may have to wait or
others cross, is followed; beside them it is too late to turn back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import atan2, cos, hypot, inf, isfinite, sin

import numpy as np

from logs.agents import AgentKind, among
from logs.kernel import BoolArray, FloatArray, interpolated, kernel
from logs.road import line_project
from planners.dp_qp.path.bounds import CorridorConfig, InTheWay, swing_span
from planners.dp_qp.path.oncoming_lane import passed_by_oncoming_lane, widest_gaps
from planners.frenet.occupancy import Occupancy
from planners.frenet.profiles import STEP_S
from planners.frenet.reference_path import Section
from planners.frenet.scene import UNLIKELY, AgentsAlong, Bodies, Futures, Scene

PASSED = among(AgentKind.PEDESTRIAN, AgentKind.BICYCLE)
"""Who is passed while they go on, by their codes."""
SLOW_MPS = 7.0
"""Who is faster is followed, m/s."""
NEAR_M = 2.0
"""The ego is beside them from so far behind them on (1), m."""
ASIDE_M = 0.9
"""Room on both sides of them (2), m: with the path's usual clearance 1.5 m, as German law asks in towns (StVO, 5 (4));
where there is less, 1.15 m.

So much keeps a plan that passes them. Where they are beside the lane that is kept, `caps.passing_caps` alone says how
fast.
"""
ROAD_RIGHT, ROAD_LEFT = Section._fields.index("road_right"), Section._fields.index("road_left")
"""Rows of `Scene.across`."""
ALONG_RAD = 0.4
"""Who turns further aside crosses, rad."""
SLACK = 1.5
"""By this factor those that the ego is passing may be faster, or turn further."""
GAIN_MPS2 = 1.2
"""Acceleration of an ego with a free road ahead, m/s2."""
PLACE_M = 10.0
"""So far before a place at which it may have to wait the ego is back in its lane, m."""
REACH_M = 120.0
"""Who is farther is not looked at, m."""
SPARE_S = 1.0
"""So long before the predictions end the ego must be past those that it begins to pass, s."""


@dataclass(frozen=True, eq=False, slots=True)
class PassTarget:
    """A road user along the lane, slower than the ego, that is to be passed.

    Attributes:
        agent: Index into the frame's agents.
        box: The stations and offsets at which they are while the ego is beside them.
        begin: Station of the ego's rear axle at which it comes beside them, m; `end` at which it is past them.
        places: Where they are predicted meanwhile `(n, 2)`, m.
    """

    agent: int
    box: Occupancy
    begin: float
    end: float
    places: FloatArray


def along_lane(scene: Scene, passed: frozenset[str] = frozenset()) -> list[int]:
    """The agents ahead or beside who walk or ride along the road in the ego's direction.

    Those that the ego is passing (`passed`) may become faster by `SLACK`, or turn further aside, and still are among
    them.
    """
    agents, ego = scene.frame.agents, scene.frame.ego
    may = PASSED[agents.codes] & ~scene.standing
    if not may.any() or not len(scene.frame.predictions.t):
        return []
    slack = np.array([SLACK if name in passed else 1.0 for name in agents.ids]) if passed else np.ones(len(may))
    place = ego.x, ego.y, scene.rear
    return _goes_along(may, slack, scene.speed, scene.agents, scene.across, scene.bodies, place).nonzero()[0].tolist()


@kernel
def _goes_along(
    may: BoolArray, slack: FloatArray, speed: FloatArray, along: AgentsAlong, across: FloatArray, bodies: Bodies,
    ego: tuple[float, float, float],
) -> BoolArray:  # fmt: skip
    """Who of those that `may` goes along the lane `(n,)`, each with its slack; `ego` is x, y, station of the rear."""
    out = np.zeros(len(may), np.bool_)
    for i in range(len(may)):
        near, half = hypot(bodies.x[i] - ego[0], bodies.y[i] - ego[1]) < REACH_M, 0.5 * bodies.length[i]
        if may[i] and near and speed[i] <= slack[i] * SLOW_MPS and along.s[i] + half > ego[2]:
            on_road = across[ROAD_RIGHT, i] - half < along.l[i] < across[ROAD_LEFT, i] + half
            out[i] = on_road and atan2(abs(along.v_l[i]), along.v_s[i]) <= slack[i] * ALONG_RAD
    return out


def pass_targets(
    scene: Scene, who: Sequence[int], stations: FloatArray, passed: frozenset[str] = frozenset()
) -> tuple[PassTarget, ...]:
    """The boxes (2) of the agents `who`, for an ego at `stations` `(k,)` at the times of the predictions.

    Only of those that it comes beside, and is past before the last of these times; `SPARE_S` before, unless it is
    passing them already.
    """
    agents, futures, line, found = scene.frame.agents, scene.futures, scene.reference.line, []
    t = np.arange(futures.t[0], futures.t[-1] + 1e-9, STEP_S)
    ego = np.array([scene.s, scene.vehicle.axle_to_front, scene.vehicle.rear_overhang])
    for i in who:
        spare = 0.0 if agents.ids[i] in passed else SPARE_S
        (s_from, s_to, l_from, l_to), (begin, end), places = _boxed(
            line.s, line.coef, line.yaw, futures, t, stations, i, agents.length[i], agents.width[i], ego, spare
        )
        if isfinite(begin):
            box = Occupancy(agents.ids[i], s_from, s_to, l_from - ASIDE_M, l_to + ASIDE_M, aside=ASIDE_M)  # (2)
            found.append(PassTarget(i, box, begin, end, places))
    return tuple(sorted(found, key=lambda one: (one.box.s_from, one.box.agent)))


@kernel
def _boxed(
    knots: FloatArray, coef: FloatArray, line_yaw: FloatArray, futures: Futures, t: FloatArray, stations: FloatArray,
    agent: int, length: float, width: float, ego: FloatArray, spare: float,
) -> tuple[tuple[float, float, float, float], tuple[float, float], FloatArray]:  # fmt: skip
    """(1) and (2) of one agent.

    Args:
        knots: Of the reference line; `coef`, `line_yaw` likewise.
        coef: Likewise.
        line_yaw: Likewise.
        futures: The predictions, of all agents.
        t: The times that are looked at `(m,)`, s.
        stations: Of the ego at the times of the predictions, m.
        agent: Which.
        length: Of them, m.
        width: Of them, m.
        ego: Station of the start; from the rear axle to the front, to the rear, m `(3,)`.
        spare: So long before the last time the ego must be past them, s.

    Returns:
        Least and greatest station and offset; first and last station of the ego beside them, infinite where it does not
        come there or is past them too late; where they are then `(n, 2)`.
    """
    s_from, s_to, l_from, l_to, begin, end = inf, -inf, inf, -inf, inf, -inf
    m, n, times = len(t), 0, futures.t
    places = np.empty((int((futures.agent == agent).sum()) * m, 2))
    reach = interpolated(t[m - 1], times, stations) - ego[0] + 60.0
    for row in range(len(futures.agent)):
        if futures.agent[row] != agent or not futures.probability[row] > UNLIKELY:
            continue
        foot, before, first, last, now_from, now_to = ego[0], n, inf, -inf, 0.0, 0.0
        for k in range(m):
            at = t[k]
            px, py = interpolated(at, times, futures.x[row]), interpolated(at, times, futures.y[row])
            axle = interpolated(at, times, stations)
            foot, offset = line_project(knots, coef, px, py, foot, reach)
            turn = interpolated(at, times, futures.yaw[row]) - interpolated(foot, knots, line_yaw)
            c, s = abs(cos(turn)), abs(sin(turn))
            half_s, half_l = 0.5 * (c * length + s * width), 0.5 * (s * length + c * width)
            if k == 0:  # where they are now
                now_from, now_to = offset - half_l, offset + half_l
            if axle + ego[1] > foot - half_s - NEAR_M and axle - ego[2] < foot + half_s:  # (1)
                if at > t[m - 1] - spare - 0.5 * STEP_S:
                    return (s_from, s_to, l_from, l_to), (inf, -inf), places[:0]
                s_from, s_to = min(s_from, foot - half_s), max(s_to, foot + half_s)
                l_from, l_to = min(l_from, offset - half_l), max(l_to, offset + half_l)
                first, last = axle if n == before else first, axle
                places[n, 0], places[n, 1] = px, py
                n += 1
        if n == before:
            return (s_from, s_to, l_from, l_to), (inf, -inf), places[:0]
        l_from, l_to, begin, end = min(l_from, now_from), max(l_to, now_to), min(begin, first), max(end, last)
    return (s_from, s_to, l_from, l_to), (begin, end), places[:n]


def to_pass(
    scene: Scene, found: tuple[PassTarget, ...], stations: FloatArray, sides: tuple[bool, bool],
    config: CorridorConfig, places: tuple[float, ...], passed: frozenset[str] = frozenset(),
) -> InTheWay:  # fmt: skip
    """What the path stage is given, for an ego as in `pass_targets`.

    Args:
        scene: The scene.
        found: All who are slower; those who are to be passed too near to one of the `places` are left out.
        stations: Of the ego at the times of the predictions `(k,)`.
        sides: Whether the road left and right of the lane may be borrowed.
        config: Distances.
        places: Stations at which lanes part or meet, vehicles may have to wait, or others cross, m.
        passed: Those that the ego is passing already: it may be back in its lane nearer to a place.
    """
    boxes = []
    for box in (one.box for one in found):
        begin, end = swing_span(box, 0.0 if box.agent in passed else scene.frame.ego.v, scene.vehicle)
        too_late = scene.front > box.s_from  # to turn back: the ego is beside them
        if too_late or not any(begin < place < end + PLACE_M for place in places):
            boxes.append(box)
    room = scene.vehicle.width + 2.0 * config.min_clearance_m
    gaps = zip(boxes, widest_gaps(scene.reference, boxes), strict=True)
    narrow = tuple(box for box, gap in gaps if gap < room)
    return InTheWay(tuple(boxes), *sides, passed_by_oncoming_lane(scene, narrow, config, stations))


@kernel
def gone_on(t: FloatArray, s_ego: float, v: float, limit: float) -> FloatArray:
    """Stations at times `(k,)` from the first on of an ego that reaches a limit with `GAIN_MPS2` and keeps it."""
    out, total, before = np.empty(len(t)), 0.0, v
    for k in range(len(t)):
        at = t[k] - t[0]
        speed = min(max(limit, v - GAIN_MPS2 * at), v + GAIN_MPS2 * at)
        if k > 0:
            total += 0.5 * (at - (t[k - 1] - t[0])) * (speed + before)
        out[k], before = s_ego + total, speed
    return out
