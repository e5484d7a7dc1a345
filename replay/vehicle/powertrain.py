"""Pedals to acceleration: a drive limited by grip and power, brakes, drag, rolling resistance.

With throttle p and brake q as the actuators have them, 0 to 1:

(1) dp/dt = (p_command - p) / throttle_lag         dq/dt = (q_command - q) / brake_lag
(2) drive  = p min(max_accel, max_power / v)
(3) resist = rolling + q max_decel                 friction: opposes motion, never causes it
(4) dv/dt  = drive - resist - drag v^2             while rolling (v > 0, or drive > resist)
    dv/dt  = 0                                     at standstill, held by friction: no creep, no reversing
"""

from __future__ import annotations

from dataclasses import dataclass

from logs.kernel import kernel
from logs.vehicle import VehicleParameters

Limits = tuple[float, float, float, float, float]
"""max_accel, max_power, max_decel, drag, rolling of VehicleParameters: what the kernels take."""


@kernel
def drive_force(v: float, throttle: float, limits: Limits) -> float:
    """Acceleration by the drive (2), m/s2."""
    return throttle * min(limits[0], limits[1] / max(abs(v), 1e-3))


@kernel
def friction_force(brake: float, limits: Limits) -> float:
    """Deceleration that brakes and rolling can give (3), m/s2."""
    return limits[4] + brake * limits[2]


@kernel
def is_rolling(v: float, throttle: float, brake: float, limits: Limits) -> bool:
    """Whether the vehicle moves or is about to (4)."""
    return v > 0.0 or drive_force(0.0, throttle, limits) > friction_force(brake, limits)


@kernel
def rolling_acceleration(v: float, throttle: float, brake: float, limits: Limits) -> float:
    """dv/dt while rolling (4), m/s2."""
    return drive_force(v, throttle, limits) - friction_force(brake, limits) - limits[3] * v * abs(v)


@dataclass(frozen=True)
class PedalPowertrain:
    """The powertrain of `VehicleParameters` in steady state (2)-(4); see `replay.vehicle.base.Powertrain`."""

    parameters: VehicleParameters

    @property
    def limits(self) -> Limits:
        """What the kernels of this module take."""
        p = self.parameters
        return float(p.max_accel), float(p.max_power), float(p.max_decel), float(p.drag), float(p.rolling)

    @property
    def throttle_lag(self) -> float:
        """S."""
        return self.parameters.throttle_lag

    @property
    def brake_lag(self) -> float:
        """S."""
        return self.parameters.brake_lag

    @property
    def brake_delay(self) -> float:
        """S; this model's brake has none."""
        return 0.0

    def coasting(self, v: float) -> float:
        """Acceleration without pedals, m/s2."""
        return -(self.parameters.rolling + self.parameters.drag * v * abs(v))

    def full_throttle(self, v: float) -> float:
        """What full throttle adds, m/s2."""
        return min(self.parameters.max_accel, self.parameters.max_power / max(abs(v), 1e-3))

    def full_brake(self, v: float) -> float:
        """What full brake takes, m/s2."""
        return self.parameters.max_decel
