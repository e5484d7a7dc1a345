"""Speed stage: S-T boundaries, caps -> speed DP (who goes first) -> bounds -> speed QP (how hard), and the S-T graph.

Hypotheses that are unlikely bind only where hard braking would come too late for them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from logs.kernel import BoolArray, FloatArray, IntArray, kernel
from logs.trace import Artefact, Corridor, Decision, DecisionKind, GridCost, SolverReport, StGraph
from logs.vehicle import VehicleParameters
from planners.dp_qp.scene.caps import CautionConfig, LoweredLimit, PathView, lowered
from planners.dp_qp.scene.goal_window import HURRIED_GAP_S, GoalWindow, SpeedTarget
from planners.dp_qp.scene.hesitant_pedestrians import came_to_path
from planners.dp_qp.scene.pass_target import PassTarget
from planners.dp_qp.scene.producers import OTHERS, OWN
from planners.dp_qp.speed.braking import RESERVE, BrakingLadder, BrakingMemory, Case, SolvedSpeed
from planners.dp_qp.speed.dp import DS_M, DT_S, SpeedDpConfig, cost_map, speed_dp, stop_map
from planners.dp_qp.speed.qp import SpeedProblem, SpeedQpConfig
from planners.frenet.occupancy import Occupancy, upper_bound
from planners.frenet.path import Path
from planners.frenet.profiles import STEP_S, KnotLimits, Limits, braking, cruising, limit_profile
from planners.frenet.scene import UNLIKELY, Scene
from planners.frenet.st_boundaries import (
    StBoundaries,
    StGraphConfig,
    decide_speed,
    decided,
    outlines,
    st_boundaries,
    stop_outlines,
)
from planners.piecewise_jerk.solvers import DEFAULT

SPEED_ROOM_MPS = 0.8
"""Room above the limit, m/s, but not above a cap that is a bound: it makes the profile smooth."""
TILT_MPS2 = 4.0
"""Lateral acceleration for which a curve is braked for as hard as comfort allows, instead of with `ease_mps2`, m/s2."""
BRANCH_S = 0.5
"""An unlikely hypothesis binds only so far that hard braking could still avoid it so long after now, s."""
STAY_M = 0.05
"""Least upper bound of s: to stand still is always allowed, m."""
NOTHING = np.empty(0)
"""Stations of a speed DP that decided nothing."""
DRAWN_ROWS = 4
"""The grid is drawn with every so many rows: a picture does not need more."""


@dataclass(frozen=True)
class SpeedConfig:
    """Settings of the speed stage, by part."""

    graph: StGraphConfig = field(default_factory=StGraphConfig)
    caution: CautionConfig = field(default_factory=CautionConfig)
    dp: SpeedDpConfig = field(default_factory=SpeedDpConfig)
    qp: SpeedQpConfig = field(default_factory=SpeedQpConfig)


@dataclass(frozen=True, eq=False, slots=True)
class SpeedMemory:
    """What the speed stage remembers: how it braked, and who came to the path when, s."""

    braking: BrakingMemory = field(default_factory=BrakingMemory)
    came: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, slots=True)
class SpeedTask:
    """What the speed stage is asked on a path.

    Attributes:
        passed: Agents that the path passes while they stand.
        skip: Agents who follow behind `(agents,)`.
        stops: That the rules demand on the path.
        targets: Those who go along the lane where the ego comes beside them; `is_pass` whether it swings out for them.
        is_pass: See there.
        goal: The goal along the lane; `target` what it asks now.
    """

    passed: frozenset[str]
    skip: BoolArray
    stops: tuple[Occupancy, ...]
    targets: tuple[PassTarget, ...]
    is_pass: bool
    goal: GoalWindow
    target: SpeedTarget


@dataclass(frozen=True, eq=False, slots=True)
class ChosenSpeed:
    """What the speed stage found.

    Attributes:
        profile: Rows s, v, a `(3, knots)` every 0.1 s; None where the QP failed.
        reason: Why it failed or what it could not keep; empty otherwise.
        unavoidable: Whether even the hardest braking would meet an agent.
        free_m: Station at the horizon's end on a free road, m.
        reports: Of the solver.
        artefacts: Makes graph, decisions, costs and reports for whoever wants to see them.
    """

    profile: FloatArray | None
    reason: str
    unavoidable: bool
    free_m: float
    reports: tuple[SolverReport, ...]
    artefacts: Callable[[], tuple[Artefact, ...]]


@dataclass(frozen=True, eq=False, slots=True)
class _Way:
    """What is planned on: the scene on its path, the limit (`own` on an empty road), boundaries by margins."""

    view: PathView
    limit: LoweredLimit
    own: LoweredLimit
    taken: Callable[[StGraphConfig], StBoundaries]
    hurried: bool


@dataclass(frozen=True, eq=False, slots=True)
class _Planned:
    """A solved speed and what it came from; how far driving at the limit comes, m, where no one else lowers it."""

    solved: SolvedSpeed
    problem: SpeedProblem
    blocks: StBoundaries
    kinds: tuple[DecisionKind, ...]
    cannot_be_first: bool
    grid: tuple[FloatArray, IntArray] | None
    s_dp: FloatArray
    free_m: float | None


class SpeedStage:
    """Chooses the speed of each frame along a path."""

    def __init__(
        self, vehicle: VehicleParameters, config: SpeedConfig, lap: Callable[[str], None], solver: str = DEFAULT
    ) -> None:
        self._vehicle, self._config, self._lap = vehicle, config, lap
        self._ladder = BrakingLadder(config.qp, config.dp.gap_m, vehicle.max_decel, solver)
        self._hard_mps2 = RESERVE * config.qp.emergency.decel_mps2
        self._times = STEP_S * np.arange(config.qp.knots)
        self._soft = Limits(config.qp.comfort).columns

    def choose(self, scene: Scene, path: Path, task: SpeedTask, memory: SpeedMemory) -> tuple[ChosenSpeed, SpeedMemory]:
        """The speed along a path; and what is remembered."""
        config, passed = self._config, task.passed
        found = st_boundaries(scene, path, task.skip, passed, config.graph)
        self._lap("S-T graph")
        came = came_to_path(scene, found, memory.came, config.caution.hesitates_s)
        line = scene.reference.line
        road = np.interp(path.s, line.s, scene.reference.limit)
        view = PathView(
            scene, path, road, found, task.stops, task.targets, task.is_pass, task.goal, task.target, came,
            self._hard_mps2, config.graph.vulnerable_margin_m, config.caution,
        )  # fmt: skip
        bare = LoweredLimit(road, np.zeros(len(road), np.bool_))
        own = lowered(path.sigma, bare, (cap for caps in OWN for cap in caps(view)))
        limit = lowered(path.sigma, own, (cap for caps in OTHERS for cap in caps(view)))

        @cache
        def taken(margins: StGraphConfig) -> StBoundaries:
            """The boundaries with other margins: of those who are in the way, unless they may be faster than now."""
            skip = task.skip
            if margins.brisk_mps <= config.graph.brisk_mps:
                skip = np.ones(len(skip), np.bool_)
                skip[found.agent] = False
            return st_boundaries(scene, path, skip, passed, margins).with_stops(task.stops)

        way = _Way(view, limit, own, taken, task.target.hurried)
        likely = found.probability > UNLIKELY
        planned = self._planned(way, found.only(likely) if not likely.all() else found, memory.braking)
        unlikely = None
        if not likely.all():
            if self._could_stop(planned.solved.profile, found.only(~likely)):
                unlikely = found.only(~likely)
            else:
                planned = self._planned(way, found, memory.braking)
        solved = planned.solved
        free_m = self._free_m(way) if planned.free_m is None else planned.free_m
        chosen = ChosenSpeed(
            solved.profile, solved.reason, solved.unavoidable, free_m, solved.reports,
            lambda: self._artefacts(way, planned, unlikely),
        )  # fmt: skip
        return chosen, SpeedMemory(memory.braking.after(scene.frame.t, solved), came)

    def _planned(self, way: _Way, blocks: StBoundaries, memory: BrakingMemory) -> _Planned:
        """The speed that keeps to these boundaries."""
        scene, path, stops = way.view.scene, way.view.path, way.view.stops
        limit = way.limit.v
        stop_line = self._stop_line(blocks, scene)
        if stop_line < path.length:
            limit = np.where(path.sigma >= stop_line, 0.0, limit)
        v_limit = self._reachable(path, limit)
        grid = self._grid(blocks, v_limit, way) if len(blocks) or stops else None
        s_dp = self._dp_stations(grid) if grid is not None else np.zeros(len(self._times))
        at = np.interp(blocks.t, self._times, s_dp)
        kinds = tuple(decided(blocks, scene, at, row) for row in range(len(blocks)))
        self._lap("speed DP")
        moves = bool((~scene.standing[blocks.agent]).any()) or any(stop.until < np.inf for stop in stops)
        free, free_m = self._problem(way, v_limit, s_dp if moves else NOTHING)
        problem = self._bounded(free, blocks, kinds) if len(blocks) else free
        solved = self._ladder.solve(Case(problem, way.taken, scene.frame.t, memory))
        cannot_be_first = not _overtakes(blocks, kinds, solved.profile, self._times)
        if cannot_be_first:
            kinds = tuple(DecisionKind.YIELD if kind is DecisionKind.OVERTAKE else kind for kind in kinds)
            problem, tried = self._bounded(free, blocks, kinds), solved.asked
            solved = self._ladder.solve(Case(problem, way.taken, scene.frame.t, memory))
            solved = replace(solved, asked=(*tried, *solved.asked))
        self._lap("speed QP")
        alone = free_m if limit is way.own.v else None
        return _Planned(solved, problem, blocks, kinds, cannot_be_first, grid, s_dp, alone)

    def _could_stop(self, profile: FloatArray | None, blocks: StBoundaries) -> bool:
        """Whether hard braking, `BRANCH_S` after driving on along a profile, would stay behind these boundaries."""
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

    def _free_m(self, way: _Way) -> float:
        """How far the ego would come on an empty road, m."""
        scene, path, soft = way.view.scene, way.view.path, self._soft
        v_limit = self._reachable(path, way.own.v)
        start, knots = (scene.v, scene.start.a), self._config.qp.knots
        free = cruising(path.sigma, v_limit, *start, soft.accel, soft.decel, soft.jerk, STEP_S, knots)
        return float(free[0, -1])

    def _stop_line(self, blocks: StBoundaries, scene: Scene) -> float:
        """Station before the first that stands in the path, m; inf where none does."""
        if not len(blocks):
            return np.inf
        entries = blocks.lower[scene.standing[blocks.agent]]
        if not len(entries):
            return np.inf
        return max(float(np.nanmin(entries)) - self._config.dp.standstill_gap_m, 0.0)

    def _grid(self, blocks: StBoundaries, v_limit: FloatArray, way: _Way) -> tuple[FloatArray, IntArray]:
        """Cost of the grid and its solution."""
        dp, path, scene, stops = self._config.dp, way.view.path, way.view.scene, way.view.stops
        rows = int(path.length / DS_M + 1e-6) + 1
        limit = np.interp(DS_M * np.arange(rows), path.sigma, v_limit)
        time_gap = min(dp.time_gap_s, HURRIED_GAP_S) if way.hurried else dp.time_gap_s
        wanted = np.array([dp.standstill_gap_m, time_gap])
        occupancy = cost_map(rows, blocks.lower, blocks.upper, blocks.speed, dp.gap_m, wanted, dp.w_near)
        if stops:
            occupancy += stop_map(rows, blocks.t, stops)
        per_column = max(1, round(DT_S / blocks.step))
        return speed_dp(occupancy, per_column, limit, np.array([scene.v, scene.start.a]), dp.weights, dp.columns)

    def _dp_stations(self, grid: tuple[FloatArray, IntArray]) -> FloatArray:
        """The grid's solution at the QP's times `(knots,)`, m."""
        return np.interp(self._times, DT_S * np.arange(self._config.dp.columns + 1), DS_M * grid[1])

    def _bounded(self, problem: SpeedProblem, blocks: StBoundaries, kinds: tuple[DecisionKind, ...]) -> SpeedProblem:
        """The problem with its bounds of s: below those that the ego yields to, above those that it overtakes."""
        gap = self._config.dp.gap_m
        upper, lower = problem.upper.copy(), np.zeros(len(self._times))
        reach = 0.5 * blocks.step + 1e-9
        near = np.searchsorted(blocks.t, self._times - reach), np.searchsorted(blocks.t, self._times + reach) - 1
        sides = [np.clip(side, 0, len(blocks.t) - 1) for side in near]
        for i, kind in enumerate(kinds):
            if kind is DecisionKind.OVERTAKE:
                edge = np.fmax(blocks.upper[i, sides[0]], blocks.upper[i, sides[1]]) + gap
                lower = np.fmax(lower, np.where(np.isfinite(edge), edge, 0.0))
            else:
                edge = np.fmin(blocks.lower[i, sides[0]], blocks.lower[i, sides[1]]) - gap
                upper = np.fmin(upper, edge)
        upper = np.maximum(upper, STAY_M)
        return problem._replace(lower=np.minimum(lower, upper), upper=upper)

    def _problem(self, way: _Way, v_limit: FloatArray, s_dp: FloatArray) -> tuple[SpeedProblem, float]:
        """What is wanted and the limit, with nothing in the way but stops, and how far driving at the limit comes, m.

        `s_dp` is `(knots,)` where an agent moves, else empty.
        """
        qp, path, scene = self._config.qp, way.view.path, way.view.scene
        start, soft = (scene.v, scene.start.a), self._soft
        s_ref, v_ref, limit, free_m = _wanted(
            path.sigma, path.kappa, v_limit, way.limit.is_bound, s_dp, start, soft, qp.ease_mps2, qp.knots
        )
        upper = upper_bound(way.view.stops, self._times, path.length)
        return SpeedProblem(start, np.zeros(qp.knots), upper, limit, s_ref, v_ref, path.length), free_m

    def _artefacts(self, way: _Way, planned: _Planned, unlikely: StBoundaries | None) -> tuple[Artefact, ...]:
        """Graph (with the DP where it was run), decisions, costs and reports."""
        scene, path, stops = way.view.scene, way.view.path, way.view.stops
        blocks, solved = planned.blocks, planned.solved
        drawn, s_dp = planned.grid, planned.s_dp
        decisions = decide_speed(blocks, scene, np.interp(blocks.t, self._times, s_dp))
        if planned.cannot_be_first:
            decisions = tuple(_let_go(decision) for decision in decisions)
        profile = solved.profile
        graph = StGraph(
            _thinned(DT_S * np.arange(self._config.dp.columns + 1), *drawn) if drawn is not None else None,
            Corridor(self._times, planned.problem.lower, planned.problem.upper),
            np.column_stack([self._times, s_dp]) if drawn is not None else np.empty((0, 2)),
            np.column_stack([self._times, profile[0]]) if profile is not None else np.empty((0, 2)),
            (*outlines(blocks, decisions), *stop_outlines(stops, float(self._times[-1]), path.length)),
        )
        ignored = _ignored(unlikely, scene) if unlikely is not None else ()
        asked = (stop.decision for stop in stops)
        costs = self._ladder.program.costs
        asked_qps = (part for each in solved.asked for part in (costs(each.result.x, each.problem), each.result.report))
        return (graph, *decisions, *asked_qps, *ignored, *asked, *way.limit.decisions)


@kernel
def _wanted(
    sigma: FloatArray, kappa: FloatArray, v_limit: FloatArray, is_bound: BoolArray, s_dp: FloatArray,
    start: tuple[float, float], soft: KnotLimits, ease: float, knots: int,
) -> tuple[FloatArray, FloatArray, FloatArray, float]:  # fmt: skip
    """References of s and v and the limit of v `(knots,)`, and how far driving at the limit comes, m.

    Args:
        sigma: Arc lengths `(m,)`, m.
        kappa: Of the path `(m,)`, 1/m.
        v_limit: Speed limit along it `(m,)`, m/s.
        is_bound: Where that is kept exactly `(m,)`.
        s_dp: Stations of the speed DP `(knots,)`; empty: it decided nothing.
        start: v, a.
        soft: Limits of comfort.
        ease: Deceleration towards a lower limit, m/s2.
        knots: Of the profile.
    """
    v0, a0 = start
    free = cruising(sigma, v_limit, v0, a0, soft.accel, soft.decel, soft.jerk, STEP_S, knots)
    s_ref, v_ref = free[0].copy(), free[1].copy()
    if len(s_dp):
        s_ref = np.minimum(s_ref, s_dp)
        for i in range(knots):
            low, high = max(i - 1, 0), min(i + 1, knots - 1)
            v_ref[i] = min(v_ref[i], (s_ref[high] - s_ref[low]) / ((high - low) * STEP_S))
    eased = braking(v0, a0, ease, soft.jerk, STEP_S, knots)
    if (eased[1] ** 2 * np.abs(np.interp(eased[0], sigma, kappa)) > TILT_MPS2).any():
        eased = braking(v0, a0, soft.decel, soft.jerk, STEP_S, knots)
    ahead, at = np.interp(s_ref, sigma, v_limit), np.searchsorted(sigma, s_ref)
    limit = np.empty(knots)
    for i in range(knots):
        room = 0.0 if is_bound[min(at[i], len(sigma) - 1)] else SPEED_ROOM_MPS
        limit[i] = max(ahead[i], eased[1, i]) + room
    return s_ref, v_ref, limit, free[0, -1]


def _overtakes(
    blocks: StBoundaries, kinds: Sequence[DecisionKind], profile: FloatArray | None, times: FloatArray
) -> bool:
    """Whether a profile stays clear of all that it should overtake; the DP knows nothing of jerk."""
    overtaken = [i for i, kind in enumerate(kinds) if kind is DecisionKind.OVERTAKE]
    if profile is None or not overtaken:
        return not overtaken
    s = np.interp(blocks.t, times, profile[0])
    return not ((s > blocks.lower[overtaken]) & (s < blocks.upper[overtaken])).any()


def _let_go(decision: Decision) -> Decision:
    if decision.kind is not DecisionKind.OVERTAKE:
        return decision
    return replace(decision, kind=DecisionKind.YIELD, reason=f"{decision.reason}; the ego cannot be there first")


def _ignored(blocks: StBoundaries, scene: Scene) -> tuple[Decision, ...]:
    """What is decided about hypotheses that do not bind."""
    return tuple(
        Decision(
            scene.frame.agents.ids[who], DecisionKind.IGNORE, "speed",
            f"may take the path from {float(np.nanmin(lower)):.1f} m on, but that is unlikely ({share:.0%}); "
            "hard braking could still avoid it",
        )
        for who, lower, share in zip(blocks.agent, blocks.lower, blocks.probability, strict=True)
    )  # fmt: skip


def _thinned(times: FloatArray, cost: FloatArray, chosen: IntArray) -> GridCost:
    """The grid for the record, every fourth row."""
    rows = DS_M * DRAWN_ROWS * np.arange(len(cost[0, ::DRAWN_ROWS]))
    return GridCost(times, rows, cost[:, ::DRAWN_ROWS], chosen // DRAWN_ROWS)
