"""Recordings: a drive or a log as one .rrd file with its views in it. The only package that writes
with rerun.

Import this package only where something is drawn: it loads the viewer's library. It draws, and
computes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from hashlib import sha256
from math import ceil
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from replan.core.arrays import FloatArray
from replan.core.memory import trim_memory
from replan.draw.markers import Marker
from replan.draw.panels import panels, stage_panel, steps_of
from replan.draw.plan_graphs import SL, ST, DrawnGraph, GraphKind
from replan.draw.recording import pages, plots, state_rows
from replan.draw.recording.graphs import Axes, draw_graph, draw_occupancy
from replan.draw.recording.moving import draw_moving, draw_others, draw_scene
from replan.draw.recording.plots import RecordingContents, blueprint
from replan.draw.recording.tape import Instants, Tape, field_name, path_parts, recording_file
from replan.explain.drive_events import TimedEvent, events
from replan.explain.planner_input import actual_occupancy
from replan.logs.frame_store import light
from replan.logs.nearby_tracks import NearbyTracks
from replan.logs.scenario import Scenario
from replan.logs.trace import EndReason, Mode, PlannedFrame, Trace

if TYPE_CHECKING:
    from pandas import DataFrame

    from replan.replay.drive import Drive

__all__ = ["write_log_recording", "write_recording"]

SCENE_STEP_S = 0.1
PART, SAMPLE = 500, 1000
"""The number of frames that are drawn at once, and the largest number of frames that determine the
axes of graphs.
"""


def write_recording(
    path: Path,
    drive: Drive,
    scenario: Scenario,
    table: DataFrame | None = None,
    steps: DataFrame | None = None,
) -> None:
    """Write one drive as a recording: scene, graphs, curves, decisions and the reasons for them.

    `path`: the .rrd file; it appears only when it is complete. `table`: rows of
    `replan.metrics.evaluate` for this trace; None: no metrics in the summary. `steps`: rows of
    `metrics.series` for this trace; None: no curves of metrics. OutputError if the file cannot be
    written.
    """
    whole, trace = drive.trace, replace(drive.trace, frames=light(drive.trace.frames))
    times = scene_times(trace, float(trace.ego.t[-1]))
    frames = np.array([frame.t for frame in trace.frames]) if trace.frames else times
    instants, planned = Instants.among(times, frames), Instants.among(frames, frames)
    sample = whole.frames[:: max(1, ceil(len(frames) / SAMPLE))]
    axes = dict[GraphKind, Axes]()
    for kind in (ST, SL):
        axis = Axes.of([graph for graph in _graphs(sample, kind) if graph], kind)
        if axis is not None:
            axes[kind] = axis
    del sample
    curves = panels(trace, scenario, steps_of(steps))
    curves += stage_panel(drive.timings, path_parts(timing.stage for timing in drive.timings))
    names = ("why", "numbers", "recent", "summary") if trace.frames else ("recent", "summary")
    lanes = state_rows.state_lanes(trace, scenario.road)
    lanes += state_rows.driver_lanes(scenario.driving, *map(float, trace.ego.t[[0, -1]]))
    contents = RecordingContents(
        curves, list(axes.values()), [lane.name for lane in lanes], names, _bounds(trace, scenario)
    )
    application = f"replan {scenario.name} {trace.mode.value} loop"
    short = scenario.short_names
    with recording_file(
        path, application, trace.planner, _digest(trace), blueprint(contents), short
    ) as tape:
        draw_scene(tape, trace, scenario, instants)
        for begin in range(0, len(planned), PART):
            part = range(begin, begin + PART)
            _draw_part(tape, whole, scenario, instants.within(part), planned.within(part), axes)
            if len(planned) > PART:
                trim_memory()
        plots.draw_panels(tape, curves, frames)
        state_rows.draw_lanes(tape, lanes, frames)
        pages.draw_events(tape, events(trace), planned)
        pages.draw_summary(tape, pages.summary(whole, scenario, table))
        if table is not None:  # properties of the recording, each a column in a table of recordings
            shown = table[table["available"] & np.isfinite(table["value"].to_numpy(dtype=float))]
            values = {
                field_name(name): float(v)
                for name, v in zip(shown["metric"], shown["value"], strict=True)
            }
            if values:
                tape.stream.send_property(
                    "metrics", rr.AnyValues(drop_untyped_nones=True, **values)
                )


def _draw_part(
    tape: Tape,
    whole: Trace,
    scenario: Scenario,
    instants: Instants,
    planned: Instants,
    axes: Mapping[GraphKind, Axes],
) -> None:
    """Draw agents, plans and graphs of some frames, so that only these frames of a long drive are
    in memory.
    """
    frames = whole.frames[int(planned.frame[0]) : int(planned.frame[-1]) + 1]
    begin = min([float(instants.t[0]), *(frame.t for frame in frames[:1])])
    end = max([float(instants.t[-1]), *(float(frame.plan.trajectory.t[-1]) for frame in frames)])
    perceived = None if whole.perceived is None else NearbyTracks().of(whole.perceived, begin, end)
    trace = replace(
        whole,
        frames=frames,
        agents=NearbyTracks().of(whole.agents, begin, end),
        perceived=perceived,
    )
    draw_moving(tape, trace, frozenset(whole.agents.kinds), instants, planned)
    draw_others(tape, trace, planned)
    for kind, axis in axes.items():
        draw_graph(tape, planned, _graphs(frames, kind), axis)
    if ST in axes:
        draw_occupancy(tape, planned, list(actual_occupancy(trace, scenario)), axes[ST])
    if frames:
        pages.draw_why(tape, trace, scenario, planned)


def write_log_recording(path: Path, scenario: Scenario, markers: Sequence[Marker] = ()) -> None:
    """Write a log by itself: the scene, the ego's speed, acceleration and steering, and markers on
    the timeline.

    OutputError if the file cannot be written.
    """
    trace = Trace(
        scenario.name,
        "log",
        Mode.OPEN,
        False,
        scenario.ego,
        scenario.tracks,
        (),
        EndReason.END_OF_LOG,
    )
    times = scene_times(trace, scenario.duration)
    curves = panels(trace, scenario, steps_of(None))
    lanes = state_rows.marker_lanes(markers, float(times[-1]))
    lanes += state_rows.driver_lanes(scenario.driving, *map(float, times[[0, -1]]))
    names = ("recent", "summary") if lanes else ("summary",)
    contents = RecordingContents(
        curves, (), [lane.name for lane in lanes], names, _bounds(trace, scenario)
    )
    instants = Instants.among(times, times)
    application, short = f"replan {scenario.name} log", scenario.short_names
    with recording_file(
        path, application, "log", _digest(trace), blueprint(contents), short
    ) as tape:
        draw_scene(tape, trace, scenario, instants)
        draw_moving(tape, trace, frozenset(trace.agents.kinds), instants, instants)
        plots.draw_panels(tape, curves, times)
        if lanes:
            state_rows.draw_lanes(tape, lanes, times)
            begins = [
                TimedEvent(marker.begin, "INFO", marker.words)
                for marker in sorted(markers, key=attrgetter("begin"))
            ]
            pages.draw_events(tape, begins, instants)
        pages.draw_summary(tape, pages.log_summary(scenario))


def scene_times(trace: Trace, end: float) -> FloatArray:
    """Times at which the scene is drawn: every frame, every `SCENE_STEP_S` where frames are rarer,
    and the end.
    """
    start = float(trace.ego.t[0])
    frames = np.array([frame.t for frame in trace.frames])
    grid = start + SCENE_STEP_S * np.arange(int(np.floor((end - start) / SCENE_STEP_S + 1e-9)) + 1)
    if len(frames):
        padded = np.r_[-np.inf, frames, np.inf]
        after = np.searchsorted(padded, grid)
        gap = np.minimum(grid - padded[after - 1], padded[after] - grid)
        grid = np.r_[frames, grid[gap > 0.75 * SCENE_STEP_S]]
    times = np.unique(np.round(np.r_[grid, end], 9))
    return times[times <= end + 1e-9] if (times <= end + 1e-9).any() else times


def _graphs(frames: Sequence[PlannedFrame], kind: GraphKind) -> list[DrawnGraph | None]:
    """The first graph of a kind in each frame."""
    return [DrawnGraph.of(frame.plan, kind) for frame in frames]


def _bounds(trace: Trace, scenario: Scenario) -> FloatArray:
    """Lower and upper corner `(2, 2)` of the lanes and the driven path."""
    path = np.column_stack([trace.ego.x, trace.ego.y])
    points = np.concatenate([path, *(lane.polygon for lane in scenario.road.lanes.values())])
    return np.stack([points.min(axis=0), points.max(axis=0)])


def _digest(trace: Trace) -> str:
    """The id of the recording: the same for the same drive."""
    digest = sha256(
        repr((trace.scenario, trace.planner, trace.mode.value, len(trace.frames))).encode()
    )
    for column in (trace.ego.t, trace.ego.x, trace.ego.y, trace.ego.v):
        digest.update(column.tobytes())
    return digest.hexdigest()[:32]
