"""Stanley: the front wheels point along the path and towards it.

At the middle of the front axle, with its foot point on the path:

(1) steer = (path's heading - yaw) - atan(gain e_lat / (softening + v))          e_lat positive left of the path

Source: Thrun et al., Stanley: The Robot that Won the DARPA Grand Challenge, J. Field Robotics 23 (2006), eq. 5; the
softening: Hoffmann et al., Autonomous Automobile Trajectory Tracking for Off-Road Driving, ACC 2007. Of the gains 1,
1.5, 2 and 2.5, tried on `replay.paper.manoeuvres` with the single-track vehicle, 2 is the best (2.5 loses
ISO 3888-2).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan, cos, sin
from typing import NamedTuple

from logs.errors import ConfigError
from logs.kernel import FloatArray, inner_kernel
from logs.states import wrap
from logs.vehicle import VehicleParameters
from replay.vehicle.base import Motion
from replay.vehicle.plan_path import Deviation, path_foot, path_point


@dataclass(frozen=True)
class StanleyConfig:
    """Gain 1/s and softening m/s of (1)."""

    gain: float = 2.0
    softening_mps: float = 1.0

    def __post_init__(self) -> None:
        if not (self.gain > 0.0 and self.softening_mps > 0.0):
            raise ConfigError("Stanley: gain and softening_mps must be positive")


class StanleyLaw(NamedTuple):
    """The numbers of (1): 1/s, m/s, wheelbase m, max_steer rad."""

    gain: float
    softening: float
    wheelbase: float
    max_steer: float


def stanley_law(p: VehicleParameters, config: StanleyConfig | None = None) -> StanleyLaw:
    """The law for a vehicle."""
    c = config or StanleyConfig()
    return StanleyLaw(float(c.gain), float(c.softening_mps), float(p.wheelbase), float(p.max_steer))


@inner_kernel
def steer_at_front(law: StanleyLaw, now: Motion, off: Deviation, knots: FloatArray) -> float:
    """Front wheel angle to command, rad."""
    x, y = now.x + law.wheelbase * cos(now.yaw), now.y + law.wheelbase * sin(now.yaw)
    rx, ry, yaw, _ = path_point(knots, path_foot(knots, x, y, off.foot + law.wheelbase))
    lateral = (y - ry) * cos(yaw) - (x - rx) * sin(yaw)
    towards = atan(law.gain * lateral / (law.softening + max(now.v, 0.0)))
    command = wrap(yaw - now.yaw) - towards  # (1)
    return min(max(command, -law.max_steer), law.max_steer)
