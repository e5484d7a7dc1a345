"""The planner's one screen: start, candidate lanes, choice, trajectory; or the fallback and why."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from math import hypot, inf

from logs.frame import Frame, PlannerContext
from logs.states import EgoState
from logs.trace import Artefact, Plan, PlanStart, PlanStatus
from planners.dp_qp.decide import choose, worth_looking
from planners.dp_qp.fallback import along, fall_back
from planners.dp_qp.lane_plan import LanePlan, LanePlanner
from planners.dp_qp.lanes import Lanes, Strip
from planners.dp_qp.passing import Passing
from planners.dp_qp.path_stage import PathConfig
from planners.dp_qp.speed_stage import SpeedConfig
from planners.piecewise_jerk.solvers import DEFAULT, check_solver
from planners.rules import Rulebook


@dataclass(frozen=True)
class DpQpConfig:
    """Settings of `dp_qp`.

    Attributes:
        path: The path stage.
        speed: The speed stage.
        solver: Of the path and speed QPs: "interior_point", "osqp" or "piqp".
        stitch_m: The plan starts on the previous one where the ego is nearer to it than this ...
        stitch_mps: ... and its speed nearer than this; else at the ego.
    """

    path: PathConfig = field(default_factory=PathConfig)
    speed: SpeedConfig = field(default_factory=SpeedConfig)
    solver: str = DEFAULT
    stitch_m: float = 0.5
    stitch_mps: float = 1.0

    def __post_init__(self) -> None:
        check_solver(self.solver)


class DpQp:
    """DP and QP planner over candidate lanes.

    Memory, dropped where `frame.previous is None`: the lane that is driven and since when; per lane the last
    station, and whom the ego is passing there.
    """

    def __init__(self, context: PlannerContext, config: DpQpConfig | None = None) -> None:
        self._config = config or DpQpConfig()
        self._context, self._vehicle, self._lap = context, context.vehicle, context.lap
        self._lanes = Lanes(context)
        self._planners: dict[Strip, LanePlanner] = {}
        self._passings: dict[Strip, Passing] = {}
        self._driven = self._planner(self._lanes.start(context.start))
        self._changed = -inf

    def plan(self, frame: Frame) -> Plan:
        """A plan from the previous plan or the ego; with a fallback, its status and reason."""
        fresh = frame.previous is None
        start, start_kind = self._start(frame)
        if fresh:
            for planner in self._planners.values():
                planner.forget()
            for passing in self._passings.values():
                passing.forget()
            self._driven, self._changed = self._planner(self._lanes.start(start)), -inf
        self._lap("start")
        chosen, considered = self._choose(frame, start, fresh=fresh)
        artefacts = (*chosen.artefacts, *considered)
        config = self._config.speed.qp
        path, speed = chosen.path.path, chosen.speed
        if path is None or speed is None or speed.profile is None:
            reason = chosen.path.reason or (speed.reason if speed else "")
            return fall_back(frame, start, start_kind, path, reason, artefacts, self._vehicle, config)
        status = PlanStatus.HARD_STOP if speed.unavoidable else PlanStatus.PLANNED
        return Plan(along(path, speed.profile, frame.t), status, speed.reason, start_kind, artefacts)

    def _choose(self, frame: Frame, start: EgoState, *, fresh: bool) -> tuple[LanePlan, tuple[Artefact, ...]]:
        """The plan in the best lane; the neighbours are planned only where that may pay."""
        keep = self._driven.plan("keep", frame, start, fresh=fresh)
        keep, considered = self._passing_in(keep.strip).choose(keep, frame, start, fresh=fresh)
        self._lap("passing")
        if not worth_looking(keep, since_change=frame.t - self._changed):
            return keep, considered
        beside = self._lanes.beside(keep.strip, keep.s)
        others = [self._planner(strip).plan(side, frame, start, fresh=fresh) for side, strip in beside]
        if not others:
            return keep, considered
        chosen, more = choose(keep, others, frame, self._vehicle)
        if chosen is not keep:
            self._passing_in(keep.strip).forget()
            self._driven, self._changed = self._planner(chosen.strip), frame.t
        self._lap("lane choice")
        return chosen, (*considered, *more)

    def _passing_in(self, strip: Strip) -> Passing:
        if strip not in self._passings:
            left = self._context.road.drives_on_right
            self._passings[strip] = Passing(
                partial(self._new_planner, strip), self._vehicle, self._config.path.corridor, passes_left=left
            )
        return self._passings[strip]

    def _planner(self, strip: Strip) -> LanePlanner:
        if strip not in self._planners:
            self._planners[strip] = self._new_planner(strip)
        return self._planners[strip]

    def _new_planner(self, strip: Strip) -> LanePlanner:
        return LanePlanner(
            strip,
            Rulebook(self._context.road, strip.course, self._vehicle),
            self._context.goal,
            self._vehicle,
            self._config.path,
            self._config.speed,
            passes_left=self._context.road.drives_on_right,
            lap=self._lap,
            solver=self._config.solver,
        )

    def _start(self, frame: Frame) -> tuple[EgoState, PlanStart]:
        if frame.previous is not None:
            old = frame.previous.trajectory.at(frame.t)
            near = hypot(old.x - frame.ego.x, old.y - frame.ego.y) <= self._config.stitch_m
            if near and abs(old.v - frame.ego.v) <= self._config.stitch_mps:
                return old, PlanStart.PREVIOUS_PLAN
        return frame.ego, PlanStart.EGO
