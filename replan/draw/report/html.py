"""The report as one HTML file: it opens from disk, makes no request to any network, and is readable
without script.

It has an overview, a comparison if there is a baseline, and a page per drive; charts of pass
shares, of distributions over the logs, and of changes of metrics. The page, its style and its
script are in templates/ (jinja2, everything escaped). An error in one part removes that part, never
the report.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from functools import partial
from itertools import chain, islice
from pathlib import Path

from replan.core.errors import writing
from replan.core.names import counted
from replan.draw.charts.chart import Chart
from replan.draw.report.attempts import Attempts
from replan.draw.report.comparison_sections import comparison_sections
from replan.draw.report.drive_page import DrivePage, chart_markup, drive_page
from replan.draw.report.overview import Overview
from replan.draw.report.rendering import rendered
from replan.draw.report.run_sections import BROKEN, run_sections
from replan.draw.report.section import ReportSection, with_contents
from replan.draw.report.summary_charts import distributions, most_moved, pass_shares
from replan.results.tables import numbered, safe_name, write_text

# Largest number of events that are listed; the page gives the number of the others
MOST_EVENTS = 60


def write_html(over: Overview, path: Path, *, drives: int = 100) -> tuple[str, ...]:
    """Write the report as one HTML file; the same run gives the same bytes.

    OutputError if the file cannot be written.

    `over`: the overview of a run, with its comparison, if there is one. `path`: the file; links to
    recordings are relative to it. `drives`: the number of drives with a page, the worst first; the
    table has all of them.

    Returns:
        A sentence for each part that could not be made, with the number of drives.
    """
    rows, comparison, broken = over.drives[:drives], over.comparison, Counter[str]()
    names = numbered(f"drive/{safe_name(row.log)}/{safe_name(row.planner)}" for row in rows)
    anchors = {(row.log, row.planner): name for row, name in zip(rows, names, strict=True)}
    attempt = Attempts()
    shares = attempt("The chart of shares", lambda: pass_shares(over), None)
    strips = attempt("The charts of distributions", lambda: distributions(over), list[Chart]())
    sections = attempt("The tables of the run", lambda: run_sections(over), list[ReportSection]())
    compared: list[ReportSection] = []
    moved: list[Chart] | None = None
    if comparison:
        compared = attempt("The comparison", lambda: comparison_sections(comparison), compared)
        moved = attempt("The charts of changes", lambda: list(most_moved(comparison)), None)
    sections += with_contents([ReportSection(BROKEN, lines=attempt.broken)])

    def pages() -> Iterator[DrivePage]:
        for row in rows:
            anchor, of_page = anchors[row.log, row.planner], Attempts()
            make = partial(drive_page, over.results, row, anchor, reads_input=row in over.first)
            page = of_page("The page of a drive", make, None)
            if page is None:
                page = DrivePage(anchor, row, why=of_page.broken[0], broken=of_page.broken)
            broken.update(page.broken)
            yield page

    rest = pages()
    first = list(islice(rest, min(len(over.first), len(rows))))
    content = rendered(
        "report.html",
        overview=over,
        logs=counted(len(over.results.logs), "log"),
        link=lambda file: Path(os.path.relpath(over.results.path / file, path.parent)).as_posix(),
        most_events=MOST_EVENTS,
        first=first,
        shares=chart_markup(shares) if shares else "",
        distributions=[chart_markup(chart) for chart in strips],
        anchors=anchors,
        pages=chain(first, rest),
        paged=rows,
        sections=sections,
        compared=compared,
        moved=None if moved is None else [chart_markup(chart) for chart in moved],
    )
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, content)
    of_pages = (
        f"{error} ({times} of {counted(len(rows), 'drive')})" for error, times in broken.items()
    )
    return (*attempt.broken, *of_pages)
