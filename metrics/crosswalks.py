"""Crosswalks, closed loop: pedestrians on the ego's half of a crosswalk while the ego drives on it.

A pedestrian counts for each passage of the ego: inside the crosswalk's outline, and within
`HALF_LANE_M` of the path of the ego's centre. A passage that is under way when the drive begins is
left out. The pedestrians are those of the drive: replayed pedestrians do not wait for an ego that
does not wait.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import hypot

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.core.kernel import kernel
from replan.logs.agents import AgentKind
from replan.logs.polylines import inside
from replan.logs.rules import Crosswalk
from replan.logs.scenario import Scenario
from replan.logs.trace import Trace
from replan.metrics.boxes import EgoOutline, car_of, ego_boxes, name_of, present_between, some_at
from replan.metrics.metric import Measured, Unavailable, counted, metric
from replan.metrics.reductions import COUNT
from replan.metrics.stop_lines import REST_MPS

HALF_LANE_M = 1.75


@metric(
    unit="count",
    better="lower",
    reductions=(COUNT,),
    parameters=(f"half a lane {HALF_LANE_M} m", f"drives above {REST_MPS} m/s"),
    needs="a crosswalk",
    source="StVO 26 (1): who evidently wants to cross is let cross",
)
def crosswalk(trace: Trace, scenario: Scenario) -> Measured:
    """Pedestrians who were on the ego's half of a crosswalk while it drove over it.

    Formula: sum over passages of the pedestrians on the ego's half
    """
    if not scenario.road.crosswalks:
        return Unavailable("the log has no crosswalk")
    events: list[tuple[int, str]] = []
    pedestrians = np.flatnonzero([kind is AgentKind.PEDESTRIAN for kind in trace.agents.kinds])
    ego = ego_boxes(trace.ego, scenario)
    for crossing in scenario.road.crosswalks if len(pedestrians) else ():
        over = _over(ego, car_of(scenario), crossing.polygon)
        change = np.flatnonzero(np.diff(np.r_[False, over, False].astype(int))).tolist()
        for first, end in zip(change[::2], change[1::2], strict=True):
            if first > 0:  # else it is under way when the drive begins
                events += _passage(crossing, trace, ego, pedestrians, first, end)
    return counted(trace.ego.t, events)


def _passage(
    crossing: Crosswalk,
    trace: Trace,
    ego: FloatArray,
    pedestrians: IntArray,
    first: int,
    end: int,
) -> Iterator[tuple[int, str]]:
    """Yield step and label of each pedestrian of one passage, from step `first` to before `end`."""
    t = trace.ego.t[first:end]
    path = np.ascontiguousarray(ego[:2, first:end])
    # As a straight line: the path over a crosswalk is short
    dx, dy = path[:, -1] - path[:, 0]
    length = hypot(dx, dy)
    present = np.intersect1d(pedestrians, present_between(trace.agents, t[0], t[-1]))
    others = some_at(trace.agents, present, t)
    drives = np.abs(trace.ego.v[first:end]) > REST_MPS
    for row, agent in enumerate(present.tolist()):
        position = others.pose[:2, row]
        near = np.zeros(end - first, np.bool_)  # on the crosswalk and near the ego's path
        for k in np.flatnonzero(np.isfinite(position[0])):
            x, y = float(position[0, k]), float(position[1, k])
            ahead, left = x - path[0, 0], y - path[1, 0]
            beside = hypot(ahead, left)
            if length >= 1e-6:
                beside = abs(ahead * dy - left * dx) / length
            near[k] = inside(x, y, crossing.polygon) and beside <= HALF_LANE_M
        near &= others.there[row] & drives
        if near.any():
            label = f"crosswalk {crossing.id}: {name_of(trace.agents, agent)}"
            yield first + int(np.argmax(near)), label


@kernel
def _over(ego: FloatArray, car: EgoOutline, polygon: FloatArray) -> BoolArray:
    """Return the steps at which a box (rows x, y, yaw) overlaps a polygon, tested at 9 by 5 points
    of the box.
    """
    overlaps = np.zeros(ego.shape[1], np.bool_)
    for k in range(ego.shape[1]):
        c, s = np.cos(ego[2, k]), np.sin(ego[2, k])
        for i in range(45):
            along, left = (i // 5 / 8.0 - 0.5) * car.length, (i % 5 / 4.0 - 0.5) * car.width
            if inside(ego[0, k] + along * c - left * s, ego[1, k] + along * s + left * c, polygon):
                overlaps[k] = True
                break
    return overlaps
