"""Piecewise-jerk constraints, shared by the path QP (over station) and the speed QP (over time).

Variables at n knots, step h: z = (x_0 .. x_{n-1}, x'_0 .., x''_0 ..), the third derivative constant between knots
(Zhang et al., "Optimal Vehicle Path Planning Using Quadratic Optimization for Baidu Apollo Open Platform", 2020):

(1) x'_{i+1} = x'_i + h/2 (x''_i + x''_{i+1})
(2) x_{i+1}  = x_i + h x'_i + h^2/3 x''_i + h^2/6 x''_{i+1}
(3) lower <= (x, x', x'') <= upper                            at each knot
(4) lower <= (x''_{i+1} - x''_i) / h <= upper                 third derivative
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from logs.kernel import FloatArray


def constraint_matrix(knots: int, step: float) -> sparse.csc_matrix:
    """The rows of (1), (2), (3), (4) in this order: `((n-1) + (n-1) + 3n + (n-1), 3n)`."""
    now, then = sparse.eye(knots - 1, knots), sparse.eye(knots - 1, knots, k=1)
    none = sparse.csc_matrix((knots - 1, knots))
    first = sparse.hstack([none, now - then, 0.5 * step * (now + then)])  # (1)
    zeroth = sparse.hstack([now - then, step * now, step**2 / 3.0 * now + step**2 / 6.0 * then])  # (2)
    third = sparse.hstack([none, none, (then - now) / step])  # (4)
    return sparse.vstack([first, zeroth, sparse.eye(3 * knots), third], format="csc")


def bounds(
    lower: tuple[FloatArray, FloatArray, FloatArray],
    upper: tuple[FloatArray, FloatArray, FloatArray],
    third: tuple[float | FloatArray, float | FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Lower and upper vectors of `constraint_matrix` from knot bounds `(n,)` of x, x', x'' and of x''' `(n-1,)`."""
    knots = len(lower[0])
    dynamics = np.zeros(2 * (knots - 1))
    return (
        np.concatenate([dynamics, *lower, np.broadcast_to(third[0], knots - 1)]),
        np.concatenate([dynamics, *upper, np.broadcast_to(third[1], knots - 1)]),
    )


def difference_penalty(knots: int) -> sparse.csc_matrix:
    """D' D with (D x)_i = x_{i+1} - x_i: `(n, n)`."""
    D = sparse.eye(knots - 1, knots, k=1) - sparse.eye(knots - 1, knots)
    return (D.T @ D).tocsc()
