"""What nuPlan's maps call roadblocks and lane connectors, for every road, and the lanes of lights.

A connector is a lane in a junction: the log calls it so (`IN_JUNCTION`), or, in a log that calls
none so, it crosses another lane. So is, of a road, a lane beside a connector.

A group is a set of lanes beside each other in one direction, named by the least of their ids: as
the map has it, or, where a drivable lane has none,

(1) of lanes outside of junctions, those that are neighbours
(2) of connectors, those that lead from the same groups to the same groups. Groups within a junction
        are here those of neighbours, as are those of connectors that begin or end where the road
        does.

A light stands at a stop line, and controls the lanes that begin behind it: those that the line
names, else the successors of the lane that it lies across, else that lane itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.core.once import once
from replan.logs.road import IN_JUNCTION, Lane, Road


@once
def lane_groups(road: Road) -> dict[int, int]:
    """Return the group of each drivable lane, by id."""
    drivable = {lane.id: lane for lane in road.lanes.values() if lane.drivable}
    stated = {lane.id: lane.group for lane in drivable.values() if lane.group is not None}
    if len(stated) == len(drivable):
        return stated
    beside = _of_neighbours(drivable)
    return beside | _of_same_ends(drivable, connectors_of(road), beside)


def _of_neighbours(lanes: Mapping[int, Lane]) -> dict[int, int]:
    """Return the groups (1) of some lanes."""
    group = {name: name for name in lanes}
    changed = True
    while changed:
        changed = False
        for lane in lanes.values():
            beside = (lane.left_neighbour, lane.right_neighbour)
            members = [lane.id, *(i for i in beside if i is not None and i in lanes)]
            least = min(group[i] for i in members)
            for i in members:
                changed |= group[i] != least
                group[i] = least
    return group


def _of_same_ends(
    drivable: Mapping[int, Lane], inside: frozenset[int], beside: Mapping[int, int]
) -> dict[int, int]:
    """Return the groups (2) of the connectors that have lanes before and behind them."""
    before: dict[int, set[int]] = {name: set() for name in inside}
    behind: dict[int, set[int]] = {name: set() for name in inside}
    for lane in drivable.values():
        for after in drivable.keys() & lane.successors:
            if after in inside:
                before[after].add(beside[lane.id])
            if lane.id in inside:
                behind[lane.id].add(beside[after])
    members: dict[tuple[frozenset[int], frozenset[int]], list[int]] = {}
    for name in inside:
        if before[name] and behind[name]:
            ends = frozenset(before[name]), frozenset(behind[name])
            members.setdefault(ends, []).append(name)
    return {name: min(names) for names in members.values() for name in names}


def connectors(lanes: Sequence[Lane]) -> tuple[bool, ...]:
    """Return which lanes are in a junction."""
    in_junction = [IN_JUNCTION in lane.kind.split("+") for lane in lanes]
    if not any(in_junction) and lanes:
        x_low, y_low, x_high, y_high = np.array([lane.box for lane in lanes]).T[:, :, None]
        meets = (
            (x_low <= x_high.T) & (x_high >= x_low.T) & (y_low <= y_high.T) & (y_high >= y_low.T)
        )
        for i, j in np.argwhere(np.triu(meets, 1)):
            if _cross(lanes[i].center, lanes[j].center):
                in_junction[i] = in_junction[j] = True
    return tuple(in_junction)


@once
def connectors_of(road: Road) -> frozenset[int]:
    """Return the drivable lanes of a road that are in a junction, and those beside them."""
    lanes = [lane for lane in road.lanes.values() if lane.drivable]
    beside = _of_neighbours({lane.id: lane for lane in lanes})
    pairs = zip(lanes, connectors(lanes), strict=True)
    groups = {beside[lane.id] for lane, is_connector in pairs if is_connector}
    return frozenset(name for name, group in beside.items() if group in groups)


def complete_road(road: Road) -> Road:
    """Return a copy of the road in which each drivable lane has its group, and each connector
    `IN_JUNCTION` in its kind.
    """
    groups, in_junction, lanes = lane_groups(road), connectors_of(road), {}
    for lane in road.lanes.values():
        words = lane.kind.split("+")
        words += [IN_JUNCTION] if lane.id in in_junction and IN_JUNCTION not in words else []
        lanes[lane.id] = replace(lane, group=groups.get(lane.id), kind="+".join(words))
    return replace(road, lanes=lanes)


def lanes_of_lights(road: Road) -> dict[int, tuple[int, ...]]:
    """Return the lanes that each light controls, by its id."""
    controlled: dict[int, dict[int, None]] = {}
    for line in road.stop_lines:
        if line.light is not None:
            behind = line.towards or road.lanes[line.lane].successors
            known = [lane for lane in behind if lane in road.lanes] or [line.lane]
            controlled.setdefault(line.light, {}).update(dict.fromkeys(known))
    return {light: tuple(lanes) for light, lanes in controlled.items()}


def _cross(line: FloatArray, other: FloatArray) -> bool:
    """Return whether one of the segments of a polyline `(n, 2)` properly crosses one of another's
    `(m, 2)`.
    """
    starts, ends = (line[:-1], other[:-1]), (line[1:], other[1:])
    low = np.max([points.min(axis=0) for points in starts], axis=0)
    high = np.max(
        [np.min([points.max(axis=0) for points in pair], axis=0) for pair in (starts, ends)], axis=0
    )
    if (low > high).any():
        return False
    across = _separates(line, other) & _separates(other, line).T
    return bool(across.any())


def _separates(line: FloatArray, other: FloatArray) -> BoolArray:
    """Return `(n - 1, m - 1)`: whether each segment's straight of a polyline separates the ends of
    each segment of another's.
    """
    (px, py), (qx, qy) = line[:-1].T[:, :, None], line[1:].T[:, :, None]
    x, y = other.T
    side = (qx - px) * (y - py) - (qy - py) * (x - px)
    return np.asarray(side[:, :-1] * side[:, 1:] < 0.0)
