"""What took the way in the end: who is in the S-T graph of a frame, as they then moved, beside as they were predicted.

The boxes of the trace (its samples, straight between them) are swept against the ego's own along the path of the plan
and `BEYOND_M` straight on from its end, without margin or time to spare: what differs from an obstacle of the graph was
predicted wrongly, or is the planner's margin.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from logs.kernel import FloatArray
from logs.scenario import Scenario, Tracks
from logs.states import Trajectory
from logs.trace import DecisionKind, PlannedFrame, StGraph, Trace
from planners.frenet.scene import Bodies, Futures
from planners.frenet.st_boundaries import Roles, Swept, Way, sweep
from replay.explain.course import arc_lengths

STEP_S = 0.25
"""Between two times at which a box is held against the way."""
BEYOND_M = 15.0
"""Who stops a plan stands beyond its end."""
SAME_M = 1e-3
"""Points nearer than this are one."""


def happened(trace: Trace, scenario: Scenario) -> Iterator[list[FloatArray]]:
    """For each frame the outlines `(k, 2)` of those that its S-T graph decides about: s from it, m from the ego."""
    car, rows = scenario.vehicle, {name: i for i, name in enumerate(trace.agents.ids)}
    ego = Swept(car.axle_to_center, car.length, car.width, 0.0, 0.0, 0.0, 0.0, 0.0)
    end = float(trace.ego.t[-1])
    for frame in trace.frames:
        graph = next((each for each in frame.plan.internals if isinstance(each, StGraph)), None)
        things = [thing for thing in graph.obstacles if thing.decision is not DecisionKind.IGNORE] if graph else []
        names = dict.fromkeys(thing.agent for thing in things if thing.agent in rows)
        if not names:
            yield []
            continue
        way = _way(frame.plan.trajectory)
        found = (_outline(trace.agents, rows[name], frame, way, end, ego) for name in names)
        yield [outline for outline in found if outline is not None]


def _way(path: Trajectory) -> FloatArray:
    """Rows s, x, y, yaw `(4, k)`."""
    s = arc_lengths(path.x, path.y)
    kept = np.r_[True, np.diff(np.floor(s / SAME_M)) > 0.0]
    rows = np.stack([s, path.x, path.y, path.yaw])[:, kept]
    d = np.arange(0.5, BEYOND_M + 0.5, 0.5)
    yaw = rows[3, -1]
    on = np.stack([d, d * np.cos(yaw), d * np.sin(yaw), 0.0 * d])
    return np.ascontiguousarray(np.hstack([rows, rows[:, -1:] + on]))


def _outline(tracks: Tracks, i: int, frame: PlannedFrame, way: FloatArray, end: float, ego: Swept) -> FloatArray | None:
    """Where an agent was on the way until the drive, their log or the plan ends; None: nowhere."""
    own = slice(int(tracks.offsets[i]), int(tracks.offsets[i + 1]))
    last = min(end, float(frame.plan.trajectory.t[-1]), np.inf if tracks.static[i] else float(tracks.t[own][-1]))
    times = frame.t + STEP_S * np.arange(int(np.floor((last - frame.t) / STEP_S + 1e-9)) + 1)
    if len(times) < 2:
        return None
    columns = tracks.x[own], tracks.y[own], np.unwrap(tracks.yaw[own])
    x, y, yaw = (np.interp(times, tracks.t[own], column)[None] for column in columns)
    one, zero, no = np.zeros(1, np.int64), np.zeros(1), np.zeros(1, np.bool_)
    futures = Futures(times, one, zero, x, y, yaw)
    bodies = Bodies(zero, zero, zero, zero, zero, tracks.length[[i]], tracks.width[[i]])
    t, _, lower, upper, _, _ = sweep(Way(*way), futures, bodies, Roles(no, no, no), ego, float(frame.t), 1)
    if not len(lower):
        return None
    there = np.isfinite(lower[0])
    low, high = np.column_stack([t, lower[0]])[there], np.column_stack([t, upper[0]])[there]
    return np.vstack([low, high[::-1]])
