"""A scenario family: named parameters with units, and a deterministic builder.

The scenario's metadata have the generator's version, all parameters, and `expected_decisions` as
JSON: agent id or "stop line ID" -> kinds (`DecisionKind` values). A planner should make one of
these decisions about it at some time of the drive. Agents and lines that are not listed need no
decision.

The logged driver of a scenario has no collision. Where that is impossible in a cell of a published
grid, the log ends with the last state `before_contact`, and the metadata have the agent and the
time of the contact.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from math import isfinite
from types import MappingProxyType

from replan.core.errors import ConfigError
from replan.logs.plan import DecisionKind
from replan.logs.scenario import Scenario
from replan.logs.shapes import overlap

VERSION = "1"


@dataclass(frozen=True, eq=False)
class Family:
    """One family of scenarios.

    Attributes:
        name: "group/name".
        summary: One line for lists.
        parameters: Defaults by name, units in the names.
        tags: Words by which gates and reports group scenarios.
        build: All parameters -> Scenario; raises ValueError for parameters without a valid
            scenario.
        grid: Published values by parameter, whose product gives the family's cells; empty: one
            cell, the defaults.
        source: Source of the numbers.
        holds: All parameters -> whether the grid contains this cell of the product (the ego is
            faster than its target).
    """

    name: str
    summary: str
    parameters: Mapping[str, float]
    tags: tuple[str, ...]
    build: Callable[[Mapping[str, float]], Scenario]
    grid: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    source: str = ""
    holds: Callable[[Mapping[str, float]], bool] = lambda parameters: True

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", MappingProxyType(dict(self.parameters)))
        object.__setattr__(self, "grid", MappingProxyType(dict(self.grid)))

    def cells(self) -> Iterator[dict[str, float]]:
        """The cells of the grid, the last parameter varying fastest."""
        for values in product(*self.grid.values()):
            cell = dict(zip(self.grid, values, strict=True))
            if self.holds({**self.parameters, **cell}):
                yield cell

    def named(self, changed: Mapping[str, float]) -> str:
        """The name of a variant, from which `replan.logs.catalogue.scenario` builds it, with every
        number in full.
        """
        words = []
        for name, value in sorted(changed.items()):
            short = f"{value:g}"
            words.append(f"{name}={short if float(short) == value else repr(float(value))}")
        variant = ",".join(words)
        return f"{self.name}@{variant}" if variant else self.name

    def scenario(self, **overrides: float) -> Scenario:
        """The scenario with these parameters changed, which its name lists; ConfigError if there is
        none with them.
        """
        unknown = sorted(set(overrides) - set(self.parameters))
        if unknown:
            raise ConfigError(
                f"{self.name} has no parameter {unknown[0]}; it has {', '.join(self.parameters)}"
            )
        changed = {name: float(value) for name, value in overrides.items()}
        for name, value in changed.items():
            if not isfinite(value):
                raise ConfigError(f"{self.name}: {name} is {value}, it must be finite")
        parameters = {**self.parameters, **changed}
        try:
            scenario = self.build(parameters)
        except ValueError as error:
            raise ConfigError(
                f"{self.name}: {error}; change {', '.join(changed) or 'a parameter'}"
            ) from error
        touched = touches(scenario)
        if touched is not None:
            raise ConfigError(
                f"{self.name}: with these parameters the logged driver touches {touched}"
            )
        metadata = {
            "generator": "replan catalogue",
            "generator_version": VERSION,
            "family": self.name,
            **({"parameter_source": self.source} if self.source else {}),
            **{f"parameter.{name}": repr(float(value)) for name, value in parameters.items()},
            **scenario.metadata,
        }
        return replace(
            scenario,
            name=self.named(changed),
            tags=("synthetic", *self.tags),
            source=f"replan catalogue: {self.name}",
            licence="Apache-2.0",
            metadata=metadata,
            traffic=((0.0, scenario.duration),),
        )


Build = Callable[[Mapping[str, float]], Scenario]


def family(
    name: str,
    summary: str,
    tags: tuple[str, ...],
    parameters: Mapping[str, float],
    grid: Mapping[str, tuple[float, ...]] | None = None,
    source: str = "",
    holds: Callable[[Mapping[str, float]], bool] = lambda p: True,
) -> Callable[[Build], Family]:
    """Decorator that makes a `Family` of a function that builds its scenarios."""

    def made(build: Build) -> Family:
        return Family(name, summary, parameters, tags, build, grid or {}, source, holds)

    return made


def expects(**kinds: tuple[DecisionKind, ...]) -> dict[str, str]:
    """The metadata entry `expected_decisions` (module docstring)."""
    return {
        "expected_decisions": json.dumps(
            {agent: [kind.value for kind in decisions] for agent, decisions in kinds.items()}
        )
    }


def touches(scenario: Scenario) -> str | None:
    """The first agent that the logged ego touches, or None."""
    contact = _contact(scenario)
    return None if contact is None else contact[1]


def before_contact(scenario: Scenario) -> Scenario:
    """The scenario, its ego log ended before the first contact, which the metadata name; ValueError
    at the start.
    """
    contact = _contact(scenario)
    if contact is None:
        return scenario
    step, agent = contact
    if step == 0:
        raise ValueError(f"{agent} is in the ego at the start")
    t = scenario.ego.t
    meeting = {
        "logged_driver_would_meet": agent,
        "logged_driver_would_meet_s": repr(float(t[step])),
    }
    ego = scenario.ego.between(float(t[0]), float(t[step - 1]))
    return replace(scenario, ego=ego, metadata={**scenario.metadata, **meeting})


def _contact(scenario: Scenario) -> tuple[int, str] | None:
    """The first state of the logged ego that touches an agent, and the agent's id."""
    ego, car = scenario.ego, scenario.vehicle
    for i in range(len(ego)):
        state, others = ego.state(i), scenario.tracks.truth(float(ego.t[i]))
        box = (*state.ahead(car.axle_to_center), state.yaw, car.length, car.width)
        for k in range(len(others)):
            other = (others.x[k], others.y[k], others.yaw[k], others.length[k], others.width[k])
            if overlap(*box, *(float(value) for value in other)):
                return i, others.ids[k]
    return None
