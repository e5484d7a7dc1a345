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

from collections.abc import Mapping
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
from replan.logs.trace import Mode, Trace
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
from replan.metrics.metric import MIN, Measured, Metric, Series, time_below
from replan.metrics.safety import CATALOGUE

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
            found = time_to_contact(
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
            if found <= PIECE_S:
                return i * PIECE_S + found
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
        mine, theirs = (
            corners(x1, y1, yaw1, length1, width1),
            corners(x2, y2, yaw2, length2, width2),
        )
        for i in range(4):
            for j in range(4):
                dx, dy = theirs[j, 0] - mine[i, 0], theirs[j, 1] - mine[i, 1]
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
    pose, size = others.pose[:, i, k], others.size[i]
    return MovingBox(pose[0], pose[1], pose[2], size[0], size[1], pose[3], pose[4], accel)


@kernel
def _least_with_acceleration(
    ego: FloatArray, ego_accel: FloatArray, car: EgoOutline, others: OtherBoxes
) -> tuple[FloatArray, IntArray]:
    """Return for each step the least (1) (NaN: none) and the agent's index (-1)."""
    pose, size, steps = others.pose, others.size, others.there.shape[1]
    least, agent = np.full(steps, np.nan), np.full(steps, -1, np.int64)
    for k in range(steps):
        x, y, yaw, vx, vy = ego[0, k], ego[1, k], ego[2, k], ego[3, k], ego[4, k]
        rear_x, rear_y, best, v = (
            x - car.axle * cos(yaw),
            y - car.axle * sin(yaw),
            HORIZON_S,
            hypot(vx, vy),
        )
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
            one = MovingBox(x, y, yaw, car.length, car.width, vx, vy, ego_accel[k])
            found = time_to_contact_accelerated(one, _body(others, i, k, a), best)
            if found < best:
                best, least[k], agent[k] = found, found, i
    return least, agent


@kernel
def _closest(ego: FloatArray, car: EgoOutline, others: OtherBoxes) -> tuple[FloatArray, IntArray]:
    """Return for each step the least DCE and its TTCE `(2, k)` (NaN: no other agent), and the
    agent's index (-1).
    """
    pose, size, steps = others.pose, others.size, others.there.shape[1]
    found, agent, reach = (
        np.full((2, steps), np.nan),
        np.full(steps, -1, np.int64),
        0.5 * hypot(car.length, car.width),
    )
    for k in range(steps):
        x, y, yaw, vx, vy = ego[0, k], ego[1, k], ego[2, k], ego[3, k], ego[4, k]
        best, when = inf, inf
        for i in range(len(size)):
            if not others.there[i, k]:
                continue
            dx, dy, du, dv = (
                pose[0, i, k] - x,
                pose[1, i, k] - y,
                pose[3, i, k] - vx,
                pose[4, i, k] - vy,
            )
            square = du * du + dv * dv
            t = min(max(-(dx * du + dy * dv) / square, 0.0), HORIZON_S) if square > 0.0 else 0.0
            if hypot(dx + t * du, dy + t * dv) - reach - 0.5 * hypot(size[i, 0], size[i, 1]) > best:
                continue
            one = MovingBox(x, y, yaw, car.length, car.width, vx, vy, 0.0)
            near, after = closest_encounter(one, _body(others, i, k, 0.0), HORIZON_S)
            if near < best or (near == best and after < when):
                best, when, agent[k] = near, after, i
                found[0, k], found[1, k] = near, after
    return found, agent


@kernel
def encroachment(
    ego: FloatArray,
    mine: IntArray,
    other: FloatArray,
    theirs: IntArray,
    sizes: FloatArray,
    angle: float,
) -> IntArray:
    """Return (3) in steps `(4, steps of the ego)`, for increasing steps `mine` of the ego and
    `theirs` of an agent.

    The rows are the least j - i >= 0 and the least i - j > 0 over the boxes that overlap and whose
    headings differ by at least `angle` (-1: none), then the numbers of such pairs. `sizes` are
    length and width of both boxes `(2, 2)`.
    """
    out = np.zeros((4, ego.shape[1]), np.int64)
    out[:2] = -1
    reach = 0.5 * (hypot(sizes[0, 0], sizes[0, 1]) + hypot(sizes[1, 0], sizes[1, 1]))
    for i in mine:
        for j in theirs:
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
            out[2 + order, i] += 1
            if out[order, i] < 0 or steps < out[order, i]:
                out[order, i] = steps
    return out


def _ttc_accelerated(trace: Trace, scenario: Scenario) -> Measured:
    ego, car = grid_of(trace), car_of(scenario)
    boxes, forth = ego_boxes(ego, scenario), ego.a * np.where(ego.v < 0.0, -1.0, 1.0)
    least, agent = nearest(
        trace.agents,
        ego.t,
        lambda k, seen, others: _least_with_acceleration(boxes[:, k], forth[k], car, others),
    )
    return Series(
        ego.t, least, labels_of(trace, agent), f"never on a course to touch within {HORIZON_S:g} s"
    )


@once
def _encounters(trace: Trace, scenario: Scenario) -> tuple[FloatArray, IntArray]:
    """Return `_closest` over all road users present, and the index of the nearest one."""
    boxes, car = ego_boxes(grid_of(trace), scenario), car_of(scenario)
    return nearest(
        trace.agents, grid_of(trace).t, lambda k, seen, others: _closest(boxes[:, k], car, others)
    )


def _encounter(trace: Trace, scenario: Scenario, *, row: int) -> Measured:
    found, agent = _encounters(trace, scenario)
    value = found[row] if row == 0 else np.where(found[1] > 0.0, found[1], np.nan)
    nothing = (
        "no other road user in the scene"
        if row == 0 or not (agent >= 0).any()
        else "no other came nearer"
    )
    return Series(grid_of(trace).t, value, labels_of(trace, agent), nothing)


def _pet(trace: Trace, scenario: Scenario) -> Mapping[str, Measured]:
    t, boxes, car = grid_of(trace).t, ego_boxes(grid_of(trace), scenario), car_of(scenario)
    best = {part: np.full(len(t), np.nan) for part in PET_PARTS}
    labels = {part: [""] * len(t) for part in PET_PARTS}
    for i, others, row in each(trace.agents, t):
        mine, theirs = may_meet(boxes, car, others, row)
        if trace.agents.static[i] or not len(mine) or not len(theirs):
            continue
        name, sizes = name_of(trace.agents, i), np.array([car[1:3], others.size[row]])
        poses = np.ascontiguousarray(others.pose[:, row])
        across = 0.0 if trace.agents.kinds[i] is AgentKind.PEDESTRIAN else CROSSING_RAD
        for angle, after, before in (
            (0.0, "ego_first", "ego_second"),
            (across, "crossing", "crossing"),
        ):
            found = encroachment(boxes, mine, poses, theirs, sizes, angle)
            for part, steps, sign, order in (
                (after, found[0], 1, "second"),
                (before, found[1], -1, "first"),
            ):
                at = np.flatnonzero(steps >= 0)
                for k, pet in zip(at, np.abs(t[at + sign * steps[at]] - t[at]), strict=True):
                    if not best[part][k] <= pet:
                        best[part][k], labels[part][k] = pet, f"{name} {order}"
    return {part: Series(t, best[part], tuple(labels[part]), PET_PARTS[part]) for part in PET_PARTS}


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
    mine = ((ego >= low) & (ego <= high)).all(axis=1)
    theirs = ((other >= ego.min(axis=0) - reach) & (other <= ego.max(axis=0) + reach)).all(axis=1)
    return np.flatnonzero(mine), np.flatnonzero(theirs)


PET_PARTS = {
    "ego_first": "the ego left no place that another took after it",
    "ego_second": "the ego took no place that another had left",
    "crossing": "no other crossed the ego's way",
}
"""The parts of PET, and the reason if a part has no value."""
_GRID = f"every {GRID_S:g} s"
TTC_ACCELERATED = Metric(
    "ttc_accelerated",
    "s",
    "higher",
    (Mode.CLOSED,),
    _ttc_accelerated,
    (MIN, time_below(1.5, "time_below_1500ms")),
    "Least time until boxes touch when all go on along their velocity vectors with their "
    "accelerations, none into "
    "reverse; not to those behind.",
    f"{CATALOGUE}; commonroad-crime asks it of a lead in a lane",
    formula="v(t) = max(v + a t, 0) of each",
    parameters=(f"horizon {HORIZON_S:g} s", f"pieces of {PIECE_S:g} s", "bound 1.5 s", _GRID),
    needs="another on a course to touch an ego that drives",
)
DCE = Metric(
    "dce",
    "m",
    "higher",
    (Mode.CLOSED,),
    partial(_encounter, row=0),
    (MIN,),
    "Distance of the closest encounter: the least distance of the boxes within 10 s at constant "
    "velocity vectors.",
    f"Eggert, Proc. IEEE ITSC 2014; {CATALOGUE}",
    formula="min over 0 <= t <= horizon of distance(t)",
    parameters=(f"horizon {HORIZON_S:g} s", _GRID),
    needs="another road user",
)
TTCE = Metric(
    "ttce",
    "s",
    "higher",
    (Mode.CLOSED,),
    partial(_encounter, row=1),
    (MIN,),
    "Time to the closest encounter (of dce) where that is still to come.",
    f"Eggert, Proc. IEEE ITSC 2014; {CATALOGUE}",
    formula="argmin over 0 < t <= horizon of distance(t)",
    parameters=(f"horizon {HORIZON_S:g} s", _GRID),
    needs="another who comes nearer",
)
PET = Metric(
    "pet",
    "s",
    "higher",
    (Mode.CLOSED,),
    _pet,
    (MIN, time_below(SERIOUS_S, "time_below_1s")),
    "Post-encroachment time: from one leaving a place to the other taking it; the ego first, "
    "second, or either at a "
    "crossing.",
    f"Allen, Shin, Cooper, Transp. Res. Rec. 667 (1978); {CATALOGUE}",
    formula="min |t_j - t_i| over overlapping boxes",
    parameters=(
        _GRID,
        "crossing: pedestrians, and headings 30 degrees or more apart",
        f"serious below {SERIOUS_S:g} s",
    ),
    parts=tuple(PET_PARTS),
    needs="a place that both take",
)
