"""Speed QP: the smoothest speed profile between the bounds that the speed DP decided.

Unknown s, v, a at knots every 0.1 s, piecewise-constant jerk (`planners.piecewise_jerk`). Minimise

(1) sum w_s (s - s_ref)^2 + w_v (v - v_ref)^2 + w_a a^2 + w_j jerk^2

subject to s_lower(t) <= s <= s_upper(t) from the decisions, 0 <= v <= v_limit (`planners.frenet.profiles`, (1)), a and
jerk limits, and the start.

(2) `braking` takes the mildest limits of acceleration and jerk with which braking keeps s_upper, so that the problem
    has a solution. Braking that is harder than comfort may be released with `RELEASE_MPS3`, down to comfort.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from logs.arrays import FloatArray
from logs.kernel import kernel
from logs.plan import CostTerms
from planners.frenet.profiles import COMFORT, EMERGENCY, STEP_S, KnotLimits, SpeedLimits, braking
from planners.piecewise_jerk.problem import PiecewiseJerkProblem, Weights
from planners.piecewise_jerk.solvers import DEFAULT, solve
from planners.solver import QPResult

Rows = tuple[FloatArray, FloatArray, FloatArray, FloatArray]  # The result of `rows_of`
NO_LEADS = np.empty(0)  # A speed profile has no points ahead of the rear axle
LIMIT_ROOM_MPS = 0.05  # Distance of the speed's bound above the braking profile that must stay below it, m/s
REST_MPS = 1e-3  # Speed below which a profile rests, m/s ...
REST_MPS2 = 0.02  # ... and acceleration, m/s2.
TOLERANCE = 0.05  # Largest violation of a bound in a solution, in the units of the row
RELEASE_MPS3 = 15.0  # Jerk with which braking that is harder than comfort may be released, m/s3


@dataclass(frozen=True)
class SpeedQpConfig:
    """Weights and limits of the speed QP.

    Attributes:
        knots: Number of knots, 0.1 s apart.
        w_s: Weight of the squared distance to the reference station.
        w_v: Weight of the squared difference from the reference speed.
        w_a: Weight of the squared acceleration.
        w_j: Weight of the squared jerk.
        comfort: Limits to try first.
        emergency: Limits where comfort cannot keep a bound.
        curve_accel_mps2: Greatest lateral acceleration in curves.
        ease_mps2: Deceleration towards lower limits and curves.
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
        weights = self.w_s, self.w_v, self.w_a, self.w_j
        if min(weights) < 0.0 or not max(weights) > 0.0:
            raise ValueError("the weights of the speed QP must not be negative, and one of them positive")
        if self.knots < 11 or not (self.curve_accel_mps2 > 0.0 and self.ease_mps2 > 0.0):
            raise ValueError("speed QP needs at least 11 knots and positive limits")

    def ladder(self) -> tuple[SpeedLimits, ...]:
        """From comfort to emergency, so that braking is no harder than needed; jerk rises later than braking."""
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


class SpeedProblem(NamedTuple):
    """One speed problem; arrays `(knots,)`."""

    start: tuple[float, float]  # v, a of the ego
    lower: FloatArray  # Bounds of s, m; `upper` likewise
    upper: FloatArray
    limit: FloatArray  # Upper bound of v, m/s
    s_ref: FloatArray  # m; `v_ref` m/s
    v_ref: FloatArray
    end: float = inf  # Station at which the path ends, m

    @property
    def overtakes(self) -> bool:
        """Whether an agent is to be overtaken: then another deceleration does not help."""
        return bool((self.lower > 0.0).any())


class SpeedQp:
    """The speed QP, for a solver of `planners.piecewise_jerk.solvers`."""

    def __init__(self, config: SpeedQpConfig, solver: str = DEFAULT) -> None:
        self._config, self._solver = config, solver
        self._weights = Weights(config.w_s, config.w_v, config.w_a, config.w_j)  # (1)

    def solve(self, rows: Rows) -> QPResult:
        """The profile, x = (s, v, a) `(3 knots,)`, of a problem with the rows of `rows_of`."""
        stated = PiecewiseJerkProblem(STEP_S, NO_LEADS, rows[0], self._weights, *rows[1:], 0.0)
        return solve(stated, self._solver, stage="speed QP", tolerance=TOLERANCE)

    def costs(self, x: FloatArray, problem: SpeedProblem) -> CostTerms:
        """The terms of (1) of a profile."""
        s, v, a = x.reshape(3, self._config.knots)
        c = self._config
        values = {
            "station": c.w_s * float(np.sum((s - problem.s_ref) ** 2)),
            "speed": c.w_v * float(np.sum((v - problem.v_ref) ** 2)),
            "acceleration": c.w_a * float(a @ a),
            "jerk": c.w_j * float(np.sum(np.diff(a) ** 2)) / STEP_S**2,
        }
        return CostTerms("speed QP", tuple(values.items()))


@kernel
def rows_of(problem: SpeedProblem, limits: KnotLimits, comfort: float) -> Rows:
    """Start s, v, a `(3,)`, references of s and v `(2, n)`, lower and upper bounds of s, v, a, jerk `(4, n)`.

    The bounds of the acceleration contain that of the start, and return from it with half of the jerk. `comfort`:
    deceleration, m/s2; harder braking may be released (2).
    """
    n, a0 = len(problem.upper), problem.start[1]
    lower, upper, references = np.zeros((4, n)), np.empty((4, n)), np.empty((2, n))
    references[0], references[1] = problem.s_ref, problem.v_ref
    lower[0], upper[0], upper[1] = np.minimum(problem.lower, problem.upper), problem.upper, problem.limit
    excess = max(-comfort - a0, 0.0)
    total = 0.0
    for i in range(n):
        ramp = STEP_S * total
        lower[2, i] = min(-limits.decel, a0 + 0.5 * ramp)
        upper[2, i] = max(limits.accel, a0 - 0.5 * ramp)
        release = min(excess / STEP_S - i * RELEASE_MPS3, RELEASE_MPS3)  # (2): down to comfort, and no further
        lower[3, i], upper[3, i] = -limits.jerk, max(limits.jerk, release)
        total += limits.jerk
    return np.array([0.0, problem.start[0], a0]), references, lower, upper


@kernel
def ease_problem(
    problem: SpeedProblem, limits: KnotLimits, share: float, given: float, comfort: float
) -> tuple[bool, SpeedProblem, Rows]:
    """Whether braking with a share of the limits keeps the bounds, and the QP for it.

    The gap may shrink by `given` m, but not beyond the path's end. The start's deceleration is reduced until the jerk
    can release it before the ego would reverse; the bounds contain the braking profile.
    """
    v0 = problem.start[0]
    a0 = max(problem.start[1], -sqrt(2.0 * 0.9 * limits.jerk * v0))
    stop = braking(v0, a0, share * limits.decel, share * limits.jerk, STEP_S, len(problem.upper))
    upper = np.minimum(problem.upper + given, problem.end)
    lower = np.minimum(problem.lower, np.maximum(problem.s_ref, stop[0]))
    limit = np.maximum(problem.limit, stop[1] + LIMIT_ROOM_MPS)
    loosened = SpeedProblem((v0, a0), lower, upper, limit, problem.s_ref, problem.v_ref, problem.end)
    return not (stop[0] > upper).any(), loosened, rows_of(loosened, limits, comfort)


@kernel
def tidy_profile(x: FloatArray) -> FloatArray:
    """Remove the solver's residual motion from a profile x = (s, v, a) `(3 n,)`; returns rows `(3, n)`.

    The result never moves backwards, and is exactly at rest where it rests.
    """
    out = x.copy().reshape(3, len(x) // 3)
    furthest = 0.0
    for i in range(out.shape[1]):
        furthest = max(furthest, out[0, i])
        out[0, i] = furthest
        if out[1, i] < REST_MPS:
            out[1, i] = 0.0
            if abs(out[2, i]) < REST_MPS2:
                out[2, i] = 0.0
    return out
