"""Evaluates one log in a worker: log -> drives -> tables -> files. It returns errors instead of
raising them.

The files of a log are written into a folder with a temporary name, which is renamed when all files
are complete.
"""

from __future__ import annotations

import os
import shutil
import traceback
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from hashlib import sha256
from math import inf
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import pandas as pd

from replan import metrics
from replan.config import RunConfig
from replan.core.errors import (
    ConfigError,
    OutputError,
    PlannerError,
    ReplanError,
    described,
    writing,
)
from replan.core.memory import trim_memory
from replan.draw.panels import MEASURED
from replan.logs.forward import drivable_part
from replan.logs.frame_store import FrameStore
from replan.logs.mcap import write_scenario, write_trace
from replan.logs.mcap.writer import Entry
from replan.logs.scenario import Scenario
from replan.logs.trace import EndReason, Mode, Trace
from replan.metrics import METRICS, Metric, health, load_metric
from replan.metrics.judge.added_rows import MEMBER
from replan.replay.drive import Drive, DriveKey, Mark
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.open_loop import run_open_loop
from replan.replay.loop.planning import Planning, marked_random, with_probe
from replan.replay.loop.reference_drives import (
    discriminating_tables,
    late_follower,
    with_avoidability,
    with_references,
)
from replan.replay.planner_process.planner_config import is_built_in
from replan.results.log_result import (
    DriveRecord,
    Failure,
    LogResult,
    LogTables,
    Stamp,
    Steps,
    StepsFile,
    write_result,
)
from replan.results.tables import (
    KEYS,
    PARTIAL,
    TIMING_COLUMNS,
    finish_folder,
    joined,
    safe_name,
    safe_names,
)
from replan.run.ensemble import perturbed
from replan.run.log_source import LogSource, file_hash

LOOPS = {Mode.OPEN: run_open_loop, Mode.CLOSED: run_closed_loop}


@dataclass
class _Progress:
    log: str
    drives: list[DriveRecord] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)
    tables: list[pd.DataFrame] = field(default_factory=list)
    timings: list[pd.DataFrame] = field(default_factory=list)
    members: list[pd.DataFrame] = field(default_factory=list)

    @contextmanager
    def attempt(self, planner: str | None = None, mode: Mode | None = None) -> Iterator[None]:
        """Turn an exception in the block into a failure of this log, planner and mode."""
        where = (planner, mode.value if mode else None)
        try:
            yield
        except OutputError:
            raise
        except ReplanError as error:
            code = 2 if isinstance(error, ConfigError) else 3
            self.failures.append(Failure(self.log, str(error), *where, exit_code=code))
        except (Exception, SystemExit) as error:
            line = f"{self.log}: {described(error)}; traceback in summary.json"
            self.failures.append(Failure(self.log, line, *where, traceback=traceback.format_exc()))

    def broken(self, planner: str, mode: Mode) -> metrics.OnError:
        """The function that records a metric of this drive that raises.

        No other metric is affected.
        """

        def noted(metric: Metric, reason: str, error: BaseException) -> None:
            ours = METRICS.get(metric.name) is metric
            name = f"the metric '{metric.name}'"
            problem = f"a bug in replan: {name} raised" if ours else f"{name} is not available"
            line = f"{self.log}: {problem}: {reason}; traceback in summary.json"
            reported = {
                (failure.message, failure.planner, failure.mode) for failure in self.failures
            }
            # Only once for all reductions and ensemble members
            if (line, planner, mode.value) not in reported:
                trace = "".join(traceback.format_exception(error))
                self.failures.append(Failure(self.log, line, planner, mode.value, traceback=trace))

        return noted


def evaluate_log(source: LogSource, run: RunConfig, out: Path, stamp: Stamp) -> LogResult:
    """Drive one log with each planner in each mode, measure, and write the log's folder into `out`.

    If it cannot be written (full disk), `LogResult.stopped` gives the error, and the partial folder
    is removed. If another log has the same content, the result is its twin (`LogResult.twin`).
    """
    progress, begin = _Progress(source.label), perf_counter()
    partial = out / f"{PARTIAL}{sha256(source.label.encode()).hexdigest()[:16]}-{os.getpid()}"
    finished: LogResult | None = None
    try:
        with writing(partial):
            partial.mkdir()
        with progress.attempt(), source.fetched() as near:
            identity = source.identity()
            scenario = near.read()
            result, health_table = _describe_log(near, scenario, partial, run)
            progress.log = scenario.name
            if (out / result.folder).exists():
                return replace(result, twin=True, seconds=perf_counter() - begin)
            driven = with_avoidability(
                drivable_part(scenario).in_vehicle(run.driven(scenario.vehicle))
            )
            _drive_all(driven, run, partial, result.folder, progress)
            for member in range(1, run.ensemble + 1):
                _drive_member(driven, run, member, progress)
            result = replace(
                result, drives=tuple(progress.drives), failures=tuple(progress.failures)
            )
            tables = LogTables(
                metrics=joined(progress.tables, KEYS, metrics.COLUMNS),
                members=joined(progress.members, [MEMBER, *KEYS]),
                health=health_table,
                timings=joined(progress.timings, TIMING_COLUMNS[:4], TIMING_COLUMNS),
            )
            write_result(partial, result, tables, identity, stamp)
            finished = replace(result, twin=not finish_folder(partial, out / result.folder))
    except OutputError as error:
        return LogResult(source.label, progress.log, stopped=str(error))
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    result = finished or LogResult(source.label, progress.log)
    return replace(result, failures=tuple(progress.failures), seconds=perf_counter() - begin)


def all_metrics(run: RunConfig) -> Mapping[str, Metric]:
    """The built-in metrics and the run's own; ConfigError if a metric cannot be loaded, or has the
    name of another.
    """
    by_name = dict(METRICS)
    for metric in map(load_metric, run.metrics):
        if metric.name in by_name:
            raise ConfigError(f"there are two metrics called '{metric.name}'; rename yours")
        by_name[metric.name] = metric
    return by_name


def _describe_log(
    source: LogSource, scenario: Scenario, folder: Path, run: RunConfig
) -> tuple[LogResult, pd.DataFrame]:
    """The log by name and content, and its health; other logs than native and OSI MCAP are written
    as `log.mcap`.

    The hash of the content ignores channels for Foxglove.
    """
    path = source.path
    if path is None or not source.is_mcap:
        path = folder / "log.mcap"
        write_scenario(path, scenario)
    digest = file_hash(path)
    if run.foxglove and path.parent == folder:
        from replan.draw.foxglove import scenario_messages

        write_scenario(path, scenario, beside=scenario_messages(scenario))
    name = safe_name(scenario.name, digest)
    findings = health.findings(scenario)
    notes = (*map(scenario.short_names, scenario.notes), *health.sentences(findings))
    table = health.table(scenario.name, findings)
    groups = scenario.family, scenario.dataset, scenario.tags
    return LogResult(source.label, scenario.name, digest, name, *groups, notes), table


def _drive_all(
    scenario: Scenario, run: RunConfig, folder: Path, final: str, progress: _Progress
) -> None:
    if Mode.CLOSED in run.modes:
        with progress.attempt():
            scenario, tables = with_references(scenario, run.drive_loop)
            progress.tables += [*tables, *discriminating_tables(scenario, run.drive_loop)]
    names = safe_names(run.planners)
    with closing(StepsFile(folder)) as steps:
        for spec in _places(run):
            with progress.attempt(spec.planner, spec.mode):
                loop = spec.mode.value
                stem = loop if len(run.planners) == 1 else f"{loop}.{names[spec.planner]}"
                trace, marks = _drive_one(scenario, spec, run, folder / stem, progress, steps)
                if trace.end is EndReason.PLANNER_FAILURE:
                    progress.failures.append(
                        Failure(progress.log, trace.detail, spec.planner, loop)
                    )
                files = tuple(f"{final}/{file.name}" for file in sorted(folder.glob(f"{stem}.*")))
                record = DriveRecord(
                    log=trace.scenario,
                    planner=trace.planner,
                    mode=loop,
                    oracle=trace.oracle,
                    end=trace.end.value,
                    detail=scenario.short_names(trace.detail),
                    t_end_s=float(trace.ego.t[-1]),
                    marks=tuple(mark.value for mark in marks),
                    notes=tuple(map(scenario.short_names, trace.notes)),
                    files=files,
                )
                progress.drives.append(record)
                del trace  # free it before the next drive: the trace of an hour is large
        steps.write()
    with progress.attempt():
        progress.tables += late_follower(progress.tables, scenario, run.drive_loop)


class _DriveSpec(NamedTuple):
    planner: str
    mode: Mode
    key: DriveKey


def _places(run: RunConfig, member: int = 0) -> Iterator[_DriveSpec]:
    for i, planner in enumerate(run.planners):
        for j, mode in enumerate(run.modes):
            yield _DriveSpec(planner, mode, DriveKey(member, i, j))


def _drive_one(
    scenario: Scenario,
    spec: _DriveSpec,
    run: RunConfig,
    file: Path,
    progress: _Progress,
    steps: StepsFile,
) -> tuple[Trace, tuple[Mark, ...]]:
    """Drive, measure and write one planner in one loop: the trace as `file`.mcap, its recording as
    `file`.rrd.
    """
    drive = _probe_determinism(
        _drive_log(scenario, spec, run, keep=run.keep_internals), scenario, spec, run
    )
    stored: dict[str, Steps] = {}

    def put(name: str, series: metrics.Series) -> None:
        stored[name] = steps.put(name, series)

    broken = progress.broken(spec.planner, spec.mode)
    _free_memory(drive.trace)
    table = metrics.evaluate(
        drive.trace, scenario, metrics=all_metrics(run), broken=broken, found=put
    )
    _free_memory(drive.trace)
    steps.add(drive.trace.planner, spec.mode.value, tuple(stored.values()))
    progress.tables.append(table)
    timings = {
        "log": drive.trace.scenario,
        "planner": drive.trace.planner,
        "mode": drive.trace.mode.value,
        "t_s": [lap.t for lap in drive.timings],
        "stage": [lap.stage for lap in drive.timings],
        "seconds": [lap.seconds for lap in drive.timings],
    }
    progress.timings.append(pd.DataFrame(timings, columns=TIMING_COLUMNS))
    with progress.attempt(spec.planner, spec.mode):
        shown = steps.table([stored[name] for name in MEASURED if name in stored])
        beside: Iterable[Entry] = ()
        if run.foxglove:
            from replan.draw.foxglove import trace_messages

            beside = trace_messages(drive.trace, scenario)
        write_trace(
            Path(f"{file}.mcap"), drive.trace, scenario, internals=run.internals, beside=beside
        )
        _free_memory(drive.trace)
        if run.recording:
            from replan.draw.recording import write_recording

            write_recording(Path(f"{file}.rrd"), drive, scenario, table, shown)
    return drive.trace, drive.marks


def _free_memory(trace: Trace) -> None:
    """Return memory to the system after a stage of a long drive."""
    if isinstance(trace.frames, FrameStore):
        trim_memory()


def _drive_log(
    scenario: Scenario, spec: _DriveSpec, run: RunConfig, *, keep: bool, until_s: float = inf
) -> Drive:
    return LOOPS[spec.mode](
        scenario,
        spec.planner,
        planner_config=run.planner_keywords(spec.planner),
        config=run.drive_loop,
        keep_internals=keep,
        until_s=until_s,
        seat=partial(Planning, place=spec.key),
    )


def _probe_determinism(drive: Drive, scenario: Scenario, spec: _DriveSpec, run: RunConfig) -> Drive:
    """The drive, with a note if its planner is the user's own and not deterministic
    (`RunConfig.repeat_s`).
    """
    planner, until_s = drive.trace.planner, float(scenario.ego.t[0]) + run.repeat_s
    if not run.repeat_s or drive.trace.oracle or is_built_in(planner) or not drive.trace.frames:
        return drive
    try:
        second = spec._replace(key=replace(spec.key, again=True))
        again = _drive_log(scenario, second, run, keep=False, until_s=until_s).trace
    except PlannerError as error:
        return marked_random(drive, f"{planner}, driven twice: it can be built only once: {error}")
    return with_probe(drive, again, until_s)


def _drive_member(scenario: Scenario, run: RunConfig, member: int, progress: _Progress) -> None:
    """Drive one member of the ensemble, and keep only its rows of metrics."""
    name, other = perturbed(scenario, member)
    other = with_avoidability(other)
    measures = all_metrics(run)
    tables: list[pd.DataFrame] = []
    if Mode.CLOSED in run.modes:
        other, tables = with_references(other, run.drive_loop)
    for spec in _places(run, member):
        with progress.attempt(spec.planner, spec.mode):
            drive = _drive_log(other, spec, run, keep=bool(run.metrics))
            noted = progress.broken(spec.planner, spec.mode)
            tables.append(metrics.evaluate(drive.trace, other, metrics=measures, broken=noted))
    tables += late_follower(tables, other, run.drive_loop)
    progress.members.extend(table.assign(member=member, perturbation=name) for table in tables)
