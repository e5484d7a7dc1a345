"""Rows of the table that the gates make: is a verdict robust or fragile, and how many of the gates were asked?

A member is the log driven again under one perturbation (`replay.perturb`). What a log says of a planner in one mode is
the worst of what it says of the gates. With the unperturbed drive among the members:

(1) ensemble.pass_share = members that pass / members
(2) ensemble.fragile    = 1 where a member's verdict is another than the unperturbed drive's, else 0

`asked.share` is the share of the gates that were asked of a drive.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import pandas as pd

from metrics.aggregate import LogLabels
from metrics.evidence import ASKED, ENSEMBLE
from metrics.gates import Gates, Outcome
from metrics.judge import judge, outcomes, worst

MEMBER, PERTURBATION = "member", "perturbation"
"""The columns of a table of members beside those of `metrics.evaluate`."""
_KEY = ["log", "planner", "mode"]


def with_ensemble(
    table: pd.DataFrame, members: pd.DataFrame, gates: Gates, labels: Mapping[str, LogLabels]
) -> pd.DataFrame:
    """The table with the rows (1) and (2) of each drive; as it is where there are no members.

    Args:
        table: The rows of the unperturbed drives.
        members: The rows of all members, `MEMBER` counted from 1.
        gates: The rules; those on `ensemble` itself are left out here.
        labels: As of `judge`.
    """
    if members.empty:
        return table
    rules = replace(gates, gates=tuple(gate for gate in gates.gates if not gate.metric.startswith(ENSEMBLE.name)))
    plain = _said(rules, table, labels)
    found: dict[tuple[str, str, str], list[tuple[Outcome, str]]] = {}
    for (_, name), rows in members.groupby([MEMBER, PERTURBATION], sort=True):
        logs = set(rows["log"])
        said = _said(rules, rows, {log: mine for log, mine in labels.items() if log in logs})
        for key in plain:
            if key[0] in logs:
                found.setdefault(key, []).append(_compared(str(name), plain[key], said.get(key)))
    values: dict[tuple[str, str, str, str], tuple[float, str]] = {}
    for key, others in found.items():
        base = worst([Outcome(outcome) for outcome in plain[key]["outcome"]])
        passed = sum(outcome is Outcome.PASS for outcome in (base, *(outcome for outcome, _ in others)))
        changes = [change for _, change in others if change]
        values[*key, f"{ENSEMBLE.name}.pass_share"] = passed / (len(others) + 1.0), ""  # (1)
        values[*key, f"{ENSEMBLE.name}.fragile"] = float(bool(changes)), "; ".join(changes)  # (2)
    return _filled(table, values)


def with_asked(table: pd.DataFrame, gates: Gates, labels: Mapping[str, LogLabels]) -> pd.DataFrame:
    """The table with the row `asked.share` of each drive: the share of the other gates that are asked of it."""
    rules = replace(gates, gates=tuple(gate for gate in gates.gates if not gate.metric.startswith(ASKED.name)))
    values: dict[tuple[str, str, str, str], tuple[float, str]] = {}
    for key, rows in _said(rules, table, labels).items():
        missing = rows.loc[rows["outcome"] == Outcome.NOT_ASKED.value, "gate"]
        reason = f"not asked: {', '.join(missing)}" if len(missing) else ""
        values[*key, f"{ASKED.name}.share"] = 1.0 - len(missing) / len(rows), reason
    return _filled(table, values)


def _filled(table: pd.DataFrame, values: Mapping[tuple[str, str, str, str], tuple[float, str]]) -> pd.DataFrame:
    """The table with the values and reasons of these rows, by log, planner, mode and metric."""
    keys = list(zip(*(table[name] for name in (*_KEY, "metric")), strict=True))
    at = table.index[[i for i, key in enumerate(keys) if key in values]]
    found = [values[key] for key in keys if key in values]
    out = table.copy()
    out.loc[at, "value"], out.loc[at, "reason"] = [value for value, _ in found], [reason for _, reason in found]
    out.loc[at, "available"] = True
    return out


def _said(
    gates: Gates, table: pd.DataFrame, labels: Mapping[str, LogLabels]
) -> dict[tuple[str, str, str], pd.DataFrame]:
    """What each log says of each gate, by log, planner and mode."""
    found = outcomes(judge(gates, table, labels))
    return {(str(key[0]), str(key[1]), str(key[2])): rows for key, rows in found.groupby(_KEY, sort=False)}


def _compared(name: str, plain: pd.DataFrame, member: pd.DataFrame | None) -> tuple[Outcome, str]:
    """A member's verdict, and how it differs: "turned: pass -> fail (gap.min >= 0.5)"; empty: it does not."""
    if member is None:
        return Outcome.INCONCLUSIVE, f"{name}: not evaluated"
    before, now = (worst([Outcome(outcome) for outcome in rows["outcome"]]) for rows in (plain, member))
    if before is now:
        return now, ""
    one, two = (rows.set_index("gate")["outcome"] for rows in (plain, member))
    gates = [str(gate) for gate in one.index if two.get(gate) != one[gate]]
    return now, f"{name}: {before.value} -> {now.value} ({', '.join(gates)})"
