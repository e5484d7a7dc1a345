"""Where a plan leads: its own path, and how the road goes on from its end.

A plan that stops has a path that ends before whatever it stops for. The road goes on from there along the reference
line of the lane that the ego is in (the one nearest to the goal), at the offset at which the path ends; where the path
ends farther than `LEFT_M` from that line, or across it, straight on.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, radians

import numpy as np

from logs.frame import PlannerContext
from logs.kernel import FloatArray
from logs.road import line_project_many
from logs.scenario import Scenario
from logs.states import EgoState, Trajectory, wrap
from logs.trace import Plan
from planners.frenet.lane_sequence import LaneSequences
from planners.frenet.reference_path import ReferencePath
from replay.explain.course import arc_lengths

SPACING_M = 0.5
"""Between two points of a way."""
LEFT_M, ACROSS_RAD = 5.0, radians(60.0)
"""Whose path ends farther from the line, or more across it, has left it."""
SAME_M = 1e-3
"""Points nearer than this are one."""


@dataclass(frozen=True, eq=False, slots=True)
class Way:
    """Points every `SPACING_M` from where a plan begins, `(m,)` each, at the rear axle.

    Attributes:
        s: Arc length, m.
        x: World, m; `y` likewise; `yaw` rad, without jumps; `kappa` 1/m.
        y: See there.
        yaw: See there.
        kappa: See there.
        limit: Speed limit of the lane that the ego is in, m/s; NaN where the way is not near its line.
        end: Arc length at which the map of that lane ends, m; inf: beyond the way.
        lanes: The lanes of that line.
    """

    s: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    kappa: FloatArray
    limit: FloatArray
    end: float
    lanes: tuple[int, ...]

    def pose(self, s: float) -> tuple[float, float, float]:
        """x, y, yaw at an arc length."""
        return tuple(float(np.interp(s, self.s, column)) for column in (self.x, self.y, self.yaw))  # type: ignore[return-value]


class Ways:
    """Makes the ways of one drive; what it keeps are the reference lines of the scenario's lanes."""

    def __init__(self, scenario: Scenario) -> None:
        start = scenario.ego.state(0)
        self._lanes = LaneSequences(PlannerContext(scenario.road, scenario.goal, scenario.vehicle, 0.1, start))

    def of(self, plan: Plan, reach: float) -> Way:
        """The way of a plan, for `reach` m."""
        path, lane = plan.trajectory, None
        first, last = path.state(0), path.state(len(path) - 1)
        lane = self._lanes.start(first).reference
        own = _thinned(path)
        near = lane.line.project(first.x, first.y)[0]
        beyond = _beyond(lane, last, near + float(own[0, -1]), reach - float(own[0, -1]))
        rows = np.hstack([own, beyond + np.array([[own[0, -1]], [0.0], [0.0], [0.0], [0.0]])])
        rows[3] = np.unwrap(rows[3])
        s = np.arange(0.0, max(reach, float(own[0, -1])) + SPACING_M, SPACING_M)
        x, y, yaw, kappa = (np.interp(s, rows[0], row) for row in rows[1:])
        placed = line_project_many(lane.line.s, lane.line.coef, x, y, near, 30.0)
        limit = np.interp(placed[:, 0], lane.line.s, lane.limit)
        out = np.flatnonzero((placed[:, 0] >= lane.line.length - SAME_M) & (np.abs(placed[:, 1]) <= LEFT_M))
        end = float(s[out[0]]) if len(out) else inf
        return Way(s, x, y, yaw, kappa, np.where(np.abs(placed[:, 1]) <= LEFT_M, limit, np.nan), end, lane.lanes)


def _thinned(path: Trajectory) -> FloatArray:
    """Rows s, x, y, yaw, kappa `(5, k)` of a plan's path, without points that are the same."""
    s = arc_lengths(path.x, path.y)
    kept = np.r_[True, np.diff(np.floor(s / SAME_M)) > 0.0]
    rows: FloatArray = np.stack([s, path.x, path.y, path.yaw, path.kappa])[:, kept]
    return rows


def _beyond(lane: ReferencePath, last: EgoState, near: float, length: float) -> FloatArray:
    """Rows s, x, y, yaw, kappa `(5, k)` from the end of a path on, s from there; empty where it is long enough."""
    d = np.arange(SPACING_M, length + 2.0 * SPACING_M, SPACING_M) if length > 0.0 else np.empty(0)
    s, l = lane.line.project(last.x, last.y, near, 50.0)  # noqa: E741
    yaw = lane.line.frame(s)[2]
    if abs(l) > LEFT_M or abs(wrap(last.yaw - yaw)) > ACROSS_RAD:
        c, sn = np.cos(last.yaw), np.sin(last.yaw)
        return np.stack([d, last.x + d * c, last.y + d * sn, np.full(len(d), last.yaw), np.zeros(len(d))])
    turn = last.yaw - wrap(last.yaw - yaw) - yaw
    frames = np.array([lane.line.frame(s + each) for each in d]).reshape(-1, 4)
    x, y = frames[:, 0] - l * np.sin(frames[:, 2]), frames[:, 1] + l * np.cos(frames[:, 2])
    along = np.hypot(np.diff(np.r_[last.x, x]), np.diff(np.r_[last.y, y])).cumsum()
    return np.stack([along, x, y, frames[:, 2] + turn, frames[:, 3] / np.maximum(1.0 - frames[:, 3] * l, 0.1)])
