"""The input of the planner in each frame of a drive, and the actual motion of the agents in its S-T
graph.

A trace in memory keeps the predictions at `KEPT_STEP_S`; its file keeps fewer, without headings.
For a trace that was read from a file, the predictions are therefore made again with the settings of
the loop, and thinned as in memory: the numbers are the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from replan.core.arrays import FloatArray, frozen
from replan.explain.course import path_rows
from replan.explain.occupancy import occupied
from replan.logs.agents import Agents
from replan.logs.frame import Predictions
from replan.logs.plan import DecisionKind, StGraph
from replan.logs.rules import Colour
from replan.logs.scenario import Scenario
from replan.logs.shapes import corners
from replan.logs.trace import PlannedFrame, Trace
from replan.logs.tracks import Tracks
from replan.logs.vehicle import VehicleParameters
from replan.planners.frenet.scene import Bodies, Futures
from replan.planners.frenet.sweep import SweptPath
from replan.replay.loop_config import LoopConfig
from replan.replay.perception import Perception, shows_truth
from replan.replay.world import World

SAME_TIME_S = 1e-6
STEP_S = 0.25
"""Interval between two times at which a box is compared with the path."""
BEYOND_M = 15.0
"""The path is extended by this length: a plan that stops for an agent ends before it."""

ROUNDS = 3
"""The stations along a path are found in this number of rounds, since offsets depend on them."""


@dataclass(frozen=True, eq=False, slots=True)
class PlannerInput:
    """A frame of a trace, with the data that explain its plan.

    Attributes:
        planned: The frame.
        agents: The agents as they were shown to the planner.
        predictions: The predictions of these agents; None if they were not kept.
        lights: The colour of each traffic light.
    """

    planned: PlannedFrame
    agents: Agents
    predictions: Predictions | None
    lights: Mapping[int, Colour]


def planner_inputs(
    trace: Trace, scenario: Scenario, loop: LoopConfig | None = None, earlier: Iterable[float] = ()
) -> Iterator[PlannerInput]:
    """The planner's input at each frame of a trace.

    A trace that was read from a file needs the settings of its loop, and the times of frames
    `earlier` than its own, s, which a sensor model remembers.
    """
    perception = None if loop is None else Perception(scenario, loop)
    if perception is not None and loop is not None and not shows_truth(loop.perception, scenario):
        for t in earlier:
            perception.frame(World(trace.ego.at(t), trace.agents), None)
    for frame in trace.frames:
        lights = {light.id: light.at(frame.t) for light in scenario.lights}
        if perception is None:
            shown = agents_shown(trace, frame.t)
            row = {name: i for i, name in enumerate(shown.ids)}
            agents = shown.some(np.array([row[name] for name in frame.agents], dtype=np.int64))
            yield PlannerInput(frame, agents, frame.predictions, lights)
            continue
        made = perception.frame(World(trace.ego.at(frame.t), trace.agents), None)
        yield PlannerInput(
            frame, made.agents, PlannedFrame.of(made, frame.plan).predictions, lights
        )


def agents_shown(trace: Trace, t: float) -> Agents:
    """The agents as they were shown to the planner in the frame at `t`.

    Their order is not that of the frame.
    """
    tracks = trace.perceived
    if tracks is None:
        return trace.agents.perceived(t)
    samples = np.flatnonzero(np.abs(tracks.t - t) < SAME_TIME_S)
    rows = np.searchsorted(tracks.offsets, samples, side="right") - 1
    poses = (getattr(tracks, name)[samples] for name in ("x", "y", "yaw", "vx", "vy"))
    ids, kinds = (tuple(names[i] for i in rows) for names in (tracks.ids, tracks.kinds))
    return Agents(ids, kinds, tracks.length[rows], tracks.width[rows], *poses)


def actual_occupancy(trace: Trace, scenario: Scenario) -> Iterator[list[FloatArray]]:
    """For each frame, where the agents that its S-T graph decides about were on the path, as they
    really drove.

    The boxes of the trace (linear between its samples) are swept against the ego's box along the
    path of the plan and `BEYOND_M` straight on from its end, without any margin. A difference from
    an obstacle of the graph is therefore an error of the prediction, or the margin of the planner.

    Yields:
        Outlines `(k, 2)`: time from the frame, s, and station along the path from the ego, m.
    """
    car, rows = scenario.vehicle, {name: i for i, name in enumerate(trace.agents.ids)}
    end = float(trace.ego.t[-1])
    beyond = np.arange(0.5, BEYOND_M + 0.5, 0.5)
    for frame in trace.frames:
        graph = next((item for item in frame.plan.internals if isinstance(item, StGraph)), None)
        obstacles = (
            [
                obstacle
                for obstacle in graph.obstacles
                if obstacle.decision is not DecisionKind.IGNORE
            ]
            if graph
            else []
        )
        names = dict.fromkeys(obstacle.agent for obstacle in obstacles if obstacle.agent in rows)
        if not names:
            yield []
            continue
        plan_rows = path_rows(frame.plan.trajectory)[:4]
        yaw = plan_rows[-1, -1]
        ahead = np.stack([beyond, beyond * np.cos(yaw), beyond * np.sin(yaw), 0.0 * beyond])
        path = np.ascontiguousarray(np.hstack([plan_rows, plan_rows[:, -1:] + ahead]))
        outlines = (_outline(trace.agents, rows[name], frame, path, end, car) for name in names)
        yield [outline for outline in outlines if outline is not None]


def true_boxes(trace: Trace, frame: PlannedFrame, line: FloatArray) -> Iterator[FloatArray]:
    """The boxes of the agents as they really were at a frame, in its S-L graph, without any margin.

    (1) heading of the reference line = yaw - delta, tan(delta) = dl/ds of `line`
    (2) ds = cos(delta) d(arc) + l d(heading), along the path
    (3) a corner = the nearest point of the path + its distance along and across the heading

    Boxes that are more than `BEYOND_M` beyond the end of the path, from where (3) goes straight on,
    are left out.

    `line`: the path in the graph, station and offset `(n, 2)`, n > 1, m.

    Yields:
        Corners `(4, 2)`: station and lateral offset of the reference line, m.
    """
    arc, x, y, yaw, _ = path_rows(frame.plan.trajectory)
    slope = np.gradient(line[:, 1], line[:, 0])
    station = line[0, 0] + arc
    for _ in range(ROUNDS):
        offset = np.interp(station, line[:, 0], line[:, 1])
        delta = np.arctan(np.interp(station, line[:, 0], slope))
        heading = np.unwrap(yaw) - delta  # (1)
        steps = _means(np.cos(delta)) * np.diff(arc) + _means(offset) * np.diff(heading)  # (2)
        station = line[0, 0] + np.r_[0.0, np.cumsum(steps)]
    agents = trace.agents.truth(frame.t)
    columns = agents.x, agents.y, agents.yaw, agents.length, agents.width
    for box in np.column_stack(columns).tolist():
        points = corners(*box)
        nearest = np.argmin(np.hypot(points[:, :1] - x, points[:, 1:] - y), axis=1)
        dx, dy, turn = points[:, 0] - x[nearest], points[:, 1] - y[nearest], heading[nearest]
        along, across = dx * np.cos(turn) + dy * np.sin(turn), dy * np.cos(turn) - dx * np.sin(turn)
        if along.min() <= BEYOND_M:
            yield np.column_stack([station[nearest] + along, offset[nearest] + across])  # (3)


def _means(values: FloatArray) -> FloatArray:
    return 0.5 * (values[1:] + values[:-1])


def _outline(
    tracks: Tracks,
    row: int,
    frame: PlannedFrame,
    path: FloatArray,
    end: float,
    car: VehicleParameters,
) -> FloatArray | None:
    """The outline of an agent on the path until the drive, its log or the plan ends; None if it is
    never on it.
    """
    samples = slice(int(tracks.offsets[row]), int(tracks.offsets[row + 1]))
    last = min(
        end,
        float(frame.plan.trajectory.t[-1]),
        np.inf if tracks.static[row] else float(tracks.t[samples][-1]),
    )
    times = frame.t + STEP_S * np.arange(int(np.floor((last - frame.t) / STEP_S + 1e-9)) + 1)
    if len(times) < 2:
        return None
    columns = tracks.x[samples], tracks.y[samples], np.unwrap(tracks.yaw[samples])
    x, y, yaw = (np.interp(times, tracks.t[samples], column)[None] for column in columns)
    agent, zero = np.zeros(1, np.int64), np.zeros(1)
    futures = Futures(frozen(times), agent, *map(frozen, (zero, x, y, yaw)))
    size = tracks.length[[row]], tracks.width[[row]]
    box = Bodies(*map(frozen, (zero, zero, zero, zero, zero, *size)))
    taken = next(occupied(SweptPath(*path), futures, box, car), None)
    if taken is None:
        return None
    on_path = np.isfinite(taken.lower)
    low, high = (
        np.column_stack([times - frame.t, edge])[on_path] for edge in (taken.lower, taken.upper)
    )
    return np.vstack([low, high[::-1]])
