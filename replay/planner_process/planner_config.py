"""Finds the factory of a named planner, where it runs, and the keywords of its configuration
table.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from inspect import getattr_static
from types import MappingProxyType
from typing import Any

from replan.core.errors import ConfigError
from replan.replay.loop_config import PlannerProcessConfig
from replan.replay.parts import PLANNER, Factory, Part

FOREIGN = ("exec:", "tcp://", "nuplan:")
"""Prefixes of planners that are not Python classes to load."""


def is_built_in(spec: str) -> bool:
    """Whether a planner comes with replan."""
    return spec in PLANNER.builtin


def is_foreign(spec: str) -> bool:
    """Whether a planner is a program, a node or one of nuPlan: "exec:COMMAND", "tcp://HOST:PORT",
    "nuplan:MODULE:CLASS".
    """
    return spec.startswith(FOREIGN)


def is_apart(spec: str, apart: PlannerProcessConfig) -> bool:
    """Whether a planner runs in a process of its own; an invalid name does not."""
    named = all(spec.partition(":")) or (not is_built_in(spec) and spec in PLANNER.entries())
    return is_foreign(spec) or (not is_built_in(spec) and named and not apart.trust)


def planner_part(spec: str, settings: Mapping[str, Any] = MappingProxyType({})) -> Part:
    """The planner or oracle of a name, loaded into Python; ConfigError if it is a program or a
    node.
    """
    if spec.partition(":")[0] in ("exec", "tcp", "nuplan"):
        raise ConfigError(
            f"planner '{spec}': write exec:COMMAND, tcp://HOST:PORT or nuplan:MODULE:CLASS; none "
            "is loaded into this Python"
        )
    return Part(PLANNER, spec, settings)


def of_class(factory: Factory, name: str) -> Callable[..., Any] | None:
    """A class method or static method of a planner class; None if it has none, or only an instance
    method.
    """
    shared = isinstance(getattr_static(factory, name, None), classmethod | staticmethod)
    return getattr(factory, name) if shared else None


_prepared: dict[Factory, Mapping[str, Any]] = {}
"""The keywords with which each class of planners was last prepared in this process."""


def prepared(spec: str, keywords: Mapping[str, Any]) -> Factory:
    """The factory of the planner, after it has loaded the data that all its drives share.

    A class may have a class method `prepare(**keywords)`, which gets the keywords of the planner
    before it is built with them. It is called once per process, and once in the process from which
    those of drives are forked.
    """
    factory = planner_part(spec).factory
    prepare = of_class(factory, "prepare")
    if prepare is not None and _prepared.get(factory) != keywords:
        prepare(**keywords)
        _prepared[factory] = keywords
    return factory
