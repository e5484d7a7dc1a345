"""Road users who were not there: one who crosses the ego's path, one who stands on it."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, pi, sin

import numpy as np

from logs.agents import USUAL_SIZE_M, AgentKind
from logs.scenario import Scenario
from logs.variations.ego import on_path
from logs.variations.tracks import RATE_S, with_agent

WALKER, STANDER = "inserted pedestrian", "inserted car"
WALK_MPS = 1.4
"""Of an adult at a crossing (Fitzpatrick et al., TCRP Report 112, 2006: mean 1.45 m/s)."""
KERB_M = 6.0
"""How far beside the ego's path whoever is inserted begins and ends to walk: a lane and a half."""
LEAST_MPS = 3.0
"""An ego that stands at the start is taken to arrive at this speed."""
AROUND_S = 60.0
"""The walker stands at the kerbs so long before and after the log: more than time and speed can take away."""


def pedestrian(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """With an adult who crosses `value` m ahead."""
    x, y, yaw = on_path(scenario, value)
    start, car = scenario.ego.state(0), scenario.vehicle
    meet = start.t + max(value - car.axle_to_front, 0.0) / max(start.v, LEAST_MPS)
    t = np.arange(-AROUND_S, scenario.duration + AROUND_S, RATE_S)
    l = np.clip(WALK_MPS * (t - meet), -KERB_M, KERB_M)  # noqa: E741
    v = np.where(np.abs(l) < KERB_M, WALK_MPS, 0.0)
    rows = [t, x - l * sin(yaw), y + l * cos(yaw), np.full(len(t), yaw + 0.5 * pi), -v * sin(yaw), v * cos(yaw)]
    kind = AgentKind.PEDESTRIAN
    return with_agent(scenario, WALKER, kind, USUAL_SIZE_M[kind], np.column_stack(rows), static=False)


def standing_car(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """With a car that stands `value` m ahead."""
    kind = AgentKind.CAR
    size = USUAL_SIZE_M[kind]
    x, y, yaw = on_path(scenario, value + 0.5 * size[0])
    return with_agent(scenario, STANDER, kind, size, np.array([[0.0, x, y, yaw, 0.0, 0.0]]), static=True)
