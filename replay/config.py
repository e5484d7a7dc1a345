"""What a run does: `RunConfig`, from a TOML file and back.

    planners = ["dp_qp"]             # names, "module:Class", "exec:COMMAND" or "tcp://HOST:PORT"
    mode = "both"                    # "open", "closed" or "both"
    gates = "default"                # or a file of thresholds
    internals = "summary"            # what of a planner's inside goes into the traces: "none", "summary", "full"
    recording = true                 # write .rrd files
    foxglove = false                 # channels that Foxglove draws, in the logs and traces that are written
    metrics = []                     # of your own, beside the built-in ones: "module:NAME"
    charts = []                      # likewise, in the report
    ensemble = 0                     # each log so many times more, in worlds that should not matter (replay.perturb)

    repeat_s = 2.0                   # so much of a drive of your own planner is driven twice: is it deterministic?
    deadline_s = 0.0                 # a plan may take so long (0.1 at 10 Hz); 0: not asked, as clocks differ

    [log]                            # logs.readers.LogSettings: what logs do not say, or where they say it
    [loop]                           # LoopConfig
    [loop.apart]                     # ApartConfig: planners of your own in their process, and its limits
    [planner.dp_qp]                  # keywords of the planner; likewise, of what [loop] names:
    [controller.mpc]                 # also [traffic.NAME], [prediction.NAME], [perception.NAME]
    [vehicle_model.single_track]     # of the vehicle model; [loop.plant] is what the controller does not know
    [vehicle]                        # VehicleParameters: takes the place of what the logs say
    set = "vw_vanagon"               # all of a known vehicle's, a file of `logs/vehicles`; other keys are put over it

Every key may be left out. What a file says wrongly is an error that names file, key and remedy; nothing is ignored.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from enum import Enum
from math import inf
from pathlib import Path
from typing import Any, Literal, TypeVar, get_type_hints

import msgspec
import tomli_w

from logs.errors import ConfigError, unknown_name
from logs.files import read_toml
from logs.readers.base import LogSettings
from logs.trace import Mode
from logs.vehicle import VehicleParameters, vehicle_parameters
from logs.words import visible_name
from replay.drive import LoopConfig

RunMode = Literal["both", "open", "closed"]
Internals = Literal["none", "summary", "full"]

HEADER = "# The resolved configuration of a run, written by `replan evaluate`; give it to --config to run that again.\n"

SETTINGS: Mapping[str, str] = {
    "vehicle": "vehicle_model",
    "controller": "controller",
    "traffic": "traffic",
    "prediction": "prediction",
    "perception": "perception",
}
"""What [loop] names, and the table that has the settings of each by name ([vehicle] are the car's numbers)."""

T = TypeVar("T")


@dataclass(frozen=True)
class RunConfig:
    """One run: which planners, in which loops, judged by what.

    Attributes:
        planners: Names as `replay.planning.Planning` takes them; one column of the results each.
        mode: Which loops are run.
        gates: "default" (the packaged thresholds), or the path of a TOML file.
        internals: How much of the planner's inside is kept in the traces.
        recording: Whether Rerun recordings are written.
        foxglove: Whether the logs and traces that are written get channels for Foxglove (`replay.foxglove`).
        metrics: "module:NAME" of metrics from outside, measured beside the built-in ones.
        charts: "module:NAME" of charts from outside, drawn in the report beside the built-in ones.
        ensemble: How many times each log is driven again under a perturbation (`replay.perturb`).
        repeat_s: So much of the start of a drive is driven twice where the planner does not come with replan
            (`replay.determinism`), s; 0: nothing.
        deadline_s: At most 1 % of a drive's plans may take longer, s; 0: not asked.
        log: How logs are read.
        loop: Periods and limits of the loops.
        planner: Keywords of each planner, by the name given in `planners`.
        vehicle_model: Keywords of each vehicle model, by the name given in `loop.vehicle`; `controller`, `traffic`,
            `prediction` and `perception` likewise.
        vehicle: Vehicle parameters by name that replace those of the logs; "set" names a known vehicle for all of them.
    """

    planners: tuple[str, ...] = ("dp_qp",)
    mode: RunMode = "both"
    gates: str = "default"
    internals: Internals = "summary"
    recording: bool = True
    foxglove: bool = False
    metrics: tuple[str, ...] = ()
    charts: tuple[str, ...] = ()
    ensemble: int = 0
    repeat_s: float = 2.0
    deadline_s: float = 0.0
    log: LogSettings = field(default_factory=LogSettings)
    loop: LoopConfig = field(default_factory=LoopConfig)
    planner: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    vehicle_model: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    controller: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    traffic: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    prediction: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    perception: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    vehicle: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.planners:
            raise ConfigError("planners: name at least one planner")
        if len(set(self.planners)) < len(self.planners):
            raise ConfigError(f"planners: the same planner is named twice: {', '.join(self.planners)}")
        for name in self.planners:
            if visible_name(name, inf) != name:
                raise ConfigError(f"planners: {visible_name(name)} has control characters in it")
        for name in ("ensemble", "deadline_s"):
            if not 0.0 <= getattr(self, name) < 1e6:
                raise ConfigError(f"{name} must not be negative, got {getattr(self, name)}")
        known_keys(self.vehicle, ("set", *(item.name for item in fields(VehicleParameters))), "vehicle")
        self.driven(VehicleParameters())
        chosen = {key: getattr(self, table).get(getattr(self.loop, key), {}) for key, table in SETTINGS.items()}
        settings = {key: dict(table) for key, table in chosen.items() if table}
        object.__setattr__(self, "loop", replace(self.loop, settings=settings))

    @property
    def modes(self) -> tuple[Mode, ...]:
        """The loops in the order in which they are run."""
        return (Mode.OPEN, Mode.CLOSED) if self.mode == "both" else (Mode(self.mode),)

    @property
    def drives(self) -> tuple[tuple[str, str], ...]:
        """Planner and mode of each drive of a log."""
        return tuple((planner, mode.value) for planner in self.planners for mode in self.modes)

    @property
    def keep_internals(self) -> bool:
        """Whether anything looks at the planner's inside: traces, recordings, metrics from outside."""
        return self.recording or self.internals != "none" or bool(self.metrics)

    @property
    def gates_path(self) -> Path | None:
        """The file of thresholds; None is the packaged default."""
        return None if self.gates == "default" else Path(self.gates)

    def in_car(self, name: str | None) -> RunConfig:
        """The run with a known vehicle in place of the logs'; None: as it is."""
        return self if name is None else replace(self, vehicle={**self.vehicle, "set": name})

    def driven(self, vehicle: VehicleParameters) -> VehicleParameters:
        """The vehicle of a log with this run's replacements.

        Raises:
            ConfigError: They make no vehicle.
        """
        over = dict(self.vehicle)
        name = over.pop("set", None)
        if not isinstance(name, str | None):
            raise ConfigError(f"vehicle.set: expected str, got {type(name).__name__}")
        base = vehicle if name is None else vehicle_parameters(name)
        return strict(VehicleParameters, {**asdict(base), **over}, "vehicle") if over else base


def load_run(path: Path) -> RunConfig:
    """The configuration in a TOML file; a relative `gates` is relative to that file.

    Raises:
        ConfigError: The file is absent or no TOML, a key is unknown, a value has the wrong type or range.
    """
    table = read_toml(path)
    try:
        run = strict(RunConfig, table)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None
    return run if run.gates == "default" else replace(run, gates=str(path.parent / run.gates))


def dump_run(run: RunConfig) -> str:
    """The configuration as TOML, every default spelled out; `load_run` reads it back to an equal one."""
    table = asdict(run)
    del table["loop"]["settings"]  # the tables that they are from are there
    return HEADER + tomli_w.dumps(_plain(table))


def _plain(value: Any) -> Any:
    """Values as TOML has them: enums by value, no None."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items() if item is not None}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return value.value if isinstance(value, Enum) else value


def strict(cls: type[T], table: Mapping[str, Any], where: str = "") -> T:
    """The dataclass that a table spells, nested tables included.

    Args:
        cls: A dataclass; its own checks (`__post_init__`) are run.
        table: Keys and values as TOML gives them.
        where: Dotted name of the table, for messages.

    Raises:
        ConfigError: A key is unknown, a value is of the wrong type or refused by the dataclass.
    """
    _known_tree(cls, table, where)
    try:
        return msgspec.convert(dict(table), cls)
    except msgspec.ValidationError as error:
        raise ConfigError(_said_plainly(str(error), where)) from None


def _known_tree(cls: type, table: Mapping[str, Any], where: str) -> None:
    known_keys(table, (item.name for item in fields(cls) if item.metadata.get("key", item.init)), where)
    hints = get_type_hints(cls)
    for key, value in table.items():
        kind = hints[key]
        if isinstance(kind, type) and is_dataclass(kind) and isinstance(value, Mapping):
            _known_tree(kind, value, dotted(where, key))


def known_keys(table: Mapping[str, Any], known: Iterable[str], where: str) -> None:
    """Refuse the keys of a table that nobody reads.

    Raises:
        ConfigError: Names the key and the nearest known one.
    """
    names = list(known)
    for key in table:
        if key not in names:
            raise unknown_name("key", dotted("", key), [dotted("", name) for name in names], where and f"{where}.")


def dotted(where: str, key: str) -> str:
    """`where.key`, the key quoted where TOML would."""
    name = key if key.replace("_", "").replace("-", "").isalnum() else f'"{key}"'
    return f"{where}.{name}" if where else name


def _said_plainly(message: str, where: str) -> str:
    """Turn "Expected `float`, got `str` - at `$.loop.period`" into "loop.period: expected float, got str"."""
    what, _, place = message.partition(" - at ")
    key = ".".join(filter(None, [where, place.strip("`").removeprefix("$").removeprefix(".")]))
    what = what.replace("`", "")
    what = what[:1].lower() + what[1:] if what.startswith("Expected") else what
    return f"{key}: {what}" if key else what
