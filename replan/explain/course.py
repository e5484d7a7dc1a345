"""The action of a plan, its way, its motion if it did not slow down, and the agents that it would
meet then.

With the time t from the frame and the arc length s along the plan's path, m, the plan is held from
`t_b` on:

(1) t_b    = the first time at which the plan brakes by `BRAKES_MPS2` or more while it moves
(2) s_h(t) = s(t) for t <= t_b,  s(t_b) + v(t_b) (t - t_b) after it
(3) s_h(t) = v_0 t + t^2 START_MPS2 / 2 up to `START_TO_MPS`, then at that speed:
        for a plan that stands or crawls, as if it drove off now; likewise up to a speed that is
        wanted, for a plan that does not brake

A plan that stops has a path that ends before its reason to stop. The way goes on from there along
the reference line of the lane that the ego is in (the one nearest to the goal), at the lateral
offset of the end of the path; it goes straight on where the path ends farther than `LEFT_M` from
that line, or across it.

The agents' predicted boxes are swept along the way against the ego's. For each prediction (`sweep`
of `replan.planners.frenet.st_boundaries`, without any margin of time), [lower(t), upper(t)] are the
stations at which the ego's box, widened by `MARGIN_M` (`VULNERABLE_MARGIN_M` for pedestrians and
riders) on either side, overlaps the agent's. After the last prediction all agents go straight on.

(4) met at the first t with  lower(t) - GAP_M < s_h(t) < upper(t),  unless their centre is behind
                             the ego's then
(5) else, if they go along the way: followed from the first t with  s_h(t) > lower(t) - HEADWAY_S
    v_h
(6) need = the least constant deceleration from t_b on that stays GAP_M behind them
        at all times from (4) on:
    max over t of 2 (v_h T - room) / T^2, and v_h^2 / (2 room) where it stops before t;
        T = t - t_b,
    room = lower(t) - s(t_b) - GAP_M, half of lower(t) - s(t_b) where that is more
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from math import cos, hypot, inf, nan, radians, sin

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, arc_lengths, frozen
from replan.explain.occupancy import OccupiedStations, bodies, occupied
from replan.logs.agents import Agents
from replan.logs.frame import PlannerContext, Predictions
from replan.logs.plan import Plan
from replan.logs.reference_line import line_project_many
from replan.logs.scenario import Scenario
from replan.logs.shapes import distance
from replan.logs.states import Trajectory, wrap
from replan.logs.vehicle import VehicleParameters
from replan.planners.frenet.lane_sequences import LaneSequences
from replan.planners.frenet.scene import STANDING_MPS as AGENT_STANDS_MPS, VULNERABLE, Futures
from replan.planners.frenet.st_boundaries import ALONG
from replan.planners.frenet.sweep import Roles, SweptPath

BRAKES_MPS2 = -0.3
"""A plan brakes if its acceleration is at most this: weaker braking is comfortable (ISO 2631-1:
below 0.315 m/s2).
"""
STANDING_MPS = 0.1
CRAWL_MPS = 2.0
"""A plan that stays below this speed and neither speeds up nor brakes crawls: as fast as a
pedestrian walks.
"""
START_MPS2, START_TO_MPS = 1.0, 5.0
"""How an ego that stands or crawls is assumed to drive off (3)."""
STEP_S = 0.1
LOOK_S = 12.0
"""The plan is held for this long: half as long again as the default horizon of predictions."""
EASE_MPS2 = 0.75
"""The plan is held at least for the distance of a stop with this deceleration: half of that of
planners far ahead.
"""
SPACING_M = 0.5
"""Distance of two points of a way."""
LEFT_M, ACROSS_RAD = 5.0, radians(60.0)
"""A path has left a line if it ends farther from it, or at a larger angle to it."""
SAME_M = 1e-3
"""Points nearer to each other than this are merged."""


class PlanAction(Enum):
    """The actions of a plan within the next second."""

    STANDS = "stands"
    CRAWLS = "crawls"
    SLOWS = "slows down"
    SPEEDS = "speeds up"
    HOLDS = "holds its speed"


@dataclass(frozen=True, slots=True)
class Course:
    """The course of a plan; times are s from its frame, NaN if there is none.

    Attributes:
        action: The action within the next second.
        v_start, v_end, v_least: Speed now, at the end of the plan, and the lowest one, m/s.
        duration: Length of the plan, s.
        t_least: Time of the lowest speed.
        a_least: The hardest braking, m/s2.
        t_hardest: Time of the hardest braking.
        t_brakes: The time t_b of (1).
    """

    action: PlanAction
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
        return self.action in (PlanAction.STANDS, PlanAction.CRAWLS)

    @property
    def is_asked(self) -> bool:
        """Whether there is something to explain: it brakes at some time as it drives forward, or
        stands, or crawls.
        """
        return self.is_slow or bool(np.isfinite(self.t_brakes))

    @classmethod
    def of(cls, plan: Plan) -> Course:
        """The course of a plan."""
        path = plan.trajectory
        t = path.t - path.t[0]
        ahead = min(1.0, float(t[-1]))
        v_now, v_ahead = abs(float(path.v[0])), abs(float(np.interp(ahead, t, path.v)))
        accel = (v_ahead - v_now) / max(ahead, 1e-9)
        if max(v_now, v_ahead) < STANDING_MPS:
            action = PlanAction.STANDS
        else:
            action = PlanAction.SPEEDS if accel > -BRAKES_MPS2 else PlanAction.HOLDS
            if accel < BRAKES_MPS2:
                action = PlanAction.SLOWS
        slowest, hardest = int(np.argmin(path.v)), int(np.argmin(path.a))
        braking = np.flatnonzero((path.a <= BRAKES_MPS2) & (path.v > STANDING_MPS))
        if (
            action is PlanAction.HOLDS
            and not len(braking)
            and path.v.min() >= 0.0
            and path.v.max() < CRAWL_MPS
        ):
            action = PlanAction.CRAWLS
        return cls(
            action,
            float(path.v[0]),
            float(path.v[-1]),
            float(path.v[slowest]),
            float(t[-1]),
            float(t[slowest]),
            float(path.a[hardest]),
            float(t[hardest]),
            float(t[braking[0]]) if len(braking) else np.nan,
        )


@dataclass(frozen=True, eq=False, slots=True)
class Held:
    """A plan that is held, (2) or (3).

    Attributes:
        t: `(n,)` s from the frame, every `STEP_S` for `LOOK_S`.
        s: `(n,)` arc length, m; up to `t_from` it is `planned`.
        planned: `(n,)` the plan's own arc length, m; after its end, that of its last point.
        t_from: t_b, s; 0 for a plan that stands or crawls.
        s_from: Arc length at `t_from`, m.
        v: The speed that is held, m/s; with (3) the speed that it would reach.
        drives_off: Whether (3) applies.
    """

    t: FloatArray
    s: FloatArray
    planned: FloatArray
    t_from: float
    s_from: float
    v: float
    drives_off: bool

    @classmethod
    def of(cls, plan: Plan, course: Course, wanted: float = nan) -> Held:
        """Hold a plan that brakes, stands or crawls, or is slower than a wanted speed, m/s."""
        path, t = plan.trajectory, STEP_S * np.arange(round(LOOK_S / STEP_S) + 1)
        own, sigma = path.t - path.t[0], arc_lengths(path.x, path.y)
        planned = np.interp(t, own, sigma)
        if course.is_slow or (np.isfinite(wanted) and np.isnan(course.t_brakes)):
            v0, to = (
                0.0 if course.action is PlanAction.STANDS else course.v_start,
                float(np.fmax(START_TO_MPS, wanted)),
            )
            ramp = max((to - v0) / START_MPS2, 0.0)
            # (3)
            s = np.where(
                t < ramp, v0 * t + 0.5 * START_MPS2 * t**2, to * t - 0.5 * START_MPS2 * ramp**2
            )
            return cls(t, s, planned, 0.0, 0.0, to, True)
        begin = course.t_brakes
        s_from, v = (
            float(np.interp(begin, own, sigma)),
            max(float(np.interp(begin, own, path.v)), 0.0),
        )
        s = np.where(t <= begin, planned, s_from + v * (t - begin))  # (2)
        return cls(t, s, planned, begin, s_from, v, False)

    def when(self, s: float) -> float:
        """The time at which an arc length is reached, s from the frame.

        Beyond `t`, at the speed that is held.
        """
        return float(np.interp(s, self.s, self.t)) + max(s - float(self.s[-1]), 0.0) / max(
            self.v, STANDING_MPS
        )

    @property
    def is_start(self) -> bool:
        """Whether it drives off without a wanted speed: then limits, curves and followed agents are
        no reasons.
        """
        return self.drives_off and self.v <= START_TO_MPS

    @property
    def reach(self) -> float:
        """The distance ahead within which causes are searched, m."""
        far = 0.0 if self.drives_off else self.s_from + 0.5 * self.v**2 / EASE_MPS2
        return max(float(self.s[-1]), far)

    def need(self, ahead: float) -> float:
        """The least constant deceleration to stop within `ahead` m of the plan's start, m/s2; NaN
        if it stands.
        """
        room = ahead - self.s_from
        return self.v**2 / (2.0 * room) if room > 0.0 and not self.drives_off else np.nan


def path_rows(path: Trajectory) -> FloatArray:
    """Rows s, x, y, yaw, kappa `(5, k)` of a plan's path, without repeated points."""
    s = arc_lengths(path.x, path.y)
    is_new = np.r_[True, np.diff(np.floor(s / SAME_M)) > 0.0]
    rows: FloatArray = np.stack([s, path.x, path.y, path.yaw, path.kappa])[:, is_new]
    return rows


@dataclass(frozen=True, eq=False, slots=True)
class PlanWay:
    """Points every `SPACING_M` from the start of a plan, `(m,)` each, of the rear axle.

    Attributes:
        s: Arc length, m.
        x, y: World, m.
        yaw: Without jumps, rad.
        kappa: 1/m.
        limit: Speed limit of the lane that the ego is in, m/s; NaN where the way is not near its
            reference line.
        end: Arc length at which the map of that lane ends, m; inf if it is beyond the way.
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

    @property
    def swept(self) -> SweptPath:
        """The way as the path of a sweep."""
        return SweptPath(self.s, self.x, self.y, self.yaw)

    def crossing(self, points: FloatArray, front: float) -> float:
        """The arc length at which a point `front` m ahead of the rear axle crosses a line between
        two points `(2, 2)`, m; inf if it does not.
        """
        x, y = self.x + front * np.cos(self.yaw), self.y + front * np.sin(self.yaw)
        (ax, ay), (bx, by) = points
        # The side of the line on which the ego's front is
        side = (bx - ax) * (y - ay) - (by - ay) * (x - ax)
        i = np.flatnonzero((side[:-1] * side[1:] <= 0.0) & (side[:-1] != side[1:]))
        u = side[i] / (side[i] - side[i + 1])
        px, py = x[i] + u * (x[i + 1] - x[i]), y[i] + u * (y[i + 1] - y[i])
        length2 = (bx - ax) ** 2 + (by - ay) ** 2
        share = ((px - ax) * (bx - ax) + (py - ay) * (by - ay)) / length2
        stations = self.s[i] + u * (self.s[i + 1] - self.s[i])
        return float(min(stations[(share >= 0.0) & (share <= 1.0)], default=np.inf))

    def pose(self, s: float) -> tuple[float, float, float]:
        """x, y, yaw at an arc length."""
        return tuple(float(np.interp(s, self.s, column)) for column in (self.x, self.y, self.yaw))  # type: ignore[return-value]


class Ways:
    """Makes the ways of the plans of one drive.

    It caches the reference lines of the scenario's lanes.
    """

    def __init__(self, scenario: Scenario) -> None:
        start = scenario.ego.state(0)
        self._lanes = LaneSequences(
            PlannerContext(scenario.road, scenario.goal, scenario.vehicle, 0.1, start)
        )

    def of(self, plan: Plan, reach: float) -> PlanWay:
        """The way of a plan, for `reach` m."""
        path = plan.trajectory
        first, last = path.state(0), path.state(len(path) - 1)
        lane = self._lanes.start(first).reference
        own = path_rows(path)
        near = lane.line.project(first.x, first.y)[0]
        length = reach - float(own[0, -1])  # of the way beyond the path
        d = (
            np.arange(SPACING_M, length + 2.0 * SPACING_M, SPACING_M)
            if length > 0.0
            else np.empty(0)
        )
        s, l = lane.line.project(last.x, last.y, near + float(own[0, -1]), 50.0)
        yaw = lane.line.frame(s)[2]
        if abs(l) > LEFT_M or abs(wrap(last.yaw - yaw)) > ACROSS_RAD:  # straight on
            c, sn = np.cos(last.yaw), np.sin(last.yaw)
            beyond = np.stack(
                [d, last.x + d * c, last.y + d * sn, np.full(len(d), last.yaw), np.zeros(len(d))]
            )
        else:
            turn = last.yaw - wrap(last.yaw - yaw) - yaw
            frames = np.array([lane.line.frame(s + each) for each in d]).reshape(-1, 4)
            line_x, line_y, line_yaw, line_kappa = frames.T
            x, y = line_x - l * np.sin(line_yaw), line_y + l * np.cos(line_yaw)
            along = np.hypot(np.diff(np.r_[last.x, x]), np.diff(np.r_[last.y, y])).cumsum()
            kappa = line_kappa / np.maximum(1.0 - line_kappa * l, 0.1)
            beyond = np.stack([along, x, y, line_yaw + turn, kappa])
        rows = np.hstack([own, beyond + np.array([[own[0, -1]], [0.0], [0.0], [0.0], [0.0]])])
        rows[3] = np.unwrap(rows[3])
        stations = np.arange(0.0, max(reach, float(own[0, -1])) + SPACING_M, SPACING_M)
        x, y, yaws, kappa = (np.interp(stations, rows[0], row) for row in rows[1:])
        placed = line_project_many(lane.line.s, lane.line.coef, x, y, near, 30.0)
        limit = np.interp(placed[:, 0], lane.line.s, lane.limit)
        out = np.flatnonzero(
            (placed[:, 0] >= lane.line.length - SAME_M) & (np.abs(placed[:, 1]) <= LEFT_M)
        )
        end = float(stations[out[0]]) if len(out) else inf
        return PlanWay(
            stations,
            x,
            y,
            yaws,
            kappa,
            np.where(np.abs(placed[:, 1]) <= LEFT_M, limit, np.nan),
            end,
            lane.lanes,
        )


MARGIN_M, VULNERABLE_MARGIN_M = 0.3, 0.6
GAP_M = 2.0
"""An ego that comes nearer than this behind an agent has met them: the gap at standstill (IDM's
s0).
"""
HEADWAY_S = 2.0
"""Least time headway of a follower: the two-second rule."""
TOO_LATE_M = 0.1
"""With less space than this the ego cannot stay behind."""


@dataclass(frozen=True, slots=True)
class Meeting:
    """An agent in the way of a plan that is held.

    Attributes:
        away_m: Distance between the boxes now, m.
        time_s: Time of (4) or (5), s from the frame; NaN if neither occurs, and the agent is only
            in the way.
        distance_m: Distance that the ego would have driven until then, m.
        need_mps2: (6); NaN if the ego stands or crawls, for (5), and if it is too late to stay
            behind.
        left_m: The least gap of the plan itself behind them, m; NaN if it is not behind them.
        left_at_s: Time of the least gap, s from the frame.
        is_met: Whether (4) occurs.
    """

    agent: str
    away_m: float
    time_s: float
    distance_m: float
    need_mps2: float
    left_m: float
    left_at_s: float
    is_met: bool


def meetings(
    held: Held,
    way: PlanWay,
    agents: Agents,
    futures: Predictions,
    car: VehicleParameters,
    passed: BoolArray,
) -> list[Meeting]:
    """One meeting for each agent that occupies a part of the way: the one of its most demanding
    prediction.

    The way is long enough for the plan; agents that are `passed` `(agents,)` have no margin.
    """
    times, poses = fine(futures)
    no_one = np.zeros(len(agents), np.bool_)
    occupied_parts = occupied(
        way.swept,
        Futures(frozen(times), futures.agent, futures.probability, *map(frozen, poses)),
        bodies(agents),
        car,
        (MARGIN_M, VULNERABLE_MARGIN_M, 0.0),
        Roles(no_one, VULNERABLE[agents.codes], passed),
    )
    meetings_of: dict[int, Meeting] = {}
    for taken in occupied_parts:
        agent = taken.agent
        meeting = _meeting(held, way, agents, taken, poses[:, taken.prediction], car)
        if meeting is not None and (
            agent not in meetings_of or _order(meeting) < _order(meetings_of[agent])
        ):
            meetings_of[agent] = meeting
    return list(meetings_of.values())


def fine(futures: Predictions) -> tuple[FloatArray, FloatArray]:
    """Times `(k,)` for `LOOK_S`, s, and the poses x, y, yaw `(3, n, k)` there: linear in between,
    straight on after.
    """
    t = futures.t
    times = t[0] + STEP_S * np.arange(round(LOOK_S / STEP_S) + 1)
    poses = np.stack([futures.x, futures.y, np.unwrap(futures.yaw, axis=1)])
    if len(t) == 1:
        return times, np.repeat(poses, len(times), axis=2)
    i = np.clip(np.searchsorted(t, times + 1e-9, side="right") - 1, 0, len(t) - 2)
    u = (times - t[i]) / (t[i + 1] - t[i])
    turn = np.minimum(u, 1.0)
    weight = np.stack([u, u, turn])[:, None]
    return times, np.ascontiguousarray(
        poses[:, :, i] * (1.0 - weight) + poses[:, :, i + 1] * weight
    )


def _order(one: Meeting) -> tuple[bool, bool, float, float]:
    """Sort key, the most demanding first: met too late, met by need, met sooner.

    Then followed too near.
    """
    late = one.is_met and np.isnan(one.need_mps2)
    return (
        not one.is_met,
        not late,
        -np.nan_to_num(one.need_mps2),
        float(np.nan_to_num(one.time_s, nan=np.inf)),
    )


def _meeting(
    held: Held,
    way: PlanWay,
    agents: Agents,
    taken: OccupiedStations,
    pose: FloatArray,
    car: VehicleParameters,
) -> Meeting | None:
    """The meeting with an agent whose predicted poses are rows x, y, yaw `(3, k)`; None if they
    come only from behind.
    """
    on_path, lower, upper = np.isfinite(taken.lower), taken.lower, taken.upper
    first = int(np.flatnonzero(on_path)[0])
    if _is_behind(way, held.s[first], pose[:, first], car):
        return None
    row, (x, y, yaw) = taken.agent, pose[:, 0]
    ex, ey, eyaw = _center(way, 0.0, car)
    distance_m = distance(
        ex, ey, eyaw, car.length, car.width, x, y, yaw, agents.length[row], agents.width[row]
    )
    speed = float(hypot(agents.vx[row], agents.vy[row]))
    with np.errstate(invalid="ignore"):
        met = np.flatnonzero(on_path & (held.s > lower - GAP_M) & (held.s < upper))  # (4)
        # (5)
        close = np.flatnonzero(on_path & (held.s > lower - HEADWAY_S * held.v) & (held.s < upper))
        left = np.where(held.planned <= lower, lower - held.planned, np.nan)
    follows = taken.along > ALONG * speed and speed > AGENT_STANDS_MPS and not held.is_start
    k = int(close[0]) if len(close) and follows else -1
    if len(met):
        k = int(met[0])
    if len(met) and _is_behind(way, held.s[k], pose[:, k], car):
        return None
    need = nan
    later = np.flatnonzero(on_path & (np.arange(len(lower)) >= k) & (held.t > held.t_from))
    if len(met) and len(later) and not held.drives_off:  # (6)
        ahead, T = lower[later] - held.s_from, held.t[later] - held.t_from
        # Half of the distance if the ego is nearer already
        room = np.maximum(ahead - GAP_M, 0.5 * ahead)
        if not (room < TOO_LATE_M).any():
            slower = 2.0 * np.maximum(held.v * T - room, 0.0) / T**2
            stops = slower * T > held.v
            need = float(np.where(stops, held.v**2 / (2.0 * room), slower).max())
    least = int(np.nanargmin(left)) if np.isfinite(left).any() else -1
    return Meeting(
        agents.ids[row],
        float(distance_m),
        float(held.t[k]) if k >= 0 else nan,
        float(held.s[k]) if k >= 0 else nan,
        need,
        float(left[least]) if least >= 0 else nan,
        float(held.t[least]) if least >= 0 else nan,
        len(met) > 0,
    )


def _is_behind(way: PlanWay, s: float, pose: FloatArray, car: VehicleParameters) -> bool:
    """Whether an agent's centre is behind that of the ego at a station."""
    x, y, yaw = _center(way, s, car)
    return bool((pose[0] - x) * cos(yaw) + (pose[1] - y) * sin(yaw) < 0.0)


def _center(way: PlanWay, s: float, car: VehicleParameters) -> tuple[float, float, float]:
    """The ego's box at a station: centre and heading."""
    x, y, yaw = way.pose(s)
    return x + car.axle_to_center * cos(yaw), y + car.axle_to_center * sin(yaw), yaw
