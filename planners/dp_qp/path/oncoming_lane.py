"""Passing who blocks the lane by the lane of the opposite direction: which agents, and whether the lane is free.

An agent that stands in the lane and leaves no room on either side of the road, and is in no queue, is passed where the
marking between may be crossed and, for the whole stretch from where the ego leaves its lane to where it is back,

(1) no agent is predicted on the oncoming lane there until the ego is back, and `facing_margin_s` more; nor stands
    there so that the ego would not fit between: behind one who stands there may be more,
(2) (BACK_M behind the obstacle - s) / max(v, PASSING_MPS) + facing_margin_s <= horizon of the predictions.

Otherwise the ego waits `WAIT_M` before it, from where it can still steer round it. For an agent along the lane
(`scene.moving_obstacles`), (2) asks when the ego will be there by its plan, and the sensor must

(3) see the oncoming lane as far as one who comes at its speed limit must be away to leave (1) true (StVO, 5 (2)).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from logs.kernel import FloatArray
from logs.road import line_project_many
from logs.vehicle import VehicleParameters
from planners.dp_qp.path.bounds import CorridorConfig, PathBounds, side_gaps, swing_span
from planners.frenet.occupancy import Occupancy
from planners.frenet.reference_path import ReferencePath
from planners.frenet.scene import Scene

PASSING_MPS = 5.0
"""What the ego drives at least while it passes (2), m/s."""
BACK_M = 10.0
"""So far behind the obstacle the ego is in its lane again (2), m."""
WAIT_M = 9.0
"""It waits with its front so far before the obstacle, m: from there it can still steer round it."""
NEARLY_M = 1.0
"""A gap is looked at closely where it is less than this wider than the ego, m."""
SIGHT_M = 5.0
"""Between two places of the oncoming lane that must be seen, m."""
QUEUE_M = 25.0
"""Who stands so near behind another who stands in the lane waits in a queue, m."""
ROOM_M = 0.5
"""Room that the oncoming lane must leave beside the ego for it to be worth waiting for, m."""


def widest_gaps(reference: ReferencePath, boxes: Sequence[Occupancy], *, oncoming: bool = False) -> list[float]:
    """Between each box and the road's edge at the box's middle, on the side where there is more, m."""
    if not boxes:
        return []
    road = reference.at(np.array([box.s_middle for box in boxes]))
    left, right = (road.facing_left, road.facing_right) if oncoming else (road.road_left, road.road_right)
    edges = zip(boxes, left.tolist(), right.tolist(), strict=True)
    return [max(most - box.l_to, box.l_from - least) for box, most, least in edges]


def may_block(scene: Scene, obstacles: Sequence[Occupancy]) -> bool:
    """Whether an agent leaves less than the ego's width on both sides of the road, or nearly."""
    return min(widest_gaps(scene.reference, obstacles), default=np.inf) < scene.vehicle.width + NEARLY_M


def blocking(
    obstacles: tuple[Occupancy, ...], space: PathBounds, vehicle: VehicleParameters, config: CorridorConfig
) -> tuple[Occupancy, ...]:
    """The obstacles that leave the ego no room on either side of the road, those in a queue not among them."""
    found = []
    for box, (lower, upper) in zip(obstacles, space.room(obstacles, vehicle, config), strict=True):
        touches = lower < box.l_to + 0.5 * vehicle.width and upper > box.l_from - 0.5 * vehicle.width
        queue = any(
            other is not box
            and max(other.s_from - box.s_to, box.s_from - other.s_to) < QUEUE_M
            and other.l_from < upper
            and other.l_to > lower
            for other in obstacles
        )
        if touches and max(side_gaps(box, lower, upper, vehicle)) < config.min_clearance_m and not queue:
            found.append(box)
    return tuple(found)


def passed_by_oncoming_lane(
    scene: Scene, blocked: tuple[Occupancy, ...], config: CorridorConfig, stations: FloatArray | None = None
) -> frozenset[str]:
    """The agents that the ego may pass by the oncoming lane: it stays free until the ego is back, and some time more.

    The time that this takes is that of an ego at `stations` `(k,)` at the times of the predictions; None: it counts on
    driving at least `PASSING_MPS`. What lasts longer than the predictions is refused. Beside the obstacle it is too
    late to turn back.
    """
    if not blocked:
        return frozenset()
    frame, car, line = scene.frame, scene.vehicle, scene.reference.line
    futures, v = frame.predictions, max(frame.ego.v, PASSING_MPS)
    names, agents = {box.agent for box in blocked}, frame.agents
    others, widest = np.array([name not in names for name in agents.ids], bool), float(agents.width.max(initial=2.0))
    found = []
    for box in blocked:
        begin, end = swing_span(box, frame.ego.v, car)
        place = box.s_to + car.rear_overhang + BACK_M
        lasts = (place - scene.s) / v  # (2)
        if stations is not None:
            is_reached = len(futures.t) > 0 and stations[-1] >= place
            lasts = float(futures.t[np.argmax(stations >= place)] - frame.t) if is_reached else np.inf
        back = frame.t + lasts + config.facing_margin_s
        if scene.front < box.s_from:
            if not len(futures.t) or back > futures.t[-1]:
                continue
            aside = np.abs(scene.agents.l - 0.5 * (box.l_from + box.l_to)) - 0.5 * (box.l_to - box.l_from)
            fits = scene.standing & (aside - 0.5 * agents.width > car.width + 2.0 * config.min_clearance_m)
            now, rows = futures.t <= back, (others & ~fits)[futures.agent]
            x, y = futures.x[rows][:, now].ravel(), futures.y[rows][:, now].ravel()
            near = np.hypot(x - frame.ego.x, y - frame.ego.y) < end - scene.s + 30.0
            feet = line_project_many(line.s, line.coef, x[near], y[near], scene.s, 250.0)
            if len(feet) and _meets_oncoming(scene.reference, feet, widest, (scene.s, begin, end)):  # (1)
                continue
            if stations is not None and not _in_sight(scene, place, back - frame.t):  # (3)
                continue
        found.append(box.agent)
    return frozenset(found)


def _in_sight(scene: Scene, place: float, lasts: float) -> bool:
    """(3), for an ego that is back in its lane at a place (m) and safe after `lasts` s."""
    view, reference = scene.frame.visibility, scene.reference
    if view is None:
        return True
    limit = float(np.interp(place, reference.line.s, reference.limit))
    s = np.arange(scene.s + SIGHT_M, place + limit * lasts, SIGHT_M)
    s = s[s < reference.line.s[-1]]
    road = reference.at(s)
    by_left = road.facing_left > road.road_left
    middle = np.where(by_left, road.road_left + road.facing_left, road.road_right + road.facing_right) / 2.0
    points = [reference.line.point(float(at), float(aside)) for at, aside in zip(s, middle, strict=True)]
    return not view.hides(np.reshape(points, (-1, 2))).any()


def _meets_oncoming(reference: ReferencePath, feet: FloatArray, width: float, span: tuple[float, float, float]) -> bool:
    """Whether points (s, l) `(n, 2)` come on the oncoming lane between the ego and the end of the passing."""
    s_ego, begin, end = span
    s, l = feet.T  # noqa: E741
    road = reference.at(s)
    on_left = (road.facing_left > road.road_left) & (l > road.road_left - 0.5 * width) & (l < road.facing_left)
    on_right = (road.facing_right < road.road_right) & (l < road.road_right + 0.5 * width) & (l > road.facing_right)
    return bool(((on_left | on_right) & (s > min(s_ego, begin) - width) & (s < end + 10.0)).any())


def waiting_place(scene: Scene, blocked: tuple[Occupancy, ...], passed: frozenset[str]) -> float:
    """Station of the rear axle to wait at for the oncoming lane, m; inf where there is none or no need to wait."""
    car, waits = scene.vehicle, [box for box in blocked if box.agent not in passed]
    gaps = widest_gaps(scene.reference, waits, oncoming=True)
    places = [
        box.s_from - car.axle_to_front - WAIT_M
        for box, gap in zip(waits, gaps, strict=True)
        if gap > car.width + ROOM_M
    ]
    return min(places, default=np.inf)
