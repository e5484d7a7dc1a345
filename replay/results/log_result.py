"""What came of one log, in memory and in the log's folder: `log.json`, `metrics.parquet` and `timings.parquet`.

A folder is there only when all of it is (it is renamed from a temporary name), so that a run that was interrupted can
take it as it stands. The tables of a run are always made of tables read back from the folders: whether a log was
evaluated just now or before an interruption makes no difference to a byte of them.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from math import nan
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from replay.results.schema import SCHEMA_VERSION
from replay.results.tables import LOG_CARD, write_json, write_parquet

METRICS, MEMBERS, HEALTH, TIMINGS = "metrics.parquet", "ensemble.parquet", "health.parquet", "timings.parquet"


@dataclass(frozen=True)
class Failure:
    """A log, or a drive of it, that could not be evaluated.

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
        family: Of the scenario (`Scenario.family`); `dataset` likewise.
        tags: Of the scenario.
        notes: What was assumed in reading it.
        drives: What was driven, planners in the order of the run, open before closed.
        failures: What was not.
        seconds: How long it took, for people to read; in no file; NaN where it was there already.
        stopped: Why it could not be written, and with it the run; empty: it was.
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
    """What a log's results depend on beside the configuration.

    Attributes:
        replan: Version.
        code: Hash of the source of replan and of the user's planners and metrics.
    """

    replan: str
    code: str


def keep(folder: Path, result: LogResult, tables: LogTables, identity: str, stamp: Stamp) -> None:
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
    card = {
        "log": result.name,
        "source": result.source,
        "sha256": result.digest,
        "family": result.family,
        "dataset": result.dataset,
        "tags": result.tags,
        "notes": result.notes,
        "drives": [asdict(drive) for drive in result.drives],
        "failures": [asdict(failure) for failure in result.failures],
        "input": identity,
        **asdict(stamp),
    }
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
    files = [(result, out / result.folder / name) for result in results if result.folder]
    tables = [_named(pq.read_table(file), result.name) for result, file in files if file.exists()]
    tables = [table for table in tables if len(table)]
    return pa.concat_tables(tables, promote_options="permissive").to_pandas() if tables else pd.DataFrame()


def _named(table: pa.Table, log: str) -> pa.Table:
    place = table.schema.get_field_index("log")
    field = table.schema.field(place)
    return table.set_column(place, field, pa.repeat(pa.scalar(log, field.type), len(table)))


def timings_of(out: Path, result: LogResult) -> pd.DataFrame:
    """The timings of a log, from its folder in `out`, under the name that it has in the run."""
    return pd.read_parquet(out / result.folder / TIMINGS).assign(log=result.name)
