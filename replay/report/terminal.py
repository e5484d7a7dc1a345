"""The report of a run for a terminal: drives, gates, latency, what was assumed, and how to look closer.

Plain letters only (no symbols that a terminal may lack); fits 80 columns, uses more where there are more.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import isfinite

import pandas as pd
from rich import box
from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from logs.trace import EndReason
from metrics.gates import Outcome
from metrics.judge import Verdict, verdicts_by_log
from replay.batch import RunResult
from replay.batch.log_result import DriveRecord, LogResult

MAX_ROWS = 30
"""More drives than these are not listed; those with trouble come first."""

MAX_NOTES = 12
NOTHING = "-"

Cell = tuple[str, str]
"""Text and style."""
Key = tuple[str, str]
"""Log and planner."""


@dataclass(frozen=True)
class Column:
    """One metric of the table of drives.

    Attributes:
        title: With the unit, lines short.
        metric: Row of the metric table.
        mode: Loop in which it was measured.
        show: Value to text.
        bad: Whether the value deserves colour.
    """

    title: str
    metric: str
    mode: str
    show: Callable[[float], str]
    bad: Callable[[float], bool] = lambda value: False


def _fixed(digits: int) -> Callable[[float], str]:
    return lambda value: f"{value:.{digits}f}"


def _percent(value: float) -> str:
    return f"{100.0 * value:.0f}%" if value == 0.0 or value >= 0.01 else "<1%"


COLUMNS = (
    Column("ADE\n3 s\n[m]", "ade.3s.mean", "open", _fixed(2)),
    Column("fall\nback", "fallback.rate", "open", _percent, lambda value: value > 0.0),
    Column("route\ndone", "route_progress.final", "closed", _percent, lambda value: value < 0.5),
    Column("goal", "goal.final", "closed", lambda value: "yes" if value else "no", lambda value: value == 0.0),
    Column("hits\nat\nfault", "collision_at_fault.count", "closed", _fixed(0), lambda value: value > 0.0),
    Column("least\ngap\n[m]", "gap.min", "closed", _fixed(2), lambda value: value < 0.2),
    Column("off\nplan\n[m]", "tracking_lateral.max_abs", "closed", _fixed(2)),
    Column("TTC\n[s]", "ttc.min", "closed", _fixed(1), lambda value: value < 0.95),
    Column("jerk\n[s]", "lon_jerk_state.time_out_of_bounds", "closed", _fixed(1), lambda value: value > 2.0),
    Column("fall\nback", "fallback.rate", "closed", _percent, lambda value: value > 0.0),
)
"""Open loop first; the closed loop's columns come after how its drive ended."""

FIRST_CLOSED = next(column for column in COLUMNS if column.mode == "closed")

LEGEND = (
    "open loop: the log drives, plans are compared with it; ADE 3 s: mean distance of plan and log over 3 s.",
    "closed loop: the planner drives; route done: of what the log's driver, else the careful driver, does in all;",
    "TTC: least time to a collision; off plan: largest lateral distance; jerk: seconds beyond 4.13 m/s3.",
    "verdict: the worst that the gates say of this log; inconclusive: evidence neither for nor against the planner.",
    "fall back: share of frames in which the planner could not plan.  - : not available (why: metrics.csv).",
)


def print_report(result: RunResult, console: Console) -> None:
    """The whole report."""
    console.print(Group(*_parts(result)))


def _parts(result: RunResult) -> Iterator[RenderableType]:
    if result.drives:
        yield from _drives(result)
        if len({drive.planner for drive in result.drives}) > 1:
            yield from _titled("Planners", _comparison(result))
        frames = int((result.timings["stage"] == "total").sum())
        yield from _titled(f"Planning time (wall clock, {frames} plans)", _latency(result))
    judged = _gates(result) if result.shard is None else Text(f"not judged: shard {result.shard}; see replan merge")
    yield from _titled("Gates", judged, *_coverage(result))
    yield from _ensemble(result)
    yield from _notes(result)
    yield from _failures(result)
    yield from _ending(result)


def _titled(title: str, *parts: RenderableType) -> Iterator[RenderableType]:
    yield Text(title, style="bold underline")
    yield from parts
    yield Text()


def _grid(*, padding: int = 1) -> Table:
    return Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, padding, 0, 0))


def _drives(result: RunResult) -> Iterator[RenderableType]:
    """One row per log and planner, and what the columns mean."""
    values = _values(result.table)
    rows = [_row(key, drives, values) for key, drives in _by_log(result.drives).items()]
    shown = rows if len(rows) <= MAX_ROWS else sorted(rows, key=lambda row: -row.trouble)[:MAX_ROWS]
    columns = _shown_columns(result)
    several = len({drive.planner for drive in result.drives}) > 1
    table = _grid(padding=0)
    table.add_column("log", overflow="fold")
    table.add_column("verdict", no_wrap=True)
    for column in columns:
        if column is FIRST_CLOSED:
            table.add_column("closed loop\nended by", overflow="fold", max_width=13)
        table.add_column(Text(column.title), justify="right", no_wrap=True)
    before = ""
    said = verdicts_by_log(result.verdicts)
    for row in shown:
        if several and row.log != before:
            table.add_row(Text(row.log))
        verdict = said.get(row.key)
        word = Text(SAYS[verdict], style=STYLES[Outcome(verdict)]) if verdict else Text(NOTHING)
        name = Text(f"  {row.planner}" if several else row.log)
        table.add_row(name, word, *(Text(*cell) for cell in row.cells(columns)))
        before = row.log
    legend = Text("\n".join([*LEGEND, *_omitted(len(rows) - len(shown))]), style="dim")
    yield from _titled("Drives", table, legend)


def _omitted(count: int) -> list[str]:
    return [f"{count} more drives without more trouble than these: metrics.csv"] if count > 0 else []


def _shown_columns(result: RunResult) -> list[Column]:
    modes = {mode.value for mode in result.run.modes}
    return [column for column in COLUMNS if column.mode in modes]


@dataclass(frozen=True)
class _Row:
    """A log and a planner: how its closed loop ended, and its values by column."""

    key: Key
    log: str
    planner: str
    end: Cell
    values: dict[Column, float]

    @property
    def trouble(self) -> int:
        """How many of its cells are coloured."""
        return bool(self.end[1]) + sum(column.bad(value) for column, value in self.values.items())

    def cells(self, columns: Sequence[Column]) -> Iterator[Cell]:
        """What stands right of the planner."""
        for column in columns:
            if column is FIRST_CLOSED:
                yield self.end
            value = self.values.get(column)
            yield (NOTHING, "") if value is None else (column.show(value), "red" if column.bad(value) else "")


def _by_log(drives: Sequence[DriveRecord]) -> dict[Key, list[DriveRecord]]:
    grouped: dict[Key, list[DriveRecord]] = {}
    for drive in drives:
        grouped.setdefault((drive.log, drive.planner), []).append(drive)
    return grouped


def _values(table: pd.DataFrame) -> dict[tuple[str, str, str, str], float]:
    found = table[table["available"].astype(bool)]
    keys = zip(found["log"], found["planner"], found["mode"], found["metric"], strict=True)
    return dict(zip(keys, map(float, found["value"]), strict=True))


def _row(key: Key, drives: Sequence[DriveRecord], values: dict[tuple[str, str, str, str], float]) -> _Row:
    log, planner = key
    closed = next((drive for drive in drives if drive.mode == "closed"), None)
    known = {column: values.get((log, planner, column.mode, column.metric)) for column in COLUMNS}
    return _Row(
        key,
        log,
        marked(planner, oracle=drives[0].oracle),
        _end(closed),
        {column: value for column, value in known.items() if value is not None and isfinite(value)},
    )


def marked(planner: str, *, oracle: bool) -> str:
    """The planner's name, with a mark where it knows the log's future."""
    return f"{planner} (oracle)" if oracle else planner


def _end(drive: DriveRecord | None) -> Cell:
    if drive is None:
        return NOTHING, ""
    good = drive.end in (EndReason.GOAL.value, EndReason.END_OF_LOG.value)
    whom = f": {drive.detail}" if drive.end in CONTACTS else ""
    return f"{SHORT.get(drive.end, drive.end)}{whom}", "" if good else "red"


CONTACTS = (EndReason.COLLISION.value, EndReason.REPLAY_CONTACT.value)
SHORT = {
    EndReason.GOAL.value: "goal",
    EndReason.END_OF_LOG.value: "end of log",
    EndReason.REPLAY_CONTACT.value: "run into",
    EndReason.OFF_ROAD.value: "off the road",
    EndReason.PLANNER_FAILURE.value: "planner failed",
}


def _comparison(result: RunResult) -> Table:
    """One column per planner: each metric over the logs."""
    planners = list(dict.fromkeys((drive.planner, drive.oracle) for drive in result.drives))
    values = _values(result.table)
    table = _grid()
    table.add_column("over all logs")
    for planner, oracle in planners:
        table.add_column(marked(planner, oracle=oracle), justify="right", overflow="fold")
    modes = {mode.value for mode in result.run.modes}
    for label, mode, metric, reduce in COMPARED:
        if mode in modes:
            found = [[v for (_, p, m, name), v in values.items() if (p, m, name) == (planner, mode, metric)]
                     for planner, _ in planners]  # fmt: skip
            table.add_row(Text(label), *(reduce(column) if column else NOTHING for column in found))
    return table


COMPARED: tuple[tuple[str, str, str, Callable[[list[float]], str]], ...] = (
    ("ADE over 3 s, mean [m] (open)", "open", "ade.3s.mean", lambda v: f"{sum(v) / len(v):.2f}"),
    ("frames with fallback, mean (open)", "open", "fallback.rate", lambda v: _percent(sum(v) / len(v))),
    ("goal reached (closed)", "closed", "goal.final", lambda v: f"{sum(v):.0f} of {len(v)}"),
    ("collisions at fault (closed)", "closed", "collision_at_fault.count", lambda v: f"{sum(v):.0f}"),
    ("least gap [m] (closed)", "closed", "gap.min", lambda v: f"{min(v):.2f}"),
    ("off plan, worst [m] (closed)", "closed", "tracking_lateral.max_abs", lambda v: f"{max(v):.2f}"),
    ("least TTC [s] (closed)", "closed", "ttc.min", lambda v: f"{min(v):.1f}"),
    ("run into by the replay (closed)", "closed", "replay_contact.final", lambda v: f"{sum(v):.0f}"),
    (
        "jerk beyond 4.13 m/s3, worst [s] (closed)",
        "closed",
        "lon_jerk_state.time_out_of_bounds",
        lambda v: f"{max(v):.1f}",
    ),
    ("frames with fallback, mean (closed)", "closed", "fallback.rate", lambda v: _percent(sum(v) / len(v))),
)


def _latency(result: RunResult) -> Table:
    """p50, p95, p99 of each stage, over all frames of both loops."""
    table = _grid()
    for title in ("planner", "stage"):
        table.add_column(title, overflow="fold")
    for title in ("p50 [ms]", "p95 [ms]", "p99 [ms]", "share"):
        table.add_column(Text(title), justify="right")
    for planner, rows in result.timings.groupby("planner", sort=False, observed=True):
        whole = float(rows.loc[rows["stage"] == "total", "seconds"].sum())
        by_stage = rows.groupby("stage", sort=False, observed=True)["seconds"]
        for stage, times in sorted(by_stage, key=lambda one: one[0] == "total"):
            quantiles = (f"{1e3 * times.quantile(q):.2f}" for q in (0.5, 0.95, 0.99))
            share = f"{100.0 * times.sum() / whole:.0f}%" if whole > 0.0 else NOTHING
            last = stage == "total"
            table.add_row(str(planner), str(stage), *quantiles, share, style="bold" if last else "", end_section=last)
    return table


SAYS = {"pass": "pass", "fail": "FAIL", "inconclusive": "inconcl."}
STYLES = {Outcome.PASS: "green", Outcome.FAIL: "bold red", Outcome.INCONCLUSIVE: "yellow"}


def _gates(result: RunResult) -> RenderableType:
    """What is not passed first, in full."""
    units = dict(zip(result.table["metric"], result.table["unit"], strict=True)) if len(result.table) else {}
    table = _grid()
    for title in ("outcome", "rule", "what was found"):
        table.add_column(title, overflow="fold", no_wrap=title == "outcome")
    for verdict in sorted(result.verdicts, key=lambda verdict: _ORDER.index(verdict.outcome)):
        word = Text(verdict.outcome.value.upper(), style=STYLES[verdict.outcome])
        table.add_row(word, Text(str(verdict.gate)), Text(_found(verdict, units.get(verdict.gate.metric, ""))))
    return table


def _coverage(result: RunResult) -> Iterator[RenderableType]:
    """What the verdicts rest on: seconds driven of those logged, by planner and loop."""
    values = _values(result.table)
    for planner, mode in dict.fromkeys((drive.planner, drive.mode) for drive in result.drives):
        driven, logged = (
            [v for (_, p, m, name), v in values.items() if (p, m, name) == (planner, mode, f"coverage.{part}.final")]
            for part in ("driven_s", "log_s")
        )
        if logged:
            word = "planned along" if mode == "open" else "driven"
            seconds = f"{sum(driven):.0f} of {sum(logged):.0f} s"
            logs = f"{len(logged)} {'log' if len(logged) == 1 else 'logs'}"
            yield Text(f"{planner}, {mode} loop: {seconds} {word} in {logs}", style="dim")


_ORDER = (Outcome.FAIL, Outcome.INCONCLUSIVE, Outcome.PASS)


def _found(verdict: Verdict, unit: str) -> str:
    """The verdict's reason; of a pass only the value that came nearest to the bound."""
    if verdict.outcome is not Outcome.PASS:
        why = verdict.outcome is Outcome.FAIL and verdict.gate.reason
        return f"{verdict.reason} (the gate: {why})" if why else verdict.reason
    value = 0.0 if abs(verdict.value) < 1e-9 else verdict.value
    shown = f"{value:.3g}" + (f" {unit}" if unit not in ("", "1", "count") else "")
    lacking = sum(log.outcome is Outcome.INCONCLUSIVE for log in verdict.logs)
    aside = f"; no evidence in {lacking} of {len(verdict.logs)} logs" if lacking else ""
    return f"{verdict.planner}: {shown}" + (f", on {verdict.log}" if value else "") + aside


def _ensemble(result: RunResult) -> Iterator[RenderableType]:
    """How many verdicts hold in the worlds that should not matter, and which do not."""
    rows = result.table[(result.table["metric"] == "ensemble.fragile") & result.table["available"].astype(bool)]
    if len(rows):
        fragile = rows[rows["value"] > 0.0]
        lines = [f"{row.log} [{row.planner}, {row.mode} loop]: {row.reason}" for row in fragile.itertuples()]
        more = [f"{len(lines) - MAX_ROWS} more: metrics.csv"] if len(lines) > MAX_ROWS else []
        title = f"Ensemble: {len(fragile)} of {len(rows)} verdicts are fragile"
        yield from _titled(title, *(_indented(line) for line in (*lines[:MAX_ROWS], *more)))


def _notes(result: RunResult) -> Iterator[RenderableType]:
    """Every note once, with how many logs it concerns; notes that differ in numbers only are one."""
    logs: Counter[str] = Counter()
    texts: dict[str, set[str]] = {}
    for log in result.logs:
        notes = {re.sub(r"[\d.]*\d", "#", note): note for note in (*log.notes, *_driving_notes(log))}
        logs.update(notes.keys())
        for key, note in notes.items():
            texts.setdefault(key, set()).add(note)
    if logs:
        lines = [f"{_example(texts[key])} ({count} of {len(result.logs)} logs)" for key, count in logs.most_common()]
        more = [f"{len(lines) - MAX_NOTES} more: summary.json"] if len(lines) > MAX_NOTES else []
        yield from _titled("Notes", *(_indented(line) for line in (*lines[:MAX_NOTES], *more)))


def _driving_notes(log: LogResult) -> Iterator[str]:
    return (note for drive in log.drives for note in drive.notes)


def _example(notes: set[str]) -> str:
    first = min(notes).rstrip(".")
    return first if len(notes) == 1 else f"for example: {first}"


def _failures(result: RunResult) -> Iterator[RenderableType]:
    if result.failures:
        lines = [failure.line for failure in result.failures]
        more = [f"{len(lines) - MAX_ROWS} more: summary.json"] if len(lines) > MAX_ROWS else []
        title = f"Could not be evaluated ({len(lines)})"
        yield from _titled(title, *(_indented(line) for line in (*lines[:MAX_ROWS], *more)))


def _indented(line: str) -> Padding:
    return Padding(Text(line), (0, 0, 0, 2))


def _ending(result: RunResult) -> Iterator[RenderableType]:
    recordings = _worth_a_look(result)
    yield Text(f"Results: {result.out}  (metrics.csv, summary.json, a folder per log)")
    if result.resumed:
        yield Text(f"Resumed: {result.resumed} of {len(result.logs)} logs are those of the interrupted run")
    if recordings:
        yield Text.assemble("Look at a drive:  ", (f"replan view {result.out / recordings[0]}", "bold"))
    code = result.exit_code
    yield Text(f"Outcome: {result.outcome.upper()} (exit code {code})", style="bold green" if code == 0 else "bold red")


def _worth_a_look(result: RunResult) -> list[str]:
    """Recordings, those of the gates' worst failures first, closed loop before open."""
    failed = [(v.log, v.planner) for v in result.verdicts if v.outcome is Outcome.FAIL]
    drives = sorted(result.drives, key=lambda drive: ((drive.log, drive.planner) not in failed[:1], drive.mode))
    return [file for drive in drives for file in drive.files if file.endswith(".rrd")]
