"""Panels of curves of a recording, with axes and legends, and layouts of views.

Layouts leave out empty views.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from replan.core.arrays import FloatArray
from replan.draw.panels import Panel
from replan.draw.plan_graphs import SL, ST
from replan.draw.recording.graphs import (
    HEIGHT,
    MARGIN_BOTTOM,
    MARGIN_LEFT,
    MARGIN_RIGHT,
    MARGIN_TOP,
    WIDTH,
    Axes,
)
from replan.draw.recording.tape import FRAME, REMOVED, SIM_TIME, SPACER, Instants, Tape, plain

Corner = Literal["RightTop", "RightBottom", "LeftTop", "LeftBottom"]
CORNERS: tuple[Corner, ...] = ("RightTop", "RightBottom", "LeftTop", "LeftBottom")
# Width of a legend, and height of one of its rows, as shares of a panel of usual size
LEGEND = 0.16, 0.14
# Largest number of labels along an axis; the viewer writes multiples of a power of ten
MOST_NUMBERS = 8.0


def draw_panels(tape: Tape, panels: Iterable[Panel], frames: FloatArray) -> None:
    """Each curve is an entity of its own; values that are not finite are gaps."""
    for panel in panels:
        for curve in panel.curves:
            entity = f"plots/{panel.name}/{curve.name}"
            mode = rr.components.InterpolationMode.StepAfter if curve.steps else None
            style = rr.SeriesLines(
                colors=[curve.colour],
                names=[plain(curve.legend)],
                widths=[curve.width],
                interpolation_mode=mode,
            )
            tape.static(entity, style)
            values = np.where(np.isfinite(curve.values), curve.values, np.nan)
            tape.rows(entity, Instants.among(curve.t, frames), rr.Scalars.columns(scalars=values))


def plot(panel: Panel, **more: Any) -> rrb.TimeSeriesView:
    """A panel as a view; `more` replaces arguments of the view if the curves are not below the
    panel's entity.

    The axis has at least two numbers. The legend is in the corner in which it hides the least of
    the curves; ties go to the first in `CORNERS`.
    """
    (low, high), wide, tall = with_two_numbers(*panel.range), *LEGEND
    begin, end = (
        min(curve.t[0] for curve in panel.curves),
        max(curve.t[-1] for curve in panel.curves),
    )
    hidden: dict[Corner, float] = dict.fromkeys(CORNERS, 0.0)
    for curve in panel.curves:
        x, y = (curve.t - begin) / max(end - begin, 1e-9), (curve.values - low) / (high - low)
        for corner in CORNERS:
            across = x > 1.0 - wide if "Right" in corner else x < wide
            room = tall * len(panel.curves) + 0.05
            hidden[corner] += float(
                np.mean(across & (y > 1.0 - room if "Top" in corner else y < room))
            )
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


def with_two_numbers(low: float, high: float) -> tuple[float, float]:
    """A range, extended if the viewer would write fewer than two numbers along it."""
    step = 10.0 ** np.ceil(np.log10((high - low) / MOST_NUMBERS) - 1e-9)
    first, last = step * np.ceil(low / step - 1e-9), step * np.floor(high / step + 1e-9)
    if last > first:
        return low, high
    margin = 0.08 * step
    if last < first:  # no number in the range
        return float(last - margin), float(first + margin)
    above, below = first + step - high, low - (first - step)
    return (
        (low, float(first + step + margin))
        if above <= below
        else (float(first - step - margin), high)
    )


PAGES = {
    "why": "Why",
    "numbers": "Solvers and costs",
    "recent": "Events until now",
    "summary": "Summary",
}
GRAPHS = {
    ST: "S-T graph: DP yellow, QP blue, actual occupancy pink",
    SL: "S-L graph: DP yellow, QP blue",
}
ROWS = {
    "overview": (
        (("speed", "progress", "displacement"), 1.2),
        (("acceleration", "jerk", "plan_acceleration", "plan_jerk"), 1.2),
        (("gap", "ttc", "change"), 1.0),
    ),
    "planner": ((("speed",), 1.2), (("stages",), 1.2)),
    "control": (
        (("speed",), 1.0),
        (("acceleration",), 1.0),
        (("pedals",), 1.0),
        (("steer",), 1.0),
        (("tracking",), 1.0),
        (("tracking_speed", "tracking_heading"), 1.0),
        (("slip",), 1.0),
        (("friction",), 1.0),
    ),
}
"""Panels of each layout in order, and their shares of the height.

The panels of one row are tabs of one place.
"""


@dataclass(frozen=True, eq=False)
class RecordingContents:
    """The contents of a recording: panels, graphs, rows of states, pages, and the corners of the
    map `(2, 2)`.
    """

    panels: Sequence[Panel]
    graphs: Sequence[Axes]
    lanes: Sequence[str]
    pages: Sequence[str]
    bounds: FloatArray

    @property
    def lanes_share(self) -> float:
        """Share of the height for the rows of states, which all have the same height."""
        return 0.35 + 0.24 * len(self.lanes)


# Share of the width of a panel that the numbers of its axis take, in a window of usual size
NUMBERS = 0.032


def blueprint(contents: RecordingContents) -> rrb.Blueprint:
    """The layouts as tabs; ValueError if a panel is in no row of `ROWS`, so that it would not be
    shown.
    """
    panels = {panel.name: panel for panel in contents.panels}
    shown = {name for row in chain.from_iterable(ROWS.values()) for name in row[0]}
    nowhere = set(panels) - shown
    if nowhere:
        raise ValueError(f"the panel '{min(nowhere)}' is in no row of ROWS: it would not be seen")
    tabs = [_overview(contents, panels)]
    if contents.graphs or "stages" in panels:  # the graphs large, the pages, and the stage times
        rows, shares = _rows("planner", panels)
        words = rrb.Vertical(
            _pages(contents, ("why",)), _pages(contents, ("numbers",)), row_shares=[1.3, 1.0]
        )
        views = (scene_behind(), *rows, _decisions(contents))
        right = rrb.Vertical(*views, row_shares=[2.0, *shares, contents.lanes_share])
        graphs = _graphs(contents)
        columns = [rrb.Vertical(*graphs), words, right] if graphs else [words, right]
        tabs.append(
            rrb.Horizontal(*columns, column_shares=[1.3, 0.9, 1.2][-len(columns) :], name="Planner")
        )
    # Two columns of curves
    if any(name in panels for names, _ in ROWS["control"][2:] for name in names):
        rows, shares = _rows("control", panels)
        half = (len(rows) + 1) // 2
        below = [_decisions(contents)] if contents.lanes else []
        columns = [rrb.Vertical(scene_behind(), *below, row_shares=[2.0, 1.0][: 1 + len(below)])]
        for part in (slice(0, half), slice(half, None)):
            if rows[part]:
                columns.append(rrb.Vertical(*rows[part], row_shares=shares[part]))
        tabs.append(rrb.Horizontal(*columns, column_shares=[1.0] * len(columns), name="Control"))
    return window(rrb.Tabs(*tabs, active_tab=0) if len(tabs) > 1 else tabs[0])


def window(contents: rrb.Container) -> rrb.Blueprint:
    """A window with these views, and nothing around them but the collapsed time panel."""
    return rrb.Blueprint(
        contents,
        rrb.TimePanel(timeline=SIM_TIME, state="collapsed"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        auto_layout=False,
        auto_views=False,
    )


def _overview(contents: RecordingContents, panels: Mapping[str, Panel]) -> rrb.Container:
    """Scenes, words and graphs on the left, curves, decisions and events on the right.

    The scene is seen from behind the ego, from above it, and as the whole map (without names).
    """
    above = rrb.EyeControls3D(
        position=[22.0, 0.0, 58.0], look_target=[22.01, 0.0, 0.0], eye_up=[1.0, 0.0, 0.0]
    )
    middle, span = contents.bounds.mean(axis=0), np.ptp(contents.bounds, axis=0)
    height = 0.75 * float(max(span[0], 1.6 * span[1], 40.0))
    whole = rrb.EyeControls3D(
        position=[middle[0], middle[1], height],
        look_target=[middle[0], middle[1] + 0.01, 0.0],
        eye_up=[0.0, 1.0, 0.0],
    )
    scenes = rrb.Tabs(
        scene_behind(),
        _scene("From above", "/world/ego", ["+ /world/**"], above),
        _scene(
            "Map",
            "/world",
            ["+ /world/**", "- /world/agents/names", "- /world/agents/velocity"],
            whole,
        ),
        active_tab=0,
    )
    top = rrb.Horizontal(scenes, _pages(contents, ("why", "summary")), column_shares=[1.75, 1.0])
    graphs = _graphs(contents)
    left = [top, rrb.Horizontal(*graphs)] if graphs else [top]
    rows, shares = _rows("overview", panels)
    if contents.lanes:
        columns = rrb.TextLogColumns(
            timeline_columns=[SIM_TIME], text_log_columns=["LogLevel", "Body"]
        )
        events = rrb.TextLogView(origin="/events", name="All events", columns=columns)
        rows += [
            _decisions(contents),
            rrb.Tabs(*_page_views(contents, ("recent",)), events, active_tab=0),
        ]
        shares += [contents.lanes_share, 0.9]
    return rrb.Horizontal(
        rrb.Vertical(*left, row_shares=[1.35, 1.0][: len(left)]),
        rrb.Vertical(*rows, row_shares=shares),
        column_shares=[1.75, 1.0],
        name="Overview",
    )


def scene_behind(name: str = "Scene", under: str = "") -> rrb.Spatial3DView:
    """The scene from behind the ego; `under`: the entity that contains the recording ("/A")."""
    eye = rrb.EyeControls3D(
        position=[-18.0, 0.0, 13.0], look_target=[14.0, 0.0, 0.0], eye_up=[0.0, 0.0, 1.0]
    )
    return _scene(name, f"{under}/world/ego", [f"+ {under}/world/**"], eye, under)


def _scene(
    name: str, origin: str, contents: list[str], eye: rrb.EyeControls3D, under: str = ""
) -> rrb.Spatial3DView:
    """A view of the scene; the driven path is shown up to the cursor, removed tracks are hidden."""
    begin, cursor = rrb.TimeRangeBoundary.infinite(), rrb.TimeRangeBoundary.cursor_relative()
    ranges = [
        rrb.VisibleTimeRange(timeline, start=begin, end=cursor) for timeline in (SIM_TIME, FRAME)
    ]
    driven = rrb.VisibleTimeRanges(ranges)
    return rrb.Spatial3DView(
        origin=origin,
        contents=contents,
        name=name,
        eye_controls=eye,
        line_grid=False,
        overrides={
            f"{under}/world/driven": [driven],
            f"{under}/{REMOVED}": [rrb.EntityBehavior(visible=False)],
        },
    )


def _graphs(contents: RecordingContents) -> list[rrb.View]:
    return [graph_view(GRAPHS[axes.kind], "/graphs", f"/{axes.entity}") for axes in contents.graphs]


def graph_view(name: str, origin: str, entity: str) -> rrb.Spatial2DView:
    """A graph with its axes."""
    x, y = [-MARGIN_LEFT, WIDTH + MARGIN_RIGHT], [-HEIGHT - MARGIN_TOP, MARGIN_BOTTOM]
    bounds = rrb.VisualBounds2D(x_range=x, y_range=y)
    return rrb.Spatial2DView(
        origin=origin, contents=f"{entity}/**", name=name, visual_bounds=bounds
    )


def _rows(
    layout: str, panels: Mapping[str, Panel]
) -> tuple[list[rrb.Container | rrb.View], list[float]]:
    """The rows of curves of a layout that have a panel, and their shares."""
    rows = [
        ([plot(panels[name]) for name in names if name in panels], share)
        for names, share in ROWS[layout]
    ]
    return (
        [
            rrb.Tabs(*views, active_tab=0) if len(views) > 1 else views[0]
            for views, _ in rows
            if views
        ],
        [share for views, share in rows if views],
    )


def _pages(contents: RecordingContents, names: Sequence[str]) -> rrb.Container:
    """Pages as tabs of one place, without those that the recording does not have."""
    return rrb.Tabs(
        *_page_views(contents, names) or _page_views(contents, ("summary",)), active_tab=0
    )


def _page_views(contents: RecordingContents, names: Sequence[str]) -> list[rrb.View]:
    return [
        rrb.TextDocumentView(origin=f"/{name}", name=PAGES[name])
        for name in names
        if name in contents.pages
    ]


def _decisions(contents: RecordingContents) -> rrb.Container:
    name = "Decisions and status" if "why" in contents.pages else "Events"
    return lanes_beside_numbers(state_view(name, contents.lanes))


def state_view(name: str, lanes: Sequence[str], under: str = "") -> rrb.StateTimelineView:
    """Rows of states; `under`: the entity that contains the recording ("/A")."""
    shown = [f"{under}/{lane}" for lane in lanes]
    return rrb.StateTimelineView(
        origin=under or "/", contents=shown, name=name, time_view=time_axis()
    )


def lanes_beside_numbers(lanes: rrb.Container | rrb.View, under: str = "") -> rrb.Container:
    """Rows of states with an empty view on their left, so that their time axis is aligned with that
    of the curves.
    """
    room = rrb.TextDocumentView(origin=f"{under}/{SPACER}", name=" ", titlebar=False)
    return rrb.Horizontal(room, lanes, column_shares=[NUMBERS, 1.0 - NUMBERS])
