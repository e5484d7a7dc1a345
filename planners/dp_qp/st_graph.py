"""S-T graph: when which part of the path is taken by whom.

The ego's footprint is swept along the planned path and tested against each predicted footprint:

(1) blocked(agent, t) = { sigma : box of the ego at path(sigma), widened by a margin, overlaps the agent's box at t }

which is an interval [lower, upper] of stations of the rear axle for each time sample. Corners and the curvature of the
path are exact up to the path's spacing, since real boxes are tested.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, hypot, sin

import numpy as np

from logs.frame import Frame
from logs.kernel import FloatArray, IntArray, kernel
from logs.road import line_project
from logs.scenario import AgentKind
from logs.shapes import overlap
from logs.states import wrap
from logs.trace import Decision, DecisionKind
from logs.vehicle import VehicleParameters
from planners.dp_qp.path import Path
from planners.dp_qp.reference_line import Course

CURVE_ALLOWANCE_M = 0.7


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
class Blocks:
    """The blocked intervals (1) of `n` predictions at `k` times; NaN where not blocked.

    Attributes:
        t: `(k,)` s from the frame.
        agent: `(n,)` index into the frame's agents.
        lower: `(n, k)` m along the path; `upper` likewise.
        speed: `(n,)` the agent's speed along the path where it enters, m/s.
    """

    t: FloatArray
    agent: IntArray
    lower: FloatArray
    upper: FloatArray
    speed: FloatArray

    def __len__(self) -> int:
        return len(self.agent)


@kernel
def _swept(
    path: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray, length: float, width: float,
    rear_to_center: float, ego_length: float, ego_width: float, out: FloatArray,
) -> None:  # fmt: skip
    """Blocked interval (1) of one prediction `(k,)`, into `out` `(2, k)`; rows of `path`: sigma, x, y, yaw."""
    sigma, px, py, pyaw = path[0], path[1], path[2], path[3]
    last = len(sigma) - 1
    spacing = sigma[1] - sigma[0]
    reach = 0.5 * (hypot(ego_length, ego_width) + hypot(length, width)) + abs(rear_to_center)
    span = int(reach / spacing) + 2
    near, low, high = 0, 0, last
    for k in range(len(x)):
        best = 1e300
        for j in range(low, high + 1):
            square = (px[j] - x[k]) ** 2 + (py[j] - y[k]) ** 2
            if square < best:
                best, near = square, j
        low, high = max(0, near - span - 8), min(last, near + span + 8)
        out[0, k], out[1, k] = np.nan, np.nan
        if best > reach * reach:
            continue
        c, s = cos(pyaw[near]), sin(pyaw[near])
        side = abs((y[k] - py[near]) * c - (x[k] - px[near]) * s)
        turn = yaw[k] - pyaw[near]
        half = 0.5 * (length * abs(sin(turn)) + width * abs(cos(turn)) + ego_width)
        if side > half + CURVE_ALLOWANCE_M and 0 < near < last:
            continue
        for j in range(max(0, near - span), min(last, near + span) + 1):
            ex, ey = px[j] + rear_to_center * cos(pyaw[j]), py[j] + rear_to_center * sin(pyaw[j])
            if overlap(ex, ey, pyaw[j], ego_length, ego_width, x[k], y[k], yaw[k], length, width):
                if not out[0, k] <= sigma[j]:
                    out[0, k] = sigma[max(j - 1, 0)]
                out[1, k] = sigma[min(j + 1, last)]


@kernel
def _sweep_all(
    path: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray, sizes: FloatArray, ego: FloatArray
) -> FloatArray:
    """`_swept` of predictions `(n, k)`: `(n, 2, k)`. Rows of `sizes`: length, width, margin; `ego`: offset, l, w."""
    out = np.empty((len(x), 2, x.shape[1]))
    for i in range(len(x)):
        _swept(path, x[i], y[i], yaw[i], sizes[0, i], sizes[1, i], ego[0], ego[1], ego[2] + 2.0 * sizes[2, i], out[i])
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
    course: Course, frame: Frame, s_ego: float, l_ego: float, vehicle: VehicleParameters, *, keeps_track: bool
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


def block_intervals(
    path: Path, frame: Frame, vehicle: VehicleParameters, skip: np.ndarray, passed: frozenset[str],
    config: StGraphConfig,
) -> Blocks:  # fmt: skip
    """The blocked intervals (1) of all predictions but those of agents to `skip` `(agents,)`."""
    agents, predictions = frame.agents, frame.predictions
    stride = max(1, round(config.step_s / (predictions.t[1] - predictions.t[0]))) if len(predictions.t) > 1 else 1
    used = np.flatnonzero(~skip[predictions.agent]) if len(predictions) else np.empty(0, np.int64)
    agent = predictions.agent[used]
    margin = np.array([_margin(agents.ids[i], agents.kinds[i], passed, config) for i in agent])
    t = predictions.t[::stride] - frame.t
    x, y, yaw = (np.ascontiguousarray(v[used][:, ::stride]) for v in (predictions.x, predictions.y, predictions.yaw))
    spans = _sweep_all(
        np.vstack([path.sigma, path.x, path.y, path.yaw]),
        x,
        y,
        yaw,
        np.vstack([agents.length[agent], agents.width[agent], margin]),
        np.array([vehicle.axle_to_center, vehicle.length, vehicle.width]),
    )
    blocked = np.isfinite(spans[:, 0]).any(axis=1) if len(spans) else np.zeros(0, bool)
    agent, spans = agent[blocked], spans[blocked]
    for span in spans:
        _drawn_out(t, span, config)
    return Blocks(t, agent, spans[:, 0].copy(), spans[:, 1].copy(), _speeds_along(path, frame, agent, spans))


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


def decide_speed(blocks: Blocks, frame: Frame, s_dp: FloatArray) -> tuple[Decision, ...]:
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
