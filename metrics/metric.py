"""The vocabulary of metrics: a metric measures a drive step by step, and its reductions make named
values of the steps.

A metric is one function `(trace, scenario)` with the decorator `metric`, and one entry in
`replan.metrics.GROUPS`. The function returns a Series, Unavailable, or a mapping from parts to
these ("1s", "3s" of the displacement error). A complete example:

    @metric(unit="m/s", better="none", reductions=(MEAN, MAX))
    def speed(trace: Trace, scenario: Scenario) -> Measured:
        '''Speed of the rear axle.

        Formula: v
        '''
        return Series(trace.ego.t, trace.ego.v)

It becomes the rows `speed.mean` and `speed.max` of the table, and the series `speed` of the plots.
The first paragraph of the docstring is the metric's meaning; a paragraph that begins with
"Formula:" is its formula. A metric that cannot be measured returns Unavailable with the reason; a
single step without a value is NaN. Sentinel values and infinities are not allowed.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import wraps
from typing import Literal, ParamSpec, get_args

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, frozen
from replan.core.names import first_paragraph
from replan.core.once import last
from replan.logs.forward import tighter_than_vehicle
from replan.logs.scenario import Scenario
from replan.logs.trace import Mode, Trace

P = ParamSpec("P")

Direction = Literal["lower", "higher", "none"]  # The direction that is better
BOTH_LOOPS = (Mode.OPEN, Mode.CLOSED)


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


@dataclass(frozen=True, slots=True)
class Unavailable:
    """The reason why a metric cannot be measured on this drive, one sentence."""

    reason: str


Measured = Series | Unavailable
Parts = Mapping[str, Measured]
Measure = Callable[[Trace, Scenario], Measured | Parts]


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
                isinstance(reduction, Reduction) for reduction in self.reductions
            ),
            "reductions: at least one, with names of their own": len({*names}) == len(names) > 0,
        }
        broken = next((rule for rule, holds in rules.items() if not holds), None)
        if broken is not None:
            raise ValueError(f"metric {self.name!r}: {broken}")

    @property
    def rows(self) -> tuple[str, ...]:
        """The names of its rows in the table: "gap.min", "ade.3s.mean"; "*" stands for any part."""
        series = [f"{self.name}.{part}" for part in self.parts] or [self.name]
        return tuple(f"{name}.{reduction.name}" for name in series for reduction in self.reductions)

    def __call__(self, trace: Trace, scenario: Scenario) -> Measured | Parts:
        """Return the result of `measure`, cached for metrics that are made of others.

        A long drive caches only the newest results.
        """
        remember = _remember_all if len(trace.ego) <= LONG_STEPS else _remember_newest
        return remember(trace, scenario, self.measure)

    def measured(self, trace: Trace, scenario: Scenario) -> dict[str, Measured]:
        """Return its series by full name ("gap", "ade.3s"); an unavailable metric has the names of
        its parts too.

        TypeError if `measure` returned something else.
        """
        result = self(trace, scenario)
        for part in result.values() if isinstance(result, Mapping) else (result,):
            if not isinstance(part, Series) and not (
                isinstance(part, Unavailable) and isinstance(part.reason, str)
            ):
                raise TypeError(
                    f"it returned {type(part).__name__}, not a Series, Unavailable, or a mapping "
                    "to these"
                )
        if isinstance(result, Mapping):
            return {f"{self.name}.{part}": series for part, series in result.items()}
        return self.unavailable(result) if isinstance(result, Unavailable) else {self.name: result}

    def unavailable(self, reason: Unavailable) -> dict[str, Measured]:
        """Return all its series as unavailable, with one reason."""
        parts = () if self.parts == ("*",) else self.parts
        return {f"{self.name}.{part}": reason for part in parts} or {self.name: reason}


def metric(
    *,
    unit: str,
    better: Direction,
    reductions: Iterable[Reduction],
    modes: Iterable[Mode] = (Mode.CLOSED,),
    parts: Iterable[str] = (),
    parameters: Iterable[str] = (),
    needs: str = "",
    source: str = "",
    version: int = 1,
    name: str = "",
) -> Callable[[Measure], Metric]:
    """Make a metric of a function `(trace, scenario)`; the keywords are fields of `Metric`.

    The metric has the function's name, unless `name` is given. The first paragraph of the docstring
    is its meaning; a paragraph that begins with "Formula:" is its formula.
    """

    def decorate(measure: Measure) -> Metric:
        return Metric(
            name or measure.__name__,
            unit,
            better,
            tuple(modes),
            measure,
            tuple(reductions),
            first_paragraph(measure),
            source,
            version,
            tuple(parts),
            _formula(measure),
            tuple(parameters),
            needs,
        )

    return decorate


def _formula(measure: Measure) -> str:
    """Return the formula in a docstring, in one line; "" if it has none."""
    for paragraph in (inspect.getdoc(measure) or "").split("\n\n"):
        if paragraph.startswith("Formula:"):
            return " ".join(paragraph.removeprefix("Formula:").split())
    return ""


def _measure(trace: Trace, scenario: Scenario, measure: Measure) -> Measured | Parts:
    return measure(trace, scenario)


_remember_all, _remember_newest = last(1024)(_measure), last(8)(_measure)
LONG_STEPS = 60_000  # Drives with more steps (1 MB per series) keep only the newest series


def where_followed(measure: Callable[P, Measured]) -> Callable[P, Measured]:
    """Make a measure, whose last argument is the scenario, unavailable where no planner can follow
    the log's path.
    """

    @wraps(measure)
    def checked(*args: P.args, **kwargs: P.kwargs) -> Measured:
        scenario = args[-1]
        assert isinstance(scenario, Scenario)
        reason = tighter_than_vehicle(scenario)
        return Unavailable(reason) if reason else measure(*args, **kwargs)

    return checked


def counted(t: FloatArray, events: Iterable[tuple[int, str]]) -> Series:
    """Count the events (step and label) at each of the times `t` `(n,)`.

    Labels of one step are joined.
    """
    counts, labels = np.zeros(len(t)), [""] * len(t)
    for step, label in events:
        counts[step] += 1.0
        labels[step] = f"{labels[step]}; {label}" if labels[step] else label
    return Series(t, counts, tuple(labels))


def rate_of_change(t: FloatArray, value: FloatArray, window: float) -> FloatArray:
    """Return the rate of change `(n,)` of a sampled value, per s; all metrics differentiate with
    this function.

    (1) rate(t) = (value(t) - value(t - window)) / window, linear between the samples;
            NaN in the first `window` s

    The rate is causal: later samples, and where a log is cut, do not change it.
    """
    before = np.interp(t - window, t, value)
    return np.where(t - window >= t[0] - 1e-9, (value - before) / window, np.nan)
