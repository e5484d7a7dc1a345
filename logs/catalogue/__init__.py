"""Synthesised scenario families: deterministic, with their parameters in the metadata."""

from collections.abc import Iterable

from logs.catalogue import euro_ncap, everyday, faults, iso3888, paper, pedestrians, raw, rules, unece_r157
from logs.catalogue.family import Family
from logs.errors import ConfigError
from logs.extension import Kind, an_instance
from logs.scenario import Scenario

CATALOGUE: dict[str, Family] = {
    family.name: family
    for family in (*paper.FAMILIES, *everyday.FAMILIES, *rules.FAMILIES, *pedestrians.FAMILIES, raw.CROSSING)
}
"""The families that the built-in suite has, by name, in the order in which they are listed."""
FAMILIES: dict[str, Family] = CATALOGUE | {
    family.name: family
    for family in (
        *euro_ncap.FAMILIES,
        *unece_r157.FAMILIES,
        *iso3888.FAMILIES,
        *faults.FAMILIES,
        *raw.FAMILIES,
    )
}
"""Those and the ones with published grids."""
FAMILY: Kind[Family] = Kind("family", "families", FAMILIES, an_instance(Family, "replan.Family"))
"""Finds those, and users' own."""


def families() -> dict[str, Family]:
    """Ours, and those of other distributions; ConfigError where an entry point has another name than its family."""
    found = FAMILY.installed()
    for name, family in found.items():
        if family.name != name:
            raise ConfigError(f"the entry point of the family '{family.name}' is called '{name}'; give them one name")
    return FAMILIES | found


def scenario(name: str) -> Scenario:
    """The scenario of a name as scenarios have it: "family" or "family@parameter=number,parameter=number".

    The family may be "module:NAME", of users' own.

    Raises:
        ConfigError: No family has that name, or it refuses the parameters.
    """
    family, _, words = name.partition("@")
    return FAMILY.find(family).scenario(**numbers(words.split(",") if words else (), name))


def numbers(words: Iterable[str], where: str) -> dict[str, float]:
    """Parameters from "key=value" words.

    Raises:
        ConfigError: A word has no `=`, or its value is no number.
    """
    out = {}
    for word in words:
        key, separator, value = word.partition("=")
        try:
            out[key.strip()] = float(value)
        except ValueError:
            hint = f"'{value}' is no number" if separator else "there is no '='"
            raise ConfigError(f"{where}: write {word} as parameter=number; {hint}") from None
    return out


__all__ = ["CATALOGUE", "FAMILIES", "FAMILY", "Family", "families", "numbers", "scenario"]
