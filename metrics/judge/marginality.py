"""Marginal outcomes: could the outcome of a gate change if the road users of the log were sampled
at another rate?

A sample is up to one interval d old when the next one arrives, and a speed from two samples is as
old as their midpoint, so values are late by (1) tau = 1.5 d. A value is marginal if it is no
farther from its bound than it can change in that time:
(2) times, s: tau; distances, m: a tau^2 / 2 with a = `HARD_MPS2`, as hard as cars brake.

A gate that allows no time beyond a bound depends on the extreme value: `ttc.time_below_950ms <= 0`
is marginal if `ttc.min` is near 0.95 s. A gate that allows some time depends on that time itself.
This is tested for metrics about other road users, and for comfort, because the braking of a planner
depends on when it sees them.
"""

from __future__ import annotations

from collections.abc import Callable

from replan.metrics import GROUPS, METRICS
from replan.metrics.judge.gates import Gate

INTERVAL = "agent_interval.final"
HARD_MPS2 = 8.0
AGE = 1.5  # Age of a speed, in intervals
ABOUT_OTHERS = (
    "gap_kept",
    "gap_kept_vulnerable",
    "ttc",
    "ttc_vulnerable",
    "thw",
    "priority_gap",
    "priority_gap_assumed",
    "yielding",
)
_TESTED = frozenset({*ABOUT_OTHERS, *(metric.name for metric in GROUPS["comfort"])})


def marginal(gate: Gate, value_of: Callable[[str], float]) -> str:
    """Return why a gate's outcome on a drive is marginal: "marginal: at 5 Hz ..."; empty if it is
    not.

    `value_of` returns the drive's value by its name in the table ("ttc.min"); NaN if there is none.
    """
    series, _, reduction_name = gate.metric.rpartition(".")
    metric, interval = METRICS.get(series.partition(".")[0]), value_of(INTERVAL)
    if metric is None or metric.name not in _TESTED or not interval > 0.0:
        return ""
    reduction = next(item for item in metric.reductions if item.name == reduction_name)
    value, unit = value_of(gate.metric), reduction.unit or metric.unit
    bound = gate.max if gate.min is None else gate.min
    if bound == 0.0 and reduction.bounds is not None and metric.name in ABOUT_OTHERS:
        value, unit, bound = value_of(f"{series}.min"), metric.unit, reduction.bounds[0]
    late_s = AGE * interval  # (1)
    reach = {"s": late_s, "m": 0.5 * HARD_MPS2 * late_s**2}.get(unit, 0.0)  # (2)
    if bound is None or reach == 0.0 or value == 0.0 or not abs(value - bound) <= reach:
        return ""
    return (
        f"marginal: at {1.0 / interval:.3g} Hz the bound of {bound:g} {unit} is within "
        f"{reach:.2g} {unit} of {value:.3g} {unit}"
    )
