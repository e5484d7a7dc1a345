"""Speed QP: the smoothest speed profile between the bounds that the speed DP decided.

Unknown s, v, a at knots every 0.1 s, piecewise-constant jerk (`replan.planners.piecewise_jerk`).
Minimise

(1) sum w_s (s - s_ref)^2 + w_v (v - v_ref)^2 + w_a a^2 + w_j jerk^2

subject to s_lower(t) <= s <= s_upper(t) from the decisions, 0 <= v <= v_limit
(`replan.planners.frenet.profiles`, (1)), a and jerk limits, and the start.

(2) `braking` takes the mildest limits of acceleration and jerk with which braking keeps s_upper, so
    that the problem has a solution. Braking that is harder than comfort may be released with
    `RELEASE_MPS3`, down to comfort.

How hard to brake is a ladder of limits; the ego drives with the first that keeps the bounds:

(3) Comfortable limits, smoothed by the QP; first with their reserve, then with less, then with half
    of the gap.
(4) Hard limits, the mildest with which braking keeps the bounds.
(5) Full braking (`UTMOST_MPS3`) where it keeps some of the gap or does not touch, else driving on
    where that does not touch, else full braking.

Where a QP was tried without a solution, only rungs with a QP remain; where an agent is to be
overtaken, none remains, since another deceleration does not help.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import inf, sqrt
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta

from replan.core.arrays import FloatArray
from replan.core.errors import ConfigError
from replan.core.kernel import kernel
from replan.core.settings import Config, NotNegative, Positive
from replan.logs.plan import CostTerms, SolverReport
from replan.planners.frenet.profiles import (
    COMFORT,
    EMERGENCY,
    STEP_S,
    KnotLimits,
    SpeedLimits,
    braking,
)
from replan.planners.frenet.st_boundaries import StBoundaries, StGraphConfig
from replan.planners.piecewise_jerk.problem import PiecewiseJerkProblem, Weights
from replan.planners.piecewise_jerk.solvers import DEFAULT, solve
from replan.planners.solver import QPResult

Rows = tuple[FloatArray, FloatArray, FloatArray, FloatArray]  # The result of `rows_of`
NO_LEADS = np.empty(0)  # A speed profile has no points ahead of the rear axle
# Distance of the speed's bound above the braking profile that must stay below it, m/s
LIMIT_ROOM_MPS = 0.05
REST_MPS = 1e-3  # Speed below which a profile rests, m/s ...
REST_MPS2 = 0.02  # ... and acceleration, m/s2.
TOLERANCE = 0.05  # Largest violation of a bound in a solution, in the units of the row
RELEASE_MPS3 = 15.0  # Jerk with which braking that is harder than comfort may be released, m/s3


@dataclass(frozen=True)
class SpeedQpConfig(Config):
    """Weights and limits of the speed QP."""

    knots: Annotated[int, Meta(ge=11)] = 81
    """Number of knots, 0.1 s apart."""
    w_s: NotNegative = 0.2
    """Weight of the squared distance to the reference station."""
    w_v: NotNegative = 1.0
    """Weight of the squared difference from the reference speed."""
    w_a: NotNegative = 2.0
    """Weight of the squared acceleration."""
    w_j: NotNegative = 3.0
    """Weight of the squared jerk."""
    comfort: SpeedLimits = COMFORT
    """Limits to try first."""
    emergency: SpeedLimits = EMERGENCY
    """Limits where comfort cannot keep a bound."""
    curve_accel_mps2: Positive = 3.0
    """Greatest lateral acceleration in curves."""
    ease_mps2: Positive = 1.5
    """Deceleration towards lower limits and curves."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not max(self.w_s, self.w_v, self.w_a, self.w_j) > 0.0:
            raise ConfigError("speed QP: one of w_s, w_v, w_a and w_j must be positive")

    def ladder(self) -> tuple[SpeedLimits, ...]:
        """From comfort to emergency, so that braking is no harder than needed.

        Jerk rises later than braking.
        """
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
    """The speed QP, for a solver of `replan.planners.piecewise_jerk.solvers`."""

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
    """Start s, v, a `(3,)`, references of s and v `(2, n)`, lower and upper bounds of s, v, a, jerk
    `(4, n)`.

    The bounds of the acceleration contain that of the start, and return from it with half of the
    jerk. `comfort`: deceleration, m/s2; harder braking may be released (2).
    """
    n, a0 = len(problem.upper), problem.start[1]
    lower, upper, references = np.zeros((4, n)), np.empty((4, n)), np.empty((2, n))
    references[0], references[1] = problem.s_ref, problem.v_ref
    lower[0], upper[0], upper[1] = (
        np.minimum(problem.lower, problem.upper),
        problem.upper,
        problem.limit,
    )
    excess = max(-comfort - a0, 0.0)
    total = 0.0
    for i in range(n):
        ramp = STEP_S * total
        lower[2, i] = min(-limits.decel, a0 + 0.5 * ramp)
        upper[2, i] = max(limits.accel, a0 - 0.5 * ramp)
        # (2): down to comfort, and no further
        release = min(excess / STEP_S - i * RELEASE_MPS3, RELEASE_MPS3)
        lower[3, i], upper[3, i] = -limits.jerk, max(limits.jerk, release)
        total += limits.jerk
    return np.array([0.0, problem.start[0], a0]), references, lower, upper


@kernel
def ease_problem(
    problem: SpeedProblem, limits: KnotLimits, share: float, less_gap: float, comfort: float
) -> tuple[bool, SpeedProblem, Rows]:
    """Whether braking with a share of the limits keeps the bounds, and the QP for it.

    The gap may shrink by `less_gap` m, but not beyond the path's end. The start's deceleration is
    reduced until the jerk can release it before the ego would reverse; the bounds contain the
    braking profile.
    """
    v0 = problem.start[0]
    a0 = max(problem.start[1], -sqrt(2.0 * 0.9 * limits.jerk * v0))
    stop = braking(v0, a0, share * limits.decel, share * limits.jerk, STEP_S, len(problem.upper))
    upper = np.minimum(problem.upper + less_gap, problem.end)
    lower = np.minimum(problem.lower, np.maximum(problem.s_ref, stop[0]))
    limit = np.maximum(problem.limit, stop[1] + LIMIT_ROOM_MPS)
    loosened = SpeedProblem(
        (v0, a0), lower, upper, limit, problem.s_ref, problem.v_ref, problem.end
    )
    return not (stop[0] > upper).any(), loosened, rows_of(loosened, limits, comfort)


@kernel
def tidy_profile(x: FloatArray) -> FloatArray:
    """Remove the solver's residual motion from a profile x = (s, v, a) `(3 n,)`; returns rows
    `(3, n)`.

    The result never moves backwards, and is exactly at rest where it rests.
    """
    profile = x.copy().reshape(3, len(x) // 3)
    furthest = 0.0
    for i in range(profile.shape[1]):
        furthest = max(furthest, profile[0, i])
        profile[0, i] = furthest
        if profile[1, i] < REST_MPS:
            profile[1, i] = 0.0
            if abs(profile[2, i]) < REST_MPS2:
                profile[2, i] = 0.0
    return profile


# Share of the limits with which braking must keep the bounds, so that the QP has room to be smooth
RESERVE = 0.85
LEAST_RESERVE = 0.97  # The same where braking would otherwise be hard
TOUCHING = StGraphConfig(
    margin_m=0.05, vulnerable_margin_m=0.05, passed_margin_m=0.05, early_s=0.0, late_s=0.0
)
"""Nearly the bare footprints: for braking that can do no better than not to touch."""
BARE = StGraphConfig(
    margin_m=0.0, vulnerable_margin_m=0.0, passed_margin_m=0.0, early_s=0.0, late_s=0.0
)
"""The footprints as predicted."""
UTMOST_MPS3 = 30.0  # Jerk of full braking, m/s3
# An ego that drives on releases the brake and reaches its acceleration within this time, s ...
ONWARD_S = 0.8
RESTING_MPS = 0.5  # ... and does not come to rest: it stays faster than this, m/s.
Attempts = tuple[tuple[SpeedProblem, QPResult], ...]  # QPs that were tried, with their results


@dataclass(frozen=True, eq=False, slots=True)
class SolvedSpeed:
    """The speed found: rows s, v, a `(3, knots)`, or None; the reason why it is not comfortable, or
    is None.

    Whether it keeps the bounds by (3) or (4), whether no profile avoids a contact, whether it
    brakes as hard as it can, and the QPs that were tried, with their results.
    """

    profile: FloatArray | None
    reason: str
    keeps: bool = False
    unavoidable: bool = False
    is_full: bool = False
    attempts: Attempts = ()

    @property
    def reports(self) -> tuple[SolverReport, ...]:
        """The solver reports of all attempts."""
        return tuple(result.report for _, result in self.attempts)


class Rung(NamedTuple):
    """A rung: braking with a share of limits keeps the bounds, with the gap reduced by `less_gap`,
    m; the QP smooths it.

    `after_full`: whether it may follow full braking, which continues until the whole gap is kept.
    """

    limits: SpeedLimits
    share: float
    less_gap: float = 0.0
    reason: str = ""
    after_full: bool = True


class BrakingLadder:
    """The rungs of (3) and (4), the loop over them, and (5), for problems whose upper bounds
    include a gap, m.
    """

    def __init__(
        self, config: SpeedQpConfig, gap_m: float, most_mps2: float, solver: str = DEFAULT
    ) -> None:
        self._config, self._gap = config, gap_m
        self.program = SpeedQp(config, solver)
        self._times = STEP_S * np.arange(config.knots)
        self._utmost = replace(config.emergency, decel_mps2=most_mps2, jerk_mps3=UTMOST_MPS3)
        comfort, *harder = config.ladder()
        hardest, half = harder[-1], 0.5 * gap_m
        words = [f"hard braking, up to {limits.decel_mps2:.1f} m/s2, keeps" for limits in harder]
        self._rungs = (
            Rung(comfort, RESERVE),
            Rung(comfort, LEAST_RESERVE),
            Rung(comfort, LEAST_RESERVE, half),
            *(
                Rung(limits, RESERVE, 0.0, f"{hard} the distance")
                for limits, hard in zip(harder, words, strict=True)
            ),
            Rung(hardest, LEAST_RESERVE, 0.0, f"{words[-1]} the distance"),
            Rung(
                hardest, LEAST_RESERVE, half, f"{words[-1]} half of the distance", after_full=False
            ),
        )

    def solve(
        self,
        problem: SpeedProblem,
        taken: Callable[[StGraphConfig], StBoundaries],
        *,
        braked_fully: bool = False,
    ) -> SolvedSpeed:
        """Find the profile of a frame.

        `taken` returns the S-T boundaries with other margins, stops included; `braked_fully`:
        whether the ego braked as hard as it can in the frame before.
        """
        tried: list[tuple[SpeedProblem, QPResult]] = []
        for rung in self._rungs:
            if braked_fully and not rung.after_full:
                continue
            comfort = self._config.comfort.decel_mps2
            fits, posed, rows = ease_problem(
                problem, rung.limits.columns, rung.share, rung.less_gap, comfort
            )
            if fits:
                result = self.program.solve(rows)
                tried.append((posed, result))
                if result.report.solved:
                    return SolvedSpeed(
                        tidy_profile(result.x), rung.reason, keeps=True, attempts=tuple(tried)
                    )
            if tried and problem.overtakes:
                break
        if tried:
            return SolvedSpeed(None, "speed QP: no profile found", attempts=tuple(tried))
        # (5): full braking where it leaves some of the gap or does not touch; else driving on
        times, full = self._times, self._utmost.braking(problem.start, self._config.knots)
        left = self._gap - float((full[0] - problem.upper).max())
        if left > 0.0:
            return SolvedSpeed(full, f"full braking, which leaves {left:.1f} m", is_full=True)
        touching = taken(TOUCHING)
        if touching.leave(times, full[0], 0.0):
            return SolvedSpeed(full, "full braking, which just does not touch", is_full=True)
        short, bare, (v0, a0) = (
            f"full braking comes {-left:.1f} m too far",
            taken(BARE),
            problem.start,
        )
        # Driving on, at the present speed or accelerating
        for accel in (0.0, self._config.comfort.accel_mps2):
            released = np.minimum(min(a0, 0.0) + RELEASE_MPS3 * times, 0.0)
            a = released + max(a0, 0.0) + (accel - max(a0, 0.0)) * np.minimum(times / ONWARD_S, 1.0)
            v = np.maximum(v0 + np.r_[0.0, np.cumsum(0.5 * STEP_S * (a[1:] + a[:-1]))], 0.0)
            v = np.minimum(v, np.maximum(problem.limit, v0))
            s = np.r_[0.0, np.cumsum(0.5 * STEP_S * (v[1:] + v[:-1]))]
            if v[-1] > RESTING_MPS and s[-1] <= problem.end and not bare.meets(times, s):
                onward = np.vstack([s, v, np.gradient(v, STEP_S)])
                return SolvedSpeed(onward, f"driving on, which just does not touch: {short}")
        if not touching.meets(times, full[0]):
            return SolvedSpeed(full, "full braking, which just does not touch", is_full=True)
        return SolvedSpeed(full, short, unavoidable=True, is_full=True)
