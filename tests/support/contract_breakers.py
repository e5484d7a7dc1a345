"""Planners, metrics and readers that break one rule of `replay.contract` each, and are named for it."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from itertools import count
from typing import Self

import numpy as np

from logs import Frame, Plan, PlannerContext, PlanStatus, Scenario, Trajectory
from logs.rules import Colour
from planners.constant_speed import ConstantSpeed, arc

AHEAD = np.arange(0.0, 8.0, 0.1)


class Build(ConstantSpeed):
    def __init__(self, context: PlannerContext, weights: str) -> None:
        super().__init__(context)


class Answer(ConstantSpeed):
    def plan(self, frame: Frame) -> Plan:
        return None  # type: ignore[return-value]


class Time(ConstantSpeed):
    def plan(self, frame: Frame) -> Plan:
        return Plan(arc(frame.ego, frame.t + 0.1 + AHEAD))


class Start(ConstantSpeed):
    def plan(self, frame: Frame) -> Plan:
        return Plan(arc(replace(frame.ego, x=frame.ego.x + 0.1), frame.t + AHEAD))


class Horizon(ConstantSpeed):
    def plan(self, frame: Frame) -> Plan:
        return Plan(arc(frame.ego, frame.t + AHEAD[:20]))


class Reason(ConstantSpeed):
    def plan(self, frame: Frame) -> Plan:
        return replace(super().plan(frame), status=PlanStatus.HARD_STOP)


class Columns(ConstantSpeed):
    def plan(self, frame: Frame) -> Plan:
        way = super().plan(frame).trajectory
        return Plan(replace(way, yaw=way.yaw + 0.5))


class Drivable(ConstantSpeed):
    """Accelerates with 3 g."""

    def plan(self, frame: Frame) -> Plan:
        ego, zero = frame.ego, np.zeros(len(AHEAD))
        v, s = ego.v + 30.0 * AHEAD, ego.v * AHEAD + 15.0 * AHEAD**2
        x, y = ego.x + s * np.cos(ego.yaw), ego.y + s * np.sin(ego.yaw)
        return Plan(Trajectory(frame.t + AHEAD, x, y, zero + ego.yaw, v, zero + 30.0, zero))


class Writes(ConstantSpeed):
    def plan(self, frame: Frame) -> Plan:
        frame.lights[7] = Colour.RED  # type: ignore[index]
        return super().plan(frame)


class Deterministic(ConstantSpeed):
    def plan(self, frame: Frame) -> Plan:
        return Plan(arc(replace(frame.ego, kappa=1e-6 * os.urandom(1)[0]), frame.t + AHEAD))


class Memory(ConstantSpeed):
    def __init__(self, context: PlannerContext) -> None:
        super().__init__(context)
        self._frames = count()

    def plan(self, frame: Frame) -> Plan:
        return Plan(arc(replace(frame.ego, kappa=1e-6 * next(self._frames)), frame.t + AHEAD))


class Future(ConstantSpeed):
    """Finds the log in the frames of Python."""

    def plan(self, frame: Frame) -> Plan:
        at, log = sys._getframe(), None
        while at is not None and not isinstance(log, Scenario):
            log, at = at.f_locals.get("scenario"), at.f_back  # type: ignore[assignment]
        later = float(log.tracks.t[-1]) if isinstance(log, Scenario) and len(log.tracks) else 0.0
        return Plan(arc(replace(frame.ego, kappa=1e-6 * later), frame.t + AHEAD))


class Batch(ConstantSpeed):
    @classmethod
    def plan_batch(cls, frames: list[Frame], planners: list[Self]) -> list[Plan]:
        return [planner.plan(frame) for planner, frame in zip(planners, frames, strict=True)][:1]


PLANNERS = {
    "build": Build,
    "answer": Answer,
    "time": Time,
    "start": Start,
    "horizon": Horizon,
    "reason": Reason,
    "columns": Columns,
    "drivable": Drivable,
    "frame": Writes,
    "deterministic": Deterministic,
    "memory": Memory,
    "future": Future,
    "batch": Batch,
}
"""By the rule that they break."""
