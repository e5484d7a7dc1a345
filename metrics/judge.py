"""Judging: the gates on the table of a run, log by log, and then over the logs.

The outcome of a gate on a log is the first of these that holds:

    INCONCLUSIVE    the log could not be evaluated, or has no value (NaN is no value) although the gate is not optional
    NOT ASKED       the gate is optional and the log has no value; the reason of the metric says why
    INCONCLUSIVE    the value is within the bounds, but the drive crashed, or less than `min_evidence` of it has the
                    evidence that the gate names (`evidence.PART.share`): traffic, lights, limit or lane
    PASS            the value is within the bounds, or the gate asks for the sum of all logs
    INCONCLUSIVE    the value is out of bounds, the gate is `reachable`, and no yardstick holds the bound
    INCONCLUSIVE    the value is out of bounds, but is excused (below), or `broken = "inconclusive"`
    FAIL            the value is out of bounds

A pass or fail says in its reason where it is marginal: another rate of the log might turn it (`metrics.marginal`).

Yardsticks of a `reachable` gate are the recorded driver, and where their drives hold the gates on safety and rules the
route follower (`REFERENCES`) and all other planners of the run. The careful driver is none: it knows no rules.

A value is excused by a reference drive of `EXCUSED` that breaks the same bound in the same event: the values are about
the same road user or thing, at most `SAME_S` apart, and the planner's is not clearly worse (`WORSE`). In comfort an
event without a road user excuses nothing. A collision is not excused where the careful driver of UN R157
collides more slowly by more than `SLOWER_MPS`. Safety and progress are excused, too, by a replayed road user that drove
into the ego (`replay_contact`): safety where it is about that road user. Progress is excused where the
collision that ended the drive is, and where a phantom of the log stops the route follower as well. Nothing excuses a
drive in which the planner failed.

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
                    `min_share`; or with `confident` the lower end of its 95 % interval is (`metrics.aggregate`, (1))
    PASS            else

FAIL is INCONCLUSIVE where the gate says `broken = "inconclusive"`. Nothing judged is INCONCLUSIVE always. An optional
gate has no verdict where no log was asked; filters that no log passes and planners that are not in the run are
INCONCLUSIVE always, since they are most likely misspelt.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import isfinite, nan
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from metrics import GROUPS
from metrics.aggregate import LogLabels, wilson
from metrics.gates import Gate, Gates, Outcome, count_logs, meant, unit_of
from metrics.marginal import marginal

_NOTHING: Mapping[Any, str] = MappingProxyType({})
REFERENCE = "reference"  # Mode of the rows of reference drives
DRIVER, CAREFUL, FOLLOWER = "driver", "careful", "follower"
REFERENCES = {DRIVER: "the recorded driver", CAREFUL: "the careful driver", FOLLOWER: "the route follower"}
"""Planner of those rows: the log's own driver; the careful driver of UN R157, which brakes only and knows no rules; and
the route follower, which accelerates, steers and obeys the rules (`replay.loop.reference_drives`)."""
REPLAY_CONTACT = "replay_contact.final"
NO_COLLISION = Gate("collision_at_fault.count", max=0.0)  # It ends a drive: progress is excused where it is
SAME_S, SLOWER_MPS, WORSE = 2.0, 1.0, 1.5
"""A stop at another time, or an impact that is clearly harder, is another event (`CC_TTC_S` of the careful driver). A
value that is farther out of bounds than `WORSE` times the reference drive's holds more than that event."""
IMPACT = "collision_severity.impact_speed.max"
PHANTOMS = "phantom.count"
EXCUSED: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"safety": (DRIVER, CAREFUL), "rules": (DRIVER,), "comfort": (CAREFUL,)}
)
"""Which reference drives are asked, by group of metrics."""
NAMED, LAWFUL = ("comfort",), ("safety", "rules")  # Excused only about a road user; held by a yardstick
_GROUP = {metric.name: name for name, group in GROUPS.items() for metric in group}
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


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a gate says of one planner in one mode, and why.

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


class _Row(NamedTuple):
    value: float
    available: bool
    reason: str
    unit: str
    time_s: float
    about: str = ""  # Which road user or thing, with the whole id: "car 12"

    @property
    def known(self) -> bool:
        return self.available and isfinite(self.value)


_NONE = _Row(nan, False, "not measured", "", nan)
_Drive = Mapping[tuple[str, str], _Row]  # The rows of a planner and mode by (log, metric)


@dataclass(frozen=True, eq=False, slots=True)
class _Rows:
    """The table by (planner, mode), its oracles and crashed drives, and the gates on safety and rules."""

    drives: Mapping[tuple[str, str], _Drive]
    oracles: frozenset[str]
    crashed: Mapping[tuple[str, str, str], str]
    lawful: tuple[Gate, ...]

    def reference(self, planner: str, log: str, metric: str) -> _Row:
        """The value of a reference drive."""
        return self.drives.get((planner, REFERENCE), {}).get((log, metric), _NONE)


def judge(
    gates: Gates,
    table: pd.DataFrame,
    labels: Mapping[str, LogLabels],
    *,
    failed: Mapping[str, str] = _NOTHING,
    crashed: Mapping[tuple[str, str, str], str] = _NOTHING,
) -> tuple[Verdict, ...]:
    """The verdicts on a table of `evaluate` rows, in the order of the gates.

    Args:
        gates: The rules.
        table: The rows of all logs, planners and modes, reference drives among them.
        labels: Of all logs of the run, so that one without rows is missed.
        failed: Logs that could not be evaluated, and why.
        crashed: Likewise drives, by log, planner and mode.
    """
    drives: dict[tuple[str, str], dict[tuple[str, str], _Row]] = {}
    columns = ("planner", "mode", "log", "metric", *_Row._fields)
    about = table.get("about", table["reason"]).astype(object)
    about = about.where(about.notna(), table["reason"])  # rows of an older replan have whole ids in their reasons
    table = table.assign(about=[str(each).partition(":")[0] for each in about])
    for planner, mode, log, metric, *rest in zip(*(table[name] for name in columns), strict=True):
        drives.setdefault((planner, mode), {})[log, metric] = _Row(*rest)
    lawful = tuple(gate for gate in gates.gates if gate.over == "worst" and _group(gate) in LAWFUL)
    rows = _Rows(drives, frozenset(table.loc[table["oracle"].astype(bool), "planner"]), crashed, lawful)
    return tuple(verdict for gate in gates.gates for verdict in _judge(gate, rows, table, labels, failed))


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


def _group(gate: Gate) -> str:
    return _GROUP.get(gate.metric.partition(".")[0], "")


def _judge(
    gate: Gate, rows: _Rows, table: pd.DataFrame, labels: Mapping[str, LogLabels], failed: Mapping[str, str]
) -> list[Verdict]:
    logs = [log for log in dict.fromkeys([*labels, *table["log"], *failed]) if _selected(log, gate, labels, failed)]
    lost = "".join(f"; {log} could not be evaluated: {failed[log]}" for log in logs if log in failed)
    if not logs:
        return [Verdict(gate, Outcome.INCONCLUSIVE, f"nothing to judge: no log has {_filters(gate, labels)}")]
    drives = [
        (planner, mode)
        for planner, mode in rows.drives
        if (planner not in rows.oracles if gate.planner is None else planner == gate.planner)
        if mode != REFERENCE and gate.mode in (None, mode)
    ]
    modes = {mode for planner, mode in drives if any(name == gate.metric for _, name in rows.drives[planner, mode])}
    if modes:
        groups, drives = _grouped(logs, gate, labels), [drive for drive in drives if drive[1] in modes]
        return [
            _verdict(gate, drive, tuple(_of_logs(gate, drive, rows, mine, failed)), group)
            for drive in drives
            for group, mine in groups.items()
        ]
    known = sorted({planner for planner, mode in rows.drives if mode != REFERENCE})
    near = meant(gate.planner, known) if gate.planner and gate.planner not in known else ""
    planner = f"planner {gate.planner}{near}" if gate.planner else "a planner that is no oracle"
    loop = f" in {gate.mode} loop" if gate.mode else ""
    reason = f"nothing to judge: {gate.metric} was not measured for {planner}{loop} in this run{lost}"
    misspelt = gate.planner is not None and all(gate.planner != name for name, _ in rows.drives)
    return [Verdict(gate, Outcome.INCONCLUSIVE, reason)] if misspelt or not gate.optional else []


def _selected(log: str, gate: Gate, labels: Mapping[str, LogLabels], failed: Mapping[str, str]) -> bool:
    """Whether the gate asks for a log; one that failed before its labels were known may be asked for."""
    mine = labels.get(log, LogLabels())
    asked = (not gate.families or mine.family in gate.families) and (not gate.datasets or mine.dataset in gate.datasets)
    return (asked and set(gate.tags) <= set(mine.tags)) or (log in failed and log not in labels)


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


def _grouped(logs: Sequence[str], gate: Gate, labels: Mapping[str, LogLabels]) -> dict[str, list[str]]:
    """The logs by what a verdict of its own is asked for; a log that has no such word is in a group for such logs."""
    if gate.per is None:
        return {"": list(logs)}
    found: dict[str, list[str]] = {}
    for log in logs:
        mine = labels.get(log, LogLabels())
        words = {"family": (mine.family,), "dataset": (mine.dataset,), "tag": mine.tags}[gate.per]
        for word in words or ("",):
            found.setdefault(f"{gate.per} {word}" if word else f"{gate.per} not known", []).append(log)
    return dict(sorted(found.items()))


def _of_logs(
    gate: Gate, drive: tuple[str, str], rows: _Rows, logs: Sequence[str], failed: Mapping[str, str]
) -> Iterator[LogOutcome]:
    """The outcome of each log that the gate selects (module docstring)."""
    mine = rows.drives[drive]
    ran = {log for log, _ in mine}
    for log in logs:
        row = mine.get((log, gate.metric), _NONE)
        if log in failed or log not in ran:
            yield LogOutcome(log, Outcome.INCONCLUSIVE, failed.get(log, "no result"), evaluated=False)
            continue
        if not row.known:
            why = "the value is not a number" if row.available else row.reason
            yield LogOutcome(log, Outcome.NOT_ASKED if gate.optional else Outcome.INCONCLUSIVE, why)
            continue
        crashed, outcome, why = (log, *drive) in rows.crashed, Outcome.PASS, row.reason
        if gate.over == "sum" or gate.margin(row.value) >= 0.0:
            if crashed:
                yield LogOutcome(log, Outcome.INCONCLUSIVE, rows.crashed[log, *drive], evaluated=False)
                continue
            lacking = _lacking_evidence(gate, log, mine)
            outcome, why = (Outcome.INCONCLUSIVE, lacking) if lacking else (outcome, why)
        else:
            excuse = _excuse(gate, log, row, drive, rows)
            outcome = Outcome.INCONCLUSIVE if excuse else Outcome(gate.broken)
            why = excuse or row.reason or (gate.reason if outcome is Outcome.INCONCLUSIVE else "")
        if outcome is not Outcome.INCONCLUSIVE and gate.over != "sum":
            why = "; ".join(filter(None, (why, marginal(gate, partial(_value, mine, log)))))
        yield LogOutcome(log, outcome, why, row.value, row.unit, row.time_s)


def _value(mine: _Drive, log: str, metric: str) -> float:
    """A value of a drive by its name in the table; NaN where it has none."""
    row = mine.get((log, metric), _NONE)
    return row.value if row.known else nan


def _lacking_evidence(gate: Gate, log: str, mine: _Drive) -> str:
    """Why a value within the bounds is no pass: too little of the drive has the evidence; empty: it has enough."""
    share = mine.get((log, f"evidence.{gate.evidence}.share"), _NONE)
    if not share.known or share.value >= gate.min_evidence:
        return ""
    known = f"evidence about {gate.evidence} covers {100.0 * share.value:.3g} % of the drive"
    return f"{known}, less than {100.0 * gate.min_evidence:g} %" + (f" ({share.reason})" if share.reason else "")


def _excuse(gate: Gate, log: str, row: _Row, drive: tuple[str, str], rows: _Rows) -> str:
    """Why a broken value is no evidence against the planner (module docstring); empty: it is."""
    mine, group = rows.drives[drive], _group(gate)
    if (log, *drive) in rows.crashed:
        return ""
    if gate.reachable and not _reached(gate, log, drive, rows):
        return "no yardstick holds it: neither the recorded driver, the route follower nor another planner"
    contact, crash, phantom = (mine.get((log, name), _NONE) for name in (REPLAY_CONTACT, NO_COLLISION.metric, PHANTOMS))
    concerned = group == "progress" or (group == "safety" and row.about == contact.about)
    if concerned and contact.known and contact.value > 0.0:
        return f"the replay ran into the ego ({contact.reason})"
    if group in EXCUSED:
        return _by_reference(gate, log, row, mine, rows)
    if group != "progress":
        return ""
    if crash.known and NO_COLLISION.margin(crash.value) < 0.0:
        return _by_reference(NO_COLLISION, log, crash, mine, rows)
    follower = rows.reference(FOLLOWER, log, gate.metric)
    if follower.known and gate.margin(follower.value) < 0.0 and phantom.known and phantom.value > 0.0:
        return f"the log shows what was not there ({phantom.reason}), and stops the route follower, too"
    return ""


def _reached(gate: Gate, log: str, drive: tuple[str, str], rows: _Rows) -> bool:
    """Whether a yardstick holds the bound in this log (module docstring)."""
    for key, other in rows.drives.items():
        if key == drive or key[1] not in (drive[1], REFERENCE) or key[0] == CAREFUL:
            continue
        rules = () if key == (DRIVER, REFERENCE) else rows.lawful
        values = {rule: _value(other, log, rule.metric) for rule in rules if rule.mode in (None, drive[1])}
        lawful = all(rule.margin(value) >= 0.0 for rule, value in values.items() if isfinite(value))
        reached = _value(other, log, gate.metric)
        if lawful and isfinite(reached) and gate.margin(reached) >= 0.0:
            return True
    return False


def _by_reference(gate: Gate, log: str, row: _Row, mine: _Drive, rows: _Rows) -> str:
    """Which reference drive breaks the bound in the same event (module docstring); empty: none."""
    impact, careful = mine.get((log, IMPACT), _NONE), rows.reference(CAREFUL, log, IMPACT)
    harder = impact.known and not (careful.known and impact.value <= careful.value + SLOWER_MPS)
    for planner in EXCUSED[_group(gate)]:
        found = rows.reference(planner, log, gate.metric)
        if not found.known or gate.margin(found.value) >= 0.0 or (harder and planner != DRIVER):
            continue
        same = row.about == found.about and abs(row.time_s - found.time_s) <= SAME_S
        same = same and (row.about != "" or _group(gate) not in NAMED)
        if same and gate.margin(row.value) >= WORSE * gate.margin(found.value):
            about = f" ({found.reason})" if found.reason else ""
            return f"{REFERENCES[planner]} breaks {gate} too: {found.value:.4g}{unit_of(found.unit)}{about}"
    return ""


_REDUCE: Mapping[str, Callable[[Sequence[float]], float]] = MappingProxyType(
    {"mean": lambda v: float(np.mean(v)), "median": lambda v: float(np.median(v)), "sum": lambda v: float(np.sum(v))}
)


def _verdict(gate: Gate, drive: tuple[str, str], logs: tuple[LogOutcome, ...], group: str) -> Verdict:
    """The verdict on one planner and mode; NOT ASKED where no log was asked and the gate is optional."""
    planner, mode = drive
    who = f"{planner}, {mode} loop" + (f", {group}" if group else "")
    nothing = Verdict(gate, Outcome.INCONCLUSIVE, f"{who}: no log was asked", planner, mode, logs=logs, group=group)
    found = tuple(log for log in logs if log.outcome is not Outcome.NOT_ASKED)
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
    value, outcome, what = (_shared if gate.over == "pass_share" else _held)(gate, judged, bad, found)
    reason = f"{who}: {what}{few}{aside}"
    return replace(nothing, outcome=outcome, reason=reason, value=value, log=bad.log, time_s=bad.time_s)


def _held(
    gate: Gate, judged: Sequence[LogOutcome], bad: LogOutcome, found: Sequence[LogOutcome]
) -> tuple[float, Outcome, str]:
    """Value, outcome and what was found: "gap.min = 0.31 m, below 0.5, on log X at 3.20 s (car 7)"."""
    reduce = _REDUCE.get(gate.over)
    value = reduce([log.value for log in judged]) if reduce else bad.value
    broken = sum(gate.margin(log.value) < 0.0 for log in judged)
    share = f"; broken in {broken} of {count_logs(len(judged))}" if gate.over == "worst" and broken else ""
    unit, bound, outcome = unit_of(bad.unit), ", within bounds,", Outcome(gate.broken)
    if gate.min is not None and value < gate.min:
        bound = f", below {gate.min:g},"
    elif gate.max is not None and value > gate.max:
        bound = f", above {gate.max:g},"
    else:
        lost = any(not log.evaluated for log in found)
        outcome = Outcome.INCONCLUSIVE if lost or _lacking(gate, judged, found) else Outcome.PASS
    worst_of = f"worst {bad.value:.4g}{unit} " if reduce else ""
    return value, outcome, f"{gate.judged} = {value:.4g}{unit}{bound} {worst_of}{_place(bad)}{share}"


def _shared(
    gate: Gate, judged: Sequence[LogOutcome], bad: LogOutcome, found: Sequence[LogOutcome]
) -> tuple[float, Outcome, str]:
    """The same of the share of logs that pass."""
    least, n = gate.min_share or 0.0, len(found)
    passed = sum(log.outcome is Outcome.PASS for log in found)
    unsure = sum(log.outcome is Outcome.INCONCLUSIVE and log.evaluated for log in found)
    low, high = wilson(passed, n)
    if (passed + unsure) / n < least:
        outcome, how = Outcome(gate.broken), f"below {100.0 * least:g} %"
    elif passed / n < least:
        outcome, how = Outcome.INCONCLUSIVE, f"below {100.0 * least:g} %, unless what is inconclusive passes"
    elif gate.confident and low < least:
        outcome, how = Outcome.INCONCLUSIVE, f"but not surely {100.0 * least:g} %"
    elif _lacking(gate, judged, found):
        outcome, how = Outcome.INCONCLUSIVE, f"at least {100.0 * least:g} %, but of too few that were judged"
    else:
        outcome, how = Outcome.PASS, f"at least {100.0 * least:g} %"
    interval = f"95 % interval {100.0 * low:.3g} to {100.0 * high:.3g} %"
    share = f"holds in {passed} of {count_logs(n)} ({100.0 * passed / n:.3g} %, {interval}), {how}"
    worst = f"worst {bad.value:.4g}{unit_of(bad.unit)} {_place(bad)}"
    return passed / n, outcome, f"{gate.bound} {share}; {worst}"


def _lacking(gate: Gate, judged: Sequence[LogOutcome], found: Sequence[LogOutcome]) -> bool:
    """Whether too few logs were judged."""
    return len(judged) < gate.min_logs or len(found) - len(judged) > gate.max_missing * len(found) + 1e-9


def _place(log: LogOutcome) -> str:
    """Where a value is: "on log X at 3.20 s (car 7)"."""
    when = f" at {log.time_s:.2f} s" if isfinite(log.time_s) else ""
    return f"on {log.log}{when}" + (f" ({log.why})" if log.why else "")
