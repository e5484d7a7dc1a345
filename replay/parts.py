"""The parts of a drive by name: planner, vehicle, controller, traffic, prediction, perception.

`PARTS` is their only table. The command line, its completion, `replan list`, the tables of a run's
TOML file and the loops read it. A new built-in part is one file and one line here; one of a user is
"module:NAME" or an entry point (docs/extend.md). The places of built-in parts are texts, so that a
part is imported when a drive names it.

A part takes its settings as keywords (`horizon_s: float = 8.0`), or all in one keyword `config`,
annotated with a frozen dataclass: then its table mirrors that dataclass, sub-tables included.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, is_dataclass
from functools import partial, reduce
from importlib import import_module
from typing import Annotated, Any, get_args, get_origin

from replan.core.errors import ConfigError, PlannerError
from replan.core.extension import ExtensionKind
from replan.core.settings import Table, converted, dotted, known_keys, strict, types_of

Factory = Callable[..., Any]

PLAIN = (float, int, bool, str)
"""Types of keywords that are checked."""


class Places(Mapping[str, Factory]):
    """Factories by name, each imported at its first use.

    Args:
        places: "module:NAME" by name; NAME may be dotted.
    """

    def __init__(self, places: Mapping[str, str]) -> None:
        self._places = places

    def __getitem__(self, name: str) -> Factory:
        return loaded(self._places[name])

    def __contains__(self, name: object) -> bool:
        return name in self._places

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)


def loaded(place: str) -> Any:
    """The object at "module:NAME"."""
    module, _, name = place.partition(":")
    return reduce(getattr, name.split("."), import_module(module))


@dataclass(frozen=True, eq=False)
class PartKind(ExtensionKind[Factory]):
    """A kind of part.

    Attributes:
        table: The table of a run's file with the settings of its parts, [TABLE.NAME].
        given: Number of arguments before the settings with which a part is built.
        members: "module:Protocol" with the members that a built part must have; "": none are
            checked.
        method: The method by which a user's class is recognised as such a part; a function has
            "__call__".
        oracles: The built-in ones that see the log's future.
    """

    table: str = ""
    given: int = 1
    members: str = ""
    method: str = "__call__"
    oracles: tuple[str, ...] = ()

    @property
    def causal(self) -> tuple[str, ...]:
        """The built-in ones that do not see the log's future."""
        return tuple(name for name in self.builtin if name not in self.oracles)

    def fits(self, thing: Any) -> bool:
        """Whether an object of a user can be the factory of such a part."""
        try:
            parameters = inspect.signature(thing).parameters.values()
        except ValueError:  # some of C
            return False
        bare = sum(p.default is p.empty and p.kind <= p.POSITIONAL_OR_KEYWORD for p in parameters)
        bases = thing.__mro__ if isinstance(thing, type) else ()
        return bare == self.given and (
            not bases or any(self.method in vars(base) for base in bases)
        )


def _no_planner(thing: object) -> str:
    """Describe why an object cannot build planners; empty if it can."""
    fits = callable(thing) and (
        not isinstance(thing, type) or callable(getattr(thing, "plan", None))
    )
    return "" if fits else "is not a planner: it needs a method plan(frame) -> Plan"


PLANNER = PartKind(
    "planner",
    "planners",
    Places(
        {
            "dp_qp": "replan.planners.dp_qp:DpQp",
            "lattice": "replan.planners.lattice:Lattice",
            "idm": "replan.planners.idm:Idm",
            "pdm": "replan.planners.pdm:Pdm",
            "constant_speed": "replan.planners.constant_speed:ConstantSpeed",
            "blind": "replan.planners.blind:Blind",
            "parked": "replan.planners.blind:Parked",
            "logged": "replan.replay.oracle:Logged",
            "onboard": "replan.replay.oracle:Onboard",
        }
    ),
    _no_planner,
    PlannerError,
    "module:Class",
    table="planner",
    method="plan",
    oracles=("logged", "onboard"),
)
"""`factory(context, **settings) -> Planner`; an oracle gets the scenario after the context."""
VEHICLE = PartKind(
    "vehicle",
    "vehicles",
    Places(
        {
            "kinematic_bicycle": "replan.replay.vehicle.kinematic_bicycle:KinematicBicycle",
            "kinematic_rear_steer": "replan.replay.vehicle.kinematic_bicycle:rear_steer",
            "single_track": "replan.replay.vehicle.single_track:SingleTrack",
            "multibody": "replan.replay.vehicle.multibody:Multibody",
            "perfect": "replan.replay.vehicle.kinematic_bicycle:Perfect",
        }
    ),
    table="vehicle_model",  # [vehicle] has the VehicleParameters
    given=2,
    members="replan.replay.vehicle.base:Vehicle",
    method="step",
)
"""`factory(parameters, start, **settings) -> Vehicle`"""
CONTROLLER = PartKind(
    "controller",
    "controllers",
    Places(
        {
            "dlqr_pid": "replan.replay.control:dlqr_pid",
            "dlqr_kinematic_pid": "replan.replay.control:dlqr_kinematic_pid",
            "mpc": "replan.replay.control:mpc_or_dlqr",
            "pure_pursuit": "replan.replay.control:pure_pursuit",
            "stanley": "replan.replay.control:stanley",
            "pid": "replan.replay.control:pid",
        }
    ),
    table="controller",
    given=3,
    members="replan.replay.vehicle.base:Controller",
    method="control",
)
"""`factory(parameters, powertrain, period, **settings) -> Controller`; `period` in s"""
TRAFFIC = PartKind(
    "traffic",
    "traffic",
    Places(
        {
            "give_way": "replan.replay.traffic:give_way",
            "time": "replan.replay.traffic:ReplayedByTime",
            "ego_position": "replan.replay.traffic:ReplayedByEgoPosition",
            "reactive": "replan.replay.traffic:Reactive",
        }
    ),
    table="traffic",
    members="replan.replay.traffic:Traffic",
    method="step",
)
"""`factory(scenario, **settings) -> Traffic`"""
PREDICTION = PartKind(
    "prediction",
    "predictions",
    Places(
        {
            "constant_velocity": "replan.replay.prediction:straight_on",
            "constant_turn_rate": "replan.replay.prediction:round_a_circle",
            "lane_following": "replan.replay.prediction.lane_following:everybody",
            "pedestrian": "replan.replay.prediction:pedestrian",
            "lanes_and_pedestrians": "replan.replay.prediction:lanes_and_pedestrians",
            "oracle": "replan.replay.perception:logged_futures",
        }
    ),
    table="prediction",
    given=3,
    oracles=("oracle",),
)
"""`predictor(agents, t, lanes, **settings) -> Predictions`: futures of the agents on a time grid
`(k,)`, s, whose first entry is the time at which they were perceived; "oracle" gets the log's
tracks, the agents and the grid."""
PERCEPTION = PartKind(
    "perception",
    "perceptions",
    Places(
        {
            "auto": "replan.replay.perception:auto",
            "ground_truth": "replan.replay.perception:ground_truth",
            "recorded": "replan.replay.perception:recorded",
            "sensor": "replan.replay.perception:sensor",
        }
    ),
    table="perception",
    given=2,
)
"""`factory(scenario, config, **settings) -> Sight`, once per drive"""

OF_LOOP: Mapping[str, PartKind] = {
    kind.name: kind for kind in (CONTROLLER, VEHICLE, TRAFFIC, PREDICTION, PERCEPTION)
}
"""The kinds whose names are keys of [loop]."""
PARTS: Mapping[str, PartKind] = {PLANNER.name: PLANNER, **OF_LOOP}
"""All kinds by name."""


@dataclass(frozen=True)
class Part:
    """A part that a drive names, with its settings.

    Attributes:
        kind: Its kind.
        name: Its name: a built-in one, an entry point or "module:NAME".
        settings: Its table; what it does not set keeps its default.
    """

    kind: PartKind
    name: str
    settings: Table = field(default_factory=dict)

    @property
    def where(self) -> str:
        """The dotted name of its table."""
        return dotted(self.kind.table, self.name)

    @property
    def factory(self) -> Factory:
        """What builds it; errors as `ExtensionKind.find`."""
        return self.kind.find(self.name)

    def keywords(self) -> dict[str, Any]:
        """The settings as keywords of the factory.

        Raises:
            ConfigError: A key is unknown, or a value has the wrong type or is refused.
        """
        factory, table = self.factory, self.settings
        config = config_class(factory)
        if config is not None:
            return {"config": strict(config, table, self.where)} if table else {}
        parameters = inspect.signature(factory).parameters.values()
        if not any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
            known_keys(table, [p.name for p in parameters if p.kind is p.KEYWORD_ONLY], self.where)
        kinds = types_of(factory)
        for name, value in table.items():
            kind: Any = kinds.get(name)
            plain = get_args(kind)[0] if get_origin(kind) is Annotated else kind
            if plain in PLAIN:
                converted(value, kind, dotted(self.where, name))
        return dict(table)

    def resolved(self) -> dict[str, Any]:
        """The settings with all defaults, after a check that the factory accepts them.

        A part with these settings has the same keywords.

        Raises:
            ConfigError: As `keywords`; or a keyword is missing or not accepted.
        """
        factory, keywords = self.factory, self.keywords()
        given = self.kind.given + (self.kind is PLANNER and self.name in PLANNER.oracles)
        try:
            inspect.signature(factory).bind(*given * (None,), **keywords)
        except TypeError as error:
            raise ConfigError(
                f"{self.kind.name} '{self.name}' cannot be built: {error}; it receives {given}"
                f" argument{'s' * (given != 1)} and its settings"
            ) from None
        config = config_class(factory)
        if config is not None:
            return asdict(keywords.get("config") or config())
        parameters = inspect.signature(factory).parameters.values()
        defaults = {
            p.name: p.default
            for p in parameters
            if p.kind is p.KEYWORD_ONLY and p.default is not p.empty
        }
        return {**defaults, **keywords}

    def configured(self) -> Factory:
        """The factory with the settings bound."""
        return partial(self.factory, **self.keywords()) if self.settings else self.factory

    def build(self, *given: Any, **more: Any) -> Any:
        """Build it from the arguments that come before the settings; `more` are further keywords.

        Raises:
            ConfigError: As `keywords`; or what was built lacks a member of its protocol.
        """
        made = self.configured()(*given, **more)
        protocol = loaded(self.kind.members) if self.kind.members else object
        names = [name for name in vars(protocol) if not name.startswith("_")]
        lacking = [name for name in names if not hasattr(made, name)]
        if lacking:
            raise ConfigError(
                f"{self.kind.name} '{self.name}': it built a {type(made).__name__} without "
                f"{lacking[0]} ({protocol.__module__}.{protocol.__name__})"
            )
        return made


def config_class(factory: Factory) -> type | None:
    """Return the dataclass in the annotation of the keyword `config`, or None."""
    while isinstance(factory, partial):
        factory = factory.func
    parameter = inspect.signature(factory).parameters.get("config")
    if parameter is None or parameter.default is parameter.empty:
        return None
    hint = types_of(factory).get("config")
    classes = [
        kind for kind in (hint, *get_args(hint)) if isinstance(kind, type) and is_dataclass(kind)
    ]
    return classes[0] if classes else None
