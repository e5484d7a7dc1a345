"""Piecewise-jerk QPs of every kind, by seed."""

import numpy as np

from replan.core.arrays import FloatArray
from replan.planners.piecewise_jerk import interior_point
from replan.planners.piecewise_jerk.interior_point import ACCURACY_M, MAX_ITERATIONS, Solution
from replan.planners.piecewise_jerk.problem import PiecewiseJerkProblem, Weights

KINDS = {"roomy": 1.0, "tight": 0.02, "nearly infeasible": 1e-5, "soft": 0.02}
"""Room on either side of a curve that keeps all bounds, m."""


def curve_of(rng: np.random.Generator, n: int, h: float) -> FloatArray:
    """Rows x, x', x'' `(3, n)` of a curve of a few metres.

    Its third derivative is a sum of slow waves.
    """
    t, length = np.linspace(0.0, 1.0, n - 1), h * n
    jerk = (
        10.0
        / length**3
        * sum(rng.normal() * np.sin(2.0 * np.pi * (k * t + rng.uniform())) for k in range(1, 4))
    )
    curve = np.zeros((3, n))
    curve[:, 0] = rng.normal(size=3) / (1.0, length, length**2)
    for i, j in enumerate(jerk):
        x, dx, ddx = curve[:, i]
        curve[:, i + 1] = (
            x + h * dx + h**2 / 2 * ddx + h**3 / 6 * j,
            dx + h * ddx + h**2 / 2 * j,
            ddx + h * j,
        )
    return curve


def made(kind: str, seed: int, shift: float = 0.0) -> PiecewiseJerkProblem:
    """A problem around a curve that keeps all bounds; `shift` moves two of x inwards by so many
    rooms.
    """
    rng, room = np.random.default_rng(seed), KINDS[kind]
    n, h = int(rng.integers(12, 60)), float(np.exp(rng.uniform(np.log(0.05), np.log(5.0))))
    leads, curve = rng.uniform(0.0, 4.0 * h, rng.integers(0, 3)), curve_of(rng, n, h)
    rows = np.vstack(
        [curve, np.r_[np.diff(curve[2]) / h, 0.0], curve[0] + leads[:, None] * curve[1]]
    )
    power = np.r_[0:4, 0.0 * leads][:, None]
    rooms = np.maximum(room * float(n) ** -power, min(room, 1e-4)) / h**power
    lower, upper = (rows + sign * rooms * rng.uniform(0.5, 2.0, rows.shape) for sign in (-1.0, 1.0))
    absent = rng.random(rows.shape)
    lower[absent < 0.2], upper[absent > 0.8] = -np.inf, np.inf
    for sign, bounds, other in ((1.0, lower, upper), (-1.0, upper, lower)):
        knot = int(rng.integers(2, n))
        bounds[0, knot], other[0, knot] = rows[0, knot] + sign * room * (shift - 1.0), sign * np.inf
    if kind == "soft":
        lower[0, n // 2 : n // 2 + 2] = rows[0, n // 2] + 0.5, -np.inf
        upper[0, n // 2 : n // 2 + 2] = np.inf, rows[0, n // 2 + 1] - 0.5
    settle = h * rng.uniform(3.0, n / 3.0)
    weights = Weights(1.0, (0.5 * settle) ** 2, settle**4, (0.7 * settle) ** 6)
    references = rng.normal(size=(2, 1)) / np.array([[1.0], [h * n]]) * np.ones((2, n))
    return PiecewiseJerkProblem(
        h, leads, curve[:, 0].copy(), weights, references, lower, upper, 1e4 * (kind == "soft")
    )


def answer(problem: PiecewiseJerkProblem) -> Solution:
    return interior_point.solve(problem, ACCURACY_M, MAX_ITERATIONS)
