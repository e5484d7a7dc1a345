"""Braking, standing and steering without a reason, and missing braking; closed loop, every 0.1 s.

Reasons for the ego to slow down or to stand are searched along the route (`progress`), ahead of its front, up to the
distance (v: its speed)

(1) look = 10 m + 1.5 s v + max(v - u, 0)^2 / (2 EASE_MPS2)      u: speed of the road user ahead, along the route

The reasons are those that a careful driver could have:

    road users   ahead or beside, whose box is within 1 m (pedestrians and riders: 2 m) of the strip that the ego sweeps
                 here or on the route, or comes so near within `COMING_S` at its velocity, and who do not drive away:
                 those that were present, phantoms included, and those that the planner perceived
    rules        a stop line with a sign, or a light that is not green; a crosswalk with a pedestrian or rider
                 within 10 m of it;
                 a lane that yields; the far end of the goal, its near end where it asks for a speed; a goal's time,
                 where the ego would leave the goal before it; the end of the route
    caps         v exceeds the limit, the speed with 2 m/s2 of lateral acceleration in a curve, or the speed of the
                 recorded driver at that place

Reasons other than caps last `AFTER_S` longer. An ego more than `ASIDE_M` beside the route is not judged.

(2) needless_braking(t) = highest speed since the last reason - v(t)
(3) needless_standing(t) = 1 where v < 0.5 m/s and no reason is within 10 m of its front, and no stop line within
    `LINE_M`
(4) needless_steering: each change of the offset from the route by 0.5 m to 2 m between two turning points, if no road
    user and no curve is near in its first half

False braking is hard braking without a cause. A planner that avoids it may miss braking instead, so both are measured:

(5) A hard episode: steps every `GRID_S` with a < -`HARD_MPS2`, less than `APART_S` apart.
(6) It had a cause if, within `CAUSE_S` of its begin, the box of any road user came within `CAUSE_M` of the strip that
    the ego sweeps from there: along its drive, straight beyond its end, for the distance that it would cover at its
    speed.
(7) missed(t) = max((v - u)^2 / (2 gap) - b, 0) for the lead in the path ahead (`following`) with gap and u, v > u, and
    the ego's deceleration b: the deceleration of a steady approach that the ego does not apply.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from math import cos, sin

import numpy as np

from logs.arrays import BoolArray, FloatArray, arc_lengths
from logs.kernel import kernel
from logs.once import once
from logs.road import ReferenceLine, line_project_many
from logs.rules import Colour
from logs.scenario import Scenario
from logs.states import Trajectory
from logs.trace import Mode, Trace
from logs.tracks import Tracks
from metrics.boxes import GRID_S, EgoOutline, OtherBoxes, car_of, each, grid_of, labels_of, others_at, phantoms, touches
from metrics.following import ahead_of
from metrics.lanes import drivable_lanes, limits_at, points_inside
from metrics.metric import COUNT, MAX, RATE, Measured, Metric, Series, worst_episode
from metrics.progress import WINDOW_M, route_of

NEAR_M, HEADWAY_S, EASE_MPS2, FARTHEST_M = 10.0, 1.5, 1.5, 150.0
LINE_M = 6.0
COMING_S, AFTER_S = 6.0, 2.0
SIDE_M, SIDE_VULNERABLE_M, DRIFT_MPS = 1.0, 2.0, 0.3
ASIDE_M, ACROSS_M = 5.0, 2.0
CURVE_MPS2, CURVE_RADIUS_M = 2.0, 50.0
SLACK_MPS, STANDS_MPS = 0.3, 0.5
SWING_M, CHANGE_M, FALL_MPS = 0.5, 2.0, 0.5
HARD_MPS2, APART_S, CAUSE_S, CAUSE_M = 3.5, 0.5, 5.0, 0.3
SPACING_M = 0.5
"""Distance between the boxes of the ego whose union approximates the strip."""
TOUCHING_M = 0.5
"""Least gap in (7): nearer road users are contacts."""


@dataclass(frozen=True, eq=False, slots=True)
class Reasons:
    """The ego's speed v, m/s, its offset l from the route, m, and its reasons, at k times t, s.

    Attributes:
        slow: Whether it has a reason to be slower.
        stand: Whether it has a reason to stand.
        steer: Whether it has a reason to change its offset; `beside`: a road user is one; `change`: its lane.
    """

    t: FloatArray
    v: FloatArray
    l: FloatArray  # noqa: E741
    slow: BoolArray
    stand: BoolArray
    steer: BoolArray
    beside: BoolArray
    change: BoolArray


@once
def reasons(trace: Trace, scenario: Scenario) -> Reasons:
    """Find the reasons of the ego at each step."""
    ego, line = grid_of(trace), route_of(scenario).line
    s, l = line_project_many(line.s, line.coef, ego.x, ego.y, 0.0, WINDOW_M).T  # noqa: E741
    front = s + scenario.vehicle.axle_to_front
    slow, stand, steer, change = np.zeros((4, len(s)), np.bool_)
    for begin, end, active, near in _places_to_stop(trace, scenario, ego.t, line):
        ahead = (s <= end) & active
        slow |= ahead & (begin - front <= _look_ahead(ego.v, 0.0))
        stand |= ahead & (begin - front <= near)
    ghosts = {phantom.agent for phantom in phantoms(scenario)}
    shown = (trace.agents, trace.perceived, scenario.tracks.only(ghosts) if ghosts else None)
    for tracks in filter(None, shown):
        for brakes, stands, beside, far in _agents_as_reasons(tracks, ego.t, s, l, ego.v, line, scenario):
            slow, stand, steer, change = slow | brakes, stand | stands, steer | beside, change | far
    goal, early = scenario.goal, np.zeros(len(s), np.bool_)
    if goal is not None and goal.t is not None:  # at its speed it would leave the goal before the goal's time
        early = s + np.maximum(ego.v, STANDS_MPS) * (goal.t[0] - ego.t) > route_of(scenario).far
    flags = np.stack([slow | early, stand | early, steer, change])
    since = np.maximum.accumulate(np.where(flags, ego.t, -np.inf), axis=1)
    slow, stand, steer, change = ego.t - since <= AFTER_S + 1e-9
    off = np.abs(l) > ASIDE_M
    lanes, default = drivable_lanes(scenario.road), scenario.road.default_speed_limit
    x, y = np.ascontiguousarray(line.xy[:, 0]), np.ascontiguousarray(line.xy[:, 1])
    limit = np.nan_to_num(limits_at(lanes, x, y), nan=default) if lanes is not None else np.full(len(x), default)
    caps = np.minimum(limit, np.sqrt(CURVE_MPS2 / np.maximum(np.abs(line.kappa), 1e-9)))
    if scenario.is_recorded and len(scenario.ego) > 1:
        logged = scenario.ego
        passed = line_project_many(line.s, line.coef, logged.x, logged.y, 0.0, WINDOW_M)[:, 0]
        np.minimum.at(caps, np.clip(np.searchsorted(line.s, passed), 0, len(caps) - 1), np.abs(logged.v))
    ease = NEAR_M + HEADWAY_S * ego.v  # and the distance to slow down to a cap with `EASE_MPS2`
    first, end = np.searchsorted(line.s, [s, s + FARTHEST_M + NEAR_M])
    for k, v in enumerate(ego.v.tolist()):
        some = slice(max(int(first[k]) - 1, 0), int(end[k]))
        far = line.s[some] - s[k] - ease[k] - np.maximum(v**2 - caps[some] ** 2, 0.0) / (2.0 * EASE_MPS2)
        slow[k] |= off[k] or bool(((v > caps[some] + SLACK_MPS) & (far <= 0.0)).any())
    curved = np.interp(s, line.s, np.abs(line.kappa)) > 1.0 / CURVE_RADIUS_M
    return Reasons(ego.t, ego.v, l, slow, stand | off, steer | curved, steer, change | off)


def _look_ahead(v: FloatArray, u: FloatArray | float) -> FloatArray:
    """Return (1), at most `FARTHEST_M`."""
    return np.minimum(NEAR_M + HEADWAY_S * v + np.maximum(v - u, 0.0) ** 2 / (2.0 * EASE_MPS2), FARTHEST_M)


def _agents_as_reasons(
    tracks: Tracks, t: FloatArray, s: FloatArray, l: FloatArray, v: FloatArray, line: ReferenceLine,  # noqa: E741
    scenario: Scenario,
) -> Iterator[BoolArray]:  # fmt: skip
    """Yield for each road user the steps at which it is a reason to brake, to stand, to steer, to change lanes."""
    car, place = scenario.vehicle, np.stack([np.interp(s, line.s, column) for column in line.xy.T])
    for i, others, row in each(tracks, t):
        x, y, yaw, vx, vy = np.nan_to_num(others.pose[:, row])
        length, width = others.size[row]
        there = others.there[row] & (np.hypot(*(others.pose[:2, row] - place)) < FARTHEST_M)
        steps = np.flatnonzero(there)
        flags = np.zeros((4, len(t)), np.bool_)
        if len(steps):
            guess = float(s[steps[0]])
            at, aside = line_project_many(line.s, line.coef, x[steps], y[steps], guess, FARTHEST_M).T
            road = np.interp(at, line.s, line.yaw)
            turn = yaw[steps] - road
            u = vx[steps] * np.cos(road) + vy[steps] * np.sin(road)
            w = vy[steps] * np.cos(road) - vx[steps] * np.sin(road)
            along = 0.5 * (length * np.abs(np.cos(turn)) + width * np.abs(np.sin(turn)))
            across = 0.5 * (length * np.abs(np.sin(turn)) + width * np.abs(np.cos(turn)))
            gap = at - along - s[steps] - car.axle_to_front
            side = aside - l[steps]
            room = np.minimum(np.abs(side), np.abs(aside)) - across - 0.5 * car.width
            coming = -w * np.sign(side)
            room -= COMING_S * np.where(coming > DRIFT_MPS, coming, 0.0)
            near = room <= (SIDE_VULNERABLE_M if tracks.kinds[i].is_vulnerable else SIDE_M)
            ahead = gap + 2.0 * along + car.length > 0.0
            leaves = (u > v[steps] + 1.0) & (gap > 2.0 + 0.5 * v[steps])
            look = _look_ahead(v[steps], u)
            flags[0, steps] = near & ahead & ~leaves & (gap <= look)
            flags[1, steps] = near & ahead & (gap <= NEAR_M)
            beside = near & (gap + 2.0 * along + car.length > -NEAR_M)
            flags[2, steps], flags[3, steps] = beside & (gap <= look), beside & ~leaves
        yield flags


def _places_to_stop(
    trace: Trace, scenario: Scenario, t: FloatArray, line: ReferenceLine
) -> Iterator[tuple[float, float, BoolArray, float]]:
    """Yield places where rules stop the ego: first and last station, when `(k,)`, and how near it may stand, m."""
    always, route, goal = np.ones(len(t), np.bool_), route_of(scenario), scenario.goal
    lights = {light.id: light for light in scenario.lights}
    for mark in scenario.road.stop_lines:
        at, aside = line.project(*mark.points.mean(axis=0).tolist())
        if abs(aside) < 0.5 * float(np.hypot(*np.diff(mark.points, axis=0)[0])) + ACROSS_M:
            light = lights.get(mark.light) if mark.light is not None else None
            shut = always if light is None else np.array([light.at(now) is not Colour.GREEN for now in t])
            yield at, at + ACROSS_M, shut, LINE_M
    zones = []
    for walk in scenario.road.crosswalks:  # active while a pedestrian or rider is within `NEAR_M` of its bounding box
        low, high = walk.polygon.min(axis=0) - NEAR_M, walk.polygon.max(axis=0) + NEAR_M
        walked = np.zeros(len(t), np.bool_)
        for i, others, row in each(trace.agents, t):
            if trace.agents.kinds[i].is_vulnerable:
                x, y = others.pose[:2, row]
                walked |= others.there[row] & (x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1])
        zones.append((walk.polygon, walked))
    zones += [(lane.polygon, always) for lane in scenario.road.lanes.values() if lane.yields_to]
    for polygon, active in zones:
        on = line.s[points_inside(polygon, *line.xy.T)]
        if len(on):
            yield float(on[0]), float(on[-1]), active, NEAR_M
    yield line.length, np.inf, always, NEAR_M
    if goal is not None and np.isfinite(route.length):  # a goal that asks for no speed is driven through
        yield (route.far if goal.v is None else route.length), np.inf, always, NEAR_M
    elif scenario.is_recorded:
        yield float(line.project(scenario.ego.x[-1], scenario.ego.y[-1], route.length)[0]), np.inf, always, NEAR_M


def _braking(trace: Trace, scenario: Scenario) -> Measured:
    found, top = reasons(trace, scenario), -np.inf
    lost = np.full(len(found.t), np.nan)
    for k in np.flatnonzero(~found.slow):
        top = max(found.v[k], -np.inf if k and found.slow[k - 1] else top)
        lost[k] = top - found.v[k]
    return Series(found.t, lost, missing=_ALWAYS)  # (2)


def _standing(trace: Trace, scenario: Scenario) -> Measured:
    found = reasons(trace, scenario)
    return Series(found.t, ((np.abs(found.v) < STANDS_MPS) & ~found.stand).astype(float))  # (3)


def _steering(trace: Trace, scenario: Scenario) -> Measured:
    found, counts = reasons(trace, scenario), np.zeros(len(reasons(trace, scenario).t))
    for a, b in pairwise(turning_points(found.l, SWING_M)):
        if abs(found.l[b] - found.l[a]) < CHANGE_M and not found.steer[a : (a + b) // 2 + 1].any():  # (4)
            counts[b] += 1.0
    return Series(found.t, counts)


@once
def falls(trace: Trace, scenario: Scenario) -> tuple[tuple[float, float], ...]:
    """Return the falls of the speed by `FALL_MPS` or more without a reason, between two turning points: s from, to."""
    found, out = reasons(trace, scenario), []
    for steps in np.split(np.arange(len(found.t)), np.flatnonzero(np.diff(found.slow)) + 1):
        v = found.v[steps]
        for a, b in pairwise(turning_points(v, FALL_MPS)) if not found.slow[steps[0]] else ():
            if v[b] < v[a]:
                begin = a + np.flatnonzero(v[a : b + 1] >= v[a] - SLACK_MPS)[-1]
                out.append((float(found.t[steps[begin]]), float(found.t[steps[b]])))
    return tuple(out)


def turning_points(value: FloatArray, least: float) -> list[int]:
    """Return the steps at which a value turns back by at least `least`, and the ends of the first and last change."""
    turns: list[int] = []
    rising, low, high = 0, 0, 0
    for k in range(len(value)):
        low = k if value[k] < value[low] else low
        high = k if value[k] > value[high] else high
        if rising >= 0 and value[high] - value[k] >= least:
            turns, rising, low, high = [*turns, high], -1, k, k
        elif rising <= 0 and value[k] - value[low] >= least:
            turns, rising, low, high = [*turns, low], 1, k, k
    return [*turns, high if rising > 0 else low] if turns else []


_ALWAYS = "something called for it all the time"
_SHARED = (
    f"look {NEAR_M:g} m + {HEADWAY_S:g} s v + (v - u)^2 / {2.0 * EASE_MPS2:g} m/s2", f"coming within {COMING_S:g} s",
    f"a reason lasts {AFTER_S:g} s longer",
)  # fmt: skip
NEEDLESS_BRAKING = Metric(
    "needless_braking", "m/s", "lower", (Mode.CLOSED,), _braking, (MAX,),
    "Speed that the ego lost while no road user, rule, limit, curve, goal or end of the route ahead called for it.",
    formula="highest speed since the last reason - v", parameters=_SHARED, needs="a time without a reason to brake",
)  # fmt: skip
NEEDLESS_STANDING = Metric(
    "needless_standing", "1", "lower", (Mode.CLOSED,), _standing, (worst_episode(-np.inf, 0.5),),
    "1 while the ego stands and no reason to stand is near.",
    formula="[v < 0.5 m/s and no reason within 10 m ahead, no stop line within 6 m]", parameters=_SHARED,
)  # fmt: skip
NEEDLESS_STEERING = Metric(
    "needless_steering", "count", "lower", (Mode.CLOSED,), _steering, (COUNT,),
    "Swings of the ego's offset from the route by 0.5 m to 2 m with no road user and no curve near.",
    formula="sum of the changes between two turning points", parameters=_SHARED,
)  # fmt: skip


def hard_episodes(ego: Trajectory) -> list[int]:
    """The steps at which the episodes (5) begin."""
    hard = np.flatnonzero(ego.a < -HARD_MPS2)
    return [int(k) for i, k in enumerate(hard) if i == 0 or ego.t[k] - ego.t[hard[i - 1]] > APART_S + 1e-9]


@kernel
def _any_touches(way: FloatArray, car: EgoOutline, others: OtherBoxes) -> bool:
    """Return whether any of the boxes `(n, k)` overlaps the ego at any pose of its rear axle: x, y, yaw `(3, m)`."""
    for j in range(way.shape[1]):
        x, y, yaw = way[0, j] + car.axle * cos(way[2, j]), way[1, j] + car.axle * sin(way[2, j]), way[2, j]
        for i in range(others.there.shape[0]):
            for k in range(others.there.shape[1]):
                if others.there[i, k] and touches(x, y, yaw, car, others, i, k):
                    return True
    return False


def _false_braking(trace: Trace, scenario: Scenario) -> Measured:
    ego, car = grid_of(trace), car_of(scenario)
    wider, value = car._replace(width=car.width + 2.0 * CAUSE_M), np.full(len(ego.t), np.nan)
    for k in hard_episodes(ego):
        begin = float(ego.t[k])
        drive = trace.ego.resampled(np.r_[begin, trace.ego.t[trace.ego.t > begin]])
        s = arc_lengths(drive.x, drive.y)
        at = np.arange(0.0, max(float(drive.v[0]), 0.0) * CAUSE_S + SPACING_M, SPACING_M)
        beyond = np.maximum(at - s[-1], 0.0)
        x, y, yaw = (np.interp(at, s, column) for column in (drive.x, drive.y, drive.yaw))
        way = np.stack([x + beyond * np.cos(yaw), y + beyond * np.sin(yaw), yaw])
        t = begin + GRID_S * np.arange(round(CAUSE_S / GRID_S) + 1)
        value[k] = not _any_touches(way, wider, others_at(trace.agents, t))  # (6)
    return Series(ego.t, value, missing="the ego never brakes hard")


def _missed_braking(trace: Trace, scenario: Scenario) -> Measured:
    found = ahead_of(trace, scenario)
    closing = np.maximum(found.v - found.u, 0.0)
    required = closing**2 / (2.0 * np.maximum(found.gap, TOUCHING_M))
    value = np.maximum(required - np.maximum(-found.a, 0.0), 0.0)
    return Series(found.t, value, labels_of(trace, found.agent), missing="the path ahead was free")


FALSE_BRAKING = Metric(
    "false_braking", "1", "lower", (Mode.CLOSED,), _false_braking, (RATE, COUNT),
    "1 where a hard braking begins after which no road user comes near the ego's way, 0 where one does.",
    formula="[no road user within 0.3 m of the way ahead within 5 s]",
    parameters=(
        f"hard below -{HARD_MPS2:g} m/s2", f"apart {APART_S:g} s", f"near {CAUSE_M:g} m", f"within {CAUSE_S:g} s",
    ),
    needs="a hard braking",
)  # fmt: skip
MISSED_BRAKING = Metric(
    "missed_braking", "m/s2", "lower", (Mode.CLOSED,), _missed_braking, (MAX,),
    "Deceleration that a steady approach behind the one ahead in the path asks beyond the ego's.",
    formula="max((v - u)^2 / (2 gap) - b, 0)", parameters=(f"gap at least {TOUCHING_M:g} m",),
    needs="a road user ahead in the path",
)  # fmt: skip
