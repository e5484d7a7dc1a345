"""The tests of the paper: free driving, static obstacles on both sides, a crossing pedestrian.

The paper gives no numbers; these are a passenger car's: arcs of 50 m at 12 m/s (2.9 m/s2 to the
side), cars that leave 0.7 m of clearance, a pedestrian at 1 m/s before a car at 36 km/h, so that a
careful driver brakes for about 4 s.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import radians

import numpy as np

from replan.logs.catalogue.family import expects, family
from replan.logs.catalogue.family_parts import (
    BEYOND_M,
    CAR,
    HALF_LANE,
    SIDEWALK_M,
    START_M,
    WAITS,
    bypass,
    drive,
    finished,
    parked,
    past_parked_cars,
    pedestrian_across,
    straight_path,
    tenths,
    waiting,
)
from replan.logs.catalogue.roads import curve, left_turn, one_lane, opposite, weaving
from replan.logs.plan import DecisionKind
from replan.logs.scenario import Scenario
from replan.logs.vehicle import VehicleParameters


@family(
    "paper/free_road",
    "S-curve left then right, no obstacle: tracking",
    ("paper", "free"),
    {
        "ego_speed_mps": 12.0,
        "radius_m": 50.0,
        "turn_deg": 60.0,
        "clothoid_m": 20.0,
        "straight_m": 60.0,
    },
)
def free_road(p: Mapping[str, float]) -> Scenario:
    radius, clothoid, v = p["radius_m"], p["clothoid_m"], p["ego_speed_mps"]
    kappa = 1.0 / radius
    arc = radius * radians(p["turn_deg"]) - clothoid
    bend = left_turn(arc, kappa, clothoid)
    entry, exit_ = p["straight_m"] + START_M, p["straight_m"] + 20.0
    path = curve((entry, 0.0, 0.0), *bend, *opposite(bend), (exit_ + BEYOND_M, 0.0, 0.0))
    duration = tenths((path.length - BEYOND_M - START_M) / v)
    driven = drive(path, speed=v, duration=duration)
    return finished(
        path, driven, [], one_lane(path, v), duration, begin=path.length - BEYOND_M - 10.0
    )


@family(
    "paper/static_obstacles",
    "parked cars reach into the lane from the right, from the left and from the right: bypass left "
    "and right",
    ("paper", "static"),
    {
        "ego_speed_mps": 8.0,
        "first_m": 60.0,
        "spacing_m": 50.0,
        "intrusion_right_m": 1.0,
        "intrusion_left_m": 0.85,
        "clearance_m": 0.7,
    },
)
def static_obstacles(p: Mapping[str, float]) -> Scenario:
    v, spacing, width = p["ego_speed_mps"], p["spacing_m"], VehicleParameters().width
    stations = START_M + p["first_m"] + spacing * np.arange(3)
    from_right = p["intrusion_right_m"] - HALF_LANE
    from_left = HALF_LANE - p["intrusion_left_m"]
    cars = (
        parked("right_1", stations[0], from_right - 0.5 * CAR[1]),
        parked("left", stations[1], from_left + 0.5 * CAR[1]),
        parked("left_outer", stations[1], from_left + 1.5 * CAR[1] + 0.4),
        parked("right_2", stations[2], from_right - 0.5 * CAR[1]),
    )
    to_left = max(0.0, bypass(from_right, p["clearance_m"], width))
    to_right = min(0.0, bypass(from_left, -p["clearance_m"], width))
    # Length of each shift, and of the straight beside each car
    run, flat = 0.6 * spacing, 0.2 * spacing
    past = [
        (station - flat - run, station - flat, left)
        for station, left in zip(stations, (to_left, to_right, to_left), strict=True)
    ]
    last = stations[2] + flat
    path = weaving(last + run + 40.0 + BEYOND_M, [*past, (last, last + run, 0.0)])
    duration = tenths((stations[2] + spacing + 40.0 - START_M) / v)
    left, right = (DecisionKind.NUDGE_LEFT,), (DecisionKind.NUDGE_RIGHT,)
    metadata = expects(right_1=left, left=right, right_2=left)
    return past_parked_cars(path, cars, v, duration, metadata)


@family(
    "paper/crossing_pedestrian",
    "a pedestrian crosses from the right, leaves the lane and stands still: brake, then drive on",
    ("paper", "pedestrian"),
    {
        "ego_speed_mps": 10.0,
        "pedestrian_speed_mps": 0.85,
        "walk_start_s": 5.0,
        "distance_m": 33.0,
        "kerb_distance_m": 0.6,
        "rest_distance_m": 2.5,
        "stop_distance_m": 3.0,
        "reaction_s": 0.4,
        "duration_s": 26.0,
    },
)
def crossing_pedestrian(p: Mapping[str, float]) -> Scenario:
    v, duration, front = p["ego_speed_mps"], p["duration_s"], VehicleParameters().axle_to_front
    x = START_M + front + v * p["walk_start_s"] + p["distance_m"]
    pedestrian, off_lane = pedestrian_across(p, x)
    path = straight_path(v, duration)
    ahead = waiting(x, p["stop_distance_m"], p["walk_start_s"] + p["reaction_s"], off_lane, front)
    driven = drive(path, speed=v, duration=duration, ahead=ahead)
    metadata = {**expects(pedestrian=WAITS), "pedestrian_off_lane_s": repr(off_lane)}
    return finished(
        path,
        driven,
        [pedestrian],
        one_lane(path, v, sidewalk=SIDEWALK_M),
        duration,
        metadata=metadata,
    )


FAMILIES = (free_road, static_obstacles, crossing_pedestrian)
