"""Reads columns of Arrow IPC (feather) and Parquet files as arrays.

Any bytes give a table or a LogError.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from replan.core.arrays import FloatArray, IntArray
from replan.core.errors import LogError

METADATA = b"metadata"
"""Key of the metadata (msgpack) in the schema of a 123D file."""
LARGEST_BYTES = 4_000_000_000
"""Largest size of a table in memory, bytes (ten hours of 100 boxes at 10 Hz take 1.5 GB)."""
LARGEST = 1e8
"""A larger length, speed or position, in m and s, is not valid and read as NaN."""
COPY_AGAIN = "copy the log again from its source"
_WRONG = (
    pa.ArrowException,
    msgspec.MsgspecError,
    OSError,
    EOFError,
    MemoryError,
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    AttributeError,
    OverflowError,
    NotImplementedError,
    RecursionError,
)
"""The exceptions of pyarrow, msgspec and NumPy for damaged or unknown bytes."""


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn any error about the bytes of a file into a LogError that names the file."""
    try:
        yield
    except LogError as error:
        if error.topic is None:
            error = LogError(
                error.what, time_ns=error.time_ns, topic=path.name, remedy=error.remedy
            )
        raise error from None
    except _WRONG as error:
        problem = (
            str(error)
            if isinstance(error, OSError | pa.ArrowException)
            else f"{type(error).__name__}: {error}"
        )
        problem = f"cannot be read: {' '.join(problem.split())[:200]}"
        raise LogError(problem, topic=path.name, remedy=COPY_AGAIN) from None


def ipc_table(path: Path, columns: Sequence[str] = ()) -> Any:
    """Read an Arrow IPC file with at least these columns.

    It is validated fully, so that all offsets are valid.
    """
    with reading(path):
        with pa.OSFile(str(path)) as stream, pa.ipc.open_file(stream) as file:
            _demand(path, columns, file.schema.names)
            table = file.read_all()
        return _checked_table(table)


def parquet_table(path: Path, columns: Sequence[str]) -> Any:
    """Read these columns of a Parquet file."""
    import pyarrow.parquet as pq

    with reading(path):
        with pq.ParquetFile(str(path)) as file:
            _demand(path, columns, file.schema_arrow.names)
            if (
                sum(file.metadata.row_group(i).total_byte_size for i in range(file.num_row_groups))
                > LARGEST_BYTES
            ):
                raise LogError(f"it would take more than {LARGEST_BYTES} bytes")
            table = file.read(columns=list(columns), use_threads=False)
        return _checked_table(table)


def _demand(path: Path, columns: Sequence[str], present: Sequence[str]) -> None:
    lacking = [name for name in columns if name not in present]
    if lacking:
        raise LogError(
            f"column {lacking[0]} is missing; there are {', '.join(present[:12]) or 'none'}",
            topic=path.name,
        )


def _checked_table(table: Any) -> Any:
    table.validate(full=True)
    if table.nbytes > LARGEST_BYTES:
        raise LogError(f"it takes {table.nbytes} bytes, more than {LARGEST_BYTES}")
    return table.combine_chunks()


def metadata_of(table: Any) -> dict[Any, Any]:
    """Return the metadata of a 123D file; {} if it has none."""
    packed = (table.schema.metadata or {}).get(METADATA)
    metadata = msgspec.msgpack.decode(packed) if packed is not None else {}
    return metadata if isinstance(metadata, dict) else {}


def array_of(value: Any) -> FloatArray:
    """Decode a NumPy array as packed by 123D, `(n, 2 or more)`, or a list of points."""
    if isinstance(value, dict):
        dtype = value[b"dtype"]
        if dtype not in ("<f8", "<f4", "<i8", "<i4"):
            raise ValueError(f"an array has the type {dtype!r}")
        return np.frombuffer(value[b"data"], dtype).reshape(value[b"shape"]).astype(np.float64)
    return np.asarray(value, dtype=np.float64)


def whole(table: Any, name: str) -> IntArray:
    """Return a column of integers `(n,)`; ValueError if one is missing."""
    return _integers(_one(table[name]), name)


def _integers(array: Any, name: str) -> IntArray:
    if array.null_count or not pa.types.is_integer(array.type):
        raise ValueError(f"{name} has empty entries or no whole numbers")
    return array.to_numpy(zero_copy_only=False).astype(np.int64)


def numbers(table: Any, name: str) -> FloatArray:
    """Return a column of numbers `(n,)`; NaN where one is missing or beyond `LARGEST`."""
    values = np.array(
        table[name].cast(pa.float64()).to_numpy(zero_copy_only=False), dtype=np.float64
    )
    values[~(np.abs(values) <= LARGEST)] = np.nan
    return values


def words(table: Any, name: str) -> tuple[IntArray, list[str]]:
    """Return a column of strings as codes `(n,)`, and the strings by code."""
    return _codes_and_names(_one(table[name]))


def vectors(column: Any, size: int) -> FloatArray:
    """Return a column of lists `(n, size)`; missing lists are NaN, and so are numbers beyond
    `LARGEST`.

    Flattening drops the undefined content of missing lists: the mask restores the rows.
    """
    array = _one(column)
    if not pa.types.is_fixed_size_list(array.type) or array.type.list_size != size:
        raise ValueError(f"lists of {size} numbers were expected, found {array.type}")
    values = np.full((len(array), size), np.nan)
    present = ~np.asarray(array.is_null())
    values[present] = np.asarray(
        array.flatten().cast(pa.float64()).to_numpy(zero_copy_only=False)
    ).reshape(-1, size)
    values[~(np.abs(values) <= LARGEST)] = np.nan
    return values


class Lists:
    """Columns with one list per row; in each row, all lists have the same length.

    Attributes:
        row: `(m,)` row of each item.
    """

    def __init__(self, table: Any, key: str) -> None:
        self._table, self._key = table, key
        self._sizes = self._lengths(key)
        self.row: IntArray = np.repeat(np.arange(len(table)), self._sizes)

    def _lengths(self, name: str) -> IntArray:
        return (
            pc.fill_null(pc.list_value_length(_one(self._table[name])), 0)
            .to_numpy()
            .astype(np.int64)
        )

    def items(self, name: str) -> Any:
        """Return the items of a column, all rows in one array."""
        if not np.array_equal(self._lengths(name), self._sizes):
            raise ValueError(f"{name} and {self._key} have lists of different lengths")
        return _one(self._table[name]).flatten()

    def numbers(self, name: str) -> IntArray:
        """Return the items of a column of integers `(m,)`."""
        return _integers(self.items(name), name)

    def words(self, name: str) -> tuple[IntArray, list[str]]:
        """Return the items of a column of strings as codes `(m,)`, and the strings by code."""
        return _codes_and_names(self.items(name))


def _one(column: Any) -> Any:
    if not isinstance(column, pa.ChunkedArray):
        return column
    if not column.num_chunks:
        return pa.array([], type=column.type)
    return column.chunk(0) if column.num_chunks == 1 else pa.concat_arrays(column.chunks)


def _codes_and_names(array: Any) -> tuple[IntArray, list[str]]:
    if array.null_count or not (
        pa.types.is_string(array.type) or pa.types.is_large_string(array.type)
    ):
        raise ValueError("names are missing or are no text")
    coded = array.dictionary_encode()
    return coded.indices.to_numpy(zero_copy_only=False).astype(
        np.int64
    ), coded.dictionary.to_pylist()
