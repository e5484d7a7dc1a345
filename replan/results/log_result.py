"""The result of one log, in memory and in the log's folder: `log.json`, its tables, and the steps
of its metrics.

A folder exists only when it is complete (it is renamed from a temporary name), so that a resumed
run can use it unchanged. The tables of a run are always made from tables that are read back from
the folders, so that they are the same, byte for byte, with and without an interruption.

frames.parquet is sorted by planner, loop and metric; the metrics are measured in another order, and
an hour takes half a gigabyte. So they are stored in a file (`StepsFile`) until all are complete,
and are written in groups of about `GROUP_ROWS` rows, which depend only on the values.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from math import nan
from pathlib import Path
from tempfile import SpooledTemporaryFile
from typing import Any

import msgspec
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from replan.core.arrays import FloatArray
from replan.core.errors import ReplanError, writing
from replan.metrics import Series
from replan.results.schema import (
    METADATA,
    FileName,
    Name,
    Place,
    arrow_schema,
    read_json,
    read_table,
)
from replan.results.tables import LOG_CARD, write_file, write_json, write_parquet

METRICS = "metrics.parquet"
MEMBERS = "ensemble.parquet"
HEALTH = "health.parquet"
TIMINGS = "timings.parquet"
FRAMES = "frames.parquet"
NOT_OF_A_LOG = ("schema_version",)  # Columns that the tables in a log's folder lack
# The largest number of bytes of steps in memory; more are stored in the file
SPOOL_BYTES = 16 * 2**20
# Number of rows that are in memory at once, and the least that a reader of a part reads
GROUP_ROWS = 1 << 18


@dataclass(frozen=True)
class Failure:
    """A log, or a drive of it, that could not be evaluated."""

    log: str
    message: str  # One line that names the subject, the place and the remedy
    planner: str | None = None  # The planner; None for the log itself
    mode: str | None = None  # The loop; None if it failed before any loop
    exit_code: int = 3  # The exit code that it causes
    traceback: str = ""  # Traceback of a bug; empty for an error that the user can correct

    @property
    def line(self) -> str:
        """The message, with planner and loop if they are known."""
        return (
            f"{self.message} [{self.planner}, {self.mode} loop]" if self.planner else self.message
        )


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
    files: tuple[FileName, ...]
    marks: tuple[str, ...] = ()


class LogCard(msgspec.Struct, kw_only=True):
    """A log in summary.json, as `LogResult.record`."""

    log: str
    source: Place
    sha256: str
    folder: Name = ""
    family: str = ""
    dataset: str = ""
    tags: tuple[str, ...]
    notes: tuple[str, ...]
    drives: tuple[DriveRecord, ...]


class LogFileCard(LogCard, kw_only=True):
    """The contents of log.json."""

    failures: tuple[Failure, ...]
    input: str
    replan: str
    code: str


@dataclass(frozen=True, eq=False)
class LogResult:
    """The result of one log."""

    source: str  # Label of the log: the path as given, or the family's name
    name: str  # Name of the scenario; the label of the source if it could not be read
    digest: str = ""  # SHA-256 of the log's bytes; empty if it could not be read
    folder: str = ""  # Name of its folder in the result folder; empty if there is none
    family: str = ""  # Family of the scenario (`Scenario.family`); `dataset` likewise
    dataset: str = ""
    tags: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()  # Assumptions that were made when it was read
    # The drives, planners in the order of the run, open before closed loop
    drives: tuple[DriveRecord, ...] = ()
    failures: tuple[Failure, ...] = ()  # Drives that failed
    # How long the evaluation took, for display only; NaN if the result is from an earlier run
    seconds: float = nan
    # The reason why the result could not be written, which stops the run; empty if it was written
    stopped: str = ""
    # Whether the folder is that of another log of the run with the same content; this one was not
    # driven
    twin: bool = False

    def record(self) -> dict[str, Any]:
        """The record in summary.json and log.json, without failures."""
        return {
            "log": self.name,
            "source": self.source,
            "sha256": self.digest,
            "folder": self.folder,
            "family": self.family,
            "dataset": self.dataset,
            "tags": self.tags,
            "notes": self.notes,
            "drives": [asdict(drive) for drive in self.drives],
        }


@dataclass(frozen=True, eq=False)
class LogTables:
    """The tables of one log.

    They are only in its folder, so that a run over many logs keeps none of them in memory.
    """

    metrics: pd.DataFrame  # Rows of `replan.metrics.evaluate`
    # Rows of `replan.metrics.evaluate` of the ensemble's drives, with `MEMBER` and `PERTURBATION`;
    # mostly empty
    members: pd.DataFrame
    health: pd.DataFrame  # Rows of `replan.metrics.health.table`: findings about the log
    timings: pd.DataFrame  # Rows of timings.parquet


@dataclass(frozen=True)
class Stamp:
    """Version and code, on which the results of a log depend besides the configuration."""

    replan: str
    code: str  # Hash of the source of replan and of the user's planners and metrics


def write_result(
    folder: Path, result: LogResult, tables: LogTables, identity: str, stamp: Stamp
) -> None:
    """Write a result into its (still unfinished) folder.

    `folder`: the folder, which already contains the files of the drives. `identity`: identity of
    the input (`LogSource.identity`).
    """
    write_parquet(folder / METRICS, tables.metrics)
    write_parquet(folder / TIMINGS, tables.timings)
    write_parquet(folder / HEALTH, tables.health)
    if len(tables.members):
        write_parquet(folder / MEMBERS, tables.members)
    card = {key: value for key, value in result.record().items() if key != "folder"}
    card |= {
        "failures": [asdict(failure) for failure in result.failures],
        "input": identity,
        **asdict(stamp),
    }
    write_json(folder / LOG_CARD, card)


def load_result(folder: Path) -> tuple[LogResult, str, Stamp] | None:
    """Read the result in a log's folder, its input and its stamp; None if the folder is not
    complete.
    """
    try:
        _, card = read_json(folder / LOG_CARD, LogFileCard)
        for name in (METRICS, HEALTH, *([MEMBERS] if (folder / MEMBERS).exists() else [])):
            read_table(folder / name, NOT_OF_A_LOG)
    except ReplanError:
        return None
    result = LogResult(
        card.source,
        card.log,
        card.sha256,
        folder.name,
        card.family,
        card.dataset,
        card.tags,
        card.notes,
        card.drives,
        card.failures,
    )
    files = [folder.parent / file for drive in result.drives for file in drive.files]
    whole = all(file.is_file() for file in (*files, folder / TIMINGS))
    return (result, card.input, Stamp(card.replan, card.code)) if whole else None


def table_of(out: Path, results: Iterable[LogResult], name: str) -> pd.DataFrame:
    """A table of all logs, from their folders in `out`, under their names in the run.

    Empty if no log has it.
    """
    tables: list[pa.Table] = []
    for result in results:
        file = out / result.folder / name
        if result.folder and file.exists() and len(table := read_table(file, NOT_OF_A_LOG)):
            place = table.schema.get_field_index("log")
            field = table.schema.field(place)
            tables.append(
                table.set_column(
                    place, field, pa.repeat(pa.scalar(result.name, field.type), len(table))
                )
            )
    return (
        pa.concat_tables(tables, promote_options="permissive").to_pandas()
        if tables
        else pd.DataFrame()
    )


def timings_of(out: Path, result: LogResult) -> pd.DataFrame:
    """The timings of a log, from its folder in `out`, under the name that it has in the run."""
    table: pd.DataFrame = read_table(out / result.folder / TIMINGS).to_pandas()
    return table.assign(log=result.name)


@dataclass(frozen=True)
class Steps:
    """One metric of one drive: its name, and the place of its times and values in the file."""

    metric: str
    begin: int
    rows: int


class StepsFile:
    """Stores the steps of metrics until all drives of a log are complete.

    OutputError if the file cannot be written; every method may raise it.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / FRAMES
        with writing(self._path):
            self._file = SpooledTemporaryFile(SPOOL_BYTES, dir=str(folder))  # noqa: SIM115  it is closed with this
        self._drives: dict[tuple[str, str], tuple[Steps, ...]] = {}

    def put(self, metric: str, series: Series) -> Steps:
        """Write a metric's steps, and return their place in the file."""
        with writing(self._path):
            begin = self._file.seek(0, 2)
            self._file.write(series.t.tobytes())
            self._file.write(series.value.tobytes())
        return Steps(metric, begin, len(series.t))

    def add(self, planner: str, mode: str, steps: tuple[Steps, ...]) -> None:
        """Add the metrics of a drive."""
        self._drives[planner, mode] = tuple(sorted(steps, key=lambda one: one.metric))

    def table(self, some: Sequence[Steps]) -> pd.DataFrame:
        """Some of the metrics of a drive, as `metrics.series` has them."""
        curves = [(steps.metric, *self._samples_of(steps)) for steps in some]
        parts = [
            pd.DataFrame({"t_s": t, "metric": metric, "value": value})
            for metric, t, value in curves
        ]
        return (
            pd.concat(parts, ignore_index=True)
            if parts
            else pd.DataFrame(columns=["t_s", "metric", "value"])
        )

    def _samples_of(self, steps: Steps) -> tuple[FloatArray, FloatArray]:
        """Times and values `(n,)` of a metric."""
        self._file.seek(steps.begin)
        both = np.frombuffer(self._file.read(16 * steps.rows))
        return both[: steps.rows], both[steps.rows :]

    def write(self) -> None:
        """Write the table of all drives that were added, if there are any."""
        if self._drives:
            write_file(self._path, self._write)

    def close(self) -> None:
        """Remove the temporary file; errors while its rest is written are ignored."""
        with suppress(OSError):
            self._file.close()

    def _write(self, partial: Path) -> None:
        schema = arrow_schema(FRAMES).with_metadata(METADATA)
        waiting, rows = list[pa.Table](), 0
        with pq.ParquetWriter(partial, schema, compression="zstd") as writer:
            for planner, mode in sorted(self._drives):
                for steps in self._drives[planner, mode]:
                    t, value = self._samples_of(steps)
                    kind, text = (
                        schema.field(0).type,
                        {"planner": planner, "mode": mode, "metric": steps.metric},
                    )
                    words = {
                        key: pa.repeat(pa.scalar(word, kind), steps.rows)
                        for key, word in text.items()
                    }
                    numbers = {
                        "t_s": pa.array(t, from_pandas=True),
                        "value": pa.array(value, from_pandas=True),
                    }
                    waiting.append(pa.table({**words, **numbers}, schema=schema))
                    rows += steps.rows
                    if rows >= GROUP_ROWS:
                        writer.write_table(pa.concat_tables(waiting))
                        waiting, rows = [], 0
            if waiting or not any(self._drives.values()):
                writer.write_table(pa.concat_tables([schema.empty_table(), *waiting]))
