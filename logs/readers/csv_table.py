"""Loads CSV and Parquet tables, and SUMO's floating car data (XML), as pandas frames, and refuses
rows that do not fit the header.

The columns of a CSV file are separated by commas, semicolons, tabs, or (if the header has none of
these) spaces; the first three may be followed by spaces. With all but the comma, numbers may have
decimal commas. The header is the first line that does not begin with "#". If that line holds only
numbers, the header is the last "#" line before it that has as many names, as numpy.savetxt writes
it. Other "#" lines are comments.

An empty last field of the header or of the rows belongs to a separator at the end of the line, and
is left out. Any other row whose number of fields is not that of the header is refused.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, TextIO

import pandas as pd

from replan.core.errors import LogError
from replan.core.files import read_xml

SUFFIXES = (".csv", ".parquet")
FCD_SUFFIX, FCD_ROOT = ".xml", "fcd-export"
"""Floating car data of SUMO: `<timestep time="..."><vehicle id="..." x="..." .../></timestep>`."""
FCD_BEGIN = 1 << 14
"""Number of bytes in which the root of an XML file stands."""
SEPARATORS = (",", ";", "\t")
_NUMBER = r"\s*[-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?\s*"
FIRST_LINE = 1024**2
"""Number of characters of the first line that are searched for the separator."""
WRITE_NAMES = "write the names of the columns in the first line"


class _Layout(NamedTuple):
    """Names of the columns, their separator, the lines that are no rows (from 0), and whether rows
    end in one.
    """

    names: list[str]
    mark: str
    skipped: list[int]
    is_longer: bool


def load_table(path: Path) -> pd.DataFrame:
    """Load a table, without spaces around values and names; LogError if its rows do not fit its
    header.
    """
    import pyarrow as pa

    try:
        if path.suffix == ".parquet":
            return pd.read_parquet(path)
        if path.suffix == FCD_SUFFIX:
            return _floating_car_data(path)
        layout = _layout(path)
        names = [*layout.names, *(["(trailing)"] if layout.is_longer else [])]
        table = pd.read_csv(
            path,
            sep=r"\s+" if layout.mark == " " else layout.mark,
            encoding="utf-8-sig",
            header=None,
            names=names,
            skiprows=layout.skipped,
            index_col=False,
            skipinitialspace=True,
            low_memory=False,
        )
        table = table[layout.names]
        for name in table.columns:
            if table[name].dtype.kind in "OTU" or isinstance(table[name].dtype, pd.StringDtype):
                table[name] = (
                    table[name].str.strip() if layout.mark == "," else _decimals(table[name])
                )
        return table
    except UnicodeDecodeError as error:
        raise LogError(
            f"the table is no UTF-8: {error}", topic=path.name, remedy="write it as UTF-8"
        ) from None
    except (
        OSError,
        ValueError,
        LookupError,
        TypeError,
        csv.Error,
        pa.ArrowException,
        OverflowError,
    ) as error:
        problem = " ".join(str(error).split())[:200]
        raise LogError(
            f"the table cannot be read: {problem}", topic=path.name, remedy="write it again"
        ) from None


def header_of(path: Path) -> list[str]:
    """Return the names of a table's columns; empty if the file has none or cannot be read."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        if path.suffix == ".parquet":
            return list(pq.read_schema(path).names)
        if path.suffix == FCD_SUFFIX:
            return list(FCD_COLUMNS) if is_floating_car_data(path) else []
        with path.open(encoding="utf-8-sig", newline="") as stream:
            return _header(stream, path.name)[0]
    except (OSError, ValueError, csv.Error, pa.ArrowException, LogError):
        return []


FCD_COLUMNS = ("timestep_time", *(f"vehicle_{name}" for name in ("id", "x", "y", "angle", "speed")))
"""Columns of floating car data that are always there, as SUMO's xml2csv names them."""


def is_floating_car_data(path: Path) -> bool:
    """Return whether a file is SUMO's floating car data; OSError if it cannot be read."""
    with path.open("rb") as stream:
        return path.suffix == FCD_SUFFIX and f"<{FCD_ROOT}".encode() in stream.read(FCD_BEGIN)


def _floating_car_data(path: Path) -> pd.DataFrame:
    """Load floating car data as SUMO's xml2csv would: a row for each vehicle or person and time."""
    rows = list[dict[str, str]]()
    for timestep in read_xml(path).iter("timestep"):
        for element in timestep:
            row = {f"vehicle_{name}": value for name, value in element.attrib.items()}
            if element.tag == "person":
                row["vehicle_type"] = "pedestrian"
            rows.append({"timestep_time": timestep.get("time", ""), **row})
    table = pd.DataFrame(rows, columns=None if rows else list(FCD_COLUMNS))
    for name in table.columns:
        if name not in ("vehicle_id", "vehicle_type", "vehicle_lane"):
            table[name] = pd.to_numeric(table[name], errors="coerce")
    return table


def _decimals(column: pd.Series[Any]) -> pd.Series[Any]:
    """Return a column of texts without spaces around, and with decimal points if all are
    numbers.
    """
    words = column.dropna().astype(str)
    if words.str.fullmatch(_NUMBER).all() and words.str.contains(",", regex=False).any():
        return pd.to_numeric(column.astype(str).str.replace(",", ".", regex=False))
    return column.str.strip()


def _fields(stream: TextIO, mark: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the number of each line that is not blank (from 0) and its fields."""
    if mark == " ":
        yield from ((k, line.split()) for k, line in enumerate(stream) if line.strip())
        return
    rows = csv.reader(stream, delimiter=mark, skipinitialspace=True)
    yield from (
        (rows.line_num - 1, row) for row in rows if len(row) > 1 or (row and row[0].strip())
    )


def _split(line: str) -> tuple[str, list[str]]:
    parts = {
        mark: next(csv.reader([line], delimiter=mark, skipinitialspace=True), [])
        for mark in SEPARATORS
    }
    mark = max(SEPARATORS, key=lambda each: len(parts[each]))
    if len(parts[mark]) < 2 and len(line.split()) > 1:
        return " ", line.split()
    return mark, [name.strip() for name in parts[mark]]


def _header(stream: TextIO, topic: str) -> tuple[list[str], str, int]:
    """Return the names of the columns, their separator, and the number of the first row's line, or
    later.
    """
    above: list[str] = []
    for k, line in enumerate(iter(lambda: stream.readline(FIRST_LINE), "")):
        if not line.strip():
            continue
        if line.lstrip().startswith("#"):
            above.append(line.lstrip().lstrip("#").strip())
            continue
        mark, names = _split(line.rstrip("\r\n"))
        are_numbers = [re.fullmatch(_NUMBER, name) is not None for name in names if name]
        if any(are_numbers):
            for sign, fields in map(_split, reversed(above)):
                row = next(_fields(io.StringIO(line), sign))[1]
                if len(row) - (not row[-1].strip()) == len(fields) - (not fields[-1]):
                    return fields, sign, k
            if all(are_numbers):
                problem = f"there is no header: the first line is {', '.join(names[:6])}"[:120]
                raise LogError(problem, topic=topic, remedy=WRITE_NAMES)
        return names, mark, k + 1
    raise LogError("the table has no header", topic=topic, remedy=WRITE_NAMES)


def _layout(path: Path) -> _Layout:
    """Find the layout of a CSV file, and check that its rows have as many fields as its header."""
    with path.open(encoding="utf-8-sig", newline="") as stream:
        names, mark, begin = _header(stream, path.name)
        stream.seek(0)
        count, skipped, is_longer = len(names), list(range(begin)), False
        for line, row in _fields(stream, mark):
            if line < begin:
                continue
            if row[0].startswith("#") and len(row) != count:
                skipped.append(line)
                continue
            more, less = (
                len(row) == count + 1 and not row[-1].strip(),
                len(row) == count - 1 and not names[-1],
            )
            is_longer = is_longer or more
            if len(row) != count and not (more or less):
                problem = f"rows have {len(row)} fields, the header {count}: line {line + 1}"
                remedy = "write as many values as names; texts that hold the separator need quotes"
                raise LogError(problem, topic=path.name, remedy=remedy)
    twice = sorted({name for name in names if name and names.count(name) > 1})
    if twice:
        raise LogError(
            f"two columns are called {twice[0]}", topic=path.name, remedy="rename one of them"
        )
    names = [name or f"Unnamed: {k}" for k, name in enumerate(names)]  # as pandas names them
    return _Layout(names, mark, skipped, is_longer)
