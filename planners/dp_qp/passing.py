"""The driven lane planned past those who are slower: path and speed found in turns (paper, section II-F, "nudge").

The plan that keeps the lane follows them. A second plan of the same lane passes them where `slower` says; it is taken
where it is worth it and endangers nobody (`decide`). Its first turn counts on the speed of a road without them, the
next on the speed that the turn before found, at most `TURNS` in one frame; later frames go on from the last one's plan.

The lanes beside may be borrowed on the passing side; whoever follows there must not have to brake (`decide`, (1) and
(2)), until the ego is over the marking and is seen.

Memory: the last plan past somebody, and whether it was driven; none of it where the frame is fresh.
"""

from __future__ import annotations

from math import inf

import numpy as np

from logs.frame import Frame
from logs.kernel import FloatArray
from logs.states import EgoState
from logs.vehicle import VehicleParameters
from planners.dp_qp.corridor import CorridorConfig
from planners.dp_qp.decide import borrowing_endangers
from planners.dp_qp.lane_plan import FORGET_S, LanePlan, LanePlanner, Past
from planners.dp_qp.reference_line import Course
from planners.dp_qp.slower import Slower, along_lane, gone_on, movers, slower
from planners.dp_qp.speed_qp import STEP_S

TURNS = 3
SETTLED_M = 1.0
"""Boxes that a further turn moves by less are left."""


class Passing:
    """Plans one lane past who is slower; owns a planner of that lane, since its stages remember their last solution."""

    def __init__(
        self, planner: LanePlanner, vehicle: VehicleParameters, config: CorridorConfig, *, passes_left: bool
    ) -> None:
        self._planner, self._vehicle, self._config, self._left = planner, vehicle, config, passes_left
        self.under_way = False
        self._last: tuple[float, FloatArray] | None = None  # when, and stations at the times of the predictions since

    def forget(self) -> None:
        """The next plan is as the first one."""
        self._planner.forget()
        self.under_way, self._last = False, None

    def plan(self, keep: LanePlan, frame: Frame, start: EgoState, *, fresh: bool) -> LanePlan | None:
        """The plan past those whom the plan that keeps the lane follows; None where there is nobody, or no room."""
        who = self._in_the_way(keep, frame)
        if not who:
            self.under_way, self._last = False, None
            return None
        course, t = keep.strip.course, frame.predictions.t
        sides = self._sides(course, keep, frame)
        stations = self._stations(course, keep, frame, start)
        found, plan = slower(course, frame, keep.s, who, stations, self._vehicle), None
        for turn in range(TURNS):
            told = movers(course, frame, keep.s, found, stations, sides, self._vehicle, self._config)
            if not told.boxes:
                break
            plan = self._planner.plan("pass", frame, start, fresh=fresh and not turn, past=Past(found, told))
            if plan.speed is None or plan.speed.profile is None or plan.path.path is None:
                break
            stations = _stations_of(plan, t)
            again = slower(course, frame, keep.s, who, stations, self._vehicle)
            settled, found = _same(found, again), again
            if settled:
                break
        self._last = (frame.t, stations) if plan is not None and found else None
        return plan

    def _in_the_way(self, keep: LanePlan, frame: Frame) -> list[int]:
        """All who go along the road, where there is somebody."""
        if keep.speed is None or not len(frame.predictions):
            return []
        return along_lane(keep.strip.course, frame, keep.s, self._vehicle)

    def _stations(self, course: Course, keep: LanePlan, frame: Frame, start: EgoState) -> FloatArray:
        """Where the ego will be at the times of the predictions, by the last plan, else on a road without them."""
        t = frame.predictions.t
        if self._last is not None and frame.t - self._last[0] <= FORGET_S:
            since, stations = self._last
            gone = np.interp(t - since, t - t[0], stations)
            over = np.maximum(t - since - (t[-1] - t[0]), 0.0)
            return gone + over * (stations[-1] - stations[-2]) / (t[-1] - t[-2])
        limit = float(np.interp(keep.s, course.line.s, course.limit))
        return gone_on(t, keep.s, start.v, limit)

    def _sides(self, course: Course, keep: LanePlan, frame: Frame) -> tuple[bool, bool]:
        """Whether the road left and right of the lane may be borrowed: on the passing side, and where nobody minds."""
        over = 0.5 * self._vehicle.width + abs(keep.l)
        left, right = (float(np.interp(keep.s, course.line.s, edge)) for edge in (course.lane_left, course.lane_right))
        seen = over > (left if keep.l > 0.0 else -right)
        free = seen or not borrowing_endangers(course, frame, keep.s, self._vehicle, left=self._left)
        return free and self._left, free and not self._left


def _stations_of(plan: LanePlan, t: FloatArray) -> FloatArray:
    """The stations on the reference line that a plan reaches at times `(k,)`."""
    path, speed = plan.path.path, plan.speed
    assert path is not None and speed is not None and speed.profile is not None
    sigma = np.interp(t - t[0], STEP_S * np.arange(speed.profile.shape[1]), speed.profile[0])
    return np.interp(sigma, path.sigma, path.s)


def _same(before: tuple[Slower, ...], after: tuple[Slower, ...]) -> bool:
    """Whether two turns pass the same people at nearly the same places."""
    if [one.agent for one in before] != [one.agent for one in after]:
        return False
    moved = [
        abs(a.box.s_from - b.box.s_from) + abs(a.box.s_to - b.box.s_to) for a, b in zip(before, after, strict=True)
    ]
    return max(moved, default=inf) < SETTLED_M
