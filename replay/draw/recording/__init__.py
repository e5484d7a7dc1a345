"""Recordings: a drive or a log as one .rrd file with its views in it. The only door to rerun; it draws, never computes.

Import this package only where something is drawn: it loads the viewer's library.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from hashlib import sha256
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from logs.frame_store import light
from logs.kernel import FloatArray
from logs.memory import trim_memory
from logs.nearby import NearbyTracks
from logs.scenario import Scenario
from logs.trace import EndReason, Graph, Mode, PlannedFrame, SlGraph, StGraph, Trace
from replay.draw.recording import events, plots, states, why, words
from replay.draw.recording.axes import Axes, sl_axes, st_axes
from replay.draw.recording.blueprint import Contents, blueprint
from replay.draw.recording.columns import Instants, Tape
from replay.draw.recording.file import recording_file
from replay.draw.recording.graphs import draw_graph, draw_happened
from replay.draw.recording.others import draw_others
from replay.draw.recording.scene import draw_moving, draw_scene
from replay.draw.recording.text import field_name
from replay.explain.happened import happened

if TYPE_CHECKING:
    from pandas import DataFrame

    from replay.drive import Drive

__all__ = ["write_log_recording", "write_recording"]

SCENE_STEP_S = 0.1
PART, SAMPLE = 500, 1000
"""Frames that are drawn at once, and of which the axes of graphs are made."""


def write_recording(
    path: Path,
    drive: Drive,
    scenario: Scenario,
    table: DataFrame | None = None,
    steps: DataFrame | None = None,
) -> None:
    """Write one drive as a recording: scene, graphs, curves, decisions and the reasons for them.

    Args:
        path: The .rrd file; it appears only when it is complete.
        drive: The trace and the stage times.
        scenario: The log that was driven.
        table: Rows of `metrics.evaluate` for this trace; None: no metrics in the summary.
        steps: Rows of `metrics.series` for this trace; None: no curves of metrics.

    Raises:
        OutputError: The file cannot be written.
    """
    whole, trace = drive.trace, replace(drive.trace, frames=light(drive.trace.frames))
    times = scene_times(trace, float(trace.ego.t[-1]))
    frames = np.array([frame.t for frame in trace.frames]) if trace.frames else times
    instants, planned = Instants.among(times, frames), Instants.among(frames, frames)
    some = whole.frames[:: max(1, ceil(len(frames) / SAMPLE))]
    axes: dict[type[Graph], Axes | None] = {
        StGraph: st_axes([graph for graph in _graphs(some, StGraph) if graph]),
        SlGraph: sl_axes([graph for graph in _graphs(some, SlGraph) if graph]),
    }
    del some
    panels = plots.motion_panels(trace, scenario, times, steps)
    stages = plots.stage_panel(drive.timings)
    panels += [stages] if stages else []
    pages = ("why", "numbers", "recent", "summary") if trace.frames else ("recent", "summary")
    lanes = states.state_lanes(trace, scenario.road)
    contents = Contents(
        panels, axes[StGraph], axes[SlGraph], [lane.name for lane in lanes], pages, _bounds(trace, scenario)
    )
    application = f"replan {scenario.name} {trace.mode.value} loop"
    short = scenario.short_names
    with recording_file(path, application, trace.planner, _digest(trace), blueprint(contents), short) as tape:
        draw_scene(tape, trace, scenario, instants)
        for begin in range(0, len(planned), PART):
            part = range(begin, begin + PART)
            _draw_part(tape, whole, scenario, instants.within(part), planned.within(part), axes)
            if len(planned) > PART:
                trim_memory()
        plots.draw_panels(tape, panels, frames)
        states.draw_lanes(tape, lanes, frames)
        events.draw_events(tape, events.events(trace), planned)
        words.draw_summary(tape, words.summary(whole, scenario, table))
        _send_metrics(tape, table)


def _draw_part(
    tape: Tape,
    whole: Trace,
    scenario: Scenario,
    instants: Instants,
    planned: Instants,
    axes: Mapping[type[Graph], Axes | None],
) -> None:
    """What there is of others, plans and graphs in some frames: a long drive has no more than these in memory."""
    frames = whole.frames[int(planned.frame[0]) : int(planned.frame[-1]) + 1]
    trace = _around(whole, frames, instants.t)
    draw_moving(tape, trace, frozenset(whole.agents.kinds), instants, planned)
    draw_others(tape, trace, planned)
    for kind, axis in axes.items():
        if axis:
            draw_graph(tape, planned, _graphs(frames, kind), axis)
    st = axes[StGraph]
    if st is not None:
        draw_happened(tape, planned, list(happened(trace, scenario)), st)
    if frames:
        why.draw_why(tape, trace, scenario, planned)


def _around(whole: Trace, frames: Sequence[PlannedFrame], t: FloatArray) -> Trace:
    """The part of a trace for some frames and the instants `t` `(k,)`, s, with who is there until their plans end."""
    begin = min([float(t[0]), *(frame.t for frame in frames[:1])])
    end = max([float(t[-1]), *(float(frame.plan.trajectory.t[-1]) for frame in frames)])
    shown = None if whole.perceived is None else NearbyTracks().of(whole.perceived, begin, end)
    return replace(whole, frames=frames, agents=NearbyTracks().of(whole.agents, begin, end), perceived=shown)


def write_log_recording(path: Path, scenario: Scenario) -> None:
    """Write a log by itself: the scene, and the ego's speed, acceleration and steering.

    Raises:
        OutputError: The file cannot be written.
    """
    trace = Trace(scenario.name, "log", Mode.OPEN, False, scenario.ego, scenario.tracks, (), EndReason.END_OF_LOG)
    times = scene_times(trace, scenario.duration)
    panels = plots.motion_panels(trace, scenario, times)
    contents = Contents(panels, None, None, (), ("summary",), _bounds(trace, scenario))
    instants = Instants.among(times, times)
    application, short = f"replan {scenario.name} log", scenario.short_names
    with recording_file(path, application, "log", _digest(trace), blueprint(contents), short) as tape:
        draw_scene(tape, trace, scenario, instants)
        draw_moving(tape, trace, frozenset(trace.agents.kinds), instants, instants)
        plots.draw_panels(tape, panels, times)
        words.draw_summary(tape, words.log_summary(scenario))


def scene_times(trace: Trace, end: float) -> FloatArray:
    """When the scene is drawn: at every frame, every `SCENE_STEP_S` where frames are rarer, and at the end."""
    start = float(trace.ego.t[0])
    frames = np.array([frame.t for frame in trace.frames])
    grid = start + SCENE_STEP_S * np.arange(int(np.floor((end - start) / SCENE_STEP_S + 1e-9)) + 1)
    if len(frames):
        gap = np.abs(grid[:, None] - frames[None, :]).min(axis=1) if len(frames) < 3 else _away(grid, frames)
        grid = np.r_[frames, grid[gap > 0.75 * SCENE_STEP_S]]
    times = np.unique(np.round(np.r_[grid, end], 9))
    return times[times <= end + 1e-9] if (times <= end + 1e-9).any() else times


def _away(grid: FloatArray, frames: FloatArray) -> FloatArray:
    after = np.clip(np.searchsorted(frames, grid), 1, len(frames) - 1)
    return np.minimum(np.abs(grid - frames[after - 1]), np.abs(grid - frames[after]))


def _graphs(frames: Sequence[PlannedFrame], kind: type[Graph]) -> list[Graph | None]:
    """The first graph of a kind in each frame."""
    return [
        next((artefact for artefact in frame.plan.internals if isinstance(artefact, kind)), None) for frame in frames
    ]


def _bounds(trace: Trace, scenario: Scenario) -> FloatArray:
    """Lower and upper corner `(2, 2)` of the lanes and the driven path."""
    path = np.column_stack([trace.ego.x, trace.ego.y])
    points = np.concatenate([path, *(lane.polygon for lane in scenario.road.lanes.values())])
    return np.stack([points.min(axis=0), points.max(axis=0)])


def _digest(trace: Trace) -> str:
    """The recording's id: the same drive has the same one."""
    digest = sha256(repr((trace.scenario, trace.planner, trace.mode.value, len(trace.frames))).encode())
    for column in (trace.ego.t, trace.ego.x, trace.ego.y, trace.ego.v):
        digest.update(column.tobytes())
    return digest.hexdigest()[:32]


def _send_metrics(tape: Tape, table: DataFrame | None) -> None:
    """Available metrics as properties of the recording: a column each in a table of recordings."""
    if table is None:
        return
    shown = table[table["available"] & np.isfinite(table["value"].to_numpy(dtype=float))]
    values = {field_name(name): float(value) for name, value in zip(shown["metric"], shown["value"], strict=True)}
    if values:
        tape.stream.send_property("metrics", rr.AnyValues(drop_untyped_nones=True, **values))
