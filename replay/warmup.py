"""Kernels compiled beforehand: a few built-in logs are driven, measured and recorded into a folder that is deleted."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

from logs.errors import OutputError
from logs.kernel import cache_folder, compiled_here
from replay.batch.checks import checked
from replay.batch.engine import Local
from replay.batch.log_result import Failure, LogResult
from replay.batch.resume import stamp_of
from replay.batch.sources import LogSource
from replay.config import RunConfig

SCENES = ("paper/crossing_pedestrian", "everyday/junction", "everyday/traffic_light")
"""Walkers and cars, lanes that join and cross, lights and stop lines: together nearly all that a drive may call."""


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


def warm_up(run: RunConfig) -> Warmed:
    """Compile what a run needs, in this process.

    Raises:
        ConfigError, PlannerError: As `replay.batch.evaluate_logs`.
        OutputError: There is no room for what the drives write.
    """
    begin = perf_counter()
    run, failures = checked(run)
    with TemporaryDirectory(prefix="replan-warmup-") as folder:
        sources = [LogSource(scene) for scene in SCENES]
        ended = [result for _, result in Local().evaluate(sources, run, Path(folder), stamp_of(run))]
    results = [result for result in ended if isinstance(result, LogResult)]
    for stopped in filter(None, (result.stopped for result in results)):
        raise OutputError(stopped)
    failed = (*failures, *(failure for result in results for failure in result.failures))
    return Warmed(perf_counter() - begin, compiled_here(), cache_folder(), failed)
