"""Acceleration to pedals: the powertrain inverted, one pedal at a time, and the brake that holds a standstill.

(1) throttle = (a - coasting(v)) / full_throttle(v)        while driving, not below 0
(2) brake    = (coasting(v) - a) / full_brake(v)           while braking, not below 0

The pedal changes only when `a` is HYSTERESIS_MPS2 beyond coasting on the other side; until then the pedal in use is
released. So both are never on together, and noise around coasting does not make them alternate.
"""

from __future__ import annotations

from replay.control.tracking import PlanPath
from replay.vehicle.base import Powertrain

HYSTERESIS_MPS2 = 0.15
HOLDING_BRAKE = 0.2
STOPPING_BRAKE, STILL_MPS = 0.03, 0.01

STANDING_MPS = 0.1
"""The ego stands where it is slower than this and the plan does not want to move within LOOK_AHEAD_S."""
LEAVING_MPS = 0.15
LOOK_AHEAD_S = 1.0


class Pedals:
    """(1)-(2); remembers which pedal is in use."""

    def __init__(self, powertrain: Powertrain) -> None:
        self._train = powertrain
        self._braking = False

    def press(self, acceleration: float, v: float) -> tuple[float, float]:
        """Throttle and brake, 0 to 1, for an acceleration (m/s2) at a speed (m/s)."""
        beyond = acceleration - self._train.coasting(v)
        if self._braking and beyond > HYSTERESIS_MPS2:
            self._braking = False
        elif not self._braking and beyond < -HYSTERESIS_MPS2:
            self._braking = True
        if self._braking:
            return 0.0, min(max(-beyond / self._train.full_brake(v), 0.0), 1.0)
        return min(max(beyond / self._train.full_throttle(v), 0.0), 1.0), 0.0

    def hold(self, v: float) -> tuple[float, float]:
        """Throttle and brake that hold a standstill; gently, while the last of the speed `v` (m/s) goes."""
        self._braking = True
        return 0.0, HOLDING_BRAKE if v < STILL_MPS else STOPPING_BRAKE


class Standstill:
    """Whether the vehicle is to be held: a stop state with hysteresis, so that it neither creeps nor hesitates."""

    def __init__(self) -> None:
        self._holds = False

    def holds(self, v: float, t: float, path: PlanPath) -> bool:
        """Whether to hold at speed `v` (m/s) and time `t` (s), following `path`."""
        wanted = max(path.timed(t)[1], path.timed(t + LOOK_AHEAD_S)[1])
        self._holds = wanted <= LEAVING_MPS if self._holds else v < STANDING_MPS and wanted <= STANDING_MPS
        return self._holds
