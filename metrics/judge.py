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

Over the logs together a gate has a verdict per planner and mode, and per group where it asks so (`metrics.over_logs`).
An optional gate has no verdict where no log was asked; filters that no log passes and planners that are not in the run
are INCONCLUSIVE always, since they are most likely misspelt.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import isfinite, nan
from types import MappingProxyType

import pandas as pd

from metrics import GROUPS
from metrics.aggregate import LogLabels
from metrics.gates import Gate, Gates, Outcome, meant
from metrics.marginal import marginal
from metrics.over_logs import LogOutcome, Verdict, unit_of, verdict_on

__all__ = ["LogOutcome", "Verdict", "judge", "outcomes", "verdicts_by_log", "worst"]

_NOTHING: Mapping[str, str] = MappingProxyType({})
_NO_DRIVE: Mapping[tuple[str, str, str], str] = MappingProxyType({})
REFERENCE = "reference"
"""Mode of the rows of reference drives."""
DRIVER, CAREFUL, FOLLOWER = "driver", "careful", "follower"
REFERENCES = {DRIVER: "the recorded driver", CAREFUL: "the careful driver", FOLLOWER: "the route follower"}
"""Planner of those rows: the log's own driver; the careful driver of UN R157, which brakes only and knows no rules; and
the route follower, which accelerates, steers and obeys the rules (`replay.reference_drives`)."""
REPLAY_CONTACT = "replay_contact.final"
NO_COLLISION = Gate("collision_at_fault.count", max=0.0)
"""A collision ends a drive: where it is no evidence, neither is that the drive got no further."""
SAME_S, SLOWER_MPS, WORSE = 2.0, 1.0, 1.5
"""A stop at another time, or an impact that is clearly harder, is another event (`CC_TTC_S` of the careful driver). A
value that is farther out of bounds than `WORSE` times the reference drive's holds more than that event."""
IMPACT = "collision_severity.impact_speed.max"
PHANTOMS = "phantom.count"
EXCUSED: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"safety": (DRIVER, CAREFUL), "rules": (DRIVER,), "comfort": (CAREFUL,)}
)
"""Which reference drives are asked, by group of metrics."""
NAMED, LAWFUL = ("comfort",), ("safety", "rules")
"""Groups whose events are excused only where they are about a road user, and whose gates a yardstick holds."""
_GROUP = {metric.name: name for name, group in GROUPS.items() for metric in group}
OUTCOME_COLUMNS = ("gate", "log", "planner", "mode", "outcome", "value", "time_s", "reason")


@dataclass(frozen=True, eq=False, slots=True)
class _Rows:
    """The table by (planner, mode), and within that by (log, metric): value, available, reason, unit, time."""

    drives: Mapping[tuple[str, str], Mapping[tuple[str, str], _Row]]
    oracles: frozenset[str]
    crashed: Mapping[tuple[str, str, str], str]
    lawful: tuple[Gate, ...]

    def reference(self, planner: str, log: str, metric: str) -> _Row | None:
        """The value of a reference drive; None where it has none."""
        row = self.drives.get((planner, REFERENCE), {}).get((log, metric))
        return row if row is not None and row.known else None


@dataclass(frozen=True, slots=True)
class _Row:
    value: float
    available: bool
    reason: str
    unit: str
    time_s: float

    @property
    def known(self) -> bool:
        return self.available and isfinite(self.value)


def judge(
    gates: Gates,
    table: pd.DataFrame,
    labels: Mapping[str, LogLabels],
    *,
    failed: Mapping[str, str] = _NOTHING,
    crashed: Mapping[tuple[str, str, str], str] = _NO_DRIVE,
) -> tuple[Verdict, ...]:
    """The verdicts on a table of `evaluate` rows, in the order of the gates.

    Args:
        gates: The rules.
        table: The rows of all logs, planners and modes, reference drives among them.
        labels: What each log belongs to: all logs of the run, so that one without rows is missed.
        failed: Logs that could not be evaluated, and why.
        crashed: Drives that ended in an error, by log, planner and mode, and in which.
    """
    rows = _rows(table, crashed, tuple(gate for gate in gates.gates if gate.over == "worst" and _group(gate) in LAWFUL))
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


def verdicts_by_log(verdicts: Sequence[Verdict]) -> dict[tuple[str, str], str]:
    """The worst outcome, "pass", "fail" or "inconclusive", by log and planner, over both loops."""
    found: dict[tuple[str, str], list[Outcome]] = {}
    for verdict in verdicts:
        for log in verdict.logs:
            found.setdefault((log.log, verdict.planner), []).append(log.outcome)
    return {key: worst(said).value for key, said in found.items()}


def _group(gate: Gate) -> str:
    return _GROUP.get(gate.metric.partition(".")[0], "")


def _rows(table: pd.DataFrame, crashed: Mapping[tuple[str, str, str], str], lawful: tuple[Gate, ...]) -> _Rows:
    drives: dict[tuple[str, str], dict[tuple[str, str], _Row]] = {}
    columns = ("planner", "mode", "log", "metric", "value", "available", "reason", "unit", "time_s")
    for planner, mode, log, metric, *rest in zip(*(table[name] for name in columns), strict=True):
        drives.setdefault((planner, mode), {})[log, metric] = _Row(*rest)
    return _Rows(drives, frozenset(table.loc[table["oracle"].astype(bool), "planner"]), crashed, lawful)


def _judge(
    gate: Gate, rows: _Rows, table: pd.DataFrame, labels: Mapping[str, LogLabels], failed: Mapping[str, str]
) -> list[Verdict]:
    logs = [log for log in dict.fromkeys([*labels, *table["log"], *failed]) if _selected(log, gate, labels, failed)]
    lost = "".join(f"; {log} could not be evaluated: {failed[log]}" for log in logs if log in failed)
    if not logs:
        return [Verdict(gate, Outcome.INCONCLUSIVE, f"nothing to judge: no log has {_filters(gate, labels)}")]
    drives = [drive for drive in rows.drives if _is_judged(gate, drive, rows)]
    modes = {mode for planner, mode in drives if any(name == gate.metric for _, name in rows.drives[planner, mode])}
    if not modes:
        asked = not gate.optional or (gate.planner is not None and all(gate.planner != name for name, _ in rows.drives))
        reason = f"nothing to judge: {_nothing(gate, rows)} in this run{lost}"
        return [Verdict(gate, Outcome.INCONCLUSIVE, reason)] if asked else []
    return [
        verdict_on(gate, drive, tuple(_of_logs(gate, drive, rows, mine, failed)), group)
        for drive in drives
        if drive[1] in modes
        for group, mine in _grouped(logs, gate, labels).items()
    ]


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


def _is_judged(gate: Gate, drive: tuple[str, str], rows: _Rows) -> bool:
    planner, mode = drive
    named = planner not in rows.oracles if gate.planner is None else planner == gate.planner
    return named and mode != REFERENCE and gate.mode in (None, mode)


def _nothing(gate: Gate, rows: _Rows) -> str:
    known = sorted({planner for planner, mode in rows.drives if mode != REFERENCE})
    near = meant(gate.planner, known) if gate.planner and gate.planner not in known else ""
    planner = f"planner {gate.planner}{near}" if gate.planner else "a planner that is no oracle"
    return f"{gate.metric} was not measured for {planner}{f' in {gate.mode} loop' if gate.mode else ''}"


# one log ----------------------------------------------------------------------------------------------------------


def _of_logs(
    gate: Gate, drive: tuple[str, str], rows: _Rows, logs: Sequence[str], failed: Mapping[str, str]
) -> Iterator[LogOutcome]:
    """The outcome of each log that the gate selects (module docstring)."""
    mine = rows.drives[drive]
    ran = {log for log, _ in mine}
    for log in logs:
        row = mine.get((log, gate.metric))
        if log in failed or log not in ran:
            yield LogOutcome(log, Outcome.INCONCLUSIVE, failed.get(log, "no result"), evaluated=False)
            continue
        if row is None or not row.known:
            yield LogOutcome(log, Outcome.NOT_ASKED if gate.optional else Outcome.INCONCLUSIVE, _lack(row))
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


def _value(mine: Mapping[tuple[str, str], _Row], log: str, metric: str) -> float:
    """A value of a drive by its name in the table; NaN where it has none."""
    row = mine.get((log, metric))
    return row.value if row is not None and row.known else nan


def _lack(row: _Row | None) -> str:
    if row is None:
        return "not measured"
    return row.reason if not row.available else "the value is not a number"


def _lacking_evidence(gate: Gate, log: str, mine: Mapping[tuple[str, str], _Row]) -> str:
    """Why a value within the bounds is no pass: too little of the drive has the evidence; empty: it has enough."""
    share = mine.get((log, f"evidence.{gate.evidence}.share"))
    if share is None or not share.known or share.value >= gate.min_evidence:
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
    contact = mine.get((log, REPLAY_CONTACT))
    if contact is not None and contact.known and contact.value > 0.0 and _concerns(group, row, contact):
        return f"the replay ran into the ego ({contact.reason})"
    if group in EXCUSED:
        return _by_reference(gate, log, row, mine, rows)
    crash, phantom = mine.get((log, NO_COLLISION.metric)), mine.get((log, PHANTOMS))
    if group == "progress" and crash is not None and crash.known and NO_COLLISION.margin(crash.value) < 0.0:
        return _by_reference(NO_COLLISION, log, crash, mine, rows)
    follower = rows.reference(FOLLOWER, log, gate.metric)
    stopped = follower is not None and gate.margin(follower.value) < 0.0
    if group == "progress" and stopped and phantom is not None and phantom.known and phantom.value > 0.0:
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


def _concerns(group: str, row: _Row, contact: _Row) -> bool:
    """Whether a value of a group is concerned by the replay's running into the ego."""
    return group == "progress" or (group == "safety" and _about(row) == _about(contact))


def _by_reference(gate: Gate, log: str, row: _Row, mine: Mapping[tuple[str, str], _Row], rows: _Rows) -> str:
    """Which reference drive breaks the bound in the same event (module docstring); empty: none."""
    group = _group(gate)
    for planner in EXCUSED[group]:
        found = rows.reference(planner, log, gate.metric)
        if found is None or gate.margin(found.value) >= 0.0:
            continue
        if _about(row) != _about(found) or not abs(row.time_s - found.time_s) <= SAME_S:
            continue
        if (group in NAMED and not _about(row)) or gate.margin(row.value) < WORSE * gate.margin(found.value):
            continue
        impacts = mine.get((log, IMPACT)), rows.reference(CAREFUL, log, IMPACT)
        if planner == DRIVER or not _harder(*impacts):
            return f"{REFERENCES[planner]} breaks {gate} too: {_shown(found)}"
    return ""


def _harder(impact: _Row | None, careful: _Row | None) -> bool:
    """Whether the planner collides, and the careful driver does not, or clearly more slowly."""
    if impact is None or not impact.known:
        return False
    return careful is None or impact.value > careful.value + SLOWER_MPS


def _about(row: _Row | None) -> str:
    """On which road user or thing a value is: "car 12" of "car 12: from behind, not at fault"."""
    return row.reason.partition(":")[0] if row is not None else ""


def _shown(row: _Row) -> str:
    about = f" ({row.reason})" if row.reason else ""
    return f"{row.value:.4g}{unit_of(row.unit)}{about}"
