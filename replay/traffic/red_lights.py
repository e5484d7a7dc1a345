"""Traffic lights for agents that drive by the model: a stop line with a closed light is a standing leader.

A line is on a vehicle's path where the middle of its front bumper first crosses it in the lane's direction, at most
`ASIDE_M` beside its ends, on a way that the line applies to. With the gap s to it and the speed v, a stop takes the
deceleration

(1) b = v^2 / (2 s)

At yellow, a vehicle stops if that takes no more than `DECEL_MPS2`; at red, and at red and yellow, no more than
`HARDEST_MPS2`. It stops by `replay.traffic.following` (4) until the light opens (green, off). A vehicle that could not
stop drives on, whatever the light shows next, unless something else slows it down until `DECEL_MPS2` suffices.

Until the log leaves its own last standstill before a line, the vehicle stops there as logged, and no line keeps it from
being on time again. Stop signs and right of way are as in the log: the late vehicle slows down where it did.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import atan2, hypot
from typing import NamedTuple

import numpy as np

from logs.kernel import BoolArray, FloatArray, IntArray, kernel
from logs.lanes import ASIDE_M, ASKEW_RAD, BEHIND_M, on_lane
from logs.road import Road
from logs.rules import RED, Colour, StopLine
from logs.scenario import Scenario, Tracks
from planners.rules.zones import turned
from replay.traffic.following import (
    ACCEL_MPS2,
    DECEL_MPS2,
    HARDEST_MPS2,
    LOOK_M,
    LOOK_S,
    STANDING_MPS,
    Leaders,
    Paths,
    accelerations,
    paths_along,
    places,
)
from replay.traffic.phase_replay import PERIOD_S


class Crossing(NamedTuple):
    """Where a path crosses a line: agent, light, station along all paths (m), end of its last standstill (s)."""

    owner: int
    light: int
    station: float
    stands_until: float


class RedLights:
    """See the module docstring; remembers which agents stop for which line, and which could not.

    Args:
        scenario: Its road and lights.
        paths: The logged paths, each extended along its lane.
        reacts: `(n,)` which agents may drive by the model.
    """

    def __init__(self, scenario: Scenario, paths: Tracks, reacts: BoolArray) -> None:
        self._lights = scenario.lights
        found = list(_crossings(scenario, paths, reacts)) if scenario.lights and len(paths) else []
        self._owner = np.array([one.owner for one in found], np.int64)
        self._light = np.array([one.light for one in found], np.int64)
        self._at = np.array([one.station for one in found])
        self._stands_until = np.array([one.stands_until for one in found])
        self._paths = paths_along(paths)
        self._station = _stations(paths)
        self._stops, self._passes = np.zeros(len(found), np.bool_), np.zeros(len(found), np.bool_)

    def accelerations(
        self, t: float, who: IntArray, phase: FloatArray, speed: FloatArray, whose: BoolArray
    ) -> FloatArray:
        """The greatest accelerations `(k,)` that lights allow the agents `who` (those `whose`) from `t` on, m/s2."""
        out = np.full(len(phase), ACCEL_MPS2)
        if not len(self._owner):
            return out
        at = places(who, self._owner)
        some = np.flatnonzero((at >= 0) & np.append(whose, False)[at])
        at, stops, passes = at[some], self._stops[some], self._passes[some]
        self._stops[:], self._passes[:] = False, False
        if not len(some):
            return out
        shown = [light.at(t) for light in self._lights]
        red = np.array([colour in RED for colour in shown])[self._light[some]]
        yellow = np.array([colour is Colour.YELLOW for colour in shown])[self._light[some]]
        gap, v = _gaps(self._paths, self._station, phase[at], self._owner[some], self._at[some]), speed[at]
        counts = (red | yellow) & (gap > 0.0) & (gap <= LOOK_M + LOOK_S * v)
        counts &= self._stands_until[some] <= t + PERIOD_S + 1e-9
        able = v * v <= 2.0 * gap * np.where(yellow | passes, DECEL_MPS2, HARDEST_MPS2)
        stops = counts & (stops | able)
        self._stops[some], self._passes[some] = stops, counts & ~stops
        still = np.zeros(len(gap))
        wanted = accelerations(v, Leaders(np.where(stops, gap, np.inf), still, still))
        np.minimum.at(out, at, wanted)
        return out


def _stations(paths: Tracks) -> FloatArray:
    """Length `(samples,)` along all paths, one after the other, m; only differences within one path are meaningful."""
    return np.r_[0.0, np.cumsum(np.hypot(np.diff(paths.x), np.diff(paths.y)))] if len(paths.t) else np.empty(0)


def _crossings(scenario: Scenario, paths: Tracks, reacts: BoolArray) -> Iterator[Crossing]:
    owner = np.repeat(np.arange(len(paths)), np.diff(paths.offsets))
    within = (owner[1:] == owner[:-1]) & reacts[owner[1:]]
    ahead = 0.5 * paths.length[owner]
    front = np.column_stack([paths.x + ahead * np.cos(paths.yaw), paths.y + ahead * np.sin(paths.yaw)])
    station = _stations(paths)
    stands = np.diff(station) < STANDING_MPS * np.diff(paths.t)
    lights = {light.id: i for i, light in enumerate(scenario.lights)}
    for line in scenario.road.stop_lines:
        if line.light not in lights:
            continue
        lane, over = scenario.road.lanes[line.lane], set[int]()
        for k, u in _over(line, scenario.road, front, within):
            i = int(owner[k])
            if i in over or turned(lane, float(front[k, 0]), float(front[k, 1]), float(paths.yaw[k])) >= ASKEW_RAD:
                continue
            over.add(i)
            behind = slice(k + 1, int(np.searchsorted(station[: paths.offsets[i + 1]], station[k] + BEHIND_M)))
            if _counts(line, scenario.road, paths.x[behind], paths.y[behind], paths.yaw[behind]):
                stood = np.flatnonzero(stands[paths.offsets[i] : k + 1])
                until = paths.t[paths.offsets[i] + stood[-1] + 1] if len(stood) else -np.inf
                at = station[k] + u * (station[k + 1] - station[k])
                yield Crossing(i, lights[line.light], float(at), float(until))


def _over(line: StopLine, road: Road, front: FloatArray, within: BoolArray) -> Iterator[tuple[int, float]]:
    """The steps `within` a path in which a front `(samples, 2)` crosses a line, and each one's share before it."""
    half = 0.5 * hypot(*(line.points[1] - line.points[0]))
    middle, across = line.points.mean(axis=0), (line.points[1] - line.points[0]) / max(2.0 * half, 1e-9)
    normal = np.array([across[1], -across[0]])
    if turned(road.lanes[line.lane], float(middle[0]), float(middle[1]), atan2(normal[1], normal[0])) > 0.5 * np.pi:
        normal = -normal
    ahead, beside = (front - middle) @ normal, (front - middle) @ across
    for k in np.flatnonzero(within & (ahead[:-1] < 0.0) & (ahead[1:] >= 0.0)).tolist():
        u = float(ahead[k] / (ahead[k] - ahead[k + 1]))
        if abs(beside[k] + u * (beside[k + 1] - beside[k])) <= half + ASIDE_M:
            yield k, u


def _counts(line: StopLine, road: Road, x: FloatArray, y: FloatArray, yaw: FloatArray) -> bool:
    """Whether a line applies to the way `(k,)` behind it; it does where the way is on none of the lanes after it."""
    if not line.towards:
        return True
    ways = [i for i in road.lanes[line.lane].successors if i in road.lanes]
    on = {i: int(on_lane(road.lanes[i], x, y, yaw).sum()) for i in ways}
    return not any(on.values()) or max(ways, key=lambda i: (on[i], -i)) in line.towards


@kernel
def _gaps(paths: Paths, station: FloatArray, phase: FloatArray, owner: IntArray, at: FloatArray) -> FloatArray:
    """Length of path `(k,)` from each owner's phase `(k,)` to the station `at` `(k,)`, m."""
    out = np.empty(len(owner))
    for c in range(len(owner)):
        first, end = paths.first[owner[c]], paths.end[owner[c]]
        now = phase[c]
        k = min(max(first, first + np.searchsorted(paths.t[first:end], now, side="right") - 1), end - 2)
        u = min(max((now - paths.t[k]) / (paths.t[k + 1] - paths.t[k]), 0.0), 1.0)
        out[c] = at[c] - station[k] - u * (station[k + 1] - station[k])
    return out
