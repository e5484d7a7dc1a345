"""How the ego moves: a Command and a time step give the next EgoState.

VEHICLES    the models by name, each built as `Class(parameters, start, **settings)`; adding one is one file and one
            line here; what may be set of a model are its keywords (replay.vehicle.plant)
VEHICLE     finds those, and users' own
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from logs.extension import Kind
from replay.vehicle.base import Vehicle
from replay.vehicle.kinematic_bicycle import KinematicBicycle
from replay.vehicle.multibody import Multibody
from replay.vehicle.perfect import Perfect
from replay.vehicle.single_track import SingleTrack

VehicleFactory = Callable[..., Vehicle]

REAR_RATIO = -0.2
"""Of "kinematic_rear_steer": the rear wheels turn against the front ones by a fifth, which a few real axles can."""

VEHICLES: dict[str, VehicleFactory] = {
    "kinematic_bicycle": KinematicBicycle,
    "kinematic_rear_steer": partial(KinematicBicycle, rear_ratio=REAR_RATIO),
    "single_track": SingleTrack,
    "multibody": Multibody,
    "perfect": Perfect,
}

VEHICLE: Kind[VehicleFactory] = Kind("vehicle", "vehicles", VEHICLES)
