"""The configuration of a run: `RunConfig`, read from and written to TOML.

    planners = ["dp_qp"]             # names, "module:Class", "exec:COMMAND" or "tcp://HOST:PORT"
    mode = "both"                    # "open", "closed" or "both"
    gates = "default"                # or a file of thresholds
    internals = "summary"            # how much of a planner's internals the traces hold: "none", "summary", "full"
    recording = true                 # write .rrd files
    foxglove = false                 # write channels for Foxglove into logs and traces
    metrics = []                     # your own, in addition to the built-in ones: "module:NAME"
    charts = []                      # likewise, in the report
    ensemble = 0                     # perturbed runs per log (replay.run.sources)
    repeat_s = 2.0                   # length of the start that is driven twice, to test determinism of planners
    deadline_s = 0.0                 # the longest time of a plan (0.1 at 10 Hz); 0: not judged, as clocks differ

    [log]                            # logs.readers.LogSettings: information that logs lack, or where they store it
    [loop]                           # LoopConfig
    [loop.apart]                     # PlannerProcessConfig: planners of your own in their process, and its limits
    [planner.dp_qp]                  # keywords of the planner; likewise for the names in [loop]:
    [controller.mpc]                 # also [traffic.NAME], [prediction.NAME], [perception.NAME]
    [vehicle_model.single_track]     # keywords of the vehicle model; the controller does not know [loop.plant]
    [vehicle]                        # VehicleParameters: replaces the values of the logs
    set = "vw_vanagon"               # all values of a known vehicle (a file of `logs/vehicles`); other keys override it

All keys are optional. An error in a file names file, key and remedy; unknown keys are errors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from enum import Enum
from math import inf
from pathlib import Path
from typing import Any, Literal

import tomli_w

from logs.errors import ConfigError
from logs.files import read_toml
from logs.log_settings import LogSettings
from logs.names import visible_name
from logs.observed import MAX_AGE_S
from logs.trace import Mode
from logs.vehicle import VehicleParameters, vehicle_parameters
from metrics.judge.gates import PACKAGED
from replay.parts import OF_LOOP, Part
from replay.settings import known_keys, merged, strict

RunMode = Literal["both", "open", "closed"]
Internals = Literal["none", "summary", "full"]

HEADER = "# The resolved configuration of a run, written by `replan evaluate`; give it to --config to run that again.\n"

MOST_TOGETHER = 64
"""Most logs in lock step: their answers, 1 MB each with internals of plans, must fit into one message."""


@dataclass(frozen=True)
class SensorConfig:
    """The abilities of a sensor; the defaults are round values for the lidars and cameras of a car.

    Attributes:
        range_m: Agents farther away are not seen.
        field_of_view_deg: Angle of view, centred on the ego's heading; 360 covers all directions.
        occlusion: Whether road users hide others behind them.
        position_noise_m: Standard deviation of positions along and across the agent's heading, for each measurement.
        yaw_noise_deg: Standard deviation of headings.
        velocity_noise_mps: Standard deviation of velocities along and across the agent's heading.
        latency_s: Time from the measurement to the planner; counted in whole frames.
        dropout: Probability that an agent is not measured in a slot.
        dropout_s: Length of the slots.
        coast_s: How long an agent that is no longer measured is extrapolated.
        seed: Seed of the random draws.

    Raises:
        ConfigError: A value is out of its range.
    """

    range_m: float = 100.0
    field_of_view_deg: float = 360.0
    occlusion: bool = True
    position_noise_m: float = 0.1
    yaw_noise_deg: float = 1.0
    velocity_noise_mps: float = 0.1
    latency_s: float = 0.1
    dropout: float = 0.02
    dropout_s: float = 0.3
    coast_s: float = MAX_AGE_S
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("range_m", "field_of_view_deg", "dropout_s"):
            if not 0.0 < getattr(self, name) < 1e6:
                raise ConfigError(f"loop.sensor.{name} must be positive, got {getattr(self, name)}")
        for name in ("position_noise_m", "yaw_noise_deg", "velocity_noise_mps", "latency_s", "coast_s"):
            if not 0.0 <= getattr(self, name) < 1e6:
                raise ConfigError(f"loop.sensor.{name} must not be negative, got {getattr(self, name)}")
        if not 0.0 <= self.dropout <= 1.0:
            raise ConfigError(f"loop.sensor.dropout is a probability, got {self.dropout}")


@dataclass(frozen=True)
class PlannerProcessConfig:
    """How planners that are not built in are isolated (docs/planners_apart.md).

    Attributes:
        trust: Planners named "module:Class" run in the process that holds the log: faster, and without limits.
        plan_timeout_s: Longest time for a plan.
        start_timeout_s: Longest time to build the planner, and for its first plan (kernels, models).
        log_timeout_s: Longest time for all plans of a drive; 0: no limit.
        memory_gb: Largest memory of the planner's process; 0: no limit.
        environment: Variables that it receives besides `replay.planner_process.processes.ENVIRONMENT`.
        batch: Number of logs in lock step, whose frames are planned together (`plan_batch`); 0: each log by itself.

    Raises:
        ConfigError: A limit is negative, a timeout is 0, or `batch` is too large.
    """

    trust: bool = False
    plan_timeout_s: float = 10.0
    start_timeout_s: float = 60.0
    log_timeout_s: float = 0.0
    memory_gb: float = 8.0
    environment: tuple[str, ...] = ()
    batch: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.batch <= MOST_TOGETHER:
            raise ConfigError(f"loop.apart.batch must be from 0 to {MOST_TOGETHER}, got {self.batch}")
        for name in ("plan_timeout_s", "start_timeout_s"):
            if not 1e-3 <= getattr(self, name) < 1e6:
                raise ConfigError(f"loop.apart.{name} must be positive, got {getattr(self, name)}")
        for name in ("log_timeout_s", "memory_gb"):
            if not 0.0 <= getattr(self, name) < 1e6:
                raise ConfigError(f"loop.apart.{name} must not be negative, got {getattr(self, name)}")


@dataclass(frozen=True)
class LoopConfig:
    """How the loops run.

    Attributes:
        plan_period_s: Time between two frames.
        control_period_s: Time between two commands; the plan period is a multiple of it.
        vehicle: Name of a vehicle model (`replay.parts`), or "module:Class", as for all names here (docs/extend.md).
        plant: Properties of the vehicle model that are hidden from planner and controller: VehicleParameters by name,
            and keywords of the model (`replay.vehicle.build_vehicle`).
        controller: Name of a controller; the vehicle "perfect" needs none.
        traffic: Name of how the others move.
        plan_delay_s: Time from a frame until its plan is driven (the computing time), in whole control periods.
        perception: Name of what the planner sees.
        sensor: Abilities of the sensor, for the perception "sensor".
        prediction: Name of a predictor; "oracle" is the log's own future, with traffic "time".
        prediction_horizon_s: How far the others are predicted.
        prediction_step_s: Time between two samples of a prediction.
        end_with_evidence: A closed drive ends when the recording of the log's traffic ends (`Scenario.traffic_spans`).
        drives_on: A closed drive goes on to the end of the log's drive, through contacts, goals and off the road, as in
            nuPlan (`replan score`).
        apart: How planners that are not built in are isolated.
        settings: Keywords of the named parts, by key; not a key of the file: `RunConfig.drive_loop` fills it in.

    Raises:
        ConfigError: A period is not positive, or the periods do not fit.
    """

    plan_period_s: float = 0.1
    control_period_s: float = 0.01
    vehicle: str = "kinematic_bicycle"
    controller: str = "dlqr_pid"
    traffic: str = "give_way"
    prediction: str = "lane_following"
    prediction_horizon_s: float = 8.0
    prediction_step_s: float = 0.1
    plant: Mapping[str, float | str] = field(default_factory=dict)
    plan_delay_s: float = 0.0
    perception: str = "ground_truth"
    sensor: SensorConfig = field(default_factory=SensorConfig)
    end_with_evidence: bool = False
    drives_on: bool = False
    apart: PlannerProcessConfig = field(default_factory=PlannerProcessConfig)
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict, metadata={"key": False})

    def __post_init__(self) -> None:
        for name in ("plan_period_s", "control_period_s", "prediction_horizon_s", "prediction_step_s"):
            if not 1e-9 <= getattr(self, name) < 1e6:
                raise ConfigError(f"loop.{name} must be positive, got {getattr(self, name)}")
        if self.prediction == "oracle" and self.traffic != "time":
            raise ConfigError(
                f"loop.prediction 'oracle' uses the log's future, which road users do not follow with loop.traffic"
                f" '{self.traffic}'; take traffic 'time' (--traffic time)"
            )
        if not 0.0 <= self.plan_delay_s < 1e6:
            raise ConfigError(f"loop.plan_delay_s must not be negative, got {self.plan_delay_s}")
        if round(self.plan_delay_s * 1e9) % self.control_period_ns:
            raise ConfigError(
                f"loop.plan_delay_s ({self.plan_delay_s}) must be a multiple of"
                f" loop.control_period_s ({self.control_period_s})"
            )
        if self.plan_period_ns % self.control_period_ns:
            raise ConfigError(
                f"loop.plan_period_s ({self.plan_period_s}) must be a multiple of"
                f" loop.control_period_s ({self.control_period_s})"
            )

    def part(self, kind: str) -> Part:
        """The part that a key names ("vehicle", "controller" ...), with its settings."""
        return Part(OF_LOOP[kind], getattr(self, kind), self.settings.get(kind, {}))

    @property
    def plan_period_ns(self) -> int:
        """Nanoseconds between two frames."""
        return round(self.plan_period_s * 1e9)

    @property
    def plan_delay_steps(self) -> int:
        """Control periods from a frame until its plan is driven."""
        return round(self.plan_delay_s * 1e9) // self.control_period_ns

    @property
    def control_period_ns(self) -> int:
        """Nanoseconds between two commands."""
        return round(self.control_period_s * 1e9)


DEFAULT_LOOP = LoopConfig()


@dataclass(frozen=True)
class RunConfig:
    """One run: its planners, loops, gates and settings.

    Attributes:
        planners: Names as `replay.loop.planning.Planning` takes them; one column of the results each.
        mode: Which loops are run.
        gates: "default" or "safety" (packaged thresholds), or the path of a TOML file.
        internals: How much of the planner's internals is kept in the traces.
        recording: Whether Rerun recordings are written.
        foxglove: Whether the logs and traces that are written get channels for Foxglove (`replay.draw.foxglove`).
        metrics: "module:NAME" of metrics from outside, measured beside the built-in ones.
        charts: "module:NAME" of charts from outside, drawn in the report beside the built-in ones.
        ensemble: How many times each log is driven again under a perturbation (`replay.run.sources`).
        repeat_s: Length of the start of a drive that is driven twice if the planner is not built in
            (`replay.loop.planning`), s; 0: no test.
        deadline_s: At most 1 % of a drive's plans may take longer, s; 0: not judged.
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

    @property
    def drive_loop(self) -> LoopConfig:
        """`loop` with the settings of the parts that it names, as the loops expect it."""
        chosen = {key: getattr(self, kind.table).get(getattr(self.loop, key), {}) for key, kind in OF_LOOP.items()}
        return replace(self.loop, settings={key: dict(table) for key, table in chosen.items() if table})

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
        """Whether the planner's internals are used: by traces, recordings or metrics from outside."""
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
        path: The file; None: the defaults. A relative path of `gates` is relative to the file.
        changes: A table like that of the file, which overrides it key by key.

    Raises:
        ConfigError: The file is absent or not TOML, a key is unknown, a value has the wrong type or range.
    """
    table: dict[str, Any] = {}
    if path is not None:
        table = dict(read_toml(path))
        try:
            gates = strict(RunConfig, table).gates
        except ConfigError as error:
            raise ConfigError(f"{path}: {error}") from None
        table["gates"] = gates if gates in PACKAGED else str(path.parent / gates)
    return strict(RunConfig, merged(table, changes or {}))


def dump_run(run: RunConfig) -> str:
    """Write the configuration as TOML with all defaults; `load_run` reads it back to an equal one."""
    return HEADER + tomli_w.dumps(_as_toml_value(run))


def _as_toml_value(value: Any) -> Any:
    """Convert values for TOML: dataclasses to tables of their keys, enums to values, without None."""
    if is_dataclass(value) and not isinstance(value, type):
        keys = (item.name for item in fields(value) if item.metadata.get("key", True))
        value = {key: getattr(value, key) for key in keys}
    if isinstance(value, Mapping):
        return {str(key): _as_toml_value(item) for key, item in value.items() if item is not None}
    if isinstance(value, (list, tuple)):
        return [_as_toml_value(item) for item in value]
    return value.value if isinstance(value, Enum) else value
