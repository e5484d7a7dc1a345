"""Traffic lights and right of way for agents that drive by the model: a standing leader is placed
where they wait.

A stop line is on a vehicle's path where the middle of its front bumper first crosses it in the
lane's direction, at most `ASIDE_M` beside its ends, on a way that the line applies to. With the gap
s to it and the speed v, a stop takes the deceleration

(1) b = v^2 / (2 s)

At yellow, a vehicle stops if that takes no more than `DECEL_MPS2`; at red, and at red and yellow,
no more than `HARDEST_MPS2`. It stops by `replan.replay.traffic.leaders` (4) until the light opens
(green, off). A vehicle that could not stop drives on, whatever the light shows next, unless
something else slows it down until `DECEL_MPS2` suffices.

Until the log leaves its own last standstill before a line, the vehicle stops there as logged, and
no line keeps it from being on time again. Stop signs are as in the log: the late vehicle slows down
where it did.

An agent on a lane that yields (`Lane.yields_to`) waits for the ego on a lane with priority. The ego
is predicted along its lanes (`replan.replay.prediction`, every way that it may take) for
`LOOK_AHEAD_S`. It has the right of way at its boxes on a lane with priority. An agent that is on
the yielding lane, or comes to it, goes on as in its log, but no faster than its speed v allows:
with the distance s from here and a = `leaders.ACCEL_MPS2`, it arrives after

(2) tau(s) = max(time of the log to there, (sqrt(v^2 + 2 a s) - v) / a)

It waits where its box would reach such a place within `SERIOUS_S` before or after the ego (a
post-encroachment time below 1 s violates the right of way: `replan.metrics.priority`), if it
can stop with `leaders.HARDEST_MPS2` before all of the ego's way, held by right or not: a standing
leader is placed there. An agent that cannot stop, or is there already, drives on.
"""

from __future__ import annotations

from math import atan2, cos, hypot, sin, sqrt
from typing import NamedTuple

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray, arc_lengths
from replan.core.kernel import inner_kernel, kernel
from replan.core.once import once
from replan.logs.agents import AgentKind, Agents
from replan.logs.road import Road
from replan.logs.route import ASIDE_M, ASKEW_RAD, BEHIND_M, on_lane
from replan.logs.rules import RED, Colour, TrafficLight
from replan.logs.scenario import Scenario
from replan.logs.shapes import axis_gap
from replan.logs.states import EgoState
from replan.logs.tracks import Tracks
from replan.metrics.priority import SERIOUS_S
from replan.planners.rules.zones import turned
from replan.replay.prediction import LaneMap
from replan.replay.prediction.lane_following import followers
from replan.replay.traffic import leaders
from replan.replay.traffic.leaders import (
    ACCEL_MPS2,
    DECEL_MPS2,
    FINE_M,
    HARDEST_MPS2,
    Leaders,
    Paths,
    places,
    sample_at,
)
from replan.replay.traffic.phase_replay import PERIOD_S
from replan.replay.world import ROUNDING_M, box_center

LOOK_AHEAD_S, STEP_S = 6.0, 0.25
"""Horizon of the ego's prediction (a stop from 13.9 m/s with 3 m/s2 takes 4.6 s), and the time
between two boxes.
"""


TIME, X, Y, YAW = range(4)
"""Rows of the ego's boxes."""


class Crossing(NamedTuple):
    """Where a path crosses a line: agent, light, station along all paths (m), end of its last
    standstill (s).
    """

    owner: int
    light: int
    station: float
    stands_until: float


class RedLights:
    """Stops agents at closed lights; remembers which agents stop for which line, and which could
    not.

    Args:
        scenario: Its road and lights.
        paths: The logged paths, each extended along its lane.
        reacts: `(n,)` which agents may drive by the model.
    """

    def __init__(self, scenario: Scenario, paths: Tracks, reacts: BoolArray) -> None:
        self._lights = scenario.lights
        crossings: tuple[Crossing, ...] = ()
        if scenario.lights and len(paths):
            agents = tuple(np.flatnonzero(reacts).tolist())
            crossings = _crossings(paths, scenario.road, scenario.lights, agents)
        self._owner = np.array([crossing.owner for crossing in crossings], np.int64)
        self._light = np.array([crossing.light for crossing in crossings], np.int64)
        self._line = np.array([crossing.station for crossing in crossings])
        self._stands_until = np.array([crossing.stands_until for crossing in crossings])
        self._paths, self._station = leaders.paths_along(paths), _stations(paths)
        self._stops = np.zeros(len(crossings), np.bool_)
        self._passes = np.zeros(len(crossings), np.bool_)

    def accelerations(
        self, t: float, who: IntArray, phase: FloatArray, speed: FloatArray, whose: BoolArray
    ) -> FloatArray:
        """The greatest accelerations `(k,)` that lights allow the agents `who` (those `whose`) from
        `t` on, m/s2.
        """
        accels = np.full(len(phase), ACCEL_MPS2)
        if not len(self._owner):
            return accels
        agents = places(who, self._owner)
        near = np.flatnonzero((agents >= 0) & np.append(whose, False)[agents])
        agents, stops, passes = agents[near], self._stops[near], self._passes[near]
        self._stops[:], self._passes[:] = False, False
        if not len(near):
            return accels
        colours = [light.at(t) for light in self._lights]
        red = np.array([colour in RED for colour in colours])[self._light[near]]
        yellow = np.array([colour is Colour.YELLOW for colour in colours])[self._light[near]]
        v = speed[agents]
        gap = _gaps(self._paths, self._station, phase[agents], self._owner[near], self._line[near])
        counts = (red | yellow) & (gap > 0.0) & (gap <= leaders.LOOK_M + leaders.LOOK_S * v)
        counts &= self._stands_until[near] <= t + PERIOD_S + 1e-9
        able = v * v <= 2.0 * gap * np.where(yellow | passes, DECEL_MPS2, HARDEST_MPS2)
        stops = counts & (stops | able)
        self._stops[near], self._passes[near] = stops, counts & ~stops
        still = np.zeros(len(gap))
        wanted = leaders.accelerations(v, Leaders(np.where(stops, gap, np.inf), still, still))
        np.minimum.at(accels, agents, wanted)
        return accels


def _stations(paths: Tracks) -> FloatArray:
    """Length `(samples,)` along all paths, one after the other, m.

    Only differences within one path are meaningful.
    """
    return arc_lengths(paths.x, paths.y) if len(paths.t) else np.empty(0)


@once
def _crossings(
    paths: Tracks, road: Road, signals: tuple[TrafficLight, ...], who: tuple[int, ...]
) -> tuple[Crossing, ...]:
    """Where the paths of `who` cross lines that apply to them: also where a way is on no lane after
    the line.
    """
    crossings = []
    owner = np.repeat(np.arange(len(paths)), np.diff(paths.offsets))
    within = (owner[1:] == owner[:-1]) & np.isin(owner[1:], who)
    ahead = 0.5 * paths.length[owner]
    front = np.column_stack(
        [paths.x + ahead * np.cos(paths.yaw), paths.y + ahead * np.sin(paths.yaw)]
    )
    station = _stations(paths)
    stands = np.diff(station) < leaders.STANDING_MPS * np.diff(paths.t)
    lights = {light.id: i for i, light in enumerate(signals)}
    for line in road.stop_lines:
        if line.light not in lights:
            continue
        lane, over = road.lanes[line.lane], set[int]()
        half = 0.5 * hypot(*(line.points[1] - line.points[0]))
        middle = line.points.mean(axis=0)
        across = (line.points[1] - line.points[0]) / max(2.0 * half, 1e-9)
        normal = np.array([across[1], -across[0]])
        askew = turned(lane, float(middle[0]), float(middle[1]), atan2(normal[1], normal[0]))
        if askew > 0.5 * np.pi:
            normal = -normal
        forward, beside = (front - middle) @ normal, (front - middle) @ across
        for k in np.flatnonzero(within & (forward[:-1] < 0.0) & (forward[1:] >= 0.0)).tolist():
            i, u = int(owner[k]), float(forward[k] / (forward[k] - forward[k + 1]))
            if i in over or abs(beside[k] + u * (beside[k + 1] - beside[k])) > half + ASIDE_M:
                continue
            askew = turned(lane, float(front[k, 0]), float(front[k, 1]), float(paths.yaw[k]))
            if askew >= ASKEW_RAD:
                continue
            over.add(i)
            end = np.searchsorted(station[: paths.offsets[i + 1]], station[k] + BEHIND_M)
            behind = slice(k + 1, int(end))
            poses = paths.x[behind], paths.y[behind], paths.yaw[behind]
            ways = [n for n in lane.successors if n in road.lanes]
            on = {n: int(on_lane(road.lanes[n], *poses).sum()) for n in ways if line.towards}
            if not any(on.values()) or max(ways, key=lambda n: (on[n], -n)) in line.towards:
                stood = np.flatnonzero(stands[paths.offsets[i] : k + 1])
                until = paths.t[paths.offsets[i] + stood[-1] + 1] if len(stood) else -np.inf
                place = station[k] + u * (station[k + 1] - station[k])
                crossings.append(Crossing(i, lights[line.light], float(place), float(until)))
    return tuple(crossings)


@kernel
def _gaps(
    paths: Paths, station: FloatArray, phase: FloatArray, owner: IntArray, stations: FloatArray
) -> FloatArray:
    """Length of path `(k,)` from each owner's phase `(k,)` to the station `at` `(k,)`, m."""
    gaps = np.empty(len(owner))
    for c in range(len(owner)):
        now = phase[c]
        k = min(sample_at(paths, owner[c], now), paths.end[owner[c]] - 2)
        u = min(max((now - paths.t[k]) / (paths.t[k + 1] - paths.t[k]), 0.0), 1.0)
        gaps[c] = stations[c] - station[k] - u * (station[k + 1] - station[k])
    return gaps


class YieldingWay(NamedTuple):
    """An agent's way over a yielding lane: its index, the lanes with priority, when its log leaves
    the lane (s).
    """

    owner: int
    first: tuple[int, ...]
    until: float


class Yielding:
    """Keeps agents that yield out of the ego's way.

    Args:
        scenario: Its road and the ego's size.
        paths: The logged paths, each extended along its lane.
        reacts: `(n,)` which agents may drive by the model.
    """

    def __init__(self, scenario: Scenario, paths: Tracks, reacts: BoolArray) -> None:
        self._road, self._car, self._tracks = scenario.road, scenario.vehicle, paths
        self._lanes, self._paths = LaneMap.of(scenario.road), leaders.paths_along(paths)
        self._ways = _yielding_ways(paths, scenario.road, tuple(np.flatnonzero(reacts).tolist()))
        self._owner = np.array([yielding.owner for yielding in self._ways], np.int64)
        self._until = np.array([yielding.until for yielding in self._ways])

    def gaps(
        self, ego: EgoState, who: IntArray, phase: FloatArray, speed: FloatArray, whose: BoolArray
    ) -> FloatArray:
        """Distance of the tracks `who` (those `whose`) to where they must wait for the ego `(k,)`,
        m; inf: no wait.
        """
        gaps = np.full(len(phase), np.inf)
        if not self._ways:
            return gaps
        agents = places(who, self._owner)
        is_near = (agents >= 0) & np.append(whose, False)[agents]
        is_near &= np.append(phase, np.nan)[agents] <= self._until + 1e-9
        ways = [(self._ways[k], agents[k]) for k in np.flatnonzero(is_near)]
        if not ways:
            return gaps
        x, y = box_center(ego, self._car)
        vx, vy = ego.v * cos(ego.yaw), ego.v * sin(ego.yaw)
        numbers = (self._car.length, self._car.width, x, y, ego.yaw, vx, vy, ego.yaw_rate, ego.a)
        now = Agents(("ego",), (AgentKind.CAR,), *(np.array([number]) for number in numbers))
        t = np.arange(0.0, LOOK_AHEAD_S + 0.5 * STEP_S, STEP_S)
        ego_ways = followers(now, t, self._lanes)
        pose = ego_ways.x, ego_ways.y, ego_ways.yaw
        # Of the ego, on all its ways
        boxes = np.stack([np.broadcast_to(t, ego_ways.x.shape), *pose]).reshape(4, -1)
        on = {
            k: on_lane(self._road.lanes[k], *boxes[1:])
            for k in sorted({k for yielding, _ in ways for k in yielding.first})
        }
        size = float(self._car.length), float(self._car.width)
        for yielding, k in ways:
            i = yielding.owner
            by_right = np.logical_or.reduce([on[lane] for lane in yielding.first])
            if by_right.any():
                own = float(self._tracks.length[i]), float(self._tracks.width[i])
                gap = _wait(self._paths, i, phase[k], speed[k], own, boxes, by_right, size)
                gaps[k] = min(gaps[k], gap)
        return gaps


@once
def _yielding_ways(paths: Tracks, road: Road, agents: tuple[int, ...]) -> tuple[YieldingWay, ...]:
    """The ways of `who` over lanes that yield."""
    ways = []
    for i in agents:
        samples = paths.samples(i)
        for lane in road.lanes.values():
            first = tuple(k for k in lane.yields_to if k in road.lanes)
            if not first:
                continue
            on = on_lane(lane, paths.x[samples], paths.y[samples], paths.yaw[samples])
            if on.any():
                ways.append(YieldingWay(i, first, float(paths.t[samples][on].max())))
    return tuple(ways)


@kernel
def _wait(
    paths: Paths,
    i: int,
    phase: float,
    speed: float,
    own: tuple[float, float],
    boxes: FloatArray,
    by_right: BoolArray,
    size: tuple[float, float],
) -> float:
    """Distance of agent i to the first of the ego's boxes if it must and can wait for one, m; else
    inf.

    `boxes` `(4, k)`: t, x, y, yaw; `own` and `size`: length and width of agent and ego, m;
    `by_right` `(k,)`: whether the ego has the right of way in the box.
    """
    clear, place, meets = 0.0, np.inf, False  # clear: the last station without a box
    station = 0.0
    times, xs, ys = boxes[TIME], boxes[X], boxes[Y]
    cosines, sines = np.cos(boxes[YAW]), np.sin(boxes[YAW])
    (length, width), (ego_length, ego_width) = own, size
    near = 0.5 * (hypot(length, width) + hypot(ego_length, ego_width)) + ROUNDING_M
    for k in range(sample_at(paths, i, phase), paths.end[i] - 1):
        dt, turn = paths.t[k + 1] - paths.t[k], paths.yaw[k + 1] - paths.yaw[k]
        dx, dy = paths.x[k + 1] - paths.x[k], paths.y[k + 1] - paths.y[k]
        length_m = hypot(dx, dy)
        start = max((phase - paths.t[k]) / dt, 0.0)
        steps = int((1.0 - start) * length_m / FINE_M) + 1
        for m in range(steps + 1):
            u = start + (1.0 - start) * m / steps
            s = station + (u - start) * length_m
            # (2)
            tau = max(
                paths.t[k] + u * dt - phase,
                (sqrt(speed * speed + 2.0 * ACCEL_MPS2 * s) - speed) / ACCEL_MPS2,
            )
            if tau > LOOK_AHEAD_S:
                return _place(speed, place, meets)
            x, y, yaw = paths.x[k] + u * dx, paths.y[k] + u * dy, paths.yaw[k] + u * turn
            c, sine, free = cos(yaw), sin(yaw), True
            for b in range(boxes.shape[1]):
                if (xs[b] - x) ** 2 + (ys[b] - y) ** 2 > near * near:
                    continue
                gap = axis_gap(
                    x,
                    y,
                    c,
                    sine,
                    length,
                    width,
                    xs[b],
                    ys[b],
                    cosines[b],
                    sines[b],
                    ego_length,
                    ego_width,
                )
                if gap <= 0.0:
                    free = False
                    meets = meets or (by_right[b] and abs(times[b] - tau) <= SERIOUS_S)
            if free and not np.isfinite(place):
                clear = s
            elif not np.isfinite(place):
                place = clear
        station += (1.0 - start) * length_m
    return _place(speed, place, meets)


@inner_kernel
def _place(speed: float, place: float, meets: bool) -> float:
    """Return the distance to the place where it must wait, if it must and can stop; else inf, m."""
    return (
        place if meets and speed * speed <= 2.0 * HARDEST_MPS2 * place and place > 0.0 else np.inf
    )
