"""Speed caps: every reason to drive slower than the road allows is a stretch of the path with a speed.

A producer is a function `caps(view) -> tuple[SpeedCap, ...]`, one file each in this folder and one line in `producers`.
`lowered` takes the minimum and makes the decisions:

(1) limit(sigma) = min(road(sigma), v of the caps with s_from < sigma <= s_to)
(2) A cap that is a bound is kept exactly; above any other limit the profile has some room (`speed.stage`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from logs.kernel import BoolArray, FloatArray
from logs.trace import Decision, DecisionKind
from planners.dp_qp.scene.goal_window import GoalWindow, SpeedTarget
from planners.frenet.occupancy import Occupancy
from planners.frenet.path import Path
from planners.frenet.scene import Scene
from planners.frenet.st_boundaries import StBoundaries

WORTH_MPS = 0.5
"""A cap is reported as a decision where it lowers the limit by more than this, m/s."""


@dataclass(frozen=True)
class CautionConfig:
    """How the ego prepares for road users who may come into its way.

    Attributes:
        walk_mps: Who may step out, or set off, walks as fast as this: 5 km/h, up to which UN R157 asks to avoid them.
        ride_mps: Who rides along the lane may swerve into the way as fast as this.
        hesitates_s: Who came to the path, and stands beside it, may set off again for so long.
    """

    walk_mps: float = 5.0 / 3.6
    ride_mps: float = 0.8
    hesitates_s: float = 5.0

    def __post_init__(self) -> None:
        if not min(self.walk_mps, self.ride_mps) > 0.0:
            raise ValueError("walk_mps and ride_mps must be positive")


@dataclass(frozen=True, eq=False, slots=True)
class PassTarget:
    """Who goes along the lane slower than the ego, and is to be passed.

    Attributes:
        agent: Index into the frame's agents.
        box: The stations and offsets at which they are while the ego is beside them.
        begin: Station of the ego's rear axle at which it comes beside them, m; `end` at which it is past them.
        places: Where they are predicted meanwhile `(n, 2)`, m.
    """

    agent: int
    box: Occupancy
    begin: float
    end: float
    places: FloatArray


@dataclass(frozen=True, slots=True)
class SpeedCap:
    """A reason to drive slower.

    Attributes:
        s_from: Arc length of the rear axle from which it holds, m; `s_to` to which.
        v: The speed, m/s.
        agent: The agent or thing that it is for; empty where it is not reported.
        reason: In words.
        is_bound: Whether the speed is kept exactly (2).
    """

    s_from: float
    s_to: float
    v: float
    agent: str = ""
    reason: str = ""
    is_bound: bool = True


@dataclass(frozen=True, eq=False, slots=True)
class PathView:
    """A scene on the path that was chosen: what the producers of caps look at.

    Attributes:
        scene: The scene.
        path: The path.
        limit: The road's speed limit along it `(m,)`, m/s.
        taken: When which part of it is taken, and by which agent.
        passed: The room that it leaves to each agent that it passes while they stand, m.
        stops: That the rules demand on it.
        targets: Those who go along the lane where the ego comes beside them.
        is_pass: Whether the path swings out to pass them.
        goal: The goal along the lane; `target` what it asks now.
        came: Who came to the path and when, s.
        hard_mps2: Deceleration with which the ego must be able to stop for who steps out.
        margin_m: An agent that the path comes nearer to than this is followed, not passed.
        caution: How fast others may come into the way.
    """

    scene: Scene
    path: Path
    limit: FloatArray
    taken: StBoundaries
    passed: Mapping[str, float]
    stops: tuple[Occupancy, ...]
    targets: tuple[PassTarget, ...]
    is_pass: bool
    goal: GoalWindow
    target: SpeedTarget
    came: Mapping[str, float]
    hard_mps2: float
    margin_m: float
    caution: CautionConfig

    def arc(self, s: float) -> float:
        """The arc length at a station of the reference path, m; beyond the path's ends as far beyond them."""
        at, sigma = self.path.s, self.path.sigma
        return float(np.interp(s, at, sigma)) + min(s - float(at[0]), 0.0) + max(s - float(at[-1]), 0.0)


@dataclass(frozen=True, eq=False, slots=True)
class LoweredLimit:
    """A speed limit along a path `(m,)`, m/s, where it is kept exactly `(m,)`, and what was decided."""

    v: FloatArray
    is_bound: BoolArray
    decisions: tuple[Decision, ...] = ()


def lowered(sigma: FloatArray, road: LoweredLimit, caps: Sequence[SpeedCap]) -> LoweredLimit:
    """(1) along a path `(m,)`; a decision for each agent whose cap is worth reporting, the lowest of theirs."""
    if not caps:
        return road
    v, bound = road.v.copy(), road.is_bound.copy()
    reported: dict[str, SpeedCap] = {}
    for cap in caps:
        begin, end = np.searchsorted(sigma, (cap.s_from, cap.s_to), side="right")
        there = slice(int(begin), int(end))
        less, same = cap.v < v[there], cap.v == v[there]
        bound[there] = np.where(less, cap.is_bound, bound[there] | (same & cap.is_bound))  # (2)
        v[there] = np.where(less, cap.v, v[there])  # (1)
        if cap.agent and (cap.v < road.v[there] - WORTH_MPS).any():
            reported[cap.agent] = min(reported.get(cap.agent, cap), cap, key=lambda each: each.v)
    decisions = (Decision(cap.agent, DecisionKind.YIELD, "speed", cap.reason) for cap in reported.values())
    return LoweredLimit(v, bound, (*road.decisions, *decisions))
