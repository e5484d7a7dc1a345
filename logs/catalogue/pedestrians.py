"""Pedestrians who turn back, hesitate, run out, jaywalk, cross in groups, walk along the lane, come
from both sides.

One straight lane with sidewalks along x. A walk is a sum of legs, each at its own speed with ramps
of 0.4 s (`scene.walked`); where one leg begins as the other slows down, the speed changes without a
stop. `distance_m` is from the front bumper of an ego that kept its speed to the walker's line, at
the time when they set off towards the lane.

The logged driver does not anticipate: `reaction_s` after the walker has set off they brake towards
`stop_distance_m` before the walker, and drive on when the last walker has left the lane.

Metadata: `pedestrian_sets_off_s`, when the first sets off onto the lane (for the last time), and
`pedestrian_off_lane_s`, when the last has left it. Sources: Euro NCAP CPNCO and CPLA for running
out and walking along; replan's own for the others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import copysign, cos, inf, pi, radians, sin, sqrt

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind
from replan.logs.catalogue.family import expects, family
from replan.logs.catalogue.family_parts import (
    ADULT,
    APART_M,
    BESIDE_M,
    HALF_LANE,
    LARGE_CAR,
    SIDEWALK_M,
    SMALL_CAR,
    START_M,
    WAITS,
    Agent,
    Ahead,
    Reaction,
    drive,
    finished,
    grid,
    moving,
    obstruction,
    straight_path,
    waiting,
    walked,
)
from replan.logs.catalogue.roads import one_lane
from replan.logs.plan import DecisionKind
from replan.logs.scenario import Scenario
from replan.logs.vehicle import VehicleParameters

RAMP_S = 0.4
CHILD = (0.711, 0.298)
SLOWING_MPS2, SLOW_BEFORE_M = 1.2, 8.0
"""Deceleration towards the parked cars, m/s2.

Distance before them at which to be slow, m (the speed lags behind).
"""


@dataclass(frozen=True, slots=True)
class Leg:
    """A part of a walk: its begin (s), distance (m, signed) and speed (m/s)."""

    begin: float
    distance: float
    speed: float

    @property
    def slows(self) -> float:
        """Time at which it begins to slow down, s.

        A leg that begins at this time continues without a stop.
        """
        return self.begin + abs(self.distance) / self.speed

    @property
    def end(self) -> float:
        """Time at which it comes to a stand, s."""
        return self.slows + RAMP_S


def strolled(t: FloatArray, legs: Sequence[Leg]) -> FloatArray:
    """Distance of a walk of legs at times `(n,)`, m; ValueError if a leg is too short to reach its
    speed.
    """
    whole = np.zeros(len(t))
    for leg in legs:
        whole += leg.distance * walked(t - leg.begin, abs(leg.distance), leg.speed, RAMP_S)
    return whole


def walker(
    name: str,
    t: FloatArray,
    start: tuple[float, float],
    legs: Sequence[Leg],
    *,
    towards: float = 0.5 * pi,
    size: tuple[float, float] = ADULT,
) -> Agent:
    """A pedestrian who walks legs from a point in one direction (rad), backwards for legs of
    negative distance.
    """
    walked_m = strolled(t, legs)
    x, y = start[0] + walked_m * cos(towards), start[1] + walked_m * sin(towards)
    return moving(name, AgentKind.PEDESTRIAN, size, t, x, y, yaw=towards)


def off_lane(walkers: Sequence[Agent]) -> float:
    """The first sample at which all have left the lane for good, s; ValueError if one stays on it,
    or none comes.
    """
    last = -1
    for agent in walkers:
        on = np.flatnonzero(np.abs(agent.samples[:, 2]) <= HALF_LANE + 0.5 * max(agent.size))
        last = max(last, int(on[-1]) if len(on) else -1)
    t = walkers[0].samples[:, 0]
    if not 0 <= last < len(t) - 1:
        raise ValueError("the pedestrian does not come onto the lane, or does not leave it")
    return float(t[last + 1])


def _station(p: Mapping[str, float], sets_off: float) -> float:
    """Station of the walker's line, m, from `distance_m`."""
    return (
        START_M
        + VehicleParameters().axle_to_front
        + p["ego_speed_mps"] * sets_off
        + p["distance_m"]
    )


def _kerbs(p: Mapping[str, float]) -> tuple[float, float]:
    """The y, m, at which a walk over the lane begins on the right and ends on the left."""
    return -(HALF_LANE + p["kerb_distance_m"]), HALF_LANE + p["rest_distance_m"]


def _waiting_driver(
    p: Mapping[str, float],
    walkers: Sequence[Agent],
    x: float,
    sets_off: float,
    *,
    cars: Sequence[Agent] = (),
    cruise: Callable[[float], float] | None = None,
    noticed: float | None = None,
) -> Scenario:
    """The scenario with a driver who waits before x until all are off the lane."""
    begin, clear = sets_off + p["reaction_s"] if noticed is None else noticed, off_lane(walkers)
    ahead = waiting(x, p["stop_distance_m"], begin, clear, VehicleParameters().axle_to_front)
    return _crossing_scene(p, [*walkers, *cars], sets_off, clear, ahead, cruise=cruise)


def _crossing_scene(
    p: Mapping[str, float],
    agents: Sequence[Agent],
    sets_off: float,
    clear: float,
    ahead: Reaction,
    *,
    cruise: Callable[[float], float] | None = None,
    kinds: tuple[DecisionKind, ...] = WAITS,
) -> Scenario:
    """The scenario of a driver who reacts to `ahead`; `cruise` None: the ego's speed at the
    start.
    """
    v, duration = p["ego_speed_mps"], p["duration_s"]
    path = straight_path(v, duration)
    driven = drive(path, speed=v, cruise=cruise, duration=duration, ahead=ahead)
    metadata = {
        **expects(**{agent.id: kinds for agent in agents if agent.kind is AgentKind.PEDESTRIAN}),
        "pedestrian_sets_off_s": repr(sets_off),
        "pedestrian_off_lane_s": repr(clear),
    }
    return finished(
        path, driven, agents, one_lane(path, v, sidewalk=SIDEWALK_M), duration, metadata=metadata
    )


@family(
    "pedestrian/turns_back",
    "a pedestrian walks onto the lane, stands there, and walks back: wait, do not creep, then "
    "drive on",
    ("pedestrian",),
    {
        "ego_speed_mps": 10.0,
        "pedestrian_speed_mps": 1.2,
        "return_speed_mps": 1.5,
        "stop_lateral_m": 0.0,
        "dwell_s": 2.5,
        "walk_start_s": 3.0,
        "distance_m": 33.0,
        "kerb_distance_m": 0.6,
        "stop_distance_m": 3.0,
        "reaction_s": 0.4,
        "duration_s": 22.0,
    },
)
def turns_back(p: Mapping[str, float]) -> Scenario:
    y0 = -(HALF_LANE + p["kerb_distance_m"])
    distance = p["stop_lateral_m"] - y0
    onto_lane = Leg(p["walk_start_s"], distance, p["pedestrian_speed_mps"])
    back = Leg(onto_lane.end + p["dwell_s"], -distance, p["return_speed_mps"])
    x = _station(p, onto_lane.begin)
    agent = walker("pedestrian", grid(p["duration_s"]), (x, y0), (onto_lane, back))
    return _waiting_driver(p, [agent], x, onto_lane.begin)


@family(
    "pedestrian/hesitates",
    "a pedestrian comes to the kerb, stops there, and then crosses after all",
    ("pedestrian",),
    {
        "ego_speed_mps": 8.3,
        "approach_m": 2.0,
        "approach_speed_mps": 1.4,
        "pedestrian_speed_mps": 1.4,
        "dwell_s": 2.0,
        "walk_start_s": 1.0,
        "distance_m": 20.0,
        "kerb_distance_m": 0.6,
        "rest_distance_m": 2.5,
        "stop_distance_m": 3.0,
        "reaction_s": 0.4,
        "duration_s": 22.0,
    },
)
def hesitates(p: Mapping[str, float]) -> Scenario:
    y0, y1 = _kerbs(p)
    to_kerb = Leg(p["walk_start_s"], p["approach_m"], p["approach_speed_mps"])
    across = Leg(to_kerb.end + p["dwell_s"], y1 - y0, p["pedestrian_speed_mps"])
    x = _station(p, across.begin)
    agent = walker(
        "pedestrian", grid(p["duration_s"]), (x, y0 - p["approach_m"]), (to_kerb, across)
    )
    return _waiting_driver(p, [agent], x, across.begin)


RUNS_OUT: Mapping[str, float] = {
    "ego_speed_mps": 8.3,
    "pedestrian_speed_mps": 1.39,
    "passing_speed_mps": 4.0,
    "start_lateral_m": 4.0,
    "walk_start_s": 3.0,
    "distance_m": 25.6,
    "rest_distance_m": 2.5,
    "stop_distance_m": 3.0,
    "reaction_s": 0.4,
    "duration_s": 22.0,
}


@family(
    "pedestrian/runs_out",
    "a child runs out from behind parked cars (CPNCO): be slow where the view is blocked",
    ("pedestrian", "occlusion"),
    RUNS_OUT,
)
def runs_out(p: Mapping[str, float]) -> Scenario:
    car = VehicleParameters()
    y0, y1 = -p["start_lateral_m"], HALF_LANE + p["rest_distance_m"]
    leg = Leg(p["walk_start_s"], y1 - y0, p["pedestrian_speed_mps"])
    x, side = _station(p, leg.begin), -(0.5 * car.width + BESIDE_M)
    cars = obstruction(x, side)
    large_front = x - APART_M - SMALL_CAR[0] - APART_M
    t = grid(p["duration_s"])
    child = walker("child", t, (x, y0), (leg,), size=CHILD)
    emerges = float(t[np.argmax(child.samples[:, 2] + 0.5 * CHILD[0] > side)])
    slow, begin = (
        p["passing_speed_mps"],
        large_front - LARGE_CAR[0] - SLOW_BEFORE_M - car.axle_to_front,
    )

    def cruise(s: float) -> float:
        allowed = sqrt(slow**2 + 2.0 * SLOWING_MPS2 * max(begin - s, 0.0))
        return min(p["ego_speed_mps"], allowed if s + car.axle_to_front < x else inf)

    return _waiting_driver(
        p, [child], x, leg.begin, cars=cars, cruise=cruise, noticed=emerges + p["reaction_s"]
    )


@family(
    "pedestrian/jaywalker",
    "a pedestrian walks diagonally over the lane and hurries halfway (above 90 degrees: towards "
    "the car)",
    ("pedestrian",),
    {
        "ego_speed_mps": 10.0,
        "pedestrian_speed_mps": 1.4,
        "hurry_speed_mps": 2.2,
        "angle_deg": 45.0,
        "step_lateral_m": -0.5,
        "walk_start_s": 3.0,
        "distance_m": 26.0,
        "kerb_distance_m": 0.6,
        "rest_distance_m": 2.5,
        "stop_distance_m": 3.0,
        "reaction_s": 0.4,
        "duration_s": 21.0,
    },
)
def jaywalker(p: Mapping[str, float]) -> Scenario:
    y0, y1 = _kerbs(p)
    angle = radians(p["angle_deg"])
    if not 0.1 < angle < pi - 0.1:
        raise ValueError(
            f"angle_deg is {p['angle_deg']:g}: between the lane and the walk, above 6 and below 174"
        )
    begin = Leg(
        p["walk_start_s"], (p["step_lateral_m"] - y0) / sin(angle), p["pedestrian_speed_mps"]
    )
    hurry = Leg(begin.slows, (y1 - p["step_lateral_m"]) / sin(angle), p["hurry_speed_mps"])
    x = _station(p, begin.begin)
    agent = walker("pedestrian", grid(p["duration_s"]), (x, y0), (begin, hurry), towards=angle)
    on = np.abs(agent.samples[:, 2]) <= HALF_LANE
    return _waiting_driver(p, [agent], float(agent.samples[on, 1].min()), begin.begin)


@family(
    "pedestrian/group",
    "three pedestrians cross one after the other: drive on after the last",
    ("pedestrian",),
    {
        "ego_speed_mps": 10.0,
        "pedestrian_speed_mps": 1.2,
        "between_s": 0.5,
        "beside_m": 0.8,
        "walk_start_s": 3.0,
        "distance_m": 31.0,
        "kerb_distance_m": 0.6,
        "rest_distance_m": 2.5,
        "stop_distance_m": 3.0,
        "reaction_s": 0.4,
        "duration_s": 22.0,
    },
)
def group(p: Mapping[str, float]) -> Scenario:
    y0, y1 = _kerbs(p)
    t, begin = grid(p["duration_s"]), p["walk_start_s"]
    x = _station(p, begin)
    legs = [Leg(begin + k * p["between_s"], y1 - y0, p["pedestrian_speed_mps"]) for k in range(3)]
    walkers = [
        walker(f"pedestrian_{k + 1}", t, (x + k * p["beside_m"], y0), [leg])
        for k, leg in enumerate(legs)
    ]
    return _waiting_driver(p, walkers, x, begin)


@family(
    "pedestrian/along",
    "a pedestrian walks along the lane ahead (CPLA) and leaves it: follow them, then drive on",
    ("pedestrian",),
    {
        "ego_speed_mps": 10.0,
        "pedestrian_speed_mps": 1.39,
        "lateral_m": 0.0,
        "distance_m": 45.0,
        "leave_s": 10.0,
        "rest_distance_m": 1.0,
        "stop_distance_m": 1.0,
        "reaction_s": 0.4,
        "duration_s": 22.0,
    },
)
def along(p: Mapping[str, float]) -> Scenario:
    """The pedestrian already walks before t = 0, turns right where they slow down along the lane,
    and leaves it.
    """
    v, duration, front = (
        p["pedestrian_speed_mps"],
        p["duration_s"],
        VehicleParameters().axle_to_front,
    )
    t = grid(duration)
    along, aside = (
        Leg(-RAMP_S, v * (p["leave_s"] + RAMP_S), v),
        p["lateral_m"] + HALF_LANE + p["rest_distance_m"],
    )
    begun = float(strolled(np.zeros(1), (along,))[0])
    x = START_M + front + p["distance_m"] - begun + strolled(t, (along,))
    y = p["lateral_m"] - strolled(t, (Leg(p["leave_s"], aside, v),))
    agent = moving("pedestrian", AgentKind.PEDESTRIAN, ADULT, t, x, y, yaw=0.0)
    clear = off_lane([agent])

    def ahead(time: float, s: float) -> Ahead | None:
        gap = float(np.interp(time, t, x)) - 0.5 * max(ADULT) - p["stop_distance_m"] - (s + front)
        return Ahead(gap, v) if p["reaction_s"] <= time < clear else None

    return _crossing_scene(p, [agent], 0.0, clear, ahead, kinds=(DecisionKind.FOLLOW, *WAITS))


@family(
    "pedestrian/both_sides",
    "two pedestrians cross from both sides, each at a time of its own: drive on after the last",
    ("pedestrian",),
    {
        "ego_speed_mps": 10.0,
        "right_speed_mps": 1.4,
        "left_speed_mps": 1.2,
        "right_start_s": 3.0,
        "left_start_s": 4.5,
        "beside_m": 1.2,
        "distance_m": 31.0,
        "kerb_distance_m": 0.6,
        "rest_distance_m": 2.5,
        "stop_distance_m": 3.0,
        "reaction_s": 0.4,
        "duration_s": 22.0,
    },
)
def both_sides(p: Mapping[str, float]) -> Scenario:
    y0, y1 = _kerbs(p)
    t, sets_off = grid(p["duration_s"]), min(p["right_start_s"], p["left_start_s"])
    x = _station(p, sets_off)
    walkers = []
    for name, side, beyond in (("right", -1.0, 0.0), ("left", 1.0, p["beside_m"])):
        leg = Leg(p[f"{name}_start_s"], y1 - y0, p[f"{name}_speed_mps"])
        walkers.append(
            walker(name, t, (x + beyond, copysign(y0, side)), [leg], towards=-0.5 * pi * side)
        )
    return _waiting_driver(p, walkers, x, sets_off)


runs_fast = family(
    "pedestrian/runs_fast",
    "as runs_out, nearer: who sees them half a second late brakes with 8 m/s2",
    ("pedestrian", "occlusion"),
    {**RUNS_OUT, "pedestrian_speed_mps": 1.5, "start_lateral_m": 3.2, "distance_m": 18.0},
)(runs_out.build)
FAMILIES = (turns_back, hesitates, runs_out, runs_fast, jaywalker, group, along, both_sides)
