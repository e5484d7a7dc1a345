"""The planner: start, candidate lanes, choice, trajectory; or the fallback and its reason."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf

from logs.frame import Frame, PlannerContext
from logs.plan import Artefact, Internals, Plan, PlanStatus
from logs.states import EgoState
from planners.dp_qp.choice import PassMemory, choose, hopeless, passing, worth_looking
from planners.dp_qp.lane import DpQpConfig, LaneMemory, LanePlan, LanePlanner
from planners.frenet.fallback import Stops, fall_back, trajectory_along
from planners.frenet.lane_sequence import LaneSequence, LaneSequences
from planners.frenet.scene import start_of


@dataclass(eq=False)
class PlannerMemory:
    """The planner's memory; a frame without a previous plan has a new one.

    The lane that the ego drives in, and when it `changed` to it, s; the memory of each lane, and of passing in it.
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
        """Plan from the previous plan or the ego; a fallback has its status and reason.

        A frame without a previous plan starts with fresh memory.
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
            stops = Stops(qp.comfort, qp.emergency, qp.knots)
            return fall_back(frame, start, start_kind, path, reason, internals, self._vehicle, stops)
        status = PlanStatus.HARD_STOP if speed.unavoidable else PlanStatus.PLANNED
        return Plan(trajectory_along(path, speed.profile, frame.t), status, speed.reason, start_kind, internals)

    def _choose(self, frame: Frame, start: EgoState) -> tuple[LanePlan, tuple[Artefact, ...]]:
        """The plan in the best lane; neighbouring lanes are planned only where they may be cheaper."""
        memory, config = self._memory, self._config
        planner, before = self._planner(memory.driven), memory.lanes.get(memory.driven, LaneMemory())
        keep, memory.lanes[memory.driven] = planner.plan("keep", planner.scene(frame, start, before), before)
        past = memory.passing.get(keep.lane, PassMemory())
        passes_left = self._context.road.drives_on_right
        keep, considered, memory.passing[keep.lane] = passing(keep, planner, past, config, passes_left=passes_left)
        self._lap("passing")
        if not worth_looking(keep, config.lane, since_change=frame.t - memory.changed):
            return keep, considered
        beside = self._lanes.beside(keep.lane, keep.scene.s)
        if not beside:
            return keep, considered
        others: list[LanePlan] = []
        unplanned: list[Artefact] = []
        hysteresis = config.lane.hysteresis_s
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

    def _planner(self, lane: LaneSequence) -> LanePlanner:
        if lane not in self._planners:
            self._planners[lane] = LanePlanner(lane, self._context, self._config)
        return self._planners[lane]
