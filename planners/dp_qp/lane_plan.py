"""One candidate lane planned: path and speed in its own Frenet frame, and what that plan is worth.

The cost of a candidate adds terms in seconds:

(1) time lost     = (distance with nobody in the way - distance planned) / speed limit, over the horizon
(2) lane changes  = n (ROUTE_S + URGENCY_S u),  u from 0 to 1 as the place where the first is due, or the goal's last
                    time, comes near; DEAD_END_S where the goal cannot be reached from the lane
(3) change        = CHANGE_S for another lane than the one that is driven
(4) braking       = HARD_S where comfort cannot keep the distance, FAILED_S where nothing can or a stage failed
(5) late          = how much later than the goal's last time the ego would be there at the lane's speed limit
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import hypot, inf

import numpy as np

from logs.frame import Frame
from logs.road import Goal
from logs.states import EgoState
from logs.trace import Artefact, CostTerms
from logs.vehicle import VehicleParameters
from planners.dp_qp.appointment import Appointment, Pace
from planners.dp_qp.lanes import Strip
from planners.dp_qp.path_stage import ChosenPath, PathConfig, PathStage
from planners.dp_qp.slower import NOBODY, Movers, Slower, along_lane, beside_limit, gone_on, slower, swerve_limit
from planners.dp_qp.speed_solve import RESERVE
from planners.dp_qp.speed_stage import ChosenSpeed, SpeedConfig, SpeedStage
from planners.dp_qp.st_graph import behind
from planners.piecewise_jerk.solvers import DEFAULT
from planners.rules import Rulebook, walls_on

FORGET_S = 0.5
"""A lane that was not planned for so long is planned as if for the first time."""
LOST_M = 15.0
"""A lane that was not planned for so long is looked for anew: the foot point is not near the last one."""
TRACK_M = 1.0
"""A path that stays within this of the ego's offset keeps its track."""

ROUTE_S, URGENCY_S, DEAD_END_S = 1.6, 6.0, 25.0
CHANGE_S = 1.0
HARD_S, FAILED_S = 3.0, 50.0
DUE_S = 15.0
"""A lane change is urgent where less than this is left to drive until it is due, per change."""


@dataclass(frozen=True, eq=False, slots=True)
class Past:
    """Those whom a plan is to pass while they go on, and what the path stage is told of them."""

    found: tuple[Slower, ...]
    movers: Movers


@dataclass(frozen=True, eq=False, slots=True)
class LanePlan:
    """What was planned in one lane.

    Attributes:
        name: "keep", "pass" (the same lane, past who is slower), "left" or "right".
        strip: The lane.
        s: Station of the start, m; `l` its offset.
        path: What the path stage found.
        speed: What the speed stage found; None where there is no path.
        costs: (1)-(5).
    """

    name: str
    strip: Strip
    s: float
    l: float  # noqa: E741
    path: ChosenPath
    speed: ChosenSpeed | None
    costs: CostTerms

    @property
    def cost(self) -> float:
        """Sum of (1)-(5), s."""
        return sum(value for _, value in self.costs.terms)

    @property
    def time_lost(self) -> float:
        """(1) and (5), s."""
        terms = dict(self.costs.terms)
        return terms["time lost"] + terms["late"]

    @property
    def braking(self) -> float:
        """(4), s."""
        return dict(self.costs.terms)["braking"]

    @property
    def is_comfortable(self) -> bool:
        """Whether both stages found a plan without hard braking."""
        return self.speed is not None and self.speed.profile is not None and not self.speed.reason

    @property
    def artefacts(self) -> tuple[Artefact, ...]:
        """Of both stages."""
        return (*self.path.artefacts, *(self.speed.artefacts if self.speed else ()))


class LanePlanner:
    """Plans in one strip; owns its stages, and the station where the ego was last."""

    def __init__(
        self,
        strip: Strip,
        rules: Rulebook,
        goal: Goal | None,
        vehicle: VehicleParameters,
        path: PathConfig,
        speed: SpeedConfig,
        *,
        passes_left: bool,
        lap: Callable[[str], None],
        solver: str = DEFAULT,
    ) -> None:
        self.strip, self._rules = strip, rules
        self._appointment = Appointment(goal, strip.course, vehicle)
        self._vehicle, self._horizon = vehicle, speed.qp.horizon
        self._hard, self._margin = RESERVE * speed.qp.emergency.decel_mps2, speed.graph.vulnerable_margin_m
        self._path = PathStage(
            strip.course, vehicle, path, self._appointment,
            horizon=speed.qp.horizon, passes_left=passes_left, lap=lap, solver=solver,
        )  # fmt: skip
        self._speed = SpeedStage(vehicle, speed, lap, solver)
        self._last: tuple[float, float, float] | None = None  # x, y and station of the last start
        self._planned = -inf

    @property
    def places(self) -> tuple[float, ...]:
        """Stations at which lanes part or meet, somebody may have to wait, or others cross, m."""
        return (*self.strip.course.waits, *self._rules.places)

    def forget(self) -> None:
        """The next plan is as the first one: the frames before do not count any more."""
        self._planned = -inf

    def locate(self, start: EgoState, *, fresh: bool) -> tuple[float, float]:
        """Station and offset of a start; near the last one unless `fresh` or that is further away than `LOST_M`."""
        near = None
        if self._last is not None and not fresh and hypot(start.x - self._last[0], start.y - self._last[1]) < LOST_M:
            near = self._last[2]
        s, l = self.strip.course.line.project(start.x, start.y, near)  # noqa: E741
        self._last = start.x, start.y, s
        return s, l

    def plan(self, name: str, frame: Frame, start: EgoState, *, fresh: bool, past: Past | None = None) -> LanePlan:
        """Path and speed from `start`, with costs; `name` is "keep" for the lane that is driven."""
        s, l = self.locate(start, fresh=fresh)  # noqa: E741
        fresh = fresh or not 0.0 <= frame.t - self._planned <= FORGET_S
        self._planned = frame.t
        course = self.strip.course
        path = self._path.choose(frame, start, s, l, past.movers if past else NOBODY, fresh=fresh)
        speed, pace = None, self._appointment.pace(frame.t, s, start.v)
        if path.path is not None:
            limit = self._appointment.limit(path.path.s, np.interp(path.path.s, course.line.s, course.limit), pace)
            skip = behind(course, frame, s, l, self._vehicle, keeps_track=path.shift < TRACK_M and past is None)
            alone, found = limit, past.found if past else self._beside(frame, s, start.v)
            limit, told = beside_limit(path.path, limit, frame, found, self._vehicle, self._hard, self._margin)
            limit = swerve_limit(path.path, limit, course) if past else limit
            standing = path.passed - {box.agent for box in past.movers.boxes} if past else path.passed
            walls = walls_on(self._rules.stops(frame, start, s, standing, fresh=fresh), path.path, self._vehicle)
            speed = self._speed.choose(
                frame, start, path.path, limit, skip, standing, walls, fresh=fresh, hurried=pace.hurried, alone=alone
            )
            speed = replace(speed, artefacts=(*speed.artefacts, *told)) if told else speed
        return LanePlan(name, self.strip, s, l, path, speed, self._costs(name, start, s, speed, pace))

    def _beside(self, frame: Frame, s: float, v: float) -> tuple[Slower, ...]:
        """Those who go along the lane, where the ego would come beside them if it drove at the limit.

        That is when it comes beside them soonest, and what it needs to know: whom it will follow is not beside it.
        """
        course, t = self.strip.course, frame.predictions.t
        who = along_lane(course, frame, s, self._vehicle)
        if not who:
            return ()
        limit = float(np.interp(s, course.line.s, course.limit))
        return slower(course, frame, s, who, gone_on(t, s, v, limit), self._vehicle)

    def _costs(self, name: str, start: EgoState, s: float, speed: ChosenSpeed | None, pace: Pace) -> CostTerms:
        lost, braking = self._horizon, FAILED_S
        if speed is not None and speed.profile is not None:
            limit = float(np.interp(s, self.strip.course.line.s, self.strip.course.limit))
            lost = (speed.free_m - float(speed.profile[0, -1])) / max(limit, 1.0)
            braking = FAILED_S if speed.unavoidable else HARD_S if speed.reason else 0.0
        terms = {
            "time lost": lost,
            "lane changes": self._route_cost(s, start),
            "change": CHANGE_S if name in ("left", "right") else 0.0,
            "braking": braking,
            "late": pace.missed_s,
        }
        return CostTerms(f"lane {name}", tuple(terms.items()))

    def _route_cost(self, s: float, start: EgoState) -> float:
        if self.strip.changes is None:
            return DEAD_END_S
        if self.strip.changes == 0:
            return 0.0
        seconds = min((self.strip.change_by - s) / max(start.v, 5.0), self._appointment.time_left(start.t))
        left = seconds / (DUE_S * self.strip.changes)
        return self.strip.changes * (ROUTE_S + URGENCY_S * float(np.clip(1.0 - left, 0.0, 1.0)))
