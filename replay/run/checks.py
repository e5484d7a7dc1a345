"""Checks a run's configuration before anything is driven. An error here gives exit code 2: nothing was run."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from typing import Any

from logs.catalogue import scenario
from logs.errors import ConfigError, PlannerError, of_users, raised, unknown_name
from logs.extension import ExtensionKind
from logs.states import EgoState
from logs.vehicle import VehicleParameters
from planners import PLANNER, PLANNERS
from replay.config import RunConfig
from replay.control import CONTROLLER
from replay.loop.perception import ORACLE, PERCEPTION
from replay.loop.simulation_setup import controller_of
from replay.oracle import ORACLES
from replay.planner_process.connection import describe_planner
from replay.planner_process.planner_config import is_apart, is_built_in, planner_keywords, resolved_table
from replay.prediction import PREDICTION, LaneMap, predict
from replay.results.log_result import Failure
from replay.settings import SETTINGS, configured, dotted, keywords_of, resolved
from replay.traffic import TRAFFIC_KIND
from replay.vehicle import VEHICLE, build_vehicle, split_plant

KINDS: Mapping[str, tuple[ExtensionKind[Callable[..., Any]], int]] = {
    "vehicle": (VEHICLE, 2),
    "controller": (CONTROLLER, 3),
    "traffic": (TRAFFIC_KIND, 1),
    "prediction": (PREDICTION, 3),
    "perception": (PERCEPTION, 2),
}
"""By key of [loop]: the kind that resolves its name, and the number of arguments before the settings."""
SCENE = "paper/crossing_pedestrian"
REFUSALS = (ValueError, TypeError)
"""The errors with which a factory refuses a setting."""
_OF_THE_LOG = ("length", "wheelbase", "rear_overhang")
"""Plant parameters that are not checked here: whether they are consistent depends on the log's vehicle."""


def checked(run: RunConfig) -> tuple[RunConfig, tuple[Failure, ...]]:
    """The run with the planners that can be loaded, their settings resolved, and the failures of the others.

    Raises:
        ConfigError: A name, a planner's keyword or a key of the plant is unknown or missing, a value is refused, or the
            package for Foxglove is not installed.
        PlannerError: No planner is left.
    """
    tables: dict[str, Any] = {SETTINGS[key]: _resolve_choice(key, run) for key in KINDS}
    run = replace(run, **tables)
    _check_plant(run)
    _check_simulation_extensions(run)
    if run.foxglove:
        import replay.draw.foxglove  # noqa: F401  # raises ConfigError now if its package is not installed
    named = {*PLANNERS, *ORACLES, *PLANNER.entries(), *run.planners}
    for name, table in run.planner.items():  # also the planners that are not driven
        if name not in named and ":" not in name:
            raise unknown_name("planner (in the configuration)", name, named)
        if name in PLANNERS or name in ORACLES:
            planner_keywords(name, table)
    if run.charts:
        from replay.draw.charts.layout import CHART  # here: few runs draw charts, and it takes long to load

        for chart in run.charts:
            CHART.find(chart)
    left: dict[str, Mapping[str, Any]] = {}
    errors: list[PlannerError] = []
    for planner in run.planners:
        try:
            left[planner] = _resolve_planner(planner, run)
        except PlannerError as error:
            errors.append(error)
    if not left:
        raise errors[0]
    failures = tuple(Failure("", str(error)) for error in errors)
    return replace(run, planners=tuple(left), planner=left), failures


def _resolve_choice(key: str, run: RunConfig) -> Mapping[str, Mapping[str, Any]]:
    """The settings, with defaults, of the choice for a key of [loop]; ConfigError if its name or a setting is wrong."""
    kind, given = KINDS[key]
    tables, chosen = getattr(run, SETTINGS[key]), getattr(run.loop, key)
    for name, table in tables.items():
        if name in kind.builtin or name == chosen:
            keywords_of(kind.find(name), table, dotted(SETTINGS[key], name))
        elif ":" not in name:
            kind.place(name)
    if key == "prediction" and chosen == ORACLE:
        return {}
    try:
        factory = kind.find(chosen)
    except ConfigError as error:
        raise ConfigError(f"loop.{key}: {error}") from None
    where = dotted(SETTINGS[key], chosen)
    found = resolved(factory, tables.get(chosen, {}), where, f"{key} '{chosen}'", given)
    return {chosen: found} if found else {}


def _resolve_planner(planner: str, run: RunConfig) -> dict[str, Any]:
    """The planner's table with its defaults, resolved where the planner will run; checks that it can be built."""
    table, apart = run.planner.get(planner, {}), run.loop.apart
    if is_apart(planner, apart):
        return describe_planner(planner, table, apart)
    if apart.batch and not is_built_in(planner):
        raise ConfigError("loop.apart.batch is for planners in a process of their own: leave out loop.apart.trust")
    return resolved_table(planner, table)


def _check_plant(run: RunConfig) -> None:
    """Refuse a vehicle, plant or controller that no log can have; the log's own numbers are not known yet."""
    default = VehicleParameters()
    vehicle = run.driven(default) if "set" in run.vehicle else default
    loop = run.drive_loop
    split_plant(loop.plant)
    table = {key: value for key, value in loop.plant.items() if key not in _OF_THE_LOG}
    model, start = configured(VEHICLE, loop.vehicle, loop.settings), EgoState(0.0, 0.0, 0.0, 0.0, 0.0)
    with _building("vehicle", loop.vehicle):
        built = build_vehicle(model, loop.vehicle, vehicle, start, table)
    if loop.controller in CONTROLLER.builtin:
        return
    with _building("controller", loop.controller):
        controller_of(built, vehicle, loop.controller, loop.control_period_ns / 1e9, loop.settings)


def _check_simulation_extensions(run: RunConfig) -> None:
    """Raise ConfigError if the user's traffic, perception or prediction refuses its settings on a built-in log.

    An error that it also raises with default settings may be due to that log, and is left to the user's own logs.
    """
    loop, scene = run.drive_loop, cache(lambda: scenario(SCENE))

    def predicted(predictor: Any) -> object:
        tracks, t = scene().tracks, scene().ego.state(0).t
        lanes = LaneMap.of(scene().road)
        return predict(tracks.perceived(t), t, method=loop.prediction, lanes=lanes, predictor=predictor)

    makes: Mapping[str, Callable[[Any], object]] = {
        "traffic": lambda factory: factory(scene()),
        "perception": lambda factory: factory(scene(), loop),
        "prediction": predicted,
    }
    for key, make in makes.items():
        kind, name = KINDS[key][0], getattr(loop, key)
        if name in kind.builtin or name == ORACLE:
            continue
        error = _refusal(make, configured(kind, name, loop.settings))
        if error is not None and _refusal(make, configured(kind, name, {})) is None:
            raise ConfigError(f"{key} '{name}' cannot be built: {raised(error)}") from error


def _refusal(make: Callable[[Any], object], factory: Any) -> BaseException | None:
    """The error with which the user's code refuses a setting; None if it raises no error, or another kind of error."""
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
