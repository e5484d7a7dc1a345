"""The MPC's prediction: deviations from exact following of the plan, linear and time-varying along it.

xi = (e_s m, e_v m/s, e_a m/s2, e_d m, v_lat m/s, e_phi rad, r rad/s, sigma), u = (a m/s2, w): each minus that of
exact following (`lateral_model` (4), with the slip that was learned); input a is the commanded acceleration, w the
steer rate.

(1) e_s' = e_v,   e_v' = e_a,   e_a' = (a - e_a) / lag                             lag of the pedal that the plan takes
    (not e_v + v kappa e_d: a controller that knows it cuts corners to make up for lost time)
(2) e_d' = v_lat + v e_phi,   e_phi' = r,   (v_lat, r)' = body_model(v),   steer' = w
(3) sigma = g steer,  w <- g w,  g = 1 + (v / v_0)^2             so that one weight suits all speeds
(4) xi[k+1] = A_k xi[k] + B_k u[k]       exact for inputs held over h; (2) from a table over speed
(5) |steer| <= max_steer, |steer'| <= max_steer_rate, a within the power train's: of the whole motion, plan included
(6) cos(j pi / 4) a_long + sin(j pi / 4) a_lat <= mu g cos(pi / 8), j = 0..7: the polygon within the friction circle,
    a_lat = v^2 kappa + v^2 steer / d_0

The plan is entered at the ego's foot point: station s_0 + the way driven at v_k, which goes from the ego's speed to the
plan's in SETTLE_S.
"""

from __future__ import annotations

from functools import lru_cache
from math import cos, exp, pi, sin

import numpy as np

from logs.kernel import FloatArray, IntArray, frozen, kernel
from logs.vehicle import VehicleParameters
from replay.control.feedforward import following_at, steer_for
from replay.control.lateral_model import body_model, has_rigid_tyres, held
from replay.control.regulator import at_speed, table_speeds
from replay.vehicle.pedal_map import PedalMap, reach
from replay.vehicle.plan_path import path_kappa, timed

STATES, INPUTS, SIDES = 8, 2, 8
LIMITS = 3 + SIDES
"""Bounded rows of a step: a, w, sigma, the polygon (6)."""
STEP_SIZE = STATES * INPUTS + STATES * STATES + 2 * SIDES
SETTLE_S = 1.0
GRAVITY = 9.81

_A = np.zeros((STATES, STATES), bool)
_A[0, [0, 1, 2]] = _A[1, [1, 2]] = _A[2, 2] = _A[3, 3:] = True
_A[4, [4, 6, 7]] = _A[5, [4, 5, 6, 7]] = _A[6, [4, 6, 7]] = _A[7, 7] = True
_B = np.zeros((STATES, INPUTS), bool)
_B[:3, 0] = _B[3:, 1] = True
PATTERN_A, PATTERN_B = frozen(_A, np.bool_), frozen(_B, np.bool_)
"""Where A and B of (4) may differ from 0."""


@lru_cache(maxsize=32)
def lateral_table(p: VehicleParameters, h: float) -> FloatArray:
    """A and B of (2) held over `h` s `(n, 5, 6)`, of (e_d, v_lat, e_phi, r, steer), at `feedforward.table_speeds`."""
    of = _rigid if has_rigid_tyres(p) else _slipping
    return frozen(np.stack([of(v, p, h) for v in table_speeds().tolist()]))


def _slipping(v: float, p: VehicleParameters, h: float) -> FloatArray:
    body, steered = body_model(v, p)
    A = np.zeros((5, 5))
    A[0, [1, 2]] = 1.0, v  # (2)
    A[2, 3] = 1.0
    A[np.ix_([1, 3], [1, 3])] = body
    A[[1, 3], 4] = steered
    return np.hstack(held(A, np.array([[0.0], [0.0], [0.0], [0.0], [1.0]]), h))


def _rigid(v: float, p: VehicleParameters, h: float) -> FloatArray:
    """Rigid tyres: (e_d, e_phi, steer) moves by itself, v_lat = 0, r = v steer / L."""
    turn = v / p.wheelbase
    A, B = held(np.array([[0.0, v, 0.0], [0.0, 0.0, turn], [0.0, 0.0, 0.0]]), np.array([[0.0], [0.0], [1.0]]), h)
    out = np.zeros((5, 6))
    out[np.ix_([0, 2, 4], [0, 2, 4, 5])] = np.hstack([A, B])
    out[3] = turn * out[4]
    return out


@kernel
def entered(
    times: FloatArray, knots: FloatArray, slips: FloatArray, wheelbase: float, ratios: tuple[float, float],
    lags: tuple[float, float, float], t: float, foot: float, v: float, h: float, n: int,
) -> FloatArray:  # fmt: skip
    """The plan as it will be driven, `(n + 1, 7)`: v, kappa, a, commanded a, steer, d_0, lag of the pedal in use.

    Args:
        times: Of `PlanPath`; `knots` likewise.
        knots: Of `PlanPath`.
        slips: From `slip_table`.
        wheelbase: m.
        ratios: Learned compliance of front and rear axle.
        lags: Of throttle and brake, s, and the acceleration below which the brake is in use, m/s2.
        t: Now, s.
        foot: Station of the ego's foot point, m.
        v: Of the ego, m/s.
        h: Step, s.
        n: Steps.
    """
    out = np.empty((n + 1, 7))
    _, planned, _ = timed(times, t)
    s, before = foot, v
    for k in range(n + 1):
        _, wanted, a = timed(times, t + k * h)
        speed = max(wanted + (v - planned) * exp(-k * h / SETTLE_S), 0.0)
        s += 0.5 * h * (speed + before) if k > 0 else 0.0
        lag = lags[0] if a >= lags[2] else lags[1]
        _, angle = following_at(slips, wheelbase, ratios, speed)
        out[k] = (
            speed, path_kappa(knots, s), a, timed(times, t + k * h + lag)[2],
            steer_for(knots, s, speed, angle), angle[0], lag,
        )  # fmt: skip
        before = speed
    return out


@kernel
def predicted(along: FloatArray, table: FloatArray, v_0: float, h: float) -> tuple[FloatArray, FloatArray]:
    """A `(n, 8, 8)` and B `(n, 8, 2)` of (4)."""
    n = len(along) - 1
    A, B = np.zeros((n, STATES, STATES)), np.zeros((n, STATES, INPUTS))
    for k in range(n):
        v, lag = along[k, 0], along[k, 6]
        decay = exp(-h / lag)
        once = lag * (1.0 - decay)
        twice = lag * (h - once)
        A[k, 0, 0], A[k, 0, 1], A[k, 0, 2] = 1.0, h, twice  # (1), (4)
        A[k, 1, 1], A[k, 1, 2], A[k, 2, 2] = 1.0, once, decay
        B[k, 0, 0], B[k, 1, 0], B[k, 2, 0] = 0.5 * h * h - twice, h - once, 1.0 - decay
        now, then = 1.0 + (v / v_0) ** 2, 1.0 + (along[k + 1, 0] / v_0) ** 2  # (3)
        i, u = at_speed(table, v)
        for row in range(5):
            for column in range(6):
                entry = table[i, row, column] + u * (table[i + 1, row, column] - table[i, row, column])
                entry *= then if row == 4 else 1.0
                if column < 4:
                    A[k, 3 + row, 3 + column] = entry
                elif column == 4:
                    A[k, 3 + row, 7] = entry / now
                else:
                    B[k, 3 + row, 1] = entry / now
    return A, B


@kernel
def limits(
    along: FloatArray, train: PedalMap, grip: float, steering: tuple[float, float], v_0: float, h: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(5)-(6) for the deviations: lower and upper bounds `(n, LIMITS)`, polygon rows `(n, SIDES, 2)` of (e_a, sigma).

    Args:
        along: From `entered`.
        train: Of the vehicle: what it can do at each speed.
        grip: mu g, m/s2.
        steering: max_steer rad, max_steer_rate rad/s.
        v_0: Of (3).
        h: Step, s.
    """
    n = len(along) - 1
    lower, upper = np.full((n, LIMITS), -np.inf), np.empty((n, LIMITS))
    sides = np.empty((n, SIDES, 2))
    for k in range(n):
        scale, then = 1.0 + (along[k, 0] / v_0) ** 2, 1.0 + (along[k + 1, 0] / v_0) ** 2
        turning = (along[k + 1, 4] - along[k, 4]) / h
        v, steer = along[k + 1, 0], along[k + 1, 4]
        least, most = reach(train, along[k, 0])
        lower[k, 0], upper[k, 0] = least - along[k, 3], most - along[k, 3]  # (5)
        lower[k, 1], upper[k, 1] = scale * (-steering[1] - turning), scale * (steering[1] - turning)
        lower[k, 2], upper[k, 2] = then * (-steering[0] - steer), then * (steering[0] - steer)
        for j in range(SIDES):
            c, s = cos(0.25 * pi * j), sin(0.25 * pi * j)
            sides[k, j, 0], sides[k, j, 1] = c, s * v * v / (along[k + 1, 5] * then)
            # (6)
            upper[k, 3 + j] = grip * cos(pi / SIDES) - c * along[k + 1, 2] - s * v * v * along[k + 1, 1]
    return lower, upper, sides


@kernel
def packed(A: FloatArray, B: FloatArray, sides: FloatArray, places: IntArray) -> FloatArray:
    """The entries of the program's matrix in the order of `places` (indices into all entries, then 1)."""
    n = len(A)
    entries = np.ones(n * STEP_SIZE + 1)
    at = 0
    for k in range(n):
        for row in range(STATES):
            for column in range(INPUTS):
                entries[at] = -B[k, row, column]
                at += 1
        for row in range(STATES):
            for column in range(STATES):
                entries[at] = -A[k, row, column]
                at += 1
        for side in range(SIDES):
            entries[at], entries[at + 1] = sides[k, side, 0], sides[k, side, 1]
            at += 2
    out = np.empty(len(places))
    for i in range(len(places)):
        out[i] = entries[places[i]]
    return out
