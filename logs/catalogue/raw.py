"""Drives whose road users a detector sees: the data of a team's own bag, with known truth.

The careful driver drives through a scene with bystanders, and `replan.logs.catalogue.detector`
models the detections from the ego. The log has the detections alone: the reader makes tracks of
them (`replan.logs.readers.repaired`). `TRUE` has the scenes with the true road users, for the
evaluation of a repair. The goal begins `EARLY_M` before the end of the drive, so that a slower ego
still reaches it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from math import pi

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind
from replan.logs.catalogue import paper
from replan.logs.catalogue.detector import detected
from replan.logs.catalogue.family import Family, touches
from replan.logs.catalogue.family_parts import (
    ADULT,
    BEYOND_M,
    BICYCLE,
    CAR,
    HALF_LANE,
    START_M,
    Agent,
    Ahead,
    drive,
    grid,
    moving,
    parked,
    tracks,
)
from replan.logs.catalogue.roads import (
    LANE_WIDTH_M,
    CurveSamples,
    curve,
    one_lane,
    stretch,
    two_way,
)
from replan.logs.road import Goal, Road
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.tracks import Tracks
from replan.logs.vehicle import VehicleParameters

EARLY_M = 80.0
ROW_M = 3.4
"""Distance of the middle of a row of parked cars from the middle of the lane, m."""
TRUCK = (8.0, 2.4)
Parameters = Mapping[str, float]


Build = Callable[[Parameters], Scenario]
TRUE: dict[str, Build] = {}
"""The true scenes by the name of their family."""
SOURCE = "ours; errors of the detector as measured on 13 city drives (logs/catalogue/detector.py)"


def _scene(
    name: str, summary: str, tag: str, parameters: Mapping[str, float]
) -> Callable[[Build], Family]:
    """Decorate a true scene: return its family, as the detector sees it."""

    def register(scene: Build) -> Family:
        family = f"raw/{name}"
        TRUE[family] = scene
        build = partial(_as_detected, scene=scene)
        return Family(
            family, summary, {**parameters, "seed": 1.0}, ("raw", tag), build, source=SOURCE
        )

    return register


def _as_detected(p: Parameters, scene: Build) -> Scenario:
    true = scene(p)
    if (agent := touches(true)) is not None:
        raise ValueError(f"the logged driver touches {agent}")
    detections = detected(true.tracks, true.ego, int(p["seed"]))
    return replace(true, tracks=Tracks.empty(), detections=detections, metadata={})


def _row(name: str, first: float, last: float, y: float, *, spacing: float = 6.5) -> list[Agent]:
    """Cars parked one behind the other, at y."""
    return [
        parked(f"{name}_{k}", x, y) for k, x in enumerate(np.arange(first, last, spacing).tolist())
    ]


def _moving_agent(
    name: str,
    kind: AgentKind,
    size: tuple[float, float],
    t: FloatArray,
    x: float,
    y: float,
    speed: float,
) -> Agent:
    """A road user along the road at a constant speed, which is backwards where it is negative."""
    return moving(name, kind, size, t, x + speed * t, y, yaw=0.0 if speed > 0.0 else pi)


def _true_scene(
    p: Parameters,
    others: list[Agent],
    road: Callable[..., Road],
    cruise: float,
    ahead: Callable[..., Ahead | None],
) -> Scenario:
    v, duration = p["ego_speed_mps"], p["duration_s"]
    path = curve((max(v, cruise) * duration + BEYOND_M, 0.0, 0.0))
    driven = drive(path, speed=v, cruise=cruise, duration=duration, ahead=ahead)
    return Scenario(
        "", driven, tracks(others), road(path, max(v, cruise)), duration, _goal(path, driven)
    )


def _goal(path: CurveSamples, driven: Trajectory) -> Goal:
    end = float(driven.x[-1])
    return Goal((stretch(path, end - EARLY_M, end + EARLY_M, right=-HALF_LANE, left=HALF_LANE),))


@_scene(
    "crossing",
    "a pedestrian crosses between parked cars, others walk along: detections without identities",
    "pedestrian",
    {
        "ego_speed_mps": 8.0,
        "pedestrian_speed_mps": 1.2,
        "walk_start_s": 5.0,
        "distance_m": 28.0,
        "kerb_distance_m": 0.6,
        "duration_s": 27.0,
    },
)
def crossing(p: Parameters) -> Scenario:
    """The paper's crossing pedestrian, between rows of parked cars and people on the sidewalks."""
    scene = paper.crossing_pedestrian
    whole = scene.build(
        {**scene.parameters, **{name: p[name] for name in scene.parameters if name in p}}
    )
    t, x = grid(p["duration_s"]), float(whole.tracks.x[0])
    straight = curve((float(whole.ego.x[-1]) + BEYOND_M, 0.0, 0.0))
    bystanders = [
        *_row("right", START_M, x - 12.0, -ROW_M),
        *_row("left", x + 12.0, x + 60.0, ROW_M),
        _moving_agent("walker_1", AgentKind.PEDESTRIAN, ADULT, t, x - 20.0, -6.0, 1.3),
        _moving_agent("walker_2", AgentKind.PEDESTRIAN, ADULT, t, x + 40.0, 6.2, -1.1),
    ]
    everyone = whole.tracks.with_more(tracks(bystanders))
    return replace(
        whole, tracks=everyone, duration=p["duration_s"], goal=_goal(straight, whole.ego)
    )


@_scene(
    "queue",
    "a queue stands in the lane and drives on, another stands beside it",
    "follow",
    {"ego_speed_mps": 8.0, "distance_m": 60.0, "stands_s": 10.0, "duration_s": 34.0},
)
def queue(p: Parameters) -> Scenario:
    """Cars stand in the ego's lane until they drive on, others in the lane beside it."""
    t, v, car = grid(p["duration_s"]), p["ego_speed_mps"], VehicleParameters()
    last = START_M + car.axle_to_front + p["distance_m"]
    cars, positions = [], []
    for k in range(4):
        begins = p["stands_s"] + 1.2 * k
        rolls = np.clip(t - begins, 0.0, v / 1.5)
        x = last + (3 - k) * 7.0 + 0.75 * rolls**2 + v * np.clip(t - begins - v / 1.5, 0.0, np.inf)
        cars.append(moving(f"queue_{k}", AgentKind.CAR, CAR, t, x, 0.0, yaw=0.0))
        positions.append(x)

    def ahead(time: float, s: float) -> Ahead:
        gap = float(np.interp(time, t, positions[-1])) - 0.5 * CAR[0] - (s + car.axle_to_front)
        speed = float(np.interp(time, t, np.gradient(positions[-1], t)))
        return Ahead(gap - 3.0, speed, stop=speed < 0.1)

    beside = _row("beside", last - 40.0, last + 40.0, LANE_WIDTH_M, spacing=6.8)
    turn = np.array([0.0, 0.0, 0.0, pi, 0.0, 0.0])
    turned = [replace(car, samples=car.samples + turn) for car in beside]
    return _true_scene(p, [*cars, *turned], two_way, v, ahead)


@_scene(
    "parked",
    "rows of parked cars on both sides, people behind them",
    "static",
    {"ego_speed_mps": 8.0, "duration_s": 25.0},
)
def parked_rows(p: Parameters) -> Scenario:
    """Rows of parked cars on both sides, a truck among them, and people behind them."""
    t, end = grid(p["duration_s"]), START_M + p["ego_speed_mps"] * p["duration_s"] + 40.0
    truck = Agent(
        "truck",
        AgentKind.TRUCK,
        TRUCK,
        np.array([[0.0, 90.0, -ROW_M - 0.3, 0.0, 0.0, 0.0]]),
        static=True,
    )
    walkers = [
        _moving_agent(f"walker_{k}", AgentKind.PEDESTRIAN, ADULT, t, 40.0 + 30.0 * k, -6.5, 1.2)
        for k in range(3)
    ]
    rows = [
        *_row("right", START_M, 82.0, -ROW_M),
        *_row("right_on", 99.0, end, -ROW_M),
        *_row("left", START_M, end, ROW_M, spacing=7.5),
    ]
    return _true_scene(p, [*rows, truck, *walkers], one_lane, p["ego_speed_mps"], lambda t, s: None)


@_scene(
    "rider",
    "a rider comes towards the ego, taken for a pedestrian",
    "cyclist",
    {
        "ego_speed_mps": 8.0,
        "distance_m": 90.0,
        "offset_m": 2.4,
        "rider_speed_mps": 5.5,
        "duration_s": 25.0,
    },
)
def rider(p: Parameters) -> Scenario:
    """A rider comes towards the ego in the lane beside, detected as a pedestrian.

    Cars come, too.
    """
    t = grid(p["duration_s"])
    rider = _moving_agent(
        "rider",
        AgentKind.PEDESTRIAN,
        BICYCLE,
        t,
        p["distance_m"],
        p["offset_m"],
        -p["rider_speed_mps"],
    )
    cars = [
        _moving_agent(f"oncoming_{k}", AgentKind.CAR, CAR, t, 160.0 + 60.0 * k, LANE_WIDTH_M, -8.0)
        for k in range(2)
    ]
    side = _row("right", START_M, 140.0, -ROW_M, spacing=9.0)
    return _true_scene(p, [rider, *cars, *side], two_way, p["ego_speed_mps"], lambda t, s: None)


@_scene(
    "clusters",
    "clusters of points beside the road, a car ahead",
    "static",
    {"ego_speed_mps": 8.0, "clusters": 80.0, "duration_s": 25.0},
)
def clusters(p: Parameters) -> Scenario:
    """Bushes, poles and walls beside the road, as clusters of points; a car ahead."""
    t, v, rng = grid(p["duration_s"]), p["ego_speed_mps"], np.random.default_rng(int(p["seed"]))
    count, end = int(p["clusters"]), START_M + v * p["duration_s"] + 40.0
    x, y, yaw = (
        rng.uniform(0.0, end, count),
        rng.uniform(3.5, 14.0, count),
        rng.uniform(-pi, pi, count),
    )
    size, side = rng.uniform(0.3, 2.0, (count, 2)), rng.choice([-1.0, 1.0], count)
    things = [
        Agent(
            f"thing_{k}",
            AgentKind.OBJECT,
            (float(size[k].max()), float(size[k].min())),
            np.array([[0.0, x[k], side[k] * y[k], yaw[k], 0.0, 0.0]]),
            static=True,
        )
        for k in range(count)
    ]
    lead = _moving_agent("lead", AgentKind.CAR, CAR, t, START_M + 30.0, 0.0, v)
    return _true_scene(p, [lead, *things], one_lane, v, lambda t, s: None)


FAMILIES = (crossing, queue, parked_rows, rider, clusters)
