"""Finds the factory of a named planner, where it runs, and the keywords of its configuration table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from inspect import getattr_static
from typing import Any

from planners import PLANNER, PLANNERS, load_planner
from replay.config import PlannerProcessConfig, RunConfig
from replay.oracle import ORACLES
from replay.settings import dotted, keywords_of, resolved

Factory = Callable[..., Any]


FOREIGN = ("exec:", "tcp://")
"""Prefixes of planners that are not Python classes to load."""


def is_built_in(spec: str) -> bool:
    """Whether a planner comes with replan."""
    return spec in PLANNERS or spec in ORACLES


def is_foreign(spec: str) -> bool:
    """Whether a planner is a program or a node: "exec:COMMAND" or "tcp://HOST:PORT"."""
    return spec.startswith(FOREIGN)


def is_apart(spec: str, apart: PlannerProcessConfig) -> bool:
    """Whether a planner runs in a process of its own; an invalid name does not."""
    named = all(spec.partition(":")) or (not is_built_in(spec) and spec in PLANNER.entries())
    return is_foreign(spec) or (not is_built_in(spec) and named and not apart.trust)


def planner_factory(spec: str) -> Factory:
    """The factory of the planner or oracle of this name; ConfigError or PlannerError if there is none."""
    return ORACLES[spec] if spec in ORACLES else load_planner(spec, also=ORACLES)


def of_class(factory: Factory, name: str) -> Callable[..., Any] | None:
    """A class method or static method of a planner class; None if it has none, or only an instance method."""
    shared = isinstance(getattr_static(factory, name, None), classmethod | staticmethod)
    return getattr(factory, name) if shared else None


_prepared: dict[Factory, Mapping[str, Any]] = {}
"""The keywords with which each class of planners was last prepared in this process."""


def prepared(spec: str, keywords: Mapping[str, Any]) -> Factory:
    """The factory of the planner, after it has loaded the data that all its drives share.

    A class may have a class method `prepare(**keywords)`, which gets the keywords of the planner before it is built
    with them. It is called once per process, and once in the process from which those of drives are forked.
    """
    factory = planner_factory(spec)
    prepare = of_class(factory, "prepare")
    if prepare is not None and _prepared.get(factory) != keywords:
        prepare(**keywords)
        _prepared[factory] = keywords
    return factory


def planner_keywords(spec: str, table: Mapping[str, Any]) -> dict[str, Any]:
    """The keywords of a planner's table; ConfigError if it is wrong (`replay.settings`)."""
    return keywords_of(planner_factory(spec), table, dotted("planner", spec))


def drive_keywords(spec: str, run: RunConfig) -> Mapping[str, Any]:
    """The keywords with which a loop builds a planner of a run: its table, where it runs in a process of its own."""
    table = run.planner.get(spec, {})
    return table if is_apart(spec, run.loop.apart) else planner_keywords(spec, table)


def resolved_table(spec: str, table: Mapping[str, Any]) -> dict[str, Any]:
    """The table with all defaults; ConfigError if the planner cannot be built with it."""
    given = 2 if spec in ORACLES else 1  # the context, and for an oracle the log
    return resolved(planner_factory(spec), table, dotted("planner", spec), f"planner '{spec}'", given)
