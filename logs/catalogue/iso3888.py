"""The tracks of ISO 3888-1 (double lane change) and -2 (obstacle avoidance): their cones, and a
road between them.

Lengths and widths in m, with b the vehicle's width; x = 0 at the first cones, the offset lane is to
the left:

    3888-1   entry 15, 1.1 b + 0.25  gap 30    offset lane 25, 1.2 b + 0.25, 3.5 left  gap
             25    exit 30, 1.3 b + 0.25
    3888-2   entry 12, 1.1 b + 0.25  gap 13.5  offset lane 11, b + 1.0, 1.0 clear      gap
             12.5  exit 12, at least 3.0

The 3.5 m are from middle to middle, with `edge_based` from the entry's middle to the offset lane's
right edge; the 1.0 m from the entry lane's left edge to the offset lane's right edge; the exit's
middle is the entry's. (Other interpretations exist. The sources are Project Chrono's demonstration
and another one, not the standard itself.)

In the scenario the sections are one lane, which runs straight from one to the next and is wider
between them; it has no other road users. The ego must stay in the lane; it may slow down, as the
logged driver does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.catalogue.family import Family
from replan.logs.catalogue.family_parts import BEYOND_M, HALF_LANE, SPARE_S, drive, finished, tenths
from replan.logs.catalogue.protocols import KMH, speeds
from replan.logs.catalogue.roads import curve, weaving
from replan.logs.road import Lane, Road
from replan.logs.scenario import Scenario
from replan.logs.vehicle import VehicleParameters

CONE_SPACING_M = 3.0
SOURCE = "ISO 3888-1 and -2, per Project Chrono's double lane change"


@dataclass(frozen=True)
class ConeLane:
    """A lane between cones: from `begin` to `end`, `width`, its middle `offset` to the left; m."""

    begin: float
    end: float
    width: float
    offset: float


def double_lane_change(width: float, *, edge_based: bool = False) -> tuple[ConeLane, ...]:
    """ISO 3888-1 for a vehicle of this width, m."""
    offset = 1.2 * width + 0.25
    return (
        ConeLane(0.0, 15.0, 1.1 * width + 0.25, 0.0),
        ConeLane(45.0, 70.0, offset, 3.5 + (0.5 * offset if edge_based else 0.0)),
        ConeLane(95.0, 125.0, 1.3 * width + 0.25, 0.0),
    )


def obstacle_avoidance(width: float) -> tuple[ConeLane, ...]:
    """ISO 3888-2 for a vehicle of this width, m."""
    entry, offset = 1.1 * width + 0.25, width + 1.0
    return (
        ConeLane(0.0, 12.0, entry, 0.0),
        ConeLane(25.5, 36.5, offset, 0.5 * entry + 1.0 + 0.5 * offset),
        ConeLane(49.0, 61.0, max(1.3 * width + 0.25, 3.0), 0.0),
    )


def cones(sections: tuple[ConeLane, ...]) -> FloatArray:
    """Positions of the cones `(n, 2)`, m, along both edges of each section."""
    rows: list[FloatArray] = []
    for section in sections:
        x = np.linspace(
            section.begin, section.end, round((section.end - section.begin) / CONE_SPACING_M) + 1
        )
        edges = [section.offset + side * section.width for side in (-0.5, 0.5)]
        rows.extend(np.column_stack([x, np.full(len(x), edge)]) for edge in edges)
    return np.vstack(rows)


WIDER_M = 1.5
"""Extra width of the lane on each side in the middle of a gap, where the standard has no bound,
m.
"""
TAPER_M, LANE_STEP_M = 15.0, 1.0
LONGER = 3.0
"""Factor of the road's length behind the track, for a drive that does not slow down."""
APPROACH_M, BRAKE_MPS2, LATERAL_MPS2 = 40.0, 1.2, 2.0
"""The logged driver: way before the track, m, deceleration towards it and lateral acceleration on
it, m/s2.
"""


def _track(p: Mapping[str, float], sections: Callable[..., tuple[ConeLane, ...]]) -> Scenario:
    v, car = p["ego_kmh"] * KMH, VehicleParameters()
    approach = APPROACH_M + 0.5 * v * v / BRAKE_MPS2
    lanes = (
        sections(car.width, edge_based=p["edge_based"] > 0.0)
        if "edge_based" in p
        else sections(car.width)
    )
    ahead = car.axle_to_center
    shifts = [
        (approach + lane_before.end - ahead, approach + lane_after.begin - ahead, lane_after.offset)
        for lane_before, lane_after in pairwise(lanes)
    ]
    last = approach + lanes[-1].end
    path = weaving(LONGER * (last + BEYOND_M), shifts)
    slow = min(v, (LATERAL_MPS2 / float(np.abs(path.kappa).max())) ** 0.5)
    first = approach + lanes[0].begin - APPROACH_M

    def cruise(s: float) -> float:
        allowed: float = (slow**2 + 2.0 * BRAKE_MPS2 * max(first - s, 0.0)) ** 0.5
        return v if s > last else min(v, allowed)

    driven = drive(path, start=0.0, speed=v, cruise=cruise, duration=tenths(last / slow + SPARE_S))
    driven = driven.between(0.0, float(driven.t[np.argmax(driven.x > last + 2.0 * TAPER_M)]))
    duration = float(driven.t[-1])
    # Stations of the lane through the sections
    begin, end = -approach - car.length, path.length - approach
    knots = [(begin, HALF_LANE, -HALF_LANE), (lanes[0].begin - TAPER_M, HALF_LANE, -HALF_LANE)]
    for i, section in enumerate(lanes):
        edges = section.offset + 0.5 * section.width, section.offset - 0.5 * section.width
        if i:
            before, on_left, on_right = knots[-1]
            middle = 0.5 * (on_left + edges[0]) + WIDER_M, 0.5 * (on_right + edges[1]) - WIDER_M
            knots.append((0.5 * (before + section.begin), *middle))
        knots += [(section.begin, *edges), (section.end, *edges)]
    knots += [(lanes[-1].end + TAPER_M, HALF_LANE, -HALF_LANE), (end, HALF_LANE, -HALF_LANE)]
    stations, left, right = np.array(knots).T
    x = np.union1d(stations, np.arange(begin, end, LANE_STEP_M))
    left, right = (
        np.column_stack([x, np.interp(x, stations, y)]) + np.array([approach, 0.0])
        for y in (left, right)
    )
    lane = Lane(1, left, right, speed_limit=v, kind="urban")
    road = Road({1: lane}, default_speed_limit=v)
    return finished(
        curve((path.length, 0.0, 0.0)), driven, [], road, duration, begin=last + TAPER_M
    )


FAMILIES = (
    Family(
        "iso3888/double_lane_change",
        "ISO 3888-1: to the left lane and back between cones",
        {"ego_kmh": 60.0, "edge_based": 0.0},
        ("iso3888", "free"),
        partial(_track, sections=double_lane_change),
        {"ego_kmh": speeds(30, 80, 10), "edge_based": (0.0, 1.0)},
        SOURCE,
    ),
    Family(
        "iso3888/obstacle_avoidance",
        "ISO 3888-2: round an obstacle and back between cones",
        {"ego_kmh": 50.0},
        ("iso3888", "free"),
        partial(_track, sections=obstacle_avoidance),
        {"ego_kmh": speeds(20, 70, 10)},
        SOURCE,
    ),
)
