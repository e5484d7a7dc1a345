"""The picture of `replan falsify`: a trial has the sign and the colour of its outcome."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from replan.draw.charts.axes import Plane
from replan.draw.charts.chart import Chart
from replan.draw.charts.legend import Entry
from replan.draw.charts.svg import dot
from replan.draw.spans import widened

if TYPE_CHECKING:
    from replan.experiments.search_subject import SearchAxis

POINTS = {
    "pass": ("\u25cf", "blue", "passes"),
    "fail": ("\u00d7", "red", "fails, the reference driver does not"),
    "both fail": ("\u25a0", "grey", "fails, the reference driver too"),
    "inconclusive": ("\u25c6", "olive", "inconclusive"),
    "error": ("+", "", "cannot be made or driven"),
}
"""Sign, colour and meaning of each outcome of a point of a falsification."""
RECORDED = "\u25cb"
MILDEST = "\u2605"
WIDTH_PX = 620.0
HEIGHT_PX = 420.0
LINE_HEIGHT_PX = 180.0
"""Height of a picture with one axis."""
RING_PX = 9.0
"""Radius of the ring about the recorded point."""
MARGIN = 0.03
"""Share of an axis that is shown beyond its ends."""
CIRCLE_POINTS = 181
"""Points of a line of equal distance: every 2 degrees."""


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
    x_span = widened(first.low, first.high, 0.0, MARGIN)
    y_span = widened(second.low, second.high, 0.0, MARGIN) if second else (-1.0, 1.0)
    plane = Plane(x_span, y_span, WIDTH_PX, HEIGHT_PX if second else LINE_HEIGHT_PX)
    entries: list[Entry] = []
    inside = over = ""
    for name, (sign, colour, meaning) in POINTS.items():
        points = table[table["outcome"] == name]
        across = points[second.name] if second else [0.0] * len(points)
        inside += "".join(
            plane.sign(x, y, sign, colour) for x, y in zip(points[first.name], across, strict=True)
        )
        entries += [(sign, colour, f"{meaning} ({len(points)})")] if len(points) else []
    origin_y = second.origin if second else 0.0
    over += dot(float(plane.at_x(first.origin)), float(plane.at_y(origin_y)), RING_PX, "ring")
    entries.append((RECORDED, "", "as recorded"))
    if case:
        over += plane.sign(case[first.name], case[second.name] if second else 0.0, MILDEST)
        entries.append((MILDEST, "", f"mildest failure, distance {case['distance']:.3f}"))
        turn, away = np.linspace(0.0, 2.0 * np.pi, CIRCLE_POINTS), float(case["distance"])
        if second:
            along, up = first.scale * away * np.cos(turn), second.scale * away * np.sin(turn)
            inside += plane.line(first.origin + along, second.origin + up, "reference")
            entries.append(("line", "reference", "as far as that"))
        else:
            for end in (first.origin - first.scale * away, first.origin + first.scale * away):
                inside += plane.line(np.full(2, end), np.array(y_span), "reference")
    return plane.chart(
        "falsify",
        title,
        inside,
        entries=entries,
        over=over,
        y_ticks=None if second else (),
        x_title=first.label,
        y_title=second.label if second else "",
    )
