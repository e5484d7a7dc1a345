"""Small scenes for the tests of planners: others that move by a formula, frames, paths."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from roads import lanes

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind, Agents
from replan.logs.frame import Frame, Visibility
from replan.logs.plan import Plan
from replan.logs.road import Road
from replan.logs.route import find_route
from replan.logs.states import EgoState
from replan.logs.vehicle import VehicleParameters
from replan.planners.frenet.path import Path
from replan.planners.frenet.reference_path import ReferencePath, make_reference_path
from replan.planners.frenet.scene import Scene, scene_of
from replan.replay.loop_config import DEFAULT_LOOP, LoopConfig
from replan.replay.perception import GroundTruth
from replan.replay.prediction import predict
from replan.replay.world import World

CAR = VehicleParameters()
START = EgoState(0.0, 0.0, 0.0, 0.0, 8.0)


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
