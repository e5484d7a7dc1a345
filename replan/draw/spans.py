"""Ranges of axes, and their ticks."""

from __future__ import annotations

from math import ceil, floor, log10

import numpy as np

from replan.core.arrays import FloatArray

Span = tuple[float, float]
ROUND_FACTORS = (1.0, 2.0, 2.5, 5.0, 10.0)
MOST_TICKS = 40
ROUNDING = 1e-9  # Share of a step


def nice_step(span: float, most: int) -> float:
    """The smallest of 1, 2, 2.5, 5 times a power of ten that divides a span into at most `most`
    parts.
    """
    rough = max(span, 1e-9) / most
    unit = 10.0 ** floor(log10(rough))
    steps = (unit * factor for factor in ROUND_FACTORS)
    return next(step for step in steps if step >= rough * (1.0 - ROUNDING))


def ticks(low: float, high: float, most: int) -> FloatArray:
    """Multiples of a round step in a range: at least two, about `most` at most."""
    for parts in range(max(most, 2), MOST_TICKS):
        step = nice_step(high - low, parts)
        multiples = np.arange(ceil(low / step - ROUNDING), floor(high / step + ROUNDING) + 1) * step
        if len(multiples) > 1:
            return multiples
    return np.array([low, high])


def widened(low: float, high: float, least: float, room: float = 0.06) -> Span:
    """A range with a margin, never shorter than `least`, so that a constant value looks
    constant.
    """
    half = max((0.5 + room) * (high - low), 0.5 * least)
    return 0.5 * (low + high) - half, 0.5 * (low + high) + half
