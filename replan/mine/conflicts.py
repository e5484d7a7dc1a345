"""Events of two road users that use the same place: near misses, and which of them yields.

A road user and the ego conflict where their boxes take the same place at different times, the ego's
at step i and the other's at step j of the grid; for vehicles with headings that differ by 30
degrees or more. With the pair of least time

(1) PET = |t_j - t_i|

and the first one there goes first. The second one has yielded if it slowed down before the first
one was there, and at the speed that it had before it slowed down it would have come less than
`CLOSE_S` after the first one, or before it.

They are on a collision course while the time to collision TTC
(`replan.metrics.time_to_collision`) is below its critical value. With the relative speed u,
the braking that just avoids the contact, with boxes that may be off by `DEEP_M`, is

(2) needed = u^2 / (2 (u TTC + DEEP_M))

A short TTC alone is no near miss: in a queue at 3 m/s, 1.2 s of it need 1.1 m/s2.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import hypot, inf

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray, arc_lengths
from replan.core.kernel import kernel
from replan.core.once import once
from replan.logs.agents import AgentKind
from replan.logs.shapes import clearance, overlap, time_to_contact, time_to_contact_turning
from replan.logs.states import wrap
from replan.metrics.boxes import DEEP_M, GRID_S, NO_TTC_MPS, TURN_S, EgoOutline, is_behind
from replan.metrics.encounters import CROSSING_RAD, SERIOUS_S as PET_S
from replan.metrics.time_to_collision import TAU_S as TTC_S
from replan.mine.driven_log import JUMPS, DrivenLog, Event, EventKind, Neighbour, runs, steps
from replan.mine.ego_and_road import HARD_MPS2
from replan.mine.road_users import ALONG

COURSE_S = 0.3
"""Least duration of a collision course."""
NEAR_S = 2.0
"""A collision course that needs hard braking (2) is a near miss if, until so long after it, the two
come within `NEAR_M` or one of them brakes hard, s.
"""
NEAR_M = 1.0
"""Least gap of two road users that do not come near, m."""
HOLE_S = 0.5
"""An event goes on over an interruption up to this long, s."""
WINDOW_S = 10.0
"""Largest time between two road users at a place that are in conflict."""
CLOSE_S = 1.0
"""The second one would have come less than this time after the first one, had it not yielded."""
BEFORE_S = 10.0
"""A road user that yields slows down within this time before the other one is there."""
SLOWED_MPS = 1.0
"""Least decrease of the speed of a road user that yields, m/s."""
SLOWED = 0.3
"""Least decrease of the speed of a road user that yields, as a share of its speed before."""
BEYOND_M = 10.0
"""Places farther outside of the box around the ego's way are not compared with it, m."""
MOVES_MPS = 0.5
"""Slower road users stand."""
X, Y, YAW, VX, VY = range(5)
"""Rows of the boxes of the ego and of a road user: box centre, heading and velocity vector."""
POSITION, VELOCITY = slice(X, YAW), slice(VX, None)
"""Their rows together."""
SUDDEN = "they are first seen as they touch"
SHALLOW = f"the boxes overlap by less than {DEEP_M:g} m, which boxes may be off by"
TOO_LARGE = "the two hardly move against each other: the boxes may be too large"


def _near_miss_ttc(log: DrivenLog) -> Iterator[Event]:
    turn = log.ego.v * log.ego.kappa
    for user in log.neighbours:
        size = np.array(user.size)
        ttc, needed = _courses(log.boxes, turn, log.car, user.pose, user.turn, user.k, size, TTC_S)
        gaps = _gaps(log.boxes, log.car, user.pose, user.k, size)
        for first, last in runs(ttc < TTC_S, user.k, steps(COURSE_S), steps(HOLE_S)):
            if needed[first : last + 1].max() < HARD_MPS2:
                continue
            window = slice(first, min(last + steps(NEAR_S), len(user.k) - 1) + 1)
            braked = min(
                float(np.nanmin(log.accel[user.k[window]], initial=0.0)),
                float(user.accel[window].min()),
            )
            along = abs(user.along[first]) > ALONG and not user.kind.is_vulnerable
            beside = along and not user.reaches_into(log.half)[window].any()
            gap = gaps[window].min()
            if (braked <= -HARD_MPS2 and not beside) or gap < NEAR_M:
                doubt = SHALLOW if -DEEP_M < gap <= 0.0 else ""
                if log.jumps[user.k[first : last + 1]].any():
                    doubt = JUMPS
                yield log.event(user, first, last, ttc[first : last + 1].min(), doubt=doubt)


def _contact(log: DrivenLog) -> Iterator[Event]:
    for user in log.neighbours:
        gaps = _gaps(log.boxes, log.car, user.pose, user.k, np.array(user.size))
        closing = np.hypot(*(user.pose[VELOCITY] - log.boxes[VELOCITY, user.k]))
        for first, last in runs(gaps <= 0.0, user.k, hole=steps(HOLE_S)):
            doubt = ""
            if first == 0 or user.k[first] > user.k[first - 1] + 1:
                doubt = SUDDEN
            elif float(closing[first : last + 1].max()) < MOVES_MPS:
                doubt = TOO_LARGE
            elif gaps[first : last + 1].min() > -DEEP_M:
                doubt = SHALLOW
            yield log.event(user, first, last, closing[first], doubt=doubt)


def _near_miss_pet(log: DrivenLog) -> Iterator[Event]:
    for user, i, j in _conflicts(log):
        pet = abs(float(log.t[j] - log.t[i]))
        moving = abs(float(log.ego.v[i])) > MOVES_MPS
        if pet <= PET_S and moving:
            order = "the ego was there first" if i <= j else "the ego was there second"
            yield log.event_at(user, min(i, j), max(i, j), pet, order)


def _ego_yields(log: DrivenLog) -> Iterator[Event]:
    for user, i, j in _conflicts(log):
        slowed = _step_of_slowing(log.ego.v, log.station, j, i) if j < i else -1
        if slowed >= 0:
            yield log.event_at(user, slowed, i, float(log.t[i] - log.t[j]))


def _ego_is_yielded_to(log: DrivenLog) -> Iterator[Event]:
    for user, i, j in _conflicts(log):
        arrival = int(np.searchsorted(user.k, j))
        is_whole = user.k[arrival] - user.k[0] == arrival  # seen without a gap until then
        if i >= j or not is_whole:
            continue
        travelled = arc_lengths(*user.pose[POSITION])
        ego_arrival = int(np.searchsorted(user.k, i))
        slowed = _step_of_slowing(user.speed, travelled, min(ego_arrival, arrival), arrival)
        if slowed >= 0:
            yield log.event_at(user, int(user.k[slowed]), j, float(log.t[j] - log.t[i]))


def _step_of_slowing(v: FloatArray, travelled: FloatArray, first: int, arrival: int) -> int:
    """The step at which the second one begins to slow down for the first one; -1 if it does not.

    Args:
        v: `(n,)` its speed, m/s.
        travelled: `(n,)` distance that it has moved, m.
        first: The step at which the first one is at the place.
        arrival: The step at which the second one is there.
    """
    begin = max(first - steps(BEFORE_S), 0)
    if first <= begin:
        return -1
    before = v[begin : first + 1]
    fastest = begin + int(len(before) - 1 - np.argmax(before[::-1]))
    slowest = float(v[fastest : arrival + 1].min())
    speed = float(v[fastest])
    if speed < MOVES_MPS or speed - slowest < max(SLOWED_MPS, SLOWED * speed):
        return -1
    # Step at which it would have come
    undisturbed = fastest + float(travelled[arrival] - travelled[fastest]) / speed / GRID_S
    return fastest if undisturbed < first + steps(CLOSE_S) else -1


@once
def _conflicts(log: DrivenLog) -> tuple[tuple[Neighbour, int, int], ...]:
    """Each road user in conflict with the ego, with the steps of the ego and of the other at the
    least PET.
    """
    conflicts = []
    size = np.array([log.car.length, log.car.width])
    centers = log.boxes[POSITION].T
    low, high = centers.min(axis=0) - BEYOND_M, centers.max(axis=0) + BEYOND_M
    for user in log.neighbours:
        moves = user.speed > MOVES_MPS
        if not moves.any():
            continue
        places = user.pose[POSITION].T
        near: BoolArray = ((places >= low) & (places <= high)).all(axis=1)
        angle = 0.0 if user.kind is AgentKind.PEDESTRIAN else CROSSING_RAD
        use = near & moves
        pose = np.ascontiguousarray(user.pose[:, use])
        i, j = _least_encroachment(
            log.boxes, size, pose, user.k[use], np.array(user.size), angle, steps(WINDOW_S)
        )
        if i >= 0:
            conflicts.append((user, i, j))
    return tuple(conflicts)


@kernel
def _least_encroachment(
    ego: FloatArray,
    car: FloatArray,
    pose: FloatArray,
    k: IntArray,
    size: FloatArray,
    angle: float,
    window: int,
) -> tuple[int, int]:
    """(1): the ego's step i and the other's step j of the least |i - j| <= window, the first of
    equals; -1: none.
    """
    best, best_i, best_j = window + 1, -1, -1
    reach = 0.5 * (hypot(car[0], car[1]) + hypot(size[0], size[1]))
    for m in range(len(k)):
        j = k[m]
        x, y, yaw = pose[X, m], pose[Y, m], pose[YAW, m]
        for i in range(max(j - best + 1, 0), min(j + best, ego.shape[1])):
            if abs(i - j) >= best or hypot(x - ego[X, i], y - ego[Y, i]) > reach:
                continue
            if abs(wrap(yaw - ego[YAW, i])) >= angle and overlap(
                x1=ego[X, i],
                y1=ego[Y, i],
                yaw1=ego[YAW, i],
                length1=car[0],
                width1=car[1],
                x2=x,
                y2=y,
                yaw2=yaw,
                length2=size[0],
                width2=size[1],
            ):
                best, best_i, best_j = abs(i - j), i, j
    return best_i, best_j


@kernel
def _courses(
    ego: FloatArray,
    turn: FloatArray,
    car: EgoOutline,
    pose: FloatArray,
    turns: FloatArray,
    k: IntArray,
    size: FloatArray,
    horizon: float,
) -> FloatArray:
    """TTC (`replan.metrics.time_to_collision`), s, and (2), m/s2, `(2, m)` with one road user.

    Inf and 0 beyond the horizon, s.
    """
    courses = np.zeros((2, len(k)))
    courses[0] = inf
    reach = 0.5 * (hypot(car.length, car.width) + hypot(size[0], size[1]))
    for m in range(len(k)):
        x, y, yaw = ego[X, k[m]], ego[Y, k[m]], ego[YAW, k[m]]
        vx, vy = ego[VX, k[m]], ego[VY, k[m]]
        if hypot(vx, vy) <= NO_TTC_MPS:
            continue
        rear_x, rear_y = x - car.axle * np.cos(yaw), y - car.axle * np.sin(yaw)
        other_x, other_y, other_yaw = pose[X, m], pose[Y, m], pose[YAW, m]
        other_vx, other_vy = pose[VX, m], pose[VY, m]
        away, closing = hypot(other_x - x, other_y - y), hypot(other_vx - vx, other_vy - vy)
        if away - reach > horizon * closing or is_behind(rear_x, rear_y, yaw, other_x, other_y):
            continue
        ttc = time_to_contact(
            x1=x,
            y1=y,
            yaw1=yaw,
            length1=car.length,
            width1=car.width,
            x2=other_x,
            y2=other_y,
            yaw2=other_yaw,
            length2=size[0],
            width2=size[1],
            dvx=other_vx - vx,
            dvy=other_vy - vy,
        )
        if ttc < horizon:
            turning = time_to_contact_turning(
                x1=x,
                y1=y,
                yaw1=yaw,
                length1=car.length,
                width1=car.width,
                vx1=vx,
                vy1=vy,
                w1=turn[k[m]],
                x2=other_x,
                y2=other_y,
                yaw2=other_yaw,
                length2=size[0],
                width2=size[1],
                vx2=other_vx,
                vy2=other_vy,
                w2=turns[m],
                turning_s=TURN_S,
            )
            ttc = max(ttc, turning)
        if ttc < horizon:
            courses[0, m], courses[1, m] = ttc, closing**2 / (2.0 * (closing * ttc + DEEP_M))  # (2)
    return courses


@kernel
def _gaps(
    ego: FloatArray, car: EgoOutline, pose: FloatArray, k: IntArray, size: FloatArray
) -> FloatArray:
    """Distance of the boxes of the ego `(5, n)` at the steps `k` and of a road user `(5, m)`, m,
    `(m,)`.

    Minus how deep they overlap; inf where their circles are more than `NEAR_M` apart.
    """
    gaps = np.full(len(k), inf)
    reach = 0.5 * (hypot(car.length, car.width) + hypot(size[0], size[1])) + NEAR_M
    for m in range(len(k)):
        x, y, yaw = ego[X, k[m]], ego[Y, k[m]], ego[YAW, k[m]]
        other_x, other_y, other_yaw = pose[X, m], pose[Y, m], pose[YAW, m]
        if hypot(other_x - x, other_y - y) <= reach:
            gaps[m] = clearance(
                x, y, yaw, car.length, car.width, other_x, other_y, other_yaw, size[0], size[1]
            )
    return gaps


CONFLICTS = (
    EventKind(
        name="contact",
        find=_contact,
        meaning=(
            "The boxes of the ego and a road user overlap, but for phantoms (docs/gates.md). While "
            "they do."
        ),
        measures="speed of the two against each other at first",
        unit="m/s",
        doubted=f"{SUDDEN}; or {TOO_LARGE}; or {SHALLOW}",
    ),
    EventKind(
        name="near_miss_ttc",
        find=_near_miss_ttc,
        meaning=(
            f"For {COURSE_S} s the time to collision is below {TTC_S} s, at constant velocity and "
            f"as the two turn, and only braking with {HARD_MPS2:g} m/s2 or more avoids the "
            f"contact; until {NEAR_S:g} s later the two come within {NEAR_M:g} m, or one of them, "
            f"but for a vehicle beside the band, brakes with {HARD_MPS2:g} m/s2 or more."
        ),
        measures="least TTC",
        unit="s",
        source=(
            "TTC and required deceleration: criticality metrics catalogue, Westhofen et al. 2023"
        ),
        doubted=f"{JUMPS}; or {SHALLOW}",
    ),
    EventKind(
        name="near_miss_pet",
        find=_near_miss_pet,
        meaning=(
            f"The ego, moving, and another road user take the same place within {PET_S:g} s. From "
            "the first to the second."
        ),
        measures="PET",
        unit="s",
        source=(
            "Allen, Shin, Cooper, Transp. Res. Rec. 667 (1978); the bound is that of the metric pet"
        ),
    ),
    EventKind(
        name="ego_yields",
        find=_ego_yields,
        meaning=(
            f"The ego slows down by {SLOWED_MPS:g} m/s and {SLOWED:.0%} or more before another "
            f"road user takes a place on its way, and comes there up to {WINDOW_S:g} s later; at "
            f"the speed before it would have come before the other or less than {CLOSE_S:g} s "
            "after. From when it begins to slow down until it is there."
        ),
        measures="PET",
        unit="s",
    ),
    EventKind(
        name="ego_is_yielded_to",
        find=_ego_is_yielded_to,
        meaning=(
            "The same with the roles exchanged: another road user slows down, and the ego goes "
            "first."
        ),
        measures="PET",
        unit="s",
    ),
)
