"""The stop lines of a 123D map.

A stop zone names lanes, and lies on them or on their predecessors. The stop line is at the point
where the centre line enters the zone. For a zone at the begin of a lane in a junction, it lies at
the ends of that lane's predecessors, and applies to the way onto the lane. A zone of a traffic
light identifies the light by its lane.

A light has the id of the lane that it controls. For a light without a stop zone, the stop line is
at the ends of that lane's predecessors.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from replan.core.arrays import FloatArray, arc_lengths
from replan.logs.maps.arrow123d_objects import MapObject
from replan.logs.maps.strips import dense
from replan.logs.polylines import inside
from replan.logs.road import Lane, Road, predecessors
from replan.logs.rules import StopLine, TrafficLight

ZONE_LIGHT, ZONE_STOP = 1, 2
"""Types of stop zones: of a traffic light, and where all must stop."""
# Distance of the points of a centre line of which it is known whether they lie in a zone, m
STEP_M = 0.5


class Place(NamedTuple):
    """Where a stop line lies: a lane, the relative length of 0 to 1, and the lanes after it that it
    applies to (empty: all).
    """

    lane: int
    share: float
    towards: tuple[int, ...] = ()


def stop_lines(
    zones: Sequence[tuple[MapObject, FloatArray]], lanes: Mapping[int, Lane], notes: list[str]
) -> tuple[StopLine, ...]:
    """Return the stop lines of stop zones with their outlines (module docstring).

    A zone that lies on none of its lanes is left out.
    """
    feeding, lines, lost = predecessors(lanes), list[StopLine](), 0
    for zone, ring in zones:
        named = [lanes[number] for number in zone.ids_in("lane_ids") if number in lanes]
        places = list(_places(named, ring, feeding, lanes)) if len(ring) > 2 else []
        lost += not places
        kind = zone.features.get("stop_zone_type")
        for place in places:
            lights: list[tuple[int | None, tuple[int, ...]]] = [(None, place.towards)]
            if kind == ZONE_LIGHT:  # a light has the id of its lane
                after = place.towards or lanes[place.lane].successors
                lights = [(lane, (lane,)) for lane in after] or [(place.lane, ())]
            ends = ends_at(lanes[place.lane], place.share)
            for light, ways in lights:
                lines.append(StopLine(len(lines), place.lane, ends, light, kind == ZONE_STOP, ways))
    if lost:
        notes.append(
            f"{lost} of {len(zones)} stop zones lie on none of the lanes that they name and are "
            "left out."
        )
    return _merged(lines)


def _places(
    named: Sequence[Lane],
    ring: FloatArray,
    feeding: Mapping[int, Sequence[int]],
    lanes: Mapping[int, Lane],
) -> Iterator[Place]:
    """Yield the stop lines of a zone with an outline and the lanes that it names."""
    for lane in named:
        ahead, share = [lanes[before] for before in feeding.get(lane.id, ())], _entry(lane, ring)
        if share is not None and (share * lane.length > STEP_M or not ahead):
            yield Place(lane.id, share)
            continue
        for before in ahead:
            entry = _entry(before, ring)
            if entry is not None or share is not None:
                yield Place(before.id, 1.0 if entry is None else entry, (lane.id,))


def _merged(lines: Sequence[StopLine]) -> tuple[StopLine, ...]:
    """Return the lines, of which those at the same place are one for all of their ways."""
    merged: dict[Any, StopLine] = {}
    for line in lines:
        key = (line.lane, line.points.tobytes(), line.light, line.must_stop)
        known = merged.setdefault(key, replace(line, id=len(merged)))
        ways = (*known.towards, *line.towards) if known.towards and line.towards else ()
        merged[key] = replace(known, towards=tuple(dict.fromkeys(ways)))
    return tuple(merged.values())


def lines_of_lights(road: Road, lights: Sequence[TrafficLight]) -> tuple[StopLine, ...]:
    """Return the road's stop lines, and those of the lights on its lanes that have none there."""
    named, feeding = {line.light for line in road.stop_lines}, predecessors(road.lanes)
    lines = list(road.stop_lines)
    number = max((line.id for line in lines), default=-1) + 1
    for light in lights:
        if light.id in named or light.id not in road.lanes:
            continue
        for lane, ends, towards in _sites(road, light.id, feeding.get(light.id, ())):
            lines.append(StopLine(number, lane, ends, light.id, towards=towards))
            number += 1
    return tuple(lines)


def _sites(
    road: Road, controlled: int, before: Sequence[int]
) -> Iterator[tuple[int, FloatArray, tuple[int, ...]]]:
    """Yield lane, ends and ways of the stop lines of a lane's light; `before`: its predecessors."""
    own = [line for line in road.stop_lines if line.lane == controlled]
    if own:
        yield controlled, own[0].points, ()
        return
    places = [Place(lane, 1.0, (controlled,)) for lane in before] or [Place(controlled, 0.0)]
    for place in places:
        yield place.lane, ends_at(road.lanes[place.lane], place.share), place.towards


def ends_at(lane: Lane, share: float) -> FloatArray:
    """Return the ends `(2, 2)` of a line across a lane at a relative length of 0 to 1."""
    shares = arc_lengths(*lane.center.T) / lane.length
    return np.array(
        [[np.interp(share, shares, side[:, k]) for k in (0, 1)] for side in (lane.left, lane.right)]
    )


def _entry(lane: Lane, ring: FloatArray) -> float | None:
    """Return the relative length at which a lane's centre line enters an outline; None if it does
    not.
    """
    points = dense(lane.center, STEP_M)
    within = [inside(x, y, ring) for x, y in points]
    return within.index(True) / (len(points) - 1) if any(within) else None
