"""A plan resampled by quintic polynomials, the paper's eq. 16.

Between two samples of the plan, x and y are one polynomial each,

(1) f(t) = a_0 + a_1 (t - t_i) + ... + a_5 (t - t_i)^5        (the paper prints a_6 for a_5)

It matches position, velocity (v cos yaw, v sin yaw) and acceleration (a along the heading,
v^2 kappa across it) at both samples, so that the path is C2 there. Heading and speed are those of
f'; below `SLOW_MPS` f' has no direction, and the headings of the samples are used. Curvature is
linear: f'' would give it with the rounding of the positions over h^2.
"""

from __future__ import annotations

from math import atan2, cos, hypot, sin

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.kernel import kernel
from replan.logs.states import Trajectory, wrap

SLOW_MPS = 1.0
"""Between slower samples, heading and speed are linear, m/s."""
LEAST_SPEED_MPS = 1e-9
"""An acceleration along f' is divided by this speed at least, m/s."""
ROUNDING_STEPS = 1e-6
"""A last step of a smaller share is rounding, and is not taken."""


@kernel
def quintic(
    p0: float, v0: float, a0: float, p1: float, v1: float, a1: float, h: float, tau: float
) -> tuple[float, float, float]:
    """Value, first and second derivative of (1) at `tau` in [0, 1], from those at both ends of `h`
    s.
    """
    v0, a0 = h * v0, h * h * a0
    v1, a1 = h * v1, h * h * a1
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
def derivatives(yaw: float, v: float, a: float, kappa: float) -> tuple[float, float, float, float]:
    """Velocity and acceleration in the world: x', y', x'', y''."""
    c, s, across = cos(yaw), sin(yaw), v * v * kappa
    return v * c, v * s, a * c - across * s, a * s + across * c


@kernel
def resampled_columns(
    wanted: FloatArray,
    t: FloatArray,
    x: FloatArray,
    y: FloatArray,
    yaw: FloatArray,
    v: FloatArray,
    a: FloatArray,
    kappa: FloatArray,
) -> FloatArray:
    """`(7, m)`: t, x, y, yaw, v, a, kappa at the `wanted` times `(m,)`, of a plan's columns `(n,)`,
    n > 1, within its span.
    """
    columns = np.empty((7, len(wanted)))
    i = 0
    for k in range(len(wanted)):
        while i < len(t) - 2 and wanted[k] >= t[i + 1]:
            i += 1
        j = i + 1
        h = t[j] - t[i]
        tau = min(max((wanted[k] - t[i]) / h, 0.0), 1.0)
        vx0, vy0, ax0, ay0 = derivatives(yaw[i], v[i], a[i], kappa[i])
        vx1, vy1, ax1, ay1 = derivatives(yaw[j], v[j], a[j], kappa[j])
        px, vx, ax = quintic(x[i], vx0, ax0, x[j], vx1, ax1, h, tau)
        py, vy, ay = quintic(y[i], vy0, ay0, y[j], vy1, ay1, h, tau)
        heading, speed = yaw[i] + tau * (yaw[j] - yaw[i]), v[i] + tau * (v[j] - v[i])
        acceleration = a[i] + tau * (a[j] - a[i])
        if min(v[i], v[j]) > SLOW_MPS:
            heading, speed = heading + wrap(atan2(vy, vx) - heading), hypot(vx, vy)
            acceleration = (ax * vx + ay * vy) / max(speed, LEAST_SPEED_MPS)
        bend = kappa[i] + tau * (kappa[j] - kappa[i])
        columns[:, k] = (wanted[k], px, py, heading, speed, acceleration, bend)
    return columns


def resampled(plan: Trajectory, step: float) -> Trajectory:
    """The plan every `step` s from its first sample on, and its last sample."""
    if len(plan) < 2:
        return plan
    count = int(np.ceil((plan.t[-1] - plan.t[0]) / step - ROUNDING_STEPS))
    wanted = np.r_[plan.t[0] + step * np.arange(count), plan.t[-1]]
    return Trajectory.of_rows(
        resampled_columns(wanted, plan.t, plan.x, plan.y, plan.yaw, plan.v, plan.a, plan.kappa)
    )
