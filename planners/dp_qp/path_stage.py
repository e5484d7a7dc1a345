"""Path stage: room -> path DP (sides) -> corridor -> path QP -> path, and the S-L graph of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from logs.frame import Frame
from logs.kernel import FloatArray, IntArray
from logs.states import EgoState
from logs.trace import Artefact, Corridor, Decision, DecisionKind, GraphObstacle, GridCost, SlGraph
from logs.vehicle import VehicleParameters
from planners.dp_qp import corridor
from planners.dp_qp.corridor import CorridorConfig, PathObstacle
from planners.dp_qp.path import Path, frenet_start, make_path, out_of_frame
from planners.dp_qp.path_dp import SAMPLES, PathDpConfig, path_dp, path_dp_offset
from planners.dp_qp.path_qp import PathQp, PathQpConfig
from planners.dp_qp.reference_line import Course

LENGTHS_M = (60.0, 90.0, 130.0, 180.0, 250.0, 340.0)
"""Path lengths; the shortest that holds the horizon at the present speed is taken, so that matrices stay constant."""


SHIFT_AHEAD_M = 60.0

SHARPEST_MPS2 = 4.0
"""Lateral acceleration up to which a path swerves; beyond it the ego brakes instead."""


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


class PathStage:
    """Chooses the path of each frame along one course; owns the QP workspaces."""

    def __init__(
        self,
        course: Course,
        vehicle: VehicleParameters,
        config: PathConfig,
        *,
        horizon: float,
        passes_left: bool,
        lap: Callable[[str], None],
    ) -> None:
        self._course, self._vehicle, self._config, self._lap = course, vehicle, config, lap
        self._horizon = horizon
        self._rows = config.dp.offsets(passes_left=passes_left)
        self._programs: dict[float, PathQp] = {}
        dp = config.dp
        self._weights = np.array([dp.w_ref, dp.w_dl, dp.w_ddl, dp.w_near, dp.reach_m])

    def choose(self, frame: Frame, start: EgoState, s0: float, l0: float, *, fresh: bool) -> ChosenPath:
        """The path from `start`, whose foot on the reference line is (s0, l0)."""
        trouble = out_of_frame(self._course.line, start, s0, l0)
        if trouble:
            return ChosenPath(None, trouble, frozenset(), 0.0, ())
        program = self._program(start.v)
        frenet = frenet_start(self._course.line, start, s0, l0)
        knots = s0 + program.step * np.arange(program.knots)
        obstacles = corridor.path_obstacles(self._course, frame, s0, program.length, self._vehicle)
        left, right = corridor.free_sides(self._course, frame, s0, self._config.corridor) if obstacles else (True, True)
        stations = s0 + program.length / self._config.dp.columns * np.arange(1, self._config.dp.columns + 1)
        grid, chosen, dp_knots, dp_at = self._dp(stations, knots, (s0, *frenet), obstacles, left, right, start.v)
        self._lap("path DP")
        space = corridor.widened(self._room(knots, obstacles, left, right, start.v), frenet, start.v)
        decisions = corridor.decide_sides(obstacles, dp_at, space, self._vehicle, self._config.corridor)
        lower, upper, decisions = corridor.narrowed(space, obstacles, decisions, self._vehicle, self._config.corridor)
        sharpest = min(0.5 * self._vehicle.max_kappa, SHARPEST_MPS2 / max(start.v, 1.0) ** 2)
        low, high = corridor.reachable(knots, lower, upper, frenet, sharpest)
        kappa = np.interp(knots, self._course.line.s, self._course.line.kappa)
        result, costs = program.solve(frenet, low, high, kappa, self._vehicle.max_kappa, fresh=fresh)
        offsets = result.x.reshape(3, program.knots)
        path = make_path(self._course.line, s0, program.step, offsets) if result.report.solved else None
        self._lap("path QP")
        solution = np.column_stack([knots, offsets[0]]) if path is not None else np.empty((0, 2))
        graph = SlGraph(
            GridCost(stations, self._rows, grid, chosen),
            Corridor(knots, lower, upper),
            np.column_stack([knots, dp_knots]),
            solution,
            tuple(_outlined(box, decision.kind) for box, decision in zip(obstacles, decisions, strict=True)),
        )
        nudged = (DecisionKind.NUDGE_LEFT, DecisionKind.NUDGE_RIGHT)
        passed = frozenset(decision.agent for decision in decisions if decision.kind in nudged)
        reason = "" if path is not None else f"path QP: {result.report.status}"
        shift = float(np.abs(offsets[0, knots < s0 + SHIFT_AHEAD_M] - offsets[0, 0]).max())
        return ChosenPath(path, reason, passed, shift, (graph, *_told(decisions), costs, result.report))

    def _program(self, speed: float) -> PathQp:
        wanted = (speed + 4.0) * self._horizon + 10.0
        length = next((candidate for candidate in LENGTHS_M if candidate >= wanted), LENGTHS_M[-1])
        if length not in self._programs:
            self._programs[length] = PathQp(length, length / self._horizon - 5.0, self._config.qp)
        return self._programs[length]

    def _room(
        self,
        s: FloatArray,
        obstacles: tuple[PathObstacle, ...],
        left: bool,
        right: bool,
        speed: float,
    ) -> corridor.Room:
        borrow = corridor.borrowed(obstacles, s, speed, self._vehicle)
        return corridor.room(
            self._course, s, borrow, left_free=left, right_free=right,
            vehicle=self._vehicle, config=self._config.corridor,
        )  # fmt: skip

    def _dp(
        self, stations: FloatArray, knots: FloatArray, start: tuple[float, float, float, float],
        obstacles: tuple[PathObstacle, ...], left: bool, right: bool, speed: float,
    ) -> tuple[FloatArray, IntArray, FloatArray, FloatArray]:  # fmt: skip
        """Grid cost, chosen rows, the DP path's offsets at the knots and at the obstacles' middles."""
        step = stations[1] - stations[0]
        samples = (stations[:, None] - step + step / SAMPLES * np.arange(1, SAMPLES + 1)).ravel()
        space = self._room(samples, obstacles, left, right, speed)
        gaps = self._config.corridor
        boxes = np.array([corridor.grown(b, self._vehicle, gaps.min_clearance_m, gaps.gap_m) for b in obstacles])
        ego = np.array(start)
        shape = (len(stations), SAMPLES)
        cost, chosen = path_dp(
            stations, self._rows, ego, boxes.reshape(-1, 4),
            space.lower.reshape(shape), space.upper.reshape(shape), self._weights,
        )  # fmt: skip
        at = [path_dp_offset(stations, self._rows, chosen, ego, s) for s in knots]
        beside = [path_dp_offset(stations, self._rows, chosen, ego, 0.5 * (b.s_from + b.s_to)) for b in obstacles]
        return cost, chosen, np.array(at), np.array(beside)


def _outlined(box: PathObstacle, kind: DecisionKind) -> GraphObstacle:
    s, l = (box.s_from, box.s_to), (box.l_from, box.l_to)  # noqa: E741
    return GraphObstacle(box.agent, np.array([(s[0], l[0]), (s[1], l[0]), (s[1], l[1]), (s[0], l[1])]), kind)


def _told(decisions: tuple[Decision, ...]) -> tuple[Decision, ...]:
    """What is worth telling: not those whom the path ignores."""
    return tuple(decision for decision in decisions if decision.kind is not DecisionKind.IGNORE)
