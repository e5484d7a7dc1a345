"""Situations that tell a planner with a fault in its input or its decisions from one without: a
suite of their own, `--suite separating`, and no part of the others.

Each asks for what the other families seldom ask for: a stop sign without a light, a light that
turns yellow late, the second of two stop lines, a person who comes out of a standing queue, a car
that is fast and far to the side, a lead that brakes hard, a car that cuts in close, people on both
kerbs of a narrow road, a rider at its left edge. The logged driver obeys the rule, as in
`everyday`. The numbers are replan's own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import copysign, sqrt

import numpy as np

from replan.logs.agents import AgentKind
from replan.logs.catalogue.everyday import BRAKE_MPS2, RED_YELLOW_S, cut_in, stopping, yellow_light
from replan.logs.catalogue.family import expects, family
from replan.logs.catalogue.family_parts import (
    ADULT,
    BEYOND_M,
    BICYCLE,
    CAR,
    HALF_LANE,
    SIDEWALK_M,
    SPARE_S,
    START_M,
    WAITS,
    Ahead,
    drive,
    finished,
    grid,
    moving,
    parked,
    straight_path,
    walked,
)
from replan.logs.catalogue.roads import (
    LANE_WIDTH_M,
    junction,
    lanes_to_stop_lines,
    one_lane,
    two_way,
)
from replan.logs.plan import DecisionKind
from replan.logs.rules import Colour, TrafficLight
from replan.logs.scenario import Scenario
from replan.logs.vehicle import VehicleParameters

SOURCE = "ours"
STANDS_MPS, WAIT_S = 0.02, 0.8
"""Below this speed the driver has stopped at a sign; they drive on after this time."""
KEEPS_BEHIND = (DecisionKind.FOLLOW, *WAITS)
PASSES = (DecisionKind.IGNORE, DecisionKind.NUDGE_LEFT, DecisionKind.NUDGE_RIGHT)


@family(
    "separating/stop_sign",
    "a stop sign without a light on an empty road: stop at the line, then drive on",
    ("separating", "rules", "sign"),
    {"ego_speed_mps": 10.0, "distance_m": 90.0, "duration_s": 28.0},
    {"ego_speed_mps": (8.0, 10.0, 12.0)},
    SOURCE,
)
def stop_sign(p: Mapping[str, float]) -> Scenario:
    v, duration, car = p["ego_speed_mps"], p["duration_s"], VehicleParameters()
    line = START_M + car.axle_to_front + p["distance_m"]
    path = straight_path(v, duration)
    stops = drive(path, speed=v, duration=duration, ahead=lambda t, s: stopping(line, v, car, s))
    goes = float(stops.t[np.argmax(stops.v < STANDS_MPS)]) + WAIT_S

    def ahead(time: float, s: float) -> Ahead | None:
        return stopping(line, v, car, s) if time < goes else None

    driven = drive(path, speed=v, duration=duration, ahead=ahead)
    metadata = expects(**{"stop line 1": (DecisionKind.STOP,)})
    return finished(
        path, driven, [], lanes_to_stop_lines(path, {line: None}, v), duration, metadata=metadata
    )


late_amber = family(
    "separating/late_amber",
    "a light turns yellow late, where a firm stop is just possible: stop, then drive on at green",
    ("separating", "rules", "light"),
    {
        "ego_speed_mps": 8.3,
        "distance_m": 75.0,
        "yellow_s": 6.2,
        "yellow_lasts_s": 3.0,
        "red_lasts_s": 6.0,
        "reaction_s": 0.4,
        "duration_s": 30.0,
    },
    {"yellow_s": (5.8, 6.2)},
    SOURCE,
)(yellow_light.build)


@family(
    "separating/two_stop_lines",
    "two lights in a row: the first turns green while the second is still red: stop at each",
    ("separating", "rules", "light"),
    {
        "ego_speed_mps": 10.0,
        "distance_m": 70.0,
        "between_m": 40.0,
        "first_green_s": 12.0,
        "second_green_s": 26.0,
        "reaction_s": 0.5,
        "duration_s": 40.0,
    },
    {"between_m": (25.0, 40.0)},
    SOURCE,
)
def two_stop_lines(p: Mapping[str, float]) -> Scenario:
    v, duration, car = p["ego_speed_mps"], p["duration_s"], VehicleParameters()
    first, between = START_M + car.axle_to_front + p["distance_m"], p["between_m"]
    greens = {first: p["first_green_s"], first + between: p["second_green_s"]}
    # The driver speeds up on the first third of the way between the lines
    arrives = {first: v, first + between: min(v, sqrt(4.0 / 3.0 * BRAKE_MPS2 * between))}
    lights = tuple(
        TrafficLight(
            i,
            np.array([0.0, green - RED_YELLOW_S, green]),
            (Colour.RED, Colour.RED_YELLOW, Colour.GREEN),
        )
        for i, green in enumerate(greens.values(), start=1)
    )

    def ahead(time: float, s: float) -> Ahead | None:
        red = [line for line, green in greens.items() if time < green + p["reaction_s"]]
        return next(filter(None, (stopping(line, arrives[line], car, s) for line in red)), None)

    path = straight_path(v, duration)
    driven = drive(path, speed=v, duration=duration, ahead=ahead)
    road = lanes_to_stop_lines(path, dict(zip(greens, (1, 2), strict=True)), v)
    metadata = expects(**{f"stop line {i}": (DecisionKind.STOP,) for i in (1, 2)})
    return replace(finished(path, driven, [], road, duration, metadata=metadata), lights=lights)


@family(
    "separating/fast_car",
    "a fast car comes from far to the side on the main road: let it pass, then cross",
    ("separating", "rules", "junction"),
    {
        "ego_speed_mps": 8.3,
        "distance_m": 50.0,
        "from_left": 1.0,
        "limit_mps": 13.9,
        "car_speed_mps": 25.0,
        "passes_s": 6.0,
        "gap_s": 5.0,
        "behind_s": 0.6,
        "reaction_s": 0.4,
        "duration_s": 26.0,
    },
    {"from_left": (1.0, -1.0), "passes_s": (5.6, 6.2)},
    SOURCE,
)
def fast_car(p: Mapping[str, float]) -> Scenario:
    v, u, duration = p["ego_speed_mps"], p["car_speed_mps"], p["duration_s"]
    t, car, passes = grid(duration), VehicleParameters(), p["passes_s"]
    side = copysign(1.0, p["from_left"])
    reach = u * (duration + SPARE_S) + BEYOND_M
    begin = START_M + car.axle_to_front + p["distance_m"]
    crossroads = junction(begin, reach, reach, turn=0.0, speed_limit=p["limit_mps"])
    x, y = crossroads.center
    lane, along = x - side * HALF_LANE, y - side * u * (t - passes)
    fast = moving("fast", AgentKind.CAR, CAR, t, lane, along, yaw=-side * 0.5 * np.pi)

    def ahead(time: float, s: float) -> Ahead | None:
        arrival = time + max(0.0, begin - s - car.axle_to_front) / v
        has_passed = time - p["reaction_s"] >= passes + p["behind_s"]
        return None if has_passed or arrival <= passes - p["gap_s"] else stopping(begin, v, car, s)

    driven = drive(crossroads.path, speed=v, duration=duration, ahead=ahead)
    return finished(
        crossroads.path, driven, [fast], crossroads.road, duration, metadata=expects(fast=WAITS)
    )


@family(
    "separating/person_behind_queue",
    "a person comes out of a queue that stands on the opposite lane, and crosses: let them go",
    ("separating", "pedestrian", "traffic"),
    {
        "ego_speed_mps": 9.0,
        "distance_m": 60.0,
        "pedestrian_speed_mps": 2.0,
        "walk_start_s": 3.9,
        "kerb_distance_m": 0.6,
        "rest_distance_m": 2.5,
        "stop_distance_m": 3.0,
        "gap_m": 2.5,
        "reaction_s": 0.4,
        "duration_s": 24.0,
    },
    {"pedestrian_speed_mps": (1.4, 2.0, 2.4)},
    SOURCE,
)
def person_behind_queue(p: Mapping[str, float]) -> Scenario:
    v, duration, car = p["ego_speed_mps"], p["duration_s"], VehicleParameters()
    t, length = grid(duration), CAR[0] + p["gap_m"]
    line = START_M + car.axle_to_front + p["distance_m"]
    queue = [parked(f"queue_{k}", line + (k - 3.5) * length, LANE_WIDTH_M) for k in range(1, 7)]
    begin, end = LANE_WIDTH_M + HALF_LANE + p["kerb_distance_m"], -HALF_LANE - p["rest_distance_m"]
    share = walked(t - p["walk_start_s"], begin - end, p["pedestrian_speed_mps"])
    y = begin + (end - begin) * share
    person = moving("person", AgentKind.PEDESTRIAN, ADULT, t, line, y, yaw=-0.5 * np.pi)
    off_lane = float(t[np.argmax(y < -HALF_LANE - 0.5 * max(ADULT))])

    def ahead(time: float, s: float) -> Ahead | None:
        crosses = p["walk_start_s"] <= time < off_lane + p["reaction_s"]
        return stopping(line - p["stop_distance_m"], v, car, s) if crosses else None

    path = straight_path(v, duration)
    driven = drive(path, speed=v, duration=duration, ahead=ahead)
    road, metadata = two_way(path, v, sidewalk=SIDEWALK_M), expects(person=WAITS)
    return finished(path, driven, [*queue, person], road, duration, metadata=metadata)


@family(
    "separating/hard_braking_lead",
    "the lead brakes hard to a stop and drives on: keep the distance",
    ("separating", "traffic"),
    {
        "speed_mps": 13.9,
        "gap_m": 34.0,
        "brake_s": 4.0,
        "brake_mps2": 5.0,
        "stands_s": 4.0,
        "accel_mps2": 1.5,
        "duration_s": 26.0,
    },
    {"brake_mps2": (3.5, 5.0)},
    SOURCE,
)
def hard_braking_lead(p: Mapping[str, float]) -> Scenario:
    v, duration, car = p["speed_mps"], p["duration_s"], VehicleParameters()
    t = grid(duration)
    corners = np.cumsum([p["brake_s"], v / p["brake_mps2"], p["stands_s"], v / p["accel_mps2"]])
    u = np.interp(t, corners, [v, 0.0, 0.0, v])
    x = START_M + car.axle_to_front + p["gap_m"] + 0.5 * CAR[0]
    x = x + np.r_[0.0, np.cumsum(0.5 * (u[1:] + u[:-1]) * np.diff(t))]
    lead = moving("lead", AgentKind.CAR, CAR, t, x, 0.0, yaw=0.0)

    def ahead(time: float, s: float) -> Ahead:
        gap = float(np.interp(time, t, x)) - 0.5 * CAR[0] - (s + car.axle_to_front)
        return Ahead(gap, float(np.interp(time, t, u)))

    path = straight_path(v, duration)
    driven = drive(path, speed=v, duration=duration, ahead=ahead)
    metadata = expects(lead=KEEPS_BEHIND)
    return finished(path, driven, [lead], one_lane(path, v), duration, metadata=metadata)


close_cut_in = family(
    "separating/close_cut_in",
    "as everyday/cut_in, nearer: who sees the car a second late runs into it",
    ("separating", "cut_in"),
    {**cut_in.parameters, "gap_m": 10.0, "cut_in_duration_s": 2.0},
    {"relative_speed_mps": (-5.0, -4.0), "cut_in_duration_s": (2.0, 3.0)},
    SOURCE,
)(cut_in.build)


@family(
    "separating/both_kerbs",
    "people stand on both kerbs of a narrow road: pass in its middle",
    ("separating", "pedestrian"),
    {
        "ego_speed_mps": 8.3,
        "distance_m": 60.0,
        "kerb_distance_m": 0.4,
        "between_m": 9.0,
        "duration_s": 20.0,
    },
    {"ego_speed_mps": (8.3, 10.0), "kerb_distance_m": (0.15, 0.4)},
    SOURCE,
)
def both_kerbs(p: Mapping[str, float]) -> Scenario:
    v, duration, t = p["ego_speed_mps"], p["duration_s"], grid(p["duration_s"])
    first = START_M + VehicleParameters().axle_to_front + p["distance_m"]
    beside = HALF_LANE + p["kerb_distance_m"] + 0.5 * ADULT[1]
    people = [
        moving(
            f"{name}_{k + 1}",
            AgentKind.PEDESTRIAN,
            ADULT,
            t,
            first + k * p["between_m"],
            y,
            yaw=0.0,
        )
        for k in range(3)
        for name, y in (("left", beside), ("right", -beside))
    ]
    path = straight_path(v, duration)
    driven = drive(path, speed=v, duration=duration)
    road = one_lane(path, v, sidewalk=SIDEWALK_M)
    metadata = expects(**{person.id: PASSES for person in people})
    return finished(path, driven, people, road, duration, metadata=metadata)


@family(
    "separating/rider_at_left_edge",
    "a rider keeps to the left edge of a narrow road, and turns off there: stay behind until then",
    ("separating", "cyclist"),
    {
        "ego_speed_mps": 8.3,
        "rider_speed_mps": 4.0,
        "distance_m": 35.0,
        "lateral_m": 1.0,
        "turns_s": 9.0,
        "turn_speed_mps": 1.5,
        "rest_distance_m": 4.0,
        "reaction_s": 0.4,
        "duration_s": 20.0,
    },
    {"lateral_m": (1.0, 1.2)},
    SOURCE,
)
def rider_at_left_edge(p: Mapping[str, float]) -> Scenario:
    v, u, duration = p["ego_speed_mps"], p["rider_speed_mps"], p["duration_s"]
    t, car, aside = grid(duration), VehicleParameters(), p["rest_distance_m"]
    x = START_M + car.axle_to_front + p["distance_m"] + u * t
    y = p["lateral_m"] + aside * walked(t - p["turns_s"], aside, p["turn_speed_mps"])
    rider = moving("rider", AgentKind.BICYCLE, BICYCLE, t, x, y, yaw=0.0)
    off_lane = float(t[np.argmax(y > HALF_LANE + 0.5 * max(BICYCLE))])

    def ahead(time: float, s: float) -> Ahead | None:
        gap = float(np.interp(time, t, x)) - 0.5 * BICYCLE[0] - (s + car.axle_to_front)
        return Ahead(gap, u) if time < off_lane + p["reaction_s"] else None

    path = straight_path(v, duration)
    driven = drive(path, speed=v, duration=duration, ahead=ahead)
    road = one_lane(path, v, sidewalk=SIDEWALK_M)
    return finished(path, driven, [rider], road, duration, metadata=expects(rider=KEEPS_BEHIND))


FAMILIES = (
    stop_sign,
    late_amber,
    two_stop_lines,
    fast_car,
    person_behind_queue,
    hard_braking_lead,
    close_cut_in,
    both_kerbs,
    rider_at_left_edge,
)
