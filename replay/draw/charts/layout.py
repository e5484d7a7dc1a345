"""The charts of a drive by name, where each stands in its page, and those that users add ("module:NAME").

A chart is a function: `draw(subject) -> Chart`, or several. Charts of users come after the pictures. A chart that
raises is replaced by its error, and nothing else is affected.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from logs.errors import raised
from logs.extension import Kind
from replay.draw.charts.canvas import Chart, shortened, text
from replay.draw.charts.curves import curves
from replay.draw.charts.graphs import sl_graph, st_graph
from replay.draw.charts.lanes import decisions
from replay.draw.charts.scene import scenes
from replay.draw.charts.subject import Subject

Draw = Callable[[Subject], "Chart | Sequence[Chart]"]

CHARTS: dict[str, Draw] = {"scene": scenes, "st": st_graph, "sl": sl_graph, "curves": curves, "decisions": decisions}
CHART: Kind[Draw] = Kind("chart", "charts", CHARTS, besides=("all",))
"""Finds these charts, and those of users."""
LAYOUT: Mapping[str, tuple[str, ...]] = {
    "pictures": ("scene", "st", "sl"),
    "decided": ("decisions",),
    "curves": ("curves",),
}
"""By place in the page of a drive, from top to bottom, the charts that stand there."""
OWN = "pictures"
"""The place of charts of users."""
BROKEN, BROKEN_PX = "broken", (440.0, 40.0)
"""Name and size of the placeholder of a chart that could not be drawn."""


def placed(subject: Subject, own: Sequence[str] = ()) -> dict[str, list[Chart]]:
    """All charts of a drive by their places.

    Args:
        subject: The drive.
        own: Of users ("module:NAME"), beside those of entry points.

    Raises:
        ConfigError: One of users' own cannot be loaded.
        ValueError: A chart of ours has no place: it would not be seen.
    """
    nowhere = set(CHARTS) - {name for names in LAYOUT.values() for name in names}
    if nowhere:
        raise ValueError(f"the chart '{min(nowhere)}' has no place in LAYOUT: it would not be seen")
    found = {place: [one for name in names for one in drawn(subject, name)] for place, names in LAYOUT.items()}
    found[OWN] += [chart for name in (*CHART.entries(), *own) for chart in drawn(subject, name)]
    return found


def drawn(subject: Subject, name: str) -> list[Chart]:
    """The charts of a name; one that fails is a placeholder with the error. ConfigError as `Kind.find`."""
    draw = CHART.find(name)
    try:
        charts: Any = draw(subject)
        charts = list(charts) if isinstance(charts, (list, tuple)) else [charts]
        wrong = next((type(one).__name__ for one in charts if not isinstance(one, Chart)), "")
        return [_broken(name, f"returned {wrong} instead of a Chart")] if wrong else charts
    except (Exception, SystemExit) as error:
        return [_broken(name, raised(error, of=draw))]


def _broken(name: str, why: str) -> Chart:
    width, height = BROKEN_PX
    body = text(0.0, 14.0, shortened(name, width), "title") + text(0.0, 32.0, shortened(why, width), "small", about=why)
    return Chart(BROKEN, name, f"The chart {name} could not be drawn: {why}", width, height, body)
