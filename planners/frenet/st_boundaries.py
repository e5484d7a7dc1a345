"""S-T boundaries: when which part of the path is taken, and by which agent.

The ego's footprint is swept along the planned path and tested against each predicted footprint:

(1) taken(agent, t) = { sigma : box of the ego at path(sigma), widened by a margin, overlaps the agent's box at t }

which is an interval [lower, upper] of stations of the rear axle for each time sample. Corners and the curvature of the
path are exact, since real boxes are tested: at the path's points, and between two of them by bisection (`HALVINGS`).

(2) An agent who crosses may come sooner by `early_s` and leave later by `late_s`: the first and the last interval are
    drawn out in time, less where the event is near and so surer.
(3) The agent's speed along the path is that of their velocity along the path's heading where they enter it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, hypot, inf, isnan, sin
from typing import NamedTuple

import numpy as np

from logs.kernel import BoolArray, FloatArray, IntArray, frozen, kernel
from logs.shapes import axis_gap, overlap_turned
from logs.states import wrap
from logs.trace import Decision, DecisionKind, GraphObstacle
from planners.frenet.occupancy import Occupancy
from planners.frenet.path import Path
from planners.frenet.scene import STANDING_MPS, Scene

CREEPING_MPS = 0.1
"""Who is slower does not walk, m/s: their prediction leads nowhere."""
HALVINGS = 4
"""Of the path's spacing, about 0.4 m, towards the edge of an interval."""
JUMP = 0.999
"""Share of a gap that is jumped over, so that rounding does not jump over a touch."""
ALONG = 0.7
"""Who moves along the path with this share of their speed is followed, not let go first."""


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
        brisk_mps: Who walks or rides slower than this is taken to be as fast as this, on the predicted way.
    """

    margin_m: float = 0.3
    vulnerable_margin_m: float = 0.6
    passed_margin_m: float = 0.1
    step_s: float = 0.1
    early_s: float = 0.4
    late_s: float = 0.6
    brisk_mps: float = 0.0

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


class Swept(NamedTuple):
    """What a sweep takes of the ego and of the time, for the kernel.

    Attributes:
        rear_to_center: From the rear axle to the box's centre, m; `length` and `width` of the box.
        early: (2), s; `late` likewise.
    """

    rear_to_center: float
    length: float
    width: float
    early: float
    late: float


def st_boundaries(
    scene: Scene, path: Path, skip: BoolArray, passed: frozenset[str], config: StGraphConfig
) -> StBoundaries:
    """The intervals (1) of all predictions but those of agents to `skip` `(agents,)`.

    Agents that the path passes on purpose (`passed`, their ids) have the smallest margin.
    """
    agents, futures, car = scene.frame.agents, scene.frame.predictions, scene.vehicle
    stride = max(1, round(config.step_s / float(futures.t[1] - futures.t[0]))) if len(futures.t) > 1 else 1
    margin = np.where(scene.vulnerable, config.vulnerable_margin_m, config.margin_m)
    for i, name in enumerate(agents.ids if passed else ()):
        if name in passed:
            margin[i] = config.passed_margin_m
    ways = _brisk(scene, config.brisk_mps) if config.brisk_mps > 0.0 else (futures.x, futures.y, futures.yaw)
    t, found, lower, upper, speed = _swept(
        np.vstack([path.sigma, path.x, path.y, path.yaw]), futures.t, scene.frame.t, stride, futures.agent, skip, *ways,
        agents.length, agents.width, margin, agents.vx, agents.vy,
        Swept(car.axle_to_center, car.length, car.width, config.early_s, config.late_s),
    )  # fmt: skip
    return StBoundaries(t, futures.agent[found], lower, upper, speed, futures.probability[found])


def _brisk(scene: Scene, brisk: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The predictions x, y, yaw `(n, k)`, who walks or rides slower than `brisk`, m/s, as fast as that on their way."""
    futures = scene.frame.predictions
    t, slow = futures.t - scene.frame.t, _is_slow(scene, futures.agent, brisk)
    ways = [way.copy() for way in (futures.x, futures.y, futures.yaw)]
    for i in np.flatnonzero(slow):
        ahead = t * brisk / scene.speed[futures.agent[i]]
        for way in ways:
            way[i] = _beyond(ahead, t, way[i])
    x, y, yaw = (frozen(way) for way in ways)
    return x, y, yaw


def _is_slow(scene: Scene, agent: IntArray, brisk: float) -> BoolArray:
    """Which of the predicted agents `(n,)` walk or ride slower than `brisk`, m/s, but do not stand."""
    speed = scene.speed[agent]
    return np.asarray(scene.vulnerable[agent] & (speed > CREEPING_MPS) & (speed < brisk))


def _beyond(ahead: FloatArray, t: FloatArray, way: FloatArray) -> FloatArray:
    """A predicted coordinate `(k,)` at the times `ahead`, s; after its end it goes on as at its end."""
    slope = (way[-1] - way[-2]) / (t[-1] - t[-2])
    return np.interp(ahead, t, way) + slope * np.maximum(ahead - t[-1], 0.0)


@kernel
def _swept(
    path: FloatArray, times: FloatArray, now: float, stride: int, agent: IntArray, skip: BoolArray,
    x: FloatArray, y: FloatArray, yaw: FloatArray, length: FloatArray, width: FloatArray, margin: FloatArray,
    vx: FloatArray, vy: FloatArray, ego: Swept,
) -> tuple[FloatArray, IntArray, FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """The predictions that take the path: times from now `(m,)`, rows `(r,)`, lower and upper `(r, m)`, speed `(r,)`.

    Times are `stride` samples apart. `path` has the rows sigma, x, y, yaw `(4, points)`, predictions are `(n, k)`; size
    margin, velocity and whether to `skip` them are the agents'.
    """
    widest = margin.max() if len(margin) else 0.0
    boxes, moved = _ego_boxes(path, ego.rear_to_center, 0.5 * hypot(ego.length, ego.width + 2.0 * widest))
    low_x, high_x, low_y, high_y = boxes[0].min(), boxes[0].max(), boxes[1].min(), boxes[1].max()
    t = times[::stride] - now
    rows, speed = np.empty(len(x), np.int64), np.empty(len(x))
    lower, upper = np.empty((len(x), len(t))), np.empty((len(x), len(t)))
    count = 0
    for i in range(len(x)):
        who = agent[i]
        if skip[who]:
            continue
        size = length[who], width[who]
        ego_width = ego.width + 2.0 * margin[who]
        reach = 0.5 * hypot(ego.length, ego_width) + 0.5 * hypot(size[0], size[1])
        taken = False
        for k in range(len(t)):
            lower[count, k] = upper[count, k] = np.nan
            at_x, at_y = x[i, k * stride], y[i, k * stride]
            if not (low_x - reach <= at_x <= high_x + reach and low_y - reach <= at_y <= high_y + reach):
                continue
            heading = yaw[i, k * stride]
            other = at_x, at_y, cos(heading), sin(heading), size[0], size[1]
            met = _first_met(boxes, 0, 1, moved, ego.length, ego_width, other)
            if met >= 0:
                last = _first_met(boxes, boxes.shape[1] - 1, -1, moved, ego.length, ego_width, other)
                lower[count, k] = _edge(path[0], boxes, met, -1, ego.length, ego_width, other)  # (1)
                upper[count, k] = _edge(path[0], boxes, last, 1, ego.length, ego_width, other)
                taken = True
        if taken:
            rows[count] = i
            entry = _drawn_out(t, lower[count], upper[count], ego.early, ego.late)  # (2)
            at = min(int(np.searchsorted(path[0], entry)), path.shape[1] - 1)
            speed[count] = vx[who] * cos(path[3, at]) + vy[who] * sin(path[3, at])  # (3)
            count += 1
    return t, rows[:count].copy(), lower[:count].copy(), upper[:count].copy(), speed[:count].copy()


@kernel
def _ego_boxes(path: FloatArray, rear_to_center: float, radius: float) -> tuple[FloatArray, float]:
    """Rows x, y, yaw, cos yaw, sin yaw `(5, m)` of the ego's box along a path; how far its points move at most, m."""
    out = np.empty((5, path.shape[1]))
    moved = 1e-6
    for j in range(path.shape[1]):
        c, s = cos(path[3, j]), sin(path[3, j])
        out[0, j], out[1, j] = path[1, j] + rear_to_center * c, path[2, j] + rear_to_center * s
        out[2, j], out[3, j], out[4, j] = path[3, j], c, s
        if j > 0:
            away = hypot(out[0, j] - out[0, j - 1], out[1, j] - out[1, j - 1])
            moved = max(moved, away + radius * abs(wrap(out[2, j] - out[2, j - 1])))
    return out, moved


@kernel
def _first_met(
    boxes: FloatArray, begin: int, step: int, moved: float, length: float, width: float,
    other: tuple[float, float, float, float, float, float],
) -> int:  # fmt: skip
    """The first point from `begin` on, in steps of +-1, at which the ego overlaps a box; -1 where there is none.

    Points are jumped over at which the gap cannot have closed: from one to the next no point of the ego's box moves
    further than `moved` m. The `other` box is x, y, cos yaw, sin yaw, length, width.
    """
    j = begin
    while 0 <= j < boxes.shape[1]:
        gap = axis_gap(
            boxes[0, j], boxes[1, j], boxes[3, j], boxes[4, j], length, width,
            other[0], other[1], other[2], other[3], other[4], other[5],
        )  # fmt: skip
        if gap <= 0.0:
            return j
        j += step * (1 + int(JUMP * gap / moved))
    return -1


@kernel
def _edge(
    sigma: FloatArray, boxes: FloatArray, met: int, step: int, length: float, width: float,
    other: tuple[float, float, float, float, float, float],
) -> float:  # fmt: skip
    """The station next to point `met`, which overlaps, towards `met + step`, at which the ego does not overlap."""
    free = met + step
    if free < 0 or free >= boxes.shape[1]:
        return sigma[met]
    low, high = 0.0, 1.0  # share of the way from `met` to `free`: overlaps at low, not at high
    for _ in range(HALVINGS):
        u = 0.5 * (low + high)
        x = boxes[0, met] + u * (boxes[0, free] - boxes[0, met])
        y = boxes[1, met] + u * (boxes[1, free] - boxes[1, met])
        turned = boxes[2, met] + u * wrap(boxes[2, free] - boxes[2, met])
        if overlap_turned(
            x, y, cos(turned), sin(turned), length, width, other[0], other[1], other[2], other[3], other[4], other[5]
        ):
            low = u
        else:
            high = u
    return sigma[met] + high * (sigma[free] - sigma[met])


@kernel
def _drawn_out(t: FloatArray, lower: FloatArray, upper: FloatArray, early: float, late: float) -> float:
    """Draw an interval `(k,)` out in time (2); returns the station at which the agent enters."""
    first, last = 0, len(t) - 1
    while isnan(lower[first]):
        first += 1
    while isnan(lower[last]):
        last -= 1
    begin = t[first] - min(early, t[first] / 3.0)
    end = t[last] + (min(late, 0.5 * t[last]) if last < len(t) - 1 else 0.0)
    for k in range(len(t)):
        if begin <= t[k] < t[first]:
            lower[k], upper[k] = lower[first], upper[first]
        elif t[last] < t[k] <= end:
            lower[k], upper[k] = lower[last], upper[last]
    return lower[first]


def decide_speed(blocks: StBoundaries, scene: Scene, s_dp: FloatArray) -> tuple[Decision, ...]:
    """Per row: overtake where a profile `(k,)` at the boundaries' times passes above, else stop, follow or yield."""
    return tuple(
        Decision(scene.frame.agents.ids[who], decided(blocks, scene, s_dp, i), "speed", said(blocks, scene, i))
        for i, who in enumerate(blocks.agent)
    )


def decided(blocks: StBoundaries, scene: Scene, s_dp: FloatArray, row: int) -> DecisionKind:
    """The decision about one row."""
    lower, upper, total = blocks.lower[row], blocks.upper[row], float(scene.speed[blocks.agent[row]])
    taken = np.isfinite(lower)
    if bool((s_dp[taken] >= 0.5 * (lower[taken] + upper[taken])).all()):
        return DecisionKind.OVERTAKE
    if total < STANDING_MPS:
        return DecisionKind.STOP
    return DecisionKind.FOLLOW if float(blocks.speed[row]) > ALONG * total else DecisionKind.YIELD


def said(blocks: StBoundaries, scene: Scene, row: int) -> str:
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
