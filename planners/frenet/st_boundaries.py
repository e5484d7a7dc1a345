"""S-T boundaries: when which part of the path is taken, and by which agent.

The ego's footprint is swept along the planned path and tested against each predicted footprint:

(1) taken(agent, t) = { sigma : box of the ego at path(sigma), widened by a margin, overlaps the agent's box at t }

which is an interval [lower, upper] of stations of the rear axle for each time sample. Corners and the curvature of the
path are exact, since real boxes are tested (`sweep`): at the path's points, and between two of them by bisection.

(2) An agent who crosses may come sooner by `early_s` and leave later by `late_s`: the first and the last interval are
    drawn out in time, less where the event is near and so surer.
(3) The agent's speed along the path is that of their velocity along the path's heading where they enter it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from logs.kernel import BoolArray, FloatArray, IntArray
from logs.trace import Decision, DecisionKind, GraphObstacle
from planners.frenet.occupancy import Occupancy
from planners.frenet.path import Path
from planners.frenet.scene import STANDING_MPS, Scene
from planners.frenet.sweep import Swept, sweep

NO_ONE = np.zeros(0, np.bool_)
"""None of the agents."""
ALONG = 0.8
"""Who moves along the path with this share of their speed is followed, not let go first; at 45 degrees they cross."""


@dataclass(frozen=True)
class StGraphConfig:
    """Margins of the swept footprint, added to each side of the ego, m.

    Attributes:
        margin_m: To vehicles and objects.
        vulnerable_margin_m: To pedestrians and riders.
        passed_margin_m: To an obstacle that the path passes on purpose.
        step_s: Between two time samples.
        early_s: An agent that crosses may come sooner by this, or by a third of the time that is left until then.
        late_s: It may leave later by this, or by half of the time that is left: the nearer, the surer.
    """

    margin_m: float = 0.3
    vulnerable_margin_m: float = 0.6
    passed_margin_m: float = 0.1
    step_s: float = 0.1
    early_s: float = 0.4
    late_s: float = 0.6

    def __post_init__(self) -> None:
        if not self.step_s > 0.0:
            raise ValueError("step_s must be positive")


@dataclass(frozen=True, eq=False, slots=True)
class StBoundaries:
    """The intervals (1) of `n` predictions at `k` times; NaN where the path is free.

    Attributes:
        t: `(k,)` s from the frame.
        agent: `(n,)` index into the frame's agents; -1 for a stop that belongs to none.
        lower: `(n, k)` m along the path, drawn out in time by what is uncertain; `upper` likewise.
        speed: `(n,)` the agent's speed along the path where they enter (3), m/s.
        probability: `(n,)` of the prediction.
    """

    t: FloatArray
    agent: IntArray
    lower: FloatArray
    upper: FloatArray
    speed: FloatArray
    probability: FloatArray

    def __len__(self) -> int:
        return len(self.agent)

    def only(self, rows: BoolArray) -> StBoundaries:
        """Some of them `(n,)`."""
        return StBoundaries(
            self.t, self.agent[rows], self.lower[rows], self.upper[rows], self.speed[rows], self.probability[rows]
        )

    def meets(self, t: FloatArray, s: FloatArray) -> bool:
        """Whether a profile s(t) `(m,)` enters an interval."""
        at = np.interp(self.t, t, s)
        return bool(((at > self.lower) & (at < self.upper)).any())

    def leave(self, t: FloatArray, s: FloatArray, gap: float) -> bool:
        """Whether a profile s(t) `(m,)` stays behind all intervals by a gap, m."""
        return not bool((np.interp(self.t, t, s) > self.lower - gap).any())

    @property
    def step(self) -> float:
        """Between two times, s; the predictions may be coarser than `StGraphConfig.step_s`."""
        return float(self.t[1] - self.t[0]) if len(self.t) > 1 else np.inf

    @property
    def first(self) -> float:
        """The nearest station that is taken at any time, m; inf where the path is free."""
        return float(np.nanmin(self.lower)) if len(self) else inf

    def with_stops(self, stops: Sequence[Occupancy]) -> StBoundaries:
        """These and a row per stop on the path, which belongs to no agent (-1)."""
        if not stops:
            return self
        lower = np.array([np.where(self.t < stop.until, stop.s_from, np.nan) for stop in stops])
        return StBoundaries(
            self.t,
            np.r_[self.agent, np.full(len(stops), -1)],
            np.vstack([self.lower, lower]),
            np.vstack([self.upper, np.where(np.isfinite(lower), np.inf, np.nan)]),
            np.r_[self.speed, np.zeros(len(stops))],
            np.r_[self.probability, np.ones(len(stops))],
        )


def st_boundaries(
    scene: Scene, path: Path, skip: BoolArray, passed: Collection[str], config: StGraphConfig
) -> StBoundaries:
    """The intervals (1) of all predictions but those of agents to `skip` `(agents,)`.

    Agents that the path passes on purpose (`passed`, their ids) have the smallest margin.
    """
    agents, futures, car = scene.frame.agents, scene.frame.predictions, scene.vehicle
    stride = max(1, round(config.step_s / float(futures.t[1] - futures.t[0]))) if len(futures.t) > 1 else 1
    is_passed = np.array([name in passed for name in agents.ids], np.bool_) if passed else NO_ONE
    return StBoundaries(*sweep(
        path.sigma, path.x, path.y, path.yaw, futures.t, scene.frame.t, stride, futures.agent, futures.probability,
        futures.x, futures.y, futures.yaw, agents.length, agents.width, agents.vx, agents.vy, scene.vulnerable,
        is_passed, skip,
        Swept(
            car.axle_to_center, car.length, car.width, config.margin_m, config.vulnerable_margin_m,
            config.passed_margin_m, config.early_s, config.late_s,
        ),
    ))  # fmt: skip


def decide_speed(blocks: StBoundaries, scene: Scene, s_dp: FloatArray) -> tuple[Decision, ...]:
    """Per row: overtake where a profile `(k,)` at the boundaries' times passes above, else stop, follow or yield."""
    found = []
    for i, who in enumerate(blocks.agent):
        past, total = s_dp >= 0.5 * (blocks.lower[i] + blocks.upper[i]), float(scene.speed[who])
        kind = DecisionKind.FOLLOW if blocks.speed[i] > ALONG * total else DecisionKind.YIELD
        kind = DecisionKind.STOP if total < STANDING_MPS else kind
        kind = DecisionKind.OVERTAKE if (past | np.isnan(blocks.lower[i])).all() else kind
        found.append(Decision(scene.frame.agents.ids[who], kind, "speed", _said(blocks, scene, i)))
    return tuple(found)


def _said(blocks: StBoundaries, scene: Scene, row: int) -> str:
    """When and where a row takes the path, in words."""
    taken = np.flatnonzero(np.isfinite(blocks.lower[row]))
    first, last = taken[0], taken[-1]
    return (
        f"{scene.frame.agents.kinds[blocks.agent[row]].value} takes the path from {blocks.t[first]:.1f} s to "
        f"{blocks.t[last]:.1f} s, from {blocks.lower[row, first]:.1f} m on"
    )


def outlines(blocks: StBoundaries, decisions: Sequence[Decision]) -> tuple[GraphObstacle, ...]:
    """The intervals as polygons of the S-T graph, each with what was decided about it."""
    found = []
    for i, decision in enumerate(decisions):
        taken = np.isfinite(blocks.lower[i])
        low: FloatArray = np.column_stack([blocks.t[taken], blocks.lower[i, taken]])
        high: FloatArray = np.column_stack([blocks.t[taken], blocks.upper[i, taken]])
        found.append(GraphObstacle(decision.agent, np.vstack([low, high[::-1]]), decision.kind))
    return tuple(found)


def stop_outlines(stops: Sequence[Occupancy], horizon: float, length: float) -> tuple[GraphObstacle, ...]:
    """The stops on a path as rectangles of the S-T graph, to the path's end."""
    found = []
    for stop in stops:
        end, top = min(stop.until, horizon), max(length, stop.s_from)
        corners = np.array([(0.0, stop.s_from), (end, stop.s_from), (end, top), (0.0, top)])
        found.append(GraphObstacle(stop.agent, corners, stop.kind))
    return tuple(found)
