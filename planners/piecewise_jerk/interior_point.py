"""Interior-point method for the piecewise-jerk QP (`problem`), in B-spline coefficients, where it is banded.

A curve with piecewise-constant third derivative is a cubic B-spline with uniform knots. Its coefficients c_0 .. c_{n+1}
fulfil the dynamics (1), (2) of `problem` by themselves, and each row of its bounds reads four neighbours:

(1) x_i       = (c_i + 4 c_{i+1} + c_{i+2}) / 6              h x'_i      = (c_{i+2} - c_i) / 2
    h^2 x''_i = c_i - 2 c_{i+1} + c_{i+2}                    h^3 x'''_i  = c_{i+3} - 3 c_{i+2} + 3 c_{i+1} - c_i
(2) the start fixes c_0, c_1, c_2:  c_1 = x_0 - h^2 x''_0 / 6,   c_0, c_2 = x_0 -+ h x'_0 + h^2 x''_0 / 3

Scaled by 1, h, h^2, h^3 all rows are of the size of x. With A the matrix of (1), the cost is divided by the curvature
that it has in x at least, so that cost is the square of a distance (m2), and the problem is

(3) minimise  1/2 sum q (y - r)^2 + 1/2 sum e^2 / give    subject to   y = A c,   lower <= y + e <= upper

over all rows; give = 0 (thus e = 0) for rows that do not give way. A slack z >= 0 and a multiplier f >= 0 per bound,
the force on a row f = f_lower - f_upper, sign = 1 for lower and -1 for upper bounds. KKT conditions (Nocedal & Wright,
"Numerical Optimization", 2006, ch. 16.6):

(4) dual:            A' (q (y - r) - force) = 0   (rows of the free coefficients),   e = give force
(5) primal:          sign (y + e - bound) - z = 0
(6) complementary:   z f = 0

Newton's step for (4), (5), (6) with the target z f -> sigma mu, eliminated down to the coefficients, where t is the
right-hand side of a row and W its barrier's curvature. The matrix has 4 bands: L D L', O(n).

(7) (A' (q + W~) A) dc = A' t~ - (A' (q (y - r) - force)),   W = sum f / z,   W~ = W / (1 + give W),
    t = - sum sign (product + f primal) / z,   t~ = t / (1 + give W),   product = z f [+ dz df - sigma mu]
(8) dy = A dc,   d force = t~ - W~ dy,   dz = sign (dy + give d force) + primal,   df = - (product + f dz) / z

Mehrotra's predictor-corrector ("On the implementation of a primal-dual interior point method", 1992): the step with
sigma = 0 says how far the boundary is, then

(9) sigma = (mu after that step / mu)^3, its second-order term dz df joins the product, and 0.995 of the way to the
    boundary is gone, primal and dual apart (together where rows give way: there they are coupled by e = give force)

(10) Stop: at the optimum the duality gap bounds the distance, 1/2 |x - x*|^2 <= sum z f (the cost is that convex in
     x): so sum z f <= 1/2 accuracy^2, and the residuals of (4), (5) are far below the accuracy.
(11) Infeasible (Farkas): forces with A' force = 0 on the free coefficients, give force = 0 and
     sum sign f bound > force' A c_fixed  contradict every c. Called so where the two are small to the last: `FARKAS`.

Nothing is warm-started: a solution depends on its problem alone. A mirrored problem gives the mirrored bits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from logs.kernel import FloatArray, kernel
from planners.piecewise_jerk.problem import DDDX, DX, PiecewiseJerkProblem, X

SOLVED, SPENT, INFEASIBLE, BROKEN, CROSSED, NOT_FINITE = 1, 2, 3, 4, 5, 6
"""Status codes; `STATUS` has them in words."""
STATUS = {
    SOLVED: "solved",
    SPENT: "iterations spent",
    INFEASIBLE: "infeasible",
    BROKEN: "overflow",
    CROSSED: "bounds cross or are not numbers",
    NOT_FINITE: "cost is not finite",
}
ACCURACY_M = 1e-4
"""Distance of (10) from the optimum; what a solver of the general form reaches in practice is 1e-4 to 0.5 m."""
MAX_ITERATIONS = 60
RESIDUAL = 1e-2
"""Residuals of (4) and (5) that may be left, as a share of the accuracy."""
FARKAS = 1e-7
"""(11): the forces' residual, as a share of the contradiction: it holds for all coefficients up to the inverse, m."""
NARROW_M = 1e-6
"""Bounds that are nearer to each other than twice this are moved apart to that: the method needs an inside."""
FAR_M = 1e6
"""A bound that is farther away than this is none."""
TO_BOUNDARY = 0.995
FLOOR = 0.1
"""Products z f are not aimed below this share of what (10) asks for: smaller ones only cost digits."""
ROUNDING, HUGE = 1e-15, 1e128
"""Pivots that are less than this share of their diagonal are rounding, and are replaced by a huge one."""
PROXIMAL, PROXIMAL_M = 1e-10, 1e-6
"""The give of every row in a step: the matrix stays positive definite in floating point, the solution is the same."""
START_SHARE, START_LEAST_M, START_MOST_M, START_MU = 0.1, 0.01, 2.0, 1.0
"""First slacks are at least this share of the room between two bounds, which counts as neither less nor more than this;
first products z f, m2."""


class Rows(NamedTuple):
    """The rows of (3); K kinds (x, x', x'', x''', x + lead x'), m = n - 1 rows each, row j of all on c_j .. c_{j+3}.

    Attributes:
        stencil: Coefficients of (1) `(K, 4)`.
        scale: To the size of x `(K,)`.
        cost: q `(K,)`; `wanted` r `(K, m)`.
        give: Of (3) `(K,)`.
        bound: Lower and upper `(2, K, m)`.
    """

    stencil: FloatArray
    scale: FloatArray
    cost: FloatArray
    wanted: FloatArray
    give: FloatArray
    bound: FloatArray


class Point(NamedTuple):
    """An iterate, or a step: c `(m + 3,)`, y and force `(K, m)`, slacks z and multipliers f `(2, K, m)`."""

    c: FloatArray
    y: FloatArray
    force: FloatArray
    slack: FloatArray
    multiplier: FloatArray


class Newton(NamedTuple):
    """Work arrays of (7).

    Attributes:
        primal: Residuals of (5) `(2, K, m)`.
        product: z f and what joins it `(2, K, m)`.
        stiffness: W~ `(K, m)`.
        softening: 1 / (1 + give W) `(K, m)`.
        push: t~ `(K, m)`.
        dual: Residual of (4) `(m + 3,)`, 0 for the fixed coefficients.
        pull: A' force `(m + 3,)`.
        band: The matrix by diagonals, then its factors `(4, m + 3)`.
    """

    primal: FloatArray
    product: FloatArray
    stiffness: FloatArray
    softening: FloatArray
    push: FloatArray
    dual: FloatArray
    pull: FloatArray
    band: FloatArray


class Solution(NamedTuple):
    """What came out.

    Attributes:
        curve: x, x', x'' `(3, n)`, to be used only where `status` is `SOLVED`.
        status: A key of `STATUS`.
        iterations: Matrices factorised.
        primal: Largest residual of (5), m; `dual` of (4), m.
        gap: Sum of the products (6), m2.
    """

    curve: FloatArray
    status: int
    iterations: int
    primal: float
    dual: float
    gap: float


@kernel
def solve(problem: PiecewiseJerkProblem, accuracy: float, max_iterations: int) -> Solution:
    """The curve of a problem, `accuracy` m from the optimum at most."""
    rows = rows_of(problem)
    point = _first_point(problem, rows)
    step, newton = _blank(rows), _workspace(rows)
    status, iteration, primal, dual, gap = _fault(problem), 0, np.nan, np.nan, np.nan
    together, least = problem.soft > 0.0, FLOOR * 0.5 * accuracy**2 / point.slack.size
    while status == SPENT:
        primal, dual, gap = _residuals(rows, point, newton)
        status = _verdict(rows, point, newton, primal, dual, gap, accuracy)
        if status != SPENT or iteration == max_iterations:
            break
        iteration += 1
        proximal = min(PROXIMAL, PROXIMAL_M / point.multiplier.max())
        _assemble(rows, point, newton, proximal)
        if not _factorise(newton.band):
            status = BROKEN
            break
        _direction(rows, point, newton, step, proximal)
        primal_step, dual_step = _step_lengths(point, step, 1.0, together)
        mu = gap / point.slack.size
        after = _gap_after(point, step, primal_step, dual_step) / point.slack.size
        _correct(newton.product, step, max((after / mu) ** 3 * mu, least))  # (9)
        _direction(rows, point, newton, step, proximal)
        primal_step, dual_step = _step_lengths(point, step, TO_BOUNDARY, together)
        _advance(point, step, primal_step, dual_step)
    return Solution(_curve(point.c, problem.step), status, iteration, primal, dual, gap)


@kernel
def rows_of(problem: PiecewiseJerkProblem) -> Rows:
    """The rows (1) of a problem, scaled, with their cost and bounds (3)."""
    kinds, n = problem.lower.shape
    h, m = problem.step, n - 1
    stencil, scale, cost, give = np.zeros((kinds, 4)), np.ones(kinds), np.zeros(kinds), np.zeros(kinds)
    stencil[0, 1], stencil[0, 2], stencil[0, 3] = 1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0  # (1)
    stencil[1, 1], stencil[1, 3] = -0.5, 0.5
    stencil[2, 1], stencil[2, 2], stencil[2, 3] = 1.0, -2.0, 1.0
    stencil[3, 0], stencil[3, 1], stencil[3, 2], stencil[3, 3] = -1.0, 3.0, -3.0, 1.0
    scale[1], scale[2], scale[3] = h, h * h, h * h * h
    for k in range(4):
        cost[k] = 2.0 * problem.weights[k] / scale[k] ** 2
    for k in range(4, kinds):
        stencil[k] = stencil[0] + problem.leads[k - 4] / h * stencil[1]
    # curvature of the cost in x: |x_j|^2 <= m^(2k-1) sum_i |scaled row i of kind k|^2, by Cauchy and Schwarz
    unit = max(cost[0], cost[1] / m, cost[2] / m**3, cost[3] / m**5)
    cost /= unit
    wanted, bound = np.zeros((kinds, m)), np.empty((2, kinds, m))
    for k in range(kinds):
        first = 0 if k == DDDX else 1
        if k <= DX:
            wanted[k] = scale[k] * problem.references[k, 1:]
        if problem.soft > 0.0 and (k == X or k > DDDX):
            give[k] = unit / (2.0 * problem.soft)
        for j in range(m):
            low = max(scale[k] * problem.lower[k, j + first], -FAR_M)
            high = min(scale[k] * problem.upper[k, j + first], FAR_M)
            if high - low < 2.0 * NARROW_M:
                middle = 0.5 * (low + high)
                low, high = middle - NARROW_M, middle + NARROW_M
            bound[0, k, j], bound[1, k, j] = low, high
    return Rows(stencil, scale, cost, wanted, give, bound)


@kernel
def _fault(problem: PiecewiseJerkProblem) -> int:
    """Why there is nothing to solve; `SPENT` where there is."""
    for k in range(problem.lower.shape[0]):
        first, last = (0, -1) if k == DDDX else (1, problem.lower.shape[1])
        if not (problem.lower[k, first:last] <= problem.upper[k, first:last]).all():
            return CROSSED
    if not (np.isfinite(problem.start).all() and np.isfinite(problem.references).all()):
        return NOT_FINITE
    return SPENT


@kernel
def _first_point(problem: PiecewiseJerkProblem, rows: Rows) -> Point:
    """The start going on with constant x'; slacks well inside, multipliers to match."""
    point = _blank(rows)
    c, h = point.c, problem.step
    x, dx, ddx = problem.start[0], h * problem.start[1], h * h * problem.start[2]
    c[0], c[1], c[2] = x - dx + ddx / 3.0, x - ddx / 6.0, x + dx + ddx / 3.0  # (2)
    for i in range(3, len(c)):
        c[i] = 2.0 * c[i - 1] - c[i - 2]
    _apply(rows.stencil, c, point.y)
    _, kinds, m = rows.bound.shape
    for side in range(2):
        sign = 1.0 - 2.0 * side
        for k in range(kinds):
            for j in range(m):
                least = START_SHARE * min(max(rows.bound[1, k, j] - rows.bound[0, k, j], START_LEAST_M), START_MOST_M)
                point.slack[side, k, j] = max(sign * (point.y[k, j] - rows.bound[side, k, j]), least)
                point.multiplier[side, k, j] = START_MU / point.slack[side, k, j]
    return point


@kernel
def _blank(rows: Rows) -> Point:
    _, kinds, m = rows.bound.shape
    sides = np.zeros((2, kinds, m))
    return Point(np.zeros(m + 3), np.zeros((kinds, m)), np.zeros((kinds, m)), sides, np.zeros_like(sides))


@kernel
def _workspace(rows: Rows) -> Newton:
    _, kinds, m = rows.bound.shape
    sides, each, ends = np.zeros((2, kinds, m)), np.zeros((kinds, m)), np.zeros(m + 3)
    return Newton(
        sides, np.zeros_like(sides), each, np.zeros_like(each), np.zeros_like(each), ends, np.zeros_like(ends),
        np.zeros((4, m + 3)),
    )  # fmt: skip


@kernel
def _apply(stencil: FloatArray, c: FloatArray, out: FloatArray) -> None:
    """Write A c."""
    kinds, m = out.shape
    for k in range(kinds):
        a0, a1, a2, a3 = stencil[k]
        for j in range(m):
            out[k, j] = a0 * c[j] + a1 * c[j + 1] + a2 * c[j + 2] + a3 * c[j + 3]


@kernel
def _gather(stencil: FloatArray, of_rows: FloatArray, out: FloatArray) -> None:
    """Write A' of_rows."""
    kinds, m = of_rows.shape
    out[:] = 0.0
    for k in range(kinds):
        for i in range(4):
            a = stencil[k, i]
            for j in range(m):
                out[j + i] += a * of_rows[k, j]


@kernel
def _residuals(rows: Rows, point: Point, newton: Newton) -> tuple[float, float, float]:
    """Residuals of (4), (5), products of (6); the largest of (5), of (4), and the sum of the products."""
    _, kinds, m = rows.bound.shape
    slack, multiplier, force = point.slack, point.multiplier, point.force
    worst, gap = 0.0, 0.0
    for k in range(kinds):
        for j in range(m):
            force[k, j] = multiplier[0, k, j] - multiplier[1, k, j]
            at = point.y[k, j] + rows.give[k] * force[k, j]
            below = (at - rows.bound[0, k, j]) - slack[0, k, j]  # (5)
            above = -(at - rows.bound[1, k, j]) - slack[1, k, j]
            newton.primal[0, k, j], newton.primal[1, k, j] = below, above
            worst = max(worst, abs(below), abs(above))
            newton.product[0, k, j] = slack[0, k, j] * multiplier[0, k, j]  # (6)
            newton.product[1, k, j] = slack[1, k, j] * multiplier[1, k, j]
            gap += newton.product[0, k, j] + newton.product[1, k, j]
            newton.push[k, j] = rows.cost[k] * (point.y[k, j] - rows.wanted[k, j])
    _gather(rows.stencil, force, newton.pull)
    _gather(rows.stencil, newton.push, newton.dual)
    newton.dual[:] -= newton.pull  # (4)
    newton.dual[:3] = 0.0
    return worst, np.abs(newton.dual).max(), gap


@kernel
def _verdict(rows: Rows, point: Point, newton: Newton, primal: float, dual: float, gap: float, accuracy: float) -> int:
    """`SOLVED` by (10), `INFEASIBLE` by (11), else `SPENT`."""
    _, kinds, m = rows.bound.shape
    left = np.abs(newton.pull[3:]).max()
    small = RESIDUAL * accuracy
    if gap <= 0.5 * accuracy**2 and primal <= small and dual <= small * (1.0 + left):  # (10)
        return SOLVED
    excess = 0.0
    for k in range(kinds):
        for j in range(m):
            low, high = rows.bound[0, k, j], rows.bound[1, k, j]
            excess += low * point.multiplier[0, k, j] - high * point.multiplier[1, k, j]
            left = max(left, rows.give[k] * abs(point.force[k, j]))
    excess -= newton.pull[0] * point.c[0] + newton.pull[1] * point.c[1] + newton.pull[2] * point.c[2]
    return INFEASIBLE if left < FARKAS * excess else SPENT  # (11)


@kernel
def _assemble(rows: Rows, point: Point, newton: Newton, proximal: float) -> None:
    """The matrix of (7), lower diagonals; the fixed coefficients get rows of the identity."""
    _, kinds, m = rows.bound.shape
    band, slack, multiplier = newton.band, point.slack, point.multiplier
    band[:] = 0.0
    for k in range(kinds):
        for j in range(m):
            barrier = multiplier[0, k, j] / slack[0, k, j] + multiplier[1, k, j] / slack[1, k, j]
            newton.softening[k, j] = 1.0 / (1.0 + (rows.give[k] + proximal) * barrier)
            newton.stiffness[k, j] = barrier * newton.softening[k, j]
        for i in range(4):
            for d in range(4 - i):
                product = rows.stencil[k, i] * rows.stencil[k, i + d]
                if product != 0.0:
                    for j in range(m):
                        band[d, j + i] += product * (rows.cost[k] + newton.stiffness[k, j])
    band[0, :3], band[1:, :3] = 1.0, 0.0


@kernel
def _factorise(band: FloatArray) -> bool:
    """L D L' in place: D in the first row, L below the diagonal in the others; False where a number is not finite.

    A pivot that is nothing but rounding becomes infinite, so that its coefficient does not move (Wright, "Modified
    Cholesky factorizations in interior-point algorithms for linear programming", 1999).
    """
    size = band.shape[1]
    diagonal = band[0].copy()
    for i in range(size):
        if not np.isfinite(band[0, i]):
            return False
        if band[0, i] < ROUNDING * diagonal[i]:
            band[0, i] = HUGE
        pivot = band[0, i]
        for d in range(1, min(4, size - i)):
            share = band[d, i] / pivot
            for e in range(d, min(4, size - i)):
                band[e - d, i + d] -= share * band[e, i]
        for d in range(1, 4):
            band[d, i] /= pivot
    return True


@kernel
def _back_substitute(band: FloatArray, x: FloatArray) -> None:
    """Replace x by (L D L')^-1 x."""
    size = len(x)
    for i in range(size):
        for d in range(1, min(4, size - i)):
            x[i + d] -= band[d, i] * x[i]
    for i in range(size - 1, -1, -1):
        value = x[i] / band[0, i]
        for d in range(1, min(4, size - i)):
            value -= band[d, i] * x[i + d]
        x[i] = value


@kernel
def _direction(rows: Rows, point: Point, newton: Newton, step: Point, proximal: float) -> None:
    """Newton's step (7), (8) for the products that are in `newton`."""
    _, kinds, m = rows.bound.shape
    slack, multiplier, primal, product = point.slack, point.multiplier, newton.primal, newton.product
    for k in range(kinds):
        for j in range(m):
            below = (product[0, k, j] + multiplier[0, k, j] * primal[0, k, j]) / slack[0, k, j]
            above = (product[1, k, j] + multiplier[1, k, j] * primal[1, k, j]) / slack[1, k, j]
            newton.push[k, j] = (above - below) * newton.softening[k, j]  # (7)
    _gather(rows.stencil, newton.push, step.c)
    step.c[:] -= newton.dual
    step.c[:3] = 0.0
    _back_substitute(newton.band, step.c)
    _apply(rows.stencil, step.c, step.y)
    for k in range(kinds):
        for j in range(m):
            force = newton.push[k, j] - newton.stiffness[k, j] * step.y[k, j]  # (8)
            move = step.y[k, j] + (rows.give[k] + proximal) * force
            for side in range(2):
                opening = (move if side == 0 else -move) + primal[side, k, j]
                step.slack[side, k, j] = opening
                closing = product[side, k, j] + multiplier[side, k, j] * opening
                step.multiplier[side, k, j] = -closing / slack[side, k, j]


@kernel
def _step_lengths(point: Point, step: Point, share: float, together: bool) -> tuple[float, float]:
    """Primal and dual share of a step up to which slacks and multipliers stay positive, times `share`; 1 at most."""
    primal = min(1.0, share * _reach(point.slack.ravel(), step.slack.ravel()))
    dual = min(1.0, share * _reach(point.multiplier.ravel(), step.multiplier.ravel()))
    return (min(primal, dual), min(primal, dual)) if together else (primal, dual)


@kernel
def _reach(value: FloatArray, change: FloatArray) -> float:
    """How much of the change keeps the values positive; 2 at most, since no more than 1 is gone."""
    steepest = 0.5
    for i in range(len(value)):
        steepest = max(steepest, -change[i] / value[i])
    return 1.0 / steepest


@kernel
def _gap_after(point: Point, step: Point, primal: float, dual: float) -> float:
    """Sum of the products z f after a step."""
    _, kinds, m = point.slack.shape
    total = 0.0
    for k in range(kinds):
        for j in range(m):
            below = point.slack[0, k, j] + primal * step.slack[0, k, j]
            above = point.slack[1, k, j] + primal * step.slack[1, k, j]
            below *= point.multiplier[0, k, j] + dual * step.multiplier[0, k, j]
            above *= point.multiplier[1, k, j] + dual * step.multiplier[1, k, j]
            total += below + above
    return total


@kernel
def _correct(product: FloatArray, step: Point, target: float) -> None:
    """Second-order term and centring of (9)."""
    flat, slack, multiplier = product.ravel(), step.slack.ravel(), step.multiplier.ravel()
    for i in range(len(flat)):
        flat[i] += slack[i] * multiplier[i] - target


@kernel
def _advance(point: Point, step: Point, primal: float, dual: float) -> None:
    """The point after a step."""
    point.c[:] += primal * step.c
    point.y[:] += primal * step.y
    point.slack[:] += primal * step.slack
    point.multiplier[:] += dual * step.multiplier


@kernel
def _curve(c: FloatArray, h: float) -> FloatArray:
    """x, x', x'' `(3, n)` of (1)."""
    n = len(c) - 2
    curve = np.empty((3, n))
    for i in range(n):
        curve[0, i] = (c[i] + 4.0 * c[i + 1] + c[i + 2]) / 6.0
        curve[1, i] = (c[i + 2] - c[i]) / (2.0 * h)
        curve[2, i] = (c[i] - 2.0 * c[i + 1] + c[i + 2]) / (h * h)
    return curve
