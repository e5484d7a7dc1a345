"""The picture of `replan tune`: the gains of all trials, and which of them no other one excels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from replan.draw.charts.axes import Plane
from replan.draw.charts.chart import Chart
from replan.draw.charts.legend import Entry
from replan.draw.charts.svg import dot
from replan.draw.spans import widened

DEFAULTS = "\u25cb"
CHOSEN = "\u2605"
WIDTH_PX = 620.0
HEIGHT_PX = 420.0
RING_PX = 9.0
"""Radius of the ring about the defaults."""
LEAST = 1e-3
"""An axis covers at least this gain."""


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
    spans = [widened(min([0.0, *shown[name]]), max([0.0, *shown[name]]), LEAST) for name in (x, y)]
    plane = Plane(spans[0], spans[1], WIDTH_PX, HEIGHT_PX)
    entries: list[Entry] = []
    inside = over = ""
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
        inside += plane.line(front[x].to_numpy(float), front[y].to_numpy(float), "front")
        over += dot(float(plane.at_x(0.0)), float(plane.at_y(0.0)), RING_PX, "ring")
        entries.append((DEFAULTS, "", "the defaults"))
    else:
        inside += plane.line(np.array(spans[0]), np.zeros(2), "reference")
        entries.append(("line", "reference", "the defaults"))
    if chosen:
        over += plane.sign(chosen[x], chosen[y], CHOSEN)
        entries.append((CHOSEN, "", "chosen"))
    return plane.chart("pareto", title, inside, entries=entries, over=over, x_title=x, y_title=y)
