"""How the ego moves: a Command and a time step give the next EgoState.

VEHICLES    the models by name, each built as `Class(parameters, start)`; adding one is one file and one line here
"""

from __future__ import annotations

from collections.abc import Callable

from logs.states import EgoState
from logs.vehicle import VehicleParameters
from replay.vehicle.base import Vehicle
from replay.vehicle.kinematic_bicycle import KinematicBicycle

VehicleFactory = Callable[[VehicleParameters, EgoState], Vehicle]

VEHICLES: dict[str, VehicleFactory] = {
    "kinematic_bicycle": KinematicBicycle,
}
