"""Right of way: an agent on a lane that yields (`Lane.yields_to`) waits for the ego on a lane with priority.

The ego is predicted along its lanes (`replay.prediction`, every way that it may take) for `LOOK_AHEAD_S`. Its boxes on
a lane with priority are places that it holds by right. An agent that is on the yielding lane, or comes to it, goes on
as in its log, but no faster than its speed v allows: with the distance s from here and a = `following.ACCEL_MPS2`, it
arrives after

(1) tau(s) = max(time of the log to there, (sqrt(v^2 + 2 a s) - v) / a)

It waits where its box would reach such a place within `SERIOUS_S` before or after the ego (a post-encroachment time
below 1 s violates the right of way: `metrics.rules`), if it can stop with `following.HARDEST_MPS2` before all of the
ego's way, held by right or not: a standing leader is placed there. An agent that cannot stop, or is there already,
drives on.
"""

from __future__ import annotations

from math import cos, hypot, sin, sqrt
from typing import NamedTuple

import numpy as np

from logs.kernel import BoolArray, FloatArray, IntArray, inner_kernel, kernel
from logs.route import on_lane
from logs.scenario import AgentKind, Agents, Scenario, Tracks
from logs.shapes import overlap_turned
from logs.states import EgoState
from metrics.rules import SERIOUS_S
from replay.prediction import LaneMap
from replay.prediction.lane_following import followers
from replay.traffic.following import ACCEL_MPS2, FINE_M, HARDEST_MPS2, Paths, paths_along, places
from replay.world import ROUNDING_M, box_center

LOOK_AHEAD_S, STEP_S = 6.0, 0.25
"""Horizon of the ego's prediction (a stop from 13.9 m/s with 3 m/s2 takes 4.6 s), and the time between two boxes."""


class Way(NamedTuple):
    """An agent's way over a yielding lane: its index, the lanes with priority, when its log leaves the lane (s)."""

    owner: int
    first: tuple[int, ...]
    until: float


class Yielding:
    """See the module docstring.

    Args:
        scenario: Its road and the ego's size.
        paths: The logged paths, each extended along its lane.
        reacts: `(n,)` which agents may drive by the model.
        lanes: Of the road; the ego is predicted along them.
    """

    def __init__(self, scenario: Scenario, paths: Tracks, reacts: BoolArray, lanes: LaneMap) -> None:
        self._road, self._car, self._tracks, self._lanes = scenario.road, scenario.vehicle, paths, lanes
        self._paths = paths_along(paths)
        self._ways: list[Way] = []
        for i in np.flatnonzero(reacts).tolist():
            mine = paths.samples(i)
            for lane in scenario.road.lanes.values():
                first = tuple(k for k in lane.yields_to if k in scenario.road.lanes)
                on = on_lane(lane, paths.x[mine], paths.y[mine], paths.yaw[mine]) if first else np.zeros(1, np.bool_)
                if on.any():
                    self._ways.append(Way(i, first, float(paths.t[mine][on].max())))
        self._owner = np.array([way.owner for way in self._ways], np.int64)
        self._until = np.array([way.until for way in self._ways])

    def gaps(self, ego: EgoState, who: IntArray, phase: FloatArray, speed: FloatArray, whose: BoolArray) -> FloatArray:
        """Distance of the tracks `who` (those `whose`) to where they must wait for the ego `(k,)`, m; inf: no wait."""
        out = np.full(len(phase), np.inf)
        if not self._ways:
            return out
        at = places(who, self._owner)
        some = (at >= 0) & np.append(whose, False)[at]
        some &= np.append(phase, np.nan)[at] <= self._until + 1e-9
        ways = [(self._ways[k], at[k]) for k in np.flatnonzero(some)]
        if not ways:
            return out
        boxes, on = self._boxes({k for way, _ in ways for k in way.first}, ego)
        size = np.array([self._car.length, self._car.width])
        for way, k in ways:
            i = way.owner
            by_right = np.logical_or.reduce([on[lane] for lane in way.first])
            if by_right.any():
                own = np.array([self._tracks.length[i], self._tracks.width[i]])
                out[k] = min(out[k], _wait(self._paths, i, phase[k], speed[k], own, boxes, by_right, size))
        return out

    def _boxes(self, first: set[int], ego: EgoState) -> tuple[FloatArray, dict[int, BoolArray]]:
        """Time, x, y and yaw of the ego's boxes `(4, k)` on all its ways; which are on each lane with priority."""
        x, y = box_center(ego, self._car)
        t = np.arange(0.0, LOOK_AHEAD_S + 0.5 * STEP_S, STEP_S)
        vx, vy = ego.v * cos(ego.yaw), ego.v * sin(ego.yaw)
        own = (self._car.length, self._car.width, x, y, ego.yaw, vx, vy, ego.yaw_rate, ego.a)
        now = Agents(("ego",), (AgentKind.CAR,), *(np.array([value]) for value in own))
        ways = followers(now, t, self._lanes)
        rows = np.stack([np.broadcast_to(t, ways.x.shape), ways.x, ways.y, ways.yaw]).reshape(4, -1)
        return rows, {k: on_lane(self._road.lanes[k], *rows[1:]) for k in sorted(first)}


@kernel
def _wait(
    paths: Paths, i: int, phase: float, speed: float, own: FloatArray,
    boxes: FloatArray, by_right: BoolArray, size: FloatArray,
) -> float:  # fmt: skip
    """Distance of agent i to the first of the boxes `(4, k)` if it must and can wait for one, m; else inf."""
    first, end = paths.first[i], paths.end[i]
    station, clear, place, meets = 0.0, 0.0, np.inf, False
    c2, s2 = np.cos(boxes[3]), np.sin(boxes[3])
    near = 0.5 * (hypot(own[0], own[1]) + hypot(size[0], size[1])) + ROUNDING_M
    for k in range(max(first, first + np.searchsorted(paths.t[first:end], phase, side="right") - 1), end - 1):
        span, length = paths.t[k + 1] - paths.t[k], hypot(paths.x[k + 1] - paths.x[k], paths.y[k + 1] - paths.y[k])
        start = max((phase - paths.t[k]) / span, 0.0)
        steps = int((1.0 - start) * length / FINE_M) + 1
        for m in range(steps + 1):
            u = start + (1.0 - start) * m / steps
            s = station + (u - start) * length
            # (1)
            tau = max(paths.t[k] + u * span - phase, (sqrt(speed * speed + 2.0 * ACCEL_MPS2 * s) - speed) / ACCEL_MPS2)
            if tau > LOOK_AHEAD_S:
                return _place(speed, place, meets)
            x, y = paths.x[k] + u * (paths.x[k + 1] - paths.x[k]), paths.y[k] + u * (paths.y[k + 1] - paths.y[k])
            yaw, free = paths.yaw[k] + u * (paths.yaw[k + 1] - paths.yaw[k]), True
            c1, s1 = cos(yaw), sin(yaw)
            for b in range(boxes.shape[1]):
                if (boxes[1, b] - x) ** 2 + (boxes[2, b] - y) ** 2 <= near * near and overlap_turned(
                    x, y, c1, s1, own[0], own[1], boxes[1, b], boxes[2, b], c2[b], s2[b], size[0], size[1]
                ):
                    free, meets = False, meets or (by_right[b] and abs(boxes[0, b] - tau) <= SERIOUS_S)
            if free and not np.isfinite(place):
                clear = s
            elif not free and not np.isfinite(place):
                place = clear
        station += (1.0 - start) * length
    return _place(speed, place, meets)


@inner_kernel
def _place(speed: float, place: float, meets: bool) -> float:
    """The place where it must wait, if it must and can; else inf."""
    return place if meets and speed * speed <= 2.0 * HARDEST_MPS2 * place and place > 0.0 else np.inf
