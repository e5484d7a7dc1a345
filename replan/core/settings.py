"""Converts a table of a run's file or of `--set` into dataclasses: keys, defaults and types are
checked.
"""

from __future__ import annotations

import inspect
import json
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import MISSING, asdict, fields, is_dataclass
from functools import partial
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import msgspec

from replan.core.errors import ConfigError, unknown_name

T = TypeVar("T")
Table = Mapping[str, Any]


def strict(cls: type[T], table: Mapping[str, Any], where: str = "") -> T:
    """Convert a table to a dataclass, nested tables included: what one does not name keeps its
    default.

    Args:
        cls: A dataclass; its own checks (`__post_init__`) are run.
        table: Keys and values as TOML gives them.
        where: Dotted name of the table, for messages.

    Raises:
        ConfigError: A key is unknown, or a value has the wrong type or is refused by the dataclass.
    """
    _known_tree(cls, table, where)
    return converted(_with_defaults(cls, table), cls, where)


def _with_defaults(cls: type, table: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table with its nested tables filled up from the defaults of their fields."""
    filled = dict(table)
    for item in fields(cls):
        default = item.default if item.default_factory is MISSING else item.default_factory()
        if (
            is_dataclass(default)
            and not isinstance(default, type)
            and isinstance(table.get(item.name), Mapping)
        ):
            filled[item.name] = asdict(default) | _with_defaults(type(default), table[item.name])
    return filled


def converted(value: Any, kind: type[T], where: str) -> T:
    """Convert a value to a type; ConfigError as `strict`."""
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        # "Expected `float`, got `str` - at `$.loop.period`" becomes "loop.period: expected float,
        # got str"
        what, _, place = str(error).replace("`", "").partition(" - at ")
        what = what[:1].lower() + what[1:] if what.startswith("Expected") else what
        names = place.removeprefix("$").removeprefix(".")
        key = ".".join(filter(None, [where, names]))
        choices = _choices(kind, names)
        what = f"{what}; known are: {', '.join(map(str, choices))}" if choices else what
        raise ConfigError(f"{key}: {what}" if key else what) from None


def _choices(kind: Any, place: str) -> tuple[Any, ...]:
    """The values that a type allows at a place ("loop.mode"), if they are listed."""
    for name in filter(None, place.split(".")):
        kind = (
            get_type_hints(kind).get(name)
            if isinstance(kind, type) and is_dataclass(kind)
            else None
        )
    return get_args(kind) if get_origin(kind) is Literal else ()


def _known_tree(cls: type, table: Mapping[str, Any], where: str) -> None:
    known_keys(
        table, (item.name for item in fields(cls) if item.metadata.get("key", item.init)), where
    )
    hints = get_type_hints(cls)
    for key, value in table.items():
        kind = hints[key]
        if isinstance(kind, type) and is_dataclass(kind) and isinstance(value, Mapping):
            _known_tree(kind, value, dotted(where, key))


def known_keys(table: Mapping[str, Any], known: Iterable[str], where: str) -> None:
    """Refuse unknown keys of a table.

    Raises:
        ConfigError: Names the key and the nearest known one.
    """
    names = list(known)
    for key in table:
        if key not in names:
            raise unknown_name(
                "key", dotted("", key), [dotted("", name) for name in names], where and f"{where}."
            )


def dotted(where: str, key: str) -> str:
    """Return `where.key`, with the key quoted if TOML requires it."""
    name = key if key.replace("_", "").replace("-", "").isalnum() else f'"{key}"'
    return f"{where}.{name}" if where else name


def dotted_keys(cls: type, where: str = "") -> Iterator[str]:
    """Yield all keys of the table that mirrors a dataclass, dotted for sub-tables
    ("loop.plan_period_s").
    """
    hints = get_type_hints(cls)
    for item in fields(cls):
        if item.metadata.get("key", item.init):
            key, kind = dotted(where, item.name), hints[item.name]
            yield from (
                dotted_keys(kind, key) if isinstance(kind, type) and is_dataclass(kind) else (key,)
            )


def merged(table: Table, changes: Table) -> dict[str, Any]:
    """Return a table with changes applied key by key, sub-tables included."""
    result = dict(table)
    for key, value in changes.items():
        old = result.get(key)
        result[key] = (
            merged(old, value) if isinstance(old, Mapping) and isinstance(value, Mapping) else value
        )
    return result


def flat(table: Table, where: str = "") -> Iterator[tuple[str, Any]]:
    """Yield dotted keys and values of a table, sub-tables included."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{where}{key}.")
        else:
            yield f"{where}{key}", value


def set_table(words: Iterable[str]) -> dict[str, Any]:
    """Parse words "KEY=VALUE" to a table: the key is dotted as in TOML, the value is TOML or plain
    text.

    Raises:
        ConfigError: A word is not of this form.
    """
    table: dict[str, Any] = {}
    for word in words:
        key, separator, value = word.partition("=")
        try:
            if not separator:
                raise ValueError("there is no '='")
            try:
                entry = tomllib.loads(f"{key} = {value}")
            except tomllib.TOMLDecodeError:  # text without quotes
                entry = tomllib.loads(f"{key} = {json.dumps(value)}")
        except ValueError as error:
            hint = "write it as KEY=VALUE, for example loop.plan_period_s=0.2"
            raise ConfigError(f"--set {word}: {hint} ({error})") from None
        table = merged(table, entry)
    return table


def meaning(thing: Any, name: str) -> str:
    """The entry of a field or keyword in the docstring of a class (and its bases) or function; ""
    if it has none.
    """
    while isinstance(thing, partial):
        thing = thing.func
    cls = thing if isinstance(thing, type) else type(thing) if is_dataclass(thing) else None
    places = [thing] if cls is None else [*cls.__mro__, cls.__init__]  # type: ignore[misc]
    for doc in map(inspect.getdoc, places):
        found = re.search(
            rf"^ +{name}(?: \([^)\n]*\))?: (.*(?:\n {{8,}}.*)*)", doc or "", re.MULTILINE
        )
        if found:
            return " ".join(found[1].split())
    return ""
