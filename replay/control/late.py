"""Steering that comes late: how late, learned while driving, and where the ego will be when a command takes effect.

The actuator's model has the wheel angle w under the commands so far. Where they come late by a time d that nobody
stated (a slow bus, a slower actuator), the measured angle is w(t - d):

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

from collections import deque
from math import cos, exp, sin

import numpy as np

from logs.kernel import FloatArray, kernel
from logs.states import EgoState
from logs.vehicle import VehicleParameters
from replay.control.dlqr_kinematic import SHORTEST_LAG_S
from replay.control.exact import at_speed, kappa_rate, steer_for
from replay.control.mpc_model import lateral_table
from replay.control.tracking import Deviation, path_kappa

GAIN_PER_S = 12.0
RATE_0_RADPS = 0.05
OFFSET_S = 2.0
LONGEST_S = 0.3

Lateral = tuple[float, float, float, float]
"""e_d m, v_lat m/s, e_phi rad, r rad/s: each minus that of exact following."""


class LateSteering:
    """(1)-(4); told what is measured (`saw`) and what is commanded (`sent`) once a period each.

    Attributes:
        late: d of (3), s.
    """

    def __init__(self, parameters: VehicleParameters, period: float) -> None:
        self._most = float(parameters.max_steer_rate) * period
        self._share = 1.0 - exp(-period / max(parameters.steer_lag, SHORTEST_LAG_S))
        self._period = period
        self._table = lateral_table(parameters, period)
        self._size = round(LONGEST_S / period) + 2
        self._wheel = deque(self._size * [0.0], self._size)
        self._offset = 0.0
        self._known = False
        self.late = 0.0

    @property
    def steps(self) -> int:
        """Whole periods of `late`."""
        return round(self.late / self._period)

    @property
    def wheel(self) -> float:
        """The wheel angle when all that was commanded has arrived, rad."""
        return self._wheel[0] + self._offset

    def rest(self) -> None:
        """The vehicle is held: what the wheel does until it drives again is not known."""
        self._known = False

    def saw(self, measured: float) -> None:
        """The wheel angle is `measured` now, rad."""
        if not self._known:
            self._known, self._offset = True, 0.0
            self._wheel.extend(self._size * [measured])
            return
        place = self.late / self._period
        i = int(place)
        rate = (self._wheel[i] - self._wheel[i + 1]) / self._period
        error = measured - (self._wheel[i] - (place - i) * self._period * rate) - self._offset
        self._offset += self._period / OFFSET_S * error
        step = GAIN_PER_S * rate * error / (RATE_0_RADPS**2 + rate * rate)
        self.late = min(max(self.late - self._period * step, 0.0), LONGEST_S)

    def sent(self, command: float) -> None:
        """`command` is given for a period, rad."""
        moved = self._share * (command - self._wheel[0])
        after = float(self._wheel[0] + min(max(moved, -self._most), self._most))
        self._wheel.appendleft(after)

    def led(self, y: Lateral, knots: FloatArray, foot: float, v: float, angle: tuple[float, float, float]) -> Lateral:
        """The deviation (4) when a command of now takes effect.

        Args:
            y: Now.
            knots: Of the path.
            foot: Station of the ego's foot point now, m.
            v: Speed, m/s.
            angle: Series of exact following (`exact.following_at`).
        """
        n = self.steps
        if n == 0:
            return y
        coming = np.array(self._wheel)[n::-1] + self._offset
        return led(y, coming, self._table, knots, foot, v, angle, self._period)


def lateral_deviation(state: EgoState, off: Deviation, knots: FloatArray, slip: float) -> Lateral:
    """How far the ego is off exact following of a path now; `slip` is p_0 of `exact.following_at`."""
    v, kappa = state.v, path_kappa(knots, off.foot)
    side = state.v_lat * cos(off.heading) + v * (sin(off.heading) - off.heading)
    turning = v * kappa + slip * kappa_rate(knots, off.foot, v)
    return off.lateral, side + v * slip * kappa, off.heading - slip * kappa, state.yaw_rate - turning


@kernel
def led(
    y: tuple[float, float, float, float], coming: FloatArray, table: FloatArray, knots: FloatArray, foot: float,
    v: float, angle: tuple[float, float, float], h: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    """(4) under the wheel angles `coming` `(n + 1,)`, `h` s apart; `table` from `lateral_table` for `h`."""
    i, u = at_speed(table, v)
    wheel = coming[0] - steer_for(knots, foot, v, angle)
    now, then = np.array(y), np.empty(4)
    for k in range(1, len(coming)):
        after = coming[k] - steer_for(knots, foot + k * h * v, v, angle)
        for row in range(4):
            then[row] = 0.0
            for column in range(6):
                entry = table[i, row, column] + u * (table[i + 1, row, column] - table[i, row, column])
                value = now[column] if column < 4 else wheel if column == 4 else (after - wheel) / h
                then[row] += entry * value
        now[:], wheel = then, after
    return now[0], now[1], now[2], now[3]
