"""The others' futures as they may be assumed at a frame: called by replay, which fills `Frame.predictions`.

(1) constant velocity: p(t + tau) = p(t) + v(t) tau, the heading stays
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from logs.errors import unknown_name
from logs.frame import Predictions
from logs.kernel import FloatArray
from logs.scenario import Agents

Predictor = Callable[[Agents, FloatArray], Predictions]
"""Futures of the agents on a time grid `(k,)`, s, whose first entry is the time at which they were perceived."""


def constant_velocity(agents: Agents, t: FloatArray) -> Predictions:
    """Each agent goes straight on with its velocity vector (1): one hypothesis of probability 1 per agent."""
    ahead = t - t[0]
    n = len(agents)
    return Predictions(
        t=t,
        agent=np.arange(n),
        probability=np.ones(n),
        x=agents.x[:, None] + agents.vx[:, None] * ahead,
        y=agents.y[:, None] + agents.vy[:, None] * ahead,
        yaw=np.broadcast_to(agents.yaw[:, None], (n, len(t))),
        method="constant_velocity",
    )


PREDICTORS: dict[str, Predictor] = {
    "constant_velocity": constant_velocity,
}


def predict(
    agents: Agents, t: float, *, horizon: float = 8.0, step: float = 0.1, method: str = "constant_velocity"
) -> Predictions:
    """Futures of `agents`, perceived at `t`, on the grid t, t + step, ... t + horizon (s).

    Raises:
        ConfigError: No predictor is called `method`.
    """
    if method not in PREDICTORS:
        raise unknown_name("prediction method", method, PREDICTORS)
    return PREDICTORS[method](agents, t + step * np.arange(round(horizon / step) + 1))
