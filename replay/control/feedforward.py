"""The feed-forward of exact following along a path: (4) of `lateral_model` over speed, with the slip that was learned.

(1) steer(t) = d_0 kappa + d_1 kappa' + d_2 kappa'' = d_0 kappa(t + d_1 / d_0) + (d_2 - d_1^2 / (2 d_0)) kappa''
(2) of a command that the steering follows with lag T and that is held for h, (1 + T D) exp(h D / 2) times (1):
        d_1 + (T + h / 2) d_0        d_2 + (T + h / 2) d_1 + (T h / 2 + h^2 / 8) d_0

The shift in time reads the curvature ahead and differentiates nothing; kappa'' is a difference over 2 SPREAD_S, so that
the kinks of a sampled plan do not come through. Times are stations at the present speed.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from logs.kernel import FloatArray, frozen, kernel
from logs.vehicle import VehicleParameters
from replay.control.lateral_model import following
from replay.control.regulator import SPEED_STEP_MPS, at_speed, table_speeds
from replay.vehicle.plan_path import path_kappa

SPREAD_S = 0.15
SLOPE_S = 0.05
"""Half of the time over which the curvature's rate is taken."""

Series = tuple[float, float, float]
"""d_0 rad m, d_1 rad m s, d_2 rad m s2."""


@lru_cache(maxsize=32)
def slip_table(p: VehicleParameters) -> FloatArray:
    """rear_0, front_0, front_1, front_2 `(n, 4)` of `following` at `table_speeds`."""
    rows = [(rear[0], *front) for rear, front, _ in (following(float(v), p) for v in table_speeds())]
    return frozen(np.array(rows))


@kernel
def following_at(
    slips: FloatArray, wheelbase: float, ratios: tuple[float, float], v: float
) -> tuple[float, tuple[float, float, float]]:
    """p_0 rad m and the series d of exact following; `ratios` of front and rear compliance (`Slip`)."""
    i, u = at_speed(slips, v)
    rear = ratios[1] * (slips[i, 0] + u * (slips[i + 1, 0] - slips[i, 0]))
    front = ratios[0] * (slips[i, 1] + u * (slips[i + 1, 1] - slips[i, 1]))
    spin = ratios[0] * (slips[i, 2] + u * (slips[i + 1, 2] - slips[i, 2]))
    third = ratios[0] * (slips[i, 3] + u * (slips[i + 1, 3] - slips[i, 3]))
    return rear, (wheelbase + front - rear, wheelbase * rear / max(v, SPEED_STEP_MPS) + spin, third)


@kernel
def commanded(d: tuple[float, float, float], lag: float, hold: float) -> tuple[float, float, float]:
    """The series (2) of the command whose wheel angle has the series d."""
    ahead = lag + 0.5 * hold
    second = d[2] + ahead * d[1] + (0.5 * lag * hold + 0.125 * hold * hold) * d[0]
    return d[0], d[1] + ahead * d[0], second  # (2)


@kernel
def within(knots: FloatArray, s: float, reach: float) -> float:
    """The station nearest to `s` with `reach` m of path on both sides: a plan often begins at the ego."""
    return max(min(s, knots[-1, 0] - reach), knots[0, 0] + reach)


@kernel
def steer_for(knots: FloatArray, s: float, v: float, d: tuple[float, float, float]) -> float:
    """Wheel angle at station `s` of a path, speed `v`, rad."""
    at, reach = s + v * d[1] / d[0], v * SPREAD_S
    mid = within(knots, at, reach)
    bend = path_kappa(knots, mid + reach) - 2.0 * path_kappa(knots, mid) + path_kappa(knots, mid - reach)
    bend /= SPREAD_S * SPREAD_S
    return d[0] * path_kappa(knots, at) + (d[2] - 0.5 * d[1] * d[1] / d[0]) * bend  # (1)


@kernel
def kappa_rate(knots: FloatArray, s: float, v: float) -> float:
    """The curvature's rate in time at station `s`, 1/(m s)."""
    reach = v * SLOPE_S
    mid = within(knots, s, reach)
    return (path_kappa(knots, mid + reach) - path_kappa(knots, mid - reach)) / (2.0 * SLOPE_S)
