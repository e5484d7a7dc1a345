"""Everyday driving: follow a lead, let someone cut in, pass a parked car, pass a cyclist.

Numbers: UN R157 4.3_1 (follow: headway 1.6 s, lead +-5 m/s at 1 m/s2), 4.4_1 (cut-in), 4.2_2 and Euro NCAP practice
(partly blocked lane); 1.5 m beside a cyclist in towns: StVO, 5 (4).
"""

from __future__ import annotations

from collections.abc import Mapping
from math import pi

import numpy as np

from logs.catalogue.driver import Ahead, drive
from logs.catalogue.family import Family, expects
from logs.catalogue.roads import LANE_WIDTH_M, curve, one_lane, two_lanes, two_way, weaving
from logs.catalogue.scene import (
    BEYOND_M,
    BICYCLE,
    CAR,
    HALF_LANE,
    START_M,
    WAITS,
    bypass,
    finished,
    grid,
    moving,
    parked,
    tenths,
)
from logs.scenario import AgentKind, Scenario
from logs.trace import DecisionKind
from logs.vehicle import VehicleParameters


def _follow(p: Mapping[str, float]) -> Scenario:
    v, duration, thw, car = p["ego_speed_mps"], p["duration_s"], p["headway_s"], VehicleParameters()
    t = grid(duration)
    ramp = p["lead_change_mps"] / p["lead_accel_mps2"]
    corners = np.cumsum([p["hold_s"], ramp, p["hold_s"], ramp])
    speed = np.interp(t, corners, [v, v - p["lead_change_mps"], v - p["lead_change_mps"], v])
    if speed.min() < 0.0:
        raise ValueError("the lead would drive backwards")
    x = START_M + car.axle_to_front + thw * v + 0.5 * CAR[0]
    x = x + np.r_[0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(t))]
    lead = moving("lead", AgentKind.CAR, CAR, t, x, np.zeros(len(t)), yaw=0.0)

    def ahead(time: float, s: float) -> Ahead:
        gap = np.interp(time, t, x) - 0.5 * CAR[0] - (s + car.axle_to_front)
        return Ahead(float(gap), float(np.interp(time, t, speed)))

    path = curve((float(x[-1]) + BEYOND_M, 0.0, 0.0))
    limit = v + p["limit_above_mps"]
    driven = drive(path, start=START_M, speed=v, cruise=limit, duration=duration, ahead=ahead, thw=thw)
    metadata = expects(lead=(DecisionKind.FOLLOW, DecisionKind.YIELD))
    return finished(path, driven, [lead], one_lane(path, limit), duration, metadata=metadata)


FOLLOW = Family(
    "everyday/follow", "follow a lead that slows by 5 m/s and speeds up again",
    {
        "ego_speed_mps": 13.9, "headway_s": 1.6, "lead_change_mps": 5.0, "lead_accel_mps2": 1.0, "hold_s": 5.0,
        "limit_above_mps": 2.8, "duration_s": 28.0,
    },
    ("everyday", "follow"), _follow,
)  # fmt: skip


def _cut_in(p: Mapping[str, float]) -> Scenario:
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
    driven = drive(path, start=START_M, speed=v, cruise=v, duration=duration, ahead=ahead)
    metadata = {**expects(cutter=(DecisionKind.FOLLOW, *WAITS)), "entered_lane_s": repr(entered)}
    road = two_lanes(path, v, ego_on_right=False)
    return finished(path, driven, [cutter], road, duration, right=-3.0 * HALF_LANE, metadata=metadata)


CUT_IN = Family(
    "everyday/cut_in", "a slower car cuts in from the neighbour lane",
    {
        "ego_speed_mps": 16.7, "gap_m": 25.0, "relative_speed_mps": -5.0, "cut_in_start_s": 4.0,
        "cut_in_duration_s": 3.5, "reaction_s": 0.4, "duration_s": 22.0,
    },
    ("everyday", "cut_in"), _cut_in,
)  # fmt: skip


def _nudge(p: Mapping[str, float]) -> Scenario:
    v, width, at = p["ego_speed_mps"], VehicleParameters().width, START_M + p["distance_m"]
    edge = p["intrusion_m"] - HALF_LANE
    offset = max(0.0, bypass(edge, p["clearance_m"], width))
    run, beside = p["shift_m"], 10.0
    shifts = [(at - beside - run, at - beside, offset), (at + beside, at + beside + run, 0.0)]
    end = at + beside + run + 60.0
    path = weaving(end + BEYOND_M, shifts)
    duration = tenths((end - START_M) / v)
    driven = drive(path, start=START_M, speed=v, cruise=v, duration=duration)
    straight = curve((path.length, 0.0, 0.0))
    cars, road = [parked("parked", at, edge - 0.5 * CAR[1])], two_lanes(straight, v, ego_on_right=True)
    metadata = expects(parked=(DecisionKind.NUDGE_LEFT,))
    return finished(straight, driven, cars, road, duration, left=3.0 * HALF_LANE, metadata=metadata)


NUDGE = Family(
    "everyday/nudge", "a parked car reaches into the lane from the right",
    {"ego_speed_mps": 10.0, "distance_m": 80.0, "intrusion_m": 0.7, "clearance_m": 0.6, "shift_m": 30.0},
    ("everyday", "static"), _nudge,
)  # fmt: skip


def _cyclist(p: Mapping[str, float]) -> Scenario:
    v, u, car, facing = p["ego_speed_mps"], p["cyclist_speed_mps"], VehicleParameters(), LANE_WIDTH_M
    if not v > u:
        raise ValueError("the cyclist would not be reached")
    ahead, run, room = p["distance_m"] + car.axle_to_front + 0.5 * BICYCLE[0], p["shift_m"], p["room_m"]
    first, last = (v * (ahead + side * (car.length + BICYCLE[0])) / (v - u) + START_M for side in (-1.0, 1.0))
    offset = max(0.0, bypass(p["offset_m"] + 0.5 * BICYCLE[1], p["clearance_m"], car.width))
    end = last + room + run + 40.0
    path = weaving(end + BEYOND_M, [(first - room - run, first - room, offset), (last + room, last + room + run, 0.0)])
    duration = tenths((end - START_M) / v)
    t = grid(duration)
    beside = np.full(len(t), p["offset_m"])
    rider = moving("cyclist", AgentKind.BICYCLE, BICYCLE, t, START_M + ahead + u * t, beside, yaw=0.0)
    comes, w = START_M + p["oncoming_m"], p["oncoming_speed_mps"]
    held = comes - CAR[0] - 0.25 * w**2  # then it brakes with 2 m/s2, to a stand at the road's end
    braking = np.clip(t - held / w, 0.0, 0.5 * w)
    gone = np.minimum(w * t, held) + w * braking - braking**2
    oncoming = moving("oncoming", AgentKind.CAR, CAR, t, comes - gone, np.full(len(t), facing), yaw=pi)
    driven = drive(path, start=START_M, speed=v, cruise=v, duration=duration)
    straight = curve((path.length, 0.0, 0.0))
    metadata = expects(cyclist=(DecisionKind.NUDGE_LEFT,))
    return finished(straight, driven, [rider, oncoming], two_way(straight, v), duration, metadata=metadata)


CYCLIST = Family(
    "everyday/cyclist", "a cyclist rides in the lane, a car comes on the facing one: pass them after it",
    {
        "ego_speed_mps": 10.0, "cyclist_speed_mps": 4.0, "distance_m": 45.0, "offset_m": -1.0, "clearance_m": 1.5,
        "shift_m": 40.0, "room_m": 2.0, "oncoming_m": 90.0, "oncoming_speed_mps": 10.0,
    },
    ("everyday", "cyclist"), _cyclist,
)  # fmt: skip
FAMILIES = (FOLLOW, CUT_IN, NUDGE, CYCLIST)
