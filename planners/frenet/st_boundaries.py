"""S-T boundaries: when agents take which part of the path.

The ego's footprint is swept along the planned path and tested against each predicted footprint:

(1) taken(agent, t) = { sigma : box of the ego at path(sigma), widened by a margin,
        overlaps the agent's box at t }

which is an interval [lower, upper] of stations of the rear axle for each time sample (`sweep`).

(2) An agent that crosses may come sooner by `early_s` and leave later by `late_s`: the first and
    the last interval are extended in time, less where the event is near and so more certain.
(3) The agent's speed along the path is the component of its velocity along the path's heading where
    it enters the path.
(4) Decision for a profile s(t): overtake where it passes above the middle of all intervals; else
    stop for agents that stand, follow those that move along the path with more than the share
    `ALONG` of their speed, yield to all others.
(5) Braking gives a vehicle that comes towards the ego no more room beside it, so that it needs only
    the margin of what the path passes on purpose.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from math import inf, isnan, pi

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.core.kernel import kernel
from replan.core.settings import Config, NotNegative, Positive
from replan.logs.plan import Decision, DecisionKind, GraphObstacle
from replan.planners.frenet.path import Path
from replan.planners.frenet.scene import STANDING_MPS, Occupancy, Scene
from replan.planners.frenet.sweep import Roles, Swept, SweptPath, sweep

ALONG = 0.8
"""An agent with this share of its speed along the path is followed, not yielded to.

At 45 degrees it crosses.
"""
# A vehicle that is turned against the lane by more than this comes towards the ego, rad
ONCOMING_RAD = 0.75 * pi
# The decisions (4) ...
KINDS = (DecisionKind.OVERTAKE, DecisionKind.STOP, DecisionKind.FOLLOW, DecisionKind.YIELD)
OVERTAKE, STOP, FOLLOW, YIELD = range(len(KINDS))  # ... and their codes.


@dataclass(frozen=True)
class StGraphConfig(Config):
    """Margins of the swept footprint, added to each side of the ego, m."""

    margin_m: NotNegative = 0.3
    """Margin to vehicles and objects."""
    vulnerable_margin_m: NotNegative = 0.6
    """Margin to pedestrians and riders."""
    passed_margin_m: NotNegative = 0.1
    """Margin to an obstacle that the path passes on purpose."""
    step_s: Positive = 0.1
    """Time between two samples."""
    early_s: NotNegative = 0.4
    """An agent that crosses may come sooner by this, at most by a third of the time left until
    then.
    """
    late_s: NotNegative = 0.6
    """An agent that crosses may leave later by this, at most by half of the time left until then.
    """


@dataclass(frozen=True, eq=False, slots=True)
class StBoundaries:
    """The intervals (1) of `n` predictions at `k` times; NaN where the path is free."""

    t: FloatArray  # `(k,)` s from the frame
    # `(n,)` index into the frame's agents; -1 for a stop, which belongs to no agent
    agent: IntArray
    # `(n, k)` m along the path, extended in time by the uncertainty (2); `upper` likewise
    lower: FloatArray
    upper: FloatArray
    speed: FloatArray  # `(n,)` the agent's speed along the path where it enters (3), m/s
    probability: FloatArray  # `(n,)` probability of the prediction

    def __len__(self) -> int:
        return len(self.agent)

    def only(self, rows: BoolArray) -> StBoundaries:
        """The boundaries of some rows; `rows` is a mask `(n,)`."""
        return StBoundaries(
            self.t,
            self.agent[rows],
            self.lower[rows],
            self.upper[rows],
            self.speed[rows],
            self.probability[rows],
        )

    def meets(self, t: FloatArray, s: FloatArray) -> bool:
        """Whether a profile s(t) `(m,)` enters an interval."""
        stations = np.interp(self.t, t, s)
        return bool(((stations > self.lower) & (stations < self.upper)).any())

    def leave(self, t: FloatArray, s: FloatArray, gap: float) -> bool:
        """Whether a profile s(t) `(m,)` stays behind all intervals by a gap, m."""
        return not bool((np.interp(self.t, t, s) > self.lower - gap).any())

    @property
    def step(self) -> float:
        """Time between two samples, s.

        The predictions may be coarser than `StGraphConfig.step_s`.
        """
        return float(self.t[1] - self.t[0]) if len(self.t) > 1 else np.inf

    @property
    def first(self) -> float:
        """The nearest station that is taken at any time, m; inf where the path is free."""
        return float(np.nanmin(self.lower)) if len(self) else inf

    def with_stops(self, stops: Sequence[Occupancy]) -> StBoundaries:
        """Add a row for each stop on the path; its agent is -1."""
        if not stops:
            return self
        n, lower = (
            len(stops),
            np.array([np.where(self.t < stop.until, stop.s_from, np.nan) for stop in stops]),
        )
        upper = np.where(np.isfinite(lower), np.inf, np.nan)
        agent, speed, sure = (
            np.r_[self.agent, np.full(n, -1)],
            np.r_[self.speed, np.zeros(n)],
            np.ones(n),
        )
        lowest, highest = np.vstack([self.lower, lower]), np.vstack([self.upper, upper])
        return StBoundaries(self.t, agent, lowest, highest, speed, np.r_[self.probability, sure])


def st_boundaries(
    scene: Scene, path: Path, skip: BoolArray, passed: Collection[str], config: StGraphConfig
) -> StBoundaries:
    """The intervals (1) of all predictions except those of agents to `skip` `(agents,)`.

    Agents that the path passes on purpose (`passed`, their ids) have the smallest margin, and
    oncoming vehicles (5).
    """
    agents, futures, car = scene.frame.agents, scene.futures, scene.vehicle
    stride = (
        max(1, round(config.step_s / float(futures.t[1] - futures.t[0])))
        if len(futures.t) > 1
        else 1
    )
    # (5)
    is_passed = (np.abs(scene.agents.turn) > ONCOMING_RAD) & ~scene.standing & ~scene.vulnerable
    if passed:
        is_passed |= np.array([name in passed for name in agents.ids], np.bool_)
    margins = config.margin_m, config.vulnerable_margin_m, config.passed_margin_m
    ego = Swept(car.axle_to_center, car.length, car.width, *margins, config.early_s, config.late_s)
    swept = SweptPath(path.sigma, path.x, path.y, path.yaw)
    roles = Roles(skip, scene.vulnerable, is_passed)
    return StBoundaries(*sweep(swept, futures, scene.bodies, roles, ego, scene.frame.t, stride))


@kernel
def decide(
    lower: FloatArray, upper: FloatArray, speed: FloatArray, total: FloatArray, s: FloatArray
) -> IntArray:
    """Codes of (4) `(n,)` for intervals `(n, k)` and a profile `(k,)` at their times.

    `speed` is that along the path, `total` the speed of the agents `(n,)`, m/s.
    """
    codes = np.empty(len(lower), np.int64)
    for i in range(len(lower)):
        is_past = True
        for k in range(len(s)):
            is_past &= isnan(lower[i, k]) or s[k] >= 0.5 * (lower[i, k] + upper[i, k])
        if is_past:  # (4)
            codes[i] = OVERTAKE
        elif total[i] < STANDING_MPS:
            codes[i] = STOP
        else:
            codes[i] = FOLLOW if speed[i] > ALONG * total[i] else YIELD
    return codes


def decide_speed(blocks: StBoundaries, scene: Scene, s: FloatArray) -> tuple[Decision, ...]:
    """Decide (4) for each row and a profile `(k,)` at the boundaries' times.

    The reason has when and where.
    """
    decisions, agents = [], scene.frame.agents
    codes = decide(blocks.lower, blocks.upper, blocks.speed, scene.speed[blocks.agent], s)
    for code, agent, lower in zip(codes, blocks.agent, blocks.lower, strict=True):
        taken = np.flatnonzero(np.isfinite(lower))
        times = (
            f"from {blocks.t[taken[0]]:.1f} s to {blocks.t[taken[-1]]:.1f} s, from "
            f"{lower[taken[0]]:.1f} m on"
        )
        reason = f"{agents.kinds[agent].value} takes the path {times}"
        decisions.append(Decision(agents.ids[agent], KINDS[code], "speed", reason))
    return tuple(decisions)


def outlines(blocks: StBoundaries, decisions: Sequence[Decision]) -> tuple[GraphObstacle, ...]:
    """The intervals as polygons of the S-T graph, each with its decision."""
    polygons = []
    for i, decision in enumerate(decisions):
        taken = np.isfinite(blocks.lower[i])
        low: FloatArray = np.column_stack([blocks.t[taken], blocks.lower[i, taken]])
        high: FloatArray = np.column_stack([blocks.t[taken], blocks.upper[i, taken]])
        polygons.append(GraphObstacle(decision.agent, np.vstack([low, high[::-1]]), decision.kind))
    return tuple(polygons)


def stop_outlines(
    stops: Sequence[Occupancy], horizon: float, length: float
) -> tuple[GraphObstacle, ...]:
    """The stops on a path as rectangles of the S-T graph, to the path's end."""
    rectangles = []
    for stop in stops:
        end, top = min(stop.until, horizon), max(length, stop.s_from)
        corners = np.array([(0.0, stop.s_from), (end, stop.s_from), (end, top), (0.0, top)])
        rectangles.append(GraphObstacle(stop.agent, corners, stop.kind))
    return tuple(rectangles)
