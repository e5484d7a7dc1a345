"""Futures that need no road: straight on, or round a circle.

(1) constant velocity: p(t + tau) = p(t) + v(t) tau, the heading stays
(2) constant turn rate and velocity: the velocity vector turns with the yaw rate w, so that in tau a chord of length
    |v| tau sin(h) / h is covered in the direction of v turned by h = w tau / 2; the heading turns by w tau
"""

from __future__ import annotations

from math import cos, pi, sin

import numpy as np

from logs.agents import AgentKind, Agents, among
from logs.frame import Predictions
from logs.kernel import FloatArray, inner_kernel

SLOWEST_MPS = 1.0
"""Below this speed a heading changes mostly by noise: the turn rate counts as zero."""
MAX_LATERAL_MPS2 = 5.0
"""A turn rate that asks for more than this lateral acceleration is noise, and is cut to it."""
MAX_KAPPA = 0.2
"""Nor does a vehicle turn tighter than this, 1/m."""
ON_FOOT = among(AgentKind.PEDESTRIAN, AgentKind.OBJECT)
"""Who turns on the spot or not at all, by their codes: their yaw rate says nothing of where they go."""


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


@inner_kernel
def turn_rate(code: int, speed: float, yaw_rate: float) -> float:
    """The yaw rate that goes on: of moving vehicles and bicycles, within what they can turn, rad/s."""
    most = min(MAX_LATERAL_MPS2 / max(speed, SLOWEST_MPS), MAX_KAPPA * speed)
    return 0.0 if ON_FOOT[code] or speed < SLOWEST_MPS else min(max(yaw_rate, -most), most)


@inner_kernel
def turned(one: FloatArray, direction: float, ahead: FloatArray, out: FloatArray) -> None:
    """Round a circle (2).

    Args:
        one: x, y, yaw, vx, vy, yaw rate that goes on `(6,)`.
        direction: Of its velocity.
        ahead: Times from now `(k,)`, s.
        out: Rows x, y, yaw `(3, k)`.
    """
    speed = np.hypot(one[3], one[4])
    for k in range(len(ahead)):
        half = 0.5 * one[5] * ahead[k]
        bent = pi * (half / pi)
        chord = speed * ahead[k] * (sin(bent) / bent if bent != 0.0 else 1.0)
        toward = direction + half
        out[0, k], out[1, k] = one[0] + chord * cos(toward), one[1] + chord * sin(toward)
        out[2, k] = one[2] + 2.0 * half
