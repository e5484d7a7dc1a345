"""What a plan does, where it leads, and what it would do if it did not slow down.

With the time t from the frame and the arc length s along the plan's path, m, the plan is held from `t_b` on:

(1) t_b    = the first time at which the plan brakes by `BRAKES_MPS2` or more while it moves
(2) s_h(t) = s(t) for t <= t_b,  s(t_b) + v(t_b) (t - t_b) after it
(3) s_h(t) = v_0 t + t^2 START_MPS2 / 2 up to `START_TO_MPS`, then at that speed: of a plan that stands or crawls, as if
    it drove off now

A plan that stops has a path that ends before its reason to stop. The way goes on from there along the reference line of
the lane that the ego is in (the one nearest to the goal), at the lateral offset of the end of the path; it goes
straight on where the path ends farther than `LEFT_M` from that line, or across it.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
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

BRAKES_MPS2 = -0.3
"""A plan brakes where its acceleration is at most this: less is no discomfort (ISO 2631-1: below 0.315 m/s2)."""
STANDING_MPS = 0.1
CRAWL_MPS = 2.0
"""A plan that stays below this speed and neither speeds up nor brakes crawls: as fast as a pedestrian walks."""
START_MPS2, START_TO_MPS = 1.0, 5.0
"""How an ego that stands or crawls is assumed to drive off (3)."""
STEP_S = 0.1
LOOK_S = 12.0
"""The plan is held for this long: half as long again as the default horizon of predictions."""
EASE_MPS2 = 0.75
"""It is held at least for the distance of a stop with this deceleration: half of what planners use far ahead."""
SPACING_M = 0.5
"""Distance of two points of a way."""
LEFT_M, ACROSS_RAD = 5.0, radians(60.0)
"""A path has left a line if it ends farther from it, or at a larger angle to it."""
SAME_M = 1e-3
"""Points nearer than this are one."""


class Action(Enum):
    """What a plan does within the next second."""

    STANDS = "stands"
    CRAWLS = "crawls"
    SLOWS = "slows down"
    SPEEDS = "speeds up"
    HOLDS = "holds its speed"


@dataclass(frozen=True, slots=True)
class Course:
    """What a plan does; times are s from its frame, NaN if there is none.

    Attributes:
        action: What it does within the next second.
        v_start: Speed now, m/s; `v_end` at the end of the plan, `v_least` the lowest one.
        v_end: See there.
        v_least: See there.
        duration: Length of the plan, s.
        t_least: Time of the lowest speed.
        a_least: The hardest braking, m/s2.
        t_hardest: Time of the hardest braking.
        t_brakes: (1).
    """

    action: Action
    v_start: float
    v_end: float
    v_least: float
    duration: float
    t_least: float
    a_least: float
    t_hardest: float
    t_brakes: float

    @property
    def is_slow(self) -> bool:
        """Whether it stands or crawls."""
        return self.action in (Action.STANDS, Action.CRAWLS)

    @property
    def is_asked(self) -> bool:
        """Whether there is something to explain: it brakes at some time as it drives forward, or stands, or crawls."""
        return self.is_slow or bool(np.isfinite(self.t_brakes))

    @classmethod
    def of(cls, plan: Plan) -> Course:
        """The course of a plan."""
        path = plan.trajectory
        t = path.t - path.t[0]
        ahead = min(1.0, float(t[-1]))
        now, then = abs(float(path.v[0])), abs(float(np.interp(ahead, t, path.v)))
        accel = (then - now) / max(ahead, 1e-9)
        if max(now, then) < STANDING_MPS:
            action = Action.STANDS
        else:
            action = Action.SLOWS if accel < BRAKES_MPS2 else Action.SPEEDS if accel > -BRAKES_MPS2 else Action.HOLDS
        slowest, hardest = int(np.argmin(path.v)), int(np.argmin(path.a))
        braking = np.flatnonzero((path.a <= BRAKES_MPS2) & (path.v > STANDING_MPS))
        if action is Action.HOLDS and not len(braking) and path.v.min() >= 0.0 and path.v.max() < CRAWL_MPS:
            action = Action.CRAWLS
        return cls(
            action, float(path.v[0]), float(path.v[-1]), float(path.v[slowest]), float(t[-1]), float(t[slowest]),
            float(path.a[hardest]), float(t[hardest]), float(t[braking[0]]) if len(braking) else np.nan,
        )  # fmt: skip


@dataclass(frozen=True, eq=False, slots=True)
class Held:
    """A plan held (2), (3).

    Attributes:
        t: `(n,)` s from the frame, every `STEP_S` for `LOOK_S`.
        s: `(n,)` arc length, m; up to `t_from` that of the plan.
        planned: `(n,)` the plan's own arc length, m; after its end that of its end.
        t_from: t_b, s; 0 for a plan that stands or crawls.
        s_from: Arc length at `t_from`, m.
        v: The speed that is held, m/s; of a plan that stands or crawls, the speed that it would drive off to.
        drives_off: Whether it is (3).
    """

    t: FloatArray
    s: FloatArray
    planned: FloatArray
    t_from: float
    s_from: float
    v: float
    drives_off: bool

    @classmethod
    def of(cls, plan: Plan, course: Course) -> Held:
        """Hold a plan that brakes, stands or crawls."""
        path, t = plan.trajectory, STEP_S * np.arange(round(LOOK_S / STEP_S) + 1)
        own, sigma = path.t - path.t[0], arc_lengths(path.x, path.y)
        planned = np.interp(t, own, sigma)
        if course.is_slow:
            v0 = course.v_start if course.action is Action.CRAWLS else 0.0
            ramp = (START_TO_MPS - v0) / START_MPS2
            s = np.where(
                t < ramp, v0 * t + 0.5 * START_MPS2 * t**2, START_TO_MPS * t - 0.5 * START_MPS2 * ramp**2
            )  # (3)
            return cls(t, s, planned, 0.0, 0.0, START_TO_MPS, True)
        begin = course.t_brakes
        s_from, v = float(np.interp(begin, own, sigma)), max(float(np.interp(begin, own, path.v)), 0.0)
        s = np.where(t <= begin, planned, s_from + v * (t - begin))  # (2)
        return cls(t, s, planned, begin, s_from, v, False)

    def when(self, s: float) -> float:
        """When an arc length is reached, s from the frame; beyond `t` at the speed that is held."""
        return float(np.interp(s, self.s, self.t)) + max(s - float(self.s[-1]), 0.0) / max(self.v, STANDING_MPS)

    @property
    def reach(self) -> float:
        """How far ahead causes are looked for, m."""
        far = 0.0 if self.drives_off else self.s_from + 0.5 * self.v**2 / EASE_MPS2
        return max(float(self.s[-1]), far)

    def need(self, ahead: float) -> float:
        """The least constant deceleration to stop within `ahead` m of the plan's start, m/s2; NaN if it stands."""
        room = ahead - self.s_from
        return self.v**2 / (2.0 * room) if room > 0.0 and not self.drives_off else np.nan


def arc_lengths(x: FloatArray, y: FloatArray) -> FloatArray:
    """Arc length `(n,)` along points, m."""
    return np.r_[0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y)))]


def path_rows(path: Trajectory) -> FloatArray:
    """Rows s, x, y, yaw, kappa `(5, k)` of a plan's path, without repeated points."""
    s = arc_lengths(path.x, path.y)
    kept = np.r_[True, np.diff(np.floor(s / SAME_M)) > 0.0]
    rows: FloatArray = np.stack([s, path.x, path.y, path.yaw, path.kappa])[:, kept]
    return rows


@dataclass(frozen=True, eq=False, slots=True)
class Way:
    """Points every `SPACING_M` from the start of a plan, `(m,)` each, of the rear axle.

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
    """Makes the ways of the plans of one drive; it caches the reference lines of the scenario's lanes."""

    def __init__(self, scenario: Scenario) -> None:
        start = scenario.ego.state(0)
        self._lanes = LaneSequences(PlannerContext(scenario.road, scenario.goal, scenario.vehicle, 0.1, start))

    def of(self, plan: Plan, reach: float) -> Way:
        """The way of a plan, for `reach` m."""
        path = plan.trajectory
        first, last = path.state(0), path.state(len(path) - 1)
        lane = self._lanes.start(first).reference
        own = path_rows(path)
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


def _beyond(lane: ReferencePath, last: EgoState, near: float, length: float) -> FloatArray:
    """Rows s, x, y, yaw, kappa `(5, k)` after the end of a path, s from there; empty where it is long enough."""
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
