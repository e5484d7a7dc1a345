"""`replan warmup` compiles kernels: it drives, measures and records built-in logs in a folder that
is then deleted.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

from replan.config import RunConfig
from replan.core.errors import OutputError
from replan.core.kernel import cache_folder, compiled_count
from replan.replay.parts import OF_LOOP, PLANNER
from replan.results.log_result import Failure, LogResult
from replan.run.checks import checked
from replan.run.evaluate import Local
from replan.run.log_source import LogSource
from replan.run.resume import stamp_of

SCENES = (
    "paper/crossing_pedestrian",
    "paper/static_obstacles",
    "everyday/cyclist",
    "everyday/crosswalk",
    "everyday/traffic_light",
    "everyday/junction",
    "everyday/pull_outs",
    "raw/crossing",
)
"""Scenes with walkers, cyclists, cars that pull out, obstacles, junctions, lights, raw detections:
as in the suite.
"""
OF_A_CHOICE = ("everyday/traffic_light", "everyday/junction", "raw/crossing")
"""Scenes that need all kernels of one choice beside the default: a stop, others from the side, raw
detections.
"""


@dataclass(frozen=True)
class Warmed:
    """The result of a warm-up."""

    seconds: float  # Its duration, s
    compiled: int  # The number of compiled kernels; the others were in the cache
    folder: Path | None  # The folder of their machine code; None if it is not kept
    failures: tuple[Failure, ...]  # Drives that failed


ELSEWHERE = ("multibody", "recorded")
"""Choices that are left out: the first has no kernels and an optional package; "auto" uses the
second for raw logs.
"""


def everything() -> Iterator[tuple[RunConfig, Sequence[str]]]:
    """Runs, and their scenes, that need all built-in kernels: of all planners, and of each other
    choice in turn.
    """
    yield RunConfig(planners=PLANNER.causal), SCENES
    apart = RunConfig(mode="closed", recording=False, internals="none")
    yield replace(apart, planner={"dp_qp": {"solver": "osqp"}}), OF_A_CHOICE
    for key, kind in OF_LOOP.items():
        for name in kind.causal:
            if name not in (getattr(apart.loop, key), *ELSEWHERE):
                instead: dict[str, Any] = {key: name}
                yield replace(apart, loop=replace(apart.loop, **instead)), OF_A_CHOICE


def warm_up(runs: Iterable[tuple[RunConfig, Sequence[str]]]) -> Warmed:
    """Compile the kernels that runs need on built-in logs, in this process.

    ConfigError and PlannerError as `replan.run.evaluate_logs`; OutputError if the disk is too full
    for the files of the drives.
    """
    begin = perf_counter()
    failures: list[Failure] = []
    for named, scenes in runs:
        run, refused = checked(named)
        failures += refused
        with TemporaryDirectory(prefix="replan-warmup-") as folder:
            sources = [LogSource(scene) for scene in scenes]
            ended = [
                result for _, result in Local().evaluate(sources, run, Path(folder), stamp_of(run))
            ]
        results = [result for result in ended if isinstance(result, LogResult)]
        for stopped in filter(None, (result.stopped for result in results)):
            raise OutputError(stopped)
        failures += [failure for result in results for failure in result.failures]
    return Warmed(perf_counter() - begin, compiled_count(), cache_folder(), tuple(failures))
