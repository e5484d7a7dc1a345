"""The result of one log, in memory and in the log's folder: `log.json`, its tables, and the steps of its metrics.

A folder is there only when all of it is (it is renamed from a temporary name), so that a run that was interrupted can
take it as it stands. The tables of a run are always made of tables read back from the folders: whether a log was
evaluated just now or before an interruption makes no difference to a byte of them.

frames.parquet is sorted by planner, loop and metric; the metrics are measured in another order, and take half a
gigabyte of an hour. So they wait in a file (`StepsFile`) until all are there, and are written in groups of
`GROUP_ROWS` rows, which depend on nothing but the values.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from math import nan
from pathlib import Path
from tempfile import SpooledTemporaryFile
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from logs.errors import writing
from logs.kernel import FloatArray
from metrics import Series
from replay.results.schema import SCHEMA_VERSION, arrow
from replay.results.tables import LOG_CARD, write_file, write_json, write_parquet

METRICS, MEMBERS, HEALTH, TIMINGS = "metrics.parquet", "ensemble.parquet", "health.parquet", "timings.parquet"
FRAMES = "frames.parquet"
SPOOL_BYTES = 16 * 2**20
"""The greatest number of bytes of steps in memory; more wait in the file."""
GROUP_ROWS = 1 << 18
"""Rows that are in memory at once, and that a reader of a part takes at least."""


@dataclass(frozen=True)
class Failure:
    """A log, or a drive of it, that could not be evaluated.

    Attributes:
        log: Label or name of the log.
        message: One line that names the thing, the place and the remedy.
        planner: None: the log itself.
        mode: None: before any loop.
        exit_code: The exit code that it causes.
        traceback: Traceback of a bug; empty for an error that the user can correct.
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
    """The result of one log.

    Attributes:
        source: Label of the log: the path as given, or the family's name.
        name: Of the scenario; the source's label where it could not be read.
        digest: SHA-256 of the log's bytes; empty where it could not be read.
        folder: Its folder's name in the result folder; empty where there is none.
        family: Of the scenario (`Scenario.family`); `dataset` likewise.
        tags: Of the scenario.
        notes: What was assumed in reading it.
        drives: What was driven, planners in the order of the run, open before closed.
        failures: What could not be driven.
        seconds: How long it took; for display, in no file; NaN if it was taken from an earlier run.
        stopped: Why the result, and so the run, could not be written; empty if it was.
    """

    source: str
    name: str
    digest: str = ""
    folder: str = ""
    family: str = ""
    dataset: str = ""
    tags: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    drives: tuple[DriveRecord, ...] = ()
    failures: tuple[Failure, ...] = ()
    seconds: float = nan
    stopped: str = ""

    def record(self) -> dict[str, Any]:
        """As summary.json and log.json have it, without its failures."""
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
    """The tables of one log; they are in its folder only, so that a run over many logs holds none of them.

    Attributes:
        metrics: Rows of `metrics.evaluate`.
        members: Rows of `metrics.evaluate` of the ensemble's drives, with `MEMBER` and `PERTURBATION`; mostly empty.
        health: Rows of `metrics.health.table`: what is wrong with the log.
        timings: Rows of timings.parquet.
    """

    metrics: pd.DataFrame
    members: pd.DataFrame
    health: pd.DataFrame
    timings: pd.DataFrame


@dataclass(frozen=True)
class Stamp:
    """What the results of a log depend on besides the configuration.

    Attributes:
        replan: Version.
        code: Hash of the source of replan and of the user's planners and metrics.
    """

    replan: str
    code: str


def write_result(folder: Path, result: LogResult, tables: LogTables, identity: str, stamp: Stamp) -> None:
    """Write a result into its (still unfinished) folder.

    Args:
        folder: Where the drives' files are already.
        result: What is kept.
        tables: Likewise.
        identity: Which input it came from (`LogSource.identity`).
        stamp: What it depends on.
    """
    write_parquet(folder / METRICS, tables.metrics)
    write_parquet(folder / TIMINGS, tables.timings)
    write_parquet(folder / HEALTH, tables.health)
    if len(tables.members):
        write_parquet(folder / MEMBERS, tables.members)
    card = {key: value for key, value in result.record().items() if key != "folder"}
    card |= {"failures": [asdict(failure) for failure in result.failures], "input": identity, **asdict(stamp)}
    write_json(folder / LOG_CARD, card)


def load_result(folder: Path) -> tuple[LogResult, str, Stamp] | None:
    """Read the result in a log's folder, its input and its stamp; None where the folder is not whole."""
    try:
        card: dict[str, Any] = json.loads((folder / LOG_CARD).read_text(encoding="utf-8"))
        if card["schema_version"] != SCHEMA_VERSION:
            return None
        result = LogResult(
            card["source"],
            card["log"],
            card["sha256"],
            folder.name,
            card["family"],
            card["dataset"],
            tuple(card["tags"]),
            tuple(card["notes"]),
            tuple(
                DriveRecord(**{**drive, "notes": tuple(drive["notes"]), "files": tuple(drive["files"])})
                for drive in card["drives"]
            ),
            tuple(Failure(**failure) for failure in card["failures"]),
        )
        files = [folder.parent / file for drive in result.drives for file in drive.files]
        whole = all(file.is_file() for file in (*files, folder / TIMINGS))
        stamp = Stamp(card["replan"], card["code"])
        for name in (METRICS, HEALTH, *([MEMBERS] if (folder / MEMBERS).exists() else [])):
            pq.read_table(folder / name)
        return (result, card["input"], stamp) if whole else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def table_of(out: Path, results: Iterable[LogResult], name: str) -> pd.DataFrame:
    """A table of all logs, from their folders in `out`, under the names that they have in the run; empty: of none."""
    tables: list[pa.Table] = []
    for result in results:
        file = out / result.folder / name
        if result.folder and file.exists() and len(table := pq.read_table(file)):
            place = table.schema.get_field_index("log")
            field = table.schema.field(place)
            tables.append(table.set_column(place, field, pa.repeat(pa.scalar(result.name, field.type), len(table))))
    return pa.concat_tables(tables, promote_options="permissive").to_pandas() if tables else pd.DataFrame()


def timings_of(out: Path, result: LogResult) -> pd.DataFrame:
    """The timings of a log, from its folder in `out`, under the name that it has in the run."""
    return pd.read_parquet(out / result.folder / TIMINGS).assign(log=result.name)


@dataclass(frozen=True)
class Steps:
    """One metric of one drive: its name, and where its times and values are in the file."""

    metric: str
    begin: int
    rows: int


class StepsFile:
    """The steps so far.

    Args:
        folder: Of the log, still unfinished.

    Raises:
        OutputError: As any method: the file cannot be written.
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
        parts = [pd.DataFrame({"t_s": t, "metric": metric, "value": value}) for metric, t, value in curves]
        return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=["t_s", "metric", "value"])

    def _samples_of(self, steps: Steps) -> tuple[FloatArray, FloatArray]:
        """Times and values `(n,)` of a metric."""
        self._file.seek(steps.begin)
        both = np.frombuffer(self._file.read(16 * steps.rows))
        return both[: steps.rows], both[steps.rows :]

    def write(self) -> None:
        """The table of all drives that were added, where there is one."""
        if self._drives:
            write_file(self._path, self._write)

    def close(self) -> None:
        """Remove the file; whether the rest of it could be written no longer matters."""
        with suppress(OSError):
            self._file.close()

    def _write(self, partial: Path) -> None:
        columns = ["planner", "mode", "t_s", "metric", "value"]
        schema = arrow(FRAMES, pd.DataFrame(columns=columns)).schema
        schema = schema.with_metadata({"replan_schema_version": str(SCHEMA_VERSION)})
        waiting, rows = list[pa.Table](), 0
        with pq.ParquetWriter(partial, schema, compression="zstd") as writer:
            for planner, mode in sorted(self._drives):
                for steps in self._drives[planner, mode]:
                    t, value = self._samples_of(steps)
                    kind, text = schema.field(0).type, {"planner": planner, "mode": mode, "metric": steps.metric}
                    words = {key: pa.repeat(pa.scalar(word, kind), steps.rows) for key, word in text.items()}
                    numbers = {"t_s": pa.array(t, from_pandas=True), "value": pa.array(value, from_pandas=True)}
                    waiting.append(pa.table({**words, **numbers}, schema=schema))
                    rows += steps.rows
                    if rows >= GROUP_ROWS:
                        writer.write_table(pa.concat_tables(waiting))
                        waiting, rows = [], 0
            if waiting or not any(self._drives.values()):
                writer.write_table(pa.concat_tables([schema.empty_table(), *waiting]))
