"""Settings: dataclasses (`Config`), and the tables of a run's file or of `--set` that fill them.

A field states its type and range in its annotation (`Positive`, or `Annotated` with a
`msgspec.Meta`), its unit in the last part of its name, and its meaning in the string below it.
Checks, messages, `replan list`, completion and run.toml read them from there. A keyword of a
function states them in its annotation: `Annotated[float, Meta(gt=0.0, description="...")]`.
"""

from __future__ import annotations

import ast
import inspect
import json
import tomllib
from collections.abc import Hashable, Iterable, Iterator, Mapping
from dataclasses import MISSING, asdict, dataclass, fields, is_dataclass
from functools import cache, partial
from itertools import pairwise
from textwrap import dedent
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import msgspec
from msgspec import Meta
from msgspec.inspect import type_info

from replan.core.errors import ConfigError, unknown_name

T = TypeVar("T")
Table = Mapping[str, Any]
Positive = Annotated[float, Meta(gt=0.0)]
NotNegative = Annotated[float, Meta(ge=0.0)]
BOUNDS = {"ge": "minimum", "gt": "exclusiveMinimum", "le": "maximum", "lt": "exclusiveMaximum"}
"""Names of a number's bounds in JSON Schema, by those of `msgspec.Meta`."""


@dataclass(frozen=True)
class Config:
    """Settings, whose values lie within the ranges of their annotations.

    Raises:
        ConfigError: A value does not.
    """

    def __post_init__(self) -> None:
        for name, kind in types_of(type(self)).items():  # type: ignore[arg-type]
            if _is_limited(kind):
                value = getattr(self, name)
                of_numpy = getattr(value, "item", None)
                converted(value if of_numpy is None else of_numpy(), kind, name)


@cache
def types_of(thing: Hashable) -> dict[str, Any]:
    """The types of a dataclass's fields, or of a factory's keywords, ranges included.

    A class of keywords has them in its constructor. A callable whose annotations cannot be resolved
    (names that only type checkers import) has none.
    """
    has_fields = isinstance(thing, type) and is_dataclass(thing)
    target = thing.__init__ if isinstance(thing, type) and not has_fields else thing  # type: ignore[misc]
    try:
        return get_type_hints(target, include_extras=True)
    except (NameError, TypeError):
        return {}


def _is_limited(kind: Any) -> bool:
    """Whether a type, or that of a tuple's elements, states a range."""
    return any(get_origin(part) is Annotated for part in (kind, *get_args(kind)))


def bounds_of(kind: Any) -> dict[str, float]:
    """The bounds of a number, or of each number of a tuple, named as in JSON Schema."""
    if not _is_limited(kind):
        return {}
    number = type_info(kind)
    number = getattr(number, "item_type", number)
    stated = {name: getattr(number, key, None) for key, name in BOUNDS.items()}
    return {name: bound for name, bound in stated.items() if bound is not None}


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
        problem, _, path = str(error).replace("`", "").partition(" - at ")
        names = path.removeprefix("$").removeprefix(".")
        key = ".".join(filter(None, [where, names]))
        if problem.startswith("Expected"):
            problem = problem[:1].lower() + problem[1:]
            refused = _value_at(value, names)
            if ", got" not in problem and isinstance(refused, int | float):
                problem += f", got {refused}"
        choices = _choices(kind, names)
        if choices:
            problem += f"; known are: {', '.join(map(str, choices))}"
        raise ConfigError(f"{key}: {problem}" if key else problem) from None


def _value_at(value: Any, path: str) -> Any:
    """The value at a place ("loop.mode") of a table; None if there is none."""
    for name in filter(None, path.split(".")):
        value = value.get(name) if isinstance(value, Mapping) else None
    return value


def _choices(kind: Any, path: str) -> tuple[Any, ...]:
    """The values that a type allows at a place ("loop.mode"), if they are listed."""
    for name in filter(None, path.split(".")):
        kind = _hints_of(kind).get(name) if isinstance(kind, type) and is_dataclass(kind) else None
    return get_args(kind) if get_origin(kind) is Literal else ()


def _known_tree(cls: type, table: Mapping[str, Any], where: str) -> None:
    known_keys(
        table, (item.name for item in fields(cls) if item.metadata.get("key", item.init)), where
    )
    hints = _hints_of(cls)
    for key, value in table.items():
        kind = hints[key]
        if isinstance(kind, type) and is_dataclass(kind) and isinstance(value, Mapping):
            _known_tree(kind, value, dotted(where, key))


@cache
def _hints_of(kind: type) -> dict[str, Any]:
    """The types of the fields of a dataclass."""
    return get_type_hints(kind)


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


def nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table of values by dotted keys: what `flat` takes apart."""
    table: dict[str, Any] = {}
    for key, value in values.items():
        *parents, last = key.split(".")
        inner = table
        for name in parents:
            inner = inner.setdefault(name, {})
        inner[last] = value
    return table


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
    """What a field of a dataclass, or a keyword of a factory, means; "" if it is not stated."""
    while isinstance(thing, partial):
        thing = thing.func
    cls = thing if isinstance(thing, type) else type(thing)
    if is_dataclass(cls):
        return next((texts[name] for texts in map(_field_texts, cls.__mro__) if name in texts), "")
    notes = getattr(types_of(thing).get(name), "__metadata__", ())
    return next((note.description or "" for note in notes if isinstance(note, Meta)), "")


@cache
def _field_texts(cls: type) -> dict[str, str]:
    """The string below each field of a class."""
    if not is_dataclass(cls):
        return {}
    (definition,) = ast.parse(dedent(inspect.getsource(cls))).body
    texts = {}
    for node, after in pairwise(definition.body):  # type: ignore[attr-defined]
        match node, after:
            case (
                ast.AnnAssign(target=ast.Name(id=name)),
                ast.Expr(value=ast.Constant(value=str(text))),
            ):
                texts[name] = " ".join(text.split())
    return texts
