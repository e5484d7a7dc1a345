"""Mehrotra's interior-point method for the piecewise-jerk QP, in B-spline coefficients.

`problem` defines the rows (its (7)), the fixed coefficients (its (8)), and the QP (its (9)):

(3) minimise  1/2 sum q (y - r)^2 + 1/2 sum e^2 / give    subject to   y = A c,
        lower <= y + e <= upper

Each bound has a slack z >= 0 and a multiplier f >= 0; force = f_lower - f_upper on a row; sign = 1
for lower and -1 for upper bounds. KKT conditions (Nocedal & Wright, "Numerical Optimization", 2006,
ch. 16.6):

(4) dual:            A' (q (y - r) - force) = 0   (rows of the free coefficients),   e = give force
(5) primal:          sign (y + e - bound) - z = 0
(6) complementary:   z f = 0

Newton's step for (4), (5), (6) with the target z f -> sigma mu, eliminated down to the
coefficients, where t is the right-hand side of a row and W its barrier's curvature. The matrix has
4 bands: L D L', O(n).

(7) (A' (q + W~) A) dc = A' t~ - (A' (q (y - r) - force)),   W = sum f / z,   W~ = W / (1 + give W),
    t = - sum sign (product + f primal) / z,   t~ = t / (1 + give W),
        product = z f [+ dz df - sigma mu] (with `PROXIMAL` more give, in the step alone)
(8) dy = A dc,   d force = t~ - W~ dy,   dz = sign (dy + give d force) + primal,
        df = - (product + f dz) / z

Mehrotra's predictor-corrector ("On the implementation of a primal-dual interior point method",
1992): the step with sigma = 0 shows how far the boundary is. Then

(9) sigma = (mu after that step / mu)^3, its second-order term dz df is added to the product,
        and the step goes 0.995 of the way to the boundary. Its primal and dual lengths differ,
        which is faster, until the gap is nearly closed; then
    they are equal, so that the residual of (4) falls (always where rows give way: there e
        = give force couples them)

The first point is the optimum without bounds, which costs one factorisation. In most frames it
violates no bound by more than the residual of (5) may be, and is the solution.

(10) Stop: at the optimum the duality gap bounds the distance,
         1/2 |x - x*|^2 <= sum z f (the cost is that convex in
     x): so sum z f <= 1/2 accuracy^2, and the residuals of (4), (5) are small.
(11) Infeasible (Farkas): forces with A' force = 0 on the free coefficients, give force = 0 and
     sum sign f bound > force' A c_fixed
         contradict every c. The two terms may be as small as `FARKAS` instead of 0.

Each solve starts cold: a solution depends on its problem alone. A mirrored problem has exactly the
mirrored solution.
"""

from __future__ import annotations

from math import isfinite
from typing import NamedTuple

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.kernel import inner_kernel, kernel
from replan.planners.piecewise_jerk.problem import (
    DDDX,
    PiecewiseJerkProblem,
    Rows,
    apply,
    back_substitute,
    coast,
    curve_of,
    factorise,
    gather,
    largest_violation,
    multiply,
    rows_of,
)

# Status codes; `STATUS` has them in words
SOLVED, SPENT, INFEASIBLE, BROKEN, CROSSED, NOT_FINITE = range(1, 7)
STATUS = {
    SOLVED: "solved",
    SPENT: "iterations spent",
    INFEASIBLE: "infeasible",
    BROKEN: "overflow",
    CROSSED: "bounds cross or are not numbers",
    NOT_FINITE: "cost is not finite",
}
"""The status codes in words."""
ACCURACY_M = 1e-4
"""Distance from the optimum in (10), far below what a car can steer. Where bounds are nearly equal,
residuals and `NARROW_M` add to it (measured: benchmarks/README.md)."""
# Several times the iterations that problems from roads need (benchmarks/README.md)
MAX_ITERATIONS = 60
RESIDUAL = 1e-2  # Greatest residuals of (4) and (5) in a solution, as a share of the accuracy
FARKAS = 1e-7
"""Residual of the forces in (11), as a share of the contradiction, which holds for coefficients up
to 1 / this, m.
"""
TO_BOUNDARY = 0.995  # Share of the way to the boundary that a step goes (9)
NEARLY = 1e3  # The gap is nearly closed where it is less than this multiple of the accuracy squared
# Least target of the products z f, as a share of what (10) needs: smaller ones only lose digits
FLOOR = 0.1
PROXIMAL = 1e-10
"""The give of every row in a step: the matrix stays positive definite in floating point, and the
solution is the same (proximal method of multipliers) ..."""
# ... it is smaller where its product with the largest multiplier would exceed this, m.
PROXIMAL_M = 1e-6
START_SHARE = 0.1  # First slacks are at least this share of the distance between two bounds ...
START_LEAST_M = 0.01  # ... which is taken as at least this, m ...
START_MOST_M = 2.0  # ... and at most this, m.
START_MU = 1.0  # First products z f, m2


class Point(NamedTuple):
    """An iterate, or a step: c `(m + 3,)`, y and force `(N,)`, slacks z and multipliers f
    `(2, N)`.
    """

    c: FloatArray
    y: FloatArray
    force: FloatArray
    slack: FloatArray
    multiplier: FloatArray


class Newton(NamedTuple):
    """Work arrays of (7)."""

    primal: FloatArray  # Residuals of (5) `(2, N)`
    product: FloatArray  # z f and the terms that (7) adds to it `(2, N)`
    inverse: FloatArray  # 1 / z `(2, N)`
    stiffness: FloatArray  # W~ `(N,)`
    softening: FloatArray  # 1 / (1 + give W) `(N,)`
    push: FloatArray  # Input of `gather` and `multiply`: q (y - r), q + W~, t~ in turn `(N,)`
    dual: FloatArray  # Residual of (4) `(m + 3,)`, 0 for the fixed coefficients
    pull: FloatArray  # A' force `(m + 3,)`
    band: FloatArray  # The matrix by diagonals, then its factors `(4, m + 3)`


class Solution(NamedTuple):
    """The result of `solve`."""

    curve: FloatArray  # x, x', x'' `(3, n)`, to be used only where `status` is `SOLVED`
    status: int  # A key of `STATUS`
    iterations: int  # Number of factorised matrices
    primal: float  # Largest residual of (5), m; `dual` of (4), m
    dual: float
    gap: float  # Sum of the products (6), m2
    # Largest violation of the problem's bounds, in the units of the row (`largest_violation`)
    violation: float


@kernel
def solve(problem: PiecewiseJerkProblem, accuracy: float, max_iterations: int) -> Solution:
    """The curve of a problem, at most `accuracy` m from the optimum."""
    rows = rows_of(problem)
    point, step = _blank(rows), _blank(rows)
    size, ends = len(point.y), len(point.c)
    newton = Newton(
        np.empty((2, size)),
        np.empty((2, size)),
        np.empty((2, size)),
        np.empty(size),
        np.empty(size),
        np.empty(size),
        np.empty(ends),
        np.empty(ends),
        np.empty((4, ends)),
    )
    coast(problem, point.c)
    apply(rows.stencil, point.c, point.y)
    status, iteration = _fault(problem), 0
    primal, dual = np.nan, np.nan
    gap = np.nan
    if status == SPENT and max_iterations > 0:
        iteration = 1
        free = _to_free_optimum(rows, point, newton, step)
        primal = 0.0
        for i in range(size):
            primal = max(primal, rows.bound[0, i] - point.y[i], point.y[i] - rows.bound[1, i])
        # Rounding of a bound decides nothing
        if primal <= RESIDUAL * accuracy and free <= RESIDUAL * accuracy:
            status, dual, gap = SOLVED, free, 0.0
    if status == SPENT:
        _open(rows, point)
    least = FLOOR * 0.5 * accuracy**2 / point.slack.size
    while status == SPENT:
        primal, dual, gap = _residuals(rows, point, newton)
        status = _verdict(rows, point, newton, primal, dual, gap, accuracy)
        if status != SPENT or iteration == max_iterations:
            break
        iteration += 1
        proximal = min(
            PROXIMAL, PROXIMAL_M / max(_largest(point.multiplier[0]), _largest(point.multiplier[1]))
        )
        together = problem.soft > 0.0 or gap <= NEARLY * accuracy**2  # (9)
        _assemble(rows, point, newton, proximal)
        if not factorise(newton.band):
            status = BROKEN
            break
        _direction(rows, point, newton, step, proximal)
        primal_step, dual_step = _step_lengths(point, newton, step, 1.0, together)
        mu = gap / point.slack.size
        after = _gap_after(point, step, primal_step, dual_step) / point.slack.size
        target = max((after / mu) ** 3 * mu, least)  # (9): centring, and the second-order term
        for side in range(2):
            for i in range(newton.product.shape[1]):
                newton.product[side, i] += step.slack[side, i] * step.multiplier[side, i] - target
        _direction(rows, point, newton, step, proximal)
        primal_step, dual_step = _step_lengths(point, newton, step, TO_BOUNDARY, together)
        for i in range(ends):
            point.c[i] += primal_step * step.c[i]
        for i in range(size):
            point.y[i] += primal_step * step.y[i]
        for side in range(2):
            for i in range(size):
                point.slack[side, i] += primal_step * step.slack[side, i]
                point.multiplier[side, i] += dual_step * step.multiplier[side, i]
    curve = curve_of(point.c, problem.step)
    return Solution(curve, status, iteration, primal, dual, gap, largest_violation(problem, curve))


@inner_kernel
def _fault(problem: PiecewiseJerkProblem) -> int:
    """The status of a problem that cannot be solved: `CROSSED` or `NOT_FINITE`; else `SPENT`."""
    kinds, n = problem.lower.shape
    for k in range(kinds):
        first = 0 if k == DDDX else 1
        for i in range(first, n - 1 + first):
            if not problem.lower[k, i] <= problem.upper[k, i]:
                return CROSSED
    total = problem.start[0] + problem.start[1] + problem.start[2]
    for i in range(n):
        total += problem.references[0, i] + problem.references[1, i]
    return SPENT if isfinite(total) else NOT_FINITE


@inner_kernel
def _to_free_optimum(rows: Rows, point: Point, newton: Newton, step: Point) -> float:
    """Move c and y to the optimum without bounds.

    The residual of (4) there, inf where the matrix is not finite.
    """
    multiply(rows.stencil, rows.cost, newton.band)
    if not factorise(newton.band):
        return np.inf
    _pull(rows, point, newton)
    for i in range(len(step.c)):
        step.c[i] = -newton.dual[i]
    back_substitute(newton.band, step.c)
    for i in range(len(step.c)):
        point.c[i] += step.c[i]
    apply(rows.stencil, point.c, point.y)
    _pull(rows, point, newton)
    return _largest(newton.dual)


@inner_kernel
def _pull(rows: Rows, point: Point, newton: Newton) -> None:
    """Write A' q (y - r), the cost's slope, of the free coefficients into `newton.dual`."""
    for i in range(len(point.y)):
        newton.push[i] = rows.cost[i] * (point.y[i] - rows.wanted[i])
    gather(rows.stencil, newton.push, newton.dual)
    newton.dual[:3] = 0.0


@inner_kernel
def _open(rows: Rows, point: Point) -> None:
    """Write first slacks, well inside the bounds, and multipliers to match."""
    size = len(rows.cost)
    for i in range(size):
        low, high = rows.bound[0, i], rows.bound[1, i]
        least = START_SHARE * min(max(high - low, START_LEAST_M), START_MOST_M)
        point.slack[0, i] = max(point.y[i] - low, least)
        point.slack[1, i] = max(high - point.y[i], least)
        for side in range(2):
            point.multiplier[side, i] = START_MU / point.slack[side, i]


@inner_kernel
def _blank(rows: Rows) -> Point:
    size = len(rows.cost)
    ends = size // len(rows.stencil) + 3
    return Point(
        np.zeros(ends), np.zeros(size), np.zeros(size), np.zeros((2, size)), np.zeros((2, size))
    )


@inner_kernel
def _largest(values: FloatArray) -> float:
    """Largest magnitude."""
    most = 0.0
    for i in range(len(values)):
        most = max(most, abs(values[i]))
    return most


@inner_kernel
def _residuals(rows: Rows, point: Point, newton: Newton) -> tuple[float, float, float]:
    """Write residuals (4), (5) and products (6).

    Return the largest of (5), of (4), and the sum of the products.
    """
    y, force = point.y, point.force
    slack, multiplier = point.slack, point.multiplier
    give, bound = rows.give, rows.bound
    primal, product = newton.primal, newton.product
    size = len(y)
    for i in range(size):
        force[i] = multiplier[0, i] - multiplier[1, i]
    for i in range(size):
        value = y[i] + give[i] * force[i]
        primal[0, i] = (value - bound[0, i]) - slack[0, i]  # (5)
        primal[1, i] = -(value - bound[1, i]) - slack[1, i]
    for side in range(2):
        for i in range(size):
            product[side, i] = slack[side, i] * multiplier[side, i]  # (6)
    gap = 0.0
    for i in range(size):
        gap += product[0, i] + product[1, i]
    gather(rows.stencil, point.force, newton.pull)
    _pull(rows, point, newton)
    for i in range(3, len(newton.dual)):
        newton.dual[i] -= newton.pull[i]  # (4)
    return max(_largest(primal[0]), _largest(primal[1])), _largest(newton.dual), gap


@inner_kernel
def _verdict(
    rows: Rows,
    point: Point,
    newton: Newton,
    primal: float,
    dual: float,
    gap: float,
    accuracy: float,
) -> int:
    """`SOLVED` by (10), `INFEASIBLE` by (11), else `SPENT`."""
    left, small = _largest(newton.pull[3:]), RESIDUAL * accuracy
    if primal <= small:
        # (10)
        return SOLVED if gap <= 0.5 * accuracy**2 and dual <= small * (1.0 + left) else SPENT
    force, multiplier = point.force, point.multiplier
    give, bound = rows.give, rows.bound
    excess, size = 0.0, len(force)
    for i in range(size):
        excess += bound[0, i] * multiplier[0, i] - bound[1, i] * multiplier[1, i]
        left = max(left, give[i] * abs(force[i]))
    for i in range(3):
        excess -= newton.pull[i] * point.c[i]
    return INFEASIBLE if left < FARKAS * excess else SPENT  # (11)


@inner_kernel
def _assemble(rows: Rows, point: Point, newton: Newton, proximal: float) -> None:
    """Write the matrix of (7) by its lower diagonals.

    The fixed coefficients get rows of the identity.
    """
    slack, multiplier, inverse = point.slack, point.multiplier, newton.inverse
    softening, stiffness, push = newton.softening, newton.stiffness, newton.push
    cost, give = rows.cost, rows.give
    size = len(cost)
    for side in range(2):
        for i in range(size):
            inverse[side, i] = 1.0 / slack[side, i]
    for i in range(size):
        stiffness[i] = multiplier[0, i] * inverse[0, i] + multiplier[1, i] * inverse[1, i]
    for i in range(size):
        softening[i] = 1.0 / (1.0 + (give[i] + proximal) * stiffness[i])
    for i in range(size):
        stiffness[i] *= softening[i]
    for i in range(size):
        push[i] = cost[i] + stiffness[i]
    multiply(rows.stencil, newton.push, newton.band)


@inner_kernel
def _direction(rows: Rows, point: Point, newton: Newton, step: Point, proximal: float) -> None:
    """Write Newton's step (7), (8) for the products in `newton`."""
    multiplier, inverse, give = point.multiplier, newton.inverse, rows.give
    primal, product, push = newton.primal, newton.product, newton.push
    size = len(push)
    softening, stiffness = newton.softening, newton.stiffness
    for i in range(size):
        below = (product[0, i] + multiplier[0, i] * primal[0, i]) * inverse[0, i]
        above = (product[1, i] + multiplier[1, i] * primal[1, i]) * inverse[1, i]
        push[i] = (above - below) * softening[i]  # (7)
    gather(rows.stencil, newton.push, step.c)
    for i in range(len(step.c)):
        step.c[i] = step.c[i] - newton.dual[i] if i > 2 else 0.0
    back_substitute(newton.band, step.c)
    apply(rows.stencil, step.c, step.y)
    dy, slack, change = step.y, step.slack, step.multiplier
    for i in range(size):
        # (8): dy + give d force
        push[i] = dy[i] + (give[i] + proximal) * (push[i] - stiffness[i] * dy[i])
    for i in range(size):
        slack[0, i] = push[i] + primal[0, i]
        slack[1, i] = -push[i] + primal[1, i]
    for side in range(2):
        for i in range(size):
            change[side, i] = (
                -(product[side, i] + multiplier[side, i] * slack[side, i]) * inverse[side, i]
            )


@inner_kernel
def _step_lengths(
    point: Point, newton: Newton, step: Point, share: float, together: bool
) -> tuple[float, float]:
    """Primal and dual share of a step up to which slacks and multipliers stay positive, times
    `share`; 1 at most.
    """
    slack, multiplier, inverse = step.slack, step.multiplier, newton.inverse
    below = above = pull = push = 0.5  # four independent chains of operations
    for i in range(slack.shape[1]):
        below = max(below, -slack[0, i] * inverse[0, i])
        above = max(above, -slack[1, i] * inverse[1, i])
        pull = max(pull, -multiplier[0, i] / point.multiplier[0, i])
        push = max(push, -multiplier[1, i] / point.multiplier[1, i])
    primal, dual = min(1.0, share / max(below, above)), min(1.0, share / max(pull, push))
    return (min(primal, dual), min(primal, dual)) if together else (primal, dual)


@inner_kernel
def _gap_after(point: Point, step: Point, primal: float, dual: float) -> float:
    """Sum of the products z f after a step."""
    slack, opening = point.slack, step.slack
    multiplier, change = point.multiplier, step.multiplier
    total, size = 0.0, slack.shape[1]
    for i in range(size):
        below = (slack[0, i] + primal * opening[0, i]) * (multiplier[0, i] + dual * change[0, i])
        above = slack[1, i] + primal * opening[1, i]
        total += below + above * (multiplier[1, i] + dual * change[1, i])
    return total
