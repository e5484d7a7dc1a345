"""The picture of `replan vary`: a cell of the grid has the letter and the colour of its outcome."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from replan.draw.charts.axes import Plane
from replan.draw.charts.chart import Chart
from replan.draw.charts.legend import Entry
from replan.draw.charts.svg import dot
from replan.experiments.brackets import Bracket
from replan.experiments.question import SurfaceQuestion

CELLS = {
    "pass": ("P", "blue", "passes all gates"),
    "fail": ("F", "red", "a gate fails"),
    "unavoidable": ("U", "grey", "no evidence: the careful driver collides, too"),
    "inconclusive": ("I", "olive", "no evidence otherwise"),
    "error": ("E", "blank", "could not be evaluated"),
}
"""Letter, colour and meaning of each outcome of a cell."""
SHADE = 0.45
"""Opacity of a cell, so that its words can be read."""
CELL_WIDTH_PX = 96.0
CELL_HEIGHT_PX = 48.0
LEAST_WIDTH_PX = 620.0
AROUND_PX = 80.0
"""Height of titles, ticks and legend."""
CELL_GAP_PX = 0.5
"""A cell is smaller by this on each side, so that neighbours are apart."""
RING_PX = 21.0
"""Radius of the ring about the words of the recorded cell."""
RECORDED = "\u25cb"
"""The sign of the ring in the legend."""


@dataclass(frozen=True)
class Grid:
    """The values of the cells along both axes; a surface of one axis has one row at y = 0.

    Attributes:
        x: Values of the columns.
        y: Values of the rows.
        half: Half of the width and of the height of a cell.
    """

    x: tuple[float, ...]
    y: tuple[float, ...]
    half: tuple[float, float]

    @classmethod
    def of(cls, question: SurfaceQuestion) -> Grid:
        """The grid of a question."""
        x, *others = question.axes
        y, height = (others[0].values, others[0].spacing) if others else ((0.0,), 1.0)
        return cls(x.values, y, (0.5 * x.spacing, 0.5 * height))

    def plane(self) -> Plane:
        """The plot area, with half of a cell around the outer values."""
        half_x, half_y = self.half
        return Plane(
            (self.x[0] - half_x, self.x[-1] + half_x),
            (self.y[0] - half_y, self.y[-1] + half_y),
            max(CELL_WIDTH_PX * len(self.x), LEAST_WIDTH_PX),
            CELL_HEIGHT_PX * len(self.y) + AROUND_PX,
        )


def surface_figure(
    table: pd.DataFrame,
    edges: Sequence[Bracket],
    question: SurfaceQuestion,
    deciding: Mapping[str, str],
    title: str,
) -> Chart:
    """The cells of a surface, the edges of "pass", and the recorded point.

    A cell shows its letter, the least gap, an x if the drive ended in a contact, and below them the
    metric of the first gate that decides it.

    Args:
        table: A row per point; the cells have the part "grid".
        edges: Where rows change.
        question: The question of the surface.
        deciding: The metric of the first deciding gate, by log.
        title: The title.
    """
    cells, grid = table[table["part"] == "grid"], Grid.of(question)
    plane = grid.plane()
    first, *second = question.axes
    xs = cells[first.name].astype(float)
    ys = cells[second[0].name].astype(float) if second else np.zeros(len(cells))
    inside = over = ""
    for x, y, (_, cell) in zip(xs, ys, cells.iterrows(), strict=True):
        inside += _box(plane, grid, x, y, cell)
        over += _words(plane, x, y, cell, deciding.get(str(cell["log"]), "").partition(".")[0])
    for edge in edges:
        y = edge.row[0] if edge.row else 0.0
        ends = y - grid.half[1], y + grid.half[1]
        inside += plane.box((edge.low, edge.high), ends, "bracket")
        inside += plane.line(np.full(2, edge.middle), np.array(ends), "boundary")
    recorded = _recorded_point(question, grid)
    if recorded is not None:
        x, y = recorded
        over += dot(float(plane.at_x(x)), float(plane.at_y(y)), RING_PX, "ring")
    entries = [*_entries(cells, edges, question, is_recorded=recorded is not None)]
    return plane.chart(
        "surface",
        title,
        inside,
        entries=entries,
        over=over,
        x_title=first.label,
        x_ticks=_ticks(grid.x),
        y_title=second[0].label if second else "",
        y_ticks=_ticks(grid.y) if second else (),
    )


def _box(plane: Plane, grid: Grid, x: float, y: float, cell: pd.Series) -> str:
    """The coloured box of a cell."""
    _, colour, _ = CELLS[cell["outcome"]]
    half_x, half_y = grid.half
    span_x, span_y = (x - half_x, x + half_x), (y - half_y, y + half_y)
    return plane.box(span_x, span_y, colour, str(cell["gates"]), SHADE, CELL_GAP_PX)


def _words(plane: Plane, x: float, y: float, cell: pd.Series, metric: str) -> str:
    """The words of a cell, in one line, or in two if a gate decides it."""
    letter, _, _ = CELLS[cell["outcome"]]
    gap = f" {cell['least_gap_m']:.1f}" if np.isfinite(cell["least_gap_m"]) else ""
    contact = " x" if cell["contact"] else ""
    warned = " !" if cell["careful"] == "unavoidable" else ""
    text = f"{letter}{gap}{contact}{warned}"
    line = plane.words(x, y, text, "middle", -2.0 if metric else 4.0)
    return line + plane.words(x, y, metric, "small middle", 11.0)


def _entries(
    cells: pd.DataFrame, edges: Sequence[Bracket], question: SurfaceQuestion, *, is_recorded: bool
) -> Iterator[Entry]:
    """The legend."""
    counts = cells["outcome"].value_counts()
    for name, (letter, colour, meaning) in CELLS.items():
        if name in counts:
            yield "area", colour, f"{letter}: {meaning} ({counts[name]})"
    if (cells["careful"] == "unavoidable").any():
        yield "!", "", "the careful driver of UN R157 collides"
    if edges:
        width = f"{question.resolution:.3g} {question.axes[0].unit}".rstrip()
        yield "line", "boundary", f"edge of pass, to {width}"
    if is_recorded:
        yield RECORDED, "", "as recorded"
    yield "x", "", "contact; the number: least gap [m]; below it: the first gate"


def _ticks(values: Sequence[float]) -> list[tuple[float, str]]:
    return [(value, f"{value:g}") for value in values]


def _recorded_point(question: SurfaceQuestion, grid: Grid) -> tuple[float, float] | None:
    """The point at which nothing is varied; None if it is not within the axes."""
    if question.recorded is None:
        return None
    x, y = (*question.recorded, 0.0)[:2]
    within = grid.x[0] <= x <= grid.x[-1] and grid.y[0] <= y <= grid.y[-1]
    return (x, y) if within else None
