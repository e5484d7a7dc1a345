"""Speed stage: blocked intervals -> speed DP (who goes first) -> bounds -> speed QP, and the S-T graph of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from logs.frame import Frame
from logs.kernel import FloatArray, IntArray
from logs.states import EgoState
from logs.trace import Artefact, Corridor, Decision, DecisionKind, GraphObstacle, GridCost, StGraph
from logs.vehicle import VehicleParameters
from planners.dp_qp.corridor import STANDING_MPS
from planners.dp_qp.path import Path
from planners.dp_qp.speed_dp import DS_M, DT_S, SpeedDpConfig, cost_map, speed_dp
from planners.dp_qp.speed_qp import (
    STEP_S,
    SpeedLimits,
    SpeedProblem,
    SpeedQp,
    SpeedQpConfig,
    braking,
    cruising,
    limit_profile,
)
from planners.dp_qp.st_graph import TOUCHING, Blocks, StGraphConfig, block_intervals, decide_speed

RESERVE = 0.85
"""Share of the limits with which braking must keep the bounds, so that the QP has room to be smooth."""
LEAST_RESERVE = 0.97
"""The same where braking would turn hard otherwise."""


SPEED_ROOM_MPS = 0.8
"""Room above the limit that the reference keeps: a tight tube would cost the solver many iterations."""


ONWARD_S = 0.5
"""Driving on instead of braking reaches its acceleration within this time."""

STAY_M = 0.05
"""Least upper bound of s."""


@dataclass(frozen=True)
class SpeedConfig:
    """Settings of the speed stage, by part."""

    graph: StGraphConfig = field(default_factory=StGraphConfig)
    dp: SpeedDpConfig = field(default_factory=SpeedDpConfig)
    qp: SpeedQpConfig = field(default_factory=SpeedQpConfig)


@dataclass(frozen=True, eq=False, slots=True)
class ChosenSpeed:
    """What the speed stage found.

    Attributes:
        profile: Rows s, v, a `(3, knots)` every 0.1 s; None where the QP failed.
        reason: Why it failed or what it could not keep; empty otherwise.
        unavoidable: Whether even the hardest braking would meet somebody.
        free_m: Station at the horizon's end with nobody in the way, m.
        blocks: Who takes the path when.
        artefacts: Graph, decisions, costs, solver report.
    """

    profile: FloatArray | None
    reason: str
    unavoidable: bool
    free_m: float
    blocks: Blocks
    artefacts: tuple[Artefact, ...]


class SpeedStage:
    """Chooses the speed of each frame along a path; owns the QP workspace."""

    def __init__(self, vehicle: VehicleParameters, config: SpeedConfig, lap: Callable[[str], None]) -> None:
        self._vehicle, self._config, self._lap = vehicle, config, lap
        self._program = SpeedQp(config.qp)
        dp = config.dp
        self._weights = np.array([dp.w_v, dp.w_a, dp.w_j, dp.max_accel_mps2, dp.max_decel_mps2])
        self._times = STEP_S * np.arange(config.qp.knots)

    def choose(
        self, frame: Frame, start: EgoState, path: Path, limit: FloatArray, skip: np.ndarray,
        passed: frozenset[str], *, fresh: bool,
    ) -> ChosenSpeed:  # fmt: skip
        """The speed along `path` with the road's speed limit `(m,)` on it; agents to `skip` `(agents,)`."""
        blocks = block_intervals(path, frame, self._vehicle, skip, passed, self._config.graph)
        self._lap("S-T graph")
        v_open = self._reachable(path, limit)
        v_limit = self._reachable(path, np.where(path.sigma >= self._stop_line(blocks, frame), 0.0, limit))
        grid, s_dp = self._dp(blocks, path, v_limit, start)
        decisions = decide_speed(blocks, frame, np.interp(blocks.t, self._times, s_dp))
        self._lap("speed DP")
        state = _startable(start.v, start.a, self._config.qp.comfort.jerk_mps3)
        free = self._problem(path, v_limit, s_dp, state, constrained=_meets_movers(blocks, frame))
        problem = self._bounded(free, blocks, decisions, path)
        touching = partial(block_intervals, path, frame, self._vehicle, skip, passed, TOUCHING)
        solved = self._solve(problem, touching, fresh=fresh)
        if not _overtakes(blocks, decisions, solved.profile, self._times):
            decisions = tuple(_let_go(decision) for decision in decisions)
            problem, tried = self._bounded(free, blocks, decisions, path), solved.artefacts
            solved = self._solve(problem, touching, fresh=fresh)
            solved = replace(solved, artefacts=(*tried, *solved.artefacts))
        self._lap("speed QP")
        graph = StGraph(
            grid,
            Corridor(self._times, problem.lower, problem.upper),
            np.column_stack([self._times, s_dp]),
            np.column_stack([self._times, solved.profile[0]]) if solved.profile is not None else np.empty((0, 2)),
            _outlines(blocks, decisions),
        )
        return ChosenSpeed(
            solved.profile,
            solved.reason,
            solved.unavoidable,
            float(self._cruise(path, v_open, state)[0, -1]),
            blocks,
            (graph, *decisions, *solved.artefacts),
        )

    def _reachable(self, path: Path, limit: FloatArray) -> FloatArray:
        """The speed limit `(m,)` with curves and comfortable braking in it."""
        qp = self._config.qp
        return limit_profile(path.sigma, path.kappa, limit, qp.curve_accel_mps2, qp.ease_mps2)

    def _cruise(self, path: Path, v_limit: FloatArray, start: tuple[float, float]) -> FloatArray:
        """Rows s, v `(2, knots)` of driving at a limit."""
        qp = self._config.qp
        soft = qp.comfort
        return cruising(path.sigma, v_limit, *start, soft.accel_mps2, soft.decel_mps2, soft.jerk_mps3, STEP_S, qp.knots)

    def _stop_line(self, blocks: Blocks, frame: Frame) -> float:
        """Station before the first who stands in the path, m; inf where nobody does."""
        standing = frame.agents.speed[blocks.agent] < STANDING_MPS
        entries = blocks.lower[standing]
        if not len(entries):
            return np.inf
        return max(float(np.nanmin(entries)) - self._config.dp.standstill_gap_m, 0.0)

    def _dp(self, blocks: Blocks, path: Path, v_limit: FloatArray, start: EgoState) -> tuple[GridCost, FloatArray]:
        """The grid and its solution, stations at the QP's times `(knots,)`."""
        dp = self._config.dp
        rows = int(path.length / DS_M) + 1
        limit = np.interp(DS_M * np.arange(rows), path.sigma, v_limit)
        wanted = np.array([dp.standstill_gap_m, dp.time_gap_s])
        occupancy = cost_map(rows, blocks.lower, blocks.upper, blocks.speed, dp.gap_m, wanted, dp.w_near)
        per_column = max(1, round(DT_S / blocks.step))
        ego = np.array([max(start.v, 0.0), start.a])
        cost, chosen = speed_dp(occupancy, per_column, limit, ego, self._weights, dp.columns)
        times = DT_S * np.arange(dp.columns + 1)
        return _thinned(times, cost, chosen), np.interp(self._times, times, DS_M * chosen)

    def _bounded(
        self, problem: SpeedProblem, blocks: Blocks, decisions: tuple[Decision, ...], path: Path
    ) -> SpeedProblem:
        """The problem with its bounds of s: below whom the ego yields to, above whom it overtakes."""
        gap = self._config.dp.gap_m
        upper, lower = np.full(len(self._times), path.length), np.zeros(len(self._times))
        reach = 0.5 * blocks.step + 1e-9
        for i, decision in enumerate(decisions):
            near = np.searchsorted(blocks.t, self._times - reach), np.searchsorted(blocks.t, self._times + reach) - 1
            sides = [np.clip(side, 0, len(blocks.t) - 1) for side in near]
            if decision.kind is DecisionKind.OVERTAKE:
                edge = np.fmax(blocks.upper[i, sides[0]], blocks.upper[i, sides[1]]) + gap
                lower = np.fmax(lower, np.where(np.isfinite(edge), edge, 0.0))
            else:
                edge = np.fmin(blocks.lower[i, sides[0]], blocks.lower[i, sides[1]]) - gap
                upper = np.fmin(upper, edge)
        upper = np.maximum(upper, STAY_M)  # to stand still is always allowed, even where somebody may run into the ego
        return replace(problem, lower=np.minimum(lower, upper), upper=upper)

    def _problem(
        self, path: Path, v_limit: FloatArray, s_dp: FloatArray, start: tuple[float, float], *, constrained: bool
    ) -> SpeedProblem:
        """What is wanted and the limit, with nobody in the way."""
        qp = self._config.qp
        free = self._cruise(path, v_limit, start)
        s_ref, v_ref = free
        if constrained:
            s_ref = np.minimum(free[0], s_dp)
            v_ref = np.minimum(free[1], np.gradient(s_ref, STEP_S))
        eased = braking(*start, qp.ease_mps2, qp.comfort.jerk_mps3, STEP_S, qp.knots)
        ahead = np.interp(s_ref, path.sigma, v_limit)
        limit = np.maximum(ahead, eased[1]) + SPEED_ROOM_MPS
        nowhere, everywhere = np.zeros(qp.knots), np.full(qp.knots, path.length)
        return SpeedProblem(start, nowhere, everywhere, limit, s_ref, v_ref)

    def _solve(self, problem: SpeedProblem, touching: Callable[[], Blocks], *, fresh: bool) -> SolvedSpeed:
        """Comfortable limits where they can keep the bounds, else the mildest that can, else the hardest braking."""
        qp = self._config.qp
        artefacts: tuple[Artefact, ...] = ()
        for limits, reserve, given in self._attempts():
            reason = (
                "" if limits is qp.comfort else f"hard braking, up to {limits.decel_mps2:.1f} m/s2, keeps the distance"
            )
            upper = np.minimum(problem.upper + given, problem.upper.max())
            stop = braking(*problem.start, reserve * limits.decel_mps2, reserve * limits.jerk_mps3, STEP_S, qp.knots)
            if (stop[0] > upper).any():
                continue
            limit = np.maximum(problem.limit, stop[1] + 0.05)
            lower = np.minimum(problem.lower, np.maximum(problem.s_ref, stop[0]))
            result, costs = self._program.solve(
                replace(problem, limit=limit, lower=lower, upper=upper), limits, fresh=fresh
            )
            artefacts = (*artefacts, costs, result.report)
            if result.report.solved:
                return SolvedSpeed(_tidied(result.x.reshape(3, -1)), reason, False, artefacts)
            if (lower > 0.0).any():
                break  # whom the ego cannot overtake with one deceleration it cannot overtake with another
        if artefacts:
            return SolvedSpeed(None, "speed QP: no profile found", False, artefacts)
        stop = braking(*problem.start, qp.emergency.decel_mps2, qp.emergency.jerk_mps3, STEP_S, qp.knots)
        left = self._config.dp.gap_m - float((stop[0] - problem.upper).max())
        if left > 0.0:
            return SolvedSpeed(stop, f"hardest braking, which leaves {left:.1f} m", False, ())
        boxes = touching()
        if not boxes.meets(self._times, stop[0]):
            return SolvedSpeed(stop, "hardest braking, which just does not touch", False, ())
        onward = self._onward(problem, boxes)
        if onward is not None:
            return SolvedSpeed(onward, f"driving on: hardest braking comes {-left:.1f} m too far", False, ())
        return SolvedSpeed(stop, f"hardest braking comes {-left:.1f} m too far", True, ())

    def _attempts(self) -> tuple[tuple[SpeedLimits, float, float], ...]:
        """Limits, share of them with which braking must keep the bounds, and what of the gap is given up, m.

        Comfort gives up its reserve, then half of the gap, before braking turns hard.
        """
        comfort, *harder = self._config.qp.ladder()
        half = 0.5 * self._config.dp.gap_m
        soft = ((comfort, RESERVE, 0.0), (comfort, LEAST_RESERVE, 0.0), (comfort, LEAST_RESERVE, half))
        return (*soft, *((limits, RESERVE, 0.0) for limits in harder))

    def _onward(self, problem: SpeedProblem, blocks: Blocks) -> FloatArray | None:
        """Driving on, at the present speed or accelerating, where that meets nobody as predicted; else None."""
        v0, a0 = problem.start
        for accel in (0.0, self._config.qp.comfort.accel_mps2):
            a = a0 + np.clip(accel - a0, -1.0, 1.0) * np.minimum(self._times / ONWARD_S, 1.0)
            v = np.maximum(v0 + np.r_[0.0, np.cumsum(0.5 * STEP_S * (a[1:] + a[:-1]))], 0.0)
            v = np.minimum(v, np.maximum(problem.limit, v0))
            s = np.r_[0.0, np.cumsum(0.5 * STEP_S * (v[1:] + v[:-1]))]
            if not blocks.meets(self._times, s):
                return np.vstack([s, v, np.gradient(v, STEP_S)])
        return None


@dataclass(frozen=True, eq=False, slots=True)
class SolvedSpeed:
    """Rows s, v, a `(3, knots)` or None, why, whether nothing could keep the distance, costs and reports."""

    profile: FloatArray | None
    reason: str
    unavoidable: bool
    artefacts: tuple[Artefact, ...]


def _overtakes(blocks: Blocks, decisions: tuple[Decision, ...], profile: FloatArray | None, times: FloatArray) -> bool:
    """Whether a profile stays clear of everybody whom it should overtake; the DP knows nothing of jerk."""
    overtaken = [i for i, decision in enumerate(decisions) if decision.kind is DecisionKind.OVERTAKE]
    if profile is None or not overtaken:
        return not overtaken
    s = np.interp(blocks.t, times, profile[0])
    return not ((s > blocks.lower[overtaken]) & (s < blocks.upper[overtaken])).any()


def _let_go(decision: Decision) -> Decision:
    if decision.kind is not DecisionKind.OVERTAKE:
        return decision
    return replace(decision, kind=DecisionKind.YIELD, reason=f"{decision.reason}; the ego cannot be there first")


def _meets_movers(blocks: Blocks, frame: Frame) -> bool:
    return bool((frame.agents.speed[blocks.agent] >= STANDING_MPS).any())


def _startable(v: float, a: float, jerk: float) -> tuple[float, float]:
    """Speed and acceleration from which the jerk can stop before reversing."""
    v = max(v, 0.0)
    return v, max(a, -float(np.sqrt(2.0 * 0.9 * jerk * v)))


def _tidied(profile: FloatArray) -> FloatArray:
    """The profile without the solver's last micrometres: never backwards, exactly at rest where it rests."""
    s, v, a = profile
    rest = v < 1e-3
    return np.vstack(
        [np.maximum.accumulate(np.maximum(s, 0.0)), np.where(rest, 0.0, v), np.where(rest & (np.abs(a) < 0.02), 0.0, a)]
    )


def _thinned(times: FloatArray, cost: FloatArray, chosen: IntArray) -> GridCost:
    """The grid for the record, every fourth row: a picture does not need more."""
    stride = 4
    return GridCost(times, DS_M * stride * np.arange(len(cost[0, ::stride])), cost[:, ::stride], chosen // stride)


def _outlines(blocks: Blocks, decisions: tuple[Decision, ...]) -> tuple[GraphObstacle, ...]:
    found = []
    for i, decision in enumerate(decisions):
        taken = np.isfinite(blocks.lower[i])
        t, low, high = blocks.t[taken], blocks.lower[i, taken], blocks.upper[i, taken]
        outline = np.vstack([np.column_stack([t, low]), np.column_stack([t, high])[::-1]])
        found.append(GraphObstacle(decision.agent, outline, decision.kind))
    return tuple(found)
