"""The charts of a drive by name, their places in its page, and charts of users ("module:NAME").

A chart is a function: `draw(subject) -> Chart`, or several. Charts of users come after the
pictures. A chart that raises is replaced by its error, and nothing else is affected. Several charts
are written as one SVG or PNG.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from replan.core.errors import raised
from replan.core.extension import ExtensionKind
from replan.draw.charts.bird_view import scenes
from replan.draw.charts.chart import Chart
from replan.draw.charts.curves import curves, decisions, sl_graph, st_graph
from replan.draw.charts.subject import Subject
from replan.draw.charts.svg import group, shortened, text
from replan.results.tables import safe_name

Draw = Callable[[Subject], "Chart | Sequence[Chart]"]

CHARTS: dict[str, Draw] = {
    "scene": scenes,
    "st": st_graph,
    "sl": sl_graph,
    "curves": curves,
    "decisions": decisions,
}
CHART: ExtensionKind[Draw] = ExtensionKind("chart", "charts", CHARTS, besides=("all",))
"""Finds charts by name: the built-in ones and those of users."""
LAYOUT: Mapping[str, tuple[str, ...]] = {
    "pictures": ("scene", "st", "sl"),
    "decided": ("decisions",),
    "curves": ("curves",),
}
"""Names of charts by their place in the page of a drive, from top to bottom."""
OWN = "pictures"  # The place in the page for charts of users
TOGETHER = ("scene", "curves")
"""Charts that show several drives in one; the others are drawn for each drive, under its name."""
# Name and size of the placeholder of a chart that could not be drawn
BROKEN, BROKEN_PX = "broken", (440.0, 40.0)


def placed(subject: Subject, own: Sequence[str] = ()) -> dict[str, list[Chart]]:
    """All charts of a drive by their places.

    `own`: charts of users ("module:NAME"), in addition to those of entry points. ConfigError if a
    chart of users cannot be loaded; ValueError if a built-in chart has no place in `LAYOUT`, so
    that it would not be shown.
    """
    nowhere = set(CHARTS) - {name for names in LAYOUT.values() for name in names}
    if nowhere:
        raise ValueError(f"the chart '{min(nowhere)}' has no place in LAYOUT: it would not be seen")
    places = {
        place: [chart for name in names for chart in drawn(subject, name)]
        for place, names in LAYOUT.items()
    }
    places[OWN] += [chart for name in (*CHART.entries(), *own) for chart in drawn(subject, name)]
    return places


def drawn(subject: Subject, name: str) -> list[Chart]:
    """Draw the charts of a name; a failed one is a placeholder with its error.

    ConfigError as `ExtensionKind.find`.
    """
    draw = CHART.find(name)
    try:
        charts: Any = draw(subject)
        charts = list(charts) if isinstance(charts, (list, tuple)) else [charts]
        wrong = [type(chart).__name__ for chart in charts if not isinstance(chart, Chart)]
        return [_broken(name, f"returned {wrong[0]} instead of a Chart")] if wrong else charts
    except (Exception, SystemExit) as error:
        return [_broken(name, raised(error, of=draw))]


def _broken(name: str, why: str) -> Chart:
    width, height = BROKEN_PX
    body = text(0.0, 14.0, shortened(name, width), "title") + text(
        0.0, 32.0, shortened(why, width), "small", about=why
    )
    return Chart(BROKEN, name, f"The chart {name} could not be drawn: {why}", width, height, body)


COLUMN_PX, GAP_PX, MARGIN_PX = 440.0, 16.0, 14.0
HEAD_PX, NAME_PX = 44.0, 16.0  # Heights of the title of a picture, and of the name of a drive
ALL = "all"


def charts_of(seen: Subject, kind: str, width: float) -> list[Chart]:
    """The charts of one name (see `CHART`), or of all names (`ALL`), for a picture of this width in
    pixels.

    Of several drives, each chart shows all (`TOGETHER`), or there is one for each, side by side
    where they fit.
    """
    charts = list[Chart]()
    for name in CHART.names() if kind == ALL else (kind,):
        if name in TOGETHER or not seen.beside:
            charts += _charts(seen, name, width)
            continue
        of_drives = [
            _under(drive, chart)
            for drive, of_drive in seen.drives.items()
            for chart in _charts(of_drive, name, width)
        ]
        total = sum(chart.width + GAP_PX for chart in of_drives) - GAP_PX
        fits = of_drives and total <= row_width(width)
        charts += [_row(of_drives, name, total)] if fits else of_drives
    return charts


def _charts(seen: Subject, name: str, width: float) -> list[Chart]:
    return [decisions(seen, row_width(width))] if name == "decisions" else drawn(seen, name)


def _row(charts: Sequence[Chart], name: str, width: float) -> Chart:
    """Charts side by side, as one."""
    body, x = "", 0.0
    for chart in charts:
        body, x = body + group(x, 0.0, chart.body), x + chart.width + GAP_PX
    title = "; ".join(chart.title for chart in charts)
    says = "; ".join(chart.says for chart in charts)
    return Chart(name, title, says, width, max(chart.height for chart in charts), body)


def _under(drive: str, chart: Chart) -> Chart:
    """A chart under the name of its drive."""
    body = text(2.0, 13.0, shortened(drive, chart.width), "title") + group(0.0, NAME_PX, chart.body)
    name, title = f"{chart.name}_{safe_name(drive)}", f"{drive}: {chart.title}"
    return Chart(name, title, f"{drive}: {chart.says}", chart.width, chart.height + NAME_PX, body)


def row_width(width: float) -> float:
    """The width of as many columns as fit into a width, at least one, pixels."""
    columns = max(1, int((width + GAP_PX) / (COLUMN_PX + GAP_PX)))
    return columns * (COLUMN_PX + GAP_PX) - GAP_PX


def together(charts: Sequence[Chart], title: str, says: str, width: float) -> Chart:
    """Charts in rows that are at most so wide (pixels), or as one chart, under a title."""
    body, full = "", 0.0
    x, y, row_height = 0.0, HEAD_PX, 0.0
    for chart in charts:
        if x > 0.0 and x + chart.width > width + 1.0:
            x, y, row_height = 0.0, y + row_height + GAP_PX, 0.0
        full = max(full, x + chart.width)
        body += group(MARGIN_PX + x, y, chart.body)
        x, row_height = x + chart.width + GAP_PX, max(row_height, chart.height)
    head = text(MARGIN_PX, 18.0, shortened(title, full), "title")
    head += text(MARGIN_PX, 34.0, shortened(says, full), "small")
    spoken = f"{title}; {says}: " + "; ".join(chart.title for chart in charts)
    height = y + row_height + MARGIN_PX
    return Chart("all", title, spoken, full + 2.0 * MARGIN_PX, height, head + body)
