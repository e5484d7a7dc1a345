"""The figures of the paper's experiments: path (Fig. 9), S-T graph (Fig. 10), pedals (Fig. 12), and
the pedestrian varied.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from replan.core.arrays import FloatArray, arc_lengths
from replan.core.errors import ConfigError
from replan.draw.charts.axes import LEFT_PX, RIGHT_PX, Plane
from replan.draw.charts.bird_view import BirdView, drawn_road, scene
from replan.draw.charts.chart import Chart, stacked
from replan.draw.charts.curves import KINDS, Span, panel_chart, plan_graph
from replan.draw.charts.layout import together
from replan.draw.charts.subject import Moment, SceneSubject
from replan.draw.panels import Curve, Panel
from replan.draw.plan_graphs import ST
from replan.logs.scenario import Scenario
from replan.logs.states import EgoState
from replan.logs.trace import PlannedFrame, Trace

WIDTH_PX = 800.0  # Width of a figure
CURVE_PX = 190.0  # Height of a panel of curves
AROUND_M = 10.0  # Ground around the path


def path_figure(
    traces: Sequence[tuple[str, Trace]], planned: FloatArray, scenario: Scenario
) -> Chart:
    """Fig. 9: planned and driven path, and below them the lateral error over station, because the
    paths coincide.

    `traces`: controllers and drives; the path of the first drive and the errors of all drives are
    drawn. `planned`: points `(n, 2)` of the plans of the first drive.
    """
    name, first = traces[0]
    x, y = (
        (float(axis.min()) - AROUND_M, float(axis.max()) + AROUND_M)
        for axis in (first.ego.x, first.ego.y)
    )
    high = (WIDTH_PX - LEFT_PX - RIGHT_PX) * (y[1] - y[0]) / (x[1] - x[0])
    plane = Plane(x, y, WIDTH_PX, 0.0)
    plane = replace(plane, height=high - plane.inner[1])
    inside = drawn_road(BirdView(plane, EgoState(0.0, 0.0, 0.0, 0.0, 0.0)), scenario)
    inside += plane.line(planned[:, 0], planned[:, 1], "paper_plan")
    inside += plane.line(first.ego.x, first.ego.y, "curve1")
    entries = [("line", "paper_plan", "planned"), ("line", "curve1", f"driven ({name})")]
    titles = dict[str, Any](entries=entries, x_title="x [m]", y_title="y [m]")
    drawn = [plane.chart("path", "Planned and driven path", inside, **titles)]
    errors = []
    for label, trace in traces:
        if trace.tracking is not None:
            station = arc_lengths(trace.ego.x, trace.ego.y)
            errors.append(Curve(label, label, station, 1e3 * trace.tracking.lateral))
    if errors:
        panel = Panel(
            "error", "Lateral error, driven minus planned, left positive [mm]", tuple(errors), 0.1
        )
        far = max(float(curve.t[-1]) for curve in errors)
        drawn.append(
            panel_chart(panel, (0.0, far), x_title="station driven [m]", size=(WIDTH_PX, CURVE_PX))
        )
    title = "Planned and driven path"
    return stacked(drawn, "path", title, f"{title}, and the lateral error")


def st_figure(
    frames: Sequence[tuple[str, PlannedFrame]], trace: Trace, scenario: Scenario
) -> Chart:
    """Fig. 10: a row per moment, the scene at the left, the S-T graph at the right."""
    drawn = list[Chart]()
    for word, frame in frames:
        seen = SceneSubject(Moment(frame.t, word), replace(trace, frames=(frame,)), scenario)
        drawn += [scene(seen, frame.t, word), plan_graph(seen, ST, "no S-T graph")]
    return together(
        drawn, "The scene and the S-T graph of the plan", scenario.name, 2.0 * drawn[0].width + 16.0
    )


def pedals_figure(
    trace: Trace, braking: Sequence[tuple[float, float]], clear: float, limits: tuple[float, float]
) -> Chart:
    """Fig. 12: throttle, brake and speed over time; braking intervals shaded, with their duration.

    `braking`: begin and end of each braking interval, s. `clear`: time at which the walker has left
    the path, s. `limits`: limits of the time axis, s.
    """
    commanded, actuated = trace.commands, trace.actuation
    if commanded is None or actuated is None:
        raise ConfigError("the drive has no commands to draw")
    panels = [
        Panel(
            name,
            f"{name.capitalize()} [0 to 1]",
            (
                Curve("asked", "commanded", commanded.t, getattr(commanded, name)),
                Curve("done", "actuated", actuated.t, getattr(actuated, name)),
            ),
            0.05,
            floor=0.0,
        )
        for name in ("throttle", "brake")
    ]
    speed = Panel(
        "speed",
        "Speed [m/s]; dashed: the walker has left the path",
        (Curve("ego", "ego", trace.ego.t, trace.ego.v),),
        1.0,
        floor=0.0,
    )
    shaded = [Span(begin, end, f"{end - begin:.1f} s", "braking") for begin, end in braking]
    size = WIDTH_PX, CURVE_PX
    charts = [
        panel_chart(panel, limits, shaded, now=clear, size=size, kinds=KINDS)
        for panel in (*panels, speed)
    ]
    title = "Throttle, brake and speed"
    return stacked(charts, "pedals", title, f"{title} over time")


QUANTITIES = {
    "least_gap_m": ("Least gap [m]", (-1.0, 3.0)),
    "release_after_clear_s": ("Brake release after clear [s]", (-2.0, 2.0)),
    "peak_jerk_mps3": ("Peak jerk [m/s³]", (-1.0, 8.0)),
    "braking_s": ("Braking [s]", (-1.0, 6.0)),
}
"""By column: the title, and the values of full red and full blue."""
MARKS = {
    "failed": ("F", "the drive failed"),
    "contact": ("X", "contact, though braking avoids it"),
    "drive on": ("D", "contact, though driving on avoids it"),
    "unavoidable": ("u", "unavoidable contact"),
    "late release": ("L", "late release"),
    "jerk": ("J", "needless jerk"),
}
"""Letters and words for the verdicts of `replan.paper.pedestrian_grid`."""
MAP_PX = 260.0, 210.0


def grid_figure(table: pd.DataFrame) -> Chart:
    """The pedestrian grid as heat maps: a row per quantity, a column per speed of the ego.

    Letters are verdicts.
    """
    speeds = sorted(table["ego_kmh"].unique())
    charts = [
        _heat_map(table[table["ego_kmh"] == speed], column, speed)
        for column in QUANTITIES
        for speed in speeds
    ]
    marks = ", ".join(f"{letter}: {word}" for letter, word in MARKS.values())
    wide = len(speeds) * (MAP_PX[0] + 16.0) - 16.0
    return together(
        charts, "The pedestrian varied; darker: more, red: below 0, blank: no braking", marks, wide
    )


def _heat_map(cells: pd.DataFrame, column: str, ego_kmh: float) -> Chart:
    """A quantity of the cells with one speed of the ego, by delay and speed of the walker."""
    title, limits = QUANTITIES[column]
    late, walkers = (sorted(cells[name].unique()) for name in ("late_s", "walker_mps"))
    plane = Plane((0.0, float(len(late))), (0.0, float(len(walkers))), *MAP_PX)
    inside = over = ""
    for row in cells.itertuples():
        i, j = late.index(row.late_s), walkers.index(row.walker_mps)
        value = float(getattr(row, column))
        if np.isfinite(value):
            inside += plane.heat((i, i + 1.0), (j, j + 1.0), value, limits)
        if row.verdict in MARKS:
            letter, _ = MARKS[str(row.verdict)]
            over += plane.words(i + 0.5, j + 0.5, letter, "label middle title")
    return plane.chart(
        column,
        f"{title}: 0 to {limits[1]:g}",
        inside,
        over=over,
        x_title="walker comes later by [s]",
        y_title=f"ego {ego_kmh:g} km/h; walker [m/s]",
        x_ticks=[(i + 0.5, f"{value:g}") for i, value in enumerate(late)],
        y_ticks=[(j + 0.5, f"{value:g}") for j, value in enumerate(walkers)],
    )
