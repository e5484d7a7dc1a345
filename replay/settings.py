"""A table in the configuration -> the keywords that something is built with: planners, vehicle models, controllers ...

A factory takes its settings either as keywords (`horizon_s: float = 8.0`), or all in one keyword `config`, annotated
with a frozen dataclass: then its table mirrors that dataclass, sub-tables included.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import asdict, is_dataclass
from functools import partial
from typing import Any, TypeVar, get_args, get_type_hints

from logs.errors import ConfigError
from logs.extension import Kind
from replay.config import SETTINGS, dotted, known_keys, strict

F = TypeVar("F", bound=Callable[..., Any])
Table = Mapping[str, Any]


def keywords_of(factory: Callable[..., Any], table: Table, where: str) -> dict[str, Any]:
    """The keywords that a configuration table stands for.

    Args:
        factory: What is built with them.
        table: Keys and values as TOML gives them.
        where: Dotted name of the table, for messages.

    Raises:
        ConfigError: A key is unknown, or a value of the wrong type or refused.
    """
    config = _config_class(factory)
    if config is not None:
        return {"config": strict(config, table, where)} if table else {}
    parameters = inspect.signature(factory).parameters.values()
    if not any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
        known_keys(table, [p.name for p in parameters if p.kind is p.KEYWORD_ONLY], where)
    return dict(table)


def resolved(factory: Callable[..., Any], table: Table, where: str) -> dict[str, Any]:
    """The table with every default spelled out; `keywords_of` makes the same of it; ConfigError as there."""
    keywords, config = keywords_of(factory, table, where), _config_class(factory)
    if config is not None:
        return asdict(keywords.get("config") or config())
    parameters = inspect.signature(factory).parameters.values()
    defaults = {p.name: p.default for p in parameters if p.kind is p.KEYWORD_ONLY and p.default is not p.empty}
    return {**defaults, **keywords}


def check(factory: Callable[..., Any], table: Table, where: str, what: str, given: int) -> None:
    """Refuse what a factory cannot be called with; ConfigError says what is missing or too much.

    Args:
        factory: What is called.
        table: Its table.
        where: Dotted name of the table.
        what: The thing, for messages ("planner 'idm'").
        given: How many arguments it is given before the keywords.
    """
    try:
        inspect.signature(factory).bind(*given * (None,), **keywords_of(factory, table, where))
    except TypeError as error:
        raise ConfigError(
            f"{what} cannot be built so: {error}; it is given {given} argument{'s' * (given != 1)} and its settings"
        ) from None


def configured(kind: Kind[F], name: str, settings: Mapping[str, Table]) -> F:
    """What the user named, with its `LoopConfig.settings` in it; ConfigError as `Kind.find` and `keywords_of`."""
    factory, table = kind.find(name), settings.get(kind.name, {})
    made: Any = partial(factory, **keywords_of(factory, table, dotted(SETTINGS[kind.name], name))) if table else factory
    return made


def check_members(kind: str, name: str, thing: object, protocol: type) -> None:
    """Refuse what lacks a member of its protocol; ConfigError says which."""
    lacking = [member for member in vars(protocol) if not member.startswith("_") and not hasattr(thing, member)]
    if lacking:
        of = f"{protocol.__module__}.{protocol.__name__}"
        raise ConfigError(f"{kind} '{name}': what it built is a {type(thing).__name__} without {lacking[0]} ({of})")


def _config_class(factory: Callable[..., Any]) -> type | None:
    """The dataclass by which the keyword `config` is annotated, or None."""
    while isinstance(factory, partial):
        factory = factory.func
    asked = inspect.signature(factory).parameters.get("config")
    if asked is None or asked.default is asked.empty:
        return None
    target = factory.__init__ if isinstance(factory, type) else factory  # type: ignore[misc]
    try:
        hint = get_type_hints(target).get("config")
    except (NameError, TypeError):  # annotations that exist for a type checker only; a callable object
        return None
    found = [kind for kind in (hint, *get_args(hint)) if isinstance(kind, type) and is_dataclass(kind)]
    return found[0] if found else None
