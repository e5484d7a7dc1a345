"""Predicts the futures of the other road users at a frame; the loop puts them into
`Frame.predictions`.

A predictor receives only the lanes and the agents as perceived at one instant: it has no memory and
no access to the log. Its settings are keywords. To add one, write a function and list it in
`replan.replay.parts`; `replan list predictions` shows the first line of its docstring. "oracle",
the log's own future, is made by `replan.replay.perception`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.errors import ConfigError
from replan.logs.agents import Agents
from replan.logs.frame import Predictions
from replan.replay.parts import PREDICTION
from replan.replay.prediction.lane_following import everybody
from replan.replay.prediction.lane_map import LaneMap
from replan.replay.prediction.off_lanes import constant_velocity, walkers

__all__ = ["NO_LANES", "LaneMap", "Predictor", "predict"]

NO_LANES = LaneMap.unknown()
Predictor = Callable[..., Predictions]
"""As `replan.replay.parts.PREDICTION`."""


def straight_on(agents: Agents, t: FloatArray, lanes: LaneMap) -> Predictions:
    """All go straight on at constant velocity."""
    return constant_velocity(agents, t)


def round_a_circle(agents: Agents, t: FloatArray, lanes: LaneMap) -> Predictions:
    """All keep a constant turn rate; pedestrians go straight on."""
    return everybody(agents, t, NO_LANES)


def pedestrian(agents: Agents, t: FloatArray, lanes: LaneMap) -> Predictions:
    """Pedestrians go on, stop or turn back; all others go on at constant velocity."""
    return _instead(constant_velocity(agents, t), walkers(agents, t, lanes))


def lanes_and_pedestrians(agents: Agents, t: FloatArray, lanes: LaneMap) -> Predictions:
    """Vehicles follow their lanes, pedestrians go on, stop or turn back, others keep a constant
    turn rate.
    """
    return _instead(everybody(agents, t, lanes), walkers(agents, t, lanes))


def predict(
    agents: Agents,
    t: float,
    *,
    horizon: float = 8.0,
    step: float = 0.1,
    method: str = "constant_velocity",
    lanes: LaneMap = NO_LANES,
    predictor: Predictor | None = None,
) -> Predictions:
    """Predict the futures of `agents`, perceived at `t`, on the grid t, t + step, ... t + horizon
    (s).

    Every agent has at least one hypothesis; each begins at the agent's position. They are in the
    order of the agents.

    Args:
        agents: The agents as perceived.
        t: s since the scenario's start.
        horizon: Length of the prediction, s.
        step: Time between two samples, s.
        method: Its name, or "module:function".
        lanes: `LaneMap.of(road)`, made once per scenario; by default no lanes are known, and no
            agent follows one.
        predictor: The predictor of the name `method`, if it is already loaded.

    Raises:
        ConfigError: There is no predictor `method`, or it does not return `Predictions`.
    """
    predictor = predictor or PREDICTION.find(method)
    futures = predictor(agents, t + step * np.arange(round(horizon / step) + 1), lanes)
    if not isinstance(futures, Predictions):
        raise ConfigError(
            f"prediction '{method}' returned {type(futures).__name__} instead of Predictions"
        )
    return futures if futures.method == method else replace(futures, method=method)


def _instead(general: Predictions, special: Predictions) -> Predictions:
    """Return `general`, with the hypotheses of the agents in `special` replaced by those of
    `special`.
    """
    others = np.flatnonzero(~np.isin(general.agent, special.agent))
    order = np.argsort(np.r_[general.agent[others], special.agent], kind="stable")
    agent, probability, x, y, yaw = (
        np.concatenate([getattr(general, name)[others], getattr(special, name)])[order]
        for name in ("agent", "probability", "x", "y", "yaw")
    )
    return Predictions(general.t, agent, probability, x, y, yaw, general.method)
