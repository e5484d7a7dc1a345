"""How hard to brake: a ladder, and the first rung that holds is driven.

(1) Comfortable limits, smoothed by the QP; they give up their reserve, then half of the gap, then more of it and some
    of the time to spare (`CLEAR`), before anything below is tried.
(2) Wait: comfortable limits for a moment, then hard ones. Only for `PATIENCE_S` after comfort has ceased to suffice:
    one who just begins to walk is not yet predictable, and what a frame demands the next may take back.
(3) Driving on, where that is clear of everybody by `ONWARD`: better than hard braking for one who comes late.
(4) Hard limits, the mildest with which braking keeps the bounds.
(5) Driving on as in (3), or all that the brakes can do (`UTMOST_MPS3`) where that stays behind, or driving on where
    that does not touch, or all that the brakes can do.

Where a QP was asked and has no answer, only rungs with a QP are left, and none where an agent is to be overtaken: what
one deceleration cannot, another cannot either.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import inf

import numpy as np

from logs.kernel import FloatArray
from logs.trace import SolverReport
from planners.dp_qp.speed.qp import RELEASE_MPS3, Rows, SpeedProblem, SpeedQp, SpeedQpConfig, eased, tidied
from planners.frenet.profiles import STEP_S, Limits, SpeedLimits
from planners.frenet.st_boundaries import StBoundaries, StGraphConfig
from planners.piecewise_jerk.solvers import DEFAULT
from planners.qp import QPResult

RESERVE = 0.85
"""Share of the limits with which braking must keep the bounds, so that the QP has room to be smooth."""
LEAST_RESERVE = 0.97
"""The same where braking would turn hard otherwise."""
PATIENCE_S = 0.5
"""So long after comfort has ceased to suffice the ego waits (2), s."""
WAIT_S = 0.4
"""The longest wait (2), s."""
CLEAR = StGraphConfig(margin_m=0.3, vulnerable_margin_m=0.3, passed_margin_m=0.1, early_s=0.3, late_s=0.15)
"""How clear comfortable braking must be of everybody, to be better than hard braking ..."""
LEAST_GAP = 0.3
"""... and what share of the gap it must leave."""
ONWARD = StGraphConfig(margin_m=0.3, vulnerable_margin_m=0.3, passed_margin_m=0.1, early_s=0.3, late_s=0.0)
"""How clear driving on must be of everybody, to be better than hard braking."""
TOUCHING = StGraphConfig(margin_m=0.05, vulnerable_margin_m=0.05, passed_margin_m=0.05, early_s=0.0, late_s=0.0)
"""The footprints, almost: what counts for braking where nothing better than not to touch can be had."""
BARE = StGraphConfig(margin_m=0.0, vulnerable_margin_m=0.0, passed_margin_m=0.0, early_s=0.0, late_s=0.0)
"""The footprints as predicted."""
UTMOST_MPS3 = 30.0
"""Jerk of a full brake, where nothing less will do, m/s3."""
BRISK_MPS = 1.4
"""How fast a walker may become who just begins, m/s: as most do."""
ONWARD_S = 0.8
"""Driving on lets go of the brake and reaches its acceleration within this time, s ..."""
RESTING_MPS = 0.5
"""... and does not come to rest: it stays faster than this, m/s."""


@dataclass(frozen=True, slots=True)
class BrakingMemory:
    """What is remembered of the frames before.

    Attributes:
        since: Since when comfort does not suffice, s; inf: it does; -inf: nothing is known, and it is not waited.
        drove_on: Whether (3) was driven; `braked_fully` whether the ego braked as hard as it can.
    """

    since: float = -inf
    drove_on: bool = False
    braked_fully: bool = False

    def after(self, t: float, solved: SolvedSpeed) -> BrakingMemory:
        """What is remembered of a frame at `t`, s."""
        return BrakingMemory(inf if not solved.reason else min(self.since, t), solved.is_onward, solved.is_full)


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
        is_onward: Whether it drives on instead of braking; `is_full` whether it brakes as hard as it can.
        asked: The QPs of all attempts.
    """

    profile: FloatArray | None
    reason: str
    unavoidable: bool = False
    is_onward: bool = False
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
        t: The frame's time, s.
        memory: Of the frames before.
        tried: The QPs asked so far.
    """

    problem: SpeedProblem
    taken: Callable[[StGraphConfig], StBoundaries]
    t: float
    memory: BrakingMemory
    tried: list[Asked] = field(default_factory=list)

    @property
    def is_patient(self) -> bool:
        """Whether comfort has sufficed until a moment ago."""
        return self.t - self.memory.since < PATIENCE_S - 1e-6

    @property
    def clearance(self) -> StGraphConfig:
        """With which driving on begins, or goes on."""
        return TOUCHING if self.memory.drove_on else ONWARD


@dataclass(frozen=True, slots=True)
class Rung:
    """One way to brake: whether it may be tried, and the attempt, None where it does not hold."""

    applies: Callable[[Case], bool]
    attempt: Callable[[Case], SolvedSpeed | None]


class BrakingLadder:
    """The rungs of (1) to (5), and the loop over them.

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
        self._utmost = Limits(replace(config.emergency, decel_mps2=most_mps2, jerk_mps3=UTMOST_MPS3))
        soft = self._soft = Limits(config.comfort)
        self._rungs = (
            self._smooth(soft, RESERVE),
            self._smooth(soft, LEAST_RESERVE),
            self._smooth(soft, LEAST_RESERVE, 0.5 * gap_m),
            Rung(_untried, self._gentle),
            *(rung for wait in range(round(WAIT_S / STEP_S), 0, -1) for rung in self._hard(wait)),
            Rung(lambda case: _untried(case) and not case.is_patient, self._onward_instead),
            *self._hard(0),
            Rung(_untried, self._onward_brisk),
            Rung(_untried, self._full_stop),
            Rung(_untried, self._onward_bare),
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

    def _hard(self, wait: int) -> tuple[Rung, ...]:
        """(4), or (2) with a wait of so many knots; the hardest give up their reserve and, at last, half of the gap.

        The gap not after full braking, which goes on until the whole gap is kept.
        """
        before = f"comfortable braking for {wait * STEP_S:.1f} s, then " if wait else ""
        _, *harder = self._config.ladder()
        hardest = Limits(harder[-1], self._config.comfort, wait)

        def applies(case: Case) -> bool:
            return not wait or (case.is_patient and self._eased(case.problem, hardest, LEAST_RESERVE)[0])

        rungs = [
            self._smooth(
                Limits(limits, self._config.comfort, wait), RESERVE, 0.0, before + _keeps(limits, 0.0), applies
            )
            for limits in harder
        ]
        rungs.append(self._smooth(hardest, LEAST_RESERVE, 0.0, before + _keeps(harder[-1], 0.0), applies))
        if not wait:
            given, reason = 0.5 * self._gap, before + _keeps(harder[-1], 0.5 * self._gap)
            rungs.append(self._smooth(hardest, LEAST_RESERVE, given, reason, lambda case: not case.memory.braked_fully))
        return tuple(rungs)

    def _smooth(
        self, limits: Limits, share: float, given: float = 0.0, reason: str = "",
        applies: Callable[[Case], bool] = lambda case: True,
    ) -> Rung:  # fmt: skip
        """Braking with a share of these limits keeps the bounds, less what is given up of the gap; smoothed."""

        def attempt(case: Case) -> SolvedSpeed | None:
            fits, _, problem, rows = self._eased(case.problem, limits, share, given)
            if not fits:
                return None
            result = self.program.solve(rows)
            case.tried.append(Asked(problem, result))
            if not result.report.solved:
                return None
            return SolvedSpeed(tidied(result.x), reason, asked=tuple(case.tried))

        return Rung(applies, attempt)

    def _eased(
        self, problem: SpeedProblem, limits: Limits, share: float, given: float = 0.0
    ) -> tuple[bool, FloatArray, SpeedProblem, Rows]:
        """`qp.eased`."""
        return eased(problem, limits.columns, share, given, self._config.comfort.decel_mps2)

    def _gentle(self, case: Case) -> SolvedSpeed | None:
        """(1): comfortable braking to a stop, where that stays behind everybody by some of the gap."""
        _, stop, problem, _ = self._eased(case.problem, self._soft, 1.0)
        if stop[0, -1] > problem.end or not case.taken(CLEAR).leave(self._times, stop[0], LEAST_GAP * self._gap):
            return None
        return SolvedSpeed(stop, "comfortable braking, which is clear, but with less time to spare than wanted")

    def _onward_instead(self, case: Case) -> SolvedSpeed | None:
        """(3)."""
        return self._onward(case, case.clearance, "driving on, which is clear, instead of hard braking")

    def _onward_brisk(self, case: Case) -> SolvedSpeed | None:
        """(5): as (3), also of those who may walk faster than now."""
        margins = replace(case.clearance, brisk_mps=BRISK_MPS)
        return self._onward(case, margins, f"driving on, which is clear: full braking {self._short(case)}")

    def _full_stop(self, case: Case) -> SolvedSpeed | None:
        """(5): all that the brakes can do, where that leaves some of the gap or stays behind."""
        full, left = self._full(case)
        if left <= 0.0 and not case.taken(TOUCHING).leave(self._times, full[0], 0.0):
            return None
        reason = f"full braking, which {self._short(case) if left > 0.0 else 'just does not touch'}"
        return SolvedSpeed(full, reason, is_full=True)

    def _onward_bare(self, case: Case) -> SolvedSpeed | None:
        """(5): driving on, where that does not touch."""
        return self._onward(case, BARE, f"driving on, which just does not touch: full braking {self._short(case)}")

    def _full_braking(self, case: Case) -> SolvedSpeed:
        """(5): all that the brakes can do."""
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

    def _onward(self, case: Case, margins: StGraphConfig, reason: str) -> SolvedSpeed | None:
        """Driving on, at the present speed or accelerating, where that meets no one."""
        problem, taken = case.problem, case.taken(margins)
        v0, a0 = problem.start
        for accel in (0.0, self._config.comfort.accel_mps2):
            released = np.minimum(min(a0, 0.0) + RELEASE_MPS3 * self._times, 0.0)
            a = released + max(a0, 0.0) + (accel - max(a0, 0.0)) * np.minimum(self._times / ONWARD_S, 1.0)
            v = np.maximum(v0 + np.r_[0.0, np.cumsum(0.5 * STEP_S * (a[1:] + a[:-1]))], 0.0)
            v = np.minimum(v, np.maximum(problem.limit, v0))
            s = np.r_[0.0, np.cumsum(0.5 * STEP_S * (v[1:] + v[:-1]))]
            if v[-1] > RESTING_MPS and s[-1] <= problem.end and not taken.meets(self._times, s):
                return SolvedSpeed(np.vstack([s, v, np.gradient(v, STEP_S)]), reason, is_onward=True)
        return None


def _untried(case: Case) -> bool:
    return not case.tried


def _keeps(limits: SpeedLimits, given: float) -> str:
    kept = "half of the distance" if given > 0.0 else "the distance"
    return f"hard braking, up to {limits.decel_mps2:.1f} m/s2, keeps {kept}"
