"""Reductions: how the steps of a series become one number of the table.

In a sum over time each step stands for half of the time to each of its neighbours, so the steps
last as long as the drive.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.metrics.metric import Reduction, Series

LEAST_S = 4.0  # For `share_beyond`: the horizon over which plans are judged


def durations(t: FloatArray) -> FloatArray:
    """Return the duration of each step `(n,)`, s: half of the time to each neighbour.

    They sum to the drive's.
    """
    return split_to_neighbours(np.diff(t))


def split_to_neighbours(between: FloatArray) -> FloatArray:
    """Split values between the steps `(n - 1,)` into values of the steps `(n,)`: half goes to each
    neighbour.
    """
    shares = np.zeros(len(between) + 1)
    shares[:-1] += 0.5 * between
    shares[1:] += 0.5 * between
    return shares


def first_of(flags: BoolArray) -> int:
    """Return the first marked step; -1 if no step is marked."""
    return int(np.argmax(flags)) if flags.any() else -1


def longest(series: Series, flags: BoolArray) -> tuple[float, int]:
    """Return the longest unbroken stretch of marked steps: duration, s, and first step.

    The earliest of equals.
    """
    if not flags.any():
        return 0.0, -1
    edge = np.diff(np.r_[False, flags, False].astype(np.int64))
    first, end = np.flatnonzero(edge > 0), np.flatnonzero(edge < 0)
    until = np.r_[0.0, np.cumsum(durations(series.t))]
    length = until[end] - until[first]
    best = int(np.argmax(length > length.max() - 1e-9))
    return float(length[best]), int(first[best])


def _mean(series: Series) -> tuple[float, int]:
    return float(np.mean(series.value[series.known])), -1


def _root_mean_square(series: Series) -> tuple[float, int]:
    return float(np.sqrt(np.mean(series.value[series.known] ** 2))), -1


def _extreme(series: Series, score: FloatArray, value: FloatArray) -> tuple[float, int]:
    """Return the value at the step with the highest score (the earliest of equals), and that
    step.
    """
    step = int(np.argmax(np.where(series.known, score, -np.inf)))
    return float(value[step]), step


def _largest_size(series: Series) -> tuple[float, int]:
    size = np.abs(series.value)
    return _extreme(series, size, size)


def _last_value(series: Series) -> tuple[float, int]:
    return _extreme(series, np.arange(len(series.t), dtype=float), series.value)


def _percentile(q: float) -> Callable[[Series], tuple[float, int]]:
    def reduce(series: Series) -> tuple[float, int]:
        """Equal `np.percentile` bit for bit, in a tenth of its time."""
        size = np.sort(np.abs(series.value[series.known]))
        place = (len(size) - 1) * (q / 100.0)
        low, share = float(size[int(place)]), place - int(place)
        high = float(size[min(int(place) + 1, len(size) - 1)])
        if share < 0.5:
            return low + (high - low) * share, -1
        return high - (high - low) * (1.0 - share), -1

    return reduce


def _sum(series: Series) -> tuple[float, int]:
    events = (series.value != 0.0) & series.known
    return float(np.sum(series.value[series.known])), first_of(events)


def _mean_and_first(series: Series) -> tuple[float, int]:
    return float(np.mean(series.value[series.known])), first_of(series.value > 0.0)


def share_known(series: Series) -> tuple[float, int]:
    """Return the share of the steps that have a value, and the first such step."""
    return float(np.mean(series.known)), first_of(series.known)


MEAN = Reduction("mean", _mean)
MIN = Reduction("min", lambda series: _extreme(series, -series.value, series.value))
MAX = Reduction("max", lambda series: _extreme(series, series.value, series.value))
MAX_ABS = Reduction("max_abs", _largest_size)
RMS = Reduction("rms", _root_mean_square)
P95 = Reduction("p95", _percentile(95.0))  # of the absolute value, linear between order statistics
P99 = Reduction("p99", _percentile(99.0))  # 99th percentile, likewise
FINAL = Reduction("final", _last_value)
COUNT = Reduction("count", _sum, unit="count", empty=0.0)
"""Sum over the steps; its time is that of the first step that is not 0."""
RATE = Reduction("rate", _mean_and_first, unit="1", empty=0.0)
"""Mean over the steps of a 0/1 series; its time is the first 1."""
HAVING = Reduction("rate", share_known, unit="1", direction="lower", empty=0.0)
"""Share of the steps that have a value; its time is that of the first such step."""
SHARE = Reduction(
    "share", lambda series: (share_known(series)[0], -1), unit="1", direction="higher", empty=0.0
)
"""Share of the steps that have a value, where every step should have one.

Below 1, the mean is over a part only.
"""


def _marked_time(
    name: str,
    mark: Callable[[Series], BoolArray],
    whole: Callable[[Series, FloatArray], float] | None = None,
    bounds: tuple[float, float] | None = None,
) -> Reduction:
    """Duration of the marked steps, s, or their share of the duration `whole`.

    Its time is the first marked step.
    """

    def reduce(series: Series) -> tuple[float, int]:
        flags, weight = mark(series), durations(series.t)
        if not flags.any():
            return 0.0, -1
        total = whole(series, weight) if whole else 1.0
        share = float(np.sum(weight[flags])) / total if total > 0.0 else float(flags[0])
        return share, first_of(flags)

    return Reduction(name, reduce, "1" if whole else "s", "lower", 0.0, bounds)


def time_outside(low: float, high: float, name: str) -> Reduction:
    """Seconds during which the value is below `low` or above `high`; 0 where no step has a
    value.
    """

    def outside(series: Series) -> BoolArray:
        return (series.value < low) | (series.value > high)

    return _marked_time(name, outside, bounds=(low, high))


def time_below(bound: float, name: str) -> Reduction:
    """Seconds during which the value is below `bound`; 0 where no step has a value."""
    return time_outside(bound, np.inf, name)


def time_above(bound: float, name: str) -> Reduction:
    """Seconds during which the absolute value is above `bound`."""
    return time_outside(-bound, bound, name)


def worst_episode(low: float, high: float) -> Reduction:
    """Longest unbroken stretch below `low` or above `high`, s.

    Its time is the stretch's first step.
    """

    def reduce(series: Series) -> tuple[float, int]:
        return longest(series, (series.value < low) | (series.value > high))

    return Reduction("worst_episode", reduce, "s", "lower", 0.0, (low, high))


def share_while(condition: Callable[[FloatArray], BoolArray], name: str) -> Reduction:
    """Share of the drive's time during which a condition holds; 0 if no step has a value."""
    return _marked_time(
        name,
        lambda series: condition(series.value) & series.known,
        lambda series, weight: float(weight.sum()),
    )


def share_beyond(bound: float, name: str) -> Reduction:
    """Share of the time of the steps with a value (at least `LEAST_S`) during which the value is
    above `bound`.
    """

    def beyond(series: Series) -> BoolArray:
        return series.value > bound

    return _marked_time(
        name,
        beyond,
        lambda series, weight: max(float(weight[series.known].sum()), LEAST_S),
    )
