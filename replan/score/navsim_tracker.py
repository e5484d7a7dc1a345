"""How NAVSIM drives a plan: by nuPlan's two-stage LQR and a kinematic bicycle with lags, at 10 Hz.

The tracker knows a plan's poses alone. It fits speeds v_k and curvatures kappa_k to the
displacements d_k and turns theta_k between them, h = `STEP_S`:

(1) d_k = h v_k (cos yaw_k, sin yaw_k),   v_k = v_0 + h (a_0 + ... + a_(k-1))
    least squares + `JERK_PENALTY` (a_0^2 + ... + a_(n-4)^2 + (a_(n-2) - a_(n-3))^2):
        meant are the differences of all, but the original's -1 overwrite its +1 except in the last
        row
(2) theta_k = h v_k kappa_k,   kappa_k = kappa_0 + h (c_0 + ...)
    least squares + `CURVATURE_PENALTY` sum of c_k^2 + `FIRST_PENALTY` kappa_0^2

Then, as in `replan.planners.pdm.lqr_tracker` (1), (2) with those v and kappa, and its (3) with the
Euler rule: positions, heading and steering move with the speed, heading and steering before the
step. NAVSIM's tracker has the wheelbase of nuPlan's car (`NUPLAN_WHEELBASE_M`) whatever the car is.

Source: autonomousvision/navsim 0a380a90, planner/pdm_planner/simulation (Apache-2.0; formulae
only).
"""

from __future__ import annotations

from math import atan2, cos, pi, sin, tan

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.kernel import kernel
from replan.logs.states import wrapped
from replan.planners.pdm.lqr_tracker import (
    ACCEL_LAG_S,
    AHEAD as STEPS_AHEAD,
    Q_HEADING,
    Q_OFFSET,
    Q_SPEED,
    STEER_LAG_S,
    STOPPING_GAIN,
    STOPPING_MPS,
)

STEP_S = 0.1  # Time between two states, s
JERK_PENALTY, CURVATURE_PENALTY, FIRST_PENALTY = 1e-4, 1e-2, 1e-10  # (1), (2)
MAX_STEER = pi / 3.0  # Largest steering angle, rad
NUPLAN_WHEELBASE_M = 3.089  # Of the Pacifica, m
X, Y, YAW, V, A, LATERAL, STEER, TURN, TURN_RATE = range(9)
"""Columns of a state: rear axle, speed, acceleration, lateral acceleration, steering angle, yaw
rate and its rate.
"""


def fitted(poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the speeds (1) and curvatures (2) `(n - 1,)` of poses x, y, yaw `(n, 3)`."""
    moved, turned = np.diff(poses[:, :2], axis=0), wrapped(np.diff(poses[:, 2]))
    m, h = len(moved), STEP_S
    ahead = np.column_stack([np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])]).reshape(-1, 1)
    lower = np.repeat(np.tri(m), 2, axis=0)
    design = ahead * lower * np.r_[h, np.full(m - 1, h * h)]
    penalty = np.zeros((m - 2, m))
    penalty[:, 2:] = np.eye(m - 2)
    penalty[:, 1:-1] = -np.eye(m - 2)  # over the ones of the line above, as in the devkit
    normal = np.linalg.pinv(design.T @ design + JERK_PENALTY * penalty.T @ penalty)
    solution = normal @ design.T @ moved.reshape(-1)
    speed = solution[0] + np.r_[0.0, np.cumsum(solution[1:] * h)]
    design = np.tri(m)
    design[:, 0] = speed * h
    design[1:, 1:] *= (speed * h * h)[1:, None]
    weights = np.full(m, CURVATURE_PENALTY)
    weights[0] = FIRST_PENALTY
    solution = np.linalg.pinv(design.T @ design + np.diag(weights)) @ design.T @ turned
    return speed, solution[0] + np.r_[0.0, np.cumsum(solution[1:] * h)]


def simulated(poses: FloatArray, start: FloatArray, wheelbase: float) -> FloatArray:
    """Return the states `(n, 9)` of the car that follows poses `(n, 3)` from the state `start`
    `(9,)`.
    """
    speed, kappa = fitted(poses)
    return _follow(np.ascontiguousarray(poses), speed, kappa, start, wheelbase)


@kernel
def _follow(
    poses: FloatArray, speed: FloatArray, kappa: FloatArray, start: FloatArray, wheelbase: float
) -> FloatArray:
    states, last, h = np.zeros((len(poses), 9)), len(speed) - 1, STEP_S
    states[0] = start
    for k in range(len(poses) - 1):
        x, y, yaw = states[k, X], states[k, Y], states[k, YAW]
        v, a, steer = states[k, V], states[k, A], states[k, STEER]
        ahead = min(k + STEPS_AHEAD, last)
        if speed[ahead] <= STOPPING_MPS and v <= STOPPING_MPS:
            accel, rate = STOPPING_GAIN * (speed[ahead] - v), 0.0
        else:
            span = h * STEPS_AHEAD
            accel = span * Q_SPEED * (speed[ahead] - v) / (span * span * Q_SPEED + 1.0)
            e = (y - poses[k, 1]) * cos(poses[k, 2]) - (x - poses[k, 0]) * sin(poses[k, 2])
            psi = atan2(sin(yaw - poses[k, 2]), cos(yaw - poses[k, 2]))
            e1, psi1, steer1 = 0.0, 0.0, 0.0
            for i in range(STEPS_AHEAD):
                moved = h * (v + i * h * accel)
                bend = steer / NUPLAN_WHEELBASE_M - kappa[min(k + i, ahead)]
                e, psi = e + moved * psi, psi + moved * bend
                e1, psi1 = e1 + moved * psi1, psi1 + moved * steer1 / NUPLAN_WHEELBASE_M
                steer1 += h
            psi = atan2(sin(psi), cos(psi))
            rate = -(Q_OFFSET * e1 * e + Q_HEADING * psi1 * psi) / (
                Q_OFFSET * e1**2 + Q_HEADING * psi1**2 + 1.0
            )
        states[k + 1, X], states[k + 1, Y] = x + h * v * cos(yaw), y + h * v * sin(yaw)
        states[k + 1, YAW] = yaw + h * v * tan(steer) / wheelbase
        states[k + 1, A] = a + h / (h + ACCEL_LAG_S) * (accel - a)
        states[k + 1, V] = v + h * states[k + 1, A]
        states[k + 1, STEER] = min(
            max(steer + h / (h + STEER_LAG_S) * h * rate, -MAX_STEER), MAX_STEER
        )
        states[k + 1, TURN] = states[k + 1, V] * tan(states[k + 1, STEER]) / wheelbase
        states[k + 1, TURN_RATE] = (states[k + 1, TURN] - states[k, TURN]) / h
    return states
