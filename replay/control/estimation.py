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
from replan.logs.vehicle import VehicleParameters
from replan.replay.control.lateral_model import (
    SteerSeries,
    at_speed,
    kappa_rate,
    lateral_table,
    steer_for,
)
from replan.replay.vehicle.base import MotionState
from replan.replay.vehicle.drivetrain import SHORTEST_LAG_S
from replan.replay.vehicle.plan_path import Deviation, path_kappa

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


class SlipState(NamedTuple):
    """The ratios of both axles.

    Values of the previous period: v_lat, r, alpha_f, alpha_r, NaN if there are none.
    """

    front: float
    rear: float
    v_lat: float
    turn: float
    alpha_front: float
    alpha_rear: float


NO_SLIP = SlipState(1.0, 1.0, nan, nan, nan, nan)


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
def learned(state: SlipState, car: SlipModel, now: MotionState) -> SlipState:
    """The state after the motion of one more period."""
    r, v = now.yaw_rate, now.v
    if v < SLOWEST_MPS:
        return SlipState(state.front, state.rear, nan, nan, nan, nan)
    alpha_front, alpha_rear = now.steer - (now.v_lat + car.wheelbase * r) / v, -now.v_lat / v  # (2)
    if isnan(state.v_lat):
        return SlipState(state.front, state.rear, now.v_lat, r, alpha_front, alpha_rear)
    side, spin = (now.v_lat - state.v_lat) / car.period, (r - state.turn) / car.period
    across = car.mass * car.a * (side + 0.5 * v * (r + state.turn))
    rear = (across + (car.a * car.b * car.mass - car.inertia) * spin) / car.wheelbase  # (1)
    front = (car.inertia * spin + car.b * rear) / car.a
    return SlipState(
        nearer(state.front, front / car.front, 0.5 * (alpha_front + state.alpha_front), car.period),
        nearer(state.rear, rear / car.rear, 0.5 * (alpha_rear + state.alpha_rear), car.period),
        now.v_lat,
        r,
        alpha_front,
        alpha_rear,
    )


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


class DelayState(NamedTuple):
    """The estimated state of the steering.

    Attributes:
        wheel: `(k,)` w of (4) now, one period ago, ... rad; kernels write into it.
        offset: o of (5), rad.
        delay: d of (6), s.
        known: Whether the wheel's angle is known.
    """

    wheel: FloatArray
    offset: float
    delay: float
    known: bool


def delay_model(p: VehicleParameters, period: float) -> DelayModel:
    """The numbers of (4)-(7)."""
    share = 1.0 - exp(-period / max(p.steer_lag, SHORTEST_LAG_S))
    return DelayModel(float(p.max_steer_rate) * period, share, period, lateral_table(p, period))


def no_delay(period: float) -> DelayState:
    """No delay, until one is learned."""
    return DelayState(np.zeros(round(LONGEST_S / period) + 2), 0.0, 0.0, False)


@inner_kernel
def periods(state: DelayState, model: DelayModel) -> int:
    """Whole periods of the delay."""
    return round(state.delay / model.period)


@kernel
def settled_wheel(state: DelayState) -> float:
    """The wheel angle when all that was commanded has arrived, rad."""
    return state.wheel[0] + state.offset


@kernel
def observed(state: DelayState, model: DelayModel, measured: float) -> DelayState:
    """The state after the wheel angle `measured` is observed, rad."""
    wheel, h = state.wheel, model.period
    if not state.known:
        wheel[:] = measured
        return DelayState(wheel, 0.0, state.delay, True)
    place = state.delay / h
    i = int(place)
    rate = (wheel[i] - wheel[i + 1]) / h
    error = measured - (wheel[i] - (place - i) * h * rate) - state.offset
    offset = state.offset + h / OFFSET_S * error  # (5)
    step = DELAY_GAIN_PER_S * rate * error / (RATE_0_RADPS * RATE_0_RADPS + rate * rate)  # (6)
    return DelayState(wheel, offset, min(max(state.delay - h * step, 0.0), LONGEST_S), True)


@kernel
def record(state: DelayState, model: DelayModel, command: float) -> None:
    """Take in `command`, which holds for a period, rad."""
    wheel = state.wheel
    turned = model.share * (command - wheel[0])
    after = wheel[0] + min(max(turned, -model.most), model.most)  # (4)
    for i in range(len(wheel) - 1, 0, -1):
        wheel[i] = wheel[i - 1]
    wheel[0] = after


@kernel
def lateral_deviation(now: MotionState, off: Deviation, knots: FloatArray, slip: float) -> Lateral:
    """How far the ego is off exact following of a path now; `slip` is p_0 of `following_at`."""
    v, kappa = now.v, path_kappa(knots, off.foot)
    side = now.v_lat * cos(off.heading) + v * (sin(off.heading) - off.heading)
    turning = v * kappa + slip * kappa_rate(knots, off.foot, v)
    return off.lateral, side + v * slip * kappa, off.heading - slip * kappa, now.yaw_rate - turning


@kernel
def predicted(
    y: Lateral,
    state: DelayState,
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
    n, h, table = periods(state, model), model.period, model.table
    if n == 0:
        return y
    i, u = at_speed(table, v)
    wheel = state.wheel[n] + state.offset - steer_for(knots, foot, v, angle)
    now, then = np.array(y), np.empty(4)
    for k in range(1, n + 1):  # (7)
        after = state.wheel[n - k] + state.offset - steer_for(knots, foot + k * h * v, v, angle)
        for row in range(4):
            then[row] = 0.0
            for column in range(6):
                entry = table[i, row, column] + u * (
                    table[i + 1, row, column] - table[i, row, column]
                )
                value = now[column] if column < 4 else wheel if column == 4 else (after - wheel) / h
                then[row] += entry * value
        now[:], wheel = then, after
    return now[0], now[1], now[2], now[3]


class SteeringDelay:
    """Estimates the delay (4)-(7) from the measured (`observe`) and commanded (`record`) wheel
    angle, once per period.

    Attributes:
        model: The parameters.
        state: The present estimate.
    """

    def __init__(self, parameters: VehicleParameters, period: float) -> None:
        self.model, self.state = delay_model(parameters, period), no_delay(period)

    @property
    def seconds(self) -> float:
        """The delay d of (6), s."""
        return self.state.delay

    @property
    def wheel(self) -> float:
        """The wheel angle when all that was commanded has arrived, rad."""
        return float(settled_wheel(self.state))

    def rest(self) -> None:
        """Note that the vehicle is held: the wheel angle is not known until it drives again."""
        self.state = self.state._replace(known=False)

    def observe(self, measured: float) -> None:
        """Take in the wheel angle `measured` now, rad."""
        self.state = observed(self.state, self.model, measured)

    def record(self, command: float) -> None:
        """Take in `command`, which holds for a period, rad."""
        record(self.state, self.model, command)

    def predict(
        self, y: Lateral, knots: FloatArray, foot: float, v: float, angle: SteerSeries
    ) -> Lateral:
        """Return the deviation when a present command takes effect; arguments as `predicted`."""
        return predicted(y, self.state, self.model, knots, foot, v, angle)
