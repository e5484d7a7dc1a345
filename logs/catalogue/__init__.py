"""Synthesised scenario families: deterministic, with their parameters in the metadata; and suites
of their cells.

There is one order of all cells; a suite is a prefix of it, so that a smaller suite is part of a
larger one; the group `separating` is a suite of its own. The k-th cell, from 0, of a family with n
cells has the position

(1) k / sqrt(n)

so that at first each family gives one cell, with the groups in turn, and then about as many as the
root of its size (power allocation; Bankier, The American Statistician 42, 1988): a large grid is
represented, and does not hide small ones.

Within a family the cells spread: the next is the one farthest from all before it, by the indices of
its values in their lists, each scaled to length 1 (a maximin design; Johnson, Moore, Ylvisaker, J.
Stat. Plan. Inference 26, 1990). The corners of a grid come early. Draws use the SHA-256 of seed,
family and cell, so that they do not change when another family is added.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from hashlib import sha256
from heapq import merge
from itertools import chain, islice, zip_longest
from math import sqrt

import numpy as np

from replan.core.errors import ConfigError, unknown_name
from replan.core.extension import ExtensionKind, an_instance
from replan.logs.catalogue import (
    euro_ncap,
    everyday,
    faults,
    iso3888,
    paper,
    pedestrians,
    raw,
    separating,
    unece_r157,
)
from replan.logs.catalogue.family import Family
from replan.logs.scenario import Scenario

CATALOGUE: dict[str, Family] = {
    family.name: family
    for family in (
        *paper.FAMILIES,
        *everyday.FAMILIES,
        *everyday.RULES,
        *pedestrians.FAMILIES,
        raw.crossing,
    )
}
"""The families without published grids by name, in the order of lists."""
_ALIKE = {f"pedestrian/{name}" for name in ("turns_back", "hesitates", "group", "both_sides")}
BUILTIN = tuple(name for name in CATALOGUE if name not in _ALIKE)
"""The logs of the built-in suite.

What fails with the pedestrians that are left out fails with the others, too.
"""
FAMILIES: dict[str, Family] = CATALOGUE | {
    family.name: family
    for family in (
        *euro_ncap.FAMILIES,
        *unece_r157.FAMILIES,
        *iso3888.FAMILIES,
        *faults.FAMILIES,
        *raw.FAMILIES,
        *separating.FAMILIES,
    )
}
"""All built-in families: those of `CATALOGUE` and those with published grids."""
FAMILY: ExtensionKind[Family] = ExtensionKind(
    "family", "families", FAMILIES, an_instance(Family, "replan.Family")
)
"""Finds families by name: the built-in ones and those of users."""


SEED = 1
SEPARATING = "separating"
"""A group of families that is a suite of its own, and no part of the others."""


@dataclass(frozen=True)
class Suite:
    """A suite: its number of cells and its purpose."""

    size: int
    summary: str


SUITES: Mapping[str, Suite] = {
    "smoke": Suite(20, "some of every group: does it run"),
    "full": Suite(300, "every family, the corners of its grid first: before a release"),
    "nightly": Suite(3000, "the grids: at night"),
    SEPARATING: Suite(26, "tells planners with faults in their input from those without"),
}


def families() -> dict[str, Family]:
    """The built-in families and those of other distributions; ConfigError if an entry point has
    another name.
    """
    all_families = FAMILY.installed()
    for name, family in all_families.items():
        if family.name != name:
            raise ConfigError(
                f"the entry point of the family '{family.name}' is called '{name}'; give them one "
                "name"
            )
    return FAMILIES | all_families


def scenario(name: str) -> Scenario:
    """Build the scenario with a name: "family" or "family@parameter=number,parameter=number".

    The family may be a user's, "module:NAME".

    Raises:
        ConfigError: No family has this name, or it refuses the parameters.
    """
    family, _, words = name.partition("@")
    return FAMILY.find(family).scenario(**numbers(words.split(",") if words else (), name))


def scenario_name(name: str) -> str:
    """The name that the scenario of this name has, which does not tell a user's module; raises as
    `scenario`, but does not build it.
    """
    family, _, words = name.partition("@")
    return FAMILY.find(family).named(numbers(words.split(",") if words else (), name))


def numbers(words: Iterable[str], where: str) -> dict[str, float]:
    """Parameters from "key=value" words; ConfigError if a word has no `=`, or its value is not a
    number.
    """
    parameters = {}
    for word in words:
        key, separator, value = word.partition("=")
        try:
            parameters[key.strip()] = float(value)
        except ValueError:
            hint = f"'{value}' is no number" if separator else "there is no '='"
            raise ConfigError(f"{where}: write {word} as parameter=number; {hint}") from None
    return parameters


def suite(name: str, seed: int = SEED) -> tuple[str, ...]:
    """Names of scenarios (`scenario`): those of a suite, or of all cells of a family or a group.

    A suite has built-in families only; a user's family is "module:NAME".

    Raises:
        ConfigError: No suite, family or group has this name.
    """
    if name in SUITES and name != SEPARATING:
        return tuple(islice(ordered(seed), SUITES[name].size))
    if ":" in name:
        own = FAMILY.find(name)
        return tuple(name + own.named(cell).removeprefix(own.name) for cell in own.cells())
    by_name = families()
    meant = [family for key, family in by_name.items() if name in (key, key.partition("/")[0])]
    if not meant:
        raise unknown_name("suite", name, [*SUITES, *groups(), *by_name])
    return tuple(family.named(cell) for family in meant for cell in family.cells())


def groups() -> dict[str, list[Family]]:
    """The families by group."""
    by_group: dict[str, list[Family]] = {}
    for name, family in FAMILIES.items():
        by_group.setdefault(name.partition("/")[0], []).append(family)
    return by_group


def ordered(seed: int = SEED) -> Iterator[str]:
    """All cells of all families in the order of the module docstring, as names; without
    `SEPARATING`.
    """
    in_order = [group for name, group in groups().items() if name != SEPARATING]
    turns = zip_longest(
        *(sorted(group, key=lambda family: _draw(seed, family.name)) for group in in_order)
    )
    in_turn = [family for family in chain.from_iterable(turns) if family is not None]

    def placed(turn: int, family: Family) -> Iterator[tuple[float, int, str]]:
        rate = sqrt(sum(1 for _ in family.cells()))
        return ((k / rate, turn, name) for k, name in enumerate(spread(family, seed)))  # (1)

    return (
        name for _, _, name in merge(*(placed(turn, family) for turn, family in enumerate(in_turn)))
    )


def spread(family: Family, seed: int = SEED) -> Iterator[str]:
    """The cells of a family, each farthest from those before it; draws decide ties."""
    by_name = {family.named(cell): cell for cell in family.cells()}
    cells = sorted(by_name, key=lambda name: _draw(seed, name))
    places = np.empty((len(cells), len(family.grid)))
    for column, (key, values) in enumerate(family.grid.items()):
        places[:, column] = [
            values.index(by_name[name][key]) / max(len(values) - 1, 1) for name in cells
        ]
    far = np.full(len(cells), np.inf)
    for _ in cells:
        k = int(np.argmax(far))
        yield cells[k]
        far = np.minimum(far, ((places - places[k]) ** 2).sum(axis=1))
        far[k] = -1.0


def _draw(seed: int, name: str) -> bytes:
    return sha256(f"{seed} {name}".encode()).digest()


__all__ = [
    "BUILTIN",
    "CATALOGUE",
    "FAMILIES",
    "FAMILY",
    "SEED",
    "SUITES",
    "Family",
    "Suite",
    "families",
    "groups",
    "numbers",
    "ordered",
    "scenario",
    "spread",
    "suite",
]
