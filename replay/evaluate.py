"""One log: log -> drives -> tables -> files. What a worker does; it returns its errors and raises none.

The files of a log are written into a folder with a temporary name, which is renamed when all are there.
"""

from __future__ import annotations

import shutil
import sys
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from hashlib import sha256
from pathlib import Path

import pandas as pd

import metrics
from logs.errors import ConfigError, ReplanError
from logs.mcap import write_scenario, write_trace
from logs.scenario import Scenario
from logs.trace import EndReason, Mode
from metrics import METRICS, Metric, load_metric
from replay.avoidability import with_avoidability
from replay.closed_loop import run_closed_loop
from replay.config import RunConfig
from replay.drive import Drive
from replay.open_loop import run_open_loop
from replay.planner_config import planner_keywords
from replay.results import KEYS, PARTIAL, TIMING_COLUMNS, joined, safe_name, write_json, write_parquet
from replay.sources import LOG_CARD, LogSource, file_hash

LOOPS = {Mode.OPEN: run_open_loop, Mode.CLOSED: run_closed_loop}


@dataclass(frozen=True)
class Failure:
    """What could not be evaluated.

    Attributes:
        log: Label or name of the log.
        message: One line that names the thing, the place and the remedy.
        planner: None: the log itself.
        mode: None: before any loop.
        exit_code: What it costs.
        traceback: Of a bug; empty where the user can mend it.
    """

    log: str
    message: str
    planner: str | None = None
    mode: str | None = None
    exit_code: int = 3
    traceback: str = ""

    @property
    def line(self) -> str:
        """The message, with planner and loop where they are known."""
        return f"{self.message} [{self.planner}, {self.mode} loop]" if self.planner else self.message


@dataclass(frozen=True)
class DriveRecord:
    """One drive as the reports need it; `files` are relative to the result folder."""

    log: str
    planner: str
    mode: str
    oracle: bool
    end: str
    detail: str
    t_end_s: float
    notes: tuple[str, ...]
    files: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class LogResult:
    """What came of one log.

    Attributes:
        source: Label of the log: the path as given, or the family's name.
        name: Of the scenario; the source's label where it could not be read.
        digest: SHA-256 of the log's bytes; empty where it could not be read.
        folder: Its folder's name in the result folder; empty where there is none.
        tags: Of the scenario.
        notes: What was assumed in reading it.
        drives: What was driven, planners in the order of the run, open before closed.
        failures: What was not.
        table: Rows of `metrics.evaluate`.
        timings: Rows of timings.parquet.
    """

    source: str
    name: str
    digest: str = ""
    folder: str = ""
    tags: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    drives: tuple[DriveRecord, ...] = ()
    failures: tuple[Failure, ...] = ()
    table: pd.DataFrame = field(default_factory=pd.DataFrame)
    timings: pd.DataFrame = field(default_factory=pd.DataFrame)


@dataclass
class _Progress:
    """What one log has given so far."""

    log: str
    drives: list[DriveRecord] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)
    tables: list[pd.DataFrame] = field(default_factory=list)
    timings: list[pd.DataFrame] = field(default_factory=list)
    series: list[pd.DataFrame] = field(default_factory=list)

    @contextmanager
    def attempt(self, planner: str | None = None, mode: Mode | None = None) -> Iterator[None]:
        """What is raised inside becomes a failure of this log, planner and mode."""
        place = (planner, mode.value if mode else None)
        try:
            yield
        except ReplanError as error:
            code = 2 if isinstance(error, ConfigError) else 3
            self.failures.append(Failure(self.log, str(error), *place, exit_code=code))
        except (Exception, SystemExit) as error:
            what = f"{type(error).__name__}: {error}"
            line = f"{self.log}: a bug in replan or in the planner: {what}; traceback in summary.json"
            self.failures.append(Failure(self.log, " ".join(line.split()), *place, traceback=traceback.format_exc()))


def evaluate_log(source: LogSource, run: RunConfig, out: Path) -> LogResult:
    """Drive one log with each planner in each mode, measure, and write the log's folder into `out`."""
    progress = _Progress(source.label)
    partial = out / f"{PARTIAL}{sha256(source.label.encode()).hexdigest()[:16]}"
    partial.mkdir()
    result = LogResult(source.label, source.label)
    try:
        with progress.attempt():
            scenario = source.read()
            result = _identified(source, scenario, partial)
            progress.log = scenario.name
            driven = with_avoidability(replace(scenario, vehicle=run.driven(scenario.vehicle)))
            _drive_all(driven, run, partial, result.folder, progress)
            _publish(partial, out, result)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return replace(
        result,
        drives=tuple(progress.drives),
        failures=tuple(progress.failures),
        table=joined(progress.tables, KEYS),
        timings=joined(progress.timings, TIMING_COLUMNS[:4]),
    )


def all_metrics(run: RunConfig) -> Mapping[str, Metric]:
    """The built-in metrics and the run's own; modules are looked for in the working directory too.

    Raises:
        ConfigError: A metric cannot be loaded, or has the name of another.
    """
    here = str(Path.cwd())
    if run.metrics and here not in sys.path:
        sys.path.append(here)
    found = dict(METRICS)
    for metric in map(load_metric, run.metrics):
        if metric.name in found:
            raise ConfigError(f"there are two metrics called '{metric.name}'; rename yours")
        found[metric.name] = metric
    return found


def _identified(source: LogSource, scenario: Scenario, folder: Path) -> LogResult:
    """The log by name and content; what was no MCAP file is written as one, `log.mcap`."""
    path = source.path
    if path is None or path.suffix.lower() != ".mcap":
        path = folder / "log.mcap"
        write_scenario(path, scenario)
    digest = file_hash(path)
    name = safe_name(scenario.name, digest)
    return LogResult(source.label, scenario.name, digest, name, scenario.tags, scenario.notes)


def _drive_all(scenario: Scenario, run: RunConfig, folder: Path, final: str, progress: _Progress) -> None:
    measures = all_metrics(run)
    for planner in run.planners:
        for mode in run.modes:
            with progress.attempt(planner, mode):
                keywords = planner_keywords(planner, run.planner.get(planner, {}))
                drive = LOOPS[mode](scenario, planner, planner_config=keywords, config=run.loop)
                table = metrics.evaluate(drive.trace, scenario, metrics=measures)
                progress.tables.append(table)
                progress.timings.append(_timings(drive))
                progress.series.append(_series(drive, scenario, measures))
                stem = mode.value if len(run.planners) == 1 else f"{mode.value}.{safe_name(planner)}"
                with progress.attempt(planner, mode):
                    _write_drive(folder, stem, drive, scenario, table, run)
                if drive.trace.end is EndReason.PLANNER_FAILURE:
                    progress.failures.append(Failure(progress.log, drive.trace.detail, planner, mode.value))
                files = tuple(f"{final}/{file.name}" for file in sorted(folder.glob(f"{stem}.*")))
                progress.drives.append(_record(drive, files))
    if progress.series:
        frames = joined(progress.series, ["planner", "mode", "metric", "t_s"])
        write_parquet(folder / "frames.parquet", frames)


def _write_drive(
    folder: Path, stem: str, drive: Drive, scenario: Scenario, table: pd.DataFrame, run: RunConfig
) -> None:
    """The trace as `stem`.mcap, its recording as `stem`.rrd."""
    write_trace(folder / f"{stem}.mcap", drive.trace, scenario, internals=run.internals)
    if run.recording:
        from replay.recording import write_recording

        write_recording(folder / f"{stem}.rrd", drive, scenario, table)


def _publish(partial: Path, out: Path, result: LogResult) -> None:
    card = {"log": result.name, "source": result.source, "sha256": result.digest, "tags": result.tags}
    write_json(partial / LOG_CARD, card)
    partial.rename(out / result.folder)


def _record(drive: Drive, files: tuple[str, ...]) -> DriveRecord:
    trace = drive.trace
    return DriveRecord(
        log=trace.scenario,
        planner=trace.planner,
        mode=trace.mode.value,
        oracle=trace.oracle,
        end=trace.end.value,
        detail=trace.detail,
        t_end_s=float(trace.ego.t[-1]),
        notes=trace.notes,
        files=files,
    )


def _timings(drive: Drive) -> pd.DataFrame:
    table = pd.DataFrame([asdict(stage) for stage in drive.timings], columns=["t", "stage", "seconds"])
    table = table.rename(columns={"t": "t_s"})
    table[["log", "planner", "mode"]] = [drive.trace.scenario, drive.trace.planner, drive.trace.mode.value]
    return table[TIMING_COLUMNS]


def _series(drive: Drive, scenario: Scenario, measures: Mapping[str, Metric]) -> pd.DataFrame:
    table = metrics.series(drive.trace, scenario, metrics=measures)
    table.insert(0, "planner", drive.trace.planner)
    table.insert(1, "mode", drive.trace.mode.value)
    return table
