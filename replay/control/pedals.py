"""Converts acceleration to pedals by inverting the powertrain, one pedal at a time; ends and holds
stops.

(1) throttle = (a - coasting(v)) / full_throttle(v)        while driving, not below 0
(2) brake    = (coasting(v) - a) / full_brake(v)           while braking, not below 0

The pedal changes only when `a` is HYSTERESIS_MPS2 beyond coasting on the other side; until then,
the pedal in use is released. So the pedals are never pressed together, and do not alternate due to
noise around coasting.

The pedal's dead time d and lag T are inverted. A plan that begins now cannot be met before d has
passed. The deficit is then made up over CATCH_UP_S, because making it up at once would add jerk to
the plan's. Over a period h:

(3) m+ = m + a(t + d + h) - a(t + d) + h (a(t + d) - m) / CATCH_UP_S,
        a_command = m + (m+ - m) / (1 - exp(-h / T)) limited so that it never presses the other
        pedal, unless the plan requires that

A planned stop ends softly: a deceleration b that lasted until standstill would drop to 0 abruptly.
From the speed v on at which it can be released with the jerk j, it follows v = j u^2 / 2, b = j u,
with u s left; that is b^3 / (24 j^2) longer, so

(4) j = max(GENTLE_MPS3, sqrt(b^3 / (24 LONGER_M))),
        a_command = -j max(sqrt(2 v / j) - d - LAGS T, 0) + o
    o' = -HARDER_PER_S (b_v + a), from 0, while it slows down by less than half
        of b_v = sqrt(2 j v): an unknown slope

The calibration table: acceleration x speed -> pedals, as the vehicle's own model has it in steady
state.

(5) pedal(a, v) > 0: throttle, < 0: brake;  beyond = a - coasting(v)
    pedal = beyond / full_throttle(v) where beyond >= 0,
        beyond / full_brake(v) where it is negative; NaN out of reach

Such a table is measured on a car whose drive train cannot be inverted. Here the power train is
known and linear in the pedal at each speed, so controllers use the exact inverse, without
interpolation errors or a file that must match the vehicle. The table is for inspection, and for
driving a real car.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from math import exp, isnan, sqrt
from pathlib import Path

import numpy as np

from replan.core.arrays import FloatArray, frozen
from replan.core.kernel import kernel
from replan.replay.vehicle.base import Powertrain
from replan.replay.vehicle.pedal_map import PedalMap, coasting, full_throttle
from replan.replay.vehicle.plan_path import timed

HYSTERESIS_MPS2 = 0.15
HOLDING_BRAKE = 0.2
STILL_MPS, SLOWING_MPS2 = 0.002, 0.05

STANDING_MPS = 0.1
"""The ego stands if it is slower than this and the plan does not move within LOOK_AHEAD_S."""
LEAVING_MPS = 0.15
LOOK_AHEAD_S = 1.0
GENTLE_MPS3 = 4.0
LONGER_M = 0.06
"""By how much the soft end (4) lengthens a stop; the residue of the lag adds as much again."""
HARDER_PER_S = 3.0
LAGS = 1.1
"""Lead of (4), in lags of the brake: slightly early, because braking that remains at standstill is
a jerk.
"""
CATCH_UP_S = 0.3
STEEPEST_MPS3 = 15.0
"""Faster changes of a plan's acceleration are steps, which (3) does not follow."""

SPEEDS_MPS = np.arange(0.0, 50.1, 1.0)
ACCELERATIONS_MPS2 = np.arange(-9.0, 5.1, 0.25)
"""Grid of the calibration table."""


class PedalMemory:
    """Whether the brake is the pedal in use, and whether it holds a standstill; a record."""

    braking: bool = False
    holding: bool = False


class StopMemory:
    """j m/s3 and o m/s2 of the stop (4) in progress; j = 0: there is none. A record."""

    jerk: float = 0.0
    offset: float = 0.0


@kernel
def press(
    pedal: PedalMemory, train: PedalMap, acceleration: float, v: float
) -> tuple[float, float]:
    """Return throttle and brake, 0 to 1, for an acceleration (m/s2) at a speed (m/s)."""
    beyond = acceleration - coasting(train, v)
    pedal.braking = beyond < -HYSTERESIS_MPS2 or (pedal.braking and beyond <= HYSTERESIS_MPS2)
    pedal.holding = False
    if pedal.braking:
        return 0.0, min(max(-beyond / train.max_decel, 0.0), 1.0)  # (2)
    return min(max(beyond / full_throttle(train, v), 0.0), 1.0), 0.0  # (1)


@kernel
def hold(pedal: PedalMemory, v: float, a: float) -> tuple[float, float]:
    """Throttle and brake that hold a standstill.

    Both 0 while the car still slows down by itself, `v` m/s, `a` m/s2.
    """
    pedal.braking = True
    pedal.holding = pedal.holding or v < STILL_MPS or a > -SLOWING_MPS2
    return 0.0, HOLDING_BRAKE if pedal.holding else 0.0


@kernel
def compensated(
    m: float, train: PedalMap, times: FloatArray, t: float, v: float, h: float
) -> tuple[float, float]:
    """Return the acceleration to command at `t` (s), speed `v` (m/s), for a period `h`, to get the
    plan's; and m+ (3).

    `m` is m of (3), m/s2; NaN: nothing has been commanded yet.
    """
    coast = coasting(train, v)
    later = timed(times, t + train.brake_delay + h)[2]
    brakes = later < coast
    now = timed(times, t)[2]
    before = timed(times, t + train.brake_delay)[2] if brakes else now
    after = later if brakes else timed(times, t + h)[2]
    lag = train.brake_lag if brakes else train.throttle_lag
    m = now if isnan(m) else m
    steepest = STEEPEST_MPS3 * h
    # (3)
    following = m + min(max(after - before, -steepest), steepest) + h / CATCH_UP_S * (before - m)
    command = m + (following - m) / (1.0 - exp(-h / lag)) if lag > 0.0 else following
    return min(command, coast) if brakes else max(command, coast), following


@kernel
def eased(
    stop: StopMemory,
    train: PedalMap,
    times: FloatArray,
    t: float,
    v: float,
    a: float,
    wanted: float,
    h: float,
) -> float:
    """Soften the end of a stop (4): return the acceleration to command at `t`, `v`, `a` instead of
    `wanted`, m/s2.
    """
    v, late = max(v, 0.0), train.brake_delay + LAGS * train.brake_lag
    if timed(times, t + LOOK_AHEAD_S)[1] > STANDING_MPS:
        stop.jerk = stop.offset = 0.0
    elif stop.jerk == 0.0 and wanted < 0.0:
        gentle = max(GENTLE_MPS3, sqrt(-(wanted**3.0) / (24.0 * LONGER_M)))  # (4)
        if wanted * wanted > 2.0 * gentle * max(v + wanted * late, 0.0):
            stop.jerk = gentle
    if stop.jerk == 0.0:
        return wanted
    left = sqrt(2.0 * v / stop.jerk)
    if a > -0.5 * stop.jerk * left:
        stop.offset -= h * HARDER_PER_S * (stop.jerk * left + a)
    return stop.offset - stop.jerk * max(left - late, 0.0)  # (4)


@kernel
def stands(standing: bool, v: float, t: float, times: FloatArray) -> bool:
    """Return whether to hold the vehicle at speed `v` (m/s) and time `t` (s); `standing`: it has
    been held.
    """
    wanted = max(timed(times, t)[1], timed(times, t + LOOK_AHEAD_S)[1])
    return wanted <= LEAVING_MPS if standing else v < STANDING_MPS and wanted <= STANDING_MPS


@dataclass(frozen=True, eq=False)
class Calibration:
    """The table (5).

    Attributes:
        speed: `(n,)` m/s, increasing.
        acceleration: `(m,)` m/s2, increasing.
        pedal: `(m, n)`; throttle positive, brake negative, -1 to 1; NaN out of the vehicle's reach.
    """

    speed: FloatArray
    acceleration: FloatArray
    pedal: FloatArray

    def __post_init__(self) -> None:
        for name in ("speed", "acceleration", "pedal"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @classmethod
    def of(
        cls,
        powertrain: Powertrain,
        speed: FloatArray = SPEEDS_MPS,
        acceleration: FloatArray = ACCELERATIONS_MPS2,
    ) -> Calibration:
        """Compute the table of a power train."""
        coasting, throttle, brake = (
            np.array([of(float(v)) for v in speed])
            for of in (powertrain.coasting, powertrain.full_throttle, powertrain.full_brake)
        )
        beyond = acceleration[:, None] - coasting
        pedal = np.divide(beyond, np.where(beyond >= 0.0, throttle, brake))
        return cls(speed, acceleration, np.where(np.abs(pedal) <= 1.0, pedal, np.nan))

    def at(self, acceleration: float, v: float) -> tuple[float, float]:
        """Return throttle and brake by bilinear interpolation, constant beyond its ends; NaN if
        unreachable.
        """
        i, u = _place(self.acceleration, acceleration)
        j, w = _place(self.speed, v)
        corners = self.pedal[i : i + 2, j : j + 2]
        pedal = float(np.array([1.0 - u, u]) @ corners @ np.array([1.0 - w, w]))
        return max(pedal, 0.0) if pedal == pedal else pedal, max(
            -pedal, 0.0
        ) if pedal == pedal else pedal

    def save(self, path: Path) -> None:
        """Write the table as CSV: a row per acceleration, a column per speed.

        Empty out of the vehicle's reach.
        """
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["acceleration_mps2", *(f"{v:g}_mps" for v in self.speed)])
            for a, row in zip(self.acceleration, self.pedal, strict=True):
                writer.writerow(
                    [f"{a:g}", *("" if np.isnan(value) else f"{value:.6f}" for value in row)]
                )


def _place(grid: FloatArray, value: float) -> tuple[int, float]:
    """Return the cell of a value in an increasing grid, and the share of the next node, 0 to 1,
    limited at the ends.
    """
    i = int(np.clip(np.searchsorted(grid, value, side="right") - 1, 0, len(grid) - 2))
    return i, float(np.clip((value - grid[i]) / (grid[i + 1] - grid[i]), 0.0, 1.0))
