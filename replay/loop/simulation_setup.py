"""What a closed loop is driven with: vehicle, controller, traffic and the steps of its clock, as configured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import ceil, floor, inf
from types import MappingProxyType
from typing import Any

from logs.errors import LogError
from logs.observed import observed_until
from logs.road import RoadSource
from logs.scenario import Scenario
from logs.vehicle import VehicleParameters
from replay.config import LoopConfig
from replay.control import CONTROLLER
from replay.control.lateral_model import with_rigid_tyres
from replay.loop.plan_period import PlanPeriod
from replay.settings import check_members, configured
from replay.traffic import TRAFFIC_KIND, TRAFFIC_NOTES, Traffic
from replay.vehicle import VEHICLE, build_vehicle
from replay.vehicle.base import Controller, Vehicle
from replay.world import World, box_center, logged_ego

ROUNDING = 1e-7
"""Of a control period: times that differ by less are the same."""


@dataclass(frozen=True, eq=False)
class SimulationSetup:
    """Vehicle, controller and traffic of one drive, and its clock.

    Attributes:
        vehicle: At the log's first ego state, moving as it did.
        controller: Knows the vehicle's numbers, not its state.
        traffic: Moves the others.
        steps: Control periods from the ego's first sample to the end of the log, or to the last that is asked for.
        steps_per_plan: Control steps between two frames.
        period: Of the control, s.
        assumptions: About the start, the vehicle and the road, one sentence each.
        end: Why the drive ends at its last step where the log goes on; empty: the log ends there.
    """

    vehicle: Vehicle
    controller: Controller
    traffic: Traffic
    steps: int
    steps_per_plan: int
    period: float
    assumptions: tuple[str, ...]
    end: str = ""

    @classmethod
    def of(cls, scenario: Scenario, config: LoopConfig, until_s: float = inf) -> SimulationSetup:
        """The setup for a scenario, whose last step begins at `until_s`, s since its start.

        Raises:
            LogError: The log ends before the first step.
            ConfigError: No vehicle, controller or traffic of that name, or the plant's table is wrong.
        """
        start_ns = round(float(scenario.ego.t[0]) * 1e9)
        steps = (round(scenario.duration * 1e9) - start_ns) // config.control_period_ns
        if steps < 1:
            raise LogError(
                f"{scenario.name}: the log ends at the ego's first sample, so that there is nothing to drive",
                remedy="a closed loop needs a log of at least one control period",
            )
        start = replace(logged_ego(scenario.ego, scenario.vehicle, start_ns / 1e9), t=start_ns / 1e9)
        period, end = config.control_period_ns / 1e9, ""
        if until_s < scenario.duration:
            steps = min(steps, max(0, floor((until_s - start_ns / 1e9) / period + ROUNDING)) + 1)
        known = observed_until(scenario.traffic_spans, start.t) if config.end_with_evidence else scenario.duration
        if floor((known - start.t) / period + ROUNDING) < steps:
            steps = max(1, floor((known - start.t) / period + ROUNDING))
            end = f"traffic is recorded until {known:.1f} s of {scenario.duration:.1f} s, and the drive ends with it"
        model = configured(VEHICLE, config.vehicle, config.settings)
        vehicle = build_vehicle(model, config.vehicle, scenario.vehicle, start, config.plant)
        believed = build_vehicle(model, config.vehicle, scenario.vehicle, start, {}) if config.plant else vehicle
        traffic = configured(TRAFFIC_KIND, config.traffic, config.settings)(scenario)
        check_members("traffic", config.traffic, traffic, Traffic)
        return cls(
            vehicle=vehicle,
            controller=controller_of(believed, scenario.vehicle, config.controller, period, config.settings),
            traffic=traffic,
            steps=steps,
            steps_per_plan=config.plan_period_ns // config.control_period_ns,
            period=period,
            end=end,
            assumptions=(*_notes(scenario, config), *TRAFFIC_NOTES.get(config.traffic, ())),
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """The assumptions, and the notes of controller and traffic on the drive so far."""
        return (*self.assumptions, *self.controller.notes, *self.traffic.notes)

    def world(self) -> World:
        """The world as the vehicle and the traffic have it now."""
        return World(self.vehicle.state, self.traffic.step(self.vehicle.state))

    def plan_period(self) -> PlanPeriod:
        """The object that runs controller and vehicle."""
        return PlanPeriod(self.controller, self.vehicle, self.period)

    def horizon(self, step: int, most: int) -> int:
        """The step until which only the ego moves, at most `most` after `step`: the next frame or traffic step."""
        frame = step - step % self.steps_per_plan + self.steps_per_plan
        ahead = (self.traffic.due - self.vehicle.state.t) / self.period
        reacts = step + max(ceil(ahead - ROUNDING), 1) if ahead < most else self.steps
        return min(frame, reacts, step + most, self.steps)


def controller_of(
    vehicle: Vehicle,
    parameters: VehicleParameters,
    name: str,
    period: float,
    settings: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
) -> Controller:
    """The controller of that name for the vehicle's assumed parameters; a vehicle that follows plans has its own.

    Where the vehicle's tyres are rigid, the controller's model has them so.

    Raises:
        ConfigError: No controller of that name, it does not take these settings (`LoopConfig.settings`), or is none.
    """
    factory = configured(CONTROLLER, name, settings)
    if vehicle.own_controller is not None:
        return vehicle.own_controller
    known = with_rigid_tyres(parameters) if vehicle.has_rigid_tyres else parameters
    controller = factory(known, vehicle.powertrain, period)
    check_members("controller", name, controller, Controller)
    return controller


def _notes(scenario: Scenario, config: LoopConfig) -> list[str]:
    """What the user must know of the start, the road and the vehicle."""
    notes = []
    first = scenario.ego.state(0)
    if first.v < 0.0:
        notes.append(f"the log starts in reverse at {-first.v:.1f} m/s: the vehicle model starts from a standstill")
    if scenario.road.source is RoadSource.DRIVEN_PATH:
        notes.append("the log has no lanes: whether the ego leaves the road is not judged")
    elif not scenario.road.is_drivable(*box_center(first, scenario.vehicle)):
        notes.append("the ego starts off the lanes: leaving the road is judged from when it has been on them")
    if config.vehicle == "perfect":
        notes.append("the vehicle follows its plans exactly: no controller drives it")
    if config.plan_delay_s:
        notes.append(f"each plan but the first is driven from {config.plan_delay_s:g} s after its frame on")
    if config.plant:
        changed = ", ".join(f"{key} = {value}" for key, value in config.plant.items())
        notes.append(f"the vehicle model differs from what planner and controller believe: {changed}")
    return notes
