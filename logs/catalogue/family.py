"""A scenario family: named parameters with units, and a deterministic builder.

The scenario's metadata hold the generator's version, all parameters, and under `expected_decisions` what a planner may
decide, as JSON: agent id, or "stop line ID" -> kinds (`DecisionKind` values), one of which it should decide about that
agent or line at some time of the drive. Those that are not named need no decision.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import cos, isfinite, sin
from types import MappingProxyType

from logs.errors import ConfigError
from logs.scenario import Scenario
from logs.shapes import overlap
from logs.trace import DecisionKind

VERSION = "1"


@dataclass(frozen=True, eq=False)
class Family:
    """One family of scenarios.

    Attributes:
        name: "group/name".
        summary: One line for lists.
        parameters: Defaults by name, units in the names.
        tags: Words by which gates and reports group.
        build: All parameters -> Scenario; raises ValueError where they make no sense.
    """

    name: str
    summary: str
    parameters: Mapping[str, float]
    tags: tuple[str, ...]
    build: Callable[[Mapping[str, float]], Scenario]

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", MappingProxyType(dict(self.parameters)))

    def scenario(self, **overrides: float) -> Scenario:
        """The scenario with these parameters changed; a variant's name lists them.

        Raises:
            ConfigError: A parameter is unknown or not finite, or leaves no careful drive.
        """
        unknown = sorted(set(overrides) - set(self.parameters))
        if unknown:
            raise ConfigError(f"{self.name} has no parameter {unknown[0]}; it has {', '.join(self.parameters)}")
        changed = {name: float(value) for name, value in overrides.items()}
        for name, value in changed.items():
            if not isfinite(value):
                raise ConfigError(f"{self.name}: {name} is {value}, it must be finite")
        parameters = {**self.parameters, **changed}
        try:
            scenario = self.build(parameters)
        except ValueError as error:
            raise ConfigError(f"{self.name}: {error}; change {', '.join(changed) or 'a parameter'}") from error
        touched = touches(scenario)
        if touched is not None:
            raise ConfigError(f"{self.name}: with these parameters the logged driver touches {touched}")
        return self._signed(scenario, parameters, changed)

    def _signed(self, scenario: Scenario, parameters: Mapping[str, float], changed: Mapping[str, float]) -> Scenario:
        metadata = {
            "generator": "replan catalogue",
            "generator_version": VERSION,
            "family": self.name,
            **{f"parameter.{name}": repr(float(value)) for name, value in parameters.items()},
            **scenario.metadata,
        }
        variant = ",".join(f"{name}={value:g}" for name, value in sorted(changed.items()))
        return replace(
            scenario,
            name=f"{self.name}@{variant}" if variant else self.name,
            tags=("synthetic", *self.tags),
            source=f"replan catalogue: {self.name}",
            licence="Apache-2.0",
            metadata=metadata,
        )


def expects(**kinds: tuple[DecisionKind, ...]) -> dict[str, str]:
    """The metadata entry `expected_decisions` (module docstring)."""
    return {
        "expected_decisions": json.dumps({agent: [kind.value for kind in wanted] for agent, wanted in kinds.items()})
    }


def touches(scenario: Scenario) -> str | None:
    """The first agent that the logged ego touches, or None."""
    ego, car = scenario.ego, scenario.vehicle
    for i in range(len(ego)):
        state, others = ego.state(i), scenario.tracks.truth(float(ego.t[i]))
        x, y = state.x + car.axle_to_center * cos(state.yaw), state.y + car.axle_to_center * sin(state.yaw)
        box = (x, y, state.yaw, car.length, car.width)
        for k in range(len(others)):
            other = (others.x[k], others.y[k], others.yaw[k], others.length[k], others.width[k])
            if overlap(*box, *(float(value) for value in other)):
                return others.ids[k]
    return None
