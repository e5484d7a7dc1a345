"""Marginal: would the log at another rate of its road users' samples say something else of a gate?

A sample is up to one interval d old when the next one comes, and a speed from two samples is as old as their middle:
what is judged is (1) tau = 1.5 d late. A value is marginal where it is no further from its bound than what may happen
in that time: (2) times, s: tau; distances, m: a tau^2 / 2 with a = `HARD_MPS2`, as hard as cars brake.

A gate that allows no time or number of steps beyond a bound is about the extreme value: `ttc.time_below_950ms <= 0` is
marginal where `ttc.min` is near 0.95 s. One that allows some is about that time itself. Asked are the metrics that are
about others, and comfort: how hard a planner brakes depends on when it sees them.
"""

from __future__ import annotations

from collections.abc import Callable

from metrics import GROUPS, METRICS
from metrics.gates import Gate

INTERVAL = "agent_interval.final"
HARD_MPS2 = 8.0
AGE = 1.5
OF_OTHERS = ("gap_kept", "gap_kept_vulnerable", "ttc", "ttc_vulnerable", "thw", "priority_gap", "yielding")
_ASKED = frozenset({*OF_OTHERS, *(metric.name for metric in GROUPS["comfort"])})


def marginal(gate: Gate, value_of: Callable[[str], float]) -> str:
    """Why a gate's outcome on a drive is marginal: "marginal: at 5 Hz ..."; empty: it is not.

    `value_of` gives the drive's value by its name in the table ("ttc.min"); NaN where it has none.
    """
    name, _, reduced = gate.metric.rpartition(".")
    metric, interval = METRICS.get(name.partition(".")[0]), value_of(INTERVAL)
    if metric is None or metric.name not in _ASKED or not interval > 0.0:
        return ""
    reduction = next(one for one in metric.reductions if one.name == reduced)
    value, unit = value_of(gate.metric), reduction.unit or metric.unit
    bound = gate.max if gate.min is None else gate.min
    if bound == 0.0 and reduction.bounds is not None and metric.name in OF_OTHERS:
        value, unit, bound = value_of(f"{name}.min"), metric.unit, reduction.bounds[0]
    near = {"s": AGE * interval, "m": 0.5 * HARD_MPS2 * (AGE * interval) ** 2}.get(unit, 0.0)  # (1), (2)
    if bound is None or near == 0.0 or value == 0.0 or not abs(value - bound) <= near:
        return ""
    found = f"the bound of {bound:g} {unit} is within {near:.2g} {unit} of {value:.3g} {unit}"
    return f"marginal: at {1.0 / interval:.3g} Hz {found}"
