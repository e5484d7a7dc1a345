"""What a run asks for, checked as a whole before anything is driven: exit code 2 says that nothing was run."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

from logs.errors import ConfigError, PlannerError, unknown_name
from logs.states import EgoState
from logs.vehicle import VehicleParameters
from planners import PLANNERS
from replay.apart.proxy import described
from replay.batch.log_result import Failure
from replay.config import RunConfig
from replay.control import CONTROLLERS
from replay.oracle import ORACLES
from replay.perception import PERCEPTIONS, PREDICTIONS
from replay.planner_config import check_keywords, is_apart, planner_keywords, resolved_table
from replay.traffic import TRAFFIC
from replay.vehicle import VEHICLES
from replay.vehicle.plant import build, parted

_TABLES: Mapping[str, Collection[str]] = {
    "vehicle": VEHICLES,
    "controller": CONTROLLERS,
    "traffic": TRAFFIC,
    "prediction": PREDICTIONS,
    "perception": PERCEPTIONS,
}
"""The names that the keys of [loop] may have."""
_OF_THE_LOG = ("length", "wheelbase", "rear_overhang")
"""Whether these fit each other depends on the log's vehicle."""


def checked(run: RunConfig) -> tuple[RunConfig, tuple[Failure, ...]]:
    """The run with the planners that can be loaded, their settings resolved, and what is wrong with the others.

    Raises:
        ConfigError: A name, a planner's keyword or a key of the plant is unknown or missing, a value is refused, or
            what Foxglove needs is not installed.
        PlannerError: No planner is left.
    """
    for key, known in _TABLES.items():
        name = getattr(run.loop, key)
        if name not in known:
            raise ConfigError(f"loop.{key}: {unknown_name(key, name, known)}")
    _check_plant(run)
    if run.foxglove:
        import replay.foxglove  # noqa: F401  # its package is there, or this says so before anything is driven
    _check_tables(run)
    left: dict[str, Mapping[str, Any]] = {}
    errors: list[PlannerError] = []
    for planner in run.planners:
        try:
            left[planner] = _resolved(planner, run)
        except PlannerError as error:
            errors.append(error)
    if not left:
        raise errors[0]
    failures = tuple(Failure("", str(error)) for error in errors)
    return replace(run, planners=tuple(left), planner=left), failures


def _resolved(planner: str, run: RunConfig) -> dict[str, Any]:
    """The planner's table with its defaults, found out where it will run; checked that it can be built of it."""
    table, apart = run.planner.get(planner, {}), run.loop.apart
    if is_apart(planner, apart):
        return described(planner, table, apart)
    resolved = resolved_table(planner, table)
    check_keywords(planner, resolved)
    return resolved


def _check_plant(run: RunConfig) -> None:
    """Refuse a vehicle or a plant that no log can have; the log's own numbers are not known yet."""
    default = VehicleParameters()
    vehicle = run.driven(default) if "set" in run.vehicle else default
    parted(run.loop.plant)
    table = {key: value for key, value in run.loop.plant.items() if key not in _OF_THE_LOG}
    build(VEHICLES[run.loop.vehicle], run.loop.vehicle, vehicle, EgoState(0.0, 0.0, 0.0, 0.0, 0.0), table)


def _check_tables(run: RunConfig) -> None:
    """Refuse a table of a planner that is not there, or that this planner does not take, be it driven or not."""
    named = {*PLANNERS, *ORACLES, *run.planners}
    for name, table in run.planner.items():
        if name not in named and ":" not in name:
            raise unknown_name("planner (in the configuration)", name, named)
        if name in PLANNERS or name in ORACLES:
            planner_keywords(name, table)
