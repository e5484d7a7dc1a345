"""Futures that need no road: straight on, or round a circle.

(1) constant velocity: p(t + tau) = p(t) + v(t) tau, the heading stays
(2) constant turn rate and velocity: the velocity vector turns with the yaw rate w, so that in tau a chord of length
    |v| tau sin(h) / h is covered in the direction of v turned by h = w tau / 2; the heading turns by w tau
"""

from __future__ import annotations

import numpy as np

from logs.frame import Predictions
from logs.kernel import FloatArray
from logs.scenario import AgentKind, Agents

SLOWEST_MPS = 1.0
"""Below this speed a heading changes mostly by noise: the turn rate counts as zero."""
MAX_LATERAL_MPS2 = 5.0
"""A turn rate that asks for more than this lateral acceleration is noise, and is cut to it."""
MAX_KAPPA = 0.2
"""Nor does a vehicle turn tighter than this, 1/m."""


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


def turn_rates(agents: Agents) -> FloatArray:
    """The yaw rates `(n,)` that go on: of moving vehicles and bicycles, within what they can turn, rad/s."""
    speed = agents.speed
    on_foot = np.array([kind in (AgentKind.PEDESTRIAN, AgentKind.OBJECT) for kind in agents.kinds], bool)
    most = np.minimum(MAX_LATERAL_MPS2 / np.maximum(speed, SLOWEST_MPS), MAX_KAPPA * speed)
    return np.where(on_foot | (speed < SLOWEST_MPS), 0.0, np.clip(agents.yaw_rate, -most, most))


def constant_turn_rate(agents: Agents, t: FloatArray) -> Predictions:
    """Each agent goes on at its speed and yaw rate (2), pedestrians straight: one hypothesis per agent."""
    ahead = t - t[0]
    half = 0.5 * turn_rates(agents)[:, None] * ahead
    chord = agents.speed[:, None] * ahead * np.sinc(half / np.pi)
    direction = np.arctan2(agents.vy, agents.vx)[:, None] + half
    n = len(agents)
    return Predictions(
        t=t,
        agent=np.arange(n),
        probability=np.ones(n),
        x=agents.x[:, None] + chord * np.cos(direction),
        y=agents.y[:, None] + chord * np.sin(direction),
        yaw=agents.yaw[:, None] + 2.0 * half,
        method="constant_turn_rate",
    )
