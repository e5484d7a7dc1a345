"""The planner: start, candidate lanes, choice, trajectory; or the fallback and its reason.

It keeps the lane, passes within it, or changes: by cost with hysteresis and a safety protocol
(paper, section II-F).

The neighbouring lanes are planned where the route needs a change, a slow agent is ahead, or the
plan in the lane is not comfortable (while a change is under way, only then: it may be aborted). The
ego changes to a neighbouring lane that is cheaper by `hysteresis_s` if it endangers no agent on it:

(1) gap behind >= MIN_GAP_M + REACTION_S max(0, v_a - v) + max(0, v_a - v)^2 / (2 YIELD_MPS2)
        for each follower
(2) no agent beside the ego, from MIN_GAP_M behind its rear to MIN_GAP_M before its front
(3) the lane's own S-T graph contains the agents ahead; the plan must not need hard braking

The plan that keeps the lane follows slower agents. A second plan of the same lane passes them where
`path.passing` allows it ("nudge" in the paper): it must be comfortable and cheaper by
`hysteresis_s`; once it is under way, it may not be dearer by more than that. Its path and speed are
found in turns, at most `TURNS` in one frame: the first turn assumes the speed on a free road, the
next the speed of the turn before; later frames start from the plan of the last frame. It is a plan
only if, at its own speed, it gets past the nearest agent within the predictions. It may borrow the
lane on the passing side where (1) and (2) hold for it; once the ego is over the marking, others see
it and they need not hold.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.frame import Frame, PlannerContext
from replan.logs.plan import (
    Artefact,
    Candidates,
    CostTerms,
    Internals,
    LaneOption,
    Plan,
    PlanStatus,
)
from replan.logs.states import EgoState
from replan.planners.dp_qp.lane import (
    FORGET_S,
    DpQpConfig,
    LaneConfig,
    LaneMemory,
    LanePlan,
    LanePlanner,
    MovingObstacles,
)
from replan.planners.dp_qp.path.bounds import CorridorConfig
from replan.planners.dp_qp.path.passing import (
    find_slow_agents,
    free_stations,
    obstacles_to_pass,
    pass_targets,
)
from replan.planners.frenet.lane_sequences import LaneSequence, LaneSequences
from replan.planners.frenet.profiles import STEP_S, Stops, fall_back, trajectory_along
from replan.planners.frenet.scene import Scene, start_of
from replan.planners.rules.rulebook import YIELD_MPS2


@dataclass(eq=False)
class PlannerMemory:
    """The planner's memory; a frame without a previous plan has a new one.

    The lane that the ego drives in, and when it `changed` to it, s; the memory of each lane, and of
    passing in it.
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
        driven, start = self._memory.driven, context.start
        station, _ = driven.reference.line.project(start.x, start.y)
        for lane in (driven, *(lane for _, lane in self._lanes.beside(driven, station))):
            self._planner(lane)  # made before the first frame, which would be late

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
            qp, reason = (
                self._config.speed.qp,
                chosen.path.reason or (speed.reason if speed else ""),
            )
            stops = Stops(qp.comfort, qp.emergency, qp.knots)
            return fall_back(
                frame, start, start_kind, path, reason, internals, self._vehicle, stops
            )
        status = PlanStatus.HARD_STOP if speed.unavoidable else PlanStatus.PLANNED
        return Plan(
            trajectory_along(path, speed.profile, frame.t),
            status,
            speed.reason,
            start_kind,
            internals,
        )

    def _choose(self, frame: Frame, start: EgoState) -> tuple[LanePlan, tuple[Artefact, ...]]:
        """The plan in the best lane.

        Neighbouring lanes are planned only where they may be cheaper.
        """
        memory, config = self._memory, self._config
        planner, lane_memory = (
            self._planner(memory.driven),
            memory.lanes.get(memory.driven, LaneMemory()),
        )
        keep, memory.lanes[memory.driven] = planner.plan(
            "keep", planner.scene(frame, start, lane_memory), lane_memory
        )
        pass_memory = memory.passing.get(keep.lane, PassMemory())
        passes_left = self._context.road.drives_on_right
        keep, considered, memory.passing[keep.lane] = passing(
            keep, planner, pass_memory, config, passes_left=passes_left
        )
        self._lap("passing")
        if not worth_looking(keep, config.lane, since_change=frame.t - memory.changed):
            return keep, considered
        beside = self._lanes.beside(keep.lane, keep.scene.s)
        if not beside:
            return keep, considered
        neighbours: list[LanePlan] = []
        unplanned: list[Artefact] = []
        hysteresis = config.lane.hysteresis_s
        for side, lane in beside:
            planner, lane_memory = self._planner(lane), memory.lanes.get(lane, LaneMemory())
            scene = planner.scene(frame, start, lane_memory)
            option = hopeless(side, scene, planner.least_costs(side, scene), keep, hysteresis)
            if option is not None:
                unplanned.append(option)
                continue
            plan, memory.lanes[lane] = planner.plan(side, scene, lane_memory)
            neighbours.append(plan)
        chosen, options = choose(keep, neighbours, hysteresis)
        if chosen is not keep:
            memory.passing.pop(keep.lane, None)
            memory.driven, memory.changed = chosen.lane, frame.t
        self._lap("lane choice")
        return chosen, (*considered, *options, *unplanned)

    def _planner(self, lane: LaneSequence) -> LanePlanner:
        if lane not in self._planners:
            self._planners[lane] = LanePlanner(lane, self._context, self._config)
        return self._planners[lane]


MIN_GAP_M = 2.0  # Least gap to a follower (1) or an agent beside the ego (2), m
REACTION_S = 1.0  # Reaction time of a follower before it brakes with `YIELD_MPS2` (1), s
INSIDE_M = 1.0  # An ego nearer than this to a lane's reference line drives in that lane, m
# A slower ego does not begin a lane change, m/s: it would stop across the marking
SLOWEST_CHANGE_MPS = 1.0
TURNS = 3  # Most turns of path and speed in one frame
SETTLED_M = 1.0  # The turns end when the last one has moved each box by less than this, m


def worth_looking(keep: LanePlan, config: LaneConfig, *, since_change: float) -> bool:
    """Whether to plan the neighbouring lanes, by the plan in the lane and the time (s) since the
    last change.
    """
    if abs(keep.scene.l) > INSIDE_M:  # a change is under way
        return not keep.is_comfortable
    slow = keep.time_lost > config.look_s and since_change > config.dwell_s
    return keep.lane.changes != 0 or slow or not keep.is_comfortable


def hopeless(
    name: str, scene: Scene, least: CostTerms, keep: LanePlan, hysteresis_s: float
) -> LaneOption | None:
    """Why a neighbouring lane that costs `least` or more need not be planned; None if it must
    be.
    """
    cost = sum(value for _, value in least.terms)
    reason = ""
    if not cost < keep.cost - hysteresis_s:
        reason = (
            f"costs at least {cost:.1f} s, {keep.name} {keep.cost:.1f} s: not "
            f"{hysteresis_s:.1f} s better"
        )
    elif abs(scene.l) > INSIDE_M:
        reason = _unsafe(scene)
    return LaneOption(name, least.terms, reason) if reason else None


def choose(
    keep: LanePlan, neighbours: list[LanePlan], hysteresis_s: float
) -> tuple[LanePlan, tuple[Artefact, ...]]:
    """The cheapest permitted plan, and the options that were compared."""
    best, rejected = keep, dict[str, str]()
    for neighbour in neighbours:
        reason = "" if neighbour.is_comfortable else neighbour.trouble
        if not reason and abs(neighbour.scene.l) > INSIDE_M:
            reason = _unsafe(neighbour.scene)
        needed = hysteresis_s if best is keep else 0.0
        if not reason and not neighbour.cost < best.cost - needed:
            reason = f"costs {neighbour.cost:.1f} s, {best.name} {best.cost:.1f} s"
            reason += f": not {needed:.1f} s better" if neighbour.cost < best.cost else ""
        if reason:
            rejected[neighbour.name] = reason
            continue
        if best is not keep:
            rejected[best.name] = (
                f"costs {best.cost:.1f} s, {neighbour.name} {neighbour.cost:.1f} s"
            )
        best = neighbour
    if best is not keep:
        rejected[keep.name] = f"costs {keep.cost:.1f} s, {best.name} {best.cost:.1f} s"
    compared = (
        LaneOption(plan.name, plan.costs.terms, rejected.get(plan.name, ""))
        for plan in (keep, *neighbours)
    )
    return best, tuple(compared)


def _unsafe(scene: Scene) -> str:
    """Why a change into the scene's lane must not begin now; empty if it may."""
    return "too slow to change" if scene.frame.ego.v < SLOWEST_CHANGE_MPS else endangered(scene)


def endangered(scene: Scene, beside: str = "") -> str:
    """The agent that the ego would endanger (1), (2), and how; empty if there is none.

    The ego changes into the scene's lane, or borrows the road `beside` it ("left" or "right").
    """
    lane = scene.reference
    right_edge, left_edge = {
        "": (lane.lane_right, lane.lane_left),
        "left": (lane.lane_left, lane.road_left),
        "right": (lane.road_right, lane.lane_right),
    }[beside]
    agents, along = scene.frame.agents, scene.agents
    left, right = (np.interp(along.s, lane.line.s, edge) for edge in (left_edge, right_edge))
    inside = (along.l - 0.5 * agents.width < left) & (along.l + 0.5 * agents.width > right)
    for i in np.flatnonzero(inside).tolist():
        head, tail = along.s[i] + 0.5 * agents.length[i], along.s[i] - 0.5 * agents.length[i]
        if tail > scene.front + MIN_GAP_M:
            continue
        if head > scene.rear - MIN_GAP_M:
            return f"{scene.name(i)} is beside"  # (2)
        closing = max(0.0, float(along.v_s[i]) - scene.frame.ego.v)
        needed = MIN_GAP_M + REACTION_S * closing + closing**2 / (2.0 * YIELD_MPS2)  # (1)
        gap = scene.rear - head
        if gap < needed:
            return (
                f"{scene.name(i)} is {gap:.1f} m behind and {closing:.1f} m/s faster: needs "
                f"{needed:.1f} m"
            )
    return ""


@dataclass(frozen=True, eq=False, slots=True)
class PassMemory:
    """Memory of passing slower agents in one lane: time `t` of the last frame that considered it,
    s, and those passed.

    `given_up`: when the ego gave up passing an agent, s; `stations`: those of the last passing plan
    at the times of the predictions since `t` `(k,)`, m; `lane`: memory of the passing plans, not of
    those that keep the lane.
    """

    t: float = -inf
    passed: frozenset[str] = frozenset()
    given_up: Mapping[str, float] = field(default_factory=dict)
    stations: FloatArray | None = None
    lane: LaneMemory = field(default_factory=LaneMemory)


def passing(
    keep: LanePlan,
    planner: LanePlanner,
    memory: PassMemory,
    config: DpQpConfig,
    *,
    passes_left: bool,
) -> tuple[LanePlan, tuple[Artefact, ...], PassMemory]:
    """The plan that passes slower agents if it is better, else `keep`.

    The options considered; the memory.
    """
    scene, t, hysteresis = keep.scene, keep.scene.frame.t, config.lane.hysteresis_s
    if not 0.0 <= t - memory.t <= FORGET_S:
        memory = PassMemory()
    if not memory.passed and keep.time_lost + keep.braking < hysteresis:
        return keep, (), memory
    slow, ids = find_slow_agents(scene, memory.passed), scene.frame.agents.ids
    if not slow and not memory.passed:
        return keep, (), PassMemory(t, given_up=memory.given_up, lane=memory.lane)
    pass_plan, names, memory_after = _plan_past(
        keep, planner, memory, slow, config.path.corridor, passes_left=passes_left
    )
    under_way = bool(names & memory.passed)
    reason = ""
    if pass_plan is None:
        reason = "no plan"
    elif not pass_plan.is_comfortable and (keep.is_comfortable or not under_way):
        reason = pass_plan.trouble
    elif not pass_plan.cost < keep.cost - (-hysteresis if under_way else hysteresis):
        reason = f"costs {pass_plan.cost:.1f} s, keep {keep.cost:.1f} s" + (
            " and it is not begun" if not under_way else ""
        )
    if not under_way and any(
        t - memory.given_up.get(name, -inf) < config.lane.dwell_s for name in names
    ):
        reason = "abandoned a moment ago"
    passed = frozenset() if reason else names
    given_up = {**memory.given_up, **{ids[i]: t for i in slow if ids[i] in memory.passed - passed}}
    memory = replace(memory_after, t=t, passed=passed, given_up=given_up)
    if pass_plan is None:
        return keep, (), memory
    chosen, best = ("keep", keep) if reason else ("pass", pass_plan)
    why_other = reason or f"costs {keep.cost:.1f} s, pass {pass_plan.cost:.1f} s"
    candidates = Candidates("passing", 2, ((why_other, 1),), chosen)
    return best, (keep.costs, pass_plan.costs, candidates), memory


def _plan_past(
    keep: LanePlan,
    planner: LanePlanner,
    memory: PassMemory,
    slow: list[int],
    config: CorridorConfig,
    *,
    passes_left: bool,
) -> tuple[LanePlan | None, frozenset[str], PassMemory]:
    """The plan past the nearest agent, all agents that it passes, the memory; None where there is
    no such plan.
    """
    scene, t, lane = keep.scene, keep.scene.frame.predictions.t, memory.lane
    if not slow:
        return None, frozenset(), replace(memory, stations=None)
    course, passing_side = scene.reference, "left" if passes_left else "right"
    aside, edge = (scene.l, course.lane_left) if passes_left else (-scene.l, -course.lane_right)
    over_marking = aside + 0.5 * scene.vehicle.width > float(
        np.interp(scene.s, course.line.s, edge)
    )
    free = over_marking or not endangered(scene, passing_side)
    sides, stations = (free and passes_left, free and not passes_left), memory.stations
    if stations is None or len(stations) != len(t):
        stations = free_stations(t, scene.s, scene.start.v, scene.limit)
    else:
        stations = _carried_on(t - t[0], stations, t - memory.t)
    targets = pass_targets(scene, slow, stations, memory.passed)
    for turn in range(TURNS):
        in_the_way = obstacles_to_pass(
            scene, targets, stations, sides, config, planner.places, memory.passed
        )
        if not in_the_way.obstacles:
            return None, frozenset(), replace(memory, stations=None, lane=lane)
        plan, lane = planner.plan("pass", scene, lane, MovingObstacles(targets, in_the_way))
        path, speed = plan.path.path, plan.speed
        if path is None or speed is None or speed.profile is None:
            return None, frozenset(), replace(memory, stations=None, lane=lane)
        sigma = speed.profile[0]
        driven = np.interp(sigma, path.sigma, path.s)  # on the reference line
        stations = _carried_on(STEP_S * np.arange(len(sigma)), driven, t - t[0])
        previous, targets = targets, pass_targets(scene, slow, stations, memory.passed)
        moved = [
            abs(a.box.s_from - b.box.s_from) + abs(a.box.s_to - b.box.s_to)
            for a, b in zip(previous, targets, strict=False)
        ]
        are_same = [target.agent for target in previous] == [target.agent for target in targets]
        if turn + 1 == TURNS or (are_same and max(moved, default=inf) < SETTLED_M):
            break
    names = (
        frozenset(plan.path.passed)
        & {box.agent for box in in_the_way.obstacles}
        & {target.box.agent for target in targets}
    )
    if in_the_way.obstacles[0].agent not in names:
        return None, frozenset(), replace(memory, stations=None, lane=lane)
    return plan, names, replace(memory, stations=stations, lane=lane)


def _carried_on(times: FloatArray, stations: FloatArray, t: FloatArray) -> FloatArray:
    """Interpolate stations `(n,)` at `times` times to other times `(k,)`.

    After the last, at the last speed.
    """
    speed = (stations[-1] - stations[-2]) / (times[-1] - times[-2])
    return np.asarray(np.interp(t, times, stations) + speed * np.maximum(t - times[-1], 0.0))
