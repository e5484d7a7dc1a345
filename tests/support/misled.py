"""Planners that plan with dp_qp or idm from another input than the frame that they got."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from replan.core.arrays import BoolArray
from replan.logs.frame import Frame, PlannerContext
from replan.logs.plan import Plan
from replan.logs.rules import Colour
from replan.planners.dp_qp import DpQp


class Misled:
    """Plans as dp_qp; `mislead` changes the frame."""

    def __init__(self, context: PlannerContext) -> None:
        self._planner, self.frames = DpQp(context), list[Frame]()

    def plan(self, frame: Frame) -> Plan:
        self.frames = [] if frame.previous is None else self.frames
        self.frames.append(frame)
        return self._planner.plan(self.mislead(frame))

    def mislead(self, frame: Frame) -> Frame:
        return frame


class Stale(Misled):
    """Agents and predictions of 8 frames ago."""

    def mislead(self, frame: Frame) -> Frame:
        old = self.frames[max(len(self.frames) - 9, 0)]
        futures = replace(old.predictions, t=old.predictions.t - old.t + frame.t)
        return replace(frame, agents=old.agents, predictions=futures)


class Aside(Misled):
    """Agents 1.2 m to the right of where they are, for the ego."""

    def mislead(self, frame: Frame) -> Frame:
        dx, dy = 1.2 * np.sin(frame.ego.yaw), -1.2 * np.cos(frame.ego.yaw)
        agents, futures = frame.agents, frame.predictions
        return replace(
            frame,
            agents=replace(agents, x=agents.x + dx, y=agents.y + dy),
            predictions=replace(futures, x=futures.x + dx, y=futures.y + dy),
        )


class Sluggish(Misled):
    """Predictions at 0.4 of their displacements."""

    def mislead(self, frame: Frame) -> Frame:
        futures = frame.predictions
        x, y = (column[:, :1] + 0.4 * (column - column[:, :1]) for column in (futures.x, futures.y))
        return replace(frame, predictions=replace(futures, x=x, y=y))


class Unseeing(Misled):
    """No agents."""

    def mislead(self, frame: Frame) -> Frame:
        nobody: BoolArray = np.zeros(len(frame.predictions.agent), np.bool_)
        rows = {name: getattr(frame.predictions, name)[nobody] for name in PER_AGENT}
        agents = frame.agents.some(np.empty(0, np.int64))
        return replace(frame, agents=agents, predictions=replace(frame.predictions, **rows))


PER_AGENT = ("agent", "probability", "x", "y", "yaw")


class Braking(Misled):
    """The ego at 0.7 of its speed, without the previous plan."""

    def mislead(self, frame: Frame) -> Frame:
        return replace(frame, ego=replace(frame.ego, v=0.7 * frame.ego.v), previous=None)


class AllGreen(Misled):
    """Green lights."""

    def mislead(self, frame: Frame) -> Frame:
        lights: Mapping[int, Colour] = dict.fromkeys(frame.lights, Colour.GREEN)
        return replace(frame, lights=lights)
