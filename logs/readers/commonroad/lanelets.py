"""Makes a road from CommonRoad lanelets: lanes, crosswalks, and the rules that hold on them.

The rules: speed limits (`lanelet_speed_limits`), stop lines and lights (`lanelet_stop_lines`),
right of way (`lanelet_priority`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.maps.strips import resampled
from replan.logs.readers.commonroad.document_records import Document, PlanningProblem
from replan.logs.readers.commonroad.lanelet_priority import right_of_way
from replan.logs.readers.commonroad.lanelet_speed_limits import with_speed_limits
from replan.logs.readers.commonroad.lanelet_stop_lines import (
    LightChains,
    PlacedStopLine,
    numbered,
    stop_lines_at,
)
from replan.logs.readers.commonroad.lanelet_turns import turns_of
from replan.logs.road import Lane, Road
from replan.logs.rules import Crosswalk

NOT_DRIVABLE = {
    "sidewalk",
    "crosswalk",
    "bicycleLane",
    "shoulder",
    "busLane",
    "busStop",
    "border",
    "restricted",
}
NOT_CROSSABLE = {"solid", "broad_solid", "solid_solid", "curb"}
LEFT_HAND_COUNTRIES = frozenset(
    (  # noqa: SIM905
        "AUS BGD BHS BRB BRN BTN BWA CYP FJI GBR GUY HKG IDN IMN IND IRL JAM JPN KEN LKA LSO MAC "
        "MDV MLT MOZ MUS MWI MYS NAM NPL NZL PAK PNG SGP SUR SWZ SYC THA TLS TTO TZA UGA ZAF ZMB "
        "ZWE"
    ).split()
)


def road_of(
    document: Document,
    origin: tuple[float, float],
    driven: FloatArray,
    problem: PlanningProblem | None,
) -> tuple[Road, tuple[str, ...]]:
    """Make the road, `origin` subtracted from all points, m, and notes on assumptions.

    `driven` are positions and speeds of the traffic at the start `(m, 3)`, file coordinates, m and
    m/s, for assumed speed limits, as are the goals of the `problem`.
    """
    lanes, notes = {}, []
    for lanelet in document.lanelets:
        left, right = lanelet.left, lanelet.right
        keep = np.zeros(0, np.bool_)
        if min(len(left), len(right)) > 1:
            if len(left) != len(right):
                count = max(len(left), len(right))
                left, right = resampled(left, count), resampled(right, count)
            keep = np.r_[True, np.hypot(*np.diff(0.5 * (left + right), axis=0).T) > 1e-3]
        if keep.sum() < 2:
            notes.append(f"lanelet {lanelet.id} is dropped: its boundaries are no strip")
            continue
        on_left, on_right = lanelet.beside
        for_cars = not lanelet.users or {"car", "vehicle"} & set(lanelet.users)
        lanes[lanelet.id] = Lane(
            lanelet.id,
            left[keep] - origin,
            right[keep] - origin,
            successors=lanelet.successors,
            left_neighbour=on_left[0] if on_left and on_left[1] else None,
            right_neighbour=on_right[0] if on_right and on_right[1] else None,
            left_opposite=bool(on_left and not on_left[1]),
            right_opposite=bool(on_right and not on_right[1]),
            speed_limit=lanelet.speed,
            drivable=bool(for_cars) and not NOT_DRIVABLE & set(lanelet.types),
            left_crossable=_crossable(lanelet.markings[0], near=-1),
            right_crossable=_crossable(lanelet.markings[1], near=0),
            kind="+".join(lanelet.types) or "lane",
        )
    uneven = sum(len(lanelet.left) != len(lanelet.right) for lanelet in document.lanelets)
    if uneven:
        notes.append(
            f"{uneven} lanelets have boundaries of unequal point counts: resampled by arc length"
        )
    road = Road(lanes, drives_on_right=document.country not in LEFT_HAND_COUNTRIES)
    road, limit_notes = with_speed_limits(document, road, origin, driven - (*origin, 0.0), problem)
    return road, (*notes, *limit_notes)


def _crossable(marking: str, *, near: int) -> bool:
    """Whether a marking may be crossed from the lane.

    Of a double line the near one counts ("solid_dashed").
    """
    parts = marking.split("_")
    if set(parts) == {"solid", "dashed"}:
        return parts[near] == "dashed"
    return marking not in NOT_CROSSABLE


def with_rules(
    document: Document, road: Road, origin: tuple[float, float]
) -> tuple[Road, LightChains, tuple[str, ...]]:
    """Add the rules to the road; return it, the file's lights of each of its lights, and notes."""
    turns = turns_of(document, road)
    placed: list[PlacedStopLine] = []
    for lanelet in document.lanelets:
        if lanelet.id in road.lanes:
            placed += stop_lines_at(document, lanelet, road.lanes[lanelet.id], turns, origin)
    first_free = 1 + max((light.id for light in document.lights), default=0)
    stop_lines, chains = numbered(placed, first_free)
    priority = right_of_way(document, road, turns)
    notes = priority.notes
    lanes = {
        i: replace(lane, yields_to=tuple(sorted(priority.yields_to.get(i, ()))))
        for i, lane in road.lanes.items()
    }
    crossings = {i for intersection in document.intersections for i in intersection.crossings}
    marked = (
        lane
        for lane in road.lanes.values()
        if lane.id in crossings or "crosswalk" in lane.kind.split("+")
    )
    walks = tuple(Crosswalk(lane.id, lane.polygon) for lane in marked)
    known = {light.id for light in document.lights}
    unused = known - {i for chain in chains.values() for i in chain}
    if unused:
        notes.append(
            f"traffic lights {_comma_list(unused)} are ignored: no lane that goes their way names "
            "them"
        )
    dark = {light.id for light in document.lights if light.active and not light.cycle}
    if dark:
        notes.append(f"traffic lights {_comma_list(dark)} have no cycle: they are taken as off")
    lost = {i for lanelet in document.lanelets for i in lanelet.lights_here} - known
    if lost:
        notes.append(
            f"traffic lights {_comma_list(lost)} are named by lanelets, but are not in the file"
        )
    ruled = replace(
        road,
        lanes=lanes,
        stop_lines=stop_lines,
        crosswalks=walks,
        assumed_priority=priority.assumed,
    )
    return ruled, chains, tuple(notes)


def _comma_list(names: Iterable[int]) -> str:
    return ", ".join(map(str, sorted(names)))
