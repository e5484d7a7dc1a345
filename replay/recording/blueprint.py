"""What is shown where: the views of a recording, only those that have something to show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun.blueprint as rrb

from logs.kernel import FloatArray
from replay.recording.axes import (
    HEIGHT,
    MARGIN_BOTTOM,
    MARGIN_LEFT,
    MARGIN_RIGHT,
    MARGIN_TOP,
    WIDTH,
    Axes,
)
from replay.recording.columns import FRAME, SIM_TIME
from replay.recording.plots import Panel


@dataclass(frozen=True, eq=False)
class Contents:
    """What there is to show: panels, graphs, which pages, and the corners of the map `(2, 2)`."""

    panels: Sequence[Panel]
    st: Axes | None
    sl: Axes | None
    lanes: bool
    pages: Sequence[str]
    bounds: FloatArray


PAGES = {"why": "Why", "summary": "Summary"}
ROWS = (
    (("speed",), 1.2),
    (("acceleration", "jerk"), 1.2),
    (("pedals", "steer", "error_across", "error_along", "stages"), 1.0),
)
"""Panels from top to bottom and their shares of the height; those of one row are tabs of one place."""


def blueprint(contents: Contents) -> rrb.Blueprint:
    """Scene, words and graphs on the left, curves on the right."""
    pages = rrb.Tabs(*(_page(page) for page in contents.pages), active_tab=0)
    top = rrb.Horizontal(_scenes(contents.bounds), pages, column_shares=[1.75, 1.0])
    left: list[rrb.Container | rrb.View] = [top]
    graphs = [
        _graph(axes, name)
        for axes, name in (
            (contents.st, "S-T graph: DP yellow, QP blue"),
            (contents.sl, "S-L graph: DP yellow, QP blue"),
        )
        if axes
    ]
    if graphs:
        left.append(rrb.Horizontal(*graphs))
    right, shares = _right(contents)
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(*left, row_shares=[1.35, 1.0][: len(left)]),
            rrb.Vertical(*right, row_shares=shares),
            column_shares=[1.75, 1.0],
        ),
        rrb.TimePanel(timeline=SIM_TIME, state="collapsed"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        auto_layout=False,
        auto_views=False,
    )


def _scenes(bounds: FloatArray) -> rrb.Tabs:
    """The same scene thrice: from behind the ego, from above it, and the whole map (without names)."""
    behind = rrb.EyeControls3D(position=[-18.0, 0.0, 13.0], look_target=[14.0, 0.0, 0.0], eye_up=[0.0, 0.0, 1.0])
    above = rrb.EyeControls3D(position=[22.0, 0.0, 58.0], look_target=[22.01, 0.0, 0.0], eye_up=[1.0, 0.0, 0.0])
    middle, span = bounds.mean(axis=0), np.ptp(bounds, axis=0)
    height = 0.75 * float(max(span[0], 1.6 * span[1], 40.0))
    whole = rrb.EyeControls3D(
        position=[middle[0], middle[1], height], look_target=[middle[0], middle[1] + 0.01, 0.0], eye_up=[0.0, 1.0, 0.0]
    )
    views = (
        _scene("Scene", "/world/ego", ["+ /world/**"], behind),
        _scene("From above", "/world/ego", ["+ /world/**"], above),
        _scene("Map", "/world", ["+ /world/**", "- /world/agents/names", "- /world/agents/velocity"], whole),
    )
    return rrb.Tabs(*views, active_tab=0)


def _scene(name: str, origin: str, contents: list[str], eye: rrb.EyeControls3D) -> rrb.Spatial3DView:
    """A view of the scene; the driven path is shown from its begin to the cursor."""
    begin, cursor = rrb.TimeRangeBoundary.infinite(), rrb.TimeRangeBoundary.cursor_relative()
    driven = rrb.VisibleTimeRanges(
        [rrb.VisibleTimeRange(timeline, start=begin, end=cursor) for timeline in (SIM_TIME, FRAME)]
    )
    return rrb.Spatial3DView(
        origin=origin,
        contents=contents,
        name=name,
        eye_controls=eye,
        line_grid=False,
        overrides={"/world/driven": [driven]},
    )


def _graph(axes: Axes, name: str) -> rrb.Spatial2DView:
    bounds = rrb.VisualBounds2D(
        x_range=[-MARGIN_LEFT, WIDTH + MARGIN_RIGHT], y_range=[-HEIGHT - MARGIN_TOP, MARGIN_BOTTOM]
    )
    return rrb.Spatial2DView(origin="/graphs", contents=f"/{axes.entity}/**", name=name, visual_bounds=bounds)


def _right(contents: Contents) -> tuple[list[rrb.Container | rrb.View], list[float]]:
    views: list[rrb.Container | rrb.View] = []
    shares: list[float] = []
    panels = {panel.entity.removeprefix("plots/"): panel for panel in contents.panels}
    nowhere = set(panels) - {name for names, _ in ROWS for name in names}
    if nowhere:
        raise ValueError(f"the panel '{min(nowhere)}' is in no row of ROWS: it would not be seen")
    for names, share in ROWS:
        row = [_plot(panels[name]) for name in names if name in panels]
        if row:
            views.append(rrb.Tabs(*row, active_tab=0) if len(row) > 1 else row[0])
            shares.append(share)
    if contents.lanes:
        decided = rrb.StateTimelineView(origin="/state", name="Decisions and status", time_view=_time_axis())
        views += [decided, _events()]
        shares += [1.75, 1.0]
    return views, shares


def _page(page: str) -> rrb.View:
    return rrb.TextDocumentView(origin=f"/{page}", name=PAGES[page])


def _events() -> rrb.View:
    columns = rrb.TextLogColumns(timeline_columns=[SIM_TIME], text_log_columns=["LogLevel", "Body"])
    return rrb.TextLogView(origin="/events", name="Events", columns=columns)


def _time_axis() -> rrb.TimeAxis:
    return rrb.TimeAxis(link="LinkToGlobal")


def _plot(panel: Panel) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=f"/{panel.entity}",
        name=panel.title,
        axis_x=_time_axis(),
        axis_y=rrb.ScalarAxis(range=panel.y_range),
        plot_legend=rrb.PlotLegend(corner="RightTop"),
        interaction=rrb.PlotInteraction(tooltip_mode="All"),
    )
