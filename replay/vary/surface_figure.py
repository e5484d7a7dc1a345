"""The picture of `replan vary`: outcome over one or two parameters, the edge of pass, the recorded point.

Colours are of Okabe and Ito's palette for the colour-blind, and every cell also has its outcome as a letter.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from replay.draw.report.figures import STYLE, empty_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from replay.vary.brackets import Bracket
    from replay.vary.question import SurfaceQuestion

LOOKS = {
    "pass": ("P", "#56b4e9", "passes all gates"),
    "fail": ("F", "#d55e00", "a gate fails"),
    "unavoidable": ("U", "#999999", "no evidence: the careful driver collides, too"),
    "inconclusive": ("I", "#f0e442", "no evidence otherwise"),
    "error": ("E", "#ffffff", "could not be evaluated"),
}
"""Letter, colour and meaning of each outcome."""
CELL_IN, ROOM_IN = 1.0, 2.6
WIDEST_IN = 16.0
EDGE, RECORDED, HATCH = "#000000", "#009e73", "#555555"


def surface_figure(table: pd.DataFrame, edges: Sequence[Bracket], question: SurfaceQuestion, title: str) -> Figure:
    """The surface; each cell with its letter, the least gap, an x if the drive ended in a contact, and a gate."""
    import matplotlib as mpl

    cells = table[table["part"] == "grid"]
    x, ys = question.axes[0], question.axes[1].values if len(question.axes) > 1 else (0.0,)
    with mpl.rc_context({**STYLE, "axes.grid": False, "hatch.linewidth": 0.6}):
        width = min(max(CELL_IN * len(x.values) + ROOM_IN, 7.5), WIDEST_IN)
        figure = empty_figure(width, 0.5 * CELL_IN * len(ys) + ROOM_IN)
        axes = figure.subplots()
        half_x, half_y = 0.5 * x.spacing, 0.5 * (ys[1] - ys[0]) if len(ys) > 1 else 0.5
        rows = cells[question.axes[1].name] if len(question.axes) > 1 else np.zeros(len(cells))
        for (_, cell), y in zip(cells.iterrows(), rows, strict=True):
            _cell(axes, cell, float(cell[x.name]), float(y), half_x, half_y)
        for edge in edges:
            y = edge.row[0] if edge.row else 0.0
            axes.fill_betweenx([y - half_y, y + half_y], edge.low, edge.high, color=EDGE, alpha=0.25, lw=0.0, zorder=2)
            axes.plot([edge.middle] * 2, [y - half_y, y + half_y], color=EDGE, lw=2.5, zorder=2)
        point = _recorded_point(question)
        if point is not None:
            axes.plot(*(*point, 0.0)[:2], "o", ms=34.0, mfc="none", mec=RECORDED, mew=2.5, zorder=5)
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
    corner, size = (x - half_x, y - half_y), (2.0 * half_x, 2.0 * half_y)
    axes.add_patch(Rectangle(corner, *size, fc=colour, ec="white", lw=0.8))
    if cell["careful"] == "unavoidable":
        axes.add_patch(Rectangle(corner, *size, fill=False, ec=HATCH, lw=0.0, hatch="///"))
    gap = f" {cell['least_gap_m']:.1f}" if np.isfinite(cell["least_gap_m"]) else ""
    back = {"boxstyle": "round,pad=0.1", "fc": colour, "lw": 0.0}
    said = f"{letter}{gap}{' x' if cell['contact'] else ''}"
    gate = cell["gates"].partition(".")[0].rpartition(" ")[2]
    axes.annotate(said, (x, y), (0.0, 5.0 if gate else 0.0), textcoords="offset points", ha="center", va="center",
                  fontsize=8, bbox=back, zorder=3)  # fmt: skip
    axes.annotate(gate, (x, y), (0.0, -6.0), textcoords="offset points", ha="center", va="center", fontsize=5.5,
                  bbox=back if gate else None, zorder=3)  # fmt: skip


def _recorded_point(question: SurfaceQuestion) -> tuple[float, ...] | None:
    """The point at which nothing is varied; None if it is not within the axes."""
    point = question.recorded
    inside = point is not None and all(
        a.values[0] <= v <= a.values[-1] for a, v in zip(question.axes, point, strict=True)
    )
    return point if inside else None


def _legend(figure: Figure, cells: pd.DataFrame, edges: Sequence[Bracket], question: SurfaceQuestion) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    counts = cells["outcome"].value_counts()
    handles: list[Patch | Line2D] = [
        Patch(fc=colour, ec="#777777", label=f"{letter}: {meaning} ({counts[name]})")
        for name, (letter, colour, meaning) in LOOKS.items()
        if name in counts
    ]
    if (cells["careful"] == "unavoidable").any():
        handles.append(Patch(fc="white", ec=HATCH, hatch="///", label="the careful driver of UN R157 collides"))
    if edges:
        unit = question.axes[0].label.partition(" ")[2].strip("[]")
        fine = f"{question.resolution:.3g} {unit}".strip()
        handles.append(Line2D([], [], color=EDGE, lw=3.0, label=f"edge of pass, to {fine}"))
    if _recorded_point(question) is not None:
        ring = Line2D([], [], marker="o", ms=10.0, mfc="none", mec=RECORDED, mew=2.0, ls="", label="as recorded")
        handles.append(ring)
    handles.append(Line2D([], [], ls="", label="number: least gap [m]; x: contact; below: the first gate"))
    figure.legend(handles=handles, loc="outside lower left", ncols=2, fontsize=8)
