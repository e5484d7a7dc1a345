"""How the simulated ego of PDM-Closed follows a proposal: the two-stage LQR of nuPlan and a
bicycle.

The LQR looks `AHEAD` steps of h = `STEP_S` ahead, T = h `AHEAD`. Longitudinal, with the proposal's
speed v_r then and q = `Q_SPEED`:

(1) a = T q (v_r - v) / (T^2 q + 1); where both are below `STOPPING_MPS`:
        (v_r - v) / 2, no steering

Lateral: e and psi are the offset and the heading from the proposal's pose, kappa_k its curvature,
v_k = v + k h a:

(2) e_k+1 = e_k + h v_k psi_k,   psi_k+1 = psi_k + h v_k (steer_k / L - kappa_k),
        steer_k+1 = steer_k + h u
    the constant rate u minimises  e_N^2 + 10 psi_N^2 + u^2  after N = `AHEAD` steps

The car is a kinematic bicycle with lags (the planner's own model; `replan.replay.vehicle` has those
of the simulation):

(3) a <- a + h / (h + 0.2 s) (a_wanted - a),   steer <- steer + h / (h + 0.05 s) h u,
        v <- v + h a >= 0
    yaw' = v tan(steer) / L, x and y by the midpoint rule

Source: see `replan.planners.pdm.planner`.
"""

from __future__ import annotations

from math import atan, atan2, cos, sin, tan

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.kernel import kernel
from replan.logs.states import EgoState, wrap
from replan.logs.vehicle import VehicleParameters
from replan.planners.frenet.path import Path, states_on_path
from replan.planners.frenet.profiles import STEP_S

X, Y, YAW, SPEED, ACCEL, KAPPA = range(6)
"""Rows of a simulated drive; the poses of a proposal begin with the first three."""
POSE_KAPPA = 3
"""Row of the curvature in the poses of a proposal."""
AHEAD = 10
"""Steps that (1) and (2) look ahead."""
Q_SPEED = 10.0
"""Weight of the speed in (1); the weight of the acceleration is 1."""
Q_OFFSET = 1.0
"""Weight of the offset in (2); the weight of the steering rate is 1."""
Q_HEADING = 10.0
"""Weight of the heading in (2)."""
STOPPING_MPS = 0.2
"""Speed up to which (1) only stops, m/s."""
STOPPING_GAIN = 0.5
"""Gain of (1) where it only stops, 1/s."""
ACCEL_LAG_S = 0.2
"""Lag of the acceleration in (3), s."""
STEER_LAG_S = 0.05
"""Lag of the steering in (3), s."""


def track_proposal(
    path: Path, profile: FloatArray, start: EgoState, car: VehicleParameters, knots: int
) -> FloatArray:
    """Simulate the ego on a proposal (`follow_proposal`): a profile s, v `(2, HORIZON_KNOTS)` on a
    path.
    """
    s, speed = profile
    poses = states_on_path(
        path.sigma, path.x, path.y, path.yaw, path.kappa, np.ascontiguousarray(s)
    )
    steer = atan(car.wheelbase * start.kappa)
    state = np.array([start.x, start.y, start.yaw, max(start.v, 0.0), start.a, steer])
    return follow_proposal(poses, speed, state, car.wheelbase, car.max_steer, knots)


@kernel
def follow_proposal(
    poses: FloatArray,
    speed: FloatArray,
    start: FloatArray,
    wheelbase: float,
    max_steer: float,
    knots: int,
) -> FloatArray:
    """Rows x, y, yaw, v, a, kappa `(6, knots)` of the ego that follows a proposal.

    The proposal has the rows x, y, yaw, kappa `(4, n)` and the `speed` `(n,)`; `start` is x, y,
    yaw, v, a, steer.
    """
    states, last = np.empty((6, knots)), len(speed) - 1
    x, y, yaw, v, a, steer = start
    for k in range(knots):
        states[X, k], states[Y, k], states[YAW, k] = x, y, yaw
        states[SPEED, k], states[ACCEL, k], states[KAPPA, k] = v, a, tan(steer) / wheelbase
        knot, v_then = min(k, last), speed[min(k + AHEAD, last)]
        if v_then <= STOPPING_MPS and v <= STOPPING_MPS:
            wanted_accel, rate = STOPPING_GAIN * (v_then - v), 0.0
        else:
            T = STEP_S * AHEAD
            wanted_accel = T * Q_SPEED * (v_then - v) / (T * T * Q_SPEED + 1.0)  # (1)
            yaw_r = poses[YAW, knot]
            e = (y - poses[Y, knot]) * cos(yaw_r) - (x - poses[X, knot]) * sin(yaw_r)
            psi = wrap(yaw - yaw_r)
            # The response to a rate of 1; e and psi become that to a rate of 0
            e1, psi1, steer1 = 0.0, 0.0, 0.0
            for i in range(AHEAD):
                step_m = STEP_S * max(v + i * STEP_S * wanted_accel, 0.0)
                e += step_m * psi
                psi += step_m * (steer / wheelbase - poses[POSE_KAPPA, min(knot + i, last)])
                e1 += step_m * psi1
                psi1 += step_m * steer1 / wheelbase
                steer1 += STEP_S
            psi = atan2(sin(psi), cos(psi))
            gain = Q_OFFSET * e1**2 + Q_HEADING * psi1**2 + 1.0
            rate = -(Q_OFFSET * e1 * e + Q_HEADING * psi1 * psi) / gain  # (2)
        a += STEP_S / (STEP_S + ACCEL_LAG_S) * (wanted_accel - a)  # (3)
        v_next = max(v + STEP_S * a, 0.0)
        if v_next == 0.0:
            a = 0.0
        turn = STEP_S * 0.5 * (v + v_next) * tan(steer) / wheelbase
        x += STEP_S * 0.5 * (v + v_next) * cos(yaw + 0.5 * turn)
        y += STEP_S * 0.5 * (v + v_next) * sin(yaw + 0.5 * turn)
        yaw, v = yaw + turn, v_next
        steered = steer + STEP_S / (STEP_S + STEER_LAG_S) * STEP_S * rate
        steer = min(max(steered, -max_steer), max_steer)
    return states
