"""How far steering can take a path of the path QP.

With the expected speed v(s) along the reference line, the curvature K at the steering lock, and the
steering rate d(delta)/dt, steering keeps

(1) |kappa| <= min(K, a_lat / v^2)           (2) |kappa'| <= rate / (wheelbase v)

For a path at offset l the curvature is kappa_r / (1 - kappa_r l) + l'' / (1 - kappa_r l)^2 where l'
is small.

(3) The reach: l, l' and l'' of steering to one side as hard as (1) and (2) permit.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.kernel import inner_kernel, kernel
from replan.planners.frenet.path import MIN_REGULAR

SHARPEST = 1.0  # Largest rate of the curvature, 1/m2, however slow the ego is
SHARE = 0.8  # Share of the bounds that the reach (3) uses; the rest lets the path be smooth
SLOWEST_MPS = 1.0  # Least v in (1) and (2), m/s


@kernel
def expected_speed(
    v0: float,
    limit: FloatArray,
    kappa: FloatArray,
    step: float,
    accel: float,
    decel: float,
    lateral: float,
) -> FloatArray:
    """Speed `(n,)` at stations `step` m apart, m/s: that of limit and curves, braking with `decel`
    at most.
    """
    expected = np.empty(len(limit))
    for i in range(len(limit)):
        expected[i] = min(limit[i], sqrt(lateral / max(abs(kappa[i]), 1e-6)))
    for i in range(len(limit) - 2, -1, -1):
        most = expected[i + 1] ** 2 + 2.0 * decel * step
        if expected[i] ** 2 > most:
            expected[i] = sqrt(most)
    expected[0] = v0
    for i in range(1, len(limit)):
        least, most = (
            expected[i - 1] ** 2 - 2.0 * decel * step,
            expected[i - 1] ** 2 + 2.0 * accel * step,
        )
        if expected[i] ** 2 > most:
            expected[i] = sqrt(most)
        elif expected[i] ** 2 < least:
            expected[i] = sqrt(least)
    return expected


@inner_kernel
def _bend_bounds(bend: float, kappa: float, offset: float) -> tuple[float, float]:
    """Bounds of l'' that keep the curvature of a path near an offset within +-`bend`."""
    regular = max(1.0 - kappa * offset, MIN_REGULAR)
    return (-bend - kappa / regular) * regular**2, (bend - kappa / regular) * regular**2


@inner_kernel
def _reach(
    start: FloatArray, aim: FloatArray, low: FloatArray, high: FloatArray, step: float
) -> FloatArray:
    """Rows l, l', l'' `(3, n)` of (3): l'' goes to `aim` `(n,)` as fast as the bounds of its rate
    `(n - 1,)` permit.
    """
    n = len(aim)
    reach = np.empty((3, n))
    reach[:, 0] = start[:3]
    for i in range(n - 1):
        now = reach[2, i]
        then = min(max(aim[i + 1], now + step * low[i]), now + step * high[i])  # (3)
        reach[2, i + 1] = then
        reach[1, i + 1] = reach[1, i] + 0.5 * step * (now + then)
        reach[0, i + 1] = reach[0, i] + step * reach[1, i] + step * step * (now / 3.0 + then / 6.0)
    return reach


@kernel
def steering_bounds(
    start: FloatArray,
    limit: FloatArray,
    kappa: FloatArray,
    offset: FloatArray,
    step: float,
    car: FloatArray,
    limits: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Bounds of l'' `(2, n)` and of its rate `(2, n - 1)`, and the reach (3) to the left and to the
    right `(3, n)`.

    Args:
        start: l, l', l'' and the speed (m/s) at the first knot; the bounds of l'' are widened to
            the reach from there.
        limit: Speed limit at the knots `(n,)`, m/s.
        kappa: Curvature of the reference line there `(n,)`, 1/m.
        offset: Offsets near which the path is `(n,)`, m.
        step: Distance between two knots, m.
        car: Curvature at the lock, 1/m, its rate over time, 1/(m s), and the lateral acceleration
            for which the speed stage slows down in curves, m/s2.
        limits: `COMFORT` or `HARD`.
    """
    n = len(limit)
    _, _, _, speed = start
    v = expected_speed(speed, limit, kappa, step, limits[2], limits[1], car[2])
    bounds, aims = np.empty((2, n)), np.empty((2, n))
    rates, share = np.empty((2, n - 1)), np.empty((2, n - 1))
    quickest = np.inf
    for i in range(n):
        fast = max(v[i], SLOWEST_MPS)
        bend = min(car[0], limits[0] / fast**2)  # (1)
        bounds[0, i], bounds[1, i] = _bend_bounds(bend, kappa[i], offset[i])
        aim = max(SHARE * bend, min(bend, 1.02 * abs(kappa[i])))
        aims[0, i], aims[1, i] = _bend_bounds(aim, kappa[i], offset[i])
        quickest_before, quickest = quickest, min(car[1] / fast, SHARPEST)
        if i > 0:
            rate, turning = min(quickest_before, quickest), (kappa[i] - kappa[i - 1]) / step  # (2)
            rates[0, i - 1], rates[1, i - 1] = -rate - turning, rate - turning
            share[0, i - 1], share[1, i - 1] = -SHARE * rate - turning, SHARE * rate - turning
    left = _reach(start, aims[1], share[0], share[1], step)
    right = _reach(start, aims[0], share[0], share[1], step)
    for i in range(n):
        bounds[0, i], bounds[1, i] = min(bounds[0, i], left[2, i]), max(bounds[1, i], right[2, i])
    return bounds, rates, left, right
