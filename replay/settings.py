"""Converts a table of the configuration into keywords of a planner, vehicle model, controller ...

A factory takes its settings either as keywords (`horizon_s: float = 8.0`), or all in one keyword `config`, annotated
with a frozen dataclass: then its table mirrors that dataclass, sub-tables included.
"""

from __future__ import annotations

import inspect
import json
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import MISSING, asdict, fields, is_dataclass
from functools import partial
from typing import Any, TypeVar, get_args, get_type_hints

import msgspec

from logs.errors import ConfigError, unknown_name
from logs.extension import ExtensionKind

SETTINGS: Mapping[str, str] = {
    "vehicle": "vehicle_model",
    "controller": "controller",
    "traffic": "traffic",
    "prediction": "prediction",
    "perception": "perception",
}
"""Keys of [loop] that name a part, and the table with the settings of the parts ([vehicle] has VehicleParameters)."""

T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., Any])
Table = Mapping[str, Any]


PLAIN: Mapping[str, type] = {kind.__name__: kind for kind in (float, int, bool, str)}
"""Types of keywords that are checked, by their names in annotations."""


def keywords_of(factory: Callable[..., Any], table: Table, where: str) -> dict[str, Any]:
    """Convert a configuration table to keywords.

    Args:
        factory: The factory that receives them.
        table: Keys and values as TOML gives them.
        where: Dotted name of the table, for messages.

    Raises:
        ConfigError: A key is unknown, or a value has the wrong type or is refused.
    """
    config = config_class(factory)
    if config is not None:
        return {"config": strict(config, table, where)} if table else {}
    parameters = inspect.signature(factory).parameters.values()
    if not any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
        known_keys(table, [p.name for p in parameters if p.kind is p.KEYWORD_ONLY], where)
    kinds = {p.name: PLAIN.get(getattr(p.annotation, "__name__", p.annotation)) for p in parameters}
    for name, kind in kinds.items():
        if name in table and kind is not None:
            _converted(table[name], kind, dotted(where, name))
    return dict(table)


def resolved(factory: Callable[..., Any], table: Table, where: str, what: str, given: int) -> dict[str, Any]:
    """Return the table with all defaults, after a check that the factory accepts it.

    `keywords_of` converts the result to the same keywords as the table.

    Args:
        factory: The factory.
        table: Its table.
        where: Dotted name of the table.
        what: Name of what is built, for messages ("planner 'idm'").
        given: Number of positional arguments before the keywords.

    Raises:
        ConfigError: As `keywords_of`; or a keyword is missing or not accepted.
    """
    keywords, config = keywords_of(factory, table, where), config_class(factory)
    try:
        inspect.signature(factory).bind(*given * (None,), **keywords)
    except TypeError as error:
        raise ConfigError(
            f"{what} cannot be built: {error}; it receives {given} argument{'s' * (given != 1)} and its settings"
        ) from None
    if config is not None:
        return asdict(keywords.get("config") or config())
    parameters = inspect.signature(factory).parameters.values()
    defaults = {p.name: p.default for p in parameters if p.kind is p.KEYWORD_ONLY and p.default is not p.empty}
    return {**defaults, **keywords}


def configured(kind: ExtensionKind[F], name: str, settings: Mapping[str, Table]) -> F:
    """The factory of a name with its `LoopConfig.settings`; ConfigError as `ExtensionKind.find` and `keywords_of`."""
    factory, table = kind.find(name), settings.get(kind.name, {})
    made: Any = partial(factory, **keywords_of(factory, table, dotted(SETTINGS[kind.name], name))) if table else factory
    return made


def check_members(kind: str, name: str, thing: object, protocol: type) -> None:
    """Check that an object has all members of its protocol; ConfigError names the one that is missing."""
    lacking = [member for member in vars(protocol) if not member.startswith("_") and not hasattr(thing, member)]
    if lacking:
        of = f"{protocol.__module__}.{protocol.__name__}"
        raise ConfigError(f"{kind} '{name}': it built a {type(thing).__name__} without {lacking[0]} ({of})")


def config_class(factory: Callable[..., Any]) -> type | None:
    """Return the dataclass in the annotation of the keyword `config`, or None."""
    while isinstance(factory, partial):
        factory = factory.func
    parameter = inspect.signature(factory).parameters.get("config")
    if parameter is None or parameter.default is parameter.empty:
        return None
    target = factory.__init__ if isinstance(factory, type) else factory  # type: ignore[misc]
    try:
        hint = get_type_hints(target).get("config")
    except (NameError, TypeError):  # annotations only for type checkers; a callable object
        return None
    found = [kind for kind in (hint, *get_args(hint)) if isinstance(kind, type) and is_dataclass(kind)]
    return found[0] if found else None


def strict(cls: type[T], table: Mapping[str, Any], where: str = "") -> T:
    """Convert a table to a dataclass, nested tables included: what one does not name keeps its default.

    Args:
        cls: A dataclass; its own checks (`__post_init__`) are run.
        table: Keys and values as TOML gives them.
        where: Dotted name of the table, for messages.

    Raises:
        ConfigError: A key is unknown, or a value has the wrong type or is refused by the dataclass.
    """
    _known_tree(cls, table, where)
    return _converted(_with_defaults(cls, table), cls, where)


def _with_defaults(cls: type, table: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table with its nested tables filled up from the defaults of their fields."""
    filled = dict(table)
    for item in fields(cls):
        default = item.default if item.default_factory is MISSING else item.default_factory()
        if is_dataclass(default) and not isinstance(default, type) and isinstance(table.get(item.name), Mapping):
            filled[item.name] = asdict(default) | _with_defaults(type(default), table[item.name])
    return filled


def _converted(value: Any, kind: type[T], where: str) -> T:
    """Convert a value to a type; ConfigError as `strict`."""
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        # "Expected `float`, got `str` - at `$.loop.period`" becomes "loop.period: expected float, got str"
        what, _, place = str(error).replace("`", "").partition(" - at ")
        what = what[:1].lower() + what[1:] if what.startswith("Expected") else what
        key = ".".join(filter(None, [where, place.removeprefix("$").removeprefix(".")]))
        raise ConfigError(f"{key}: {what}" if key else what) from None


def _known_tree(cls: type, table: Mapping[str, Any], where: str) -> None:
    known_keys(table, (item.name for item in fields(cls) if item.metadata.get("key", item.init)), where)
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
            raise unknown_name("key", dotted("", key), [dotted("", name) for name in names], where and f"{where}.")


def dotted(where: str, key: str) -> str:
    """Return `where.key`, with the key quoted if TOML requires it."""
    name = key if key.replace("_", "").replace("-", "").isalnum() else f'"{key}"'
    return f"{where}.{name}" if where else name


def dotted_keys(cls: type, where: str = "") -> Iterator[str]:
    """Yield all keys of the table that mirrors a dataclass, dotted for sub-tables ("loop.plan_period_s")."""
    hints = get_type_hints(cls)
    for item in fields(cls):
        if item.metadata.get("key", item.init):
            key, kind = dotted(where, item.name), hints[item.name]
            yield from dotted_keys(kind, key) if isinstance(kind, type) and is_dataclass(kind) else (key,)


def merged(table: Table, changes: Table) -> dict[str, Any]:
    """Return a table with changes applied key by key, sub-tables included."""
    result = dict(table)
    for key, value in changes.items():
        old = result.get(key)
        result[key] = merged(old, value) if isinstance(old, Mapping) and isinstance(value, Mapping) else value
    return result


def flat(table: Table, where: str = "") -> Iterator[tuple[str, Any]]:
    """Yield dotted keys and values of a table, sub-tables included."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{where}{key}.")
        else:
            yield f"{where}{key}", value


def set_table(words: Iterable[str]) -> dict[str, Any]:
    """Parse words "KEY=VALUE" to a table: the key is dotted as in TOML, the value is TOML or plain text.

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
