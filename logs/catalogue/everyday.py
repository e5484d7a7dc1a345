"""Everyday driving: a lead, a cut-in, a parked car, a cyclist, bends, cars that pull out; and
traffic rules.

Numbers: UN R157 4.3_1 (follow: headway 1.6 s, lead +-5 m/s at 1 m/s2), 4.4_1 (cut-in), 4.2_2 and
Euro NCAP practice (partly blocked lane); 1.5 m beside a cyclist in towns: StVO, 5 (4).

Rules: a red light that turns green, a green one that turns yellow, a pedestrian at a crosswalk, a
side road before a main road. A planner that ignores the rule runs the red light, drives on before
the waiting pedestrian, or violates the right of way of vehicles. The logged driver obeys it: they
stop `STOP_SHORT_M` before the line, and drive on `reaction_s` after the rule permits it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import copysign, pi, radians, sqrt

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind
from replan.logs.catalogue.family import expects, family
from replan.logs.catalogue.family_parts import (
    BEYOND_M,
    BICYCLE,
    CAR,
    HALF_LANE,
    SIDEWALK_M,
    SPARE_S,
    START_M,
    WAITS,
    Agent,
    Ahead,
    bypass,
    drive,
    finished,
    grid,
    moving,
    parked,
    past_parked_cars,
    pedestrian_across,
    straight_path,
    tenths,
    walked,
)
from replan.logs.catalogue.roads import (
    LANE_WIDTH_M,
    curve,
    junction,
    lanes_to_stop_lines,
    left_turn,
    one_lane,
    opposite,
    two_lanes,
    two_way,
    weaving,
)
from replan.logs.plan import DecisionKind
from replan.logs.rules import Colour, Crosswalk, TrafficLight
from replan.logs.scenario import Scenario
from replan.logs.vehicle import VehicleParameters

STOP_SHORT_M = 1.5
"""Space between the front of a stopped ego and the line."""
BRAKE_MPS2 = 1.2
"""The driver begins to brake where this deceleration stops them at the line, m/s2."""
RED_YELLOW_S = 1.0  # Duration of red and yellow before green
VAN = (6.0, 2.0)  # Length and width, m


@family(
    "everyday/follow",
    "follow a lead that slows by 5 m/s and speeds up again",
    ("everyday", "follow"),
    {
        "ego_speed_mps": 13.9,
        "headway_s": 1.6,
        "lead_change_mps": 5.0,
        "lead_accel_mps2": 1.0,
        "hold_s": 5.0,
        "limit_above_mps": 2.8,
        "duration_s": 28.0,
    },
)
def follow(p: Mapping[str, float]) -> Scenario:
    v, duration, thw = p["ego_speed_mps"], p["duration_s"], p["headway_s"]
    t, car = grid(duration), VehicleParameters()
    ramp = p["lead_change_mps"] / p["lead_accel_mps2"]
    corners = np.cumsum([p["hold_s"], ramp, p["hold_s"], ramp])
    speed = np.interp(t, corners, [v, v - p["lead_change_mps"], v - p["lead_change_mps"], v])
    if speed.min() < 0.0:
        raise ValueError("the lead would drive backwards")
    x = START_M + car.axle_to_front + thw * v + 0.5 * CAR[0]
    x = x + np.r_[0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(t))]
    lead = moving("lead", AgentKind.CAR, CAR, t, x, 0.0, yaw=0.0)

    def ahead(time: float, s: float) -> Ahead:
        gap = np.interp(time, t, x) - 0.5 * CAR[0] - (s + car.axle_to_front)
        return Ahead(float(gap), float(np.interp(time, t, speed)))

    path = curve((float(x[-1]) + BEYOND_M, 0.0, 0.0))
    limit = v + p["limit_above_mps"]
    driven = drive(path, speed=v, cruise=limit, duration=duration, ahead=ahead, thw=thw)
    metadata = expects(lead=(DecisionKind.FOLLOW, DecisionKind.YIELD))
    return finished(path, driven, [lead], one_lane(path, limit), duration, metadata=metadata)


@family(
    "everyday/cut_in",
    "a slower car cuts in from the neighbour lane",
    ("everyday", "cut_in"),
    {
        "ego_speed_mps": 16.7,
        "gap_m": 25.0,
        "relative_speed_mps": -5.0,
        "cut_in_start_s": 4.0,
        "cut_in_duration_s": 3.5,
        "reaction_s": 0.4,
        "duration_s": 22.0,
    },
)
def cut_in(p: Mapping[str, float]) -> Scenario:
    v, duration, car = p["ego_speed_mps"], p["duration_s"], VehicleParameters()
    other = v + p["relative_speed_mps"]
    if not other > 0.0:
        raise ValueError("the other would not drive forward")
    t = grid(duration)
    begin, run = p["cut_in_start_s"], p["cut_in_duration_s"]
    u = np.clip((t - begin) / run, 0.0, 1.0)
    y = -LANE_WIDTH_M * (1.0 - (10.0 - 15.0 * u + 6.0 * u**2) * u**3)
    entered = float(t[np.argmax(y + 0.5 * CAR[1] > -HALF_LANE)])
    gap_there = START_M + car.axle_to_front + v * entered + p["gap_m"] + 0.5 * CAR[0]
    x = gap_there + other * (t - entered)
    cutter = moving("cutter", AgentKind.CAR, CAR, t, x, y, yaw=0.0)

    def ahead(time: float, s: float) -> Ahead | None:
        gap = np.interp(time, t, x) - 0.5 * CAR[0] - (s + car.axle_to_front)
        return Ahead(float(gap), other) if time >= entered + p["reaction_s"] else None

    path = curve((float(x[-1]) + BEYOND_M, 0.0, 0.0))
    driven = drive(path, speed=v, duration=duration, ahead=ahead)
    metadata = {**expects(cutter=(DecisionKind.FOLLOW, *WAITS)), "entered_lane_s": repr(entered)}
    road = two_lanes(path, v, ego_on_right=False)
    return finished(
        path,
        driven,
        [cutter],
        road,
        duration,
        edges=(-3.0 * HALF_LANE, HALF_LANE),
        metadata=metadata,
    )


@family(
    "everyday/nudge",
    "a parked car reaches into the lane from the right",
    ("everyday", "static"),
    {
        "ego_speed_mps": 10.0,
        "distance_m": 80.0,
        "intrusion_m": 0.7,
        "clearance_m": 0.6,
        "shift_m": 30.0,
    },
)
def nudge(p: Mapping[str, float]) -> Scenario:
    v, width, station = p["ego_speed_mps"], VehicleParameters().width, START_M + p["distance_m"]
    edge = p["intrusion_m"] - HALF_LANE
    offset = max(0.0, bypass(edge, p["clearance_m"], width))
    run, beside = p["shift_m"], 10.0
    shifts = [
        (station - beside - run, station - beside, offset),
        (station + beside, station + beside + run, 0.0),
    ]
    end = station + beside + run + 60.0
    path = weaving(end + BEYOND_M, shifts)
    cars = [parked("parked", station, edge - 0.5 * CAR[1])]
    metadata = expects(parked=(DecisionKind.NUDGE_LEFT,))
    return past_parked_cars(path, cars, v, tenths((end - START_M) / v), metadata)


@family(
    "everyday/cyclist",
    "a cyclist rides in the lane, a car comes on the facing one: pass them after it",
    ("everyday", "cyclist"),
    {
        "ego_speed_mps": 10.0,
        "cyclist_speed_mps": 4.0,
        "distance_m": 45.0,
        "offset_m": -1.0,
        "clearance_m": 1.5,
        "shift_m": 40.0,
        "room_m": 2.0,
        "oncoming_m": 90.0,
        "oncoming_speed_mps": 10.0,
    },
)
def cyclist(p: Mapping[str, float]) -> Scenario:
    v, u, car = p["ego_speed_mps"], p["cyclist_speed_mps"], VehicleParameters()
    if not v > u:
        raise ValueError("the cyclist would not be reached")
    ahead = p["distance_m"] + car.axle_to_front + 0.5 * BICYCLE[0]
    run, room = p["shift_m"], p["room_m"]
    first, last = (
        v * (ahead + side * (car.length + BICYCLE[0])) / (v - u) + START_M for side in (-1.0, 1.0)
    )
    offset = max(0.0, bypass(p["offset_m"] + 0.5 * BICYCLE[1], p["clearance_m"], car.width))
    end = last + room + run + 40.0
    path = weaving(
        end + BEYOND_M,
        [(first - room - run, first - room, offset), (last + room, last + room + run, 0.0)],
    )
    duration = tenths((end - START_M) / v)
    t = grid(duration)
    rider = moving(
        "cyclist", AgentKind.BICYCLE, BICYCLE, t, START_M + ahead + u * t, p["offset_m"], yaw=0.0
    )
    comes, w = START_M + p["oncoming_m"], p["oncoming_speed_mps"]
    held = comes - CAR[0] - 0.25 * w**2  # then it brakes with 2 m/s2, to a stand at the road's end
    braking = np.clip(t - held / w, 0.0, 0.5 * w)
    driven_m = np.minimum(w * t, held) + w * braking - braking**2
    oncoming = moving("oncoming", AgentKind.CAR, CAR, t, comes - driven_m, LANE_WIDTH_M, yaw=pi)
    driven = drive(path, speed=v, duration=duration)
    straight = curve((path.length, 0.0, 0.0))
    metadata = expects(cyclist=(DecisionKind.NUDGE_LEFT,))
    return finished(
        straight, driven, [rider, oncoming], two_way(straight, v), duration, metadata=metadata
    )


def stopping(line: float, speed: float, car: VehicleParameters, s: float) -> Ahead | None:
    """The reaction of a driver at station `s` (rear axle), who arrives at `speed`, to the line at
    which they must stop.

    Stations in m, `speed` in m/s. None if the line is still far away, or the front is beyond it.
    """
    gap = line - STOP_SHORT_M - (s + car.axle_to_front)
    return Ahead(gap, stop=True) if -STOP_SHORT_M < gap < speed**2 / (2.0 * BRAKE_MPS2) else None


@family(
    "everyday/traffic_light",
    "a red light ahead that turns green: stop at the line, then drive on",
    ("everyday", "rules", "light"),
    {
        "ego_speed_mps": 13.9,
        "distance_m": 120.0,
        "green_s": 18.0,
        "reaction_s": 0.6,
        "duration_s": 34.0,
    },
)
def traffic_light(p: Mapping[str, float]) -> Scenario:
    green = p["green_s"]
    return _at_light(
        p, ((0.0, Colour.RED), (green - RED_YELLOW_S, Colour.RED_YELLOW), (green, Colour.GREEN))
    )


def _at_light(p: Mapping[str, float], changes: Sequence[tuple[float, Colour]]) -> Scenario:
    """A straight road with a light `distance_m` ahead that changes at these times, s.

    The last colour is green.
    """
    v, duration, car = p["ego_speed_mps"], p["duration_s"], VehicleParameters()
    line = START_M + car.axle_to_front + p["distance_m"]
    shown = {max(t, 0.0): colour for t, colour in changes}
    light = TrafficLight(1, np.array(list(shown)), tuple(shown.values()))

    def ahead(time: float, s: float) -> Ahead | None:
        goes = light.at(max(time - p["reaction_s"], 0.0)) is Colour.GREEN
        return None if goes else stopping(line, v, car, s)

    path = straight_path(v, duration)
    driven = drive(path, speed=v, duration=duration, ahead=ahead)
    road = lanes_to_stop_lines(path, {line: light.id}, v)
    metadata = (
        expects(**{"stop line 1": (DecisionKind.STOP,)})
        if p["distance_m"] / v < changes[-1][0]
        else {}
    )
    return replace(finished(path, driven, [], road, duration, metadata=metadata), lights=(light,))


@family(
    "everyday/crosswalk",
    "a pedestrian waits at a crosswalk and crosses when the car has slowed down: let them go first",
    ("everyday", "rules", "pedestrian"),
    {
        "ego_speed_mps": 10.0,
        "distance_m": 80.0,
        "crosswalk_width_m": 3.0,
        "pedestrian_speed_mps": 1.2,
        "walk_start_s": 6.0,
        "kerb_distance_m": 0.6,
        "rest_distance_m": 2.5,
        "reaction_s": 0.4,
        "duration_s": 28.0,
    },
)
def crosswalk(p: Mapping[str, float]) -> Scenario:
    v, duration, car = p["ego_speed_mps"], p["duration_s"], VehicleParameters()
    near = START_M + car.axle_to_front + p["distance_m"]
    far = near + p["crosswalk_width_m"]
    pedestrian, off_lane = pedestrian_across(p, 0.5 * (near + far))

    def ahead(time: float, s: float) -> Ahead | None:
        return None if time >= off_lane + p["reaction_s"] else stopping(near, v, car, s)

    path = straight_path(v, duration)
    driven = drive(path, speed=v, duration=duration, ahead=ahead)
    corners = [(near, -HALF_LANE), (far, -HALF_LANE), (far, HALF_LANE), (near, HALF_LANE)]
    road = replace(
        one_lane(path, v, sidewalk=SIDEWALK_M), crosswalks=(Crosswalk(1, np.array(corners)),)
    )
    metadata = {**expects(pedestrian=WAITS), "pedestrian_off_lane_s": repr(off_lane)}
    return finished(path, driven, [pedestrian], road, duration, metadata=metadata)


@family(
    "everyday/junction",
    "out of a side road over a main road: let both sides pass, then cross (turn 0), or turn left "
    "(1) or right (-1)",
    ("everyday", "rules", "junction"),
    {
        "ego_speed_mps": 8.3,
        "distance_m": 50.0,
        "turn": 0.0,
        "main_speed_mps": 13.9,
        "first_s": 6.0,
        "between_s": 2.5,
        "gap_s": 5.0,
        "behind_s": 0.6,
        "lateral_mps2": 1.3,
        "reaction_s": 0.4,
        "duration_s": 32.0,
    },
)
def at_junction(p: Mapping[str, float]) -> Scenario:
    v, duration, car = p["ego_speed_mps"], p["duration_s"], VehicleParameters()
    reach = max(v, p["main_speed_mps"]) * (duration + SPARE_S) + BEYOND_M
    begin = START_M + car.axle_to_front + p["distance_m"]
    crossroads = junction(begin, reach, reach, turn=p["turn"], speed_limit=p["main_speed_mps"])
    t, (x, y) = grid(duration), crossroads.center
    cars, passing = [], []
    # On the main road, from both sides in turn
    for k, name in enumerate(("left_1", "right_1", "left_2", "right_2")):
        time, side = p["first_s"] + k * p["between_s"], copysign(1.0, -(k % 2) + 0.5)
        along, lane = y - side * p["main_speed_mps"] * (t - time), x - side * HALF_LANE
        cars.append(moving(name, AgentKind.CAR, CAR, t, lane, along, yaw=-side * 0.5 * np.pi))
        passing.append(time)

    def ahead(time: float, s: float) -> Ahead | None:
        arrival = time + max(0.0, begin - s - car.axle_to_front) / v
        reacted_to = time - p["reaction_s"]
        free = not any(
            passes - p["gap_s"] < arrival and reacted_to < passes + p["behind_s"]
            for passes in passing
        )
        return None if free else stopping(begin, v, car, s)

    turning = min(v, sqrt(p["lateral_mps2"] * crossroads.radius))

    def cruise(s: float) -> float:
        if s < crossroads.begin:  # brakes gently towards the turn
            return min(v, sqrt(turning**2 + 2.0 * BRAKE_MPS2 * (crossroads.begin - s)))
        return turning if s < crossroads.end else p["main_speed_mps"]

    driven = drive(crossroads.path, speed=v, cruise=cruise, duration=duration, ahead=ahead)
    last = float(np.hypot(np.diff(driven.x), np.diff(driven.y)).sum()) + START_M
    metadata = {**expects(left_2=WAITS), "last_passes_s": repr(max(passing))}
    return finished(
        crossroads.path,
        driven,
        cars,
        crossroads.road,
        duration,
        begin=last - 10.0,
        metadata=metadata,
    )


@family(
    "everyday/yellow_light",
    "a light turns yellow where the car can just stop comfortably: stop, then drive on at green",
    ("everyday", "rules", "light"),
    {
        "ego_speed_mps": 13.9,
        "distance_m": 110.0,
        "yellow_s": 4.2,
        "yellow_lasts_s": 3.0,
        "red_lasts_s": 5.0,
        "reaction_s": 0.6,
        "duration_s": 26.0,
    },
)
def yellow_light(p: Mapping[str, float]) -> Scenario:
    red = p["yellow_s"] + p["yellow_lasts_s"]
    green = red + p["red_lasts_s"]
    changes = ((0.0, Colour.GREEN), (p["yellow_s"], Colour.YELLOW), (red, Colour.RED))
    return _at_light(
        p, (*changes, (green - RED_YELLOW_S, Colour.RED_YELLOW), (green, Colour.GREEN))
    )


@family(
    "everyday/bend",
    "two tight curves on a fast road of two empty lanes: slow down before them, keep the lane",
    ("everyday", "curve"),
    {
        "ego_speed_mps": 13.9,
        "distance_m": 60.0,
        "radius_m": 25.0,
        "clothoid_m": 16.0,
        "turn_deg": 90.0,
        "between_m": 25.0,
        "lateral_mps2": 1.6,
        "look_m": 10.0,
        "duration_s": 27.0,
    },
)
def bend(p: Mapping[str, float]) -> Scenario:
    v, kappa, clothoid = p["ego_speed_mps"], 1.0 / p["radius_m"], p["clothoid_m"]
    arc = radians(p["turn_deg"]) / kappa - clothoid
    turn = left_turn(arc, kappa, clothoid)
    beyond = v * (p["duration_s"] + SPARE_S)
    path = curve(
        (START_M + p["distance_m"], 0.0, 0.0),
        *turn,
        (p["between_m"], 0.0, 0.0),
        *opposite(turn),
        (beyond, 0.0, 0.0),
    )
    slow = np.minimum(v, np.sqrt(p["lateral_mps2"] / np.maximum(np.abs(path.kappa), 1e-9)))
    allowed = np.sqrt(  # it brakes gently towards each curve
        np.minimum.accumulate((slow**2 + 2.0 * BRAKE_MPS2 * path.s)[::-1])[::-1]
        - 2.0 * BRAKE_MPS2 * path.s
    )

    def cruise(s: float) -> float:
        return float(np.interp([s, s + p["look_m"]], path.s, allowed).min())

    driven = drive(path, speed=v, cruise=cruise, duration=p["duration_s"])
    last = float(np.hypot(np.diff(driven.x), np.diff(driven.y)).sum()) + START_M
    road, edges = two_lanes(path, v, ego_on_right=True), (-HALF_LANE, 3.0 * HALF_LANE)
    return finished(path, driven, [], road, p["duration_s"], begin=last - 10.0, edges=edges)


@family(
    "everyday/pull_outs",
    "cars pull out before the ego, one after the other, to pass vans that stand on the right lane",
    ("everyday", "traffic"),
    {
        "ego_speed_mps": 13.9,
        "car_speed_mps": 7.0,
        "van_m": 110.0,
        "between_m": 100.0,
        "gap_m": 55.0,
        "shift_m": 16.0,
        "follower_m": 25.0,
        "duration_s": 36.0,
    },
)
def pull_outs(p: Mapping[str, float]) -> Scenario:
    v, u, duration = p["ego_speed_mps"], p["car_speed_mps"], p["duration_s"]
    t, right, car = grid(duration), -LANE_WIDTH_M, VehicleParameters()
    path = straight_path(v, duration)
    agents: list[Agent] = []
    lanes: list[tuple[FloatArray, FloatArray]] = []

    def ahead(time: float, s: float) -> Ahead | None:
        gaps = [
            (float(np.interp(time, t, x)) - 0.5 * CAR[0] - s - car.axle_to_front, u)
            for x, y in lanes
            if float(np.interp(time, t, y)) + 0.5 * CAR[1] > -HALF_LANE
        ]
        nearest = min((gap for gap in gaps if gap[0] > 0.0), default=None)
        return None if nearest is None else Ahead(*nearest)

    # Each car stands behind its van, and pulls out when the driver is `gap_m` behind it
    for k in range(3):
        van, shift = START_M + p["van_m"] + k * p["between_m"], p["shift_m"]
        begin = van - 0.5 * VAN[0] - shift - 0.5 * CAR[0]
        driven = drive(path, speed=v, duration=duration, ahead=ahead)
        starts = float(
            np.interp(begin - 0.5 * CAR[0] - p["gap_m"] - car.axle_to_front, driven.x, driven.t)
        )
        distance = 4.0 * shift + VAN[0]
        x = begin + distance * walked(t - starts, distance, u, ramp=3.0)
        left, back = (
            np.clip((x - begin - far) / shift, 0.0, 1.0) for far in (0.0, 2.0 * shift + VAN[0])
        )
        y = right - right * (left**2 * (3.0 - 2.0 * left) - back**2 * (3.0 - 2.0 * back))
        lanes.append((x, y))
        agents += [
            parked(f"van_{k + 1}", van, right, size=VAN),
            moving(f"car_{k + 1}", AgentKind.CAR, CAR, t, x, y, yaw=0.0),
        ]
    driven = drive(path, speed=v, duration=duration, ahead=ahead)
    behind = (
        np.interp(t, driven.t, driven.x)
        + np.maximum(t - driven.t[-1], 0.0) * driven.v[-1]
        - p["follower_m"]
    )
    agents.append(moving("follower", AgentKind.CAR, CAR, t, behind, 0.0, yaw=0.0))
    metadata = expects(**{f"car_{k}": (DecisionKind.FOLLOW, *WAITS) for k in (1, 2, 3)})
    return finished(
        path, driven, agents, two_lanes(path, v, ego_on_right=False), duration, metadata=metadata
    )


FAMILIES = (follow, cut_in, nudge, cyclist, bend, pull_outs)
RULES = (traffic_light, crosswalk, at_junction, yellow_light)
