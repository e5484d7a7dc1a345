"""The steering's unknown delay, learned while driving, and where the ego will be when a command takes effect.

The actuator's model gives the wheel angle w under the commands so far. Where commands act late by an unknown time d (a
slow bus, a slower actuator), the measured angle is w(t - d):

(1) w' = clip((command - w) / lag, -max_rate, max_rate)                             exact for a held command
(2) o' = (measured - w(t - d) - o) / OFFSET_S                                       what else the model does not know
(3) d' = -GAIN w'(t - d) (measured - w(t - d) - o) / (RATE_0^2 + w'(t - d)^2)       normalised gradient, from d = 0

Nothing is learned while the wheel rests. Source of (3): Ioannou and Sun, Robust Adaptive Control, 4.3.

A command given now meets the ego as it is d later. Until then the wheel moves as (1) says, whatever is commanded, and
the deviation from exact following of the path (`mpc_model` (2)) with it:

(4) y[k+1] = A y[k] + B (wheel[k], wheel[k+1]) - the same of exact following,  d / period times     a Smith predictor

Only the steering's delay is learned; the pedals' is not.
"""

from __future__ import annotations

from math import cos, exp, sin
from typing import NamedTuple

import numpy as np

from logs.kernel import FloatArray, inner_kernel, kernel
from logs.vehicle import VehicleParameters
from replay.control.feedforward import kappa_rate, steer_for
from replay.control.mpc_model import lateral_table
from replay.control.regulator import SHORTEST_LAG_S, at_speed
from replay.vehicle.base import Motion
from replay.vehicle.plan_path import Deviation, path_kappa

GAIN_PER_S = 12.0
RATE_0_RADPS = 0.05
OFFSET_S = 2.0
LONGEST_S = 0.3

Lateral = tuple[float, float, float, float]
"""e_d m, v_lat m/s, e_phi rad, r rad/s: each minus that of exact following."""


class DelayModel(NamedTuple):
    """The actuator (1) over one period, and the lateral motion (4).

    Attributes:
        most: The most that the wheel turns in a period, rad.
        share: Of the way to the command that it goes in a period.
        period: s.
        table: `mpc_model.lateral_table` for the period.
    """

    most: float
    share: float
    period: float
    table: FloatArray


class DelayState(NamedTuple):
    """What is known of the steering.

    Attributes:
        wheel: `(k,)` w of (1) now, one period ago, ... rad; kernels write into it.
        offset: o of (2), rad.
        delay: d of (3), s.
        known: Whether the wheel's angle is.
    """

    wheel: FloatArray
    offset: float
    delay: float
    known: bool


def delay_model(p: VehicleParameters, period: float) -> DelayModel:
    """The numbers of (1)-(4)."""
    share = 1.0 - exp(-period / max(p.steer_lag, SHORTEST_LAG_S))
    return DelayModel(float(p.max_steer_rate) * period, share, period, lateral_table(p, period))


def nothing_known(period: float) -> DelayState:
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
    """What is known after the wheel angle `measured` now, rad."""
    wheel, h = state.wheel, model.period
    if not state.known:
        wheel[:] = measured
        return DelayState(wheel, 0.0, state.delay, True)
    place = state.delay / h
    i = int(place)
    rate = (wheel[i] - wheel[i + 1]) / h
    error = measured - (wheel[i] - (place - i) * h * rate) - state.offset
    offset = state.offset + h / OFFSET_S * error  # (2)
    step = GAIN_PER_S * rate * error / (RATE_0_RADPS * RATE_0_RADPS + rate * rate)  # (3)
    return DelayState(wheel, offset, min(max(state.delay - h * step, 0.0), LONGEST_S), True)


@kernel
def record(state: DelayState, model: DelayModel, command: float) -> None:
    """`command` is given for a period, rad."""
    wheel = state.wheel
    turned = model.share * (command - wheel[0])
    after = wheel[0] + min(max(turned, -model.most), model.most)  # (1)
    for i in range(len(wheel) - 1, 0, -1):
        wheel[i] = wheel[i - 1]
    wheel[0] = after


@kernel
def lateral_deviation(
    now: Motion, off: Deviation, knots: FloatArray, slip: float
) -> tuple[float, float, float, float]:  # fmt: skip
    """How far the ego is off exact following of a path now; `slip` is p_0 of `feedforward.following_at`."""
    v, kappa = now.v, path_kappa(knots, off.foot)
    side = now.v_lat * cos(off.heading) + v * (sin(off.heading) - off.heading)
    turning = v * kappa + slip * kappa_rate(knots, off.foot, v)
    return off.lateral, side + v * slip * kappa, off.heading - slip * kappa, now.yaw_rate - turning


@kernel
def predicted(
    y: tuple[float, float, float, float], state: DelayState, model: DelayModel, knots: FloatArray, foot: float,
    v: float, angle: tuple[float, float, float],
) -> tuple[float, float, float, float]:  # fmt: skip
    """The deviation when a command of now takes effect.

    Args:
        y: The deviation now.
        state: Of the steering.
        model: Of the steering and the car.
        knots: Of the path.
        foot: Station of the ego's foot point now, m.
        v: Speed, m/s.
        angle: Series of exact following (`feedforward.following_at`).
    """
    n, h, table = periods(state, model), model.period, model.table
    if n == 0:
        return y
    i, u = at_speed(table, v)
    wheel = state.wheel[n] + state.offset - steer_for(knots, foot, v, angle)
    now, then = np.array(y), np.empty(4)
    for k in range(1, n + 1):  # (4)
        after = state.wheel[n - k] + state.offset - steer_for(knots, foot + k * h * v, v, angle)
        for row in range(4):
            then[row] = 0.0
            for column in range(6):
                entry = table[i, row, column] + u * (table[i + 1, row, column] - table[i, row, column])
                value = now[column] if column < 4 else wheel if column == 4 else (after - wheel) / h
                then[row] += entry * value
        now[:], wheel = then, after
    return now[0], now[1], now[2], now[3]


class SteeringDelay:
    """(1)-(4); is given what is measured (`observe`) and what is commanded (`record`) once a period each.

    Attributes:
        model: The numbers.
        state: What is known.
    """

    def __init__(self, parameters: VehicleParameters, period: float) -> None:
        self.model, self.state = delay_model(parameters, period), nothing_known(period)

    @property
    def seconds(self) -> float:
        """D of (3), s."""
        return self.state.delay

    @property
    def wheel(self) -> float:
        """The wheel angle when all that was commanded has arrived, rad."""
        return float(settled_wheel(self.state))

    def rest(self) -> None:
        """The vehicle is held: what the wheel does until it drives again is not known."""
        self.state = self.state._replace(known=False)

    def observe(self, measured: float) -> None:
        """The wheel angle is `measured` now, rad."""
        self.state = observed(self.state, self.model, measured)

    def record(self, command: float) -> None:
        """`command` is given for a period, rad."""
        record(self.state, self.model, command)

    def predict(
        self, y: Lateral, knots: FloatArray, foot: float, v: float, angle: tuple[float, float, float]
    ) -> Lateral:
        """The deviation when a command of now takes effect; arguments as `predicted`."""
        return predicted(y, self.state, self.model, knots, foot, v, angle)
