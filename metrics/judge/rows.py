"""Rows of the table that the gates make: is a verdict robust or fragile, and how many of the gates were asked?

A member is the log driven again under one perturbation (`replay.perturb`); its verdict on a planner in one mode is the
worst outcome of the gates. With the unperturbed drive among the members:

(1) ensemble.pass_share = members that pass / members
(2) ensemble.fragile    = 1 where a member's verdict is another than the unperturbed drive's, else 0
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import pandas as pd

from metrics.evidence import ASKED, ENSEMBLE
from metrics.judge.aggregate import LogLabels
from metrics.judge.gates import Gates, Outcome
from metrics.judge.verdicts import judge, outcomes, worst

MEMBER, PERTURBATION = "member", "perturbation"  # The columns of a table of members beside those of `metrics.evaluate`
_DRIVE = ["log", "planner", "mode"]
Drive = tuple[str, str, str]
Values = dict[tuple[str, str, str, str], tuple[float, str]]  # Value and reason by log, planner, mode and metric


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
