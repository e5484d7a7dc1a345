"""Turns from CommonRoad lanelets to their successors: those of the intersections, else by the
change of heading on the successor.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from math import atan2, radians

from replan.core.arrays import FloatArray
from replan.logs.readers.commonroad.document_records import Document
from replan.logs.road import Road
from replan.logs.states import wrap

TURNING = radians(30.0)
"""Change of heading from which a successor turns to the left or right, rad."""

Turns = Mapping[tuple[int, int], str]
"""Turn ("left", "straight" or "right") by lanelet and successor."""


def turns_of(document: Document, road: Road) -> Turns:
    """Return the turn by lanelet and successor: from the intersections, else by the change of
    heading.
    """
    turns: dict[tuple[int, int], str] = {}
    for intersection in document.intersections:
        for incoming in intersection.incomings:
            for lanelet, (successor, turn) in product(incoming.lanelets, incoming.successors):
                turns[lanelet, successor] = turn
    for lane in road.lanes.values():
        for successor in lane.successors:
            if successor in road.lanes:
                ahead = road.lanes[successor].center
                gained = wrap(_heading(ahead[-2:]) - _heading(ahead[:2]))
                turn = "left" if gained > 0.0 else "right"
                if abs(gained) < TURNING:
                    turn = "straight"
                turns.setdefault((lane.id, successor), turn)
    return turns


def _heading(points: FloatArray) -> float:
    return atan2(points[-1, 1] - points[0, 1], points[-1, 0] - points[0, 0])
