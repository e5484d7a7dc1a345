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

from logs.states import EgoState
from logs.vehicle import VehicleParameters

GAIN_PER_S = 16.0
PHI_0_RAD = 0.005
SLOWEST_MPS = 2.0
LEAST, MOST = 1.0 / 3.0, 4.0
"""Beyond these it is no tyre: where hardly any force acts, slip that the model does not have passes for compliance."""


class Slip:
    """(1)-(3).

    Attributes:
        front: Compliance of the front axle over that of the parameters; `rear` likewise.
    """

    def __init__(self, parameters: VehicleParameters, period: float) -> None:
        self._p = parameters
        self._period = period
        self._before: tuple[float, float, float, float] | None = None
        self.front = 1.0
        self.rear = 1.0

    @property
    def ratios(self) -> tuple[float, float]:
        """Of front and rear."""
        return self.front, self.rear

    def learn(self, state: EgoState) -> None:
        """Take in the state one period after the last."""
        p, r, v = self._p, state.yaw_rate, state.v
        if v < SLOWEST_MPS:
            self._before = None
            return
        now = (state.v_lat, r, state.steer - (state.v_lat + p.wheelbase * r) / v, -state.v_lat / v)
        before, self._before = self._before, now
        if before is None:
            return
        a, b = p.cog_to_front, p.wheelbase - p.cog_to_front
        side, spin = (now[0] - before[0]) / self._period, (r - before[1]) / self._period
        across = p.mass * a * (side + 0.5 * v * (r + before[1]))
        rear = (across + (a * b * p.mass - p.yaw_inertia) * spin) / p.wheelbase
        front = (p.yaw_inertia * spin + b * rear) / a
        self.front = self._nearer(self.front, front / p.cornering_front, 0.5 * (now[2] + before[2]))
        self.rear = self._nearer(self.rear, rear / p.cornering_rear, 0.5 * (now[3] + before[3]))

    def _nearer(self, ratio: float, phi: float, alpha: float) -> float:
        rate = GAIN_PER_S * phi * (alpha - ratio * phi) / (PHI_0_RAD**2 + phi * phi)
        return min(max(ratio + self._period * rate, LEAST), MOST)
