"""The planner's one screen: start, path, speed, trajectory; or the fallback and why."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import hypot

import numpy as np

from logs.frame import Frame, PlannerContext
from logs.states import EgoState
from logs.trace import Plan, PlanStart, PlanStatus
from planners.dp_qp.fallback import along, fall_back
from planners.dp_qp.path_stage import PathConfig, PathStage
from planners.dp_qp.reference_line import make_course
from planners.dp_qp.route import find_route
from planners.dp_qp.speed_stage import SpeedConfig, SpeedStage
from planners.dp_qp.st_graph import behind

TRACK_M = 1.0
"""A path that stays within this of the ego's offset keeps its track."""


@dataclass(frozen=True)
class DpQpConfig:
    """Settings of `dp_qp`.

    Attributes:
        path: The path stage.
        speed: The speed stage.
        stitch_m: The plan starts on the previous one where the ego is nearer to it than this ...
        stitch_mps: ... and its speed nearer than this; else at the ego.
    """

    path: PathConfig = field(default_factory=PathConfig)
    speed: SpeedConfig = field(default_factory=SpeedConfig)
    stitch_m: float = 0.5
    stitch_mps: float = 1.0


class DpQp:
    """DP and QP planner on one reference line.

    Memory: solver warm starts and the last station on the reference line; both are dropped where
    `frame.previous is None`.
    """

    def __init__(self, context: PlannerContext, config: DpQpConfig | None = None) -> None:
        self._config = config or DpQpConfig()
        self._vehicle, self._lap = context.vehicle, context.lap
        route = find_route(context.road, context.start, context.goal)
        self._course = make_course(context.road, route, context.start)
        self._path = PathStage(
            self._course,
            context.vehicle,
            self._config.path,
            horizon=self._config.speed.qp.horizon,
            passes_left=context.road.drives_on_right,
            lap=context.lap,
        )
        self._speed = SpeedStage(context.vehicle, self._config.speed, context.lap)
        self._station: float | None = None

    def plan(self, frame: Frame) -> Plan:
        """A plan from the previous plan or the ego; with a fallback, its status and reason."""
        fresh = frame.previous is None
        start, start_kind = self._start(frame)
        s0, l0 = self._course.line.project(start.x, start.y, None if fresh else self._station)
        self._station = s0
        self._lap("start")
        path = self._path.choose(frame, start, s0, l0, fresh=fresh)
        if path.path is None:
            return fall_back(
                frame, start, start_kind, None, path.reason, path.artefacts, self._vehicle, self._config.speed.qp
            )
        limit = np.interp(path.path.s, self._course.line.s, self._course.limit)
        skip = behind(self._course, frame, s0, l0, self._vehicle, keeps_track=path.shift < TRACK_M)
        speed = self._speed.choose(frame, start, path.path, limit, skip, path.passed, fresh=fresh)
        artefacts = (*path.artefacts, *speed.artefacts)
        if speed.profile is None:
            return fall_back(
                frame, start, start_kind, path.path, speed.reason, artefacts, self._vehicle, self._config.speed.qp
            )
        trajectory = along(path.path, speed.profile, frame.t)
        status = PlanStatus.HARD_STOP if speed.unavoidable else PlanStatus.PLANNED
        return Plan(trajectory, status, speed.reason, start_kind, artefacts)

    def _start(self, frame: Frame) -> tuple[EgoState, PlanStart]:
        if frame.previous is not None:
            old = frame.previous.trajectory.at(frame.t)
            near = hypot(old.x - frame.ego.x, old.y - frame.ego.y) <= self._config.stitch_m
            if near and abs(old.v - frame.ego.v) <= self._config.stitch_mps:
                return old, PlanStart.PREVIOUS_PLAN
        return frame.ego, PlanStart.EGO
