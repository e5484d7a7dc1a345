"""What a candidate must keep: speed and acceleration, curvature, the road, and a distance from everybody."""

from __future__ import annotations

from enum import IntEnum
from math import cos, sin
from typing import NamedTuple

import numpy as np

from logs.kernel import BoolArray, FloatArray, IntArray, inner_kernel, kernel
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


class Room(NamedTuple):
    """Where the rear axle may be.

    Attributes:
        knots: Stations of the reference line `(n,)`, uniform, m; `coef` its coefficients `(n-1, 8)`.
        coef: See there.
        left: Greatest offset at the knots `(n,)`, m; `right` least.
        right: See there.
    """

    knots: FloatArray
    coef: FloatArray
    left: FloatArray
    right: FloatArray


class Others(NamedTuple):
    """The predictions, as of `Futures`: poses `(3, n, k)`, sizes `(3, n)`, not looked at on which track `(2, n)`."""

    pose: FloatArray
    sizes: FloatArray
    behind: BoolArray


class Body(NamedTuple):
    """The ego's box and limits: rear axle to the box's centre, length, width (m), curvature (1/m), a_lat (m/s2)."""

    rear_to_center: float
    length: float
    width: float
    max_kappa: float
    lat_accel: float


class Tried(NamedTuple):
    """The pairs, as of `Pairs`: longitudinal polynomials `(m, 6)` and durations `(m,)`; per pair the others `(n,)`."""

    lon: FloatArray
    T: FloatArray
    row: IntArray
    l1: FloatArray
    length: FloatArray
    changes: BoolArray


@inner_kernel
def _met(x: float, y: float, yaw: float, k: int, others: Others, skip: BoolArray, ego: Body) -> bool:
    """Whether the ego's box, grown by each agent's margin, meets an agent at sample k."""
    cx, cy = x + ego.rear_to_center * cos(yaw), y + ego.rear_to_center * sin(yaw)
    pose, sizes = others.pose, others.sizes
    for j in range(pose.shape[1]):
        margin = 2.0 * sizes[2, j]
        if not skip[j] and overlap(
            cx, cy, yaw, ego.length + margin, ego.width + margin,
            pose[0, j, k], pose[1, j, k], pose[2, j, k], sizes[0, j], sizes[1, j],
        ):  # fmt: skip
            return True
    return False


@inner_kernel
def drive_fault(
    at: FloatArray, motion: FloatArray, s0: float, room: Room, others: Others, skip: BoolArray, ego: Body
) -> int:
    """The first fault of a candidate's `states` `(9, k)` along time, 0 where it has none.

    A bound that the start breaks already may stay broken as much as there, but not more.

    Args:
        at: `states`.
        motion: Its s, s_dot, s_ddot `(3, k)`.
        s0: Station of the start.
        room: Of the rear axle.
        others: The predictions.
        skip: Who is not looked at `(n,)`.
        ego: Its box and limits.
    """
    out = _outside(at[6, 0], s0, room.knots, room.left, room.right) + 0.02
    kappa_max = max(ego.max_kappa, abs(at[5, 0]) + 0.01)
    lat_max = max(ego.lat_accel, at[3, 0] ** 2 * abs(at[5, 0]) + 0.2)
    for k in range(at.shape[1]):
        if at[8, k] < MIN_REGULAR or abs(at[7, k]) > MAX_TURN:
            return Fault.FRAME.value
        if abs(at[5, k]) > kappa_max:
            return Fault.CURVATURE.value
        if at[3, k] ** 2 * abs(at[5, k]) > lat_max:
            return Fault.LATERAL_ACCELERATION.value
        if _outside(at[6, k], s0 + motion[0, k], room.knots, room.left, room.right) > out:
            return Fault.CORRIDOR.value
        if k > 0 and at[3, k] > REST_MPS and _met(at[0, k], at[1, k], at[2, k], k, others, skip, ego):
            return Fault.COLLISION.value
    return Fault.NONE.value


@kernel
def first_feasible(
    tried: Tried, order: IntArray, s0: float, start: FloatArray, room: Room, others: Others, ego: Body
) -> tuple[int, IntArray]:
    """The first pair in `order` without a fault, -1 where there is none, and how many were found with which fault.

    Args:
        tried: The pairs.
        order: Of them, the cheapest first.
        s0: Station of the start.
        start: l, l', l''.
        room: Of the rear axle.
        others: The predictions.
        ego: Its box and limits.
    """
    found = np.zeros(FAULTS, np.int64)
    for pair in order:
        i = tried.row[pair]
        motion = sampled(tried.lon[i : i + 1], tried.T[i : i + 1], HORIZON_STEPS)[0]
        lateral = lateral_polynomial(start, tried.l1[pair], tried.length[pair])
        at = states(room.knots, room.coef, s0, lateral, tried.length[pair], motion)
        unseen = others.behind[1] if tried.changes[pair] else others.behind[0]
        fault = drive_fault(at, motion, s0, room, others, unseen, ego)
        if fault == 0:
            return pair, found
        found[fault] += 1
    return -1, found
