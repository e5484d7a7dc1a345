"""Moves the ego: a Command and a time step give the next EgoState.

A plant's table (`LoopConfig.plant`) holds properties of the vehicle that are hidden from planner
and controller: VehicleParameters by name (mass, tyre_friction, ...: a mismatch on purpose) and
keywords of the model (tyre, grade, ...). A changed mass keeps the forces of motor, brakes and drag,
unless they are changed as well.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from replan.core.errors import ConfigError, unknown_name
from replan.logs.states import EgoState
from replan.logs.vehicle import VehicleParameters
from replan.replay.parts import Part
from replan.replay.vehicle.base import Vehicle

PlantTable = Mapping[str, float | str]
SCALARS = tuple(item.name for item in fields(VehicleParameters) if item.type == "float")
"""The parameters that a plant may change."""


def build_vehicle(
    part: Part, parameters: VehicleParameters, start: EgoState, plant: PlantTable
) -> Vehicle:
    """The vehicle at its start, with the plant's own parameters and keywords.

    Raises:
        ConfigError: A key is neither a parameter nor a keyword of this model, or a value is
            refused.
    """
    numbers, keywords = split_plant(plant)
    known = [
        k.name
        for k in inspect.signature(part.configured()).parameters.values()
        if k.kind is k.KEYWORD_ONLY
    ]
    for key in keywords:
        if key not in known:
            raise ConfigError(
                f"loop.plant, vehicle '{part.name}': {unknown_name('key', key, [*known, *SCALARS])}"
            )
    try:
        loaded = parameters.loaded(numbers["mass"]) if "mass" in numbers else parameters
        own = replace(loaded, **numbers)
    except (ValueError, ZeroDivisionError) as error:
        raise ConfigError(f"loop.plant: {error}") from None
    vehicle: Vehicle = part.build(own, start, **keywords)
    return vehicle


def split_plant(plant: PlantTable) -> tuple[dict[str, Any], dict[str, float | str]]:
    """A plant's table as parameters and keywords.

    Raises:
        ConfigError: A parameter is not a number.
    """
    numbers: dict[str, Any] = {}
    for key in SCALARS:
        value = plant.get(key, 0.0)
        if isinstance(value, str):
            raise ConfigError(f"loop.plant.{key}: expected a number, got '{value}'")
        if key in plant:
            numbers[key] = float(value)
    return numbers, {key: value for key, value in plant.items() if key not in numbers}
