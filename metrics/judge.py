"""Judging: the gates on the table of a run, log by log, and then over the logs.

What a log says of a gate, the first that holds:

    INCONCLUSIVE    the log could not be evaluated, or has no value (a NaN is none)
    PASS            the value is within the bounds
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

A verdict per gate, planner and mode: FAIL where a log (`over = "worst"`) or the mean over the judged logs breaks the
bound; else INCONCLUSIVE where a log could not be evaluated, fewer than `min_logs` were judged, or more than
`max_missing` of those asked are inconclusive; else PASS. An optional gate has no verdict where no log was asked; tags
that no log has and planners that are not in the run are INCONCLUSIVE always, since they are most likely misspelt.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, nan
from types import MappingProxyType

import numpy as np
import pandas as pd

from metrics import GROUPS
from metrics.gates import Gate, Gates, Outcome, meant

_NOTHING: Mapping[str, str] = MappingProxyType({})
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


@dataclass(frozen=True, slots=True)
class LogOutcome:
    """What one log says of a gate: `why` it is inconclusive, else on which road user or thing the value is."""

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
        outcome: Pass, fail or inconclusive.
        reason: One sentence that names planner, worst log, value and time.
        planner: "" where no planner was to be judged; `mode` likewise.
        value: The judged value (the mean with `over = "mean"`, else the worst log's); NaN where there is none.
        log: The worst log; "" where there is none.
        time_s: When its value occurred; NaN where it has no time.
        logs: What each log that was asked says.
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


@dataclass(frozen=True, eq=False, slots=True)
class _Rows:
    """The table by (planner, mode), and within that by (log, metric): value, available, reason, unit, time."""

    drives: Mapping[tuple[str, str], Mapping[tuple[str, str], _Row]]
    oracles: frozenset[str]

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
    tags: Mapping[str, tuple[str, ...]],
    *,
    failed: Mapping[str, str] = _NOTHING,
) -> tuple[Verdict, ...]:
    """The verdicts on a table of `evaluate` rows, in the order of the gates.

    Args:
        gates: The rules.
        table: The rows of all logs, planners and modes, reference drives among them.
        tags: Tags by log: all logs of the run, so that one without rows is missed.
        failed: Logs that could not be evaluated, and why.
    """
    rows = _rows(table)
    return tuple(verdict for gate in gates.gates for verdict in _judge(gate, rows, table, tags, failed))


def outcomes(verdicts: Sequence[Verdict]) -> pd.DataFrame:
    """What each log says of each gate, a row each: `OUTCOME_COLUMNS`."""
    found = [
        (str(v.gate), log.log, v.planner, v.mode, log.outcome.value, log.value, log.time_s, log.why)
        for v in verdicts
        for log in v.logs
    ]
    return pd.DataFrame(found, columns=list(OUTCOME_COLUMNS)).astype({"value": "float64", "time_s": "float64"})


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


def _rows(table: pd.DataFrame) -> _Rows:
    drives: dict[tuple[str, str], dict[tuple[str, str], _Row]] = {}
    columns = ("planner", "mode", "log", "metric", "value", "available", "reason", "unit", "time_s")
    for planner, mode, log, metric, *rest in zip(*(table[name] for name in columns), strict=True):
        drives.setdefault((planner, mode), {})[log, metric] = _Row(*rest)
    return _Rows(drives, frozenset(table.loc[table["oracle"].astype(bool), "planner"]))


def _judge(
    gate: Gate, rows: _Rows, table: pd.DataFrame, tags: Mapping[str, tuple[str, ...]], failed: Mapping[str, str]
) -> list[Verdict]:
    logs = [log for log in dict.fromkeys([*tags, *table["log"], *failed]) if _tagged(log, gate, tags, failed)]
    lost = "".join(f"; {log} could not be evaluated: {failed[log]}" for log in logs if log in failed)
    if not logs:
        known = sorted({tag for words in tags.values() for tag in words})
        words = ", ".join(f"{tag}{meant(tag, known, cutoff=0.7) if tag not in known else ''}" for tag in gate.tags)
        return [Verdict(gate, Outcome.INCONCLUSIVE, f"nothing to judge: no log has the tags {words}")]
    drives = [drive for drive in rows.drives if _is_judged(gate, drive, rows)]
    modes = {mode for planner, mode in drives if any(name == gate.metric for _, name in rows.drives[planner, mode])}
    if not modes:
        asked = not gate.optional or (gate.planner is not None and all(gate.planner != name for name, _ in rows.drives))
        reason = f"nothing to judge: {_nothing(gate, rows)} in this run{lost}"
        return [Verdict(gate, Outcome.INCONCLUSIVE, reason)] if asked else []
    found = (_verdict(gate, drive, rows, logs, failed) for drive in drives if drive[1] in modes)
    return [verdict for verdict in found if verdict is not None]


def _tagged(log: str, gate: Gate, tags: Mapping[str, tuple[str, ...]], failed: Mapping[str, str]) -> bool:
    """Whether the gate asks for a log; one that failed before its tags were known may be asked for."""
    return set(gate.tags) <= set(tags.get(log, ())) or (log in failed and log not in tags)


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
        elif gate.margin(row.value) >= 0.0:
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
    return f"{row.value:.4g}{_unit(row.unit)}{about}"


# all logs ---------------------------------------------------------------------------------------------------------


def _verdict(
    gate: Gate, drive: tuple[str, str], rows: _Rows, logs: Sequence[str], failed: Mapping[str, str]
) -> Verdict | None:
    """The verdict on one planner and mode; None: no log was asked."""
    found = tuple(_of_logs(gate, drive, rows, logs, failed))
    planner, mode = drive
    who = f"{planner}, {mode} loop"
    judged = [log for log in found if isfinite(log.value) and log.outcome is not Outcome.INCONCLUSIVE]
    if not found:
        return None if gate.optional else Verdict(gate, Outcome.INCONCLUSIVE, f"{who}: no log was asked", planner, mode)
    aside = _aside(found)
    if not judged:
        return Verdict(gate, Outcome.INCONCLUSIVE, f"{who}: nothing to judge{aside}", planner, mode, logs=found)
    margins = np.array([gate.margin(log.value) for log in judged])
    bad = judged[int(np.argmin(margins))]
    value = float(np.mean([log.value for log in judged])) if gate.over == "mean" else bad.value
    few = f"; {_logs(len(judged))} judged, {gate.min_logs} must be" if len(judged) < gate.min_logs else ""
    broken = int((margins < 0.0).sum())
    share = f"; broken in {broken} of {_logs(len(judged))}" if gate.over == "worst" and broken else ""
    reason = f"{who}: {_found(gate, value, bad)}{share}{few}{aside}"
    outcome = _outcome(gate, value, len(judged), found)
    return Verdict(gate, outcome, reason, planner, mode, value, bad.log, bad.time_s, found)


def _outcome(gate: Gate, value: float, judged: int, found: Sequence[LogOutcome]) -> Outcome:
    if gate.margin(value) < 0.0:
        return Outcome(gate.broken)
    lost = any(not log.evaluated for log in found)
    missing = len(found) - judged > gate.max_missing * len(found) + 1e-9
    return Outcome.INCONCLUSIVE if lost or missing or judged < gate.min_logs else Outcome.PASS


def _found(gate: Gate, value: float, worst_log: LogOutcome) -> str:
    """What was found: "gap.min = 0.31 m, below 0.5, on log X at 3.20 s (car 12)"."""
    unit = _unit(worst_log.unit)
    if gate.min is not None and value < gate.min:
        bound = f", below {gate.min:g},"
    elif gate.max is not None and value > gate.max:
        bound = f", above {gate.max:g},"
    else:
        bound = ", within bounds,"
    mean = gate.over == "mean"
    where = f"worst {worst_log.value:.4g}{unit} on {worst_log.log}" if mean else f"on {worst_log.log}"
    when = f" at {worst_log.time_s:.2f} s" if isfinite(worst_log.time_s) else ""
    about = f" ({worst_log.why})" if worst_log.why else ""
    return f"{'mean ' if mean else ''}{gate.metric} = {value:.4g}{unit}{bound} {where}{when}{about}"


def _unit(unit: str) -> str:
    return "" if unit in ("1", "count") else f" {unit}"


def _logs(count: int) -> str:
    return "1 log" if count == 1 else f"{count} logs"


def _aside(found: Sequence[LogOutcome]) -> str:
    """What could not be judged: logs without evidence (with the commonest reason), logs without a result."""
    without = [log for log in found if log.outcome is Outcome.INCONCLUSIVE and log.evaluated]
    missing = [log for log in found if not log.evaluated]
    out = ""
    if without:
        ran = len(found) - len(missing)
        common = Counter(log.why for log in without).most_common(1)[0][0]
        out = f"; no evidence in {len(without)} of {_logs(ran)} ({common})"
    if missing:
        out += f"; {_logs(len(missing))} could not be evaluated ({missing[0].log}: {missing[0].why})"
    return out
