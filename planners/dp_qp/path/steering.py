"""What steering can do along a path: bounds of its curvature and of the curvature's rate, and the reach that they give.

With the speed v(s) that is expected along the reference line, the lock K and the steering rate d(delta)/dt,

(1) |kappa| <= min(K, a_lat / v^2)           (2) |kappa'| <= rate / (wheelbase v)

For a path at offset l the curvature is kappa_r / (1 - kappa_r l) + l'' / (1 - kappa_r l)^2 where l' is small.

(3) The reach: l, l' and l'' of steering to one side as hard as (1) and (2) let it. A bound that asks for more cannot be
    kept; it is loosened to the reach, so that a path is found, and whoever is then met is met in the S-T graph.

A point of the ego's axis `lead` m before the rear axle has the offset, from the reference line at s + lead,

(4) l + lead l' - swing,      swing = (sqrt(1 + (kappa_r lead)^2) - 1) / kappa_r
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from logs.kernel import FloatArray, frozen, inner_kernel, kernel
from planners.frenet.path import MIN_REGULAR

COMFORT = frozen(np.array([4.0, 3.0, 1.8]))
"""Lateral acceleration that a path may need, braking and acceleration that the expected speed counts on, m/s2 ..."""
HARD = frozen(np.array([6.0, 5.0, 0.0]))
"""... and those where comfort would leave the lane by more than `FORCED_M`."""
SHARPEST = 1.0
"""Largest rate of the curvature, 1/m2, however slow the ego is."""
SHARE = 0.8
"""Share of the bounds with which the reach (3) steers: what is left makes the path smooth."""
SLOWEST_MPS = 1.0
"""v of (1) and (2) is not less than this, m/s."""
AHEAD = 1.0 / 3.0
"""The swing (4) is that of the curvature at s + lead / 3: exact to second order where the curvature rises linearly."""


@kernel
def expected_speed(
    v0: float, limit: FloatArray, kappa: FloatArray, step: float, accel: float, decel: float, lateral: float
) -> FloatArray:
    """Speed `(n,)` at stations `step` m apart: the limit and the curves, with as much braking as `decel`, m/s."""
    out = np.empty(len(limit))
    for i in range(len(limit)):
        out[i] = min(limit[i], sqrt(lateral / max(abs(kappa[i]), 1e-6)))
    for i in range(len(limit) - 2, -1, -1):
        most = out[i + 1] ** 2 + 2.0 * decel * step
        if out[i] ** 2 > most:
            out[i] = sqrt(most)
    out[0] = v0
    for i in range(1, len(limit)):
        least, most = out[i - 1] ** 2 - 2.0 * decel * step, out[i - 1] ** 2 + 2.0 * accel * step
        if out[i] ** 2 > most:
            out[i] = sqrt(most)
        elif out[i] ** 2 < least:
            out[i] = sqrt(least)
    return out


@inner_kernel
def bend_bounds(bend: float, kappa: float, offset: float) -> tuple[float, float]:
    """Bounds of l'' that keep the curvature of a path near an offset within +-`bend`."""
    regular = max(1.0 - kappa * offset, MIN_REGULAR)
    return (-bend - kappa / regular) * regular**2, (bend - kappa / regular) * regular**2


@inner_kernel
def reach(start: FloatArray, aim: FloatArray, low: FloatArray, high: FloatArray, step: float) -> FloatArray:
    """Rows l, l', l'' `(3, n)` of (3): l'' goes to `aim` `(n,)` as fast as the bounds of its rate `(n - 1,)` let it."""
    n = len(aim)
    out = np.empty((3, n))
    out[:, 0] = start
    for i in range(n - 1):
        now = out[2, i]
        then = min(max(aim[i + 1], now + step * low[i]), now + step * high[i])  # (3)
        out[2, i + 1] = then
        out[1, i + 1] = out[1, i] + 0.5 * step * (now + then)
        out[0, i + 1] = out[0, i] + step * out[1, i] + step * step * (now / 3.0 + then / 6.0)
    return out


@kernel
def bounded(
    start: FloatArray, v0: float, limit: FloatArray, kappa: FloatArray, offset: FloatArray, step: float,
    car: FloatArray, limits: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """Bounds of l'' `(2, n)` and of its rate `(2, n - 1)`, and the reach (3) to the left and to the right `(3, n)`.

    Args:
        start: l, l', l'' at the first knot `(3,)`; the bounds of l'' are widened to the reach from there.
        v0: Speed at the first knot, m/s.
        limit: Speed limit at the knots `(n,)`, m/s.
        kappa: Of the reference line at the knots `(n,)`, 1/m.
        offset: Near which the path is `(n,)`, m.
        step: Between two knots, m.
        car: Curvature at the lock, 1/m, its rate over time, 1/(m s), and the lateral acceleration for which the speed
            stage slows down in curves, m/s2.
        limits: `COMFORT` or `HARD`.
    """
    n = len(limit)
    v = expected_speed(v0, limit, kappa, step, limits[2], limits[1], car[2])
    bounds, aims, rates, share = np.empty((2, n)), np.empty((2, n)), np.empty((2, n - 1)), np.empty((2, n - 1))
    quickest = np.inf
    for i in range(n):
        fast = max(v[i], SLOWEST_MPS)
        bend = min(car[0], limits[0] / fast**2)  # (1)
        bounds[0, i], bounds[1, i] = bend_bounds(bend, kappa[i], offset[i])
        aim = max(SHARE * bend, min(bend, 1.02 * abs(kappa[i])))
        aims[0, i], aims[1, i] = bend_bounds(aim, kappa[i], offset[i])
        before, quickest = quickest, min(car[1] / fast, SHARPEST)
        if i > 0:
            rate, turning = min(before, quickest), (kappa[i] - kappa[i - 1]) / step  # (2)
            rates[0, i - 1], rates[1, i - 1] = -rate - turning, rate - turning
            share[0, i - 1], share[1, i - 1] = -SHARE * rate - turning, SHARE * rate - turning
    left, right = reach(start, aims[1], share[0], share[1], step), reach(start, aims[0], share[0], share[1], step)
    for i in range(n):
        bounds[0, i], bounds[1, i] = min(bounds[0, i], left[2, i]), max(bounds[1, i], right[2, i])
    return bounds, rates, left, right


@inner_kernel
def swing_of(kappa: float, lead: float) -> float:
    """(4) for the curvature there, 1/m: m to the right in a left turn."""
    turn = kappa * lead
    return lead * turn / (1.0 + sqrt(1.0 + turn**2))
