"""Who goes along the lane on foot or by bicycle, slower than the ego: where the path must pass him, and how fast.

He moves: where he is while the ego passes depends on its speed, and how fast it may pass on the room that the path
leaves him. So path and speed are found in turns (`passing`). With s(t) the stations of the ego's rear axle, as of the
last plan,

(1) beside   = the times at which the ego's front is past his rear, less `NEAR_M`, and its rear not past his front
(2) box      = the stations and offsets at which he is predicted while the ego is beside him, and his offset now;
               `ASIDE_M` wider on both sides
(3) v       <= max(2 b (d / w - T), `LEAST_MPS`) beside him and as far before as it takes to stop       (`sight`, (3))

d is the room that the path leaves him, w how fast he may come into the way: then the ego either is past him or stops
before him wherever he does. (The speed stage may exceed a limit by `SPEED_ROOM_MPS`, which is taken off.)

(4) v       <= sqrt(`SWERVE_MPS2` / |kappa - kappa_r|)      where the path swerves from the reference line

Who cannot be passed within the predictions, or only near a place where lanes part or meet, the ego may have to wait or
others cross, is followed; beside him it is too late to turn back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from logs.frame import Frame
from logs.kernel import FloatArray
from logs.road import line_project_many
from logs.scenario import AgentKind
from logs.trace import Decision, DecisionKind
from logs.vehicle import VehicleParameters
from planners.dp_qp.path.bounds import STANDING_MPS, CorridorConfig, PathObstacle, swing_span
from planners.dp_qp.path.oncoming_lane import passed_facing
from planners.dp_qp.scene.occlusion import LEAST_MPS, REACTION_S, WALK_MPS
from planners.dp_qp.speed.stage import SPEED_ROOM_MPS
from planners.frenet.path import Path
from planners.frenet.reference_path import ReferencePath

SLOW_MPS = 7.0
"""Who is faster is followed."""
NEAR_M = 2.0
"""The ego is beside him from so far behind him on."""
ASIDE_M = 0.9
"""With the path's usual clearance 1.5 m, as German law asks in towns (StVO, 5 (4)); where there is less, 1.15 m.

So much keeps a plan that passes him. Where he is beside the lane that is kept, (3) alone says how fast.
"""
ALONG_RAD = 0.4
"""Who turns further aside crosses."""
SWERVE_MPS = 0.8
"""How fast who rides may come into the way; who walks with `WALK_MPS`."""
SLACK = 1.5
"""By this factor whom the ego is passing may be faster, or turn further."""
UNLIKELY = 0.2
"""A hypothesis that is not more probable than this is left to the S-T graph."""
GAIN_MPS2 = 1.2
"""Acceleration of an ego that nobody holds up."""
PLACE_M = 10.0
"""So far before a place at which it may have to wait the ego is back in its lane."""
REACH_M = 120.0
"""Who is farther is not looked at."""
GRID_S = 0.1
"""Predictions are looked at every so often, however coarse they are."""
SPARE_S = 1.0
"""So long before the predictions end the ego must be past whom it begins to pass."""
SWERVE_MPS2 = 1.6
"""Lateral acceleration of a swerve round somebody who could be followed instead."""


@dataclass(frozen=True, eq=False, slots=True)
class PassTarget:
    """Somebody to be passed.

    Attributes:
        agent: Index into the frame's agents.
        box: (2).
        begin: Station of the ego's rear axle at which it comes beside him, m; `end` at which it is past him.
        places: Where he is predicted meanwhile `(n, 2)`, m.
    """

    agent: int
    box: PathObstacle
    begin: float
    end: float
    places: FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class Movers:
    """What the path stage is told of them: whom to pass, on which sides, and for whom the facing lane is free."""

    boxes: tuple[PathObstacle, ...] = ()
    left: bool = True
    right: bool = True
    facing: frozenset[str] = frozenset()


NOBODY = Movers()


def along_lane(
    course: ReferencePath, frame: Frame, s_ego: float, vehicle: VehicleParameters, passed: frozenset[str] = frozenset()
) -> list[int]:
    """The agents ahead or beside who walk or ride along the road in the ego's direction.

    Whom the ego is passing (`passed`) may become faster by `SLACK`, or turn further aside, before he is not among them.
    """
    agents, line, found = frame.agents, course.line, []
    if not len(frame.predictions.t):
        return []
    near = np.hypot(agents.x - frame.ego.x, agents.y - frame.ego.y) < REACH_M
    kinds = AgentKind.PEDESTRIAN, AgentKind.BICYCLE
    for i in np.flatnonzero(near & (agents.speed >= STANDING_MPS)):
        slack = SLACK if agents.ids[i] in passed else 1.0
        if agents.kinds[i] not in kinds or agents.speed[i] > slack * SLOW_MPS:
            continue
        s, l = line.project(float(agents.x[i]), float(agents.y[i]), s_ego, REACH_M)  # noqa: E741
        yaw = line.frame(s)[2]
        along = float(agents.vx[i] * np.cos(yaw) + agents.vy[i] * np.sin(yaw))
        across = float(agents.vy[i] * np.cos(yaw) - agents.vx[i] * np.sin(yaw))
        _, right, _, _, left, _, _, _ = course.at(np.array([s]))[:, 0]
        half = 0.5 * float(agents.length[i])
        on_road = right - half < l < left + half
        if on_road and s + half > s_ego - vehicle.rear_overhang and np.arctan2(abs(across), along) <= slack * ALONG_RAD:
            found.append(int(i))
    return found


def slower(
    course: ReferencePath, frame: Frame, s_ego: float, who: Sequence[int], stations: FloatArray,
    vehicle: VehicleParameters, passed: frozenset[str] = frozenset(),
) -> tuple[PassTarget, ...]:  # fmt: skip
    """The boxes (2) of the agents `who`, for an ego at `stations` `(k,)` at the times of the predictions.

    Only of those whom it is past before the last of these times; `SPARE_S` before, unless it is passing them already.
    """
    spare = [0.0 if frame.agents.ids[i] in passed else SPARE_S for i in who]
    found = [_slower(course, frame, s_ego, i, stations, vehicle, each) for i, each in zip(who, spare, strict=True)]
    ready = [one for one in found if one is not None]
    return tuple(sorted(ready, key=lambda one: (one.box.s_from, one.box.agent)))


def _slower(
    course: ReferencePath,
    frame: Frame,
    s_ego: float,
    i: int,
    stations: FloatArray,
    vehicle: VehicleParameters,
    spare: float,
) -> PassTarget | None:
    """(1) and (2) of one agent; None where the ego does not come beside him, or is past him too late."""
    agents, futures, line = frame.agents, frame.predictions, course.line
    t = np.arange(futures.t[0], futures.t[-1] + 1e-9, GRID_S)
    ego = np.interp(t, futures.t, stations)
    size = np.array([agents.length[i], agents.width[i]])
    lowest, highest = np.full(2, np.inf), np.full(2, -np.inf)  # station and offset
    begin, end, places = np.inf, -np.inf, [np.empty((0, 2))]
    for row in np.flatnonzero((futures.agent == i) & (futures.probability > UNLIKELY)):
        x, y, yaw = (np.interp(t, futures.t, way[row]) for way in (futures.x, futures.y, futures.yaw))
        feet = line_project_many(line.s, line.coef, x, y, s_ego, ego[-1] - s_ego + 60.0)
        turn = yaw - np.interp(feet[:, 0], line.s, line.yaw)
        c, s = np.abs(np.cos(turn))[:, None], np.abs(np.sin(turn))[:, None]
        half = 0.5 * np.hstack([c * size[0] + s * size[1], s * size[0] + c * size[1]])
        low, high = feet - half, feet + half
        beside = (ego + vehicle.axle_to_front > low[:, 0] - NEAR_M) & (ego - vehicle.rear_overhang < high[:, 0])
        past_him_in_time = not beside[t > t[-1] - spare - 0.5 * GRID_S].any()
        if not beside.any() or not past_him_in_time:
            return None
        lowest, highest = np.minimum(lowest, low[beside].min(axis=0)), np.maximum(highest, high[beside].max(axis=0))
        lowest[1], highest[1] = min(lowest[1], low[0, 1]), max(highest[1], high[0, 1])  # and where he is now
        begin, end = min(begin, float(ego[beside][0])), max(end, float(ego[beside][-1]))
        places.append(np.column_stack([x[beside], y[beside]]))
    if not np.isfinite(begin):
        return None
    s_from, s_to = float(lowest[0]), float(highest[0])
    l_from, l_to = float(lowest[1]) - ASIDE_M, float(highest[1]) + ASIDE_M
    box = PathObstacle(agents.ids[i], s_from, s_to, l_from, l_to, aside=ASIDE_M)
    return PassTarget(i, box, begin, end, np.vstack(places))


def movers(
    course: ReferencePath, frame: Frame, s_ego: float, found: tuple[PassTarget, ...], stations: FloatArray,
    sides: tuple[bool, bool], vehicle: VehicleParameters, config: CorridorConfig, places: tuple[float, ...],
    passed: frozenset[str] = frozenset(),
) -> Movers:  # fmt: skip
    """What the path stage is told, for an ego as in `slower`.

    Args:
        course: The lane.
        frame: The scene.
        s_ego: Station of the ego, m.
        found: All who are slower; those who are to be passed too near to one of the `places` are left out.
        stations: Of the ego at the times of the predictions `(k,)`.
        sides: Whether the road left and right of the lane may be borrowed.
        vehicle: The ego.
        config: Distances.
        places: Stations at which lanes part or meet, somebody may have to wait, or others cross, m.
        passed: Whom the ego is passing already: it may be back in its lane nearer to a place.
    """
    front = s_ego + vehicle.axle_to_front
    boxes = tuple(
        one.box
        for one in found
        if front > one.box.s_from  # beside him it is too late
        or not _near_place(places, one.box, 0.0 if one.box.agent in passed else frame.ego.v, vehicle)
    )
    narrow = tuple(box for box in boxes if _room(course, box) < vehicle.width + 2.0 * config.min_clearance_m)
    return Movers(boxes, *sides, passed_facing(course, frame, s_ego, narrow, vehicle, config, stations))


def _near_place(places: tuple[float, ...], box: PathObstacle, speed: float, vehicle: VehicleParameters) -> bool:
    begin, end = swing_span(box, speed, vehicle)
    return any(begin < place < end + PLACE_M for place in places)


def _room(course: ReferencePath, box: PathObstacle) -> float:
    """Between the box and the road's edge, on the side where there is more, m."""
    _, right, _, _, left, _, _, _ = course.at(np.array([0.5 * (box.s_from + box.s_to)]))[:, 0]
    return float(max(left - box.l_to, box.l_from - right))


def beside_limit(
    path: Path, limit: FloatArray, frame: Frame, found: tuple[PassTarget, ...], vehicle: VehicleParameters,
    decel: float, margin: float,
) -> tuple[FloatArray, tuple[Decision, ...]]:  # fmt: skip
    """The speed limit `(m,)` along a path with (3) in it, and for whom; b is `decel`, m/s2.

    To whom the path comes nearer than `margin`, m, is followed: he is in the S-T graph.
    """
    out, told, agents = limit, [], frame.agents
    for one in found:
        at = (path.s > one.begin - NEAR_M) & (path.s < one.end + NEAR_M)
        if not at.any():
            continue
        away = np.hypot(path.x[at, None] - one.places[:, 0], path.y[at, None] - one.places[:, 1])
        d = float(away.min()) - 0.5 * float(vehicle.width + agents.width[one.agent])
        if d < margin:
            continue
        w = SWERVE_MPS if agents.kinds[one.agent] is AgentKind.BICYCLE else WALK_MPS
        v = max(2.0 * decel * (d / w - REACTION_S) - SPEED_ROOM_MPS, LEAST_MPS)
        stops = v * REACTION_S + v * v / (2.0 * decel)
        at = (path.s > one.begin - stops) & (path.s < one.end + NEAR_M)
        if v < float(limit[at].min()):
            reason = (
                f"goes along the lane: passed with {d:.1f} m and at {v:.1f} m/s, so that the ego could stop for him"
            )
            told.append(Decision(agents.ids[one.agent], DecisionKind.YIELD, "speed", reason))
        out = np.where(at, np.minimum(out, v), out)
    return out, tuple(told)


def swerve_limit(path: Path, limit: FloatArray, course: ReferencePath) -> FloatArray:
    """The speed limit `(m,)` along a path with (4) in it."""
    swerve = np.abs(path.kappa - np.interp(path.s, course.line.s, course.line.kappa))
    return np.minimum(limit, np.sqrt(SWERVE_MPS2 / np.maximum(swerve, 1e-6)))


def gone_on(t: FloatArray, s_ego: float, v: float, limit: float) -> FloatArray:
    """Stations at times `(k,)` from the first on of an ego that reaches a limit with `GAIN_MPS2` and keeps it."""
    at = t - t[0]
    speed = np.clip(limit, v - GAIN_MPS2 * at, v + GAIN_MPS2 * at)
    return s_ego + np.r_[0.0, np.cumsum(0.5 * np.diff(at) * (speed[1:] + speed[:-1]))]
