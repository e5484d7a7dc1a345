"""The others of the catalogue: parked, and moving along given positions; joined into Tracks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from logs.kernel import FloatArray
from logs.scenario import AgentKind, Tracks

CAR = (4.5, 1.8)
ADULT = (0.5, 0.6)
BICYCLE = (1.8, 0.6)
SMALL_CAR, LARGE_CAR = (4.316, 1.79), (4.418, 1.82)
"""Length and width of the cars of CPNCO, m."""
BESIDE_M, APART_M = 1.0, 1.0
"""CPNCO: from the ego's side to theirs; from the small car's front to the child's line, and from car to car."""


@dataclass(frozen=True, eq=False)
class Agent:
    """One road user: size (length, width) m and samples `(n, 6)` of t, x, y, yaw, vx, vy at its box centre."""

    id: str
    kind: AgentKind
    size: tuple[float, float]
    samples: FloatArray
    static: bool = False


def parked(name: str, x: float, y: float, *, size: tuple[float, float] = CAR) -> Agent:
    """A car that stands along the x axis, its centre at (x, y)."""
    return Agent(name, AgentKind.CAR, size, np.array([[0.0, x, y, 0.0, 0.0, 0.0]]), static=True)


def obstruction(x: float, side: float) -> tuple[Agent, Agent]:
    """The two parked cars of CPNCO before the line x, their left sides at y = `side`, m."""
    small_front = x - APART_M
    large_front = small_front - SMALL_CAR[0] - APART_M
    return (
        parked("small_car", small_front - 0.5 * SMALL_CAR[0], side - 0.5 * SMALL_CAR[1], size=SMALL_CAR),
        parked("large_car", large_front - 0.5 * LARGE_CAR[0], side - 0.5 * LARGE_CAR[1], size=LARGE_CAR),
    )


def moving(
    name: str, kind: AgentKind, size: tuple[float, float], t: FloatArray, x: FloatArray, y: FloatArray, *, yaw: float
) -> Agent:
    """A road user at positions `(n,)` at times `(n,)`, uniformly spaced.

    Velocities are backward differences: nothing of a later position is in a sample. The heading is that of the
    velocity; `yaw` where and as long as it stands from the begin.
    """
    vx, vy = (np.r_[way[0], way] for way in (np.diff(x) / np.diff(t), np.diff(y) / np.diff(t)))
    heading, last = np.empty(len(t)), yaw
    for i in range(len(t)):
        last = float(np.arctan2(vy[i], vx[i])) if np.hypot(vx[i], vy[i]) > 0.05 else last
        heading[i] = last
    return Agent(name, kind, size, np.column_stack([t, x, y, np.unwrap(heading), vx, vy]))


def tracks(agents: Sequence[Agent]) -> Tracks:
    """All of them as Tracks."""
    if not agents:
        return Tracks.empty()
    t, x, y, yaw, vx, vy = np.vstack([agent.samples for agent in agents]).T
    return Tracks(
        tuple(agent.id for agent in agents),
        tuple(agent.kind for agent in agents),
        np.array([agent.size[0] for agent in agents]),
        np.array([agent.size[1] for agent in agents]),
        np.array([agent.static for agent in agents]),
        np.cumsum([0, *(len(agent.samples) for agent in agents)]),
        t,
        x,
        y,
        yaw,
        vx,
        vy,
    )
