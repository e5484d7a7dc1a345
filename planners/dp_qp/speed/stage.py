"""Speed stage: S-T boundaries, caps -> speed DP (who goes first) -> bounds -> speed QP (how hard), and the S-T graph.

Hypotheses that are unlikely bind only where hard braking would come too late for them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from logs.kernel import BoolArray, FloatArray, IntArray
from logs.trace import Artefact, Corridor, Decision, DecisionKind, GridCost, SolverReport, StGraph
from logs.vehicle import VehicleParameters
from planners.dp_qp.scene.caps import CautionConfig, LoweredLimit, PathView, lowered
from planners.dp_qp.scene.goal_window import HURRIED_GAP_S, GoalWindow, SpeedTarget
from planners.dp_qp.scene.hesitant_pedestrians import came_to_path
from planners.dp_qp.scene.pass_target import PassTarget
from planners.dp_qp.scene.producers import OTHERS, OWN
from planners.dp_qp.speed.braking import RESERVE, BrakingLadder, BrakingMemory, Case, SolvedSpeed
from planners.dp_qp.speed.dp import DS_M, DT_S, SpeedDpConfig
from planners.dp_qp.speed.problem import OVERTAKE, Posed, Settings, pose
from planners.dp_qp.speed.qp import SpeedQpConfig
from planners.frenet.occupancy import Occupancy
from planners.frenet.path import Path
from planners.frenet.profiles import STEP_S, Limits
from planners.frenet.scene import UNLIKELY, Scene
from planners.frenet.st_boundaries import (
    StBoundaries,
    StGraphConfig,
    decide_speed,
    outlines,
    st_boundaries,
    stop_outlines,
)
from planners.piecewise_jerk.solvers import DEFAULT

BRANCH_S = 0.5
"""An unlikely hypothesis binds only so far that hard braking could still avoid it so long after now, s."""
NO_STOPS = np.empty((0, 2))
"""Where the rules demand none."""
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


@dataclass(frozen=True, eq=False, slots=True)
class _Planned:
    """A solved speed and what it came from."""

    solved: SolvedSpeed
    posed: Posed
    blocks: StBoundaries
    cannot_be_first: bool


class SpeedStage:
    """Chooses the speed of each frame along a path."""

    def __init__(
        self, vehicle: VehicleParameters, config: SpeedConfig, lap: Callable[[str], None], solver: str = DEFAULT
    ) -> None:
        self._vehicle, self._config, self._lap = vehicle, config, lap
        self._ladder = BrakingLadder(config.qp, config.dp.gap_m, vehicle.max_decel, solver)
        self._hard_mps2 = RESERVE * config.qp.emergency.decel_mps2
        self._times = STEP_S * np.arange(config.qp.knots)
        qp, dp = config.qp, config.dp
        self._settings = Settings(
            qp.knots, qp.curve_accel_mps2, qp.ease_mps2, Limits(qp.comfort).columns,
            dp.columns, dp.weights, dp.gap_m, dp.standstill_gap_m, dp.w_near,
        )  # fmt: skip

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
        own = lowered(path.sigma, bare, [cap for caps in OWN for cap in caps(view)])
        limit = lowered(path.sigma, own, [cap for caps in OTHERS for cap in caps(view)])
        swept: dict[StGraphConfig, StBoundaries] = {}

        def taken(margins: StGraphConfig) -> StBoundaries:
            """The boundaries with other margins: of those who are in the way, unless they may be faster than now."""
            if margins not in swept:
                skip = task.skip
                if margins.brisk_mps <= config.graph.brisk_mps:
                    skip = np.ones(len(skip), np.bool_)
                    skip[found.agent] = False
                swept[margins] = st_boundaries(scene, path, skip, passed, margins).with_stops(task.stops)
            return swept[margins]

        way = _Way(view, limit, own, taken)
        likely, unlikely = found.probability > UNLIKELY, None
        if not len(found) or likely.all():
            planned = self._planned(way, found, memory.braking)
        else:
            planned, unlikely = self._planned(way, found.only(likely), memory.braking), found.only(~likely)
            if not self._could_stop(planned.solved.profile, unlikely):
                planned, unlikely = self._planned(way, found, memory.braking), None
        solved = planned.solved
        chosen = ChosenSpeed(
            solved.profile, solved.reason, solved.unavoidable, planned.posed.free_m, solved.reports,
            lambda: self._artefacts(way, planned, unlikely),
        )  # fmt: skip
        return chosen, SpeedMemory(memory.braking.after(scene.frame.t, solved), came)

    def _planned(self, way: _Way, blocks: StBoundaries, memory: BrakingMemory) -> _Planned:
        """The speed that keeps to these boundaries."""
        posed = self._posed(way, blocks)
        self._lap("speed DP")
        solved = self._ladder.solve(Case(posed.problem, way.taken, way.view.scene.frame.t, memory))
        cannot_be_first = not _overtakes(blocks, posed.kinds, solved.profile, self._times)
        if cannot_be_first:
            posed, tried = self._posed(way, blocks, may_overtake=False), solved.asked
            solved = self._ladder.solve(Case(posed.problem, way.taken, way.view.scene.frame.t, memory))
            solved = replace(solved, asked=(*tried, *solved.asked))
        self._lap("speed QP")
        return _Planned(solved, posed, blocks, cannot_be_first)

    def _posed(
        self, way: _Way, blocks: StBoundaries, *, may_overtake: bool = True, is_drawn: bool = False
    ) -> Posed:  # fmt: skip
        """The problem with these boundaries, and the speed DP where it decides or `is_drawn`."""
        view, time_gap = way.view, self._config.dp.time_gap_s
        stops = np.array([(stop.s_from, stop.until) for stop in view.stops]) if view.stops else NO_STOPS
        return pose(
            view.path.sigma, view.path.kappa, way.own.v, way.limit.v, way.limit.is_bound,
            blocks.t, blocks.agent, blocks.lower, blocks.upper, blocks.speed, view.scene.speed, stops,
            (view.scene.v, view.scene.start.a), min(time_gap, HURRIED_GAP_S) if view.target.hurried else time_gap,
            way.limit.v is not way.own.v, may_overtake, is_drawn, self._settings,
        )  # fmt: skip

    def _could_stop(self, profile: FloatArray | None, blocks: StBoundaries) -> bool:
        """Whether hard braking, `BRANCH_S` after driving on along a profile, would stay behind these boundaries."""
        if profile is None:
            return False
        k, qp = round(BRANCH_S / STEP_S), self._config.qp
        s, v, a = profile[:, k]
        stop = Limits(qp.emergency).braking((v, a), qp.knots - k, share=RESERVE)
        return blocks.leave(self._times, np.r_[profile[0, :k], s + stop[0]], 0.0)

    def _artefacts(self, way: _Way, planned: _Planned, unlikely: StBoundaries | None) -> tuple[Artefact, ...]:
        """Graph (with the DP where it was run), decisions, costs and reports."""
        scene, path, stops = way.view.scene, way.view.path, way.view.stops
        blocks, solved, problem = planned.blocks, planned.solved, planned.posed.problem
        drawn = self._posed(way, blocks, is_drawn=True)
        decisions = decide_speed(blocks, scene, np.interp(blocks.t, self._times, drawn.s_dp))
        if planned.cannot_be_first:
            decisions = tuple(_let_go(decision) for decision in decisions)
        profile = solved.profile
        graph = StGraph(
            _thinned(drawn.cost, drawn.chosen) if len(drawn.cost) else None,
            Corridor(self._times, problem.lower, problem.upper),
            np.column_stack([self._times, drawn.s_dp]) if len(drawn.cost) else np.empty((0, 2)),
            np.column_stack([self._times, profile[0]]) if profile is not None else np.empty((0, 2)),
            (*outlines(blocks, decisions), *stop_outlines(stops, float(self._times[-1]), path.length)),
        )
        ignored = _ignored(unlikely, scene) if unlikely is not None else ()
        asked = (stop.decision for stop in stops)
        costs = self._ladder.program.costs
        asked_qps = (part for each in solved.asked for part in (costs(each.result.x, each.problem), each.result.report))
        return (graph, *decisions, *asked_qps, *ignored, *asked, *way.limit.decisions)


def _overtakes(blocks: StBoundaries, kinds: IntArray, profile: FloatArray | None, times: FloatArray) -> bool:
    """Whether a profile stays clear of all that it should overtake; the DP knows nothing of jerk."""
    overtaken = kinds == OVERTAKE
    if not len(kinds) or not overtaken.any():
        return True
    if profile is None:
        return False
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


def _thinned(cost: FloatArray, chosen: IntArray) -> GridCost:
    """The grid for the record, every fourth row."""
    times = DT_S * np.arange(len(cost))
    rows = DS_M * DRAWN_ROWS * np.arange(len(cost[0, ::DRAWN_ROWS]))
    return GridCost(times, rows, cost[:, ::DRAWN_ROWS], chosen // DRAWN_ROWS)
