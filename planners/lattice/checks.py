"""What a candidate must keep: speed and acceleration, curvature, the road, and a distance from everybody."""

from __future__ import annotations

from enum import IntEnum
from math import cos, sin

import numpy as np

from logs.kernel import BoolArray, FloatArray, IntArray, kernel
from logs.shapes import overlap
from planners.frenet.path import MAX_TURN, MIN_REGULAR
from planners.frenet.profiles import HORIZON_STEPS
from planners.lattice.polynomials import lateral_polynomial, sampled, states

REST_MPS = 0.05
"""Below this the ego stands: who then runs into it is not its doing."""


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


SAID = {
    Fault.BACKWARDS: "drives backwards",
    Fault.TOO_FAST: "above the speed limit",
    Fault.ACCELERATION: "accelerates too hard",
    Fault.BRAKING: "brakes too hard",
    Fault.FRAME: "leaves the Frenet frame",
    Fault.CURVATURE: "bends too sharply",
    Fault.LATERAL_ACCELERATION: "lateral acceleration",
    Fault.CORRIDOR: "leaves the road",
    Fault.COLLISION: "meets somebody",
    Fault.STOP_LINE: "passes a place where it must stop",
}
"""The faults in words."""
FAULTS = len(Fault)
"""Length of a count by fault."""


@kernel
def speed_faults(
    motion: FloatArray, s0: float, grid: FloatArray, limit: FloatArray, allowed: FloatArray, upper: FloatArray,
    bounds: FloatArray,
) -> IntArray:  # fmt: skip
    """Per longitudinal candidate `(m, 3, k)` its first fault.

    Args:
        motion: s (from the start), s_dot, s_ddot.
        s0: Station of the start.
        grid: Stations of `limit`, uniform.
        limit: Speed limit, m/s.
        allowed: Speed that is allowed in any case at each time `(k,)`: who starts too fast has to come down.
        upper: How far the traffic rules let the ego go `(k,)`, m from the start; inf where they do not care.
        bounds: Greatest acceleration, hardest deceleration, room above the limit.
    """
    out = np.zeros(len(motion), np.int64)
    h = grid[1] - grid[0]
    for i in range(len(motion)):
        for k in range(motion.shape[2]):
            at = min(max(int((s0 + motion[i, 0, k] - grid[0]) / h), 0), len(grid) - 1)
            v, a = motion[i, 1, k], motion[i, 2, k]
            if v < -REST_MPS:
                out[i] = Fault.BACKWARDS.value
            elif motion[i, 0, k] > upper[k]:
                out[i] = Fault.STOP_LINE.value
            elif v > max(limit[at] + bounds[2], allowed[k]):
                out[i] = Fault.TOO_FAST
            elif a > max(bounds[0], motion[i, 2, 0] + 1e-6):
                out[i] = Fault.ACCELERATION.value
            elif a < min(-bounds[1], motion[i, 2, 0] - 1e-6):
                out[i] = Fault.BRAKING.value
            if out[i] != 0:
                break
    return out


@kernel
def _outside(l: float, s: float, grid: FloatArray, left: FloatArray, right: FloatArray) -> float:  # noqa: E741
    """How far an offset lies outside of the edges at station s, m."""
    at = min(max(int((s - grid[0]) / (grid[1] - grid[0])), 0), len(grid) - 1)
    return max(l - left[at], right[at] - l, 0.0)


@kernel
def _met(
    x: float, y: float, yaw: float, k: int, others: FloatArray, sizes: FloatArray, skip: BoolArray, car: FloatArray
) -> bool:
    """Whether the ego's box, grown by each agent's margin, meets an agent at sample k.

    `others` is x, y, yaw `(3, n, k)`, `sizes` length, width, margin `(3, n)`, `car` axle to centre, length, width.
    """
    cx, cy = x + car[0] * cos(yaw), y + car[0] * sin(yaw)
    for j in range(others.shape[1]):
        margin = 2.0 * sizes[2, j]
        if not skip[j] and overlap(
            cx, cy, yaw, car[1] + margin, car[2] + margin,
            others[0, j, k], others[1, j, k], others[2, j, k], sizes[0, j], sizes[1, j],
        ):  # fmt: skip
            return True
    return False


@kernel
def drive_fault(
    at: FloatArray, motion: FloatArray, s0: float, grid: FloatArray, left: FloatArray, right: FloatArray,
    others: FloatArray, sizes: FloatArray, skip: BoolArray, car: FloatArray, limits: FloatArray,
) -> int:  # fmt: skip
    """The first fault of a candidate's `states` `(9, k)` along time, 0 where it has none.

    A bound that the start breaks already may stay broken as much as there, but not more.

    Args:
        at: `states`.
        motion: Its s, s_dot, s_ddot `(3, k)`.
        s0: Station of the start.
        grid: Stations of the edges, uniform; `left` and `right` bound the rear axle's offset.
        left: m.
        right: m.
        others: As of `_met`; `sizes`, `skip` and `car` likewise.
        sizes: m.
        skip: Who is not looked at.
        car: m.
        limits: Greatest curvature, lateral acceleration.
    """
    out = _outside(at[6, 0], s0, grid, left, right) + 0.02
    kappa_max = max(limits[0], abs(at[5, 0]) + 0.01)
    lat_max = max(limits[1], at[3, 0] ** 2 * abs(at[5, 0]) + 0.2)
    for k in range(at.shape[1]):
        if at[8, k] < MIN_REGULAR or abs(at[7, k]) > MAX_TURN:
            return Fault.FRAME.value
        if abs(at[5, k]) > kappa_max:
            return Fault.CURVATURE.value
        if at[3, k] ** 2 * abs(at[5, k]) > lat_max:
            return Fault.LATERAL_ACCELERATION.value
        if _outside(at[6, k], s0 + motion[0, k], grid, left, right) > out:
            return Fault.CORRIDOR.value
        if k > 0 and at[3, k] > REST_MPS and _met(at[0, k], at[1, k], at[2, k], k, others, sizes, skip, car):
            return Fault.COLLISION.value
    return Fault.NONE.value


@kernel
def first_feasible(
    knots: FloatArray, coef: FloatArray, s0: float, start: FloatArray, lon: FloatArray, T: FloatArray,
    row: IntArray, l1: FloatArray, length: FloatArray, changes: BoolArray, order: IntArray,
    left: FloatArray, right: FloatArray, others: FloatArray, sizes: FloatArray, skip: BoolArray,
    car: FloatArray, limits: FloatArray,
) -> tuple[int, IntArray]:  # fmt: skip
    """The first pair in `order` without a fault, -1 where there is none, and how many were found with which fault.

    Args:
        knots: Of the reference line; `coef` likewise.
        coef: `(n-1, 8)`.
        s0: Station of the start.
        start: l, l', l''.
        lon: Longitudinal polynomials `(m, 6)`, their durations `T` `(m,)`.
        T: s.
        row: Per pair, its longitudinal polynomial, end offset, lateral length, and whether it changes the track.
        l1: m.
        length: m.
        changes: bool.
        order: Pairs, the cheapest first.
        left: As of `drive_fault`, on `knots`; `right`, `others`, `sizes`, `car` and `limits` likewise.
        right: m.
        others: `(3, n, k)`.
        sizes: `(3, n)`.
        skip: `(2, n)`: who is not looked at on the own track, and on another.
        car: m.
        limits: 1/m, m/s2.
    """
    found = np.zeros(FAULTS, np.int64)
    for pair in order:
        i = row[pair]
        motion = sampled(lon[i : i + 1], T[i : i + 1], HORIZON_STEPS)[0]
        lateral = lateral_polynomial(start, l1[pair], length[pair])
        at = states(knots, coef, s0, lateral, length[pair], motion)
        unseen = skip[1] if changes[pair] else skip[0]
        fault = drive_fault(at, motion, s0, knots, left, right, others, sizes, unseen, car, limits)
        if fault == 0:
            return pair, found
        found[fault] += 1
    return -1, found
