"""What a planner was shown at the frames of a drive: the others, their predicted futures, the lights.

A trace in memory has the predictions at `KEPT_STEP_S`; the file of a trace has fewer, without headings. From a file the
predictions are therefore made anew by the loop's settings, and thinned as they were in memory: the same numbers.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from logs.agents import Agents
from logs.frame import Predictions
from logs.kernel import IntArray
from logs.rules import Colour
from logs.scenario import Scenario, Tracks
from logs.trace import PlannedFrame, Trace
from replay.config import LoopConfig
from replay.loop.perception import Perception, shows_truth
from replay.world import World

SAME_TIME_S = 1e-6


@dataclass(frozen=True, eq=False, slots=True)
class Shown:
    """A frame of a trace with what is needed to explain its plan.

    Attributes:
        planned: The frame.
        agents: As the planner was shown them.
        predictions: Of these agents; None: not kept.
        lights: What each light showed.
    """

    planned: PlannedFrame
    agents: Agents
    predictions: Predictions | None
    lights: Mapping[int, Colour]


def shown(
    trace: Trace, scenario: Scenario, loop: LoopConfig | None = None, earlier: Iterable[float] = ()
) -> Iterator[Shown]:
    """What was shown at each frame of a trace.

    Args:
        trace: The drive.
        scenario: As it was driven.
        loop: With which it was driven, where the trace was read from a file; None: the trace is as it was made.
        earlier: Times of frames before those of the trace, s: a sensor remembers them.
    """
    perception = None if loop is None else Perception(scenario, loop)
    if perception is not None and loop is not None and not shows_truth(loop.perception, scenario):
        for t in earlier:
            perception.frame(World(trace.ego.at(t), trace.agents), None)
    for frame in trace.frames:
        lights = {light.id: light.at(frame.t) for light in scenario.lights}
        if perception is None:
            yield Shown(frame, _agents(trace, frame), frame.predictions, lights)
            continue
        made = perception.frame(World(trace.ego.at(frame.t), trace.agents), None)
        yield Shown(frame, made.agents, PlannedFrame.of(made, frame.plan).predictions, lights)


def _agents(trace: Trace, frame: PlannedFrame) -> Agents:
    """The agents of a frame in its order."""
    if trace.perceived is None:
        known = trace.agents.perceived(frame.t)
        row = {name: i for i, name in enumerate(known.ids)}
        rows = np.array([row[name] for name in frame.agents], dtype=np.int64)
        return known.some(rows)
    tracks = trace.perceived
    at = np.flatnonzero(np.abs(tracks.t - frame.t) < SAME_TIME_S)
    track = np.searchsorted(tracks.offsets, at, side="right") - 1
    place = {tracks.ids[j]: i for i, j in enumerate(track)}
    order = np.array([place[name] for name in frame.agents], dtype=np.int64)
    return picked(tracks, track[order], at[order])


def picked(some: Tracks, rows: IntArray, at: IntArray) -> Agents:
    """The agents `rows` with the sizes there and the poses at `at`."""
    poses = (getattr(some, name)[at] for name in ("x", "y", "yaw", "vx", "vy"))
    ids, kinds = (tuple(names[i] for i in rows) for names in (some.ids, some.kinds))
    return Agents(ids, kinds, some.length[rows], some.width[rows], *poses)
