"""Pedals to acceleration: the map in steady state that a controller inverts, and the powertrain of
simple vehicles.

In steady state:

(1) coasting(v)      = -(rolling + drag v |v| + overrun(v))
(2) full_throttle(v) = min(max_accel, max_power / |v|),
        or where a motor is described most(v) + overrun(v)
(3) full_brake(v)    = max_decel

A powertrain limited by grip and power, with brakes, drag and rolling resistance; throttle p and
brake q as the actuators have them, 0 to 1:

(4) dp/dt = (p_command - p) / throttle_lag         dq/dt = (q_command - q) / brake_lag
(5) drive  = p min(max_accel, max_power / v)
(6) resist = rolling + q max_decel                 friction: opposes motion, never causes it
(7) dv/dt  = drive - resist - drag v^2             while rolling (v > 0, or drive > resist)
    dv/dt  = 0
        at standstill, held by friction: no creep, no reversing
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from replan.core.arrays import FloatArray, frozen
from replan.core.kernel import inner_kernel, kernel
from replan.logs.vehicle import VehicleParameters

SPEED_STEP_MPS = 0.25
NO_MOTOR = frozen(np.empty(0))


class PedalMap(NamedTuple):
    """The parameters of (1)-(3), and lags and dead time of the pedals.

    Attributes:
        max_accel: m/s2.
        max_power: W/kg.
        max_decel: m/s2.
        rolling: m/s2.
        drag: 1/m.
        most: `(n,)` the motor's greatest force over speed 0, SPEED_STEP_MPS, ... in its best gear,
            m/s2; empty: (2).
        overrun: `(n,)` m/s2 at the same speeds.
        throttle_lag: s.
        brake_lag: s.
        brake_delay: Dead time before the lag, s.
    """

    max_accel: float
    max_power: float
    max_decel: float
    rolling: float
    drag: float
    most: FloatArray
    overrun: FloatArray
    throttle_lag: float
    brake_lag: float
    brake_delay: float


def pedal_map(
    p: VehicleParameters, most: FloatArray, overrun: FloatArray, brake_delay: float
) -> PedalMap:
    """The map of a vehicle's parameters, with its motor's tables."""
    return PedalMap(
        float(p.max_accel),
        float(p.max_power),
        float(p.max_decel),
        float(p.rolling),
        float(p.drag),
        most,
        overrun,
        float(p.throttle_lag),
        float(p.brake_lag),
        float(brake_delay),
    )


@kernel
def at_speed(table: FloatArray, v: float) -> float:
    """Return a table's value at |v|, m/s, interpolated linearly, constant beyond its end."""
    place = min(abs(v) / SPEED_STEP_MPS, len(table) - 1.0)
    i = min(int(place), len(table) - 2)
    return table[i] + (place - i) * (table[i + 1] - table[i])


@kernel
def coasting(train: PedalMap, v: float) -> float:
    """Acceleration without pedals, m/s2."""
    resist = train.rolling + train.drag * v * abs(v)
    return -(resist + at_speed(train.overrun, v)) if len(train.overrun) else -resist  # (1)


@kernel
def full_throttle(train: PedalMap, v: float) -> float:
    """What full throttle adds, m/s2."""
    if len(train.most):
        return at_speed(train.most, v) + at_speed(train.overrun, v)
    return min(train.max_accel, train.max_power / max(abs(v), 1e-3))  # (2)


@kernel
def reach(train: PedalMap, v: float) -> tuple[float, float]:
    """Least and greatest acceleration at a speed, m/s2."""
    coast = coasting(train, v)
    return coast - train.max_decel, coast + full_throttle(train, v)  # (3)


Limits = tuple[float, float, float, float, float]
"""max_accel, max_power, max_decel, drag, rolling of VehicleParameters: what the kernels take."""


@kernel
def drive_force(v: float, throttle: float, limits: Limits) -> float:
    """Acceleration by the drive, m/s2."""
    max_accel, max_power, _, _, _ = limits
    return throttle * min(max_accel, max_power / max(abs(v), 1e-3))  # (5)


@inner_kernel
def friction_force(brake: float, limits: Limits) -> float:
    """Deceleration that brakes and rolling can give, m/s2."""
    _, _, max_decel, _, rolling = limits
    return rolling + brake * max_decel  # (6)


@inner_kernel
def is_rolling(v: float, throttle: float, brake: float, limits: Limits) -> bool:
    """Whether the vehicle moves or is about to (7)."""
    return v > 0.0 or drive_force(0.0, throttle, limits) > friction_force(brake, limits)


@inner_kernel
def rolling_acceleration(v: float, throttle: float, brake: float, limits: Limits) -> float:
    """dv/dt while rolling, m/s2."""
    _, _, _, drag, _ = limits
    # (7)
    return drive_force(v, throttle, limits) - friction_force(brake, limits) - drag * v * abs(v)


@dataclass(frozen=True)
class PedalPowertrain:
    """The powertrain of `VehicleParameters` in steady state (5)-(7).

    See `replan.replay.vehicle.base.Powertrain`.
    """

    parameters: VehicleParameters

    @property
    def limits(self) -> Limits:
        """What the kernels of this module take."""
        p = self.parameters
        return (
            float(p.max_accel),
            float(p.max_power),
            float(p.max_decel),
            float(p.drag),
            float(p.rolling),
        )

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
