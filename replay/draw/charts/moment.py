"""When to look at a drive, and when it broke a gate: from the tables of the run, before a trace is read."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from math import inf, isfinite
from typing import Any

import numpy as np

from logs.kernel import BoolArray, FloatArray
from metrics import GROUPS, METRICS
from metrics.judge.gates import Outcome
from replay.results.load import DriveResult

GRAVE = ("collision_at_fault", "safety", "rules", "progress")
"""Metrics and groups of metrics, the gravest first: the failed gates that are looked at before the others."""
NEAREST = (("ttc.min", "least time to a collision"), ("gap.min", "least distance to another road user"))
"""What is looked at where no gate failed."""
_GROUP = {metric.name: name for name, group in GROUPS.items() for metric in group}
_RULE = re.compile(r"(?:(?P<low>\S+) <= )?(?P<metric>\S.*?) (?P<sign><=|>=) (?P<bound>\S+)")


@dataclass(frozen=True)
class Moment:
    """A time in a drive, s, and why it is worth a look, in a sentence."""

    t: float
    why: str


@dataclass(frozen=True, eq=False)
class Violation:
    """A gate that a drive broke.

    Attributes:
        gate: The rule.
        series: The series that its metric is made of ("lon_accel").
        spans: From when to when its steps are out of bounds, s; the one instant of its value where it has no steps.
    """

    gate: str
    series: str
    spans: tuple[tuple[float, float], ...]


def worst_moment(drive: DriveResult) -> Moment:
    """The time of the worst failed gate's value, else of the least TTC or gap, else the middle of the drive.

    Gates of safety and rules are worse than others; among equals the first of the gates' file is.
    """
    failed = drive.verdicts[drive.verdicts["outcome"] == Outcome.FAIL.value]
    rows = [row for row in list[Any](failed.itertuples()) if isfinite(row.time_s)]
    if rows:
        worst = min(rows, key=lambda row: gravity(str(row.gate)))
        about = f" ({worst.reason})" if worst.reason else ""
        return Moment(float(worst.time_s), f"{worst.gate} fails: {worst.value:.4g}{about}")
    failure = "a gate fails, at no instant; " if len(failed) else "no gate of this loop fails; "
    found = {row.metric: row for row in list[Any](drive.metrics.itertuples()) if row.available and isfinite(row.time_s)}
    for name, words in NEAREST:
        if name in found:
            near = found[name]
            about = f" ({near.reason})" if near.reason else ""
            return Moment(float(near.time_s), f"{failure}{words}: {near.value:.3g} {near.unit}{about}")
    return Moment(
        0.5 * float(drive.info["t_end_s"]),
        f"{failure}no distance to others was measured: the middle of the drive",
    )


def gravity(gate: str) -> int:
    """The place of a rule in `GRAVE`, by its metric, else by the group of its metric."""
    metric = measured_by(gate).partition(".")[0]
    return next((i for i, word in enumerate(GRAVE) if word in (metric, _GROUP.get(metric, ""))), len(GRAVE))


def measured_by(gate: str) -> str:
    """The metric that a rule as text is about: "gap.min" of "gap.min >= 0.5 [closed]"; "" where it cannot be told."""
    found = _RULE.match(gate)
    return found["metric"].rpartition("mean ")[2] if found else ""


def violations(drive: DriveResult) -> list[Violation]:
    """The failed gates of a drive, and when."""
    failed = drive.verdicts[drive.verdicts["outcome"] == Outcome.FAIL.value]
    return [_violation(drive, str(row.gate), float(row.time_s)) for row in list[Any](failed.itertuples())]


def _violation(drive: DriveResult, gate: str, time_s: float) -> Violation:
    series, _, reduction = measured_by(gate).rpartition(".")
    t, values = drive.steps(series)
    known = np.isfinite(values)
    t, values = t[known], values[known]
    out = _out(gate, series, reduction, values)
    spans = tuple(_spans(t, out)) if out is not None and out.any() else ((time_s, time_s),) if isfinite(time_s) else ()
    return Violation(gate, series, spans)


def _out(gate: str, series: str, reduction: str, values: FloatArray) -> BoolArray | None:
    """Which steps break a rule `(n,)`: those that its reduction counts, else those out of its own bounds."""
    metric = METRICS.get(series.partition(".")[0])
    how = next((some for some in metric.reductions if some.name == reduction), None) if metric else None
    if how is not None and how.bounds is not None:
        low, high = how.bounds
    elif reduction in ("count", "rate"):
        low, high = -inf, 0.0
    elif reduction in ("min", "max", "max_abs"):
        low, high = _bounds(gate)
        low = -high if reduction == "max_abs" else low
    else:
        return None
    return np.asarray((values < low) | (values > high))


def _bounds(gate: str) -> tuple[float, float]:
    """The bounds of a rule as text."""
    found = _RULE.match(gate)
    if found is None:
        return -inf, inf
    bound = float(found["bound"])
    return (bound, inf) if found["sign"] == ">=" else (float(found["low"] or -inf), bound)


def _spans(t: FloatArray, out: BoolArray) -> Iterator[tuple[float, float]]:
    """The unbroken stretches of marked steps, first to last step."""
    edge = np.diff(np.r_[False, out, False].astype(np.int64))
    for first, end in zip(np.flatnonzero(edge > 0), np.flatnonzero(edge < 0), strict=True):
        yield float(t[first]), float(t[end - 1])
