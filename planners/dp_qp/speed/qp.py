"""Speed QP: the smoothest speed profile between the bounds that the speed DP decided.

Unknown s, v, a at knots every 0.1 s, piecewise-constant jerk (`planners.piecewise_jerk`). Minimise

(1) sum w_s (s - s_ref)^2 + w_v (v - v_ref)^2 + w_a a^2 + w_j jerk^2

subject to s_lower(t) <= s <= s_upper(t) from the decisions, 0 <= v <= v_limit, a and jerk limits, and the start.

(2) v_limit(sigma) = min(limit, sqrt(a_lat / |kappa|)), lowered so that it can be reached with a comfortable
    deceleration b:  v(sigma)^2 <= v(sigma + d)^2 + 2 b d
(3) Which limits of acceleration and jerk: `braking` takes the mildest with which braking keeps s_upper, so that the
    problem has a solution. Braking that is harder than comfort may be let go with `RELEASE_MPS3`.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np

from logs.kernel import FloatArray
from logs.trace import CostTerms
from planners.frenet.profiles import COMFORT, EMERGENCY, STEP_S, Limits, SpeedLimits
from planners.piecewise_jerk.problem import PiecewiseJerkProblem, Weights
from planners.piecewise_jerk.solvers import DEFAULT, solve
from planners.qp import QPResult

TOLERANCE = 0.05
"""By which a solution may violate a bound, in the units of the row."""
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
    """The speed QP.

    Args:
        config: Settings.
        solver: Name of a solver of `planners.piecewise_jerk.solvers`.
    """

    def __init__(self, config: SpeedQpConfig, solver: str = DEFAULT) -> None:
        self._config, self._solver = config, solver

    def solve(self, problem: SpeedProblem, limits: Limits) -> QPResult:
        """The profile, x = (s, v, a) `(3 knots,)`."""
        return solve(self.stated(problem, limits), self._solver, stage="speed QP", tolerance=TOLERANCE)

    def stated(self, problem: SpeedProblem, limits: Limits) -> PiecewiseJerkProblem:
        """(1) with its bounds."""
        c, n = self._config, self._config.knots
        v0, a0 = problem.start
        jerk = limits.row("jerk_mps3", n)
        ramp = np.r_[0.0, STEP_S * np.cumsum(jerk[:-1])]
        low_a = np.minimum(-limits.row("decel_mps2", n), a0 + 0.5 * ramp)
        high_a = np.maximum(limits.row("accel_mps2", n), a0 - 0.5 * ramp)
        harder = max(-c.comfort.decel_mps2 - a0, 0.0)
        release = np.where(np.arange(n) < harder / (RELEASE_MPS3 * STEP_S), RELEASE_MPS3, 0.0)
        lower = np.vstack([np.minimum(problem.lower, problem.upper), np.zeros(n), low_a, -jerk])
        upper = np.vstack([problem.upper, problem.limit, high_a, np.maximum(jerk, release)])
        references, weights = np.vstack([problem.s_ref, problem.v_ref]), Weights(c.w_s, c.w_v, c.w_a, c.w_j)
        return PiecewiseJerkProblem(
            STEP_S, np.empty(0), np.array([0.0, v0, a0]), weights, references, lower, upper, 0.0
        )

    def costs(self, x: FloatArray, problem: SpeedProblem) -> CostTerms:
        """(1) of a profile, by term."""
        s, v, a = x.reshape(3, self._config.knots)
        c = self._config
        values = {
            "station": c.w_s * float(np.sum((s - problem.s_ref) ** 2)),
            "speed": c.w_v * float(np.sum((v - problem.v_ref) ** 2)),
            "acceleration": c.w_a * float(a @ a),
            "jerk": c.w_j * float(np.sum(np.diff(a) ** 2)) / STEP_S**2,
        }
        return CostTerms("speed QP", tuple(values.items()))
