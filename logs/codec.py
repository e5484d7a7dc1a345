"""Converts between the data classes (nouns) and their messages in files or on the wire.

A message is a `msgspec.Struct` whose fields have the same names as those of the noun. The types of
both fields define how a field is stored:

    noun                                     message
    FloatArray, IntArray                     list of numbers, or bytes: little-endian float64, row
                                             by row
    Points `(n, 2)`                          list of pairs, or bytes; or two lists: x and y, left ->
                                             left_x and left_y
    float                                    number; null where it is NaN
    tuple of pairs (name, value)             object
    Enum                                     its value; in a text field, its name in lower case
    noun; tuple or mapping by id of nouns    message; list of messages

A field of the noun that the message lacks keeps its default. Numbers are the same to the bit on
both sides, and arrays that are read from bytes share their memory. Nouns that need no conversion
(only numbers, text, enums, and arrays as bytes) are sent as they are: `array_as_bytes` and
`array_of` are the hooks of msgspec for their arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache, partial
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec
import numpy as np

from replan.core.arrays import FloatArray, IntArray, Points

M = TypeVar("M")
N = TypeVar("N")
Convert = Callable[[Any], Any]
Row = tuple[str, str, Convert | None]

WIRE = np.dtype("<f8")
Column = bytes | list[float]
"""A column of a message, read in either form."""
ABSENT = {"cost": np.inf, "lower": -np.inf, "upper": np.inf}
"""Meaning of null in the arrays of a graph, by field: a node that is not reached, a free bound.

Elsewhere NaN.
"""
_AXES: dict[str, Convert] = {
    "x": lambda points: points[:, 0].tolist(),
    "y": lambda points: points[:, 1].tolist(),
}


def packed(values: FloatArray) -> Any:
    """Return an array as bytes, row by row; without a copy if its memory has this layout."""
    array: Any = np.ascontiguousarray(values, WIRE)
    return memoryview(array).cast("B") if array.size else b""


def unpacked(column: Column) -> FloatArray:
    """Return the numbers of a column `(n,)`; ValueError if the bytes are not a multiple of 8."""
    return (
        np.frombuffer(column, WIRE) if isinstance(column, bytes) else np.array(column, np.float64)
    )


def scalar_as_number(value: object) -> object:
    """The `enc_hook` of messages without arrays: scalars of NumPy are numbers."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} cannot be sent")


def array_as_bytes(value: object) -> object:
    """The `enc_hook` of messages that hold nouns: arrays are bytes, scalars of NumPy are
    numbers.
    """
    return packed(value) if isinstance(value, np.ndarray) else scalar_as_number(value)


def array_of(kind: Any, value: Any) -> Any:
    """The `dec_hook` of messages that hold nouns: make an array of type `FloatArray` or `Points`
    from bytes.
    """
    column = unpacked(value)
    return column.reshape(-1, 2) if kind == Points else column


def message_of(kind: Callable[..., M], noun: Any, **given: Any) -> M:
    """Make the message of a noun; `given` fields replace those of the noun."""
    values = given
    for name, source, convert in _writers(kind, noun.__class__):
        if name not in given:
            value = getattr(noun, source)
            values[name] = value if convert is None else convert(value)
    return kind(**values)


def noun_of(kind: Callable[..., N], message: Any, **given: Any) -> N:
    """Make the noun of a message; `given` fields replace those of the message.

    Raises:
        ValueError: Columns differ in length, or the noun rejects the values.
        KeyError: A text names no member of an Enum.
    """
    values = given
    for name, source, convert in _readers(kind, message.__class__):
        if name not in given:
            value = getattr(message, source) if source else message
            values[name] = value if convert is None else convert(value)
    return kind(**values)


@cache
def _writers(kind: Any, noun: Any) -> tuple[Row, ...]:
    """Return for each field of a message its name, the noun's field, and the function that converts
    its value.
    """
    hints, rows = get_type_hints(noun), list[Row]()
    outline = next((name for name, hint in hints.items() if hint == Points), "")
    for name, hint in get_type_hints(kind).items():
        source, axis = (outline, name) if name in ("x", "y") else (name[:-2], name[-1])
        if name in hints:
            rows.append((name, name, _written(hint, hints[name])))
        elif hints.get(source) == Points:
            rows.append((name, source, _AXES[axis]))
    return tuple(rows)


def _written(hint: Any, noun_type: Any = None) -> Convert | None:
    """Return the function that converts a noun's value, of type `own`, for a message; None: no
    conversion.
    """
    if (inner := _without_none(hint)) is not hint:
        return _or_none(_written(inner, noun_type))
    origin, args = get_origin(hint), get_args(hint)
    if hint is bytes or hint == Column:
        return packed
    if (hint is str or origin is Literal) and _is_enum(noun_type):
        return lambda member: member.name.lower()
    if origin is dict:
        return dict
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        if hint.__struct_fields__ == ("x", "y"):
            return lambda points: hint(*points.T.tolist())
        return lambda noun: message_of(hint, noun)
    if origin is not list:
        return None
    item = _written(args[0])

    def write_list(values: Any) -> list[Any]:
        if isinstance(values, np.ndarray):
            values = values.tolist()
        elif isinstance(values, Mapping):
            values = values.values()
        elif isinstance(values, frozenset):
            values = sorted(values)
        return list(values) if item is None else [item(value) for value in values]

    return write_list


@cache
def _readers(noun: Any, kind: Any) -> tuple[Row, ...]:
    """Return for each noun field in a message its name, the message's field ("": several), and the
    converter.
    """
    hints, names, rows = get_type_hints(noun), kind.__struct_fields__, list[Row]()
    for name in (field.name for field in fields(noun)):
        if name in names:
            rows.append((name, name, _read(hints[name], ABSENT.get(name))))
        elif hints[name] == Points:
            axes = (f"{name}_x", f"{name}_y") if f"{name}_x" in names else ("x", "y")
            rows.append((name, "", _columns(noun, kind, *axes)))
    return tuple(rows)


def _columns(noun: type, kind: Any, x: str, y: str) -> Convert:
    """Return a function that makes points from two columns of a message."""
    serialised = {column.name: column.encode_name for column in msgspec.structs.fields(kind)}
    words = "".join(
        f" {letter.lower()}" if letter.isupper() else letter for letter in noun.__name__
    ).strip()

    def read(message: Any) -> FloatArray:
        xs, ys = getattr(message, x), getattr(message, y)
        if len(xs) != len(ys):
            raise ValueError(
                f"{words} {message.id} has {len(xs)} {serialised[x]} and {len(ys)} {serialised[y]}"
            )
        return np.column_stack([xs, ys])

    return read


def _read(hint: Any, absent: float | None = None) -> Convert | None:
    """Return the function that converts a message's value for a noun; None: no conversion."""
    if (inner := _without_none(hint)) is not hint:
        return _or_none(_read(inner, absent))
    origin, args = get_origin(hint), get_args(hint)
    if hint is float:
        return _number
    if hint == Points:
        return _points
    if hint == FloatArray:
        if absent is None:
            return unpacked
        return lambda values: np.nan_to_num(
            np.array(values, np.float64), nan=absent, posinf=np.inf, neginf=-np.inf
        )
    if hint == IntArray:
        return lambda values: np.array(values, np.int64)
    if _is_enum(hint):
        return partial(_member, hint)
    if origin is frozenset:
        return frozenset
    if origin is tuple and args[-1] is ...:
        if get_origin(args[0]) is tuple:
            return _pairs
        item = None if _is_enum(args[0]) else _read(args[0])
        return tuple if item is None else lambda values: tuple(map(item, values))
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return partial(_nouns_by_id, args[1])
    return partial(_noun, hint) if is_dataclass(hint) else None


def _number(value: float | None) -> float:
    return np.nan if value is None else value


def _pairs(values: Mapping[str, float | None]) -> tuple[tuple[str, float], ...]:
    return tuple((key, _number(value)) for key, value in values.items())


def _member(kind: type[Enum], value: Any) -> Any:
    """Return the member of an Enum that a text names; a value that is no text is returned
    unchanged.
    """
    return kind[value.upper()] if isinstance(value, str) else value


def _nouns_by_id(kind: Any, values: Any) -> dict[Any, Any]:
    return {value.id: _noun(kind, value) for value in values}


def _noun(kind: Any, value: Any) -> Any:
    """Return the noun of a message; a value that is no message is returned unchanged."""
    return noun_of(kind, value) if isinstance(value, msgspec.Struct) else value


def _points(value: Any) -> FloatArray:
    if isinstance(value, msgspec.Struct):
        return np.column_stack(msgspec.structs.astuple(value))
    return unpacked(value).reshape(-1 if isinstance(value, bytes) else len(value), 2)


def _without_none(hint: Any) -> Any:
    """Return the type of an optional field without None; any other type unchanged."""
    types = [member for member in get_args(hint) if member is not NoneType]
    return types[0] if get_origin(hint) in (Union, UnionType) and len(types) == 1 else hint


def _or_none(convert: Convert | None) -> Convert | None:
    if convert is None:
        return None

    def convert_or_none(value: Any) -> Any:
        return None if value is None else convert(value)

    return convert_or_none


def _is_enum(hint: Any) -> bool:
    return isinstance(hint, type) and issubclass(hint, Enum)
