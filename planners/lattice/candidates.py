"""Pairs of polynomials: their states, their cost, and their constraints.

Longitudinal, from (s, s_dot, s_ddot) at the start:

(1) keep a speed: quartic s(t) to (s_dot, s_ddot) = (v1, 0) at T, s free
        least integral of jerk^2
(2) reach a point (stop, follow): quintic s(t) to (s1, v1, 0) at T
        least integral of jerk^2 after T both continue with v1

Lateral, from (l, l', l'') at the start:

(3) quintic l(s) to (l1, 0, 0) over D = max(s(T_l) - s(0), `LEAST_M`), then l1

(Werling et al., ICRA 2010; l over s is its form for low speeds. It is used at all speeds here,
since at constant speed it is the same polynomial as l over t, and needs no switch.) Cost of a pair,
where Delta s is the distance by which it misses its wanted point:

(4) J = K_LAT (k_j J_l + k_u T_l + k_l l1^2) + k_j J_s + k_t T + k_v (v1 - v_wanted)^2
        + k_s (Delta s)^2 + k_gap H
    J_s = integral of s_dddot^2 dt
    J_l = (D / T_l)^5 integral of l'''^2 ds, which is the integral of l_dddot^2 dt at constant speed
(5) H = mean over the horizon, sum over the agents on the track of l1, of
        max(0, 1 - gap / (g0 + tau v))^2: the missing share of the wanted gap to the agent ahead,
        and, where the track changes, to the agent behind

Where the traffic rules demand a stop soon, v_wanted is 0, and Delta s is the distance by which a
pair ends before that place. All terms but H are Werling's. Without H, a pair that ends a hand's
breadth behind its leader would be as good as any. A pair must keep bounds of speed and
acceleration, the curvature, the road, and a distance from all agents.
"""

from __future__ import annotations

from enum import IntEnum
from math import atan2, cos, sin, tan
from typing import NamedTuple

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.core.kernel import inner_kernel, kernel
from replan.logs.reference_line import line_curvature, line_frame, line_project
from replan.logs.shapes import overlap
from replan.logs.states import wrap
from replan.planners.frenet.path import MAX_TURN, MIN_REGULAR, quintic
from replan.planners.frenet.profiles import HORIZON_STEPS, STEP_S

# Least length of a lateral move (3), m: at low speeds a shorter one would be too sharp to steer
LEAST_M = 8.0
# Below this speed the ego stands: an agent that then runs into it is not the ego's fault
REST_MPS = 0.05
SIDE_M = 0.1  # An agent nearer than this beside a track is on it
# The names of the terms of (4) in traces
COST_PARTS = ("jerk along", "time", "speed", "sideways", "gap")
STRIDE = 4  # Samples of the plan per sample of the agents' Frenet coordinates


class Fault(IntEnum):
    """Why a candidate cannot be driven."""

    NONE = 0
    BACKWARDS = 1
    TOO_FAST = 2
    ACCELERATION = 3
    BRAKING = 4
    FRAME = 5
    CURVATURE = 6
    LATERAL_ACCELERATION = 7
    CORRIDOR = 8
    COLLISION = 9
    STOP_LINE = 10


REASONS = {
    Fault.BACKWARDS: "drives backwards",
    Fault.TOO_FAST: "above the speed limit",
    Fault.ACCELERATION: "accelerates too hard",
    Fault.BRAKING: "brakes too hard",
    Fault.FRAME: "leaves the Frenet frame",
    Fault.CURVATURE: "bends too sharply",
    Fault.LATERAL_ACCELERATION: "lateral acceleration",
    Fault.CORRIDOR: "leaves the road",
    Fault.COLLISION: "meets a road user",
    Fault.STOP_LINE: "passes a place where it must stop",
}
"""The faults in words."""
X, Y, YAW, SPEED, ACCEL, KAPPA, OFFSET, TURN, REGULAR = range(9)
"""Rows of `states`."""
FAULTS = len(Fault)  # Length of a count by fault: kernels cannot count an enumeration


@kernel
def keep_speed(v0: float, a0: float, v1: float, T: float) -> tuple[float, float, float]:
    """Coefficients c3, c4, c5 = 0 of the quartic (1)."""
    change, bend = v1 - v0 - a0 * T, -a0
    return (change - bend * T / 3.0) / T**2, (bend * T - 2.0 * change) / (4.0 * T**3), 0.0


@kernel
def reach_point(v0: float, a0: float, s1: float, v1: float, T: float) -> tuple[float, float, float]:
    """Coefficients c3, c4, c5 of the quintic (2), s measured from the start."""
    return quintic(0.0, v0 - v1, a0, s1 - v1 * T, T)


@kernel
def third_square(c3: float, c4: float, c5: float, T: float) -> float:
    """Integral of the squared third derivative over [0, T]."""
    a, b, c = 6.0 * c3, 24.0 * c4, 60.0 * c5
    return T * (
        a * a
        + T * (a * b + T * ((b * b + 2.0 * a * c) / 3.0 + T * (0.5 * b * c + T * 0.2 * c * c)))
    )


@kernel
def evaluate_polynomial(c: FloatArray, T: float, x: float) -> tuple[float, float, float]:
    """Value, first and second derivative of a polynomial `(6,)` at x.

    Beyond T it continues linearly.
    """
    u = min(x, T)
    c0, c1, c2, c3, c4, c5 = c
    value = ((((c5 * u + c4) * u + c3) * u + c2) * u + c1) * u + c0
    first = (((5.0 * c5 * u + 4.0 * c4) * u + 3.0 * c3) * u + 2.0 * c2) * u + c1
    second = ((20.0 * c5 * u + 12.0 * c4) * u + 6.0 * c3) * u + 2.0 * c2
    return (value + first * (x - T), first, 0.0) if x > T else (value, first, second)


@kernel
def sample_polynomials(lon: FloatArray, T: FloatArray, steps: int) -> FloatArray:
    """s, s_dot, s_ddot `(m, 3, steps + 1)` of polynomials `(m, 6)` every `STEP_S`."""
    motion = np.empty((len(lon), 3, steps + 1))
    for i in range(len(lon)):
        for k in range(steps + 1):
            motion[i, 0, k], motion[i, 1, k], motion[i, 2, k] = evaluate_polynomial(
                lon[i], T[i], k * STEP_S
            )
    return motion


@kernel
def squared_jerks(coef: FloatArray, T: FloatArray) -> FloatArray:
    """Integral of the squared third derivative of each polynomial `(m, 6)` over its duration
    `(m,)`.
    """
    jerks = np.empty(len(T))
    for i in range(len(T)):
        jerks[i] = third_square(coef[i, 3], coef[i, 4], coef[i, 5], T[i])
    return jerks


@kernel
def lateral_polynomial(start: FloatArray, l1: float, D: float) -> FloatArray:
    """Coefficients `(6,)` of (3), lowest power first, from `start` (l, l', l'')."""
    c3, c4, c5 = quintic(start[0], start[1], start[2], l1, D)
    return np.array([start[0], start[1], 0.5 * start[2], c3, c4, c5])


@kernel
def states(
    knots: FloatArray,
    coef: FloatArray,
    s0: float,
    lateral: FloatArray,
    D: float,
    motion: FloatArray,
) -> FloatArray:
    """Rows x, y, yaw, v, a, kappa, l, turn, 1 - kappa l `(9, k)` of a candidate
    (`replan.planners.frenet.path`, (1) to (3)).

    a = s_ddot R / cos d + s_dot^2 / cos d (R tan d (kappa R / cos d - kappa_r) - (kappa_r' l +
    kappa_r l')) with R = 1 - kappa_r l and d the heading off the line.
    """
    rows = np.empty((9, motion.shape[1]))
    for k in range(motion.shape[1]):
        ahead, v, a = motion[0, k], motion[1, k], motion[2, k]
        l, dl, ddl = evaluate_polynomial(lateral, D, ahead)
        x, y, yaw_r, kappa_r = line_frame(knots, coef, s0 + ahead)
        s = s0 + ahead
        dkappa_r = 2.0 * (
            line_curvature(knots, coef, s + 0.25) - line_curvature(knots, coef, s - 0.25)
        )
        regular = 1.0 - kappa_r * l
        R = max(regular, MIN_REGULAR)
        turn = atan2(dl, R)
        c, bend = cos(turn), dkappa_r * l + kappa_r * dl
        kappa = ((ddl + bend * tan(turn)) * c * c / R + kappa_r) * c / R
        rows[X, k], rows[Y, k] = x - l * sin(yaw_r), y + l * cos(yaw_r)
        rows[YAW, k] = yaw_r + turn
        rows[SPEED, k] = v * R / c
        rows[ACCEL, k] = a * R / c
        rows[ACCEL, k] += v**2 / c * (R * tan(turn) * (kappa * R / c - kappa_r) - bend)
        rows[KAPPA, k], rows[OFFSET, k] = kappa, l
        rows[TURN, k], rows[REGULAR, k] = turn, regular
        if k > 0:
            rows[YAW, k] = rows[YAW, k - 1] + wrap(rows[YAW, k] - rows[YAW, k - 1])
    return rows


@kernel
def speed_faults(
    motion: FloatArray,
    s0: float,
    grid: FloatArray,
    limit: FloatArray,
    allowed: FloatArray,
    upper: FloatArray,
    bounds: FloatArray,
) -> IntArray:
    """Per longitudinal candidate, s from the start, s_dot, s_ddot `(m, 3, k)`, its first fault.

    `limit` is that at stations `grid`, uniform; `allowed` a speed that is always allowed at each
    time `(k,)`, since an ego that starts too fast has to slow down; `upper` the distance that the
    traffic rules permit `(k,)`, m from the start; `bounds` the greatest acceleration, the greatest
    deceleration, and the permitted excess over the limit.
    """
    faults = np.zeros(len(motion), np.int64)
    h = grid[1] - grid[0]
    for i in range(len(motion)):
        for k in range(motion.shape[2]):
            cell = min(max(int((s0 + motion[i, 0, k] - grid[0]) / h), 0), len(grid) - 1)
            v, a = motion[i, 1, k], motion[i, 2, k]
            if v < -REST_MPS:
                faults[i] = Fault.BACKWARDS.value
            elif motion[i, 0, k] > upper[k]:
                faults[i] = Fault.STOP_LINE.value
            elif v > max(limit[cell] + bounds[2], allowed[k]):
                faults[i] = Fault.TOO_FAST
            elif a > max(bounds[0], motion[i, 2, 0] + 1e-6):
                faults[i] = Fault.ACCELERATION.value
            elif a < min(-bounds[1], motion[i, 2, 0] - 1e-6):
                faults[i] = Fault.BRAKING.value
            if faults[i] != 0:
                break
    return faults


@inner_kernel
def _outside(l: float, s: float, grid: FloatArray, left: FloatArray, right: FloatArray) -> float:
    """Distance of an offset outside the edges at station s, m."""
    cell = min(max(int((s - grid[0]) / (grid[1] - grid[0])), 0), len(grid) - 1)
    return max(l - left[cell], right[cell] - l, 0.0)


class FrenetStart(NamedTuple):
    """The start in the Frenet frame: station, m; l, l', l''; s_dot, m/s; s_ddot, m/s2."""

    s: float
    lateral: tuple[float, float, float]
    speed: float
    accel: float


class NearFutures(NamedTuple):
    """The n predictions near the ego, on the plan's grid of `HORIZON_KNOTS` times."""

    agent: IntArray  # `(n,)` index into the frame's agents
    # x, y, yaw `(3, n, HORIZON_KNOTS)`; beyond the predictions' horizon all agents stay
    pose: FloatArray
    frenet: FloatArray  # `futures_frenet` of every `STRIDE`-th time `(4, n, m)`
    speed: FloatArray  # Speed along the line at the first time `(n,)`, m/s
    sizes: FloatArray  # Length, width, margin `(3, n)`, m
    # `(2, n)` which the ego ignores: when it keeps its track, and when it changes it
    behind: BoolArray


class Longitudinal(NamedTuple):
    """Longitudinal polynomials that keep the limits, m of them: coefficients `(m, 6)`, lowest power
    first.

    Durations T, s, end speeds v1, m/s, distances by which they miss their wanted point, m, and the
    index of their end offset, -1 for any: `(m,)` each.
    """

    coef: FloatArray
    T: FloatArray
    v1: FloatArray
    missed: FloatArray
    track: IntArray


class Pairs(NamedTuple):
    """Candidates, n of them: a row of `Longitudinal` with an end offset and a length of the lateral
    move.
    """

    lon: Longitudinal  # The longitudinal polynomials; `row` `(n,)` index into them
    row: IntArray
    l1: FloatArray  # End offset `(n,)`, m; `length` D of the lateral polynomial
    length: FloatArray
    changes: BoolArray  # `(n,)` whether they end on another track
    costs: FloatArray  # Cost by `COST_PARTS` `(5, n)`
    # Number of pairs, by fault, that were not made since their longitudinal polynomial breaks a
    # limit
    faults: IntArray


class Room(NamedTuple):
    """Where the rear axle may be: stations of the reference line `(n,)`, uniform, m, its
    coefficients `(n-1, 8)`.

    Also the greatest and the least offset at these stations `(n,)`, m.
    """

    knots: FloatArray
    coef: FloatArray
    left: FloatArray
    right: FloatArray


class EgoLimits(NamedTuple):
    """The ego's box and limits: distance from rear axle to centre, length, width (m), curvature
    (1/m), a_lat (m/s2).
    """

    rear_to_center: float
    length: float
    width: float
    max_kappa: float
    lat_accel: float


@inner_kernel
def _met(
    x: float, y: float, yaw: float, k: int, others: NearFutures, skip: BoolArray, ego: EgoLimits
) -> bool:
    """Whether the ego's box, grown by each agent's margin, meets an agent at sample k."""
    cx, cy = x + ego.rear_to_center * cos(yaw), y + ego.rear_to_center * sin(yaw)
    pose, sizes = others.pose, others.sizes
    for j in range(pose.shape[1]):
        margin = 2.0 * sizes[2, j]
        if not skip[j] and overlap(
            cx,
            cy,
            yaw,
            ego.length + margin,
            ego.width + margin,
            pose[0, j, k],
            pose[1, j, k],
            pose[2, j, k],
            sizes[0, j],
            sizes[1, j],
        ):
            return True
    return False


@inner_kernel
def drive_fault(
    drive: FloatArray,
    motion: FloatArray,
    s0: float,
    room: Room,
    others: NearFutures,
    skip: BoolArray,
    ego: EgoLimits,
) -> int:
    """The first fault of a candidate's `states` `(9, k)` and s, s_dot, s_ddot `(3, k)` over time, 0
    without one.

    A bound that the start violates may stay violated by as much as at the start, but not more.
    `skip`: ignored agents.
    """
    outside = _outside(drive[OFFSET, 0], s0, room.knots, room.left, room.right) + 0.02
    kappa_max = max(ego.max_kappa, abs(drive[KAPPA, 0]) + 0.01)
    lat_max = max(ego.lat_accel, drive[SPEED, 0] ** 2 * abs(drive[KAPPA, 0]) + 0.2)
    for k in range(drive.shape[1]):
        v, bend = drive[SPEED, k], abs(drive[KAPPA, k])
        if drive[REGULAR, k] < MIN_REGULAR or abs(drive[TURN, k]) > MAX_TURN:
            return Fault.FRAME.value
        if bend > kappa_max:
            return Fault.CURVATURE.value
        if v**2 * bend > lat_max:
            return Fault.LATERAL_ACCELERATION.value
        s = s0 + motion[0, k]
        if _outside(drive[OFFSET, k], s, room.knots, room.left, room.right) > outside:
            return Fault.CORRIDOR.value
        x, y, yaw = drive[X, k], drive[Y, k], drive[YAW, k]
        if k > 0 and v > REST_MPS and _met(x, y, yaw, k, others, skip, ego):
            return Fault.COLLISION.value
    return Fault.NONE.value


@kernel
def first_feasible(
    pairs: Pairs,
    order: IntArray,
    ego: FrenetStart,
    room: Room,
    others: NearFutures,
    body: EgoLimits,
) -> tuple[int, IntArray]:
    """The first pair in `order` without a fault, -1 if there is none, and the number of pairs found
    with each fault.
    """
    counts, start = np.zeros(FAULTS, np.int64), np.array(ego.lateral)
    for pair in order:
        i = pairs.row[pair]
        motion = sample_polynomials(
            pairs.lon.coef[i : i + 1], pairs.lon.T[i : i + 1], HORIZON_STEPS
        )[0]
        lateral = lateral_polynomial(start, pairs.l1[pair], pairs.length[pair])
        drive = states(room.knots, room.coef, ego.s, lateral, pairs.length[pair], motion)
        unseen = others.behind[1] if pairs.changes[pair] else others.behind[0]
        fault = drive_fault(drive, motion, ego.s, room, others, unseen, body)
        if fault == 0:
            return pair, counts
        counts[fault] += 1
    return -1, counts


@kernel
def futures_frenet(
    knots: FloatArray,
    coef: FloatArray,
    x: FloatArray,
    y: FloatArray,
    yaw: FloatArray,
    sizes: FloatArray,
    s_ego: float,
) -> FloatArray:
    """Predictions `(n, k)` in the Frenet frame: s, l, half length along s, half width along l
    `(4, n, k)`.
    """
    frenet = np.empty((4, x.shape[0], x.shape[1]))
    for i in range(len(x)):
        guess, window = s_ego, 150.0
        for k in range(x.shape[1]):
            s, l = line_project(knots, coef, x[i, k], y[i, k], guess, window)
            guess, window = s, 25.0
            turn = yaw[i, k] - line_frame(knots, coef, s)[2]
            c, d = abs(cos(turn)), abs(sin(turn))
            frenet[0, i, k], frenet[1, i, k] = s, l
            frenet[2, i, k] = 0.5 * (sizes[0, i] * c + sizes[1, i] * d)
            frenet[3, i, k] = 0.5 * (sizes[0, i] * d + sizes[1, i] * c)
    return frenet


@kernel
def headway(
    motion: FloatArray,
    s0: float,
    others: FloatArray,
    speed: FloatArray,
    behind: BoolArray,
    l1: float,
    box: FloatArray,
    wanted_gap: FloatArray,
    changes: bool,
) -> FloatArray:
    """(5) of longitudinal candidates `(m, 3, k)`, as in `sample_polynomials`, on the track at
    offset `l1`: `(m,)`.

    `others` are `futures_frenet`, `behind` is as in `NearFutures`; `box` has the distances from the
    rear axle to front and rear, and half the width, m; `wanted_gap` is g0, tau; `changes`: whether
    the track is not the ego's.
    """
    costs = np.zeros(len(motion))
    for j in range(others.shape[1]):
        if behind[1, j] or (behind[0, j] and not changes):
            continue
        for k in range(others.shape[2]):
            if abs(others[1, j, k] - l1) > others[3, j, k] + box[2] + SIDE_M:
                continue
            for i in range(len(motion)):
                s, v = s0 + motion[i, 0, k * STRIDE], motion[i, 1, k * STRIDE]
                gap = others[0, j, k] - others[2, j, k] - s - box[0]
                if behind[0, j]:
                    gap, v = s - box[1] - others[0, j, k] - others[2, j, k], max(speed[j], 0.0)
                elif v < REST_MPS:
                    continue
                missing = 1.0 - max(gap, 0.0) / (wanted_gap[0] + wanted_gap[1] * v)
                costs[i] += max(missing, 0.0) ** 2 / others.shape[2]  # (5)
    return costs


@kernel
def lateral_costs(
    motion: FloatArray, start: FloatArray, l1: float, T: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The lateral part of (4), without K_LAT, and the lengths D, of the pairs with durations `T`
    `(p,)`: `(m, p)` each.

    `start` is l, l', l''; `weights` are k_j, k_u, k_l.
    """
    cost, length = np.empty((len(motion), len(T))), np.empty((len(motion), len(T)))
    for i in range(len(motion)):
        for p in range(len(T)):
            D = max(motion[i, 0, min(int(T[p] / STEP_S + 0.5), motion.shape[2] - 1)], LEAST_M)
            c3, c4, c5 = quintic(start[0], start[1], start[2], l1, D)
            jerk = third_square(c3, c4, c5, D) * (D / T[p]) ** 5  # (4), J_l
            cost[i, p], length[i, p] = weights[0] * jerk + weights[1] * T[p] + weights[2] * l1**2, D
    return cost, length
