"""Stops that the traffic rules demand, in the S-T graph: nobody's box, but a bound for as long as the demand lasts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from logs.kernel import FloatArray
from logs.trace import Decision, GraphObstacle
from planners.frenet.st_boundaries import StBoundaries
from planners.rules import Wall


def open_end(walls: Sequence[Wall]) -> float:
    """Where the ego should come to rest before the first wall of which nobody knows the end, m; inf: there is none."""
    return min((wall.aim for wall in walls if wall.stop.until == np.inf), default=np.inf)


def upper_bound(walls: Sequence[Wall], times: FloatArray, length: float) -> FloatArray:
    """Greatest station `(n,)` at times `(n,)`; `length` where no wall stands."""
    upper = np.full(len(times), length)
    for wall in walls:
        upper = np.where(times < wall.stop.until, np.minimum(upper, wall.bound), upper)
    return upper


def walled(blocks: StBoundaries, walls: Sequence[Wall]) -> StBoundaries:
    """The blocks with a row per wall, which belongs to no agent (-1)."""
    if not walls:
        return blocks
    lower = np.array([np.where(blocks.t < wall.stop.until, wall.bound, np.nan) for wall in walls])
    return StBoundaries(
        blocks.t,
        np.r_[blocks.agent, np.full(len(walls), -1)],
        np.vstack([blocks.lower, lower]),
        np.vstack([blocks.upper, np.where(np.isfinite(lower), np.inf, np.nan)]),
        np.r_[blocks.speed, np.zeros(len(walls))],
        np.r_[blocks.probability, np.ones(len(walls))],
    )


def told(walls: Sequence[Wall]) -> tuple[Decision, ...]:
    """What is decided about each wall, and why."""
    return tuple(Decision(wall.stop.name, wall.stop.kind, "speed", wall.stop.reason) for wall in walls)


def wall_outlines(walls: Sequence[Wall], horizon: float, length: float) -> tuple[GraphObstacle, ...]:
    """The walls as rectangles of the S-T graph, to the path's end."""
    found = []
    for wall in walls:
        end, top = min(wall.stop.until, horizon), max(length, wall.bound)
        corners = np.array([(0.0, wall.bound), (end, wall.bound), (end, top), (0.0, top)])
        found.append(GraphObstacle(wall.stop.name, corners, wall.stop.kind))
    return tuple(found)
