"""The page of a drive: why it is judged as it is, its pictures, what was decided, its metrics, and where to look on."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pandas as pd
from markupsafe import Markup

from logs.errors import LogError, ReplanError, raised
from metrics.judge.gates import Outcome
from replay.draw.charts import Chart, subject
from replay.draw.charts.layout import BROKEN, placed
from replay.draw.charts.subject import Subject
from replay.draw.recording.events import Event, events
from replay.draw.report.attempts import Attempts
from replay.draw.report.model import DriveRow
from replay.results.load import DriveResult, Results

MOST_EVENTS = 60
"""Events on a page; what is beyond is counted."""
_WEIGHT = {outcome.value: weight for weight, outcome in enumerate(Outcome)}


@dataclass(frozen=True)
class VerdictLine:
    """What a gate says of this drive."""

    gate: str
    mode: str
    outcome: str
    value: float
    time_s: float
    reason: str


@dataclass(frozen=True)
class MetricLine:
    """One metric of this drive."""

    metric: str
    value: float
    unit: str
    time_s: float
    reason: str


@dataclass(frozen=True)
class Recording:
    """A file to look at: its name and loop, a link relative to the page, and the command that opens it."""

    name: str
    mode: str
    href: str
    command: str


@dataclass(frozen=True, eq=False)
class DrivePage:
    """All that the page of a drive shows.

    Attributes:
        anchor: Its id in the page.
        row: Of the overview.
        mode: Which loop the pictures are of.
        tags: Words of the log.
        time_s: The moment that is looked at; NaN where there are no pictures.
        why: Why that one; where there are no pictures, why not.
        because: What the plan does there, and why, in sentences.
        end: How the drive ended.
        verdicts: Of both loops, failed ones first.
        pictures: Scenes and graphs; then `decided`, and `curves`.
        events: What changed, when.
        more_events: How many are left out.
        metrics: By loop, those that are available.
        missing: Reason, and the metrics that are not available for it.
        files: Recordings, else traces.
        plot: The command that draws the same pictures.
        broken: Charts that could not be drawn, a sentence each.
    """

    anchor: str
    row: DriveRow
    mode: str
    tags: tuple[str, ...]
    time_s: float
    why: str
    because: tuple[str, ...]
    end: str
    verdicts: tuple[VerdictLine, ...]
    pictures: tuple[Markup, ...]
    decided: Markup
    curves: tuple[Markup, ...]
    events: tuple[Event, ...]
    more_events: int
    metrics: tuple[tuple[str, tuple[MetricLine, ...]], ...]
    missing: tuple[tuple[str, str], ...]
    files: tuple[Recording, ...]
    plot: str
    broken: tuple[str, ...]

    @property
    def failed(self) -> tuple[VerdictLine, ...]:
        """Verdicts that fail or are inconclusive."""
        good = (Outcome.PASS.value, Outcome.NOT_ASKED.value)
        return tuple(line for line in self.verdicts if line.outcome not in good)

    @property
    def passed(self) -> tuple[VerdictLine, ...]:
        """Verdicts that pass."""
        return tuple(line for line in self.verdicts if line.outcome == Outcome.PASS.value)

    @property
    def not_asked(self) -> tuple[VerdictLine, ...]:
        """Gates that were not asked of this drive."""
        return tuple(line for line in self.verdicts if line.outcome == Outcome.NOT_ASKED.value)


def drive_page(results: Results, row: DriveRow, anchor: str, page: Path) -> DrivePage:
    """The page of a log and a planner; the pictures are of the loop in which a gate failed, the closed one first.

    Args:
        results: The run.
        row: Of the overview.
        anchor: Its id in the page.
        page: Where the page will be: links are relative to it.
    """
    mine = results.drives[(results.drives["log"] == row.log) & (results.drives["planner"] == row.planner)]
    drives = [results.drive(row.log, row.planner, mode) for mode in ("closed", "open") if mode in set(mine["mode"])]
    shown = next((drive for drive in drives if _fails(drive)), drives[0])
    attempt = Attempts()
    seen, why = _subject(shown)
    found = attempt("The list of events", lambda: _events(seen) if seen else [], list[Event]())
    because = attempt("The account of the plan", lambda: seen.because if seen else (), tuple[str, ...]())
    charts = placed(seen, results.run.charts) if seen else {}
    labels = results.labels.get(row.log)
    detail = f": {shown.info['detail']}" if shown.info["detail"] else ""
    return DrivePage(
        anchor, row, shown.mode, labels.tags if labels else (),
        seen.moment.t if seen else float("nan"), seen.moment.why if seen else why,
        because,
        f"{shown.info['end']}{detail}, after {shown.info['t_end_s']:.2f} s",
        tuple(line for drive in drives for line in _verdicts(drive.verdicts)),
        _drawn(charts.get("pictures", ())), Markup().join(_drawn(charts.get("decided", ()))),
        _drawn(charts.get("curves", ())),
        tuple(found[:MOST_EVENTS]), max(len(found) - MOST_EVENTS, 0),
        tuple((drive.mode, tuple(_metrics(drive))) for drive in drives),
        tuple(_missing(drives)), tuple(_files(results, drives, page)), _plot(results, row, seen, page),
        (*(chart.says for some in charts.values() for chart in some if chart.name == BROKEN), *attempt.broken),
    )  # fmt: skip


def failed_page(row: DriveRow, anchor: str, why: str) -> DrivePage:
    """The page of a drive of which no other can be made: it says why."""
    nothing = Markup()
    return DrivePage(
        anchor, row, "", (), float("nan"), why, (), "", (), (), nothing, (), (), 0, (), (), (), "", (why,)
    )  # fmt: skip


def _subject(drive: DriveResult) -> tuple[Subject | None, str]:
    """What the pictures of a drive are drawn from; None where it cannot be made, and why."""
    try:
        return subject(drive), ""
    except ReplanError as error:
        return None, f"no pictures: {error.what if isinstance(error, LogError) else error}"
    except Exception as error:
        return None, f"no pictures: a bug in replan: {raised(error)}"


def _events(seen: Subject) -> list[Event]:
    short = seen.scenario.short_names
    return [replace(event, words=short(event.words)) for event in events(seen.trace, seen.said)]


def _drawn(charts: Sequence[Chart]) -> tuple[Markup, ...]:
    return tuple(Markup(chart.inline()) for chart in charts)  # canvas escapes every word


def _fails(drive: DriveResult) -> bool:
    return bool((drive.verdicts["outcome"] == Outcome.FAIL.value).any())


def _verdicts(table: pd.DataFrame) -> list[VerdictLine]:
    lines = [VerdictLine(v.gate, v.mode, v.outcome, float(v.value), float(v.time_s), v.reason) for v in _rows(table)]
    return sorted(lines, key=lambda line: _WEIGHT[line.outcome])


def _rows(table: pd.DataFrame) -> Iterator[Any]:
    return table.itertuples(index=False)


def _metrics(drive: DriveResult) -> Iterator[MetricLine]:
    table = drive.metrics[drive.metrics["available"].astype(bool)]
    columns = (table[name].tolist() for name in ("metric", "value", "unit", "time_s", "reason"))
    return (MetricLine(*row) for row in zip(*columns, strict=True))


def _missing(drives: Sequence[DriveResult]) -> Iterator[tuple[str, str]]:
    """Why metrics are not available, and which, both loops together."""
    by_reason: dict[str, list[str]] = {}
    for drive in drives:
        lacking = drive.metrics[~drive.metrics["available"].astype(bool)]
        for reason, metric in zip(lacking["reason"].tolist(), lacking["metric"].tolist(), strict=True):
            by_reason.setdefault(reason, []).append(metric)
    for reason, names in by_reason.items():
        yield reason, ", ".join(dict.fromkeys(names))


def _relative(file: Path, page: Path) -> str:
    """A file as it is reached from where the page is."""
    return Path(os.path.relpath(file, page.parent)).as_posix()


def _files(results: Results, drives: Sequence[DriveResult], page: Path) -> Iterator[Recording]:
    """The recording of each loop, the trace where there is none."""
    for drive in drives:
        files = sorted(drive.info["files"], key=lambda file: not file.endswith(".rrd"))
        for file in files[:1]:
            near = _relative(results.path / file, page)
            yield Recording(file, drive.mode, quote(near), f"replan view {shlex.quote(near)}")


def _plot(results: Results, row: DriveRow, seen: Subject | None, page: Path) -> str:
    if seen is None:
        return ""
    words = ["replan", "plot", _relative(results.path, page), "--log", row.log, "--planner", row.planner]
    at = f"{seen.moment.t:.2f}" if isfinite(seen.moment.t) else "0"
    return shlex.join([*words, "--mode", seen.drive.mode, "--at", at])
