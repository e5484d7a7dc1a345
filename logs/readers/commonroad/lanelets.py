"""Makes a road from CommonRoad lanelets: repaired boundaries, drivable lanes, crossable markings, speed limits.

A limit that the file does not give is assumed, and the scenario says so:

(1) by the kind of road: highway 130 km/h (USA: 65 mph), country 100, ramps 80, urban and all else 50;
(2) raised to the 85th percentile of the speeds driven on those lanes at the start, rounded up to 10 km/h, where that is
    more: the speed by which traffic engineers set limits (V85), so that a motorway which the map calls "urban" keeps
    its pace. Congested traffic never lowers (1); what comes later does not count: a planner would know it in advance;
(3) raised to the middle of the goal's speeds, but at most a quarter more than the least of them, rounded up to 10 km/h,
    where even that is more than (1) and (2) and the goal lies on such a lane: it disproves the assumption.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from math import ceil

import numpy as np

from logs.arrays import FloatArray
from logs.maps.strips import resampled
from logs.readers.commonroad.document import Document, PlanningProblem
from logs.road import Lane, Road

NOT_DRIVABLE = {"sidewalk", "crosswalk", "bicycleLane", "shoulder", "busLane", "busStop", "border", "restricted"}
NOT_CROSSABLE = {"solid", "broad_solid", "solid_solid", "curb"}
LEFT_HAND_COUNTRIES = frozenset(
    "AUS BGD BHS BRB BRN BTN BWA CYP FJI GBR GUY HKG IDN IMN IND IRL JAM JPN KEN LKA LSO MAC MDV "  # noqa: SIM905
    "MLT MOZ MUS MWI MYS NAM NPL NZL PAK PNG SGP SUR SWZ SYC THA TLS TTO TZA UGA ZAF ZMB ZWE".split()
)
KPH = 1.0 / 3.6
_HIGHWAY = {"highway", "interstate", "mainCarriageWay"}
_DEFAULTS = {"country": 100.0 * KPH, "accessRamp": 80.0 * KPH, "exitRamp": 80.0 * KPH}
_URBAN = 50.0 * KPH
_ENOUGH = 5
"""Least number of vehicles for (2)."""
_PLAUSIBLE = (2.0, 45.0)
_MORE = 1.25
"""Upper bound of (3), as a factor of the goal's least speed."""


def road_of(
    document: Document, origin: tuple[float, float], driven: FloatArray, problem: PlanningProblem | None
) -> tuple[Road, tuple[str, ...]]:
    """Make the road, and notes on assumptions.

    Args:
        document: The file.
        origin: Subtracted from all points, m.
        driven: Positions and speeds of the traffic at the start `(m, 3)`, file coordinates, m and m/s: see (2).
        problem: The planning problem, whose goals may ask for a speed: see (3).
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
        notes.append(f"{uneven} lanelets have boundaries of unequal point counts: resampled by arc length")
    road = Road(lanes, drives_on_right=document.country not in LEFT_HAND_COUNTRIES)
    low, high = _PLAUSIBLE
    odd: defaultdict[float, int] = defaultdict(int)
    for lane in road.lanes.values():
        if lane.drivable and not (np.isnan(lane.speed_limit) or low <= lane.speed_limit <= high):
            odd[lane.speed_limit] += 1
    notes += [f"speed limit of {limit:g} m/s on {count} lanes is kept as given" for limit, count in odd.items()]
    return _with_defaults(document, road, origin, driven - (*origin, 0.0), problem, notes), tuple(notes)


def _crossable(marking: str, *, near: int) -> bool:
    """Whether a marking may be crossed from the lane; of a double line the near one counts ("solid_dashed")."""
    parts = marking.split("_")
    if set(parts) == {"solid", "dashed"}:
        return parts[near] == "dashed"
    return marking not in NOT_CROSSABLE


def _with_defaults(
    document: Document, road: Road, origin: tuple[float, float], driven: FloatArray, problem: PlanningProblem | None,
    notes: list[str],
) -> Road:  # fmt: skip
    """The road with (1) to (3): the commonest default is the road's, others stand on their lanes."""
    missing: defaultdict[str, list[Lane]] = defaultdict(list)
    drivable = [lane for lane in road.lanes.values() if lane.drivable]
    for lane in drivable:
        if np.isnan(lane.speed_limit):
            kinds = set(lane.kind.split("+"))  # the scenario's own tag "highway" beats a lanelet's "urban"
            usual = "highway" if _HIGHWAY & (kinds | set(document.tags)) else "urban"
            missing[next((kind for kind in _DEFAULTS if kind in kinds), usual)].append(lane)
    if not missing:
        return road
    goals = problem.goals if problem is not None else ()
    speeds = [goal.v for goal in goals if goal.v is not None]
    asks = bool(speeds) and len(speeds) == len(goals)  # for speeds between these, if all goals do
    least, most = min((v[0] for v in speeds), default=0.0), max((v[1] for v in speeds), default=0.0)
    on_goal = {i for goal in goals for i in goal.lanelets}
    for region in (region for goal in goals if asks for region in goal.regions):
        places = np.vstack([region, 0.5 * (region + np.roll(region, 1, axis=0)), region.mean(axis=0)]) - origin
        on_goal |= {lane.id for x, y in places for lane in road.lanes_at(float(x), float(y))}
    assumed = {}
    for group, lanes in sorted(missing.items(), key=lambda item: (-len(item[1]), item[0])):
        ids, moving = {lane.id for lane in lanes}, driven[driven[:, 2] > 2.0]
        limit, why = _DEFAULTS.get(group, _URBAN), f"{group} default"  # (1)
        if group == "highway":
            limit = 65.0 * 1.609344 * KPH if document.country == "USA" else 130.0 * KPH
        pace = np.array([v for x, y, v in moving if any(lane.id in ids for lane in road.lanes_at(x, y))])
        if len(pace) >= _ENOUGH:
            typical = _rounded_up(float(np.percentile(pace, 85)))
            if typical > limit:  # (2)
                limit, why = typical, f"85th percentile of the speeds at the start, above the {group} default,"
        if asks and least > limit and ids & on_goal:  # (3)
            limit = _rounded_up(min(0.5 * (least + most), _MORE * least))
            why = f"the goal asks for {least:.0f} m/s, above the {why.rstrip(',')}:"
        assumed[group] = limit
        words = f"{limit:.2f} m/s ({limit / KPH:.0f} km/h)"
        notes.append(f"speed limit missing on {len(lanes)} of {len(drivable)} lanes: {why} {words} assumed")
    default = next(iter(assumed.values()))
    changed = {lane.id: assumed[g] for g, lanes in missing.items() for lane in lanes if assumed[g] != default}
    by_id = {i: replace(lane, speed_limit=changed.get(i, lane.speed_limit)) for i, lane in road.lanes.items()}
    return replace(road, lanes=by_id, default_speed_limit=default, assumed_limits=frozenset(changed))


def _rounded_up(speed: float) -> float:
    """Round a speed up to a multiple of 10 km/h."""
    return ceil(speed / (10.0 * KPH) - 1e-6) * 10.0 * KPH
