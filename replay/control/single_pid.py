"""The plainest control: one PID for the steering, one for the speed, no model and no feed-forward.

(1) steer = -(kp e + ki int(e) dt + kd e') / (1 + (v / v_0)^2)     e = lateral error at the rear axle, e' = v sin(e_phi)
(2) a     = kp e + ki int(e) dt + kd e'                             e = v_plan - v

Integrals stand still while they would push an output further out of its limits. Source: Astrom and Hagglund, Advanced
PID Control, 3.5; the gain of (1) falls with speed as the curvature that a lateral acceleration allows. The gains
are a compromise of a few tried on `replay.experiments.manoeuvres` with the single-track vehicle: (0.6, 0.4, 0.25) loses
ISO 3888-1 as well as -2, (0.2, 0.15, 0.3) loses none but is twice as far off on roads.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sin

from logs.errors import ConfigError
from logs.states import EgoState
from logs.vehicle import VehicleParameters
from replay.control.tracking import Deviation, PlanPath
from replay.vehicle.base import Powertrain


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


class SteeringPid:
    """(1); remembers the integral. See `replay.control.base.LateralLaw`."""

    def __init__(self, parameters: VehicleParameters, period: float, config: SteeringPidConfig | None = None) -> None:
        self._max_steer, self._period, self._config = parameters.max_steer, period, config or SteeringPidConfig()
        self._integral = 0.0

    def rest(self) -> None:
        """The integral stays: what it makes up for is there when the vehicle drives on."""

    def steer(self, state: EgoState, path: PlanPath, off: Deviation) -> float:
        """Front wheel angle to command, rad."""
        gains = self._config
        slower = 1.0 + (state.v / gains.speed_mps) ** 2
        rate = state.v * sin(off.heading)
        command = -(gains.kp * off.lateral + gains.ki * self._integral + gains.kd * rate) / slower
        if abs(command) < self._max_steer or command * off.lateral > 0.0:
            self._integral += self._period * off.lateral
        return min(max(command, -self._max_steer), self._max_steer)


class SpeedPid:
    """(2); remembers the integral and the last error. See `replay.control.base.LongitudinalLaw`."""

    def __init__(self, powertrain: Powertrain, period: float, config: SpeedPidConfig | None = None) -> None:
        self._train, self._period, self._config = powertrain, period, config or SpeedPidConfig()
        self._integral = 0.0
        self._last: float | None = None

    def rest(self) -> None:
        """Forget the integral and the last error."""
        self._integral, self._last = 0.0, None

    def accelerate(self, state: EgoState, path: PlanPath, off: Deviation) -> float:
        """Acceleration to command, m/s2."""
        gains, train, error = self._config, self._train, -off.speed
        rate = 0.0 if self._last is None else (error - self._last) / self._period
        self._last = error
        wanted = gains.kp * error + gains.ki * self._integral + gains.kd * rate
        coast = train.coasting(state.v)
        lowest, highest = coast - train.full_brake(state.v), coast + train.full_throttle(state.v)
        if (wanted < highest or error < 0.0) and (wanted > lowest or error > 0.0):
            self._integral += self._period * error
        return min(max(wanted, lowest), highest)
