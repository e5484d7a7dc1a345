"""What a closed loop is driven with: vehicle, controller, traffic and the steps of its clock, as configured."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

from logs.errors import LogError, unknown_name
from logs.road import RoadSource
from logs.scenario import Scenario
from replay.control import CONTROLLERS
from replay.control.base import Controller
from replay.drive import LoopConfig
from replay.traffic import TRAFFIC, Traffic
from replay.vehicle import VEHICLES
from replay.vehicle.base import Vehicle
from replay.world import World, box_center, logged_ego

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Rig:
    """One drive's machinery.

    Attributes:
        vehicle: At the log's first ego state, moving as it did.
        controller: Knows the vehicle's numbers, not its state.
        traffic: Moves the others.
        steps: One per control period, from the ego's first sample to the end of the log.
        steps_per_plan: A frame is due at every so many steps.
        period: Of the control, s.
        notes: What was assumed about the start, one sentence each.
    """

    vehicle: Vehicle
    controller: Controller
    traffic: Traffic
    steps: range
    steps_per_plan: int
    period: float
    notes: tuple[str, ...]

    @classmethod
    def of(cls, scenario: Scenario, config: LoopConfig) -> Rig:
        """The rig for a scenario.

        Raises:
            LogError: The log ends before the first step.
            ConfigError: No vehicle, controller or traffic of that name.
        """
        start_ns = round(float(scenario.ego.t[0]) * 1e9)
        steps = range((round(scenario.duration * 1e9) - start_ns) // config.control_period_ns)
        if not steps:
            raise LogError(
                f"{scenario.name}: the log ends at the ego's first sample, so that there is nothing to drive",
                remedy="a closed loop needs a log of at least one control period",
            )
        start = replace(logged_ego(scenario.ego, scenario.vehicle, start_ns / 1e9), t=start_ns / 1e9)
        period = config.control_period_ns / 1e9
        vehicle = _named("vehicle", VEHICLES, config.vehicle)(scenario.vehicle, start)
        return cls(
            vehicle=vehicle,
            controller=_named("controller", CONTROLLERS, config.controller)(
                scenario.vehicle, vehicle.powertrain, period
            ),
            traffic=_named("traffic", TRAFFIC, config.traffic)(scenario),
            steps=steps,
            steps_per_plan=config.plan_period_ns // config.control_period_ns,
            period=period,
            notes=tuple(_notes(scenario)),
        )

    def world(self) -> World:
        """The world as the vehicle and the traffic have it now."""
        return World(self.vehicle.state, self.traffic.step(self.vehicle.state))


def _named(kind: str, table: Mapping[str, Callable[..., T]], name: str) -> Callable[..., T]:
    if name not in table:
        raise unknown_name(kind, name, table)
    return table[name]


def _notes(scenario: Scenario) -> list[str]:
    """What the user must know of the start and the road."""
    notes = []
    first = scenario.ego.state(0)
    if first.v < 0.0:
        notes.append(f"the log starts in reverse at {-first.v:.1f} m/s: the vehicle model starts from a standstill")
    if scenario.road.source is RoadSource.DRIVEN_PATH:
        notes.append("the log has no lanes: whether the ego leaves the road is not judged")
    elif not scenario.road.is_drivable(*box_center(first, scenario.vehicle)):
        notes.append("the ego starts off the lanes: leaving the road is judged from when it has been on them")
    return notes
