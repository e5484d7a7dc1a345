"""Proposals, and how the ego follows them.

A driver with the wanted speed v0 goes along a track from the ego's foot on it (IDM, as PDM-Closed has it):

(1) dv/dt = a (1 - (v / v0)^delta - (s* / max(gap, s0))^2), kept within [-b, a]
    s*    = s0 + v T + v (v - v_lead) / (2 sqrt(a b))

The leader is the nearest one on the track whose centre is ahead of the rear axle. The ego follows such a proposal with
the two-stage LQR of nuPlan, which looks `AHEAD` steps of h = `STEP_S` ahead. Along: v_r is the proposal's speed then,

(2) a = N q (v_r - v) / (N^2 q + 1), N = h `AHEAD`; where both are below `STOPPING_MPS`: (v_r - v) / 2, no steering

Across: e and psi are the offset and the heading from the proposal's pose, kappa_k its curvature, v_k = v + k h a:

(3) e_k+1 = e_k + h v_k psi_k,   psi_k+1 = psi_k + h v_k (steer_k / L - kappa_k),   steer_k+1 = steer_k + h u
    the constant rate u minimises  e_N^2 + 10 psi_N^2 + u^2  after `AHEAD` steps

The car is a kinematic bicycle with lags (`replay.vehicle` has those that drive; this is the planner's own idea of one):

(4) a <- a + h / (h + 0.2 s) (a_wanted - a),   steer <- steer + h / (h + 0.05 s) h u,   v <- v + h a >= 0
    yaw' = v tan(steer) / L, the middle of the step for x and y
"""

from __future__ import annotations

from math import atan, atan2, cos, inf, sin, sqrt, tan
from typing import NamedTuple

import numpy as np

from logs.kernel import FloatArray, inner_kernel, kernel
from logs.states import EgoState, wrap
from logs.vehicle import VehicleParameters
from planners.frenet.path import Path, states_on_path
from planners.frenet.profiles import HORIZON_KNOTS, STEP_S

AHEAD = 10
"""Steps that (2) and (3) look ahead."""
Q_SPEED, Q_OFFSET, Q_HEADING = 10.0, 1.0, 10.0
"""Weights of (2) and (3); that of the input is 1."""
STOPPING_MPS, STOPPING_GAIN, ACCEL_LAG_S, STEER_LAG_S = 0.2, 0.5, 0.2, 0.05
"""From which speed on (2) only stops, m/s, and its gain then, 1/s; lags of (4), s."""


class Driver(NamedTuple):
    """(1): a, b (m/s2), T (s), s0 (m), delta."""

    accel: float
    decel: float
    headway: float
    min_gap: float
    exponent: float


@kernel
def idm_acceleration(v: float, v0: float, gap: float, v_lead: float, driver: Driver) -> float:
    """(1), m/s2; an infinite gap is a free road."""
    a, b = driver.accel, driver.decel
    wanted = driver.min_gap + v * driver.headway + v * (v - v_lead) / (2.0 * sqrt(a * b))
    return min(max(a * (1.0 - (v / v0) ** driver.exponent - (wanted / max(gap, driver.min_gap)) ** 2), -b), a)


@kernel
def driven(
    speeds: FloatArray, t: FloatArray, lower: FloatArray, upper: FloatArray, speed: FloatArray, start_v: float,
    center: float, driver: Driver,
) -> FloatArray:  # fmt: skip
    """Rows s, v `(n, 2, HORIZON_KNOTS)` of a driver per wanted speed `(n,)`, m/s, along one track.

    `t` `(k,)`, `lower`, `upper` `(m, k)` and `speed` `(m,)` are those of `StBoundaries`, `center` is from the rear axle
    to the box's centre, m.
    """
    out = np.empty((len(speeds), 2, HORIZON_KNOTS))
    for n in range(len(speeds)):
        s, v, k = 0.0, start_v, 0
        for j in range(HORIZON_KNOTS):
            out[n, 0, j], out[n, 1, j] = s, v
            while k < len(t) - 1 and t[k + 1] <= j * STEP_S + 1e-9:
                k += 1
            gap, v_lead = inf, 0.0
            for i in range(len(lower)):
                if 0.5 * (lower[i, k] + upper[i, k]) + center > s and lower[i, k] - s < gap:
                    gap, v_lead = lower[i, k] - s, speed[i]
            a = idm_acceleration(v, max(speeds[n], 0.1), gap, v_lead, driver)
            s, v = s + STEP_S * v, max(v + STEP_S * a, 0.0)
    return out


def tracked(path: Path, profile: FloatArray, start: EgoState, car: VehicleParameters, knots: int) -> FloatArray:
    """`followed` of a profile s, v `(2, HORIZON_KNOTS)` on a path."""
    pose = states_on_path(path.sigma, path.x, path.y, path.yaw, path.kappa, np.ascontiguousarray(profile[0]))
    state = np.array([start.x, start.y, start.yaw, max(start.v, 0.0), start.a, atan(car.wheelbase * start.kappa)])
    return followed(pose, profile[1], state, car.wheelbase, car.max_steer, knots)


@kernel
def followed(
    pose: FloatArray, speed: FloatArray, start: FloatArray, wheelbase: float, max_steer: float, knots: int
) -> FloatArray:
    """Rows x, y, yaw, v, a, kappa `(6, knots)` of the ego that follows a proposal, x, y, yaw, kappa `(4, n)` of it.

    `speed` `(n,)` is the proposal's; `start` is x, y, yaw, v, a, steer.
    """
    out, last = np.empty((6, knots)), pose.shape[1] - 1
    x, y, yaw, v, a, steer = start
    for k in range(knots):
        out[0, k], out[1, k], out[2, k], out[3, k], out[4, k], out[5, k] = x, y, yaw, v, a, tan(steer) / wheelbase
        at, then = min(k, last), min(k + AHEAD, last)
        if speed[then] <= STOPPING_MPS and v <= STOPPING_MPS:
            wanted, rate = STOPPING_GAIN * (speed[then] - v), 0.0
        else:
            N = STEP_S * AHEAD
            wanted = N * Q_SPEED * (speed[then] - v) / (N * N * Q_SPEED + 1.0)  # (2)
            e = (y - pose[1, at]) * cos(pose[2, at]) - (x - pose[0, at]) * sin(pose[2, at])
            rate = _steer_rate(e, wrap(yaw - pose[2, at]), steer, v, wanted, pose[3], at, wheelbase)
        a += STEP_S / (STEP_S + ACCEL_LAG_S) * (wanted - a)  # (4)
        v_next = max(v + STEP_S * a, 0.0)
        if v_next == 0.0:
            a = 0.0
        turn = STEP_S * 0.5 * (v + v_next) * tan(steer) / wheelbase
        x += STEP_S * 0.5 * (v + v_next) * cos(yaw + 0.5 * turn)
        y += STEP_S * 0.5 * (v + v_next) * sin(yaw + 0.5 * turn)
        yaw, v = yaw + turn, v_next
        steer = min(max(steer + STEP_S / (STEP_S + STEER_LAG_S) * STEP_S * rate, -max_steer), max_steer)
    return out


@inner_kernel
def _steer_rate(
    e: float, psi: float, steer: float, v: float, a: float, kappa: FloatArray, first: int, wheelbase: float
) -> float:
    """The rate u of (3), rad/s, from the free response of (3) and that to a rate of 1."""
    e1, psi1, steer1 = 0.0, 0.0, 0.0
    for k in range(AHEAD):
        way = STEP_S * max(v + k * STEP_S * a, 0.0)
        e, psi = e + way * psi, psi + way * (steer / wheelbase - kappa[min(first + k, len(kappa) - 1)])
        e1, psi1, steer1 = e1 + way * psi1, psi1 + way * steer1 / wheelbase, steer1 + STEP_S
    psi = atan2(sin(psi), cos(psi))
    return -(Q_OFFSET * e1 * e + Q_HEADING * psi1 * psi) / (Q_OFFSET * e1**2 + Q_HEADING * psi1**2 + 1.0)
