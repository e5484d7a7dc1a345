"""A run over many logs, from the selection to the tables: `evaluate_logs`, which `replan evaluate` calls."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

from logs.errors import ConfigError, OutputError
from logs.readers import LogSettings
from replay.config import RunConfig
from replay.draw.drawn_results import Results
from replay.results.log_result import Failure, LogResult
from replay.results.tables import clear_partial, write_text
from replay.run.checks import checked
from replay.run.claim import RUN, claimed_folder, emptied
from replay.run.engine import Engine, Local, teams_of
from replay.run.judging import explained, gates_of, judge_and_write
from replay.run.output import write_origin
from replay.run.pool import WorkerLost
from replay.run.resume import finished, stamp_of
from replay.run.shards import Shard, write_card
from replay.run.sources import LogSource, Selection, builtin_suite, named_suite, select, suite_file


def evaluate_logs(
    logs: Sequence[Path | str] = (),
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
        logs: Files and folders; none: the built-in suite.
        run: Planners, loops, gates; None: all defaults.
        out: Result folder: new, empty, or results of an earlier run, which are replaced; None: `results/run-NNN`.
        workers: Number of child processes; 0 evaluates in this process. Results do not depend on it.
        engine: Where the logs are driven, with the same results; None: `workers` of this machine.
        resume: Keep the results of logs that an interrupted run into `out` has finished (`replay.run.resume`); the
            tables are the same, byte for byte, as those of a run that was never interrupted.
        window: Split each log into windows of this length, s; each is a log of its own.
        every: Time between the begins of two windows, s; None: `window`.
        suite: Instead of logs: a suite of the catalogue, or a family or group of it with all its cells.
        shard: Drive this part of the logs only; `replay.run.shards` judges all parts together.
        on_start: Called once with the selection and the result folder.
        on_log: Called as each log ends, in order of ending.

    Raises:
        ConfigError: No logs, an unknown name, gates that cannot be read, a folder that replan must not write, no run
            that can be resumed with these logs, this configuration and this code; another run writes into `out`.
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
    with claimed_folder(out, RUN, resume=resume) as out:
        done = finished(out, selection.sources, run, stamp) if resume else {}
        for team in teams_of(len(selection.sources), run.loop.apart.batch):
            if any(index not in done for index in team):  # logs in lock step are evaluated together
                for index in done.keys() & set(team):
                    shutil.rmtree(out / done.pop(index).folder)
        if not done:
            read = [source.path for source in selection.sources if source.path is not None]
            read += [Path(run.log.map)] if run.log.map else []
            for path in read:
                if Path(os.path.realpath(path)).is_relative_to(out.resolve()):
                    remedy = "which is cleared; give --out another folder"
                    raise ConfigError(f"{path}: lies in the result folder {out}, {remedy}")
            emptied(out)
        write_text(out / "run.toml", explained(run, out))
        write_origin(out)
        on_start(selection, out)
        evaluate = partial(engine.evaluate, run=run, out=out, stamp=stamp)
        try:
            results = _evaluate_rest(selection.sources, evaluate, done, on_log)
        finally:
            clear_partial(out)
        if shard is not None:
            write_card(out, shard, whole, run, stamp, failures, results)
        part = "" if shard is None else str(shard)
        return judge_and_write(out, run, selection, results, gates, failures, resumed=len(done), shard=part)


def _check_batch(engine: Engine, window: float | None, shard: Shard | None) -> None:
    """Refuse options that do not work with logs in lock step."""
    if not isinstance(engine, Local):
        raise ConfigError("loop.apart.batch drives logs together on this machine only: leave out --engine or the batch")
    if shard is not None:
        raise ConfigError(
            "loop.apart.batch drives the logs of a run together, and --shard separates them: leave out one of them"
        )
    if window is not None:
        raise ConfigError(
            "loop.apart.batch with --window would show a planner later windows of the log: leave out one of them"
        )


def selected(
    logs: Sequence[Path | str], run: RunConfig, window: float | None, suite: str | None, every: float | None = None
) -> Selection:
    """The logs of a run, from arguments of `evaluate_logs`; ConfigError if there are none, or arguments conflict."""
    if run.log.map and not Path(run.log.map).is_file():
        raise ConfigError(f"{run.log.map}: no such map")
    if suite is not None and suite.endswith(".toml") and not logs:
        logs, suite = suite_file(Path(suite)), None
    if suite is None and logs:
        return select(logs, run.log, window, every)
    if window is not None or run.log != LogSettings():
        raise ConfigError("[log] settings and --window are not for the built-in suites; name logs, or leave them out")
    if suite is None:
        return builtin_suite()
    if logs:
        raise ConfigError(f"--suite {suite} selects logs itself: leave out other logs")
    return named_suite(suite)


def _evaluate_rest(
    sources: Sequence[LogSource],
    evaluate: Callable[[Sequence[LogSource]], Iterator[tuple[int, LogResult | WorkerLost]]],
    done: Mapping[int, LogResult],
    on_log: Callable[[LogResult], None],
) -> tuple[LogResult, ...]:
    """The results in the order of the logs; `on_log` is called for the results in `done` first."""
    results = dict(done)
    for result in done.values():
        on_log(result)
    left = [index for index in range(len(sources)) if index not in done]
    for place, ended in evaluate([sources[index] for index in left]):
        index = left[place]
        if isinstance(ended, WorkerLost):
            label = sources[index].label
            ended = LogResult(label, label, failures=(Failure(label, f"{label}: not evaluated: {ended.reason}"),))
        results[index] = ended
        if results[index].stopped:
            raise OutputError(results[index].stopped)
        on_log(results[index])
    return tuple(results[index] for index in range(len(sources)))
