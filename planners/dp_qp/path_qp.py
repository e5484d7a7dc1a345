"""Path QP: the smoothest path in the corridor (paper, eq. 18, with the squares inside the sums).

Unknown l, l', l'' at knots s_i, step h, piecewise-constant l''' (`piecewise_jerk`). Minimise J_1 + ... + J_5 with

(1) J_1 = w_ref  sum l_i^2                       the reference line
(2) J_2 = w_dl   sum l'_i^2                      The paper prints (sum l')^2, which telescopes to the end points and
(3) J_3 = w_ddl  sum l''_i^2                     does not see oscillation.
(4) J_4 = w_dddl sum (l''_{i+1} - l''_i)^2 / h^2
(5) J_5 = w_mid  sum (l_i - (l_min,i + l_max,i) / 2)^2

subject to l_min <= l <= l_max, |l'| <= MAX_DL, |l'' + kappa_r| <= kappa_max, |l'''| <= MAX_DDDL,
and the start (l, l', l'').
(6) A start beyond these bounds comes back to them from the second knot on, with half the steering and half the jerk.

The weights grow with the length that a lane shift takes at the speed: w_dl = (a/2)^2, w_ddl = a^4, w_dddl = (0.7 a)^6
with the settling length a (m).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from logs.kernel import FloatArray
from logs.trace import CostTerms
from planners.dp_qp import piecewise_jerk
from planners.qp import QPConfig, QPResult, QuadraticProgram

MAX_DL = 1.0
MAX_DDDL = 1.0


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


class PathQp:
    """The path QP over one length: a workspace with constant matrices.

    Args:
        length: From first to last knot, m.
        speed: For which the weights are chosen, m/s.
        config: Settings.
    """

    def __init__(self, length: float, speed: float, config: PathQpConfig) -> None:
        self.length, self.knots = length, config.knots
        self.step = length / (config.knots - 1)
        settle = max(config.settle_s * speed, config.min_settle_m)
        self._weights = (config.w_ref, (0.5 * settle) ** 2, settle**4, (0.7 * settle) ** 6, config.w_mid)
        w_ref, w_dl, w_ddl, w_dddl, w_mid = self._weights
        eye = sparse.eye(self.knots)
        third = piecewise_jerk.difference_penalty(self.knots) * (w_dddl / self.step**2)
        P = 2.0 * sparse.block_diag([(w_ref + w_mid) * eye, w_dl * eye, w_ddl * eye + third], format="csc")
        A = piecewise_jerk.constraint_matrix(self.knots, self.step)
        self._scale = 1.0 / (w_ref + w_mid)
        sizes = np.repeat([1.0, 2.0 / settle, 4.0 / settle**2], self.knots)
        self._program = QuadraticProgram(
            "path QP",
            sparse.csc_matrix(self._scale * P),
            A,
            equalities=2 * (self.knots - 1),
            scale=sizes,
            config=QPConfig(tolerance=1e-2),
        )

    def solve(
        self,
        start: tuple[float, float, float],
        lower: FloatArray,
        upper: FloatArray,
        kappa: FloatArray,
        max_kappa: float,
        *,
        fresh: bool,
    ) -> tuple[QPResult, CostTerms]:
        """The path in a corridor.

        Args:
            start: l, l', l'' at the first knot.
            lower: Corridor `(knots,)`, m.
            upper: `(knots,)`, m.
            kappa: Curvature of the reference line at the knots `(knots,)`, 1/m.
            max_kappa: Of the vehicle, 1/m.
            fresh: Forget the last solution.

        Returns:
            The result, x = (l, l', l'') `(3 knots,)`, and the five costs.
        """
        d = self.step * np.maximum(np.arange(self.knots) - 1, 0)
        turned, bent = 0.5 * max_kappa * d, 0.5 * MAX_DDDL * d  # (6)
        low = [lower.copy(), np.minimum(-MAX_DL, start[1] + turned), np.minimum(-max_kappa - kappa, start[2] + bent)]
        high = [upper.copy(), np.maximum(MAX_DL, start[1] - turned), np.maximum(max_kappa - kappa, start[2] - bent)]
        for k in range(3):
            low[k][0] = high[k][0] = start[k]
        bounds = piecewise_jerk.bounds((low[0], low[1], low[2]), (high[0], high[1], high[2]), (-MAX_DDDL, MAX_DDDL))
        middle = 0.5 * (lower + upper)
        q = np.zeros(3 * self.knots)
        q[: self.knots] = -2.0 * self._scale * self._weights[4] * middle
        result = self._program.solve(q, *bounds, fresh=fresh)
        return result, self._costs(result.x, middle)

    def _costs(self, x: FloatArray, middle: FloatArray) -> CostTerms:
        l, dl, ddl = x.reshape(3, self.knots)  # noqa: E741
        w_ref, w_dl, w_ddl, w_dddl, w_mid = self._weights
        values = {
            "reference": w_ref * float(l @ l),
            "slope": w_dl * float(dl @ dl),
            "curvature": w_ddl * float(ddl @ ddl),
            "curvature rate": w_dddl * float(np.sum(np.diff(ddl) ** 2)) / self.step**2,
            "centre": w_mid * float((l - middle) @ (l - middle)),
        }
        return CostTerms("path QP", tuple(values.items()))
