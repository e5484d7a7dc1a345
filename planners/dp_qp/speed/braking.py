"""How hard to brake: a ladder of limits; the ego drives with the first that keeps the bounds.

(1) Comfortable limits, smoothed by the QP; first with their reserve, then with less, then with half of the gap.
(2) Hard limits, the mildest with which braking keeps the bounds.
(3) Full braking (`UTMOST_MPS3`) where it keeps some of the gap or does not touch, else driving on where that does not
    touch, else full braking.

Where a QP was tried without a solution, only rungs with a QP remain; where an agent is to be overtaken, none remains,
since another deceleration does not help.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from logs.arrays import FloatArray
from logs.plan import SolverReport
from planners.dp_qp.speed.qp import RELEASE_MPS3, SpeedProblem, SpeedQp, SpeedQpConfig, ease_problem, tidy_profile
from planners.frenet.profiles import STEP_S, SpeedLimits
from planners.frenet.st_boundaries import StBoundaries, StGraphConfig
from planners.piecewise_jerk.solvers import DEFAULT
from planners.solver import QPResult

RESERVE = 0.85  # Share of the limits with which braking must keep the bounds, so that the QP has room to be smooth
LEAST_RESERVE = 0.97  # The same where braking would otherwise be hard
TOUCHING = StGraphConfig(margin_m=0.05, vulnerable_margin_m=0.05, passed_margin_m=0.05, early_s=0.0, late_s=0.0)
"""Nearly the bare footprints: for braking that can do no better than not to touch."""
BARE = StGraphConfig(margin_m=0.0, vulnerable_margin_m=0.0, passed_margin_m=0.0, early_s=0.0, late_s=0.0)
"""The footprints as predicted."""
UTMOST_MPS3 = 30.0  # Jerk of full braking, m/s3
ONWARD_S = 0.8  # An ego that drives on releases the brake and reaches its acceleration within this time, s ...
RESTING_MPS = 0.5  # ... and does not come to rest: it stays faster than this, m/s.


Attempts = tuple[tuple[SpeedProblem, QPResult], ...]  # QPs that were tried, with their results


@dataclass(frozen=True, eq=False, slots=True)
class SolvedSpeed:
    """The speed found: rows s, v, a `(3, knots)`, or None; the reason why it is not comfortable, or is None.

    Whether it keeps the bounds by (1) or (2), whether no profile avoids a contact, whether it brakes as hard as it can,
    and the QPs that were tried, with their results.
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
    """A rung: braking with a share of limits keeps the bounds, with the gap reduced by `given`, m; the QP smooths it.

    `after_full`: whether it may follow full braking, which continues until the whole gap is kept.
    """

    limits: SpeedLimits
    share: float
    given: float = 0.0
    reason: str = ""
    after_full: bool = True


class BrakingLadder:
    """The rungs of (1) and (2), the loop over them, and (3), for problems whose upper bounds include a gap, m."""

    def __init__(self, config: SpeedQpConfig, gap_m: float, most_mps2: float, solver: str = DEFAULT) -> None:
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
            *(Rung(limits, RESERVE, 0.0, f"{hard} the distance") for limits, hard in zip(harder, words, strict=True)),
            Rung(hardest, LEAST_RESERVE, 0.0, f"{words[-1]} the distance"),
            Rung(hardest, LEAST_RESERVE, half, f"{words[-1]} half of the distance", after_full=False),
        )

    def solve(
        self, problem: SpeedProblem, taken: Callable[[StGraphConfig], StBoundaries], *, braked_fully: bool = False
    ) -> SolvedSpeed:
        """Find the profile of a frame.

        `taken` returns the S-T boundaries with other margins, stops included; `braked_fully`: whether the ego braked as
        hard as it can in the frame before.
        """
        tried: list[tuple[SpeedProblem, QPResult]] = []
        for rung in self._rungs:
            if braked_fully and not rung.after_full:
                continue
            comfort = self._config.comfort.decel_mps2
            fits, posed, rows = ease_problem(problem, rung.limits.columns, rung.share, rung.given, comfort)
            if fits:
                result = self.program.solve(rows)
                tried.append((posed, result))
                if result.report.solved:
                    return SolvedSpeed(tidy_profile(result.x), rung.reason, keeps=True, attempts=tuple(tried))
            if tried and problem.overtakes:
                break
        if tried:
            return SolvedSpeed(None, "speed QP: no profile found", attempts=tuple(tried))
        # (3): full braking where it leaves some of the gap or does not touch; else driving on
        times, full = self._times, self._utmost.braking(problem.start, self._config.knots)
        left = self._gap - float((full[0] - problem.upper).max())
        if left > 0.0:
            return SolvedSpeed(full, f"full braking, which leaves {left:.1f} m", is_full=True)
        touching = taken(TOUCHING)
        if touching.leave(times, full[0], 0.0):
            return SolvedSpeed(full, "full braking, which just does not touch", is_full=True)
        short, bare, (v0, a0) = f"full braking comes {-left:.1f} m too far", taken(BARE), problem.start
        for accel in (0.0, self._config.comfort.accel_mps2):  # driving on, at the present speed or accelerating
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
