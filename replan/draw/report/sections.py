"""A report as a list of sections. Terminal, Markdown and HTML render every section in the same way.

    run_sections(overview)            what a run found, the answer first
    comparison_sections(comparison)   what changed against a baseline

A new part of the reports is one function here.

Reports for a terminal are ASCII only (no symbols that a terminal may lack); they fit 80 columns,
and use more if there are more. The sections come in reverse, so that the answer stands last, where
it is seen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from math import isfinite, nan
from pathlib import Path
from typing import Any

import pandas as pd
from rich import box
from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from replan.core.names import counted
from replan.draw.report.contents import (
    BROKEN,
    NOTHING,
    Cell,
    GateRow,
    Overview,
    PassShare,
    legend,
    worst_flips,
)
from replan.metrics.comparison import Comparison
from replan.metrics.judge.gates import Outcome
from replan.metrics.judge.verdicts import DRIVE

MOST_ROWS = 30  # Largest number of drives in a terminal
MOST_PAIRS, MOST_GROUPS = 50, 80
"""Largest numbers of regressions and improvements, and of means over groups of logs, that are
kept.
"""


@dataclass(frozen=True)
class ReportColumn:
    """A column of a section."""

    title: str
    # Whether its cells are numbers: aligned to the right, and sorted by their value
    is_number: bool = False
    short: str = ""  # The title in short lines, where there is little room; "": `title`
    about: str = ""  # More about it, where a pointer can rest on the title


@dataclass(frozen=True)
class ReportSection:
    """A part of a report."""

    title: str
    columns: tuple[ReportColumn, ...] = ()  # The columns of its table; none: it has no table
    rows: tuple[tuple[Cell, ...], ...] = ()  # Rows of cells, the ones to look at first
    lines: tuple[str, ...] = ()
    says: tuple[str, ...] = ()
    # Whether it is only for those who look for it: folded where a report can fold
    folded: bool = False
    most: int = 30  # Largest number of rows and of lines that a terminal shows
    rest: str = ""  # The file that has all rows
    key: str = ""  # A name for links, and for what an output adds to the section


def _columns(*titles: str, numbers: Iterable[str] = ()) -> tuple[ReportColumn, ...]:
    return tuple(ReportColumn(title, title in numbers) for title in titles)


def _words(*texts: str) -> tuple[Cell, ...]:
    return tuple(map(Cell, texts))


def number_cell(
    value: float, show: Callable[[float], str] = "{:.4g}".format, unit: str = ""
) -> Cell:
    """A number with its unit; `NOTHING` where it is missing."""
    known = f" {unit}" if unit not in ("", "1", "count") else ""
    return Cell(f"{show(value)}{known}", value) if isfinite(value) else Cell()


def _seconds(value: float) -> Cell:
    return number_cell(value, "{:.2f}".format, "s")


def _outcome(word: str, more: str = "") -> Cell:
    return Cell(f"{word}{more}" if word else NOTHING, outcome=word)


# a run --------------------------------------------------------------------------------------------


def run_sections(over: Overview) -> list[ReportSection]:
    """The sections of a run, in their order; those with nothing to say are left out."""
    ensemble = f"Ensemble: {len(over.fragile)} of {over.ensembles} verdicts are fragile"
    made = [
        ReportSection(
            f"Could not be evaluated ({len(over.failures)})",
            lines=over.failures,
            rest="summary.json",
        ),
        *_gates(over),
        *_diagnosis(over),
        *_shares(over),
        *_drives(over),
        *_planners(over),
        ReportSection("Driven", lines=over.driven, key="driven"),
        ReportSection(
            ensemble, lines=over.fragile or ("none",) if over.ensembles else (), rest="metrics.csv"
        ),
        ReportSection(BROKEN, lines=over.broken, most=12, rest="report.html"),
        ReportSection("Notes", lines=over.notes, most=12, rest="summary.json"),
        *_latency(over),
    ]
    return [section for section in made if section.rows or section.lines or section.says]


def _gates(over: Overview) -> Iterator[ReportSection]:
    if over.shard:
        yield ReportSection(
            "Gates",
            says=(f"Not judged: shard {over.shard}; `replan merge` judges all shards together.",),
        )
        return
    columns = _columns("outcome", "rule", "what was found")
    good, bad = (
        tuple(_gate(row) for row in over.gates if (row.outcome == "pass") is passed)
        for passed in (True, False)
    )
    yield ReportSection(
        "Gates",
        columns,
        bad,
        says=() if bad else ("No gate fails, none is inconclusive.",),
        rest="report.html",
        key="gates",
    )
    yield ReportSection(
        f"{counted(len(good), 'verdict')} of gates: pass",
        columns,
        good,
        folded=True,
        most=6,
        rest="report.html",
    )
    unasked = f"{counted(len(over.not_asked), 'gate')} not asked of some drives"
    yield ReportSection(unasked, lines=over.not_asked, folded=True, most=12, rest="report.html")


def _gate(row: GateRow) -> tuple[Cell, ...]:
    loop = f" [{row.mode}]" if row.mode and f"[{row.mode}]" not in row.rule else ""
    drives = ((row.log, row.planner),) if row.log else ()
    return _outcome(row.outcome), Cell(row.rule + loop, code=True), Cell(row.found, drives=drives)


def _diagnosis(over: Overview) -> Iterator[ReportSection]:
    if over.diagnosis is None:
        return
    found = over.diagnosis
    columns = _columns(
        "drives",
        "what happens",
        "cause",
        "because it",
        "gates",
        "about",
        "which",
        numbers=["drives"],
    )
    rows = tuple(
        (
            number_cell(len(one["drives"])),
            *_words(
                one.get("happens", ""),
                one["cause"],
                one["why"],
                ", ".join(one["gates"]),
                one.get("about", ""),
            ),
            Cell(
                ", ".join(one["drives"]),
                drives=tuple((log, found["planner"]) for log in one["drives"]),
            ),
        )
        for one in found["clusters"]
    )
    yield ReportSection(
        f"Why {found['planner']} fails",
        columns,
        rows,
        tuple(line.strip() for line in found["said"]),
    )


def _shares(over: Overview) -> Iterator[ReportSection]:
    if not over.whole:
        return
    numbers = ("pass", "share", "95 % interval", "fail", "inconclusive", "not evaluated")
    columns = _columns("logs", "planner", "loop", *numbers, numbers=numbers)

    def rows(shares: Iterable[PassShare]) -> tuple[tuple[Cell, ...], ...]:
        return tuple(
            (
                *_words(one.name, one.planner, one.mode, f"{one.passed} of {one.logs}"),
                number_cell(100.0 * one.share, "{:.0f}%".format),
                Cell(f"{100.0 * one.low:.0f} to {100.0 * one.high:.0f}%"),
                *(
                    number_cell(count, "{:.0f}".format)
                    for count in (one.failed, one.inconclusive, one.missing)
                ),
            )
            for one in shares
        )

    says = "Shares of all logs: a log that is inconclusive or could not be evaluated does not pass."
    yield ReportSection("Logs that pass", columns, rows(over.whole), says=(says,), key="shares")
    by_group = "Logs that pass, by family, tag and dataset"
    yield ReportSection(
        by_group, columns, rows(over.grouped), folded=True, most=12, rest="groups.parquet"
    )


def _drives(over: Overview) -> Iterator[ReportSection]:
    first, several = over.first_closed, len(over.planners) > 1
    ended = (
        [ReportColumn("closed loop ended by", short="closed loop\nended by")]
        if first < len(over.columns)
        else []
    )
    both = len({column.mode for column in over.columns}) > 1
    values = [
        ReportColumn(f"{one.words}, {one.mode}" if both else one.words, True, one.title, one.metric)
        for one in over.columns
    ]
    columns = (
        *_columns("log", *(["planner"] if several else []), "verdict"),
        *values[:first],
        *ended,
        *values[first:],
    )
    rows = tuple(
        (
            Cell(row.log, drives=((row.log, row.planner),), file=row.file),
            *(_words(row.shown) if several else ()),
            _outcome(row.verdict, f" {row.asked}"),
            *row.cells[:first],
            *([row.end] if ended else []),
            *row.cells[first:],
        )
        for row in over.ranked
    )
    yield ReportSection(
        "Drives",
        columns,
        rows,
        says=tuple(legend(over.columns)),
        most=MOST_ROWS,
        rest="metrics.csv",
        key="drives",
    )


def _planners(over: Overview) -> Iterator[ReportSection]:
    if len(over.planners) > 1:
        columns = _columns("over all logs", *over.planners, numbers=over.planners)
        yield ReportSection(
            "Planners", columns, tuple(_words(label, *texts) for label, texts in over.compared)
        )


def _latency(over: Overview) -> Iterator[ReportSection]:
    numbers = ("p50 [ms]", "p95 [ms]", "p99 [ms]", "share")
    rows = tuple(
        (
            *_words(one.planner, one.stage),
            *(number_cell(ms, "{:.2f}".format) for ms in (one.p50_ms, one.p95_ms, one.p99_ms)),
            number_cell(100.0 * one.share, "{:.0f}%".format),
        )
        for one in over.latency
    )
    title = f"Planning time (wall clock, {counted(over.frames, 'plan')})"
    yield ReportSection(
        title, _columns("planner", "stage", *numbers, numbers=numbers), rows, folded=True
    )


# a comparison -------------------------------------------------------------------------------------


def comparison_sections(found: Comparison) -> list[ReportSection]:
    """The sections of a comparison, in their order; those with nothing to say are left out."""
    several = found.pairs["planner"].nunique() > 1
    rules = tuple(
        (_outcome(one.outcome.value), Cell(one.rule, code=True), Cell(one.reason))
        for one in sorted(found.verdicts, key=lambda one: list(Outcome).index(one.outcome))
    )
    same = ("the same: logs, configuration, vehicles, versions",)
    made = [
        ReportSection("Rules", _columns("outcome", "rule", "what was found"), rules),
        ReportSection("Inputs", lines=found.differences or same, most=10, rest="--json"),
        ReportSection(
            f"Only in the baseline ({len(found.only_in_baseline)})",
            lines=found.only_in_baseline,
            most=10,
        ),
        ReportSection(
            f"Only in the candidate ({len(found.only_in_candidate)})",
            lines=found.only_in_candidate,
            most=10,
        ),
        _flips(found, several=several),
        _pairs("Worst regressions", found.regressions(MOST_PAIRS, each=3), several=several),
        _pairs("Greatest improvements", found.improvements(MOST_PAIRS), several=several),
        _means(found, several=several),
        _partings(found, several=several),
    ]
    return [section for section in made if section.rows or section.lines or section.says]


def _of_drive(row: Any, *, several: bool) -> tuple[Cell, ...]:
    """The log (with its drive), the planner if there are several, and the loop of a row."""
    drives = ((row.log, row.planner.rpartition(" -> ")[2]),)
    return Cell(row.log, drives=drives), *(_words(row.planner) if several else ()), Cell(row.mode)


def _drive_columns(
    *titles: str, several: bool, numbers: Sequence[str] = ()
) -> tuple[ReportColumn, ...]:
    return _columns("log", *(["planner"] if several else []), "loop", *titles, numbers=numbers)


def _rows(table: pd.DataFrame) -> list[Any]:
    return list(table.itertuples())


def _flips(found: Comparison, *, several: bool) -> ReportSection:
    flips = found.flips
    numbers = ("value before", "value after", "time")
    columns = _drive_columns(
        "gate", "before", "after", *numbers, "about", several=several, numbers=numbers
    )
    rows = tuple(
        (
            *_of_drive(row, several=several),
            Cell(row.gate, code=True),
            _outcome(row.before),
            _outcome(row.after, " (marginal)" if row.marginal and row.after == "fail" else ""),
            number_cell(row.value_before),
            number_cell(row.value_after),
            _seconds(row.time_s),
            Cell(row.reason),
        )
        for row in _rows(worst_flips(found))
    )
    if not rows:
        return ReportSection("Flips", says=("No verdict changed.",))
    count = {word: int((flips["after"] == word).sum()) for word in ("fail", "pass")}
    title = (
        f"Flips: {count['fail']} to FAIL, {count['pass']} to pass, "
        f"{len(flips) - sum(count.values())} others"
    )
    return ReportSection(title, columns, rows, says=found.by_loop, most=20, rest="--json")


def _pairs(title: str, pairs: pd.DataFrame, *, several: bool) -> ReportSection:
    numbers = ("baseline", "candidate", "change", "time")
    columns = _drive_columns("metric", *numbers, "about", several=several, numbers=numbers)
    rows = tuple(
        (
            *_of_drive(row, several=several),
            Cell(row.metric),
            number_cell(row.baseline),
            number_cell(row.candidate, unit=row.unit),
            number_cell(row.delta),
            _seconds(row.time_s),
            Cell(row.reason),
        )
        for row in _rows(pairs)
    )
    return ReportSection(title, columns, rows, most=8, rest="--json")


def _means(found: Comparison, *, several: bool) -> ReportSection:
    """Metrics with a gate or a significant change over the suite, and those with both over groups
    of logs.

    For each metric, only the reduction that changed most is shown.
    """
    groups = found.groups[found.groups["delta"] != 0.0]
    asked = set(found.pairs.loc[found.pairs["asked"].astype(bool), "metric"])
    gated, suite, sure = (
        groups["metric"].isin(asked),
        groups["kind"] == "suite",
        groups["significant"].astype(bool),
    )
    size = groups["delta"].abs() / groups[["baseline", "candidate"]].abs().max(axis=1)
    rank = pd.DataFrame({"part": ~suite, "unsure": ~sure, "other": ~gated, "size": -size})
    shown = groups[suite & (gated | sure) | ~suite & gated & sure]
    shown = shown.loc[
        rank.loc[shown.index].sort_values(["part", "unsure", "other", "size"], kind="stable").index
    ]
    words = shown["metric"].map(lambda name: name.partition(".")[0])
    shown = shown[
        ~shown.assign(metric=words)[["kind", "group", "planner", "mode", "metric"]].duplicated()
    ]
    who, numbers = ["planner"] if several else [], ("logs", "before", "after", "better", "worse")
    columns = _columns(
        "logs of",
        *who,
        "loop",
        "metric",
        *numbers[:3],
        "change [95 %]",
        *numbers[3:],
        numbers=numbers,
    )
    rows = []
    for row in _rows(shown.head(MOST_GROUPS)):
        hurts = row.delta * {"lower": 1.0, "higher": -1.0}.get(row.direction, nan)
        unit = "" if row.unit in ("1", "count") else f" {row.unit}"
        inside = f" [{row.low:+.3g}, {row.high:+.3g}]" if isfinite(row.low) else ""
        change = f"{row.delta:+.3g}{unit}{inside}{' *' if row.significant else ''}"
        name = "all" if row.kind == "suite" else f"{row.kind} {row.group}"
        rows.append(
            (
                Cell(name),
                *(_words(row.planner) if several else ()),
                *_words(row.mode, row.metric),
                number_cell(row.logs),
                number_cell(row.baseline),
                number_cell(row.candidate),
                Cell(change, row.delta, bad=bool(row.significant) and hurts > 0.0),
                number_cell(row.better),
                number_cell(row.worse),
            )
        )
    note = "* more than chance over these logs (paired bootstrap, at least 6 logs)"
    return ReportSection(
        "Means over the logs",
        columns,
        tuple(rows),
        says=(note,) if rows else (),
        most=14,
        rest="--json",
    )


def _partings(found: Comparison, *, several: bool) -> ReportSection:
    columns = _drive_columns("time", "first difference", several=several, numbers=["time"])
    rows = tuple(
        (*_of_drive(row, several=several), _seconds(row.t_s), Cell(row.what))
        for row in _rows(found.partings)
    )
    unseen = found.not_looked_at
    says = (
        (f"Not searched in {counted(unseen, 'more drive')} that differ.",)
        if unseen and rows
        else ()
    )
    return ReportSection(
        "First differences of drives", columns, rows, says=says, most=12, rest="--json"
    )


def first_regression(found: Comparison) -> tuple[str, str, str] | None:
    """Log, planner and loop of the worst regression; None if nothing got worse."""
    worst = found.regressions(1)
    return tuple(worst.iloc[0][DRIVE]) if len(worst) else None


OUTCOMES = {0: "pass", 1: "fail", 4: "inconclusive"}  # Outcomes of a comparison by exit code
STYLES = {
    Outcome.PASS.value: "green",
    Outcome.FAIL.value: "bold red",
    Outcome.INCONCLUSIVE.value: "yellow",
}
SHORT = {"inconclusive": "inconcl."}
Watch = Callable[[str, str, str], str]
"""Maps log, planner and mode to the command that shows the drive; "" if it is not available."""


def print_report(over: Overview, console: Console, folder: Path, *, ending: bool = True) -> None:
    """Print the report on the results in a folder; `ending=False` leaves its last lines to
    `print_ending`.
    """
    console.print(Group(*_rendered(run_sections(over)[::-1])))
    if ending:
        print_ending(over, console, folder)


def print_ending(over: Overview, console: Console, folder: Path, place: str = "") -> None:
    """Print the place of the results (`place`, or the folder), and as the last line the outcome."""
    place = place or str(folder)
    there = [
        name for name in ("report.html", "metrics.csv", "summary.json") if (folder / name).is_file()
    ]
    lines = [Text(f"{each.planner}: {each.text}") for each in over.answers]
    lines.append(Text(f"Results: {place}  ({', '.join((*there, 'a folder per log'))})"))
    if over.worst is not None and over.worst.recording:
        lines.append(
            Text.assemble(
                "Look at a drive:  ", (f"replan view {place}/{over.worst.recording}", "bold")
            )
        )
    words = f"Outcome: {over.outcome.upper()} (exit code {over.exit_code})"
    lines.append(Text(words, style="bold green" if over.exit_code == 0 else "bold red"))
    console.print(Group(*lines))


def print_comparison(
    comparison: Comparison,
    console: Console,
    watch: Watch = lambda log, planner, mode: "",
    *,
    alone: bool = True,
) -> None:
    """Print the comparison; `alone`: with the exit code, which is then that of the command."""
    worst, pairs = first_regression(comparison), comparison.pairs
    command = watch(*worst) if worst is not None else ""
    parts: list[RenderableType] = [
        Text(f"{comparison.baseline} -> {comparison.candidate}", style="bold"),
        Text(),
    ]
    parts += _rendered(comparison_sections(comparison)[::-1])
    if command:
        parts.append(Text.assemble("Look at the worst regression:  ", (command, "bold")))
    count = len(pairs[["log", "planner", "mode"]].drop_duplicates())
    worse, better = int((pairs["worse"] > 0.0).sum()), int((pairs["worse"] < 0.0).sum())
    values = f"{counted(len(pairs), 'value')}: {int((pairs['delta'] == 0.0).sum())} the same"
    parts.append(Text(f"{counted(count, 'drive')}, {values}, {worse} worse, {better} better"))
    parts.append(
        Text(last_line(comparison, alone=alone), style=STYLES[OUTCOMES[comparison.exit_code]])
    )
    console.print(Group(*parts))


def _rendered(sections: Sequence[ReportSection]) -> Iterator[RenderableType]:
    """The sections as tables and lists, each with its title, the number of what is left out, and
    where that is.
    """
    for section in sections:
        parts = list[RenderableType]()
        if section.rows:
            padding = (0, 0 if len(section.columns) > 8 else 1, 0, 0)
            table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=padding)
            for column in section.columns:
                fixed = column.is_number or column.title in ("verdict", "outcome")
                table.add_column(
                    Text(column.short or column.title),
                    justify="right" if column.is_number else "left",
                    overflow="fold",
                    no_wrap=fixed,
                )
            for row in section.rows[: section.most]:
                table.add_row(*map(_cell, row))
            parts.append(table)
        parts += [Padding(Text(line), (0, 0, 0, 2)) for line in section.lines[: section.most]]
        rest = f": {section.rest}" if section.rest else ""
        left = [
            f"{len(some) - section.most} more{rest}"
            for some in (section.rows, section.lines)
            if len(some) > section.most
        ]
        parts += [Text(line, style="dim") for line in (*left, *section.says)]
        yield from (Text(section.title, style="bold underline"), *parts, Text())


def _cell(cell: Cell) -> Text:
    if cell.outcome:
        word = SHORT.get(
            cell.outcome, cell.outcome.upper() if cell.outcome == "fail" else cell.outcome
        )
        return Text(cell.text.replace(cell.outcome, word, 1), style=STYLES.get(cell.outcome, ""))
    return Text(cell.text, style="red" if cell.bad else "")


def last_line(comparison: Comparison, *, alone: bool = True) -> str:
    """The outcome in one line, with the exit code if it is that of the command."""
    code = f" (exit code {comparison.exit_code})" if alone else ""
    return f"Comparison: {OUTCOMES[comparison.exit_code].upper()}{code}"


def document(comparison: Comparison) -> dict[str, Any]:
    """The whole comparison for JSON, with only those pairs that differ."""
    changed = comparison.pairs[comparison.pairs["delta"] != 0.0]
    content = {item.name: getattr(comparison, item.name) for item in fields(comparison)}
    head = {"outcome": OUTCOMES[comparison.exit_code], "exit_code": comparison.exit_code}
    return {**head, **content, "pairs": changed, "by_loop": comparison.by_loop}
