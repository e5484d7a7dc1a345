"""What the baselines share: where a plan starts, the course and the place on it, and what a recording shows of them."""

from __future__ import annotations

from math import hypot

from logs.frame import Frame, PlannerContext
from logs.route import find_route
from logs.states import EgoState
from logs.trace import PlanStart
from planners.frenet.path import out_of_frame
from planners.frenet.reference_path import ReferencePath, make_reference_path

STITCH_M, STITCH_MPS = 0.5, 1.0
"""A plan starts on the previous one where the ego is nearer to it than this, and its speed too."""


def start_of(frame: Frame) -> tuple[EgoState, PlanStart]:
    """Where the plan begins: on the previous plan where the ego keeps to it, else at the ego."""
    if frame.previous is not None:
        old = frame.previous.trajectory.at(frame.t)
        near = hypot(old.x - frame.ego.x, old.y - frame.ego.y) <= STITCH_M
        if near and abs(old.v - frame.ego.v) <= STITCH_MPS:
            return old, PlanStart.PREVIOUS_PLAN
    return frame.ego, PlanStart.EGO


class Tracker:
    """The course of one scenario, and the ego's last station on it, from which the next projection starts."""

    def __init__(self, context: PlannerContext) -> None:
        self.course: ReferencePath = make_reference_path(
            context.road, find_route(context.road, context.start, context.goal), context.start
        )
        self._station: float | None = None

    def begin(self, frame: Frame) -> tuple[EgoState, PlanStart, float, float, str]:
        """Where the plan begins, its station and offset, and why none is possible from there; empty where one is."""
        start, kind = start_of(frame)
        s, l = self.locate(start, fresh=frame.previous is None)  # noqa: E741
        return start, kind, s, l, out_of_frame(self.course.line, start, s, l)

    def locate(self, state: EgoState, *, fresh: bool) -> tuple[float, float]:
        """Station and offset (s, l) of a state; `fresh` forgets the last station."""
        s, l = self.course.line.project(state.x, state.y, None if fresh else self._station)  # noqa: E741
        self._station = s
        return s, l
