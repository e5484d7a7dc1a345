"""Makes the frames that the planner sees from the World.

A frame contains no later samples, with one exception: the prediction "oracle" is the log's own
future, the upper bound for better predictions. Such a drive is marked as that of an oracle.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import chain

import numpy as np

from replan.core.arrays import FloatArray, IntArray, frozen
from replan.core.errors import LogError
from replan.logs.agents import NUMBERS, Agents
from replan.logs.frame import Frame, Predictions, Visibility
from replan.logs.nearby_tracks import NearbyTracks
from replan.logs.plan import Plan
from replan.logs.repair.detections import Owners
from replan.logs.scenario import Scenario
from replan.logs.states import wrapped
from replan.logs.tracks import Tracks
from replan.replay.loop_config import LoopConfig
from replan.replay.perception.sensor import Sensor
from replan.replay.prediction import LaneMap, predict
from replan.replay.world import World

ORACLE = "oracle"
"""The prediction that is the log's own future."""
MOVED = ("x", "y", "yaw", "vx", "vy")

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


class Recorded:
    """Shows the agents of one drive as the recorded perception detected them.

    The tracker is causal (`replan.logs.repair.tracker`), and so are its names; a repaired track has
    the name that the tracker uses longest for it (`replan.logs.repair.detections`). The detections
    are those of the log, but in closed loop the traffic moves the others differently. Known road
    users are therefore shown at their positions in the world,

    (1) shown = tracked + (world - log),
            of x, y, yaw, vx, vy at the frame's time; both as `Tracks.perceived`

    - A track that belongs to no road user of the log is a false alarm of the recorded perception;
      it is shown unchanged.
    - An agent that is present now in the log but not in the world is not shown.
    - An agent that is present now in the world but not in the log (inserted, or later than
      recorded), and a static agent, is shown as in ground truth: it has no detections.

    Later data are used only to find the road user of a track: the log's tracks are smoothed.

    Args:
        scenario: Its `repair` has the detections.

    Raises:
        LogError: It has no detections.
    """

    def __init__(self, scenario: Scenario) -> None:
        if scenario.repair is None:
            remedy = "take perception auto or ground_truth, or read the log with repair on"
            raise LogError(
                "perception recorded needs a log whose road users are made of detections",
                remedy=remedy,
            )
        self._log, self._tracked = scenario.repair.tracks, scenario.repair.detections.tracked
        self._owners, self._around, self._around_log = Owners(), NearbyTracks(), NearbyTracks()

    def see(self, world: World) -> tuple[Agents, None]:
        """Return the agents; no ground is known to be hidden."""
        t = world.ego.t
        known = self._tracked.at(t)
        log = self._around_log.of(self._log, t, t).perceived(t)
        owners = self._owners.of(known, log)
        if world.tracks is self._log:
            now, shown = log, known
        else:
            now = self._around.of(world.tracks, t, t).perceived(t)
            world_row = {name: i for i, name in enumerate(now.ids)}
            log_row = {name: i for i, name in enumerate(log.ids)}
            rows = [i for i, name in enumerate(owners) if name not in log_row or name in world_row]
            both = [row for row, i in enumerate(rows) if owners[i] in log_row]
            in_world = _rows(world_row[owners[rows[row]]] for row in both)
            in_log = _rows(log_row[owners[rows[row]]] for row in both)
            shown = known.some(_rows(rows))
            columns = np.array([getattr(shown, name) for name in NUMBERS])
            for name in MOVED:  # (1)
                change = getattr(now, name)[in_world] - getattr(log, name)[in_log]
                columns[NUMBERS.index(name), both] += wrapped(change) if name == "yaw" else change
            shown = Agents.of_rows(shown.ids, shown.kinds, columns, shown.codes)
        static = {
            name for name, still in zip(world.tracks.ids, world.tracks.static, strict=True) if still
        }
        logged = set(log.ids)
        others = [i for i, name in enumerate(now.ids) if name in static or name not in logged]
        if not others:
            return shown, None
        more = now.some(_rows(others))
        shown = shown.some(_rows(i for i, name in enumerate(shown.ids) if name not in more.ids))
        columns = np.array([np.r_[getattr(shown, name), getattr(more, name)] for name in NUMBERS])
        codes = frozen(np.r_[shown.codes, more.codes], np.int64)
        return Agents.of_rows(
            (*shown.ids, *more.ids), (*shown.kinds, *more.kinds), columns, codes
        ), None


def _rows(places: Iterable[int]) -> IntArray:
    return np.array(list(places), np.int64)


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
        self._config, self._log, self._lanes = config, scenario.tracks, LaneMap.of(scenario.road)
        self._lights = scenario.lights
        self._true = shows_truth(config.perception, scenario)
        self._sight = config.part("perception").build(scenario, config)
        self._shown: list[tuple[float, Agents]] = []
        self.is_oracle = config.prediction == ORACLE
        self._predictor = None if self.is_oracle else config.part("prediction").configured()
        notes = []
        if self.is_oracle:
            notes.append("the predictions are the log's own future, which no planner could know")
        if not self._true:
            recorded = config.perception in ("auto", "recorded")
            sight = "as recorded" if recorded else f"through a {config.perception}"
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
                self._log, agents, t + config.prediction_step_s * np.arange(steps + 1)
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
        lights = {light.id: light.at(t) for light in self._lights}
        return Frame(t, world.ego, agents, predictions, previous, visibility, lights)

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
        columns = (
            np.array([getattr(a, name)[i] for _, a, i in samples])
            for name in ("x", "y", "yaw", "vx", "vy")
        )
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
