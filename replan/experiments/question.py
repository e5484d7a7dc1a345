"""The question of a surface: `name=low:high:count` is an axis, `name=value` applies to all
cells.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from math import isfinite, prod
from typing import Any

import numpy as np

from replan.core.errors import ConfigError, unknown_name
from replan.experiments.ego_encounters import conflicting_agent
from replan.logs.edit.variations import VARIATIONS
from replan.logs.scenario import Scenario

FINER = 8
"""Default resolution of edges: the distance of two cells divided by this."""
NAMED_DIGITS = 15
"""Significant digits of a value in the name of its log: values that are equal with these are one
value.
"""
MOST_AXES, MOST_CELLS = 2, 10_000
FORM = "write it as NAME=LOW:HIGH:COUNT, or NAME=VALUE for all cells"
NEEDS = f"{FORM}; LOW below HIGH, COUNT 2 or more"


@dataclass(frozen=True)
class Axis:
    """One direction of the surface: a variation and its values, ascending."""

    name: str
    values: tuple[float, ...]

    @property
    def label(self) -> str:
        """The name with its unit."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    @property
    def unit(self) -> str:
        """The unit; "" for a number without one."""
        unit = VARIATIONS[self.name].unit
        return "" if unit == "1" else unit

    @property
    def spacing(self) -> float:
        """Distance of two values."""
        return self.values[1] - self.values[0]


@dataclass(frozen=True)
class SurfaceQuestion:
    """A surface to evaluate.

    Attributes:
        axes: One or two; the first is along the rows of the picture.
        fixed: Values by name that are the same in all cells.
        agents: Ids of the varied agents; empty if the agent is inserted.
        resolution: Width to which edges are bisected, in the unit of the first axis.
    """

    axes: tuple[Axis, ...]
    fixed: Mapping[str, float] = field(default_factory=dict)
    agents: tuple[str, ...] = ()
    resolution: float = 0.0

    @property
    def cells(self) -> Iterator[tuple[float, ...]]:
        """The values of each cell, row by row (the first axis changes fastest)."""
        values = product(*(axis.values for axis in self.axes[::-1]))
        return ((first, *others) for *others, first in values)

    def values(self, cell: Sequence[float]) -> dict[str, float]:
        """The values of all parameters in a cell, by name."""
        return {
            **self.fixed,
            **{axis.name: value for axis, value in zip(self.axes, cell, strict=True)},
        }

    @property
    def recorded(self) -> tuple[float, ...] | None:
        """The point of the surface at which nothing is varied; None if there is none."""
        point = tuple(VARIATIONS[axis.name].neutral for axis in self.axes)
        return point if all(map(isfinite, point)) and not self.fixed else None

    @property
    def varies_agents(self) -> bool:
        """Whether agents must be named: a variation changes agents, and no variation inserts its
        agent.
        """
        return vary_agents([*self.fixed, *(axis.name for axis in self.axes)])


def vary_agents(names: Iterable[str]) -> bool:
    """Whether variations change agents, and none of them inserts its agent."""
    kinds = [VARIATIONS[name] for name in names]
    return any(kind.of == "agent" for kind in kinds) and not any(kind.inserts for kind in kinds)


def check_agents(agents: Sequence[str], known: Collection[str], *, required: bool = False) -> None:
    """Raise ConfigError if an agent to vary is not known, or if one is required and none is
    named.
    """
    missing = [agent for agent in agents if agent not in known]
    if missing or (required and not agents):
        reason = f"no agent is called '{missing[0]}'" if missing else "no agent is named"
        raise ConfigError(f"{reason}; `replan vary LOG --list-agents` lists them")


def question(
    words: Sequence[str], agents: Sequence[str] = (), resolution: float | None = None
) -> SurfaceQuestion:
    """Parse the words of `--vary`.

    Raises:
        ConfigError: A word is not of this form, a name is unknown or duplicate, a value out of
            range, no or more than two axes, a resolution that is not positive.
    """
    axes: list[Axis] = []
    fixed: dict[str, float] = {}
    for word in words:
        name, values = _varied_values(word)
        if name in fixed or any(axis.name == name for axis in axes):
            raise ConfigError(f"--vary {word}: {name} is varied twice")
        if len(values) > 1:
            axes.append(Axis(name, values))
        else:
            fixed[name] = values[0]
    if not 1 <= len(axes) <= MOST_AXES:
        raise ConfigError(
            f"a surface has one or two axes, got {len(axes)}: --vary NAME=LOW:HIGH:COUNT"
        )
    if (count := prod(len(axis.values) for axis in axes)) > MOST_CELLS:
        raise ConfigError(f"--vary: {count} cells, a surface has at most {MOST_CELLS}; lower COUNT")
    if resolution is not None and not resolution > 0.0:
        raise ConfigError(f"--resolution must be positive, got {resolution:g}")
    return SurfaceQuestion(tuple(axes), fixed, tuple(agents), resolution or axes[0].spacing / FINER)


def _varied_values(word: str) -> tuple[str, tuple[float, ...]]:
    """The variation that a word names, and its values; ConfigError as `question`."""
    name, separator, text = word.partition("=")
    if not separator:
        raise ConfigError(f"--vary {word}: {FORM}")
    if name not in VARIATIONS:
        raise unknown_name("variation", name, VARIATIONS)
    try:
        numbers = [float(part) for part in text.split(":")]
    except ValueError:
        raise ConfigError(f"--vary {word}: '{text}' is no number; {FORM}") from None
    if len(numbers) == 3:
        numbers = _spaced(word, *numbers)
    elif len(numbers) != 1:
        raise ConfigError(f"--vary {word}: {NEEDS}")
    for value in numbers:
        VARIATIONS[name].check(value)
    return name, tuple(numbers)


def _spaced(word: str, low: float, high: float, count: float) -> list[float]:
    """`count` values from low to high; ConfigError as `question`."""
    if not (low < high and count >= 2 and count == int(count)):
        raise ConfigError(f"--vary {word}: {NEEDS}")
    if count > MOST_CELLS:
        raise ConfigError(f"--vary {word}: a surface has at most {MOST_CELLS} cells; lower COUNT")
    values: list[float] = np.linspace(low, high, int(count)).round(12).tolist()
    if len({f"{value:.{NAMED_DIGITS}g}" for value in values}) < len(values):
        raise ConfigError(f"--vary {word}: COUNT values are not apart; lower COUNT")
    return values


def question_about(
    scenario: Scenario, words: Sequence[str], agents: Sequence[str], resolution: float | None
) -> SurfaceQuestion:
    """The question of `--vary` about agents, named by whole id or short name; by default the one in
    conflict.

    Raises:
        ConfigError: As `question` and `replan.experiments.ego_encounters.conflicting_agent`.
    """
    asked = question(words, [*map(scenario.short_names.whole, agents)], resolution)
    if agents or not asked.varies_agents:
        return asked
    return replace(asked, agents=(conflicting_agent(scenario),))


def variations() -> Iterator[str]:
    """The variations, a line each."""
    width = max(map(len, VARIATIONS))
    for kind in VARIATIONS.values():
        neutral = f"; {kind.shown(kind.neutral)}: as recorded" if isfinite(kind.neutral) else ""
        ends = f"{kind.low:g} to {kind.shown(kind.high)}"
        yield f"{kind.name:{width}}  {kind.summary} ({ends}{neutral})"


def variation_table() -> list[dict[str, Any]]:
    """The content of `variations`, as data."""
    keys = ("name", "summary", "low", "high", "neutral")
    return [{key: getattr(kind, key) for key in keys} for kind in VARIATIONS.values()]
