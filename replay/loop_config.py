"""The configuration of the loops: `LoopConfig`, with that of the sensor and of planners in
processes of their own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

from msgspec import Meta

from replan.core.errors import ConfigError
from replan.core.settings import Config
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


LARGEST = 1e6
"""Bound of times, distances and deviations, which nothing sensible reaches."""
Reach = Annotated[float, Meta(gt=0.0, lt=LARGEST)]
Limited = Annotated[float, Meta(ge=0.0, lt=LARGEST)]
Period = Annotated[float, Meta(ge=SHORTEST_S, lt=LARGEST)]


@dataclass(frozen=True)
class SensorConfig(Config):
    """The abilities of a sensor; the defaults are round values for the lidars and cameras of a car.

    Raises:
        ConfigError: A value is out of its range.
    """

    range_m: Reach = 100.0
    """Agents farther away are not seen."""
    field_of_view_deg: Reach = 360.0
    """Angle of view, centred on the ego's heading; 360 covers all directions."""
    occlusion: bool = True
    """Whether road users hide others behind them."""
    position_noise_m: Limited = 0.1
    """Standard deviation of positions along and across the agent's heading, for each measurement.
    """
    yaw_noise_deg: Limited = 1.0
    """Standard deviation of headings."""
    velocity_noise_mps: Limited = 0.1
    """Standard deviation of velocities along and across the agent's heading."""
    latency_s: Limited = 0.1
    """Time from the measurement to the planner; counted in whole frames."""
    dropout: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.02
    """Probability that an agent is not measured in a slot."""
    dropout_s: Reach = 0.3
    """Length of the slots."""
    coast_s: Limited = MAX_AGE_S
    """How long an agent that is no longer measured is extrapolated."""
    seed: int = 0
    """Seed of the random draws."""


@dataclass(frozen=True)
class PlannerProcessConfig(Config):
    """How planners that are not built in are isolated (docs/bring_planner.md).

    Raises:
        ConfigError: A limit is negative, a timeout is 0, or `batch` is too large.
    """

    trust: bool = False
    """Planners named "module:Class" run in the process that holds the log: faster, and without
    limits.
    """
    plan_timeout_s: Annotated[float, Meta(ge=1e-3, lt=LARGEST)] = 10.0
    """Longest time for a plan."""
    start_timeout_s: Annotated[float, Meta(ge=1e-3, lt=LARGEST)] = 60.0
    """Longest time to build the planner, and for its first plan (kernels, models)."""
    log_timeout_s: Limited = 0.0
    """Longest time for all plans of a drive; 0: no limit."""
    memory_gb: Limited = 8.0
    """Largest memory of the planner's process; 0: no limit."""
    environment: tuple[str, ...] = ()
    """Variables that it receives besides `replan.replay.planner_process.processes.ENVIRONMENT`."""
    batch: Annotated[int, Meta(ge=0, le=MOST_TOGETHER)] = 0
    """Number of logs in lock step, whose frames are planned together (`plan_batch`); 0: each log by
    itself.
    """


@dataclass(frozen=True)
class LoopConfig(Config):
    """How the loops run.

    Raises:
        ConfigError: A period is not positive, or the periods do not fit.
    """

    plan_period_s: Period = 0.1
    """Time between two frames."""
    control_period_s: Period = 0.01
    """Time between two commands; the plan period is a multiple of it."""
    vehicle: str = "kinematic_bicycle"
    """Name of a vehicle model (`replan.replay.parts`), or "module:Class", as for all names here
    (docs/extend.md).
    """
    controller: str = "dlqr_pid"
    """Name of a controller; the vehicle "perfect" needs none."""
    traffic: str = "give_way"
    """Name of how the others move."""
    prediction: str = "lane_following"
    """Name of a predictor; "oracle" is the log's own future, with traffic "time"."""
    prediction_horizon_s: Period = 8.0
    """How far the others are predicted."""
    prediction_step_s: Period = 0.1
    """Time between two samples of a prediction."""
    plant: Mapping[str, float | str] = field(default_factory=dict)
    """Properties of the vehicle model that are hidden from planner and controller:
    VehicleParameters by name, and keywords of the model (`replan.replay.vehicle.build_vehicle`).
    """
    warm_up_s: Limited = 0.0
    """Least time of the log before a drive: it begins so late, and the planner's first frame has a
    real past (2.2 s for all of it). `log.begin` is set to it if it is earlier.
    """
    plan_delay_s: Limited = 0.0
    """Time from a frame until its plan is driven (the computing time), in whole control periods."""
    perception: str = "ground_truth"
    """Name of what the planner sees."""
    sensor: SensorConfig = field(default_factory=SensorConfig)
    """Abilities of the sensor, for the perception "sensor"."""
    end_with_evidence: bool = False
    """A closed drive ends when the recording of the log's traffic ends (`Scenario.traffic_spans`).
    """
    drives_on: bool = False
    """A closed drive goes on to the end of the log's drive, through contacts, goals and off the
    road, as in nuPlan (`replan score`).
    """
    apart: PlannerProcessConfig = field(default_factory=PlannerProcessConfig)
    """How planners that are not built in are isolated."""
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict, metadata={"key": False})
    """Keywords of the named parts, by key; not a key of the file: `RunConfig.drive_loop` fills it
    in.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.prediction_horizon_s / self.prediction_step_s <= MOST_SAMPLES:
            raise ConfigError(
                f"loop.prediction_step_s ({self.prediction_step_s}) gives more than {MOST_SAMPLES} "
                f"samples in loop.prediction_horizon_s ({self.prediction_horizon_s}); raise it"
            )
        if self.prediction == "oracle" and self.traffic != "time":
            raise ConfigError(
                "loop.prediction 'oracle' uses the log's future, which road users do not follow "
                f"with loop.traffic '{self.traffic}'; take traffic 'time' (--traffic time)"
            )
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
