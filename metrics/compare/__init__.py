"""Comparison of two runs: their tables (`tables`), and the rules that a candidate must keep (`rules`)."""

from metrics.compare.rules import Rule, judged, load_rules
from metrics.compare.tables import DRIVE, PARTING_COLUMNS, Comparison, RuleVerdict, Side, compare

__all__ = [
    "DRIVE", "PARTING_COLUMNS", "Comparison", "Rule", "RuleVerdict", "Side", "compare", "judged", "load_rules",
]  # fmt: skip
