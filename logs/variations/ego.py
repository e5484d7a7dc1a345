"""Where and how fast the ego starts: (4) of the package, and whether that is a sensible state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import cos, sin

import numpy as np

from logs.errors import LogError
from logs.road import ReferenceLine, thinned
from logs.scenario import Scenario
from logs.shapes import overlap
from logs.states import Trajectory

LATERAL_MPS2 = 4.89
"""An ego that would begin in a curve with more has no sensible state (nuPlan's comfort bound)."""


def start_of(ego: Trajectory) -> Trajectory:
    """Its first state alone."""
    return ego.between(float(ego.t[0]), float(ego.t[0]))


def driven_line(scenario: Scenario) -> ReferenceLine:
    """The ego's driven path from its first state on; straight ahead where less than 2 m were driven."""
    ego, start = scenario.ego, scenario.ego.state(0)
    path = thinned(np.column_stack([ego.x, ego.y]), 1.0)
    if len(path) < 3:
        path = np.array([[start.x + s * cos(start.yaw), start.y + s * sin(start.yaw)] for s in (0.0, 1.0, 2.0)])
    return ReferenceLine.through(path)


def on_path(scenario: Scenario, s: float) -> tuple[float, float, float]:
    """Point and heading `s` m along the ego's driven path."""
    x, y, yaw, _ = driven_line(scenario).frame(s)
    return x, y, yaw


def ego_start(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """(4) of the package: so far along the path."""
    start = scenario.ego.state(0)
    if value < 0.0:
        x, y, yaw, kappa = start.x + value * cos(start.yaw), start.y + value * sin(start.yaw), start.yaw, 0.0
    else:
        x, y, yaw, kappa = driven_line(scenario).frame(value)
    columns = (start.t, x, y, yaw, start.v, 0.0, kappa)
    return replace(scenario, ego=Trajectory(*(np.array([value]) for value in columns)))  # (4)


def ego_speed(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """(4) of the package: a factor of the speed."""
    start = start_of(scenario.ego)
    return replace(scenario, ego=replace(start, v=value * start.v, a=np.zeros(1)))


def check_start(was: Scenario, now: Scenario) -> None:
    """LogError where the ego of `now` starts in an impossible state, or inside an agent that `was` did not touch."""
    start, before, road = now.ego.state(0), was.ego.state(0), now.road
    if road.is_drivable(before.x, before.y) and not road.is_drivable(start.x, start.y):
        raise LogError("the ego would start off the road", remedy="keep ego_start on it")
    lateral = start.v**2 * abs(start.kappa)
    if lateral > max(LATERAL_MPS2, before.v**2 * abs(before.kappa)):
        raise LogError(f"the ego would start at {start.v:.1f} m/s in a curve of {1.0 / abs(start.kappa):.0f} m radius")
    stands_in = [name for name in _touched(now) if name not in _touched(was)]
    if stands_in:
        raise LogError(f"{stands_in[0]} would stand in the ego at the start")


def _touched(scenario: Scenario) -> list[str]:
    """Ids of those whose boxes the ego's touches at the start."""
    start, car = scenario.ego.state(0), scenario.vehicle
    x, y = start.x + car.axle_to_center * cos(start.yaw), start.y + car.axle_to_center * sin(start.yaw)
    others = scenario.tracks.truth(start.t)
    boxes = np.column_stack([others.x, others.y, others.yaw, others.length, others.width]).tolist()
    found = [overlap(x, y, start.yaw, car.length, car.width, *box) for box in boxes]
    return [name for name, touches in zip(others.ids, found, strict=True) if touches]
