"""Who goes along the lane on foot or by bicycle, slower than the ego: where the path must pass them.

They move: where they are while the ego passes depends on its speed, and how fast it may pass (`passing_speed`) on the
room that the path leaves them. So path and speed are found in turns (`lane.passing`). With s(t) the stations of the
ego's rear axle, as of the last plan,

(1) beside   = the times at which the ego's front is past their rear, less `NEAR_M`, and its rear not past their front
(2) box      = the stations and offsets at which they are predicted while the ego is beside them, and their offset now;
               `ASIDE_M` wider on both sides

Who cannot be passed within the predictions, or only near a place where lanes part or meet, the ego may have to wait or
others cross, is followed; beside them it is too late to turn back.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from logs.kernel import FloatArray
from logs.road import line_project_many
from logs.scenario import AgentKind
from logs.vehicle import VehicleParameters
from planners.dp_qp.path.bounds import CorridorConfig, InTheWay, swing_span
from planners.dp_qp.path.oncoming_lane import passed_by_oncoming_lane, widest_gap
from planners.dp_qp.scene.pass_target import PassTarget
from planners.frenet.occupancy import Occupancy
from planners.frenet.profiles import STEP_S
from planners.frenet.scene import UNLIKELY, Scene

KINDS = AgentKind.PEDESTRIAN, AgentKind.BICYCLE
"""Who is passed while they go on."""
SLOW_MPS = 7.0
"""Who is faster is followed, m/s."""
NEAR_M = 2.0
"""The ego is beside them from so far behind them on (1), m."""
ASIDE_M = 0.9
"""Room on both sides of them (2), m: with the path's usual clearance 1.5 m, as German law asks in towns (StVO, 5 (4));
where there is less, 1.15 m.

So much keeps a plan that passes them. Where they are beside the lane that is kept, `passing_speed` alone says how fast.
"""
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


def along_lane(scene: Scene, passed: frozenset[str] = frozenset()) -> list[int]:
    """The agents ahead or beside who walk or ride along the road in the ego's direction.

    Those that the ego is passing (`passed`) may become faster by `SLACK`, or turn further aside, and still are among
    them.
    """
    agents, along, found = scene.frame.agents, scene.agents, []
    if not len(scene.frame.predictions.t):
        return []
    near = np.hypot(agents.x - scene.frame.ego.x, agents.y - scene.frame.ego.y) < REACH_M
    for i in np.flatnonzero(near & ~scene.standing & scene.vulnerable):
        slack = SLACK if agents.ids[i] in passed else 1.0
        if agents.kinds[i] not in KINDS or scene.speed[i] > slack * SLOW_MPS:
            continue
        road, half = scene.reference.at(along.s[i : i + 1]), 0.5 * float(agents.length[i])
        on_road = road.road_right[0] - half < along.l[i] < road.road_left[0] + half
        turned = np.arctan2(abs(along.v_l[i]), along.v_s[i])
        if on_road and along.s[i] + half > scene.rear and turned <= slack * ALONG_RAD:
            found.append(int(i))
    return found


def pass_targets(
    scene: Scene, who: Sequence[int], stations: FloatArray, passed: frozenset[str] = frozenset()
) -> tuple[PassTarget, ...]:
    """The boxes (2) of the agents `who`, for an ego at `stations` `(k,)` at the times of the predictions.

    Only of those that it is past before the last of these times; `SPARE_S` before, unless it is passing them already.
    """
    spare = [0.0 if scene.frame.agents.ids[i] in passed else SPARE_S for i in who]
    found = [_target(scene, i, stations, each) for i, each in zip(who, spare, strict=True)]
    ready = [one for one in found if one is not None]
    return tuple(sorted(ready, key=lambda one: (one.box.s_from, one.box.agent)))


def _target(scene: Scene, i: int, stations: FloatArray, spare: float) -> PassTarget | None:
    """(1) and (2) of one agent; None where the ego does not come beside them, or is past them too late."""
    agents, futures, line = scene.frame.agents, scene.frame.predictions, scene.reference.line
    vehicle, s_ego = scene.vehicle, scene.s
    t = np.arange(futures.t[0], futures.t[-1] + 1e-9, STEP_S)
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
        beside = (ego + vehicle.axle_to_front > low[:, 0] - NEAR_M) & (ego - vehicle.rear_overhang < high[:, 0])  # (1)
        past_in_time = not beside[t > t[-1] - spare - 0.5 * STEP_S].any()
        if not beside.any() or not past_in_time:
            return None
        lowest, highest = np.minimum(lowest, low[beside].min(axis=0)), np.maximum(highest, high[beside].max(axis=0))
        lowest[1], highest[1] = min(lowest[1], low[0, 1]), max(highest[1], high[0, 1])  # and where they are now
        begin, end = min(begin, float(ego[beside][0])), max(end, float(ego[beside][-1]))
        places.append(np.column_stack([x[beside], y[beside]]))
    if not np.isfinite(begin):
        return None
    s_from, s_to = float(lowest[0]), float(highest[0])
    l_from, l_to = float(lowest[1]) - ASIDE_M, float(highest[1]) + ASIDE_M
    box = Occupancy(agents.ids[i], s_from, s_to, l_from, l_to, aside=ASIDE_M)  # (2)
    return PassTarget(i, box, begin, end, np.vstack(places))


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
    boxes = tuple(
        one.box
        for one in found
        if scene.front > one.box.s_from  # beside them it is too late
        or not _near_place(places, one.box, 0.0 if one.box.agent in passed else scene.frame.ego.v, scene.vehicle)
    )
    room = scene.vehicle.width + 2.0 * config.min_clearance_m
    narrow = tuple(box for box in boxes if widest_gap(scene.reference, box) < room)
    return InTheWay(boxes, *sides, passed_by_oncoming_lane(scene, narrow, config, stations))


def _near_place(places: tuple[float, ...], box: Occupancy, speed: float, vehicle: VehicleParameters) -> bool:
    begin, end = swing_span(box, speed, vehicle)
    return any(begin < place < end + PLACE_M for place in places)


def gone_on(t: FloatArray, s_ego: float, v: float, limit: float) -> FloatArray:
    """Stations at times `(k,)` from the first on of an ego that reaches a limit with `GAIN_MPS2` and keeps it."""
    at = t - t[0]
    speed = np.clip(limit, v - GAIN_MPS2 * at, v + GAIN_MPS2 * at)
    return s_ego + np.r_[0.0, np.cumsum(0.5 * np.diff(at) * (speed[1:] + speed[:-1]))]
