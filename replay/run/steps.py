"""frames.parquet while the drives of a log are measured: what is long waits in a file until all metrics are there.

The table is sorted by planner, loop and metric, the metrics are measured in another order; of an hour they take half a
gigabyte. They are written in groups of `GROUP_ROWS` rows, which depend on nothing but the values.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import SpooledTemporaryFile

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from logs.errors import writing
from logs.kernel import FloatArray
from metrics import Series
from replay.results.schema import SCHEMA_VERSION, arrow
from replay.results.tables import write_file

NAME = "frames.parquet"
SPOOL_BYTES = 16 * 2**20
"""The greatest number of bytes of steps in memory; more wait in the file."""
GROUP_ROWS = 1 << 18
"""Rows that are in memory at once, and that a reader of a part takes at least."""


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
        self._path = folder / NAME
        with writing(self._path):
            self._file = SpooledTemporaryFile(SPOOL_BYTES, dir=str(folder))  # noqa: SIM115  it is closed with this
        self._drives: dict[tuple[str, str], tuple[Steps, ...]] = {}

    def put(self, metric: str, series: Series) -> Steps:
        """Where a metric's steps are from now on."""
        with writing(self._path):
            begin = self._file.seek(0, 2)
            self._file.write(series.t.tobytes())
            self._file.write(series.value.tobytes())
        return Steps(metric, begin, len(series.t))

    def add(self, planner: str, mode: str, steps: tuple[Steps, ...]) -> None:
        """A drive has been measured: these are its metrics."""
        self._drives[planner, mode] = tuple(sorted(steps, key=lambda one: one.metric))

    def table(self, some: Sequence[Steps]) -> pd.DataFrame:
        """Some of the metrics of a drive, as `metrics.series` has them."""
        curves = [(steps.metric, *self._taken(steps)) for steps in some]
        parts = [pd.DataFrame({"t_s": t, "metric": metric, "value": value}) for metric, t, value in curves]
        return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=["t_s", "metric", "value"])

    def _taken(self, steps: Steps) -> tuple[FloatArray, FloatArray]:
        """Times and values `(n,)` of a metric."""
        self._file.seek(steps.begin)
        both = np.frombuffer(self._file.read(16 * steps.rows))
        return both[: steps.rows], both[steps.rows :]

    def write(self) -> None:
        """The table of all drives that were added, where there is one."""
        if self._drives:
            write_file(self._path, self._write)

    def close(self) -> None:
        """The file goes; whether the rest of it could be written no longer matters."""
        with suppress(OSError):
            self._file.close()

    def _write(self, partial: Path) -> None:
        columns = ["planner", "mode", "t_s", "metric", "value"]
        schema = arrow(NAME, pd.DataFrame(columns=columns)).schema
        schema = schema.with_metadata({"replan_schema_version": str(SCHEMA_VERSION)})
        waiting, rows = list[pa.Table](), 0
        with pq.ParquetWriter(partial, schema, compression="zstd") as writer:
            for planner, mode in sorted(self._drives):
                for steps in self._drives[planner, mode]:
                    waiting.append(self._table(planner, mode, steps, schema))
                    rows += steps.rows
                    if rows >= GROUP_ROWS:
                        writer.write_table(pa.concat_tables(waiting))
                        waiting, rows = [], 0
            if waiting or not any(self._drives.values()):
                writer.write_table(pa.concat_tables([schema.empty_table(), *waiting]))

    def _table(self, planner: str, mode: str, steps: Steps, schema: pa.Schema) -> pa.Table:
        t, value = self._taken(steps)
        words = (pa.repeat(pa.scalar(word, schema.field(0).type), steps.rows) for word in (planner, mode, steps.metric))
        named = dict(zip(("planner", "mode", "metric"), words, strict=True))
        numbers = {"t_s": pa.array(t, from_pandas=True), "value": pa.array(value, from_pandas=True)}
        return pa.table({**named, **numbers}, schema=schema)
