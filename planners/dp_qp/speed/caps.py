"""Speed caps: every reason to drive slower than the road allows is a stretch of the path with a
speed.

(1) limit(sigma) = min(road(sigma), v of the caps with s_from < sigma <= s_to)
(2) The profile keeps a cap that is a bound exactly; it may exceed other limits by a little
    (`speed.problem`).

A producer is a function `caps(view: PathView) -> tuple[SpeedCap, ...]`; a new one is one line in
`OWN` or `OTHERS`.

Most producers compute how fast the ego may pass an agent that may come into its way with the speed
w (`CautionConfig`: UN R157 requires that pedestrians of up to 5 km/h are avoided) from d m beside
its side, which takes d / w. The ego with its front x before the agent passes first, or it stops:

(3) x / v <= d / w                        (4) v T + v^2 / (2 b) <= x
        T: reaction, b: deceleration

There is an x at which it can do neither if the greatest x of (3) is less than the least of (4), so
that

(5) v <= max(2 b (d / w - T), `LEAST_MPS`)

keeps the ego safe at any x; at `LEAST_MPS` it creeps past in any case. The cap applies while the
front is beside the agent; before that, the limit is lowered so that the ego reaches the cap
comfortably (`profiles.limit_profile`). It applies to agents that move along the lane (from the
stopping distance before them), to pedestrians and riders who came to the path and stand beside it
now, and to people who may step out of hidden ground: ground in the shadow of slow or standing
agents, but not where an agent is. There d is less by the radius of a person. Hidden ground is that
of the present frame; as the ego comes nearer, more is visible and the limit rises. Beyond the
sensor's range nothing is visible: there (4) alone limits the speed, with the range as x.

(6) v <= v_limit max(d / `ROOM_M`, `NUDGE_SHARE`)
        beside standing agents, where the path leaves less than `ROOM_M` (the share is Apollo's
        `static_obs_nudge_speed_ratio`)
(7) v <= sqrt(`SWERVE_MPS2` / |kappa - kappa_r|)
        where the path swerves from the reference line to pass agents that the ego could follow
        instead
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, pi, sqrt
from typing import NamedTuple

import numpy as np

from replan.core.arrays import TIE, BoolArray, FloatArray
from replan.core.kernel import kernel
from replan.core.settings import Config, NotNegative, Positive
from replan.logs.agents import AgentKind, Agents
from replan.logs.frame import Visibility
from replan.logs.plan import Decision, DecisionKind
from replan.logs.vehicle import VehicleParameters
from replan.planners.dp_qp.goal_window import GoalWindow, SpeedTarget
from replan.planners.dp_qp.path.passing import NEAR_M, PassTarget
from replan.planners.frenet.path import Path
from replan.planners.frenet.scene import Occupancy, Scene, open_end
from replan.planners.frenet.st_boundaries import StBoundaries
from replan.planners.rules.zone_times import TOWARDS_MPS

WORTH_MPS = 0.5  # A cap is reported as a decision where it lowers the limit by more than this, m/s
# T, s, until the ego brakes: a frame, the sensor's latency, the brake's dead time and lag
REACTION_S = 0.5
LEAST_MPS = 2.5  # Least cap (5), at which the ego creeps past, m/s
PERSON_M = 0.3  # Radius of a person who steps out of hidden ground, m
# Distance ahead within which hidden ground and people beside the path are considered, m ...
LOOK_M = 60.0
STEP_M = 1.0  # ... in steps of this, m.
SIDE_M = 0.25 * np.arange(1, 15)
"""Distances from the ego's side at which ground is tested, m.

Ground beyond the last does not limit a car's speed.
"""
ROOM_M = 0.5  # Space beside standing agents with which the ego passes at the speed limit (6), m
NUDGE_SHARE = 0.6  # Least share of the speed limit in (6)
SWERVE_MPS2 = 1.6  # Lateral acceleration of a swerve (7), m/s2


@dataclass(frozen=True)
class CautionConfig(Config):
    """How the ego prepares for road users who may come into its way."""

    walk_mps: Positive = 5.0 / 3.6
    """Speed of a person who steps out or sets off: 5 km/h, up to which UN R157 requires to avoid
    them.
    """
    ride_mps: Positive = 0.8
    """Lateral speed of a rider along the lane who swerves into the way."""
    hesitates_s: NotNegative = 5.0
    """Time for which a person who came to the path and stands beside it may set off again."""


@dataclass(frozen=True, slots=True)
class SpeedCap:
    """A reason to drive slower."""

    s_from: float  # Arc length of the rear axle from which it applies, m; `s_to` to which
    s_to: float
    v: float  # The speed, m/s
    # Its cause, as the report names it (an agent, "hidden ground"); empty: it is not reported
    agent: str = ""
    reason: str = ""
    is_bound: bool = True  # Whether the profile keeps the speed exactly (2)


@dataclass(frozen=True, eq=False, slots=True)
class SpeedTask:
    """The input of the speed stage on a path."""

    # The space between the path and each standing agent that it passes, m
    passed: Mapping[str, float]
    skip: BoolArray  # Which agents follow the ego `(agents,)`
    stops: tuple[Occupancy, ...]  # The stops that the rules demand on the path
    # Agents along the lane that the ego comes beside; `is_pass`: whether the path swings out for
    # them
    targets: tuple[PassTarget, ...]
    is_pass: bool
    goal: GoalWindow  # The goal along the lane; `target`: its demands now
    target: SpeedTarget


@dataclass(frozen=True, eq=False, slots=True)
class PathView:
    """A scene on the chosen path: the input of the producers of caps."""

    scene: Scene
    path: Path
    task: SpeedTask  # The agents that it passes, the stops and the goal
    limit: FloatArray  # The road's speed limit along it `(m,)`, m/s
    taken: StBoundaries  # When which part of it is taken, and by which agent
    came: Mapping[str, float]  # When each pedestrian or rider was last in the path, s
    # Deceleration with which the ego must be able to stop for a person who steps out (b)
    hard_mps2: float
    margin_m: float  # The ego follows an agent that the path comes nearer to than this
    caution: CautionConfig

    def arc(self, s: float) -> float:
        """The arc length at a station of the reference path, m.

        Extrapolated beyond the path's ends.
        """
        stations, sigma = self.path.s, self.path.sigma
        return (
            float(np.interp(s, stations, sigma))
            + min(s - float(stations[0]), 0.0)
            + max(s - float(stations[-1]), 0.0)
        )


@dataclass(frozen=True, eq=False, slots=True)
class LoweredLimit:
    """A speed limit along a path `(m,)`, m/s, where the profile keeps it exactly `(m,)`, and the
    decisions.
    """

    v: FloatArray
    is_bound: BoolArray
    decisions: tuple[Decision, ...] = ()


def lower_limit(sigma: FloatArray, road: LoweredLimit, caps: Sequence[SpeedCap]) -> LoweredLimit:
    """The limit (1) along a path `(m,)`.

    A decision for each agent whose cap lowers it noticeably, by the lowest.
    """
    if not caps:
        return road
    v, bound = road.v.copy(), road.is_bound.copy()
    reported: dict[str, SpeedCap] = {}
    for cap in caps:
        begin, end = np.searchsorted(sigma, (cap.s_from, cap.s_to), side="right")
        section = slice(int(begin), int(end))
        less, same = cap.v < v[section], cap.v == v[section]
        bound[section] = np.where(less, cap.is_bound, bound[section] | (same & cap.is_bound))  # (2)
        v[section] = np.where(less, cap.v, v[section])  # (1)
        if cap.agent and (cap.v < road.v[section] - WORTH_MPS).any():
            reported[cap.agent] = min(reported.get(cap.agent, cap), cap, key=lambda each: each.v)
    decisions = (
        Decision(cap.agent, DecisionKind.YIELD, "speed", cap.reason) for cap in reported.values()
    )
    return LoweredLimit(v, bound, (*road.decisions, *decisions))


def avoidable_speed(d: float, w: float, decel: float) -> float:
    """(5): the speed, m/s, at which the ego passes first or stops for an agent from `d` m aside at
    `w` m/s.
    """
    return max(2.0 * decel * (d / w - REACTION_S), LEAST_MPS)  # (5)


def stopping_speed(x: float, decel: float) -> float:
    """The speed for which (4) needs exactly `x` m, m/s."""
    return decel * (sqrt(REACTION_S**2 + 2.0 * x / decel) - REACTION_S) if x < inf else inf  # (4)


def goal_and_rules_caps(view: PathView) -> tuple[SpeedCap, ...]:
    """Caps that keep the goal's time, the speed in its region (`goal_window`) and the first open
    stop.
    """
    target, caps = view.task.target, []
    if target.cap < inf:
        caps.append(SpeedCap(-inf, view.arc(target.until), target.cap, is_bound=False))
    if target.stop < inf:
        caps.append(SpeedCap(view.arc(target.stop), inf, 0.0, is_bound=False))
    slow = view.task.goal.slow_zone
    if slow is not None:
        begin, end, v = slow
        caps.append(SpeedCap(view.arc(begin), view.arc(end), v, is_bound=False))
    begin = open_end(view.task.stops) if view.task.stops else inf
    if begin < inf:
        caps.append(SpeedCap(begin - TIE, inf, 0.0, is_bound=False))
    return tuple(caps)


def passing_caps(view: PathView) -> tuple[SpeedCap, ...]:
    """(6) beside standing agents that are passed, (5) beside agents that go along the lane.

    An agent along the lane that is nearer to the path than the margin has no cap: the ego follows
    it, by the S-T graph.
    """
    scene, path = view.scene, view.path
    agents, caps = view.scene.frame.agents, []
    for name, d in view.task.passed.items():
        if d < ROOM_M:
            i = agents.ids.index(name)
            s, half = float(scene.agents.s[i]), 0.5 * float(agents.length[i])
            begin, end = (
                s - half - scene.vehicle.axle_to_front,
                s + half + scene.vehicle.rear_overhang,
            )
            v = max(d / ROOM_M, NUDGE_SHARE) * float(np.interp(s, path.s, view.limit))  # (6)
            reason = f"stands {d:.2f} m beside the path: passed at {v:.1f} m/s"
            caps.append(SpeedCap(view.arc(begin), view.arc(end), v, name, reason))
    for target in view.task.targets:
        beside = (path.s > target.begin - NEAR_M) & (path.s < target.end + NEAR_M)
        if not beside.any():
            continue
        away = np.hypot(
            path.x[beside, None] - target.places[:, 0], path.y[beside, None] - target.places[:, 1]
        )
        d = float(away.min()) - 0.5 * float(scene.vehicle.width + agents.width[target.agent])
        if d < view.margin_m:
            continue
        is_rider = agents.kinds[target.agent] is AgentKind.BICYCLE
        v = avoidable_speed(
            d, view.caution.ride_mps if is_rider else view.caution.walk_mps, view.hard_mps2
        )
        begin = view.arc(target.begin - (v * REACTION_S + v * v / (2.0 * view.hard_mps2)))
        reason = (
            f"goes along the lane: passed with {d:.1f} m and at {v:.1f} m/s, so that the ego "
            "could stop for them"
        )
        caps.append(
            SpeedCap(begin, view.arc(target.end + NEAR_M), v, agents.ids[target.agent], reason)
        )
    return tuple(caps)


def swerve_caps(view: PathView) -> tuple[SpeedCap, ...]:
    """(7) at each point of a path that passes an agent that moves, where it is below the road's
    limit.
    """
    if not view.task.is_pass:
        return ()
    path, line = view.path, view.scene.reference.line
    swerved = np.abs(path.kappa - np.interp(path.s, line.s, line.kappa))
    v = np.sqrt(SWERVE_MPS2 / np.maximum(swerved, 1e-6))  # (7)
    begins = np.r_[-np.inf, path.sigma[:-1]]
    return tuple(
        SpeedCap(float(begins[i]), float(path.sigma[i]), float(v[i]), is_bound=False)
        for i in np.flatnonzero(v < view.limit)
    )


def came_to_path(
    scene: Scene, taken: StBoundaries, came: Mapping[str, float], hesitates_s: float
) -> Mapping[str, float]:
    """When each pedestrian or rider was last in the path, s, for the next frames.

    `came` is that of the frames before; entries older than `hesitates_s` are dropped.
    """
    if not (came or len(taken)):
        return came
    t, agents = scene.frame.t, scene.frame.agents
    now = {agents.ids[i]: t for i in taken.agent if scene.vulnerable[i]}
    return {name: since for name, since in {**came, **now}.items() if t - since <= hesitates_s}


def hesitation_caps(view: PathView) -> tuple[SpeedCap, ...]:
    """(5) beside each agent that came to the path, does not take it now, and stands: it may set off
    at any moment.
    """
    if not view.came:
        return ()
    scene, path = view.scene, view.path
    agents, caps = view.scene.frame.agents, []
    taking = set(view.taken.agent.tolist())
    for i, name in enumerate(agents.ids):
        if name not in view.came or i in taking or scene.speed[i] >= TOWARDS_MPS:
            continue
        away = np.hypot(path.x - agents.x[i], path.y - agents.y[i])
        nearest = int(np.argmin(away))
        ahead = float(path.sigma[nearest]) - scene.vehicle.axle_to_front
        if not 0.0 < ahead < LOOK_M:
            continue
        d = float(away[nearest]) - 0.5 * (
            scene.vehicle.width + max(agents.length[i], agents.width[i])
        )
        v = avoidable_speed(d, view.caution.walk_mps, view.hard_mps2)
        where = f"stands {d:.1f} m beside it, {ahead:.0f} m ahead"
        reason = f"came to the path and {where}: could be avoided at {v:.1f} m/s"
        caps.append(SpeedCap(ahead - STEP_M, ahead, v, name, reason))
    return tuple(caps)


def hidden_ground_caps(view: PathView) -> tuple[SpeedCap, ...]:
    """(5) beside hidden ground, up to the first agent that takes the path; (4) for the sensor's
    range.
    """
    view_field, scene = view.scene.frame.visibility, view.scene
    if view_field is None:
        return ()
    front, until = (
        scene.vehicle.axle_to_front,
        min(view.taken.first + scene.vehicle.axle_to_front, LOOK_M),
    )
    caps = [SpeedCap(-inf, inf, stopping_speed(view_field.range, view.hard_mps2))]
    for s, d in hidden_beside(
        view.path, view_field, scene.frame.agents, scene.vehicle, until, view.caution.walk_mps
    ):
        v = avoidable_speed(d - PERSON_M, view.caution.walk_mps, view.hard_mps2)
        where = f"{s - front:.0f} m ahead, {d:.1f} m beside"
        reason = f"who steps out of the hidden ground {where}, could be avoided at {v:.1f} m/s"
        caps.append(SpeedCap(s - front - STEP_M, s - front, v, "hidden ground", reason))
    return tuple(caps)


class Hidden(NamedTuple):
    """Hidden ground beside the path: `s` m along it, `d` m from the ego's side."""

    s: float
    d: float


def hidden_beside(
    path: Path,
    view: Visibility,
    agents: Agents,
    vehicle: VehicleParameters,
    until: float,
    walk: float,
) -> list[Hidden]:
    """The nearest hidden ground on either side of the path, at most one per point, from the front
    to `until` m.

    Shadows of agents that are faster than `walk`, m/s, are left out: pedestrians do not come out
    behind them.
    """
    shadows = view.shadows
    if len(agents):
        middle = 0.5 * (shadows[:, 0] + shadows[:, 3])
        away = np.hypot(middle[:, :1] - agents.x, middle[:, 1:] - agents.y)
        caster = np.argmin(away, axis=1)
        shadows = shadows[
            ~((agents.speed[caster] > walk) & (away.min(axis=1) < agents.length[caster]))
        ]
    if not len(shadows):
        return []
    ahead = np.arange(vehicle.axle_to_front, until, STEP_M)
    indices = np.searchsorted(path.sigma, ahead[ahead < path.length])
    side = 0.5 * vehicle.width + np.r_[SIDE_M, SIDE_M]
    side[len(SIDE_M) :] *= -1.0
    x = path.x[indices, None] - side * np.sin(path.yaw[indices, None])
    y = path.y[indices, None] + side * np.cos(path.yaw[indices, None])
    points = np.column_stack([x.ravel(), y.ravel()])
    everywhere = replace(view, range=inf, field_of_view=2.0 * pi, shadows=shadows)
    boxes = np.column_stack(
        [agents.x, agents.y, agents.yaw, 0.5 * agents.length, 0.5 * agents.width]
    )
    hides = (everywhere.hides(points) & ~_points_in_boxes(points, boxes)).reshape(x.shape)
    return [
        Hidden(float(path.sigma[indices[i]]), float(np.abs(side[row]).min() - 0.5 * vehicle.width))
        for i, row in enumerate(hides)
        if row.any()
    ]


@kernel
def _points_in_boxes(points: FloatArray, boxes: FloatArray) -> BoolArray:
    """Which of the points `(k, 2)` lie in a box `(n, 5)`: x, y, yaw, half length, half width."""
    covered = np.zeros(len(points), np.bool_)
    for i in range(len(boxes)):
        c, s = np.cos(boxes[i, 2]), np.sin(boxes[i, 2])
        for k in range(len(points)):
            dx, dy = points[k, 0] - boxes[i, 0], points[k, 1] - boxes[i, 1]
            inside = abs(c * dx + s * dy) <= boxes[i, 3] and abs(c * dy - s * dx) <= boxes[i, 4]
            covered[k] = covered[k] or inside
    return covered


Producer = Callable[[PathView], tuple[SpeedCap, ...]]

OWN: tuple[Producer, ...] = (goal_and_rules_caps,)
"""Caps that also apply on an empty road: the time lost to other agents is relative to these."""
OTHERS: tuple[Producer, ...] = (passing_caps, swerve_caps, hidden_ground_caps, hesitation_caps)
"""Caps because of other road users, visible or hidden."""
