"""Speed limits of CommonRoad lanelets: those of the file, kept as given, and assumed ones.

A limit that the file does not give is assumed, and the scenario says so:

(1) by the kind of road: highway 130 km/h (USA: 65 mph), country 100, ramps 80, urban and all else
    50;
(2) raised to the 85th percentile of the speeds driven on those lanes at the start, rounded up to 10
    km/h, where that is more: the speed by which traffic engineers set limits (V85), so that a
    motorway which the map calls "urban" keeps its pace. Congested traffic never lowers (1); what
    comes later does not count: a planner would know it in advance;
(3) raised to the middle of the goal's speeds, but at most a quarter more than the least of them,
    rounded up to 10 km/h, where even that is more than (1) and (2) and the goal lies on such a
    lane: it disproves the assumption.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Set
from dataclasses import dataclass, replace
from math import ceil

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.readers.commonroad.document_records import Document, PlanningProblem
from replan.logs.road import Lane, Road

MPS_PER_KPH = 1.0 / 3.6
KPH_PER_MPH = 1.609344
HIGHWAY_KINDS = {"highway", "interstate", "mainCarriageWay"}
"""Kinds of lanelets, and tags of scenarios, that mean a highway."""
DEFAULT_KPH = {
    "country": 100.0,
    "accessRamp": 80.0,
    "exitRamp": 80.0,
    "highway": 130.0,
    "urban": 50.0,
}
"""Limits (1) by the group of lanes, km/h."""
USA_HIGHWAY_KPH = 65.0 * KPH_PER_MPH
"""Limit (1) of highways in the USA, km/h."""
KINDS_WITH_DEFAULT = ("country", "accessRamp", "exitRamp")
"""Kinds of lanelets that are a group of (1), whatever the scenario's tags are."""
ENOUGH = 5
"""Least number of vehicles for (2)."""
MOVING_MPS = 2.0
"""Slower vehicles do not count for (2), m/s."""
LEAST_PLAUSIBLE_MPS = 2.0
"""A lower limit in a file is noted, m/s."""
MOST_PLAUSIBLE_MPS = 45.0
"""A higher limit in a file is noted, m/s."""
ABOVE_LEAST = 1.25
"""Upper bound of (3), as a factor of the goal's least speed."""


@dataclass(frozen=True)
class _GoalSpeeds:
    """The least and the greatest speed that the goals ask for, m/s, and the lanes on which they
    lie.
    """

    least: float
    most: float
    lanes: Set[int]


def with_speed_limits(
    document: Document,
    road: Road,
    origin: tuple[float, float],
    driven: FloatArray,
    problem: PlanningProblem | None,
) -> tuple[Road, list[str]]:
    """Add limits (1) to (3) where the file has none; return the road, and notes.

    `driven` are positions and speeds of the traffic at the start `(m, 3)`, coordinates of the road,
    m and m/s. The commonest default is the road's; the others stand on their lanes.
    """
    drivable = [lane for lane in road.lanes.values() if lane.drivable]
    odd = Counter(
        lane.speed_limit
        for lane in drivable
        if lane.speed_limit < LEAST_PLAUSIBLE_MPS or lane.speed_limit > MOST_PLAUSIBLE_MPS
    )
    notes = [
        f"speed limit of {limit:g} m/s on {count} lanes is kept as given"
        for limit, count in odd.items()
    ]
    missing: defaultdict[str, list[Lane]] = defaultdict(list)
    for lane in drivable:
        if np.isnan(lane.speed_limit):
            missing[_group(lane, document)].append(lane)
    if not missing:
        return road, notes
    goal = _goal_speeds(road, origin, problem)
    moving = driven[driven[:, 2] > MOVING_MPS]
    assumed: dict[str, float] = {}
    for group, lanes in sorted(missing.items(), key=lambda item: (-len(item[1]), item[0])):
        ids = {lane.id for lane in lanes}
        pace = [v for x, y, v in moving if any(lane.id in ids for lane in road.lanes_at(x, y))]
        asked = goal if goal is not None and ids & goal.lanes else None
        limit, reason = _assumed_limit(group, document.country, np.array(pace), asked)
        assumed[group] = limit
        notes.append(
            f"speed limit missing on {len(lanes)} of {len(drivable)} lanes: {reason} "
            f"{limit:.2f} m/s ({limit / MPS_PER_KPH:.0f} km/h) assumed"
        )
    default = next(iter(assumed.values()))
    others = [group for group in missing if assumed[group] != default]
    changed = {lane.id: assumed[group] for group in others for lane in missing[group]}
    by_id = {
        i: replace(lane, speed_limit=changed.get(i, lane.speed_limit))
        for i, lane in road.lanes.items()
    }
    limited = replace(
        road, lanes=by_id, default_speed_limit=default, assumed_limits=frozenset(changed)
    )
    return limited, notes


def _group(lane: Lane, document: Document) -> str:
    """The group of (1): the scenario's own tag "highway" beats a lanelet's "urban"."""
    kinds = set(lane.kind.split("+"))
    usual = "highway" if HIGHWAY_KINDS & (kinds | set(document.tags)) else "urban"
    return next((kind for kind in KINDS_WITH_DEFAULT if kind in kinds), usual)


def _assumed_limit(
    group: str, country: str, pace: FloatArray, goal: _GoalSpeeds | None
) -> tuple[float, str]:
    """The limit of a group of lanes, m/s, and its reason as the first words of a note.

    `pace` are the speeds driven on them `(m,)`, m/s; `goal` is that on one of them.
    """
    kph = USA_HIGHWAY_KPH if group == "highway" and country == "USA" else DEFAULT_KPH[group]
    limit, reason, mark = kph * MPS_PER_KPH, f"{group} default", ""  # (1)
    typical = _rounded_up(float(np.percentile(pace, 85))) if len(pace) >= ENOUGH else 0.0
    if typical > limit:  # (2)
        limit, mark = typical, ","
        reason = f"85th percentile of the speeds at the start, above the {reason}"
    if goal is not None and goal.least > limit:  # (3)
        limit, mark = (
            _rounded_up(min(0.5 * (goal.least + goal.most), ABOVE_LEAST * goal.least)),
            ":",
        )
        reason = f"the goal asks for {goal.least:.0f} m/s, above the {reason}"
    return limit, reason + mark


def _goal_speeds(
    road: Road, origin: tuple[float, float], problem: PlanningProblem | None
) -> _GoalSpeeds | None:
    """What the goals of a problem ask for; None unless all of them ask for a speed."""
    goals = problem.goals if problem is not None else ()
    speeds = [goal.v for goal in goals if goal.v is not None]
    if not speeds or len(speeds) != len(goals):
        return None
    lanes = {i for goal in goals for i in goal.lanelets}
    for region in (region for goal in goals for region in goal.regions):
        middles = 0.5 * (region + np.roll(region, 1, axis=0))
        places = np.vstack([region, middles, region.mean(axis=0)]) - origin
        lanes |= {lane.id for x, y in places for lane in road.lanes_at(float(x), float(y))}
    return _GoalSpeeds(min(low for low, _ in speeds), max(high for _, high in speeds), lanes)


def _rounded_up(speed: float) -> float:
    """A speed, m/s, rounded up to 10 km/h; one above by rounding errors only is not."""
    return ceil(speed / (10.0 * MPS_PER_KPH) - 1e-6) * 10.0 * MPS_PER_KPH
