"""Acceleration to pedals: the powertrain inverted, one pedal at a time; how a stop ends and is held.

(1) throttle = (a - coasting(v)) / full_throttle(v)        while driving, not below 0
(2) brake    = (coasting(v) - a) / full_brake(v)           while braking, not below 0

The pedal changes only when `a` is HYSTERESIS_MPS2 beyond coasting on the other side; until then the pedal in use is
released. So both are never on together, and noise around coasting does not make them alternate.

The pedal's dead time d and lag T are inverted. A plan that begins now cannot be met before d has passed; what is
missing then is made up for over CATCH_UP_S and not at once, which would be a jerk beyond the plan's. Over a period h:

(3) m+ = m + a(t + d + h) - a(t + d) + h (a(t + d) - m) / CATCH_UP_S,   a_command = m + (m+ - m) / (1 - exp(-h / T))
    not so far that the other pedal would be pressed: that is the plan's to ask for

A stop that is wanted ends softly: a deceleration b that stayed until standstill would drop to 0 there at once. From the
speed v on at which it can be released with the jerk j, it follows v = j u^2 / 2, b = j u, with u s left; that is b^3 /
(24 j^2) longer, so

(4) j = max(GENTLE_MPS3, sqrt(b^3 / (24 LONGER_M))),   a_command = -j max(sqrt(2 v / j) - d - LAGS T, 0) + o
    o' = -HARDER_PER_S (b_v + a), from 0, while it slows down by less than half of b_v = sqrt(2 j v): an unknown slope
"""

from __future__ import annotations

from math import exp, sqrt

from logs.states import EgoState
from replay.control.tracking import PlanPath
from replay.vehicle.base import Powertrain

HYSTERESIS_MPS2 = 0.15
HOLDING_BRAKE = 0.2
STILL_MPS, SLOWING_MPS2 = 0.002, 0.05

STANDING_MPS = 0.1
"""The ego stands where it is slower than this and the plan does not want to move within LOOK_AHEAD_S."""
LEAVING_MPS = 0.15
LOOK_AHEAD_S = 1.0
GENTLE_MPS3 = 4.0
LONGER_M = 0.06
"""By how much the soft end (4) lengthens a stop; the residue of the lag adds as much again."""
HARDER_PER_S = 3.0
LAGS = 1.1
"""Lags of the brake by which (4) is led: a little early, for what is left of the brake at standstill is a jerk."""
CATCH_UP_S = 0.3
STEEPEST_MPS3 = 15.0
"""Changes of a plan's acceleration beyond this are taken for steps, which (3) does not follow."""


class Pedals:
    """(1)-(2); remembers which pedal is in use, and whether the brake holds."""

    def __init__(self, powertrain: Powertrain) -> None:
        self._train = powertrain
        self._braking = self._holding = False

    def press(self, acceleration: float, v: float) -> tuple[float, float]:
        """Throttle and brake, 0 to 1, for an acceleration (m/s2) at a speed (m/s)."""
        self._holding = False
        beyond = acceleration - self._train.coasting(v)
        if self._braking and beyond > HYSTERESIS_MPS2:
            self._braking = False
        elif not self._braking and beyond < -HYSTERESIS_MPS2:
            self._braking = True
        if self._braking:
            return 0.0, min(max(-beyond / self._train.full_brake(v), 0.0), 1.0)
        return min(max(beyond / self._train.full_throttle(v), 0.0), 1.0), 0.0

    def hold(self, v: float, a: float) -> tuple[float, float]:
        """Throttle and brake that hold a standstill; none while the last of `v` (m/s) goes by itself, `a` (m/s2)."""
        self._braking = True
        self._holding = self._holding or v < STILL_MPS or a > -SLOWING_MPS2
        return 0.0, HOLDING_BRAKE if self._holding else 0.0


class Lead:
    """(3); remembers m, which follows the commands as the acceleration does."""

    def __init__(self, powertrain: Powertrain, period: float) -> None:
        self._train, self._period = powertrain, period
        self._m: float | None = None

    def rest(self) -> None:
        """The vehicle is held: what was commanded is gone."""
        self._m = None

    def command(self, path: PlanPath, t: float, v: float) -> float:
        """The acceleration to command at `t` (s) and speed `v` (m/s), for a period, for that of the plan, m/s2."""
        train, h = self._train, self._period
        coast = train.coasting(v)
        now, soon, late, later = path.accelerations(t, train.brake_delay, h)
        brakes = later < coast
        before, after, lag = (late, later, train.brake_lag) if brakes else (now, soon, train.throttle_lag)
        m = now if self._m is None else self._m
        steepest = STEEPEST_MPS3 * h
        self._m = m + min(max(after - before, -steepest), steepest) + h / CATCH_UP_S * (before - m)
        command = m + (self._m - m) / (1.0 - exp(-h / lag)) if lag > 0.0 else self._m
        return min(command, coast) if brakes else max(command, coast)


class SoftStop:
    """(4); remembers j and o of the stop that it ends."""

    def __init__(self, powertrain: Powertrain, period: float) -> None:
        self._period = period
        self._late = powertrain.brake_delay + LAGS * powertrain.brake_lag
        self._jerk = self._offset = 0.0

    def eased(self, acceleration: float, state: EgoState, path: PlanPath) -> float:
        """What to command where `acceleration` is wanted, m/s2."""
        v = max(state.v, 0.0)
        if path.timed(state.t + LOOK_AHEAD_S)[1] > STANDING_MPS:
            self._jerk = self._offset = 0.0
        elif not self._jerk and acceleration < 0.0:
            jerk = max(GENTLE_MPS3, sqrt(-(acceleration**3) / (24.0 * LONGER_M)))
            if acceleration**2 > 2.0 * jerk * max(v + acceleration * self._late, 0.0):
                self._jerk = jerk
        if not self._jerk:
            return acceleration
        left = sqrt(2.0 * v / self._jerk)
        if state.a > -0.5 * self._jerk * left:
            self._offset -= self._period * HARDER_PER_S * (self._jerk * left + state.a)
        return self._offset - self._jerk * max(left - self._late, 0.0)


class Standstill:
    """Whether the vehicle is to be held: a stop state with hysteresis, so that it neither creeps nor hesitates."""

    def __init__(self) -> None:
        self._holds = False

    def holds(self, v: float, t: float, path: PlanPath) -> bool:
        """Whether to hold at speed `v` (m/s) and time `t` (s), following `path`."""
        wanted = max(path.timed(t)[1], path.timed(t + LOOK_AHEAD_S)[1])
        self._holds = wanted <= LEAVING_MPS if self._holds else v < STANDING_MPS and wanted <= STANDING_MPS
        return self._holds
