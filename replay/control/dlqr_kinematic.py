"""Lateral DLQR on the kinematic error model with the steering's lag, curvature fed forward.

State x = (e_lat m, e_yaw rad, e_steer rad), input u = commanded steer minus that of the path, rad; at the rear axle,
small angles, speed v, wheelbase L, steering lag T (Rajamani, Vehicle Dynamics and Control, 2.5; the lag added):

(1) d(e_lat)/dt   = v e_yaw
(2) d(e_yaw)/dt   = v / L e_steer
(3) d(e_steer)/dt = (u - e_steer) / T
(4) x[k+1] = A x[k] + B u[k]          exact for an input held over dt (ZOH), (1)-(3) integrated from the last up:
    r = exp(-dt / T),  e_steer+ = r e_steer + (1 - r) u
    e_yaw+ = e_yaw + v / L (i e_steer + (dt - i) u)                             i = T (1 - r)
    e_lat+ = e_lat + v dt e_yaw + v^2 / L (j e_steer + (dt^2 / 2 - j) u)        j = T (dt - i)

The gain K of u = -K x is that of `replay.control.regulator`, tabulated over speed.

(5) steer command = atan(L kappa(s + v (T + dt / 2))) - K x
    The curvature is read ahead by the steering's lag and half a period of the hold: to first order, the wheel then has
    the angle of the path at the foot point s, and on a constant curve every error is 0 in the steady state.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import atan, exp
from typing import NamedTuple

import numpy as np

from logs.errors import ConfigError
from logs.kernel import FloatArray, frozen, inner_kernel
from logs.vehicle import VehicleParameters
from replay.control.regulator import (
    SHORTEST_LAG_S,
    Regulator,
    gain,
    solve_regulator,
    table_speeds,
)
from replay.vehicle.base import Motion
from replay.vehicle.plan_path import Deviation, path_kappa


@dataclass(frozen=True)
class KinematicDlqrConfig:
    """Weights of the regulator.

    Attributes:
        lateral_weight: 1/m2; `heading_weight` 1/rad2; `steer_weight` 1/rad2.
        heading_weight: Of e_yaw.
        steer_weight: Of u.
        speed_mps: v_0 of the regulator's R.
    """

    lateral_weight: float = 1.0
    heading_weight: float = 1.0
    steer_weight: float = 40.0
    speed_mps: float = 12.0

    def __post_init__(self) -> None:
        if not (self.lateral_weight > 0.0 and self.heading_weight >= 0.0):
            raise ConfigError("DLQR: lateral_weight must be positive and heading_weight not negative")
        if not (self.steer_weight > 0.0 and self.speed_mps > 0.0):
            raise ConfigError("DLQR: steer_weight and speed_mps must be positive")


def error_model(v: float, wheelbase: float, lag: float, period: float) -> tuple[FloatArray, FloatArray]:
    """A `(3, 3)` and B `(3, 1)` of (4)."""
    turn, decay = v / wheelbase, exp(-period / lag)
    once = lag * (1.0 - decay)
    twice = lag * (period - once)
    A = np.array([[1.0, v * period, v * turn * twice], [0.0, 1.0, turn * once], [0.0, 0.0, decay]])  # (4)
    B = np.array([[v * turn * (0.5 * period**2 - twice)], [turn * (period - once)], [1.0 - decay]])
    return A, B


def regulator(v: float, wheelbase: float, lag: float, period: float, config: KinematicDlqrConfig) -> Regulator:
    """The regulator of (4) at one speed, m/s.

    Raises:
        ConfigError: The weights, or a speed of 0, allow no stable gain.
    """
    A, B = error_model(v, wheelbase, lag, period)
    weights = (config.lateral_weight, config.heading_weight, 0.0)
    return solve_regulator(A, B, weights, config.steer_weight, v, config.speed_mps)


@lru_cache(maxsize=32)
def gain_table(wheelbase: float, lag: float, period: float, config: KinematicDlqrConfig) -> FloatArray:
    """K `(n, 3)` at `table_speeds`."""
    return frozen(np.array([regulator(float(v), wheelbase, lag, period, config).K[0] for v in table_speeds()]))


class KinematicLaw(NamedTuple):
    """The numbers of (5): K over speed, wheelbase m, max_steer rad, T + dt / 2 s."""

    gains: FloatArray
    wheelbase: float
    max_steer: float
    preview: float


def kinematic_law(p: VehicleParameters, period: float, config: KinematicDlqrConfig | None = None) -> KinematicLaw:
    """The law for a vehicle with rigid tyres."""
    lag = max(float(p.steer_lag), SHORTEST_LAG_S)
    gains = gain_table(p.wheelbase, lag, period, config or KinematicDlqrConfig())
    return KinematicLaw(gains, float(p.wheelbase), float(p.max_steer), lag + 0.5 * period)


@inner_kernel
def steer_rolling(law: KinematicLaw, now: Motion, off: Deviation, knots: FloatArray) -> float:
    """Front wheel angle to command, rad."""
    here = atan(law.wheelbase * path_kappa(knots, off.foot))
    ahead = atan(law.wheelbase * path_kappa(knots, off.foot + now.v * law.preview))
    command = (
        ahead
        - gain(law.gains, now.v, 0) * off.lateral
        - gain(law.gains, now.v, 1) * off.heading
        - gain(law.gains, now.v, 2) * (now.steer - here)  # (5)
    )
    return min(max(command, -law.max_steer), law.max_steer)
