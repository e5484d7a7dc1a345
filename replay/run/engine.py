"""Engines drive the logs of a run: in this process, in processes of this machine, or on a Ray cluster. Same bytes.

An engine applies a function to items and yields the result of each as it ends, in any order; if a worker dies, the
result of its item is `WorkerLost`, and no other item is affected. The function writes a log's folder into the result
folder if the workers share that with the driver (`Local`); otherwise its result contains the folder
(`replay.run.on_ray`).

Items are started by their expected duration, the longest first (Graham, SIAM J. Appl. Math. 17, 1969: within
4/3 - 1/(3 m) of the shortest makespan on m workers), so that no long log begins last. An item is a log, or the logs
that are driven in lock step.

While no machine code is on disk, the first log of a run is driven alone, so that kernels that all logs need are
compiled once. It begins with the reference drives and their metrics; meanwhile a second process plans over some
built-in scenes (`compile_planning`). `replan warmup` compiles kernels beforehand: it drives, measures and records a few
built-in logs in a folder that is then deleted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import accumulate
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any, Protocol, TypeVar
from uuid import uuid4

from logs.catalogue import scenario
from logs.errors import OutputError, ReplanError
from logs.kernel_watch import cache_folder, compiled_count, is_cache_cold
from replay.config import RunConfig
from replay.loop.open_loop import run_open_loop
from replay.parts import OF_LOOP, PLANNER
from replay.planner_process.batch import in_lockstep
from replay.planner_process.planner_config import drive_keywords
from replay.planner_process.processes import set_template_run
from replay.results.log_result import Failure, LogResult, Stamp
from replay.run.checks import checked
from replay.run.one_log import evaluate_log
from replay.run.pool import WorkerLost, run_all
from replay.run.resume import stamp_of
from replay.run.sources import LogSource

T = TypeVar("T")
R = TypeVar("R")


class Engine(Protocol):
    """Evaluates logs into a result folder."""

    def evaluate(
        self, sources: Sequence[LogSource], run: RunConfig, out: Path, stamp: Stamp
    ) -> Iterator[tuple[int, LogResult | WorkerLost]]:
        """Yield the result of each source, by index, as it ends; its folder is in `out` by then."""
        ...


@dataclass(frozen=True)
class Local:
    """This machine."""

    workers: int = 0  # Number of child processes; 0: this process, in the order given

    def evaluate(
        self, sources: Sequence[LogSource], run: RunConfig, out: Path, stamp: Stamp
    ) -> Iterator[tuple[int, LogResult | WorkerLost]]:
        """As `Engine.evaluate`."""
        teams = [sources[places.start : places.stop] for places in teams_of(len(sources), run.loop.apart.batch)]
        job, begins = Job(run, out, stamp), list(accumulate(map(len, teams), initial=0))
        if self.workers == 0:
            try:
                for begin, team in zip(begins, teams, strict=False):
                    yield from enumerate(job(team), begin)
            finally:
                set_template_run("")  # this process may do other work afterwards
            return
        drive = partial(
            run_all, job, workers=max(1, min(self.workers, len(teams))), one_first=is_cache_cold(),
            meanwhile=partial(compile_planning, run) if self.workers > 1 else None,
        )  # fmt: skip
        ended = longest_first(teams, drive, lambda team: sum(source.expected_s for source in team))
        for index, results in ended:
            every = [results] * len(teams[index]) if isinstance(results, WorkerLost) else results
            yield from enumerate(every, begins[index])


def teams_of(count: int, batch: int) -> list[range]:
    """Indices of the logs that are evaluated together, in teams of one log, or of `batch` consecutive logs."""
    size = max(batch, 1)
    return [range(begin, min(begin + size, count)) for begin in range(0, count, size)]


@dataclass(frozen=True)
class Job:
    """`evaluate_log` with all arguments except the log; a process that calls it loads a planner's module once."""

    run: RunConfig
    out: Path
    stamp: Stamp  # See `evaluate_log`
    name: str = field(default_factory=lambda: uuid4().hex)  # A name that no other run has

    def __call__(self, team: Sequence[LogSource]) -> list[LogResult]:
        """Evaluate each log of a team; in lock step if `LoopConfig.apart.batch` is set."""
        set_template_run(self.name)
        tasks = [partial(evaluate_log, source, self.run, self.out, self.stamp) for source in team]
        return in_lockstep(tasks) if self.run.loop.apart.batch else [task() for task in tasks]


def longest_first(
    items: Sequence[T], drive: Callable[[Sequence[T]], Iterator[tuple[int, R]]], expected_s: Callable[[T], float]
) -> Iterator[tuple[int, R]]:
    """Pass the items to `drive` by expected cost, and yield its results under the indices that they have here."""
    order = sorted(range(len(items)), key=lambda index: -expected_s(items[index]))
    for place, ended in drive([items[index] for index in order]):
        yield order[place], ended


FIRST_SCENES = ("everyday/traffic_light", "everyday/cyclist", "paper/static_obstacles", "everyday/pull_outs")
"""Scenes in which most kernels of a plan are needed within `UNTIL_S`."""
UNTIL_S = 1.5


def compile_planning(run: RunConfig) -> None:
    """Plan the begin of each scene with the built-in planners of a run."""
    for name in FIRST_SCENES:
        for planner in run.planners:
            if planner in PLANNER.causal:
                with suppress(ReplanError):  # the run itself says what is wrong
                    run_open_loop(
                        scenario(name), planner, planner_config=drive_keywords(planner, run), config=run.drive_loop,
                        until_s=UNTIL_S,
                    )  # fmt: skip


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
"""Scenes with walkers, cyclists, cars that pull out, obstacles, junctions, lights, raw detections: as in the suite."""
OF_A_CHOICE = ("everyday/traffic_light", "everyday/junction", "raw/crossing")
"""Scenes that need all kernels of one choice beside the default: a stop, others from the side, raw detections."""


@dataclass(frozen=True)
class Warmed:
    """The result of a warm-up."""

    seconds: float  # Its duration, s
    compiled: int  # The number of compiled kernels; the others were in the cache
    folder: Path | None  # The folder of their machine code; None if it is not kept
    failures: tuple[Failure, ...]  # Drives that failed


ELSEWHERE = ("multibody", "recorded")
"""Choices that are left out: the first has no kernels and an optional package; "auto" uses the second for raw logs."""


def everything() -> Iterator[tuple[RunConfig, Sequence[str]]]:
    """Runs, and their scenes, that need all built-in kernels: of all planners, and of each other choice in turn."""
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

    ConfigError and PlannerError as `replay.run.evaluate_logs`; OutputError if the disk is too full for the files of the
    drives.
    """
    begin = perf_counter()
    failures: list[Failure] = []
    for named, scenes in runs:
        run, refused = checked(named)
        failures += refused
        with TemporaryDirectory(prefix="replan-warmup-") as folder:
            sources = [LogSource(scene) for scene in scenes]
            ended = [result for _, result in Local().evaluate(sources, run, Path(folder), stamp_of(run))]
        results = [result for result in ended if isinstance(result, LogResult)]
        for stopped in filter(None, (result.stopped for result in results)):
            raise OutputError(stopped)
        failures += [failure for result in results for failure in result.failures]
    return Warmed(perf_counter() - begin, compiled_count(), cache_folder(), tuple(failures))
