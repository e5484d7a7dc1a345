"""What came of one log, in memory and in the log's folder: `log.json`, `metrics.parquet` and `timings.parquet`.

A folder is there only when all of it is (it is renamed from a temporary name), so that a run that was interrupted can
take it as it stands. The tables of a run are always made of tables read back from the folders: whether a log was
evaluated just now or before an interruption makes no difference to a byte of them.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, replace
from math import nan
from pathlib import Path
from typing import Any

import pandas as pd

from replay.batch.schema import SCHEMA_VERSION
from replay.batch.sources import LOG_CARD
from replay.batch.tables import KEYS, joined, write_json, write_parquet

MEMBERS = "ensemble.parquet"


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
        family: Of the scenario (`Scenario.family`); `dataset` likewise.
        tags: Of the scenario.
        notes: What was assumed in reading it.
        drives: What was driven, planners in the order of the run, open before closed.
        failures: What was not.
        table: Rows of `metrics.evaluate`.
        health: Rows of `metrics.health.table`: what is wrong with the log.
        seconds: How long it took, for people to read; in no file; NaN where it was there already.
        stopped: Why it could not be written, and with it the run; empty: it was.
        members: Rows of `metrics.evaluate` of the ensemble's drives, with `metrics.ensemble`'s columns; mostly empty.
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
    table: pd.DataFrame = field(default_factory=pd.DataFrame)
    members: pd.DataFrame = field(default_factory=pd.DataFrame)
    health: pd.DataFrame = field(default_factory=pd.DataFrame)
    seconds: float = nan
    stopped: str = ""


@dataclass(frozen=True)
class Stamp:
    """What a log's results depend on beside the configuration.

    Attributes:
        replan: Version.
        code: Hash of the source of replan and of the user's planners and metrics.
    """

    replan: str
    code: str


def keep(folder: Path, result: LogResult, timings: pd.DataFrame, identity: str, stamp: Stamp) -> LogResult:
    """Write a result into its (still unfinished) folder; returns it with its tables as they will be read back.

    The timings stay in the folder: they are by far the largest table, and are not asked for before the end.

    Args:
        folder: Where the drives' files are already.
        result: What is kept.
        timings: Rows of timings.parquet.
        identity: Which input it came from (`LogSource.identity`).
        stamp: What it depends on.
    """
    write_parquet(folder / "metrics.parquet", result.table)
    write_parquet(folder / "timings.parquet", timings)
    write_parquet(folder / "health.parquet", result.health)
    if len(result.members):
        write_parquet(folder / MEMBERS, result.members)
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
    return _with_tables(folder, result)


def kept(folder: Path) -> tuple[LogResult, str, Stamp] | None:
    """The result in a log's folder, its input and what it depends on; None where it is not whole."""
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
            tuple(_drive(drive) for drive in card["drives"]),
            tuple(Failure(**failure) for failure in card["failures"]),
        )
        files = [folder.parent / file for drive in result.drives for file in drive.files]
        whole = all(file.is_file() for file in (*files, folder / "timings.parquet"))
        stamp = Stamp(card["replan"], card["code"])
        return (_with_tables(folder, result), card["input"], stamp) if whole else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _drive(card: dict[str, Any]) -> DriveRecord:
    return DriveRecord(**{**card, "notes": tuple(card["notes"]), "files": tuple(card["files"])})


def _with_tables(folder: Path, result: LogResult) -> LogResult:
    table = pd.read_parquet(folder / "metrics.parquet")
    members = pd.read_parquet(folder / MEMBERS) if (folder / MEMBERS).exists() else pd.DataFrame()
    health = pd.read_parquet(folder / "health.parquet")
    return replace(result, table=joined([table], KEYS), members=members, health=health)


def timings_of(out: Path, result: LogResult) -> pd.DataFrame:
    """The timings of a log, from its folder in `out`, under the name that it has in the run."""
    return pd.read_parquet(out / result.folder / "timings.parquet").assign(log=result.name)
