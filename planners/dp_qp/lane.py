"""Plans one candidate lane: path and speed in its own Frenet frame, and the cost of that plan.

The cost of a candidate adds terms in seconds, weighted as `LaneConfig` says:

(1) time lost     = (distance on a free road - distance planned) / speed limit, over the horizon
(2) lane changes  = n (route_s + urgency_s u),
        u from 0 to 1 as the ego comes near the place where the first is due, or the goal's last
        time; dead_end_s where the goal cannot be reached from the lane
(3) change        = change_s for a lane that the ego does not drive in
(4) braking       = hard_s where comfortable braking cannot keep the distance,
        failed_s where no braking can, or a stage failed
(5) late          = lateness at the goal, after its last time, at the lane's speed limit

Settings of `dp_qp`: of its stages, of the choice between lanes, and of the planner as a whole.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf

from replan.core.settings import Config, NotNegative, Positive
from replan.logs.frame import Frame, PlannerContext
from replan.logs.plan import Artefact, CostTerms, SolverReport
from replan.logs.states import EgoState
from replan.planners.dp_qp.goal_window import GoalWindow, SpeedTarget
from replan.planners.dp_qp.path.bounds import InTheWay
from replan.planners.dp_qp.path.passing import (
    PassTarget,
    find_slow_agents,
    free_stations,
    pass_targets,
)
from replan.planners.dp_qp.path.stage import ChosenPath, PathConfig, PathMemory, PathStage
from replan.planners.dp_qp.speed.caps import SpeedTask
from replan.planners.dp_qp.speed.stage import ChosenSpeed, SpeedConfig, SpeedMemory, SpeedStage
from replan.planners.frenet.lane_sequences import LaneSequence
from replan.planners.frenet.scene import (
    STITCH_M,
    STITCH_MPS,
    TRACK_M,
    Scene,
    StartPlace,
    behind,
    on_path,
    scene_of,
)
from replan.planners.piecewise_jerk.solvers import DEFAULT, check_solver
from replan.planners.rules import Rulebook, RuleMemory, RulesConfig

FORGET_S = 0.5  # The memory of a lane that was not planned for this long is dropped, s


@dataclass(frozen=True, eq=False, slots=True)
class MovingObstacles:
    """The moving agents that a plan is to pass, and the input of the path stage for them."""

    targets: tuple[PassTarget, ...]
    in_the_way: InTheWay


@dataclass(frozen=True, eq=False, slots=True)
class LaneMemory:
    """Memory of the previous frames in one lane; a frame without a previous plan has
    `LaneMemory()`.

    Time `t` of the last plan, s; the `place` of its start, None if unknown; the memory of both
    stages and of the rules.
    """

    t: float = -inf
    place: StartPlace | None = None
    path: PathMemory = field(default_factory=PathMemory)
    speed: SpeedMemory = field(default_factory=SpeedMemory)
    rules: RuleMemory = field(default_factory=RuleMemory)


@dataclass(frozen=True, eq=False, slots=True)
class LanePlan:
    """The plan in one lane: "keep", "pass" (the same lane, past slower agents), "left" or "right".

    `speed` is None where there is no path; `costs` are (1)-(5).
    """

    name: str
    lane: LaneSequence
    scene: Scene
    path: ChosenPath
    speed: ChosenSpeed | None
    costs: CostTerms

    @property
    def cost(self) -> float:
        """Sum of (1)-(5), s."""
        return sum([value for _, value in self.costs.terms])

    @property
    def time_lost(self) -> float:
        """The time lost (1) and the lateness (5), s."""
        terms = dict(self.costs.terms)
        return terms["time lost"] + terms["late"]

    @property
    def braking(self) -> float:
        """The cost of hard braking (4), s."""
        return dict(self.costs.terms)["braking"]

    @property
    def is_comfortable(self) -> bool:
        """Whether both stages found a plan without hard braking."""
        return self.speed is not None and self.speed.profile is not None and not self.speed.reason

    @property
    def trouble(self) -> str:
        """Why the plan is not comfortable, in words."""
        return self.path.reason or (self.speed.reason if self.speed else "") or "no plan"

    @property
    def reports(self) -> tuple[SolverReport, ...]:
        """The solver reports of both stages."""
        return (*self.path.reports, *(self.speed.reports if self.speed else ()))

    def artefacts(self) -> tuple[Artefact, ...]:
        """The artefacts of both stages."""
        return (*self.path.artefacts(), *(self.speed.artefacts() if self.speed else ()))


class LanePlanner:
    """Plans in one lane sequence; the caller keeps its memory."""

    def __init__(
        self, lane: LaneSequence, context: PlannerContext, config: DpQpConfig | None = None
    ) -> None:
        config = config or DpQpConfig()
        qp, self._vehicle = config.speed.qp, context.vehicle
        self.lane, self._config, self._horizon = lane, config.lane, qp.horizon
        self._rules = Rulebook(
            context.road,
            lane.reference,
            context.vehicle,
            curve_accel_mps2=qp.curve_accel_mps2,
            ease_mps2=qp.ease_mps2,
            config=config.rules,
        )
        self._goal = GoalWindow(
            context.goal, lane.reference, context.vehicle, qp.comfort.accel_mps2
        )
        self._path = PathStage(
            context,
            config.path,
            self._goal,
            horizon=qp.horizon,
            curve_accel_mps2=qp.curve_accel_mps2,
            solver=config.solver,
        )
        self._speed = SpeedStage(context, config.speed, config.solver)

    @property
    def places(self) -> tuple[float, ...]:
        """Stations at which lanes part or meet, vehicles may have to wait, or agents cross, m."""
        return (*self.lane.reference.waits, *self._rules.places)

    def scene(self, frame: Frame, start: EgoState, memory: LaneMemory) -> Scene:
        """The scene of a frame in this lane."""
        return scene_of(frame, start, self.lane.reference, self._vehicle, memory.place)

    def plan(
        self,
        name: str,
        scene: Scene,
        memory: LaneMemory,
        moving_obstacles: MovingObstacles | None = None,
    ) -> tuple[LanePlan, LaneMemory]:
        """Plan path and speed from the scene's start, with costs; and the new memory.

        `name` is "keep" for the lane that the ego drives in; `moving_obstacles` are the moving
        agents that the plan is to pass. A path that does not pass the nearest of them gets no
        speed.
        """
        t, start, config = scene.frame.t, scene.start, self._config
        if not 0.0 <= t - memory.t <= FORGET_S:
            memory = LaneMemory()
        target = self._goal.target(t, scene.s, start.v)
        path, path_memory = self._path.choose(
            scene, memory.path, moving_obstacles.in_the_way if moving_obstacles else None
        )
        speed, speed_memory, rules = None, memory.speed, memory.rules
        if path.path is not None and (
            moving_obstacles is None
            or moving_obstacles.in_the_way.obstacles[0].agent in path.passed
        ):
            moving = (
                {box.agent for box in moving_obstacles.in_the_way.obstacles}
                if moving_obstacles
                else set()
            )
            standing = {name: room for name, room in path.passed.items() if name not in moving}
            demanded, rules = self._rules.stops(scene, memory.rules, frozenset(standing))
            stops = on_path(demanded, path.path, self._vehicle)
            skip = behind(scene, keeps_track=path.shift < TRACK_M and moving_obstacles is None)
            slow, beside = (
                [] if moving_obstacles else find_slow_agents(scene),
                moving_obstacles.targets if moving_obstacles else (),
            )
            # Passing them is planned for an ego at the limit, which gets there soonest; else it
            # follows them
            if slow:
                expected = free_stations(scene.frame.predictions.t, scene.s, start.v, scene.limit)
                beside = pass_targets(scene, slow, expected)
            task = SpeedTask(
                standing, skip, stops, beside, moving_obstacles is not None, self._goal, target
            )
            speed, speed_memory = self._speed.choose(scene, path.path, task, memory.speed)
        lost, braking = self._horizon, config.failed_s
        if speed is not None and speed.profile is not None:
            lost = (speed.free_m - float(speed.profile[0, -1])) / max(scene.limit, 1.0)  # (1)
            braking = config.hard_s if speed.reason else 0.0  # (4)
            if speed.unavoidable:
                braking = config.failed_s
        changes, change, late = self.least_costs(name, scene, target).terms
        costs = CostTerms(
            f"lane {name}", (("time lost", lost), changes, change, ("braking", braking), late)
        )
        plan = LanePlan(name, self.lane, scene, path, speed, costs)
        return plan, LaneMemory(t, scene.place, path_memory, speed_memory, rules)

    def least_costs(self, name: str, scene: Scene, target: SpeedTarget | None = None) -> CostTerms:
        """(2), (3) and (5) of a plan in this lane, without planning it: it costs no less, except
        for time gained.
        """
        lane, start, config = self.lane, scene.start, self._config
        target = target or self._goal.target(scene.frame.t, scene.s, start.v)
        route = 0.0 if lane.changes == 0 else config.dead_end_s
        if lane.changes:
            seconds = min(
                (lane.change_by - scene.s) / max(start.v, 5.0), self._goal.time_left(start.t)
            )
            left = seconds / (config.due_s * lane.changes)
            # (2)
            route = lane.changes * (
                config.route_s + config.urgency_s * min(max(1.0 - left, 0.0), 1.0)
            )
        change = config.change_s if name in ("left", "right") else 0.0  # (3)
        return CostTerms(
            f"lane {name}", (("lane changes", route), ("change", change), ("late", target.missed_s))
        )


@dataclass(frozen=True)
class LaneConfig(Config):
    """Settings of the lane choice; costs are in seconds of equivalent time."""

    hysteresis_s: NotNegative = 0.5
    """Amount by which another lane, or passing, must be cheaper than keeping the lane."""
    look_s: NotNegative = 1.0
    """Time lost to other agents from which the neighbouring lanes are planned."""
    dwell_s: NotNegative = 3.0
    """No further change and no new attempt to pass within this time, unless the lane fails."""
    route_s: NotNegative = 1.6
    """Cost of a lane change that the route needs."""
    urgency_s: NotNegative = 6.0
    """Cost that is added to it as the change becomes due."""
    due_s: Positive = 15.0
    """Changes are urgent where less than this time per change is left until they are due."""
    dead_end_s: NotNegative = 25.0
    """Cost of a lane from which the goal cannot be reached."""
    change_s: NotNegative = 1.0
    """Cost of leaving the driven lane, so that only a clear gain leads to a change."""
    hard_s: NotNegative = 3.0
    """Cost where comfortable braking cannot keep the distance."""
    failed_s: NotNegative = 50.0
    """Cost where no braking can, or a stage failed: more than all others together."""


@dataclass(frozen=True)
class DpQpConfig(Config):
    """Settings of `dp_qp`."""

    path: PathConfig = field(default_factory=PathConfig)
    """The path stage."""
    speed: SpeedConfig = field(default_factory=SpeedConfig)
    """The speed stage."""
    lane: LaneConfig = field(default_factory=LaneConfig)
    """The choice between lanes, and of passing."""
    rules: RulesConfig = field(default_factory=RulesConfig)
    """Settings of the traffic rules."""
    solver: str = DEFAULT
    """Solver of the path and speed QPs: "interior_point", "osqp" or "piqp"."""
    stitch_m: NotNegative = STITCH_M
    """The plan starts on the previous one where the ego is nearer to it than this; else at the ego.
    """
    stitch_mps: NotNegative = STITCH_MPS
    """The plan starts on the previous one where the ego's speed is nearer to its speed than this.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        check_solver(self.solver)
