"""Reductions over time, in which each step holds for `metric.holds`, the last one too: time exposed, integrated.

(1) TET = sum of w_k [TTC_k <= tau],  time exposed time-to-collision, s
(2) TIT = sum of w_k (tau - TTC_k) [TTC_k <= tau],  time integrated time-to-collision, s^2: the variant of the published
    definition and of commonroad-crime; the other one integrates 1 / TTC - 1 / tau and is infinite at a contact

Source: Minderhoud, Bovy, Accid. Anal. Prev. 33 (2001) 89.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from logs.kernel import BoolArray, FloatArray
from metrics.metric import Direction, Reduction, Series, first_of, holds

TAU_S = 1.5
"""Critical TTC of the criticality metrics catalogue (Westhofen et al., Arch. Comput. Methods Eng. 30, 2023)."""
LEAST_S = 4.0
"""Of `share_beyond`: the horizon over which plans are judged."""


def share_while(condition: Callable[[FloatArray], BoolArray], name: str, direction: Direction = "lower") -> Reduction:
    """Share of the drive's time in which a condition holds; 0 where no step has a value."""

    def reduce(series: Series) -> tuple[float, int]:
        flags, weight = condition(series.value) & series.known, holds(series.t)
        total = float(np.sum(weight))
        return (float(np.sum(weight[flags])) / total if total > 0.0 else float(flags[0])), first_of(flags)

    return Reduction(name, reduce, "1", direction, 0.0)


def share_beyond(bound: float, name: str) -> Reduction:
    """Share of the time of the known steps in which the value is above `bound`; 0 where no step has a value.

    The time counts as `LEAST_S` at least: a few steps are no habit.
    """

    def reduce(series: Series) -> tuple[float, int]:
        flags, weight = series.value > bound, holds(series.t)
        return float(np.sum(weight[flags])) / max(float(np.sum(weight[series.known])), LEAST_S), first_of(flags)

    return Reduction(name, reduce, "1", "lower", 0.0)


def integrated_below(tau: float, name: str) -> Reduction:
    """(2) with the bound `tau`; 0 where no step has a value."""

    def reduce(series: Series) -> tuple[float, int]:
        flags = series.known & (series.value <= tau)
        return float(np.sum((holds(series.t) * (tau - series.value))[flags])), first_of(flags)

    return Reduction(name, reduce, "s2", "lower", 0.0)
