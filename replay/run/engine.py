"""Engines drive the logs of a run: in this process, in processes of this machine, or on a Ray cluster. Same bytes.

An engine applies a function to items and yields the result of each as it ends, in any
order; if a worker dies, the result of its item is `WorkerLost`, and no other item is
affected. The function writes a log's folder into the result folder if the workers
share that with the driver (`Local`); otherwise its result contains the folder (`replay.run.on_ray`).

Items are started by their expected duration, the longest first (Graham, SIAM J. Appl. Math. 17, 1969:
within 4/3 - 1/(3 m) of the shortest makespan on m workers), so that no long log begins last. An item is a log, or the
logs that are driven in lock step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import accumulate
from pathlib import Path
from typing import Protocol, TypeVar
from uuid import uuid4

from logs.kernel import is_cache_cold
from replay.config import RunConfig
from replay.planner_process.batch import in_lockstep
from replay.planner_process.processes import set_template_run
from replay.results.log_result import LogResult, Stamp
from replay.run.head_start import compile_planning
from replay.run.one_log import evaluate_log
from replay.run.pool import WorkerLost, run_all
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
    """This machine.

    Attributes:
        workers: Number of child processes; 0: this process, in the order given.
    """

    workers: int = 0

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
    """`evaluate_log` with all arguments except the log; a process that calls it loads a planner's module once.

    Attributes:
        run: The configuration of the run.
        out: The result folder.
        stamp: See `evaluate_log`.
        name: A name that no other run has.
    """

    run: RunConfig
    out: Path
    stamp: Stamp
    name: str = field(default_factory=lambda: uuid4().hex)

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
