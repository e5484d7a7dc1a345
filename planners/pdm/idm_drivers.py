"""The drivers of PDM-Closed, which follow the traffic on a track.

A driver with the wanted speed v0 drives along a track, from the projection of the ego on it (IDM as
in PDM-Closed):

(1) dv/dt = a (1 - (v / v0)^delta - (s* / max(gap, s0))^2), kept within [-b, a]
    s*    = s0 + v T + v (v - v_lead) / (2 sqrt(a b))

The leader is the nearest one on the track whose centre is ahead of the rear axle.

Source: see `replan.planners.pdm.planner`.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.kernel import kernel
from replan.planners.frenet.profiles import HORIZON_KNOTS, STEP_S

LEAST_WANTED_MPS = 0.1
"""Least wanted speed of a driver: (1) divides by it, m/s."""
ROUNDING_S = 1e-9
"""A knot this much before a time of the S-T boundaries is at it, s: products of steps are
rounded."""


class Driver(NamedTuple):
    """Parameters of (1): a, b (m/s2), T (s), s0 (m), delta."""

    accel: float
    decel: float
    headway: float
    min_gap: float
    exponent: float


@kernel
def idm_acceleration(v: float, v0: float, gap: float, v_lead: float, driver: Driver) -> float:
    """Acceleration (1), m/s2; an infinite gap is a free road."""
    a, b = driver.accel, driver.decel
    wanted_gap = driver.min_gap + v * driver.headway + v * (v - v_lead) / (2.0 * sqrt(a * b))
    gap_term = (wanted_gap / max(gap, driver.min_gap)) ** 2
    return min(max(a * (1.0 - (v / v0) ** driver.exponent - gap_term), -b), a)


@kernel
def drive_track(
    speeds: FloatArray,
    t: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    speed: FloatArray,
    start_v: float,
    center: float,
    driver: Driver,
) -> FloatArray:
    """Rows s, v `(n, 2, HORIZON_KNOTS)` of a driver per wanted speed `(n,)`, m/s, along one track.

    `t` `(k,)`, `lower`, `upper` `(m, k)` and `speed` `(m,)` are those of `StBoundaries`; `center`
    is the distance from the rear axle to the box's centre, m.
    """
    profiles = np.empty((len(speeds), 2, HORIZON_KNOTS))
    for n in range(len(speeds)):
        s, v, k = 0.0, start_v, 0
        for j in range(HORIZON_KNOTS):
            profiles[n, 0, j], profiles[n, 1, j] = s, v
            while k < len(t) - 1 and t[k + 1] <= j * STEP_S + ROUNDING_S:
                k += 1
            gap, v_lead = inf, 0.0
            for i in range(len(lower)):
                if 0.5 * (lower[i, k] + upper[i, k]) + center > s and lower[i, k] - s < gap:
                    gap, v_lead = lower[i, k] - s, speed[i]
            a = idm_acceleration(v, max(speeds[n], LEAST_WANTED_MPS), gap, v_lead, driver)
            s, v = s + STEP_S * v, max(v + STEP_S * a, 0.0)
    return profiles
