"""The figures of the paper: each function only draws its arguments.

matplotlib is imported when the first figure is made, with the Agg canvas: no display, no global state.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from logs.arrays import FloatArray
from logs.errors import ConfigError
from logs.plan import StGraph
from logs.scenario import Scenario
from logs.shapes import corners
from logs.trace import PlannedFrame, Trace
from replay.results.tables import write_file
from replay.world import box_center

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DP, QP, OBSTACLE = "#d62728", "#1f5fb4", "#111111"
PLANNED, DRIVEN = "#f2a65a", "#1f5fb4"
ROAD, OTHER, LINE = "#e6e6e6", "#f3f1ea", "#9a9a9a"
STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.titlelocation": "left",
    "axes.titlesize": 10.0,
    "legend.frameon": False,
}
DPI = 120
BEHIND_M, AHEAD_M, BESIDE_M = 8.0, 42.0, 8.0


def save(figure: Figure, path: Path) -> None:
    """Write the picture in the format of the path's suffix; the same figure gives the same bytes."""
    write_file(path, lambda partial: figure.savefig(partial, dpi=DPI, metadata={"Software": None}))


def empty_figure(width: float, height: float) -> Figure:
    """An empty figure in inches, with its canvas.

    Raises:
        ConfigError: matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise ConfigError("figures need matplotlib, which is not installed") from None
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def path_figure(traces: Sequence[tuple[str, Trace]], planned: FloatArray, scenario: Scenario) -> Figure:
    """Fig. 9: planned and driven path, and below them the lateral error over station, because the paths coincide.

    Args:
        traces: Controllers and drives; the path of the first drive and the errors of all drives are drawn.
        planned: Points `(n, 2)` of the plans of the first drive.
        scenario: The road.
    """
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        figure = empty_figure(8.0, 5.6)
        above, below = figure.subplots(2, 1, height_ratios=(2.2, 1.0))
        _lanes(above, scenario)
        name, first = traces[0]
        above.plot(*planned.T, color=PLANNED, lw=5.0, solid_capstyle="round", label="planned")
        above.plot(first.ego.x, first.ego.y, color=DRIVEN, lw=1.3, label=f"driven ({name})")
        above.set_aspect("equal")
        above.set(xlabel="x [m]", ylabel="y [m]", title="Planned and driven path")
        x, y = first.ego.x, first.ego.y
        above.set(xlim=(x.min() - 10.0, x.max() + 10.0), ylim=(y.min() - 10.0, y.max() + 10.0))
        above.legend(loc="upper left")
        for (label, trace), color in zip(traces, (DRIVEN, DP, "#3a923a", "#888888"), strict=False):
            if trace.tracking is not None:
                station = np.r_[0.0, np.cumsum(np.hypot(np.diff(trace.ego.x), np.diff(trace.ego.y)))]
                below.plot(station, 1e3 * trace.tracking.lateral, color=color, lw=1.3, label=label)
        below.axhline(0.0, color=LINE, lw=0.8)
        below.set(xlabel="station driven [m]", ylabel="lateral error [mm]", title="Driven minus planned, left positive")
        below.set_xlim(0.0, None)
        if below.get_legend_handles_labels()[0]:
            below.legend(ncols=2, loc="best")
        return figure


def st_figure(frames: Sequence[tuple[str, PlannedFrame]], trace: Trace, scenario: Scenario) -> Figure:
    """Fig. 10: a row per moment, the scene at the left, the S-T graph (DP red, QP blue) at the right."""
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        figure = empty_figure(12.0, 2.7 * len(frames))
        rows = figure.subplots(len(frames), 2, width_ratios=(1.5, 1.0), squeeze=False)
        graphs = [
            next((artefact for artefact in frame.plan.internals if isinstance(artefact, StGraph)), None)
            for _, frame in frames
        ]
        top = max([float(np.nanmax(g.qp[:, 1])) for g in graphs if g and len(g.qp)], default=50.0)
        for (scene, plane), (word, frame), graph in zip(rows, frames, graphs, strict=True):
            ego, car = trace.ego.at(frame.t), scenario.vehicle
            _lanes(scene, scenario)
            plan = frame.plan.trajectory
            scene.plot(plan.x, plan.y, color=QP, lw=1.2)
            dots = plan.resampled(np.arange(np.ceil(plan.t[0]), plan.t[-1] + 1e-9))
            scene.plot(dots.x, dots.y, "o", color=QP, markersize=3.0)
            x, y = box_center(ego, car)
            scene.fill(*corners(x, y, ego.yaw, car.length, car.width).T, fc=QP, ec="black", lw=0.6, alpha=0.8, zorder=3)
            agents = trace.agents.truth(frame.t)
            for i in range(len(agents)):
                box = corners(*(float(v[i]) for v in (agents.x, agents.y, agents.yaw, agents.length, agents.width)))
                scene.fill(*box.T, fc=OBSTACLE, zorder=4)
                if agents.speed[i] > 0.05:
                    tip = 1.5 * agents.vx[i], 1.5 * agents.vy[i]
                    scene.arrow(agents.x[i], agents.y[i], *tip, width=0.08, head_width=0.5, color=OBSTACLE, zorder=4)
            scene.set_aspect("equal")
            scene.set_xlim(ego.x - BEHIND_M, ego.x + AHEAD_M)
            scene.set_ylim(ego.y - BESIDE_M, ego.y + BESIDE_M)
            scene.set_ylabel("y [m]")
            scene.grid(visible=False)
            scene.set_title(f"{word}: t = {frame.t:.1f} s")
            plane.set(ylabel="station along the path [m]", xlim=(0.0, 8.0), ylim=(0.0, 1.05 * top))
            if graph is None:
                plane.text(0.5, 0.5, "no S-T graph", transform=plane.transAxes, ha="center")
                continue
            for obstacle in graph.obstacles:
                plane.fill(*obstacle.outline.T, fc=OBSTACLE, alpha=0.25, lw=0.0)
                plane.plot(*np.vstack([obstacle.outline, obstacle.outline[:1]]).T, color=OBSTACLE, lw=1.6)
            plane.plot([], [], color=OBSTACLE, lw=1.6, label="obstacle")
            dp, qp = graph.dp, graph.qp
            plane.plot(dp[:, 0], dp[:, 1], color=DP, lw=1.4, marker="o", markersize=3.0, markevery=10, label="DP")
            plane.plot(qp[:, 0], qp[:, 1], color=QP, lw=1.8, label="QP")
            plane.set_title("S-T graph" if graph.obstacles else "S-T graph: no obstacle")
        rows[0, 1].legend(loc="upper left")
        rows[-1, 0].set_xlabel("x [m]")
        rows[-1, 1].set_xlabel("time from the frame [s]")
        return figure


def pedals_figure(
    trace: Trace, braking: Sequence[tuple[float, float]], clear: float, limits: tuple[float, float]
) -> Figure:
    """Fig. 12: throttle, brake and speed over time; braking intervals shaded, with their duration.

    Args:
        trace: A closed loop.
        braking: Begin and end of each braking interval, s.
        clear: Time at which the walker has left the path, s.
        limits: Limits of the time axis, s.
    """
    import matplotlib as mpl

    if trace.commands is None or trace.actuation is None:
        raise ConfigError("the drive has no commands to draw")
    with mpl.rc_context(STYLE):
        figure = empty_figure(8.0, 6.0)
        panels = figure.subplots(3, 1, sharex=True)
        for panel, name, color in zip(panels[:2], ("throttle", "brake"), (DRIVEN, DP), strict=True):
            panel.plot(trace.commands.t, getattr(trace.commands, name), color=color, lw=1.4, label="commanded")
            actual = getattr(trace.actuation, name)
            panel.plot(trace.actuation.t, actual, color="#555555", lw=0.9, ls="--", label="actuated")
            panel.set(ylabel=f"{name} [0 to 1]", title=name.capitalize())
            panel.set_ylim(0.0, 1.15 * max(float(np.nanmax(getattr(trace.commands, name))), 0.05))
            panel.legend(loc="upper right")
        panels[2].plot(trace.ego.t, trace.ego.v, color="#333333", lw=1.4)
        panels[2].set(xlabel="time [s]", ylabel="speed [m/s]", title="Speed", xlim=limits)
        panels[2].set_ylim(0.0, None)
        for panel in panels:
            for begin, end in braking:
                panel.axvspan(begin, end, color=DP, alpha=0.12, lw=0.0)
            panel.axvline(clear, color="#3a923a", lw=1.2, ls=":")
        height = 0.93 * panels[1].get_ylim()[1]
        for begin, end in braking:  # a double arrow with the duration
            panels[1].annotate("", (begin, height), (end, height), arrowprops={"arrowstyle": "<->", "color": DP})
            panels[1].text(0.5 * (begin + end), height, f"{end - begin:.1f} s", color=DP, ha="center", va="bottom")
        panels[2].annotate(
            "walker has left the path", (clear, 0.0), (4.0, 5.0), textcoords="offset points", color="#3a923a"
        )
        return figure


QUANTITIES = (
    ("least_gap_m", "least gap [m]", "viridis", (0.0, 3.0)),
    ("release_after_clear_s", "brake released after\nthe path is clear [s]", "RdBu_r", (-2.0, 2.0)),
    ("peak_jerk_mps3", "peak jerk [m/s$^3$]", "magma_r", (0.0, 8.0)),
    ("braking_s", "braking [s]", "Blues", (0.0, 6.0)),
)
MARKS = {
    "failed": ("F", "the drive failed"),
    "contact": ("X", "contact, though braking avoids it"),
    "drive on": ("D", "contact, though driving on avoids it"),
    "unavoidable": ("u", "unavoidable contact"),
    "late release": ("L", "late release"),
    "jerk": ("J", "needless jerk"),
}
"""Letters and words for the verdicts of `replay.paper.pedestrian_grid`."""
MARK_STYLE: dict[str, Any] = {
    "ha": "center", "va": "center", "fontsize": 7, "weight": "bold",
    "bbox": {"boxstyle": "round,pad=0.15", "fc": "white", "ec": "black", "lw": 0.5, "alpha": 0.85},
}  # fmt: skip


def grid_figure(table: pd.DataFrame) -> Figure:
    """The pedestrian grid as heat maps: a row per quantity, a column per speed of the ego; letters are verdicts."""
    import matplotlib as mpl

    speeds = sorted(table["ego_kmh"].unique())
    with mpl.rc_context({**STYLE, "axes.grid": False, "axes.spines.top": True, "axes.spines.right": True}):
        figure = empty_figure(3.1 * len(speeds) + 1.0, 2.4 * len(QUANTITIES) + 0.5)
        rows = figure.subplots(len(QUANTITIES), len(speeds), squeeze=False, sharex=True, sharey=True)
        for panels, (column, label, colors, bounds) in zip(rows, QUANTITIES, strict=True):
            for axes, speed in zip(panels, speeds, strict=True):
                cells = table[table["ego_kmh"] == speed]
                values = cells.pivot(index="walker_mps", columns="late_s", values=column)
                x, y = values.columns.to_numpy(dtype=float), values.index.to_numpy(dtype=float)
                shown = np.ma.masked_invalid(values.to_numpy(dtype=float))
                look = {"cmap": mpl.colormaps[colors], "vmin": bounds[0], "vmax": bounds[1], "shading": "nearest"}
                axes.set_facecolor("#d0d0d0")
                mesh = axes.pcolormesh(x, y, shown, edgecolors="w", lw=0.4, **look)
                for late, walker, word in zip(cells["late_s"], cells["walker_mps"], cells["verdict"], strict=True):
                    if word in MARKS:
                        axes.text(late, walker, MARKS[word][0], **MARK_STYLE)
                axes.set_yticks(y)
            figure.colorbar(mesh, ax=list(panels), label=label, extend="both", pad=0.01)
            panels[0].set_ylabel("walker [m/s]")
        for axes, speed in zip(rows[0], speeds, strict=True):
            axes.set_title(f"ego {speed:g} km/h")
        for axes in rows[-1]:
            axes.set_xlabel("walker comes later by [s]")
        marks = ", ".join(f"{letter}: {word}" for letter, word in MARKS.values())
        figure.suptitle(f"{marks}; grey: no braking", x=0.01, ha="left", fontsize=10)
        return figure


def _lanes(axes: Axes, scenario: Scenario) -> None:
    for lane in scenario.road.lanes.values():
        axes.fill(*lane.polygon.T, fc=ROAD if lane.drivable else OTHER, lw=0.0, zorder=0)
        for side in (lane.left, lane.right):
            axes.plot(*side.T, color=LINE, lw=0.7, zorder=0.5)
