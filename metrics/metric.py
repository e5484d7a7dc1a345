"""The vocabulary of metrics: a Metric measures a trace step by step and reduces the steps to named
values.

A metric is one function `(trace, scenario) -> Series | Unavailable` and one entry in
`replan.metrics.GROUPS`. The function may also return a mapping from parts to these types ("1s",
"3s" of the displacement error). A complete example:

    def _speed(trace: Trace, scenario: Scenario) -> Measured:
        return Series(trace.ego.t, trace.ego.v)

    SPEED = Metric("speed", "m/s", "none", (Mode.CLOSED,), _speed, (MEAN, MAX), "Speed of the rear axle.")

It becomes the rows `speed.mean` and `speed.max` of the table, and the series `speed` of the plots.
A metric that cannot be measured returns Unavailable with the reason; a single step without a value
is NaN. Sentinel values and infinities are not allowed.
"""  # noqa: E501

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import wraps
from typing import Literal, ParamSpec, get_args

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, frozen
from replan.core.once import last
from replan.logs.forward import tighter_than_vehicle
from replan.logs.scenario import Scenario
from replan.logs.trace import Mode, Trace

P = ParamSpec("P")

Direction = Literal["lower", "higher", "none"]  # The direction that is better


@dataclass(frozen=True, eq=False, slots=True)
class Series:
    """One quantity over the steps of a drive.

    Attributes:
        t: `(n,)` s since the scenario's start, increasing, n >= 1.
        value: `(n,)`; NaN where the step has none.
        labels: `n` texts that name the road user or object that a step's value is about ("car 12"),
            or empty.
        missing: Why steps have no value; the reason of the row if no step has one.
        known: `(n,)` whether each step has a value; derived from `value`.

    Raises:
        ValueError: Columns differ in length or are empty, a time is not finite, or a value is
            infinite.
    """

    t: FloatArray
    value: FloatArray
    labels: tuple[str, ...] = ()
    missing: str = "no step has a value"
    known: BoolArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for name in ("t", "value"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        object.__setattr__(self, "known", np.isfinite(self.value))
        if self.t.shape != self.value.shape or self.t.ndim != 1 or not len(self.t):
            raise ValueError(f"series: t has shape {self.t.shape}, value {self.value.shape}")
        if not np.isfinite(self.t).all():
            raise ValueError("series: a time is not finite")
        if not self.known.all() and np.isinf(self.value).any():
            raise ValueError("series: a value is infinite; a missing one is NaN")
        if self.labels and len(self.labels) != len(self.t):
            raise ValueError(f"series: {len(self.labels)} labels for {len(self.t)} steps")


def counted(t: FloatArray, events: Iterable[tuple[int, str]]) -> Series:
    """Count the events (step and label) at each of the times `t` `(n,)`.

    Labels of one step are joined.
    """
    counts, labels = np.zeros(len(t)), [""] * len(t)
    for step, label in events:
        counts[step] += 1.0
        labels[step] = f"{labels[step]}; {label}" if labels[step] else label
    return Series(t, counts, tuple(labels))


@dataclass(frozen=True, slots=True)
class Unavailable:
    """The reason why a metric cannot be measured on this drive, one sentence."""

    reason: str


Measured = Series | Unavailable
Measure = Callable[[Trace, Scenario], Measured | Mapping[str, Measured]]


@dataclass(frozen=True, slots=True)
class Reduction:
    """Reduces a series that has at least one value to one number.

    Attributes:
        name: Second word of the row's name.
        reduce: Returns the value and its step, -1 if the value belongs to no step.
        unit: None: as the metric.
        direction: None: as the metric.
        empty: The value of a series without values (0 for a count); None: the reduction is
            unavailable then.
        bounds: The reduction sums over the steps below the first or above the second bound; None:
            it has no bounds.
    """

    name: str
    reduce: Callable[[Series], tuple[float, int]]
    unit: str | None = None
    direction: Direction | None = None
    empty: float | None = None
    bounds: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class Metric:
    """One metric: how it is measured, its unit, and which direction is better.

    Attributes:
        name: One word; first word of the row's name.
        unit: SI; "1" for a ratio, "count" for a number of events.
        direction: The direction that is better.
        modes: The loops in which it is defined.
        measure: The function that measures it.
        reductions: The numbers that the table shows, one row each.
        meaning: One sentence that defines it, with its parameters.
        source: Source of the definition; empty: replan.
        version: Increases when the meaning of the numbers changes.
        parts: The keys that `measure` may return; ("*",): any; empty: it returns one series.
        formula: The formula as plain text ("sqrt(x^2 + y^2)"); empty: `meaning` is complete.
        parameters: Its constants with their units, as "bound 0.95 s".
        needs: What a log or drive must contain for the metric to be available; empty: it always is.

    Raises:
        ValueError: A field has a wrong type or value.
    """

    name: str
    unit: str
    direction: Direction
    modes: tuple[Mode, ...]
    measure: Measure
    reductions: tuple[Reduction, ...]
    meaning: str
    source: str = ""
    version: int = 1
    parts: tuple[str, ...] = ()
    formula: str = ""
    parameters: tuple[str, ...] = ()
    needs: str = ""

    def __post_init__(self) -> None:
        names = [getattr(reduction, "name", "") for reduction in self.reductions]
        rules = {
            "name: one word": isinstance(self.name, str) and self.name.split() == [self.name],
            "unit: a word": isinstance(self.unit, str),
            f"direction: one of {', '.join(get_args(Direction))}": self.direction
            in get_args(Direction),
            "modes: a tuple of Mode": bool(self.modes)
            and all(isinstance(mode, Mode) for mode in self.modes),
            "measure: a function (trace, scenario)": callable(self.measure),
            "reductions: a tuple of Reduction": all(
                isinstance(one, Reduction) for one in self.reductions
            ),
            "reductions: at least one, with names of their own": len({*names}) == len(names) > 0,
        }
        broken = next((rule for rule, holds in rules.items() if not holds), None)
        if broken is not None:
            raise ValueError(f"metric {self.name!r}: {broken}")

    def found(self, trace: Trace, scenario: Scenario) -> Measured | Mapping[str, Measured]:
        """Return the cached result of `measure` for reuse by scores.

        A long drive caches only the newest results.
        """
        return (_remember_all if len(trace.ego) <= LONG_STEPS else _remember_newest)(
            trace, scenario, self.measure
        )

    def measured(self, trace: Trace, scenario: Scenario) -> dict[str, Measured]:
        """Return its series by full name ("gap", "ade.3s"); an unavailable metric has the names of
        its parts too.

        TypeError if `measure` returned something else.
        """
        found = self.found(trace, scenario)
        for one in found.values() if isinstance(found, Mapping) else (found,):
            if not isinstance(one, Series) and not (
                isinstance(one, Unavailable) and isinstance(one.reason, str)
            ):
                raise TypeError(
                    f"it returned {type(one).__name__}, not a Series, Unavailable, or a mapping to "
                    "these"
                )
        if isinstance(found, Mapping):
            return {f"{self.name}.{part}": series for part, series in found.items()}
        return self.unavailable(found) if isinstance(found, Unavailable) else {self.name: found}

    def unavailable(self, found: Unavailable) -> dict[str, Measured]:
        """Return all its series as unavailable, with one reason."""
        parts = () if self.parts == ("*",) else self.parts
        return {f"{self.name}.{part}": found for part in parts} or {self.name: found}


def _measure(
    trace: Trace, scenario: Scenario, measure: Measure
) -> Measured | Mapping[str, Measured]:
    return measure(trace, scenario)


_remember_all, _remember_newest = last(1024)(_measure), last(8)(_measure)
LONG_STEPS = 60_000  # Drives with more steps (1 MB per series) keep only the newest series
LEAST_S = 4.0  # For `share_beyond`: the horizon over which plans are judged


def where_followed(measure: Callable[P, Measured]) -> Callable[P, Measured]:
    """Make a measure, whose last argument is the scenario, unavailable where no planner can follow
    the log's path.
    """

    @wraps(measure)
    def asked(*args: P.args, **kwargs: P.kwargs) -> Measured:
        scenario = args[-1]
        assert isinstance(scenario, Scenario)
        tight = tighter_than_vehicle(scenario)
        return Unavailable(tight) if tight else measure(*args, **kwargs)

    return asked


def _extreme(series: Series, score: FloatArray, value: FloatArray) -> tuple[float, int]:
    """Return the value at the step with the highest score (the earliest of equals), and that
    step.
    """
    step = int(np.argmax(np.where(series.known, score, -np.inf)))
    return float(value[step]), step


def first_of(flags: BoolArray) -> int:
    """Return the first marked step; -1 if no step is marked."""
    return int(np.argmax(flags)) if flags.any() else -1


def _percentile(q: float) -> Callable[[Series], tuple[float, int]]:
    def reduce(series: Series) -> tuple[float, int]:
        """Equal `np.percentile` bit for bit, in a tenth of its time."""
        value = np.sort(np.abs(series.value[series.known]))
        at = (len(value) - 1) * (q / 100.0)
        low, share = float(value[int(at)]), at - int(at)
        high = float(value[min(int(at) + 1, len(value) - 1)])
        return low + (high - low) * share if share < 0.5 else high - (high - low) * (
            1.0 - share
        ), -1

    return reduce


def durations(t: FloatArray) -> FloatArray:
    """Return the duration of each step `(n,)`, s: half of the time to each neighbour.

    They sum to the drive's.
    """
    return split_to_neighbours(np.diff(t))


def split_to_neighbours(between: FloatArray) -> FloatArray:
    """Split values between the steps `(n - 1,)` into values of the steps `(n,)`: half goes to each
    neighbour.
    """
    out = np.zeros(len(between) + 1)
    out[:-1] += 0.5 * between
    out[1:] += 0.5 * between
    return out


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


MEAN = Reduction("mean", lambda series: (float(np.mean(series.value[series.known])), -1))
MIN = Reduction("min", lambda series: _extreme(series, -series.value, series.value))
MAX = Reduction("max", lambda series: _extreme(series, series.value, series.value))
MAX_ABS = Reduction(
    "max_abs", lambda series: _extreme(series, np.abs(series.value), np.abs(series.value))
)
RMS = Reduction(
    "rms", lambda series: (float(np.sqrt(np.mean(series.value[series.known] ** 2))), -1)
)
P95 = Reduction("p95", _percentile(95.0))  # of the absolute value, linear between order statistics
P99 = Reduction("p99", _percentile(99.0))  # 99th percentile, likewise
FINAL = Reduction(
    "final", lambda series: _extreme(series, np.arange(len(series.t), dtype=float), series.value)
)
COUNT = Reduction(
    "count",
    lambda series: (
        float(np.sum(series.value[series.known])),
        first_of((series.value != 0.0) & series.known),
    ),
    unit="count",
    empty=0.0,
)
"""Sum over the steps; its time is that of the first step that is not 0."""
RATE = Reduction(
    "rate",
    lambda series: (float(np.mean(series.value[series.known])), first_of(series.value > 0.0)),
    unit="1",
    empty=0.0,
)
"""Mean over the steps of a 0/1 series; its time is the first 1."""
HAVING = Reduction(
    "rate", lambda series: (float(np.mean(series.known)), first_of(series.known)), "1", "lower", 0.0
)
"""Share of the steps that have a value; its time is that of the first such step."""
SHARE = Reduction("share", lambda series: (float(np.mean(series.known)), -1), "1", "higher", 0.0)
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
        return float(np.sum(weight[flags])) / total if total > 0.0 else float(flags[0]), int(
            np.argmax(flags)
        )

    return Reduction(name, reduce, "1" if whole else "s", "lower", 0.0, bounds)


def time_outside(low: float, high: float, name: str) -> Reduction:
    """Seconds during which the value is below `low` or above `high`; 0 where no step has a
    value.
    """
    return _marked_time(
        name, lambda series: (series.value < low) | (series.value > high), bounds=(low, high)
    )


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
    return Reduction(
        "worst_episode",
        lambda series: longest(series, (series.value < low) | (series.value > high)),
        "s",
        "lower",
        0.0,
        (low, high),
    )


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
    return _marked_time(
        name,
        lambda series: series.value > bound,
        lambda series, weight: max(float(weight[series.known].sum()), LEAST_S),
    )


def rate_of_change(t: FloatArray, value: FloatArray, window: float) -> FloatArray:
    """Return the rate of change `(n,)` of a sampled value, per s; all metrics differentiate with
    this function.

    (1) rate(t) = (value(t) - value(t - window)) / window, linear between the samples;
            NaN in the first `window` s

    The rate is causal: later samples, and where a log is cut, do not change it.
    """
    before = np.interp(t - window, t, value)
    return np.where(t - window >= t[0] - 1e-9, (value - before) / window, np.nan)
