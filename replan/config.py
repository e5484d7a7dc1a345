"""The configuration of a run: `RunConfig`, read from and written to TOML.

    planners = ["dp_qp"]             # names, "module:Class", "exec:COMMAND", "tcp://HOST:PORT" ...
    mode = "both"                    # "open", "closed" or "both"
    gates = "default"                # or a file of thresholds
    internals = "summary"            # how much of a planner's internals the traces hold: "none",
                                     # "summary", "full"
    recording = true                 # write .rrd files
    foxglove = false                 # write channels for Foxglove into logs and traces
    metrics = []                     # your own, in addition to the built-in ones: "module:NAME"
    charts = []                      # likewise, in the report
    ensemble = 0                     # perturbed runs per log (replan.run.ensemble)
    repeat_s = 2.0                   # length of the start that is driven twice, to test
                                     # determinism of planners
    deadline_s = 0.0                 # the longest time of a plan (0.1 at 10 Hz); 0: not judged, as
                                     # clocks differ

    [log]                            # replan.logs.readers.LogSettings: information that logs lack,
                                     or where they store it
    [loop]                           # LoopConfig
    [loop.apart]                     # PlannerProcessConfig: planners of your own in their process,
                                     and its limits
    [planner.dp_qp]                  # keywords of the planner; likewise for the names in [loop]:
    [controller.mpc]                 # also [traffic.NAME], [prediction.NAME], [perception.NAME]
    [vehicle_model.single_track]     # keywords of the vehicle model; the controller does not know
                                     [loop.plant]
    [vehicle]                        # VehicleParameters: replaces the values of the logs
    set = "vw_vanagon"               # all values of a known vehicle (a file of `logs/vehicles`);
                                     # other keys override it
    [selection]                      # LogSelection: what is driven where no logs are named

All keys are optional. An error in a file names file, key and remedy; unknown keys are errors.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from enum import Enum
from math import inf
from pathlib import Path
from typing import Annotated, Any, Literal

import tomli_w
from msgspec import Meta

from replan.core.errors import ConfigError
from replan.core.files import read_toml
from replan.core.names import visible_name
from replan.core.settings import Config, known_keys, merged, strict
from replan.core.urls import url_of
from replan.logs.log_settings import LogSettings
from replan.logs.trace import Mode
from replan.logs.vehicle import VehicleParameters, vehicle_parameters
from replan.metrics.judge.gates import PACKAGED
from replan.replay.loop_config import LoopConfig
from replan.replay.parts import OF_LOOP
from replan.replay.planner_process.planner_config import is_apart, planner_part

RunMode = Literal["both", "open", "closed"]
Internals = Literal["none", "summary", "full"]

HEADER = (
    "# The resolved configuration of a run, written by `replan evaluate`; give it to --config "
    "to run that again.\n"
)


IN_MEMORY = "memory:"
"""Prefix of a log in `LogSelection` that was a scenario in memory."""


@dataclass(frozen=True)
class LogSelection(Config):
    """The logs of a run, as its run.toml names them; without any, the built-in suite."""

    suite: str = ""
    """A suite of the catalogue, or a family or group of it."""
    window_s: float = 0.0
    """Length of the windows into which each log is split, s; 0: whole logs."""
    every_s: float = 0.0
    """Time between the begins of two windows, s; 0: `window_s`."""
    logs: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of each log by its path, which may be relative to the file, or its version by its
    URL; "": not known.
    """


@dataclass(frozen=True)
class RunConfig(Config):
    """One run: its planners, loops, gates and settings."""

    planners: tuple[str, ...] = ("dp_qp",)
    """Names as `replan.replay.loop.planning.Planning` takes them; one column of the results each.
    """
    mode: RunMode = "both"
    """Which loops are run."""
    gates: str = "default"
    """"default" or "safety" (packaged thresholds), or the path of a TOML file."""
    internals: Internals = "summary"
    """How much of the planner's internals is kept in the traces."""
    recording: bool = True
    """Whether Rerun recordings are written."""
    foxglove: bool = False
    """Whether the logs and traces that are written get channels for Foxglove
    (`replan.draw.foxglove`).
    """
    metrics: tuple[str, ...] = ()
    """"module:NAME" of metrics from outside, measured beside the built-in ones."""
    charts: tuple[str, ...] = ()
    """"module:NAME" of charts from outside, drawn in the report beside the built-in ones."""
    ensemble: Annotated[int, Meta(ge=0, lt=1_000_000)] = 0
    """How many times each log is driven again under a perturbation (`replan.run.ensemble`)."""
    repeat_s: float = 2.0
    """Length of the start of a drive that is driven twice if the planner is not built in
    (`replan.replay.loop.planning`), s; 0: no test.
    """
    deadline_s: Annotated[float, Meta(ge=0.0, lt=1e6)] = 0.0
    """At most 1 % of a drive's plans may take longer, s; 0: not judged."""
    log: LogSettings = field(default_factory=LogSettings)
    """How logs are read."""
    loop: LoopConfig = field(default_factory=LoopConfig)
    """Periods and limits of the loops."""
    planner: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Keywords of each planner, by the name given in `planners`."""
    vehicle_model: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Keywords of each vehicle model, by the name given in `loop.vehicle`; `controller`, `traffic`,
    `prediction` and `perception` likewise.
    """
    controller: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    traffic: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    prediction: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    perception: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    vehicle: Mapping[str, Any] = field(default_factory=dict)
    """Vehicle parameters by name that replace those of the logs; "set" names a known vehicle for
    all of them.
    """
    selection: LogSelection = field(default_factory=LogSelection)
    """The logs to drive where none are named."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.log.begin < self.loop.warm_up_s:
            later = self.log.between(self.loop.warm_up_s, self.log.end)
            object.__setattr__(self, "log", later)
        if not self.planners:
            raise ConfigError("planners: name at least one planner")
        if len(set(self.planners)) < len(self.planners):
            raise ConfigError(
                f"planners: the same planner is named twice: {', '.join(self.planners)}"
            )
        for name in self.planners:
            if visible_name(name, inf) != name:
                raise ConfigError(f"planners: {visible_name(name)} has control characters in it")
        known_keys(
            self.vehicle, ("set", *(item.name for item in fields(VehicleParameters))), "vehicle"
        )
        self.driven(VehicleParameters())

    @property
    def drive_loop(self) -> LoopConfig:
        """`loop` with the settings of the parts that it names, as the loops expect it."""
        chosen = {
            key: getattr(self, kind.table).get(getattr(self.loop, key), {})
            for key, kind in OF_LOOP.items()
        }
        return replace(
            self.loop, settings={key: dict(table) for key, table in chosen.items() if table}
        )

    @property
    def modes(self) -> tuple[Mode, ...]:
        """The loops in the order in which they are run."""
        return (Mode.OPEN, Mode.CLOSED) if self.mode == "both" else (Mode(self.mode),)

    @property
    def drives(self) -> tuple[tuple[str, str], ...]:
        """Planner and mode of each drive of a log."""
        return tuple((planner, mode.value) for planner in self.planners for mode in self.modes)

    def planner_keywords(self, planner: str) -> Mapping[str, Any]:
        """The keywords with which a loop builds a planner: its table, where it runs in a process of
        its own.
        """
        table = self.planner.get(planner, {})
        return (
            table if is_apart(planner, self.loop.apart) else planner_part(planner, table).keywords()
        )

    @property
    def keep_internals(self) -> bool:
        """Whether the planner's internals are used: by traces, recordings or metrics from
        outside.
        """
        return self.recording or self.internals != "none" or bool(self.metrics)

    @property
    def gates_path(self) -> Path | None:
        """The file of thresholds; None is the packaged default."""
        return PACKAGED[self.gates] if self.gates in PACKAGED else Path(self.gates)

    def driven(self, vehicle: VehicleParameters) -> VehicleParameters:
        """Return the vehicle of a log with this run's replacements.

        Raises:
            ConfigError: The result is not a valid vehicle.
        """
        over = dict(self.vehicle)
        name = over.pop("set", None)
        if not isinstance(name, str | None):
            raise ConfigError(f"vehicle.set: expected str, got {type(name).__name__}")
        base = vehicle if name is None else vehicle_parameters(name)
        return strict(VehicleParameters, {**asdict(base), **over}, "vehicle") if over else base


def load_run(path: Path | None, changes: Mapping[str, Any] | None = None) -> RunConfig:
    """Load the configuration in a TOML file, with changes.

    Args:
        path: The file; None: the defaults. Relative paths of `gates` and `selection.logs` are
            relative to the file.
        changes: A table like that of the file, which overrides it key by key.

    Raises:
        ConfigError: The file is absent or not TOML, a key is unknown, a value has the wrong type or
            range.
    """
    table: dict[str, Any] = {}
    if path is not None:
        table = dict(read_toml(path))
        try:
            stated = strict(RunConfig, table)
        except ConfigError as error:
            raise ConfigError(f"{path}: {error}") from None
        gates, logs = stated.gates, stated.selection.logs
        table["gates"] = gates if gates in PACKAGED else str(path.parent / gates)
        if logs:
            selected = {_log_beside(log, path.parent): digest for log, digest in logs.items()}
            table["selection"] = table["selection"] | {"logs": selected}
    return strict(RunConfig, merged(table, changes or {}))


def _log_beside(log: str, folder: Path) -> str:
    """A log of a file in a folder: its URL, or its path, below the working directory a relative
    one.
    """
    if url_of(log) or log.startswith(IN_MEMORY):
        return log
    path, directory = Path(os.path.normpath(Path(os.path.realpath(folder), log))), Path.cwd()
    return str(path.relative_to(directory) if path.is_relative_to(directory) else path)


def dump_run(run: RunConfig) -> str:
    """Write the configuration as TOML with all defaults, without the selection of logs; `load_run`
    reads it back to an equal one.
    """
    table = _as_toml_value(run)
    del table["selection"]
    return HEADER + tomli_w.dumps(table)


def _as_toml_value(value: Any) -> Any:
    """Convert values for TOML: dataclasses to tables of their keys, enums to values, without
    None.
    """
    if is_dataclass(value) and not isinstance(value, type):
        keys = (item.name for item in fields(value) if item.metadata.get("key", True))
        value = {key: getattr(value, key) for key in keys}
    if isinstance(value, Mapping):
        return {str(key): _as_toml_value(item) for key, item in value.items() if item is not None}
    if isinstance(value, (list, tuple)):
        return [_as_toml_value(item) for item in value]
    return value.value if isinstance(value, Enum) else value
