"""The scenarios of UN R157 (automated lane keeping), with their grids.

Numbers as in the OpenSCENARIO files of ASAM/openMSL (sl-3-1-osc-alks-scenarios b49dc1dd). The ego
drives 5 to 60 km/h in a lane 3.5 m wide. Differences: the ego would meet standing targets after 6
s, as in Euro NCAP's tests (from the 500 m of 4.2_1 a drive at 5 km/h would last six minutes); a
cut-in or cut-out begins after 2 s, its lateral speed ramps up and down in 0.4 s, and an
acceleration lasts until the ego's speed at the begin, or standstill; a lead that cuts out is 2.0 s
ahead. 4.4_2, the unavoidable cut-in, is a cell of 4.4_1: 10 m, 3 m/s.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from math import pi

import numpy as np

from replan.logs.agents import AgentKind
from replan.logs.catalogue.family import Build, Family, family
from replan.logs.catalogue.family_parts import (
    BEYOND_M,
    CAR,
    HALF_LANE,
    SPARE_S,
    START_M,
    Ahead,
    grid,
    moving,
    parked,
    walked,
)
from replan.logs.catalogue.protocols import (
    CROSSING,
    FOLLOWS,
    KMH,
    PEDESTRIAN,
    RAMP_S,
    STOP_M,
    TTC_S,
    Target,
    crossing,
    lead,
    lead_speed,
    speeds,
    straight,
    tested,
    travelled,
)
from replan.logs.catalogue.roads import LANE_WIDTH_M, curve, one_lane, two_lanes
from replan.logs.plan import DecisionKind
from replan.logs.scenario import Scenario
from replan.logs.vehicle import VehicleParameters

SOURCE = "UN R157 (ALKS), per openMSL/sl-3-1-osc-alks-scenarios b49dc1dd"
EGO = {"ego_kmh": speeds(5, 60)}
OTHER = Target("car", AgentKind.CAR, CAR)
TRIGGER_S = 2.0
HEADWAY_S = 2.0
LATERAL_MPS = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
BASE: Mapping[str, float] = {"ego_kmh": 60.0, "reaction_s": 0.4, "duration_s": 18.0}
CHANGES: Mapping[str, float] = {
    **BASE,
    "headway_s": HEADWAY_S,
    "brake_s": TRIGGER_S,
    "brake_mps2": 6.0,
    "change_kmh": -60.0,
    "lateral_m": 0.0,
}


def _family(
    number: str,
    name: str,
    summary: str,
    parameters: Mapping[str, float],
    grid: Mapping[str, tuple[float, ...]] = EGO,
    holds: Callable[[Mapping[str, float]], bool] = lambda p: True,
) -> Callable[[Build], Family]:
    tags = ("unece_r157", f"r157_{number}")
    return family(
        f"unece_r157/{name}", f"{number}: {summary}", tags, parameters, grid, SOURCE, holds
    )


@_family(
    "4.1_1",
    "free",
    "lane keeping, straight on or in a curve",
    {**BASE, "kappa_per_m": 0.0},
    {**EGO, "kappa_per_m": (-0.004, -0.001, 0.0, 0.001, 0.004)},
)
def free(p: Mapping[str, float]) -> Scenario:
    """4.1_1: lane keeping on an arc that begins after 20 m, with clothoids of 20 m.

    Curvature 0 is straight on.
    """
    v, kappa = p["ego_kmh"] * KMH, p["kappa_per_m"]
    length = START_M + v * (p["duration_s"] + SPARE_S) + BEYOND_M
    path = curve((START_M + 20.0, 0.0, 0.0), (20.0, 0.0, kappa), (length, kappa, kappa))
    end = START_M + v * p["duration_s"] - 5.0
    return tested(p, path, one_lane(path, v), [], {}, beyond=end)


@_family(
    "4.1_2",
    "swerving_lead",
    "the car ahead swings in its lane",
    {**BASE, "swing_m": 1.5, "lateral_mps2": 0.3, "headway_s": HEADWAY_S},
)
def swerves(p: Mapping[str, float]) -> Scenario:
    """4.1_2: a lead swings in its lane, once to each side, with a lateral acceleration of at most
    `lateral_mps2`.
    """
    v, t, car = p["ego_kmh"] * KMH, grid(p["duration_s"]), VehicleParameters()
    omega = (p["lateral_mps2"] / p["swing_m"]) ** 0.5
    phase = np.clip(omega * (t - TRIGGER_S), 0.0, 2.0 * pi)
    # Begins and ends without a jump of speed
    y = p["swing_m"] * np.sin(phase) * np.sin(0.5 * phase)
    x = START_M + car.axle_to_front + p["headway_s"] * v + 0.5 * CAR[0] + v * t
    other = moving("car", AgentKind.CAR, CAR, t, x, y, yaw=0.0)
    path, end = straight(p), START_M + v * p["duration_s"] - 5.0
    return tested(p, path, one_lane(path, v), [other], {"car": FOLLOWS}, beyond=end)


@_family(
    "4.1_3",
    "alongside",
    "a car beside the ego, near the marking",
    {**BASE, "offset_m": 0.0, "from_marking_m": 0.3},
    {**EGO, "offset_m": (-5.0, -2.5, 0.0, 2.5, 5.0)},
)
def alongside(p: Mapping[str, float]) -> Scenario:
    """4.1_3: a car in the neighbour lane, as fast as the ego, close to the marking between."""
    v, t, car = p["ego_kmh"] * KMH, grid(p["duration_s"]), VehicleParameters()
    x = START_M + car.axle_to_center + p["offset_m"] + v * t
    y = np.full(len(t), HALF_LANE + 0.5 * CAR[1] + p["from_marking_m"])
    other = moving("car", AgentKind.CAR, CAR, t, x, y, yaw=0.0)
    path = straight(p)
    road, end = two_lanes(path, v, ego_on_right=True), START_M + v * p["duration_s"] - 5.0
    return tested(p, path, road, [other], {"car": tuple(DecisionKind)}, beyond=end)


def _blocked_lane(p: Mapping[str, float]) -> Scenario:
    """4.2_1, 4.2_2: a stopped car in the lane, `lateral_m` to the left of its middle.

    The neighbour lane is free.
    """
    v, car = p["ego_kmh"] * KMH, VehicleParameters()
    x = START_M + car.axle_to_front + v * TTC_S + 0.5 * CAR[0]
    rear = x - 0.5 * CAR[0]
    path, beside = straight(p), abs(p["lateral_m"]) >= 0.5 * (CAR[1] + car.width)

    def ahead(time: float, s: float) -> Ahead | None:
        return (
            None
            if beside or time < p["reaction_s"]
            else Ahead(rear - STOP_M - (s + car.axle_to_front), stop=True)
        )

    around = (*FOLLOWS, DecisionKind.NUDGE_LEFT, DecisionKind.NUDGE_RIGHT, DecisionKind.OVERTAKE)
    kinds = tuple(DecisionKind) if beside else around
    stopped = parked("car", x, p["lateral_m"])
    return tested(p, path, one_lane(path, v), [stopped], {"car": kinds}, ahead)


def _braking(p: Mapping[str, float]) -> Scenario:
    """4.3_1 and 4.3_2: a lead `headway_s` ahead changes its speed."""
    to = max(p["ego_kmh"] + p["change_kmh"], 0.0)
    gap = p["headway_s"] * p["ego_kmh"] * KMH
    return lead(
        {**p, "target_kmh": p["ego_kmh"], "gap_m": gap, "brake_to_kmh": to}, OTHER, p["lateral_m"]
    )


def _forward(p: Mapping[str, float]) -> bool:
    """Whether the vehicle that cuts in drives forward."""
    return p["ego_kmh"] + p["relative_kmh"] > 0.0


def _clears(p: Mapping[str, float]) -> bool:
    """Whether the lead that cuts out is beside the car that stands when their bumpers meet."""
    after = np.array([p["distance_m"] / (p["ego_kmh"] * KMH)])
    return LANE_WIDTH_M * float(walked(after, LANE_WIDTH_M, p["lateral_mps"], RAMP_S)[0]) >= CAR[1]


@_family(
    "4.4_1",
    "cut_in",
    "a slower car cuts in",
    {**BASE, "relative_kmh": -20.0, "gap_m": 30.0, "lateral_mps": 2.0, "accel_mps2": 0.0},
    {
        "ego_kmh": speeds(20, 60, 10),
        "relative_kmh": speeds(-50, -10, 10),
        "gap_m": speeds(0, 60, 10),
        "lateral_mps": LATERAL_MPS,
        "accel_mps2": (-3.0, -1.5, 0.0, 1.5, 3.0),
    },
    _forward,
)
def cut_in(p: Mapping[str, float]) -> Scenario:
    """4.4_1: a slower car comes in from the lane to the right, `gap_m` ahead of the ego's front at
    the begin.
    """
    v, u, car = p["ego_kmh"] * KMH, (p["ego_kmh"] + p["relative_kmh"]) * KMH, VehicleParameters()
    if not _forward(p):
        raise ValueError(
            f"with {p['relative_kmh']:g} km/h relative to the ego's the other would not drive "
            "forward"
        )
    t = grid(p["duration_s"])
    speed = lead_speed(t, TRIGGER_S, u, p["accel_mps2"], v if p["accel_mps2"] > 0.0 else 0.0)
    driven_m = travelled(t, speed)
    front, half = car.axle_to_front, 0.5 * CAR[0]
    x = START_M + front + v * TRIGGER_S + p["gap_m"] + half + driven_m - u * TRIGGER_S
    y = -LANE_WIDTH_M * (1.0 - walked(t - TRIGGER_S, LANE_WIDTH_M, p["lateral_mps"], RAMP_S))
    cutter = moving("cutter", AgentKind.CAR, CAR, t, x, y, yaw=0.0)
    noticed = float(t[np.argmax(y + 0.5 * CAR[1] > -HALF_LANE)]) + p["reaction_s"]

    def ahead(time: float, s: float) -> Ahead | None:
        gap, now = (
            float(np.interp(time, t, x)) - half - (s + front),
            float(np.interp(time, t, speed)),
        )
        return Ahead(gap - STOP_M, now, stop=now == 0.0) if time >= noticed else None

    path = straight(p)
    road = two_lanes(path, v, ego_on_right=False)
    return tested(p, path, road, [cutter], {"cutter": (*FOLLOWS, DecisionKind.NUDGE_RIGHT)}, ahead)


@_family(
    "4.5_1",
    "cut_out",
    "the car ahead leaves the lane, in which another stands",
    {**BASE, "distance_m": 50.0, "lateral_mps": 2.0},
    {"ego_kmh": speeds(10, 60, 10), "distance_m": speeds(10, 100, 10), "lateral_mps": LATERAL_MPS},
    _clears,
)
def cut_out(p: Mapping[str, float]) -> Scenario:
    """4.5_1: the lead leaves the lane to the left, `distance_m` before a car that stands in it."""
    v, car = p["ego_kmh"] * KMH, VehicleParameters()
    t = grid(p["duration_s"])
    lead_x = START_M + car.axle_to_front + HEADWAY_S * v + 0.5 * CAR[0] + v * t
    stopped = (
        START_M
        + car.axle_to_front
        + HEADWAY_S * v
        + CAR[0]
        + v * TRIGGER_S
        + p["distance_m"]
        + 0.5 * CAR[0]
    )
    y = LANE_WIDTH_M * walked(t - TRIGGER_S, LANE_WIDTH_M, p["lateral_mps"], RAMP_S)
    if not _clears(p):
        raise ValueError("the lead would drive into the car that stands before it")
    agents = [
        moving("lead", AgentKind.CAR, CAR, t, lead_x, y, yaw=0.0),
        parked("stopped", stopped, 0.0),
    ]
    shows = float(t[np.argmax(y > 0.5 * CAR[1])]) + p["reaction_s"]

    def ahead(time: float, s: float) -> Ahead | None:
        gap = stopped - 0.5 * CAR[0] - STOP_M - (s + car.axle_to_front)
        return Ahead(gap, stop=True) if time >= shows else None

    path = straight(p)
    road = two_lanes(path, v, ego_on_right=True)
    return tested(p, path, road, agents, {"stopped": (*FOLLOWS, DecisionKind.NUDGE_LEFT)}, ahead)


FAMILIES = (
    free,
    swerves,
    alongside,
    _family("4.2_1", "blocking_obstacle", "a car stands in the lane", {**BASE, "lateral_m": 0.0})(
        _blocked_lane
    ),
    _family(
        "4.2_2",
        "partly_blocking",
        "a car stands partly in the lane",
        {**BASE, "lateral_m": 1.0},
        {**EGO, "lateral_m": tuple(0.25 * k for k in range(-8, 9))},
    )(_blocked_lane),
    _family(
        "4.2_3",
        "crossing_pedestrian",
        "a pedestrian crosses from 5 m beside the ego's path",
        {**CROSSING, "ego_kmh": 60.0, "start_m": 5.0},
    )(partial(crossing, target=PEDESTRIAN)),
    _family(
        "4.3_1",
        "following",
        "the car ahead becomes slower or faster by 5 m/s",
        {**CHANGES, "headway_s": 1.6, "brake_mps2": 1.0, "change_kmh": -18.0},
        {"ego_kmh": speeds(20, 60), "change_kmh": (-18.0, 18.0)},
    )(_braking),
    _family(
        "4.3_2",
        "braking_lead",
        "the car ahead brakes to standstill",
        CHANGES,
        {
            **EGO,
            "brake_mps2": (*(float(k) for k in range(1, 10)), 9.81),
            "lateral_m": (-1.75, 0.0, 1.75),
        },
    )(_braking),
    cut_in,
    cut_out,
)
