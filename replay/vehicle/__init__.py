"""Moves the ego: a Command and a time step give the next EgoState.

VEHICLES    the models by name, each built as `Class(parameters, start, **settings)`; adding one is one file and one
            line here; the settings of a model are its keywords
VEHICLE     finds the built-in vehicles and those of users

A plant's table (`LoopConfig.plant`) holds properties of the vehicle that are hidden from planner and controller:
VehicleParameters by name (mass, tyre_friction, ...: a mismatch on purpose) and keywords of the model (tyre, grade,
...). A changed mass keeps the forces of motor, brakes and drag, unless they are changed as well.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from functools import partial
from typing import Any, TypeVar

from logs.errors import ConfigError, unknown_name
from logs.extension import ExtensionKind
from logs.states import EgoState
from logs.vehicle import VehicleParameters
from replay.settings import check_members
from replay.vehicle.base import Vehicle
from replay.vehicle.kinematic_bicycle import KinematicBicycle, Perfect
from replay.vehicle.multibody import Multibody
from replay.vehicle.single_track import SingleTrack

VehicleFactory = Callable[..., Vehicle]

REAR_RATIO = -0.2
"""Of "kinematic_rear_steer": the rear wheels turn against the front ones by a fifth; few real axles can."""

VEHICLES: dict[str, VehicleFactory] = {
    "kinematic_bicycle": KinematicBicycle,
    "kinematic_rear_steer": partial(KinematicBicycle, rear_ratio=REAR_RATIO),
    "single_track": SingleTrack,
    "multibody": Multibody,
    "perfect": Perfect,
}

VEHICLE: ExtensionKind[VehicleFactory] = ExtensionKind("vehicle", "vehicles", VEHICLES)

T = TypeVar("T")
PlantTable = Mapping[str, float | str]
SCALARS = tuple(item.name for item in fields(VehicleParameters) if item.type == "float")
"""The parameters that a plant may change."""


def build_vehicle(
    model: Callable[..., T], name: str, parameters: VehicleParameters, start: EgoState, plant: PlantTable
) -> T:
    """The model at its start, with the plant's own parameters and keywords.

    Raises:
        ConfigError: A key is neither a parameter nor a keyword of this model, or a value is refused.
    """
    numbers, keywords = split_plant(plant)
    known = [k.name for k in inspect.signature(model).parameters.values() if k.kind is k.KEYWORD_ONLY]
    for key in keywords:
        if key not in known:
            raise ConfigError(f"loop.plant, vehicle '{name}': {unknown_name('key', key, [*known, *SCALARS])}")
    try:
        loaded = parameters.loaded(numbers["mass"]) if "mass" in numbers else parameters
        own = replace(loaded, **numbers)
    except (ValueError, ZeroDivisionError) as error:
        raise ConfigError(f"loop.plant: {error}") from None
    vehicle = model(own, start, **keywords)
    check_members("vehicle", name, vehicle, Vehicle)
    return vehicle


def split_plant(plant: PlantTable) -> tuple[dict[str, Any], dict[str, float | str]]:
    """A plant's table as parameters and keywords.

    Raises:
        ConfigError: A parameter is no number.
    """
    numbers: dict[str, Any] = {}
    for key in SCALARS:
        value = plant.get(key, 0.0)
        if isinstance(value, str):
            raise ConfigError(f"loop.plant.{key}: expected a number, got '{value}'")
        if key in plant:
            numbers[key] = float(value)
    return numbers, {key: value for key, value in plant.items() if key not in numbers}
