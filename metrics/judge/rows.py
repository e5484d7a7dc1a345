"""Rows that the gates make: is a verdict robust or fragile, how many of the gates were asked, were plans late?

A member is the log driven again under one perturbation (`replay.run.perturb`); its verdict on a planner in one mode is
the worst outcome of the gates. With the unperturbed drive among the members:

(1) ensemble.pass_share = members that pass / members
(2) ensemble.fragile    = 1 where a member's verdict is another than the unperturbed drive's, else 0

Late plans are wall clock, so they are not in the table of metrics.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import pandas as pd

from metrics.evidence import ASKED, ENSEMBLE
from metrics.judge.aggregate import LogLabels
from metrics.judge.gates import Gate, Gates, Outcome
from metrics.judge.verdicts import Verdict, judge, outcomes, worst

MEMBER, PERTURBATION = "member", "perturbation"  # The columns of a table of members beside those of `metrics.evaluate`
_DRIVE = ["log", "planner", "mode"]
Drive = tuple[str, str, str]
Values = dict[tuple[str, str, str, str], tuple[float, str]]  # Value and reason by log, planner, mode and metric
SHARE = "deadline.share"
MAX_SHARE = 0.01  # The share of a drive's plans that may be late
MISS_COLUMNS = ("log", "planner", "mode", "plans", "misses", "share", "worst_s", "worst_t_s")


def with_ensemble(
    table: pd.DataFrame, members: pd.DataFrame, gates: Gates, labels: Mapping[str, LogLabels]
) -> pd.DataFrame:
    """The table of unperturbed drives with the rows (1) and (2) of each; those of `members` are counted from 1.

    Gates on `ensemble` itself are left out.
    """
    if members.empty:
        return table
    rules = replace(gates, gates=tuple(gate for gate in gates.gates if not gate.metric.startswith(ENSEMBLE.name)))
    plain = _by_drive(rules, table, labels)
    found: dict[Drive, list[tuple[Outcome, str]]] = {}
    for (_, name), rows in members.groupby([MEMBER, PERTURBATION], sort=True):
        logs = set(rows["log"])
        members_of = _by_drive(rules, rows, {log: mine for log, mine in labels.items() if log in logs})
        for drive, base in plain.items():
            if drive[0] not in logs:
                continue
            now, change = Outcome.INCONCLUSIVE, f"{name}: not evaluated"
            if (member := members_of.get(drive)) is not None:
                before, now = worst(base.values()), worst(member.values())
                gates_of = ", ".join(gate for gate, outcome in base.items() if member.get(gate) is not outcome)
                change = "" if before is now else f"{name}: {before.value} -> {now.value} ({gates_of})"
            found.setdefault(drive, []).append((now, change))
    values: Values = {}
    for drive, others in found.items():
        passed = sum(one is Outcome.PASS for one in (worst(plain[drive].values()), *(one for one, _ in others)))
        changes = [change for _, change in others if change]
        values[*drive, f"{ENSEMBLE.name}.pass_share"] = passed / (len(others) + 1.0), ""  # (1)
        values[*drive, f"{ENSEMBLE.name}.fragile"] = float(bool(changes)), "; ".join(changes)  # (2)
    return _filled(table, values)


def with_asked(table: pd.DataFrame, gates: Gates, labels: Mapping[str, LogLabels]) -> pd.DataFrame:
    """The table with the row `asked.share` of each drive: the share of the other gates that are asked of it."""
    rules = replace(gates, gates=tuple(gate for gate in gates.gates if not gate.metric.startswith(ASKED.name)))
    values: Values = {}
    for drive, said in _by_drive(rules, table, labels).items():
        missing = [gate for gate, outcome in said.items() if outcome is Outcome.NOT_ASKED]
        reason = f"not asked: {', '.join(missing)}" if missing else ""
        values[*drive, f"{ASKED.name}.share"] = 1.0 - len(missing) / len(said), reason
    return _filled(table, values)


def _filled(table: pd.DataFrame, values: Values) -> pd.DataFrame:
    """The table with these values and reasons."""
    keys = list(zip(*(table[name] for name in (*_DRIVE, "metric")), strict=True))
    at = table.index[[i for i, key in enumerate(keys) if key in values]]
    found = [values[key] for key in keys if key in values]
    out = table.copy()
    out.loc[at, "value"], out.loc[at, "reason"] = [value for value, _ in found], [reason for _, reason in found]
    out.loc[at, "available"] = True
    return out


def _by_drive(gates: Gates, table: pd.DataFrame, labels: Mapping[str, LogLabels]) -> dict[Drive, dict[str, Outcome]]:
    """Outcomes by gate, of each log, planner and mode."""
    found: dict[Drive, dict[str, Outcome]] = {}
    table = outcomes(judge(gates, table, labels))
    for *drive, gate, outcome in zip(*(table[name] for name in (*_DRIVE, "gate", "outcome")), strict=True):
        found.setdefault((drive[0], drive[1], drive[2]), {})[gate] = Outcome(outcome)
    return found


def deadline_misses(timings: pd.DataFrame, deadline_s: float) -> pd.DataFrame:
    """How many plans of each drive took longer than a deadline.

    Args:
        timings: Columns log, planner, mode, t_s, stage, seconds; the stage "total" is a whole plan.
        deadline_s: A plan that takes longer has missed it, s; ValueError unless above 0.

    Returns:
        `MISS_COLUMNS` of each log, planner and mode in the order of `timings`: plans made, misses, their share, the
        longest time of a plan, and when that plan was asked for.
    """
    if not deadline_s > 0.0:
        raise ValueError(f"a deadline of {deadline_s} s")
    rows = []
    for drive, plans in timings[timings["stage"] == "total"].groupby(_DRIVE, sort=False, observed=True):
        late, worst = plans["seconds"] > deadline_s, plans.iloc[int(plans["seconds"].argmax())]
        rows.append((*drive, len(plans), int(late.sum()), float(late.mean()), worst["seconds"], worst["t_s"]))
    return pd.DataFrame(rows, columns=list(MISS_COLUMNS))


def judge_deadline(timings: pd.DataFrame, deadline_s: float, labels: Mapping[str, LogLabels]) -> tuple[Verdict, ...]:
    """The verdicts on the share of late plans, at most `MAX_SHARE` in each drive; arguments as of `deadline_misses`."""
    late = deadline_misses(timings, deadline_s)
    why = [
        f"{row.misses} of {row.plans} plans took longer than {deadline_s:g} s, one {row.worst_s:.3g} s"
        for row in late.itertuples()
    ]
    table = late[_DRIVE].assign(
        oracle=False, metric=SHARE, value=late["share"], unit="1", available=True, reason=why, time_s=late["worst_t_s"]
    )
    gate = Gate(SHARE, max=MAX_SHARE, reason=f"plans are made within {deadline_s:g} s on this machine")
    return judge(Gates((gate,), "deadline"), table, labels)
