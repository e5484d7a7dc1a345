"""How the tyres are used, from the motion of a drive at the control rate: slip angles, and the share of the friction.

(1) a_rear  = course - yaw                            of the rear axle, where the ego's reference point is; rad
(2) a_front = atan(tan a_rear + L r / v) - steer      r = v kappa, L the wheelbase; rad
(3) use     = sqrt(a^2 + (v^2 kappa)^2) / (mu g)      1: the tyres can give no more (friction circle)

The course is that of the positions (central differences: a simulated drive has no noise). Below `SLOWEST_MPS` a slip
angle says nothing: NaN. Source of (1)-(2): Rajamani, Vehicle Dynamics and Control, 2.3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.kernel import FloatArray
from logs.states import Controls, Trajectory
from logs.vehicle import VehicleParameters
from replay.vehicle.tyres import GRAVITY

SLOWEST_MPS = 2.0


@dataclass(frozen=True, eq=False)
class TyreUse:
    """`(n,)` each, at the times of the drive: slip angles, rad, positive where a wheel moves to its left; (3)."""

    front: FloatArray
    rear: FloatArray
    friction: FloatArray


def tyre_use(ego: Trajectory, done: Controls, car: VehicleParameters) -> TyreUse:
    """Of a drive of at least two states and what its actuators did, on the same times."""
    vx, vy = np.gradient(ego.x, ego.t), np.gradient(ego.y, ego.t)
    rear = np.angle(np.exp(1j * (np.arctan2(vy, vx) - ego.yaw)))  # (1)
    rear = np.where(ego.v >= SLOWEST_MPS, rear, np.nan)
    front = np.arctan(np.tan(rear) + car.wheelbase * ego.kappa) - done.steer  # (2): r / v is kappa
    return TyreUse(front, rear, np.hypot(ego.a, ego.v**2 * ego.kappa) / (car.tyre_friction * GRAVITY))  # (3)
