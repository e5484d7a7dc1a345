"""Rows of the table that gates fill in: whether a verdict is robust or fragile, and the share of
gates that were asked.

A member is the log driven again under one perturbation (`replan.run.sources`); its verdict on a
planner in one mode is the worst outcome of the gates. The unperturbed drive is one of the members:

(1) ensemble.pass_share = members that pass / members
(2) ensemble.fragile
        = 1 if the verdict of any member differs from the unperturbed drive's, else 0
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import pandas as pd

from replan.metrics.evidence import asked, ensemble
from replan.metrics.judge.aggregate import LogLabels
from replan.metrics.judge.gates import Gates, Outcome
from replan.metrics.judge.verdicts import DRIVE, judge, outcomes, worst

MEMBER, PERTURBATION = "member", "perturbation"  # Additional columns of a table of members
Drive = tuple[str, str, str]  # Log, planner, mode
# Value and reason by log, planner, mode and metric
Values = dict[tuple[str, str, str, str], tuple[float, str]]


def with_ensemble(
    table: pd.DataFrame, members: pd.DataFrame, gates: Gates, labels: Mapping[str, LogLabels]
) -> pd.DataFrame:
    """Add the rows (1) and (2) to the table of unperturbed drives; the drives of `members` are
    numbered from 1.

    Gates on `ensemble` itself are left out.
    """
    if members.empty:
        return table
    rules = replace(
        gates,
        gates=tuple(gate for gate in gates.gates if not gate.metric.startswith(ensemble.name)),
    )
    plain = _drive_outcomes(rules, table, labels)
    by_drive: dict[Drive, list[tuple[Outcome, str]]] = {}
    for (_, name), rows in members.groupby([MEMBER, PERTURBATION], sort=True):
        logs = set(rows["log"])
        members_of = _drive_outcomes(
            rules, rows, {log: labels[log] for log in labels if log in logs}
        )
        for drive, base in plain.items():
            if drive[0] not in logs:
                continue
            now, change = Outcome.INCONCLUSIVE, f"{name}: not evaluated"
            if (member := members_of.get(drive)) is not None:
                before, now = worst(base.values()), worst(member.values())
                changed = [
                    gate for gate, outcome in base.items() if member.get(gate) is not outcome
                ]
                change = f"{name}: {before.value} -> {now.value} ({', '.join(changed)})"
                if before is now:
                    change = ""
            by_drive.setdefault(drive, []).append((now, change))
    values: Values = {}
    for drive, others in by_drive.items():
        member_outcomes = [worst(plain[drive].values()), *(outcome for outcome, _ in others)]
        passed = member_outcomes.count(Outcome.PASS)
        changes = [change for _, change in others if change]
        values[*drive, f"{ensemble.name}.pass_share"] = passed / (len(others) + 1.0), ""  # (1)
        values[*drive, f"{ensemble.name}.fragile"] = float(bool(changes)), "; ".join(changes)  # (2)
    return fill_rows(table, values)


def with_asked(table: pd.DataFrame, gates: Gates, labels: Mapping[str, LogLabels]) -> pd.DataFrame:
    """Add the row `asked.share` of each drive to the table: the share of the other gates that were
    asked.
    """
    rules = replace(
        gates, gates=tuple(gate for gate in gates.gates if not gate.metric.startswith(asked.name))
    )
    values: Values = {}
    for drive, by_gate in _drive_outcomes(rules, table, labels).items():
        missing = [gate for gate, outcome in by_gate.items() if outcome is Outcome.NOT_ASKED]
        reason = f"not asked: {', '.join(missing)}" if missing else ""
        values[*drive, f"{asked.name}.share"] = 1.0 - len(missing) / len(by_gate), reason
    return fill_rows(table, values)


def fill_rows(table: pd.DataFrame, values: Values) -> pd.DataFrame:
    """Return the table with these values and reasons filled in."""
    keys = list(zip(*(table[name] for name in (*DRIVE, "metric")), strict=True))
    filled = table.index[[i for i, key in enumerate(keys) if key in values]]
    new_values = [values[key] for key in keys if key in values]
    result = table.copy()
    result.loc[filled, "value"] = [value for value, _ in new_values]
    result.loc[filled, "reason"] = [reason for _, reason in new_values]
    result.loc[filled, "available"] = True
    return result


def _drive_outcomes(
    gates: Gates, table: pd.DataFrame, labels: Mapping[str, LogLabels]
) -> dict[Drive, dict[str, Outcome]]:
    """Return the outcomes by gate, for each log, planner and mode."""
    by_drive: dict[Drive, dict[str, Outcome]] = {}
    table = outcomes(judge(gates, table, labels))
    for *drive, gate, outcome in zip(
        *(table[name] for name in (*DRIVE, "gate", "outcome")), strict=True
    ):
        by_drive.setdefault((drive[0], drive[1], drive[2]), {})[gate] = Outcome(outcome)
    return by_drive
