"""One planning frame as a file: the input of the planner since the start of its drive, its plan, and its QPs.

A dump is one MessagePack map with the fields of `File`. Context, frames and plan are the messages of
`replay.planner_process.messages` (docs/planners_apart.md): little-endian float64 columns, so that values are read back
to the bit. A planner has memory, so a dump contains all frames up to the one of interest; in open loop, where each
frame starts with fresh memory, it contains only that one.

    dump = load(Path("frame.msgpack"))
    dump.frame.agents.ids, dump.problems[0].lower
    assert (dump.planned().trajectory.x == dump.plan.trajectory.x).all()
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from logs.codec import WIRE, packed
from logs.errors import LogError
from logs.frame import Frame, PlannerContext
from logs.plan import Plan, SolverReport
from planners.piecewise_jerk.problem import PiecewiseJerkProblem, Weights
from planners.piecewise_jerk.solvers import SolvedProblem
from planners.solver import QPResult
from replay.loop.plan_check import checked
from replay.planner_process import messages
from replay.planner_process.planner_config import planner_part
from replay.results.tables import write_file

VERSION = 1


class DumpedProblem(msgspec.Struct):
    """`planners.piecewise_jerk.problem.PiecewiseJerkProblem`, and the curve x, x', x'' `(3 n,)` that solves it."""

    report: SolverReport  # The solver's report; its stage names the caller
    numbers: list[float]  # step, soft, and the weights x, dx, ddx, dddx
    leads: bytes  # `(k,)`
    start: bytes  # `(3,)`
    references: bytes  # `(2, n)` row by row
    lower: bytes  # `(4 + k, n)` row by row; `upper` likewise
    upper: bytes
    x: bytes


class File(msgspec.Struct):
    """The contents of the file."""

    version: int
    log: str  # Name; `planner` and `config` (its table) are as in a run's configuration
    planner: str
    config: dict[str, Any]
    context: messages.Context  # The context with which the planner was built
    frames: list[messages.Frame]  # The frames in order of time; the last is the one of interest
    plan: messages.Plan  # The plan of the last frame, with its internals
    problems: list[DumpedProblem]  # The QPs that were solved for it, in their order


@dataclass(frozen=True, eq=False)
class FrameDump:
    """A dump as objects, with the attributes of `File`; the clock of the context measures nothing."""

    log: str
    planner: str
    config: Mapping[str, Any]
    context: PlannerContext
    frames: tuple[Frame, ...]
    plan: Plan
    problems: tuple[SolvedProblem, ...]

    @property
    def frame(self) -> Frame:
        """The frame of interest: the last one."""
        return self.frames[-1]

    def planned(self) -> Plan:
        """The plan made anew in this process, by a planner that gets all frames; its errors are not caught."""
        planner = planner_part(self.planner, self.config).build(self.context)
        for frame in self.frames[:-1]:
            planner.plan(frame)
        return checked(planner.plan(self.frame), self.frame).recorded(keep=True)


def dump(path: Path, one: FrameDump) -> None:
    """Write a dump; OutputError if the file cannot be written."""
    problems = []
    for problem, result in one.problems:
        arrays = {name: packed(getattr(problem, name)) for name in ("leads", "start", "references", "lower", "upper")}
        numbers = [problem.step, problem.soft, *problem.weights]
        problems.append(DumpedProblem(report=result.report, numbers=numbers, x=packed(result.x), **arrays))
    file = File(
        version=VERSION,
        log=one.log,
        planner=one.planner,
        config=dict(one.config),
        context=messages.context_message(one.context),
        frames=[messages.frame_message(frame) for frame in one.frames],
        plan=messages.plan_message(one.plan, inside=True),
        problems=problems,
    )
    data = messages.encode(file)
    write_file(path, lambda partial: partial.write_bytes(data))


def load(path: Path) -> FrameDump:
    """Read a dump; LogError if the file is damaged, or is not a dump."""
    try:
        file: File = messages.decode(path.read_bytes(), File)
        if file.version != VERSION:
            raise ValueError(f"a dump of version {file.version}, this replan reads {VERSION}")
        return FrameDump(
            log=file.log,
            planner=file.planner,
            config=file.config,
            context=messages.context_of(file.context, lambda stage: None),
            frames=tuple(map(messages.frame_of, file.frames)),
            plan=messages.plan_of(file.plan),
            problems=tuple(map(_problem_of, file.problems)),
        )
    except (OSError, ValueError, KeyError, msgspec.MsgspecError) as error:
        raise LogError(f"is not a dump of a frame: {error}", file=path) from None


def _problem_of(message: DumpedProblem) -> SolvedProblem:
    step, soft, *weights = message.numbers
    columns = (message.leads, message.start, message.references, message.lower, message.upper, message.x)
    leads, start, references, lower, upper, x = (np.frombuffer(column, WIRE).copy() for column in columns)
    problem = PiecewiseJerkProblem(
        step=step,
        leads=leads,
        start=start,
        weights=Weights(*weights),
        references=references.reshape(2, -1),
        lower=lower.reshape(4 + len(leads), -1),
        upper=upper.reshape(4 + len(leads), -1),
        soft=soft,
    )
    return SolvedProblem(problem, QPResult(x, message.report))
