"""Planners with way points of their own, in the coordinates of the log: along x, at y = 300."""

import numpy as np

from replan.logs.frame import Frame, PlannerContext
from replan.logs.plan import Plan
from replan.planners.constant_speed import arc
from replan.planners.idm import Idm

WAY = np.column_stack([np.arange(450.0, 900.0, 0.5), np.full(900, 300.0)])


class Forgets:
    """Takes the frame for one in the map's coordinates."""

    def __init__(self, context: PlannerContext) -> None:
        self.way = WAY

    def plan(self, frame: Frame) -> Plan:
        ego = frame.ego
        nearest = self.way[np.argmin(np.hypot(*(self.way - (ego.x, ego.y)).T))]
        x = nearest[0] + np.clip(ego.x - nearest[0], -0.5, 0.5)
        start = type(ego)(frame.t, float(x), float(nearest[1]), 0.0, ego.v)
        return Plan(arc(start, frame.t + np.linspace(0.0, 4.0, 41)))


class Subtracts(Forgets):
    """Converts its way points once."""

    def __init__(self, context: PlannerContext) -> None:
        self.way = WAY - context.origin


class Declares(Forgets):
    """Plans in the map's coordinates."""

    coordinates = "map"


class DeclaresAndSubtracts(Subtracts):
    """Does both, which is the same."""

    coordinates = "map"


class Unknown(Forgets):
    """Declares what does not exist."""

    coordinates = "utm"


class IdmInMap(Idm):
    """Sees and plans all in the map's coordinates."""

    coordinates = "map"

    @staticmethod
    def plan_batch(frames: list[Frame], planners: list[Idm]) -> list[Plan]:
        return [planner.plan(frame) for planner, frame in zip(planners, frames, strict=True)]
