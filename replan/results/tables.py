"""The tables and files of a run, and the folder that they are in.

    OUT/metrics.parquet, .csv   one row per log, planner, mode and metric reduction     the same for the same inputs
    OUT/verdicts.parquet        one row per gate, log, planner and mode: the outcome on this log    likewise
    OUT/groups.parquet          one row per group of logs, planner, mode and metric: mean, median, worst   likewise
    OUT/timings.parquet         log, planner, mode, t_s, stage, seconds                 not the same twice
    OUT/summary.json            outcome, gates, drives, failures
    OUT/report.md, junit.xml    the reports, by `replan evaluate` and `replan report`
    OUT/run.toml                the resolved configuration, and the logs with their digests
    OUT/origin.json             the directory in which the run was started: where its logs are (`replan.run.output`)
    OUT/shard.json              only in a shard: its number and its run (`replan.run.shards`)
    OUT/LOG-HASH/               per log: open.mcap, open.rrd, closed.mcap, closed.rrd, frames.parquet, and what the
                                tables above are made of: metrics.parquet, timings.parquet, log.json; ensemble.parquet
                                (with several planners open.PLANNER.mcap and so on; log.mcap where the log was no MCAP)

`metrics.*`, `verdicts.*`, `groups.*` and `frames.parquet` contain no measured times, paths or machines, and are sorted:
two runs give the same bytes, with any number of workers and interruptions. Every file is written
under a temporary name and renamed.
"""  # noqa: E501

from __future__ import annotations

import errno
import json
import re
import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from hashlib import sha256
from itertools import chain, count
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from replan.config import HEADER
from replan.core.errors import ConfigError, writing
from replan.results.schema import METADATA, SCHEMA_VERSION, arrow, arrow_schema, names_of

PARTIAL = ".partial-"  # Prefix of the names of unfinished files and folders

# A file that replan puts beside the traces of a log: a log beside it is a result, not an input
LOG_CARD = "log.json"
OUTCOMES = {
    0: "pass",
    1: "fail",
    2: "configuration error",
    3: "not all could be evaluated",
    4: "inconclusive",
}
PNG_MARK = b"tEXtSoftware\0replan"  # The chunk of a PNG file that says who wrote it
LOCK = ".lock"  # The file by which a run locks its folder (`replan.run.output`)

SHARD_CARD = "shard.json"  # The file that identifies a shard of a run (`replan.run.shards`)

# The file with the directory in which the run was started (`replan.run.output`)
ORIGIN = "origin.json"

TABLES = (
    "metrics.parquet",
    "metrics.csv",
    "health.parquet",
    "verdicts.parquet",
    "groups.parquet",
    "timings.parquet",
    "summary.json",
    SHARD_CARD,
    "run.toml",
    ORIGIN,
)
REPORTS = ("report.md", "junit.xml", "report.html")
FILES = (*TABLES, *REPORTS)  # The files in a result folder beside the folders of the logs
KEYS = ["log", "planner", "mode", "metric"]
TIMING_COLUMNS = names_of("timings.parquet")
LONGEST_SAFE = 80  # Longest name of a file that is made of the name of a log, without the hash
DIGITS = 8  # Hexadecimal digits of a hash in a name


def safe_name(name: str, digest: str = "") -> str:
    """A folder or file name: letters, digits, dot, dash and underscore, at most 80, then `-` and 8
    of the digest.

    Without a digest, a longer name ends in 8 of the hash of the whole name, instead of its rest.
    """
    safe = re.sub(r"[^A-Za-z0-9._-]+", "_", name).strip("._") or "log"
    if not digest and len(safe) > LONGEST_SAFE:
        hashed = sha256(name.encode(errors="surrogatepass")).hexdigest()
        return f"{safe[: LONGEST_SAFE - DIGITS - 1]}-{hashed[:DIGITS]}"
    return f"{safe[:LONGEST_SAFE]}-{digest[:DIGITS]}" if digest else safe


def safe_names(names: Iterable[str]) -> dict[str, str]:
    """A `safe_name` for each of some names, no two equal: names that would be get a hash of the
    whole name.
    """
    names = list(dict.fromkeys(names))
    counts = Counter(safe_name(name).lower() for name in names)  # some file systems ignore case
    short = {name: safe_name(name) for name in names}
    return {
        name: safe
        if counts[safe.lower()] == 1
        else safe_name(name, sha256(name.encode(errors="surrogatepass")).hexdigest())
        for name, safe in short.items()
    }


def numbered(names: Iterable[str]) -> Iterator[str]:
    """The names, no two equal: one that was there before gets the first free number, from 2."""
    used: set[str] = set()
    for name in names:
        free = chain([name], (f"{name}-{number}" for number in count(2)))
        used.add(unused := next(label for label in free if label not in used))
        yield unused


def write_file(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` fill a temporary file beside `path`, then rename it: `path` is complete or
    missing (OutputError).
    """
    partial = path.with_name(f"{PARTIAL}{path.name}")
    try:
        with writing(path):
            write(partial)
            partial.replace(path)
    finally:
        # It is not there, or the folder has become read-only, which `writing` reports
        with suppress(OSError):
            partial.unlink()


def finish_folder(partial: Path, folder: Path) -> bool:
    """Rename a finished folder; False if `folder` is there: that of another log with the same
    content (OutputError).
    """
    with writing(folder):
        try:
            partial.rename(folder)
        except OSError as error:
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                raise
            return False
    return True


def write_folder(folder: Path, fill: Callable[[Path], object]) -> bool:
    """Let `fill` make a folder under a temporary name, which is then renamed.

    Returns and raises as `finish_folder`.
    """
    partial = folder.with_name(f"{PARTIAL}{folder.name}")
    try:
        with writing(folder):
            fill(partial)
        return finish_folder(partial, folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def write_png(path: Path, data: bytes) -> None:
    """Write a PNG file, completely or not at all, with `PNG_MARK` behind its first chunk (8 + 25
    bytes).
    """
    mark = (len(PNG_MARK) - 4).to_bytes(4) + PNG_MARK + crc32(PNG_MARK).to_bytes(4)
    write_file(path, lambda partial: partial.write_bytes(data[:33] + mark + data[33:]))


def write_text(path: Path, text: str) -> None:
    """Write `text` as UTF-8, completely or not at all; characters that it lacks are escaped."""
    data = text.encode("utf-8", "backslashreplace")
    write_file(path, lambda partial: partial.write_bytes(data))


def write_parquet(path: Path, table: pd.DataFrame, file: str = "") -> None:
    """Write a table with its schema version; the same values give the same bytes.

    `file`: the name of its schema, if the file has another name.
    """
    typed = arrow(file or path.name, table).replace_schema_metadata(METADATA)
    write_file(path, lambda partial: pq.write_table(typed, partial, compression="zstd"))


def write_timings(path: Path, tables: Iterable[pd.DataFrame]) -> None:
    """Write the timings of one log after the other; only those of one log are in memory."""
    columns = arrow_schema("timings.parquet").with_metadata(METADATA)

    def write(partial: Path) -> None:
        with pq.ParquetWriter(partial, columns, compression="zstd") as writer:
            for table in tables:
                writer.write_table(pa.Table.from_pandas(table, columns, preserve_index=False))

    write_file(path, write)


def joined(
    tables: Iterable[pd.DataFrame], keys: Sequence[str], columns: Sequence[str] = ()
) -> pd.DataFrame:
    """The rows of all tables, sorted by `keys` (stable); `columns` are those of an empty result."""
    parts = [table for table in tables if len(table)]
    if not parts:
        return pd.DataFrame(columns=list(columns or keys))
    return pd.concat(parts, ignore_index=True).sort_values(
        list(keys), kind="stable", ignore_index=True
    )


FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""Texts that begin with these are formulas for spreadsheets, if they are not numbers."""


def is_formula(value: object) -> bool:
    """Whether a spreadsheet would calculate a cell of CSV with this value."""
    if not isinstance(value, str) or not value.startswith(FORMULA):
        return False
    try:
        float(value)
    except ValueError:
        return True
    return False


def csv_cell(value: object) -> object:
    """The value of a cell of CSV; an apostrophe makes a text of a formula (`is_formula`)."""
    return f"'{value}" if is_formula(value) else value


def csv_text(table: pd.DataFrame, path: Path, **options: Any) -> None:
    """Write a table as CSV with cells of `csv_cell`; options as of `DataFrame.to_csv`."""
    texts = table.copy(deep=False)
    for name in texts.columns[[not pd.api.types.is_numeric_dtype(kind) for kind in texts.dtypes]]:
        formulas = texts[name].map(is_formula).to_numpy(np.bool_)
        if formulas.any():
            texts[name] = texts[name].mask(formulas, "'" + texts[name].astype(str))
    texts.to_csv(path, index=False, lineterminator="\n", **options)


def write_csv(path: Path, table: pd.DataFrame, **options: Any) -> None:
    """Write a table as CSV (`csv_text`), completely or not at all."""
    write_file(path, lambda partial: csv_text(table, partial, **options))


def write_metrics(out: Path, table: pd.DataFrame) -> None:
    """Write metrics.parquet and metrics.csv; the schema version is their first column."""
    table = table.copy()
    table.insert(0, "schema_version", SCHEMA_VERSION)
    write_parquet(out / "metrics.parquet", table)
    write_csv(out / "metrics.csv", table)


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write JSON with the schema version first; NaN raises ValueError."""
    text = json.dumps(
        {"schema_version": SCHEMA_VERSION, **content}, indent=2, ensure_ascii=False, allow_nan=False
    )
    write_text(path, text + "\n")


def next_free() -> Path:
    """Create the first of `results/run-001`, `results/run-002`, ... that does not exist.

    ConfigError if the folder cannot be created.
    """
    for number in count(1):
        folder = Path("results", f"run-{number:03d}")
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        except OSError as error:
            raise ConfigError(
                f"{folder}: cannot be the result folder: {error.strerror}; name one with --out"
            ) from None
        return folder
    raise AssertionError


def clear_partial(out: Path) -> None:
    """Remove unfinished files and folders."""
    for entry in out.glob(f"{PARTIAL}*"):
        shutil.rmtree(entry, ignore_errors=True) if entry.is_dir() else entry.unlink(
            missing_ok=True
        )


def is_ours(entry: Path) -> bool:
    """Whether a run wrote an entry of its folder."""
    if entry.name == "run.toml":
        return entry.read_text(encoding="utf-8", errors="replace").startswith(HEADER)
    if entry.is_dir():
        return entry.name.startswith(PARTIAL) or (entry / LOG_CARD).is_file()
    return entry.name.removeprefix(PARTIAL) in (*FILES, LOCK)
