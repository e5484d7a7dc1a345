"""Reports for a terminal: ASCII only (no symbols that a terminal may lack); they fit 80 columns,
and use more if there are more.

The answer comes first, and its outcome once more as the last line.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from rich import box
from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from replan.draw.report.comparison_sections import (
    OUTCOMES,
    comparison_sections,
    first_regression,
    last_line,
    verdict_sentence,
)
from replan.draw.report.overview import Overview
from replan.draw.report.run_sections import run_sections
from replan.draw.report.section import Cell, ReportSection
from replan.metrics.comparison import Comparison
from replan.metrics.judge.gates import Outcome

STYLES = {
    Outcome.PASS.value: "green",
    Outcome.FAIL.value: "bold red",
    Outcome.INCONCLUSIVE.value: "yellow",
}
WORDS = {Outcome.FAIL.value: "FAIL", Outcome.INCONCLUSIVE.value: "inconcl."}
Watch = Callable[[str, str, str], Mapping[str, str]]
"""Maps log, planner and mode to commands about the drive, by purpose."""
WIDE = 8  # Tables of more columns have no space around their cells


def print_report(over: Overview, console: Console, folder: Path, *, ending: bool = True) -> None:
    """Print the report on the results in a folder; `ending=False` leaves its last lines to
    `print_ending`.
    """
    verdict = Text(over.verdict, style="bold green" if over.exit_code == 0 else "bold red")
    console.print(Group(verdict, Text(), *_rendered(run_sections(over))))
    if ending:
        print_ending(over, console, folder)


def print_ending(over: Overview, console: Console, folder: Path, place: str = "") -> None:
    """Print the place of the results (`place`, or the folder), and as the last line the outcome."""
    place = place or str(folder)
    names = ("report.html", "metrics.csv", "summary.json")
    files = [name for name in names if (folder / name).is_file()]
    lines = [Text(f"{planner}: {answer}") for planner, answer in over.answers]
    lines.append(Text(f"Results: {place}  ({', '.join((*files, 'a folder per log'))})"))
    if over.drives and (recording := over.drives[0].recording):
        command = f"replan view {place}/{recording}", "bold"
        lines.append(Text.assemble("Look at a drive:  ", command))
    for row in over.first[:1]:
        why = shlex.join(["replan", "explain", place, row.log, "-p", row.planner])
        lines.append(Text.assemble("Why:  ", (why, "bold")))
    words = f"Outcome: {over.outcome.upper()} (exit code {over.exit_code})"
    lines.append(Text(words, style="bold green" if over.exit_code == 0 else "bold red"))
    console.print(Group(*lines))


def print_comparison(
    comparison: Comparison,
    console: Console,
    watch: Watch = lambda log, planner, mode: {},
    *,
    alone: bool = True,
) -> None:
    """Print the comparison; `alone`: with the exit code, which is then that of the command."""
    worst = first_regression(comparison)
    commands = watch(*worst) if worst is not None else {}
    style = STYLES[OUTCOMES[comparison.exit_code]]
    title = f"{comparison.baseline} -> {comparison.candidate}"
    parts: list[RenderableType] = [Text(title, style="bold")]
    parts += [Text(verdict_sentence(comparison), style=style), Text()]
    parts += _rendered(comparison_sections(comparison))
    for purpose, command in commands.items():
        parts.append(Text.assemble(f"{purpose}:  ", (command, "bold")))
    parts.append(Text(last_line(comparison, alone=alone), style=style))
    console.print(Group(*parts))


def _rendered(sections: Sequence[ReportSection]) -> Iterator[RenderableType]:
    """The sections as tables and lists, each with its title, the number of what is left out, and
    where that is.
    """
    folded = [f"{section.title} ({section.rest})" for section in sections if section.folded]
    for section in sections:
        if section.folded:
            continue
        yield Text(section.title, style="bold underline")
        lines = list(section.lines[: section.most])
        if section.as_line is not None:
            lines += map(section.as_line, section.items[: section.most])
        elif section.items:
            yield _table(section)
        for line in lines:
            yield Padding(Text(line), (0, 0, 0, 2))
        rest = f": {section.rest}" if section.rest else ""
        for entries in (section.items, section.lines):
            if len(entries) > section.most:
                yield Text(f"{len(entries) - section.most} more{rest}", style="dim")
        for remark in section.remarks:
            yield Text(remark, style="dim")
        yield Text()
    if folded:
        yield Text(f"Not shown: {'; '.join(folded)}", style="dim")


def _table(section: ReportSection) -> Table:
    space = 0 if len(section.columns) > WIDE else 1
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, space, 0, 0))
    for column in section.columns:
        table.add_column(
            Text(column.short or column.title),
            justify="right" if column.is_number else "left",
            overflow="fold",
            no_wrap=column.is_number or column.title in ("verdict", "outcome"),
        )
    for row in section.rows[: section.most]:
        table.add_row(*map(_cell, row))
    return table


def _cell(cell: Cell) -> Text:
    if cell.outcome:
        word = WORDS.get(cell.outcome, cell.outcome)
        return Text(cell.text.replace(cell.outcome, word, 1), style=STYLES.get(cell.outcome, ""))
    return Text(cell.text, style="red" if cell.bad else "")
