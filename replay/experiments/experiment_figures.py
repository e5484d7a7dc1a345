"""The pictures of `replan vary`, `falsify` and `tune`.

Colours are of Okabe and Ito's palette for the colour-blind, and every outcome also has a letter or a marker.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from replay.draw.report.figures import STYLE, empty_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from replay.experiments.brackets import Bracket
    from replay.experiments.question import SurfaceQuestion
    from replay.experiments.search_subject import SearchAxis

CELLS = {
    "pass": ("P", "#56b4e9", "passes all gates"),
    "fail": ("F", "#d55e00", "a gate fails"),
    "unavoidable": ("U", "#999999", "no evidence: the careful driver collides, too"),
    "inconclusive": ("I", "#f0e442", "no evidence otherwise"),
    "error": ("E", "#ffffff", "could not be evaluated"),
}
"""Letter, colour and meaning of each outcome of a cell."""
POINTS = {
    "pass": ("o", "#56b4e9", "passes"),
    "fail": ("X", "#d55e00", "fails, the reference driver does not"),
    "both fail": ("s", "#999999", "fails, the reference driver too"),
    "inconclusive": ("D", "#f0e442", "inconclusive"),
    "error": ("+", "#000000", "cannot be made or driven"),
}
"""Marker, colour and meaning of each outcome of a point of a falsification."""
CELL_IN, ROOM_IN = 1.0, 2.6
WIDEST_IN = 16.0
EDGE, RECORDED, HATCH, MILDEST = "#000000", "#009e73", "#555555", "#000000"


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

    letter, colour, _ = CELLS[cell["outcome"]]
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
        for name, (letter, colour, meaning) in CELLS.items()
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


def falsify_figure(table: pd.DataFrame, axes: Sequence[SearchAxis], case: Mapping[str, Any], title: str) -> Figure:
    """The trials over the two axes that the case moves most (without a case: the first two); lines of equal distance.

    Args:
        table: A row per trial: a column per axis, `outcome`.
        axes: The axes of the search.
        case: The row of the mildest case; empty if there is none.
        title: Title of the picture.
    """
    import matplotlib as mpl

    by_step = sorted(axes, key=lambda axis: -abs(case.get(axis.name, axis.origin) - axis.origin) / axis.scale)
    first, second = by_step[0], by_step[1] if len(by_step) > 1 else None
    with mpl.rc_context(STYLE):
        figure = empty_figure(8.0, 5.6 if second else 3.2)
        picture = figure.subplots()
        spread = np.zeros(len(table)) if second is None else table[second.name].to_numpy(float)
        for name, (marker, colour, meaning) in POINTS.items():
            mine = (table["outcome"] == name).to_numpy()
            if mine.any():
                x, y, label = table[first.name][mine], spread[mine], f"{meaning} ({mine.sum()})"
                picture.scatter(x, y, marker=marker, c=colour, s=34.0, label=label, lw=1.0 if marker == "+" else 0.3)
        origin = (first.origin, 0.0 if second is None else second.origin)
        picture.plot(*origin, "o", ms=16.0, mfc="none", mec=RECORDED, mew=2.0, label="as recorded")
        if case:
            place = case[first.name], 0.0 if second is None else case[second.name]
            label = f"mildest failure, distance {case['distance']:.3f}"
            picture.plot(*place, "*", ms=15.0, mfc="none", mec=MILDEST, mew=1.4, label=label)
            turn, away = np.linspace(0.0, 2.0 * np.pi, 181), float(case["distance"])
            along = first.origin + first.scale * away * np.cos(turn)  # if no other axis is moved
            if second is not None:
                across = second.origin + second.scale * away * np.sin(turn)
                picture.plot(along, across, color="#555555", lw=0.8, ls="--", label="as far as that")
            for end in (along.min(), along.max()) if second is None else ():
                picture.axvline(end, color="#555555", lw=0.8, ls="--")
        picture.set(xlabel=first.label, xlim=_padded_range(first), title=title)
        if second is None:
            picture.set_yticks([])
        else:
            picture.set(ylabel=second.label, ylim=_padded_range(second))
        figure.legend(loc="outside lower left", ncols=2, fontsize=8)
        return figure


def _padded_range(axis: SearchAxis) -> tuple[float, float]:
    room = 0.03 * (axis.high - axis.low)
    return axis.low - room, axis.high + room


def pareto_figure(table: pd.DataFrame, metrics: Sequence[str], chosen: Mapping[str, Any], title: str) -> Figure:
    """The gains of all trials in the first two objectives; a single objective is drawn over the trial number.

    Args:
        table: A row per trial: `gain METRIC` for each objective, `feasible`, `pareto`.
        metrics: The objectives.
        chosen: The row of the chosen trial; empty if there is none.
        title: Title of the picture.
    """
    import matplotlib as mpl

    names = [f"gain {name}" for name in metrics]
    x, y = ("trial", names[0]) if len(names) == 1 else (names[0], names[1])
    front = table[table["pareto"]].sort_values([x, y], kind="stable")
    with mpl.rc_context(STYLE):
        figure = empty_figure(7.5, 5.2)
        picture = figure.subplots()
        for name, mine, colour in (
            ("feasible", table["feasible"] & ~table["pareto"], "#56b4e9"),
            ("fails more gates than the defaults", ~table["feasible"] & table["total"].notna(), "#999999"),
            ("no other trial is better in all objectives", table["pareto"], "#d55e00"),
        ):
            if mine.any():
                label = f"{name} ({mine.sum()})"
                picture.scatter(table[x][mine], table[y][mine], s=30.0, c=colour, ec="#555555", lw=0.4, label=label)
        if len(names) == 2:
            picture.plot(front[x], front[y], color="#d55e00", lw=0.8)
        if len(names) == 1:
            picture.axhline(0.0, color=RECORDED, lw=1.0, label="the defaults")
        else:
            picture.plot(0.0, 0.0, "o", ms=14.0, mfc="none", mec=RECORDED, mew=2.0, label="the defaults")
        if chosen:
            picture.plot(chosen[x], chosen[y], "*", ms=15.0, mfc="none", mec=MILDEST, mew=1.4, label="chosen")
        picture.set(xlabel=x, ylabel=y, title=title)
        figure.legend(loc="outside lower left", ncols=2, fontsize=8)
        return figure
