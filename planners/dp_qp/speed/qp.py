"""Speed QP: the smoothest speed profile between the bounds that the speed DP decided.

Unknown s, v, a at knots every 0.1 s, piecewise-constant jerk (`piecewise_jerk`). Minimise

(1) sum w_s (s - s_ref)^2 + w_v (v - v_ref)^2 + w_a a^2 + w_j jerk^2

subject to s_lower(t) <= s <= s_upper(t) from the decisions, 0 <= v <= v_limit, a and jerk limits, and the start.

(2) v_limit(sigma) = min(limit, sqrt(a_lat / |kappa|)), lowered so that it can be reached with a comfortable
    deceleration b:  v(sigma)^2 <= v(sigma + d)^2 + 2 b d
(3) Which limits of acceleration and jerk: `speed_solve` takes the mildest with which braking keeps s_upper, so that the
    problem has a solution. Braking that is harder than comfort may be let go with `RELEASE_MPS3`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import inf

import numpy as np
from scipy import sparse

from logs.kernel import FloatArray
from logs.trace import CostTerms
from planners.dp_qp import piecewise_jerk
from planners.frenet.profiles import COMFORT, EMERGENCY, STEP_S, Limits, SpeedLimits
from planners.qp import QPConfig, QPResult, QuadraticProgram

RELEASE_MPS3 = 10.0
"""Jerk with which braking that is harder than comfort may be let go."""


@dataclass(frozen=True)
class SpeedQpConfig:
    """Weights and limits of the speed QP.

    Attributes:
        knots: Number of knots, 0.1 s apart.
        w_s: Weights of (1); `w_v`, `w_a`, `w_j` likewise.
        comfort: Limits that are tried first.
        emergency: Limits where comfort cannot keep a bound.
        curve_accel_mps2: Lateral acceleration in curves.
        ease_mps2: Deceleration b of (2).
    """

    knots: int = 81
    w_s: float = 0.2
    w_v: float = 1.0
    w_a: float = 2.0
    w_j: float = 3.0
    comfort: SpeedLimits = COMFORT
    emergency: SpeedLimits = EMERGENCY
    curve_accel_mps2: float = 3.0
    ease_mps2: float = 1.5

    def __post_init__(self) -> None:
        if self.knots < 11 or not (self.curve_accel_mps2 > 0.0 and self.ease_mps2 > 0.0):
            raise ValueError("speed QP needs at least 11 knots and positive limits")

    def ladder(self) -> tuple[SpeedLimits, ...]:
        """From comfort to emergency, so that nobody brakes harder than is needed; jerk rises later than braking."""
        low, high = self.comfort, self.emergency
        decel, jerk = high.decel_mps2 - low.decel_mps2, high.jerk_mps3 - low.jerk_mps3
        between = (
            SpeedLimits(low.accel_mps2, low.decel_mps2 + u * decel, low.jerk_mps3 + u**4 * jerk)
            for u in (0.25, 0.5, 0.75)
        )
        return (low, *between, high)

    @property
    def horizon(self) -> float:
        """Length of the profile, s."""
        return (self.knots - 1) * STEP_S


@dataclass(frozen=True, eq=False, slots=True)
class SpeedProblem:
    """One speed problem; arrays `(knots,)`.

    Attributes:
        start: v, a of the ego.
        lower: Bounds of s, m; `upper` likewise.
        limit: Upper bound of v, m/s.
        s_ref: m; `v_ref` m/s.
        end: Station at which the path ends, m.
    """

    start: tuple[float, float]
    lower: FloatArray
    upper: FloatArray
    limit: FloatArray
    s_ref: FloatArray
    v_ref: FloatArray
    end: float = inf

    @property
    def overtakes(self) -> bool:
        """Whether somebody is to be overtaken: what one deceleration cannot, another cannot either."""
        return bool((self.lower > 0.0).any())


class SpeedQp:
    """The speed QP: a workspace with constant matrices."""

    def __init__(self, config: SpeedQpConfig) -> None:
        self._config = config
        n = config.knots
        P, A = _matrices(n, config.w_s, config.w_v, config.w_a, config.w_j)
        self._program = QuadraticProgram(
            "speed QP",
            P,
            A,
            equalities=2 * (n - 1),
            scale=np.repeat([20.0, 4.0, 2.0], n),
            config=QPConfig(tolerance=0.05),
        )

    def solve(self, problem: SpeedProblem, limits: Limits) -> tuple[QPResult, CostTerms]:
        """The profile, x = (s, v, a) `(3 knots,)`, and its costs."""
        n = self._config.knots
        v0, a0 = problem.start
        jerk = limits.row("jerk_mps3", n - 1)
        ramp = np.r_[0.0, STEP_S * np.cumsum(jerk)]
        low_a = np.minimum(-limits.row("decel_mps2", n), a0 + 0.5 * ramp)
        high_a = np.maximum(limits.row("accel_mps2", n), a0 - 0.5 * ramp)
        low = [np.minimum(problem.lower, problem.upper), np.zeros(n), low_a]
        high = [problem.upper.copy(), problem.limit.copy(), high_a]
        for k, value in enumerate((0.0, v0, a0)):
            low[k][0] = high[k][0] = value
        harder = max(-self._config.comfort.decel_mps2 - a0, 0.0)
        release = np.where(np.arange(n - 1) < harder / (RELEASE_MPS3 * STEP_S), RELEASE_MPS3, 0.0)
        thirds = -jerk, np.maximum(jerk, release)
        bounds = piecewise_jerk.bounds((low[0], low[1], low[2]), (high[0], high[1], high[2]), thirds)
        c = self._config
        q = np.concatenate([-2.0 * c.w_s * problem.s_ref, -2.0 * c.w_v * problem.v_ref, np.zeros(n)])
        result = self._program.solve(q, *bounds, fresh=True)
        return result, self._costs(result.x, problem)

    def _costs(self, x: FloatArray, problem: SpeedProblem) -> CostTerms:
        s, v, a = x.reshape(3, self._config.knots)
        c = self._config
        values = {
            "station": c.w_s * float(np.sum((s - problem.s_ref) ** 2)),
            "speed": c.w_v * float(np.sum((v - problem.v_ref) ** 2)),
            "acceleration": c.w_a * float(a @ a),
            "jerk": c.w_j * float(np.sum(np.diff(a) ** 2)) / STEP_S**2,
        }
        return CostTerms("speed QP", tuple(values.items()))


@cache
def _matrices(n: int, w_s: float, w_v: float, w_a: float, w_j: float) -> tuple[sparse.csc_matrix, sparse.csc_matrix]:
    """P and A of (1) and its constraints: every lane has its own workspace of them."""
    eye = sparse.eye(n)
    jerk = piecewise_jerk.difference_penalty(n) * (w_j / STEP_S**2)
    P = 2.0 * sparse.block_diag([w_s * eye, w_v * eye, w_a * eye + jerk], format="csc")
    return sparse.csc_matrix(P), piecewise_jerk.constraint_matrix(n, STEP_S)
