"""Speed stage: S-T boundaries, caps -> speed DP (order of passing) -> bounds -> speed QP (profile),
and the S-T graph.

`doubt` decides how far a prediction binds. An agent that the ego yielded to stays first, unless the
ego could be first with `CHANGE_S` to spare.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.core.settings import Config
from replan.logs.frame import PlannerContext
from replan.logs.plan import (
    Artefact,
    Corridor,
    Decision,
    DecisionKind,
    GridCost,
    SolverReport,
    StGraph,
)
from replan.planners.dp_qp.goal_window import HURRIED_GAP_S
from replan.planners.dp_qp.speed import doubt
from replan.planners.dp_qp.speed.caps import (
    OTHERS,
    OWN,
    CautionConfig,
    LoweredLimit,
    PathView,
    SpeedTask,
    came_to_path,
    lower_limit,
)
from replan.planners.dp_qp.speed.dp import COLLISION, DS_M, DT_S, SpeedDpConfig
from replan.planners.dp_qp.speed.problem import (
    BuiltProblem,
    PathLimits,
    Settings,
    Taken,
    build_problem,
)
from replan.planners.dp_qp.speed.qp import (
    RESERVE,
    TOLERANCE,
    Attempts,
    BrakingLadder,
    SolvedSpeed,
    SpeedQpConfig,
)
from replan.planners.frenet.path import Path
from replan.planners.frenet.profiles import STEP_S
from replan.planners.frenet.scene import STANDING_MPS, Scene
from replan.planners.frenet.st_boundaries import (
    ALONG,
    OVERTAKE,
    YIELD,
    StBoundaries,
    StGraphConfig,
    decide_speed,
    outlines,
    st_boundaries,
    stop_outlines,
)
from replan.planners.piecewise_jerk.solvers import DEFAULT

# Delay with which the ego must still be first to overtake an agent that it yielded to, s
CHANGE_S = 0.5
FIRST_S = 1.0
"""The same for an agent that crosses, if braking with `LETS_MPS2` is enough to yield: it may come
sooner, s.
"""
# Deceleration with which the ego yields to a vehicle, and to a pedestrian or rider, m/s2
LETS_MPS2 = 3.0, 4.5
DOUBTED = "that is doubted: comfortable braking is all that is done"
ORDERS = {DecisionKind.YIELD: ("yielding", 1e6), DecisionKind.OVERTAKE: ("going first", -1e6)}
"""The orders of passing between which the speed DP decides: name, and the bound (m) that leaves
only this order.
"""
COLLIDES = 0.01 * COLLISION  # A solution of the DP that costs more is inside a blocked interval
NO_STOPS = np.empty((0, 2))  # No stops
DRAWN_ROWS = 4  # Step between the grid's rows in the S-T graph: a picture does not need more


@dataclass(frozen=True)
class SpeedConfig(Config):
    """Settings of the speed stage, by part."""

    graph: StGraphConfig = field(default_factory=StGraphConfig)
    caution: CautionConfig = field(default_factory=CautionConfig)
    dp: SpeedDpConfig = field(default_factory=SpeedDpConfig)
    qp: SpeedQpConfig = field(default_factory=SpeedQpConfig)


@dataclass(frozen=True, eq=False, slots=True)
class SpeedMemory:
    """Memory of the speed stage: whether it braked fully, when agents came to the path, s, and
    those it yielded to.
    """

    braked_fully: bool = False
    came: Mapping[str, float] = field(default_factory=dict)
    waits: frozenset[str] = frozenset()


@dataclass(frozen=True, eq=False, slots=True)
class ChosenSpeed:
    """The result of the speed stage: rows s, v, a `(3, knots)` every 0.1 s, or None; the reason if
    not comfortable.

    `unavoidable`: whether even the hardest braking would meet an agent; `free_m`: the station at
    the horizon's end on a free road, m; `artefacts` makes them when it is called.
    """

    profile: FloatArray | None
    reason: str
    unavoidable: bool
    free_m: float
    reports: tuple[SolverReport, ...]
    artefacts: Callable[[], tuple[Artefact, ...]]


@dataclass(frozen=True, eq=False, slots=True)
class _SpeedInput:
    """The input of a plan: the scene on its path, the limits there and decisions of the caps, the
    stops, the memory.

    `taken` returns the boundaries of some agents with other margins, stops included.
    """

    view: PathView
    limits: PathLimits
    decisions: tuple[Decision, ...]
    stops: FloatArray
    taken: Callable[[IntArray, StGraphConfig], StBoundaries]
    memory: SpeedMemory


@dataclass(frozen=True, eq=False, slots=True)
class _Planned:
    """A solved speed and the data that it was made from."""

    solved: SolvedSpeed
    built: BuiltProblem
    blocks: StBoundaries
    may_overtake: BoolArray
    sure: IntArray


class SpeedStage:
    """Chooses the speed of each frame along a path."""

    def __init__(self, context: PlannerContext, config: SpeedConfig, solver: str = DEFAULT) -> None:
        self._config, self._lap = config, context.lap
        qp, dp = config.qp, config.dp
        self._ladder = BrakingLadder(qp, dp.gap_m, context.vehicle.max_decel, solver)
        self._hard_mps2 = RESERVE * qp.emergency.decel_mps2
        self._times = STEP_S * np.arange(qp.knots)
        self._shared = replace(qp.emergency, decel_mps2=doubt.SHARED_MPS2)
        self._settings = Settings(
            qp.knots,
            qp.curve_accel_mps2,
            qp.ease_mps2,
            qp.comfort.columns,
            dp.columns,
            dp.weights,
            dp.gap_m,
            dp.standstill_gap_m,
            dp.w_near,
        )

    def choose(
        self, scene: Scene, path: Path, task: SpeedTask, memory: SpeedMemory
    ) -> tuple[ChosenSpeed, SpeedMemory]:
        """Choose the speed along a path; and the new memory."""
        config = self._config
        boundaries = doubt.extend_braking(
            scene, st_boundaries(scene, path, task.skip, task.passed, config.graph)
        )
        self._lap("S-T graph")
        reached_at = came_to_path(scene, boundaries, memory.came, config.caution.hesitates_s)
        road = np.interp(path.s, scene.reference.line.s, scene.reference.limit)
        view = PathView(
            scene,
            path,
            task,
            road,
            boundaries,
            reached_at,
            self._hard_mps2,
            config.graph.vulnerable_margin_m,
            config.caution,
        )
        bare = LoweredLimit(road, np.zeros(len(road), np.bool_))
        own = lower_limit(path.sigma, bare, [cap for caps in OWN for cap in caps(view)])
        limit = lower_limit(path.sigma, own, [cap for caps in OTHERS for cap in caps(view)])

        def taken(agent: IntArray, margins: StGraphConfig) -> StBoundaries:
            """The boundaries of these agents with other margins."""
            skip = np.ones(len(task.skip), np.bool_)
            skip[agent] = False
            rows = doubt.extend_braking(
                scene, st_boundaries(scene, path, skip, task.passed, margins)
            )
            return rows.with_stops(task.stops)

        limits = PathLimits(
            path.sigma, path.kappa, own.v, limit.v, limit.is_bound, limit.v is not own.v
        )
        stops = (
            np.array([(stop.s_from, stop.until) for stop in task.stops]) if task.stops else NO_STOPS
        )
        on_path = _SpeedInput(view, limits, limit.decisions, stops, taken, memory)
        planned, unlikely = self._plan_with_doubt(on_path, boundaries)
        solved = planned.solved
        chosen = ChosenSpeed(
            solved.profile,
            solved.reason,
            solved.unavoidable,
            planned.built.free_m,
            solved.reports,
            lambda: self._artefacts(on_path, planned, unlikely),
        )
        waits = frozenset(
            scene.frame.agents.ids[agent]
            for agent in planned.blocks.agent[planned.built.kinds == YIELD]
        )
        return chosen, SpeedMemory(solved.is_full, reached_at, waits)

    def _plan_with_doubt(
        self, on_path: _SpeedInput, boundaries: StBoundaries
    ) -> tuple[_Planned, StBoundaries]:
        """The speed that keeps the rows as far as they bind (`doubt`), and the rows that do not
        bind.
        """
        if not len(boundaries):
            return self._plan_within(on_path, boundaries), boundaries
        scene = on_path.view.scene
        p, p_turn = doubt.weights(scene, on_path.view.path, boundaries)
        binds = p >= doubt.CERTAIN
        is_sure = bool(binds.all())
        planned = self._plan_within(on_path, boundaries if is_sure else boundaries.only(binds))
        solved = planned.solved
        if is_sure and not solved.reason:
            return planned, boundaries.only(~binds)
        eased = ~binds & (p >= doubt.NEGLIGIBLE)
        if eased.any() and solved.profile is not None:  # (4) of `doubt`
            k = round(doubt.SHARED_S / STEP_S)
            s, v, a = solved.profile[:, k]
            stop = np.r_[
                solved.profile[0, :k],
                s + self._shared.braking((v, a), self._config.qp.knots - k)[0],
            ]
            driven, stopped = (
                np.interp(boundaries.t, self._times, profile)
                for profile in (solved.profile[0], stop)
            )
            met = ((driven > boundaries.lower) & (driven < boundaries.upper)).any(axis=1)
            eased &= met & (stopped > boundaries.lower).any(axis=1)
        if solved.reason:
            eased |= (
                binds
                & doubt.from_beside(scene, boundaries)
                & ((p_turn < doubt.SURE) | solved.unavoidable)
            )
        if eased.any():
            qp, gap = self._config.qp, self._config.dp.gap_m + TOLERANCE
            stop = qp.comfort.braking((scene.v, scene.start.a), qp.knots, share=RESERVE)[0]
            rows = doubt.relax_rows(
                boundaries, eased, np.interp(boundaries.t, self._times, stop), gap
            )
            planned = self._plan_within(
                on_path, rows.only(binds | eased), boundaries.agent[binds & ~eased]
            )
        binds |= eased
        return planned, replace(boundaries, probability=p).only(~binds)

    def _plan_within(
        self, on_path: _SpeedInput, blocks: StBoundaries, sure: IntArray | None = None
    ) -> _Planned:
        """The speed that keeps these boundaries; those of the agents `sure` (None: all) with other
        margins, too.

        The ego goes first before agents that cross with `FIRST_S` to spare, or it yields if
        `LETS_MPS2` is enough.
        """
        scene, n = on_path.view.scene, len(blocks)
        total = scene.speed[blocks.agent]
        crosses = (blocks.speed < ALONG * total) & (total > STANDING_MPS)
        free = self._plan(
            on_path, blocks, blocks.agent if sure is None else sure, np.ones(n, np.bool_)
        )
        planned = self._yield_to_late(on_path, free, np.where(crosses, FIRST_S, 0.0))
        lets, profile = crosses & ~planned.may_overtake, planned.solved.profile
        if lets.any():
            most = LETS_MPS2[bool(scene.vulnerable[blocks.agent[lets]].any())]
            if not (planned.solved.keeps and profile is not None and profile[2].min() >= -most):
                planned = self._yield_to_late(on_path, free, np.zeros(n))
        return planned

    def _yield_to_late(
        self, on_path: _SpeedInput, planned: _Planned, spare: FloatArray
    ) -> _Planned:
        """The speed that yields to each agent that it overtakes but would not stay clear of `spare`
        s `(n,)` later.

        The DP alone does not know that, since its jerk is coarse. Without a solution it yields to
        all.
        """
        ids, blocks = on_path.view.scene.frame.agents.ids, planned.blocks
        while (late := planned.built.kinds == OVERTAKE).any():
            tried, profile = planned.solved.attempts, planned.solved.profile
            if profile is not None:
                waited = [
                    CHANGE_S if ids[agent] in on_path.memory.waits else 0.0
                    for agent in blocks.agent
                ]
                s = np.interp(
                    blocks.t - np.maximum(spare, waited)[:, None], self._times, profile[0]
                )
                late &= ((s > blocks.lower) & (s < blocks.upper)).any(axis=1)
                if not late.any():
                    break
            planned = self._plan(on_path, blocks, planned.sure, planned.may_overtake & ~late, tried)
        return planned

    def _plan(
        self,
        on_path: _SpeedInput,
        blocks: StBoundaries,
        sure: IntArray,
        may_overtake: BoolArray,
        tried: Attempts = (),
    ) -> _Planned:
        """The speed with these orders of passing; `tried`: QPs that were tried before."""
        built = self._build(on_path, blocks, may_overtake)
        self._lap("speed DP")
        solved = self._ladder.solve(
            built.problem, partial(on_path.taken, sure), braked_fully=on_path.memory.braked_fully
        )
        self._lap("speed QP")
        solved = replace(solved, attempts=(*tried, *solved.attempts)) if tried else solved
        return _Planned(solved, built, blocks, may_overtake, sure)

    def _build(
        self,
        on_path: _SpeedInput,
        blocks: StBoundaries,
        may_overtake: BoolArray,
        *,
        is_drawn: bool = False,
    ) -> BuiltProblem:
        """The problem with these boundaries, and the speed DP where it decides or `is_drawn`."""
        scene, time_gap = on_path.view.scene, self._config.dp.time_gap_s
        pace = scene.speed[blocks.agent]
        taken = Taken(
            blocks.t, blocks.lower, blocks.upper, blocks.speed, pace, may_overtake, on_path.stops
        )
        gap = min(time_gap, HURRIED_GAP_S) if on_path.view.task.target.hurried else time_gap
        return build_problem(
            on_path.limits, taken, (scene.v, scene.start.a), gap, is_drawn, self._settings
        )

    def _artefacts(
        self, on_path: _SpeedInput, planned: _Planned, unlikely: StBoundaries
    ) -> tuple[Artefact, ...]:
        """Graph (with the DP where it ran), decisions, costs and reports."""
        scene, path, stops = on_path.view.scene, on_path.view.path, on_path.view.task.stops
        blocks, solved, problem = planned.blocks, planned.solved, planned.built.problem
        drawn, decisions = self._build(on_path, blocks, planned.may_overtake, is_drawn=True), []
        doubted = np.isin(blocks.agent, planned.sure, invert=True)
        decided = decide_speed(blocks, scene, np.interp(blocks.t, self._times, drawn.s_dp))
        for i, (decision, may) in enumerate(zip(decided, planned.may_overtake, strict=True)):
            kind, reason = decision.kind, decision.reason
            if kind is DecisionKind.OVERTAKE and not may:
                kind, reason = DecisionKind.YIELD, f"{reason}; the ego cannot be there first"
            reason = f"{reason}; {DOUBTED}" if doubted[i] else reason
            if kind in ORDERS:
                known_cost = {decision.kind: float(drawn.cost[-1].min())} if len(drawn.cost) else {}
                reason = f"{reason}; {self._orders(on_path, planned, i, kind, known_cost)}"
            decisions.append(replace(decision, kind=kind, reason=reason))
        profile, was_run = solved.profile, len(drawn.cost) > 0
        grid = None
        if was_run:  # every fourth row is enough for a picture
            times, stations = (
                DT_S * np.arange(len(drawn.cost)),
                DS_M * np.arange(0, len(drawn.cost[0]), DRAWN_ROWS),
            )
            grid = GridCost(
                times, stations, drawn.cost[:, ::DRAWN_ROWS], drawn.chosen // DRAWN_ROWS
            )
        graph = StGraph(
            grid,
            Corridor(self._times, problem.lower, problem.upper),
            np.column_stack([self._times, drawn.s_dp]) if was_run else np.empty((0, 2)),
            np.column_stack([self._times, profile[0]]) if profile is not None else np.empty((0, 2)),
            (
                *outlines(blocks, decisions),
                *stop_outlines(stops, float(self._times[-1]), path.length),
            ),
        )
        ignored = []
        for agent, lower, share in zip(
            unlikely.agent, unlikely.lower, unlikely.probability, strict=True
        ):
            begin = f"may take the path from {float(np.nanmin(lower)):.1f} m on"
            reason = (
                f"{begin}, but that is unlikely ({share:.0%}); the ego is past, or could still stop"
            )
            ignored.append(
                Decision(scene.frame.agents.ids[agent], DecisionKind.IGNORE, "speed", reason)
            )
        asked, costs = (stop.decision for stop in stops), self._ladder.program.costs
        qps = (
            part for qp, result in solved.attempts for part in (costs(result.x, qp), result.report)
        )
        return (graph, *decisions, *qps, *ignored, *asked, *on_path.decisions)

    def _orders(
        self,
        on_path: _SpeedInput,
        planned: _Planned,
        i: int,
        kind: DecisionKind,
        known_cost: Mapping[DecisionKind, float],
    ) -> str:
        """The distance by which the solution clears a boundary, and the cost of each order in the
        speed DP.
        """
        blocks, profile, costs = planned.blocks, planned.solved.profile, dict(known_cost)
        took = np.isfinite(blocks.lower[i])
        for order, (_, bound) in ORDERS.items():
            if order not in known_cost:
                lower, upper = blocks.lower.copy(), blocks.upper.copy()
                (upper if order is DecisionKind.YIELD else lower)[i, took] = bound
                cost = self._build(
                    on_path, replace(blocks, lower=lower, upper=upper), planned.may_overtake
                ).cost
                costs[order] = float(cost[-1].min())
        words = []
        if profile is not None:
            s = np.interp(blocks.t[took], self._times, profile[0])
            keeps = (
                blocks.lower[i, took] - s
                if kind is DecisionKind.YIELD
                else s - blocks.upper[i, took]
            ).min()
            words.append(f"keeps {keeps:.1f} m")
        for order in (kind, *(order for order in ORDERS if order is not kind)):
            costly = f"costs {costs[order]:.1f}" if costs[order] < COLLIDES else "would collide"
            words.append(f"{ORDERS[order][0]} {costly}")
        return ", ".join(words)
