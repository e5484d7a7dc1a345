"""Judging: the gates on the table of a run, log by log, and then over the logs.

What a log says of a gate, the first that holds:

    INCONCLUSIVE    the log could not be evaluated, or has no value (a NaN is none)
    INCONCLUSIVE    the value is within the bounds, but the drive crashed: what more it would have shown is not known
    PASS            the value is within the bounds, or the gate asks for the sum of all logs
    INCONCLUSIVE    the value is broken, but is no evidence against the planner (below), or `broken = "inconclusive"`
    FAIL            the value is broken

A broken value of the groups safety and progress is no evidence where the drive ended with `replay_contact` (a replayed
road user drove into the ego without its fault): of progress at all, of safety where it is about that road user. It is
none either where a reference drive, a row of mode "reference" in the table, breaks the same bound (`EXCUSED`): the
recorded driver in any way (planner "driver", there for recorded logs only) in safety and rules; the careful driver
(planner "careful", UN R157, who knows no rules) in safety and comfort, about the same road user, within `SAME_S` of the
same time, and where both collide not more slowly than the planner by more than `SLOWER_MPS`. Progress is none where the
collision that ended the drive is none, and in a log with phantoms, for which planners stop. Not asked at all is a log
without the value by an `optional` gate, and one in which neither reference drive holds the bound by a `reachable` one.

Over the logs together a gate has a verdict per planner and mode, and per group where it asks so (`metrics.over_logs`).
An optional gate has no verdict where no log was asked; filters that no log passes and planners that are not in the run
are INCONCLUSIVE always, since they are most likely misspelt.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from types import MappingProxyType

import pandas as pd

from metrics import GROUPS
from metrics.aggregate import LogLabels
from metrics.gates import Gate, Gates, Outcome, meant
from metrics.over_logs import LogOutcome, Verdict, unit_of, verdict_on

__all__ = ["LogOutcome", "Verdict", "judge", "outcomes", "verdicts_by_log", "worst"]

_NOTHING: Mapping[str, str] = MappingProxyType({})
_NO_DRIVE: Mapping[tuple[str, str, str], str] = MappingProxyType({})
REFERENCE = "reference"
"""Mode of the rows of reference drives."""
DRIVER, CAREFUL = "driver", "careful"
"""Planner of those rows: the log's own driver, and the careful one of UN R157."""
_DRIVERS = {DRIVER: "recorded", CAREFUL: "careful"}
REPLAY_CONTACT = "replay_contact.final"
NO_COLLISION = Gate("collision_at_fault.count", max=0.0)
"""A collision ends a drive: where it is no evidence, neither is that the drive got no further."""
SAME_S, SLOWER_MPS = 2.0, 1.0
"""A stop at another time, or an impact that is clearly harder, is another event (`CC_TTC_S` of the careful driver)."""
IMPACT = "collision_severity.impact_speed.max"
PHANTOMS = "phantom.count"
EXCUSED: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"safety": (DRIVER, CAREFUL), "rules": (DRIVER,), "comfort": (CAREFUL,)}
)
"""Which reference drives are asked, by group of metrics."""
_GROUP = {metric.name: name for name, group in GROUPS.items() for metric in group}
OUTCOME_COLUMNS = ("gate", "log", "planner", "mode", "outcome", "value", "time_s", "reason")


@dataclass(frozen=True, eq=False, slots=True)
class _Rows:
    """The table by (planner, mode), and within that by (log, metric): value, available, reason, unit, time."""

    drives: Mapping[tuple[str, str], Mapping[tuple[str, str], _Row]]
    oracles: frozenset[str]
    crashed: Mapping[tuple[str, str, str], str]

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
    rows = _rows(table, crashed)
    return tuple(verdict for gate in gates.gates for verdict in _judge(gate, rows, table, labels, failed))


def outcomes(verdicts: Sequence[Verdict]) -> pd.DataFrame:
    """What each log says of each gate, a row each: `OUTCOME_COLUMNS`; once, however many groups it is in."""
    found = [
        (str(v.gate), log.log, v.planner, v.mode, log.outcome.value, log.value, log.time_s, log.why)
        for v in verdicts
        for log in v.logs
    ]
    rows = pd.DataFrame(found, columns=list(OUTCOME_COLUMNS)).astype({"value": "float64", "time_s": "float64"})
    twice = [str(v.gate) for v in verdicts if v.gate.per == "tag"]
    again = rows.duplicated(["gate", "log", "planner", "mode"]) & rows["gate"].isin(twice)
    return rows[~again].reset_index(drop=True)


def worst(found: Sequence[Outcome]) -> Outcome:
    """Several outcomes taken together; INCONCLUSIVE where there is none."""
    return min(found, key=list(Outcome).index, default=Outcome.INCONCLUSIVE)


def verdicts_by_log(verdicts: Sequence[Verdict]) -> dict[tuple[str, str], str]:
    """The worst that the gates say, "pass", "fail" or "inconclusive", by log and planner, over both loops."""
    found: dict[tuple[str, str], list[Outcome]] = {}
    for verdict in verdicts:
        for log in verdict.logs:
            found.setdefault((log.log, verdict.planner), []).append(log.outcome)
    return {key: worst(said).value for key, said in found.items()}


def _rows(table: pd.DataFrame, crashed: Mapping[tuple[str, str, str], str]) -> _Rows:
    drives: dict[tuple[str, str], dict[tuple[str, str], _Row]] = {}
    columns = ("planner", "mode", "log", "metric", "value", "available", "reason", "unit", "time_s")
    for planner, mode, log, metric, *rest in zip(*(table[name] for name in columns), strict=True):
        drives.setdefault((planner, mode), {})[log, metric] = _Row(*rest)
    return _Rows(drives, frozenset(table.loc[table["oracle"].astype(bool), "planner"]), crashed)


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
    found = (
        verdict_on(gate, drive, tuple(_of_logs(gate, drive, rows, mine, failed)), group)
        for drive in drives
        if drive[1] in modes
        for group, mine in _grouped(logs, gate, labels).items()
    )
    return [verdict for verdict in found if verdict is not None]


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
    """What the logs that are asked say."""
    mine = rows.drives[drive]
    ran = {log for log, _ in mine}
    for log in logs:
        row = mine.get((log, gate.metric))
        if log in failed or log not in ran:
            yield LogOutcome(log, Outcome.INCONCLUSIVE, failed.get(log, "no result"), evaluated=False)
        elif row is None or not row.known:
            if not gate.optional:
                yield LogOutcome(log, Outcome.INCONCLUSIVE, _lack(row))
        elif gate.over == "sum" or gate.margin(row.value) >= 0.0:
            if (log, *drive) in rows.crashed:
                yield LogOutcome(log, Outcome.INCONCLUSIVE, rows.crashed[log, *drive], evaluated=False)
                continue
            yield LogOutcome(log, Outcome.PASS, row.reason, row.value, row.unit, row.time_s)
        elif not gate.reachable or _reachable(gate, log, rows):
            why = _excuse(gate, log, row, mine, rows)
            outcome = Outcome.INCONCLUSIVE if why else Outcome(gate.broken)
            said = row.reason or (gate.reason if outcome is Outcome.INCONCLUSIVE else "")
            yield LogOutcome(log, outcome, why or said, row.value, row.unit, row.time_s)


def _lack(row: _Row | None) -> str:
    if row is None:
        return "not measured"
    return row.reason if not row.available else "the value is not a number"


def _reachable(gate: Gate, log: str, rows: _Rows) -> bool:
    """Whether a reference drive holds the bound."""
    drives = (rows.reference(planner, log, gate.metric) for planner in (DRIVER, CAREFUL))
    return any(row is not None and gate.margin(row.value) >= 0.0 for row in drives)


def _excuse(gate: Gate, log: str, row: _Row, mine: Mapping[tuple[str, str], _Row], rows: _Rows) -> str:
    """Why a broken value is no evidence against the planner (module docstring); empty: it is."""
    group = _GROUP.get(gate.metric.partition(".")[0], "")
    contact = mine.get((log, REPLAY_CONTACT))
    if contact is not None and contact.known and contact.value > 0.0 and _concerns(group, row, contact):
        return f"the replay ran into the ego ({contact.reason})"
    if group in EXCUSED:
        return _by_reference(gate, log, row, mine, rows, EXCUSED[group])
    crash = mine.get((log, NO_COLLISION.metric))
    if group == "progress" and crash is not None and crash.known and NO_COLLISION.margin(crash.value) < 0.0:
        return _by_reference(NO_COLLISION, log, crash, mine, rows, EXCUSED["safety"])
    phantom = mine.get((log, PHANTOMS))
    if group == "progress" and phantom is not None and phantom.known and phantom.value > 0.0:
        return f"the log shows planners what was not there ({phantom.reason})"
    return ""


def _concerns(group: str, row: _Row, contact: _Row) -> bool:
    """Whether a value of a group is concerned by the replay's running into the ego."""
    return group == "progress" or (group == "safety" and _about(row) == _about(contact))


def _by_reference(
    gate: Gate, log: str, row: _Row, mine: Mapping[tuple[str, str], _Row], rows: _Rows, asked: Sequence[str]
) -> str:
    """Which of the reference drives that are asked breaks the bound too; empty: none."""
    for planner in asked:
        found = rows.reference(planner, log, gate.metric)
        if found is None or gate.margin(found.value) >= 0.0:
            continue
        impacts = mine.get((log, IMPACT)), rows.reference(CAREFUL, log, IMPACT)
        if planner == DRIVER or (_same_event(row, found) and not _harder(*impacts)):
            return f"the {_DRIVERS[planner]} driver breaks {gate} too: {_shown(found)}"
    return ""


def _same_event(row: _Row, found: _Row) -> bool:
    """Whether two values are about the same road user and about the same time; a value without a time is about none."""
    return _about(row) == _about(found) and abs(row.time_s - found.time_s) <= SAME_S


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
