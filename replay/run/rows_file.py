"""Tables that a command writes into a file of the user's: CSV, Parquet or JSON, by the suffix."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from logs.errors import ConfigError
from replay.results.tables import write_file
from replay.run.claim import claimed_file

WRITERS: Mapping[str, Callable[[pd.DataFrame, Path], object]] = {
    ".csv": lambda table, path: table.to_csv(path, index=False, lineterminator="\n"),
    ".parquet": lambda table, path: table.to_parquet(path, index=False),
    ".json": lambda table, path: path.write_text(
        (table.to_json(orient="records", indent=2, double_precision=15) or "[]") + "\n", encoding="utf-8"
    ),
}
"""Functions that write rows, by the suffix of the file."""


@contextmanager
def rows_file(path: Path) -> Iterator[Callable[[pd.DataFrame], None]]:
    """The function that writes rows as .csv, .parquet or .json, by the suffix of a claimed file.

    An earlier file is replaced if it has the same columns.
    ConfigError if the file must not be written; OutputError if it cannot be written.
    """
    with claimed_file(path, tuple(WRITERS), lambda file: True) as file:

        def write(table: pd.DataFrame) -> None:
            if file.exists() and _columns_of(file) != table.columns.tolist():
                raise ConfigError(f"{file}: exists, and has other columns; name another file")
            write_file(file, lambda partial: WRITERS[file.suffix](table, partial))

        yield write


def _columns_of(file: Path) -> list[str] | None:
    """The columns of a file of rows; None if it is none."""
    try:
        if file.suffix == ".parquet":
            return list(pq.read_schema(file).names)
        if file.suffix == ".csv":
            return pd.read_csv(file, nrows=0).columns.tolist()
        rows = json.loads(file.read_text(encoding="utf-8"))
        return list(rows[0])
    except (OSError, ValueError, LookupError, TypeError, RecursionError, pa.ArrowException):
        return None
