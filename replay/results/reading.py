"""The one place where files of results are read: what passes here may be used without further checks.

Results may come from another person, or be damaged. A JSON file is checked against its type, a table against its schema
(`replay.results.schema`): version, columns, types, values that are missing or infinite, words that are none of the
known ones. Names of folders and files are plain names: nothing outside of the results is read or written.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Annotated, Any, NoReturn, TypeVar

import msgspec
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from logs.errors import ConfigError, LogError
from logs.files import check_regular
from metrics.judge.gates import Outcome
from replay.results.schema import SCHEMA_VERSION, TABLES, VERSION_KEY, is_of_kind, names_of, pa_type

AGAIN = "evaluate again"
WORDS: dict[str, Collection[str]] = {
    "mode": ("open", "closed", "reference", "both", ""),
    "direction": ("lower", "higher", "none"),
    "outcome": [one.value for one in Outcome],
}
"""The values of columns that have no others."""

Name = Annotated[str, msgspec.Meta(pattern=r"^(?:[A-Za-z0-9_-][A-Za-z0-9._-]*)?\Z")]
"""A plain name, as `replay.results.tables.safe_name` makes it; may be empty."""
FileName = Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9_-][A-Za-z0-9._-]*/[A-Za-z0-9_-][A-Za-z0-9._-]*\Z")]
"""The plain name of a file in a log's folder."""
Place = Annotated[str, msgspec.Meta(pattern=r"^[^\0]*\Z")]  # A path or URL


T = TypeVar("T")


def read_json(file: Path, kind: type[T], again: str = AGAIN) -> tuple[dict[str, Any], T]:
    """The contents of a JSON file, as they are and as a type.

    `kind`: the type of its contents, a Struct; further keys are allowed. ConfigError if it cannot be read, is of
    another version, or not of the type.
    """
    try:
        check_regular(file)
        content = file.read_bytes()
        found: Any = msgspec.json.decode(content)
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"{file}: cannot be read: {error}; {again}") from None
    version = found.get("schema_version") if isinstance(found, dict) else None
    if isinstance(version, int) and version != SCHEMA_VERSION:
        raise ConfigError(f"{file}: is of version {version}, this replan reads {SCHEMA_VERSION}; {again}")
    return checked(file, found, kind, again)


def checked(file: Path, found: Any, kind: type[T], again: str) -> tuple[dict[str, Any], T]:
    """Decoded JSON as it is and as a type; ConfigError as `read_json`."""
    if not isinstance(found, dict) or found.get("schema_version") != SCHEMA_VERSION:
        raise ConfigError(f"{file}: is no file of results; {again}")
    try:
        return found, msgspec.convert(found, kind)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{file}: is not as replan writes it: {error}; {again}") from None


def read_table(file: Path, without: Sequence[str] = (), again: str = AGAIN, *, words: Sequence[str] = ()) -> pa.Table:
    """A table, checked by the schema of its name; columns that the schema does not know are left out.

    `words`: columns of few different texts, which are read as dictionaries. LogError if it cannot be read, or is not as
    replan writes it; ConfigError if it is of another version.
    """
    check_regular(file)
    try:
        table = pq.read_table(file, partitioning=None, read_dictionary=list(words))
    except (OSError, ValueError, pa.ArrowException) as error:
        raise LogError(f"cannot be read: {error}", file=file, remedy=again) from None
    version = (table.schema.metadata or {}).get(VERSION_KEY.encode(), b"").decode("utf-8", "replace")
    if version != str(SCHEMA_VERSION):
        is_of = f"is of version {version}" if version else "has no version"
        raise ConfigError(f"{file}: {is_of}, this replan reads {SCHEMA_VERSION}; {again}")
    table = table.replace_schema_metadata(None)
    check_table(table, file, file.name, without, again)
    for at, column in enumerate(TABLES[file.name].columns):
        if column.name not in table.column_names and column.older is not None:
            table = table.add_column(at, column.name, pa.array([column.older] * len(table), pa_type(column.kind)))
    return table.select([name for name in names_of(file.name) if name in table.column_names])


def check_table(table: pa.Table, file: Path, name: str, without: Sequence[str] = (), again: str = AGAIN) -> None:
    """Raise LogError unless a table is as the schema of a file's name says; columns `without` may be missing."""

    def refuse(what: str) -> NoReturn:
        raise LogError(what, file=file, remedy=again)

    try:
        table.validate(full=True)
    except (ValueError, pa.ArrowException) as error:
        refuse(f"is damaged: {error}")
    for column in TABLES[name].columns:
        if table.column_names.count(column.name) != 1:
            if column.name in table.column_names or not (column.name in without or column.older is not None):
                refuse(f"has no column {column.name}, or several")
            continue
        values = table[column.name]
        if not is_of_kind(values.type, column.kind):
            refuse(f"column {column.name} is {values.type}, not {column.kind}")
        if values.null_count and column.kind != "number":
            refuse(f"column {column.name} has no value in {values.null_count} rows")
        if column.kind == "number" and pc.any(pc.is_inf(values)).as_py():
            refuse(f"column {column.name} has infinite values")
        if column.name in WORDS and (other := set(pc.unique(values).to_pylist()) - {*WORDS[column.name]}):
            refuse(f"column {column.name} has the value {min(other)!r}, which is unknown")
