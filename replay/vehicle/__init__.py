"""How the ego moves: a Command and a time step give the next EgoState.

VEHICLES    the models by name, each built as `Class(parameters, start)`; adding one is one file and one line here; what
            may be set of a model are its keywords (replay.vehicle.plant)
"""

from __future__ import annotations

from collections.abc import Callable

from replay.vehicle.base import Vehicle
from replay.vehicle.kinematic_bicycle import KinematicBicycle
from replay.vehicle.kinematic_rear_steer import KinematicRearSteer
from replay.vehicle.multibody import Multibody
from replay.vehicle.perfect import Perfect
from replay.vehicle.single_track import SingleTrack

VehicleFactory = Callable[..., Vehicle]

VEHICLES: dict[str, VehicleFactory] = {
    "kinematic_bicycle": KinematicBicycle,
    "kinematic_rear_steer": KinematicRearSteer,
    "single_track": SingleTrack,
    "multibody": Multibody,
    "perfect": Perfect,
}
