"""Pure pursuit: drive the circle through a point of the path ahead.

(1) ahead = clip(time v, shortest, longest)                    m
(2) alpha = bearing from the rear axle to the path's point at that distance, against the heading
(3) steer = atan(2 L sin(alpha) / ahead)

Source: Coulter, Implementation of the Pure Pursuit Path Tracking Algorithm, CMU-RI-TR-92-01; look-ahead by speed as in
Snider, Automatic Steering Methods for Autonomous Automobile Path Tracking, CMU-RI-TR-09-08. Neither looks at
curvature. The distance is the shortest, in steps of 0.1 s of driving, that keeps every manoeuvre of
`replay.paper.manoeuvres` stable on the single-track vehicle.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan, atan2, hypot, sin
from typing import NamedTuple

from logs.errors import ConfigError
from logs.kernel import FloatArray, inner_kernel
from logs.vehicle import VehicleParameters
from replay.vehicle.base import Motion
from replay.vehicle.plan_path import Deviation, path_point


@dataclass(frozen=True)
class PurePursuitConfig:
    """The distance (1): `time_s` of driving, from `shortest_m` to `longest_m`."""

    time_s: float = 0.5
    shortest_m: float = 3.0
    longest_m: float = 25.0

    def __post_init__(self) -> None:
        if not (self.time_s > 0.0 and 0.0 < self.shortest_m <= self.longest_m):
            raise ConfigError("pure pursuit: time_s must be positive and 0 < shortest_m <= longest_m")


class PursuitLaw(NamedTuple):
    """The numbers of (1)-(3): s, m, m, wheelbase m, max_steer rad."""

    time: float
    shortest: float
    longest: float
    wheelbase: float
    max_steer: float


def pursuit_law(p: VehicleParameters, config: PurePursuitConfig | None = None) -> PursuitLaw:
    """The law for a vehicle."""
    c = config or PurePursuitConfig()
    return PursuitLaw(
        float(c.time_s), float(c.shortest_m), float(c.longest_m), float(p.wheelbase), float(p.max_steer)
    )  # fmt: skip


@inner_kernel
def steer_pursuing(law: PursuitLaw, now: Motion, off: Deviation, knots: FloatArray) -> float:
    """Front wheel angle to command, rad."""
    wanted = min(max(law.time * now.v, law.shortest), law.longest)  # (1)
    s = off.foot + wanted
    for _ in range(3):  # station at which the distance is as wanted; exact on a straight
        x, y, _, _ = path_point(knots, s)
        s += wanted - hypot(x - now.x, y - now.y)
    x, y, _, _ = path_point(knots, s)
    ahead = max(hypot(x - now.x, y - now.y), 1e-3)
    alpha = atan2(y - now.y, x - now.x) - now.yaw  # (2)
    command = atan(2.0 * law.wheelbase * sin(alpha) / ahead)  # (3)
    return min(max(command, -law.max_steer), law.max_steer)
