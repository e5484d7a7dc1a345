"""Euro NCAP's tests of pedestrians, cyclists and cars, with the grids of 2023 and of 2026.

Numbers as in the OpenSCENARIO files that Vector publishes (vectorgrp/OSC-NCAP-scenarios ee7aa111):
AEB/LSS VRU 4.5.1 and AEB C2C 4.3.1 (2023), CA-FC 1.1 (2026); the protocols themselves were not
consulted. Differences: the car is the catalogue's (1.61 m wide), and overlaps refer to its width;
of 2026 only the overlaps of the standard range; a run-up without a stated length grows with the
square of the speed; CBNAO hides the cyclist behind one parked car, whose front is 1 m before the
cyclist's line and whose side is 3.55 m from the ego's path; CCFtap and CMFtap turn at the
catalogue's junction, where both would cross at the same time. Left out: reversing (CPRA),
pedestrians at turns (CPTA) and the head-on lane change (CCFhol).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from math import copysign, pi

import numpy as np

from replan.logs.catalogue.family import Build, Family
from replan.logs.catalogue.family_parts import (
    BEYOND_M,
    HALF_LANE,
    SIDEWALK_M,
    SPARE_S,
    START_M,
    WAITS,
    Ahead,
    grid,
    moving,
    waiting,
)
from replan.logs.catalogue.protocols import (
    CAR_TARGET,
    CHILD_TARGET,
    CROSSING,
    CYCLIST,
    FOLLOWS,
    KMH,
    LEAD,
    MOTORCYCLE,
    PEDESTRIAN,
    STOP_M,
    TTC_S,
    Target,
    beside,
    crossing,
    impact,
    lead,
    speeds,
    straight,
    tested,
)
from replan.logs.catalogue.roads import LANE_WIDTH_M, junction, one_lane, two_way
from replan.logs.plan import DecisionKind
from replan.logs.scenario import Scenario
from replan.logs.vehicle import VehicleParameters

SOURCES = {
    "2023": (
        "Euro NCAP AEB/LSS VRU 4.5.1 and AEB C2C 4.3.1, per vectorgrp/OSC-NCAP-scenarios ee7aa111"
    ),
    "2026": "Euro NCAP CA-FC 1.1, per vectorgrp/OSC-NCAP-scenarios ee7aa111",
}
STEPS = {"2023": 5, "2026": 10}
"""Steps of the ego's speed, km/h."""


def _target_ahead(p: Mapping[str, float], target: Target) -> Scenario:
    """A target that moves along the lane ahead; the ego would meet it after `TTC_S`."""
    v, u, car = p["ego_kmh"] * KMH, p["target_kmh"] * KMH, VehicleParameters()
    if not v > u:
        raise ValueError(
            f"the ego's {p['ego_kmh']:g} km/h do not reach a target with {p['target_kmh']:g} km/h"
        )
    t, half = grid(p["duration_s"]), 0.5 * target.size[0]
    x = START_M + car.axle_to_front + (v - u) * TTC_S + half + u * t
    beside = np.full(len(t), impact(p["overlap_percent"]))
    other = moving(target.id, target.kind, target.size, t, x, beside, yaw=0.0)

    def ahead(time: float, s: float) -> Ahead | None:
        gap = float(np.interp(time, t, x)) - half - STOP_M - (s + car.axle_to_front)
        return None if time < p["reaction_s"] else Ahead(gap, u)

    path = straight(p)
    road = one_lane(path, v, sidewalk=SIDEWALK_M)
    return tested(p, path, road, [other], {target.id: (*FOLLOWS, DecisionKind.NUDGE_LEFT)}, ahead)


def _head_on(p: Mapping[str, float], target: Target) -> Scenario:
    """A car that comes towards the ego in the ego's lane."""
    v, u, car = p["ego_kmh"] * KMH, p["target_kmh"] * KMH, VehicleParameters()
    t, half = grid(p["duration_s"]), 0.5 * target.size[0]
    meet = START_M + car.axle_to_front + v * TTC_S
    x = meet + half + u * (TTC_S - t)
    other = moving(target.id, target.kind, target.size, t, x, 0.0, yaw=pi)

    def ahead(time: float, s: float) -> Ahead | None:
        gap = float(np.interp(time, t, x)) - half - (s + car.axle_to_front)
        return Ahead(0.5 * gap, stop=True) if time >= p["reaction_s"] and gap > 0.0 else None

    path = straight(p)
    kinds = (*WAITS, DecisionKind.NUDGE_LEFT, DecisionKind.NUDGE_RIGHT)
    return tested(p, path, two_way(path, v), [other], {target.id: kinds}, ahead)


def _at_junction(p: Mapping[str, float], target: Target, *, turn: float) -> Scenario:
    """A target that crosses the ego's path at a junction; without braking both would be there at
    the same time.

    If the ego turns left, the target comes towards it; else it is on the main road, from right or
    left (`from_left`).
    """
    v, u = p["ego_kmh"] * KMH, p["target_kmh"] * KMH
    car, t = VehicleParameters(), grid(p["duration_s"])
    reach = max(u, v) * (p["duration_s"] + SPARE_S) + BEYOND_M
    crossroads = junction(START_M + v * TTC_S + 30.0, reach, reach, turn=turn, speed_limit=v)
    if turn:
        stations = np.linspace(crossroads.begin, crossroads.end, 200)
        turned_x, turned_y, _, _ = crossroads.path.at(stations)
        cross, cross_x = (
            float(np.interp(LANE_WIDTH_M, turned_y, column)) for column in (stations, turned_x)
        )
        x, y, yaw = cross_x + u * (TTC_S - t), np.full(len(t), LANE_WIDTH_M), pi
    else:
        side = 1.0 if p["from_left"] > 0.0 else -1.0
        cross = crossroads.center[0] - side * HALF_LANE
        x, y, yaw = np.full(len(t), cross), side * u * (TTC_S - t), copysign(0.5 * pi, -side)
    middle = cross - car.axle_to_center
    other = moving(target.id, target.kind, target.size, t, x, y, yaw=yaw)
    passes = TTC_S + (0.5 * target.size[0] + HALF_LANE) / u
    ahead = waiting(cross - HALF_LANE, STOP_M, p["reaction_s"], passes, car.axle_to_front)
    start, beyond = middle - v * TTC_S, crossroads.end + 15.0
    return tested(
        p,
        crossroads.path,
        crossroads.road,
        [other],
        {target.id: WAITS},
        ahead,
        beyond=beyond,
        start=start,
    )


def _is_faster(p: Mapping[str, float]) -> bool:
    return p["ego_kmh"] > p["target_kmh"]


def _is_as_fast(p: Mapping[str, float]) -> bool:
    return p["ego_kmh"] == p["target_kmh"]


ALONG: Mapping[str, float] = {
    "ego_kmh": 40.0,
    "target_kmh": 5.0,
    "overlap_percent": 50.0,
    "reaction_s": 0.4,
    "duration_s": 18.0,
}
MEETING: Mapping[str, float] = {
    "ego_kmh": 50.0,
    "target_kmh": 50.0,
    "reaction_s": 0.4,
    "duration_s": 18.0,
}
TURNING: Mapping[str, float] = {
    "ego_kmh": 15.0,
    "target_kmh": 45.0,
    "reaction_s": 0.4,
    "duration_s": 20.0,
}
AHEAD: Mapping[str, float] = {**MEETING, "target_kmh": 20.0, "overlap_percent": 100.0}
CROSSED: Mapping[str, float] = {**TURNING, "ego_kmh": 40.0, "target_kmh": 40.0, "from_left": 0.0}
OVERLAPS = (-50.0, -75.0, 100.0, 75.0, 50.0)


def _family(
    name: str,
    year: str,
    summary: str,
    build: Build,
    defaults: Mapping[str, float],
    grid: Mapping[str, tuple[float, ...]],
    holds: Callable[[Mapping[str, float]], bool] = lambda p: True,
) -> Family:
    """A family; where a parameter has a grid, its default is in the middle of it."""
    parameters = {**defaults, **{key: values[len(values) // 2] for key, values in grid.items()}}
    tags = "euro_ncap", year, name.partition("_")[0]
    return Family(
        f"euro_ncap/{name}_{year}", summary, parameters, tags, build, grid, SOURCES[year], holds
    )


def _vulnerable(year: str) -> tuple[Family, ...]:
    later, step = year == "2026", STEPS[year]
    ego = {"ego_kmh": speeds(10, 60, step)}
    walks, rides = partial(crossing, target=PEDESTRIAN), partial(crossing, target=CYCLIST)
    overlaps = {"overlap_percent": (50.0, 75.0) if later else (50.0,)}
    far = {"overlap_percent": (25.0, 50.0) if later else (50.0,)}
    own = partial(_family, year=year)
    return (
        own(
            "cpna",
            summary="an adult walks onto the road from the near side",
            build=walks,
            defaults=CROSSING,
            grid={**ego, "overlap_percent": (25.0, 50.0, 75.0) if later else (25.0, 75.0)},
        ),
        own(
            "cpfa",
            summary="an adult runs onto the road from the far side",
            build=partial(walks, far=True),
            defaults={**CROSSING, "target_kmh": 8.0, "start_m": 6.0, "run_up_m": 1.5},
            grid=ego,
        ),
        own(
            "cpnco",
            summary="a child runs out from behind two parked cars",
            build=partial(crossing, target=CHILD_TARGET, hidden="cpnco"),
            defaults=CROSSING,
            grid=ego,
        ),
        own(
            "cbna",
            summary="a cyclist crosses from the near side",
            build=rides,
            defaults={**CROSSING, "target_kmh": 15.0, "start_m": 20.5, "run_up_m": 3.5},
            grid={**ego, **overlaps},
        ),
        own(
            "cbnao",
            summary="a cyclist comes out from behind a parked car",
            build=partial(crossing, target=CYCLIST, hidden="cbnao"),
            grid={**ego, **overlaps},
            defaults={
                **CROSSING,
                "target_kmh": 10.0,
                "start_m": 6.05,
                "run_up_m": 1.55,
                "hidden_m": 3.55,
            },
        ),
        own(
            "cbfa",
            summary="a cyclist crosses from the far side",
            build=partial(rides, far=True),
            defaults={**CROSSING, "target_kmh": 20.0, "start_m": 28.2, "run_up_m": 6.2},
            grid={**ego, **far},
        ),
        own(
            "cpla",
            summary="an adult walks along the lane ahead",
            build=partial(_target_ahead, target=PEDESTRIAN),
            defaults=ALONG,
            grid={"ego_kmh": speeds(10 if later else 20, 60, step)},
        ),
        own(
            "cpla_warning",
            summary="an adult walks along at the lane's side, the ego is fast",
            build=partial(_target_ahead, target=PEDESTRIAN),
            defaults={**ALONG, "overlap_percent": 25.0},
            grid={"ego_kmh": speeds(50, 80, step)},
        ),
        own(
            "cbla",
            summary="a cyclist rides along the lane ahead",
            build=partial(_target_ahead, target=CYCLIST),
            defaults={**ALONG, "target_kmh": 15.0},
            grid={"ego_kmh": speeds(20 if later else 25, 60, step)},
        ),
    )


def _cars(year: str) -> tuple[Family, ...]:
    later, step = year == "2026", STEPS[year]
    own = partial(_family, year=year)
    ego, overlap = {"ego_kmh": speeds(10, 80, step)}, {"overlap_percent": OVERLAPS}
    slower = (
        {"ego_kmh": speeds(30, 130, 10), "target_kmh": speeds(20, 70, 10)}
        if later
        else {"ego_kmh": speeds(30, 80, step)}
    )
    braking: dict[str, tuple[float, ...]] = (
        {"ego_kmh": speeds(30, 80, 10)}
        if later
        else {"gap_m": (12.0, 40.0), "brake_mps2": (2.0, 6.0)}
    )
    return (
        own(
            "ccrs",
            summary="a stopped car ahead",
            build=_ahead,
            defaults={**AHEAD, "target_kmh": 0.0},
            grid={**ego, **overlap},
        ),
        own(
            "ccrm",
            summary="a slower car ahead",
            build=_ahead,
            defaults=AHEAD,
            grid={**slower, **overlap},
            holds=_is_faster,
        ),
        own(
            "ccrb",
            summary="the car ahead brakes to 2 km/h",
            build=_braking,
            grid=braking,
            defaults={
                **LEAD,
                "gap_m": 12.0,
                "headway_s": 1.0 if later else 0.0,
                "brake_mps2": 4.0,
                "brake_to_kmh": 2.0,
            },
        ),
    )


def _ahead(p: Mapping[str, float]) -> Scenario:
    """CCRs and CCRm: the target keeps its speed, at an overlap."""
    return lead({**LEAD, **p}, CAR_TARGET, beside(p["overlap_percent"]))


def _braking(p: Mapping[str, float]) -> Scenario:
    """CCRb: the target is as fast as the ego, `gap_m` ahead, or `headway_s` if that parameter is
    set.
    """
    gap = p["headway_s"] * p["ego_kmh"] * KMH if p["headway_s"] > 0.0 else p["gap_m"]
    return lead({**p, "target_kmh": p["ego_kmh"], "gap_m": gap}, CAR_TARGET, 0.0)


CBLA_WARNING = _family(
    "cbla_warning",
    "2023",
    "a cyclist rides along at the lane's side, the ego is fast",
    partial(_target_ahead, target=CYCLIST),
    {**ALONG, "target_kmh": 20.0, "overlap_percent": 25.0},
    {"ego_kmh": speeds(50, 80)},
)
TURNS = {"ego_kmh": (10.0, 15.0, 20.0), "target_kmh": (30.0, 45.0, 60.0)}
CCFTAP = _family(
    "ccftap",
    "2023",
    "the ego turns left across the way of an oncoming car",
    partial(_at_junction, target=CAR_TARGET, turn=1.0),
    TURNING,
    TURNS,
)
CMFTAP = _family(
    "cmftap",
    "2023",
    "the ego turns left across the way of an oncoming motorcycle",
    partial(_at_junction, target=MOTORCYCLE, turn=1.0),
    TURNING,
    TURNS,
)
CCFHOS_2023 = _family(
    "ccfhos",
    "2023",
    "a car comes towards the ego in its lane, as fast",
    partial(_head_on, target=CAR_TARGET),
    MEETING,
    {"ego_kmh": (50.0, 70.0), "target_kmh": (50.0, 70.0)},
    _is_as_fast,
)
CCFHOS_2026 = _family(
    "ccfhos",
    "2026",
    "a car comes towards the ego in its lane",
    partial(_head_on, target=CAR_TARGET),
    MEETING,
    {"ego_kmh": speeds(30, 80, 10), "target_kmh": (50.0, 70.0)},
)
CCCSCP = _family(
    "cccscp",
    "2026",
    "a car crosses on the main road, from the right (from_left 0) or from the left (1)",
    partial(_at_junction, target=CAR_TARGET, turn=0.0),
    CROSSED,
    {"ego_kmh": speeds(20, 60, 10), "target_kmh": speeds(20, 60, 10), "from_left": (0.0, 1.0)},
)
FAMILIES = (
    *_vulnerable("2023"),
    CBLA_WARNING,
    *_cars("2023"),
    CCFTAP,
    CMFTAP,
    CCFHOS_2023,
    *_vulnerable("2026"),
    *_cars("2026"),
    CCFHOS_2026,
    CCCSCP,
)
