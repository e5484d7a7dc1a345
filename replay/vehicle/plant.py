"""The vehicle model of a drive, built from its name and from what it has that planner and controller do not know of.

A plant's table (`LoopConfig.plant`) holds VehicleParameters by name (mass, tyre_friction, ...: the model's own, a
mismatch on purpose) and keywords of the model (tyre, grade, ...). A changed mass keeps the forces of motor, brakes and
drag, unless they are changed as well.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from typing import Any, TypeVar

from logs.errors import ConfigError, unknown_name
from logs.vehicle import VehicleParameters
from replay.settings import check_members
from replay.vehicle.base import Vehicle

T = TypeVar("T")
Table = Mapping[str, float | str]


def build(model: Callable[..., T], name: str, parameters: VehicleParameters, start: object, table: Table) -> T:
    """The model at its start, with the plant's own parameters and keywords.

    Raises:
        ConfigError: A key is neither a parameter nor a keyword of this model, or a value is refused.
    """
    numbers, keywords = parted(table)
    known = [k.name for k in inspect.signature(model).parameters.values() if k.kind is k.KEYWORD_ONLY]
    for key in keywords:
        if key not in known:
            known_here = [*known, *_scalars()]
            raise ConfigError(f"loop.plant, vehicle '{name}': {unknown_name('key', key, known_here)}")
    vehicle = model(own(parameters, numbers), start, **keywords)
    check_members("vehicle", name, vehicle, Vehicle)
    return vehicle


def parted(table: Table) -> tuple[dict[str, Any], dict[str, float | str]]:
    """A plant's table as parameters and keywords.

    Raises:
        ConfigError: A parameter is no number.
    """
    numbers: dict[str, Any] = {}
    for key in _scalars():
        value = table.get(key, 0.0)
        if isinstance(value, str):
            raise ConfigError(f"loop.plant.{key}: expected a number, got '{value}'")
        if key in table:
            numbers[key] = float(value)
    return numbers, {key: value for key, value in table.items() if key not in numbers}


def own(parameters: VehicleParameters, numbers: Mapping[str, Any]) -> VehicleParameters:
    """The plant's parameters.

    Raises:
        ConfigError: They make no vehicle.
    """
    try:
        loaded = parameters.loaded(numbers["mass"]) if "mass" in numbers else parameters
        return replace(loaded, **numbers)
    except (ValueError, ZeroDivisionError) as error:
        raise ConfigError(f"loop.plant: {error}") from None


def _scalars() -> list[str]:
    return [item.name for item in fields(VehicleParameters) if item.type == "float"]
