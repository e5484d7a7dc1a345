"""Axes of all pictures: round steps, ticks, and ranges with a margin."""

from __future__ import annotations

from math import ceil, floor, log10

import numpy as np

from logs.kernel import FloatArray

ROUND = (1.0, 2.0, 5.0, 10.0)
"""Steps are these multiples of a power of ten."""


def nice_step(span: float, most: int, factors: tuple[float, ...] = ROUND) -> float:
    """The smallest round step that divides a span into at most `most` parts."""
    rough = max(span, 1e-9) / most
    unit = 10.0 ** floor(log10(rough))
    return float(next(unit * factor for factor in factors if unit * factor >= rough * (1.0 - 1e-9)))


def multiples(low: float, high: float, step: float) -> FloatArray:
    """The multiples of a step in a range."""
    return np.arange(ceil(low / step - 1e-9), floor(high / step + 1e-9) + 1) * step


def ticks(low: float, high: float, most: int) -> FloatArray:
    """Multiples of 1, 2, 2.5 or 5 times a power of ten in a range: at least two, about `most` at most."""
    for bins in range(max(most, 2), 40):
        found = multiples(low, high, nice_step(high - low, bins, (1.0, 2.0, 2.5, 5.0, 10.0)))
        if len(found) > 1:
            return found
    return np.array([low, high])


def widened(low: float, high: float, least: float, room: float = 0.06) -> tuple[float, float]:
    """A range with a margin, never shorter than `least`, so that a constant value looks constant."""
    half = max((0.5 + room) * (high - low), 0.5 * least)
    return 0.5 * (low + high) - half, 0.5 * (low + high) + half
