"""Path QP: the smoothest path in the corridor (paper, eq. 18, with the squares inside the sums).

Unknown l, l', l'' at knots s_i, step h, piecewise-constant l''' (`replan.planners.piecewise_jerk`).
Minimise J_1 + ... + J_5 with

(1) J_1 = w_ref  sum l_i^2                       the reference line
(2) J_2 = w_dl   sum l'_i^2
        The paper prints (sum l')^2, which telescopes to the end points and
(3) J_3 = w_ddl  sum l''_i^2                     does not see oscillation.
(4) J_4 = w_dddl sum (l''_{i+1} - l''_i)^2 / h^2
(5) J_5 = w_mid  sum (l_i - (l_min,i + l_max,i) / 2)^2

subject to the start (l, l', l''), bounds of l' and l'', of l''', and, for each of the ego's points
`lead` m before the rear axle (itself the first, lead 0),

(6) l_min,k <= l + lead_k l' <= l_max,k

Where a corridor has no solution, the problem is solved again with (6) softened: a shift e of each
bound costs OUTSIDE e^2, so that the path leaves the corridor as little as it must.

The weights grow with the length that a lane shift takes at the speed: w_dl = (a/2)^2, w_ddl = a^4,
w_dddl = (0.7 a)^6 with the settling length a (m).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from msgspec import Meta

from replan.core.arrays import FloatArray
from replan.core.settings import Config, NotNegative, Positive
from replan.logs.plan import CostTerms
from replan.planners.piecewise_jerk.problem import PiecewiseJerkProblem, Weights, X
from replan.planners.piecewise_jerk.solvers import DEFAULT, solve
from replan.planners.solver import QPResult

OUTSIDE = 1e4  # Cost of a shift of (6), softened, 1/m2
TOLERANCE = 1e-2  # Largest violation of a bound in a solution, in the units of the row


@dataclass(frozen=True)
class PathQpConfig(Config):
    """Knots and weights of the path QP."""

    knots: Annotated[int, Meta(ge=10)] = 80
    """Number of knots."""
    w_ref: Positive = 1.0
    """Weight of the squared offset from the reference line, 1/m2."""
    w_mid: NotNegative = 0.1
    """Weight of the squared distance to the middle of the corridor, 1/m2."""
    settle_s: Positive = 1.2
    """Length of a lane shift per speed; the weights of the path's derivatives grow with it."""
    min_settle_m: NotNegative = 4.0
    """Least length of a lane shift."""


class PathQp:
    """The path QP over one length, m, with weights for a speed, m/s.

    `leads` are those of (6), m before the rear axle; the first is 0. `solver` is one of
    `replan.planners.piecewise_jerk.solvers`.
    """

    def __init__(
        self,
        length: float,
        speed: float,
        leads: tuple[float, ...],
        config: PathQpConfig,
        solver: str = DEFAULT,
    ) -> None:
        self.length, self.knots, self.leads = length, config.knots, leads
        self.step = length / (config.knots - 1)
        a = max(config.settle_s * speed, config.min_settle_m)
        self.middle = 0.5 * config.w_mid / (config.w_ref + config.w_mid)
        self._config, self._solver, self._ahead = config, solver, np.array(leads[1:], dtype=float)
        # (1) to (5)
        self._weights = Weights(config.w_ref + config.w_mid, (0.5 * a) ** 2, a**4, (0.7 * a) ** 6)

    def solve(self, problem: PiecewiseJerkProblem, *, softly: bool = False) -> QPResult:
        """The path in a corridor, which may give way (`softly`): x = (l, l', l'') `(3 knots,)`."""
        stage = "path QP without its corridor" if softly else "path QP"
        asked = problem._replace(soft=OUTSIDE) if softly else problem
        return solve(asked, self._solver, stage=stage, tolerance=TOLERANCE)

    def stated(
        self, start: FloatArray, references: FloatArray, rows: FloatArray
    ) -> PiecewiseJerkProblem:
        """The problem (1)-(6) for a start (l, l', l'') `(3,)`, with references and rows from
        `corridor.loosen_bounds`.

        (1) and (5) together are one square about a point between them:
                `middle` times the sum of the bounds.
        """
        return PiecewiseJerkProblem(
            self.step, self._ahead, start, self._weights, references, rows[0], rows[1], 0.0
        )

    def costs(self, x: FloatArray, problem: PiecewiseJerkProblem) -> CostTerms:
        """(1) to (5) of a path, by term."""
        l, dl, ddl = x.reshape(3, self.knots)
        middle = 0.5 * (problem.lower[X] + problem.upper[X])
        weights = self._weights
        values = {
            "reference": self._config.w_ref * float(l @ l),
            "slope": weights.dx * float(dl @ dl),
            "curvature": weights.ddx * float(ddl @ ddl),
            "curvature rate": weights.dddx * float(np.sum(np.diff(ddl) ** 2)) / self.step**2,
            "centre": self._config.w_mid * float((l - middle) @ (l - middle)),
        }
        return CostTerms("path QP", tuple(values.items()))
