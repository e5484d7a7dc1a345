"""The lateral motion against a path: the dynamic bicycle of the paper, in corrected form, and its limit of rigid tyres.

Front steering, small angles, constant speed v. Slip angles to the left positive, stiffness of an axle C > 0, centre of
gravity a behind the front and b before the rear axle, L = a + b, kappa the curvature of the path:

(1) F_f = C_f (steer - (v_y + a r) / v),   F_r = -C_r (v_y - b r) / v
    m (v_y' + v r) = F_f + F_r,   I r' = a F_f - b F_r
(2) x = (e_d, e_d', e_phi, e_phi') at the centre of gravity,   x' = A x + B steer + E v kappa,   the paper's eq. 4-9:
    A = [[0, 1, 0, 0], [0, -(C_f + C_r)/(m v), (C_f + C_r)/m, (b C_r - a C_f)/(m v)],
         [0, 0, 0, 1], [0, (b C_r - a C_f)/(I v), (a C_f - b C_r)/I, -(a^2 C_f + b^2 C_r)/(I v)]]
    B = (0, C_f/m, 0, a C_f/I)',   E = (0, (b C_r - a C_f)/(m v) - v, 0, -(a^2 C_f + b^2 C_r)/(I v))'
    (The paper leaves out -v in E and has signs of two conventions in one equation.)
(3) The ego's reference point is the rear axle, b behind on the same path: e_phi(rear) = e_phi(centre) + b kappa,
    e_d(rear) = e_d(centre) - b e_phi(centre) - b^2 kappa / 2: a change of coordinates of (2), T and S kappa.
(4) Following the path exactly (e_d = 0 at the rear axle) takes, with time derivatives of kappa,
        e_phi = sum of p_i kappa^(i), steer = sum of d_i kappa^(i), by (1) with v_lat = -v e_phi, r = v kappa + e_phi':
    p_0 = a m v^2 / (L C_r),   p_i = (a b m - I) r_(i-1) / (L C_r),   r_0 = v,   r_i = p_(i-1)
    d_i = (I r_(i-1) + b C_r p_i) / (a C_f) - p_i + L r_i / v           front slip, rear slip, rolling
    d_0 = L + (m v^2 / L) (b / C_f - a / C_r): understeer; e_phi = p_0 kappa is why a constant curve needs the k_3 term.
(5) Rigid tyres, C = inf: p = 0, steer = L kappa, e_d' = v e_phi, e_phi' = v steer / L - v kappa (kinematic bicycle).

Sources: Rajamani, Vehicle Dynamics and Control, 2.3-2.5, 3.1-3.2 (with C = 2 C_alpha).
"""

from __future__ import annotations

from dataclasses import replace
from math import inf, isfinite

import numpy as np
from scipy.linalg import expm

from logs.kernel import FloatArray
from logs.vehicle import VehicleParameters


def has_rigid_tyres(p: VehicleParameters) -> bool:
    """Whether the tyres do not slip (5)."""
    return not (isfinite(p.cornering_front) and isfinite(p.cornering_rear))


def with_rigid_tyres(p: VehicleParameters) -> VehicleParameters:
    """The same vehicle as a kinematic model has it (5)."""
    return replace(p, cornering_front=inf, cornering_rear=inf)


def error_model(v: float, p: VehicleParameters) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A `(4, 4)`, B `(4,)` and E `(4,)` of (2) at the centre of gravity, `v` > 0; E is per path yaw rate v kappa."""
    a, b = p.cog_to_front, p.wheelbase - p.cog_to_front
    m, inertia, front, rear = p.mass, p.yaw_inertia, p.cornering_front, p.cornering_rear
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
    """The model with its steering angle as a fifth state that follows the command u: steer' = (u - steer) / lag."""
    n = len(A)
    lagged = np.zeros((n + 1, n + 1))
    lagged[:n, :n], lagged[:n, n], lagged[n, n] = A, B, -1.0 / lag
    return lagged, np.r_[np.zeros(n), 1.0 / lag]


def held(A: FloatArray, B: FloatArray, period: float) -> tuple[FloatArray, FloatArray]:
    """The exact discrete model of x' = A x + B u for inputs held over `period` (ZOH), B `(n, m)`."""
    n, m = B.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = A, B
    moved = expm(period * block)
    return moved[:n, :n], moved[:n, n:]


def paper_form(A: FloatArray, B: FloatArray, period: float) -> tuple[FloatArray, FloatArray]:
    """The paper's eq. 11 as printed: the midpoint rule for A, but a forward step for B, which does not fit it."""
    eye = np.eye(len(A))
    return np.linalg.solve(eye - 0.5 * period * A, eye + 0.5 * period * A), period * B


def bilinear(A: FloatArray, B: FloatArray, period: float) -> tuple[FloatArray, FloatArray]:
    """The paper's eq. 11 with the midpoint rule for A and B alike (Tustin)."""
    eye = np.eye(len(A))
    return (
        np.linalg.solve(eye - 0.5 * period * A, eye + 0.5 * period * A),
        np.linalg.solve(eye - 0.5 * period * A, period * B),
    )


def following(v: float, p: VehicleParameters) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The series (4) at `v` > 0 m/s, i = 0, 1, 2, by what the tyres do: rear slip, front slip, rolling.

    p_i = rear_i and d_i = front_i - rear_i + rolling_i, in rad m s^i; slips are in proportion to compliances.
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
    """(1) at the rear axle: A `(2, 2)` and B `(2,)` of (v_lat, r)' = A (v_lat, r) + B steer, finite tyres, `v` > 0."""
    a, b = p.cog_to_front, p.wheelbase - p.cog_to_front
    forces = np.array([[-p.cornering_front / v, -p.cornering_front * p.wheelbase / v], [-p.cornering_rear / v, 0.0]])
    steered = np.array([p.cornering_front, 0.0])
    yaw = np.array([a, -b]) / p.yaw_inertia
    side = np.full(2, 1.0 / p.mass) - b * yaw
    A = np.vstack([side @ forces - np.array([0.0, v]), yaw @ forces])  # (1)
    return A, np.array([side @ steered, yaw @ steered])


DISCRETISATIONS = {"zoh": held, "bilinear": bilinear, "paper": paper_form}
"""How x' = A x + B u becomes x+ = A x + B u: exact, consistent midpoint, as printed."""
