"""Checks a run's configuration before anything is driven.

An error here gives exit code 2: nothing was run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from typing import Any

from replan.config import RunConfig
from replan.core.errors import ConfigError, PlannerError, of_users, raised, unknown_name
from replan.logs.catalogue import scenario
from replan.logs.states import EgoState
from replan.logs.vehicle import VehicleParameters
from replan.replay.loop.simulation_setup import controller_of
from replan.replay.parts import CONTROLLER, OF_LOOP, PLANNER, Part, PartKind
from replan.replay.planner_process.connection import describe_planner
from replan.replay.planner_process.planner_config import is_apart, is_built_in, planner_part
from replan.replay.prediction import LaneMap, predict
from replan.replay.vehicle import build_vehicle, split_plant
from replan.results.log_result import Failure

SCENE = "paper/crossing_pedestrian"
REFUSALS = (ValueError, TypeError)  # The errors with which a factory refuses a setting
_OF_THE_LOG = ("length", "wheelbase", "rear_overhang")
"""Plant parameters that are not checked here: whether they are consistent depends on the log's
vehicle.
"""


def checked(run: RunConfig) -> tuple[RunConfig, tuple[Failure, ...]]:
    """The run with the planners that can be loaded, their settings resolved, and the failures of
    the others.

    ConfigError if a name, a planner's keyword or a key of the plant is unknown or missing, a value
    is refused, or the package for Foxglove is not installed; PlannerError if no planner is left.
    """
    tables: dict[str, Any] = {kind.table: _resolve_choice(kind, run) for kind in OF_LOOP.values()}
    run = replace(run, **tables)
    _check_plant(run)
    _check_simulation_extensions(run)
    if run.foxglove:
        import replan.draw.foxglove  # noqa: F401  # raises ConfigError now if its package is not installed
    named = {*PLANNER.names(), *run.planners}
    for name, table in run.planner.items():  # also the planners that are not driven
        if name not in named and ":" not in name:
            raise unknown_name("planner (in the configuration)", name, named)
        if is_built_in(name):
            planner_part(name, table).keywords()
    if run.charts:
        # here: few runs draw charts, and it takes long to load
        from replan.draw.charts.layout import CHART

        for chart in run.charts:
            CHART.find(chart)
    usable: dict[str, Mapping[str, Any]] = {}
    errors: list[PlannerError] = []
    for planner in run.planners:
        try:
            usable[planner] = _resolve_planner(planner, run)
        except PlannerError as error:
            errors.append(error)
    if not usable:
        raise errors[0]
    failures = tuple(Failure("", str(error)) for error in errors)
    return replace(run, planners=tuple(usable), planner=usable), failures


def _resolve_choice(kind: PartKind, run: RunConfig) -> Mapping[str, Mapping[str, Any]]:
    """The settings, with defaults, of the choice for a key of [loop]; ConfigError if its name or a
    setting is wrong.
    """
    tables, chosen = getattr(run, kind.table), getattr(run.loop, kind.name)
    for name, table in tables.items():
        if name in kind.builtin or name == chosen:
            Part(kind, name, table).keywords()
        elif ":" not in name:
            kind.place(name)
    try:
        kind.find(chosen)
    except ConfigError as error:
        raise ConfigError(f"loop.{kind.name}: {error}") from None
    settings = Part(kind, chosen, tables.get(chosen, {})).resolved()
    return {chosen: settings} if settings else {}


def _resolve_planner(planner: str, run: RunConfig) -> dict[str, Any]:
    """The planner's table with its defaults, resolved where the planner will run.

    Checks that it can be built.
    """
    table, apart = run.planner.get(planner, {}), run.loop.apart
    if is_apart(planner, apart):
        return describe_planner(planner, table, apart)
    if apart.batch and not is_built_in(planner):
        raise ConfigError(
            "loop.apart.batch is for planners in a process of their own: leave out loop.apart.trust"
        )
    return planner_part(planner, table).resolved()


def _check_plant(run: RunConfig) -> None:
    """Refuse a vehicle, plant or controller that no log can have.

    The log's own numbers are not known yet.
    """
    default = VehicleParameters()
    vehicle = run.driven(default) if "set" in run.vehicle else default
    loop = run.drive_loop
    split_plant(loop.plant)
    table = {key: value for key, value in loop.plant.items() if key not in _OF_THE_LOG}
    with _building("vehicle", loop.vehicle):
        built = build_vehicle(
            loop.part("vehicle"), vehicle, EgoState(0.0, 0.0, 0.0, 0.0, 0.0), table
        )
    if loop.controller in CONTROLLER.builtin:
        return
    with _building("controller", loop.controller):
        controller_of(built, vehicle, loop.part("controller"), loop.control_period_ns / 1e9)


def _check_simulation_extensions(run: RunConfig) -> None:
    """Raise ConfigError if the user's traffic, perception or prediction refuses its settings on a
    built-in log.

    An error that it also raises with default settings may be due to that log, and is left to the
    user's own logs.
    """
    loop, scene = run.drive_loop, cache(lambda: scenario(SCENE))

    def predicted(predictor: Any) -> object:
        tracks, t = scene().tracks, scene().ego.state(0).t
        lanes = LaneMap.of(scene().road)
        return predict(
            tracks.perceived(t), t, method=loop.prediction, lanes=lanes, predictor=predictor
        )

    makes: Mapping[str, Callable[[Any], object]] = {
        "traffic": lambda factory: factory(scene()),
        "perception": lambda factory: factory(scene(), loop),
        "prediction": predicted,
    }
    for key, make in makes.items():
        part = loop.part(key)
        if part.name in part.kind.builtin:
            continue
        error = _refusal(make, part.configured())
        if error is not None and _refusal(make, part.factory) is None:
            raise ConfigError(f"{key} '{part.name}' cannot be built: {raised(error)}") from error


def _refusal(make: Callable[[Any], object], factory: Any) -> BaseException | None:
    """The error with which the user's code refuses a setting; None if it raises no error, or
    another kind of error.
    """
    try:
        make(factory)
    except ConfigError:
        raise
    except (Exception, SystemExit) as error:
        return error if isinstance(error, REFUSALS) and of_users(error) else None
    return None


@contextmanager
def _building(kind: str, name: str) -> Iterator[None]:
    """Turn errors of user code into a ConfigError, because every log would fail."""
    try:
        yield
    except ConfigError:
        raise
    except (Exception, SystemExit) as error:
        if of_users(error):
            raise ConfigError(f"{kind} '{name}' cannot be built: {raised(error)}") from error
        raise
