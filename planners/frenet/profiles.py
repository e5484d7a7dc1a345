"""Speed profiles along a path: the limit with its curves, driving at it, and braking.

(1) v(sigma) = min(limit, sqrt(a_lat / |kappa|)), lowered so that it can be reached with a comfortable deceleration b:
    v(sigma)^2 <= v(sigma + d)^2 + 2 b d
(2) cruising: the speed follows (1) with bounded acceleration and jerk, with no other road user in the way
(3) braking: jerk-limited to a deceleration, held, and released before standstill:  b^2 <= 2 jerk v
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import sqrt
from typing import NamedTuple

import numpy as np

from logs.arrays import FloatArray
from logs.kernel import kernel

STEP_S = 0.1  # Time between two knots of a speed profile, and between two samples of a plan, s


class KnotLimits(NamedTuple):
    """`SpeedLimits` in the form that kernels take: m/s2, m/s3."""

    accel: float
    decel: float
    jerk: float


@dataclass(frozen=True)
class SpeedLimits:
    """Acceleration and jerk that a profile may use.

    Attributes:
        accel_mps2: Greatest acceleration.
        decel_mps2: Greatest deceleration, positive.
        jerk_mps3: Greatest jerk, in both directions.
    """

    accel_mps2: float
    decel_mps2: float
    jerk_mps3: float

    @cached_property
    def columns(self) -> KnotLimits:
        """The limits in the form that kernels take."""
        return KnotLimits(self.accel_mps2, self.decel_mps2, self.jerk_mps3)

    def braking(self, start: tuple[float, float], knots: int, *, share: float = 1.0) -> FloatArray:
        """Rows s, v, a `(3, knots)` of braking with a share of these limits."""
        return braking(start[0], start[1], share * self.decel_mps2, share * self.jerk_mps3, STEP_S, knots)


COMFORT = SpeedLimits(1.8, 3.0, 3.0)  # Limits of a comfortable profile
EMERGENCY = SpeedLimits(1.8, 7.5, 15.0)  # Limits of a profile that must brake harder
HORIZON_STEPS = 80  # Steps of a plan: 8 s
HORIZON_KNOTS = HORIZON_STEPS + 1  # Knots of a profile


@kernel
def limit_profile(
    sigma: FloatArray, kappa: FloatArray, limit: FloatArray, curve_accel: float, ease: float
) -> FloatArray:
    """The speed limit (1) along a path `(m,)`."""
    out = np.empty(len(sigma))
    for i in range(len(sigma) - 1, -1, -1):
        out[i] = min(limit[i], sqrt(curve_accel / max(abs(kappa[i]), 1e-9)))  # (1)
        if i < len(sigma) - 1:
            out[i] = min(out[i], sqrt(out[i + 1] ** 2 + 2.0 * ease * (sigma[i + 1] - sigma[i])))
    return out


@kernel
def braking(v0: float, a0: float, decel: float, jerk: float, step: float, knots: int) -> FloatArray:
    """Rows s, v, a `(3, knots)` of braking to a stop: jerk-limited to `-decel`, then held, then standing.

    The stop itself is eased: the next deceleration b is not more than the jerk can release before standstill,
    b^2 <= 2 jerk v' with the speed v' = v + step (a - b) / 2 that it leaves.
    """
    out = np.zeros((3, knots))
    s, v, a, half = 0.0, v0, a0, 0.5 * jerk * step
    for i in range(knots):
        out[0, i], out[1, i], out[2, i] = s, v, a
        wanted = -min(decel, sqrt(half * half + 2.0 * jerk * max(v + 0.5 * step * a, 0.0)) - half)  # (3)
        a_next = max(wanted, a - jerk * step) if wanted < a else min(wanted, a + jerk * step)
        v_next = v + 0.5 * step * (a + a_next)
        if v_next <= 1e-6:
            s += min(v * v / max(-(a + a_next), 1e-6), v * step) if v > 0.0 else 0.0
            v, a = 0.0, 0.0
            continue
        s += step * v + step * step * (a / 3.0 + a_next / 6.0)
        v, a = v_next, a_next
    return out


@kernel
def cruising(
    sigma: FloatArray, limit: FloatArray, v0: float, a0: float, accel: float, decel: float, jerk: float,
    step: float, knots: int,
) -> FloatArray:  # fmt: skip
    """Rows s, v `(2, knots)` of driving at the limit `(m,)` along the path, on a free road."""
    out = np.zeros((2, knots))
    s, v, a, i = 0.0, v0, a0, 0
    for k in range(knots):
        out[0, k], out[1, k] = s, v
        while i < len(sigma) - 2 and sigma[i + 1] < s:
            i += 1
        falling = min(0.0, v * (limit[i + 1] - limit[i]) / (sigma[i + 1] - sigma[i]))
        wanted = min(max(falling + (limit[i] - v) / 0.6, -decel), accel)  # (2)
        a += min(max(wanted - a, -jerk * step), jerk * step)
        v_next = max(0.0, v + a * step)
        s += 0.5 * step * (v + v_next)
        v = v_next
    return out
