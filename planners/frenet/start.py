"""Where a plan begins: on the previous plan where the ego keeps to it, else at the ego."""

from __future__ import annotations

from math import hypot

from logs.frame import Frame, PlannerContext
from logs.route import find_route
from logs.states import EgoState
from logs.trace import PlanStart
from logs.vehicle import VehicleParameters
from planners.frenet.reference_path import ReferencePath, make_reference_path
from planners.frenet.scene import Scene, scene_of

STITCH_M = 0.5
"""A plan starts on the previous one where the ego is nearer to it than this, m ..."""
STITCH_MPS = 1.0
"""... and its speed nearer than this, m/s."""


def start_of(frame: Frame, stitch_m: float = STITCH_M, stitch_mps: float = STITCH_MPS) -> tuple[EgoState, PlanStart]:
    """Where the plan of a frame begins."""
    if frame.previous is not None:
        old = frame.previous.trajectory.at(frame.t)
        near = hypot(old.x - frame.ego.x, old.y - frame.ego.y) <= stitch_m
        if near and abs(old.v - frame.ego.v) <= stitch_mps:
            return old, PlanStart.PREVIOUS_PLAN
    return frame.ego, PlanStart.EGO


class RouteTracker:
    """The reference path of one scenario's route, and the last station on it, from which the next search starts."""

    def __init__(self, context: PlannerContext) -> None:
        self._vehicle: VehicleParameters = context.vehicle
        self.reference: ReferencePath = make_reference_path(
            context.road, find_route(context.road, context.start, context.goal), context.start
        )
        self._station: float | None = None

    def scene(self, frame: Frame) -> tuple[Scene, PlanStart]:
        """The scene of a frame along the route, and where its plan begins."""
        start, kind = start_of(frame)
        near = None if frame.previous is None else self._station
        scene = scene_of(frame, start, self.reference, self._vehicle, near)
        self._station = scene.s
        return scene, kind
