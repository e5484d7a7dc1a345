"""Synthesised scenario families: deterministic, with their parameters in the metadata."""

from logs.catalogue import everyday, paper, pedestrians, rules
from logs.catalogue.family import Family

CATALOGUE: dict[str, Family] = {
    family.name: family for family in (*paper.FAMILIES, *everyday.FAMILIES, *rules.FAMILIES, *pedestrians.FAMILIES)
}
"""Families by name, in the order in which they are listed."""

__all__ = ["CATALOGUE", "Family"]
