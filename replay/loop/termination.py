"""Why a closed loop ends: goal, collision, off the road. The loop itself ends at the log's end or a planner failure.

The metrics' rule of fault (`metrics.safety.classify`) decides whether a contact is the ego's collision or a replayed
agent ran into it; with several contacts at once, one at fault makes it a collision.
"""

from __future__ import annotations

from math import cos, inf, sin
from typing import NamedTuple

import numpy as np

from logs.kernel import FloatArray, IntArray, inner_kernel, kernel
from logs.memory import NearbyTracks
from logs.road import Goal, Road, RoadSource, inside
from logs.scenario import Scenario, Tracks
from logs.shapes import point_segment
from logs.states import TRAJECTORY_COLUMNS, EgoState, Trajectory
from logs.trace import EndReason
from metrics.boxes import name_of, phantoms, without_phantoms
from metrics.cut_in import LOOK_BACK_S
from metrics.safety import classify
from replay.vehicle.trace_rows import state_at
from replay.world import AgentBoxes, EgoBox, agent_boxes, box_center, ego_box, touched

CRACK_M = 0.5
"""Lanes that meet may leave a crack: off the road is who is farther than this from every drivable lane."""


class Outlines(NamedTuple):
    """Polygons, ragged: the i-th is `points[offsets[i] : offsets[i + 1]]`, points `(n, 2)`, m."""

    points: FloatArray
    offsets: IntArray


def outlines(polygons: list[FloatArray]) -> Outlines:
    """Polygons `(k, 2)` as one."""
    sizes = [len(polygon) for polygon in polygons]
    return Outlines(np.concatenate([np.zeros((0, 2)), *polygons]), np.cumsum([0, *sizes], dtype=np.int64))


@inner_kernel
def outline_distance(x: float, y: float, polygon: FloatArray) -> float:
    """Distance of a point from a polygon's outline `(n, 2)`, m."""
    best = inf
    j = len(polygon) - 1
    for i in range(len(polygon)):
        best = min(best, point_segment(x, y, polygon[j, 0], polygon[j, 1], polygon[i, 0], polygon[i, 1]))
        j = i
    return best


@kernel
def metres_off(lanes: Outlines, on: int, x: float, y: float) -> tuple[float, int]:
    """Distance of a point from the nearest lane, m, 0 on a lane and until it has been on one; the last lane it was on.

    Args:
        lanes: All that count.
        on: The last lane that it was on; -1: it never was.
        x: Of the point, m.
        y: Of the point, m.
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


class OffRoadMonitor:
    """Tells when a point that was on the road has left it; only lanes of the log are judged.

    Attributes:
        lanes: Those that count.
        on: The last one that the point was on; -1: it never was on any.
    """

    def __init__(self, road: Road) -> None:
        judged = road.source is RoadSource.LANES
        self.lanes = outlines([lane.polygon for lane in road.lanes.values() if lane.drivable and judged])
        self.on = -1

    def metres_off(self, x: float, y: float) -> float:
        """Distance from the nearest drivable lane, m; 0 on a lane, and until the point has been on one."""
        off, self.on = metres_off(self.lanes, self.on, x, y)
        return off


@kernel
def first_event(
    rows: FloatArray, first: int, end: int, car: EgoBox, agents: AgentBoxes,
    goal: tuple[float, float, float, float], lanes: Outlines, on: int,
) -> tuple[int, bool, float, int]:  # fmt: skip
    """The first of the rows from `first` to before `end` at which a drive may end (`end`: none), and what is there.

    Args:
        rows: Of the trace.
        first: Row.
        end: Row.
        car: The ego's box.
        agents: The others.
        goal: Least and greatest x, least and greatest y of the goal, m.
        lanes: As `metres_off`.
        on: As `metres_off`.

    Returns:
        Row, whether an agent is touched there, metres off the lanes there, the last lane that the ego was on.
    """
    contact, _ = touched(rows, first, end, car, agents)
    for k in range(first, min(contact + 1, end)):
        x, y = rows[k, 1] + car.ahead * cos(rows[k, 3]), rows[k, 2] + car.ahead * sin(rows[k, 3])
        off, on = metres_off(lanes, on, x, y)
        if k == contact or off > CRACK_M or (goal[0] <= x <= goal[1] and goal[2] <= y <= goal[3]):
            return k, k == contact, off, on
    return end, False, 0.0, on


class Ended(NamedTuple):
    """A drive's end: the row of the trace, the reason and its detail."""

    row: int
    reason: EndReason
    detail: str


class Termination:
    """Judges the rows of one drive's trace, in order.

    What the recorded ego stood in (`metrics.boxes`) is not touched.

    Args:
        scenario: What is driven.
        goal: Where the drive should end (the scenario's own, or one made for it); None: nowhere.
        start: The ego at the start, so that it is known whether it begins on the road.
    """

    def __init__(self, scenario: Scenario, goal: Goal | None, start: EgoState) -> None:
        self._scenario, self._car = scenario, ego_box(scenario.vehicle)
        if goal is not None and not goal.regions and goal.t is None and goal.v is None and goal.yaw is None:
            goal = None  # it asks for nothing: such a goal is never reached, since it always is
        self._goal = goal
        self._near = _surrounding(self._goal)
        self._phantoms = phantoms(scenario)
        self._monitor = OffRoadMonitor(scenario.road)
        self._monitor.metres_off(*box_center(start, scenario.vehicle))
        self._around, self._tracks = NearbyTracks(), Tracks.empty()
        self._agents = agent_boxes(self._tracks)

    def first(self, rows: FloatArray, first: int, end: int, tracks: Tracks) -> Ended | None:
        """The first end within the rows from `first` (at least 1) to before `end`; None while the drive goes on.

        At one row, a collision comes before the goal, and that before the road's edge.
        """
        if first >= end:
            return None
        near = self._around.of(tracks, rows[first, 0], rows[end - 1, 0])
        if near is not self._tracks:
            self._tracks, self._agents = near, agent_boxes(near, self._phantoms)
        monitor = self._monitor
        while first < end:
            k, hit, off, monitor.on = first_event(
                rows, first, end, self._car, self._agents, self._near, monitor.lanes, monitor.on
            )
            ended = self._judged(rows, k, off, tracks if hit else None) if k < end else None
            if ended:
                return ended
            first = k + 1
        return None

    def _judged(self, rows: FloatArray, k: int, off: float, touching: Tracks | None) -> Ended | None:
        if touching is not None:
            real, driven = without_phantoms(touching.whole, self._phantoms), rows[: k + 1]
            recent = driven[driven[:, 0] >= rows[k, 0] - LOOK_BACK_S]  # earlier touches would have ended the drive
            found = classify(Trajectory(*recent[:, : len(TRAJECTORY_COLUMNS)].T), real, self._scenario)
            worst = max(found, key=lambda touch: touch.at_fault, default=None)
            if worst is not None:
                name = name_of(real, worst.agent)
                if worst.at_fault:
                    return Ended(k, EndReason.COLLISION, name)
                return Ended(k, EndReason.REPLAY_CONTACT, f"{name}: {worst.kind.value}")
        ego = state_at(rows, k)
        x, y = box_center(ego, self._scenario.vehicle)
        if self._goal is not None and self._goal.reached(ego.t, x, y, ego.yaw, ego.v):
            return Ended(k, EndReason.GOAL, "")
        if off > CRACK_M:
            return Ended(k, EndReason.OFF_ROAD, f"box centre {off:.1f} m off the lanes at ({x:.1f}, {y:.1f})")
        return None


def _surrounding(goal: Goal | None) -> tuple[float, float, float, float]:
    """Least and greatest x and y at which a goal may be reached; NaN where there is none."""
    if goal is None:
        return (np.nan,) * 4
    if not goal.regions:
        return -inf, inf, -inf, inf
    points = np.concatenate(goal.regions)
    (x_lo, y_lo), (x_hi, y_hi) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return x_lo, x_hi, y_lo, y_hi
