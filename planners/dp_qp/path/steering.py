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
from typing import NamedTuple

import numpy as np

from logs.kernel import FloatArray, frozen, kernel
from planners.dp_qp.path.qp import MAX_DL, PathProblem
from planners.frenet.path import MIN_REGULAR

COMFORT = frozen(np.array([4.0, 3.0, 1.8]))
"""Lateral acceleration that a path may need, braking and acceleration that the expected speed counts on, m/s2 ..."""
HARD = frozen(np.array([6.0, 5.0, 0.0]))
"""... and those where comfort would leave the lane by more than `FORCED_M`."""
FORCED_M = 0.3
"""Steering hard is thought of where comfortable steering would leave the lane by more than this, m."""
SHARPEST = 1.0
"""Largest rate of the curvature, 1/m2, however slow the ego is."""
SHARE = 0.8
"""Share of the bounds with which the reach (3) steers: what is left makes the path smooth."""
SLOWEST_MPS = 1.0
"""v of (1) and (2) is not less than this, m/s."""
AHEAD = 1.0 / 3.0
"""The swing (4) is that of the curvature at s + lead / 3: exact to second order where the curvature rises linearly."""


class EgoPoints(NamedTuple):
    """The points of the ego's axis for which the bounds hold.

    Attributes:
        leads: How far before the rear axle `(k,)`, m.
        swings: (4) at the knots `(k, n)`, m.
        road_lower: Room of the road, least offset `(k, n)`, m; `road_upper` greatest.
    """

    leads: FloatArray
    swings: FloatArray
    road_lower: FloatArray
    road_upper: FloatArray


@kernel
def expected_speed(
    v0: float, limit: FloatArray, kappa: FloatArray, step: float, accel: float, decel: float, lateral: float
) -> FloatArray:
    """Speed `(n,)` at stations `step` m apart: the limit and the curves, with as much braking as `decel`, m/s."""
    out = np.empty(len(limit))
    for i in range(len(limit)):
        out[i] = min(limit[i], sqrt(lateral / max(abs(kappa[i]), 1e-6)))
    for i in range(len(limit) - 2, -1, -1):
        out[i] = min(out[i], sqrt(out[i + 1] ** 2 + 2.0 * decel * step))
    out[0] = v0
    for i in range(1, len(limit)):
        square = out[i - 1] ** 2
        slowest, fastest = sqrt(max(square - 2.0 * decel * step, 0.0)), sqrt(square + 2.0 * accel * step)
        out[i] = min(max(out[i], slowest), fastest)
    return out


@kernel
def steering(
    v0: float, limit: FloatArray, kappa: FloatArray, step: float, car: FloatArray, limits: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Bounds (1) of the curvature at knots `(n,)`, 1/m, and (2) of its rate between them `(n - 1,)`, 1/m2.

    Args:
        v0: Speed at the first knot, m/s.
        limit: Speed limit at the knots, m/s.
        kappa: Of the reference line at the knots, 1/m.
        step: Between two knots, m.
        car: Curvature at the lock, 1/m, its rate over time, 1/(m s), and the lateral acceleration for which the speed
            stage slows down in curves, m/s2.
        limits: `COMFORT` or `HARD`.
    """
    v = np.maximum(expected_speed(v0, limit, kappa, step, limits[2], limits[1], car[2]), SLOWEST_MPS)
    rate = np.minimum(car[1] / v, SHARPEST)
    return np.minimum(car[0], limits[0] / v**2), np.minimum(rate[:-1], rate[1:])  # (1), (2)


@kernel
def bend_bounds(bend: FloatArray, kappa: FloatArray, offset: FloatArray) -> FloatArray:
    """Bounds of l'' `(2, n)` that keep the curvature of a path near the offsets `(n,)` within (1)."""
    regular = np.maximum(1.0 - kappa * offset, MIN_REGULAR)
    out = np.empty((2, len(kappa)))
    out[0], out[1] = (-bend - kappa / regular) * regular**2, (bend - kappa / regular) * regular**2
    return out


@kernel
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

    Args as of `steering`; the bounds of l'' are widened to the reach from the `start` (l, l', l'').
    """
    bend, rate = steering(v0, limit, kappa, step, car, limits)
    turning = (kappa[1:] - kappa[:-1]) / step
    aims = bend_bounds(np.maximum(SHARE * bend, np.minimum(bend, 1.02 * np.abs(kappa))), kappa, offset)
    low, high = -SHARE * rate - turning, SHARE * rate - turning
    left, right = reach(start, aims[1], low, high, step), reach(start, aims[0], low, high, step)
    bounds = bend_bounds(bend, kappa, offset)
    bounds[0], bounds[1] = np.minimum(bounds[0], left[2]), np.maximum(bounds[1], right[2])
    rates = np.empty((2, len(rate)))
    rates[0], rates[1] = -rate - turning, rate - turning
    return bounds, rates, left, right


@kernel
def swings_of(kappa: FloatArray, leads: FloatArray) -> FloatArray:
    """(4) of leads `(k,)`, m, for the curvature at each `(k, n)`, 1/m: `(k, n)` m to the right in a left turn."""
    out = np.empty(kappa.shape)
    for k in range(len(leads)):
        turn = kappa[k] * leads[k]
        out[k] = leads[k] * turn / (1.0 + np.sqrt(1.0 + turn**2))  # (4)
    return out


@kernel
def loosened(
    start: FloatArray, v0: float, limit: FloatArray, kappa: FloatArray, near: FloatArray, step: float,
    car: FloatArray, points: EgoPoints, lower: FloatArray, upper: FloatArray,
) -> PathProblem:  # fmt: skip
    """The bounds of the path QP: `lower` and `upper` `(points, n)`, loosened to the reach (3) of comfortable steering.

    Where that leaves the road's room by more than `FORCED_M`, of hard steering if that leaves it by less. The bounds of
    the curvature are those at the offsets `near` `(n,)`; other args as of `steering`.
    """
    least, n, count = np.inf, len(limit), len(points.leads)
    out = PathProblem(
        start, lower + points.swings, upper + points.swings, np.empty((2, n)), np.empty((2, n)), np.empty((2, n - 1))
    )
    for limits in (COMFORT, HARD):
        bend, rate, left, right = bounded(start, v0, limit, kappa, near, step, car, limits)
        low, high = np.empty((count, n)), np.empty((count, n))
        forced = -np.inf
        for k in range(count):
            low[k] = left[0] + points.leads[k] * left[1] - points.swings[k]
            high[k] = right[0] + points.leads[k] * right[1] - points.swings[k]
            forced = max(forced, (points.road_lower[k] - low[k]).max(), (high[k] - points.road_upper[k]).max())
        if forced < least:
            out.lower[:] = np.minimum(lower, low) + points.swings
            out.upper[:] = np.maximum(upper, high) + points.swings
            out.slope[0], out.slope[1] = np.minimum(-MAX_DL, left[1]), np.maximum(MAX_DL, right[1])
            out.bend[:], out.rate[:] = bend, rate
        if forced <= FORCED_M:
            break
        least = forced
    return out
