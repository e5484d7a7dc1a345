"""Closed loops without the simulation: plans that are followed perfectly, or by a controller."""

from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import NamedTuple

import numpy as np
from scenes import CAR, Other, frame, perceive

from replan.core.arrays import FloatArray
from replan.logs.edit.transform import mirrored
from replan.logs.frame import Frame, PlannerContext
from replan.logs.plan import Decision, DecisionKind, Plan
from replan.logs.road import Goal, Road
from replan.logs.scenario import Scenario
from replan.logs.shapes import distance
from replan.logs.states import Command, EgoState, Trajectory
from replan.logs.vehicle import VehicleParameters
from replan.planners.base import Planner
from replan.planners.dp_qp import DpQp
from replan.replay.loop.simulation_setup import controller_of
from replan.replay.parts import CONTROLLER, VEHICLE, Part
from replan.replay.vehicle.plan_path import PlanPath
from replan.replay.world import World, logged_ego

PERIOD_S = 0.1

Drive = list[tuple[Frame, Plan]]


def planner(road: Road, ego: EgoState, goal: Goal | None = None) -> Planner:
    return DpQp(PlannerContext(road, goal, CAR, PERIOD_S, ego))


def followed(
    road: Road,
    ego: EgoState,
    others: Sequence[Other] = (),
    *,
    seconds: float,
    goal: Goal | None = None,
    build: Callable[[Road, EgoState, Goal | None], Planner] = planner,
) -> Drive:
    """Frames and plans of a closed loop in which the ego follows each plan without any error."""
    driver, previous, drive = build(road, ego, goal), None, []
    for k in range(round(seconds / PERIOD_S)):
        now = frame(ego, others, t=k * PERIOD_S, previous=previous)
        previous = driver.plan(now)
        drive.append((now, previous))
        ego = previous.trajectory.at((k + 1) * PERIOD_S)
    return drive


def gaps(drive: Drive, name: str, car: VehicleParameters = CAR) -> FloatArray:
    """Distance between the ego's box and an agent's at each frame, m; inf where it is not there."""
    found = []
    for now, _ in drive:
        if name not in now.agents.ids:
            found.append(np.inf)
            continue
        i = now.agents.ids.index(name)
        a, ego = now.agents, now.ego
        x = ego.x + car.axle_to_center * np.cos(ego.yaw)
        y = ego.y + car.axle_to_center * np.sin(ego.yaw)
        found.append(
            distance(
                x,
                y,
                ego.yaw,
                car.length,
                car.width,
                a.x[i],
                a.y[i],
                a.yaw[i],
                a.length[i],
                a.width[i],
            )
        )
    return np.array(found)


def decided(plan: Plan, name: str, stage: str) -> DecisionKind | None:
    """What a plan decided about an agent in a stage."""
    kinds = [
        item.kind
        for item in plan.internals
        if isinstance(item, Decision) and (item.agent, item.stage) == (name, stage)
    ]
    return kinds[0] if kinds else None


def check_mirrored(
    build: Callable[[PlannerContext], Planner], made: Scenario, *, atol: float
) -> None:
    """In the mirrored world a planner plans the mirror image, at the start and later on the log's
    drive.
    """
    plans = []
    for world in (made, mirrored(made)):
        start = logged_ego(world.ego, world.vehicle, 0.0)
        planning = build(PlannerContext(world.road, world.goal, world.vehicle, 0.1, start))
        for t in (0.0, 0.4 * world.ego.t[-1]):
            ego = logged_ego(world.ego, world.vehicle, float(t))
            plans.append(planning.plan(perceive(World(ego, world.tracks))).trajectory)
    for one, two in zip(plans[:2], plans[2:], strict=True):
        for field in fields(Trajectory):
            sign = -1.0 if field.name in ("y", "yaw", "kappa") else 1.0
            left, right = getattr(one, field.name), sign * getattr(two, field.name)
            np.testing.assert_allclose(left, right, atol=atol, err_msg=field.name)


class ControlledDrive(NamedTuple):
    """A drive along one plan by a controller."""

    commands: list[Command]
    states: list[EgoState]  # One more than commands
    errors: FloatArray  # The `Deviation` before each command, a row each


def controlled(
    plan: Trajectory,
    controller: str,
    vehicle: str,
    seconds: float,
    start: EgoState | None = None,
    plant: VehicleParameters = CAR,
) -> ControlledDrive:
    """Follow a plan at 100 Hz, without replanning."""
    car = VEHICLE.builtin[vehicle](plant, start or plan.state(0))
    driver = controller_of(car, CAR, Part(CONTROLLER, controller), 0.01)
    followed_plan, path = Plan(plan), PlanPath.of(plan)
    commands, states, errors = [], [car.state], []
    for _ in range(round(seconds / 0.01)):
        errors.append(path.deviation(car.state))
        commands.append(driver.control(car.state, followed_plan))
        states.append(car.step(commands[-1], 0.01))
    return ControlledDrive(commands, states, np.array(errors))
