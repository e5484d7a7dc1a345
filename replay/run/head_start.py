"""A head start for the first run on a machine: a second process compiles the kernels of planning.

While no machine code is on disk, the first log of a run is driven alone, so that kernels that all logs need are
compiled once. It begins with the reference drives and their metrics; meanwhile this plans over some built-in scenes.
"""

from __future__ import annotations

from contextlib import suppress

from logs.catalogue import scenario
from logs.errors import ReplanError
from replay.config import RunConfig
from replay.loop.open_loop import run_open_loop
from replay.parts import PLANNER
from replay.planner_process.planner_config import drive_keywords

SCENES = ("everyday/traffic_light", "everyday/cyclist", "paper/static_obstacles", "everyday/pull_outs")
"""Scenes in which most kernels of a plan are needed within `UNTIL_S`."""
UNTIL_S = 1.5


def compile_planning(run: RunConfig) -> None:
    """Plan the begin of each scene with the built-in planners of a run."""
    for name in SCENES:
        for planner in run.planners:
            if planner in PLANNER.causal:
                with suppress(ReplanError):  # the run itself says what is wrong
                    run_open_loop(
                        scenario(name), planner, planner_config=drive_keywords(planner, run), config=run.drive_loop,
                        until_s=UNTIL_S,
                    )  # fmt: skip
