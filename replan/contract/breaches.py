"""What the contracts share: the findings of a check, calls of users' code, equality to the bit."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from itertools import zip_longest
from typing import Any, TypeVar

import numpy as np

from replan.core.errors import ReplanError, raised
from replan.logs.catalogue import scenario as catalogue_scenario
from replan.logs.scenario import Scenario
from replan.replay.loop_config import LoopConfig

SCENARIOS = (
    "paper/free_road",
    "paper/crossing_pedestrian",
    "everyday/follow",
    "everyday/cut_in",
    "everyday/traffic_light",
    "everyday/junction",
)
"""The scenarios of the catalogue on which planners and metrics are checked by default."""
LOOP = LoopConfig(perception="ground_truth")

T = TypeVar("T")


class ContractError(ReplanError):
    """A planner, metric or reader breaks rules of its contract; the message has a line for each.

    Attributes:
        broken: The names of the broken rules.
    """

    def __init__(self, subject: str, breaches: Mapping[str, str]) -> None:
        self.broken = tuple(breaches)
        lines = [f"- {rule}: {text}" for rule, text in breaches.items()]
        super().__init__("\n".join([f"{subject} breaks its contract:", *lines]))


class Findings:
    """The first breach of each rule."""

    def __init__(self, rules: Mapping[str, str]) -> None:
        self._rules, self.breaches = rules, dict[str, str]()

    def add(self, rule: str, where: str, breach: str) -> None:
        """Keep the breach, if it is the first of its rule."""
        self.breaches.setdefault(rule, f"{where}: {breach}; {self._rules[rule]}")

    def report(self, subject: str) -> None:
        """Raise the ContractError, with the rules in the order of their table, if any is broken."""
        if self.breaches:
            raise ContractError(
                subject,
                {rule: self.breaches[rule] for rule in self._rules if rule in self.breaches},
            )


def call(
    findings: Findings, rule: str, where: str, function: Callable[..., T], *arguments: Any
) -> T | None:
    """Call a function of the user's; None if it raises, which breaks the rule."""
    try:
        return function(*arguments)
    except (Exception, SystemExit) as error:
        findings.add(rule, where, f"it raised {raised(error, of=function)}")
        return None


def difference(first: object, second: object) -> str:
    """Return the first place where two things differ ("agents.x"), or "": equal to the bit."""
    for a, b in zip_longest(leaves(first), leaves(second)):
        if a != b:
            return (a or b or ("",))[0] or "itself"
    return ""


def leaves(thing: object, path: str = "") -> Iterator[tuple[str, object]]:
    """Yield all numbers, texts and arrays within a thing, with their places."""
    if isinstance(thing, np.ndarray) and thing.dtype != object:
        yield path, (thing.shape, thing.dtype.str, thing.tobytes())
    elif is_dataclass(thing) and not isinstance(thing, type):
        for field in fields(thing):
            yield from leaves(getattr(thing, field.name, None), f"{path}.{field.name}".lstrip("."))
    elif isinstance(thing, Mapping):
        for key, value in thing.items():
            yield from leaves(value, f"{path}[{key!r}]")
    elif isinstance(thing, Sequence) and not isinstance(thing, str | bytes):
        yield path, len(thing)
        for k, value in enumerate(thing):
            yield from leaves(value, f"{path}[{k}]")
    elif isinstance(thing, float | np.floating):
        yield path, float(thing).hex()
    else:
        yield (
            path,
            thing
            if isinstance(thing, str | bytes | int | Enum | None)
            else type(thing).__qualname__,
        )


def scenarios_or_default(scenarios: Iterable[Scenario] | None) -> list[Scenario]:
    """The scenarios; None: those of `SCENARIOS`."""
    return (
        [catalogue_scenario(name) for name in SCENARIOS] if scenarios is None else list(scenarios)
    )
