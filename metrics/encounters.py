"""How near the ego and the others come: extrapolated, and as they actually passed. Closed loop,
every 0.1 s.

(1) TTC at constant acceleration: each box moves along its velocity vector
        with v(t) = max(v + a t, 0) and constant heading, until the boxes touch, within `HORIZON_S`.
        Positions are exact every `PIECE_S`, and linear in between:
    accurate to a PIECE_S^2 / 8, 6 mm at 5 m/s2. Agents behind have none, as in `ttc`.
(2) DCE = min over 0 <= t <= HORIZON_S of the distance of the boxes at constant velocity vectors,
        0 if they touch; TTCE
    = the time of this minimum, the first of equals
(3) PET = |t_j - t_i|, the least over the ego's boxes i and an agent's boxes j that overlap:
        the time from one leaving a
    place to the other taking it. "ego_first": t_j >= t_i, "ego_second": t_j < t_i;
        "crossing" uses both, but only pedestrians, and boxes whose headings differ by at least 30
        degrees: following road users do not hide crossing ones.

Only PET depends on later steps. Static agents (obstacles) have no PET.

Sources: criticality metrics catalogue (Westhofen et al., Arch. Comput. Methods Eng. 30, 2023);
Eggert, Proc. IEEE ITSC 2014, for (2); Allen, Shin, Cooper, Transp. Res. Rec. 667 (1978) for (3).
"""

from __future__ import annotations

from functools import partial
from math import cos, hypot, inf, pi, sin
from typing import NamedTuple

import numpy as np

from replan.core.arrays import FloatArray, IntArray
from replan.core.kernel import inner_kernel, kernel
from replan.core.once import once
from replan.logs.agents import AgentKind
from replan.logs.scenario import Scenario
from replan.logs.shapes import corners, distance, overlap, time_to_contact
from replan.logs.states import wrap
from replan.logs.trace import Trace
from replan.metrics.boxes import (
    GRID_S,
    NO_TTC_MPS,
    EgoOutline,
    OtherBoxes,
    car_of,
    distance_bound,
    each,
    ego_boxes,
    grid_of,
    is_behind,
    labels_of,
    name_of,
    nearest,
)
from replan.metrics.metric import Measured, Parts, Series, metric
from replan.metrics.reductions import MIN, time_below

CATALOGUE = "criticality metrics catalogue, Westhofen et al., Arch. Comput. Methods Eng. 30 (2023)"
HORIZON_S = 10.0
PIECE_S = 0.1
CROSSING_RAD = pi / 6.0
SERIOUS_S = 1.0  # A smaller PET is serious (criticality metrics catalogue), s


class MovingBox(NamedTuple):
    """A moving box: centre, m, heading, rad, length, width, m, velocity, m/s, and the rate of its
    speed, m/s2.
    """

    x: float
    y: float
    yaw: float
    length: float
    width: float
    vx: float
    vy: float
    accel: float


@inner_kernel
def _distance_travelled(v: float, a: float, t: float) -> float:
    """Return the distance after t without reversing: the motion stops when v + a t = 0."""
    if a < 0.0 and v + a * t < 0.0:
        return -0.5 * v * v / a
    return v * t + 0.5 * a * t * t


@kernel
def time_to_contact_accelerated(one: MovingBox, two: MovingBox, horizon: float) -> float:
    """Return (1), s; inf without a touch within the horizon.

    A standing box with a > 0 starts along its heading.
    """
    x1, y1, yaw1, length1, width1, vx1, vy1, a1 = one
    x2, y2, yaw2, length2, width2, vx2, vy2, a2 = two
    v1, v2 = hypot(vx1, vy1), hypot(vx2, vy2)
    c1, s1 = (vx1 / v1, vy1 / v1) if v1 > 0.0 else (cos(yaw1), sin(yaw1))
    c2, s2 = (vx2 / v2, vy2 / v2) if v2 > 0.0 else (cos(yaw2), sin(yaw2))
    reach = 0.5 * (hypot(length1, width1) + hypot(length2, width2))
    d1, d2 = 0.0, 0.0
    for i in range(round(horizon / PIECE_S)):
        then = (i + 1) * PIECE_S
        e1, e2 = _distance_travelled(v1, a1, then), _distance_travelled(v2, a2, then)
        dx, dy = x2 - x1 + d2 * c2 - d1 * c1, y2 - y1 + d2 * s2 - d1 * s1
        if hypot(dx, dy) - reach <= (e1 - d1) + (e2 - d2):
            u1, u2 = (e1 - d1) / PIECE_S, (e2 - d2) / PIECE_S
            after_s = time_to_contact(
                0.0,
                0.0,
                yaw1,
                length1,
                width1,
                dx,
                dy,
                yaw2,
                length2,
                width2,
                u2 * c2 - u1 * c1,
                u2 * s2 - u1 * s1,
            )
            if after_s <= PIECE_S:
                return i * PIECE_S + after_s
        d1, d2 = e1, e2
    return inf


@kernel
def closest_encounter(one: MovingBox, two: MovingBox, horizon: float) -> tuple[float, float]:
    """Return DCE, m, and TTCE, s (2).

    Without a touch, the minimum is at 0, at the horizon, or corner to corner.
    """
    x1, y1, yaw1, length1, width1, vx1, vy1, _ = one
    x2, y2, yaw2, length2, width2, vx2, vy2, _ = two
    vx, vy = vx2 - vx1, vy2 - vy1
    contact = time_to_contact(x1, y1, yaw1, length1, width1, x2, y2, yaw2, length2, width2, vx, vy)
    if contact <= horizon:
        return 0.0, contact
    best, when = distance(x1, y1, yaw1, length1, width1, x2, y2, yaw2, length2, width2), 0.0
    later = distance(
        x1, y1, yaw1, length1, width1, x2 + horizon * vx, y2 + horizon * vy, yaw2, length2, width2
    )
    square = vx * vx + vy * vy
    if square > 0.0:
        corners1, corners2 = (
            corners(x1, y1, yaw1, length1, width1),
            corners(x2, y2, yaw2, length2, width2),
        )
        for i in range(4):
            for j in range(4):
                dx, dy = corners2[j, 0] - corners1[i, 0], corners2[j, 1] - corners1[i, 1]
                t = -(dx * vx + dy * vy) / square
                apart = hypot(dx + t * vx, dy + t * vy)
                if 0.0 < t < horizon and (
                    apart < best - 1e-9 or (apart < best + 1e-9 and t < when)
                ):
                    best, when = min(apart, best), t
    return (later, horizon) if later < best - 1e-9 else (best, when)


@inner_kernel
def _body(others: OtherBoxes, i: int, k: int, accel: float) -> MovingBox:
    """Return box i at step k."""
    pose, size = others.pose, others.size
    return MovingBox(
        pose[0, i, k],
        pose[1, i, k],
        pose[2, i, k],
        size[i, 0],
        size[i, 1],
        pose[3, i, k],
        pose[4, i, k],
        accel,
    )


@kernel
def _least_with_acceleration(
    ego: FloatArray, ego_accel: FloatArray, car: EgoOutline, others: OtherBoxes
) -> tuple[FloatArray, IntArray]:
    """Return for each step the least (1) (NaN: none) and the agent's index (-1)."""
    pose, size, steps = others.pose, others.size, others.there.shape[1]
    least, agent = np.full(steps, np.nan), np.full(steps, -1, np.int64)
    for k in range(steps):
        x, y, yaw = ego[0, k], ego[1, k], ego[2, k]
        vx, vy = ego[3, k], ego[4, k]
        rear_x, rear_y = x - car.axle * cos(yaw), y - car.axle * sin(yaw)
        best, v = HORIZON_S, hypot(vx, vy)
        if v <= NO_TTC_MPS:
            continue
        for i in range(len(size)):
            if not others.there[i, k] or is_behind(
                rear_x, rear_y, yaw, pose[0, i, k], pose[1, i, k]
            ):
                continue
            u, a = hypot(pose[3, i, k], pose[4, i, k]), others.accel[i, k]
            a = a if np.isfinite(a) else 0.0
            if distance_bound(x, y, car, others, i, k) > _distance_travelled(
                v, ego_accel[k], best
            ) + _distance_travelled(u, a, best):
                continue
            ego_box = MovingBox(x, y, yaw, car.length, car.width, vx, vy, ego_accel[k])
            contact_s = time_to_contact_accelerated(ego_box, _body(others, i, k, a), best)
            if contact_s < best:
                best, least[k], agent[k] = contact_s, contact_s, i
    return least, agent


@kernel
def _closest(ego: FloatArray, car: EgoOutline, others: OtherBoxes) -> tuple[FloatArray, IntArray]:
    """Return for each step the least DCE and its TTCE `(2, k)` (NaN: no other agent), and the
    agent's index (-1).
    """
    pose, size, steps = others.pose, others.size, others.there.shape[1]
    closest, agent = np.full((2, steps), np.nan), np.full(steps, -1, np.int64)
    reach = 0.5 * hypot(car.length, car.width)
    for k in range(steps):
        x, y, yaw = ego[0, k], ego[1, k], ego[2, k]
        vx, vy = ego[3, k], ego[4, k]
        best, when = inf, inf
        for i in range(len(size)):
            if not others.there[i, k]:
                continue
            dx, dy = pose[0, i, k] - x, pose[1, i, k] - y
            du, dv = pose[3, i, k] - vx, pose[4, i, k] - vy
            square = du * du + dv * dv
            t = min(max(-(dx * du + dy * dv) / square, 0.0), HORIZON_S) if square > 0.0 else 0.0
            if hypot(dx + t * du, dy + t * dv) - reach - 0.5 * hypot(size[i, 0], size[i, 1]) > best:
                continue
            ego_box = MovingBox(x, y, yaw, car.length, car.width, vx, vy, 0.0)
            near, after = closest_encounter(ego_box, _body(others, i, k, 0.0), HORIZON_S)
            if near < best or (near == best and after < when):
                best, when, agent[k] = near, after, i
                closest[0, k], closest[1, k] = near, after
    return closest, agent


@kernel
def encroachment(
    ego: FloatArray,
    ego_steps: IntArray,
    other: FloatArray,
    other_steps: IntArray,
    sizes: FloatArray,
    angle: float,
) -> IntArray:
    """Return (3) in steps `(4, steps of the ego)`, for increasing steps `mine` of the ego and
    `theirs` of an agent.

    The rows are the least j - i >= 0 and the least i - j > 0 over the boxes that overlap and whose
    headings differ by at least `angle` (-1: none), then the numbers of such pairs. `sizes` are
    length and width of both boxes `(2, 2)`.
    """
    result = np.zeros((4, ego.shape[1]), np.int64)
    result[:2] = -1
    reach = 0.5 * (hypot(sizes[0, 0], sizes[0, 1]) + hypot(sizes[1, 0], sizes[1, 1]))
    for i in ego_steps:
        for j in other_steps:
            if hypot(other[0, j] - ego[0, i], other[1, j] - ego[1, i]) > reach:
                continue
            if abs(wrap(other[2, j] - ego[2, i])) < angle or not overlap(
                ego[0, i],
                ego[1, i],
                ego[2, i],
                sizes[0, 0],
                sizes[0, 1],
                other[0, j],
                other[1, j],
                other[2, j],
                sizes[1, 0],
                sizes[1, 1],
            ):
                continue
            order, steps = (0, j - i) if j >= i else (1, i - j)
            result[2 + order, i] += 1
            if result[order, i] < 0 or steps < result[order, i]:
                result[order, i] = steps
    return result


_GRID = f"every {GRID_S:g} s"


@metric(
    unit="s",
    better="higher",
    reductions=(MIN, time_below(1.5, "time_below_1500ms")),
    parameters=(f"horizon {HORIZON_S:g} s", f"pieces of {PIECE_S:g} s", "bound 1.5 s", _GRID),
    needs="another on a course to touch an ego that drives",
    source=f"{CATALOGUE}; commonroad-crime asks it of a lead in a lane",
)
def ttc_accelerated(trace: Trace, scenario: Scenario) -> Measured:
    """Least time until boxes touch when all go on along their velocity vectors with their
    accelerations, none into reverse; not to those behind.

    Formula: v(t) = max(v + a t, 0) of each
    """
    ego, car = grid_of(trace), car_of(scenario)
    boxes, forward = ego_boxes(ego, scenario), ego.a * np.where(ego.v < 0.0, -1.0, 1.0)

    def least_times(
        steps: slice, present: IntArray, others: OtherBoxes
    ) -> tuple[FloatArray, IntArray]:
        return _least_with_acceleration(boxes[:, steps], forward[steps], car, others)

    least, agent = nearest(trace.agents, ego.t, least_times)
    never = f"never on a course to touch within {HORIZON_S:g} s"
    return Series(ego.t, least, labels_of(trace, agent), never)


_encounter_metric = partial(
    metric,
    better="higher",
    reductions=(MIN,),
    parameters=(f"horizon {HORIZON_S:g} s", _GRID),
    source=f"Eggert, Proc. IEEE ITSC 2014; {CATALOGUE}",
)


@_encounter_metric(unit="m", needs="another road user")
def dce(trace: Trace, scenario: Scenario) -> Measured:
    """Distance of the closest encounter: the least distance of the boxes within 10 s at constant
    velocity vectors.

    Formula: min over 0 <= t <= horizon of distance(t)
    """
    (distances, _), agent = _encounters(trace, scenario)
    return Series(grid_of(trace).t, distances, labels_of(trace, agent), _NO_ONE)


@_encounter_metric(unit="s", needs="another who comes nearer")
def ttce(trace: Trace, scenario: Scenario) -> Measured:
    """Time to the closest encounter (of dce) where that is still to come.

    Formula: argmin over 0 < t <= horizon of distance(t)
    """
    (_, times), agent = _encounters(trace, scenario)
    missing = "no other came nearer" if (agent >= 0).any() else _NO_ONE
    to_come = np.where(times > 0.0, times, np.nan)
    return Series(grid_of(trace).t, to_come, labels_of(trace, agent), missing)


_NO_ONE = "no other road user in the scene"


@once
def _encounters(trace: Trace, scenario: Scenario) -> tuple[FloatArray, IntArray]:
    """Return `_closest` over all road users present, and the index of the nearest one."""
    boxes, car = ego_boxes(grid_of(trace), scenario), car_of(scenario)
    return nearest(
        trace.agents, grid_of(trace).t, lambda k, seen, others: _closest(boxes[:, k], car, others)
    )


PET_PARTS = {
    "ego_first": "the ego left no place that another took after it",
    "ego_second": "the ego took no place that another had left",
    "crossing": "no other crossed the ego's way",
}
"""The parts of PET, and the reason if a part has no value."""


@metric(
    unit="s",
    better="higher",
    reductions=(MIN, time_below(SERIOUS_S, "time_below_1s")),
    parts=tuple(PET_PARTS),
    parameters=(
        _GRID,
        "crossing: pedestrians, and headings 30 degrees or more apart",
        f"serious below {SERIOUS_S:g} s",
    ),
    needs="a place that both take",
    source=f"Allen, Shin, Cooper, Transp. Res. Rec. 667 (1978); {CATALOGUE}",
)
def pet(trace: Trace, scenario: Scenario) -> Parts:
    """Post-encroachment time: from one leaving a place to the other taking it; the ego first,
    second, or either at a crossing.

    Formula: min |t_j - t_i| over overlapping boxes
    """
    t, boxes, car = grid_of(trace).t, ego_boxes(grid_of(trace), scenario), car_of(scenario)
    best = {part: np.full(len(t), np.nan) for part in PET_PARTS}
    labels = {part: [""] * len(t) for part in PET_PARTS}
    for i, others, row in each(trace.agents, t):
        ego_steps, other_steps = may_meet(boxes, car, others, row)
        if trace.agents.static[i] or not len(ego_steps) or not len(other_steps):
            continue
        name, sizes = (
            name_of(trace.agents, i),
            np.array([(car.length, car.width), others.size[row]]),
        )
        poses = np.ascontiguousarray(others.pose[:, row])
        across = 0.0 if trace.agents.kinds[i] is AgentKind.PEDESTRIAN else CROSSING_RAD
        for angle, first_part, second_part in (
            (0.0, "ego_first", "ego_second"),
            (across, "crossing", "crossing"),
        ):
            after, before, _, _ = encroachment(boxes, ego_steps, poses, other_steps, sizes, angle)
            for part, steps, sign, order in (
                (first_part, after, 1, "second"),
                (second_part, before, -1, "first"),
            ):
                met = np.flatnonzero(steps >= 0)
                times = np.abs(t[met + sign * steps[met]] - t[met])
                for k, time in zip(met, times, strict=True):
                    if not best[part][k] <= time:
                        best[part][k], labels[part][k] = time, f"{name} {order}"
    return {
        part: Series(t, best[part], tuple(labels[part]), missing)
        for part, missing in PET_PARTS.items()
    }


def may_meet(
    boxes: FloatArray, car: EgoOutline, others: OtherBoxes, i: int
) -> tuple[IntArray, IntArray]:
    """Return the steps of the ego, and of the agent in row i, that lie in the bounding box of the
    other's drive.
    """
    ego, other = boxes[:2].T, others.pose[:2, i].T
    if not others.there[i].any():
        return np.empty(0, np.int64), np.empty(0, np.int64)
    reach = 0.5 * float(np.hypot(car.length, car.width) + np.hypot(*others.size[i]))
    low, high = np.nanmin(other, axis=0) - reach, np.nanmax(other, axis=0) + reach
    ego_inside = ((ego >= low) & (ego <= high)).all(axis=1)
    other_inside = ((other >= ego.min(axis=0) - reach) & (other <= ego.max(axis=0) + reach)).all(
        axis=1
    )
    return np.flatnonzero(ego_inside), np.flatnonzero(other_inside)
