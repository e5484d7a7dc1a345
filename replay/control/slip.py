"""How much the tyres slip, learned while driving: the compliance of each axle against that of the parameters.

With F the lateral force of an axle and alpha the slip angle that it shows (`lateral_model` (1)), over one period:

(1) F_r = (a m (v_lat' + v r) + (a b m - I) r') / L,      F_f = (I r' + b F_r) / a
(2) alpha_f = steer - (v_lat + L r) / v,       alpha_r = -v_lat / v
(3) ratio' = GAIN phi (alpha - ratio phi) / (PHI_0^2 + phi^2),   phi = F / C        normalised gradient, from ratio = 1

So a heavier car, softer or saturated tyres, or another model of the car cost no steady error and need no other tuning.
Nothing is learned on a straight, where there is nothing to learn from. Source of (3): Ioannou and Sun, Robust Adaptive
Control, 4.3. With rigid tyres phi = 0 and the ratios stay.
"""

from __future__ import annotations

from math import isnan, nan
from typing import NamedTuple

from logs.kernel import inner_kernel, kernel
from logs.states import EgoState
from logs.vehicle import VehicleParameters
from replay.vehicle.base import Motion, motion_of

GAIN_PER_S = 16.0
PHI_0_RAD = 0.005
SLOWEST_MPS = 2.0
LEAST, MOST = 1.0 / 3.0, 4.0
"""Beyond these it is no tyre: where hardly any force acts, slip that the model does not have passes for compliance."""


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
    """The ratios of both axles; what was seen a period ago: v_lat, r, alpha_f, alpha_r, NaN where nothing was."""

    front: float
    rear: float
    v_lat: float
    turn: float
    alpha_front: float
    alpha_rear: float


NOTHING_LEARNED = SlipState(1.0, 1.0, nan, nan, nan, nan)


def slip_model(p: VehicleParameters, period: float) -> SlipModel:
    """The numbers of (1)-(3)."""
    a, b = p.cog_to_front, p.wheelbase - p.cog_to_front
    stiffness = float(p.cornering_front), float(p.cornering_rear)
    return SlipModel(float(p.mass), float(p.yaw_inertia), float(a), float(b), float(p.wheelbase), *stiffness, period)


@kernel
def learned(state: SlipState, car: SlipModel, now: Motion) -> SlipState:
    """What is known after the motion one period after the last."""
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
        now.v_lat, r, alpha_front, alpha_rear,
    )  # fmt: skip


@inner_kernel
def nearer(ratio: float, phi: float, alpha: float, period: float) -> float:
    """The ratio after one period."""
    rate = GAIN_PER_S * phi * (alpha - ratio * phi) / (PHI_0_RAD * PHI_0_RAD + phi * phi)  # (3)
    return min(max(ratio + period * rate, LEAST), MOST)


class Slip:
    """(1)-(3); remembers the ratios."""

    def __init__(self, parameters: VehicleParameters, period: float) -> None:
        self._model, self._state = slip_model(parameters, period), NOTHING_LEARNED

    @property
    def ratios(self) -> tuple[float, float]:
        """Compliance of front and rear axle over that of the parameters."""
        return self._state.front, self._state.rear

    def learn(self, state: EgoState) -> None:
        """Take in the state one period after the last."""
        self._state = learned(self._state, self._model, motion_of(state))
