"""Path stage: corridor -> path DP (sides) -> bounds -> path QP -> path, and its S-L graph."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from replan.core.arrays import TIE, FloatArray
from replan.core.settings import Config
from replan.logs.agents import AgentKind
from replan.logs.frame import PlannerContext
from replan.logs.plan import (
    Artefact,
    Corridor,
    Decision,
    DecisionKind,
    GraphObstacle,
    GridCost,
    SlGraph,
    SolverReport,
)
from replan.planners.dp_qp.goal_window import GoalWindow
from replan.planners.dp_qp.path import bounds
from replan.planners.dp_qp.path.bounds import SIDES, CorridorConfig, InTheWay, PathBounds
from replan.planners.dp_qp.path.corridor import (
    HERE,
    KNOT,
    LOWER,
    SWING,
    UPPER,
    EgoInLane,
    RoadAhead,
    S,
    loosen_bounds,
    road_ahead,
)
from replan.planners.dp_qp.path.dp import PathDpConfig, SlGrid, solve_path_dp
from replan.planners.dp_qp.path.oncoming_lane import (
    find_blocking,
    may_block,
    passed_by_oncoming_lane,
    waiting_place,
)
from replan.planners.dp_qp.path.qp import PathQp, PathQpConfig
from replan.planners.frenet.path import Path, drivable_path
from replan.planners.frenet.scene import Occupancy, Scene
from replan.planners.piecewise_jerk.problem import LEADS, PiecewiseJerkProblem, X
from replan.planners.piecewise_jerk.solvers import DEFAULT
from replan.planners.solver import QPResult

LENGTHS_M = (60.0, 90.0, 130.0, 180.0, 250.0, 340.0)
"""Path lengths, m.

The shortest that holds the horizon at the present speed is used, so that weights stay constant.
"""
# Deceleration with which the ego stops where it waits for the oncoming lane, m/s2
WAITING_MPS2 = 2.0
JUNCTION_M = 40.0
"""An agent that stands within this before a place where lanes part or meet waits, and the ego does
not pass it, m.
"""
RELINEARISED = 2  # Greatest number of further solutions of a path that cannot keep its bounds
MOVED_M = 0.02  # A further solution that moves the path by less than this is the last, m
# A path ends where its curvature is more than this multiple of that at the steering lock
LOCK_SLACK = 1.05
NO_ONE = np.empty((0, 2))  # Begin and end of no standing agent, stations


@dataclass(frozen=True)
class PathConfig(Config):
    """Settings of the path stage, by part."""

    dp: PathDpConfig = field(default_factory=PathDpConfig)
    qp: PathQpConfig = field(default_factory=PathQpConfig)
    corridor: CorridorConfig = field(default_factory=CorridorConfig)


@dataclass(frozen=True, eq=False, slots=True)
class PathMemory:
    """The time since which each agent has stood in the way, s, and the side of the last path: 1
    left, -1 right.
    """

    standing: Mapping[str, float] = field(default_factory=dict)
    sides: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, slots=True)
class ChosenPath:
    """The result of the path stage; where the QP failed, no path, and the reason.

    `passed`: the space between the path and each agent that it passes on purpose, m; `shift`: the
    largest change of the offset from the reference line within `SHIFT_AHEAD_M`, m; `artefacts`
    makes the artefacts of `Plan.internals`.
    """

    path: Path | None
    reason: str
    passed: Mapping[str, float]
    shift: float
    reports: tuple[SolverReport, ...]
    artefacts: Callable[[], tuple[Artefact, ...]]


@dataclass(frozen=True, eq=False, slots=True)
class _Task:
    """The input of the path QP: the start, the road, and the problem in its corridor without
    obstacles.

    `space` holds the bounds of the ego's points `(points, knots)`.
    """

    program: PathQp
    ego: EgoInLane
    road: RoadAhead
    space: PathBounds
    problem: PiecewiseJerkProblem


@dataclass(frozen=True, eq=False, slots=True)
class _PathSolution:
    """The solution of the path QP: `offsets` l, l', l'' `(3, knots)`, None if it failed, of the
    solver's `x`.

    `narrow` are the bounds of `problem`, the last that was solved; `rooms` is that of
    `bounds.check_clearance`.
    """

    offsets: FloatArray | None
    x: FloatArray
    decisions: tuple[Decision, ...]
    narrow: PathBounds
    problem: PiecewiseJerkProblem
    reports: tuple[SolverReport, ...]
    rooms: Mapping[str, float]


class PathStage:
    """Chooses the path of each frame along one reference path."""

    def __init__(
        self,
        context: PlannerContext,
        config: PathConfig,
        goal: GoalWindow,
        *,
        horizon: float,
        curve_accel_mps2: float,
        solver: str = DEFAULT,
    ) -> None:
        car = self._vehicle = context.vehicle
        self._config, self._goal = config, goal
        self._solver, self._lap = solver, context.lap
        self._horizon = horizon
        self._rows = config.dp.offsets(passes_left=context.road.drives_on_right)
        self._programs: dict[float, PathQp] = {}
        self._leads = np.array([0.0, car.axle_to_front])
        self._car = np.array([car.max_kappa, car.max_steer_rate / car.wheelbase, curve_accel_mps2])

    def choose(
        self, scene: Scene, memory: PathMemory, moving: InTheWay | None = None
    ) -> tuple[ChosenPath, PathMemory]:
        """Choose the path from the scene's start, which also passes the `moving` agents.

        And the new memory.
        """
        if scene.trouble:
            return ChosenPath(None, scene.trouble, {}, 0.0, (), tuple), PathMemory()
        task, in_the_way, standing = self._task(scene, memory.standing, moving)
        program = task.program
        grid, decisions = self._sides(scene, task, in_the_way, memory.sides)
        self._lap("path DP")
        solution = self._solve_within_bounds(task, in_the_way.obstacles, decisions)
        self._lap("path QP")
        path, shift = None, 0.0
        if solution.offsets is not None:  # it ends where the ego waits or where it bends too far
            stops = scene.s + scene.start.v**2 / (2.0 * WAITING_MPS2) < in_the_way.wait + 0.5
            until = max(in_the_way.wait, scene.s + 1.0) if stops else np.inf
            sharpest = LOCK_SLACK * self._vehicle.max_kappa
            path, shift = drivable_path(
                scene.reference.line, scene.s, program.step, solution.offsets, sharpest, until
            )
        reason = "" if path is not None else f"path QP: {solution.reports[-1].status}"
        sides = {
            decision.agent: SIDES[decision.kind]
            for decision in solution.decisions
            if decision.kind in SIDES
        }
        passed = {name: solution.rooms[name] for name in sides if name in solution.rooms}

        def artefacts() -> tuple[Artefact, ...]:
            graph = self._graph(task.road, in_the_way, grid, solution)
            shown = (
                decision
                for decision in solution.decisions
                if decision.kind is not DecisionKind.IGNORE
            )
            return (graph, *shown, program.costs(solution.x, solution.problem), *solution.reports)

        chosen = ChosenPath(path, reason, passed, shift, solution.reports, artefacts)
        return chosen, PathMemory(standing, sides)

    def _task(
        self, scene: Scene, standing_since: Mapping[str, float], moving: InTheWay | None
    ) -> tuple[_Task, InTheWay, Mapping[str, float]]:
        """The corridor without obstacles, the agents in the way, and the time since which each has
        stood there.

        The path keeps the goal's sides unless a standing agent is near.
        """
        reference, car, speed = scene.reference, self._vehicle, scene.start.v
        least_length = (speed + 4.0) * self._horizon + 10.0
        length = next(
            (candidate for candidate in LENGTHS_M if candidate >= least_length - TIE), LENGTHS_M[-1]
        )
        if length not in self._programs:
            suited, leads = length / self._horizon - 5.0, tuple(self._leads)
            self._programs[length] = PathQp(length, suited, leads, self._config.qp, self._solver)
        program = self._programs[length]
        in_the_way, standing = self._in_the_way(scene, length, standing_since)
        sides = self._goal.sides(scene.s, scene.s + length + car.axle_to_front)
        standing_spans = (
            np.array([(box.s_from, box.s_to) for box in in_the_way.obstacles])
            if in_the_way.obstacles and sides.size
            else NO_ONE
        )
        in_the_way = in_the_way.and_moving(moving) if moving else in_the_way
        start = np.array((scene.s, *scene.frenet, speed))
        ego = EgoInLane(
            start, self._leads, self._car, 0.5 * car.width + self._config.corridor.edge_m
        )
        road = road_ahead(
            reference.line.s,
            reference.table,
            ego,
            program.step,
            program.knots,
            program.middle,
            bounds.borrowed_road(in_the_way, speed, car),
            sides,
            standing_spans,
        )
        space = PathBounds(road.points[S], road.points[LOWER], road.points[UPPER])
        problem = program.stated(np.array(scene.frenet), road.references, road.rows)
        return _Task(program, ego, road, space, problem), in_the_way, standing

    def _solve_within_bounds(
        self, task: _Task, obstacles: tuple[Occupancy, ...], decisions: tuple[Decision, ...]
    ) -> _PathSolution:
        """The path in the bounds, else as little outside as possible.

        Then without the agents that it cannot clear.
        """
        config, car = self._config.corridor, self._vehicle
        reports: tuple[SolverReport, ...] = ()
        while True:
            narrow, decisions = bounds.narrow_bounds(task.space, obstacles, decisions, car, config)
            problem = task.problem if narrow is task.space else self._problem(task, narrow, HERE)
            result = task.program.solve(problem)
            in_bounds, reports = result.report.solved, (*reports, result.report)
            if not in_bounds:
                result, problem, soft_reports = self._softly(task, narrow, problem)
                reports = (*reports, *soft_reports)
            if not result.report.solved:
                return _PathSolution(None, result.x, decisions, narrow, problem, reports, {})
            offsets = result.x.reshape(3, -1)
            final, rooms = decisions, dict[str, float]()
            if obstacles:
                swung = offsets[0] + self._leads[:, None] * offsets[1] - task.road.points[SWING]
                rooms, final = bounds.check_clearance(
                    PathBounds(narrow.s, swung, swung), obstacles, decisions, car, config
                )
            if in_bounds or final == decisions:
                return _PathSolution(offsets, result.x, final, narrow, problem, reports, rooms)
            decisions = final

    def _softly(
        self, task: _Task, space: PathBounds, problem: PiecewiseJerkProblem
    ) -> tuple[QPResult, PiecewiseJerkProblem, tuple[SolverReport, ...]]:
        """The path that leaves its bounds as little as it must, the problem that it solves, and all
        reports.

        It is solved again at most `RELINEARISED` times, with the curvature's bounds at its own
        offsets.
        """
        result = task.program.solve(problem, softly=True)
        reports: tuple[SolverReport, ...] = (result.report,)
        for _ in range(RELINEARISED if result.report.solved else 0):
            nearer = self._problem(task, space, result.x.reshape(3, -1)[0])
            nearer_result = task.program.solve(nearer, softly=True)
            reports = (*reports, nearer_result.report)
            if not nearer_result.report.solved:
                break
            moved = float(np.abs(nearer_result.x - result.x).max())
            result, problem = nearer_result, nearer
            if moved < MOVED_M:
                break
        return result, problem, reports

    def _problem(self, task: _Task, space: PathBounds, offsets: FloatArray) -> PiecewiseJerkProblem:
        """The path QP in bounds, loosened to what steering can keep.

        The curvature's bounds are at offsets `offsets`.
        """
        road, program = task.road, task.program
        loosened = loosen_bounds(
            road.along,
            road.points,
            space.lower,
            space.upper,
            offsets,
            task.ego,
            program.step,
            program.middle,
        )
        return program.stated(task.problem.start, *loosened)

    def _in_the_way(
        self, scene: Scene, length: float, standing: Mapping[str, float]
    ) -> tuple[InTheWay, Mapping[str, float]]:
        """The agents in the way, the free road beside the lane, and the time since which each agent
        has stood there.
        """
        config, car, agents = self._config.corridor, self._vehicle, scene.frame.agents
        obstacles = bounds.standing_obstacles(scene, length)
        since = {box.agent: standing.get(box.agent, scene.frame.t) for box in obstacles}
        if not obstacles:
            return InTheWay(), since
        in_the_way = InTheWay(obstacles, *bounds.free_sides(scene, config))
        if not may_block(scene, obstacles):
            return in_the_way, since
        stations = scene.s + np.arange(0.0, length, 2.0) + np.zeros((1, 1))
        space = bounds.lane_bounds(
            scene.reference, stations, in_the_way, scene.start.v, car, config
        )
        # Agents that will not drive on soon: objects, and those that have stood long and are in no
        # queue
        stay = []
        for box in find_blocking(obstacles, space, car, config):
            queues = any(
                box.s_from < place < box.s_to + JUNCTION_M for place in scene.reference.waits
            )
            has_stood = scene.frame.t - since[box.agent] >= config.patience_s
            is_object = agents.kinds[agents.ids.index(box.agent)] is AgentKind.OBJECT
            if is_object or (has_stood and not queues):
                stay.append(box)
        blocked = tuple(stay)
        by_oncoming = passed_by_oncoming_lane(scene, blocked, config)
        wait = waiting_place(scene, blocked, by_oncoming)
        if by_oncoming:
            obstacles = bounds.standing_obstacles(scene, length, facing=True)
        return replace(in_the_way, obstacles=obstacles, facing=by_oncoming, wait=wait), since

    def _sides(
        self, scene: Scene, task: _Task, in_the_way: InTheWay, last_sides: Mapping[str, float]
    ) -> tuple[SlGrid | None, tuple[Decision, ...]]:
        """The side on which each obstacle is passed.

        The path DP runs only where one has space on both sides.
        """
        config, car, columns = self._config.corridor, self._vehicle, self._config.dp.columns
        choices = bounds.side_choices(in_the_way.obstacles, task.space, car, config)
        if not any(choice.is_open(config.min_clearance_m) for choice in choices):
            return None, tuple(
                choice.decided(choice.left > choice.right, None, config) for choice in choices
            )
        side, gap = 0.5 * car.width + config.min_clearance_m, config.gap_m
        boxes = [  # what the rear axle must avoid
            (
                box.s_from - car.axle_to_front - gap,
                box.s_to + car.rear_overhang + gap,
                box.l_from - side,
                box.l_to + side,
                last_sides.get(box.agent, 0.0),
            )
            for box in in_the_way.obstacles
        ]

        def room(s: FloatArray) -> tuple[FloatArray, FloatArray]:
            space = bounds.lane_bounds(scene.reference, s, in_the_way, scene.start.v, car, config)
            return space.lower, space.upper

        stations, start = (
            scene.s + task.program.length / columns * np.arange(1, columns + 1),
            task.ego.start[:4],
        )
        grid = solve_path_dp(
            stations, self._rows, start, np.reshape(boxes, (-1, 5)), room, self._config.dp
        )
        decisions = []
        for choice, (left, right) in zip(choices, grid.sides.tolist(), strict=True):
            goes_left = grid.offset(choice.box.s_middle) > 0.5 * (
                choice.box.l_from + choice.box.l_to
            )
            decisions.append(choice.decided(goes_left, (left, right), config))
        return grid, tuple(decisions)

    def _graph(
        self, road: RoadAhead, in_the_way: InTheWay, grid: SlGrid | None, solution: _PathSolution
    ) -> SlGraph:
        """The S-L graph, with the DP where it ran.

        Its corridor at the knots contains the bounds of all points.
        """
        offsets, knots, stations = solution.offsets, road.along[KNOT], solution.narrow.s
        points = [X, *range(LEADS, len(solution.problem.lower))]
        lower, upper = (
            bound[points] - road.points[SWING]
            for bound in (solution.problem.lower, solution.problem.upper)
        )
        low, high = lower[0].copy(), upper[0].copy()
        for k in range(1, len(stations)):
            low = np.minimum(low, np.interp(stations[0], stations[k], lower[k], left=np.inf))
            high = np.maximum(high, np.interp(stations[0], stations[k], upper[k], left=-np.inf))
        obstacles = []
        for box, decision in zip(in_the_way.obstacles, solution.decisions, strict=True):
            s, l = (box.s_from, box.s_to), (box.l_from, box.l_to)
            outline = np.array([(s[0], l[0]), (s[1], l[0]), (s[1], l[1]), (s[0], l[1])])
            obstacles.append(GraphObstacle(box.agent, outline, decision.kind))
        return SlGraph(
            GridCost(grid.stations, self._rows, grid.cost, grid.chosen)
            if grid is not None
            else None,
            Corridor(knots, low, high),
            np.column_stack([knots, grid.offsets(knots)]) if grid is not None else np.empty((0, 2)),
            np.column_stack([knots, offsets[0]]) if offsets is not None else np.empty((0, 2)),
            tuple(obstacles),
        )
