"""What changed against a baseline, as sections; the outcome of a comparison in a line, and as
JSON.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from math import isfinite, nan
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
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
from replan.metrics.comparison import Comparison, RuleVerdict
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


def _change_words(row: Any, before: float, after: float, unit: str) -> str:
    """Two values of a drive, their time, and what they are about."""
    time = f" at {row.time_s:.2f} s" if isfinite(row.time_s) else ""
    about = f" ({row.reason})" if row.reason else ""
    return f"{number_cell(before).text} -> {number_cell(after, unit=unit).text}{time}{about}"


def _flip_line(row: Any) -> str:
    values = _change_words(row, row.value_before, row.value_after, "")
    return f"{row.gate}: {row.before} -> {row.after}: {values}"


def _pair_line(row: Any) -> str:
    return f"{row.metric} {_change_words(row, row.baseline, row.candidate, row.unit)}"


def _mean_line(row: Any) -> str:
    group = "all logs" if row.kind == SUITE else f"{row.kind} {row.group}"
    means = f"{number_cell(row.baseline).text} -> {number_cell(row.candidate).text}"
    counts = f"better in {row.better}, worse in {row.worse} of {row.logs}"
    return f"{row.metric}, {group}, {row.mode} loop: {means}: {_change_cell(row).text}; {counts}"


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


class CommonFact(NamedTuple):
    """What the first differences of drives have in common."""

    fact: str
    finding: str


COMMON = (text_column("of the first difference", "fact"), text_column("in the drives", "finding"))
PARTINGS = (
    *DRIVE_COLUMNS,
    seconds_column("time", "t_s"),
    text_column("first difference", "what"),
)


def comparison_sections(comparison: Comparison) -> list[ReportSection]:
    """The sections of a comparison, in their order; those with nothing to say are left out."""
    several = comparison.pairs["planner"].nunique() > 1

    def table(
        title: str,
        columns: Sequence[ReportColumn],
        rows: pd.DataFrame,
        most: int,
        words: Callable[[Any], str],
        *remarks: str,
    ) -> ReportSection:
        shown = [column for column in columns if several or column is not PLANNER]

        def line(row: Any) -> str:
            planner = f", {row.planner}" if several else ""
            return f"{row.log}{planner}, {row.mode} loop: {words(row)}"

        as_line = words if columns is MEANS else line
        items = list(rows.itertuples())
        return ReportSection(
            title, shown, items, remarks=remarks, most=most, rest="--json", as_line=as_line
        )

    order = list(Outcome)
    rules = sorted(comparison.verdicts, key=lambda verdict: order.index(verdict.outcome))
    broken = [verdict for verdict in rules if verdict.outcome is not Outcome.PASS]
    hold = [f"{len(rules) - len(broken)} of {counted(len(rules), 'rule')} hold."] if rules else []
    baseline, candidate = comparison.only_in_baseline, comparison.only_in_candidate
    means, partings = _most_changed_means(comparison), comparison.partings
    flips = _worst_flips(comparison)
    by_loop = comparison.by_loop if len(flips) else ()
    regressions = comparison.regressions(MOST_PAIRS, each=3)
    improvements = comparison.improvements(MOST_PAIRS)
    notes = _chance_notes(comparison) if len(means) else ()
    sections = [
        ReportSection("What changed", lines=_what_changed(comparison), most=8, rest="--json"),
        ReportSection(f"Only in the baseline ({len(baseline)})", lines=baseline, most=3),
        ReportSection(f"Only in the candidate ({len(candidate)})", lines=candidate, most=3),
        table(_flips_title(comparison), FLIPS, flips, 6, _flip_line, *by_loop),
        ReportSection("What the first differences have in common", COMMON, _in_common(partings)),
        table("First differences of drives", PARTINGS, partings, 4, attrgetter("what")),
        table("Worst regressions", PAIRS, regressions, 5, _pair_line),
        table("Greatest improvements", PAIRS, improvements, 2, _pair_line),
        table("Means over the logs", MEANS, means, 3, _mean_line, *notes),
        ReportSection(
            "Rules", RULES, broken, remarks=hold, most=3, rest="--json", as_line=_rule_line
        ),
    ]
    return with_contents(sections)


def _rule_line(verdict: RuleVerdict) -> str:
    return f"{verdict.outcome.value.upper()}: {verdict.rule}: {verdict.reason}"


def _what_changed(comparison: Comparison) -> list[str]:
    """Numbers of drives that are equal and that differ, of values, and the inputs that differ."""
    pairs, searched = comparison.pairs, len(comparison.partings)
    drives, equal = len(pairs[DRIVE].drop_duplicates()), comparison.equal_drives
    worse, better = int((pairs["worse"] > 0.0).sum()), int((pairs["worse"] < 0.0).sum())
    same = int((pairs["delta"] == 0.0).sum())
    values = f"{counted(len(pairs), 'value')}: {same} the same, {worse} worse, {better} better"
    lines = [f"{counted(drives, 'drive')} in both runs, {values}"] if drives else []
    if equal or searched:
        unseen = comparison.not_looked_at
        small = drives - equal - searched - unseen
        parts = [f"{equal} of {counted(drives, 'drive')} are equal in bits, {searched} differ"]
        parts += [f"{small} differ by less than a millimetre"] if small > 0 else []
        parts += [f"{unseen} more differ, not searched"] if unseen else []
        lines.append("; ".join(parts))
    if drives and comparison.flips.empty:
        lines.append("no gate changed its verdict")
    same_inputs = ("logs, configuration, vehicles and versions are the same",)
    lines += comparison.differences or same_inputs
    if comparison.unpaired:
        lines.append(f"no pair: planners of other names; to pair them: {comparison.unpaired}")
    return lines


def _in_common(partings: pd.DataFrame) -> list[CommonFact]:
    """The facts of first differences, each with its number of drives, the commonest first."""
    facts = []
    about = partings["kind"].where(partings["kind"] != "", partings["agent"])
    side = pd.Series(np.where(partings["left_m"] < 0.0, "right", "left"), partings.index)
    columns = {
        "stage": partings["stage"],
        "about": about.where(about != "", "no agent"),
        "side of the ego": side[partings["left_m"].notna()],
        "lights": partings["lights"].where(partings["lights"] != "", "none"),
    }
    for fact, values in columns.items():
        counts = [f"{value} in {count}" for value, count in values.value_counts().items()]
        if len(values):
            facts.append(CommonFact(fact, f"{', '.join(counts)}"))
    for fact, numbers, unit in (
        ("distance to the side", partings["left_m"].abs(), "m"),
        ("distance ahead", partings["ahead_m"], "m"),
        ("time", partings["t_s"], "s"),
    ):
        if numbers.notna().any():
            low, middle, high = (numbers.quantile(share) for share in (0.0, 0.5, 1.0))
            span = f"{low:.1f} to {high:.1f} {unit}, median {middle:.1f}"
            facts.append(CommonFact(fact, span if high > low else f"{low:.1f} {unit}"))
    return facts


def _chance_notes(comparison: Comparison) -> tuple[str, ...]:
    """What the marks of means are worth, since many are tested."""
    groups = comparison.groups
    tested = groups[(groups["kind"] == SUITE) & groups["low"].notna()]
    if tested.empty:
        return ("No mean has an interval: that needs 3 logs.",)
    marked = int(tested["significant"].astype(bool).sum())
    logs = counted(int(tested["logs"].max()), "log")
    means = f"{marked} of {counted(len(tested), 'mean')} over {logs}"
    return (
        "* more than chance over these logs (paired bootstrap, at least 6 logs)",
        f"{means} or fewer have a *; by chance alone, about {0.05 * len(tested):.0f} would.",
    )


def _flips_title(comparison: Comparison) -> str:
    after = comparison.flips["after"].value_counts()
    fail, passed = after.get("fail", 0), after.get("pass", 0)
    others = len(comparison.flips) - fail - passed
    return f"Flips: {fail} to FAIL, {passed} to pass, {others} others"


def _worst_flips(comparison: Comparison) -> pd.DataFrame:
    """The verdicts that changed: new failures first, then gates that no longer fail.

    Of each gate, one drive comes first; the closed loop first.
    """
    flips = comparison.flips
    rank = pd.DataFrame(
        {
            "fails": flips["after"] != "fail",
            "failed": flips["before"] != "fail",
            "repeat": flips.groupby(["gate", "after"]).cumcount(),
            "open": flips["mode"] == "open",
        }
    )
    return flips.loc[rank.sort_values(list(rank.columns), kind="stable").index]


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


def verdict_sentence(comparison: Comparison) -> str:
    """The outcome of a comparison, and why, in a sentence."""
    outcome = OUTCOMES[comparison.exit_code].upper()
    verdicts = comparison.verdicts
    if comparison.pairs.empty:
        hint = f"; to pair planners: {comparison.unpaired}" if comparison.unpaired else ""
        return f"{outcome}: no drive is in both runs{hint}"
    lacking = [verdict for verdict in verdicts if verdict.outcome.value.upper() == outcome]
    if comparison.exit_code == 0:
        return f"{outcome}: all {counted(len(lacking), 'rule')} hold"
    verb = "broken" if comparison.exit_code == 1 else "inconclusive"
    rules = f"{len(lacking)} of {counted(len(verdicts), 'rule')} {verb}"
    return f"{outcome}: {rules}: {lacking[0].rule}: {lacking[0].reason}"


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
