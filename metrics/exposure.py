"""Reductions over time that count every step, the last one too: time exposed, time integrated.

A step stands for half of the time to each of its neighbours (the trapezoid rule), so that the weights add up to the
drive's duration and the step of a contact, which is often the last, counts.

(1) TET = sum of w_k [TTC_k <= tau],  time exposed time-to-collision, s
(2) TIT = sum of w_k (tau - TTC_k) [TTC_k <= tau],  time integrated time-to-collision, s^2: the variant of the published
    definition and of commonroad-crime; the other one integrates 1 / TTC - 1 / tau and is infinite at a contact

Source: Minderhoud, Bovy, Accid. Anal. Prev. 33 (2001) 89.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from logs.kernel import BoolArray, FloatArray
from metrics.metric import Direction, Reduction, Series

TAU_S = 1.5
"""Critical TTC of the criticality metrics catalogue (Westhofen et al., Arch. Comput. Methods Eng. 30, 2023)."""


def weights(t: FloatArray) -> FloatArray:
    """How long each of the steps `(n,)` stands for, s; 0 where there is but one."""
    half = 0.5 * np.diff(t)
    return np.r_[half, 0.0] + np.r_[0.0, half]


def _first(flags: BoolArray) -> int:
    return int(np.argmax(flags)) if flags.any() else -1


def seconds_while(holds: Callable[[FloatArray], BoolArray], name: str) -> Reduction:
    """Seconds in which a condition holds (NaN: it does not); 0 where no step has a value."""

    def reduce(series: Series) -> tuple[float, int]:
        flags = holds(series.value) & series.known
        return float(np.sum(weights(series.t)[flags])), _first(flags)

    return Reduction(name, reduce, "s", "lower", 0.0)


def seconds_below(bound: float, name: str) -> Reduction:
    """Seconds in which the value is below `bound`."""
    return seconds_while(lambda value: value < bound, name)


def seconds_above(bound: float, name: str) -> Reduction:
    """Seconds in which the value is above `bound`."""
    return seconds_while(lambda value: value > bound, name)


def share_while(holds: Callable[[FloatArray], BoolArray], name: str, direction: Direction = "lower") -> Reduction:
    """Share of the drive's time in which a condition holds; 0 where no step has a value."""

    def reduce(series: Series) -> tuple[float, int]:
        flags, weight = holds(series.value) & series.known, weights(series.t)
        total = float(np.sum(weight))
        return (float(np.sum(weight[flags])) / total if total > 0.0 else float(flags[0])), _first(flags)

    return Reduction(name, reduce, "1", direction, 0.0)


def integrated_below(tau: float, name: str) -> Reduction:
    """(2) with the bound `tau`; 0 where no step has a value."""

    def reduce(series: Series) -> tuple[float, int]:
        flags = series.known & (series.value <= tau)
        return float(np.sum((weights(series.t) * (tau - series.value))[flags])), _first(flags)

    return Reduction(name, reduce, "s2", "lower", 0.0)
