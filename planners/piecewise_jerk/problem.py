"""The piecewise-jerk QP: a curve x(t) at n knots, its third derivative constant between two knots;
and as a B-spline.

The path QP (x = offset, t = station) and the speed QP (x = station, t = time) are both of this form
(Zhang et al., "Optimal Vehicle Path Planning Using Quadratic Optimization for Baidu Apollo Open
Platform", 2020). With the step h:

(1) x'_{i+1} = x'_i + h/2 (x''_i + x''_{i+1})
(2) x_{i+1}  = x_i + h x'_i + h^2/3 x''_i + h^2/6 x''_{i+1}
(3) x'''_i   = (x''_{i+1} - x''_i) / h
(4) minimise   sum_i w_x (x_i - r_i)^2 + w_dx (x'_i - r'_i)^2 + w_ddx x''_i^2 + w_dddx x'''_i^2
(5) subject to the start (x_0, x'_0, x''_0), and lower <= row <= upper, i = 1 .. n-1, of the rows x,
        x', x'' and
    x + lead_j x' (a point `lead` ahead of the one that follows the curve), and of x'''_i, i = 0 ..
        n-2
(6) softly: the rows x and x + lead_j x' are replaced by row + e, and soft e^2 is added to the cost

Units: x in m, t in m or s; the cost has no unit.

Such a curve is a cubic B-spline with uniform knots. Its coefficients c_0 .. c_{n+1} fulfil the
dynamics (1), (2) by themselves, and each row of its bounds reads four neighbours:

(7) x_i       = (c_i + 4 c_{i+1} + c_{i+2}) / 6              h x'_i      = (c_{i+2} - c_i) / 2
    h^2 x''_i = c_i - 2 c_{i+1} + c_{i+2}                    h^3 x'''_i
        = c_{i+3} - 3 c_{i+2} + 3 c_{i+1} - c_i
(8) the start fixes c_0, c_1, c_2:  c_1 = x_0 - h^2 x''_0 / 6,
        c_0, c_2 = x_0 -+ h x'_0 + h^2 x''_0 / 3

Scaled by 1, h, h^2, h^3 all rows are of the size of x. A is the matrix of (7). The cost is divided
by a lower bound of its curvature in x, so that it is the square of a distance (m2), and the problem
is

(9) minimise  1/2 sum q (y - r)^2 + 1/2 sum e^2 / give    subject to   y = A c,
        lower <= y + e <= upper

over all rows; give = 0 (thus e = 0) for rows that do not give way.

The matrix A' diagonal A is symmetric with four bands, stored by its lower diagonals. Where it is
positive definite, factors and solution take O(n):

(10) M = L D L',   L u = b,   D v = u,   L' x = v
"""

from __future__ import annotations

from math import isfinite, nan
from typing import NamedTuple

import numpy as np

from replan.core.arrays import FloatArray, frozen
from replan.core.kernel import inner_kernel, kernel

X, DX, DDX, DDDX, LEADS = range(5)  # Rows of the bounds; rows x + lead x' from `LEADS` on
# Bounds less than twice this apart are moved to twice this apart: the method needs an interior
NARROW_M = 1e-6
FAR_M = 1e6  # Scaled bounds are clipped to +- this, m
STENCIL = frozen(
    [
        (0.0, 1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0),
        (0.0, -0.5, 0.0, 0.5),
        (0.0, 1.0, -2.0, 1.0),
        (-1.0, 3.0, -3.0, 1.0),
    ]
)
"""The rows (7) of x, x', x'' and x''', scaled, on four coefficients of the spline."""
ROUNDING, HUGE = 1e-15, 1e128
"""Pivots that are less than this share of their diagonal are rounding errors.

A huge one replaces them.
"""


class Weights(NamedTuple):
    """Weights of the squares in (4)."""

    x: float
    dx: float
    ddx: float
    dddx: float


class PiecewiseJerkProblem(NamedTuple):
    """One problem (4)-(6); k leads, n knots.

    Also an argument of kernels: arrays C-contiguous, float64, writeable.
    """

    step: float  # h > 0
    leads: FloatArray  # Lead of each further row `(k,)`
    start: FloatArray  # x, x', x'' at the first knot `(3,)`
    weights: Weights  # Weights of (4), not negative, at least one positive
    references: FloatArray  # r and r' `(2, n)`
    # Bounds of the rows x, x', x'', x''', x + lead x' `(4 + k, n)`, -inf for none. The solvers do
    # not read those at the first knot, which is the start, except that of x''', nor the last of
    # x'''.
    lower: FloatArray
    upper: FloatArray  # Likewise, inf for none
    soft: float  # Weight in (6), with which the corridor gives way; 0: it does not


@kernel
def largest_violation(problem: PiecewiseJerkProblem, curve: FloatArray) -> float:
    """Largest violation of (1), (2), (5) by a curve x, x', x'' `(3, n)`, in the row's units; nan if
    it is not finite.

    Rows that give way in (6) are left out.
    """
    h, lower, upper = problem.step, problem.lower, problem.upper
    x, dx, ddx = curve[0], curve[1], curve[2]
    worst = max(
        abs(x[0] - problem.start[0]), abs(dx[0] - problem.start[1]), abs(ddx[0] - problem.start[2])
    )
    for i in range(1, curve.shape[1]):
        jerk = (ddx[i] - ddx[i - 1]) / h  # (3)
        worst = max(worst, lower[DDDX, i - 1] - jerk, jerk - upper[DDDX, i - 1])
        worst = max(worst, abs(dx[i] - dx[i - 1] - 0.5 * h * (ddx[i - 1] + ddx[i])))  # (1)
        # (2)
        worst = max(
            worst, abs(x[i] - x[i - 1] - h * dx[i - 1] - h * h * (ddx[i - 1] / 3.0 + ddx[i] / 6.0))
        )
        worst = max(
            worst,
            lower[DX, i] - dx[i],
            dx[i] - upper[DX, i],
            lower[DDX, i] - ddx[i],
            ddx[i] - upper[DDX, i],
        )
        if problem.soft == 0.0:
            worst = max(worst, lower[X, i] - x[i], x[i] - upper[X, i])
            for k in range(len(problem.leads)):
                ahead = x[i] + problem.leads[k] * dx[i]
                worst = max(worst, lower[LEADS + k, i] - ahead, ahead - upper[LEADS + k, i])
    for i in range(curve.shape[1]):
        if not isfinite(x[i] + dx[i] + ddx[i]):
            return nan
    return worst


class Rows(NamedTuple):
    """The rows of (9); K kinds (x, x', x'', x''', x + lead x'), m = n - 1 rows each, N = K m.

    Row j of each kind reads c_j .. c_{j+3}. Arrays `(N,)` are kind by kind.
    """

    stencil: FloatArray  # Coefficients of (7) `(K, 4)`
    cost: FloatArray  # q of (9) `(N,)`; `wanted` is r
    wanted: FloatArray
    give: FloatArray  # give of (9) `(N,)`
    bound: FloatArray  # Lower and upper bounds `(2, N)`


@inner_kernel
def rows_of(problem: PiecewiseJerkProblem) -> Rows:
    """The rows (7) of a problem, scaled, with their cost and bounds (9)."""
    kinds, n = problem.lower.shape
    h, m = problem.step, n - 1
    stencil, scale, curvature = np.zeros((kinds, 4)), np.ones(kinds), np.zeros(kinds)
    stencil[: len(STENCIL)] = STENCIL  # (7)
    scale[DX], scale[DDX], scale[DDDX] = h, h * h, h * h * h
    for k in range(4):
        curvature[k] = 2.0 * problem.weights[k] / scale[k] ** 2
    for k in range(4, kinds):
        for i in range(4):
            stencil[k, i] = stencil[0, i] + problem.leads[k - 4] / h * stencil[1, i]
    # curvature of the cost in x: |x_j|^2 <= m^(2k-1) sum_i |scaled row i of kind k|^2, by Cauchy
    # and Schwarz
    unit = max(curvature[X], curvature[DX] / m, curvature[DDX] / m**3, curvature[DDDX] / m**5)
    cost, wanted, give = np.zeros(kinds * m), np.zeros(kinds * m), np.zeros(kinds * m)
    bound = np.empty((2, kinds * m))
    for k in range(kinds):
        first = 0 if k == DDDX else 1
        for j in range(m):
            i = k * m + j
            cost[i] = curvature[k] / unit
            if k <= DX:
                wanted[i] = scale[k] * problem.references[k, j + 1]
            if problem.soft > 0.0 and (k == X or k > DDDX):
                give[i] = unit / (2.0 * problem.soft)
            low = max(scale[k] * problem.lower[k, j + first], -FAR_M)
            high = min(scale[k] * problem.upper[k, j + first], FAR_M)
            if high - low < 2.0 * NARROW_M:
                middle = 0.5 * (low + high)
                low, high = middle - NARROW_M, middle + NARROW_M
            bound[0, i], bound[1, i] = low, high
    return Rows(stencil, cost, wanted, give, bound)


@inner_kernel
def coast(problem: PiecewiseJerkProblem, c: FloatArray) -> None:
    """Write the coefficients `(m + 3,)` of a curve that keeps x' after the start.

    The first three are those of (8).
    """
    h = problem.step
    x, dx, ddx = problem.start[0], h * problem.start[1], h * h * problem.start[2]
    c[0], c[1], c[2] = x - dx + ddx / 3.0, x - ddx / 6.0, x + dx + ddx / 3.0  # (8)
    for i in range(3, len(c)):
        c[i] = 2.0 * c[i - 1] - c[i - 2]


@inner_kernel
def apply(stencil: FloatArray, c: FloatArray, out: FloatArray) -> None:
    """Write A c."""
    m = len(c) - 3
    for k in range(len(stencil)):
        a0, a1 = stencil[k, 0], stencil[k, 1]
        a2, a3 = stencil[k, 2], stencil[k, 3]
        row = out[k * m : (k + 1) * m]
        for j in range(m):
            row[j] = a0 * c[j] + a1 * c[j + 1] + a2 * c[j + 2] + a3 * c[j + 3]


@inner_kernel
def gather(stencil: FloatArray, of_rows: FloatArray, out: FloatArray) -> None:
    """Write A' of_rows."""
    m = len(out) - 3
    out[:] = 0.0
    for k in range(len(stencil)):
        row = of_rows[k * m : (k + 1) * m]
        for i in range(4):
            a = stencil[k, i]
            if a != 0.0:
                to = out[i : i + m]
                for j in range(m):
                    to[j] += a * row[j]


@inner_kernel
def multiply(stencil: FloatArray, diagonal: FloatArray, band: FloatArray) -> None:
    """Write A' diagonal A by its lower diagonals, with rows of the identity for the fixed
    coefficients.
    """
    m = band.shape[1] - 3
    band[:] = 0.0
    for k in range(len(stencil)):
        row = diagonal[k * m : (k + 1) * m]
        for i in range(4):
            for d in range(4 - i):
                product = stencil[k, i] * stencil[k, i + d]
                if product != 0.0:
                    to = band[d, i : i + m]
                    for j in range(m):
                        to[j] += product * row[j]
    for i in range(3):
        band[0, i] = 1.0
        band[1, i] = band[2, i] = band[3, i] = 0.0


@inner_kernel
def curve_of(c: FloatArray, h: float) -> FloatArray:
    """x, x', x'' `(3, n)` of (7)."""
    n = len(c) - 2
    curve = np.empty((3, n))
    for i in range(n):
        curve[0, i] = (c[i] + 4.0 * c[i + 1] + c[i + 2]) / 6.0
        curve[1, i] = (c[i + 2] - c[i]) / (2.0 * h)
        curve[2, i] = (c[i] - 2.0 * c[i + 1] + c[i + 2]) / (h * h)
    return curve


@inner_kernel
def factorise(band: FloatArray) -> bool:
    """L D L' (10) in place: D in the first row, L below the diagonal in the others; False where a
    number is not finite.

    A pivot that is only rounding error becomes `HUGE`, so that its coefficient does not move
    (Wright, "Modified Cholesky factorizations in interior-point algorithms for linear programming",
    1999).
    """
    size = band.shape[1]
    diagonal = band[0].copy()
    for i in range(size):
        if not isfinite(band[0, i]):
            return False
        if band[0, i] < ROUNDING * diagonal[i]:
            band[0, i] = HUGE
        inverse = 1.0 / band[0, i]
        for d in range(1, min(4, size - i)):
            share = band[d, i] * inverse
            for e in range(d, min(4, size - i)):
                band[e - d, i + d] -= share * band[e, i]
        for d in range(1, 4):
            band[d, i] *= inverse
    return True


@inner_kernel
def back_substitute(band: FloatArray, x: FloatArray) -> None:
    """Replace x by (L D L')^-1 x."""
    size = len(x)
    for i in range(size):
        for d in range(1, min(4, size - i)):
            x[i + d] -= band[d, i] * x[i]
    for i in range(size):
        x[i] /= band[0, i]
    for i in range(size - 1, -1, -1):
        value = x[i]
        for d in range(min(3, size - 1 - i), 0, -1):
            value -= band[d, i] * x[i + d]
        x[i] = value
