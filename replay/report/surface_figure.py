"""The picture of `replan vary`: outcome over one or two parameters, the edge of pass, the recorded point.

Colours are of Okabe and Ito's palette for the colour-blind, and every cell says its outcome in a letter, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from replay.report.figures import STYLE, empty_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from replay.vary.axes import Question
    from replay.vary.bisection import Bracket

LOOKS = {
    "pass": ("P", "#56b4e9", "passes all gates"),
    "fail": ("F", "#d55e00", "a gate fails"),
    "unavoidable": ("U", "#999999", "no evidence: the careful driver collides, too"),
    "inconclusive": ("I", "#f0e442", "no evidence otherwise"),
    "error": ("E", "#ffffff", "could not be evaluated"),
}
"""Letter, colour and meaning of each outcome."""
CELL_IN, ROOM_IN = 0.82, 2.6
WIDEST_IN = 16.0
EDGE, RECORDED = "#000000", "#009e73"


def surface_figure(table: pd.DataFrame, edges: Sequence[Bracket], question: Question, title: str) -> Figure:
    """The surface; each cell with its letter, the least gap in metres, an x where the drive ended in a contact."""
    import matplotlib as mpl

    cells = table[table["part"] == "grid"]
    x, ys = question.axes[0], question.axes[1].values if len(question.axes) > 1 else (0.0,)
    with mpl.rc_context({**STYLE, "axes.grid": False}):
        width = min(max(CELL_IN * len(x.values) + ROOM_IN, 7.5), WIDEST_IN)
        figure = empty_figure(width, 0.62 * CELL_IN * len(ys) + ROOM_IN)
        axes = figure.subplots()
        half_x, half_y = 0.5 * x.spacing, 0.5 * (ys[1] - ys[0]) if len(ys) > 1 else 0.5
        rows = cells[question.axes[1].name] if len(question.axes) > 1 else np.zeros(len(cells))
        for (_, cell), y in zip(cells.iterrows(), rows, strict=True):
            _cell(axes, cell, float(cell[x.name]), float(y), half_x, half_y)
        for edge in edges:
            y = edge.row[0] if edge.row else 0.0
            axes.fill_betweenx([y - half_y, y + half_y], edge.low, edge.high, color=EDGE, lw=2.0, zorder=4)
        _mark_recorded(axes, question)
        axes.set(xlabel=x.label, xticks=x.values, title=title)
        axes.set(xlim=(x.values[0] - half_x, x.values[-1] + half_x), ylim=(ys[0] - half_y, ys[-1] + half_y))
        if len(question.axes) > 1:
            axes.set(ylabel=question.axes[1].label, yticks=ys)
        else:
            axes.set_yticks([])
        _legend(figure, cells, edges, question)
        return figure


def _cell(axes: Axes, cell: pd.Series, x: float, y: float, half_x: float, half_y: float) -> None:
    from matplotlib.patches import Rectangle

    letter, colour, _ = LOOKS[cell["outcome"]]
    hatch = "///" if cell["careful"] == "unavoidable" else None
    box = Rectangle((x - half_x, y - half_y), 2.0 * half_x, 2.0 * half_y, fc=colour, ec="white", lw=0.8, hatch=hatch)
    axes.add_patch(box)
    gap = f" {cell['least_gap_m']:.1f}" if np.isfinite(cell["least_gap_m"]) else ""
    said = f"{letter}{gap}{' x' if cell['contact'] else ''}"
    back = {"boxstyle": "round,pad=0.15", "fc": colour, "lw": 0.0}
    axes.text(x, y, said, ha="center", va="center", fontsize=8, bbox=back, zorder=3)


def _mark_recorded(axes: Axes, question: Question) -> None:
    point = question.recorded
    if point is None:
        return
    inside = all(axis.values[0] <= v <= axis.values[-1] for axis, v in zip(question.axes, point, strict=True))
    if inside:
        y = point[1] if len(point) > 1 else 0.0
        axes.plot(
            point[0], y, "o", ms=30.0, mfc="none", mec=RECORDED, mew=2.5, zorder=5, label="as recorded", clip_on=False
        )


def _legend(figure: Figure, cells: pd.DataFrame, edges: Sequence[Bracket], question: Question) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    counts = cells["outcome"].value_counts()
    handles: list[Patch | Line2D] = [
        Patch(fc=colour, ec="#777777", label=f"{letter}: {meaning} ({counts[name]})")
        for name, (letter, colour, meaning) in LOOKS.items()
        if name in counts
    ]
    if (cells["careful"] == "unavoidable").any():
        handles.append(Patch(fc="white", ec="white", hatch="///", label="the careful driver of UN R157 collides"))
    if edges:
        unit = question.axes[0].label.partition(" ")[2].strip("[]")
        fine = f"{question.resolution:.3g} {unit}".strip()
        handles.append(Line2D([], [], color=EDGE, lw=3.0, label=f"edge of pass, to {fine}"))
    if question.recorded is not None:
        ring = Line2D([], [], marker="o", ms=10.0, mfc="none", mec=RECORDED, mew=2.0, ls="", label="as recorded")
        handles.append(ring)
    handles.append(Line2D([], [], ls="", label="number: least gap [m]; x: contact"))
    figure.legend(handles=handles, loc="outside lower left", ncols=2, fontsize=8)
