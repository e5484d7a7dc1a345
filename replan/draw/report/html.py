"""The report as one HTML file: it opens from disk, makes no request to any network, and is readable
without script.

It has an overview, a comparison if there is a baseline, and a page per drive; charts of pass
shares, of distributions over the logs, and of changes of metrics. The page, its style and its
script are in templates/ (jinja2, everything escaped). An error in one part removes that part, never
the report.
"""

from __future__ import annotations

import os
import shlex
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from importlib import resources
from itertools import chain, islice
from math import isfinite, nan
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import quote

import numpy as np
import pandas as pd
from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup

from replan.core.errors import (
    ConfigError,
    LogError,
    OutputError,
    ReplanError,
    described,
    raised,
    writing,
)
from replan.core.names import counted
from replan.draw.charts import subject
from replan.draw.charts.axes import Plane, Ticks, rows_plane
from replan.draw.charts.bird_view import place_of_moment
from replan.draw.charts.canvas import RULES, Chart, dot, filled, line, printable, rect, roles, text
from replan.draw.charts.layout import BROKEN, placed
from replan.draw.charts.subject import Subject
from replan.draw.drawn_results import DriveResult, Results
from replan.draw.model import Span, widened
from replan.draw.report.contents import DriveRow, MetricColumn, Overview, PassShare
from replan.draw.report.sections import comparison_sections, run_sections
from replan.explain.drive_events import TimedEvent, events
from replan.metrics.comparison import Comparison
from replan.metrics.judge.gates import Outcome
from replan.results.tables import numbered, safe_name, write_text

T = TypeVar("T")

MOST_MOVED = 6  # Largest number of metrics of a comparison that are drawn
# Largest number of events that are listed; the page gives the number of the others
MOST_EVENTS = 60
_WEIGHT = {outcome.value: weight for weight, outcome in enumerate(Outcome)}


class Attempts:
    """Makes parts of a report, and records the parts that fail."""

    def __init__(self) -> None:
        self.broken: list[str] = []  # a sentence for each part that could not be made

    def __call__(self, what: str, make: Callable[[], T], instead: T) -> T:
        """The result of `make`; if it raises, `instead`, and a sentence in `broken`.

        ConfigError as `make`: the user named something that does not exist; OutputError as `make`:
        nothing can be written.
        """
        try:
            return make()
        except (ConfigError, OutputError):
            raise
        except Exception as error:
            why = str(error) if isinstance(error, LogError) else raised(error)
            self.broken.append(f"{what} could not be made: {why}")
            return instead


def write_html(
    overview: Overview, results: Results, path: Path, *, drives: int = 100
) -> tuple[str, ...]:
    """Write the report as one HTML file; the same run gives the same bytes.

    OutputError if the file cannot be written.

    `overview`: the overview of the results, with its comparison, if there is one. `path`: the file;
    links to recordings are relative to it. `drives`: the number of drives with a page, the worst
    first; the table has all of them.

    Returns:
        A sentence for each chart that could not be drawn, with the number of drives.
    """
    broken = Counter[str]()

    def pages() -> Iterator[DrivePage]:
        for row in paged:
            anchor, attempt = anchors[row.log, row.planner], Attempts()
            made = attempt(
                "The page of a drive", partial(drive_page, results, row, anchor, path), None
            )
            page = (
                DrivePage(anchor, row, why=attempt.broken[0], broken=(attempt.broken[0],))
                if made is None
                else made
            )
            broken.update(page.broken)
            yield page

    paged = overview.ranked[:drives]
    anchors, shares = dict[tuple[str, str], str](), [*overview.whole, *overview.grouped]
    names = numbered(f"drive/{safe_name(row.log)}/{safe_name(row.planner)}" for row in paged)
    for row, name in zip(paged, names, strict=True):
        anchors[row.log, row.planner] = name
    attempt = Attempts()
    share = attempt(
        "The chart of shares",
        lambda: _markup(pass_shares(shares, len(overview.planners))),
        Markup(),
    )
    drawn = attempt(
        "The charts of distributions",
        lambda: distributions(overview.columns, overview.drives),
        list[Chart](),
    )
    made = pages()
    first = list(islice(made, sum(row in overview.first for row in paged)))
    page = rendered(
        "report.html",
        overview=overview,
        first=first,
        shares=share if shares else "",
        distributions=[_markup(chart) for chart in drawn],
        anchors=anchors,
        pages=chain(first, made),
        paged=paged,
        sections=run_sections(overview),
        compared=[] if overview.comparison is None else comparison_sections(overview.comparison),
        moved=[] if overview.comparison is None else _moved(overview.comparison),
    )
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, page)
    each = (
        f"{error} ({times} of {counted(len(paged), 'drive')})" for error, times in broken.items()
    )
    return (*attempt.broken, *each)


def rendered(template: str, **content: Any) -> str:
    """A page of templates/, with the style and the script of all pages."""
    # Files of replan: no escaping
    style = Markup(_read("style.css") + roles("auto") + filled(RULES, "auto"))
    return (
        _environment()
        .get_template(template)
        .render(style=style, script=Markup(_read("script.js")), **content)
    )


def _markup(chart: Chart) -> Markup:
    return Markup(chart.inline())  # canvas escapes every word


def _moved(comparison: Comparison) -> list[Markup]:
    """A chart for each of the metrics, planners and loops with the largest changes.

    Those of gates come first.
    """
    pairs = comparison.pairs
    both = pairs[pairs["baseline"].notna() & pairs["candidate"].notna() & (pairs["delta"] != 0.0)]
    both = both[both["worse"].notna()]
    keys = list(dict.fromkeys(zip(both["metric"], both["planner"], both["mode"], strict=True)))[
        :MOST_MOVED
    ]
    return [
        _markup(
            moved(
                both[(both["metric"] == m) & (both["planner"] == p) & (both["mode"] == mode)],
                f"{m}, {p}, {mode} loop",
            )
        )
        for m, p, mode in keys
    ]


def _read(name: str) -> str:
    return (
        resources.files("replan.draw.report")
        .joinpath("templates", name)
        .read_text(encoding="utf-8")
    )


@cache
def _environment() -> Environment:
    found = Environment(
        loader=FunctionLoader(_read),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )

    def number(value: object) -> str:
        """Four digits; "-" for a missing value."""
        if not isinstance(value, (int, float)) or not isfinite(value):
            return "-"
        return f"{0.0 if abs(value) < 1e-12 else value:.4g}"

    def seconds(value: float) -> str:
        return f"{value:.2f} s" if isfinite(value) else ""

    def unit(name: str) -> str:
        return "" if name in ("", "1", "count") else f" {name}"

    def sorts(value: float) -> str:
        """The sort key of a cell; an empty key is last."""
        return f"{value:.9g}" if isfinite(value) else ""

    found.filters |= {
        "number": number,
        "seconds": seconds,
        "unit": unit,
        "line": printable,
        "sorts": sorts,
    }
    return found


# the page of a drive ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Recording:
    """A file to open: its name and loop, a link relative to the page, and the command that opens
    it.
    """

    name: str
    mode: str
    href: str
    command: str


@dataclass(frozen=True, eq=False)
class DrivePage:
    """The contents of the page of a drive."""

    anchor: str
    row: DriveRow
    mode: str = ""
    tags: tuple[str, ...] = ()
    time_s: float = nan  # The moment of the pictures; NaN if there are none
    why: str = ""  # The reason for this moment; if there are no pictures, the reason for that
    # The action of the plan at this moment, and its reasons, in sentences
    because: tuple[str, ...] = ()
    end: str = ""
    # The rows of `DriveResult.verdicts` of both loops, failed ones first
    verdicts: tuple[Any, ...] = ()
    # Charts of scenes and graphs; `decided` and `curves` follow them
    pictures: tuple[Markup, ...] = ()
    scene: int = 0  # Index of the scene at the moment among them
    decided: Markup = field(default_factory=Markup)
    curves: tuple[Markup, ...] = ()
    events: tuple[TimedEvent, ...] = ()  # The changes, with their times
    more_events: int = 0  # The number of events that are left out
    # The rows of the available metrics of each loop
    metrics: tuple[tuple[str, tuple[Any, ...]], ...] = ()
    # Each reason, and the metrics that are not available because of it
    missing: tuple[tuple[str, str], ...] = ()
    files: tuple[Recording, ...] = ()
    plot: str = ""  # The command that draws the same pictures
    broken: tuple[str, ...] = ()  # Charts that could not be drawn, a sentence each

    @property
    def failed(self) -> tuple[Any, ...]:
        """Verdicts that fail or are inconclusive."""
        good = (Outcome.PASS.value, Outcome.NOT_ASKED.value)
        return tuple(line for line in self.verdicts if line.outcome not in good)

    @property
    def passed(self) -> tuple[Any, ...]:
        """Verdicts that pass."""
        return tuple(line for line in self.verdicts if line.outcome == Outcome.PASS.value)

    @property
    def not_asked(self) -> tuple[Any, ...]:
        """Verdicts of gates that do not apply to this drive."""
        return tuple(line for line in self.verdicts if line.outcome == Outcome.NOT_ASKED.value)


def drive_page(results: Results, row: DriveRow, anchor: str, page: Path) -> DrivePage:
    """The page of a log and a planner; the pictures are of the loop in which a gate failed, the
    closed one first.

    `page`: the file of the report: links are relative to it.
    """
    mine = results.drives[
        (results.drives["log"] == row.log) & (results.drives["planner"] == row.planner)
    ]
    drives = [
        results.drive(row.log, row.planner, mode)
        for mode in ("closed", "open")
        if mode in set(mine["mode"])
    ]
    failed = (drive for drive in drives if (drive.verdicts["outcome"] == Outcome.FAIL.value).any())
    shown = next(failed, drives[0])
    attempt = Attempts()
    seen, why = _subject(shown)

    def changed() -> list[TimedEvent]:
        if seen is None:
            return []
        short = seen.scenario.short_names
        return [
            replace(event, words=short(event.words)) for event in events(seen.trace, seen.plans)
        ]

    found = attempt("The list of events", changed, list[TimedEvent]())
    because = attempt(
        "The account of the plan", lambda: seen.because if seen else (), tuple[str, ...]()
    )
    charts = placed(seen, results.run.charts) if seen else {}
    markup = {place: tuple(map(_markup, some)) for place, some in charts.items()}
    verdicts, metrics, missing, files = list[Any](), [], dict[str, list[str]](), []
    for drive in drives:
        verdicts += sorted(
            drive.verdicts.itertuples(index=False), key=lambda line: _WEIGHT[line.outcome]
        )
        table, available = drive.metrics, drive.metrics["available"].astype(bool)
        metrics.append((drive.mode, tuple(table[available].itertuples(index=False))))
        for reason, metric in table[~available][["reason", "metric"]].itertuples(index=False):
            missing.setdefault(reason, []).append(metric)
        # the recording, or the trace if there is none
        for file in sorted(drive.info["files"], key=lambda file: not file.endswith(".rrd"))[:1]:
            near = _relative(results.path / file, page)
            files.append(
                Recording(file, drive.mode, quote(near), f"replan view {shlex.quote(near)}")
            )
    plot = ""
    if seen:
        words = [
            "replan",
            "plot",
            _relative(results.path, page),
            "--log",
            row.log,
            "--planner",
            row.planner,
        ]
        at = f"{seen.moment.t:.2f}" if isfinite(seen.moment.t) else "0"
        plot = shlex.join([*words, "--mode", seen.drive.mode, "--at", at])
    labels = results.labels.get(row.log)
    detail = f": {shown.info['detail']}" if shown.info["detail"] else ""
    return DrivePage(
        anchor,
        row,
        shown.mode,
        labels.tags if labels else (),
        seen.moment.t if seen else nan,
        seen.moment.why if seen else why,
        because,
        f"{shown.info['end']}{detail}, after {shown.info['t_end_s']:.2f} s",
        tuple(verdicts),
        markup.get("pictures", ()),
        place_of_moment(seen) if seen else 0,
        Markup().join(markup.get("decided", ())),
        markup.get("curves", ()),
        tuple(found[:MOST_EVENTS]),
        max(len(found) - MOST_EVENTS, 0),
        tuple(metrics),
        tuple((reason, ", ".join(dict.fromkeys(names))) for reason, names in missing.items()),
        tuple(files),
        plot,
        (
            *(chart.says for some in charts.values() for chart in some if chart.name == BROKEN),
            *attempt.broken,
        ),
    )


def _subject(drive: DriveResult) -> tuple[Subject | None, str]:
    """The subject of a drive's pictures; None if it cannot be made, and why."""
    try:
        return subject(drive), ""
    except ReplanError as error:
        return None, f"no pictures: {error.what if isinstance(error, LogError) else error}"
    except Exception as error:
        return None, f"no pictures: {described(error)}"


def _relative(file: Path, page: Path) -> str:
    return Path(os.path.relpath(file, page.parent)).as_posix()


WIDTH_PX, WIDE_PX, ROW_PX = 440.0, 640.0, 19.0
LABEL_SHARE = 0.4  # The largest share of the width for names
MAX_SHARES, MAX_PAIRS = 40, 20
FEW = 5  # A box of quartiles is drawn for more values than this


def pass_shares(shares: Sequence[PassShare], planners: int) -> Chart:
    """The share of logs that pass, with its 95 % interval, by group: a dot, a whisker, and
    counts.
    """
    shown = shares[:MAX_SHARES]
    names = [f"{share.name}, {share.planner}" if planners > 1 else share.name for share in shown]
    plane, ticks = _rows(names, (-2.0, 102.0), width=WIDE_PX)
    marks, counts = [], []
    for k, share in enumerate(shown):
        y = ROW_PX * (k + 0.5)
        low, at, high = plane.at_x(100.0 * np.array([share.low, share.share, share.high])).tolist()
        kind = "mark" if share.passed == share.logs else "hollow"
        marks.append(line(low, y, high, y, "whisker") + line(low, y - 4, low, y + 4, "whisker"))
        marks.append(
            line(high, y - 4, high, y + 4, "whisker")
            + dot(at, y, 4.5, kind, f"{share.name}: {share.text}")
        )
        words, wide = f"{share.passed}/{share.logs}", plane.inner[0]
        beside = low - 6.0 if high > wide - 50.0 else high + 6.0
        counts.append(text(beside, y + 3.5, words, "small end" if high > wide - 50.0 else "small"))
    title = "Logs that pass, with the 95 % interval of the share"
    entries = [("dot", "mark", "all pass"), ("dot", "hollow", "some do not")]
    says = f"{title}: " + "; ".join(
        f"{name}: {share.text}" for name, share in zip(names, shown, strict=True)
    )
    axes = dict[str, Any](entries=entries, x_title="share [%]", y_ticks=ticks, over="".join(counts))
    return plane.chart("pass_shares", title, "".join(marks), says=says, **axes)


def distributions(columns: Sequence[MetricColumn], drives: Sequence[DriveRow]) -> list[Chart]:
    """One chart per column of the table of drives that has at least three different values.

    A row per planner: a dot per log, and the box of the quartiles with the median.
    """
    out = []
    for i, column in enumerate(columns):
        strips: dict[str, list[tuple[float, str]]] = {drive.shown: [] for drive in drives}
        for drive in drives:
            if np.isfinite(drive.cells[i].value):
                strips[drive.shown].append((drive.cells[i].value, drive.log))
        strips = {planner: strip for planner, strip in strips.items() if strip}
        if len({value for strip in strips.values() for value, _ in strip}) < 3:
            continue
        names, values = (
            list(strips),
            [np.array([value for value, _ in strip]) for strip in strips.values()],
        )
        least, most = float(min(v.min() for v in values)), float(max(v.max() for v in values))
        low, high = widened(least, most, 1e-3, 0.04)
        plane, ticks = _rows(
            names, (min(low, 0.0) if least >= 0.0 and low < 0.0 else low, high), top=22.0
        )
        marks = ""
        for k, (some, strip) in enumerate(zip(values, strips.values(), strict=True)):
            middle = ROW_PX * (k + 0.5)
            if len(some) > FEW:
                left, median, right = plane.at_x(np.percentile(some, (25.0, 50.0, 75.0))).tolist()
                marks += rect(left, middle - 6.0, right - left, 12.0, "box")
                marks += line(median, middle - 6.0, median, middle + 6.0, "whisker")
            order = np.argsort(some, kind="stable")
            away = np.array([0.0, -3.0, 3.0])[np.arange(len(order)) % 3]
            for n, x, offset in zip(
                order, plane.at_x(some[order]).tolist(), away.tolist(), strict=True
            ):
                marks += dot(x, middle + offset, 2.6, "speck", f"{strip[n][1]}: {some[n]:.4g}")
        title = f"{column.words}, {column.mode} loop"
        says = f"{title}: " + "; ".join(
            (
                f"{name}: {some.min():.3g} to {some.max():.3g}, median {np.median(some):.3g}, "
                f"{counted(len(some), 'log')}"
            )
            for name, some in zip(names, values, strict=True)
        )
        x_title = f"{column.metric}, a dot a log"
        out.append(
            plane.chart(column.metric, title, marks, says=says, x_title=x_title, y_ticks=ticks)
        )
    return out


def moved(pairs: pd.DataFrame, title: str) -> Chart:
    """One metric from baseline to candidate, the worst regression first.

    `pairs`: rows of `Comparison.pairs` of one metric, with both values. `title`: title of the
    chart.
    """
    shown = pairs.sort_values(["worse", "log"], ascending=[False, True], kind="stable").head(
        MAX_PAIRS
    )
    names = [str(log) for log in shown["log"]]
    both = shown[["baseline", "candidate"]].to_numpy(np.float64)
    plane, ticks = _rows(names, widened(float(both.min()), float(both.max()), 1e-6))
    marks, rows = [], list[Any](shown.itertuples())
    for k, (row, (before, now)) in enumerate(zip(rows, plane.at_x(both).tolist(), strict=True)):
        y, kind = ROW_PX * (k + 0.5), "worse" if row.worse > 0.0 else "better"
        marks.append(
            line(before, y, now, y, kind)
            + dot(before, y, 4.0, "hollow", f"baseline {row.baseline:.4g}")
        )
        marks.append(
            dot(
                now,
                y,
                4.0,
                "wrong" if row.worse > 0.0 else "mark",
                f"candidate {row.candidate:.4g}",
            )
        )
    unit = str(shown["unit"].iloc[0])
    x_title = f"{shown['metric'].iloc[0]}{f' [{unit}]' if unit not in ('', '1', 'count') else ''}"
    says = f"{title}: " + "; ".join(f"{r.log} {r.baseline:.3g} to {r.candidate:.3g}" for r in rows)
    axes = dict[str, Any](entries=_MOVED, x_title=x_title, y_ticks=ticks)
    return plane.chart(str(shown["metric"].iloc[0]), title, "".join(marks), says=says, **axes)


def _rows(
    names: Sequence[str], x: Span, *, top: float = 40.0, width: float = WIDTH_PX
) -> tuple[Plane, Ticks]:
    return rows_plane(names, x, width, ROW_PX, top=top, most=LABEL_SHARE * width)


_MOVED = (
    ("dot", "hollow", "baseline"),
    ("dot", "mark", "candidate"),
    ("line", "better", "better"),
    ("line", "worse", "worse"),
)
