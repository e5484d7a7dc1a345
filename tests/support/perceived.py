"""Logs with road users, and the frames that a planner sees of them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from handmade import drive, scenario, straight, track, tracks

from replan.logs.agents import AgentKind, Agents
from replan.logs.frame import Frame
from replan.logs.repair.detections import Detections, Repair
from replan.logs.repair.offline import detections_of
from replan.logs.scenario import Scenario
from replan.logs.tracks import Tracks
from replan.replay.loop_config import LoopConfig, SensorConfig
from replan.replay.perception import Perception
from replan.replay.world import World, logged_ego

COLUMNS = ("x", "y", "yaw", "vx", "vy", "yaw_rate", "accel")
IDEAL = SensorConfig(
    range_m=1e5,
    occlusion=False,
    position_noise_m=0.0,
    yaw_noise_deg=0.0,
    velocity_noise_mps=0.0,
    latency_s=0.0,
    dropout=0.0,
    coast_s=0.0,
)


def with_agents(*agents: dict[str, object], seconds: float = 6.0) -> Scenario:
    return scenario(drive(straight, 10.0, seconds), agents=tracks(*agents))


def crowd(seed: int) -> Scenario:
    """Six road users that wander about, two of them standing."""
    rng = np.random.default_rng(seed)
    agents = []
    kinds = (AgentKind.CAR, AgentKind.TRUCK, AgentKind.PEDESTRIAN, AgentKind.BICYCLE)
    for i in range(6):
        t = np.arange(rng.integers(0, 10), rng.integers(20, 61)) * 0.1
        v = rng.uniform(0.0, 12.0) if i > 1 else 0.0
        yaw = rng.uniform(-3.0, 3.0) + np.cumsum(rng.normal(0.0, 0.02, len(t)))
        x, y = rng.uniform(-20.0, 60.0), rng.uniform(-15.0, 15.0)
        x, y = x + np.cumsum(0.1 * v * np.cos(yaw)), y + np.cumsum(0.1 * v * np.sin(yaw))
        agents.append(track(f"a{i}", t, x, y, yaw=yaw, kind=kinds[rng.integers(4)]))
    return with_agents(*agents)


def frames(
    log: Scenario, config: LoopConfig, times: Sequence[float], seen: Tracks | None = None
) -> list[Frame]:
    perception = Perception(log, config)
    shown = log.tracks if seen is None else seen
    return [
        perception.frame(World(logged_ego(log.ego, log.vehicle, t), shown), None) for t in times
    ]


def detected(log: Scenario, detections: Detections | None = None) -> Scenario:
    """As if its tracks were made of their own samples, or of these detections."""
    detections = detections_of(log.tracks) if detections is None else detections
    repair = Repair(
        detections, Tracks.empty(), np.zeros(len(log.tracks.t), np.bool_), (), log.tracks
    )
    return replace(log, repair=repair)


def sensed(log: Scenario, sensor: SensorConfig, times: Sequence[float]) -> list[Frame]:
    return frames(log, LoopConfig(perception="sensor", sensor=sensor), times)


def assert_same_agents(one: Agents, two: Agents) -> None:
    assert one.ids == two.ids and one.kinds == two.kinds
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name), err_msg=name)


GRID = [round(0.1 * k, 1) for k in range(31)]
