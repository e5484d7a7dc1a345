"""The plainest control: one PID for the steering, one for the speed, no model and no feed-forward.

(1) steer = -(kp e + ki int(e) dt + kd e') / (1 + (v / v_0)^2)     e = lateral error at the rear axle, e' = v sin(e_phi)
(2) a     = kp e + ki int(e) dt + kd e'                             e = v_plan - v

Integrals stand still while they would push an output further out of its limits. Source: Astrom and Hagglund, Advanced
PID Control, 3.5; the gain of (1) falls with speed as the curvature that a lateral acceleration allows. The gains
are a compromise of a few tried on `replay.paper.manoeuvres` with the single-track vehicle: (0.6, 0.4, 0.25) loses
ISO 3888-1 as well as -2, (0.2, 0.15, 0.3) loses none but is twice as far off on roads.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isnan, sin
from typing import NamedTuple

from logs.errors import ConfigError
from logs.kernel import inner_kernel
from logs.vehicle import VehicleParameters
from replay.control.pid import SpeedLaw, SpeedState, limited
from replay.vehicle.base import Motion
from replay.vehicle.pedal_map import PedalMap
from replay.vehicle.plan_path import Deviation


@dataclass(frozen=True)
class SteeringPidConfig:
    """Gains of (1): rad/m, rad/(m s), rad s/m; v_0 in m/s."""

    kp: float = 0.4
    ki: float = 0.3
    kd: float = 0.3
    speed_mps: float = 12.0

    def __post_init__(self) -> None:
        if min(self.kp, self.ki, self.kd) < 0.0 or not self.speed_mps > 0.0:
            raise ConfigError("steering PID: no gain may be negative, speed_mps must be positive")


@dataclass(frozen=True)
class SpeedPidConfig:
    """Gains of (2): 1/s, 1/s2, 1."""

    kp: float = 1.5
    ki: float = 0.3
    kd: float = 0.05

    def __post_init__(self) -> None:
        if min(self.kp, self.ki, self.kd) < 0.0:
            raise ConfigError("speed PID: no gain may be negative")


class SteeringPidLaw(NamedTuple):
    """The numbers of (1), max_steer rad, and the period s."""

    kp: float
    ki: float
    kd: float
    speed: float
    max_steer: float
    period: float


def steering_pid_law(p: VehicleParameters, period: float, config: SteeringPidConfig | None = None) -> SteeringPidLaw:
    """The law for a vehicle."""
    c = config or SteeringPidConfig()
    return SteeringPidLaw(float(c.kp), float(c.ki), float(c.kd), float(c.speed_mps), float(p.max_steer), period)


@inner_kernel
def steer_by_error(law: SteeringPidLaw, integral: float, now: Motion, off: Deviation) -> tuple[float, float]:
    """Front wheel angle to command, rad, and the integral after it."""
    slower = 1.0 + (now.v / law.speed) ** 2
    rate = now.v * sin(off.heading)
    command = -(law.kp * off.lateral + law.ki * integral + law.kd * rate) / slower  # (1)
    if abs(command) < law.max_steer or command * off.lateral > 0.0:
        integral += law.period * off.lateral
    return min(max(command, -law.max_steer), law.max_steer), integral


@inner_kernel
def accelerate_by_error(
    law: SpeedLaw, state: SpeedState, train: PedalMap, now: Motion, off: Deviation
) -> tuple[float, SpeedState]:
    """Acceleration to command, m/s2, and what is remembered then."""
    error = -off.speed
    rate = 0.0 if isnan(state.error) else (error - state.error) / law.period
    wanted = law.kp * error + law.ki * state.integral + law.kd * rate  # (2)
    command, integral = limited(wanted, error, state.integral, train, now.v, law.period)
    return command, SpeedState(integral, state.m, error)
