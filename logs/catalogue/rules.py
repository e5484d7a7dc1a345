"""Traffic rules: a red light that turns green, a pedestrian at a crosswalk, a side road before a main road.

Nothing forces the ego: a planner that ignores the rule runs the red light, drives on before the waiting pedestrian, or
takes the right of way of others. The logged driver obeys: it stops `STOP_SHORT_M` before the line, and drives on
`reaction_s` after it may.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import copysign, sqrt

import numpy as np

from logs.catalogue.driver import Ahead, drive
from logs.catalogue.family import Family, expects
from logs.catalogue.junctions import junction
from logs.catalogue.roads import lane_beside, one_lane
from logs.catalogue.scene import (
    BEYOND_M,
    CAR,
    HALF_LANE,
    SIDEWALK_M,
    SPARE_S,
    START_M,
    WAITS,
    crossing_pedestrian,
    finished,
    grid,
    moving,
    straight_path,
)
from logs.road import Road
from logs.rules import Colour, Crosswalk, StopLine, TrafficLight
from logs.scenario import AgentKind, Scenario
from logs.trace import DecisionKind
from logs.vehicle import VehicleParameters

STOP_SHORT_M = 1.5
BRAKE_MPS2 = 1.2
"""The driver begins to brake where this brings him to the line."""
RED_YELLOW_S = 1.0


def stopping(line: float, speed: float, car: VehicleParameters, s: float) -> Ahead | None:
    """What a driver with the rear axle at station `s`, arriving at `speed`, reacts to at a line with a mandatory stop.

    None: it is still far away, or the front is beyond it.
    """
    gap = line - STOP_SHORT_M - (s + car.axle_to_front)
    return Ahead(gap, stop=True) if -STOP_SHORT_M < gap < speed**2 / (2.0 * BRAKE_MPS2) else None


def _traffic_light(p: Mapping[str, float]) -> Scenario:
    v, duration, green, car = p["ego_speed_mps"], p["duration_s"], p["green_s"], VehicleParameters()
    line = START_M + car.axle_to_front + p["distance_m"]
    changes = ((0.0, Colour.RED), (green - RED_YELLOW_S, Colour.RED_YELLOW), (green, Colour.GREEN))
    shown = {max(t, 0.0): colour for t, colour in changes}
    light = TrafficLight(1, np.array(list(shown)), tuple(shown.values()))

    def ahead(time: float, s: float) -> Ahead | None:
        goes = light.at(time - p["reaction_s"]) is Colour.GREEN
        return None if goes else stopping(line, v, car, s)

    path = straight_path(v, duration)
    driven = drive(path, start=START_M, speed=v, cruise=v, duration=duration, ahead=ahead)
    before, behind = (
        replace(lane_beside(part, i, speed_limit=v), successors=after)
        for i, part, after in ((1, path.part(0.0, line), (2,)), (2, path.part(line, path.length), ()))
    )
    stop = StopLine(1, 1, np.vstack([before.right[-1], before.left[-1]]), light=light.id)
    road = Road({1: before, 2: behind}, default_speed_limit=v, stop_lines=(stop,))
    metadata = expects(**{f"stop line {stop.id}": (DecisionKind.STOP,)}) if p["distance_m"] / v < green else {}
    return replace(finished(path, driven, [], road, duration, metadata=metadata), lights=(light,))


TRAFFIC_LIGHT = Family(
    "everyday/traffic_light", "a red light ahead that turns green: stop at the line, then drive on",
    {"ego_speed_mps": 13.9, "distance_m": 120.0, "green_s": 18.0, "reaction_s": 0.6, "duration_s": 34.0},
    ("everyday", "rules", "light"), _traffic_light,
)  # fmt: skip


def _crosswalk(p: Mapping[str, float]) -> Scenario:
    v, duration, car = p["ego_speed_mps"], p["duration_s"], VehicleParameters()
    near = START_M + car.axle_to_front + p["distance_m"]
    far = near + p["crosswalk_width_m"]
    pedestrian, off_lane = crossing_pedestrian(p, 0.5 * (near + far))

    def ahead(time: float, s: float) -> Ahead | None:
        return None if time >= off_lane + p["reaction_s"] else stopping(near, v, car, s)

    path = straight_path(v, duration)
    driven = drive(path, start=START_M, speed=v, cruise=v, duration=duration, ahead=ahead)
    corners = [(near, -HALF_LANE), (far, -HALF_LANE), (far, HALF_LANE), (near, HALF_LANE)]
    road = replace(one_lane(path, v, sidewalk=SIDEWALK_M), crosswalks=(Crosswalk(1, np.array(corners)),))
    metadata = {**expects(pedestrian=WAITS), "pedestrian_off_lane_s": repr(off_lane)}
    return finished(path, driven, [pedestrian], road, duration, metadata=metadata)


CROSSWALK = Family(
    "everyday/crosswalk",
    "a pedestrian waits at a crosswalk and crosses when the car has slowed down: let them go first",
    {
        "ego_speed_mps": 10.0, "distance_m": 80.0, "crosswalk_width_m": 3.0, "pedestrian_speed_mps": 1.2,
        "walk_start_s": 6.0, "kerb_distance_m": 0.6, "rest_distance_m": 2.5, "reaction_s": 0.4, "duration_s": 28.0,
    },
    ("everyday", "rules", "pedestrian"), _crosswalk,
)  # fmt: skip


def _junction(p: Mapping[str, float]) -> Scenario:
    v, duration, car = p["ego_speed_mps"], p["duration_s"], VehicleParameters()
    reach = max(v, p["main_speed_mps"]) * (duration + SPARE_S) + BEYOND_M
    begin = START_M + car.axle_to_front + p["distance_m"]
    place = junction(begin, reach, reach, turn=p["turn"], speed_limit=p["main_speed_mps"])
    t, (x, y) = grid(duration), place.center
    cars, passing = [], []
    for k, name in enumerate(("left_1", "right_1", "left_2", "right_2")):  # on the main road, from both sides in turn
        at, side = p["first_s"] + k * p["between_s"], copysign(1.0, -(k % 2) + 0.5)
        way = y - side * p["main_speed_mps"] * (t - at)
        lane = np.full(len(t), x - side * HALF_LANE)
        cars.append(moving(name, AgentKind.CAR, CAR, t, lane, way, yaw=-side * 0.5 * np.pi))
        passing.append(at)

    def ahead(time: float, s: float) -> Ahead | None:
        there = time + max(0.0, begin - s - car.axle_to_front) / v
        now = time - p["reaction_s"]
        free = not any(at - p["gap_s"] < there and now < at + p["behind_s"] for at in passing)
        return None if free else stopping(begin, v, car, s)

    turning = min(v, sqrt(p["lateral_mps2"] * place.radius))

    def cruise(s: float) -> float:
        if s < place.begin:  # brakes gently towards the turn
            return min(v, sqrt(turning**2 + 2.0 * BRAKE_MPS2 * (place.begin - s)))
        return turning if s < place.end else p["main_speed_mps"]

    driven = drive(place.path, start=START_M, speed=v, cruise=cruise, duration=duration, ahead=ahead)
    last = float(np.hypot(np.diff(driven.x), np.diff(driven.y)).sum()) + START_M
    metadata = {**expects(left_2=WAITS), "last_passes_s": repr(max(passing))}
    return finished(place.path, driven, cars, place.road, duration, begin=last - 10.0, metadata=metadata)


JUNCTION = Family(
    "everyday/junction",
    "out of a side road over a main road: let both sides pass, then cross (turn 0), or turn left (1) or right (-1)",
    {
        "ego_speed_mps": 8.3, "distance_m": 50.0, "turn": 0.0, "main_speed_mps": 13.9, "first_s": 6.0, "between_s": 2.5,
        "gap_s": 5.0, "behind_s": 0.6, "lateral_mps2": 1.3, "reaction_s": 0.4, "duration_s": 32.0,
    },
    ("everyday", "rules", "junction"), _junction,
)  # fmt: skip
FAMILIES = (TRAFFIC_LIGHT, CROSSWALK, JUNCTION)
