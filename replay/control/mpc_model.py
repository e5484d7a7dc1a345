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
from typing import NamedTuple

import numpy as np

from replan.core.arrays import FloatArray, frozen
from replan.core.kernel import kernel
from replan.logs.states import Trajectory, wrap
from replan.replay.control.lateral_model import at_speed, following_at, steer_for
from replan.replay.vehicle.pedal_map import PedalMap, reach
from replan.replay.vehicle.plan_path import path_kappa, timed

STATES, INPUTS, SIDES = 8, 2, 8
E_S, E_V, E_A, E_D, V_LAT, E_PHI, R, SIGMA = range(STATES)
"""Places in xi."""
POLYGON = INPUTS + 1
LIMITS = POLYGON + SIDES
"""Bounded rows of a step: a, w, sigma, and from POLYGON on the polygon (6)."""
SETTLE_S = 1.0
SLOW_MPS = 1.0

_A = np.zeros((STATES, STATES), bool)
_A[E_S, [E_S, E_V, E_A]] = _A[E_V, [E_V, E_A]] = _A[E_A, E_A] = True
_A[E_D, E_D:] = _A[E_PHI, V_LAT:] = _A[SIGMA, SIGMA] = True
_A[V_LAT, [V_LAT, R, SIGMA]] = _A[R, [V_LAT, R, SIGMA]] = True
_B = np.zeros((STATES, INPUTS), bool)
_B[:E_D, 0] = _B[E_D:, 1] = True
PATTERN_A, PATTERN_B = frozen(_A, np.bool_), frozen(_B, np.bool_)
"""Where A and B of (4) may differ from 0."""


class EnteredPlan(NamedTuple):
    """The plan as it will be driven, `(n + 1,)` each.

    Attributes:
        speed: m/s.
        kappa: 1/m.
        a: m/s2.
        command: a of the command, a lag of the pedal later, m/s2.
        steer: Wheel angle of exact following, rad.
        d_0: Of `following_at`, rad m.
        lag: Of the pedal in use, s.
    """

    speed: FloatArray
    kappa: FloatArray
    a: FloatArray
    command: FloatArray
    steer: FloatArray
    d_0: FloatArray
    lag: FloatArray


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
) -> EnteredPlan:
    """The plan as it will be driven from `t` on.

    `slips` is from `slip_table`; `ratios` are the learned compliances of front and rear axle;
    `lags` those of throttle and brake, s, and the acceleration below which the brake is in use,
    m/s2; `foot` is the station of the ego's foot point at `t`, m; `v` its speed, m/s; `n` steps of
    `h` s.
    """
    speeds, kappas, accelerations = np.empty(n + 1), np.empty(n + 1), np.empty(n + 1)
    commands, steers = np.empty(n + 1), np.empty(n + 1)
    d_0, pedal_lags = np.empty(n + 1), np.empty(n + 1)
    throttle_lag, brake_lag, coasting = lags
    _, planned, _ = timed(times, t)
    s, before = foot, v
    for k in range(n + 1):
        _, wanted, a = timed(times, t + k * h)
        speed = max(wanted + (v - planned) * exp(-k * h / SETTLE_S), 0.0)
        s += 0.5 * h * (speed + before) if k > 0 else 0.0
        lag = throttle_lag if a >= coasting else brake_lag
        _, angle = following_at(slips, wheelbase, ratios, speed)
        speeds[k], kappas[k], accelerations[k] = speed, path_kappa(knots, s), a
        commands[k] = timed(times, t + k * h + lag)[2]
        steers[k], d_0[k], pedal_lags[k] = steer_for(knots, s, speed, angle), angle[0], lag
        before = speed
    return EnteredPlan(speeds, kappas, accelerations, commands, steers, d_0, pedal_lags)


@kernel
def predicted(
    along: EnteredPlan, table: FloatArray, v_0: float, h: float
) -> tuple[FloatArray, FloatArray]:
    """A `(n, 8, 8)` and B `(n, 8, 2)` of (4)."""
    n = len(along.speed) - 1
    A, B = np.zeros((n, STATES, STATES)), np.zeros((n, STATES, INPUTS))
    for k in range(n):
        v, lag = along.speed[k], along.lag[k]
        decay = exp(-h / lag)
        once = lag * (1.0 - decay)
        twice = lag * (h - once)
        A[k, E_S, E_S], A[k, E_S, E_V], A[k, E_S, E_A] = 1.0, h, twice  # (1), (4)
        A[k, E_V, E_V], A[k, E_V, E_A], A[k, E_A, E_A] = 1.0, once, decay
        B[k, E_S, 0], B[k, E_V, 0], B[k, E_A, 0] = 0.5 * h * h - twice, h - once, 1.0 - decay
        now, then = 1.0 + (v / v_0) ** 2, 1.0 + (along.speed[k + 1] / v_0) ** 2  # (3)
        i, u = at_speed(table, v)
        for row in range(5):
            for column in range(6):
                entry = table[i, row, column] + u * (
                    table[i + 1, row, column] - table[i, row, column]
                )
                entry *= then if row == 4 else 1.0
                if column < 4:
                    A[k, E_D + row, E_D + column] = entry
                elif column == 4:
                    A[k, E_D + row, SIGMA] = entry / now
                else:
                    B[k, E_D + row, 1] = entry / now
    return A, B


@kernel
def limits(
    along: EnteredPlan,
    train: PedalMap,
    grip: float,
    steering: tuple[float, float],
    v_0: float,
    h: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(5)-(6) for the deviations: lower and upper bounds `(n, LIMITS)`, polygon rows
    `(n, SIDES, 2)` of (e_a, sigma).

    `grip` is mu g, m/s2; `steering` max_steer, rad, max_steer_rate, rad/s; `v_0` as (3).
    """
    n, (max_steer, max_rate) = len(along.speed) - 1, steering
    lower, upper = np.full((n, LIMITS), -np.inf), np.empty((n, LIMITS))
    sides = np.empty((n, SIDES, 2))
    for k in range(n):
        v, steer = along.speed[k + 1], along.steer[k + 1]
        scale, then = 1.0 + (along.speed[k] / v_0) ** 2, 1.0 + (v / v_0) ** 2
        turning = (steer - along.steer[k]) / h
        least, most = reach(train, along.speed[k])
        lower[k, 0], upper[k, 0] = least - along.command[k], most - along.command[k]  # (5)
        lower[k, 1], upper[k, 1] = scale * (-max_rate - turning), scale * (max_rate - turning)
        lower[k, 2], upper[k, 2] = then * (-max_steer - steer), then * (max_steer - steer)
        for j in range(SIDES):
            c, s = cos(0.25 * pi * j), sin(0.25 * pi * j)
            sides[k, j, 0], sides[k, j, 1] = c, s * v * v / (along.d_0[k + 1] * then)
            # (6)
            upper[k, POLYGON + j] = (
                grip * cos(pi / SIDES) - c * along.a[k + 1] - s * v * v * along.kappa[k + 1]
            )
    return lower, upper, sides


@kernel
def quintic(
    p0: float, v0: float, a0: float, p1: float, v1: float, a1: float, h: float, tau: float
) -> tuple[float, float, float]:
    """Value, first and second derivative of (7) at `tau` in [0, 1], from those at both ends of `h`
    s.
    """
    v0, a0 = h * v0, h * h * a0
    v1, a1 = h * v1, h * h * a1
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
def derivatives(yaw: float, v: float, a: float, kappa: float) -> tuple[float, float, float, float]:
    """Velocity and acceleration in the world: x', y', x'', y''."""
    c, s, across = cos(yaw), sin(yaw), v * v * kappa
    return v * c, v * s, a * c - across * s, a * s + across * c


@kernel
def resample(
    wanted: FloatArray,
    t: FloatArray,
    x: FloatArray,
    y: FloatArray,
    yaw: FloatArray,
    v: FloatArray,
    a: FloatArray,
    kappa: FloatArray,
) -> FloatArray:
    """`(7, m)`: t, x, y, yaw, v, a, kappa at the `wanted` times `(m,)`, of a plan's columns `(n,)`,
    n > 1, within its span.
    """
    columns = np.empty((7, len(wanted)))
    i = 0
    for k in range(len(wanted)):
        while i < len(t) - 2 and wanted[k] >= t[i + 1]:
            i += 1
        j = i + 1
        h = t[j] - t[i]
        tau = min(max((wanted[k] - t[i]) / h, 0.0), 1.0)
        vx0, vy0, ax0, ay0 = derivatives(yaw[i], v[i], a[i], kappa[i])
        vx1, vy1, ax1, ay1 = derivatives(yaw[j], v[j], a[j], kappa[j])
        px, vx, ax = quintic(x[i], vx0, ax0, x[j], vx1, ax1, h, tau)
        py, vy, ay = quintic(y[i], vy0, ay0, y[j], vy1, ay1, h, tau)
        heading, speed = yaw[i] + tau * (yaw[j] - yaw[i]), v[i] + tau * (v[j] - v[i])
        along = a[i] + tau * (a[j] - a[i])
        if min(v[i], v[j]) > SLOW_MPS:
            heading, speed = heading + wrap(atan2(vy, vx) - heading), hypot(vx, vy)
            along = (ax * vx + ay * vy) / max(speed, 1e-9)
        bend = kappa[i] + tau * (kappa[j] - kappa[i])
        columns[:, k] = (wanted[k], px, py, heading, speed, along, bend)
    return columns


def resampled(plan: Trajectory, step: float) -> Trajectory:
    """The plan every `step` s from its first sample on, and its last sample."""
    if len(plan) < 2:
        return plan
    count = int(np.ceil((plan.t[-1] - plan.t[0]) / step - 1e-6))
    wanted = np.r_[plan.t[0] + step * np.arange(count), plan.t[-1]]
    return Trajectory.of_rows(
        resample(wanted, plan.t, plan.x, plan.y, plan.yaw, plan.v, plan.a, plan.kappa)
    )
