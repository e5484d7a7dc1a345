"""The MPC's prediction: deviations from exact following of the plan, linear and time-varying along
it.

xi = (e_s m, e_v m/s, e_a m/s2, e_d m, v_lat m/s, e_phi rad, r rad/s, sigma), u = (a m/s2, w): each
minus that of exact following (`lateral_model` (4), with the slip that was learned); input a is the
commanded acceleration, w the steer rate.

(1) e_s' = e_v,   e_v' = e_a,   e_a' = (a - e_a) / lag
        lag of the pedal that the plan takes (not e_v + v kappa e_d: with that term the controller
        would cut corners to make up for lost time)
(2) e_d' = v_lat + v e_phi,   e_phi' = r,   (v_lat, r)' = body_model(v),   steer' = w
(3) sigma = g steer,  w <- g w,  g = 1 + (v / v_0)^2             so that one weight suits all speeds
(4) xi[k+1] = A_k xi[k] + B_k u[k]       exact for inputs held over h; (2) from a table over speed
(5) |steer| <= max_steer, |steer'| <= max_steer_rate, a within the power train's:
        of the whole motion, plan included
(6) cos(j pi / 4) a_long + sin(j pi / 4) a_lat <= mu g cos(pi / 8), j = 0..7:
        the polygon within the friction circle,
    a_lat = v^2 kappa + v^2 steer / d_0

The plan is entered at the ego's foot point: station s_0 + the way driven at v_k, which goes from
the ego's speed to the plan's in SETTLE_S.

Before, it is resampled by quintic polynomials, the paper's eq. 16: between two samples, in x and in
y of their own,

(7) f(t) = a_0 + a_1 (t - t_i) + ... + a_5 (t - t_i)^5        (the paper prints a_6 for a_5)

matches position, velocity (v cos yaw, v sin yaw) and acceleration (a along, v^2 kappa across) at
both samples: it is C2 there. Heading and speed are those of f'; below SLOW_MPS they have no
direction, and the headings of the samples are used. Curvature is linear: f'' would give it with the
rounding of the positions over h^2.
"""

from __future__ import annotations

from math import atan2, cos, exp, hypot, pi, sin

import numpy as np

from replan.core.arrays import FloatArray, IntArray, frozen
from replan.core.kernel import kernel
from replan.logs.states import Trajectory, wrap
from replan.replay.control.lateral_model import at_speed, following_at, steer_for
from replan.replay.vehicle.pedal_map import PedalMap, reach
from replan.replay.vehicle.plan_path import path_kappa, timed

STATES, INPUTS, SIDES = 8, 2, 8
LIMITS = 3 + SIDES
"""Bounded rows of a step: a, w, sigma, the polygon (6)."""
STEP_SIZE = STATES * INPUTS + STATES * STATES + 2 * SIDES
SETTLE_S = 1.0
SLOW_MPS = 1.0

_A = np.zeros((STATES, STATES), bool)
_A[0, [0, 1, 2]] = _A[1, [1, 2]] = _A[2, 2] = _A[3, 3:] = True
_A[4, [4, 6, 7]] = _A[5, [4, 5, 6, 7]] = _A[6, [4, 6, 7]] = _A[7, 7] = True
_B = np.zeros((STATES, INPUTS), bool)
_B[:3, 0] = _B[3:, 1] = True
PATTERN_A, PATTERN_B = frozen(_A, np.bool_), frozen(_B, np.bool_)
"""Where A and B of (4) may differ from 0."""


@kernel
def entered(
    times: FloatArray,
    knots: FloatArray,
    slips: FloatArray,
    wheelbase: float,
    ratios: tuple[float, float],
    lags: tuple[float, float, float],
    t: float,
    foot: float,
    v: float,
    h: float,
    n: int,
) -> FloatArray:
    """The plan as it will be driven, `(n + 1, 7)`: v, kappa, a, commanded a, steer, d_0, lag of the
    pedal in use.

    `slips` is from `slip_table`; `ratios` are the learned compliances of front and rear axle;
    `lags` those of throttle and brake, s, and the acceleration below which the brake is in use,
    m/s2; `foot` is the station of the ego's foot point at `t`, m; `v` its speed, m/s; `n` steps of
    `h` s.
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
            speed,
            path_kappa(knots, s),
            a,
            timed(times, t + k * h + lag)[2],
            steer_for(knots, s, speed, angle),
            angle[0],
            lag,
        )
        before = speed
    return out


@kernel
def predicted(
    along: FloatArray, table: FloatArray, v_0: float, h: float
) -> tuple[FloatArray, FloatArray]:
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
                entry = table[i, row, column] + u * (
                    table[i + 1, row, column] - table[i, row, column]
                )
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
    along: FloatArray,
    train: PedalMap,
    grip: float,
    steering: tuple[float, float],
    v_0: float,
    h: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(5)-(6) for the deviations: lower and upper bounds `(n, LIMITS)`, polygon rows
    `(n, SIDES, 2)` of (e_a, sigma).

    `along` is from `entered`; `grip` is mu g, m/s2; `steering` max_steer, rad, max_steer_rate,
    rad/s; `v_0` as (3).
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
            upper[k, 3 + j] = (
                grip * cos(pi / SIDES) - c * along[k + 1, 2] - s * v * v * along[k + 1, 1]
            )
    return lower, upper, sides


@kernel
def packed(A: FloatArray, B: FloatArray, sides: FloatArray, places: IntArray) -> FloatArray:
    """The entries of the program's matrix in the order of `places` (indices into all entries, then
    1).
    """
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


@kernel
def quintic(
    p0: float, v0: float, a0: float, p1: float, v1: float, a1: float, h: float, tau: float
) -> tuple[float, float, float]:
    """Value, first and second derivative of (7) at `tau` in [0, 1], from those at both ends of `h`
    s.
    """
    v0, a0, v1, a1 = h * v0, h * h * a0, h * v1, h * h * a1
    rise = p1 - p0 - v0 - 0.5 * a0
    slope, bend = v1 - v0 - a0, a1 - a0
    c3 = 10.0 * rise - 4.0 * slope + 0.5 * bend
    c4 = -15.0 * rise + 7.0 * slope - bend
    c5 = 6.0 * rise - 3.0 * slope + 0.5 * bend
    value = p0 + tau * (v0 + tau * (0.5 * a0 + tau * (c3 + tau * (c4 + tau * c5))))
    first = v0 + tau * (a0 + tau * (3.0 * c3 + tau * (4.0 * c4 + tau * 5.0 * c5)))
    second = a0 + tau * (6.0 * c3 + tau * (12.0 * c4 + tau * 20.0 * c5))
    return value, first / h, second / (h * h)


@kernel
def resample(columns: FloatArray, t: FloatArray) -> FloatArray:
    """`(7, m)`: t, x, y, yaw, v, a, kappa at the times t, of a plan's columns `(7, n)`, n > 1,
    within its span.
    """
    out = np.empty((7, len(t)))
    i = 0
    for k in range(len(t)):
        while i < columns.shape[1] - 2 and t[k] >= columns[0, i + 1]:
            i += 1
        one, two = columns[:, i], columns[:, i + 1]
        h = two[0] - one[0]
        tau = min(max((t[k] - one[0]) / h, 0.0), 1.0)
        c0, s0, c1, s1 = cos(one[3]), sin(one[3]), cos(two[3]), sin(two[3])
        n0, n1 = one[4] * one[4] * one[6], two[4] * two[4] * two[6]
        x, vx, ax = quintic(
            one[1],
            one[4] * c0,
            one[5] * c0 - n0 * s0,
            two[1],
            two[4] * c1,
            two[5] * c1 - n1 * s1,
            h,
            tau,
        )
        y, vy, ay = quintic(
            one[2],
            one[4] * s0,
            one[5] * s0 + n0 * c0,
            two[2],
            two[4] * s1,
            two[5] * s1 + n1 * c1,
            h,
            tau,
        )
        yaw, v = one[3] + tau * (two[3] - one[3]), one[4] + tau * (two[4] - one[4])
        a = one[5] + tau * (two[5] - one[5])
        if min(one[4], two[4]) > SLOW_MPS:
            yaw, v = yaw + wrap(atan2(vy, vx) - yaw), hypot(vx, vy)
            a = (ax * vx + ay * vy) / max(v, 1e-9)
        out[:, k] = (t[k], x, y, yaw, v, a, one[6] + tau * (two[6] - one[6]))
    return out


def resampled(plan: Trajectory, step: float) -> Trajectory:
    """The plan every `step` s from its first sample on, and its last sample."""
    if len(plan) < 2:
        return plan
    count = int(np.ceil((plan.t[-1] - plan.t[0]) / step - 1e-6))
    t = np.r_[plan.t[0] + step * np.arange(count), plan.t[-1]]
    return Trajectory(
        *resample(np.stack([plan.t, plan.x, plan.y, plan.yaw, plan.v, plan.a, plan.kappa]), t)
    )
