"""A planner that plans its batches one by one, and writes down their sizes.

Tests subclass it in a file of their own; `written` makes that file in the working folder.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import dedent, indent
from typing import Any

from replan.logs.frame import Frame, PlannerContext
from replan.logs.plan import Plan
from replan.planners.constant_speed import ConstantSpeed

Answers = list[Any]


class Batched(ConstantSpeed):
    """Counts its plans; `built` and `answered` are for subclasses to fail in."""

    def __init__(self, context: PlannerContext) -> None:
        super().__init__(context)
        self.count = 0
        self.built(context)

    def built(self, context: PlannerContext) -> None:
        """Called for each drive, before its first plan."""

    @classmethod
    def answered(cls, frames: Sequence[Frame], answers: Answers) -> Answers:
        """The answers to a batch; `answers`: those of frames planned one by one."""
        return answers

    def plan(self, frame: Frame) -> Plan:
        """Plan one frame."""
        self.count += 1
        return super().plan(frame)

    @classmethod
    def plan_batch(cls, frames: Sequence[Frame], planners: Sequence[Batched]) -> Answers:
        """Plan a batch; all drives of it have made as many steps."""
        (count,) = {planner.count for planner in planners}
        with Path(f"sizes.{cls.__module__}").open("a", encoding="utf-8") as file:
            file.write(f"{len(frames)} {count}\n")
        plans = [planner.plan(frame) for planner, frame in zip(planners, frames, strict=True)]
        return cls.answered(frames, plans)


def written(name: str, hook: str = "") -> str:
    """The planner `name`:Mine in the working folder; `hook` is a method of it, as text."""
    body = indent(dedent(hook), "    ") or "    pass\n"
    source = f"import os\n\nfrom batched import Batched\n\n\nclass Mine(Batched):\n{body}"
    Path(f"{name}.py").write_text(source, encoding="utf-8")
    return f"{name}:Mine"


def sizes(name: str) -> list[tuple[int, int]]:
    """Frames of each batch, and how many plans were made before."""
    lines = Path(f"sizes.{name}").read_text(encoding="utf-8").splitlines()
    return [(int(frames), int(step)) for frames, step in map(str.split, lines)]
