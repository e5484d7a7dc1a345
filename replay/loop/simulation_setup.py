"""The setup of a closed loop: vehicle, controller, traffic and the steps of its clock, as
configured.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, floor, inf, isfinite

from replan.core.errors import LogError
from replan.logs.observed import observed_until
from replan.logs.road import RoadSource
from replan.logs.scenario import Scenario
from replan.logs.vehicle import VehicleParameters
from replan.replay.control.lateral_model import with_rigid_tyres
from replan.replay.loop.plan_period import PlanPeriod
from replan.replay.loop_config import LoopConfig
from replan.replay.parts import Part
from replan.replay.traffic import TRAFFIC_NOTES, Traffic
from replan.replay.vehicle import build_vehicle
from replan.replay.vehicle.base import Controller, Vehicle
from replan.replay.world import World, box_center, logged_ego

ROUNDING = 1e-7
"""Tolerance in control periods: times that differ by less are equal."""


@dataclass(frozen=True, eq=False)
class SimulationSetup:
    """Vehicle, controller and traffic of one drive, and its clock.

    Attributes:
        vehicle: At the log's first ego state, moving as it did.
        controller: Knows the vehicle's parameters, not its hidden state.
        traffic: Moves the other road users.
        steps: Control periods from the ego's first sample to the end of the log, or to the last
            requested step.
        steps_per_plan: Control steps between two frames.
        period: Control period, s.
        assumptions: Assumptions about the start, the vehicle and the road, one sentence each.
        end: Why the drive ends before the log; empty: it ends with the log.
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
        """Build the setup for a scenario; the last step begins at `until_s`, s since its start.

        Raises:
            LogError: The log ends before the first step.
            ConfigError: No vehicle, controller or traffic of that name, or the plant's table is
                wrong.
        """
        start_ns = round(float(scenario.ego.t[0]) * 1e9)
        steps = (round(scenario.duration * 1e9) - start_ns) // config.control_period_ns
        if steps < 1:
            raise LogError(
                f"{scenario.name}: the log ends at the ego's first sample, so that there is "
                "nothing to drive",
                remedy="a closed loop needs a log of at least one control period",
            )
        start = replace(
            logged_ego(scenario.ego, scenario.vehicle, start_ns / 1e9), t=start_ns / 1e9
        )
        period, end = config.control_period_ns / 1e9, ""
        if until_s < scenario.duration:
            steps = min(steps, max(0, floor((until_s - start_ns / 1e9) / period + ROUNDING)) + 1)
        known = (
            observed_until(scenario.traffic_spans, start.t)
            if config.end_with_evidence
            else scenario.duration
        )
        if config.drives_on:
            steps = min(steps, max(1, floor((scenario.ego.t[-1] - start.t) / period + ROUNDING)))
        if floor((known - start.t) / period + ROUNDING) < steps:
            steps = max(1, floor((known - start.t) / period + ROUNDING))
            end = (
                f"traffic is recorded until {known:.1f} s of {scenario.duration:.1f} s, and the "
                "drive ends with it"
            )
        model = config.part("vehicle")
        vehicle = build_vehicle(model, scenario.vehicle, start, config.plant)
        believed = build_vehicle(model, scenario.vehicle, start, {}) if config.plant else vehicle
        return cls(
            vehicle=vehicle,
            controller=controller_of(believed, scenario.vehicle, config.part("controller"), period),
            traffic=config.part("traffic").build(scenario),
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
        """Return the present world, from vehicle and traffic."""
        return World(self.vehicle.state, self.traffic.step(self.vehicle.state))

    def plan_period(self) -> PlanPeriod:
        """Return the object that runs controller and vehicle."""
        return PlanPeriod(self.controller, self.vehicle, self.period)

    def horizon(self, step: int) -> int:
        """Return the next step after `step` with a frame or a reaction of the traffic."""
        frame = step - step % self.steps_per_plan + self.steps_per_plan
        ahead = (self.traffic.due - self.vehicle.state.t) / self.period
        reacts = step + max(ceil(ahead - ROUNDING), 1) if isfinite(ahead) else self.steps
        return min(frame, reacts, self.steps)


def controller_of(
    vehicle: Vehicle, parameters: VehicleParameters, part: Part, period: float
) -> Controller:
    """Build a controller for the assumed parameters; a vehicle that follows plans has its own.

    If the vehicle has rigid tyres, so does the controller's model. Errors as `Part.build`.
    """
    if vehicle.own_controller is not None:
        part.keywords()  # a wrong name or setting is an error all the same
        return vehicle.own_controller
    known = with_rigid_tyres(parameters) if vehicle.has_rigid_tyres else parameters
    controller: Controller = part.build(known, vehicle.powertrain, period)
    return controller


def _notes(scenario: Scenario, config: LoopConfig) -> list[str]:
    notes = []
    first = scenario.ego.state(0)
    if first.v < 0.0:
        notes.append(
            f"the log starts in reverse at {-first.v:.1f} m/s: the vehicle model starts from a "
            "standstill"
        )
    if scenario.road.source is RoadSource.DRIVEN_PATH:
        notes.append("the log has no lanes: whether the ego leaves the road is not judged")
    elif not scenario.road.is_drivable(*box_center(first, scenario.vehicle)):
        notes.append(
            "the ego starts off the lanes: leaving the road is judged from when it has been on them"
        )
    if config.vehicle == "perfect":
        notes.append("the vehicle follows its plans exactly: no controller drives it")
    if config.plan_delay_s:
        notes.append(
            f"each plan but the first is driven from {config.plan_delay_s:g} s after its frame on"
        )
    if config.plant:
        changed = ", ".join(f"{key} = {value}" for key, value in config.plant.items())
        notes.append(
            f"the vehicle model differs from what planner and controller believe: {changed}"
        )
    return notes
