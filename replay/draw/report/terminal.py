"""The report of a run for a terminal: drives, gates, latency, assumptions, and how to look closer.

ASCII only (no symbols that a terminal may lack); it fits 80 columns, and uses more if there are more. Its contents are
those of `replay.draw.report.overview`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import isfinite
from pathlib import Path

from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from logs.names import counted
from metrics.judge.gates import Outcome
from replay.draw.report.console import grid, titled
from replay.draw.report.model import BROKEN, NOTHING, Overview, legend

MAX_ROWS = 30
"""Further drives are not listed; those with marked values come first."""

MAX_NOTES = 12
MAX_GROUPS = 12
SAYS = {"pass": "pass", "fail": "FAIL", "inconclusive": "inconcl."}
STYLES = {Outcome.PASS.value: "green", Outcome.FAIL.value: "bold red", Outcome.INCONCLUSIVE.value: "yellow"}


def print_report(over: Overview, console: Console, folder: Path, *, ending: bool = True) -> None:
    """The whole report on the results in a folder; without its `ending` if something else is printed before it."""
    console.print(Group(*_parts(over)))
    if ending:
        print_ending(over, console, folder)


def print_ending(over: Overview, console: Console, folder: Path, place: str = "") -> None:
    """The place of the results (`place`: where those of the folder go), and the outcome: the last line of a run."""
    place = place or str(folder)
    there = [name for name in ("report.html", "metrics.csv", "summary.json") if (folder / name).is_file()]
    lines = [Text(f"Results: {place}  ({', '.join((*there, 'a folder per log'))})")]
    if over.worst is not None and over.worst.recording:
        lines.append(Text.assemble("Look at a drive:  ", (f"replan view {place}/{over.worst.recording}", "bold")))
    words = f"Outcome: {over.outcome.upper()} (exit code {over.exit_code})"
    lines.append(Text(words, style="bold green" if over.exit_code == 0 else "bold red"))
    console.print(Group(*lines))


def _parts(over: Overview) -> Iterator[RenderableType]:
    if over.drives:
        yield from _drives(over)
        if len(over.planners) > 1:  # a column per planner: each metric over the logs
            table = grid()
            table.add_column("over all logs")
            for planner in over.planners:
                table.add_column(planner, justify="right", overflow="fold")
            for label, texts in over.compared:
                table.add_row(Text(label), *texts)
            yield from titled("Planners", table)
        yield from titled(f"Planning time (wall clock, {counted(over.frames, 'plan')})", _latency(over))
    judged = Text(f"not judged: shard {over.shard}; see replan merge") if over.shard else _gates(over)
    yield from titled("Gates", judged, *(Text(each.text, style="dim") for each in over.coverage))
    if over.not_asked:
        yield from titled("Gates that were not asked", *_listed(over.not_asked, MAX_NOTES, "report.html"))
    yield from _shares(over)
    if over.ensembles:
        title = f"Ensemble: {len(over.fragile)} of {over.ensembles} verdicts are fragile"
        yield from titled(title, *_listed(over.fragile, MAX_ROWS, "metrics.csv"))
    if over.broken:
        yield from titled(BROKEN, *_listed(over.broken, MAX_NOTES, "report.html"))
    if over.notes:
        yield from titled("Notes", *_listed(over.notes, MAX_NOTES, "summary.json"))
    if over.failures:
        title = f"Could not be evaluated ({len(over.failures)})"
        yield from titled(title, *_listed(over.failures, MAX_ROWS, "summary.json"))


def _listed(lines: Sequence[str], most: int, rest: str) -> Iterator[RenderableType]:
    """The lines, indented; the number of further lines, and the file that has them."""
    more = [f"{len(lines) - most} more: {rest}"] if len(lines) > most else []
    return (Padding(Text(line), (0, 0, 0, 2)) for line in (*lines[:most], *more))


def _drives(over: Overview) -> Iterator[RenderableType]:
    """One row per log and planner, and the meaning of the columns."""
    rows = over.drives
    shown = rows if len(rows) <= MAX_ROWS else sorted(rows, key=lambda row: -row.trouble)[:MAX_ROWS]
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


def _latency(over: Overview) -> Table:
    table = grid("planner", "stage")
    for title in ("p50 [ms]", "p95 [ms]", "p99 [ms]", "share"):
        table.add_column(Text(title), justify="right")
    for row in over.latency:
        last = row.stage == "total"
        quantiles = (f"{value:.2f}" for value in (row.p50_ms, row.p95_ms, row.p99_ms))
        share = f"{100.0 * row.share:.0f}%" if isfinite(row.share) else NOTHING
        table.add_row(row.planner, row.stage, *quantiles, share, style="bold" if last else "", end_section=last)
    return table


def _gates(over: Overview) -> RenderableType:
    table = grid()
    for title in ("outcome", "rule", "what was found"):
        table.add_column(title, overflow="fold", no_wrap=title == "outcome")
    for row in over.gates:
        loop = f" [{row.mode}]" if row.mode and f"[{row.mode}]" not in row.rule else ""
        table.add_row(Text(row.outcome.upper(), style=STYLES[row.outcome]), Text(row.rule + loop), Text(row.found))
    return table


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
