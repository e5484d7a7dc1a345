"""Pedals to acceleration in steady state, as kernels take it: what a controller inverts.

(1) coasting(v)      = -(rolling + drag v |v| + overrun(v))
(2) full_throttle(v) = min(max_accel, max_power / |v|), or where a motor is described most(v) + overrun(v)
(3) full_brake(v)    = max_decel
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from logs.kernel import FloatArray, frozen, kernel
from logs.vehicle import VehicleParameters

SPEED_STEP_MPS = 0.25
NO_MOTOR = frozen(np.empty(0))


class PedalMap(NamedTuple):
    """The numbers of (1)-(3), and how late each pedal acts.

    Attributes:
        max_accel: m/s2.
        max_power: W/kg.
        max_decel: m/s2.
        rolling: m/s2.
        drag: 1/m.
        most: `(n,)` the motor's greatest force over speed 0, SPEED_STEP_MPS, ... in its best gear, m/s2; empty: (2).
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


def pedal_map(p: VehicleParameters, most: FloatArray, overrun: FloatArray, brake_delay: float) -> PedalMap:
    """The map of a vehicle's parameters, with its motor's tables."""
    return PedalMap(
        float(p.max_accel), float(p.max_power), float(p.max_decel), float(p.rolling), float(p.drag), most, overrun,
        float(p.throttle_lag), float(p.brake_lag), float(brake_delay),
    )  # fmt: skip


@kernel
def at_speed(table: FloatArray, v: float) -> float:
    """A table's value at |v|, m/s, linear; the last holds."""
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
