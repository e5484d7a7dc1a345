"""Small worlds for the tests of planners: roads, others that move by a formula, scenes, and a
perfect follower.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind, Agents
from replan.logs.edit.transform import mirrored
from replan.logs.frame import Frame, PlannerContext, Visibility
from replan.logs.plan import Decision, DecisionKind, Plan
from replan.logs.road import Goal, Lane, Road
from replan.logs.route import find_route
from replan.logs.scenario import Scenario
from replan.logs.shapes import distance
from replan.logs.states import Command, EgoState, Trajectory
from replan.logs.vehicle import VehicleParameters
from replan.planners.base import Planner
from replan.planners.dp_qp import DpQp
from replan.planners.dp_qp.goal_window import GoalWindow, SpeedTarget
from replan.planners.dp_qp.path.passing import PassTarget
from replan.planners.dp_qp.speed.caps import (
    CautionConfig,
    LoweredLimit,
    PathView,
    SpeedCap,
    SpeedTask,
    lower_limit,
)
from replan.planners.frenet.path import Path
from replan.planners.frenet.reference_path import ReferencePath, make_reference_path
from replan.planners.frenet.scene import Scene, scene_of
from replan.planners.frenet.st_boundaries import StGraphConfig, st_boundaries
from replan.replay.loop.simulation_setup import controller_of
from replan.replay.loop_config import DEFAULT_LOOP, LoopConfig
from replan.replay.parts import CONTROLLER, VEHICLE, Part
from replan.replay.perception import GroundTruth
from replan.replay.prediction import predict
from replan.replay.vehicle.plan_path import PlanPath
from replan.replay.world import World, logged_ego

PERIOD = 0.1
CAR = VehicleParameters()


@dataclass(frozen=True)
class Other:
    """A road user whose pose and velocity follow a formula: t -> x, y, yaw, vx, vy."""

    id: str
    at: Callable[[float], tuple[float, float, float, float, float]]
    kind: AgentKind = AgentKind.CAR
    length: float = 4.5
    width: float = 1.8


def standing(name: str, x: float, y: float, yaw: float = 0.0, **size: float) -> Other:
    return Other(name, lambda t: (x, y, yaw, 0.0, 0.0), **size)  # type: ignore[arg-type]


def driving(name: str, x: float, y: float, vx: float, vy: float = 0.0, **size: float) -> Other:
    yaw = float(np.arctan2(vy, vx))
    return Other(name, lambda t: (x + vx * t, y + vy * t, yaw, vx, vy), **size)  # type: ignore[arg-type]


def agents(others: Sequence[Other], t: float = 0.0) -> Agents:
    columns = np.array([other.at(t) for other in others], float).reshape(-1, 5).T
    return Agents(
        tuple(other.id for other in others),
        tuple(other.kind for other in others),
        np.array([other.length for other in others], float),
        np.array([other.width for other in others], float),
        *columns,
    )


def frame(
    ego: EgoState, others: Sequence[Other] = (), *, t: float = 0.0, previous: Plan | None = None
) -> Frame:
    known = agents(others, t)
    return Frame(t, ego, known, predict(known, t), previous)


def perceive(world: World, config: LoopConfig = DEFAULT_LOOP) -> Frame:
    """A frame at the world's time, by ground truth; predictions as configured, without lanes."""
    t, known = world.ego.t, GroundTruth().see(world)[0]
    horizon, step, method = config.prediction_horizon_s, config.prediction_step_s, config.prediction
    return Frame(t, world.ego, known, predict(known, t, horizon=horizon, step=step, method=method))


def curve(*pieces: tuple[float, float], step: float = 1.0) -> FloatArray:
    """Points `(n, 2)` of arcs `(length, curvature)` from the origin along x."""
    kappa = np.concatenate([np.full(round(length / step), k) for length, k in pieces])
    yaw = np.r_[0.0, np.cumsum(kappa * step)]
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    return np.vstack(
        [[0.0, 0.0], np.cumsum(step * np.column_stack([np.cos(middle), np.sin(middle)]), axis=0)]
    )


def along_x(begin: float = -50.0, end: float = 400.0) -> FloatArray:
    x = np.arange(begin, end + 1.0, 2.0)
    return np.column_stack([x, np.zeros(len(x))])


def beside(points: FloatArray, left: float) -> FloatArray:
    """The polyline `left` m to the left of another."""
    tangent = np.gradient(points, axis=0)
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]]) / np.hypot(*tangent.T)[:, None]
    return points + left * normal


def strip(
    lane_id: int, points: FloatArray, left: float = 1.75, right: float = -1.75, **more: object
) -> Lane:
    """A lane along a polyline, from `right` to `left` of it."""
    return Lane(lane_id, beside(points, left), beside(points, right), **more)  # type: ignore[arg-type]


def lanes(
    points: FloatArray,
    count: int = 1,
    *,
    width: float = 3.5,
    limit: float = 13.89,
    right: bool = True,
) -> Road:
    """Lanes 0, 1, ... in one direction, the first on the polyline, the others to its left."""
    found = [
        strip(
            i,
            points,
            width * (i + 0.5),
            width * (i - 0.5),
            speed_limit=limit,
            left_neighbour=i + 1 if i + 1 < count else None,
            right_neighbour=i - 1 if i else None,
        )
        for i in range(count)
    ]
    return Road({lane.id: lane for lane in found}, drives_on_right=right)


def two_way(*, crossable: bool = True, right: bool = True) -> Road:
    """A lane along x and one back to its left (to its right where traffic drives on the left)."""
    side = 1.0 if right else -1.0
    marks = {"left_opposite": right, "right_opposite": not right, "speed_limit": 10.0}
    marks["left_crossable" if right else "right_crossable"] = crossable
    there, back = along_x(), along_x()[::-1] + np.array([0.0, side * 3.5])
    return Road({0: strip(0, there, **marks), 1: strip(1, back, **marks)}, drives_on_right=right)


START = EgoState(0.0, 0.0, 0.0, 0.0, 8.0)


def reference(
    road: Road | FloatArray, count: int = 1, *, ego: EgoState = START, lane: int | None = None
) -> ReferencePath:
    """The reference path from an ego on a road, or on `count` lanes along points.

    Of one lane only, if it is named.
    """
    road = road if isinstance(road, Road) else lanes(road, count)
    route = find_route(road, ego, None) if lane is None else (lane,)
    return make_reference_path(road, route, ego, CAR)


def scene(
    along: ReferencePath,
    ego: EgoState,
    others: Sequence[Other] = (),
    *,
    t: float = 0.0,
    seen: Visibility | None = None,
) -> Scene:
    """An ego and others along a reference path at a time."""
    return scene_of(replace(frame(ego, others, t=t), visibility=seen), ego, along, CAR)


def path_of(kappa: FloatArray, spacing: float) -> Path:
    """A path through the origin from curvatures at points `spacing` m apart."""
    sigma = spacing * np.arange(len(kappa))
    yaw = np.r_[0.0, np.cumsum(0.5 * spacing * (kappa[1:] + kappa[:-1]))]
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    x, y = (np.r_[0.0, np.cumsum(spacing * rate)] for rate in (np.cos(middle), np.sin(middle)))
    return Path(sigma, x, y, yaw, kappa, sigma)


def view(
    now: Scene, path: Path, *, targets: tuple[PassTarget, ...] = (), **more: object
) -> PathView:
    """What a producer of speed caps is given for a path on which all agents are met, with braking
    of 6 m/s2.
    """
    none = np.zeros(len(now.frame.agents), np.bool_)
    taken = st_boundaries(now, path, none, frozenset(), StGraphConfig())
    task = SpeedTask(
        {}, none, (), targets, False, GoalWindow(None, now.reference, now.vehicle), SpeedTarget()
    )
    given: dict[str, object] = {
        "scene": now,
        "path": path,
        "task": task,
        "limit": np.full(len(path.s), 15.0),
        "taken": taken,
        "came": {},
        "hard_mps2": 6.0,
        "margin_m": 0.6,
        "caution": CautionConfig(),
    }
    return PathView(**{**given, **more})  # type: ignore[arg-type]


def limit_of(seen: PathView, producer: Callable[[PathView], tuple[SpeedCap, ...]]) -> LoweredLimit:
    """The limit of a view with the caps of one producer in it."""
    road = LoweredLimit(seen.limit, np.zeros(len(seen.limit), np.bool_))
    return lower_limit(seen.path.sigma, road, producer(seen))


def planner(road: Road, ego: EgoState, goal: Goal | None = None) -> Planner:
    return DpQp(PlannerContext(road, goal, CAR, PERIOD, ego))


Drive = list[tuple[Frame, Plan]]


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
    for k in range(round(seconds / PERIOD)):
        now = frame(ego, others, t=k * PERIOD, previous=previous)
        previous = driver.plan(now)
        drive.append((now, previous))
        ego = previous.trajectory.at((k + 1) * PERIOD)
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
        x, y = (
            ego.x + car.axle_to_center * np.cos(ego.yaw),
            ego.y + car.axle_to_center * np.sin(ego.yaw),
        )
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
    planner: Callable[[PlannerContext], Planner], made: Scenario, *, atol: float
) -> None:
    """In the mirrored world a planner plans the mirror image, at the start and later on the log's
    drive.
    """
    plans = []
    for world in (made, mirrored(made)):
        start = logged_ego(world.ego, world.vehicle, 0.0)
        planning = planner(PlannerContext(world.road, world.goal, world.vehicle, 0.1, start))
        for t in (0.0, 0.4 * world.ego.t[-1]):
            ego = logged_ego(world.ego, world.vehicle, float(t))
            plans.append(planning.plan(perceive(World(ego, world.tracks))).trajectory)
    for one, two in zip(plans[:2], plans[2:], strict=True):
        for field in fields(Trajectory):
            sign = -1.0 if field.name in ("y", "yaw", "kappa") else 1.0
            left, right = getattr(one, field.name), sign * getattr(two, field.name)
            np.testing.assert_allclose(left, right, atol=atol, err_msg=field.name)


def controlled(
    plan: Trajectory,
    controller: str,
    vehicle: str,
    seconds: float,
    start: EgoState | None = None,
    plant: VehicleParameters = CAR,
) -> tuple[list[Command], list[EgoState], FloatArray]:
    """Commands, states (one more) and errors (`Deviation`) of a plan followed at 100 Hz without
    replanning.
    """
    car = VEHICLE.builtin[vehicle](plant, start or plan.state(0))
    driver, one, path = (
        controller_of(car, CAR, Part(CONTROLLER, controller), 0.01),
        Plan(plan),
        PlanPath.of(plan),
    )
    commands, states, errors = [], [car.state], []
    for _ in range(round(seconds / 0.01)):
        errors.append(path.deviation(car.state))
        commands.append(driver.control(car.state, one))
        states.append(car.step(commands[-1], 0.01))
    return commands, states, np.array(errors)
