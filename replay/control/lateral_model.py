"""The lateral motion against a path: the dynamic bicycle of the paper, in corrected form, and its
limit of rigid tyres.

Front steering, small angles, constant speed v. Slip angles to the left positive, stiffness of an
axle C > 0, centre of gravity a behind the front and b before the rear axle, L = a + b, kappa the
curvature of the path:

(1) F_f = C_f (steer - (v_y + a r) / v),   F_r = -C_r (v_y - b r) / v
    m (v_y' + v r) = F_f + F_r,   I r' = a F_f - b F_r
(2) x = (e_d, e_d', e_phi, e_phi') at the centre of gravity,   x' = A x + B steer + E v kappa,
        the paper's eq. 4-9:
    A = [[0, 1, 0, 0], [0, -(C_f + C_r)/(m v), (C_f + C_r)/m, (b C_r - a C_f)/(m v)],
         [0, 0, 0, 1], [0, (b C_r - a C_f)/(I v), (a C_f - b C_r)/I, -(a^2 C_f + b^2 C_r)/(I v)]]
    B = (0, C_f/m, 0, a C_f/I)',
        E = (0, (b C_r - a C_f)/(m v) - v, 0, -(a^2 C_f + b^2 C_r)/(I v))'
    (The paper leaves out -v in E and has signs of two conventions in one equation.)
(3) The ego's reference point is the rear axle, b behind on the same path:
        e_phi(rear) = e_phi(centre) + b kappa,
    e_d(rear) = e_d(centre) - b e_phi(centre) - b^2 kappa / 2: a change of coordinates of (2),
        T and S kappa.
(4) Following the path exactly (e_d = 0 at the rear axle) takes, with time derivatives of kappa,
        e_phi = sum of p_i kappa^(i), steer = sum of d_i kappa^(i), by (1) with v_lat = -v e_phi,
            r = v kappa + e_phi':
    p_0 = a m v^2 / (L C_r),   p_i = (a b m - I) r_(i-1) / (L C_r),   r_0 = v,   r_i = p_(i-1)
    d_i = (I r_(i-1) + b C_r p_i) / (a C_f) - p_i + L r_i / v
        front slip, rear slip, rolling
    d_0 = L + (m v^2 / L) (b / C_f - a / C_r): understeer;
        e_phi = p_0 kappa is why a constant curve needs the k_3 term.
(5) Rigid tyres, C = inf: p = 0, steer = L kappa, e_d' = v e_phi,
        e_phi' = v steer / L - v kappa (kinematic bicycle).

The feed-forward of exact following along a path, by (4) tabulated over speed, with the slip that
was learned:

(6) steer(t) = d_0 kappa + d_1 kappa' + d_2 kappa'' = d_0 kappa(t + d_1 / d_0) + (d_2 - d_1^2
        / (2 d_0)) kappa''
(7) of a command that the steering follows with lag T and that is held for h,
        (1 + T D) exp(h D / 2) times (6):
        d_1 + (T + h / 2) d_0        d_2 + (T + h / 2) d_1 + (T h / 2 + h^2 / 8) d_0

The shift in time reads the curvature ahead and differentiates nothing; kappa'' is a difference over
2 SPREAD_S, which smooths the kinks of a sampled plan. Times are stations at the present speed.

Sources: Rajamani, Vehicle Dynamics and Control, 2.3-2.5, 3.1-3.2 (with C = 2 C_alpha).
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from math import inf, isfinite

import numpy as np
from scipy.linalg import expm

from replan.core.arrays import FloatArray, frozen
from replan.core.kernel import kernel
from replan.logs.vehicle import VehicleParameters
from replan.replay.vehicle.plan_path import path_kappa

SPEED_STEP_MPS = 0.5
MAX_SPEED_MPS = 60.0
SPREAD_S = 0.15
SLOPE_S = 0.05
"""Half of the time over which the curvature's rate is taken."""

YAW_RATE, STEER = 3, 4
"""Rows of `lateral_table`."""

SteerSeries = tuple[float, float, float]
"""d_0 rad m, d_1 rad m s, d_2 rad m s2."""


def has_rigid_tyres(p: VehicleParameters) -> bool:
    """Return whether the tyres do not slip (5)."""
    return not (isfinite(p.cornering_front) and isfinite(p.cornering_rear))


def with_rigid_tyres(p: VehicleParameters) -> VehicleParameters:
    """Return the same vehicle with rigid tyres, as in a kinematic model (5)."""
    return replace(p, cornering_front=inf, cornering_rear=inf)


def error_model(v: float, p: VehicleParameters) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A `(4, 4)`, B `(4,)` and E `(4,)` of (2) at the centre of gravity, `v` > 0; E is per path yaw
    rate v kappa.
    """
    a, b = p.cog_to_front, p.wheelbase - p.cog_to_front
    m, inertia = p.mass, p.yaw_inertia
    front, rear = p.cornering_front, p.cornering_rear
    both, moment, turning = front + rear, b * rear - a * front, a * a * front + b * b * rear
    A = np.array(  # (2)
        [
            [0.0, 1.0, 0.0, 0.0],
            [0.0, -both / (m * v), both / m, moment / (m * v)],
            [0.0, 0.0, 0.0, 1.0],
            [0.0, moment / (inertia * v), -moment / inertia, -turning / (inertia * v)],
        ]
    )
    B = np.array([0.0, front / m, 0.0, a * front / inertia])
    E = np.array([0.0, moment / (m * v) - v, 0.0, -turning / (inertia * v)])
    return A, B, E


def at_rear_axle(
    model: tuple[FloatArray, FloatArray, FloatArray], v: float, p: VehicleParameters
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The model (2) in the coordinates (3); E for a constant curvature."""
    A, B, E = model
    b = p.wheelbase - p.cog_to_front
    T = np.eye(4)
    T[0, 2] = T[1, 3] = -b  # (3)
    A = T @ A @ np.linalg.inv(T)
    return A, T @ B, T @ E - A @ np.array([-0.5 * b * b, 0.0, b, 0.0]) / v


def with_steering(A: FloatArray, B: FloatArray, lag: float) -> tuple[FloatArray, FloatArray]:
    """The model with its steering angle as a fifth state that follows the command u: steer' = (u -
    steer) / lag.
    """
    n = len(A)
    lagged = np.zeros((n + 1, n + 1))
    lagged[:n, :n], lagged[:n, n], lagged[n, n] = A, B, -1.0 / lag
    return lagged, np.r_[np.zeros(n), 1.0 / lag]


def held(A: FloatArray, B: FloatArray, period: float) -> tuple[FloatArray, FloatArray]:
    """The exact discrete model of x' = A x + B u for inputs held over `period` (ZOH), B
    `(n, m)`.
    """
    n, m = B.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = A, B
    moved = expm(period * block)
    return moved[:n, :n], moved[:n, n:]


def paper_form(A: FloatArray, B: FloatArray, period: float) -> tuple[FloatArray, FloatArray]:
    """The paper's eq. 11 as printed: the midpoint rule for A, but a forward step for B, which does
    not fit it.
    """
    eye = np.eye(len(A))
    return np.linalg.solve(eye - 0.5 * period * A, eye + 0.5 * period * A), period * B


def bilinear(A: FloatArray, B: FloatArray, period: float) -> tuple[FloatArray, FloatArray]:
    """The paper's eq. 11 with the midpoint rule for A and B alike (Tustin)."""
    midpoint, forward = paper_form(A, B, period)
    return midpoint, np.linalg.solve(np.eye(len(A)) - 0.5 * period * A, forward)


def following(v: float, p: VehicleParameters) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the series (4) at `v` > 0 m/s, i = 0, 1, 2, split by cause: rear slip, front slip,
    rolling.

    p_i = rear_i and d_i = front_i - rear_i + rolling_i, in rad m s^i; slips are in proportion to
    compliances.
    """
    length, rolling = p.wheelbase, np.array([p.wheelbase, 0.0, 0.0])
    if has_rigid_tyres(p):
        return np.zeros(3), np.zeros(3), rolling
    a, b = p.cog_to_front, length - p.cog_to_front
    m, inertia = p.mass, p.yaw_inertia
    rear, front, before = np.zeros(3), np.zeros(3), 0.0
    for i in range(3):
        force = (a * m * v * v if i == 0 else (a * b * m - inertia) * before) / length
        rear[i] = force / p.cornering_rear  # (4): p_i
        front[i] = (inertia * before + b * force) / (a * p.cornering_front)
        before = v if i == 0 else rear[i - 1]
        rolling[i] = length * before / v  # (4): L r_i / v
    return rear, front, rolling


def body_model(v: float, p: VehicleParameters) -> tuple[FloatArray, FloatArray]:
    """(1) at the rear axle: A `(2, 2)` and B `(2,)` of (v_lat, r)' = A (v_lat, r) + B steer, finite
    tyres, `v` > 0.
    """
    a, b = p.cog_to_front, p.wheelbase - p.cog_to_front
    forces = np.array(
        [
            [-p.cornering_front / v, -p.cornering_front * p.wheelbase / v],
            [-p.cornering_rear / v, 0.0],
        ]
    )
    steered = np.array([p.cornering_front, 0.0])
    yaw = np.array([a, -b]) / p.yaw_inertia
    side = np.full(2, 1.0 / p.mass) - b * yaw
    A = np.vstack([side @ forces - np.array([0.0, v]), yaw @ forces])  # (1)
    return A, np.array([side @ steered, yaw @ steered])


DISCRETISATIONS = {"zoh": held, "bilinear": bilinear, "paper": paper_form}
"""Discretisations of x' = A x + B u: exact, consistent midpoint, as printed in the paper."""


def table_speeds() -> FloatArray:
    """The speeds of all tables, m/s: SPEED_STEP_MPS, 2 SPEED_STEP_MPS, ... MAX_SPEED_MPS."""
    return SPEED_STEP_MPS * np.arange(1, round(MAX_SPEED_MPS / SPEED_STEP_MPS) + 1)


@kernel
def at_speed(table: FloatArray, v: float) -> tuple[int, float]:
    """Return the row of a table over `table_speeds` and the share of the next row, limited at the
    ends.
    """
    place = min(max(v / SPEED_STEP_MPS - 1.0, 0.0), len(table) - 1.0)
    i = min(int(place), len(table) - 2)
    return i, place - i


@lru_cache(maxsize=32)
def lateral_table(p: VehicleParameters, h: float) -> FloatArray:
    """The motion against a path under a held steer rate, at `table_speeds` `(n, 5, 6)`.

    A and B over `h` s of (e_d, v_lat, e_phi, r, steer), each minus that of exact following: e_d' =
    v_lat + v e_phi, e_phi' = r, (v_lat, r)' = body_model(v). With rigid tyres v_lat = 0 and r = v
    steer / L.
    """
    tables = np.zeros((len(table_speeds()), 5, 6))
    for table, v in zip(tables, table_speeds().tolist(), strict=True):
        if has_rigid_tyres(p):
            turn = v / p.wheelbase
            A = np.array([[0.0, v, 0.0], [0.0, 0.0, turn], [0.0, 0.0, 0.0]])
            table[np.ix_([0, 2, 4], [0, 2, 4, 5])] = np.hstack(
                held(A, np.array([[0.0], [0.0], [1.0]]), h)
            )
            table[YAW_RATE] = turn * table[STEER]
        else:
            body, steered = body_model(v, p)
            A = np.zeros((5, 5))
            A[0, [1, 2]] = 1.0, v
            A[2, 3] = 1.0
            A[np.ix_([1, 3], [1, 3])] = body
            A[[1, 3], 4] = steered
            table[:] = np.hstack(held(A, np.array([[0.0], [0.0], [0.0], [0.0], [1.0]]), h))
    return frozen(tables)


@lru_cache(maxsize=32)
def slip_table(p: VehicleParameters) -> FloatArray:
    """rear_0, front_0, front_1, front_2 `(n, 4)` of `following` at `table_speeds`."""
    rows = [
        (rear[0], *front) for rear, front, _ in (following(float(v), p) for v in table_speeds())
    ]
    return frozen(np.array(rows))


@kernel
def following_at(
    slips: FloatArray, wheelbase: float, ratios: tuple[float, float], v: float
) -> tuple[float, SteerSeries]:
    """p_0 rad m and the series d of exact following; `ratios` of front and rear compliance
    (`Slip`).
    """
    i, u = at_speed(slips, v)
    rear = ratios[1] * (slips[i, 0] + u * (slips[i + 1, 0] - slips[i, 0]))
    front = ratios[0] * (slips[i, 1] + u * (slips[i + 1, 1] - slips[i, 1]))
    spin = ratios[0] * (slips[i, 2] + u * (slips[i + 1, 2] - slips[i, 2]))
    third = ratios[0] * (slips[i, 3] + u * (slips[i + 1, 3] - slips[i, 3]))
    return rear, (wheelbase + front - rear, wheelbase * rear / max(v, SPEED_STEP_MPS) + spin, third)


@kernel
def command_series(d: SteerSeries, lag: float, hold: float) -> SteerSeries:
    """The series (7) of the command whose wheel angle has the series d."""
    ahead = lag + 0.5 * hold
    second = d[2] + ahead * d[1] + (0.5 * lag * hold + 0.125 * hold * hold) * d[0]
    return d[0], d[1] + ahead * d[0], second  # (7)


@kernel
def within(knots: FloatArray, s: float, reach: float) -> float:
    """The station nearest to `s` with `reach` m of path on both sides: a plan often begins at the
    ego.
    """
    return max(min(s, knots[-1, 0] - reach), knots[0, 0] + reach)


@kernel
def steer_for(knots: FloatArray, s: float, v: float, d: SteerSeries) -> float:
    """Wheel angle at station `s` of a path, speed `v`, rad."""
    ahead, reach = s + v * d[1] / d[0], v * SPREAD_S
    mid = within(knots, ahead, reach)
    bend = (
        path_kappa(knots, mid + reach)
        - 2.0 * path_kappa(knots, mid)
        + path_kappa(knots, mid - reach)
    )
    bend /= SPREAD_S * SPREAD_S
    return d[0] * path_kappa(knots, ahead) + (d[2] - 0.5 * d[1] * d[1] / d[0]) * bend  # (6)


@kernel
def kappa_rate(knots: FloatArray, s: float, v: float) -> float:
    """The curvature's rate in time at station `s`, 1/(m s)."""
    reach = v * SLOPE_S
    mid = within(knots, s, reach)
    return (path_kappa(knots, mid + reach) - path_kappa(knots, mid - reach)) / (2.0 * SLOPE_S)
