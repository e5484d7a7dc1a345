"""Path QP: the smoothest path in the corridor (paper, eq. 18, with the squares inside the sums).

Unknown l, l', l'' at knots s_i, step h, piecewise-constant l''' (`piecewise_jerk`). Minimise J_1 + ... + J_5 with

(1) J_1 = w_ref  sum l_i^2                       the reference line
(2) J_2 = w_dl   sum l'_i^2                      The paper prints (sum l')^2, which telescopes to the end points and
(3) J_3 = w_ddl  sum l''_i^2                     does not see oscillation.
(4) J_4 = w_dddl sum (l''_{i+1} - l''_i)^2 / h^2
(5) J_5 = w_mid  sum (l_i - (l_min,i + l_max,i) / 2)^2

subject to the start (l, l', l''), bounds of l' and l'', of l''', and, for each of the ego's points `lead` m before the
rear axle (itself the first, lead 0),

(6) l_min,k <= l + lead_k l' <= l_max,k

A corridor that has no solution is asked for once more with (6) softened: a shift e of each bound is paid for with
OUTSIDE e^2, so that the path leaves the corridor as little as it must.

The weights grow with the length that a lane shift takes at the speed: w_dl = (a/2)^2, w_ddl = a^4, w_dddl = (0.7 a)^6
with the settling length a (m).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy import sparse

from logs.kernel import FloatArray, frozen
from logs.trace import CostTerms
from planners.dp_qp import piecewise_jerk
from planners.qp import QPConfig, QPResult, QuadraticProgram

MAX_DL = 1.0
OUTSIDE = 1e4


@dataclass(frozen=True)
class PathQpConfig:
    """Knots and weights of the path QP.

    Attributes:
        knots: Number of knots.
        w_ref: Weight of l^2, 1/m2.
        w_mid: Weight of the distance to the middle of the corridor, 1/m2.
        settle_s: The settling length is this times the speed, s.
        min_settle_m: And not less than this, m.
    """

    knots: int = 80
    w_ref: float = 1.0
    w_mid: float = 0.1
    settle_s: float = 1.2
    min_settle_m: float = 4.0

    def __post_init__(self) -> None:
        if self.knots < 10 or not (self.w_ref > 0.0 and self.w_mid >= 0.0 and self.settle_s > 0.0):
            raise ValueError("path QP needs at least 10 knots and positive weights")


@dataclass(frozen=True, eq=False, slots=True)
class PathProblem:
    """One path problem.

    Attributes:
        start: l, l', l'' at the first knot `(3,)`.
        lower: Bounds (6) `(points, knots)`, m; `upper` likewise.
        slope: Lower and upper bound of l' `(2, knots)`.
        bend: Of l'' `(2, knots)`, 1/m.
        rate: Of l''' `(2, knots - 1)`, 1/m2.
    """

    start: FloatArray
    lower: FloatArray
    upper: FloatArray
    slope: FloatArray
    bend: FloatArray
    rate: FloatArray


class PathQp:
    """The path QP over one length: workspaces with constant matrices.

    Args:
        length: From first to last knot, m.
        speed: For which the weights are chosen, m/s.
        leads: Points of (6), m before the rear axle; the first is 0.
        config: Settings.
    """

    def __init__(self, length: float, speed: float, leads: tuple[float, ...], config: PathQpConfig) -> None:
        self.length, self.knots, self.leads = length, config.knots, leads
        self.step = length / (config.knots - 1)
        self._settle = max(config.settle_s * speed, config.min_settle_m)
        a = self._settle
        self._weights = (config.w_ref, (0.5 * a) ** 2, a**4, (0.7 * a) ** 6, config.w_mid)
        self._scale = 1.0 / (config.w_ref + config.w_mid)
        self._hard = self._program(soft=False)
        self._soft: QuadraticProgram | None = None

    def solve(self, problem: PathProblem, *, softly: bool = False) -> tuple[QPResult, CostTerms]:
        """The path in a corridor.

        Args:
            problem: Its start and bounds.
            softly: With the corridor softened; such problems are rare, and each is solved afresh.

        Returns:
            The result, x = (l, l', l'') `(3 knots,)`, and the five costs.
        """
        if softly:
            self._soft = self._soft or self._program(soft=True)
            return self._told(self._soft.solve(*self._vectors(problem, soft=True), fresh=True), problem)
        return self._told(self._hard.solve(*self._vectors(problem, soft=False), fresh=True), problem)

    def _program(self, *, soft: bool) -> QuadraticProgram:
        P, A, sizes = _matrices(self.knots, self.step, self._weights, self.leads, self._settle, soft)
        return QuadraticProgram(
            "path QP without its corridor" if soft else "path QP",
            P,
            A,
            equalities=2 * (self.knots - 1),
            scale=sizes,
            config=QPConfig(tolerance=1e-2),
        )

    def _vectors(self, problem: PathProblem, *, soft: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
        """q, lower and upper of the program."""
        n = self.knots
        low = [problem.lower[0].copy(), problem.slope[0].copy(), problem.bend[0].copy()]
        high = [problem.upper[0].copy(), problem.slope[1].copy(), problem.bend[1].copy()]
        for k in range(3):
            low[k][0] = high[k][0] = problem.start[k]
        rate = problem.rate
        lower, upper = piecewise_jerk.bounds((low[0], low[1], low[2]), (high[0], high[1], high[2]), (rate[0], rate[1]))
        q = np.zeros((3 + soft * len(self.leads)) * n)
        q[:n] = -self._scale * self._weights[4] * (problem.lower[0] + problem.upper[0])
        return q, np.r_[lower, problem.lower[1:].ravel()], np.r_[upper, problem.upper[1:].ravel()]

    def _told(self, result: QPResult, problem: PathProblem) -> tuple[QPResult, CostTerms]:
        x = result.x[: 3 * self.knots]
        l, dl, ddl = x.reshape(3, self.knots)  # noqa: E741
        middle = 0.5 * (problem.lower[0] + problem.upper[0])
        w_ref, w_dl, w_ddl, w_dddl, w_mid = self._weights
        values = {
            "reference": w_ref * float(l @ l),
            "slope": w_dl * float(dl @ dl),
            "curvature": w_ddl * float(ddl @ ddl),
            "curvature rate": w_dddl * float(np.sum(np.diff(ddl) ** 2)) / self.step**2,
            "centre": w_mid * float((l - middle) @ (l - middle)),
        }
        return QPResult(x, result.report), CostTerms("path QP", tuple(values.items()))


@cache
def _matrices(
    n: int, step: float, weights: tuple[float, ...], leads: tuple[float, ...], settle: float, soft: bool
) -> tuple[sparse.csc_matrix, sparse.csc_matrix, FloatArray]:
    """P, A and the sizes of the unknowns of the program of one length: every lane has its own workspace of it."""
    points = len(leads)
    w_ref, w_dl, w_ddl, w_dddl, w_mid = weights
    eye, none = sparse.eye(n), sparse.csc_matrix((n, n))
    third = piecewise_jerk.difference_penalty(n) * (w_dddl / step**2)
    blocks = [(w_ref + w_mid) * eye, w_dl * eye, w_ddl * eye + third]
    A = piecewise_jerk.constraint_matrix(n, step)
    ahead = [sparse.hstack([eye, lead * eye, none]) for lead in leads[1:]]
    A = sparse.vstack([A, *ahead], format="csc")
    sizes = np.repeat([1.0, 2.0 / settle, 4.0 / settle**2], n)
    if soft:
        first, last = 2 * (n - 1) + 1, A.shape[0] - (points - 1) * n  # the start is no bound that gives way
        rows = np.r_[np.arange(first, first + n - 1), np.arange(last, A.shape[0])]
        columns = np.arange(1, points * n)
        shifts = sparse.csc_matrix((np.ones(len(rows)), (rows, columns)), (A.shape[0], points * n))
        A = sparse.hstack([A, shifts], format="csc")
        blocks.append(OUTSIDE * sparse.eye(points * n))
        sizes = np.r_[sizes, np.full(points * n, 0.1)]
    P = sparse.csc_matrix(2.0 / (w_ref + w_mid) * sparse.block_diag(blocks, format="csc"))
    return P, A, frozen(sizes)
