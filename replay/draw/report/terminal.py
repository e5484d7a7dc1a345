"""Reports for a terminal: the sections of a run and of a comparison (`replay.draw.report.sections`), and their ending.

ASCII only (no symbols that a terminal may lack); they fit 80 columns, and use more if there are more. The sections come
in reverse, so that the answer stands last, where it is seen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.text import Text

from logs.names import counted
from metrics.comparison import Comparison
from metrics.judge.gates import Outcome
from replay.draw.report.console import grid, titled
from replay.draw.report.contents import Cell, Overview
from replay.draw.report.sections import ReportSection, comparison_sections, first_regression, run_sections

OUTCOMES = {0: "pass", 1: "fail", 4: "inconclusive"}  # Outcomes of a comparison by exit code
STYLES = {Outcome.PASS.value: "green", Outcome.FAIL.value: "bold red", Outcome.INCONCLUSIVE.value: "yellow"}
SHORT = {"inconclusive": "inconcl."}
Watch = Callable[[str, str, str], str]
"""Maps log, planner and mode to the command that shows the drive; "" if it is not available."""


def print_report(over: Overview, console: Console, folder: Path, *, ending: bool = True) -> None:
    """Print the report on the results in a folder; `ending=False` leaves its last lines to `print_ending`."""
    console.print(Group(*_rendered(run_sections(over)[::-1])))
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


def print_comparison(
    comparison: Comparison, console: Console, watch: Watch = lambda log, planner, mode: "", *, alone: bool = True
) -> None:
    """Print the comparison; `alone`: with the exit code, which is then that of the command."""
    worst, pairs = first_regression(comparison), comparison.pairs
    command = watch(*worst) if worst is not None else ""
    parts: list[RenderableType] = [Text(f"{comparison.baseline} -> {comparison.candidate}", style="bold"), Text()]
    parts += _rendered(comparison_sections(comparison)[::-1])
    if command:
        parts.append(Text.assemble("Look at the worst regression:  ", (command, "bold")))
    count = len(pairs[["log", "planner", "mode"]].drop_duplicates())
    worse, better = int((pairs["worse"] > 0.0).sum()), int((pairs["worse"] < 0.0).sum())
    values = f"{counted(len(pairs), 'value')}: {int((pairs['delta'] == 0.0).sum())} the same"
    parts.append(Text(f"{counted(count, 'drive')}, {values}, {worse} worse, {better} better"))
    parts.append(Text(last_line(comparison, alone=alone), style=STYLES[OUTCOMES[comparison.exit_code]]))
    console.print(Group(*parts))


def _rendered(sections: Sequence[ReportSection]) -> Iterator[RenderableType]:
    """The sections as tables and lists, each with its title, the number of what is left out, and where that is."""
    for section in sections:
        parts = list[RenderableType]()
        if section.rows:
            table = grid(padding=0 if len(section.columns) > 8 else 1)
            for column in section.columns:
                fixed = column.is_number or column.title in ("verdict", "outcome")
                table.add_column(
                    Text(column.short or column.title), justify="right" if column.is_number else "left",
                    overflow="fold", no_wrap=fixed,
                )  # fmt: skip
            for row in section.rows[: section.most]:
                table.add_row(*map(_cell, row))
            parts.append(table)
        parts += [Padding(Text(line), (0, 0, 0, 2)) for line in section.lines[: section.most]]
        rest = f": {section.rest}" if section.rest else ""
        left = [f"{len(some) - section.most} more{rest}" for some in (section.rows, section.lines)
                if len(some) > section.most]  # fmt: skip
        parts += [Text(line, style="dim") for line in (*left, *section.says)]
        yield from titled(section.title, *parts)


def _cell(cell: Cell) -> Text:
    if cell.outcome:
        word = SHORT.get(cell.outcome, cell.outcome.upper() if cell.outcome == "fail" else cell.outcome)
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
