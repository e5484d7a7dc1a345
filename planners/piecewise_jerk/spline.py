"""The piecewise-jerk QP in the coefficients of a cubic B-spline, where its rows are banded.

A curve with piecewise-constant third derivative is a cubic B-spline with uniform knots. Its coefficients c_0 .. c_{n+1}
fulfil the dynamics (1), (2) of `problem` by themselves, and each row of its bounds reads four neighbours:

(1) x_i       = (c_i + 4 c_{i+1} + c_{i+2}) / 6              h x'_i      = (c_{i+2} - c_i) / 2
    h^2 x''_i = c_i - 2 c_{i+1} + c_{i+2}                    h^3 x'''_i  = c_{i+3} - 3 c_{i+2} + 3 c_{i+1} - c_i
(2) the start fixes c_0, c_1, c_2:  c_1 = x_0 - h^2 x''_0 / 6,   c_0, c_2 = x_0 -+ h x'_0 + h^2 x''_0 / 3

Scaled by 1, h, h^2, h^3 all rows are of the size of x. With A the matrix of (1), the cost is divided by the curvature
that it has in x at least, so that cost is the square of a distance (m2), and the problem is

(3) minimise  1/2 sum q (y - r)^2 + 1/2 sum e^2 / give    subject to   y = A c,   lower <= y + e <= upper

over all rows; give = 0 (thus e = 0) for rows that do not give way.

The matrix A' diagonal A is symmetric with four bands, stored by its lower diagonals. Where it is positive definite,
factors and solution take O(n):

(4) M = L D L',   L u = b,   D v = u,   L' x = v
"""

from __future__ import annotations

from math import isfinite
from typing import NamedTuple

import numpy as np

from logs.kernel import FloatArray, inner_kernel
from planners.piecewise_jerk.problem import DDDX, DX, PiecewiseJerkProblem, X

NARROW_M = 1e-6
"""Bounds that are nearer to each other than twice this are moved apart to that: the method needs an inside."""
FAR_M = 1e6
"""A bound that is farther away than this is none."""
ROUNDING, HUGE = 1e-15, 1e128
"""Pivots that are less than this share of their diagonal are rounding, and are replaced by a huge one."""


class Rows(NamedTuple):
    """The rows of (3); K kinds (x, x', x'', x''', x + lead x'), m = n - 1 rows each, N = K m.

    Row j of each kind reads c_j .. c_{j+3}. Arrays `(N,)` are kind by kind; `(2, N)` of lower and upper bounds.

    Attributes:
        stencil: Coefficients of (1) `(K, 4)`.
        cost: q `(N,)`; `wanted` r likewise.
        give: Of (3) `(N,)`.
        bound: `(2, N)`.
    """

    stencil: FloatArray
    cost: FloatArray
    wanted: FloatArray
    give: FloatArray
    bound: FloatArray


@inner_kernel
def rows_of(problem: PiecewiseJerkProblem) -> Rows:
    """The rows (1) of a problem, scaled, with their cost and bounds (3)."""
    kinds, n = problem.lower.shape
    h, m = problem.step, n - 1
    stencil, scale, curvature = np.zeros((kinds, 4)), np.ones(kinds), np.zeros(kinds)
    stencil[0, 1], stencil[0, 2], stencil[0, 3] = 1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0  # (1)
    stencil[1, 1], stencil[1, 3] = -0.5, 0.5
    stencil[2, 1], stencil[2, 2], stencil[2, 3] = 1.0, -2.0, 1.0
    stencil[3, 0], stencil[3, 1], stencil[3, 2], stencil[3, 3] = -1.0, 3.0, -3.0, 1.0
    scale[1], scale[2], scale[3] = h, h * h, h * h * h
    for k in range(4):
        curvature[k] = 2.0 * problem.weights[k] / scale[k] ** 2
    for k in range(4, kinds):
        for i in range(4):
            stencil[k, i] = stencil[0, i] + problem.leads[k - 4] / h * stencil[1, i]
    # curvature of the cost in x: |x_j|^2 <= m^(2k-1) sum_i |scaled row i of kind k|^2, by Cauchy and Schwarz
    unit = max(curvature[0], curvature[1] / m, curvature[2] / m**3, curvature[3] / m**5)
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
    """Write the coefficients `(m + 3,)` of the start going on with constant x'; the first three are those of (2)."""
    h = problem.step
    x, dx, ddx = problem.start[0], h * problem.start[1], h * h * problem.start[2]
    c[0], c[1], c[2] = x - dx + ddx / 3.0, x - ddx / 6.0, x + dx + ddx / 3.0  # (2)
    for i in range(3, len(c)):
        c[i] = 2.0 * c[i - 1] - c[i - 2]


@inner_kernel
def apply(stencil: FloatArray, c: FloatArray, out: FloatArray) -> None:
    """Write A c."""
    m = len(c) - 3
    for k in range(len(stencil)):
        a0, a1, a2, a3 = stencil[k, 0], stencil[k, 1], stencil[k, 2], stencil[k, 3]
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
    """Write A' diagonal A by its lower diagonals, with rows of the identity for the fixed coefficients."""
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
    """x, x', x'' `(3, n)` of (1)."""
    n = len(c) - 2
    curve = np.empty((3, n))
    for i in range(n):
        curve[0, i] = (c[i] + 4.0 * c[i + 1] + c[i + 2]) / 6.0
        curve[1, i] = (c[i + 2] - c[i]) / (2.0 * h)
        curve[2, i] = (c[i] - 2.0 * c[i + 1] + c[i + 2]) / (h * h)
    return curve


@inner_kernel
def factorise(band: FloatArray) -> bool:
    """L D L' (4) in place: D in the first row, L below the diagonal in the others; False where a number is not finite.

    A pivot that is nothing but rounding becomes infinite, so that its coefficient does not move (Wright, "Modified
    Cholesky factorizations in interior-point algorithms for linear programming", 1999).
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
