"""Passing what blocks the lane on the lane of the opposite direction.

An agent that blocks the lane and leaves no room on either side of the road, and is in no queue, is
passed on the lane of the opposite direction where the marking between may be crossed and, for the
whole stretch from where the ego leaves its lane to where it is back,

(3) no agent is predicted on the oncoming lane there until the ego is back, and `facing_margin_s`
    more; and no standing agent there leaves too little room for the ego, because more agents may be
    behind it,
(4) (BACK_M behind the obstacle - s) / max(v, PASSING_MPS) + facing_margin_s <= horizon
        of the predictions.

Otherwise the ego waits `WAIT_M` before it, from where it can still steer round it. For a slower
agent along the lane (`passing`), (4) takes the time at which the plan reaches the place, and the
sensor must

(5) see the oncoming lane far enough that a vehicle beyond it, at the speed limit, cannot violate
    (3) (StVO, 5 (2)).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.logs.reference_line import line_project_many
from replan.logs.vehicle import VehicleParameters
from replan.planners.dp_qp.path.bounds import CorridorConfig, PathBounds, side_gaps, swing_span
from replan.planners.frenet.reference_path import ReferencePath
from replan.planners.frenet.scene import Occupancy, Scene

PASSING_MPS = 5.0  # Least assumed speed while passing (4), m/s
BACK_M = 10.0  # The ego is back in its lane this far behind the obstacle (4), m
WAIT_M = 9.0  # Gap between the waiting ego's front and the obstacle, m; enough to steer round it
NEARLY_M = 1.0  # A gap that is wider than the ego by less than this may be blocked, m
SIGHT_M = 5.0  # Distance between two points of the oncoming lane that must be visible, m
QUEUE_M = 25.0  # An obstacle nearer than this to another one in the lane stands in a queue, m
ROOM_M = 0.5  # The ego waits for the oncoming lane only if that leaves this much space beside it, m
BEYOND_M = 10.0  # The lane must also be free this far beyond the place where the ego is back, m
AROUND_M = 30.0  # Agents this much farther from the ego than that place are not projected, m
SEARCH_M = 250.0  # Length of the line on which agents are searched, m
LEAST_WIDTH_M = 2.0  # Width of the widest agent that is assumed at least, m


def widest_gaps(
    reference: ReferencePath, boxes: Sequence[Occupancy], *, oncoming: bool = False
) -> list[float]:
    """The gap between each box and the road's edge at the box's middle, on the wider side, m."""
    if not boxes:
        return []
    road = reference.at(np.array([box.s_middle for box in boxes]))
    left, right = road.road_left, road.road_right
    if oncoming:
        left, right = road.facing_left, road.facing_right
    edges = zip(boxes, left.tolist(), right.tolist(), strict=True)
    return [max(most - box.l_to, box.l_from - least) for box, most, least in edges]


def may_block(scene: Scene, obstacles: Sequence[Occupancy]) -> bool:
    """Whether an agent leaves less than the ego's width on both sides of the road, or nearly."""
    gaps = widest_gaps(scene.reference, obstacles)
    return min(gaps, default=inf) < scene.vehicle.width + NEARLY_M


def find_blocking(
    obstacles: tuple[Occupancy, ...],
    space: PathBounds,
    vehicle: VehicleParameters,
    config: CorridorConfig,
) -> tuple[Occupancy, ...]:
    """The obstacles that leave the ego no room on either side of the road, without those in a
    queue.
    """
    blocking, half = [], 0.5 * vehicle.width
    for box, (lower, upper) in zip(obstacles, space.room(obstacles, vehicle, config), strict=True):
        touches = lower < box.l_to + half and upper > box.l_from - half
        queue = any(
            other is not box
            and max(other.s_from - box.s_to, box.s_from - other.s_to) < QUEUE_M
            and other.l_from < upper
            and other.l_to > lower
            for other in obstacles
        )
        is_closed = max(side_gaps(box, lower, upper, vehicle)) < config.min_clearance_m
        if touches and is_closed and not queue:
            blocking.append(box)
    return tuple(blocking)


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
    names = {box.agent for box in blocked}
    others = np.array([name not in names for name in scene.frame.agents.ids], bool)
    return frozenset(
        box.agent
        for box in blocked
        if scene.front >= box.s_from or _stays_free(scene, box, others, config, stations)
    )


def _stays_free(
    scene: Scene,
    box: Occupancy,
    others: BoolArray,
    config: CorridorConfig,
    stations: FloatArray | None,
) -> bool:
    """Whether (3), (4) and, for an ego at `stations`, (5) hold for an obstacle ahead.

    `others` `(agents,)` are the agents that do not block the lane.
    """
    frame, futures = scene.frame, scene.frame.predictions
    place = box.s_to + scene.vehicle.rear_overhang + BACK_M
    if stations is None:
        seconds = (place - scene.s) / max(frame.ego.v, PASSING_MPS)  # (4)
    elif len(futures.t) and stations[-1] >= place:
        seconds = float(futures.t[np.argmax(stations >= place)] - frame.t)
    else:
        return False
    back = frame.t + seconds + config.facing_margin_s
    if not len(futures.t) or back > futures.t[-1] or _is_taken(scene, box, others, back, config):
        return False
    return stations is None or _in_sight(scene, place, back - frame.t)


def _is_taken(
    scene: Scene, box: Occupancy, others: BoolArray, back: float, config: CorridorConfig
) -> bool:
    """Whether one of the `others` takes the oncoming lane beside an obstacle until the time `back`,
    s (3).
    """
    frame, car, line = scene.frame, scene.vehicle, scene.reference.line
    agents, futures = frame.agents, frame.predictions
    begin, end = swing_span(box, frame.ego.v, car)
    middle, half = 0.5 * (box.l_from + box.l_to), 0.5 * (box.l_to - box.l_from)
    gap = np.abs(scene.agents.l - middle) - half - 0.5 * agents.width
    leaves_room = scene.standing & (gap > car.width + 2.0 * config.min_clearance_m)
    until, rows = futures.t <= back, (others & ~leaves_room)[futures.agent]
    x, y = futures.x[rows][:, until].ravel(), futures.y[rows][:, until].ravel()
    near = np.hypot(x - frame.ego.x, y - frame.ego.y) < end - scene.s + AROUND_M
    s, l = line_project_many(line.s, line.coef, x[near], y[near], scene.s, SEARCH_M).T
    road, widest = scene.reference.at(s), float(agents.width.max(initial=LEAST_WIDTH_M))
    side = 0.5 * widest
    has_left, has_right = road.facing_left > road.road_left, road.facing_right < road.road_right
    on_left = has_left & (l > road.road_left - side) & (l < road.facing_left)
    on_right = has_right & (l < road.road_right + side) & (l > road.facing_right)
    on_stretch = (s > min(scene.s, begin) - widest) & (s < end + BEYOND_M)
    return bool(((on_left | on_right) & on_stretch).any())


def _in_sight(scene: Scene, place: float, seconds: float) -> bool:
    """Whether (5) holds for an ego that is back in its lane at a place (m) and safe after some
    seconds.
    """
    view, reference = scene.frame.visibility, scene.reference
    if view is None:
        return True
    limit = float(np.interp(place, reference.line.s, reference.limit))
    s = np.arange(scene.s + SIGHT_M, place + limit * seconds, SIGHT_M)
    s = s[s < reference.line.s[-1]]
    road = reference.at(s)
    left, right = road.road_left + road.facing_left, road.road_right + road.facing_right
    middle = np.where(road.facing_left > road.road_left, left, right) / 2.0
    points = [
        reference.line.point(float(station), float(offset))
        for station, offset in zip(s, middle, strict=True)
    ]
    return not view.hides(np.reshape(points, (-1, 2))).any()


def waiting_place(scene: Scene, blocked: tuple[Occupancy, ...], passed: frozenset[str]) -> float:
    """Station of the rear axle to wait at for the oncoming lane, m.

    Inf if there is none or no need to wait.
    """
    car = scene.vehicle
    boxes = [box for box in blocked if box.agent not in passed]
    gaps = widest_gaps(scene.reference, boxes, oncoming=True)
    places = [
        box.s_from - car.axle_to_front - WAIT_M
        for box, gap in zip(boxes, gaps, strict=True)
        if gap > car.width + ROOM_M
    ]
    return min(places, default=inf)
