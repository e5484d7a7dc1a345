"""Polynomials in the Frenet frame, and the states that a pair of them stands for.

Longitudinal, from (s, s_dot, s_ddot) at the start:

(1) keep a speed: quartic s(t) to (s_dot, s_ddot) = (v1, 0) at T, s free            least integral of jerk^2
(2) reach a point (stop, follow): quintic s(t) to (s1, v1, 0) at T                  least integral of jerk^2
    after T both go on with v1

Lateral, from (l, l', l'') at the start:

(3) quintic l(s) to (l1, 0, 0) over D = max(s(T_l) - s(0), `LEAST_M`), then l1

(Werling et al., ICRA 2010; l over s is its form for low speeds. It is used at all speeds here, since at constant speed
it is the same polynomial as l over t, and needs no switch.)
"""

from __future__ import annotations

from math import atan2, cos, sin, tan

import numpy as np

from logs.kernel import FloatArray, kernel
from logs.road import line_curvature, line_frame
from logs.states import wrap
from planners.frenet.path import MIN_REGULAR
from planners.frenet.profiles import STEP_S
from planners.frenet.quintic import quintic

LEAST_M = 8.0
"""A lateral move is not shorter than this (3), m: at low speeds it would be too sharp to steer."""


@kernel
def keep_speed(v0: float, a0: float, v1: float, T: float) -> tuple[float, float, float]:
    """Coefficients c3, c4, c5 = 0 of the quartic (1)."""
    change, bend = v1 - v0 - a0 * T, -a0
    return (change - bend * T / 3.0) / T**2, (bend * T - 2.0 * change) / (4.0 * T**3), 0.0


@kernel
def reach_point(v0: float, a0: float, s1: float, v1: float, T: float) -> tuple[float, float, float]:
    """Coefficients c3, c4, c5 of the quintic (2), s measured from the start."""
    return quintic(0.0, v0 - v1, a0, s1 - v1 * T, T)


@kernel
def third_square(c3: float, c4: float, c5: float, T: float) -> float:
    """Integral of the squared third derivative over [0, T]."""
    a, b, c = 6.0 * c3, 24.0 * c4, 60.0 * c5
    return T * (a * a + T * (a * b + T * ((b * b + 2.0 * a * c) / 3.0 + T * (0.5 * b * c + T * 0.2 * c * c))))


@kernel
def evaluated(c: FloatArray, T: float, x: float) -> tuple[float, float, float]:
    """Value, first and second derivative of a polynomial `(6,)` at x; beyond T it goes on straight."""
    u = min(x, T)
    value = ((((c[5] * u + c[4]) * u + c[3]) * u + c[2]) * u + c[1]) * u + c[0]
    first = (((5.0 * c[5] * u + 4.0 * c[4]) * u + 3.0 * c[3]) * u + 2.0 * c[2]) * u + c[1]
    second = ((20.0 * c[5] * u + 12.0 * c[4]) * u + 6.0 * c[3]) * u + 2.0 * c[2]
    return (value + first * (x - T), first, 0.0) if x > T else (value, first, second)


@kernel
def sampled(lon: FloatArray, T: FloatArray, steps: int) -> FloatArray:
    """s, s_dot, s_ddot `(m, 3, steps + 1)` of polynomials `(m, 6)` every `STEP_S`."""
    out = np.empty((len(lon), 3, steps + 1))
    for i in range(len(lon)):
        for k in range(steps + 1):
            out[i, 0, k], out[i, 1, k], out[i, 2, k] = evaluated(lon[i], T[i], k * STEP_S)
    return out


@kernel
def lateral_polynomial(start: FloatArray, l1: float, D: float) -> FloatArray:
    """Coefficients `(6,)` of (3), lowest power first, from `start` (l, l', l'')."""
    c3, c4, c5 = quintic(start[0], start[1], start[2], l1, D)
    return np.array([start[0], start[1], 0.5 * start[2], c3, c4, c5])


@kernel
def states(
    knots: FloatArray, coef: FloatArray, s0: float, lateral: FloatArray, D: float, motion: FloatArray
) -> FloatArray:
    """Rows x, y, yaw, v, a, kappa, l, turn, 1 - kappa l `(9, k)` of a candidate (`planners.dp_qp.path`, (1) to (3)).

    a = s_ddot R / cos d + s_dot^2 / cos d (R tan d (kappa R / cos d - kappa_r) - (kappa_r' l + kappa_r l'))
    with R = 1 - kappa_r l and d the heading off the line.
    """
    out = np.empty((9, motion.shape[1]))
    for k in range(motion.shape[1]):
        ahead = motion[0, k]
        l, dl, ddl = evaluated(lateral, D, ahead)  # noqa: E741
        x, y, yaw_r, kappa_r = line_frame(knots, coef, s0 + ahead)
        s = s0 + ahead
        dkappa_r = 2.0 * (line_curvature(knots, coef, s + 0.25) - line_curvature(knots, coef, s - 0.25))
        out[8, k] = 1.0 - kappa_r * l
        R = max(out[8, k], MIN_REGULAR)
        turn = atan2(dl, R)
        c, bend = cos(turn), dkappa_r * l + kappa_r * dl
        kappa = ((ddl + bend * tan(turn)) * c * c / R + kappa_r) * c / R
        out[0, k], out[1, k], out[2, k] = x - l * sin(yaw_r), y + l * cos(yaw_r), yaw_r + turn
        out[3, k] = motion[1, k] * R / c
        out[4, k] = motion[2, k] * R / c
        out[4, k] += motion[1, k] ** 2 / c * (R * tan(turn) * (kappa * R / c - kappa_r) - bend)
        out[5, k], out[6, k], out[7, k] = kappa, l, turn
        if k > 0:
            out[2, k] = out[2, k - 1] + wrap(out[2, k] - out[2, k - 1])
    return out
