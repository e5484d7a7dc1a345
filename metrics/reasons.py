"""Reasons for the ego to slow down, to stand or to steer, every 0.1 s.

Reasons are searched along the route (`route_gain`), ahead of the ego's front, up to the distance
(v: its speed)

(1) look = 10 m + 1.5 s v + max(v - u, 0)^2 / (2 EASE_MPS2)
        u: speed of the road user ahead, along the route

The reasons are those that a careful driver could have:

    road users   ahead or beside, whose box is within 1 m (pedestrians and riders: 2 m) of the strip
                 that the ego sweeps here or on the route, or comes so near within `COMING_S` at its
                 velocity, and who do not drive away: those that were present, phantoms included,
                 and those that the planner perceived
    rules        a stop line with a sign, or a light that is not green; a crosswalk with a
                 pedestrian or rider within 10 m of it; a lane that yields; the far end of the goal,
                 its near end where it asks for a speed; a goal's time, where the ego would leave
                 the goal before it; the end of the route
    caps         v exceeds the limit, the speed with 2 m/s2 of lateral acceleration in a curve, or
                 the speed of the recorded driver at that place

Reasons other than caps last `AFTER_S` longer. An ego more than `ASIDE_M` beside the route is not
judged.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.core.once import once
from replan.logs.polylines import points_inside
from replan.logs.reference_line import ReferenceLine, line_project_many
from replan.logs.rules import Colour
from replan.logs.scenario import Scenario
from replan.logs.trace import Trace
from replan.logs.tracks import Tracks
from replan.metrics.boxes import each, grid_of, phantoms
from replan.metrics.lanes import drivable_lanes, limits_at
from replan.metrics.route_gain import WINDOW_M, route_of

NEAR_M, FARTHEST_M = 10.0, 150.0
HEADWAY_S, EASE_MPS2 = 1.5, 1.5
LINE_M = 6.0
COMING_S, AFTER_S = 6.0, 2.0
SIDE_M, SIDE_VULNERABLE_M, DRIFT_MPS = 1.0, 2.0, 0.3
ASIDE_M, ACROSS_M = 5.0, 2.0
CURVE_MPS2, CURVE_RADIUS_M = 2.0, 50.0
SLACK_MPS, STANDS_MPS = 0.3, 0.5


@dataclass(frozen=True, eq=False, slots=True)
class Reasons:
    """The ego's speed v, m/s, its offset l from the route, m, and its reasons, at k times t, s."""

    t: FloatArray
    v: FloatArray
    l: FloatArray
    slow: BoolArray  # Whether it has a reason to be slower
    stand: BoolArray  # Whether it has a reason to stand
    # Whether it has a reason to change its offset; `beside`: a road user is one; `change`: its lane
    steer: BoolArray
    beside: BoolArray
    change: BoolArray


@once
def reasons(trace: Trace, scenario: Scenario) -> Reasons:
    """Find the reasons of the ego at each step."""
    ego, line = grid_of(trace), route_of(scenario).line
    s, l = line_project_many(line.s, line.coef, ego.x, ego.y, 0.0, WINDOW_M).T
    front = s + scenario.vehicle.axle_to_front
    slow, stand, steer, change = np.zeros((4, len(s)), np.bool_)
    for begin, end, active, near in _places_to_stop(trace, scenario, ego.t, line):
        ahead = (s <= end) & active
        slow |= ahead & (begin - front <= _look_ahead(ego.v, 0.0))
        stand |= ahead & (begin - front <= near)
    ghosts = {phantom.agent for phantom in phantoms(scenario)}
    shown = (trace.agents, trace.perceived, scenario.tracks.only(ghosts) if ghosts else None)
    for tracks in filter(None, shown):
        for brakes, stands, beside, far in _agents_as_reasons(
            tracks, ego.t, s, l, ego.v, line, scenario
        ):
            slow, stand = slow | brakes, stand | stands
            steer, change = steer | beside, change | far
    goal, early = scenario.goal, np.zeros(len(s), np.bool_)
    # At its speed it would leave the goal before the goal's time
    if goal is not None and goal.t is not None:
        early = s + np.maximum(ego.v, STANDS_MPS) * (goal.t[0] - ego.t) > route_of(scenario).far
    flags = np.stack([slow | early, stand | early, steer, change])
    since = np.maximum.accumulate(np.where(flags, ego.t, -np.inf), axis=1)
    slow, stand, steer, change = ego.t - since <= AFTER_S + 1e-9
    off = np.abs(l) > ASIDE_M
    lanes, default = drivable_lanes(scenario.road), scenario.road.default_speed_limit
    x, y = np.ascontiguousarray(line.xy[:, 0]), np.ascontiguousarray(line.xy[:, 1])
    limit = (
        np.nan_to_num(limits_at(lanes, x, y), nan=default)
        if lanes is not None
        else np.full(len(x), default)
    )
    caps = np.minimum(limit, np.sqrt(CURVE_MPS2 / np.maximum(np.abs(line.kappa), 1e-9)))
    if scenario.is_recorded and len(scenario.ego) > 1:
        logged = scenario.ego
        passed = line_project_many(line.s, line.coef, logged.x, logged.y, 0.0, WINDOW_M)[:, 0]
        np.minimum.at(
            caps, np.clip(np.searchsorted(line.s, passed), 0, len(caps) - 1), np.abs(logged.v)
        )
    ease = NEAR_M + HEADWAY_S * ego.v  # and the distance to slow down to a cap with `EASE_MPS2`
    first, end = np.searchsorted(line.s, [s, s + FARTHEST_M + NEAR_M])
    for k, v in enumerate(ego.v.tolist()):
        window = slice(max(int(first[k]) - 1, 0), int(end[k]))
        far = (
            line.s[window]
            - s[k]
            - ease[k]
            - np.maximum(v**2 - caps[window] ** 2, 0.0) / (2.0 * EASE_MPS2)
        )
        slow[k] |= off[k] or bool(((v > caps[window] + SLACK_MPS) & (far <= 0.0)).any())
    curved = np.interp(s, line.s, np.abs(line.kappa)) > 1.0 / CURVE_RADIUS_M
    return Reasons(ego.t, ego.v, l, slow, stand | off, steer | curved, steer, change | off)


def _look_ahead(v: FloatArray, u: FloatArray | float) -> FloatArray:
    """Return (1), at most `FARTHEST_M`."""
    return np.minimum(
        NEAR_M + HEADWAY_S * v + np.maximum(v - u, 0.0) ** 2 / (2.0 * EASE_MPS2), FARTHEST_M
    )


def _agents_as_reasons(
    tracks: Tracks,
    t: FloatArray,
    s: FloatArray,
    l: FloatArray,
    v: FloatArray,
    line: ReferenceLine,
    scenario: Scenario,
) -> Iterator[BoolArray]:
    """Yield for each road user the steps at which it is a reason to brake, to stand, to steer, to
    change lanes.
    """
    car, ego_places = (
        scenario.vehicle,
        np.stack([np.interp(s, line.s, column) for column in line.xy.T]),
    )
    for i, others, row in each(tracks, t):
        x, y, yaw, vx, vy = np.nan_to_num(others.pose[:, row])
        length, width = others.size[row]
        near_route = others.there[row] & (
            np.hypot(*(others.pose[:2, row] - ego_places)) < FARTHEST_M
        )
        steps = np.flatnonzero(near_route)
        flags = np.zeros((4, len(t)), np.bool_)
        if len(steps):
            guess = float(s[steps[0]])
            station, aside = line_project_many(
                line.s, line.coef, x[steps], y[steps], guess, FARTHEST_M
            ).T
            road = np.interp(station, line.s, line.yaw)
            turn = yaw[steps] - road
            u = vx[steps] * np.cos(road) + vy[steps] * np.sin(road)
            w = vy[steps] * np.cos(road) - vx[steps] * np.sin(road)
            along = 0.5 * (length * np.abs(np.cos(turn)) + width * np.abs(np.sin(turn)))
            across = 0.5 * (length * np.abs(np.sin(turn)) + width * np.abs(np.cos(turn)))
            gap = station - along - s[steps] - car.axle_to_front
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
    """Yield places where rules stop the ego: first and last station, when `(k,)`, and how near it
    may stand, m.
    """
    always, route, goal = np.ones(len(t), np.bool_), route_of(scenario), scenario.goal
    lights = {light.id: light for light in scenario.lights}
    for mark in scenario.road.stop_lines:
        station, aside = line.project(*mark.points.mean(axis=0).tolist())
        if abs(aside) < 0.5 * float(np.hypot(*np.diff(mark.points, axis=0)[0])) + ACROSS_M:
            light = lights.get(mark.light) if mark.light is not None else None
            shut = (
                always
                if light is None
                else np.array([light.at(now) is not Colour.GREEN for now in t])
            )
            yield station, station + ACROSS_M, shut, LINE_M
    zones = []
    # Active while a pedestrian or rider is within `NEAR_M` of its bounding box
    for walk in scenario.road.crosswalks:
        low, high = walk.polygon.min(axis=0) - NEAR_M, walk.polygon.max(axis=0) + NEAR_M
        walked = np.zeros(len(t), np.bool_)
        for i, others, row in each(trace.agents, t):
            if trace.agents.kinds[i].is_vulnerable:
                x, y = others.pose[:2, row]
                walked |= (
                    others.there[row] & (x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1])
                )
        zones.append((walk.polygon, walked))
    zones += [(lane.polygon, always) for lane in scenario.road.lanes.values() if lane.yields_to]
    for polygon, active in zones:
        on = line.s[points_inside(polygon, *line.xy.T)]
        if len(on):
            yield float(on[0]), float(on[-1]), active, NEAR_M
    yield line.length, np.inf, always, NEAR_M
    # A goal that asks for no speed is driven through
    if goal is not None and np.isfinite(route.length):
        yield (route.far if goal.v is None else route.length), np.inf, always, NEAR_M
    elif scenario.is_recorded:
        yield (
            float(line.project(scenario.ego.x[-1], scenario.ego.y[-1], route.length)[0]),
            np.inf,
            always,
            NEAR_M,
        )
