"""Where the logs of a run are driven: in this process, in processes of this machine, on a Ray cluster. Same bytes.

An engine applies a function to items and yields what came of each as it ends, in any order; a worker that dies costs
`WorkerLost` for its item and nothing else. The function writes a log's folder into the result folder itself where the
workers share it with the driver (`local`), else what it returns brings the folder with it (`replay.batch.on_ray`).

Items are handed out by how long they are expected to take, the longest first (Graham, SIAM J. Appl. Math. 17, 1969:
within 4/3 - 1/(3 m) of the shortest makespan on m workers), so that no long log begins last.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Protocol
from uuid import uuid4

from logs.kernel import cold
from replay.apart.processes import loaded_for
from replay.batch.one_log import evaluate_log
from replay.batch.pool import WorkerLost, run_all

if TYPE_CHECKING:
    from replay.batch.log_result import LogResult, Stamp
    from replay.batch.sources import LogSource
    from replay.config import RunConfig


class Engine(Protocol):
    """Evaluates logs into a result folder."""

    def evaluate(
        self, sources: Sequence[LogSource], run: RunConfig, out: Path, stamp: Stamp
    ) -> Iterator[tuple[int, LogResult | WorkerLost]]:
        """What came of each source, by index, as it ends; its folder is in `out` by then."""
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
        job = Job(run, out, stamp)
        if self.workers == 0:
            return _here(job, sources)
        workers = max(1, min(self.workers, len(sources)))
        return longest_first(sources, lambda ordered: run_all(job, ordered, workers, one_first=cold()))


@dataclass(frozen=True)
class Job:
    """`evaluate_log` of everything but the log; a planner's module is loaded once in each process that it is called in.

    Attributes:
        run: What is driven.
        out: The result folder.
        stamp: See `evaluate_log`.
        name: Which run it is, of all that there ever are.
    """

    run: RunConfig
    out: Path
    stamp: Stamp
    name: str = field(default_factory=lambda: uuid4().hex)

    def __call__(self, source: LogSource) -> LogResult:
        """As `evaluate_log`."""
        loaded_for(self.name)
        return evaluate_log(source, self.run, self.out, self.stamp)


def _here(job: Job, sources: Sequence[LogSource]) -> Iterator[tuple[int, LogResult]]:
    """In this process, which may go on to other things."""
    try:
        for index, source in enumerate(sources):
            yield index, job(source)
    finally:
        loaded_for("")


def longest_first(
    sources: Sequence[LogSource],
    drive: Callable[[Sequence[LogSource]], Iterator[tuple[int, LogResult | WorkerLost]]],
) -> Iterator[tuple[int, LogResult | WorkerLost]]:
    """What `drive` yields of the sources, which it gets by expected cost, under the indices that they have here."""
    order = sorted(range(len(sources)), key=lambda index: -sources[index].expected_s)
    for place, ended in drive([sources[index] for index in order]):
        yield order[place], ended
