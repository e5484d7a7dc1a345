"""Reports for a terminal: of a run (drives, gates, latency, assumptions, how to look closer), and of a comparison.

ASCII only (no symbols that a terminal may lack); they fit 80 columns, and use more if there are more. The contents of
a run's report are those of `replay.draw.report.overview`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, replace
from math import isfinite
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.text import Text

from logs.names import counted
from metrics.comparison import Comparison
from metrics.judge.gates import Outcome
from metrics.judge.verdicts import DRIVE
from replay.draw.report.console import grid, titled
from replay.draw.report.contents import BROKEN, NOTHING, Overview, legend, worst_flips

MAX_ROWS = 30
"""Largest number of listed drives; drives with most marked values come first."""

MAX_NOTES = 12
MAX_GROUPS = 12
SAYS = {"pass": "pass", "fail": "FAIL", "inconclusive": "inconcl."}
OUTCOMES = {0: "pass", 1: "fail", 4: "inconclusive"}
"""Outcomes of a comparison by exit code."""
STYLES = {Outcome.PASS.value: "green", Outcome.FAIL.value: "bold red", Outcome.INCONCLUSIVE.value: "yellow"}


def print_report(over: Overview, console: Console, folder: Path, *, ending: bool = True) -> None:
    """Print the report on the results in a folder; `ending=False` leaves its last lines to `print_ending`."""
    parts: list[RenderableType] = []
    if over.drives:
        parts += _drives(over)
        if len(over.planners) > 1:  # a column per planner: each metric over the logs
            table = grid()
            table.add_column("over all logs")
            for planner in over.planners:
                table.add_column(planner, justify="right", overflow="fold")
            for label, texts in over.compared:
                table.add_row(Text(label), *texts)
            parts += titled("Planners", table)
        table = grid("planner", "stage")
        for title in ("p50 [ms]", "p95 [ms]", "p99 [ms]", "share"):
            table.add_column(Text(title), justify="right")
        for stage in over.latency:
            last = stage.stage == "total"
            times = (f"{value:.2f}" for value in (stage.p50_ms, stage.p95_ms, stage.p99_ms))
            part = f"{100.0 * stage.share:.0f}%" if isfinite(stage.share) else NOTHING
            style = "bold" if last else ""
            table.add_row(stage.planner, stage.stage, *times, part, style=style, end_section=last)
        parts += titled(f"Planning time (wall clock, {counted(over.frames, 'plan')})", table)
    judged: RenderableType = Text(f"not judged: shard {over.shard}; see replan merge")
    if not over.shard:
        judged = table = grid()
        for title in ("outcome", "rule", "what was found"):
            table.add_column(title, overflow="fold", no_wrap=title == "outcome")
        for row in over.gates:
            loop = f" [{row.mode}]" if row.mode and f"[{row.mode}]" not in row.rule else ""
            table.add_row(Text(row.outcome.upper(), style=STYLES[row.outcome]), Text(row.rule + loop), Text(row.found))
    parts += titled("Gates", judged, *(Text(line, style="dim") for line in over.driven))
    parts += _list("Gates that were not asked", over.not_asked, MAX_NOTES, "report.html")
    parts += _shares(over)
    if over.ensembles:
        title = f"Ensemble: {len(over.fragile)} of {over.ensembles} verdicts are fragile"
        parts += titled(title, *_indented_lines(over.fragile, MAX_ROWS, "metrics.csv"))
    parts += _list(BROKEN, over.broken, MAX_NOTES, "report.html")
    parts += _list("Notes", over.notes, MAX_NOTES, "summary.json")
    parts += _list(f"Could not be evaluated ({len(over.failures)})", over.failures, MAX_ROWS, "summary.json")
    console.print(Group(*parts))
    if ending:
        print_ending(over, console, folder)


def print_ending(over: Overview, console: Console, folder: Path, place: str = "") -> None:
    """Print the place of the results (`place`, or the folder), and as the last line the outcome."""
    place = place or str(folder)
    there = [name for name in ("report.html", "metrics.csv", "summary.json") if (folder / name).is_file()]
    lines = [Text(f"{each.planner}: {each.text}") for each in over.answers]
    lines.append(Text(f"Results: {place}  ({', '.join((*there, 'a folder per log'))})"))
    if over.worst is not None and over.worst.recording:
        lines.append(Text.assemble("Look at a drive:  ", (f"replan view {place}/{over.worst.recording}", "bold")))
    words = f"Outcome: {over.outcome.upper()} (exit code {over.exit_code})"
    lines.append(Text(words, style="bold green" if over.exit_code == 0 else "bold red"))
    console.print(Group(*lines))


def _list(title: str, lines: Sequence[str], most: int, rest: str = "") -> Iterator[RenderableType]:
    """A titled list; nothing if it has no lines."""
    return titled(title, *_indented_lines(lines, most, rest)) if lines else iter(())


def _indented_lines(lines: Sequence[str], most: int, rest: str = "") -> Iterator[RenderableType]:
    """The lines, indented; the number of further lines, and the file that has them."""
    more = [f"{len(lines) - most} more{f': {rest}' if rest else ''}"] if len(lines) > most else []
    return (Padding(Text(line), (0, 0, 0, 2)) for line in (*lines[:most], *more))


def _drives(over: Overview) -> Iterator[RenderableType]:
    """One row per log and planner, and the meaning of the columns."""
    rows = over.drives
    shown = rows if len(rows) <= MAX_ROWS else over.ranked[:MAX_ROWS]
    several = len(over.planners) > 1
    table = grid(padding=0)
    table.add_column("log", overflow="fold")
    table.add_column("verdict", no_wrap=True)
    first = over.first_closed
    for i, column in enumerate(over.columns):
        if i == first:
            table.add_column("closed loop\nended by", overflow="fold", max_width=13)
        table.add_column(Text(column.title), justify="right", no_wrap=True)
    before = ""
    for row in shown:
        if several and row.log != before:
            table.add_row(Text(row.log))
        name = Text(f"  {row.shown}" if several else row.log)
        verdict = f"{SAYS[row.verdict]} {row.asked}" if row.verdict else NOTHING
        word = Text(verdict, style=STYLES.get(row.verdict, ""))
        end = (row.end,) if first < len(row.cells) else ()
        cells = (*row.cells[:first], *end, *row.cells[first:])
        table.add_row(name, word, *(Text(cell.text, "red" if cell.bad else "") for cell in cells))
        before = row.log
    left = len(rows) - len(shown)
    omitted = [f"{counted(left, 'more drive')} without more trouble than these: metrics.csv"] if left else []
    yield from titled("Drives", table, Text("\n".join([*legend(over.columns), *omitted]), style="dim"))


def _shares(over: Overview) -> Iterator[RenderableType]:
    if not over.whole:
        return
    table = grid("logs", "planner")
    for title in ("pass", "95%", "fail", "inconcl.", "lost"):
        table.add_column(Text(title), justify="right", no_wrap=True)
    for share in (*over.whole, *over.grouped[:MAX_GROUPS]):
        interval = f"{100.0 * share.low:.0f} to {100.0 * share.high:.0f}%"
        counts = (share.failed, share.inconclusive, share.missing)
        passed = f"{share.passed} of {share.logs}"
        table.add_row(Text(share.name), share.planner, passed, interval, *(str(count or NOTHING) for count in counts))
    left = len(over.grouped) - MAX_GROUPS
    more = Text(f"{counted(left, 'more group')} passing no less often: groups.parquet", style="dim")
    yield from titled("Logs that pass", table, *([more] if left > 0 else []))


MOST_FLIPS, MOST_PAIRS, MOST_GROUPS, MOST_LINES = 20, 8, 14, 10
"""Largest numbers of rows; --json has all rows."""
Watch = Callable[[str, str, str], str]
"""Maps log, planner and mode to the command that shows the drive; "" if it is not available."""


def print_comparison(
    comparison: Comparison, console: Console, watch: Watch = lambda log, planner, mode: "", *, alone: bool = True
) -> None:
    """Print the comparison; `alone`: with the exit code, which is then that of the command."""
    parts: list[RenderableType] = []
    worst = comparison.regressions(1)
    command = watch(*worst.iloc[0][DRIVE]) if len(worst) else ""
    if comparison.pairs["planner"].nunique() > 1:  # each log and group is followed by its planner
        pairs, flips, groups, partings = (
            table.assign(**{name: table[name] + " [" + table["planner"] + "]"} if len(table) else {})
            for table, name in (
                (comparison.pairs, "log"), (comparison.flips, "log"), (comparison.groups, "group"),
                (comparison.partings, "log"),
            )
        )  # fmt: skip
        comparison = replace(comparison, pairs=pairs, flips=flips, groups=groups, partings=partings)
    parts += [Text(f"{comparison.baseline} -> {comparison.candidate}", style="bold"), Text()]
    same = ("the same: logs, configuration, vehicles, versions",)
    parts += _list("Inputs", comparison.differences or same, MOST_LINES)
    for drives, word in ((comparison.only_in_baseline, "baseline"), (comparison.only_in_candidate, "candidate")):
        parts += _list(f"Only in the {word} ({len(drives)})", drives, MOST_LINES)
    parts += _flips(comparison)
    parts += _extremes("Worst regressions", comparison.regressions(MOST_PAIRS), command)
    parts += _extremes("Greatest improvements", comparison.improvements(MOST_PAIRS), "")
    parts += _groups(comparison)
    if len(comparison.partings):
        table = grid("log", "loop", "first difference")
        for row in _rows(comparison.partings):
            table.add_row(Text(row.log), row.mode, Text(row.what))
        unseen = comparison.not_looked_at
        aside = [Text(f"not searched in {counted(unseen, 'more drive')} that differ", style="dim")] if unseen else []
        parts += _title_lines("First differences of drives", table, *aside)
    if comparison.verdicts:
        table = grid("outcome", "rule", "what was found")
        for verdict in sorted(comparison.verdicts, key=lambda verdict: list(Outcome).index(verdict.outcome)):
            word = verdict.outcome.value
            table.add_row(Text(word.upper(), style=STYLES[word]), Text(verdict.rule), Text(verdict.reason))
        parts += _title_lines("Rules", table)
    pairs = comparison.pairs
    count = len(pairs[["log", "planner", "mode"]].drop_duplicates())
    worse, better = int((pairs["worse"] > 0.0).sum()), int((pairs["worse"] < 0.0).sum())
    values = f"{counted(len(pairs), 'value')}: {int((pairs['delta'] == 0.0).sum())} the same"
    parts.append(Text(f"{counted(count, 'drive')}, {values}, {worse} worse, {better} better"))
    parts.append(Text(last_line(comparison, alone=alone), style=STYLES[OUTCOMES[comparison.exit_code]]))
    console.print(Group(*parts))


def _rows(table: pd.DataFrame) -> Iterator[Any]:
    return iter(table.itertuples())


def _title_lines(title: str, *parts: RenderableType) -> Iterator[RenderableType]:
    return titled(title, *(Padding(part, (0, 0, 0, 2)) if isinstance(part, Text) else part for part in parts))


def _flips(comparison: Comparison) -> Iterator[RenderableType]:
    flips = comparison.flips
    if flips.empty:
        yield from _title_lines("Flips", Text("none: no verdict changed"))
        return
    table = grid("log", "loop", "gate", "before", "after", "value", "at")
    for row in _rows(worst_flips(comparison).head(MOST_FLIPS)):
        marginal = " (marginal)" if row.marginal and row.after == "fail" else ""
        after = Text(f"{row.after}{marginal}", style=STYLES.get(str(row.after), ""))
        values = f"{_number(row.value_before)} -> {_number(row.value_after)}"
        table.add_row(Text(row.log), row.mode, Text(row.gate), row.before, after, values, _time(row.time_s))
    count = {word: int((flips["after"] == word).sum()) for word in ("fail", "pass")}
    title = f"Flips: {count['fail']} to FAIL, {count['pass']} to pass, {len(flips) - sum(count.values())} others"
    yield from _title_lines(title, table, *_further_lines(len(flips), MOST_FLIPS), *map(Text, comparison.by_loop))


def _extremes(title: str, pairs: pd.DataFrame, command: str) -> Iterator[RenderableType]:
    if pairs.empty:
        return
    table = grid("log", "loop", "metric", "before -> after", "at", "about")
    for row in _rows(pairs):
        values = f"{_number(row.baseline)} -> {_number(row.candidate)}{_unit(row.unit)}"
        table.add_row(Text(row.log), row.mode, Text(row.metric), values, _time(row.time_s), Text(row.reason))
    yield from _title_lines(
        title, table, *([Text.assemble("Look at the first:  ", (command, "bold"))] if command else [])
    )


def _groups(comparison: Comparison) -> Iterator[RenderableType]:
    """Metrics with a gate or a significant change over the suite, and those with both over groups of logs.

    For each metric, only the reduction that changed most is shown.
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
    yield from _title_lines("Means over the logs", table, *_further_lines(len(shown), MOST_GROUPS), note)


def last_line(comparison: Comparison, *, alone: bool = True) -> str:
    """The outcome in one line, with the exit code if it is that of the command."""
    code = f" (exit code {comparison.exit_code})" if alone else ""
    return f"Comparison: {OUTCOMES[comparison.exit_code].upper()}{code}"


def _further_lines(count: int, most: int) -> list[Text]:
    return [Text(f"{count - most} more: --json", style="dim")] if count > most else []


def _number(value: float) -> str:
    return f"{value:.4g}" if isfinite(value) else "-"


def _time(value: float) -> str:
    return f"{value:.2f} s" if isfinite(value) else "-"


def _unit(unit: str) -> str:
    return "" if unit in ("1", "count") else f" {unit}"


def document(comparison: Comparison) -> dict[str, Any]:
    """The whole comparison for JSON, with only those pairs that differ."""
    changed = comparison.pairs[comparison.pairs["delta"] != 0.0]
    content = {item.name: getattr(comparison, item.name) for item in fields(comparison)}
    head = {"outcome": OUTCOMES[comparison.exit_code], "exit_code": comparison.exit_code}
    return {**head, **content, "pairs": changed, "by_loop": comparison.by_loop}
