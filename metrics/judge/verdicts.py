"""Judges the gates on the table of a run: for each log, then over all logs.

The outcome of a gate on a log is the first of these that applies:

    INCONCLUSIVE    the log could not be evaluated, or has no value (or NaN) although the gate is
                    not optional
    NOT ASKED       the gate is optional and the log has no value; the reason is that of the metric
    INCONCLUSIVE    the value is within the bounds, but the drive crashed, or less than
                    `min_evidence` of it has the
                    evidence that the gate names (`evidence.PART.share`): traffic, lights, limit or
                    lane
    PASS            the value is within the bounds, or the gate judges the sum over all logs
    INCONCLUSIVE    the value is out of bounds, the gate is `reachable`, and no yardstick stays
                    within the bound
    INCONCLUSIVE    the value is out of bounds, but excused or marginal (`excuses`),
        or `broken = "inconclusive"`
    FAIL            the value is out of bounds

The reason of a pass, too, states if it is marginal: another sampling rate of the log might change
it.

Over all logs, a gate has a verdict per planner and mode, and per group if it has `per`. A log is
judged if it passes or fails, inconclusive without evidence (no value, or excused), and missing if
it could not be evaluated, crashed or has no result. What must be within the bound:

    worst           every judged log
    mean, median    that of the judged logs
    sum             the sum over all values
    pass_share      each log by itself, in `min_share` of the logs: passed / (passed + failed +
                    inconclusive + missing)

and the verdict is the first of these:

    FAIL            the bound is broken; pass_share: the share is below `min_share` even if all
                    inconclusive logs passed
    INCONCLUSIVE    any log is missing (except pass_share, which counts it as failed); fewer than
                    `min_logs` were
                    judged; more than `max_missing` of the logs are inconclusive or missing; the
                    share is below `min_share`; or with `confident` the lower end of its 95 %
                    interval is (`aggregate`, (1))
    PASS            else

FAIL becomes INCONCLUSIVE if the gate has `broken = "inconclusive"`. If no log is judged, the
verdict is INCONCLUSIVE. An optional gate is NOT ASKED if all its logs are NOT ASKED, and has no
verdict if the run has no such metric. Filters that match no log, and planners that are not in the
run, are INCONCLUSIVE even then, since they are most likely misspelt.
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

from replan.metrics.judge.aggregate import LogLabels, wilson
from replan.metrics.judge.cases import (
    LAWFUL,
    REFERENCE,
    DrivesTable,
    GateCase,
    MetricRow,
    group_of,
    lacking_evidence,
)
from replan.metrics.judge.excuses import excuse
from replan.metrics.judge.gates import Gate, Gates, Outcome, count_logs, meant, unit_of
from replan.metrics.judge.marginality import marginal

_NO_ENTRIES: Mapping[Any, str] = MappingProxyType({})
OUTCOME_COLUMNS = (
    "gate",
    "log",
    "planner",
    "mode",
    "outcome",
    "value",
    "time_s",
    "reason",
    "metric",
    "over",
    "low",
    "high",
)
DRIVE = ["log", "planner", "mode"]


@dataclass(frozen=True, slots=True)
class LogOutcome:
    """The outcome of a gate on one log; `why`: the reason if inconclusive or not asked, or what the
    value is about.
    """

    log: str
    outcome: Outcome
    why: str
    value: float = nan
    unit: str = ""
    time_s: float = nan
    evaluated: bool = True

    @property
    def place(self) -> str:
        """The place of the value: "on log X at 3.20 s (car 7)"."""
        when = f" at {self.time_s:.2f} s" if isfinite(self.time_s) else ""
        return f"on {self.log}{when}" + (f" ({self.why})" if self.why else "")


@dataclass(frozen=True, slots=True)
class Verdict:
    """The outcome of a gate for one planner in one mode, and why."""

    gate: Gate
    outcome: Outcome  # Pass, fail, inconclusive or not asked
    reason: str  # One sentence that names planner, worst log, value and time
    planner: str = ""  # "" if no planner could be judged; `mode` likewise
    mode: str = ""
    # The judged value (the statistic `over` the logs, or the worst log's value); NaN if there is
    # none
    value: float = nan
    log: str = ""  # The worst log; "" if there is none
    time_s: float = nan  # The time of its value; NaN if it has no time
    logs: tuple[LogOutcome, ...] = ()  # The outcome of each log that the gate selects
    group: str = ""  # "family everyday/cut_in" if the gate has a verdict per group; else ""


def judge(
    gates: Gates,
    table: pd.DataFrame,
    labels: Mapping[str, LogLabels],
    *,
    failed: Mapping[str, str] = _NO_ENTRIES,
    crashed: Mapping[tuple[str, str, str], str] = _NO_ENTRIES,
) -> tuple[Verdict, ...]:
    """Return the verdicts on a table of `evaluate` rows, in the order of the gates.

    `table`: the rows of all logs, planners and modes, including reference drives. `labels`: labels
    of all logs of the run, so that logs without rows are detected. `failed`: reason by log, for
    logs that could not be evaluated. `crashed`: reason by log, planner and mode, for drives that
    crashed.
    """
    rows: dict[tuple[str, str], dict[str, dict[str, MetricRow]]] = {}
    columns = ("planner", "mode", "log", "metric", *MetricRow._fields)
    about = table.get("about", table["reason"]).astype(object)
    # Reasons of older versions of replan contain full ids
    about = about.where(about.notna(), table["reason"])
    table = table.assign(about=[str(text).partition(":")[0] for text in about])
    for planner, mode, log, metric, *rest in zip(*(table[name] for name in columns), strict=True):
        rows.setdefault((planner, mode), {}).setdefault(log, {})[metric] = MetricRow(*rest)
    lawful = tuple(
        gate for gate in gates.gates if gate.over == "worst" and group_of(gate) in LAWFUL
    )
    oracles = frozenset(
        table.loc[table["oracle"].astype(bool) & (table["mode"] != REFERENCE), "planner"]
    )
    drives = DrivesTable(rows, oracles, crashed, lawful)
    known = list(dict.fromkeys([*labels, *table["log"], *failed]))
    return tuple(
        verdict
        for gate in gates.gates
        for verdict in _judge_gate(gate, drives, known, labels, failed)
    )


def outcomes(verdicts: Sequence[Verdict]) -> pd.DataFrame:
    """Return the outcome of each gate on each log as `OUTCOME_COLUMNS`.

    One row even if a log is in several groups.
    """
    rows_ = [
        (
            str(verdict.gate),
            log.log,
            verdict.planner,
            verdict.mode,
            log.outcome.value,
            log.value,
            log.time_s,
            log.why,
            verdict.gate.metric,
            verdict.gate.over,
            verdict.gate.min,
            verdict.gate.max,
        )
        for verdict in verdicts
        for log in verdict.logs
    ]
    rows = pd.DataFrame(rows_, columns=list(OUTCOME_COLUMNS))
    rows = rows.astype(dict.fromkeys(("value", "time_s", "low", "high"), "float64"))
    twice = [str(verdict.gate) for verdict in verdicts if verdict.gate.per == "tag"]
    again = rows.duplicated(["gate", "log", "planner", "mode"]) & rows["gate"].isin(twice)
    return rows[~again].reset_index(drop=True)


def worst(found: Iterable[Outcome]) -> Outcome:
    """Return the worst of several outcomes without NOT ASKED; INCONCLUSIVE if there is none."""
    asked = (outcome for outcome in found if outcome is not Outcome.NOT_ASKED)
    return min(asked, key=list(Outcome).index, default=Outcome.INCONCLUSIVE)


def _judge_gate(
    gate: Gate,
    drives: DrivesTable,
    known: Sequence[str],
    labels: Mapping[str, LogLabels],
    failed: Mapping[str, str],
) -> list[Verdict]:
    """The verdicts of a gate, by planner, mode and group."""
    # A log that failed before its labels were known: any gate may select it
    unknown = LogLabels()
    logs = [
        log
        for log in known
        if gate.selects(labels.get(log, unknown)) or (log in failed and log not in labels)
    ]
    if not logs:
        return [Verdict(gate, Outcome.INCONCLUSIVE, _no_log_selected(gate, labels))]
    verdicts = []
    groups = sorted(_groups_of(gate, logs, labels).items())
    for drive in _measured_drives(gate, drives):
        for group, members in groups:
            outcomes = [_judge_log(GateCase(gate, log, *drive, drives), failed) for log in members]
            verdicts.append(_judge_drive(gate, drive, outcomes, group))
    return verdicts or _not_measured(gate, drives, logs, failed)


def _no_log_selected(gate: Gate, labels: Mapping[str, LogLabels]) -> str:
    """Return the reason if the filters match no log: "... the tags rian, did you mean 'rain'?"."""
    known_words = {
        "tags": {tag for log_labels in labels.values() for tag in log_labels.tags},
        "families": {log_labels.family for log_labels in labels.values()},
        "datasets": {log_labels.dataset for log_labels in labels.values()},
    }
    filters = []
    for kind, known in known_words.items():
        names = [
            word if word in known else f"{word}{meant(word, sorted(known), cutoff=0.7)}"
            for word in getattr(gate, kind)
        ]
        filters += [f"the {kind} {', '.join(names)}"] if names else []
    return f"nothing to judge: no log has {' and '.join(filters) or 'a result'}"


def _measured_drives(gate: Gate, drives: DrivesTable) -> list[tuple[str, str]]:
    """Return the planners and modes that a gate asks, in the modes that have its metric."""
    asked = []
    for planner, mode in drives.rows:
        named = planner == gate.planner
        if gate.planner is None:
            named = planner not in drives.oracles
        if named and mode != REFERENCE and gate.mode in (None, mode):
            asked.append((planner, mode))
    modes = {
        mode
        for planner, mode in asked
        if any(gate.metric in log for log in drives.rows[planner, mode].values())
    }
    return [(planner, mode) for planner, mode in asked if mode in modes]


def _groups_of(
    gate: Gate, logs: Sequence[str], labels: Mapping[str, LogLabels]
) -> dict[str, list[str]]:
    """Return the logs by group, "family everyday/cut_in"; one group "" if the gate has no `per`."""
    if not gate.per:
        return {"": list(logs)}
    groups: dict[str, list[str]] = {}
    for log in logs:
        log_labels = labels.get(log, LogLabels())
        words_of = {
            "family": (log_labels.family,),
            "dataset": (log_labels.dataset,),
            "tag": log_labels.tags,
        }
        for word in words_of[gate.per] or ("",):
            group = f"{gate.per} {word}" if word else f"{gate.per} not known"
            groups.setdefault(group, []).append(log)
    return groups


def _not_measured(
    gate: Gate, drives: DrivesTable, logs: Sequence[str], failed: Mapping[str, str]
) -> list[Verdict]:
    """Return the verdict if no drive has the metric; none if the gate is optional, and its planner
    is in the run.
    """
    planners = sorted({planner for planner, mode in drives.rows if mode != REFERENCE})
    near = meant(gate.planner, planners) if gate.planner and gate.planner not in planners else ""
    planner = f"planner {gate.planner}{near}" if gate.planner else "a planner that is no oracle"
    loop = f" in {gate.mode} loop" if gate.mode else ""
    lost = "".join(
        f"; {log} could not be evaluated: {failed[log]}" for log in logs if log in failed
    )
    reason = (
        f"nothing to judge: {gate.metric} was not measured for {planner}{loop} in this run{lost}"
    )
    misspelt = gate.planner is not None and all(gate.planner != name for name, _ in drives.rows)
    return [Verdict(gate, Outcome.INCONCLUSIVE, reason)] if misspelt or not gate.optional else []


def _judge_log(case: GateCase, failed: Mapping[str, str]) -> LogOutcome:
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
        against = excuse(case) or ("" if case.crashed else marginal(gate, case.value))
        outcome = Outcome(gate.broken)
    why = against or row.reason
    if against or outcome is Outcome.INCONCLUSIVE:
        outcome, why = Outcome.INCONCLUSIVE, why or gate.reason
    elif gate.over != "sum":
        why = "; ".join(filter(None, (why, marginal(gate, case.value))))
    return LogOutcome(log, outcome, why, row.value, row.unit, row.time_s)


def _judge_drive(
    gate: Gate, drive: tuple[str, str], logs: Sequence[LogOutcome], group: str
) -> Verdict:
    """Return the verdict on one planner and mode; NOT ASKED if the gate is optional and no log was
    asked.
    """
    planner, mode = drive
    drive_name = f"{planner}, {mode} loop" + (f", {group}" if group else "")
    nothing = Verdict(gate, Outcome.INCONCLUSIVE, "", planner, mode, logs=tuple(logs), group=group)
    asked = [log for log in logs if log.outcome is not Outcome.NOT_ASKED]
    if not asked:
        why = Counter(log.why for log in logs).most_common(1)
        reason = f"{drive_name}: no log was asked" + (f" ({why[0][0]})" if why else "")
        return replace(
            nothing,
            outcome=Outcome.NOT_ASKED if gate.optional else Outcome.INCONCLUSIVE,
            reason=reason,
        )
    judged = [
        log for log in asked if isfinite(log.value) and log.outcome is not Outcome.INCONCLUSIVE
    ]
    missing = [log for log in asked if not log.evaluated]
    without = [log for log in asked if log.outcome is Outcome.INCONCLUSIVE and log.evaluated]
    aside = ""  # text about logs that could not be judged
    if without:
        ran = count_logs(len(asked) - len(missing))
        aside = f"; no evidence in {len(without)} of {ran} ({without[0].log}: {without[0].why})"
    if missing:
        aside += (
            f"; {count_logs(len(missing))} could not be evaluated ({missing[0].log}: "
            f"{missing[0].why})"
        )
    unclear = next(iter((*without, *missing)), None)
    if not judged:
        where = asked[0] if unclear is None else unclear
        return replace(
            nothing,
            reason=f"{drive_name}: nothing to judge{aside}",
            log=where.log,
            time_s=where.time_s,
        )
    bad = min(judged, key=lambda log: gate.margin(log.value))
    few = (
        f"; {count_logs(len(judged))} judged, {gate.min_logs} must be"
        if len(judged) < gate.min_logs
        else ""
    )
    lacking = (
        len(judged) < gate.min_logs
        or len(asked) - len(judged) > gate.max_missing * len(asked) + 1e-9
    )
    if gate.over == "pass_share":
        value, outcome, summary = _judge_share(gate, asked, bad, lacking=lacking)
    else:
        value, outcome, summary = _judge_value(gate, judged, bad, lacking=bool(lacking or missing))
    reason = f"{drive_name}: {summary}{few}{aside}"
    where = bad if outcome is not Outcome.INCONCLUSIVE or unclear is None else unclear
    return replace(
        nothing, outcome=outcome, reason=reason, value=value, log=where.log, time_s=where.time_s
    )


def _judge_value(
    gate: Gate, judged: Sequence[LogOutcome], bad: LogOutcome, *, lacking: bool
) -> tuple[float, Outcome, str]:
    """Return value, outcome and reason: "gap.min = 0.31 m, below 0.5, on log X at 3.20 s (car
    7)".
    """
    how: Mapping[str, Callable[[list[float]], Any]] = {
        "mean": np.mean,
        "median": np.median,
        "sum": np.sum,
    }
    reduced = how.get(gate.over)
    value = float(reduced([log.value for log in judged])) if reduced else bad.value
    broken = sum(gate.margin(log.value) < 0.0 for log in judged)
    share = (
        f"; broken in {broken} of {count_logs(len(judged))}"
        if gate.over == "worst" and broken
        else ""
    )
    unit, bound, outcome = unit_of(bad.unit), ", within bounds,", Outcome(gate.broken)
    if gate.min is not None and value < gate.min:
        bound = f", below {gate.min:g},"
    elif gate.max is not None and value > gate.max:
        bound = f", above {gate.max:g},"
    else:
        outcome = Outcome.INCONCLUSIVE if lacking else Outcome.PASS
    worst_of = f"worst {bad.value:.4g}{unit} " if reduced else ""
    return value, outcome, f"{gate.judged} = {value:.4g}{unit}{bound} {worst_of}{bad.place}{share}"


def _judge_share(
    gate: Gate, found: Sequence[LogOutcome], bad: LogOutcome, *, lacking: bool
) -> tuple[float, Outcome, str]:
    """Return value, outcome and reason of a gate on the share of logs that pass."""
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
        how += ", but too few logs were judged"
    else:
        outcome = Outcome.PASS
    interval = f"95 % interval {100.0 * low:.3g} to {100.0 * high:.3g} %"
    share = f"holds in {passed} of {count_logs(n)} ({100.0 * passed / n:.3g} %, {interval}), {how}"
    return (
        passed / n,
        outcome,
        f"{gate.bound} {share}; worst {bad.value:.4g}{unit_of(bad.unit)} {bad.place}",
    )
