"""Passing who blocks the lane by the lane of the opposite direction: whom, and whether nobody comes.

Somebody who stands in the lane and leaves no room on either side of the road, and is in no queue, is passed where the
marking between may be crossed and, for the whole stretch from where the ego leaves its lane to where it is back,

(1) no agent is predicted on the facing lane there until the ego is back, and `facing_margin_s` more,
(2) (BACK_M behind the obstacle - s) / max(v, FACING_MPS) + facing_margin_s <= horizon of the predictions.

Otherwise the ego waits `WAIT_M` before it, from where it can still steer round it. For who goes along the lane
(`slower`), (2) asks when the ego will be there by its plan, and the sensor must

(3) see the facing lane as far as one who comes at its speed limit must be away to leave (1) true (StVO, 5 (2)).

Who stands is passed on what is seen: he may hide the facing lane for as long as he stands.
"""

from __future__ import annotations

import numpy as np

from logs.frame import Frame
from logs.kernel import FloatArray
from logs.road import line_project_many
from logs.vehicle import VehicleParameters
from planners.dp_qp.path import bounds as corridor
from planners.dp_qp.path.bounds import CorridorConfig, PathBounds, PathObstacle
from planners.frenet.reference_path import ReferencePath

FACING_MPS = 5.0
BACK_M = 10.0
"""So far behind the obstacle the ego is in its lane again."""
WAIT_M = 9.0
NEARLY_M = 1.0
SIGHT_M = 5.0
"""Between two places of the facing lane that must be seen."""
QUEUE_M = 25.0
"""Who stands so near behind another who stands in the lane waits in a queue."""


def may_block(course: ReferencePath, obstacles: tuple[PathObstacle, ...], vehicle: VehicleParameters) -> bool:
    """Whether somebody leaves less than the ego's width on both sides of the road at his middle, or nearly."""
    right, left = course.at(np.array([0.5 * (box.s_from + box.s_to) for box in obstacles]))[[1, 4]]
    rooms = [max(b - box.l_to, box.l_from - a) for box, a, b in zip(obstacles, right, left, strict=True)]
    return min(rooms, default=np.inf) < vehicle.width + NEARLY_M


def blocking(
    obstacles: tuple[PathObstacle, ...], space: PathBounds, vehicle: VehicleParameters, config: CorridorConfig
) -> tuple[PathObstacle, ...]:
    """The obstacles that leave the ego no room on either side of the road, those in a queue not among them."""
    found = []
    for box in obstacles:
        over = corridor.beside(space, box, vehicle, config)
        if not over.any():
            continue
        lower, upper = float(space.lower[over].max()), float(space.upper[over].min())
        room = max(upper - box.l_to, box.l_from - lower) - 0.5 * vehicle.width
        touches = lower < box.l_to + 0.5 * vehicle.width and upper > box.l_from - 0.5 * vehicle.width
        queue = any(
            other is not box
            and max(other.s_from - box.s_to, box.s_from - other.s_to) < QUEUE_M
            and other.l_from < upper
            and other.l_to > lower
            for other in obstacles
        )
        if touches and room < config.min_clearance_m and not queue:
            found.append(box)
    return tuple(found)


def passed_facing(
    course: ReferencePath, frame: Frame, s_ego: float, blocked: tuple[PathObstacle, ...], vehicle: VehicleParameters,
    config: CorridorConfig, stations: FloatArray | None = None,
) -> frozenset[str]:  # fmt: skip
    """Whom the ego may pass by the facing lane: nobody is predicted there until it is back, and `facing_margin_s` more.

    The time that this takes is that of an ego at `stations` `(k,)` at the times of the predictions; None: it counts on
    driving at least `FACING_MPS`. What lasts longer than the predictions is refused. Beside the obstacle it is too late
    to turn back.
    """
    futures, v, line = frame.predictions, max(frame.ego.v, FACING_MPS), course.line
    names = {box.agent for box in blocked}
    counts = np.array([name not in names for name in frame.agents.ids], bool)
    moving = ((frame.agents.speed >= corridor.STANDING_MPS) & counts)[futures.agent]
    found = []
    for box in blocked:
        begin, end = corridor.swing_span(box, frame.ego.v, vehicle)
        place = box.s_to + vehicle.rear_overhang + BACK_M
        lasts = (place - s_ego) / v if stations is None else _reached(place, futures.t - frame.t, stations)
        back = frame.t + lasts + config.facing_margin_s
        if s_ego + vehicle.axle_to_front < box.s_from:
            if not len(futures.t) or back > futures.t[-1]:
                continue
            now = futures.t <= back
            x, y = futures.x[moving][:, now].ravel(), futures.y[moving][:, now].ravel()
            near = np.hypot(x - frame.ego.x, y - frame.ego.y) < end - s_ego + 30.0
            feet = line_project_many(line.s, line.coef, x[near], y[near], s_ego, 250.0)
            widest = float(frame.agents.width.max(initial=2.0))
            if len(feet) and _meets_facing(course, feet, widest, (s_ego, begin, end)):
                continue
            if stations is not None and not _in_sight(course, frame, s_ego, place, back - frame.t):
                continue
        found.append(box.agent)
    return frozenset(found)


def _in_sight(course: ReferencePath, frame: Frame, s_ego: float, place: float, lasts: float) -> bool:
    """(3), for an ego that is back in its lane at a place (m) and safe after `lasts` s."""
    if frame.visibility is None:
        return True
    limit = float(np.interp(place, course.line.s, course.limit))
    s = np.arange(s_ego + SIGHT_M, place + limit * lasts, SIGHT_M)
    s = s[s < course.line.s[-1]]
    _, right, facing_right, _, left, facing_left, _, _ = course.at(s)
    middle = np.where(facing_left > left, 0.5 * (left + facing_left), 0.5 * (right + facing_right))
    points = [course.line.point(float(at), float(aside)) for at, aside in zip(s, middle, strict=True)]
    return not frame.visibility.hides(np.reshape(points, (-1, 2))).any()


def _reached(place: float, t: FloatArray, stations: FloatArray) -> float:
    """When stations `(k,)` at times `t` reach a place; inf where they do not."""
    return float(t[np.argmax(stations >= place)]) if len(t) and stations[-1] >= place else np.inf


def _meets_facing(course: ReferencePath, feet: FloatArray, width: float, span: tuple[float, float, float]) -> bool:
    """Whether points (s, l) `(n, 2)` come on the facing lane between the ego and the end of the passing."""
    s_ego, begin, end = span
    s, l = feet.T  # noqa: E741
    _, right, facing_right, _, left, facing_left, _, _ = course.at(s)
    on_left = (facing_left > left) & (l > left - 0.5 * width) & (l < facing_left)
    on_right = (facing_right < right) & (l < right + 0.5 * width) & (l > facing_right)
    beside = on_left | on_right
    return bool((beside & (s > min(s_ego, begin) - width) & (s < end + 10.0)).any())


def waiting_place(
    course: ReferencePath, blocked: tuple[PathObstacle, ...], passed: frozenset[str], vehicle: VehicleParameters
) -> float:
    """Station of the rear axle to wait at for the facing lane, m; inf where there is none or nobody to wait for."""
    places = []
    for box in blocked:
        _, _, right, _, _, left, _, _ = course.at(np.array([0.5 * (box.s_from + box.s_to)]))[:, 0]
        if box.agent not in passed and max(left - box.l_to, box.l_from - right) > vehicle.width + 0.5:
            places.append(box.s_from - vehicle.axle_to_front - WAIT_M)
    return min(places, default=np.inf)
