"""The driven lane planned past those who are slower: path and speed found in turns (paper, section II-F, "nudge").

The plan that keeps the lane follows them. A second plan of the same lane passes them where `slower` says; it is taken
where it is worth it and endangers nobody (`decide`). Its first turn counts on the speed of a road without them, the
next on the speed that the turn before found, at most `TURNS` in one frame; later frames go on from the last one's plan.
It is a plan only if, by its own speed, it gets past the nearest of them within the predictions.

The lane beside may be borrowed on the passing side; whoever follows there must not have to brake (`decide`, (1) and
(2)), until the ego is over the marking and is seen.

Memory: the last plan past somebody, whom the ego is passing, and whom it gave up to pass (he is not tried again for
`DWELL_S`); none of it where the frame is fresh.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf

import numpy as np

from logs.frame import Frame
from logs.kernel import FloatArray
from logs.states import EgoState
from logs.trace import Artefact, Candidates
from logs.vehicle import VehicleParameters
from planners.dp_qp.lane.choice import DWELL_S, HYSTERESIS_S, borrowing_endangers, worth_passing
from planners.dp_qp.lane.plan import FORGET_S, LanePlan, LanePlanner, Past
from planners.dp_qp.path.bounds import CorridorConfig
from planners.dp_qp.scene.moving_obstacles import PassTarget, along_lane, gone_on, movers, slower
from planners.frenet.profiles import STEP_S
from planners.frenet.reference_path import ReferencePath

TURNS = 3
SETTLED_M = 1.0
"""Boxes that a further turn moves by less are left."""

NO_PLAN = None, frozenset[str](), None


class Passing:
    """Plans one lane past who is slower.

    Args:
        planner: Makes a planner of that lane when there first is somebody; not the one that keeps the lane, since
            their stages remember their last solutions.
        vehicle: The ego.
        config: Distances.
        passes_left: The passing side.
    """

    def __init__(
        self, planner: Callable[[], LanePlanner], vehicle: VehicleParameters, config: CorridorConfig, *,
        passes_left: bool,
    ) -> None:  # fmt: skip
        self._make, self._vehicle, self._config, self._left = planner, vehicle, config, passes_left
        self._planner: LanePlanner | None = None
        self.forget()

    def forget(self) -> None:
        """The next plan is as the first one."""
        if self._planner is not None:
            self._planner.forget()
        self._passed: frozenset[str] = frozenset()
        self._given_up: dict[str, float] = {}  # who was not passed in the end, when
        self._at = -inf
        self._stations: FloatArray | None = None  # of the last plan, at the times of the predictions since `_at`

    def choose(
        self, keep: LanePlan, frame: Frame, start: EgoState, *, fresh: bool
    ) -> tuple[LanePlan, tuple[Artefact, ...]]:
        """The plan in the lane, past who is slower where that is worth it, else `keep`; and what was considered."""
        if fresh or not 0.0 <= frame.t - self._at <= FORGET_S:
            self.forget()
        if not self._passed and keep.time_lost + keep.braking < HYSTERESIS_S:
            return keep, ()
        who = along_lane(keep.strip.course, frame, keep.s, self._vehicle, self._passed)
        past, names, stations = self._plan(keep, frame, start, who) if who else NO_PLAN
        self._at, self._stations = frame.t, stations
        against = worth_passing(keep, past, under_way=bool(names & self._passed)) if past is not None else "no plan"
        if not names & self._passed and any(frame.t - self._given_up.get(name, -inf) < DWELL_S for name in names):
            against = "given up a moment ago"
        going = frozenset() if against else names
        self._given_up |= {frame.agents.ids[i]: frame.t for i in who if frame.agents.ids[i] in self._passed - going}
        self._passed = going
        if past is None:
            return keep, ()
        rejected = f"pass: {against}" if against else f"keep: costs {keep.cost:.1f} s, pass {past.cost:.1f} s"
        told = (keep.costs, past.costs, Candidates("passing", 2, ((rejected, 1),)))
        return keep if against else past, told

    def _plan(
        self, keep: LanePlan, frame: Frame, start: EgoState, who: list[int]
    ) -> tuple[LanePlan | None, frozenset[str], FloatArray | None]:
        """The plan past the nearest, all whom it passes, and its stations; None where there is no such plan."""
        planner = self._planner = self._planner or self._make()
        course, t = keep.strip.course, frame.predictions.t
        sides, stations = self._sides(course, keep, frame), self._expected(course, keep, frame, start)
        found = slower(course, frame, keep.s, who, stations, self._vehicle, self._passed)
        for turn in range(TURNS):
            told = movers(
                course, frame, keep.s, found, stations, sides, self._vehicle, self._config, planner.places,
                self._passed,
            )  # fmt: skip
            if not told.boxes:
                return NO_PLAN
            # not fresh: `forget` has told the planner where this is its first plan, and later turns go on from it
            plan = planner.plan("pass", frame, start, fresh=False, past=Past(found, told))
            if plan.speed is None or plan.speed.profile is None or plan.path.path is None:
                return NO_PLAN
            stations = _stations_of(plan, t)
            before, found = found, slower(course, frame, keep.s, who, stations, self._vehicle, self._passed)
            if turn + 1 == TURNS or _same(before, found):
                break
        names = frozenset(box.agent for box in told.boxes) & plan.path.passed & {one.box.agent for one in found}
        return (plan, names, stations) if told.boxes[0].agent in names else NO_PLAN

    def _expected(self, course: ReferencePath, keep: LanePlan, frame: Frame, start: EgoState) -> FloatArray:
        """Where the ego will be at the times of the predictions, by the last plan, else on a road without them."""
        t = frame.predictions.t
        if self._stations is None or len(self._stations) != len(t):
            limit = float(np.interp(keep.s, course.line.s, course.limit))
            return gone_on(t, keep.s, start.v, limit)
        return _carried_on(t - t[0], self._stations, t - self._at)

    def _sides(self, course: ReferencePath, keep: LanePlan, frame: Frame) -> tuple[bool, bool]:
        """Whether the road left and right of the lane may be borrowed: on the passing side, and where nobody minds."""
        left, right = (float(np.interp(keep.s, course.line.s, edge)) for edge in (course.lane_left, course.lane_right))
        aside, edge = (keep.l, left) if self._left else (-keep.l, -right)
        seen = aside + 0.5 * self._vehicle.width > edge
        free = seen or not borrowing_endangers(course, frame, keep.s, self._vehicle, left=self._left)
        return free and self._left, free and not self._left


def _stations_of(plan: LanePlan, t: FloatArray) -> FloatArray:
    """The stations on the reference line that a plan reaches at times `(k,)`; after its end it keeps its speed."""
    path, speed = plan.path.path, plan.speed
    assert path is not None and speed is not None and speed.profile is not None
    sigma = speed.profile[0]
    stations = np.interp(sigma, path.sigma, path.s)
    return _carried_on(STEP_S * np.arange(len(sigma)), stations, t - t[0])


def _carried_on(known: FloatArray, stations: FloatArray, t: FloatArray) -> FloatArray:
    """Stations `(n,)` of `known` times at other times `(k,)`; after the last with the last speed."""
    speed = (stations[-1] - stations[-2]) / (known[-1] - known[-2])
    return np.asarray(np.interp(t, known, stations) + speed * np.maximum(t - known[-1], 0.0))


def _same(before: tuple[PassTarget, ...], after: tuple[PassTarget, ...]) -> bool:
    """Whether two turns pass the same people at nearly the same places."""
    if [one.agent for one in before] != [one.agent for one in after]:
        return False
    pairs = [(a.box, b.box) for a, b in zip(before, after, strict=True)]
    return max((abs(a.s_from - b.s_from) + abs(a.s_to - b.s_to) for a, b in pairs), default=inf) < SETTLED_M
