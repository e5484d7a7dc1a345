"""Makes the frames that the planner sees from the World.

A frame contains no later samples, with one exception: the prediction "oracle" is the log's own
future, the upper bound for better predictions. Such a drive is marked as that of an oracle.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from itertools import chain

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.agents import Agents, ObjectClass
from replan.logs.frame import Frame, Predictions, Visibility
from replan.logs.nearby_tracks import NearbyTracks
from replan.logs.past import SAME_TIME_S, Earlier, PastSource, Snapshot, forget
from replan.logs.plan import Plan
from replan.logs.rules import Colour
from replan.logs.scenario import Scenario
from replan.logs.tracks import Tracks
from replan.replay.loop_config import LoopConfig
from replan.replay.perception.recorded_agents import MOVED, Recorded
from replan.replay.perception.sensor import Sensor
from replan.replay.prediction import LaneMap, predict
from replan.replay.world import World, logged_ego

ORACLE = "oracle"
"""The prediction that is the log's own future."""

Sight = Callable[[World], tuple[Agents, Visibility | None]]
"""Returns the agents as the planner sees them, and the visible ground (None: all)."""


class GroundTruth:
    """Shows all agents, as known at the world's time."""

    def __init__(self) -> None:
        self._around = NearbyTracks()

    def see(self, world: World) -> tuple[Agents, None]:
        """Return the agents; nothing is hidden."""
        t = world.ego.t
        return self._around.of(world.tracks, t, t).perceived(t), None


def shows_truth(perception: str, scenario: Scenario) -> bool:
    """Return whether a perception of this name shows the true agents."""
    return perception == "ground_truth" or (perception == "auto" and scenario.repair is None)


def auto(scenario: Scenario, config: LoopConfig) -> Sight:
    """As recorded where the log's tracks are made of detections, else as ground_truth."""
    return (GroundTruth() if shows_truth("auto", scenario) else Recorded(scenario)).see


def ground_truth(scenario: Scenario, config: LoopConfig) -> Sight:
    """Every agent at its last sample not later than the frame's time, extrapolated with its
    velocity.
    """
    return GroundTruth().see


def recorded(scenario: Scenario, config: LoopConfig) -> Sight:
    """What a tracker could know at that time from the log's own detections."""
    return Recorded(scenario).see


def sensor(scenario: Scenario, config: LoopConfig) -> Sight:
    """What a sensor on the ego would measure, and the ground that is hidden from it."""
    return Sensor(scenario, config.sensor).see


class Perception:
    """Makes the frames of one drive, in order of time.

    Args:
        scenario: The scenario.
        config: Perception and prediction by name, and their settings.

    Attributes:
        is_oracle: Whether the planner sees the log's future.
        notes: Notes for the trace, one sentence each.

    Raises:
        ConfigError: There is no perception or prediction of this name.
    """

    def __init__(self, scenario: Scenario, config: LoopConfig) -> None:
        self._config, self._lanes = config, LaneMap.of(scenario.road)
        self._true = shows_truth(config.perception, scenario)
        self._sight = config.part("perception").build(scenario, config)
        self._scenario = scenario
        self._snapshots: deque[Snapshot] = deque()
        self._shown: list[tuple[float, Agents]] = []
        self.is_oracle = config.prediction == ORACLE
        self._predictor = None if self.is_oracle else config.part("prediction").configured()
        notes = []
        if self.is_oracle:
            notes.append("the predictions are the log's own future, which no planner could know")
        if not self._true:
            is_recorded = config.perception in ("auto", "recorded")
            sight = "as recorded" if is_recorded else f"through a {config.perception}"
            notes.append(f"the planner sees the others {sight}")
        self.notes = tuple(notes)

    def frame(self, world: World, previous: Plan | None) -> Frame:
        """Return the frame at the world's time; `previous`: the plan being driven (None: open loop,
        or start).
        """
        agents, visibility = self._sight(world)
        if not self._true:
            self._shown.append((world.ego.t, agents))
        t, config = world.ego.t, self._config
        if self.is_oracle:
            steps = round(config.prediction_horizon_s / config.prediction_step_s)
            predictions = logged_futures(
                self._scenario.tracks, agents, t + config.prediction_step_s * np.arange(steps + 1)
            )
        else:
            predictions = predict(
                agents,
                t,
                horizon=config.prediction_horizon_s,
                step=config.prediction_step_s,
                method=config.prediction,
                lanes=self._lanes,
                predictor=self._predictor,
            )
        lights = self._colours(t)
        forget(self._snapshots, t)
        earlier = Earlier(tuple(self._snapshots), self._before)
        self._snapshots.append(Snapshot(t, world.ego, agents, lights))
        classes = self._classes_of(agents)
        return Frame(
            t, world.ego, agents, predictions, previous, visibility, lights, earlier, classes
        )

    def _classes_of(self, agents: Agents) -> dict[str, ObjectClass]:
        """Return the classes of the objects among the agents."""
        classes = self._scenario.object_classes
        return {name: classes[name] for name in agents.ids if name in classes} if classes else {}

    def _colours(self, t: float) -> dict[int, Colour]:
        return {light.id: light.at(t) for light in self._scenario.lights}

    def _before(self, times: Sequence[float]) -> list[Snapshot]:
        """What the log shows before the drive at times that it covers, seen anew."""
        scenario, ego = self._scenario, self._scenario.whole_ego
        sight = self._config.part("perception").build(scenario, self._config)
        snapshots = []
        for t in times:
            if t >= ego.t[0] - SAME_TIME_S:
                state = logged_ego(ego, scenario.vehicle, t)
                agents, _ = sight(World(state, scenario.tracks))
                snapshots.append(Snapshot(t, state, agents, self._colours(t), PastSource.LOG))
        return snapshots

    @property
    def shown(self) -> Tracks | None:
        """The agents as the planner saw them, one sample per frame; None with ground truth."""
        if self._true:
            return None
        rows: dict[str, list[tuple[float, Agents, int]]] = {}
        for t, agents in self._shown:
            for i, name in enumerate(agents.ids):
                rows.setdefault(name, []).append((t, agents, i))
        if not rows:
            return Tracks.empty()
        first = [samples[0] for samples in rows.values()]
        samples = [*chain.from_iterable(rows.values())]
        columns = (np.array([getattr(a, name)[i] for _, a, i in samples]) for name in MOVED)
        return Tracks(
            tuple(rows),
            tuple(a.kinds[i] for _, a, i in first),
            np.array([a.length[i] for _, a, i in first]),
            np.array([a.width[i] for _, a, i in first]),
            np.zeros(len(rows), np.bool_),
            np.cumsum([0, *map(len, rows.values())]),
            np.array([t for t, _, _ in samples]),
            *columns,
        )


def logged_futures(log: Tracks, agents: Agents, t: FloatArray) -> Predictions:
    """The log's own future: the logged positions of the agents.

    Args:
        log: The tracks of the log; after its track, an agent keeps its last velocity.
        agents: Those that are present; one that the log does not have (a false alarm) keeps its
            present velocity.
        t: Times `(k,)`, s.
    """
    index = {name: i for i, name in enumerate(log.ids)}
    last = log.offsets[1:] - 1
    vx, vy = log.velocity(np.arange(len(log)), last)
    since = t - t[0]
    x, y, yaw = poses = np.stack(
        [
            agents.x[:, None] + agents.vx[:, None] * since,
            agents.y[:, None] + agents.vy[:, None] * since,
            np.repeat(agents.yaw[:, None], len(t), axis=1),
        ]
    )
    for row, i in ((row, index[name]) for row, name in enumerate(agents.ids) if name in index):
        span, beyond = log.samples(i), np.maximum(t - log.t[last[i]], 0.0) * (not log.static[i])
        for c, (column, v) in enumerate(((log.x, vx[i]), (log.y, vy[i]), (log.yaw, 0.0))):
            poses[c, row] = np.interp(t, log.t[span], column[span]) + v * beyond
    return Predictions(t, np.arange(len(agents)), np.ones(len(agents)), x, y, yaw, ORACLE)
