"""Stanley: the front wheels point along the path and towards it.

At the middle of the front axle, with its foot point on the path:

(1) steer = (path's heading - yaw) - atan(gain e_lat / (softening + v))          e_lat positive left of the path

Source: Thrun et al., Stanley: The Robot that Won the DARPA Grand Challenge, J. Field Robotics 23 (2006), eq. 5; the
softening: Hoffmann et al., Autonomous Automobile Trajectory Tracking for Off-Road Driving, ACC 2007. Of the gains 1,
1.5, 2 and 2.5, tried on `replay.experiments.manoeuvres` with the single-track vehicle, 2 is the best (2.5 loses
ISO 3888-2).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan, cos, sin

from logs.errors import ConfigError
from logs.states import EgoState, wrap
from logs.vehicle import VehicleParameters
from replay.control.tracking import Deviation, PlanPath, path_foot, path_point


@dataclass(frozen=True)
class StanleyConfig:
    """Gain 1/s and softening m/s of (1)."""

    gain: float = 2.0
    softening_mps: float = 1.0

    def __post_init__(self) -> None:
        if not (self.gain > 0.0 and self.softening_mps > 0.0):
            raise ConfigError("Stanley: gain and softening_mps must be positive")


class Stanley:
    """(1); without memory. See `replay.control.base.LateralLaw`."""

    def __init__(self, parameters: VehicleParameters, config: StanleyConfig | None = None) -> None:
        self._wheelbase, self._max_steer = parameters.wheelbase, parameters.max_steer
        self._config = config or StanleyConfig()

    def rest(self) -> None:
        """There is nothing to forget."""

    def steer(self, state: EgoState, path: PlanPath, off: Deviation) -> float:
        """Front wheel angle to command, rad."""
        x, y = state.x + self._wheelbase * cos(state.yaw), state.y + self._wheelbase * sin(state.yaw)
        rx, ry, yaw, _ = path_point(path.knots, path_foot(path.knots, x, y, off.foot + self._wheelbase))
        lateral = (y - ry) * cos(yaw) - (x - rx) * sin(yaw)
        towards = atan(self._config.gain * lateral / (self._config.softening_mps + max(state.v, 0.0)))
        command = wrap(yaw - state.yaw) - towards
        return min(max(command, -self._max_steer), self._max_steer)
