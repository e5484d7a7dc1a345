"""How hard to brake: the mildest of these that keeps the bounds of s is driven.

(1) Comfortable limits; they give up their reserve, then half of the gap, then more of it and some of the time to spare
    (`CLEAR`), before anything below is tried.
(2) Wait: comfortable limits for a moment, then hard ones. Only for `PATIENCE_S` after comfort has ceased to suffice:
    somebody who just begins to walk is not yet predictable, and what a frame demands the next may take back.
(3) Driving on, where that is clear of everybody by `ONWARD`: better than hard braking for one who comes late.
(4) Hard limits, the mildest of a ladder with which braking keeps the bounds.
(5) Driving on as in (3), or all that the brakes can do (`UTMOST_MPS3`) where that stays behind, or driving on where
    that does not touch, or all that the brakes can do.

Memory: since when comfort does not suffice, whether (3) was driven, whether the ego braked fully; none of it where the
frame is fresh.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from logs.kernel import FloatArray
from logs.trace import Artefact
from planners.dp_qp.speed_qp import RELEASE_MPS3, STEP_S, Limits, SpeedLimits, SpeedProblem, SpeedQp, SpeedQpConfig
from planners.dp_qp.st_graph import Blocks, StGraphConfig
from planners.piecewise_jerk.solvers import DEFAULT

RESERVE = 0.85
"""Share of the limits with which braking must keep the bounds, so that the QP has room to be smooth."""
LEAST_RESERVE = 0.97
"""The same where braking would turn hard otherwise."""

PATIENCE_S = 0.5
WAIT_S = 0.4
"""The longest wait (2)."""
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
"""How fast the pedal is stamped on where nothing less will do."""
BRISK_MPS = 1.4
"""How fast a walker may become who just begins: as most do."""
ONWARD_S, RESTING_MPS = 0.8, 0.5
"""Driving on lets go of the brake, reaches its acceleration within this time, and does not come to rest."""


@dataclass(frozen=True, eq=False, slots=True)
class SolvedSpeed:
    """What was found.

    Attributes:
        profile: Rows s, v, a `(3, knots)`, or None.
        reason: Why it is not comfortable, or why there is none; empty otherwise.
        unavoidable: Whether nothing could avoid a contact.
        is_onward: Whether it drives on instead of braking; `is_full` whether it brakes as hard as it can.
        artefacts: Costs and solver reports of all attempts.
    """

    profile: FloatArray | None
    reason: str
    unavoidable: bool = False
    is_onward: bool = False
    is_full: bool = False
    artefacts: tuple[Artefact, ...] = ()


@dataclass(frozen=True, eq=False, slots=True)
class _Attempt:
    """Limits, the share of them with which braking must keep the bounds, and what of the gap is given up, m."""

    limits: Limits
    share: float = RESERVE
    given: float = 0.0
    reason: str = ""


class SpeedSolver:
    """Solves speed problems by (1)-(5); owns the speed QP.

    Args:
        config: Limits and weights.
        gap_m: The gap that is in the problems' upper bounds.
        most_mps2: Deceleration at full brake.
        solver: Of the QP.
    """

    def __init__(self, config: SpeedQpConfig, gap_m: float, most_mps2: float, solver: str = DEFAULT) -> None:
        self._config, self._gap = config, gap_m
        self._utmost = replace(config.emergency, decel_mps2=most_mps2, jerk_mps3=UTMOST_MPS3)
        self._program = SpeedQp(config, solver)
        self._times = STEP_S * np.arange(config.knots)
        self._since = inf
        self._drove_on = self._braked_fully = False

    def solve(
        self, problem: SpeedProblem, blocks: Callable[[StGraphConfig], Blocks], t: float, *, fresh: bool
    ) -> SolvedSpeed:
        """The profile of a frame at `t`, s; `blocks` makes the S-T graph with other margins."""
        if fresh:
            self._since, self._drove_on, self._braked_fully = -inf, False, False
        patient = t - self._since < PATIENCE_S - 1e-6
        tried: list[Artefact] = []
        for attempt in self._soft():
            solved = self._attempt(problem, attempt, tried)
            if solved is not None or (tried and problem.overtakes):
                return solved or _failed(tried)
        gentle = None if tried else self._gentle(problem, blocks(CLEAR))
        if gentle is not None:
            return SolvedSpeed(gentle, "comfortable braking, which is clear, but with less time to spare than wanted")
        for attempt in self._waits(problem) if patient else ():
            solved = self._attempt(problem, attempt, tried)
            if solved is not None:
                return solved
        onward = None if patient or tried else self._onward(problem, blocks(self._clearance()))
        if onward is not None:
            return SolvedSpeed(onward, "driving on, which is clear, instead of hard braking", is_onward=True)
        for attempt in self._hard():
            solved = self._attempt(problem, attempt, tried)
            if solved is not None or (tried and problem.overtakes):
                return solved or _failed(tried)
        return _failed(tried) if tried else self._last_resort(problem, blocks)

    def remember(self, t: float, solved: SolvedSpeed) -> None:
        """Take note of what a frame at `t`, s, drives."""
        self._since = inf if not solved.reason else min(self._since, t)
        self._drove_on, self._braked_fully = solved.is_onward, solved.is_full

    def _soft(self) -> tuple[_Attempt, ...]:
        soft = Limits(self._config.comfort)
        return _Attempt(soft), _Attempt(soft, LEAST_RESERVE), _Attempt(soft, LEAST_RESERVE, 0.5 * self._gap)

    def _hard(self, wait: int = 0) -> tuple[_Attempt, ...]:
        """Hard limits after a wait; the hardest give up their reserve and, without a wait, half of the gap.

        Not after full braking, which goes on until the whole gap is kept.
        """
        _, *harder = self._config.ladder()
        rungs = [(limits, RESERVE, 0.0) for limits in harder]
        rungs.append((harder[-1], LEAST_RESERVE, 0.0))
        if not wait and not self._braked_fully:
            rungs.append((harder[-1], LEAST_RESERVE, 0.5 * self._gap))
        before = f"comfortable braking for {wait * STEP_S:.1f} s, then " if wait else ""
        return tuple(
            _Attempt(Limits(limits, self._config.comfort, wait), share, given, before + _keeps(limits, given))
            for limits, share, given in rungs
        )

    def _clearance(self) -> StGraphConfig:
        return TOUCHING if self._drove_on else ONWARD

    def _waits(self, problem: SpeedProblem) -> Iterator[_Attempt]:
        """The longest wait with which the hardest braking still keeps the bounds; the mildest limits after it."""
        for wait in range(round(WAIT_S / STEP_S), 0, -1):
            attempts = self._hard(wait)
            if self._stop(problem, attempts[-1]) is not None:
                yield from attempts
                return

    def _stop(self, problem: SpeedProblem, attempt: _Attempt) -> FloatArray | None:
        """Braking with an attempt's limits, rows s, v, a, where it keeps the bounds."""
        start = _startable(problem.start, attempt.limits)
        stop = attempt.limits.braking(start, self._config.knots, share=attempt.share)
        return None if (stop[0] > _eased(problem, attempt)).any() else stop

    def _attempt(self, problem: SpeedProblem, attempt: _Attempt, tried: list[Artefact]) -> SolvedSpeed | None:
        stop = self._stop(problem, attempt)
        if stop is None:
            return None
        eased = replace(
            problem,
            start=_startable(problem.start, attempt.limits),
            limit=np.maximum(problem.limit, stop[1] + 0.05),
            lower=np.minimum(problem.lower, np.maximum(problem.s_ref, stop[0])),
            upper=_eased(problem, attempt),
        )
        result, costs = self._program.solve(eased, attempt.limits)
        tried += costs, result.report
        if not result.report.solved:
            return None
        return SolvedSpeed(_tidied(result.x.reshape(3, -1)), attempt.reason, artefacts=tuple(tried))

    def _last_resort(self, problem: SpeedProblem, blocks: Callable[[StGraphConfig], Blocks]) -> SolvedSpeed:
        """(5)."""
        full = Limits(self._utmost).braking(problem.start, self._config.knots)
        left = self._gap - float((full[0] - problem.upper).max())
        short = f"leaves {left:.1f} m" if left > 0.0 else f"comes {-left:.1f} m too far"
        onward = self._onward(problem, blocks(replace(self._clearance(), brisk_mps=BRISK_MPS)))
        if onward is not None:
            return SolvedSpeed(onward, f"driving on, which is clear: full braking {short}", is_onward=True)
        touching = blocks(TOUCHING)
        if left > 0.0 or touching.leave(self._times, full[0], 0.0):
            return SolvedSpeed(
                full, f"full braking, which {short if left > 0.0 else 'just does not touch'}", is_full=True
            )
        onward = self._onward(problem, blocks(BARE))
        if onward is not None:
            reason = f"driving on, which just does not touch: full braking {short}"
            return SolvedSpeed(onward, reason, is_onward=True)
        if not touching.meets(self._times, full[0]):
            return SolvedSpeed(full, "full braking, which just does not touch", is_full=True)
        return SolvedSpeed(full, f"full braking {short}", unavoidable=True, is_full=True)

    def _gentle(self, problem: SpeedProblem, blocks: Blocks) -> FloatArray | None:
        """Comfortable braking to a stop, where that stays behind all blocks by some of the gap; else None."""
        soft = Limits(self._config.comfort)
        stop = soft.braking(_startable(problem.start, soft), self._config.knots)
        stays = stop[0, -1] <= problem.end and blocks.leave(self._times, stop[0], LEAST_GAP * self._gap)
        return stop if stays else None

    def _onward(self, problem: SpeedProblem, blocks: Blocks) -> FloatArray | None:
        """Driving on, at the present speed or accelerating, where that enters no block; else None."""
        v0, a0 = problem.start
        for accel in (0.0, self._config.comfort.accel_mps2):
            released = np.minimum(min(a0, 0.0) + RELEASE_MPS3 * self._times, 0.0)
            a = released + max(a0, 0.0) + (accel - max(a0, 0.0)) * np.minimum(self._times / ONWARD_S, 1.0)
            v = np.maximum(v0 + np.r_[0.0, np.cumsum(0.5 * STEP_S * (a[1:] + a[:-1]))], 0.0)
            v = np.minimum(v, np.maximum(problem.limit, v0))
            s = np.r_[0.0, np.cumsum(0.5 * STEP_S * (v[1:] + v[:-1]))]
            if v[-1] > RESTING_MPS and s[-1] <= problem.end and not blocks.meets(self._times, s):
                return np.vstack([s, v, np.gradient(v, STEP_S)])
        return None


def _keeps(limits: SpeedLimits, given: float) -> str:
    kept = "half of the distance" if given > 0.0 else "the distance"
    return f"hard braking, up to {limits.decel_mps2:.1f} m/s2, keeps {kept}"


def _failed(tried: list[Artefact]) -> SolvedSpeed:
    return SolvedSpeed(None, "speed QP: no profile found", artefacts=tuple(tried))


def _eased(problem: SpeedProblem, attempt: _Attempt) -> FloatArray:
    """The upper bounds without what the attempt gives up of the gap; the path's end stays."""
    return np.minimum(problem.upper + attempt.given, problem.end)


def _startable(start: tuple[float, float], limits: Limits) -> tuple[float, float]:
    """Speed and acceleration from which the jerk can stop before reversing."""
    v, a = start
    jerk = limits.first.jerk_mps3 if limits.knots else limits.then.jerk_mps3
    return v, max(a, -float(np.sqrt(2.0 * 0.9 * jerk * v)))


def _tidied(profile: FloatArray) -> FloatArray:
    """The profile without the solver's last micrometres: never backwards, exactly at rest where it rests."""
    s, v, a = profile
    rest = v < 1e-3
    return np.vstack(
        [np.maximum.accumulate(np.maximum(s, 0.0)), np.where(rest, 0.0, v), np.where(rest & (np.abs(a) < 0.02), 0.0, a)]
    )
