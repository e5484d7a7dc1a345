"""The configuration of the loops: `LoopConfig`, with that of the sensor and of planners in
processes of their own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from replan.core.errors import ConfigError
from replan.logs.observed import MAX_AGE_S
from replan.replay.parts import OF_LOOP, Part

SHORTEST_S = 1e-4
"""Shortest period and step, s: 10 kHz is faster than any control of a car."""
MOST_SAMPLES = 1000
"""Most samples of a prediction: 100 s at 10 Hz, of each road user in each frame."""
MOST_TOGETHER = 64
"""Most logs in lock step: their answers, 1 MB each with internals of plans, must fit into one
message.
"""


@dataclass(frozen=True)
class SensorConfig:
    """The abilities of a sensor; the defaults are round values for the lidars and cameras of a car.

    Attributes:
        range_m: Agents farther away are not seen.
        field_of_view_deg: Angle of view, centred on the ego's heading; 360 covers all directions.
        occlusion: Whether road users hide others behind them.
        position_noise_m: Standard deviation of positions along and across the agent's heading, for
            each measurement.
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
        for name in (
            "position_noise_m",
            "yaw_noise_deg",
            "velocity_noise_mps",
            "latency_s",
            "coast_s",
        ):
            if not 0.0 <= getattr(self, name) < 1e6:
                raise ConfigError(
                    f"loop.sensor.{name} must not be negative, got {getattr(self, name)}"
                )
        if not 0.0 <= self.dropout <= 1.0:
            raise ConfigError(f"loop.sensor.dropout is a probability, got {self.dropout}")


@dataclass(frozen=True)
class PlannerProcessConfig:
    """How planners that are not built in are isolated (docs/planners_apart.md).

    Attributes:
        trust: Planners named "module:Class" run in the process that holds the log: faster, and
            without limits.
        plan_timeout_s: Longest time for a plan.
        start_timeout_s: Longest time to build the planner, and for its first plan (kernels,
            models).
        log_timeout_s: Longest time for all plans of a drive; 0: no limit.
        memory_gb: Largest memory of the planner's process; 0: no limit.
        environment: Variables that it receives besides
            `replan.replay.planner_process.processes.ENVIRONMENT`.
        batch: Number of logs in lock step, whose frames are planned together (`plan_batch`); 0:
            each log by itself.

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
            raise ConfigError(
                f"loop.apart.batch must be from 0 to {MOST_TOGETHER}, got {self.batch}"
            )
        for name in ("plan_timeout_s", "start_timeout_s"):
            if not 1e-3 <= getattr(self, name) < 1e6:
                raise ConfigError(f"loop.apart.{name} must be positive, got {getattr(self, name)}")
        for name in ("log_timeout_s", "memory_gb"):
            if not 0.0 <= getattr(self, name) < 1e6:
                raise ConfigError(
                    f"loop.apart.{name} must not be negative, got {getattr(self, name)}"
                )


@dataclass(frozen=True)
class LoopConfig:
    """How the loops run.

    Attributes:
        plan_period_s: Time between two frames.
        control_period_s: Time between two commands; the plan period is a multiple of it.
        vehicle: Name of a vehicle model (`replan.replay.parts`), or "module:Class", as for all
            names here (docs/extend.md).
        plant: Properties of the vehicle model that are hidden from planner and controller:
            VehicleParameters by name, and keywords of the model
            (`replan.replay.vehicle.build_vehicle`).
        controller: Name of a controller; the vehicle "perfect" needs none.
        traffic: Name of how the others move.
        plan_delay_s: Time from a frame until its plan is driven (the computing time), in whole
            control periods.
        perception: Name of what the planner sees.
        sensor: Abilities of the sensor, for the perception "sensor".
        prediction: Name of a predictor; "oracle" is the log's own future, with traffic "time".
        prediction_horizon_s: How far the others are predicted.
        prediction_step_s: Time between two samples of a prediction.
        end_with_evidence: A closed drive ends when the recording of the log's traffic ends
            (`Scenario.traffic_spans`).
        drives_on: A closed drive goes on to the end of the log's drive, through contacts, goals and
            off the road, as in nuPlan (`replan score`).
        apart: How planners that are not built in are isolated.
        settings: Keywords of the named parts, by key; not a key of the file: `RunConfig.drive_loop`
            fills it in.

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
        for name in (
            "plan_period_s",
            "control_period_s",
            "prediction_horizon_s",
            "prediction_step_s",
        ):
            seconds = getattr(self, name)
            if not SHORTEST_S <= seconds < 1e6:
                raise ConfigError(
                    f"loop.{name} must be positive, from {SHORTEST_S:g} to 1e6 s, got {seconds}"
                )
        if not self.prediction_horizon_s / self.prediction_step_s <= MOST_SAMPLES:
            raise ConfigError(
                f"loop.prediction_step_s ({self.prediction_step_s}) gives more than {MOST_SAMPLES} "
                f"samples in loop.prediction_horizon_s ({self.prediction_horizon_s}); raise it"
            )
        if self.prediction == "oracle" and self.traffic != "time":
            raise ConfigError(
                "loop.prediction 'oracle' uses the log's future, which road users do not follow "
                "with loop.traffic"
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
