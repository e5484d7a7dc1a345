"""The score of simulated proposals: nuPlan's closed-loop metrics over the proposal, as in
PDM-Closed.

(1) score = collision direction drivable (5 progress + 5 ttc + 2 comfort) / 12

    collision   0 with a contact at fault (1/2 with an object): with a standing agent, with the
                ego's front, or with its side while it is out of its lane; agents that touch the ego
                at the start are ignored, and so is an agent after a first contact that is not the
                ego's fault; a standing ego is never at fault
    direction   1/2, 0 where the centre drives more than 2 m, 6 m beside the lanes of the ego's
                direction
    drivable    0 where a corner is more than `OFF_M` farther off the road than the farthest corner
                at the start
    progress    way of the centre along the route times the first three factors, relative to that of
                the best proposal;
                where that is 0.1 m or less: 1 for each proposal whose factors are not 0
    ttc         0 where the ego's box, extrapolated straight for 0, 0.3, 0.6 or 0.9 s, touches an
                agent not behind it
    comfort     1 where six signals are within nuPlan's bounds, after Savitzky-Golay filters

The agents keep their velocity. The road is that along the route: the ego's lane (`lane_left`,
`lane_right`), those of its direction (`road_...`), and that of the opposite direction where its
marking may be crossed (`facing_...`). An offset from the route's line starts at the projection of
the ego's centre, to second order in the corner's distance d along the line:

(2) l = l_c + (the corner's distance across the line) - kappa d^2 / 2
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import cos, hypot, sin
from typing import NamedTuple

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray, frozen
from replan.core.kernel import inner_kernel, kernel
from replan.logs.agents import AgentKind, among
from replan.logs.reference_line import line_frame, line_project
from replan.logs.shapes import overlap
from replan.planners.frenet.profiles import STEP_S
from replan.planners.frenet.reference_path import sections
from replan.planners.frenet.scene import Scene
from replan.planners.pdm.lqr_tracker import SPEED, YAW, X, Y

OFF_M = 0.3
"""nuPlan's tolerance for leaving the road, m."""
HALF_AGAINST_M = 2.0
"""Way beside the lanes of the ego's direction above which `direction` is 1/2, m."""
AGAINST_M = 6.0
"""Way beside the lanes of the ego's direction above which `direction` is 0, m."""
LEAST_WAY_M = 0.1
"""Where the best proposal does not progress more than this, progress is not compared, m."""
STOPPED_MPS = 0.05
"""The ego and agents stand up to this speed, as nuPlan judges contacts, m/s."""
NO_TTC_MPS = 0.1 * STOPPED_MPS
"""Below this speed of the ego its `ttc` is 1, m/s."""
BEHIND = cos(np.deg2rad(150.0))
"""An agent more than 150 degrees off the heading, seen from the rear axle, is behind: cosine."""
CARRIED = (0, 3, 6, 9)
"""Steps by which `ttc` extrapolates the ego straight ahead."""
OBJECTS = among(AgentKind.OBJECT)
CORNERS = 4
"""Corners of a box; in arrays of its points the centre stands after them."""
SEARCH_M = 30.0
"""The foot point of the start is searched this far from the scene's station, m."""
STEP_M = 10.0
"""The foot point of a step is searched this far from that of the step before, m."""
APART, TOUCHES, TOUCHES_BEHIND = range(3)
"""How the ego and an agent meet: the agent that it touches may be behind the ego."""


class ScorePart(NamedTuple):
    """A part of the score by its name, and in words why a proposal is worse by it."""

    name: str
    why_not: str


FACTORS = (
    ScorePart("no collision", "collides at fault"),
    ScorePart("driving direction", "drives beside the lanes of its direction"),
    ScorePart("drivable area", "leaves the road"),
)
"""The factors of (1), in its order."""
TERMS = (
    ScorePart("progress", "makes less progress"),
    ScorePart("time to collision", "comes too close in time"),
    ScorePart("comfort", "uncomfortable"),
)
"""The weighted terms of (1), in its order."""


class SignalBounds(NamedTuple):
    """Bounds between which a signal is comfortable."""

    low: float
    high: float


COMFORT_BOUNDS = {
    "lon_accel_mps2": SignalBounds(-4.05, 2.40),
    "lat_accel_mps2": SignalBounds(-4.89, 4.89),
    "jerk_mps3": SignalBounds(-8.37, 8.37),
    "lon_jerk_mps3": SignalBounds(-4.13, 4.13),
    "yaw_accel_radps2": SignalBounds(-1.93, 1.93),
    "yaw_rate_radps": SignalBounds(-0.95, 0.95),
}
"""nuPlan's bounds of comfort (its configuration of the metrics of the ego's motion)."""


@dataclass(frozen=True, eq=False, slots=True)
class Scores:
    """Scores of n proposals: `FACTORS` and `TERMS` `(6, n)`, each 0 to 1, and the terms times
    weights and factors `(3, n)`.

    `contact` `(n,)` is the time of the first contact at fault, s, or inf; `agent` `(n,)` is its
    agent's index, or -1.
    """

    parts: FloatArray
    weighted: FloatArray
    contact: FloatArray
    agent: IntArray

    @property
    def total(self) -> FloatArray:
        """The score (1) `(n,)`."""
        return np.asarray(self.weighted.sum(axis=0))


class EgoSize(NamedTuple):
    """The ego's length and width, and the distances from its rear axle to its centre and front,
    m.
    """

    length: float
    width: float
    center: float
    front: float


def scores(
    states: FloatArray, scene: Scene, near: IntArray, weights: tuple[float, float, float]
) -> Scores:
    """Score proposals: x, y, yaw, v, a, kappa of the rear axle `(n, 6, k)`, every 0.1 s from the
    scene's start.

    `near` are the indices of the agents to consider, `weights` those of progress, ttc and comfort.
    """
    agents, reference, car = scene.frame.agents, scene.reference, scene.vehicle
    line = reference.line
    body = EgoSize(car.length, car.width, car.axle_to_center, car.axle_to_front)
    off, beside, against, driven = _on_road(
        states, line.s, line.coef, reference.table, scene.s, body
    )
    drivable = (off - off[:, :1]).max(axis=1) <= OFF_M
    direction = 1.0 - 0.5 * (against > HALF_AGAINST_M) - 0.5 * (against > AGAINST_M)
    columns = (agents.x, agents.y, agents.yaw, agents.vx, agents.vy, agents.length, agents.width)
    moving, objects = np.array([column[near] for column in columns]), OBJECTS[agents.codes[near]]
    step, hit, collision, ttc = _meetings(states, moving, objects, beside | (off > 0.0), body)
    factor = collision * direction * drivable
    best = float((driven * factor).max())
    progress = (factor > 0.0).astype(float)
    if best > LEAST_WAY_M:
        progress = np.maximum(driven * factor, 0.0) / best
    terms = np.vstack([progress, ttc, comfortable(states)])
    parts = np.vstack([collision, direction, drivable, terms])
    weighted = factor * (np.array(weights)[:, None] / sum(weights)) * terms
    agent = np.where(step < 0, -1, near[hit]) if len(near) else hit
    return Scores(parts, weighted, np.where(step < 0, np.inf, STEP_S * step), agent)


@kernel
def _on_road(
    states: FloatArray,
    knots: FloatArray,
    coef: FloatArray,
    table: FloatArray,
    s_start: float,
    ego: EgoSize,
) -> tuple[FloatArray, BoolArray, FloatArray, FloatArray]:
    """Per proposal and step `(n, k)`: the distance off the road, m, and whether the ego is out of
    its lane.

    Per proposal `(n,)`: the longest way of the centre beside the lanes of its direction, and its
    way along the line, m.
    """
    count, steps = states.shape[0], states.shape[2]
    off, beside = np.zeros((count, steps)), np.zeros((count, steps), np.bool_)
    against, driven = np.zeros(count), np.zeros(count)
    stations, l = np.empty(CORNERS + 1), np.empty(CORNERS + 1)  # of corners and centre
    for n in range(count):
        s_first, s_center = 0.0, s_start + ego.center
        x_before, y_before = 0.0, 0.0
        stretch = 0.0
        for k in range(steps):
            yaw = states[n, YAW, k]
            x = states[n, X, k] + ego.center * cos(yaw)
            y = states[n, Y, k] + ego.center * sin(yaw)
            window = STEP_M if k > 0 else SEARCH_M
            s_center, l_center = line_project(knots, coef, x, y, s_center, window)
            _, _, yaw_r, kappa_r = line_frame(knots, coef, s_center)
            stations[CORNERS], l[CORNERS] = s_center, l_center
            _place_corners(stations, l, yaw - yaw_r, kappa_r, ego)
            road = sections(knots, table, stations)
            for j in range(CORNERS):
                off[n, k] = max(off[n, k], l[j] - road.facing_left[j], road.facing_right[j] - l[j])
                beside[n, k] |= l[j] > road.lane_left[j] or l[j] < road.lane_right[j]
            if k == 0:
                s_first = s_center
            elif road.road_right[CORNERS] <= l_center <= road.road_left[CORNERS]:
                stretch = 0.0
            else:
                stretch += hypot(x - x_before, y - y_before)
            against[n] = max(against[n], stretch)
            x_before, y_before = x, y
        driven[n] = s_center - s_first
    return off, beside, against, driven


@inner_kernel
def _place_corners(
    stations: FloatArray, l: FloatArray, turn: float, kappa: float, ego: EgoSize
) -> None:
    """Write the stations and offsets (2) of the corners before those of the centre `(5,)`.

    The ego is turned from the line by `turn`; the line has the curvature `kappa` at the centre.
    """
    cos_turn, sin_turn = cos(turn), sin(turn)
    for j in range(CORNERS):
        ahead = (0.5 if j < 2 else -0.5) * ego.length
        left = (0.5 if j % 2 else -0.5) * ego.width
        d = ahead * cos_turn - left * sin_turn
        stations[j] = stations[CORNERS] + d
        l[j] = l[CORNERS] + ahead * sin_turn + left * cos_turn - 0.5 * kappa * d * d  # (2)


class _ScoredAgent(NamedTuple):
    """An agent at the start: pose, velocity, length and width."""

    x: float
    y: float
    yaw: float
    vx: float
    vy: float
    length: float
    width: float


@kernel
def _meetings(
    states: FloatArray, moving: FloatArray, objects: BoolArray, astray: BoolArray, ego: EgoSize
) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    """Per proposal: step and agent of the first contact at fault (-1 without one), `collision` and
    `ttc` of (1).

    `moving` is x, y, yaw, vx, vy, length, width of the agents `(7, m)`; `astray` where the ego is
    out of its lane.
    """
    count = len(states)
    step, hit = np.full(count, -1), np.full(count, -1)
    collision, ttc = np.ones(count), np.ones(count)
    for n in range(count):
        for i in range(moving.shape[1]):
            x, y, yaw, vx, vy, length, width = moving[:, i]
            agent = _ScoredAgent(x, y, yaw, vx, vy, length, width)
            if _meets(states[n], 0, 0, agent, ego) != APART:
                continue
            k = _contact_at_fault(states[n], agent, objects[i], astray[n], ego)
            if k >= 0:
                collision[n] = min(collision[n], 0.5 if objects[i] else 0.0)
                if step[n] < 0 or k < step[n]:
                    step[n], hit[n] = k, i
            if ttc[n] > 0.0 and _comes_close(states[n], agent, ego):
                ttc[n] = 0.0
    return step, hit, collision, ttc


@inner_kernel
def _meets(states: FloatArray, k: int, ahead: int, other: _ScoredAgent, ego: EgoSize) -> int:
    """How the ego, extrapolated from step k by `ahead` steps, meets an agent: `APART`, `TOUCHES` or
    `TOUCHES_BEHIND`.
    """
    x, y, yaw = states[X, k], states[Y, k], states[YAW, k]
    cos_yaw, sin_yaw = cos(yaw), sin(yaw)
    t, moved = STEP_S * (k + ahead), STEP_S * ahead * states[SPEED, k]
    center_x, center_y = x + (ego.center + moved) * cos_yaw, y + (ego.center + moved) * sin_yaw
    px, py = other.x + t * other.vx, other.y + t * other.vy
    radii = 0.5 * (hypot(ego.length, ego.width) + hypot(other.length, other.width))
    if hypot(px - center_x, py - center_y) > radii:
        return APART
    if not overlap(
        center_x,
        center_y,
        yaw,
        ego.length,
        ego.width,
        px,
        py,
        other.yaw,
        other.length,
        other.width,
    ):
        return APART
    dx, dy = px - x - moved * cos_yaw, py - y - moved * sin_yaw
    return TOUCHES_BEHIND if dx * cos_yaw + dy * sin_yaw < BEHIND * hypot(dx, dy) else TOUCHES


@inner_kernel
def _contact_at_fault(
    states: FloatArray, other: _ScoredAgent, is_object: bool, astray: BoolArray, ego: EgoSize
) -> int:
    """The step of the first contact with an agent if it is the ego's fault; else -1.

    A standing ego is never at fault.
    """
    for k in range(1, states.shape[1]):
        meeting = _meets(states, k, 0, other, ego)
        if meeting == APART:
            continue
        if states[SPEED, k] <= STOPPED_MPS:
            return -1
        if is_object or hypot(other.vx, other.vy) <= STOPPED_MPS:
            return k
        yaw, t = states[YAW, k], STEP_S * k
        x, y = states[X, k] + ego.front * cos(yaw), states[Y, k] + ego.front * sin(yaw)
        px, py = other.x + t * other.vx, other.y + t * other.vy
        front = overlap(x, y, yaw, 0.0, ego.width, px, py, other.yaw, other.length, other.width)
        return k if meeting == TOUCHES and (front or astray[k]) else -1
    return -1


@inner_kernel
def _comes_close(states: FloatArray, other: _ScoredAgent, ego: EgoSize) -> bool:
    """Whether the first contact that `ttc` finds is with an agent that is not behind."""
    for k in range(states.shape[1]):
        for ahead in CARRIED:
            if states[SPEED, k] >= NO_TTC_MPS:
                meeting = _meets(states, k, ahead, other, ego)
                if meeting != APART:
                    return meeting == TOUCHES
    return False


def comfortable(states: FloatArray) -> BoolArray:
    """Whether each of the proposals `(n, 6, k)` is within the `COMFORT_BOUNDS`, `(n,)`."""
    _, _, yaw, v, a, kappa = states.transpose(1, 0, 2)
    filters = _comfort_filters(states.shape[2])
    lateral = v * v * kappa
    signals = {
        "lon_accel_mps2": a @ filters.over_all,
        "lat_accel_mps2": lateral @ filters.over_all,
        "jerk_mps3": np.hypot(a, lateral) @ filters.smooth @ filters.slope,
        "lon_jerk_mps3": a @ filters.smooth @ filters.slope,
        "yaw_accel_radps2": yaw @ filters.yaw_accel,
        "yaw_rate_radps": yaw @ filters.yaw_rate,
    }
    within = [
        ((signal > COMFORT_BOUNDS[name].low) & (signal < COMFORT_BOUNDS[name].high)).all(axis=1)
        for name, signal in signals.items()
    ]
    return np.all(within, axis=0)


class _ComfortFilters(NamedTuple):
    """Savitzky-Golay filters of nuPlan and PDM as matrices `(k, k)`, applied from the right.

    They smooth an acceleration, smooth it over the whole proposal, give its slope over the whole
    proposal, and give the first and second derivative of the yaw.
    """

    smooth: FloatArray
    over_all: FloatArray
    slope: FloatArray
    yaw_rate: FloatArray
    yaw_accel: FloatArray


@cache
def _comfort_filters(k: int) -> _ComfortFilters:
    # Imported here: it takes longer to import than all planners
    from scipy.signal import savgol_filter

    def matrix(window: int, degree: int, derivative: int) -> FloatArray:
        return frozen(
            savgol_filter(np.eye(k), min(window, k), degree, deriv=derivative, delta=STEP_S, axis=1)
        )

    return _ComfortFilters(
        smooth=matrix(window=8, degree=2, derivative=0),
        over_all=matrix(window=k, degree=2, derivative=0),
        slope=matrix(window=k, degree=2, derivative=1),
        yaw_rate=matrix(window=5, degree=2, derivative=1),
        yaw_accel=matrix(window=5, degree=3, derivative=2),
    )
