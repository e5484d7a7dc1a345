"""Planners, metrics and readers that break one rule of `replan.contract` each, and are named for
it.
"""

import os
import sys
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Self
from zlib import crc32

import numpy as np
import pandas as pd

from replan.core.errors import LogError
from replan.logs.agents import Agents
from replan.logs.frame import Frame, PlannerContext
from replan.logs.plan import Plan, PlanStatus
from replan.logs.readers import LogSettings, Reader
from replan.logs.readers.base import LogContents
from replan.logs.readers.table import from_frames
from replan.logs.rules import Colour
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.trace import Mode, Trace
from replan.metrics.metric import Metric, Reduction, Series, Unavailable
from replan.metrics.reductions import MEAN
from replan.planners.constant_speed import ConstantSpeed, arc

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
        share = int.from_bytes(os.urandom(4), "big") / 2**32
        return Plan(arc(replace(frame.ego, kappa=2.5e-4 * share), frame.t + AHEAD))


class Memory(ConstantSpeed):
    def __init__(self, context: PlannerContext) -> None:
        super().__init__(context)
        self._frames = count()

    def plan(self, frame: Frame) -> Plan:
        return Plan(arc(replace(frame.ego, kappa=1e-6 * next(self._frames)), frame.t + AHEAD))


class RemembersAgents(ConstantSpeed):
    """Keeps the agents of the last 2 s, and bends its path by them."""

    def __init__(self, context: PlannerContext) -> None:
        super().__init__(context)
        self._agents: list[tuple[float, Agents]] = []

    def plan(self, frame: Frame) -> Plan:
        self._agents = [(t, agents) for t, agents in self._agents if t > frame.t - 2.0]
        moved = sum(float(agents.x.sum()) for _, agents in self._agents)
        self._agents.append((frame.t, frame.agents))
        return Plan(arc(replace(frame.ego, kappa=1e-8 * moved), frame.t + AHEAD))


class ReadsPast(ConstantSpeed):
    """Bends its path by all bits of its past; keeps nothing itself."""

    past_s = 2.1

    def plan(self, frame: Frame) -> Plan:
        past = frame.past
        columns = (past.t, past.x, past.y, past.yaw, past.vx, past.vy, past.length, past.seen)
        described = repr((past.ego, past.ids, past.kinds, past.lights)).encode()
        bits = crc32(described + b"".join(column.tobytes() for column in columns))
        return Plan(arc(replace(frame.ego, kappa=1e-5 * bits / 2**32), frame.t + AHEAD))


class ReadsPastOfMap(ReadsPast):
    coordinates = "map"


class ReadsPastUnasked(ReadsPast):
    past_s = 0.0


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


def _steps(trace: Trace, value: float = 1.0) -> Series:
    return Series(trace.ego.t, np.full(len(trace.ego), value))


def _open_only(trace: Trace, scenario: Scenario) -> Series:
    if trace.mode is Mode.OPEN:
        raise ValueError("no commands")
    return _steps(trace)


def _later(trace: Trace, scenario: Scenario) -> Series:
    return Series(trace.ego.t + 1.0, trace.ego.v)


def _writes(trace: Trace, scenario: Scenario) -> Series:
    object.__setattr__(scenario, "duration", 7.0)
    return _steps(trace)


_calls = count()
GOOD = Metric(
    "good",
    "m/s",
    "none",
    tuple(Mode),
    lambda trace, scenario: _steps(trace),
    (MEAN,),
    "For a test.",
)
METRICS = {
    "answer": replace(GOOD, measure=lambda trace, scenario: trace.ego.v),  # type: ignore[arg-type, return-value]
    "modes": replace(GOOD, measure=_open_only),
    "parts": replace(GOOD, measure=lambda trace, scenario: {"b": _steps(trace)}, parts=("a",)),
    "reason": replace(GOOD, measure=lambda trace, scenario: Unavailable(""), needs="luck"),
    "needs": replace(GOOD, measure=lambda trace, scenario: Unavailable("the log names no goal")),
    "times": replace(GOOD, measure=_later),
    "finite": replace(GOOD, reductions=(Reduction("inverse", lambda series: (float("inf"), -1)),)),
    "inputs": replace(GOOD, measure=_writes),
    "pure": replace(GOOD, measure=lambda trace, scenario: _steps(trace, float(next(_calls)))),
}
"""By the rule that they break."""


def _read(path: Path, settings: LogSettings) -> Scenario:
    try:
        rows = np.array([line.split() for line in path.read_text().splitlines()], float).reshape(
            -1, 4
        )
        return from_frames(pd.DataFrame(rows, columns=["t", "x", "y", "yaw"]), name=path.stem)
    except (ValueError, OSError) as error:
        raise LogError(str(error), file=path) from None


def _raises(path: Path) -> LogContents:
    raise ValueError("no topics")


def _jumps(path: Path, settings: LogSettings) -> Scenario:
    whole = _read(path, settings)
    return replace(whole, ego=replace(whole.ego, x=1e6 * whole.ego.x))


def _at_random(path: Path, settings: LogSettings) -> Scenario:
    return replace(_read(path, settings), name=str(next(_calls)))


def _crashes(path: Path, settings: LogSettings) -> Scenario:
    if not path.read_text():
        raise IndexError("list index out of range")
    return _read(path, settings)


def _writes_index(path: Path, settings: LogSettings) -> Scenario:
    path.with_suffix(".index").write_text("7")
    return _read(path, settings)


TXY = Reader(
    "txy", "t x y yaw, a line each", "*.txy", (".txy",), lambda path: path.suffix == ".txy", _read
)
READERS = {
    "claims": replace(TXY, claims=lambda path: True),
    "files": replace(TXY, files=lambda path: (path.with_suffix(".other"),)),
    "contents": replace(TXY, contents=_raises),
    "read": replace(TXY, read=lambda path, settings: _read(path, settings).ego),  # type: ignore[arg-type, return-value]
    "admitted": replace(TXY, read=_jumps),
    "same": replace(TXY, read=_at_random),
    "damaged": replace(TXY, read=_crashes),
    "beside": replace(TXY, read=_writes_index),
}
"""By the rule that they break."""
