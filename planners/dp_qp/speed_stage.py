"""Speed stage: blocked intervals, walls, sight, waverers -> speed DP (who goes first) -> bounds -> speed QP (how hard).

And the S-T graph of it. Hypotheses that are unlikely bind only where hard braking would come too late for them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from logs.frame import Frame
from logs.kernel import FloatArray, IntArray
from logs.states import EgoState
from logs.trace import Artefact, Corridor, Decision, DecisionKind, GraphObstacle, GridCost, StGraph
from logs.vehicle import VehicleParameters
from planners.dp_qp.appointment import HURRIED_GAP_S
from planners.dp_qp.corridor import STANDING_MPS
from planners.dp_qp.path import Path
from planners.dp_qp.sight import sight_limit
from planners.dp_qp.speed_dp import DS_M, DT_S, SpeedDpConfig, cost_map, speed_dp
from planners.dp_qp.speed_qp import (
    STEP_S,
    Limits,
    SpeedProblem,
    SpeedQpConfig,
    braking,
    cruising,
    limit_profile,
)
from planners.dp_qp.speed_solve import RESERVE, SolvedSpeed, SpeedSolver
from planners.dp_qp.st_graph import Blocks, StGraphConfig, block_intervals, decide_speed
from planners.dp_qp.walls import open_end, told, upper_bound, wall_map, wall_outlines, walled
from planners.dp_qp.waverers import Waverers
from planners.piecewise_jerk.solvers import DEFAULT
from planners.rules import Wall

SPEED_ROOM_MPS = 0.8
"""Room above the limit that the reference keeps: a tight tube would cost the solver many iterations."""
TILT_MPS2 = 4.0
"""Lateral acceleration for which a curve is braked for as hard as comfort allows, instead of with `ease_mps2`."""
UNLIKELY = 0.2
"""A hypothesis that is not more probable than this binds only so far that hard braking could still avoid it ..."""
BRANCH_S = 0.5
"""... so long after now."""
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


@dataclass(frozen=True, eq=False, slots=True)
class _Way:
    """What is planned on: a path with its limits `(m,)` and walls, from a start; `blocks` with any margins."""

    frame: Frame
    start: EgoState
    path: Path
    limit: FloatArray
    alone: FloatArray
    walls: Sequence[Wall]
    hurried: bool
    blocks: Callable[[StGraphConfig], Blocks]

    def others(self, margins: StGraphConfig) -> Blocks:
        """Blocks and walls."""
        return walled(self.blocks(margins), self.walls)


class SpeedStage:
    """Chooses the speed of each frame along a path; owns the speed solver."""

    def __init__(
        self, vehicle: VehicleParameters, config: SpeedConfig, lap: Callable[[str], None], solver: str = DEFAULT
    ) -> None:
        self._vehicle, self._config, self._lap = vehicle, config, lap
        self._solver, self._waverers = SpeedSolver(config.qp, config.dp.gap_m, vehicle.max_decel, solver), Waverers()
        self._hard_mps2 = RESERVE * config.qp.emergency.decel_mps2
        dp = config.dp
        self._weights = np.array([dp.w_t, dp.w_a, dp.w_j, dp.max_accel_mps2, dp.max_decel_mps2, dp.w_v])
        self._times = STEP_S * np.arange(config.qp.knots)

    def choose(
        self, frame: Frame, start: EgoState, path: Path, limit: FloatArray, skip: np.ndarray,
        passed: frozenset[str], walls: Sequence[Wall] = (), *, fresh: bool, hurried: bool = False,
        alone: FloatArray | None = None,
    ) -> ChosenSpeed:  # fmt: skip
        """The speed along `path` with the speed limit `(m,)` and stops on it; agents to `skip` `(agents,)`.

        Who is `hurried` follows more closely. `alone` `(m,)` is the limit with nobody on the road
        and nothing hidden, against which the time lost counts (None: that which is driven).
        """

        def blocks(margins: StGraphConfig) -> Blocks:
            return block_intervals(path, frame, self._vehicle, skip, passed, margins)

        found = blocks(self._config.graph)
        self._lap("S-T graph")
        limit, unseen = self._sighted(path, limit, found, frame)
        limit, wavering = self._waverers.limit(path, limit, frame, self._vehicle, found, self._hard_mps2, fresh=fresh)
        shut = path.sigma >= open_end(walls)
        limit, alone = (np.where(shut, 0.0, each) for each in (limit, limit if alone is None else alone))
        way = _Way(frame, start, path, limit, alone, walls, hurried, blocks)
        likely = found.probability > UNLIKELY
        chosen, solved = self._planned(way, found.only(likely), fresh=fresh)
        ignored: tuple[Decision, ...] = ()
        if not likely.all():
            if self._could_stop(solved.profile, found.only(~likely)):
                ignored = _ignored(found.only(~likely), frame)
            else:
                chosen, solved = self._planned(way, found, fresh=fresh)
        self._solver.remember(frame.t, solved)
        told_more = (*ignored, *told(walls), *wavering, *([unseen] if unseen else ()))
        return replace(chosen, artefacts=(*chosen.artefacts, *told_more))

    def _planned(self, way: _Way, blocks: Blocks, *, fresh: bool) -> tuple[ChosenSpeed, SolvedSpeed]:
        """The speed that minds these blocks."""
        frame, path, walls = way.frame, way.path, way.walls
        v_limit = self._reachable(path, np.where(path.sigma >= self._stop_line(blocks, frame), 0.0, way.limit))
        grid, s_dp = self._dp(blocks, v_limit, way)
        decisions = decide_speed(blocks, frame, np.interp(blocks.t, self._times, s_dp))
        self._lap("speed DP")
        state = max(way.start.v, 0.0), way.start.a
        constrained = _meets_movers(blocks, frame) or any(wall.stop.until < np.inf for wall in walls)
        free = self._problem(path, v_limit, s_dp, state, constrained=constrained)
        free = replace(free, upper=upper_bound(walls, self._times, path.length))
        problem = self._bounded(free, blocks, decisions)
        solved = self._solver.solve(problem, way.others, frame.t, fresh=fresh)
        if not _overtakes(blocks, decisions, solved.profile, self._times):
            decisions = tuple(_let_go(decision) for decision in decisions)
            problem, tried = self._bounded(free, blocks, decisions), solved.artefacts
            solved = self._solver.solve(problem, way.others, frame.t, fresh=fresh)
            solved = replace(solved, artefacts=(*tried, *solved.artefacts))
        self._lap("speed QP")
        graph = StGraph(
            grid,
            Corridor(self._times, problem.lower, problem.upper),
            np.column_stack([self._times, s_dp]),
            np.column_stack([self._times, solved.profile[0]]) if solved.profile is not None else np.empty((0, 2)),
            (*_outlines(blocks, decisions), *wall_outlines(walls, float(self._times[-1]), path.length)),
        )
        free_m = float(self._cruise(path, self._reachable(path, way.alone), state)[0, -1])
        artefacts = (graph, *decisions, *solved.artefacts)
        return ChosenSpeed(solved.profile, solved.reason, solved.unavoidable, free_m, blocks, artefacts), solved

    def _sighted(
        self, path: Path, limit: FloatArray, blocks: Blocks, frame: Frame
    ) -> tuple[FloatArray, Decision | None]:
        """The limit with what the ego cannot see in it."""
        first = float(np.nanmin(blocks.lower)) + self._vehicle.axle_to_front if len(blocks) else np.inf
        return sight_limit(path, limit, frame, self._vehicle, first, self._hard_mps2)

    def _could_stop(self, profile: FloatArray | None, blocks: Blocks) -> bool:
        """Whether hard braking, `BRANCH_S` after driving on along a profile, would stay behind these blocks."""
        if profile is None:
            return False
        k, qp = round(BRANCH_S / STEP_S), self._config.qp
        s, v, a = profile[:, k]
        stop = Limits(qp.emergency).braking((v, a), qp.knots - k, share=RESERVE)
        return blocks.leave(self._times, np.r_[profile[0, :k], s + stop[0]], 0.0)

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

    def _dp(self, blocks: Blocks, v_limit: FloatArray, way: _Way) -> tuple[GridCost, FloatArray]:
        """The grid and its solution, stations at the QP's times `(knots,)`."""
        dp, path, start, walls = self._config.dp, way.path, way.start, way.walls
        rows = int(path.length / DS_M + 1e-6) + 1
        limit = np.interp(DS_M * np.arange(rows), path.sigma, v_limit)
        time_gap = min(dp.time_gap_s, HURRIED_GAP_S) if way.hurried else dp.time_gap_s
        wanted = np.array([dp.standstill_gap_m, time_gap])
        occupancy = cost_map(rows, blocks.lower, blocks.upper, blocks.speed, dp.gap_m, wanted, dp.w_near)
        if walls:
            occupancy += wall_map(rows, blocks.t, walls)
        per_column = max(1, round(DT_S / blocks.step))
        ego = np.array([max(start.v, 0.0), start.a])
        cost, chosen = speed_dp(occupancy, per_column, limit, ego, self._weights, dp.columns)
        times = DT_S * np.arange(dp.columns + 1)
        return _thinned(times, cost, chosen), np.interp(self._times, times, DS_M * chosen)

    def _bounded(self, problem: SpeedProblem, blocks: Blocks, decisions: tuple[Decision, ...]) -> SpeedProblem:
        """The problem with its bounds of s: below whom the ego yields to, above whom it overtakes."""
        gap = self._config.dp.gap_m
        upper, lower = problem.upper.copy(), np.zeros(len(self._times))
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
        if (eased[1] ** 2 * np.abs(np.interp(eased[0], path.sigma, path.kappa)) > TILT_MPS2).any():
            eased = braking(*start, qp.comfort.decel_mps2, qp.comfort.jerk_mps3, STEP_S, qp.knots)
        ahead = np.interp(s_ref, path.sigma, v_limit)
        limit = np.maximum(ahead, eased[1]) + SPEED_ROOM_MPS
        nowhere, everywhere = np.zeros(qp.knots), np.full(qp.knots, path.length)
        return SpeedProblem(start, nowhere, everywhere, limit, s_ref, v_ref, path.length)


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


def _ignored(blocks: Blocks, frame: Frame) -> tuple[Decision, ...]:
    """What is told of hypotheses that do not bind."""
    return tuple(
        Decision(
            frame.agents.ids[who], DecisionKind.IGNORE, "speed",
            f"may take the path from {float(np.nanmin(lower)):.1f} m on, but that is unlikely ({share:.0%}); "
            "hard braking could still avoid it",
        )
        for who, lower, share in zip(blocks.agent, blocks.lower, blocks.probability, strict=True)
    )  # fmt: skip


def _meets_movers(blocks: Blocks, frame: Frame) -> bool:
    return bool((frame.agents.speed[blocks.agent] >= STANDING_MPS).any())


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
