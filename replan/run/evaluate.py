"""A run over many logs, from the selection to the tables: `evaluate_logs`, which `replan evaluate`
calls.

Engines drive the logs: in this process, in processes of this machine, or on a Ray cluster, with the
same results.

An engine applies a function to items and yields the result of each as it ends, in any order; if a
worker dies, the result of its item is `WorkerLost`, and no other item is affected. The function
writes a log's folder into the result folder if the workers share that with the driver (`Local`);
otherwise its result contains the folder (`replan.run.on_ray`).

Items are started by their expected duration, the longest first (Graham, SIAM J. Appl. Math. 17,
1969: within 4/3 - 1/(3 m) of the shortest makespan on m workers), so that no long log begins last.
An item is a log, or the logs that are driven in lock step.

While no machine code is on disk, the first log of a run is driven alone, so that kernels that all
logs need are compiled once. It begins with the reference drives and their metrics; meanwhile a
second process plans over some built-in scenes (`compile_planning`).
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import accumulate
from math import inf
from pathlib import Path
from typing import Protocol, TypeVar
from uuid import uuid4

from replan.config import IN_MEMORY, LogSelection, RunConfig
from replan.core.errors import ConfigError, OutputError, ReplanError, encodable
from replan.core.kernel import is_cache_cold
from replan.core.names import listed
from replan.core.urls import url_of
from replan.draw.drawn_results import Results
from replan.logs.catalogue import scenario
from replan.logs.readers import LogSettings
from replan.logs.scenario import Scenario
from replan.replay.loop.open_loop import run_open_loop
from replan.replay.parts import PLANNER
from replan.replay.planner_process.lockstep import in_lockstep
from replan.replay.planner_process.processes import set_template_run
from replan.results.log_result import Failure, LogResult, Stamp
from replan.results.tables import clear_partial, write_text
from replan.run.checks import checked
from replan.run.claim import RUN, claimed_folder, emptied
from replan.run.judging import explained, gates_of, judge_and_write
from replan.run.log_source import LogSource
from replan.run.one_log import evaluate_log
from replan.run.output import write_origin
from replan.run.pool import WorkerLost, run_all
from replan.run.resume import finished, stamp_of
from replan.run.shards import Shard, write_card
from replan.run.sources import Selection, builtin_suite, named_suite, select, suite_file


def evaluate_logs(
    logs: Sequence[Path | str | Scenario] = (),
    run: RunConfig | None = None,
    out: Path | str | None = None,
    *,
    workers: int = 0,
    engine: Engine | None = None,
    resume: bool = False,
    window: float | None = None,
    every: float | None = None,
    suite: str | None = None,
    shard: Shard | None = None,
    on_start: Callable[[Selection, Path], None] = lambda selection, out: None,
    on_log: Callable[[LogResult], None] = lambda result: None,
) -> Results:
    """Drive the planners over logs, measure, judge and write everything into one folder.

    Args:
        logs: Files, folders, and scenarios in memory; none: the built-in suite.
        run: Planners, loops, gates; None: all defaults.
        out: Result folder: new, empty, or results of an earlier run, which are replaced; None:
            `results/run-NNN`.
        workers: Number of child processes; 0 evaluates in this process. Results do not depend on
            it.
        engine: Where the logs are driven, with the same results; None: `workers` of this machine.
        resume: Keep the results of logs that an interrupted run into `out` has finished
            (`replan.run.resume`); the tables are the same, byte for byte, as those of a run that
            was never interrupted.
        window: Split each log into windows of this length, s; each is a log of its own.
        every: Time between the begins of two windows, s; None: `window`.
        suite: Instead of logs: a suite of the catalogue, or a family or group of it with all its
            cells.
        shard: Drive this part of the logs only; `replan.run.shards` judges all parts together.
        on_start: Called once with the selection and the result folder.
        on_log: Called as each log ends, in order of ending.

    Raises:
        ConfigError: No logs, an unknown name, gates that cannot be read, a folder that replan must
            not write, no run that can be resumed with these logs, this configuration and this code;
            another run writes into `out`.
        PlannerError: None of the planners can be loaded.
        OutputError: The disk is full; finished logs are kept for `resume`.
    """
    run, engine = run or RunConfig(), engine or Local(workers)
    whole = selected(logs, run, window, suite, every)
    selection = whole if shard is None else shard.part(whole)
    gates = gates_of(run, run.gates_path)
    if run.loop.apart.batch:
        _check_batch(engine, window, shard)
    run, failures = checked(run)
    stamp = stamp_of(run)
    with claimed_folder(out, RUN, resume=resume) as folder:
        finished_before = finished(folder, selection.sources, run, stamp) if resume else {}
        for team in teams_of(len(selection.sources), run.loop.apart.batch):
            # Logs in lock step are evaluated together
            if not finished_before.keys() >= set(team):
                for index in finished_before.keys() & set(team):
                    shutil.rmtree(folder / finished_before.pop(index).folder)
        if not finished_before:
            read = [source.path for source in selection.sources if source.path is not None]
            read += [Path(run.log.map)] if run.log.map else []
            for path in read:
                if Path(os.path.realpath(path)).is_relative_to(folder.resolve()):
                    remedy = "which is cleared; give --out another folder"
                    raise ConfigError(f"{path}: lies in the result folder {folder}, {remedy}")
            emptied(folder)
        write_text(folder / "run.toml", explained(replace(run, selection=whole.chosen), folder))
        write_origin(folder)
        on_start(selection, folder)
        evaluate = partial(engine.evaluate, run=run, out=folder, stamp=stamp)
        try:
            results = _evaluate_rest(selection.sources, evaluate, finished_before, on_log)
        finally:
            clear_partial(folder)
        if shard is not None:
            write_card(folder, shard, whole, run, stamp, failures, results)
        part = "" if shard is None else str(shard)
        return judge_and_write(
            folder,
            run,
            selection,
            results,
            gates,
            failures,
            resumed=len(finished_before),
            shard=part,
        )


def _check_batch(engine: Engine, window: float | None, shard: Shard | None) -> None:
    """Raise ConfigError for options that do not work with logs in lock step."""
    if not isinstance(engine, Local):
        raise ConfigError(
            "loop.apart.batch drives logs together on this machine only: leave out --engine or the "
            "batch"
        )
    if shard is not None:
        raise ConfigError(
            "loop.apart.batch drives the logs of a run together, and --shard separates them: leave "
            "out one of them"
        )
    if window is not None:
        raise ConfigError(
            "loop.apart.batch with --window would show a planner later windows of the log: leave "
            "out one of them"
        )


def selected(
    logs: Sequence[Path | str | Scenario],
    run: RunConfig,
    window: float | None,
    suite: str | None,
    every: float | None = None,
) -> Selection:
    """The logs of a run, from arguments of `evaluate_logs`, else as `run.selection` names them;
    ConfigError if there are none, arguments conflict, or a log that it names is not as it was.
    """
    if run.log.map and not Path(run.log.map).is_file():
        raise ConfigError(f"{run.log.map}: no such map")
    stated = LogSelection() if logs or suite is not None else run.selection
    window, every = window or stated.window_s or None, every or stated.every_s or None
    suite = stated.suite or None if suite is None else suite
    if stated.logs:
        selection = _stated_logs(stated.logs, run.log, window, every)
    else:
        selection = _selected(logs, run.log, window, suite, every)
    sources = (source.named for source in selection.sources)
    named = {encodable(path): digest for path, digest in sources if path}
    chosen = LogSelection("" if named else suite or "", window or 0.0, every or 0.0, named)
    return replace(selection, chosen=chosen)


def _selected(
    logs: Sequence[Path | str | Scenario],
    settings: LogSettings,
    window: float | None,
    suite: str | None,
    every: float | None,
) -> Selection:
    if suite is not None and suite.endswith(".toml") and not logs:
        logs, suite = suite_file(Path(suite)), None
    if suite is None and logs:
        return select(logs, settings, window, every)
    if window is not None or settings.between(0.0, inf) != LogSettings():
        raise ConfigError(
            "[log] settings but begin and end, and --window, are not for the built-in suites; name "
            "logs, or leave them out"
        )
    if suite is not None and logs:
        raise ConfigError(f"--suite {suite} selects logs itself: leave out other logs")
    built_in = builtin_suite() if suite is None else named_suite(suite)
    parts = (replace(source, settings=settings) for source in built_in.sources)
    return replace(built_in, sources=tuple(parts))


def _stated_logs(
    logs: Mapping[str, str], settings: LogSettings, window: float | None, every: float | None
) -> Selection:
    """The logs that a configuration names; ConfigError if one is not there, or has other
    content.
    """

    def refusal(wrong: Sequence[str], problem: str) -> ConfigError:
        count = f"{len(wrong)} of the {len(logs)} logs that the configuration names"
        names = [log.replace(IN_MEMORY, "in memory was ", 1) for log in wrong]
        remedy = "put them back, or name the logs to drive"
        return ConfigError(f"{count} {problem}: {listed(names, 3)}; {remedy}")

    gone = [log for log in logs if not (url_of(log) or Path(log).exists())]
    if gone:
        raise refusal(gone, "are not there")
    selection = select(list(logs), settings, window, every)
    present = dict(source.named for source in selection.sources)
    changed = [
        log
        for log, digest in logs.items()
        if log not in present or (digest and present[log] not in ("", digest))
    ]
    if changed:
        raise refusal(changed, "have other content now")
    return selection


def _evaluate_rest(
    sources: Sequence[LogSource],
    evaluate: Callable[[Sequence[LogSource]], Iterator[tuple[int, LogResult | WorkerLost]]],
    finished_before: Mapping[int, LogResult],
    on_log: Callable[[LogResult], None],
) -> tuple[LogResult, ...]:
    """The results in the order of the logs; `on_log` is called for those in `done` first.

    OutputError if the disk is full.
    """
    results = dict(finished_before)
    for result in finished_before.values():
        on_log(result)
    remaining = [index for index in range(len(sources)) if index not in finished_before]
    for position, ended in evaluate([sources[index] for index in remaining]):
        index = remaining[position]
        if isinstance(ended, WorkerLost):
            label = sources[index].label
            ended = LogResult(
                label, label, failures=(Failure(label, f"{label}: not evaluated: {ended.reason}"),)
            )
        results[index] = ended
        if results[index].stopped:
            raise OutputError(results[index].stopped)
        on_log(results[index])
    return tuple(results[index] for index in range(len(sources)))


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
        teams = [
            sources[places.start : places.stop]
            for places in teams_of(len(sources), run.loop.apart.batch)
        ]
        job, begins = Job(run, out, stamp), list(accumulate(map(len, teams), initial=0))
        if self.workers == 0:
            try:
                for begin, team in zip(begins, teams, strict=False):
                    yield from enumerate(job(team), begin)
            finally:
                set_template_run("")  # this process may do other work afterwards
            return
        drive = partial(
            run_all,
            job,
            workers=max(1, min(self.workers, len(teams))),
            one_first=is_cache_cold(),
            meanwhile=partial(compile_planning, run) if self.workers > 1 else None,
        )
        ended = longest_first(teams, drive, _expected_s)
        for index, results in ended:
            every = [results] * len(teams[index]) if isinstance(results, WorkerLost) else results
            yield from enumerate(every, begins[index])


def _expected_s(team: Sequence[LogSource]) -> float:
    return sum(source.expected_s for source in team)


def teams_of(count: int, batch: int) -> list[range]:
    """Indices of the logs that are evaluated together, in teams of one log, or of `batch`
    consecutive logs.
    """
    size = max(batch, 1)
    return [range(begin, min(begin + size, count)) for begin in range(0, count, size)]


@dataclass(frozen=True)
class Job:
    """`evaluate_log` with all arguments except the log.

    A process that calls it loads a planner's module once.
    """

    run: RunConfig
    folder: Path  # The result folder
    stamp: Stamp  # See `evaluate_log`
    name: str = field(default_factory=lambda: uuid4().hex)  # A name that no other run has

    def __call__(self, team: Sequence[LogSource]) -> list[LogResult]:
        """Evaluate each log of a team; in lock step if `LoopConfig.apart.batch` is set."""
        set_template_run(self.name)
        tasks = [
            partial(evaluate_log, source, self.run, self.folder, self.stamp) for source in team
        ]
        return in_lockstep(tasks) if self.run.loop.apart.batch else [task() for task in tasks]


def longest_first(
    items: Sequence[T],
    drive: Callable[[Sequence[T]], Iterator[tuple[int, R]]],
    expected_s: Callable[[T], float],
) -> Iterator[tuple[int, R]]:
    """Pass the items to `drive` by expected cost, and yield its results under the indices that they
    have here.
    """
    order = sorted(range(len(items)), key=lambda index: -expected_s(items[index]))
    for position, ended in drive([items[index] for index in order]):
        yield order[position], ended


FIRST_SCENES = (
    "everyday/traffic_light",
    "everyday/cyclist",
    "paper/static_obstacles",
    "everyday/pull_outs",
)
"""Scenes in which most kernels of a plan are needed within `UNTIL_S`."""
UNTIL_S = 1.5


def compile_planning(run: RunConfig) -> None:
    """Plan the begin of each scene with the built-in planners of a run."""
    for name in FIRST_SCENES:
        for planner in run.planners:
            if planner in PLANNER.causal:
                with suppress(ReplanError):  # the run itself says what is wrong
                    run_open_loop(
                        scenario(name),
                        planner,
                        planner_config=run.planner_keywords(planner),
                        config=run.drive_loop,
                        until_s=UNTIL_S,
                    )
