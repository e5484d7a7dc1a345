"""A run over many logs, from the selection to the tables: `evaluate_logs`, which `replan evaluate` calls."""

from __future__ import annotations

import os
import platform
import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from enum import Enum
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any

import pandas as pd

from logs.errors import ConfigError, OutputError
from logs.readers import LogSettings
from metrics import COLUMNS, health
from metrics.judge import Verdict, judge, outcomes
from metrics.judge.aggregate import LogLabels, groups, standings
from metrics.judge.gates import Gates, Outcome, load_gates
from metrics.judge.verdicts import LATE, judge_deadline, with_asked, with_ensemble
from replay.config import RunConfig, dump_run
from replay.results.load import Results, load
from replay.results.log_result import HEALTH, MEMBERS, METRICS, TIMINGS, Failure, LogResult, table_of, timings_of
from replay.results.tables import (
    KEYS,
    OUTCOMES,
    claim,
    clear_partial,
    joined,
    next_free,
    read_timings,
    write_json,
    write_metrics,
    write_parquet,
    write_text,
    write_timings,
)
from replay.results.version import replan_version
from replay.run.checks import checked
from replay.run.engine import Engine, Local, teams_of
from replay.run.lock import held
from replay.run.one_log import all_metrics
from replay.run.origin import write_origin
from replay.run.pool import WorkerLost
from replay.run.resume import finished, stamp_of
from replay.run.shard import Shard, write_card
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
        resume: Take the logs that an interrupted run into `out` has finished as they are (`replay.run.resume`); the
            tables are the same, byte for byte, as those of a run that was never interrupted.
        window: Split each log into windows of this length, s; each is a log of its own.
        suite: Instead of logs: a suite of the catalogue, or a family or group of it with all its cells.
        shard: Drive this part of the logs only; `replay.run.merge` judges all parts together.
        on_start: Called once with what was selected and the result folder.
        on_log: Called as each log ends, in order of ending.

    Raises:
        ConfigError: No logs, an unknown name, gates that cannot be read, a folder that is not ours to write, nothing
            that could be resumed with these logs, this configuration and this code; another run writes into `out`.
        PlannerError: None of the planners can be loaded.
        OutputError: The disk is full; finished logs are kept for `resume`.
    """
    run, engine = run or RunConfig(), engine or Local(workers)
    whole = selected(logs, run, window, suite)
    selection = whole if shard is None else shard.part(whole)
    gates = gates_of(run, run.gates_path)
    if run.loop.apart.batch:
        _check_together(engine, window, shard)
    run, failures = checked(run)
    if resume and out is None:
        raise ConfigError("name the folder of the run to be resumed with --out")
    out = next_free() if out is None else Path(out)
    stamp = stamp_of(run)
    with held(out), _to_be_resumed(out):
        done = _whole(out, finished(out, selection.sources, run, stamp), selection, run) if resume else {}
        if not done:
            _check_outside(out, selection.sources, run)
            claim(out)
        write_text(out / "run.toml", dump_run(run))
        write_origin(out)
        on_start(selection, out)
        try:
            evaluate = partial(engine.evaluate, run=run, out=out, stamp=stamp)
            results = _evaluated(selection.sources, evaluate, done, on_log)
        finally:
            clear_partial(out)
        if shard is not None:
            write_card(out, shard, whole, run, stamp, failures, results)
        return judge_and_write(out, run, selection, results, gates, failures, resumed=len(done), shard=shard)


def _check_together(engine: Engine, window: float | None, shard: Shard | None) -> None:
    """Refuse what does not go with logs in lock step."""
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


def _whole(out: Path, done: Mapping[int, LogResult], selection: Selection, run: RunConfig) -> dict[int, LogResult]:
    """Of the logs that are done those without others that are not, in lock step with them; the rest is cleared away."""
    teams = teams_of(len(selection.sources), run.loop.apart.batch)
    left = {index: done[index] for team in teams if all(index in done for index in team) for index in team}
    for index in done.keys() - left.keys():
        shutil.rmtree(out / done[index].folder)
    return left


@contextmanager
def _to_be_resumed(out: Path) -> Iterator[None]:
    """Add to the error of a full disk how to continue."""
    try:
        yield
    except OutputError as error:
        how = f"what is finished is kept: make room, and give the same command with --out {out} --resume"
        raise OutputError(f"{error}; {how}") from error


def gates_of(run: RunConfig, path: Path | None) -> Gates:
    """The thresholds in a file, or the packaged ones on what the run drives; ConfigError as `load_gates`."""
    gates = load_gates(path, metrics=all_metrics(run))
    return gates.asked_of(mode.value for mode in run.modes) if path is None else gates


def judge_and_write(
    out: Path,
    run: RunConfig,
    selection: Selection,
    results: Sequence[LogResult],
    gates: Gates,
    failures: Sequence[Failure],
    *,
    resumed: int = 0,
    shard: Shard | None = None,
) -> Results:
    """Judge the results of a run (those of a shard are not judged), and write its tables.

    Args:
        out: The result folder, where the folders of the logs are; the tables go there.
        run: As it was driven.
        selection: The logs.
        results: Of each log, in the order of the selection.
        gates: The thresholds.
        failures: What could not be evaluated and is not about a log.
        resumed: How many logs were taken from an interrupted run.
        shard: Which part of a run it is; None: all of it.
    """
    results = _distinct(results)
    table = joined([table_of(out, results, METRICS)], KEYS, COLUMNS).astype({"value": float, "time_s": float})
    labels = {log.name: LogLabels(log.family, log.dataset, log.tags) for log in results}
    read = {log.name: labels[log.name] for log in results if log.digest}
    members = joined([table_of(out, results, MEMBERS)], KEYS, COLUMNS)
    table = with_asked(with_ensemble(table, members, gates, read), gates, read)
    sorted_ = sorted((result for result in results if result.folder), key=lambda result: result.name)
    write_timings(out / TIMINGS, (timings_of(out, result) for result in sorted_))
    verdicts: tuple[Verdict, ...] = ()
    errors = [failure for result in results for failure in result.failures]
    if shard is None:
        unread = {result.name: "see the errors" for result in results if not result.digest}
        crashed = {(one.log, one.planner, one.mode): one.message for one in errors if one.planner and one.mode}
        verdicts = tuple(judge(gates, table, read, failed=unread, crashed=crashed))
        if run.deadline_s > 0.0:
            verdicts += tuple(judge_deadline(read_timings(out / TIMINGS), run.deadline_s, read))
    errors = [*failures, *errors]
    write_metrics(out, table)
    found = table_of(out, results, HEALTH)
    write_parquet(out / HEALTH, found if len(found) else health.table("", ()))
    rows = outcomes([verdict for verdict in verdicts if verdict.gate.metric != LATE])
    write_parquet(out / "verdicts.parquet", rows)
    records = [asdict(drive) for result in results for drive in result.drives]
    drives = pd.DataFrame(records, columns=["log", "planner", "mode", "oracle"])
    stand = standings(rows, drives, list(labels), run.drives, [(one.log, one.planner, one.mode) for one in errors])
    write_parquet(out / "groups.parquet", groups(table, stand, labels))
    code = exit_code_of(errors, None if shard is not None else [verdict.outcome for verdict in verdicts])
    summary = {
        "replan": replan_version(),
        "python": platform.python_version(),
        **({} if shard is None else {"shard": str(shard)}),
        "outcome": "not judged" if shard is not None and code == 0 else OUTCOMES[code],
        "exit_code": code,
        "logs_left_out": list(selection.dropped),
        "logs": [_log_summary(log) for log in results],
        "gates": [_verdict_summary(verdict) for verdict in verdicts],
        "failures": [asdict(failure) for failure in errors],
    }
    write_json(out / "summary.json", summary)
    return replace(load(out), resumed=resumed)


def exit_code_of(failures: Iterable[Failure], outcomes: Iterable[Outcome] | None) -> int:
    """Exit code of a run: 0 pass, 1 a gate failed, 2 configuration, 3 not all could be evaluated, 4 inconclusive.

    Args:
        failures: What could not be evaluated.
        outcomes: Of the gates; None: the run is not judged, and 0 means that it is done.
    """
    codes = {failure.exit_code for failure in failures}
    if codes:
        return 2 if 2 in codes else 3
    if outcomes is None:
        return 0
    asked = set(outcomes) - {Outcome.NOT_ASKED}
    if Outcome.FAIL in asked:
        return 1
    return 4 if Outcome.INCONCLUSIVE in asked or not asked else 0


def selected(logs: Sequence[Path | str], run: RunConfig, window: float | None, suite: str | None) -> Selection:
    """The logs of a run, arguments as of `evaluate_logs`; ConfigError where there are none, or they do not fit."""
    if run.log.map and not Path(run.log.map).is_file():
        raise ConfigError(f"{run.log.map}: no such map")
    if suite is not None and suite.endswith(".toml") and not logs:
        logs, suite = suite_file(Path(suite)), None
    if suite is None and logs:
        return select(logs, run.log, window)
    if window is not None or run.log != LogSettings():
        raise ConfigError("the built-in suites have no [log] settings and no parts; name logs, or leave them out")
    if suite is None:
        return builtin_suite()
    if logs:
        raise ConfigError(f"--suite {suite} are logs by themselves: leave out other logs")
    return named_suite(suite)


def _check_outside(out: Path, sources: Sequence[LogSource], run: RunConfig) -> None:
    """Refuse to clear a result folder that holds what the run reads."""
    read = [source.path for source in sources if source.path is not None]
    read += [Path(run.log.map)] if run.log.map else []
    inside = [path for path in read if Path(os.path.realpath(path)).is_relative_to(out.resolve())]
    if inside:
        raise ConfigError(f"{inside[0]}: lies in the result folder {out}, which is cleared; give --out another folder")


def _evaluated(
    sources: Sequence[LogSource],
    evaluate: Callable[[Sequence[LogSource]], Iterator[tuple[int, LogResult | WorkerLost]]],
    done: Mapping[int, LogResult],
    on_log: Callable[[LogResult], None],
) -> tuple[LogResult, ...]:
    """The results in the order of the logs; those that are there already first."""
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


def _distinct(results: Sequence[LogResult]) -> tuple[LogResult, ...]:
    """The results with different names: logs that share one get the hash of their content behind it."""
    names, distinct = Counter(result.name for result in results), []
    for result in results:
        if names[result.name] > 1 and result.digest:
            name = f"{result.name}@{result.digest[:8]}"
            drives = tuple(replace(drive, log=name) for drive in result.drives)
            failures = tuple(replace(failure, log=name) for failure in result.failures)
            distinct.append(replace(result, name=name, drives=drives, failures=failures))
        else:
            distinct.append(result)
    return tuple(distinct)


def _log_summary(log: LogResult) -> dict[str, Any]:
    return {
        "log": log.name,
        "source": log.source,
        "sha256": log.digest,
        "folder": log.folder,
        "family": log.family,
        "dataset": log.dataset,
        "tags": log.tags,
        "notes": log.notes,
        "drives": [asdict(drive) for drive in log.drives],
    }


def _verdict_summary(verdict: Verdict) -> dict[str, Any]:
    """A verdict without its rows by log, which are in verdicts.parquet; NaN is null."""
    record: dict[str, Any] = {"rule": str(verdict.gate)}
    for key, value in asdict(verdict).items():
        if key != "logs":
            plain = value.value if isinstance(value, Enum) else value
            record[key] = None if isinstance(plain, float) and not isfinite(plain) else plain
    return record
