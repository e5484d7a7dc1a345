"""Judging: the gates on the table of a run, log by log, and then over the logs.

The outcome of a gate on a log is the first of these that holds:

    INCONCLUSIVE    the log could not be evaluated, or has no value (NaN is no value) although the gate is not optional
    NOT ASKED       the gate is optional and the log has no value; the reason of the metric says why
    INCONCLUSIVE    the value is within the bounds, but the drive crashed, or less than `min_evidence` of it has the
                    evidence that the gate names (`evidence.PART.share`): traffic, lights, limit or lane
    PASS            the value is within the bounds, or the gate asks for the sum of all logs
    INCONCLUSIVE    the value is out of bounds, the gate is `reachable`, and no yardstick holds the bound
    INCONCLUSIVE    the value is out of bounds, but is excused (`excuses`), or `broken = "inconclusive"`
    FAIL            the value is out of bounds

A pass or fail says in its reason where it is marginal: another rate of the log might turn it (`excuses`).

Over the logs together a gate has a verdict per planner and mode, and per group where it asks so. Judged is a log that
passes or fails; inconclusive one with no evidence (no value, or excused); missing one that could not be evaluated,
crashed or has no result. What must hold the bound:

    worst           every judged log
    mean, median    that of the judged logs
    sum             the sum over all values
    pass_share      each log by itself, in `min_share` of the logs: passed / (passed + failed + inconclusive + missing)

and the verdict is the first of these:

    FAIL            the bound is broken; pass_share: the share is below `min_share` even if all inconclusive logs passed
    INCONCLUSIVE    any log is missing (but pass_share: there it counts like a failed one); fewer than `min_logs` were
                    judged; more than `max_missing` of the logs are inconclusive or missing; the share is below
                    `min_share`; or with `confident` the lower end of its 95 % interval is (`aggregate`, (1))
    PASS            else

FAIL is INCONCLUSIVE where the gate says `broken = "inconclusive"`. Nothing judged is INCONCLUSIVE always. An optional
gate has no verdict where no log was asked; filters that no log passes and planners that are not in the run are
INCONCLUSIVE always, since they are most likely misspelt.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite, nan
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd

from metrics.judge.aggregate import LogLabels, wilson
from metrics.judge.excuses import LAWFUL, REFERENCE, Case, Drives, Row, excuse, group_of, lacking_evidence, marginal
from metrics.judge.gates import Gate, Gates, Outcome, count_logs, meant, unit_of

_NO_ENTRIES: Mapping[Any, str] = MappingProxyType({})
OUTCOME_COLUMNS = ("gate", "log", "planner", "mode", "outcome", "value", "time_s", "reason")


@dataclass(frozen=True, slots=True)
class LogOutcome:
    """The outcome of a gate on one log: `why` it is inconclusive or not asked, else the road user that it is about."""

    log: str
    outcome: Outcome
    why: str
    value: float = nan
    unit: str = ""
    time_s: float = nan
    evaluated: bool = True

    @property
    def place(self) -> str:
        """Where the value is: "on log X at 3.20 s (car 7)"."""
        when = f" at {self.time_s:.2f} s" if isfinite(self.time_s) else ""
        return f"on {self.log}{when}" + (f" ({self.why})" if self.why else "")


@dataclass(frozen=True, slots=True)
class Verdict:
    """The outcome of a gate for one planner in one mode, and why.

    Attributes:
        gate: The rule.
        outcome: Pass, fail, inconclusive or not asked.
        reason: One sentence that names planner, worst log, value and time.
        planner: "" where no planner was to be judged; `mode` likewise.
        value: The judged value (what `over` makes of the logs, or the worst log's); NaN where there is none.
        log: The worst log; "" where there is none.
        time_s: When its value occurred; NaN where it has no time.
        logs: The outcome of each log that the gate selects.
        group: "family everyday/cut_in" where the gate has a verdict per group; else "".
    """

    gate: Gate
    outcome: Outcome
    reason: str
    planner: str = ""
    mode: str = ""
    value: float = nan
    log: str = ""
    time_s: float = nan
    logs: tuple[LogOutcome, ...] = ()
    group: str = ""


def judge(
    gates: Gates,
    table: pd.DataFrame,
    labels: Mapping[str, LogLabels],
    *,
    failed: Mapping[str, str] = _NO_ENTRIES,
    crashed: Mapping[tuple[str, str, str], str] = _NO_ENTRIES,
) -> tuple[Verdict, ...]:
    """The verdicts on a table of `evaluate` rows, in the order of the gates.

    Args:
        gates: The rules.
        table: The rows of all logs, planners and modes, reference drives among them.
        labels: Of all logs of the run, so that one without rows is missed.
        failed: Logs that could not be evaluated, and why.
        crashed: Likewise drives, by log, planner and mode.
    """
    rows: dict[tuple[str, str], dict[str, dict[str, Row]]] = {}
    columns = ("planner", "mode", "log", "metric", *Row._fields)
    about = table.get("about", table["reason"]).astype(object)
    about = about.where(about.notna(), table["reason"])  # rows of an older replan have whole ids in their reasons
    table = table.assign(about=[str(each).partition(":")[0] for each in about])
    for planner, mode, log, metric, *rest in zip(*(table[name] for name in columns), strict=True):
        rows.setdefault((planner, mode), {}).setdefault(log, {})[metric] = Row(*rest)
    lawful = tuple(gate for gate in gates.gates if gate.over == "worst" and group_of(gate) in LAWFUL)
    drives = Drives(rows, frozenset(table.loc[table["oracle"].astype(bool), "planner"]), crashed, lawful)
    known = list(dict.fromkeys([*labels, *table["log"], *failed]))
    return tuple(verdict for gate in gates.gates for verdict in _judge(gate, drives, known, labels, failed))


def outcomes(verdicts: Sequence[Verdict]) -> pd.DataFrame:
    """The outcome of each gate on each log, a row each (`OUTCOME_COLUMNS`), once however many groups the log is in."""
    found = [
        (str(v.gate), log.log, v.planner, v.mode, log.outcome.value, log.value, log.time_s, log.why)
        for v in verdicts
        for log in v.logs
    ]
    rows = pd.DataFrame(found, columns=list(OUTCOME_COLUMNS)).astype({"value": "float64", "time_s": "float64"})
    twice = [str(v.gate) for v in verdicts if v.gate.per == "tag"]
    again = rows.duplicated(["gate", "log", "planner", "mode"]) & rows["gate"].isin(twice)
    return rows[~again].reset_index(drop=True)


def worst(found: Iterable[Outcome]) -> Outcome:
    """Several outcomes taken together, those NOT ASKED left out; INCONCLUSIVE where there is none."""
    asked = (outcome for outcome in found if outcome is not Outcome.NOT_ASKED)
    return min(asked, key=list(Outcome).index, default=Outcome.INCONCLUSIVE)


def _judge(
    gate: Gate, drives: Drives, known: Sequence[str], labels: Mapping[str, LogLabels], failed: Mapping[str, str]
) -> list[Verdict]:
    """The verdicts of a gate, by planner, mode and group."""
    unknown = LogLabels()  # of a log that failed before its labels were known: it may be asked for
    logs = [log for log in known if gate.selects(labels.get(log, unknown)) or (log in failed and log not in labels)]
    if not logs:
        return [Verdict(gate, Outcome.INCONCLUSIVE, f"nothing to judge: no log has {_filters(gate, labels)}")]
    asked = [
        (planner, mode)
        for planner, mode in drives.rows
        if (planner not in drives.oracles if gate.planner is None else planner == gate.planner)
        if mode != REFERENCE and gate.mode in (None, mode)
    ]
    modes = {mode for planner, mode in asked if any(gate.metric in log for log in drives.rows[planner, mode].values())}
    groups: dict[str, list[str]] = {} if gate.per else {"": logs}
    for log in logs if gate.per else ():
        mine = labels.get(log, unknown)
        words = {"family": (mine.family,), "dataset": (mine.dataset,), "tag": mine.tags}[gate.per or ""]
        for word in words or ("",):
            groups.setdefault(f"{gate.per} {word}" if word else f"{gate.per} not known", []).append(log)
    if modes:
        return [
            _verdict(gate, drive, [_of_log(Case(gate, log, *drive, drives), failed) for log in mine], group)
            for drive in asked
            if drive[1] in modes
            for group, mine in sorted(groups.items())
        ]
    planners = sorted({planner for planner, mode in drives.rows if mode != REFERENCE})
    near = meant(gate.planner, planners) if gate.planner and gate.planner not in planners else ""
    planner = f"planner {gate.planner}{near}" if gate.planner else "a planner that is no oracle"
    loop = f" in {gate.mode} loop" if gate.mode else ""
    lost = "".join(f"; {log} could not be evaluated: {failed[log]}" for log in logs if log in failed)
    reason = f"nothing to judge: {gate.metric} was not measured for {planner}{loop} in this run{lost}"
    misspelt = gate.planner is not None and all(gate.planner != name for name, _ in drives.rows)
    return [Verdict(gate, Outcome.INCONCLUSIVE, reason)] if misspelt or not gate.optional else []


def _filters(gate: Gate, labels: Mapping[str, LogLabels]) -> str:
    """What the gate asks of logs, and what was meant where no log has it: "the tags rian, did you mean 'rain'?"."""
    known = {
        "tags": {tag for mine in labels.values() for tag in mine.tags},
        "families": {mine.family for mine in labels.values()},
        "datasets": {mine.dataset for mine in labels.values()},
    }
    return " and ".join(
        f"the {kind} " + ", ".join(f"{word}{meant(word, sorted(there), cutoff=0.7) if word not in there else ''}"
                                   for word in getattr(gate, kind))
        for kind, there in known.items() if getattr(gate, kind)
    ) or "a result"  # fmt: skip


def _of_log(case: Case, failed: Mapping[str, str]) -> LogOutcome:
    """The outcome of a gate on a log (module docstring)."""
    gate, log, row = case.gate, case.log, case.row(case.gate.metric)
    if log in failed or log not in case.drives.rows[case.planner, case.mode]:
        return LogOutcome(log, Outcome.INCONCLUSIVE, failed.get(log, "no result"), evaluated=False)
    if not row.known:
        why = "the value is not a number" if row.available else row.reason
        return LogOutcome(log, Outcome.NOT_ASKED if gate.optional else Outcome.INCONCLUSIVE, why)
    if gate.over == "sum" or gate.margin(row.value) >= 0.0:
        if case.crashed:
            return LogOutcome(log, Outcome.INCONCLUSIVE, case.crashed, evaluated=False)
        against, outcome = lacking_evidence(case), Outcome.PASS
    else:
        against, outcome = excuse(case), Outcome(gate.broken)
    why = against or row.reason
    if against or outcome is Outcome.INCONCLUSIVE:
        outcome, why = Outcome.INCONCLUSIVE, why or gate.reason
    elif gate.over != "sum":
        why = "; ".join(filter(None, (why, marginal(gate, case.value))))
    return LogOutcome(log, outcome, why, row.value, row.unit, row.time_s)


def _verdict(gate: Gate, drive: tuple[str, str], logs: Sequence[LogOutcome], group: str) -> Verdict:
    """The verdict on one planner and mode; NOT ASKED where no log was asked and the gate is optional."""
    planner, mode = drive
    who = f"{planner}, {mode} loop" + (f", {group}" if group else "")
    nothing = Verdict(gate, Outcome.INCONCLUSIVE, "", planner, mode, logs=tuple(logs), group=group)
    found = [log for log in logs if log.outcome is not Outcome.NOT_ASKED]
    if not found:
        why = Counter(log.why for log in logs).most_common(1)
        reason = f"{who}: no log was asked" + (f" ({why[0][0]})" if why else "")
        return replace(nothing, outcome=Outcome.NOT_ASKED if gate.optional else Outcome.INCONCLUSIVE, reason=reason)
    judged = [log for log in found if isfinite(log.value) and log.outcome is not Outcome.INCONCLUSIVE]
    missing = [log for log in found if not log.evaluated]
    without = Counter(log.why for log in found if log.outcome is Outcome.INCONCLUSIVE and log.evaluated)
    aside = ""  # what could not be judged
    if without:
        ran = count_logs(len(found) - len(missing))
        aside = f"; no evidence in {without.total()} of {ran} ({without.most_common(1)[0][0]})"
    if missing:
        aside += f"; {count_logs(len(missing))} could not be evaluated ({missing[0].log}: {missing[0].why})"
    if not judged:
        return replace(nothing, reason=f"{who}: nothing to judge{aside}")
    bad = min(judged, key=lambda log: gate.margin(log.value))
    few = f"; {count_logs(len(judged))} judged, {gate.min_logs} must be" if len(judged) < gate.min_logs else ""
    lacking = len(judged) < gate.min_logs or len(found) - len(judged) > gate.max_missing * len(found) + 1e-9
    if gate.over == "pass_share":
        value, outcome, what = _shared(gate, found, bad, lacking=lacking)
    else:
        value, outcome, what = _held(gate, judged, bad, lacking=bool(lacking or missing))
    reason = f"{who}: {what}{few}{aside}"
    return replace(nothing, outcome=outcome, reason=reason, value=value, log=bad.log, time_s=bad.time_s)


def _held(gate: Gate, judged: Sequence[LogOutcome], bad: LogOutcome, *, lacking: bool) -> tuple[float, Outcome, str]:
    """Value, outcome and what was found: "gap.min = 0.31 m, below 0.5, on log X at 3.20 s (car 7)"."""
    how: Mapping[str, Callable[[list[float]], Any]] = {"mean": np.mean, "median": np.median, "sum": np.sum}
    reduced = how.get(gate.over)
    value = float(reduced([log.value for log in judged])) if reduced else bad.value
    broken = sum(gate.margin(log.value) < 0.0 for log in judged)
    share = f"; broken in {broken} of {count_logs(len(judged))}" if gate.over == "worst" and broken else ""
    unit, bound, outcome = unit_of(bad.unit), ", within bounds,", Outcome(gate.broken)
    if gate.min is not None and value < gate.min:
        bound = f", below {gate.min:g},"
    elif gate.max is not None and value > gate.max:
        bound = f", above {gate.max:g},"
    else:
        outcome = Outcome.INCONCLUSIVE if lacking else Outcome.PASS
    worst_of = f"worst {bad.value:.4g}{unit} " if reduced else ""
    return value, outcome, f"{gate.judged} = {value:.4g}{unit}{bound} {worst_of}{bad.place}{share}"


def _shared(gate: Gate, found: Sequence[LogOutcome], bad: LogOutcome, *, lacking: bool) -> tuple[float, Outcome, str]:
    """The same of the share of logs that pass."""
    least, n = gate.min_share or 0.0, len(found)
    passed = sum(log.outcome is Outcome.PASS for log in found)
    unsure = sum(log.outcome is Outcome.INCONCLUSIVE and log.evaluated for log in found)
    low, high = wilson(passed, n)
    outcome, how = Outcome.INCONCLUSIVE, f"at least {100.0 * least:g} %"
    if (passed + unsure) / n < least:
        outcome, how = Outcome(gate.broken), f"below {100.0 * least:g} %"
    elif passed / n < least:
        how = f"below {100.0 * least:g} %, unless what is inconclusive passes"
    elif gate.confident and low < least:
        how = f"but not surely {100.0 * least:g} %"
    elif lacking:
        how += ", but of too few that were judged"
    else:
        outcome = Outcome.PASS
    interval = f"95 % interval {100.0 * low:.3g} to {100.0 * high:.3g} %"
    share = f"holds in {passed} of {count_logs(n)} ({100.0 * passed / n:.3g} %, {interval}), {how}"
    return passed / n, outcome, f"{gate.bound} {share}; worst {bad.value:.4g}{unit_of(bad.unit)} {bad.place}"
