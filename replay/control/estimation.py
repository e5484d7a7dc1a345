"""Estimates the slip of the tyres and the delay of the steering while driving.

Slip is the compliance of each axle against that of the parameters. With F the lateral force of an
axle and alpha the slip angle that it shows (`lateral_model` (1)), over one period:

(1) F_r = (a m (v_lat' + v r) + (a b m - I) r') / L,      F_f = (I r' + b F_r) / a
(2) alpha_f = steer - (v_lat + L r) / v,       alpha_r = -v_lat / v
(3) ratio' = GAIN phi (alpha - ratio phi) / (PHI_0^2 + phi^2),   phi = F / C
        normalised gradient, from ratio = 1

So a heavier car, softer or saturated tyres, or another vehicle model cause no steady error and need
no retuning. On a straight there is no slip to learn from, so the ratios do not change. With rigid
tyres phi = 0 and the ratios stay.

The actuator's model gives the wheel angle w under the commands so far. Where commands act late by
an unknown time d (a slow bus, a slower actuator), the measured angle is w(t - d):

(4) w' = clip((command - w) / lag, -max_rate, max_rate)
        exact for a held command
(5) o' = (measured - w(t - d) - o) / OFFSET_S
        other errors of the model
(6) d' = -GAIN w'(t - d) (measured - w(t - d) - o) / (RATE_0^2 + w'(t - d)^2)
        normalised gradient, from d = 0

Nothing is learned while the wheel rests. Only the steering's delay is learned; the pedals' is not.
Source of (3) and (6): Ioannou and Sun, Robust Adaptive Control, 4.3.

A command given now meets the ego as it is d later. Until then the wheel moves as (4) says, whatever
is commanded, and the deviation from exact following of the path (`lateral_table`) with it:

(7) y[k+1] = A y[k] + B (wheel[k], wheel[k+1]) - the same of exact following,  d / period times
        a Smith predictor
"""

from __future__ import annotations

from math import cos, exp, isnan, nan, sin
from typing import NamedTuple

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.kernel import inner_kernel, kernel
from replan.logs.states import EgoState
from replan.logs.vehicle import VehicleParameters
from replan.replay.control.lateral_model import (
    SteerSeries,
    at_speed,
    kappa_rate,
    lateral_table,
    steer_for,
)
from replan.replay.vehicle.drivetrain import SHORTEST_LAG_S
from replan.replay.vehicle.plan_path import Deviation, path_kappa
from replan.replay.vehicle.state_records import new_record

SLIP_GAIN_PER_S = 16.0
PHI_0_RAD = 0.005
SLOWEST_MPS = 2.0
LEAST, MOST = 1.0 / 3.0, 4.0
"""Bounds of plausible ratios: at small forces, slip that is not modelled looks like compliance."""
DELAY_GAIN_PER_S = 12.0
RATE_0_RADPS = 0.05
OFFSET_S = 2.0
LONGEST_S = 0.3

Lateral = tuple[float, float, float, float]
"""e_d m, v_lat m/s, e_phi rad, r rad/s: each minus that of exact following."""
E_D, V_LAT, E_PHI, R = range(4)
"""Places of `Lateral`."""


class SlipModel(NamedTuple):
    """m, I, a, b, L of (1)-(3), the stiffness of both axles, and the period between two states."""

    mass: float
    inertia: float
    a: float
    b: float
    wheelbase: float
    front: float
    rear: float
    period: float


class SlipMemory:
    """The ratios of both axles, and v_lat, r, alpha_f, alpha_r of the previous period, NaN if there
    is none. A record.
    """

    front: float = 1.0
    rear: float = 1.0
    v_lat: float = nan
    turn: float = nan
    alpha_front: float = nan
    alpha_rear: float = nan


def slip_model(p: VehicleParameters, period: float) -> SlipModel:
    """The numbers of (1)-(3)."""
    a, b = p.cog_to_front, p.wheelbase - p.cog_to_front
    stiffness = float(p.cornering_front), float(p.cornering_rear)
    return SlipModel(
        float(p.mass),
        float(p.yaw_inertia),
        float(a),
        float(b),
        float(p.wheelbase),
        *stiffness,
        period,
    )


@kernel
def learn(slip: SlipMemory, car: SlipModel, now: EgoState) -> None:
    """Take in the motion of one more period."""
    r, v = now.yaw_rate, now.v
    if v < SLOWEST_MPS:
        slip.v_lat = slip.turn = slip.alpha_front = slip.alpha_rear = nan
        return
    alpha_front, alpha_rear = now.steer - (now.v_lat + car.wheelbase * r) / v, -now.v_lat / v  # (2)
    if not isnan(slip.v_lat):
        side, spin = (now.v_lat - slip.v_lat) / car.period, (r - slip.turn) / car.period
        across = car.mass * car.a * (side + 0.5 * v * (r + slip.turn))
        rear = (across + (car.a * car.b * car.mass - car.inertia) * spin) / car.wheelbase  # (1)
        front = (car.inertia * spin + car.b * rear) / car.a
        mean_front = 0.5 * (alpha_front + slip.alpha_front)
        mean_rear = 0.5 * (alpha_rear + slip.alpha_rear)
        slip.front = nearer(slip.front, front / car.front, mean_front, car.period)
        slip.rear = nearer(slip.rear, rear / car.rear, mean_rear, car.period)
    slip.v_lat, slip.turn = now.v_lat, r
    slip.alpha_front, slip.alpha_rear = alpha_front, alpha_rear


@inner_kernel
def nearer(ratio: float, phi: float, alpha: float, period: float) -> float:
    """The ratio after one period."""
    # (3)
    rate = SLIP_GAIN_PER_S * phi * (alpha - ratio * phi) / (PHI_0_RAD * PHI_0_RAD + phi * phi)
    return min(max(ratio + period * rate, LEAST), MOST)


class DelayModel(NamedTuple):
    """The actuator (4) over one period, and the lateral motion (7).

    Attributes:
        most: The most that the wheel turns in a period, rad.
        share: Share of the way to the command that it moves in a period.
        period: s.
        table: `lateral_table` for the period.
    """

    most: float
    share: float
    period: float
    table: FloatArray


class DelayMemory:
    """What is known of the steering; a record.

    Beside it goes `wheel` `(k,)`: w of (4) now, one period ago, ... rad; kernels write into it.

    Attributes:
        offset: o of (5), rad.
        delay: d of (6), s.
        known: Whether the wheel's angle is known.
    """

    offset: float = 0.0
    delay: float = 0.0
    known: bool = False


def delay_model(p: VehicleParameters, period: float) -> DelayModel:
    """The numbers of (4)-(7)."""
    share = 1.0 - exp(-period / max(p.steer_lag, SHORTEST_LAG_S))
    return DelayModel(float(p.max_steer_rate) * period, share, period, lateral_table(p, period))


def straight_wheel(period: float) -> FloatArray:
    """Wheel angles of a past without steering, as long as a delay may be."""
    return np.zeros(round(LONGEST_S / period) + 2)


@inner_kernel
def periods(delay: DelayMemory, model: DelayModel) -> int:
    """Whole periods of the delay."""
    return round(delay.delay / model.period)


@kernel
def settled_wheel(delay: DelayMemory, wheel: FloatArray) -> float:
    """The wheel angle when all that was commanded has arrived, rad."""
    return wheel[0] + delay.offset


@kernel
def observe(delay: DelayMemory, wheel: FloatArray, model: DelayModel, measured: float) -> None:
    """Take in the wheel angle `measured` now, rad."""
    if not delay.known:
        wheel[:] = measured
        delay.offset, delay.known = 0.0, True
        return
    h = model.period
    place = delay.delay / h
    i = int(place)
    rate = (wheel[i] - wheel[i + 1]) / h
    error = measured - (wheel[i] - (place - i) * h * rate) - delay.offset
    delay.offset = delay.offset + h / OFFSET_S * error  # (5)
    step = DELAY_GAIN_PER_S * rate * error / (RATE_0_RADPS * RATE_0_RADPS + rate * rate)  # (6)
    delay.delay = min(max(delay.delay - h * step, 0.0), LONGEST_S)


@kernel
def record(wheel: FloatArray, model: DelayModel, command: float) -> None:
    """Take in `command`, which holds for a period, rad."""
    turned = model.share * (command - wheel[0])
    after = wheel[0] + min(max(turned, -model.most), model.most)  # (4)
    for i in range(len(wheel) - 1, 0, -1):
        wheel[i] = wheel[i - 1]
    wheel[0] = after


@kernel
def lateral_deviation(now: EgoState, off: Deviation, knots: FloatArray, slip: float) -> Lateral:
    """How far the ego is off exact following of a path now; `slip` is p_0 of `following_at`."""
    v, kappa = now.v, path_kappa(knots, off.foot)
    side = now.v_lat * cos(off.heading) + v * (sin(off.heading) - off.heading)
    turning = v * kappa + slip * kappa_rate(knots, off.foot, v)
    return off.lateral, side + v * slip * kappa, off.heading - slip * kappa, now.yaw_rate - turning


@kernel
def predicted(
    y: Lateral,
    delay: DelayMemory,
    wheel: FloatArray,
    model: DelayModel,
    knots: FloatArray,
    foot: float,
    v: float,
    angle: SteerSeries,
) -> Lateral:
    """Return the deviation when a present command takes effect.

    `y` is the deviation now; `foot` the station of the ego's foot point, m; `v` its speed, m/s;
    `angle` the series of exact following (`following_at`).
    """
    n, h, table = periods(delay, model), model.period, model.table
    if n == 0:
        return y
    i, u = at_speed(table, v)
    steer = wheel[n] + delay.offset - steer_for(knots, foot, v, angle)
    now, then = np.array(y), np.empty(4)
    for k in range(1, n + 1):  # (7)
        after = wheel[n - k] + delay.offset - steer_for(knots, foot + k * h * v, v, angle)
        inputs = steer, (after - steer) / h
        for row in range(4):
            then[row] = 0.0
            for column in range(6):
                entry = table[i, row, column] + u * (
                    table[i + 1, row, column] - table[i, row, column]
                )
                then[row] += entry * (now[column] if column < 4 else inputs[column - 4])
        now[:], steer = then, after
    return now[E_D], now[V_LAT], now[E_PHI], now[R]


class SteeringDelay:
    """Estimates the delay (4)-(7) from the measured (`observe`) and commanded (`record`) wheel
    angle, once per period.

    Attributes:
        model: The parameters.
        delay: The present estimate, a record.
        wheel: The wheel angles of the model, as in `DelayMemory`.
    """

    def __init__(self, parameters: VehicleParameters, period: float) -> None:
        self.model = delay_model(parameters, period)
        self.delay, self.wheel = new_record(DelayMemory), straight_wheel(period)

    @property
    def seconds(self) -> float:
        """The delay d of (6), s."""
        return float(self.delay.delay)

    @property
    def settled(self) -> float:
        """The wheel angle when all that was commanded has arrived, rad."""
        return float(settled_wheel(self.delay, self.wheel))

    def rest(self) -> None:
        """Note that the vehicle is held: the wheel angle is not known until it drives again."""
        self.delay.known = False

    def observe(self, measured: float) -> None:
        """Take in the wheel angle `measured` now, rad."""
        observe(self.delay, self.wheel, self.model, measured)

    def record(self, command: float) -> None:
        """Take in `command`, which holds for a period, rad."""
        record(self.wheel, self.model, command)

    def predict(
        self, y: Lateral, knots: FloatArray, foot: float, v: float, angle: SteerSeries
    ) -> Lateral:
        """Return the deviation when a present command takes effect; arguments as `predicted`."""
        return predicted(y, self.delay, self.wheel, self.model, knots, foot, v, angle)
