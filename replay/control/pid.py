"""PID controllers: the dual-loop PID of the speed, and one PID each for steering and speed, the
simplest controller.

Dual loop, station error -> speed -> acceleration:

(1) v_wanted = v_plan - clip(station_gain * e_station, -station_limit, station_limit)
        outer loop, e = ego - plan
(2) e        = v_wanted - v
(3) a        = a_plan + kp e + ki int(e) dt
        inner loop; a_plan led by the pedal's lag (`pedals` (3))
(4) a within what the vehicle can do at this speed; the integral is frozen while it would push a
    further out of these limits (conditional integration), which prevents windup.

One PID each, without a model or feed-forward:

(5) steer = -(kp e + ki int(e) dt + kd e') / (1 + (v / v_0)^2)
        e = lateral error at the rear axle, e' = v sin(e_phi)
(6) a     = kp e + ki int(e) dt + kd e'                             e = v_plan - v

Their integrals are frozen as in (4). Source: Astrom and Hagglund, Advanced PID Control, 3.5; the
gain of (5) falls with speed as the curvature that a lateral acceleration allows. The gains are a
compromise of a few tried on `replan.paper.manoeuvres` with the single-track vehicle: (0.6, 0.4,
0.25) loses ISO 3888-1 as well as -2, (0.2, 0.15, 0.3) loses none but is twice as far off on roads.
"""

from __future__ import annotations

from math import isnan, nan, sin
from typing import NamedTuple

from replan.core.arrays import FloatArray
from replan.core.kernel import inner_kernel, kernel
from replan.logs.states import EgoState
from replan.replay.control.pedals import compensated
from replan.replay.vehicle.pedal_map import PedalMap, reach
from replan.replay.vehicle.plan_path import Deviation, timed


class SpeedLaw(NamedTuple):
    """The numbers of a speed controller; by default those of the dual loop (1)-(3).

    Attributes:
        period: Between two commands, s.
        kp: Acceleration per speed error, 1/s.
        ki: Acceleration per integrated speed error, 1/s2.
        kd: Acceleration per rate of the speed error, 1.
        station_gain: Speed per station error, 1/s.
        station_limit: The most speed that the outer loop adds or takes, m/s.
    """

    period: float
    kp: float = 1.5
    ki: float = 0.3
    kd: float = 0.0
    station_gain: float = 0.5
    station_limit: float = 3.0


SINGLE_LOOP_KD = 0.05
"""kd of (6); its other gains are those of the inner loop (3)."""


class PidMemory:
    """The integral of the speed error, m; m of `pedals` (3), m/s2, and the last error, m/s, both
    NaN at first. A record.
    """

    integral: float = 0.0
    m: float = nan
    error: float = nan


@inner_kernel
def forget_speed(speed: PidMemory) -> None:
    """Begin anew."""
    speed.integral = 0.0
    speed.m = speed.error = nan


@kernel
def accelerate_dual_loop(
    law: SpeedLaw,
    speed: PidMemory,
    train: PedalMap,
    now: EgoState,
    off: Deviation,
    times: FloatArray,
) -> float:
    """Acceleration to command, m/s2."""
    limit = law.station_limit
    v_wanted = timed(times, now.t)[1] - min(
        max(law.station_gain * off.station, -limit), limit
    )  # (1)
    error = v_wanted - now.v  # (2)
    planned, speed.m = compensated(speed.m, train, times, now.t, now.v, law.period)
    wanted = planned + law.kp * error + law.ki * speed.integral  # (3)
    return limited(wanted, error, speed, train, now.v, law.period)


@inner_kernel
def limited(
    wanted: float, error: float, speed: PidMemory, train: PedalMap, v: float, period: float
) -> float:
    """Limit `wanted`, m/s2, to what the vehicle can do at `v`, m/s, and integrate the error over a
    period, s.
    """
    lowest, highest = reach(train, v)
    if (wanted < highest or error < 0.0) and (wanted > lowest or error > 0.0):
        speed.integral += period * error  # (4)
    return min(max(wanted, lowest), highest)


class SteeringPidLaw(NamedTuple):
    """The numbers of (5): period s, max_steer rad, gains rad/m, rad/(m s), rad s/m, v_0 m/s."""

    period: float
    max_steer: float
    kp: float = 0.4
    ki: float = 0.3
    kd: float = 0.3
    speed: float = 12.0


class LateralMemory:
    """The integral of the lateral error, m s; a record."""

    integral: float = 0.0


@inner_kernel
def steer_by_error(
    law: SteeringPidLaw, lateral: LateralMemory, now: EgoState, off: Deviation
) -> float:
    """Front wheel angle to command, rad."""
    slower = 1.0 + (now.v / law.speed) ** 2
    rate = now.v * sin(off.heading)
    command = -(law.kp * off.lateral + law.ki * lateral.integral + law.kd * rate) / slower  # (5)
    if abs(command) < law.max_steer or command * off.lateral > 0.0:
        lateral.integral += law.period * off.lateral  # (4)
    return min(max(command, -law.max_steer), law.max_steer)


@inner_kernel
def accelerate_by_error(
    law: SpeedLaw, speed: PidMemory, train: PedalMap, now: EgoState, off: Deviation
) -> float:
    """Acceleration to command, m/s2."""
    error = -off.speed
    rate = 0.0 if isnan(speed.error) else (error - speed.error) / law.period
    speed.error = error
    wanted = law.kp * error + law.ki * speed.integral + law.kd * rate  # (6)
    return limited(wanted, error, speed, train, now.v, law.period)
