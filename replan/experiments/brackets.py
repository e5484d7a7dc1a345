"""Pairs of points between which a surface changes from pass to another outcome, and their
bisection.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

PASS, ERROR = "pass", "error"

Cell = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Bracket:
    """Two points of a row, of which one has the outcome pass and the other has not.

    Attributes:
        row: Value of the second axis; empty with one axis.
        low: The lower point; `high` is the higher one.
        at_low: The outcome there; `at_high` likewise.
        is_open: Whether it can be halved; False after a point between could not be evaluated.
    """

    row: tuple[float, ...]
    low: float
    high: float
    at_low: str
    at_high: str
    is_open: bool = True

    @property
    def middle(self) -> float:
        """The midpoint."""
        return 0.5 * (self.low + self.high)

    @property
    def width(self) -> float:
        """Distance of the points."""
        return self.high - self.low

    def halved(self, outcome: str) -> Bracket:
        """The half that contains the edge, by the outcome in the middle."""
        if outcome == ERROR:
            return replace(self, is_open=False)
        if (outcome == PASS) == (self.at_low == PASS):
            return replace(self, low=self.middle, at_low=outcome)
        return replace(self, high=self.middle, at_high=outcome)


def brackets(outcomes: Mapping[Cell, str]) -> tuple[Bracket, ...]:
    """Neighbouring cells `(x, *row)` that differ in whether they pass.

    A cell with an error ends no bracket.
    """
    pairs = []
    for row in sorted({cell[1:] for cell in outcomes}):
        line = sorted((cell[0], outcome) for cell, outcome in outcomes.items() if cell[1:] == row)
        for (low, at_low), (high, at_high) in pairwise(line):
            if ERROR not in (at_low, at_high) and (at_low == PASS) != (at_high == PASS):
                pairs.append(Bracket(row, low, high, at_low, at_high))
    return tuple(pairs)


def bisect_brackets(
    pairs: Sequence[Bracket], evaluate: Callable[[Sequence[Cell]], Sequence[str]], resolution: float
) -> tuple[Bracket, ...]:
    """The brackets halved until they are no wider than `resolution`; `evaluate` gives the outcomes
    of cells.
    """
    widest = resolution * (1.0 + 1e-9)
    current = list(pairs)
    while wide := [k for k, pair in enumerate(current) if pair.is_open and pair.width > widest]:
        outcomes = evaluate([(current[k].middle, *current[k].row) for k in wide])
        for k, outcome in zip(wide, outcomes, strict=True):
            current[k] = current[k].halved(outcome)
    return tuple(current)
