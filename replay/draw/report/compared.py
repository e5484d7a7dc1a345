"""A comparison for a terminal: differing inputs, flips, what got worse and better, first differences of drives.

ASCII only, as `replay.draw.report.terminal`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, replace
from math import isfinite
from typing import Any

import pandas as pd
from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.text import Text

from logs.names import counted
from metrics.compare import DRIVE, Comparison
from metrics.judge.gates import Outcome
from replay.draw.report.console import grid, titled
from replay.draw.report.model import worst_flips

MOST_FLIPS, MOST_PAIRS, MOST_GROUPS, MOST_LINES = 20, 8, 14, 10
"""Further rows are only counted; --json has all."""
OUTCOMES = {0: "pass", 1: "fail", 4: "inconclusive"}
STYLES = {"pass": "green", "fail": "bold red", "inconclusive": "yellow"}

Watch = Callable[[str, str, str], str]
"""Log, planner and mode to the command that shows the drive; "" if it is not available."""


def print_comparison(
    comparison: Comparison, console: Console, watch: Watch = lambda log, planner, mode: "", *, alone: bool = True
) -> None:
    """The whole comparison; with the exit code if it is that of the command (`alone`)."""
    console.print(Group(*_parts(comparison, watch, alone=alone)))


def _parts(comparison: Comparison, watch: Watch, *, alone: bool) -> Iterator[RenderableType]:
    worst = comparison.regressions(1)
    command = watch(*worst.iloc[0][DRIVE]) if len(worst) else ""
    comparison = _with_planners(comparison)
    yield Text(f"{comparison.baseline} -> {comparison.candidate}", style="bold")
    yield Text()
    lines = comparison.differences or ("the same: logs, configuration, vehicles, versions",)
    yield from _titled("Inputs", *_listed(lines))
    for drives, word in ((comparison.only_in_baseline, "baseline"), (comparison.only_in_candidate, "candidate")):
        if drives:
            yield from _titled(f"Only in the {word} ({len(drives)})", *_listed(drives))
    yield from _flips(comparison)
    yield from _extremes("Worst regressions", comparison.regressions(MOST_PAIRS), command)
    yield from _extremes("Greatest improvements", comparison.improvements(MOST_PAIRS), "")
    yield from _groups(comparison)
    if len(comparison.partings):
        table = grid("log", "loop", "first difference")
        for row in _rows(comparison.partings):
            table.add_row(Text(row.log), row.mode, Text(row.what))
        unseen = comparison.not_looked_at
        aside = [Text(f"not searched in {counted(unseen, 'more drive')} that differ", style="dim")] if unseen else []
        yield from _titled("First differences of drives", table, *aside)
    if comparison.verdicts:
        table = grid("outcome", "rule", "what was found")
        for verdict in sorted(comparison.verdicts, key=lambda verdict: list(Outcome).index(verdict.outcome)):
            word = verdict.outcome.value
            table.add_row(Text(word.upper(), style=STYLES[word]), Text(verdict.rule), Text(verdict.reason))
        yield from _titled("Rules", table)
    pairs = comparison.pairs
    count = len(pairs[["log", "planner", "mode"]].drop_duplicates())
    worse, better = int((pairs["worse"] > 0.0).sum()), int((pairs["worse"] < 0.0).sum())
    values = f"{counted(len(pairs), 'value')}: {int((pairs['delta'] == 0.0).sum())} the same"
    yield Text(f"{counted(count, 'drive')}, {values}, {worse} worse, {better} better")
    yield Text(last_line(comparison, alone=alone), style=STYLES[OUTCOMES[comparison.exit_code]])


def _rows(table: pd.DataFrame) -> Iterator[Any]:
    return iter(table.itertuples())


def _with_planners(comparison: Comparison) -> Comparison:
    """If there are several planners, each log and group is followed by its planner."""
    if comparison.pairs["planner"].nunique() < 2:
        return comparison
    pairs, flips, groups, partings = (
        table.assign(**{name: table[name] + " [" + table["planner"] + "]"} if len(table) else {})
        for table, name in (
            (comparison.pairs, "log"), (comparison.flips, "log"), (comparison.groups, "group"),
            (comparison.partings, "log"),
        )
    )  # fmt: skip
    return replace(comparison, pairs=pairs, flips=flips, groups=groups, partings=partings)


def _titled(title: str, *parts: RenderableType) -> Iterator[RenderableType]:
    return titled(title, *(Padding(part, (0, 0, 0, 2)) if isinstance(part, Text) else part for part in parts))


def _listed(lines: Sequence[str]) -> list[Text]:
    more = [f"{len(lines) - MOST_LINES} more"] if len(lines) > MOST_LINES else []
    return [Text(line) for line in (*lines[:MOST_LINES], *more)]


def _flips(comparison: Comparison) -> Iterator[RenderableType]:
    flips = comparison.flips
    if flips.empty:
        yield from _titled("Flips", Text("none: no verdict changed"))
        return
    table = grid("log", "loop", "gate", "before", "after", "value", "at")
    for row in _rows(worst_flips(comparison).head(MOST_FLIPS)):
        marginal = " (marginal)" if row.marginal and row.after == "fail" else ""
        after = Text(f"{row.after}{marginal}", style=STYLES.get(str(row.after), ""))
        values = f"{_number(row.value_before)} -> {_number(row.value_after)}"
        table.add_row(Text(row.log), row.mode, Text(row.gate), row.before, after, values, _time(row.time_s))
    count = {word: int((flips["after"] == word).sum()) for word in ("fail", "pass")}
    title = f"Flips: {count['fail']} to FAIL, {count['pass']} to pass, {len(flips) - sum(count.values())} others"
    yield from _titled(title, table, *_more(len(flips), MOST_FLIPS), *map(Text, comparison.by_loop))


def _extremes(title: str, pairs: pd.DataFrame, command: str) -> Iterator[RenderableType]:
    if pairs.empty:
        return
    table = grid("log", "loop", "metric", "before -> after", "at", "about")
    for row in _rows(pairs):
        values = f"{_number(row.baseline)} -> {_number(row.candidate)}{_unit(row.unit)}"
        table.add_row(Text(row.log), row.mode, Text(row.metric), values, _time(row.time_s), Text(row.reason))
    yield from _titled(title, table, *([Text.assemble("Look at the first:  ", (command, "bold"))] if command else []))


def _groups(comparison: Comparison) -> Iterator[RenderableType]:
    """Metrics with a gate or a significant change over the suite, and those with both over groups of logs.

    Of the reductions of one metric, the one that changed most is shown.
    """
    groups = comparison.groups[comparison.groups["delta"] != 0.0]
    asked = set(comparison.pairs.loc[comparison.pairs["asked"], "metric"])
    gated, suite = groups["metric"].isin(asked), groups["kind"] == "suite"
    size = groups["delta"].abs() / groups[["baseline", "candidate"]].abs().max(axis=1)
    rank = pd.DataFrame({"part": ~suite, "unsure": ~groups["significant"], "other": ~gated, "size": -size})
    shown = groups[suite & (gated | groups["significant"]) | ~suite & gated & groups["significant"]]
    if shown.empty:
        return
    shown = shown.loc[rank.loc[shown.index].sort_values(["part", "unsure", "other", "size"], kind="stable").index]
    words = shown["metric"].map(lambda name: name.partition(".")[0])
    shown = shown[~shown.assign(metric=words)[["kind", "group", "planner", "mode", "metric"]].duplicated()]
    titles = ("logs of", "loop", "metric", "logs", "before", "after", "change [95 %]", "better", "worse")
    table = grid(*titles, right=("logs", "before", "after", "better", "worse"))
    for row in _rows(shown.head(MOST_GROUPS)):
        inside = f" [{row.low:+.3g}, {row.high:+.3g}]" if isfinite(row.low) else ""
        hurts = row.delta * {"lower": 1.0, "higher": -1.0}.get(row.direction, 0.0)
        style = "" if not row.significant else "green" if hurts < 0.0 else "red" if hurts > 0.0 else "bold"
        change = Text(f"{row.delta:+.3g}{_unit(row.unit)}{inside}{' *' if row.significant else ''}", style=style)
        values = _number(row.baseline), _number(row.candidate)
        table.add_row(row.group, row.mode, row.metric, str(row.logs), *values, change, str(row.better), str(row.worse))
    note = Text("* more than chance over these logs (paired bootstrap, at least 6 logs)", style="dim")
    yield from _titled("Means over the logs", table, *_more(len(shown), MOST_GROUPS), note)


def last_line(comparison: Comparison, *, alone: bool = True) -> str:
    """The outcome in one line, with the exit code if it is that of the command."""
    code = f" (exit code {comparison.exit_code})" if alone else ""
    return f"Comparison: {OUTCOMES[comparison.exit_code].upper()}{code}"


def _more(count: int, most: int) -> list[Text]:
    return [Text(f"{count - most} more: --json", style="dim")] if count > most else []


def _number(value: float) -> str:
    return f"{value:.4g}" if isfinite(value) else "-"


def _time(value: float) -> str:
    return f"{value:.2f} s" if isfinite(value) else "-"


def _unit(unit: str) -> str:
    return "" if unit in ("1", "count") else f" {unit}"


def document(comparison: Comparison) -> dict[str, Any]:
    """The whole comparison for JSON; of the pairs only those that differ."""
    changed = comparison.pairs[comparison.pairs["delta"] != 0.0]
    content = {item.name: getattr(comparison, item.name) for item in fields(comparison)}
    head = {"outcome": OUTCOMES[comparison.exit_code], "exit_code": comparison.exit_code}
    return {**head, **content, "pairs": changed, "by_loop": comparison.by_loop}
