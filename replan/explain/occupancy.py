"""The stations of a path that agents occupy: where the ego's box on it overlaps theirs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from replan.core.arrays import FloatArray, frozen
from replan.logs.agents import Agents
from replan.logs.vehicle import VehicleParameters
from replan.planners.frenet.scene import Bodies, Futures
from replan.planners.frenet.sweep import Roles, Swept, SweptPath, sweep

NO_MARGINS = (0.0, 0.0, 0.0)
"""Space on either side of the ego's box: in general, from vulnerable agents, from those that are
passed, m.
"""


@dataclass(frozen=True, eq=False, slots=True)
class OccupiedStations:
    """What one prediction of an agent occupies.

    Attributes:
        agent: Row of the agent.
        prediction: Row of the prediction.
        lower, upper: First and last station at each time `(k,)`, m; NaN where the path is free.
        along: Speed of the agent along the path, m/s.
    """

    agent: int
    prediction: int
    lower: FloatArray
    upper: FloatArray
    along: float


def bodies(agents: Agents) -> Bodies:
    """The boxes and velocities of agents."""
    return Bodies(
        *map(
            frozen,
            (agents.x, agents.y, agents.yaw, agents.vx, agents.vy, agents.length, agents.width),
        )
    )


def occupied(
    path: SweptPath,
    futures: Futures,
    boxes: Bodies,
    car: VehicleParameters,
    margins: tuple[float, float, float] = NO_MARGINS,
    roles: Roles | None = None,
) -> Iterator[OccupiedStations]:
    """The predictions that occupy a part of a path; the time of their samples `(k,)` is free.

    `roles`: who is vulnerable and who is passed; None: no agent.
    """
    none = np.zeros(len(boxes.x), np.bool_)
    ego = Swept(car.axle_to_center, car.length, car.width, *margins, 0.0, 0.0)
    rows = frozen(np.arange(float(len(futures.agent))))  # in place of probabilities
    _, agent, lower, upper, along, row = sweep(
        path,
        futures._replace(probability=rows),
        boxes,
        roles or Roles(none, none, none),
        ego,
        0.0,
        1,
    )
    for k in range(len(lower)):
        yield OccupiedStations(int(agent[k]), int(row[k]), lower[k], upper[k], float(along[k]))
