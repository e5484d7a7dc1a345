"""Kernels compiled beforehand: a few built-in logs are driven, measured and recorded into a folder that is deleted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

from logs.errors import OutputError
from logs.kernel import cache_folder, compiled_count
from planners import PLANNERS
from replay.config import RunConfig
from replay.results.log_result import Failure, LogResult
from replay.run.checks import KINDS, checked
from replay.run.engine import Local
from replay.run.resume import stamp_of
from replay.run.sources import LogSource

SCENES = (
    "paper/crossing_pedestrian",
    "paper/static_obstacles",
    "everyday/cyclist",
    "everyday/crosswalk",
    "everyday/traffic_light",
    "everyday/junction",
    "raw/crossing",
)
"""Walkers, cyclists, cars, standing obstacles, junctions, lights, raw detections: what the built-in suite calls."""


@dataclass(frozen=True)
class Warmed:
    """What was compiled.

    Attributes:
        seconds: How long it took.
        compiled: How many kernels were compiled; the others were there.
        folder: Where their machine code is; None: it is not kept.
        failures: What could not be driven.
    """

    seconds: float
    compiled: int
    folder: Path | None
    failures: tuple[Failure, ...]


ELSEWHERE = ("multibody", "recorded")
"""The first has no kernels and needs a package that may not be there; the second is what "auto" takes for raw logs."""


def everything() -> Iterator[RunConfig]:
    """Runs that need the kernels of all that is built in: of all planners, and of each other choice in its turn."""
    yield RunConfig(planners=tuple(PLANNERS))
    apart = RunConfig(mode="closed", recording=False, internals="none")
    yield replace(apart, planner={"dp_qp": {"solver": "osqp"}})
    for key, (kind, _) in KINDS.items():
        for name in kind.builtin:
            if name not in (getattr(apart.loop, key), *ELSEWHERE):
                instead: dict[str, Any] = {key: name}
                yield replace(apart, loop=replace(apart.loop, **instead))


def warm_up(*runs: RunConfig) -> Warmed:
    """Compile what runs need, in this process.

    Raises:
        ConfigError, PlannerError: As `replay.run.evaluate_logs`.
        OutputError: There is no room for what the drives write.
    """
    begin = perf_counter()
    failures: list[Failure] = []
    for run in runs:
        run, refused = checked(run)
        failures += refused
        with TemporaryDirectory(prefix="replan-warmup-") as folder:
            sources = [LogSource(scene) for scene in SCENES]
            ended = [result for _, result in Local().evaluate(sources, run, Path(folder), stamp_of(run))]
        results = [result for result in ended if isinstance(result, LogResult)]
        for stopped in filter(None, (result.stopped for result in results)):
            raise OutputError(stopped)
        failures += [failure for result in results for failure in result.failures]
    return Warmed(perf_counter() - begin, compiled_count(), cache_folder(), tuple(failures))
