"""What changed against a baseline, as sections; the outcome of a comparison in a line, and as
JSON.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from math import isfinite, nan
from typing import Any

import pandas as pd

from replan.core.names import counted
from replan.draw.report.section import (
    Cell,
    ReportColumn,
    ReportSection,
    number_cell,
    number_column,
    outcome_cell,
    seconds_column,
    text_column,
    unit_suffix,
    with_contents,
)
from replan.metrics.comparison import Comparison
from replan.metrics.judge.aggregate import SUITE
from replan.metrics.judge.gates import Outcome
from replan.metrics.judge.verdicts import DRIVE

MOST_PAIRS, MOST_GROUPS = 50, 80
"""Largest numbers of regressions and improvements, and of means over groups of logs, that are
kept.
"""
OUTCOMES = {0: "pass", 1: "fail", 4: "inconclusive"}  # Outcomes of a comparison by exit code


def _log_cell(row: Any) -> Cell:
    """The log of a row, with its drive: of two planners, that of the second."""
    return Cell(row.log, drives=((row.log, row.planner.rpartition(" -> ")[2]),))


def _after_cell(row: Any) -> Cell:
    marginal = row.marginal and row.after == Outcome.FAIL.value
    return outcome_cell(row.after, " (marginal)" if marginal else "")


def _change_cell(row: Any) -> Cell:
    hurts = row.delta * {"lower": 1.0, "higher": -1.0}.get(row.direction, nan)
    interval = f" [{row.low:+.3g}, {row.high:+.3g}]" if isfinite(row.low) else ""
    star = " *" if row.significant else ""
    text = f"{row.delta:+.3g}{unit_suffix(row.unit)}{interval}{star}"
    return Cell(text, row.delta, bad=bool(row.significant) and hurts > 0.0)


RULES = (
    ReportColumn("outcome", lambda row: outcome_cell(row.outcome.value)),
    ReportColumn("rule", lambda row: Cell(row.rule, code=True)),
    text_column("what was found", "reason"),
)
PLANNER = text_column("planner")  # Only in tables of several planners
DRIVE_COLUMNS = (ReportColumn("log", _log_cell), PLANNER, text_column("loop", "mode"))
FLIPS = (
    *DRIVE_COLUMNS,
    ReportColumn("gate", lambda row: Cell(row.gate, code=True)),
    ReportColumn("before", lambda row: outcome_cell(row.before)),
    ReportColumn("after", _after_cell),
    number_column("value before", "value_before"),
    number_column("value after", "value_after"),
    seconds_column("time", "time_s"),
    text_column("about", "reason"),
)
PAIRS = (
    *DRIVE_COLUMNS,
    text_column("metric"),
    number_column("baseline"),
    ReportColumn(
        "candidate", lambda row: number_cell(row.candidate, unit=row.unit), is_number=True
    ),
    number_column("change", "delta"),
    seconds_column("time", "time_s"),
    text_column("about", "reason"),
)
MEANS = (
    ReportColumn(
        "logs of", lambda row: Cell("all" if row.kind == SUITE else f"{row.kind} {row.group}")
    ),
    PLANNER,
    text_column("loop", "mode"),
    text_column("metric"),
    number_column("logs"),
    number_column("before", "baseline"),
    number_column("after", "candidate"),
    ReportColumn("change [95 %]", _change_cell),
    number_column("better"),
    number_column("worse"),
)
PARTINGS = (
    *DRIVE_COLUMNS,
    seconds_column("time", "t_s"),
    text_column("first difference", "what"),
)


def comparison_sections(comparison: Comparison) -> list[ReportSection]:
    """The sections of a comparison, in their order; those with nothing to say are left out."""
    several = comparison.pairs["planner"].nunique() > 1

    def table(
        title: str, columns: Sequence[ReportColumn], rows: pd.DataFrame, most: int, *remarks: str
    ) -> ReportSection:
        shown = [column for column in columns if several or column is not PLANNER]
        items = list(rows.itertuples())
        return ReportSection(title, shown, items, remarks=remarks, most=most, rest="--json")

    order = list(Outcome)
    rules = sorted(comparison.verdicts, key=lambda verdict: order.index(verdict.outcome))
    same = ("the same: logs, configuration, vehicles, versions",)
    baseline, candidate = comparison.only_in_baseline, comparison.only_in_candidate
    means = _most_changed_means(comparison)
    note = "* more than chance over these logs (paired bootstrap, at least 6 logs)"
    partings, unseen = comparison.partings, comparison.not_looked_at
    not_searched = f"Not searched in {counted(unseen, 'more drive')} that differ."
    sections = [
        ReportSection("Rules", RULES, rules),
        ReportSection("Inputs", lines=comparison.differences or same, most=10, rest="--json"),
        ReportSection(f"Only in the baseline ({len(baseline)})", lines=baseline, most=10),
        ReportSection(f"Only in the candidate ({len(candidate)})", lines=candidate, most=10),
        table(_flips_title(comparison), FLIPS, _worst_flips(comparison), 20, *comparison.by_loop)
        if len(comparison.flips)
        else ReportSection("Flips", remarks=["No verdict changed."]),
        table("Worst regressions", PAIRS, comparison.regressions(MOST_PAIRS, each=3), 8),
        table("Greatest improvements", PAIRS, comparison.improvements(MOST_PAIRS), 8),
        table("Means over the logs", MEANS, means, 14, *([note] if len(means) else ())),
        table(
            "First differences of drives",
            PARTINGS,
            partings,
            12,
            *([not_searched] if unseen and len(partings) else ()),
        ),
    ]
    return with_contents(sections)


def _flips_title(comparison: Comparison) -> str:
    after = comparison.flips["after"].value_counts()
    fail, passed = after.get("fail", 0), after.get("pass", 0)
    others = len(comparison.flips) - fail - passed
    return f"Flips: {fail} to FAIL, {passed} to pass, {others} others"


def _worst_flips(comparison: Comparison) -> pd.DataFrame:
    """The verdicts that changed: new failures first, then gates that no longer fail.

    The closed loop first.
    """
    flips = comparison.flips
    rank = pd.DataFrame(
        {
            "fails": flips["after"] != "fail",
            "failed": flips["before"] != "fail",
            "open": flips["mode"] == "open",
        }
    )
    return flips.loc[rank.sort_values(["fails", "failed", "open"], kind="stable").index]


def _most_changed_means(comparison: Comparison) -> pd.DataFrame:
    """Metrics with a gate or a significant change over the suite, and those with both over groups
    of logs.

    For each metric, only the reduction that changed most is shown.
    """
    groups = comparison.groups[comparison.groups["delta"] != 0.0]
    pairs = comparison.pairs
    gated = groups["metric"].isin(pairs.loc[pairs["asked"].astype(bool), "metric"])
    suite, sure = groups["kind"] == SUITE, groups["significant"].astype(bool)
    size = groups["delta"].abs() / groups[["baseline", "candidate"]].abs().max(axis=1)
    rank = pd.DataFrame({"part": ~suite, "unsure": ~sure, "other": ~gated, "size": -size})
    rank = rank[suite & (gated | sure) | ~suite & gated & sure]
    shown = groups.loc[rank.sort_values(["part", "unsure", "other", "size"], kind="stable").index]
    series = shown["metric"].str.split(".").str[0]
    names = shown.assign(metric=series)[["kind", "group", "planner", "mode", "metric"]]
    return shown[~names.duplicated()].head(MOST_GROUPS)


def first_regression(comparison: Comparison) -> tuple[str, str, str] | None:
    """Log, planner and loop of the worst regression; None if nothing got worse."""
    worst = comparison.regressions(1)
    return tuple(worst.iloc[0][DRIVE]) if len(worst) else None


def last_line(comparison: Comparison, *, alone: bool = True) -> str:
    """The outcome in one line, with the exit code if it is that of the command."""
    code = f" (exit code {comparison.exit_code})" if alone else ""
    return f"Comparison: {OUTCOMES[comparison.exit_code].upper()}{code}"


def document(comparison: Comparison) -> dict[str, Any]:
    """The whole comparison for JSON, with only those pairs that differ."""
    changed = comparison.pairs[comparison.pairs["delta"] != 0.0]
    content = {field.name: getattr(comparison, field.name) for field in fields(comparison)}
    head = {"outcome": OUTCOMES[comparison.exit_code], "exit_code": comparison.exit_code}
    return {**head, **content, "pairs": changed, "by_loop": comparison.by_loop}
