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
from functools import cached_property

from logs.kernel import inner_kernel, kernel
from logs.vehicle import VehicleParameters
from replay.vehicle.pedal_map import NO_MOTOR, PedalMap, coasting, full_throttle, pedal_map

Limits = tuple[float, float, float, float, float]
"""max_accel, max_power, max_decel, drag, rolling of VehicleParameters: what the kernels take."""


@kernel
def drive_force(v: float, throttle: float, limits: Limits) -> float:
    """Acceleration by the drive, m/s2."""
    return throttle * min(limits[0], limits[1] / max(abs(v), 1e-3))  # (2)


@inner_kernel
def friction_force(brake: float, limits: Limits) -> float:
    """Deceleration that brakes and rolling can give, m/s2."""
    return limits[4] + brake * limits[2]  # (3)


@inner_kernel
def is_rolling(v: float, throttle: float, brake: float, limits: Limits) -> bool:
    """Whether the vehicle moves or is about to (4)."""
    return v > 0.0 or drive_force(0.0, throttle, limits) > friction_force(brake, limits)


@inner_kernel
def rolling_acceleration(v: float, throttle: float, brake: float, limits: Limits) -> float:
    """dv/dt while rolling, m/s2."""
    return drive_force(v, throttle, limits) - friction_force(brake, limits) - limits[3] * v * abs(v)  # (4)


@dataclass(frozen=True)
class PedalPowertrain:
    """The powertrain of `VehicleParameters` in steady state (2)-(4); see `replay.vehicle.base.Powertrain`."""

    parameters: VehicleParameters

    @property
    def limits(self) -> Limits:
        """What the kernels of this module take."""
        p = self.parameters
        return float(p.max_accel), float(p.max_power), float(p.max_decel), float(p.drag), float(p.rolling)

    @cached_property
    def pedal_map(self) -> PedalMap:
        """What controllers' kernels take; this model's brake has no dead time."""
        return pedal_map(self.parameters, NO_MOTOR, NO_MOTOR, 0.0)

    def coasting(self, v: float) -> float:
        """Acceleration without pedals, m/s2."""
        return coasting(self.pedal_map, v)

    def full_throttle(self, v: float) -> float:
        """What full throttle adds, m/s2."""
        return full_throttle(self.pedal_map, v)

    def full_brake(self, v: float) -> float:
        """What full brake takes, m/s2."""
        return self.parameters.max_decel
