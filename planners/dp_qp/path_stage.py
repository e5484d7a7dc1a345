"""Path stage: room -> path DP (sides) -> corridor -> path QP -> path, and the S-L graph of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from logs.frame import Frame
from logs.kernel import TIE, FloatArray, IntArray
from logs.scenario import AgentKind
from logs.states import EgoState
from logs.trace import (
    Artefact,
    Corridor,
    CostTerms,
    Decision,
    DecisionKind,
    GraphObstacle,
    GridCost,
    Plan,
    SlGraph,
    SolverReport,
)
from logs.vehicle import VehicleParameters
from planners.dp_qp import corridor
from planners.dp_qp.appointment import Appointment
from planners.dp_qp.corridor import CorridorConfig, PathObstacle
from planners.dp_qp.facing import blocking, may_block, passed_facing, waiting_place
from planners.dp_qp.path import Path, frenet_start, make_path, out_of_frame
from planners.dp_qp.path_dp import SAMPLES, PathDpConfig, path_dp, path_dp_offsets, path_dp_to_go, side_costs
from planners.dp_qp.path_qp import MAX_DL, PathProblem, PathQp, PathQpConfig
from planners.dp_qp.reference_line import Course
from planners.dp_qp.slower import NOBODY, Movers
from planners.dp_qp.steering import COMFORT, HARD, bounded, swing
from planners.piecewise_jerk.solvers import DEFAULT
from planners.qp import QPResult

LENGTHS_M = (60.0, 90.0, 130.0, 180.0, 250.0, 340.0)
"""Path lengths; the shortest that holds the horizon at the present speed is taken, so that weights stay constant."""


SHIFT_AHEAD_M = 60.0
WAITING_MPS2 = 2.0
"""Braking with which it stops at the place from which it could pass by the facing lane."""
PATIENCE_S = 5.0
"""A vehicle that has stood for so long is passed by the facing lane ..."""
JUNCTION_M = 40.0
"""... unless lanes part or meet within this before it: then it waits for somebody."""

FORCED_M = 0.3
"""Steering hard is thought of where comfortable steering would leave the lane by more than this."""
NEAR_GOAL_M = 15.0
"""Who stands within this of the goal is passed as anywhere else."""
NEARLY_M, LEFT_M = 0.5, 0.1
"""A goal farther out of the room than this is not this lane's; and what is left of the room where it is outside."""
RELINEARISED, MOVED_M = 2, 0.02
"""So often the path that cannot keep its corridor is solved anew, until that moves it by less than this."""
LOCK_SLACK, AT_START_M = 1.05, 5.0
"""A path ends where its curvature is more than that much of the steering lock's, though not so near to the start."""


@dataclass(frozen=True)
class PathConfig:
    """Settings of the path stage, by part."""

    dp: PathDpConfig = field(default_factory=PathDpConfig)
    qp: PathQpConfig = field(default_factory=PathQpConfig)
    corridor: CorridorConfig = field(default_factory=CorridorConfig)


@dataclass(frozen=True, eq=False, slots=True)
class ChosenPath:
    """What the path stage found.

    Attributes:
        path: None where the QP failed.
        reason: Why it failed; empty otherwise.
        passed: Agents that the path passes on purpose.
        shift: Largest change of the offset from the reference line within `SHIFT_AHEAD_M`, m.
        artefacts: Graph, decisions, costs, solver report.
    """

    path: Path | None
    reason: str
    passed: frozenset[str]
    shift: float
    artefacts: tuple[Artefact, ...]


@dataclass(frozen=True, eq=False, slots=True)
class _Scene:
    """Who stands in the way; whether the lanes beside are free; the speed; whom the facing lane is free to pass.

    And the station at which to wait until it is, m.
    """

    obstacles: tuple[PathObstacle, ...]
    left: bool
    right: bool
    speed: float
    facing: frozenset[str] = frozenset()
    wait: float = np.inf


@dataclass(frozen=True, eq=False, slots=True)
class _Task:
    """What the path QP is asked.

    Attributes:
        program: The path QP of its length.
        knots: Stations `(knots,)`, m.
        space: Room of the ego's points `(points, knots)`, without obstacles; `road` also without the goal's sides.
        swings: How far they swing out, m.
        start: l, l', l''.
        speed: At the start, m/s.
        limit: Speed limit at the knots `(knots,)`, m/s.
        kappa: Curvature of the reference line there, 1/m.
    """

    program: PathQp
    knots: FloatArray
    space: corridor.Room
    road: corridor.Room
    swings: FloatArray
    start: tuple[float, float, float]
    speed: float
    limit: FloatArray
    kappa: FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class _Found:
    """l, l', l'' `(3, knots)` or None; what was decided in the end; the corridor kept; costs and reports."""

    offsets: FloatArray | None
    decisions: tuple[Decision, ...]
    corridor: tuple[FloatArray, FloatArray]
    costs: CostTerms
    reports: tuple[SolverReport, ...]


class PathStage:
    """Chooses the path of each frame along one course; owns the path QP of each length."""

    def __init__(
        self,
        course: Course,
        vehicle: VehicleParameters,
        config: PathConfig,
        appointment: Appointment,
        *,
        horizon: float,
        passes_left: bool,
        lap: Callable[[str], None],
        solver: str = DEFAULT,
    ) -> None:
        self._course, self._vehicle, self._config, self._lap = course, vehicle, config, lap
        self._appointment, self._horizon, self._solver = appointment, horizon, solver
        self._rows = config.dp.offsets(passes_left=passes_left)
        self._programs: dict[float, PathQp] = {}
        self._standing: dict[str, float] = {}  # who stands in the way, seen since when
        self._leads = np.array([0.0, vehicle.axle_to_front])
        self._car = np.array([vehicle.max_kappa, vehicle.max_steer_rate / vehicle.wheelbase])
        dp = config.dp
        self._weights = np.array([dp.w_ref, dp.w_dl, dp.w_ddl, dp.w_near, dp.reach_m, dp.w_switch])

    def choose(
        self, frame: Frame, start: EgoState, s0: float, l0: float, movers: Movers = NOBODY, *, fresh: bool
    ) -> ChosenPath:
        """The path from `start`, whose foot on the reference line is (s0, l0), past those who move, too."""
        line = self._course.line
        if fresh:
            self._standing = {}
        trouble = out_of_frame(line, start, s0, l0)
        if trouble:
            return ChosenPath(None, trouble, frozenset(), 0.0, ())
        program = self._program(start.v)
        frenet = frenet_start(line, start, s0, l0)
        knots = s0 + program.step * np.arange(program.knots)
        scene = self._scene(frame, s0, start.v, program)
        standing = scene.obstacles
        scene = _with(scene, movers)
        obstacles = scene.obstacles
        stations = s0 + program.length / self._config.dp.columns * np.arange(1, self._config.dp.columns + 1)
        found_dp = self._dp(stations, knots, (s0, *frenet), scene, _sides(frame.previous))
        grid, chosen, dp_knots, dp_at, sides = found_dp
        self._lap("path DP")
        points, swings = knots + self._leads[:, None], swing(self._course, knots, self._leads)
        road = corridor.eased(self._room(points, scene), swings)
        aimed = self._aimed(road, standing)
        space = corridor.widened(aimed, frenet, start.v)
        road = space if aimed is road else corridor.widened(road, frenet, start.v)
        decisions = corridor.decide_sides(obstacles, dp_at, sides, space, self._vehicle, self._config.corridor)
        at = self._course.at(knots)
        task = _Task(program, knots, space, road, swings, frenet, start.v, at[6], at[7])
        found = self._solved(task, obstacles, decisions)
        self._lap("path QP")
        offsets, path = found.offsets, None
        if offsets is not None:
            path = self._drivable(make_path(line, s0, program.step, offsets), scene.wait, start.v)
        graph = SlGraph(
            GridCost(stations, self._rows, grid, chosen),
            Corridor(knots, *found.corridor),
            np.column_stack([knots, dp_knots]),
            np.column_stack([knots, offsets[0]]) if offsets is not None else np.empty((0, 2)),
            tuple(_outlined(box, decision.kind) for box, decision in zip(obstacles, found.decisions, strict=True)),
        )
        passed = frozenset(decision.agent for decision in found.decisions if decision.kind in corridor.NUDGES)
        reason = "" if path is not None else f"path QP: {found.reports[-1].status}"
        near = knots < s0 + SHIFT_AHEAD_M
        shift = float(np.abs(offsets[0, near] - offsets[0, 0]).max()) if offsets is not None else 0.0
        told: tuple[Artefact, ...] = (graph, *_told(found.decisions), found.costs, *found.reports)
        return ChosenPath(path, reason, passed, shift, told)

    def _solved(self, task: _Task, obstacles: tuple[PathObstacle, ...], decisions: tuple[Decision, ...]) -> _Found:
        """The path in the corridor, else out of it as little as can be; then again without whom that cannot clear."""
        config = self._config.corridor
        reports: tuple[SolverReport, ...] = ()
        while True:
            narrow, decisions = corridor.narrowed(task.space, obstacles, decisions, self._vehicle, config)
            problem = self._problem(task, narrow, np.clip(0.0, narrow.lower[0], narrow.upper[0]))
            result, costs = task.program.solve(problem)
            in_corridor, reports = result.report.solved, (*reports, result.report)
            if not in_corridor:
                result, costs, problem, more = self._softly(task, narrow, problem)
                reports = (*reports, *more)
            bounds = corridor.reported(narrow, problem.lower - task.swings, problem.upper - task.swings)
            if not result.report.solved:
                return _Found(None, decisions, bounds, costs, reports)
            offsets = result.x.reshape(3, -1)
            at = offsets[0] + self._leads[:, None] * offsets[1] - task.swings
            final = corridor.given_up(at, narrow, obstacles, decisions, self._vehicle, config)
            if in_corridor or final == decisions:
                return _Found(offsets, final, bounds, costs, reports)
            decisions = final

    def _softly(
        self, task: _Task, space: corridor.Room, problem: PathProblem
    ) -> tuple[QPResult, CostTerms, PathProblem, tuple[SolverReport, ...]]:
        """The path that leaves its corridor as little as it must, the problem that it solves, and all reports.

        Solved anew at most `RELINEARISED` times, with the curvature's bounds at its own offsets.
        """
        result, costs = task.program.solve(problem, softly=True)
        reports: tuple[SolverReport, ...] = (result.report,)
        for _ in range(RELINEARISED if result.report.solved else 0):
            nearer = self._problem(task, space, result.x.reshape(3, -1)[0])
            again, again_costs = task.program.solve(nearer, softly=True)
            reports = (*reports, again.report)
            if not again.report.solved:
                break
            moved = float(np.abs(again.x - result.x).max())
            result, costs, problem = again, again_costs, nearer
            if moved < MOVED_M:
                break
        return result, costs, problem, reports

    def _problem(self, task: _Task, space: corridor.Room, near: FloatArray) -> PathProblem:
        """The bounds of the path QP: the corridor, loosened to the reach of comfortable steering.

        Where that leaves the road's room by more than `FORCED_M`, of hard steering if that leaves it by less. The
        bounds of the curvature are those at the offsets `near` `(knots,)`.
        """
        start = np.array(task.start)
        least = np.inf
        for limits in (COMFORT, HARD):
            bend, rate, left, right = bounded(
                start, task.speed, task.limit, task.kappa, near, task.program.step, self._car, limits
            )
            low = left[0] + self._leads[:, None] * left[1] - task.swings
            high = right[0] + self._leads[:, None] * right[1] - task.swings
            forced = max(float((task.road.lower - low).max()), float((high - task.road.upper).max()))
            if forced < least:
                slope = np.array([np.minimum(-MAX_DL, left[1]), np.maximum(MAX_DL, right[1])])
                lower, upper = np.minimum(space.lower, low), np.maximum(space.upper, high)
                best = PathProblem(start, lower + task.swings, upper + task.swings, slope, bend, rate)
            if forced <= FORCED_M:
                break
            least = forced
        return best

    def _aimed(self, space: corridor.Room, obstacles: tuple[PathObstacle, ...]) -> corridor.Room:
        """The room within the goal's sides, as near to them as it goes; not where somebody stands near the goal."""
        low, high = self._appointment.sides(space.s)
        there = np.isfinite(low) & (low <= space.upper + NEARLY_M) & (high >= space.lower - NEARLY_M)
        if not there.any():
            return space
        begin, end = space.s[there].min() - NEAR_GOAL_M, space.s[there].max() + NEAR_GOAL_M
        if any(box.s_from < end and box.s_to > begin for box in obstacles):
            return space
        lower = np.clip(low, space.lower, np.maximum(space.upper - LEFT_M, space.lower))
        upper = np.clip(high, np.minimum(space.lower + LEFT_M, space.upper), space.upper)
        return corridor.Room(space.s, np.where(there, lower, space.lower), np.where(there, upper, space.upper))

    def _drivable(self, path: Path, wait: float, speed: float) -> Path:
        """The path to the station at which to wait, if it can stop there, or to where it turns beyond the lock."""
        ends = (np.abs(path.kappa) > LOCK_SLACK * self._vehicle.max_kappa) & (path.sigma > AT_START_M)
        if path.s[0] + speed**2 / (2.0 * WAITING_MPS2) < wait + 0.5:
            ends |= path.s > max(wait, path.s[0] + 1.0)
        if not ends.any():
            return path
        end = int(np.argmax(ends))
        return Path(*(getattr(path, name)[:end] for name in ("sigma", "x", "y", "yaw", "kappa", "s")))

    def _program(self, speed: float) -> PathQp:
        wanted = (speed + 4.0) * self._horizon + 10.0
        length = next((candidate for candidate in LENGTHS_M if candidate >= wanted - TIE), LENGTHS_M[-1])
        if length not in self._programs:
            suited, leads = length / self._horizon - 5.0, tuple(self._leads)
            self._programs[length] = PathQp(length, suited, leads, self._config.qp, self._solver)
        return self._programs[length]

    def _scene(self, frame: Frame, s0: float, speed: float, program: PathQp) -> _Scene:
        """Who stands in the way, and what of the road beside the lane is free."""
        course, vehicle, config = self._course, self._vehicle, self._config.corridor
        obstacles = corridor.path_obstacles(course, frame, s0, program.length, vehicle)
        waited = self._waited_for(frame, obstacles)
        if not obstacles:
            return _Scene((), True, True, speed)
        left, right = corridor.free_sides(course, frame, s0, config)
        scene = _Scene(obstacles, left, right, speed)
        if not may_block(course, obstacles, vehicle):
            return scene
        near = s0 + np.arange(0.0, program.length, 2.0) + np.zeros((1, 1))
        blocked = [box for box in blocking(obstacles, self._room(near, scene), vehicle, config) if waited(box)]
        facing = passed_facing(course, frame, s0, tuple(blocked), vehicle, config)
        wait = waiting_place(course, tuple(blocked), facing, vehicle)
        if not facing:
            return replace(scene, wait=wait)
        obstacles = corridor.path_obstacles(course, frame, s0, program.length, vehicle, facing=True)
        return _Scene(obstacles, left, right, speed, facing, wait)

    def _waited_for(self, frame: Frame, obstacles: tuple[PathObstacle, ...]) -> Callable[[PathObstacle], bool]:
        """Whether somebody will not drive on soon: no vehicle, or one that stood long where nobody has to wait."""
        self._standing = {box.agent: self._standing.get(box.agent, frame.t) for box in obstacles}
        kinds = dict(zip(frame.agents.ids, frame.agents.kinds, strict=True))

        def waited(box: PathObstacle) -> bool:
            if kinds[box.agent] is AgentKind.OBJECT:
                return True
            queues = any(box.s_from < place < box.s_to + JUNCTION_M for place in self._course.waits)
            return not queues and frame.t - self._standing[box.agent] >= PATIENCE_S

        return waited

    def _room(self, s: FloatArray, scene: _Scene) -> corridor.Room:
        borrow = corridor.borrowed(scene.obstacles, s, scene.speed, self._vehicle, scene.facing)
        return corridor.room(
            self._course, s, borrow, left_free=scene.left, right_free=scene.right,
            vehicle=self._vehicle, config=self._config.corridor,
        )  # fmt: skip

    def _dp(
        self, stations: FloatArray, knots: FloatArray, start: tuple[float, float, float, float], scene: _Scene,
        before: dict[str, float],
    ) -> tuple[FloatArray, IntArray, FloatArray, FloatArray, FloatArray]:  # fmt: skip
        """Grid cost, chosen rows, the DP path's offsets at knots and obstacles' middles, costs of sides `(b, 2)`."""
        obstacles = scene.obstacles
        step = stations[1] - stations[0]
        samples = (stations[:, None] - step + step / SAMPLES * np.arange(1, SAMPLES + 1)).ravel()
        space = self._room(samples, scene)
        gaps = self._config.corridor
        boxes = np.array(
            [
                (*corridor.grown(b, self._vehicle, gaps.min_clearance_m, gaps.gap_m), before.get(b.agent, 0.0))
                for b in obstacles
            ]
        ).reshape(-1, 5)
        ego, shape = np.array(start), (len(stations), SAMPLES)
        lower, upper = space.lower.reshape(shape), space.upper.reshape(shape)
        cost, chosen = path_dp(stations, self._rows, ego, boxes, lower, upper, self._weights)
        sides: FloatArray = np.empty((0, 2))
        if len(boxes):
            through = cost + path_dp_to_go(stations, self._rows, boxes, lower, upper, self._weights)
            sides = side_costs(stations, self._rows, through, boxes)
        middles = np.array([0.5 * (b.s_from + b.s_to) for b in obstacles])
        at = path_dp_offsets(stations, self._rows, chosen, ego, np.r_[knots, middles])
        return cost, chosen, at[: len(knots)], at[len(knots) :], sides


def _with(scene: _Scene, movers: Movers) -> _Scene:
    """The scene with those who are passed while they go on; the lanes beside must be free for all."""
    if not movers.boxes:
        return scene
    both = tuple(sorted((*scene.obstacles, *movers.boxes), key=lambda box: (box.s_from, box.agent)))
    left, right = scene.left and movers.left, scene.right and movers.right
    return replace(scene, obstacles=both, left=left, right=right, facing=scene.facing | movers.facing)


def _sides(previous: Plan | None) -> dict[str, float]:
    """On which side the previous plan passes whom: 1 left, -1 right."""
    signs = {DecisionKind.NUDGE_LEFT: 1.0, DecisionKind.NUDGE_RIGHT: -1.0}
    told = [item for item in previous.internals if isinstance(item, Decision)] if previous is not None else []
    return {item.agent: signs[item.kind] for item in told if item.stage == "path" and item.kind in signs}


def _outlined(box: PathObstacle, kind: DecisionKind) -> GraphObstacle:
    s, l = (box.s_from, box.s_to), (box.l_from, box.l_to)  # noqa: E741
    return GraphObstacle(box.agent, np.array([(s[0], l[0]), (s[1], l[0]), (s[1], l[1]), (s[0], l[1])]), kind)


def _told(decisions: tuple[Decision, ...]) -> tuple[Decision, ...]:
    """What is worth telling: not those whom the path ignores."""
    return tuple(decision for decision in decisions if decision.kind is not DecisionKind.IGNORE)
