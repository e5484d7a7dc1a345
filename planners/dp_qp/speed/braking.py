"""How hard to brake: a ladder, and the first rung that holds is driven.

(1) Comfortable limits, smoothed by the QP; they give up their reserve, then half of the gap.
(2) Hard limits, the mildest with which braking keeps the bounds.
(3) All that the brakes can do (`UTMOST_MPS3`) where that stays behind, or driving on where that does not touch, or all
    that the brakes can do.

Where a QP was asked and has no answer, only rungs with a QP are left, and none where an agent is to be overtaken: what
one deceleration cannot, another cannot either.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from logs.kernel import FloatArray
from logs.trace import SolverReport
from planners.dp_qp.speed.qp import RELEASE_MPS3, SpeedProblem, SpeedQp, SpeedQpConfig, eased, tidied
from planners.frenet.profiles import STEP_S, SpeedLimits
from planners.frenet.st_boundaries import StBoundaries, StGraphConfig
from planners.piecewise_jerk.solvers import DEFAULT
from planners.qp import QPResult

RESERVE = 0.85
"""Share of the limits with which braking must keep the bounds, so that the QP has room to be smooth."""
LEAST_RESERVE = 0.97
"""The same where braking would turn hard otherwise."""
TOUCHING = StGraphConfig(margin_m=0.05, vulnerable_margin_m=0.05, passed_margin_m=0.05, early_s=0.0, late_s=0.0)
"""The footprints, almost: what counts for braking where nothing better than not to touch can be had."""
BARE = StGraphConfig(margin_m=0.0, vulnerable_margin_m=0.0, passed_margin_m=0.0, early_s=0.0, late_s=0.0)
"""The footprints as predicted."""
UTMOST_MPS3 = 30.0
"""Jerk of a full brake, where nothing less will do, m/s3."""
ONWARD_S = 0.8
"""Driving on lets go of the brake and reaches its acceleration within this time, s ..."""
RESTING_MPS = 0.5
"""... and does not come to rest: it stays faster than this, m/s."""


@dataclass(frozen=True, eq=False, slots=True)
class Asked:
    """A QP and its answer."""

    problem: SpeedProblem
    result: QPResult


@dataclass(frozen=True, eq=False, slots=True)
class SolvedSpeed:
    """What was found.

    Attributes:
        profile: Rows s, v, a `(3, knots)`, or None.
        reason: Why it is not comfortable, or why there is none; empty otherwise.
        unavoidable: Whether nothing could avoid a contact.
        is_full: Whether it brakes as hard as it can.
        asked: The QPs of all attempts.
    """

    profile: FloatArray | None
    reason: str
    unavoidable: bool = False
    is_full: bool = False
    asked: tuple[Asked, ...] = ()

    @property
    def reports(self) -> tuple[SolverReport, ...]:
        """Of all attempts."""
        return tuple(each.result.report for each in self.asked)


@dataclass(eq=False, slots=True)
class Case:
    """One frame's problem on the ladder.

    Attributes:
        problem: Its bounds and what is wanted.
        taken: The S-T boundaries with any margins, stops included.
        braked_fully: Whether the ego braked as hard as it can, in the frame before.
        tried: The QPs asked so far.
    """

    problem: SpeedProblem
    taken: Callable[[StGraphConfig], StBoundaries]
    braked_fully: bool = False
    tried: list[Asked] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Rung:
    """One way to brake: whether it may be tried, and the attempt, None where it does not hold."""

    applies: Callable[[Case], bool]
    attempt: Callable[[Case], SolvedSpeed | None]


class BrakingLadder:
    """The rungs of (1) to (3), and the loop over them.

    Args:
        config: Limits and weights.
        gap_m: The gap that is in the problems' upper bounds.
        most_mps2: Deceleration at full brake.
        solver: Of the QPs.

    Attributes:
        program: The QP.
    """

    def __init__(self, config: SpeedQpConfig, gap_m: float, most_mps2: float, solver: str = DEFAULT) -> None:
        self._config, self._gap = config, gap_m
        self.program = SpeedQp(config, solver)
        self._times = STEP_S * np.arange(config.knots)
        self._utmost = replace(config.emergency, decel_mps2=most_mps2, jerk_mps3=UTMOST_MPS3)
        self._rungs = (
            self._smooth(config.comfort, RESERVE),
            self._smooth(config.comfort, LEAST_RESERVE),
            self._smooth(config.comfort, LEAST_RESERVE, 0.5 * gap_m),
            *self._hard(),
            Rung(_untried, self._full_stop),
            Rung(_untried, self._onward),
            Rung(_untried, self._full_braking),
        )

    def solve(self, case: Case) -> SolvedSpeed:
        """The profile of a frame."""
        for rung in self._rungs:
            if not rung.applies(case):
                continue
            found = rung.attempt(case)
            if found is not None:
                return found
            if case.tried and case.problem.overtakes:
                break
        return SolvedSpeed(None, "speed QP: no profile found", asked=tuple(case.tried))

    def _hard(self) -> tuple[Rung, ...]:
        """(2); the hardest give up their reserve and, at last, half of the gap.

        The gap not after full braking, which goes on until the whole gap is kept.
        """
        _, *harder = self._config.ladder()
        hardest, given = harder[-1], 0.5 * self._gap
        return (
            *(self._smooth(limits, RESERVE, 0.0, _keeps(limits, 0.0)) for limits in harder),
            self._smooth(hardest, LEAST_RESERVE, 0.0, _keeps(hardest, 0.0)),
            self._smooth(
                hardest, LEAST_RESERVE, given, _keeps(hardest, given),
                lambda case: not case.braked_fully,
            ),
        )  # fmt: skip

    def _smooth(
        self, limits: SpeedLimits, share: float, given: float = 0.0, reason: str = "",
        applies: Callable[[Case], bool] = lambda case: True,
    ) -> Rung:  # fmt: skip
        """Braking with a share of these limits keeps the bounds, less what is given up of the gap; smoothed."""

        def attempt(case: Case) -> SolvedSpeed | None:
            comfort = self._config.comfort.decel_mps2
            fits, _, problem, rows = eased(case.problem, limits.columns, share, given, comfort)
            if not fits:
                return None
            result = self.program.solve(rows)
            case.tried.append(Asked(problem, result))
            if not result.report.solved:
                return None
            return SolvedSpeed(tidied(result.x), reason, asked=tuple(case.tried))

        return Rung(applies, attempt)

    def _full_stop(self, case: Case) -> SolvedSpeed | None:
        """(3): all that the brakes can do, where that leaves some of the gap or stays behind."""
        full, left = self._full(case)
        if left <= 0.0 and not case.taken(TOUCHING).leave(self._times, full[0], 0.0):
            return None
        reason = f"full braking, which {self._short(case) if left > 0.0 else 'just does not touch'}"
        return SolvedSpeed(full, reason, is_full=True)

    def _onward(self, case: Case) -> SolvedSpeed | None:
        """(3): driving on, at the present speed or accelerating, where that does not touch."""
        problem, taken = case.problem, case.taken(BARE)
        v0, a0 = problem.start
        for accel in (0.0, self._config.comfort.accel_mps2):
            released = np.minimum(min(a0, 0.0) + RELEASE_MPS3 * self._times, 0.0)
            a = released + max(a0, 0.0) + (accel - max(a0, 0.0)) * np.minimum(self._times / ONWARD_S, 1.0)
            v = np.maximum(v0 + np.r_[0.0, np.cumsum(0.5 * STEP_S * (a[1:] + a[:-1]))], 0.0)
            v = np.minimum(v, np.maximum(problem.limit, v0))
            s = np.r_[0.0, np.cumsum(0.5 * STEP_S * (v[1:] + v[:-1]))]
            if v[-1] > RESTING_MPS and s[-1] <= problem.end and not taken.meets(self._times, s):
                reason = f"driving on, which just does not touch: full braking {self._short(case)}"
                return SolvedSpeed(np.vstack([s, v, np.gradient(v, STEP_S)]), reason)
        return None

    def _full_braking(self, case: Case) -> SolvedSpeed:
        """(3): all that the brakes can do."""
        full, _ = self._full(case)
        if not case.taken(TOUCHING).meets(self._times, full[0]):
            return SolvedSpeed(full, "full braking, which just does not touch", is_full=True)
        return SolvedSpeed(full, f"full braking {self._short(case)}", unavoidable=True, is_full=True)

    def _full(self, case: Case) -> tuple[FloatArray, float]:
        """Rows s, v, a of full braking, and what it leaves of the gap, m."""
        full = self._utmost.braking(case.problem.start, self._config.knots)
        return full, self._gap - float((full[0] - case.problem.upper).max())

    def _short(self, case: Case) -> str:
        """How far full braking comes, in words."""
        left = self._full(case)[1]
        return f"leaves {left:.1f} m" if left > 0.0 else f"comes {-left:.1f} m too far"


def _untried(case: Case) -> bool:
    return not case.tried


def _keeps(limits: SpeedLimits, given: float) -> str:
    kept = "half of the distance" if given > 0.0 else "the distance"
    return f"hard braking, up to {limits.decel_mps2:.1f} m/s2, keeps {kept}"
