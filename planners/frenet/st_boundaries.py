"""S-T graph: when which part of the path is taken by whom.

The ego's footprint is swept along the planned path and tested against each predicted footprint:

(1) blocked(agent, t) = { sigma : box of the ego at path(sigma), widened by a margin, overlaps the agent's box at t }

which is an interval [lower, upper] of stations of the rear axle for each time sample. Corners and the curvature of the
path are exact, since real boxes are tested: at the path's points, and between two of them by bisection (`HALVINGS`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, hypot, sin, sqrt

import numpy as np

from logs.frame import Frame
from logs.kernel import BoolArray, FloatArray, IntArray, kernel
from logs.road import line_project
from logs.scenario import AgentKind
from logs.shapes import overlap
from logs.states import wrap
from logs.trace import Decision, DecisionKind, GraphObstacle
from logs.vehicle import VehicleParameters
from planners.frenet.path import Path
from planners.frenet.reference_path import ReferencePath

CREEPING_MPS = 0.1
HALVINGS = 4
"""Of the path's spacing, about 0.4 m, towards the edge of a blocked interval."""


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
    """The blocked intervals (1) of `n` predictions at `k` times; NaN where not blocked.

    Attributes:
        t: `(k,)` s from the frame.
        agent: `(n,)` index into the frame's agents.
        lower: `(n, k)` m along the path, drawn out in time by what is uncertain; `upper` likewise.
        speed: `(n,)` the agent's speed along the path where it enters, m/s.
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
        """Whether a profile s(t) `(m,)` enters a block."""
        at = np.interp(self.t, t, s)
        return bool(((at > self.lower) & (at < self.upper)).any())

    def leave(self, t: FloatArray, s: FloatArray, gap: float) -> bool:
        """Whether a profile s(t) `(m,)` stays behind all blocks by a gap, m."""
        return not bool((np.interp(self.t, t, s) > self.lower - gap).any())

    @property
    def step(self) -> float:
        """Between two times, s; the predictions may be coarser than `StGraphConfig.step_s`."""
        return float(self.t[1] - self.t[0]) if len(self.t) > 1 else np.inf


@kernel
def _first_met(
    boxes: FloatArray, begin: int, step: int, spacing: float, ego_length: float, ego_width: float,
    x: float, y: float, yaw: float, length: float, width: float,
) -> int:  # fmt: skip
    """The first point from `begin` on, in steps of +-1, at which the ego overlaps a box; -1 where there is none.

    Points too far away to overlap are jumped over: neighbours in `boxes` (rows x, y, yaw, cos, sin of the ego's box)
    are not further apart than `spacing` m.
    """
    other = 0.5 * hypot(length, width)
    reach = 0.5 * hypot(ego_length, ego_width) + other
    j = begin
    while 0 <= j < boxes.shape[1]:
        dx, dy = x - boxes[0, j], y - boxes[1, j]
        away = sqrt(dx * dx + dy * dy) - reach
        if away > 0.0:
            j += step * (1 + int(away / spacing))
            continue
        beside = abs(dy * boxes[3, j] - dx * boxes[4, j]) > 0.5 * ego_width + other
        if not beside and overlap(
            boxes[0, j], boxes[1, j], boxes[2, j], ego_length, ego_width, x, y, yaw, length, width
        ):
            return j
        j += step
    return -1


@kernel
def _ego_boxes(path: FloatArray, rear_to_center: float) -> FloatArray:
    """Rows x, y, yaw, cos yaw, sin yaw `(5, m)` of the ego's box along a path with rows sigma, x, y, yaw."""
    out = np.empty((5, path.shape[1]))
    for j in range(path.shape[1]):
        c, s = cos(path[3, j]), sin(path[3, j])
        out[0, j], out[1, j] = path[1, j] + rear_to_center * c, path[2, j] + rear_to_center * s
        out[2, j], out[3, j], out[4, j] = path[3, j], c, s
    return out


@kernel
def _edge(
    sigma: FloatArray, boxes: FloatArray, met: int, step: int, ego_length: float, ego_width: float,
    x: float, y: float, yaw: float, length: float, width: float,
) -> float:  # fmt: skip
    """The station next to point `met`, which overlaps, towards `met + step`, at which the ego does not overlap."""
    free = met + step
    if free < 0 or free >= boxes.shape[1]:
        return sigma[met]
    low, high = 0.0, 1.0  # share of the way from `met` to `free`: overlaps at low, not at high
    for _ in range(HALVINGS):
        u = 0.5 * (low + high)
        bx, by = (
            boxes[0, met] + u * (boxes[0, free] - boxes[0, met]),
            boxes[1, met] + u * (boxes[1, free] - boxes[1, met]),
        )
        turned = boxes[2, met] + u * wrap(boxes[2, free] - boxes[2, met])
        if overlap(bx, by, turned, ego_length, ego_width, x, y, yaw, length, width):
            low = u
        else:
            high = u
    return sigma[met] + high * (sigma[free] - sigma[met])


@kernel
def _sweep_all(
    path: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray, sizes: FloatArray, ego: FloatArray
) -> FloatArray:
    """Blocked intervals (1) of predictions `(n, k)`: `(n, 2, k)`.

    Args:
        path: Rows sigma, x, y, yaw `(4, m)`.
        x: Centres of the predicted boxes `(n, k)`.
        y: `(n, k)`.
        yaw: `(n, k)`.
        sizes: Rows length, width, margin `(3, n)`.
        ego: Rear axle to centre, length, width.
    """
    last = path.shape[1] - 1
    boxes = _ego_boxes(path, ego[0])
    spacing = 1e-6
    for j in range(last):
        spacing = max(spacing, hypot(boxes[0, j + 1] - boxes[0, j], boxes[1, j + 1] - boxes[1, j]))
    out = np.full((len(x), 2, x.shape[1]), np.nan)
    for i in range(len(x)):
        length, width, ego_width = sizes[0, i], sizes[1, i], ego[2] + 2.0 * sizes[2, i]
        for k in range(x.shape[1]):
            at = x[i, k], y[i, k], yaw[i, k], length, width
            first = _first_met(boxes, 0, 1, spacing, ego[1], ego_width, *at)
            if first >= 0:
                final = _first_met(boxes, last, -1, spacing, ego[1], ego_width, *at)
                out[i, 0, k] = _edge(path[0], boxes, first, -1, ego[1], ego_width, *at)
                out[i, 1, k] = _edge(path[0], boxes, final, 1, ego[1], ego_width, *at)
    return out


@kernel
def agents_frenet(
    knots: FloatArray, coef: FloatArray, x: FloatArray, y: FloatArray, s_guess: float, window: float
) -> FloatArray:
    """Frenet coordinates `(n, 2)` of points `(n,)`, each looked for around the same guess."""
    out = np.empty((len(x), 2))
    for i in range(len(x)):
        out[i, 0], out[i, 1] = line_project(knots, coef, x[i], y[i], s_guess, window)
    return out


def behind(
    course: ReferencePath, frame: Frame, s_ego: float, l_ego: float, vehicle: VehicleParameters, *, keeps_track: bool
) -> np.ndarray:
    """Which agents `(n,)` bool follow behind the ego, so that it is they who must see it.

    Where the ego keeps its track these are all behind it in its direction; where it changes, those in its track.
    """
    agents = frame.agents
    line = course.line
    frenet = agents_frenet(line.s, line.coef, agents.x, agents.y, s_ego, 80.0)
    turn = np.abs([wrap(yaw - frame.ego.yaw) for yaw in agents.yaw])
    in_track = keeps_track | (np.abs(frenet[:, 1] - l_ego) < 0.5 * (agents.width + vehicle.width) + 0.3)
    is_behind: np.ndarray = frenet[:, 0] + 0.5 * agents.length < s_ego - vehicle.rear_overhang + 0.5
    return is_behind & in_track & (turn < 0.5 * np.pi)


def st_boundaries(
    path: Path, frame: Frame, vehicle: VehicleParameters, skip: np.ndarray, passed: frozenset[str],
    config: StGraphConfig,
) -> StBoundaries:  # fmt: skip
    """The blocked intervals (1) of all predictions but those of agents to `skip` `(agents,)`."""
    agents, predictions = frame.agents, frame.predictions
    stride = max(1, round(config.step_s / (predictions.t[1] - predictions.t[0]))) if len(predictions.t) > 1 else 1
    used = np.flatnonzero(~skip[predictions.agent]) if len(predictions) else np.empty(0, np.int64)
    agent = predictions.agent[used]
    margin = np.array([_margin(agents.ids[i], agents.kinds[i], passed, config) for i in agent])
    t = predictions.t[::stride] - frame.t
    x, y, yaw = (np.ascontiguousarray(v[used][:, ::stride]) for v in (predictions.x, predictions.y, predictions.yaw))
    for i in np.flatnonzero(_is_slow(frame, agent, config.brisk_mps)):
        ahead = t * config.brisk_mps / frame.agents.speed[agent[i]]
        x[i], y[i], yaw[i] = (_beyond(ahead, t, way[i]) for way in (x, y, yaw))
    spans = _sweep_all(
        np.vstack([path.sigma, path.x, path.y, path.yaw]),
        x,
        y,
        yaw,
        np.vstack([agents.length[agent], agents.width[agent], margin]),
        np.array([vehicle.axle_to_center, vehicle.length, vehicle.width]),
    )
    blocked = np.isfinite(spans[:, 0]).any(axis=1) if len(spans) else np.zeros(0, bool)
    agent, spans, probability = agent[blocked], spans[blocked], predictions.probability[used][blocked]
    for span in spans:
        _drawn_out(t, span, config)
    return StBoundaries(
        t, agent, spans[:, 0].copy(), spans[:, 1].copy(), _speeds_along(path, frame, agent, spans), probability
    )


def _is_slow(frame: Frame, agent: IntArray, brisk: float) -> np.ndarray:
    """Which of the predicted agents `(n,)` walk or ride slower than `brisk`, m/s, but do not stand."""
    vulnerable = np.array([frame.agents.kinds[i].is_vulnerable for i in agent], bool)
    speed = frame.agents.speed[agent]
    return vulnerable & (speed > CREEPING_MPS) & (speed < brisk)


def _beyond(ahead: FloatArray, t: FloatArray, way: FloatArray) -> FloatArray:
    """A predicted coordinate `(k,)` at the times `ahead`, s; after its end it goes on as at its end."""
    slope = (way[-1] - way[-2]) / (t[-1] - t[-2])
    return np.interp(ahead, t, way) + slope * np.maximum(ahead - t[-1], 0.0)


def _drawn_out(t: FloatArray, span: FloatArray, config: StGraphConfig) -> None:
    """Let a block `(2, k)` begin sooner and end later, as its first and last interval stand."""
    taken = np.flatnonzero(np.isfinite(span[0]))
    first, last = taken[0], taken[-1]
    begin = t[first] - min(config.early_s, t[first] / 3.0)
    end = t[last] + (min(config.late_s, 0.5 * t[last]) if last < len(t) - 1 else 0.0)
    span[:, np.flatnonzero((t >= begin) & (t < t[first]))] = span[:, first, None]
    span[:, np.flatnonzero((t > t[last]) & (t <= end))] = span[:, last, None]


def _speeds_along(path: Path, frame: Frame, agent: IntArray, spans: FloatArray) -> FloatArray:
    speeds = np.zeros(len(agent))
    for i, who in enumerate(agent):
        entry = spans[i, 0, int(np.argmax(np.isfinite(spans[i, 0])))]
        yaw = path.yaw[min(int(np.searchsorted(path.sigma, entry)), len(path.yaw) - 1)]
        speeds[i] = frame.agents.vx[who] * np.cos(yaw) + frame.agents.vy[who] * np.sin(yaw)
    return speeds


def _margin(agent: str, kind: AgentKind, passed: frozenset[str], config: StGraphConfig) -> float:
    if agent in passed:
        return config.passed_margin_m
    return config.vulnerable_margin_m if kind.is_vulnerable else config.margin_m


def decide_speed(blocks: StBoundaries, frame: Frame, s_dp: FloatArray) -> tuple[Decision, ...]:
    """Per block: overtake where the DP profile `(k,)` at the blocks' times passes above, else stop, follow or yield."""
    decisions = []
    for i, who in enumerate(blocks.agent):
        taken = np.flatnonzero(np.isfinite(blocks.lower[i]))
        first, last = taken[0], taken[-1]
        above = s_dp[taken] >= 0.5 * (blocks.lower[i, taken] + blocks.upper[i, taken])
        ego_first = bool(above.all())
        speed, total = float(blocks.speed[i]), float(frame.agents.speed[who])
        if ego_first:
            kind = DecisionKind.OVERTAKE
        elif total < 0.5:
            kind = DecisionKind.STOP
        elif speed > 0.7 * total:
            kind = DecisionKind.FOLLOW
        else:
            kind = DecisionKind.YIELD
        reason = (
            f"{frame.agents.kinds[who].value} takes the path from {blocks.t[first]:.1f} s to {blocks.t[last]:.1f} s, "
            f"from {blocks.lower[i, first]:.1f} m on"
        )
        decisions.append(Decision(frame.agents.ids[who], kind, "speed", reason))
    return tuple(decisions)


def outlines(blocks: StBoundaries, decisions: Sequence[Decision]) -> tuple[GraphObstacle, ...]:
    """The blocked intervals as polygons of the S-T graph, each with what was decided about it."""
    found = []
    for i, decision in enumerate(decisions):
        taken = np.isfinite(blocks.lower[i])
        low: FloatArray = np.column_stack([blocks.t[taken], blocks.lower[i, taken]])
        high: FloatArray = np.column_stack([blocks.t[taken], blocks.upper[i, taken]])
        found.append(GraphObstacle(decision.agent, np.vstack([low, high[::-1]]), decision.kind))
    return tuple(found)
