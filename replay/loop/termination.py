"""Ends a closed loop: goal, collision, off the road. The loop itself ends at the log's end or a
planner failure.

The metrics' rule of fault (`replan.metrics.collisions.classify`) decides whether a contact is a
collision of the ego or a replayed agent ran into it. Of several simultaneous contacts, one at fault
makes it a collision.
"""

from __future__ import annotations

from math import cos, inf, sin
from typing import NamedTuple

import numpy as np

from replan.core.arrays import FloatArray, IntArray
from replan.core.kernel import inner_kernel, kernel
from replan.logs.nearby_tracks import NearbyTracks
from replan.logs.polylines import inside
from replan.logs.road import Goal, RoadSource
from replan.logs.scenario import Scenario
from replan.logs.shapes import point_segment
from replan.logs.states import TRAJECTORY_COLUMNS, EgoState
from replan.logs.trace import EndReason
from replan.logs.tracks import Tracks
from replan.metrics.arrival import Arrival
from replan.metrics.boxes import name_of, phantoms, without_phantoms
from replan.metrics.collisions import classify
from replan.metrics.cut_in import LOOK_BACK_S
from replan.replay.loop.contacts import AgentBoxes, EgoBox, agent_boxes, ego_box, touched
from replan.replay.vehicle.state_records import Records, state_at, trajectory_of
from replan.replay.world import box_center

CRACK_M = 0.5
"""A car farther than this from every drivable lane is off the road.

Adjoining lanes may leave small gaps.
"""


class Outlines(NamedTuple):
    """Polygons, ragged: the i-th is `points[offsets[i] : offsets[i + 1]]`, points `(n, 2)`, m."""

    points: FloatArray
    offsets: IntArray


@inner_kernel
def outline_distance(x: float, y: float, polygon: FloatArray) -> float:
    """Distance of a point from a polygon's outline `(n, 2)`, m."""
    best = inf
    j = len(polygon) - 1
    for i in range(len(polygon)):
        best = min(
            best, point_segment(x, y, polygon[j, 0], polygon[j, 1], polygon[i, 0], polygon[i, 1])
        )
        j = i
    return best


@kernel
def metres_off(lanes: Outlines, on: int, x: float, y: float) -> tuple[float, int]:
    """Return the distance of a point to the nearest lane, m (0 before its first lane), and the last
    lane it was on.

    `on` is the last lane that it was on; -1: it has not been on any lane.
    """
    points, offsets = lanes.points, lanes.offsets
    if on >= 0 and inside(x, y, points[offsets[on] : offsets[on + 1]]):
        return 0.0, on
    for i in range(len(offsets) - 1):
        if inside(x, y, points[offsets[i] : offsets[i + 1]]):
            return 0.0, i
    if on < 0:
        return 0.0, on
    best = inf
    for i in range(len(offsets) - 1):
        best = min(best, outline_distance(x, y, points[offsets[i] : offsets[i + 1]]))
    return best, on


@kernel
def first_event(
    rows: Records,
    first: int,
    end: int,
    car: EgoBox,
    agents: AgentBoxes,
    goal: tuple[float, float, float, float],
    lanes: Outlines,
    on: int,
) -> tuple[int, bool, float, int]:
    """The first of the rows from `first` to before `end` at which a drive may end (`end`: none),
    and what is there.

    `goal`: least and greatest x, least and greatest y, m; `lanes` and `on` as in `metres_off`.
    Returns the row, whether an agent is touched there, metres off the lanes there, and the last
    lane that the ego was on.
    """
    contact, _ = touched(rows, first, end, car, agents)
    low_x, high_x, low_y, high_y = goal
    for k in range(first, min(contact + 1, end)):
        ego = rows[k].ego
        x, y = ego.x + car.ahead * cos(ego.yaw), ego.y + car.ahead * sin(ego.yaw)
        off, on = metres_off(lanes, on, x, y)
        near_goal = low_x <= x <= high_x and low_y <= y <= high_y
        if k == contact or off > CRACK_M or near_goal:
            return k, k == contact, off, on
    return end, False, 0.0, on


class Ended(NamedTuple):
    """A drive's end: the row of the trace, the reason and its detail."""

    row: int
    reason: EndReason
    detail: str


class Termination:
    """Judges the rows of one drive's trace, in order.

    Phantoms (`replan.metrics.boxes`) are ignored.

    Args:
        scenario: The scenario.
        goal: Where the drive should end, and its way (`replan.metrics.arrival.goal_of`); None:
            nowhere.
        start: The ego at the start, so that it is known whether it begins on the road.
    """

    def __init__(self, scenario: Scenario, goal: Goal | None, start: EgoState) -> None:
        self._scenario, self._car = scenario, ego_box(scenario.vehicle)
        if (
            goal is not None
            and not goal.regions
            and goal.t is None
            and goal.v is None
            and goal.yaw is None
        ):
            goal = None  # a goal without conditions is ignored: it would always be reached
        self._arrival = None if goal is None else Arrival(scenario, goal)
        # Least and greatest x and y at which the goal may be reached; NaN: there is none
        self._near = (np.nan,) * 4
        if goal is not None:
            self._near = -inf, inf, -inf, inf
        if goal is not None and goal.regions:
            points = np.concatenate(goal.regions)
            (x_lo, y_lo), (x_hi, y_hi) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
            self._near = x_lo, x_hi, y_lo, y_hi
        self._phantoms = phantoms(scenario)
        judged = scenario.road.source is RoadSource.LANES  # only lanes of the log are judged
        polygons = [
            lane.polygon for lane in scenario.road.lanes.values() if lane.drivable and judged
        ]
        offsets = np.cumsum([0, *map(len, polygons)], dtype=np.int64)
        self._lanes = Outlines(np.concatenate([np.zeros((0, 2)), *polygons]), offsets)
        # The last lane it was on
        _, self._on = metres_off(self._lanes, -1, *box_center(start, scenario.vehicle))
        self._around, self._tracks = NearbyTracks(), Tracks.empty()
        self._agents = agent_boxes(self._tracks)

    def first(self, rows: Records, first: int, end: int, tracks: Tracks) -> Ended | None:
        """Return the first end within the rows from `first` (at least 1) to before `end`; None if
        the drive goes on.

        At one row, a collision has priority over the goal, and the goal over leaving the road.
        """
        if first >= end:
            return None
        egos = rows["ego"]
        near = self._around.of(tracks, egos[first].t, egos[end - 1].t)
        if near is not self._tracks:
            self._tracks, self._agents = near, agent_boxes(near, self._phantoms)
        while first < end:
            k, hit, off, self._on = first_event(
                rows, first, end, self._car, self._agents, self._near, self._lanes, self._on
            )
            if k >= end:
                break
            if hit:
                real, driven = without_phantoms(tracks.whole, self._phantoms), egos[: k + 1]
                # Earlier touches would have ended the drive
                recent = trajectory_of(driven[driven["t"] >= egos[k].t - LOOK_BACK_S])
                touches = classify(recent, real, self._scenario)
                worst = max(touches, key=lambda touch: touch.at_fault, default=None)
                if worst is not None:
                    name = name_of(real, worst.agent)
                    if worst.at_fault:
                        return Ended(k, EndReason.COLLISION, name)
                    return Ended(k, EndReason.REPLAY_CONTACT, f"{name}: {worst.kind.value}")
            if self._arrival is not None:
                columns = {name: egos[name] for name in TRAJECTORY_COLUMNS}
                if self._arrival.at(columns, k):
                    return Ended(k, EndReason.GOAL, "")
            if off > CRACK_M:
                x, y = box_center(state_at(rows, k), self._scenario.vehicle)
                return Ended(
                    k,
                    EndReason.OFF_ROAD,
                    f"box centre {off:.1f} m off the lanes at ({x:.1f}, {y:.1f})",
                )
            first = k + 1
        return None
