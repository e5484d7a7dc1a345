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
the ego's speed to the plan's with the time constant `SETTLE_S`.
"""

from __future__ import annotations

from math import cos, exp, pi, sin
from typing import NamedTuple

import numpy as np

from replan.core.arrays import FloatArray, frozen
from replan.core.kernel import kernel
from replan.replay.control.lateral_model import at_speed, following_at, steer_for
from replan.replay.vehicle.pedal_map import PedalMap, reach
from replan.replay.vehicle.plan_path import path_kappa, timed

STATES, INPUTS, SIDES = 8, 2, 8
E_S, E_V, E_A, E_D, V_LAT, E_PHI, R, SIGMA = range(STATES)
"""Places in xi."""
ACCEL, STEER_RATE = range(INPUTS)
"""Places in u."""
LATERAL = STATES - E_D
"""Number of lateral states, from `E_D` on: the rows of `lateral_table`."""
STEER = INPUTS
POLYGON = STEER + 1
LIMITS = POLYGON + SIDES
"""Bounded rows of a step: those of u, sigma (`STEER`), and from `POLYGON` on the polygon (6)."""
SETTLE_S = 1.0
"""The speed of the ego approaches that of the plan with this time constant, s."""

_COLUMNS_OF = {
    E_S: (E_S, E_V, E_A),
    E_V: (E_V, E_A),
    E_A: (E_A,),
    E_D: (E_D, V_LAT, E_PHI, R, SIGMA),
    V_LAT: (V_LAT, R, SIGMA),
    E_PHI: (V_LAT, E_PHI, R, SIGMA),
    R: (V_LAT, R, SIGMA),
    SIGMA: (SIGMA,),
}
"""For each row of A in (4), the columns that may differ from 0."""
PATTERN_A = frozen([[j in _COLUMNS_OF[i] for j in range(STATES)] for i in range(STATES)], np.bool_)
"""Where A of (4) may differ from 0 `(8, 8)`."""
PATTERN_B = frozen([[i < E_D, i >= E_D] for i in range(STATES)], np.bool_)
"""Where B of (4) may differ from 0 `(8, 2)`: a moves the longitudinal states, w the lateral
ones.
"""


class PedalLags(NamedTuple):
    """The lags of the pedals: `throttle` and `brake`, s; the brake is in use at accelerations below
    `brake_below`, m/s2.
    """

    throttle: float
    brake: float
    brake_below: float


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
    lags: PedalLags,
    t: float,
    foot: float,
    v: float,
    h: float,
    n: int,
) -> EnteredPlan:
    """The plan as it will be driven from `t` on.

    `slips` is from `slip_table`; `ratios` are the learned compliances of front and rear axle;
    `foot` is the station of the ego's foot point at `t`, m; `v` its speed, m/s; `n` steps of `h` s.
    """
    speeds, kappas, accelerations = np.empty(n + 1), np.empty(n + 1), np.empty(n + 1)
    commands, steers = np.empty(n + 1), np.empty(n + 1)
    d_0, pedal_lags = np.empty(n + 1), np.empty(n + 1)
    _, planned, _ = timed(times, t)
    s, before = foot, v
    for k in range(n + 1):
        _, wanted, a = timed(times, t + k * h)
        speed = max(wanted + (v - planned) * exp(-k * h / SETTLE_S), 0.0)
        s += 0.5 * h * (speed + before) if k > 0 else 0.0
        lag = lags.throttle if a >= lags.brake_below else lags.brake
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
        A[k, E_V, E_V], A[k, E_V, E_A] = 1.0, once
        A[k, E_A, E_A] = decay
        B[k, E_S, ACCEL] = 0.5 * h * h - twice
        B[k, E_V, ACCEL] = h - once
        B[k, E_A, ACCEL] = 1.0 - decay
        now, then = 1.0 + (v / v_0) ** 2, 1.0 + (along.speed[k + 1] / v_0) ** 2  # (3)
        i, u = at_speed(table, v)
        for row in range(LATERAL):
            for column in range(LATERAL + 1):
                entry = table[i, row, column] + u * (
                    table[i + 1, row, column] - table[i, row, column]
                )
                entry *= then if E_D + row == SIGMA else 1.0
                if E_D + column < SIGMA:
                    A[k, E_D + row, E_D + column] = entry
                elif E_D + column == SIGMA:
                    A[k, E_D + row, SIGMA] = entry / now
                else:
                    B[k, E_D + row, STEER_RATE] = entry / now
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
        lower[k, ACCEL], upper[k, ACCEL] = least - along.command[k], most - along.command[k]  # (5)
        lower[k, STEER_RATE] = scale * (-max_rate - turning)
        upper[k, STEER_RATE] = scale * (max_rate - turning)
        lower[k, STEER] = then * (-max_steer - steer)
        upper[k, STEER] = then * (max_steer - steer)
        for j in range(SIDES):
            c, s = cos(0.25 * pi * j), sin(0.25 * pi * j)
            sides[k, j, 0], sides[k, j, 1] = c, s * v * v / (along.d_0[k + 1] * then)
            # (6)
            upper[k, POLYGON + j] = (
                grip * cos(pi / SIDES) - c * along.a[k + 1] - s * v * v * along.kappa[k + 1]
            )
    return lower, upper, sides
