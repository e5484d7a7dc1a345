"""Leaving the road, closed loop: how far the ego's outline is off the drivable lanes.

The outline is tested at points at most `OUTLINE_M` apart, including its corners. This also detects
the corner of a kerb that reaches into the side of a turning car; anything inside the box has
crossed its outline.
"""

from __future__ import annotations

from itertools import pairwise
from math import ceil

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.kernel import kernel
from replan.logs.lane_arrays import LaneArrays
from replan.logs.road import RoadSource
from replan.logs.scenario import Scenario
from replan.logs.trace import Trace
from replan.logs.vehicle import VehicleParameters
from replan.metrics.boxes import ego_boxes
from replan.metrics.lanes import drivable_lanes, off_lanes
from replan.metrics.metric import Measured, Series, Unavailable, metric
from replan.metrics.reductions import MAX, time_above

OFF_ROAD_M = 0.3
OUTLINE_M = 0.25  # Between two points the outline is at most half of this farther off than at them


def known_lanes(scenario: Scenario) -> LaneArrays | Unavailable:
    """Return the lanes that a car may drive on, if the log has lanes."""
    if scenario.road.source is RoadSource.DRIVEN_PATH:
        return Unavailable("the log has no lanes: the road's edge is not known")
    return drivable_lanes(scenario.road) or Unavailable(
        "the log has no lane on which a car may drive"
    )


def box_off_lanes(
    lanes: LaneArrays, box: FloatArray, vehicle: VehicleParameters, step: float = OUTLINE_M
) -> FloatArray:
    """Return the greatest distance `(k,)` of a box's outline (centre, yaw: `(3 or more, k)`) to the
    drivable lanes, m.

    `step` is the greatest distance between two points of the outline, m; inf: only the corners.
    """
    ends = (
        0.5
        * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]])
        * [vehicle.length, vehicle.width]
    )
    sides = [
        np.linspace(a, b, max(ceil(np.hypot(*(b - a)) / step), 1), False) for a, b in pairwise(ends)
    ]
    x, y, yaw = box[:3]
    return _farthest_off(lanes, x, y, np.cos(yaw), np.sin(yaw), np.vstack(sides))


@kernel
def _farthest_off(
    lanes: LaneArrays,
    x: FloatArray,
    y: FloatArray,
    c: FloatArray,
    s: FloatArray,
    outline: FloatArray,
) -> FloatArray:
    """Return the greatest `off_lanes` of an outline's points (ahead, left) at poses with cosine c
    and sine s of yaw.
    """
    worst = np.zeros(len(x))
    for i in range(len(outline)):
        ahead, left = outline[i, 0], outline[i, 1]
        worst = np.maximum(
            worst, off_lanes(lanes, x + ahead * c - left * s, y + ahead * s + left * c)
        )
    return worst


@metric(
    unit="m",
    better="lower",
    reductions=(MAX, time_above(OFF_ROAD_M, "time_beyond_30cm")),
    parameters=(f"bound {OFF_ROAD_M} m", f"points at most {OUTLINE_M} m apart"),
    needs="lanes in the log",
    source="bound 0.3 m: nuPlan devkit e9241677, drivable_area_compliance (its corners alone)",
    version=2,
)
def off_road(trace: Trace, scenario: Scenario) -> Measured:
    """Greatest distance of the ego's outline from the drivable lanes.

    Formula: max over points of the outline of the distance to the nearest drivable lane
    """
    lanes = known_lanes(scenario)
    if isinstance(lanes, Unavailable):
        return lanes
    boxes = ego_boxes(trace.ego, scenario)
    return Series(trace.ego.t, box_off_lanes(lanes, boxes, scenario.vehicle))
