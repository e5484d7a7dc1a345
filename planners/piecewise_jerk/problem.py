"""The piecewise-jerk QP: a curve x(t) at n knots, its third derivative constant between two knots.

The path QP (x = offset, t = station) and the speed QP (x = station, t = time) are both of this form (Zhang et al.,
"Optimal Vehicle Path Planning Using Quadratic Optimization for Baidu Apollo Open Platform", 2020). With the step h:

(1) x'_{i+1} = x'_i + h/2 (x''_i + x''_{i+1})
(2) x_{i+1}  = x_i + h x'_i + h^2/3 x''_i + h^2/6 x''_{i+1}
(3) x'''_i   = (x''_{i+1} - x''_i) / h
(4) minimise   sum_i w_x (x_i - r_i)^2 + w_dx (x'_i - r'_i)^2 + w_ddx x''_i^2 + w_dddx x'''_i^2
(5) subject to the start (x_0, x'_0, x''_0), and lower <= row <= upper, i = 1 .. n-1, of the rows x, x', x'' and
    x + lead_j x' (what lies `lead` before the point that follows the curve), and of x'''_i, i = 0 .. n-2
(6) softly: the rows x and x + lead_j x' are replaced by row + e, and soft e^2 is added to the cost

Units: those of x (m) and t (m or s); cost without unit.
"""

from __future__ import annotations

from functools import lru_cache
from math import isfinite, nan
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from logs.kernel import FloatArray, kernel

X, DX, DDX, DDDX, LEADS = 0, 1, 2, 3, 4
"""Rows of the bounds; rows x + lead x' from `LEADS` on."""


class Weights(NamedTuple):
    """Of the squares in (4)."""

    x: float
    dx: float
    ddx: float
    dddx: float


class PiecewiseJerkProblem(NamedTuple):
    """One problem (4)-(6); k leads, n knots. Also an argument of kernels: arrays C-contiguous, float64, writeable.

    Attributes:
        step: h > 0.
        leads: Lead of each further row `(k,)`.
        start: x, x', x'' at the first knot `(3,)`.
        weights: Of (4), not negative, one of them positive.
        references: r and r' `(2, n)`.
        lower: Bounds of the rows x, x', x'', x''', x + lead x' `(4 + k, n)`, -inf for none. Not read: what belongs to
            the first knot, which is the start, and the last x''', which does not exist.
        upper: Likewise, inf for none.
        soft: 0, or the weight in (6), the corridor then giving way.
    """

    step: float
    leads: FloatArray
    start: FloatArray
    weights: Weights
    references: FloatArray
    lower: FloatArray
    upper: FloatArray
    soft: float


@kernel
def largest_violation(problem: PiecewiseJerkProblem, curve: FloatArray) -> float:
    """By how much a curve x, x', x'' `(3, n)` violates (1), (2), (5), in the units of the row; nan if one is nan.

    What gives way in (6) does not count.
    """
    h, lower, upper = problem.step, problem.lower, problem.upper
    x, dx, ddx = curve[0], curve[1], curve[2]
    worst = max(abs(x[0] - problem.start[0]), abs(dx[0] - problem.start[1]), abs(ddx[0] - problem.start[2]))
    for i in range(1, curve.shape[1]):
        jerk = (ddx[i] - ddx[i - 1]) / h  # (3)
        worst = max(worst, lower[DDDX, i - 1] - jerk, jerk - upper[DDDX, i - 1])
        worst = max(worst, abs(dx[i] - dx[i - 1] - 0.5 * h * (ddx[i - 1] + ddx[i])))  # (1)
        worst = max(worst, abs(x[i] - x[i - 1] - h * dx[i - 1] - h * h * (ddx[i - 1] / 3.0 + ddx[i] / 6.0)))  # (2)
        worst = max(worst, lower[DX, i] - dx[i], dx[i] - upper[DX, i], lower[DDX, i] - ddx[i], ddx[i] - upper[DDX, i])
        if problem.soft == 0.0:
            worst = max(worst, lower[X, i] - x[i], x[i] - upper[X, i])
            for k in range(len(problem.leads)):
                ahead = x[i] + problem.leads[k] * dx[i]
                worst = max(worst, lower[LEADS + k, i] - ahead, ahead - upper[LEADS + k, i])
    for i in range(curve.shape[1]):
        if not isfinite(x[i] + dx[i] + ddx[i]):
            return nan
    return worst


class Structure(NamedTuple):
    """What problems must share to share a solver's workspace: the arguments of `matrices`."""

    knots: int
    step: float
    leads: tuple[float, ...]
    weights: Weights
    soft: float


class Matrices(NamedTuple):
    """P and A of the sparse form, the count of its equalities (the first rows), the typical size of each unknown."""

    P: sparse.csc_matrix
    A: sparse.csc_matrix
    equalities: int
    sizes: FloatArray


def structure(problem: PiecewiseJerkProblem) -> Structure:
    """The structure of a problem."""
    leads = tuple(float(lead) for lead in problem.leads)
    return Structure(problem.lower.shape[1], float(problem.step), leads, problem.weights, float(problem.soft))


@lru_cache(maxsize=64)
def matrices(kind: Structure) -> Matrices:
    """The sparse form: minimise 1/2 z' P z + q' z subject to l <= A z <= u, z = (x, x', x'') and, softly, the shifts e.

    Rows of A: (1), (2), the start, then (5) in the order x, x', x'', x''', x + lead x'. P and q are divided by w_x
    where that is positive.
    """
    n, h = kind.knots, kind.step
    now, then = sparse.eye(n - 1, n), sparse.eye(n - 1, n, k=1)
    none = sparse.csc_matrix((n - 1, n))
    third = (then - now) / h  # (3)
    rows: list[list[Any]] = [
        [now - then, h * now, h**2 / 3.0 * now + h**2 / 6.0 * then],  # (2)
        [none, now - then, 0.5 * h * (now + then)],  # (1)
        *(_picked(sparse.eye(1, n), k) for k in range(3)),  # the start
        *(_picked(then, k) for k in range(3)),
        [none, none, third],
        *([then, lead * then, none] for lead in kind.leads),
    ]
    A: Any = sparse.bmat(rows, format="csc")
    weights = kind.weights
    squares: list[Any] = [w * sparse.eye(n) for w in weights[:3]]
    squares[DDX] = squares[DDX] + weights.dddx * (third.T @ third)
    unit = weights.x or 1.0
    sizes = np.repeat([np.sqrt(unit / w) if w > 0.0 else 1.0 for w in weights[:3]], n)
    equalities = 2 * (n - 1) + 3
    if kind.soft > 0.0:
        gives = np.r_[np.arange(n - 1), np.arange(4 * (n - 1), A.shape[0] - equalities)] + equalities
        shifts = sparse.csc_matrix((np.ones(len(gives)), (gives, np.arange(len(gives)))), (A.shape[0], len(gives)))
        A = sparse.hstack([A, shifts], format="csc")
        squares.append(kind.soft * sparse.eye(len(gives)))
        sizes = np.r_[sizes, np.full(len(gives), np.sqrt(unit / kind.soft))]
    P = 2.0 / unit * sparse.block_diag(squares, format="csc")
    return Matrices(sparse.csc_matrix(P), sparse.csc_matrix(A), equalities, sizes)


def vectors(problem: PiecewiseJerkProblem) -> tuple[FloatArray, FloatArray, FloatArray]:
    """q, l and u of the sparse form."""
    n, weights = problem.lower.shape[1], problem.weights
    q = np.zeros(len(matrices(structure(problem)).sizes))
    q[: 2 * n] = (-2.0 / (weights.x or 1.0) * np.array([[weights.x], [weights.dx]]) * problem.references).ravel()
    dynamics = np.zeros(2 * (n - 1))

    def bounds(of: FloatArray) -> FloatArray:
        return np.concatenate([dynamics, problem.start, of[:3, 1:].ravel(), of[3, :-1], of[4:, 1:].ravel()])

    return q, bounds(problem.lower), bounds(problem.upper)


def _picked(rows: Any, k: int) -> list[Any]:
    """The blocks of rows of A that pick x, x' or x'' (k = 0, 1, 2)."""
    none = sparse.csc_matrix(rows.shape)
    return [rows if k == j else none for j in range(3)]
