"""The planner's one screen: start, candidate lanes, choice, trajectory; or the fallback and why."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf

from logs.frame import Frame, PlannerContext
from logs.states import EgoState
from logs.trace import Artefact, Internals, Plan, PlanStatus
from planners.dp_qp.lane.choice import choose, hopeless, worth_looking
from planners.dp_qp.lane.config import LaneConfig
from planners.dp_qp.lane.memory import LaneMemory, PassMemory
from planners.dp_qp.lane.passing import passing
from planners.dp_qp.lane.plan import LanePlan, LanePlanner
from planners.dp_qp.path.stage import PathConfig
from planners.dp_qp.speed.stage import SpeedConfig
from planners.frenet.fallback import along, fall_back
from planners.frenet.lane_sequence import LaneSequence, LaneSequences
from planners.frenet.start import STITCH_M, STITCH_MPS, start_of
from planners.piecewise_jerk.solvers import DEFAULT, check_solver
from planners.rules import Rulebook, RulesConfig


@dataclass(frozen=True)
class DpQpConfig:
    """Settings of `dp_qp`.

    Attributes:
        path: The path stage.
        speed: The speed stage.
        lane: The choice between lanes, and of passing.
        rules: What the rules of the road leave open.
        solver: Of the path and speed QPs: "interior_point", "osqp" or "piqp".
        stitch_m: The plan starts on the previous one where the ego is nearer to it than this ...
        stitch_mps: ... and its speed nearer than this; else at the ego.
    """

    path: PathConfig = field(default_factory=PathConfig)
    speed: SpeedConfig = field(default_factory=SpeedConfig)
    lane: LaneConfig = field(default_factory=LaneConfig)
    rules: RulesConfig = field(default_factory=RulesConfig)
    solver: str = DEFAULT
    stitch_m: float = STITCH_M
    stitch_mps: float = STITCH_MPS

    def __post_init__(self) -> None:
        check_solver(self.solver)


@dataclass(eq=False)
class PlannerMemory:
    """All that the planner remembers; a fresh frame has a new one.

    Attributes:
        driven: The lane that is driven; `changed` since when, s.
        lanes: Of each lane planned so far; `passing` of passing in it.
    """

    driven: LaneSequence
    changed: float = -inf
    lanes: dict[LaneSequence, LaneMemory] = field(default_factory=dict)
    passing: dict[LaneSequence, PassMemory] = field(default_factory=dict)


class DpQp:
    """DP and QP planner over candidate lanes."""

    def __init__(self, context: PlannerContext, config: DpQpConfig | None = None) -> None:
        self._config = config or DpQpConfig()
        self._context, self._vehicle, self._lap = context, context.vehicle, context.lap
        self._lanes = LaneSequences(context)
        self._planners: dict[LaneSequence, LanePlanner] = {}
        self._memory = PlannerMemory(self._lanes.start(context.start))

    def plan(self, frame: Frame) -> Plan:
        """A plan from the previous plan or the ego; with a fallback, its status and reason.

        A frame without a previous plan is fresh: nothing is remembered.
        """
        start, start_kind = start_of(frame, self._config.stitch_m, self._config.stitch_mps)
        if frame.previous is None:
            self._memory = PlannerMemory(self._lanes.start(start))
        self._lap("start")
        chosen, considered = self._choose(frame, start)
        internals = Internals(chosen.reports, lambda: (*chosen.artefacts(), *considered))
        path, speed = chosen.path.path, chosen.speed
        if path is None or speed is None or speed.profile is None:
            qp, reason = self._config.speed.qp, chosen.path.reason or (speed.reason if speed else "")
            limits = qp.comfort, qp.emergency
            return fall_back(frame, start, start_kind, path, reason, internals, self._vehicle, limits, qp.knots)
        status = PlanStatus.HARD_STOP if speed.unavoidable else PlanStatus.PLANNED
        return Plan(along(path, speed.profile, frame.t), status, speed.reason, start_kind, internals)

    def _choose(self, frame: Frame, start: EgoState) -> tuple[LanePlan, tuple[Artefact, ...]]:
        """The plan in the best lane; the neighbours are planned only where that may pay."""
        memory = self._memory
        keep = self._planned("keep", memory.driven, frame, start)
        keep, considered, memory.passing[keep.lane] = passing(
            keep, self._planner(keep.lane), memory.passing.get(keep.lane, PassMemory()), self._config.path.corridor,
            self._config.lane, passes_left=self._context.road.drives_on_right,
        )  # fmt: skip
        self._lap("passing")
        if not worth_looking(keep, self._config.lane, since_change=frame.t - memory.changed):
            return keep, considered
        beside = self._lanes.beside(keep.lane, keep.scene.s)
        if not beside:
            return keep, considered
        others: list[LanePlan] = []
        unplanned: list[Artefact] = []
        hysteresis = self._config.lane.hysteresis_s
        for side, lane in beside:
            planner, before = self._planner(lane), memory.lanes.get(lane, LaneMemory())
            scene = planner.scene(frame, start, before)
            option = hopeless(side, scene, planner.least_costs(side, scene), keep, hysteresis)
            if option is not None:
                unplanned.append(option)
                continue
            plan, memory.lanes[lane] = planner.plan(side, scene, before)
            others.append(plan)
        chosen, more = choose(keep, others, hysteresis)
        if chosen is not keep:
            memory.passing.pop(keep.lane, None)
            memory.driven, memory.changed = chosen.lane, frame.t
        self._lap("lane choice")
        return chosen, (*considered, *more, *unplanned)

    def _planned(self, name: str, lane: LaneSequence, frame: Frame, start: EgoState) -> LanePlan:
        planner, memory = self._planner(lane), self._memory.lanes.get(lane, LaneMemory())
        plan, self._memory.lanes[lane] = planner.plan(name, planner.scene(frame, start, memory), memory)
        return plan

    def _planner(self, lane: LaneSequence) -> LanePlanner:
        if lane not in self._planners:
            speed = self._config.speed
            self._planners[lane] = LanePlanner(
                lane,
                Rulebook(
                    self._context.road,
                    lane.reference,
                    self._vehicle,
                    curve_accel_mps2=speed.qp.curve_accel_mps2,
                    ease_mps2=speed.qp.ease_mps2,
                    config=self._config.rules,
                ),
                self._context.goal,
                self._vehicle,
                self._config.path,
                speed,
                passes_left=self._context.road.drives_on_right,
                lap=self._lap,
                solver=self._config.solver,
                config=self._config.lane,
            )
        return self._planners[lane]
