"""Pure pursuit: drive the circle through a point of the path ahead.

(1) ahead = clip(time v, shortest, longest)                    m
(2) alpha = bearing from the rear axle to the path's point at that distance, against the heading
(3) steer = atan(2 L sin(alpha) / ahead)

Source: Coulter, Implementation of the Pure Pursuit Path Tracking Algorithm, CMU-RI-TR-92-01; look-ahead by speed as in
Snider, Automatic Steering Methods for Autonomous Automobile Path Tracking, CMU-RI-TR-09-08. Neither looks at
curvature. The distance is the shortest, in steps of 0.1 s of driving, that keeps every manoeuvre of
`replay.experiments.manoeuvres` stable on the single-track vehicle.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan, atan2, hypot, sin

from logs.errors import ConfigError
from logs.states import EgoState
from logs.vehicle import VehicleParameters
from replay.control.tracking import Deviation, PlanPath, path_point


@dataclass(frozen=True)
class PurePursuitConfig:
    """The distance (1): `time_s` of driving, from `shortest_m` to `longest_m`."""

    time_s: float = 0.5
    shortest_m: float = 3.0
    longest_m: float = 25.0

    def __post_init__(self) -> None:
        if not (self.time_s > 0.0 and 0.0 < self.shortest_m <= self.longest_m):
            raise ConfigError("pure pursuit: time_s must be positive and 0 < shortest_m <= longest_m")


class PurePursuit:
    """(1)-(3); without memory. See `replay.control.base.LateralLaw`."""

    def __init__(self, parameters: VehicleParameters, config: PurePursuitConfig | None = None) -> None:
        self._wheelbase, self._max_steer = parameters.wheelbase, parameters.max_steer
        self._config = config or PurePursuitConfig()

    def rest(self) -> None:
        """There is nothing to forget."""

    def steer(self, state: EgoState, path: PlanPath, off: Deviation) -> float:
        """Front wheel angle to command, rad."""
        wanted = min(max(self._config.time_s * state.v, self._config.shortest_m), self._config.longest_m)
        s = off.foot + wanted
        for _ in range(3):  # station at which the distance is as wanted; exact on a straight
            x, y, _, _ = path_point(path.knots, s)
            s += wanted - hypot(x - state.x, y - state.y)
        x, y, _, _ = path_point(path.knots, s)
        ahead = max(hypot(x - state.x, y - state.y), 1e-3)
        alpha = atan2(y - state.y, x - state.x) - state.yaw
        command = atan(2.0 * self._wheelbase * sin(alpha) / ahead)
        return min(max(command, -self._max_steer), self._max_steer)
