"""A planner's table in the configuration -> the keywords that it is built with.

A planner takes its settings either as keywords (`horizon_s: float = 8.0`), or all in one keyword `config`, annotated
with a frozen dataclass: then `[planner.NAME]` mirrors that dataclass, sub-tables included.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import asdict, is_dataclass
from typing import Any, get_args, get_type_hints

from logs.errors import ConfigError
from planners import PLANNERS, load_planner
from replay.config import dotted, known_keys, strict
from replay.drive import ApartConfig
from replay.oracle import ORACLES

Factory = Callable[..., Any]


FOREIGN = ("exec:", "tcp://")
"""How planners are named that are no Python of ours to load."""


def is_built_in(spec: str) -> bool:
    """Whether a planner comes with replan."""
    return spec in PLANNERS or spec in ORACLES


def is_foreign(spec: str) -> bool:
    """Whether a planner is a program or a node: "exec:COMMAND" or "tcp://HOST:PORT"."""
    return spec.startswith(FOREIGN)


def is_apart(spec: str, apart: ApartConfig) -> bool:
    """Whether a planner runs in a process of its own; a name that is none at all does not."""
    return is_foreign(spec) or (not is_built_in(spec) and all(spec.partition(":")) and not apart.trust)


def planner_factory(spec: str) -> Factory:
    """What builds the planner or oracle of this name; ConfigError or PlannerError where there is none."""
    return ORACLES[spec] if spec in ORACLES else load_planner(spec, also=ORACLES)


def planner_keywords(spec: str, table: Mapping[str, Any]) -> dict[str, Any]:
    """The keywords that a configuration table stands for.

    Raises:
        ConfigError: A key is unknown, or a value of the wrong type or refused.
    """
    factory, where = planner_factory(spec), dotted("planner", spec)
    config = _config_class(factory)
    if config is not None:
        return {"config": strict(config, table, where)} if table else {}
    parameters = inspect.signature(factory).parameters.values()
    if not any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
        known_keys(table, [p.name for p in parameters if p.kind is p.KEYWORD_ONLY], where)
    return dict(table)


def resolved_table(spec: str, table: Mapping[str, Any]) -> dict[str, Any]:
    """The table with every default spelled out; `planner_keywords` makes the same planner of it.

    Raises:
        ConfigError: As `planner_keywords`.
    """
    keywords, factory = planner_keywords(spec, table), planner_factory(spec)
    config = _config_class(factory)
    if config is not None:
        return asdict(keywords.get("config") or config())
    parameters = inspect.signature(factory).parameters.values()
    defaults = {p.name: p.default for p in parameters if p.kind is p.KEYWORD_ONLY and p.default is not p.empty}
    return {**defaults, **keywords}


def _config_class(factory: Factory) -> type | None:
    """The dataclass by which the keyword `config` is annotated, or None."""
    target = factory.__init__ if isinstance(factory, type) else factory  # type: ignore[misc]
    try:
        hint = get_type_hints(target).get("config")
    except NameError:  # annotations that exist for a type checker only
        return None
    found = [kind for kind in (hint, *get_args(hint)) if isinstance(kind, type) and is_dataclass(kind)]
    return found[0] if found else None


def check_keywords(planner: str, table: Mapping[str, Any]) -> None:
    """Refuse what the planner cannot be built with; ConfigError says what is missing or too much."""
    given = (None, None) if planner in ORACLES else (None,)  # the context, and for an oracle the log
    try:
        inspect.signature(planner_factory(planner)).bind(*given, **planner_keywords(planner, table))
    except TypeError as error:
        raise ConfigError(f"planner '{planner}' cannot be built so: {error}") from None
