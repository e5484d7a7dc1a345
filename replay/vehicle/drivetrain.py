"""The drive train: pedals -> motor torque -> gears -> wheels; brakes; resistances; and the
actuators.

Over speed v, per kg of vehicle, from the motor map T_g(v) = torque at speed v gear_g / radius
(below idle the clutch or converter slips: the torque is that of idle; above the last speed of the
map there is none):

(1) force_g(v)  = T_g(v) gear_g efficiency / (radius mass)       one gear;
        most(v) = max over the gears
(2) overrun(v)  = motor_overrun gear_top / (radius mass)
        closed throttle: the gearbox coasts in its top gear; below idle it fades to 0 at standstill
(3) drive       = min(p (most + overrun) - overrun, force_g)
        throttle p: a share of what this speed allows
(4) brake       = q max_decel
        brake q, shared between the axles by their loads
(5) dp/dt = (p_command - p) / throttle_lag,  dq/dt = (q_command - q) / brake_lag,
        q_command late by brake_delay
(6) resist      = rolling + drag v^2
(7) d(steer)/dt = clip((command - steer) / steer_lag, -max_rate, max_rate)
        |command| <= max_steer

So the acceleration is linear in each pedal at a given speed, as in drive-by-wire; the gear only
limits it (a kick-down takes time). Without a motor description, force = min(max_accel, max_power /
v) and overrun = 0. The inertia of motor and wheels is neglected.

Shifting: the highest gear with RESERVE above the wanted force and the motor above CRUISE times
idle; up at the earliest MIN_HOLD_S after the last shift, down when the gear cannot give what is
wanted or the motor falls below LUG times idle. While a shift lasts (shift_time) the throttle is cut
to SHIFT_THROTTLE of the command.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from replan.core.arrays import FloatArray, IntArray, frozen
from replan.core.kernel import kernel
from replan.logs.vehicle import VehicleParameters
from replan.replay.vehicle.pedal_map import (
    SPEED_STEP_MPS,
    PedalMap,
    at_speed,
    coasting,
    full_throttle,
    pedal_map,
)

MAX_SPEED_MPS = 90.0
RESERVE, CRUISE, LUG = 1.15, 1.6, 1.2
MIN_HOLD_S = 1.0
SHIFT_THROTTLE = 0.5
SHORTEST_LAG_S = 1e-3
"""Least lag; replaces a lag of zero."""

Steering = tuple[float, float, float]
"""max_steer rad, max_steer_rate rad/s, steer_lag s of VehicleParameters: what the kernel takes."""


class DriveTables(NamedTuple):
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


class Pending(NamedTuple):
    """Commands on their way to a late actuator, as kernels take them.

    Attributes:
        delay_ns: From a command to its effect.
        now_ns: Time up to which the values in effect have been returned.
        value: In effect now.
        waiting: How many are on their way.
        arrival_ns: `(k,)`, k >= waiting: when each takes effect, increasing.
        coming: `(k,)` their values.
    """

    delay_ns: int
    now_ns: int
    value: float
    waiting: int
    arrival_ns: IntArray
    coming: FloatArray


class Gearbox(NamedTuple):
    """The gear (index), how much longer its shift lasts and how long ago it began, s."""

    gear: int
    shifting: float
    since: float


@kernel
def steer_rate(steer: float, command: float, steering: Steering) -> float:
    """Rate of the front wheel angle, rad/s."""
    max_steer, max_rate, lag = steering
    wanted = (min(max(command, -max_steer), max_steer) - steer) / lag
    return min(max(wanted, -max_rate), max_rate)  # (7)


@kernel
def wanted_force(v: float, throttle: float, drive: DriveTables) -> float:
    """Return the acceleration that a throttle requests from the motor, m/s2.

    Negative in overrun.
    """
    overrun = at_speed(drive.overrun, v)
    return throttle * (at_speed(drive.most, v) + overrun) - overrun  # (3)


@kernel
def drive_force(v: float, throttle: float, gear: int, drive: DriveTables) -> float:
    """Return the acceleration by the motor in a gear, m/s2."""
    return min(wanted_force(v, throttle, drive), at_speed(drive.force[gear], v))  # (3)


@kernel
def best_gear(v: float, wanted: float, drive: DriveTables) -> int:
    """The highest gear with a reserve at this speed; else the strongest."""
    strongest = 0
    for gear in range(len(drive.force) - 1, -1, -1):
        if abs(v) >= drive.cruise[gear] and at_speed(drive.force[gear], v) >= RESERVE * wanted:
            return gear
        if at_speed(drive.force[gear], v) > at_speed(drive.force[strongest], v):
            strongest = gear
    return strongest


@kernel
def shifted(box: Gearbox, v: float, throttle: float, drive: DriveTables, h: float) -> Gearbox:
    """The gearbox after `h` s of a throttle command at a speed."""
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
    """The throttle that the motor gets: less during a shift."""
    return SHIFT_THROTTLE * command if box.shifting > 0.0 else command


@kernel
def commanded(line: Pending, command: float) -> Pending:
    """The line with one more command, from now on; its arrays have room for it."""
    line.arrival_ns[line.waiting], line.coming[line.waiting] = line.now_ns + line.delay_ns, command
    return Pending(
        line.delay_ns, line.now_ns, line.value, line.waiting + 1, line.arrival_ns, line.coming
    )


@kernel
def next_span(line: Pending, end_ns: int) -> tuple[float, float, Pending]:
    """How long the value in effect stays, not beyond `end_ns`, s.

    The value; the line after that.
    """
    value, waiting = line.value, line.waiting
    while waiting > 0 and line.arrival_ns[0] < end_ns:
        arrival, held = line.arrival_ns[0], value
        value = line.coming[0]
        waiting -= 1
        for i in range(waiting):
            line.arrival_ns[i], line.coming[i] = line.arrival_ns[i + 1], line.coming[i + 1]
        if arrival > line.now_ns and value != held:
            after = Pending(line.delay_ns, arrival, value, waiting, line.arrival_ns, line.coming)
            return (arrival - line.now_ns) / 1e9, held, after
    after = Pending(line.delay_ns, end_ns, value, waiting, line.arrival_ns, line.coming)
    return (end_ns - line.now_ns) / 1e9, value, after


def pending(delay: float, value: float) -> Pending:
    """A line of commands in which none is pending.

    Args:
        delay: s, not negative.
        value: What is in effect until the first command arrives.
    """
    return Pending(round(delay * 1e9), 0, float(value), 0, np.zeros(0, np.int64), np.zeros(0))


def with_room(line: Pending, dt_ns: int) -> Pending:
    """The same line with room for a command every `dt_ns`."""
    most = line.waiting + line.delay_ns // dt_ns + 2
    if most <= len(line.coming):
        return line
    arrival, coming = np.zeros(2 * most, np.int64), np.zeros(2 * most)
    arrival[: line.waiting], coming[: line.waiting] = (
        line.arrival_ns[: line.waiting],
        line.coming[: line.waiting],
    )
    return line._replace(arrival_ns=arrival, coming=coming)


def spans(line: Pending, command: float, dt: float) -> tuple[list[tuple[float, float]], Pending]:
    """Apply a command for `dt` s.

    Return the values in effect meanwhile with their durations, s, and the line.
    """
    dt_ns = round(dt * 1e9)
    line = commanded(with_room(line, dt_ns), command)
    end, parts = line.now_ns + dt_ns, []
    while line.now_ns < end:
        span, value, line = next_span(line, end)
        parts.append((span, value))
    return parts, line


@dataclass(frozen=True)
class Drivetrain:
    """The drive train of `VehicleParameters` in steady state; see
    `replan.replay.vehicle.base.Powertrain`.

    It assumes a level road; grades are not part of the drive train.
    """

    parameters: VehicleParameters

    @cached_property
    def pedal_map(self) -> PedalMap:
        """What controllers' kernels take."""
        return pedal_map(
            self.parameters, self.tables.most, self.tables.overrun, self.parameters.brake_delay
        )

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
        """The gearbox in steady state at this speed and throttle."""
        return Gearbox(
            int(best_gear(v, wanted_force(v, throttle, self.tables), self.tables)), 0.0, MIN_HOLD_S
        )

    @cached_property
    def tables(self) -> DriveTables:
        """What the kernels of this module take."""
        p = self.parameters
        v = np.arange(0.0, MAX_SPEED_MPS + SPEED_STEP_MPS, SPEED_STEP_MPS)
        if p.gears:  # idle: the vehicle speed at idle `(gears,)`; the lowest gear always holds
            speed, ratios = np.array(p.motor_speed), np.array(p.gears)
            wheel = ratios / (p.wheel_radius * p.mass)
            turning = v * ratios[:, None] / p.wheel_radius
            torque = np.interp(turning, speed, p.motor_torque, right=0.0)
            force = torque * wheel[:, None] * p.drive_efficiency  # (1)
            fading = np.minimum(turning[-1] / speed[0], 1.0)
            overrun = fading * np.interp(turning[-1], speed, p.motor_overrun) * wheel[-1]  # (2)
            idle = speed[0] * p.wheel_radius / ratios
            idle[0] = 0.0
        else:
            force = np.minimum(p.max_accel, p.max_power / np.maximum(v, 1e-3))[None]
            overrun, idle = np.zeros(len(v)), np.zeros(1)
        return DriveTables(
            frozen(force),
            frozen(force.max(axis=0)),
            frozen(overrun),
            frozen(CRUISE * idle),
            frozen(LUG * idle),
            float(p.max_decel),
            float(p.rolling),
            float(p.drag),
            float(p.shift_time),
        )
