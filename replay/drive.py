"""What a loop is configured by, and what it gives back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from logs.errors import ConfigError
from logs.trace import Trace
from replay.sensor import SensorConfig

TRUSTED = "the planner was trusted: it ran in the process that holds the log"
"""The note of a drive whose planner was not kept apart and does not come with replan."""
BATCHED = "batched: the planner's process was shared with other logs, up to {} in all"
"""The note of a drive whose frames were planned together with those of other logs."""
MOST_TOGETHER = 64
"""Logs in lock step: their answers, 1 MB each where the inside of plans is kept, have to fit into a message."""


@dataclass(frozen=True)
class ApartConfig:
    """How planners that are not built in are kept apart (docs/planners_apart.md).

    Attributes:
        trust: Planners named "module:Class" run in the process that holds the log: faster, and no limit holds.
        plan_timeout_s: A plan may take so long.
        start_timeout_s: Building the planner may take so long, and so may its first plan (kernels, models).
        log_timeout_s: All of it may take so long in one drive; 0: no limit.
        memory_gb: Data of the planner's process; 0: no limit.
        environment: Variables that it is given beside `replay.apart.processes.ENVIRONMENT`.
        batch: So many logs are in lock step, and their frames are planned together (`plan_batch`); 0: each by itself.

    Raises:
        ConfigError: A limit is negative, a plan has no time, or there are too many logs together.
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


@dataclass(frozen=True, order=True)
class Place:
    """Which of a log's drives it is; they are driven in this order.

    Attributes:
        member: Of the ensemble; 0: the log itself.
        planner: Of the run's, by place.
        mode: Of its loops, by place.
        again: Whether it is the second drive of a start, which is compared with the first (`replay.determinism`).
    """

    member: int = 0
    planner: int = 0
    mode: int = 0
    again: bool = False


FIRST = Place()


@dataclass(frozen=True)
class LoopConfig:
    """How the loops run.

    Attributes:
        plan_period_s: Time between two frames.
        control_period_s: Time between two commands; the plan period is a multiple of it.
        vehicle: Name in `replay.vehicle.VEHICLES`, or "module:Class" as all that is named here (docs/extend.md).
        plant: What the vehicle model has that planner and controller do not know of: VehicleParameters by name, and
            keywords of the model (`replay.vehicle.plant`).
        controller: Name in `replay.control.CONTROLLERS`; the vehicle "perfect" needs none.
        traffic: Name in `replay.traffic.TRAFFIC`.
        plan_delay_s: A plan is driven from so long after its frame on (what computing it takes), whole control periods.
        perception: Name in `replay.perception.PERCEPTIONS`.
        sensor: What the sensor can do, where the perception is "sensor".
        prediction: Name in `replay.prediction.PREDICTORS`, or "oracle": the log's own future, with traffic "time".
        prediction_horizon_s: How far the others are predicted.
        prediction_step_s: Time between two samples of a prediction.
        end_with_evidence: A closed drive ends where the recording of the log's traffic does (`Scenario.traffic_spans`).
        apart: How planners that are not built in are kept apart.
        settings: Keywords of what is named here, by its key; a run's come from its tables (`RunConfig.controller` ...).

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
    apart: ApartConfig = field(default_factory=ApartConfig)
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict, metadata={"key": False})

    def __post_init__(self) -> None:
        for name in ("plan_period_s", "control_period_s", "prediction_horizon_s", "prediction_step_s"):
            if not 1e-9 <= getattr(self, name) < 1e6:
                raise ConfigError(f"loop.{name} must be positive, got {getattr(self, name)}")
        if self.prediction == "oracle" and self.traffic != "time":
            raise ConfigError(
                f"loop.prediction 'oracle' knows the log's future, which is not the others' with loop.traffic"
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

    @property
    def plan_period_ns(self) -> int:
        """Nanoseconds between two frames."""
        return round(self.plan_period_s * 1e9)

    @property
    def plan_delay_steps(self) -> int:
        """Control periods from a frame to its plan being driven."""
        return round(self.plan_delay_s * 1e9) // self.control_period_ns

    @property
    def control_period_ns(self) -> int:
        """Nanoseconds between two commands."""
        return round(self.control_period_s * 1e9)


DEFAULT_LOOP = LoopConfig()


@dataclass(frozen=True, slots=True)
class StageTime:
    """How long a stage of one plan took; stage "total" is the whole of `plan()`.

    Attributes:
        t: The frame's time, s since the scenario's start.
        stage: As the planner named it in `lap(stage)`.
        seconds: Wall time; laps of one name within a frame are added.
    """

    t: float
    stage: str
    seconds: float


@dataclass(frozen=True, eq=False, slots=True)
class Drive:
    """A trace, and apart from it what is not the same twice: how long planning took."""

    trace: Trace
    timings: tuple[StageTime, ...]
