"""A drive of a falsification: who fails which gate, and a score by which the search is led.

A point counts where the planner fails a gate (FAIL of `metrics.judge`: an excused value is none) that the reference
driver holds:

    the careful driver of UN R157   has no contact that it does not avoid (`reference_cc`), and its own drive holds the
                                    bound of the gate, where it is measured on it (safety, progress, comfort)
    another planner                 fails no gate at all, and drives the log to an end

(1) score = distance / D                 where the point counts; D is the distance of the box's farthest corner
(2) score = 1 + robustness               where the planner passes, or is judged inconclusive
(3) score = 2 + distance / D             where the reference driver fails, too
(4) score = 3 + distance / D             where there is no such scenario, or it could not be driven
(5) robustness = 1 - (mean over the gates of (1 + m)^-4)^(1/4)
    m = how far the value is within the bound, in bounds, 0 where it is not within; of a gate that allows no time beyond
    a bound (`ttc.time_below_950ms <= 0`) the extreme value and that bound are taken (`ttc.min`, 0.95 s); gates without
    a value, or with a bound of 0 that is of a count, are left out
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, nan

import pandas as pd

from metrics import METRICS
from metrics.judge import CAREFUL, REFERENCE, worst
from metrics.judge.gates import Gate, Outcome
from metrics.reference_drivers import APPLIES, AVOIDS
from replay.results.load import Results

POWER = 4.0
FAIL, PASS, INCONCLUSIVE, BOTH, ERROR = "fail", "pass", "inconclusive", "both fail", "error"
"""Outcomes of a point; `BOTH`: the reference driver fails, too."""


@dataclass(frozen=True, slots=True)
class Case:
    """What came of one drive.

    Attributes:
        outcome: One of those above; "fail" is a point that counts.
        gates: The failed gates that count; where it does not count, those that the planner fails.
        why: The reason of the first of them, else why there is no verdict.
        end: How the planner's drive ended.
        robustness: (5); NaN where no gate has a value.
    """

    outcome: str
    gates: tuple[str, ...] = ()
    why: str = ""
    end: str = ""
    robustness: float = nan

    def score(self, distance: float) -> float:
        """(1) to (4), the distance in parts of D."""
        if self.outcome == FAIL:
            return distance
        if self.outcome in (PASS, INCONCLUSIVE):
            return 1.0 + (self.robustness if isfinite(self.robustness) else 1.0)
        return (2.0 if self.outcome == BOTH else 3.0) + distance


def judged(results: Results, log: str, gates: Sequence[Gate], planner: str, against: str) -> Case:
    """The case of a log in a run of the planner, and of the one that it is held against ("careful": no other)."""
    failures = results.failures[results.failures["log"] == log]
    drives = results.drives[(results.drives["log"] == log) & (results.drives["planner"] == planner)]
    if len(failures) or drives.empty:
        return Case(ERROR, why=str(failures["message"].iloc[0]) if len(failures) else "not driven")
    verdicts = results.verdicts[results.verdicts["log"] == log]
    mine = verdicts[verdicts["planner"] == planner]
    outcome = worst(map(Outcome, mine["outcome"]))
    failed = mine[mine["outcome"] == Outcome.FAIL.value]
    rows = results.metrics[results.metrics["log"] == log]
    known = rows["value"].where(rows["available"])
    values = {key: dict(zip(rows["metric"][at], known[at], strict=True)) for key, at in _drives(rows).items()}
    if against == CAREFUL:
        counts = _against_careful(values, failed["gate"], {str(gate): gate for gate in gates}, planner)
    else:
        other = verdicts[verdicts["planner"] == against]
        held = len(other) and not (other["outcome"] == Outcome.FAIL.value).any()
        counts = tuple(failed["gate"]) if held else ()
    shown = counts or tuple(failed["gate"])
    about = failed[failed["gate"].isin(shown)] if shown else mine[mine["outcome"] == outcome.value]
    why = next(filter(None, about["reason"]), "") if outcome is not Outcome.PASS else ""
    kind = FAIL if counts else BOTH if len(failed) else outcome.value
    end = str(drives["end"].iloc[0])
    return Case(kind, shown, why, end, robustness(gates, values.get((planner, "closed"), {})))


def _drives(rows: pd.DataFrame) -> dict[tuple[str, str], pd.Series[bool]]:
    """Which rows are of each planner and mode."""
    keys = rows[["planner", "mode"]].drop_duplicates().itertuples(index=False, name=None)
    return {key: (rows["planner"] == key[0]) & (rows["mode"] == key[1]) for key in keys}


def _against_careful(
    values: Mapping[tuple[str, str], Mapping[str, float]],
    failed: Iterable[str],
    gates: Mapping[str, Gate],
    planner: str,
) -> tuple[str, ...]:
    """The failed gates that the careful driver holds; none where it does not avoid its contact."""
    own, careful = values.get((planner, "closed"), {}), values.get((CAREFUL, REFERENCE), {})
    if own.get(f"reference_cc.{APPLIES.name}", 0.0) > 0.0 and not own.get(f"reference_cc.{AVOIDS.name}", 0.0) > 0.0:
        return ()
    return tuple(
        rule
        for rule in failed
        if rule not in gates or not gates[rule].margin(careful.get(gates[rule].metric, nan)) < 0.0
    )


def robustness(gates: Sequence[Gate], values: Mapping[str, float]) -> float:
    """(5) of a drive's values by metric; NaN where no gate has one."""
    near = [(1.0 + within) ** -POWER for gate in gates if isfinite(within := _within(gate, values))]
    return 1.0 - float((sum(near) / len(near)) ** (1.0 / POWER)) if near else nan


def _within(gate: Gate, values: Mapping[str, float]) -> float:
    """M of (5); NaN: the gate is left out."""
    name, _, reduced = gate.metric.rpartition(".")
    value, bound = values.get(gate.metric, nan), gate.max if gate.min is None else gate.min
    if bound == 0.0:
        metric = METRICS.get(name.partition(".")[0])
        bounds = next((one.bounds for one in metric.reductions if one.name == reduced), None) if metric else None
        if bounds is None:
            return nan
        below = isfinite(bounds[0])
        bound, value = bounds[0 if below else 1], values.get(f"{name}.{'min' if below else 'max'}", nan)
        return max((value - bound if below else bound - value) / abs(bound), 0.0) if bound else nan
    assert bound is not None
    return max(gate.margin(value) / abs(bound), 0.0) if isfinite(value) else nan
