"""A plan resampled by quintic polynomials, the paper's eq. 16.

Between two samples, in x and in y of their own, tau = (t - t_i) / h:

(1) f(t) = a_0 + a_1 (t - t_i) + ... + a_5 (t - t_i)^5        (the paper prints a_6 for a_5)

matches position, velocity (v cos yaw, v sin yaw) and acceleration (a along, v^2 kappa across) at both samples: it is
C2 there. Heading and speed are those of f'; where it is slower than SLOW_MPS they have no direction, and the headings
of the samples count. Curvature is linear: f'' would give it with the rounding of the positions over h^2.
"""

from __future__ import annotations

from math import atan2, cos, hypot, sin

import numpy as np

from logs.kernel import FloatArray, kernel
from logs.states import Trajectory, wrap

SLOW_MPS = 1.0


@kernel
def quintic(
    p0: float, v0: float, a0: float, p1: float, v1: float, a1: float, h: float, tau: float
) -> tuple[float, float, float]:
    """Value, first and second derivative of (1) at `tau` in [0, 1], from those at both ends of `h` s."""
    v0, a0, v1, a1 = h * v0, h * h * a0, h * v1, h * h * a1
    rise = p1 - p0 - v0 - 0.5 * a0
    slope, bend = v1 - v0 - a0, a1 - a0
    c3 = 10.0 * rise - 4.0 * slope + 0.5 * bend
    c4 = -15.0 * rise + 7.0 * slope - bend
    c5 = 6.0 * rise - 3.0 * slope + 0.5 * bend
    value = p0 + tau * (v0 + tau * (0.5 * a0 + tau * (c3 + tau * (c4 + tau * c5))))
    first = v0 + tau * (a0 + tau * (3.0 * c3 + tau * (4.0 * c4 + tau * 5.0 * c5)))
    second = a0 + tau * (6.0 * c3 + tau * (12.0 * c4 + tau * 20.0 * c5))
    return value, first / h, second / (h * h)


@kernel
def resample(columns: FloatArray, t: FloatArray) -> FloatArray:
    """`(7, m)`: t, x, y, yaw, v, a, kappa at the times t, of a plan's columns `(7, n)`, n > 1, within its span."""
    out = np.empty((7, len(t)))
    i = 0
    for k in range(len(t)):
        while i < columns.shape[1] - 2 and t[k] >= columns[0, i + 1]:
            i += 1
        one, two = columns[:, i], columns[:, i + 1]
        h = two[0] - one[0]
        tau = min(max((t[k] - one[0]) / h, 0.0), 1.0)
        c0, s0, c1, s1 = cos(one[3]), sin(one[3]), cos(two[3]), sin(two[3])
        n0, n1 = one[4] * one[4] * one[6], two[4] * two[4] * two[6]
        x, vx, ax = quintic(
            one[1], one[4] * c0, one[5] * c0 - n0 * s0, two[1], two[4] * c1, two[5] * c1 - n1 * s1, h, tau
        )
        y, vy, ay = quintic(
            one[2], one[4] * s0, one[5] * s0 + n0 * c0, two[2], two[4] * s1, two[5] * s1 + n1 * c1, h, tau
        )
        yaw, v = one[3] + tau * (two[3] - one[3]), one[4] + tau * (two[4] - one[4])
        a = one[5] + tau * (two[5] - one[5])
        if min(one[4], two[4]) > SLOW_MPS:
            yaw, v = yaw + wrap(atan2(vy, vx) - yaw), hypot(vx, vy)
            a = (ax * vx + ay * vy) / max(v, 1e-9)
        out[:, k] = (t[k], x, y, yaw, v, a, one[6] + tau * (two[6] - one[6]))
    return out


def resampled(plan: Trajectory, step: float) -> Trajectory:
    """The plan every `step` s from its first sample on, and its last sample."""
    if len(plan) < 2:
        return plan
    count = int(np.ceil((plan.t[-1] - plan.t[0]) / step - 1e-6))
    t = np.r_[plan.t[0] + step * np.arange(count), plan.t[-1]]
    return Trajectory(*resample(np.stack([plan.t, plan.x, plan.y, plan.yaw, plan.v, plan.a, plan.kappa]), t))
