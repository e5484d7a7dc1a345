"""What NAVSIM's scores see of a log in one window: the lanes and the route, the other road users,
the red lights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, pi
from typing import NamedTuple

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, arc_lengths
from replan.core.kernel import inner_kernel, kernel
from replan.core.once import once
from replan.logs.agents import AgentKind
from replan.logs.polylines import along_line, inside
from replan.logs.route import straight_on
from replan.logs.rules import RED
from replan.logs.scenario import Scenario
from replan.logs.shapes import distance, overlap
from replan.logs.states import wrap, wrapped
from replan.logs.tracks import Tracks
from replan.metrics.boxes import ego_boxes, others_at
from replan.metrics.devkit_lanes import DevkitLanes
from replan.metrics.nuplan_closed_loop import route_lanes

STEP_S, SAMPLE_S = 0.1, 0.5
NEAR_M, BEYOND_M = 100.0, 100.0


@dataclass(frozen=True, eq=False)
class RoadblockRoute:
    """The roadblocks that the log's driver comes through and those beyond, in order, and their
    lanes (by index).
    """

    blocks: tuple[int, ...]
    lanes: frozenset[int]


@once
def route_of(scenario: Scenario, lanes: DevkitLanes) -> RoadblockRoute:
    """Return the route that the log names; else that of its driver, and on straight for `BEYOND_M`.

    nuPlan's routes do not end with a log.
    """
    index = {lane.id: i for i, lane in enumerate(lanes.lanes)}
    if named := [lanes.block[index[i]] for i in scenario.road.route if i in index]:
        return _through(lanes, named)
    x, y, *_ = ego_boxes(scenario.ego, scenario)
    first = route_lanes(lanes, x, y)
    blocks = list(dict.fromkeys(lanes.block[i] for i in first))
    last, beyond = first[-1] if first else None, 0.0
    while last is not None and beyond < BEYOND_M:
        successor = straight_on(scenario.road, lanes.lanes[last].id)
        last = None if successor is None else index[successor]
        if last is None or lanes.block[last] in blocks:
            break
        blocks.append(lanes.block[last])
        beyond += lanes.lanes[last].length
    return _through(lanes, blocks)


def _through(lanes: DevkitLanes, blocks: Sequence[int]) -> RoadblockRoute:
    route = tuple(dict.fromkeys(blocks))
    on_route = frozenset(i for i, block in enumerate(lanes.block) if block in route)
    return RoadblockRoute(route, on_route)


@dataclass(frozen=True, eq=False)
class Polyline:
    """A polyline with headings: points `(n, 2)`, unwrapped headings and stations `(n,)`."""

    points: FloatArray
    yaw: FloatArray
    s: FloatArray

    @classmethod
    def through(cls, points: FloatArray, yaw: FloatArray) -> Polyline:
        """A path through points with headings."""
        stations = arc_lengths(*points.T)
        return cls(np.ascontiguousarray(points), np.unwrap(yaw), stations)

    def beside(self, offset: float) -> Polyline:
        """The path `offset` m to the left."""
        left = np.column_stack([np.cos(self.yaw + 0.5 * pi), np.sin(self.yaw + 0.5 * pi)])
        return Polyline.through(self.points + offset * left, self.yaw)

    def at(self, s: FloatArray) -> FloatArray:
        """Return x, y, yaw `(k, 3)` at stations."""
        s = np.clip(s, 1e-5, self.s[-1])
        columns = [np.interp(s, self.s, column) for column in (*self.points.T, self.yaw)]
        columns[2] = wrapped(columns[2])
        return np.column_stack(columns)

    def station(self, x: float, y: float) -> float:
        """Return the station of the point nearest to (x, y)."""
        return float(along_line(self.points, np.array([x]), np.array([y]))[0][0])


def center_line(
    lanes: DevkitLanes, route: RoadblockRoute, x: float, y: float, yaw: float
) -> tuple[int, Polyline]:
    """Return the lane at which PDM-Closed begins, and its centre line to the end of the route.

    The lane is the best aligned one of the route under the rear axle, else the nearest one; the way
    is the shortest by successors on the route, else the longest chain of them.
    """
    ends = {}
    for i in route.lanes:
        center = lanes.lanes[i].center
        directions = np.arctan2(*np.diff(center, axis=0).T[::-1])
        ends[i] = center, np.r_[directions, directions[-1]]
    under = [i for i in sorted(route.lanes) if lanes.under(np.array([x]), np.array([y]))[i, 0]]

    def misaligned(i: int) -> float:
        points, headings = ends[i]
        return abs(float(wrap(headings[np.argmin(np.hypot(*(points - [x, y]).T))] - yaw)))

    def away(i: int) -> float:
        return float(along_line(lanes.lanes[i].center, np.array([x]), np.array([y]))[1][0])

    start = min(under, key=misaligned) if under else min(sorted(route.lanes), key=away)
    length_to, queue, settled = {start: 1.0}, [start], set[int]()
    reached: dict[int, tuple[int, ...]] = {start: (start,)}
    last: tuple[int, ...] = (start,)
    while queue:
        lane = min(queue, key=lambda i: length_to[i])
        queue.remove(lane)
        settled.add(lane)
        last = max(last, reached[lane], key=len)
        if lanes.block[lane] == route.blocks[-1]:
            last = reached[lane]
            break
        for successor in lanes.after[lane]:
            length = length_to[lane] + lanes.lanes[successor].length
            if successor not in route.lanes or successor in settled:
                continue
            if length < length_to.get(successor, inf):
                length_to[successor], reached[successor] = length, (*reached[lane], successor)
                queue += [successor] if successor not in queue else []
    points, headings = zip(*(ends[i] for i in last), strict=True)
    return start, Polyline.through(np.vstack(points), np.concatenate(headings))


class WindowAgents(NamedTuple):
    """Road users of a window at k steps of 0.1 s."""

    there: BoolArray  # `(n, k)`; `pose` `(3, n, k)`: x, y, yaw
    pose: FloatArray
    speed: FloatArray  # `(n,)` when first seen; `agent` `(n,)` whether it can move; `size` `(n, 2)`
    agent: BoolArray
    size: FloatArray

    def apart(self, box: tuple[float, float, float, float, float]) -> WindowAgents:
        """Return them without those that touch the ego's box (centre x, y, yaw, length, width) at
        the first step.
        """
        touching = [
            bool(self.there[i, 0]) and overlap(*box, *self.pose[:, i, 0], *self.size[i])
            for i in range(len(self.size))
        ]
        return WindowAgents(
            self.there & ~np.array(touching, np.bool_)[:, None],
            self.pose,
            self.speed,
            self.agent,
            self.size,
        )


def _movable(tracks: Tracks) -> BoolArray:
    return np.array([kind is not AgentKind.OBJECT for kind in tracks.kinds], np.bool_)


def logged_others(scenario: Scenario, t: float, lasts: float) -> WindowAgents:
    """Return the road users as logged: samples every 0.5 s, linear between.

    One that is seen once stays.
    """
    tracks, samples = scenario.tracks, t + SAMPLE_S * np.arange(round(lasts / SAMPLE_S) + 1)
    sampled, steps = others_at(tracks, samples), round(lasts / STEP_S) + 1
    fine = STEP_S * np.arange(steps)
    is_there, pose = np.zeros((len(tracks), steps), np.bool_), np.zeros((3, len(tracks), steps))
    speed = np.zeros(len(tracks))
    for i in np.flatnonzero(sampled.there.any(axis=1)).tolist():
        seen = np.flatnonzero(sampled.there[i])
        times, rows = SAMPLE_S * seen, sampled.pose[:3, i, seen].copy()
        rows[2] = np.unwrap(rows[2])
        is_there[i] = (len(seen) == 1) | ((fine >= times[0] - 1e-9) & (fine <= times[-1] + 1e-9))
        pose[:, i] = [np.interp(fine, times, row) for row in rows]
        speed[i] = np.hypot(*sampled.pose[3:, i, seen[0]])
    return WindowAgents(is_there, pose, speed, _movable(tracks), sampled.size)


def predicted_others(scenario: Scenario, t: float, x: float, y: float, steps: int) -> WindowAgents:
    """Return the road users within `NEAR_M` as PDM-Closed predicts them: at constant speed ahead,
    every 0.2 s.
    """
    others, agent = others_at(scenario.tracks, np.array([t])), _movable(scenario.tracks)
    px, py, yaw, vx, vy = np.nan_to_num(others.pose[:, :, 0])
    speed = np.where(agent, np.hypot(vx, vy), 0.0)
    direction = yaw + pi * (np.abs(wrapped(yaw - np.arctan2(vy, vx))) >= 0.5 * pi)
    moved = speed[:, None] * STEP_S * (2 * (np.arange(steps) // 2))
    still = np.repeat(yaw[:, None], steps, axis=1)
    pose = np.stack(
        [
            px[:, None] + np.cos(direction)[:, None] * moved,
            py[:, None] + np.sin(direction)[:, None] * moved,
            still,
        ]
    )
    near = others.there[:, 0] & (np.hypot(px - x, py - y) <= NEAR_M)
    return WindowAgents(np.repeat(near[:, None], steps, axis=1), pose, speed, agent, others.size)


def red_lanes(
    scenario: Scenario, lanes: DevkitLanes, route: RoadblockRoute, t: float
) -> frozenset[int]:
    """Return the lanes of the route behind stop lines whose light is red."""
    red = {light.id for light in scenario.lights if light.at(t) in RED}
    ids = {lane.id: i for i, lane in enumerate(lanes.lanes)}
    behind: set[int] = set()
    for line in scenario.road.stop_lines:
        if line.light in red:
            successors = scenario.road.lanes[line.lane].successors
            behind |= {lane for lane in successors if not line.towards or lane in line.towards}
    return route.lanes & {ids[lane] for lane in behind if lane in ids}


@kernel
def box_on_polygon(
    x: float, y: float, yaw: float, length: float, width: float, polygon: FloatArray
) -> float:
    """Return the distance of a box from a polygon `(n, 2)`, m; 0 where they touch."""
    if inside(x, y, polygon):
        return 0.0
    best, j = inf, len(polygon) - 1
    for i in range(len(polygon)):
        best = min(best, _box_to_segment(x, y, yaw, length, width, polygon[j], polygon[i]))
        j = i
    return best


@inner_kernel
def _box_to_segment(
    x: float, y: float, yaw: float, length: float, width: float, a: FloatArray, b: FloatArray
) -> float:
    dx, dy = b[0] - a[0], b[1] - a[1]
    mid_x, mid_y, span = 0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), np.hypot(dx, dy)
    return distance(x, y, yaw, length, width, mid_x, mid_y, np.arctan2(dy, dx), span, 0.0)


@kernel
def in_corridor(
    line: FloatArray, half: float, x: float, y: float, yaw: float, length: float, width: float
) -> bool:
    """Whether a box touches the corridor of `half` m to both sides of a polyline, and beyond its
    ends.
    """
    last = len(line) - 1
    for k in range(last):
        dx, dy = line[k + 1, 0] - line[k, 0], line[k + 1, 1] - line[k, 1]
        segment = np.hypot(dx, dy)
        if segment == 0.0:
            continue
        before, after = half if k == 0 else 0.0, half if k == last - 1 else 0.0
        shift = 0.5 * (after - before)
        mid_x = 0.5 * (line[k, 0] + line[k + 1, 0]) + shift * dx / segment
        mid_y = 0.5 * (line[k, 1] + line[k + 1, 1]) + shift * dy / segment
        if overlap(
            mid_x,
            mid_y,
            np.arctan2(dy, dx),
            segment + before + after,
            2.0 * half,
            x,
            y,
            yaw,
            length,
            width,
        ):
            return True
    return False


def centroid(polygon: FloatArray) -> tuple[float, float]:
    """Return the centroid of the area of a polygon `(n, 2)`."""
    x, y = (polygon - polygon[0]).T
    area = x * np.roll(y, -1) - np.roll(x, -1) * y
    whole = 3.0 * area.sum()
    cx, cy = (((axis + np.roll(axis, -1)) * area).sum() / whole for axis in (x, y))
    return float(polygon[0, 0] + cx), float(polygon[0, 1] + cy)
