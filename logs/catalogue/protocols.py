"""The common part of the published tests: an ego that keeps its speed meets a target after `TTC_S`.

Speeds are in km/h, as in the protocols. The ego drives at constant speed on a straight road along
x; at t = 0 the impact is `TTC_S` away. The logged driver brakes as in other families, with at most
3 m/s2 and 2 m/s3, `reaction_s` after the danger is visible; where that is not enough the log ends
before the contact (`family.before_contact`).

The target crosses along y with a ramp of its run-up, so that with the ego's front at its side its
middle is at

(1) y_impact = -b / 2 + b overlap / 100
        b the ego's width; overlap from the near, right side, %
(2) t_off    = TTC_S - (r / 2 + d / u)
        start for the way d at speed u; run-up 2 s_run / u = r
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import copysign, pi

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind
from replan.logs.catalogue.family import before_contact, expects
from replan.logs.catalogue.family_parts import (
    ADULT,
    BESIDE_M,
    BEYOND_M,
    HALF_LANE,
    SIDEWALK_M,
    SPARE_S,
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
    parked,
    waiting,
    walked,
)
from replan.logs.catalogue.pedestrians import CHILD
from replan.logs.catalogue.roads import LANE_WIDTH_M, CurveSamples, curve, one_lane, two_way
from replan.logs.plan import DecisionKind
from replan.logs.road import Road
from replan.logs.scenario import Scenario
from replan.logs.vehicle import VehicleParameters

KMH = 1.0 / 3.6
TTC_S = 6.0
GOAL_M = 40.0
STOP_M, BEYOND_LINE_M, REST_M = 2.0, 20.0, 2.5
"""Distance at which the driver stops before the target.

Of the goal's begin behind it; of its walk off the lane, m.
"""
RAMP_S = 0.4
"""Time in which a target without a run-up reaches its speed, s."""


@dataclass(frozen=True, slots=True)
class Target:
    """A target of the protocols: id, kind, size (length, width) m."""

    id: str
    kind: AgentKind
    size: tuple[float, float]


PEDESTRIAN = Target("pedestrian", AgentKind.PEDESTRIAN, ADULT)
CHILD_TARGET = Target("child", AgentKind.PEDESTRIAN, CHILD)
CYCLIST = Target("cyclist", AgentKind.BICYCLE, (1.89, 0.5))
MOTORCYCLE = Target("motorcycle", AgentKind.MOTORCYCLE, (2.08, 0.79))
CAR_TARGET = Target("car", AgentKind.CAR, (4.023, 1.712))


def speeds(first: int, last: int, step: int = 5) -> tuple[float, ...]:
    """The speeds of a grid, both ends among them, km/h."""
    return tuple(float(v) for v in range(first, last + 1, step))


def tested(
    p: Mapping[str, float],
    path: CurveSamples,
    road: Road,
    agents: Sequence[Agent],
    expected: Mapping[str, tuple[DecisionKind, ...]],
    ahead: Reaction = lambda t, s: None,
    *,
    beyond: float | None = None,
    start: float = START_M,
) -> Scenario:
    """The scenario of an ego with `ego_kmh` that starts at station `start` of the `path` of its
    rear axle, m.

    `expected`: accepted decisions by agent. `beyond`: station at which the goal begins; None: the
    target cannot be passed, and the goal is the path's end, which is so far that a drive lasts as
    long as the log.
    """
    v, duration = p["ego_kmh"] * KMH, p["duration_s"]
    driven = drive(path, start=start, speed=v, duration=duration, ahead=ahead)
    begin = path.length - GOAL_M if beyond is None else beyond
    return before_contact(
        finished(path, driven, agents, road, duration, begin=begin, metadata=expects(**expected))
    )


def straight(p: Mapping[str, float]) -> CurveSamples:
    """A straight path that is long enough for a drive at `ego_kmh`."""
    return curve((START_M + p["ego_kmh"] * KMH * (p["duration_s"] + SPARE_S) + BEYOND_M, 0.0, 0.0))


def impact(overlap_percent: float) -> float:
    """The offset y_impact (1), m."""
    return VehicleParameters().width * (overlap_percent / 100.0 - 0.5)


CROSSING: Mapping[str, float] = {
    "ego_kmh": 40.0,
    "target_kmh": 5.0,
    "overlap_percent": 50.0,
    "start_m": 4.0,
    "run_up_m": 1.0,
    "reaction_s": 0.4,
    "duration_s": 18.0,
}


def crossing(
    p: Mapping[str, float], target: Target, *, far: bool = False, hidden: str = ""
) -> Scenario:
    """A target that crosses from the right, or from the `far` side; ValueError if its way is too
    short.

    `start_m` is its first distance from the ego's path. It is hidden behind two parked cars
    ("cpnco"), or behind one whose side is `hidden_m` from the ego's path ("cbnao").
    """
    v, u = p["ego_kmh"] * KMH, p["target_kmh"] * KMH
    car, side = VehicleParameters(), 1.0 if far else -1.0
    t, ramp = grid(p["duration_s"]), max(2.0 * p["run_up_m"] / u, RAMP_S)
    distance = p["start_m"] - side * impact(p["overlap_percent"])
    off = TTC_S - 0.5 * ramp - distance / u  # (2)
    whole = p["start_m"] + HALF_LANE + REST_M + 0.5 * u * ramp + (LANE_WIDTH_M if far else 0.0)
    y = side * (p["start_m"] - whole * walked(t - off, whole, u, ramp))
    line = START_M + car.axle_to_front + v * TTC_S + 0.5 * target.size[1]
    crosser = moving(
        target.id,
        target.kind,
        target.size,
        t,
        line,
        y,
        yaw=copysign(0.5 * pi, -side),
    )
    reach = 0.5 * target.size[0]
    on = np.flatnonzero(np.abs(y) <= HALF_LANE + reach)
    hiding, noticed = [], max(off, float(t[0])) + p["reaction_s"]
    if hidden:
        edge = -(0.5 * car.width + BESIDE_M) if hidden == "cpnco" else -p["hidden_m"]
        hiding = list(obstruction(line, edge))[: 2 if hidden == "cpnco" else 1]
        noticed = max(off, float(t[np.argmax(y + reach > edge)])) + p["reaction_s"]
    clear = float(t[min(on[-1] + 1, len(t) - 1)])
    ahead = waiting(line, STOP_M, noticed, clear, car.axle_to_front)
    path = straight(p)
    road = two_way(path, v) if far else one_lane(path, v, sidewalk=SIDEWALK_M)
    return tested(
        p, path, road, [crosser, *hiding], {target.id: WAITS}, ahead, beyond=line + BEYOND_LINE_M
    )


LEAD: Mapping[str, float] = {
    "ego_kmh": 50.0,
    "target_kmh": 20.0,
    "gap_m": 0.0,
    "brake_s": 2.0,
    "brake_mps2": 0.0,
    "brake_to_kmh": 0.0,
    "reaction_s": 0.4,
    "duration_s": 18.0,
}
FOLLOWS = (DecisionKind.FOLLOW, *WAITS)


def lead_speed(t: FloatArray, begin: float, u: float, rate: float, to: float) -> FloatArray:
    """Speed `(n,)` of a target that changes from u to `to` with |rate| from `begin` on, m/s.

    With rate 0 it keeps u.
    """
    if rate == 0.0:
        return np.full(len(t), u)
    changed: FloatArray = np.clip((t - begin) * abs(rate), 0.0, abs(u - to))
    return u + copysign(1.0, to - u) * changed


def travelled(t: FloatArray, speed: FloatArray) -> FloatArray:
    """Distance `(n,)` travelled at a speed `(n,)`, m."""
    return np.r_[0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(t))]


def beside(overlap_percent: float) -> float:
    """Lateral offset of a target ahead that overlaps |overlap| of the ego's width, m.

    Negative to the right.
    """
    return copysign(1.0 - abs(overlap_percent) / 100.0, overlap_percent) * VehicleParameters().width


def lead(p: Mapping[str, float], target: Target, y: float) -> Scenario:
    """A target ahead, y m left of the lane's middle: stopped, slower, or braking; ValueError if it
    is not met.

    The impact is after `TTC_S`; or the target is `gap_m` ahead, if that is positive.
    """
    v, u, car = p["ego_kmh"] * KMH, p["target_kmh"] * KMH, VehicleParameters()
    gap = p["gap_m"] if p["gap_m"] > 0.0 else (v - u) * TTC_S
    if not gap > 0.0:
        raise ValueError(
            f"the ego's {p['ego_kmh']:g} km/h do not reach a target with {p['target_kmh']:g} km/h"
        )
    t = grid(p["duration_s"])
    speed = lead_speed(t, p["brake_s"], u, p["brake_mps2"], p["brake_to_kmh"] * KMH)
    half, front = 0.5 * target.size[0], car.axle_to_front
    x = START_M + front + gap + half + travelled(t, speed)
    if u > 0.0:
        other = moving(target.id, target.kind, target.size, t, x, y, yaw=0.0)
    else:
        other = parked(target.id, float(x[0]), y, size=target.size)
    shows = p["brake_s"] if p["brake_mps2"] else 0.0

    def ahead(time: float, s: float) -> Ahead | None:
        distance = float(np.interp(time, t, x)) - half - STOP_M - (s + front)
        now = float(np.interp(time, t, speed))
        return None if time < shows + p["reaction_s"] else Ahead(distance, now, stop=now == 0.0)

    path = straight(p)
    return tested(
        p, path, one_lane(path, v, sidewalk=SIDEWALK_M), [other], {target.id: FOLLOWS}, ahead
    )
