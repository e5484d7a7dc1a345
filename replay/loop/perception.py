"""What the planner may see: a Frame, made from the World.

    "ground_truth"    every agent at its last sample not later than the frame's time, carried on with its velocity
                      (`Tracks.perceived`)
    "recorded"        what a tracker could know by then from the log's own detections (`replay.loop.recorded`)
    "auto"            "recorded" where the log's tracks are made of detections, else "ground_truth"
    "sensor"          what a sensor on the ego would measure (`replay.loop.sensor`), and the ground that it cannot see

No later sample goes into a frame, with one exception: the prediction "oracle" is the log's own future, and shows the
most that better predictions could give. It marks the drive as an oracle's.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from logs.extension import Kind
from logs.frame import Frame, Predictions, Visibility
from logs.kernel import FloatArray
from logs.memory import NearbyTracks
from logs.scenario import Agents, Scenario, Tracks
from logs.trace import Plan
from replay.config import LoopConfig
from replay.loop.recorded import Recorded
from replay.loop.sensor import Sensor
from replay.prediction import NO_LANES, PREDICTION, PREDICTORS, LaneMap, Predictor, predict
from replay.settings import configured
from replay.world import World

ORACLE = "oracle"
PREDICTIONS = (*PREDICTORS, ORACLE)
"""What `LoopConfig.prediction` may be."""

Sight = Callable[[World], tuple[Agents, Visibility | None]]
"""The agents as the planner sees them, and the ground that can be seen (None: all)."""


class GroundTruth:
    """Sees all agents, as known at the world's time."""

    def __init__(self) -> None:
        self._around = NearbyTracks()

    def see(self, world: World) -> tuple[Agents, None]:
        """The agents, and that nothing is hidden."""
        t = world.ego.t
        return self._around.of(world.tracks, t, t).perceived(t), None


def _auto(scenario: Scenario, config: LoopConfig) -> Sight:
    return GroundTruth().see if shows_truth("auto", scenario) else Recorded(scenario).see


def shows_truth(perception: str, scenario: Scenario) -> bool:
    """Whether a perception of this name shows the agents as they are."""
    return perception == "ground_truth" or (perception == "auto" and scenario.repair is None)


PERCEPTIONS: dict[str, Callable[..., Sight]] = {
    "auto": _auto,
    "ground_truth": lambda scenario, config: GroundTruth().see,
    "recorded": lambda scenario, config: Recorded(scenario).see,
    "sensor": lambda scenario, config: Sensor(scenario, config.sensor).see,
}
"""Each is built once per drive as `factory(scenario, config, **settings)`."""
PERCEPTION: Kind[Callable[..., Sight]] = Kind("perception", "perceptions", PERCEPTIONS)
"""Finds these and the user's own."""


class Perception:
    """Makes the frames of one drive, in order of time.

    Args:
        scenario: What is driven.
        config: Perception and prediction by name, and their settings.

    Attributes:
        is_oracle: Whether the planner sees the log's future.
        notes: Notes for the trace, one sentence each.

    Raises:
        ConfigError: There is no perception or prediction of this name.
    """

    def __init__(self, scenario: Scenario, config: LoopConfig) -> None:
        self._config, self._log, self._lanes = config, scenario.tracks, LaneMap.of(scenario.road)
        self._lights = scenario.lights
        self._true = shows_truth(config.perception, scenario)
        self._sight = configured(PERCEPTION, config.perception, config.settings)(scenario, config)
        self._shown: list[tuple[float, Agents]] = []
        self.is_oracle = config.prediction == ORACLE
        self._predictor = None if self.is_oracle else configured(PREDICTION, config.prediction, config.settings)
        notes = []
        if self.is_oracle:
            notes.append("the predictions are the log's own future, which no planner could know")
        if not self._true:
            recorded = config.perception in ("auto", "recorded")
            sight = "as recorded" if recorded else f"through a {config.perception}"
            notes.append(f"the planner sees the others {sight}")
        self.notes = tuple(notes)

    def frame(self, world: World, previous: Plan | None) -> Frame:
        """The frame at the world's time; `previous` is the plan being driven, None in open loop and at the start."""
        agents, visibility = self._sight(world)
        if not self._true:
            self._shown.append((world.ego.t, agents))
        t, config = world.ego.t, self._config
        if self.is_oracle:
            steps = round(config.prediction_horizon_s / config.prediction_step_s)
            predictions = logged_futures(self._log, agents, t + config.prediction_step_s * np.arange(steps + 1))
        else:
            predictions = _predicted(agents, t, config, self._lanes, self._predictor)
        lights = {light.id: light.at(t) for light in self._lights}
        return Frame(t, world.ego, agents, predictions, previous, visibility, lights)

    @property
    def shown(self) -> Tracks | None:
        """The agents as the planner saw them, one sample per frame; None with ground truth."""
        return None if self._true else _tracks(self._shown)


def perceive(world: World, previous: Plan | None, config: LoopConfig, *, lanes: LaneMap = NO_LANES) -> Frame:
    """A single frame at the world's time, by ground truth and `config.prediction` (not "oracle")."""
    agents, _ = GroundTruth().see(world)
    return Frame(world.ego.t, world.ego, agents, _predicted(agents, world.ego.t, config, lanes), previous)


def _predicted(
    agents: Agents, t: float, config: LoopConfig, lanes: LaneMap, predictor: Predictor | None = None
) -> Predictions:
    horizon, step, method = config.prediction_horizon_s, config.prediction_step_s, config.prediction
    return predict(agents, t, horizon=horizon, step=step, method=method, lanes=lanes, predictor=predictor)


def logged_futures(log: Tracks, agents: Agents, t: FloatArray) -> Predictions:
    """Where the log has the agents at the times `t` `(k,)`, s; after its end each goes on with its last velocity.

    Agents that the log does not have (false alarms of a perception) go on with theirs.
    """
    index = {name: i for i, name in enumerate(log.ids)}
    last = log.offsets[1:] - 1
    vx, vy = log.velocity(np.arange(len(log)), last)
    since = t - t[0]
    way = np.stack([agents.x[:, None] + agents.vx[:, None] * since, agents.y[:, None] + agents.vy[:, None] * since,
                    np.repeat(agents.yaw[:, None], len(t), axis=1)])  # fmt: skip
    for row, i in ((row, index[name]) for row, name in enumerate(agents.ids) if name in index):
        span, beyond = log.samples(i), np.maximum(t - log.t[last[i]], 0.0) * (not log.static[i])
        for c, (column, v) in enumerate(((log.x, vx[i]), (log.y, vy[i]), (log.yaw, 0.0))):
            way[c, row] = np.interp(t, log.t[span], column[span]) + v * beyond
    return Predictions(t, np.arange(len(agents)), np.ones(len(agents)), way[0], way[1], way[2], ORACLE)


def _tracks(shown: list[tuple[float, Agents]]) -> Tracks:
    """The agents shown at each time, as tracks."""
    rows: dict[str, list[tuple[float, Agents, int]]] = {}
    for t, agents in shown:
        for i, name in enumerate(agents.ids):
            rows.setdefault(name, []).append((t, agents, i))
    if not rows:
        return Tracks.empty()
    first = [some[0] for some in rows.values()]
    samples = [sample for some in rows.values() for sample in some]
    columns = (np.array([getattr(a, name)[i] for _, a, i in samples]) for name in ("x", "y", "yaw", "vx", "vy"))
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
