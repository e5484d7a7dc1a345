"""The pictures of `replan vary`, `falsify` and `tune`: every outcome has a letter or a sign, and a
colour.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from replan.draw.charts.axes import Plane
from replan.draw.charts.canvas import Chart, Entry, dot
from replan.draw.spans import widened

if TYPE_CHECKING:
    from replan.experiments.brackets import Bracket
    from replan.experiments.question import SurfaceQuestion
    from replan.experiments.search_subject import SearchAxis

CELLS = {
    "pass": ("P", "blue", "passes all gates"),
    "fail": ("F", "red", "a gate fails"),
    "unavoidable": ("U", "grey", "no evidence: the careful driver collides, too"),
    "inconclusive": ("I", "olive", "no evidence otherwise"),
    "error": ("E", "blank", "could not be evaluated"),
}
"""Letter, colour and meaning of each outcome of a cell."""
POINTS = {
    "pass": ("\u25cf", "blue", "passes"),
    "fail": ("\u00d7", "red", "fails, the reference driver does not"),
    "both fail": ("\u25a0", "grey", "fails, the reference driver too"),
    "inconclusive": ("\u25c6", "olive", "inconclusive"),
    "error": ("+", "", "cannot be made or driven"),
}
"""Sign, colour and meaning of each outcome of a point of a falsification."""
RING, STAR = "\u25cb", "\u2605"
SHADE = 0.45
"""Opacity of a cell, so that its words can be read."""
CELL_PX, WIDE_PX, HIGH_PX = (96.0, 48.0), 620.0, 420.0


def surface_figure(
    table: pd.DataFrame, edges: Sequence[Bracket], question: SurfaceQuestion, title: str
) -> Chart:
    """The surface.

    Each cell with its letter, the least gap, an x if the drive ended in a contact, and a gate.
    """
    cells, x = table[table["part"] == "grid"], question.axes[0]
    y = question.axes[1] if len(question.axes) > 1 else None
    ys, half_x = y.values if y else (0.0,), 0.5 * x.spacing
    half_y = 0.5 * y.spacing if y else 0.5
    size = max(CELL_PX[0] * len(x.values), WIDE_PX), CELL_PX[1] * len(ys) + 80.0
    plane = Plane(
        (x.values[0] - half_x, x.values[-1] + half_x), (ys[0] - half_y, ys[-1] + half_y), *size
    )
    inside = over = ""
    for row, (_, cell) in zip(
        cells[y.name] if y else [0.0] * len(cells), cells.iterrows(), strict=True
    ):
        column, (letter, colour, _) = float(cell[x.name]), CELLS[cell["outcome"]]
        box = (column - half_x, column + half_x), (row - half_y, row + half_y)
        inside += plane.box(*box, colour, str(cell["gates"]), SHADE, 0.5)
        gap = f" {cell['least_gap_m']:.1f}" if np.isfinite(cell["least_gap_m"]) else ""
        warned = " !" if cell["careful"] == "unavoidable" else ""
        gate = cell["gates"].partition(".")[0].rpartition(" ")[2]
        contact = " x" if cell["contact"] else ""
        text = f"{letter}{gap}{contact}{warned}"
        over += plane.words(column, row, text, "mid", -2.0 if gate else 4.0)
        over += plane.words(column, row, gate, "small mid", 11.0)
    for edge in edges:
        row = edge.row[0] if edge.row else 0.0
        ends = row - half_y, row + half_y
        inside += plane.box((edge.low, edge.high), ends, "band")
        inside += plane.line(np.full(2, edge.middle), np.array(ends), "bound")
    point = _recorded_point(question)
    if point is not None:
        over += dot(float(plane.at_x(point[0])), float(plane.at_y((*point, 0.0)[1])), 21.0, "ring")
    counts = cells["outcome"].value_counts()
    entries: list[Entry] = [
        ("area", colour, f"{letter}: {meaning} ({counts[name]})")
        for name, (letter, colour, meaning) in CELLS.items()
        if name in counts
    ]
    if (cells["careful"] == "unavoidable").any():
        entries.append(("!", "", "the careful driver of UN R157 collides"))
    if edges:
        unit = x.label.partition(" ")[2].strip("[]")
        entries.append(
            ("line", "bound", f"edge of pass, to {question.resolution:.3g} {unit}".rstrip())
        )
    entries += [(RING, "", "as recorded")] if point is not None else []
    entries.append(("x", "", "contact; the number: least gap [m]; below it: the first gate"))
    axes = dict[str, Any](x_title=x.label, x_ticks=_words(x.values), y_title=y.label if y else "")
    return plane.chart(
        "surface",
        title,
        inside,
        entries=entries,
        over=over,
        y_ticks=_words(ys) if y else (),
        **axes,
    )


def _words(values: Sequence[float]) -> list[tuple[float, str]]:
    return [(value, f"{value:g}") for value in values]


def _recorded_point(question: SurfaceQuestion) -> tuple[float, ...] | None:
    """The point at which nothing is varied; None if it is not within the axes."""
    point = question.recorded
    inside = point is not None and all(
        a.values[0] <= v <= a.values[-1] for a, v in zip(question.axes, point, strict=True)
    )
    return point if inside else None


def falsify_figure(
    table: pd.DataFrame, axes: Sequence[SearchAxis], case: Mapping[str, Any], title: str
) -> Chart:
    """The trials over the two axes that the case moves most (without a case: the first two); lines
    of equal distance.

    The table has a row per trial: a column per axis, `outcome`; `case` is the row of the mildest
    case, or empty.
    """
    by_step = sorted(
        axes, key=lambda axis: -abs(case.get(axis.name, axis.origin) - axis.origin) / axis.scale
    )
    first, second = by_step[0], by_step[1] if len(by_step) > 1 else None
    x_span = widened(first.low, first.high, 0.0, 0.03)
    y_span = widened(second.low, second.high, 0.0, 0.03) if second else (-1.0, 1.0)
    plane = Plane(x_span, y_span, WIDE_PX, HIGH_PX if second else 180.0)
    entries, inside, over = list[Entry](), "", ""
    for name, (sign, colour, meaning) in POINTS.items():
        points = table[table["outcome"] == name]
        across = points[second.name] if second else [0.0] * len(points)
        inside += "".join(
            plane.sign(x, y, sign, colour) for x, y in zip(points[first.name], across, strict=True)
        )
        entries += [(sign, colour, f"{meaning} ({len(points)})")] if len(points) else []
    over += _ring(plane, first.origin, second.origin if second else 0.0)
    entries.append((RING, "", "as recorded"))
    if case:
        over += plane.sign(case[first.name], case[second.name] if second else 0.0, STAR)
        entries.append((STAR, "", f"mildest failure, distance {case['distance']:.3f}"))
        turn, away = np.linspace(0.0, 2.0 * np.pi, 181), float(case["distance"])
        if second:
            along, up = first.scale * away * np.cos(turn), second.scale * away * np.sin(turn)
            inside += plane.line(first.origin + along, second.origin + up, "now")
            entries.append(("line", "now", "as far as that"))
        else:
            for end in (first.origin - first.scale * away, first.origin + first.scale * away):
                inside += plane.line(np.full(2, end), np.array(y_span), "now")
    titles = dict[str, Any](x_title=first.label, y_title=second.label if second else "")
    return plane.chart(
        "falsify",
        title,
        inside,
        entries=entries,
        over=over,
        y_ticks=None if second else (),
        **titles,
    )


def _ring(plane: Plane, x: float, y: float) -> str:
    return dot(float(plane.at_x(x)), float(plane.at_y(y)), 9.0, "ring")


def pareto_figure(
    table: pd.DataFrame, metrics: Sequence[str], chosen: Mapping[str, Any], title: str
) -> Chart:
    """The gains of all trials in the first two objectives; a single objective is drawn over the
    trial number.

    The table has a row per trial: `gain METRIC` for each objective, `feasible`, `pareto`; `chosen`
    is the row of the chosen trial, or empty.
    """
    names = [f"gain {name}" for name in metrics]
    x, y = ("trial", names[0]) if len(names) == 1 else (names[0], names[1])
    shown = table[table["total"].notna()]
    spans = [widened(min([0.0, *shown[name]]), max([0.0, *shown[name]]), 1e-3) for name in (x, y)]
    plane = Plane(spans[0], spans[1], WIDE_PX, HIGH_PX)
    entries, inside, over = list[Entry](), "", ""
    for name, selected, sign, colour in (
        ("feasible", table["feasible"] & ~table["pareto"], "\u25cf", "blue"),
        (
            "fails more gates than the defaults",
            ~table["feasible"] & table["total"].notna(),
            "\u25a0",
            "grey",
        ),
        ("no other trial is better in all objectives", table["pareto"], "\u25c6", "red"),
    ):
        if selected.any():
            points = zip(table[x][selected], table[y][selected], strict=True)
            inside += "".join(plane.sign(*point, sign, colour) for point in points)
            entries.append((sign, colour, f"{name} ({selected.sum()})"))
    if len(names) == 2:
        front = table[table["pareto"]].sort_values([x, y], kind="stable")
        inside += plane.line(front[x].to_numpy(float), front[y].to_numpy(float), "edge")
        over += _ring(plane, 0.0, 0.0)
        entries.append((RING, "", "the defaults"))
    else:
        inside += plane.line(np.array(spans[0]), np.zeros(2), "now")
        entries.append(("line", "now", "the defaults"))
    if chosen:
        over += plane.sign(chosen[x], chosen[y], STAR)
        entries.append((STAR, "", "chosen"))
    return plane.chart("pareto", title, inside, entries=entries, over=over, x_title=x, y_title=y)
