"""The panels of curves in a recording: their entities, axes and legends."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from logs.kernel import FloatArray
from replay.draw.curves import Panel
from replay.draw.recording.tape import Instants, Tape
from replay.draw.recording.text import plain

Corner = Literal["RightTop", "RightBottom", "LeftTop", "LeftBottom"]
CORNERS: tuple[Corner, ...] = ("RightTop", "RightBottom", "LeftTop", "LeftBottom")
LEGEND = 0.16, 0.14
"""Width of a legend, and height of one of its rows, as shares of a panel of usual size."""
MOST_NUMBERS = 8.0
"""The viewer writes multiples of a power of ten along an axis, as many as fit: no more than this."""


def draw_panels(tape: Tape, panels: Iterable[Panel], frames: FloatArray) -> None:
    """Each curve is an entity of its own; values that are not finite are gaps."""
    for panel in panels:
        for curve in panel.curves:
            entity = f"plots/{panel.name}/{curve.name}"
            mode = rr.components.InterpolationMode.StepAfter if curve.steps else None
            style = rr.SeriesLines(
                colors=[curve.colour], names=[plain(curve.legend)], widths=[curve.width], interpolation_mode=mode
            )
            tape.static(entity, style)
            values = np.where(np.isfinite(curve.values), curve.values, np.nan)
            tape.rows(entity, Instants.among(curve.t, frames), rr.Scalars.columns(scalars=values))


def plot(panel: Panel, **more: Any) -> rrb.TimeSeriesView:
    """A panel as a view; `more` if its curves are not those below its entity.

    Its legend is in the corner of `CORNERS` in which it hides least of the curves, the first of the best.
    """
    (low, high), wide, tall = axis_range(panel), *LEGEND
    begin, end = min(curve.t[0] for curve in panel.curves), max(curve.t[-1] for curve in panel.curves)
    hidden: dict[Corner, float] = dict.fromkeys(CORNERS, 0.0)
    for curve in panel.curves:
        x, y = (curve.t - begin) / max(end - begin, 1e-9), (curve.values - low) / (high - low)
        for corner in CORNERS:
            across = x > 1.0 - wide if "Right" in corner else x < wide
            room = tall * len(panel.curves) + 0.05
            hidden[corner] += float(np.mean(across & (y > 1.0 - room if "Top" in corner else y < room)))
    corner = min(CORNERS, key=hidden.__getitem__)
    return rrb.TimeSeriesView(
        **{"origin": f"/plots/{panel.name}", **more},
        name=panel.title,
        axis_x=time_axis(),
        axis_y=rrb.ScalarAxis(range=(low, high)),
        plot_legend=rrb.PlotLegend(corner=corner),
        interaction=rrb.PlotInteraction(tooltip_mode="All"),
    )


def time_axis() -> rrb.TimeAxis:
    """The time axis that all curves and rows of states share."""
    return rrb.TimeAxis(link="LinkToGlobal")


def axis_range(panel: Panel) -> tuple[float, float]:
    """All finite values (of spiky curves 96 in 100), with a margin, and at least two numbers on the axis."""
    spans = [np.percentile(curve.known, (2.0, 98.0) if curve.spiky else (0.0, 100.0)) for curve in panel.curves]
    low, high = float(np.min(spans)), float(np.max(spans))
    middle, half = 0.5 * (low + high), 0.57 * max(high - low, panel.least)
    return with_two_numbers(middle - half, middle + half)


def with_two_numbers(low: float, high: float) -> tuple[float, float]:
    """A range, extended if the viewer would write fewer than two numbers along it."""
    step = 10.0 ** np.ceil(np.log10((high - low) / MOST_NUMBERS) - 1e-9)
    first, last = step * np.ceil(low / step - 1e-9), step * np.floor(high / step + 1e-9)
    if last > first:
        return low, high
    margin = 0.08 * step
    if last < first:  # none
        return float(last - margin), float(first + margin)
    above, below = first + step - high, low - (first - step)
    return (low, float(first + step + margin)) if above <= below else (float(first - step - margin), high)
