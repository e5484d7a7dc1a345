"""Synthesised scenario families: deterministic, with their parameters in the metadata."""

from collections.abc import Iterable

from logs.catalogue import euro_ncap, everyday, faults, iso3888, paper, pedestrians, rules, unece_r157
from logs.catalogue.family import Family
from logs.errors import ConfigError, unknown_name
from logs.scenario import Scenario

CATALOGUE: dict[str, Family] = {
    family.name: family for family in (*paper.FAMILIES, *everyday.FAMILIES, *rules.FAMILIES, *pedestrians.FAMILIES)
}
"""The families that the built-in suite has, by name, in the order in which they are listed."""
FAMILIES: dict[str, Family] = CATALOGUE | {
    family.name: family for family in (*euro_ncap.FAMILIES, *unece_r157.FAMILIES, *iso3888.FAMILIES, *faults.FAMILIES)
}
"""Those and the ones with published grids."""


def scenario(name: str) -> Scenario:
    """The scenario of a name as scenarios have it: "family" or "family@parameter=number,parameter=number".

    Raises:
        ConfigError: No family has that name, or it refuses the parameters.
    """
    family, _, words = name.partition("@")
    if family not in FAMILIES:
        raise unknown_name("family", family, FAMILIES)
    return FAMILIES[family].scenario(**numbers(words.split(",") if words else (), name))


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


__all__ = ["CATALOGUE", "FAMILIES", "Family", "numbers", "scenario"]
