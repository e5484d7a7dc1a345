"""The drive train: pedals -> motor torque -> gears -> wheels; brakes; what resists.

Over speed v, per kg of vehicle, from the motor map T_g(v) = torque at speed v gear_g / radius (below idle the clutch or
converter slips: the torque is that of idle; above the last speed of the map there is none):

(1) force_g(v)  = T_g(v) gear_g efficiency / (radius mass)       one gear;  most(v) = max over the gears
(2) overrun(v)  = motor_overrun gear_top / (radius mass)         closed throttle: the gearbox coasts in its top gear;
                                                                 below idle it fades to 0 at standstill
(3) drive       = min(p (most + overrun) - overrun, force_g)     throttle p: a share of what this speed allows
(4) brake       = q max_decel                                    brake q, shared between the axles by their loads
(5) dp/dt = (p_command - p) / throttle_lag,  dq/dt = (q_command - q) / brake_lag,  q_command late by brake_delay
(6) resist      = rolling + drag v^2

So the acceleration is linear in each pedal at a given speed, which is how drive-by-wire reads the pedal; the gear only
limits (a kick-down takes its time). Where no motor is described, force = min(max_accel, max_power / v) and overrun = 0.
The inertia of motor and wheels counts as mass nowhere: neglected.

Shifting: the highest gear with RESERVE above the wanted force and the motor above CRUISE times idle; up at the earliest
MIN_HOLD_S after the last shift, down when the gear cannot give what is wanted or the motor falls below LUG times idle.
While a shift lasts (shift_time) the throttle is cut to SHIFT_THROTTLE of the command.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from logs.kernel import FloatArray, frozen, kernel
from logs.vehicle import VehicleParameters
from replay.vehicle.pedal_map import SPEED_STEP_MPS, PedalMap, at_speed, coasting, full_throttle, pedal_map

MAX_SPEED_MPS = 90.0
RESERVE, CRUISE, LUG, MIN_HOLD_S = 1.15, 1.6, 1.2, 1.0
SHIFT_THROTTLE = 0.5


class Drive(NamedTuple):
    """The tables of a drive train over speed 0, SPEED_STEP_MPS, ..., as the kernels take them.

    Attributes:
        force: `(gears, n)` m/s2, (1).
        most: `(n,)` m/s2, the greatest of them.
        overrun: `(n,)` m/s2, (2).
        cruise: `(gears,)` the least speed to shift up into a gear, m/s.
        lug: `(gears,)` below this speed it is left, m/s.
        max_decel: m/s2.
        rolling: m/s2.
        drag: 1/m.
        shift_time: s.
    """

    force: FloatArray
    most: FloatArray
    overrun: FloatArray
    cruise: FloatArray
    lug: FloatArray
    max_decel: float
    rolling: float
    drag: float
    shift_time: float


class Gearbox(NamedTuple):
    """The gear (index), how much longer its shift lasts and how long ago it began, s."""

    gear: int
    shifting: float
    since: float


@kernel
def wanted_force(v: float, throttle: float, drive: Drive) -> float:
    """What a throttle asks of the motor at the wheels, m/s2; negative in overrun."""
    overrun = at_speed(drive.overrun, v)
    return throttle * (at_speed(drive.most, v) + overrun) - overrun  # (3)


@kernel
def drive_force(v: float, throttle: float, gear: int, drive: Drive) -> float:
    """What the motor gives at the wheels in a gear, m/s2."""
    return min(wanted_force(v, throttle, drive), at_speed(drive.force[gear], v))  # (3)


@kernel
def best_gear(v: float, wanted: float, drive: Drive) -> int:
    """The highest gear with a reserve at this speed; else the strongest."""
    strongest = 0
    for gear in range(len(drive.force) - 1, -1, -1):
        if abs(v) >= drive.cruise[gear] and at_speed(drive.force[gear], v) >= RESERVE * wanted:
            return gear
        if at_speed(drive.force[gear], v) > at_speed(drive.force[strongest], v):
            strongest = gear
    return strongest


@kernel
def shifted(box: Gearbox, v: float, throttle: float, drive: Drive, h: float) -> Gearbox:
    """The gearbox after `h` s in which a throttle is asked for at a speed."""
    shifting, since = max(box.shifting - h, 0.0), box.since + h
    if len(drive.force) == 1 or shifting > 0.0:
        return Gearbox(box.gear, shifting, since)
    wanted = wanted_force(v, throttle, drive)
    best = best_gear(v, wanted, drive)
    short = at_speed(drive.force[box.gear], v) < wanted or abs(v) < drive.lug[box.gear]
    if (best > box.gear and since >= MIN_HOLD_S) or (best < box.gear and short):
        return Gearbox(best, drive.shift_time, 0.0)
    return Gearbox(box.gear, shifting, since)


@kernel
def throttle_target(command: float, box: Gearbox) -> float:
    """The throttle that the motor is asked for: less during a shift."""
    return SHIFT_THROTTLE * command if box.shifting > 0.0 else command


@dataclass(frozen=True)
class Drivetrain:
    """The drive train of `VehicleParameters` in steady state; see `replay.vehicle.base.Powertrain`.

    On a level road: a grade is not the drive train's.
    """

    parameters: VehicleParameters

    @cached_property
    def pedal_map(self) -> PedalMap:
        """What controllers' kernels take."""
        return pedal_map(self.parameters, self.tables.most, self.tables.overrun, self.parameters.brake_delay)

    def coasting(self, v: float) -> float:
        """Acceleration without pedals, m/s2."""
        return coasting(self.pedal_map, v)

    def full_throttle(self, v: float) -> float:
        """What full throttle adds, m/s2."""
        return full_throttle(self.pedal_map, v)

    def full_brake(self, v: float) -> float:
        """What full brake takes, m/s2."""
        return self.tables.max_decel

    def gearbox(self, v: float, throttle: float) -> Gearbox:
        """The gearbox as it is after driving like this for long."""
        return Gearbox(int(best_gear(v, wanted_force(v, throttle, self.tables), self.tables)), 0.0, MIN_HOLD_S)

    @cached_property
    def tables(self) -> Drive:
        """What the kernels of this module take."""
        p = self.parameters
        v = np.arange(0.0, MAX_SPEED_MPS + SPEED_STEP_MPS, SPEED_STEP_MPS)
        force, overrun, idle = _motor(p, v) if p.gears else _plain(p, v)
        return Drive(
            frozen(force), frozen(force.max(axis=0)), frozen(overrun), frozen(CRUISE * idle), frozen(LUG * idle),
            float(p.max_decel), float(p.rolling), float(p.drag), float(p.shift_time),
        )  # fmt: skip


def _plain(p: VehicleParameters, v: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Force `(1, n)`, overrun `(n,)` and idle speed `(1,)` where no motor is described."""
    return np.minimum(p.max_accel, p.max_power / np.maximum(v, 1e-3))[None], np.zeros(len(v)), np.zeros(1)


def _motor(p: VehicleParameters, v: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Force `(gears, n)` (1), overrun `(n,)` (2) and vehicle speed at idle `(gears,)`; the lowest gear always holds."""
    speed, ratios = np.array(p.motor_speed), np.array(p.gears)
    wheel = ratios / (p.wheel_radius * p.mass)
    turning = v * ratios[:, None] / p.wheel_radius
    force = np.interp(turning, speed, p.motor_torque, right=0.0) * wheel[:, None] * p.drive_efficiency  # (1)
    fading = np.minimum(turning[-1] / speed[0], 1.0)
    overrun = fading * np.interp(turning[-1], speed, p.motor_overrun) * wheel[-1]  # (2)
    idle = speed[0] * p.wheel_radius / ratios
    idle[0] = 0.0
    return force, overrun, idle
