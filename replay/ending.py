"""Why a closed loop ends: goal, collision, off the road; the log's end and the planner's failure are the loop's own.

Whether a touch is the ego's collision, or the replay ran into it, is said by the metrics' rule of fault
(`metrics.safety.classify`); where several are touched at once, one fault makes it a collision.
"""

from __future__ import annotations

from math import inf

import numpy as np

from logs.kernel import FloatArray, kernel
from logs.road import Goal, Lane, Road, RoadSource, inside
from logs.scenario import Scenario
from logs.shapes import point_segment
from logs.states import TRAJECTORY_COLUMNS, Trajectory
from logs.trace import EndReason
from metrics.others import name_of
from metrics.phantoms import phantoms, without_phantoms
from metrics.safety import Contact, classify
from replay.world import World, box_center, contact

CRACK_M = 0.5
"""Lanes that meet may leave a crack: off the road is who is farther than this from every drivable lane."""


@kernel
def outline_distance(x: float, y: float, polygon: FloatArray) -> float:
    """Distance of a point from a polygon's outline `(n, 2)`, m."""
    best = inf
    j = len(polygon) - 1
    for i in range(len(polygon)):
        best = min(best, point_segment(x, y, polygon[j, 0], polygon[j, 1], polygon[i, 0], polygon[i, 1]))
        j = i
    return best


class RoadWatch:
    """Tells when a point that was on the road has left it; only lanes of the log are judged."""

    def __init__(self, road: Road) -> None:
        self._lanes = [lane for lane in road.lanes.values() if lane.drivable]
        self._judged = road.source is RoadSource.LANES
        self._lane: Lane | None = None

    def metres_off(self, x: float, y: float) -> float:
        """Distance from the nearest drivable lane, m; 0 on a lane, and until the point has been on one."""
        if not self._judged or (self._lane is not None and inside(x, y, self._lane.polygon)):
            return 0.0
        found = next((lane for lane in self._lanes if inside(x, y, lane.polygon)), None)
        if found is None and self._lane is not None:
            return min(outline_distance(x, y, lane.polygon) for lane in self._lanes)
        self._lane = found
        return 0.0


class Ending:
    """Judges the world after each control step of one drive.

    Args:
        scenario: What is driven.
        goal: Where the drive should end (the scenario's own, or one made for it); None: nowhere.
        start: The world at the start, so that it is known whether the ego begins on the road, and touches anybody.
    """

    def __init__(self, scenario: Scenario, goal: Goal | None, start: World) -> None:
        self._scenario, self._vehicle, self._before = scenario, scenario.vehicle, start.ego
        self._goal = goal if goal is not None and _asks(goal) else None
        self._watch = RoadWatch(scenario.road)
        self._phantoms = phantoms(scenario)
        self._watch.metres_off(*box_center(start.ego, self._vehicle))

    def of(self, world: World) -> tuple[EndReason, str] | None:
        """The reason and its detail, or None while the drive goes on; a collision comes before the rest.

        What the recorded ego stood in (`metrics.phantoms`) is not touched.
        """
        touched = self._touched(world)
        if touched:
            worst, name = max(touched, key=lambda found: found[0].at_fault)
            if worst.at_fault:
                return EndReason.COLLISION, name
            return EndReason.REPLAY_CONTACT, f"{name}: {worst.kind.value}"
        ego = world.ego
        x, y = box_center(ego, self._vehicle)
        if self._goal is not None and self._goal.reached(ego.t, x, y, ego.yaw, ego.v):
            return EndReason.GOAL, ""
        off = self._watch.metres_off(x, y)
        if off > CRACK_M:
            return EndReason.OFF_ROAD, f"box centre {off:.1f} m off the lanes at ({x:.1f}, {y:.1f})"
        return None

    def _touched(self, world: World) -> list[tuple[Contact, str]]:
        """The touches of the step that led to this world, each with the agent's name; earlier ones ended the drive."""
        before, self._before = self._before, world.ego
        if contact(world, self._vehicle, self._phantoms) < 0:
            return []
        states = (before, world.ego)
        columns = (np.array([getattr(state, name) for state in states]) for name in TRAJECTORY_COLUMNS)
        real = without_phantoms(world.tracks, self._phantoms)
        found = classify(Trajectory(*columns), real, self._scenario)
        return [(touch, name_of(real, touch.agent)) for touch in found]


def _asks(goal: Goal) -> bool:
    """Whether a goal asks for anything: one that does not is never reached, since it always is."""
    return bool(goal.regions) or not (goal.t is None and goal.v is None and goal.yaw is None)
