"""Small scenarios made by hand, and planners that do as they are told."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind
from replan.logs.frame import Frame, PlannerContext
from replan.logs.plan import Plan
from replan.logs.road import Goal, Road
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.tracks import Tracks
from replan.logs.vehicle import VehicleParameters

Curvature = Callable[[FloatArray], FloatArray]


def s_curve(s: FloatArray) -> FloatArray:
    """Straight, left and right arcs of 50 m radius, clothoids of 10 m between them."""
    return np.interp(
        s, [20.0, 30.0, 70.0, 90.0, 130.0, 140.0], np.array([0.0, 1.0, 1.0, -1.0, -1.0, 0.0]) / 50.0
    )


def straight(s: FloatArray) -> FloatArray:
    return np.zeros_like(s)


def drive(
    kappa: Curvature,
    v: Callable[[FloatArray], FloatArray] | float,
    duration: float,
    step: float = 0.1,
) -> Trajectory:
    """A drive from the origin along a curvature profile, integrated finely enough to be exact for
    tests.
    """
    fine = 200
    t = np.arange(round(duration / step) * fine + 1) * step / fine
    speed = np.full_like(t, v) if isinstance(v, float | int) else v(t)
    s = np.r_[0.0, np.cumsum(0.5 * np.diff(t) * (speed[1:] + speed[:-1]))]
    k = kappa(s)
    yaw = np.r_[0.0, np.cumsum(0.5 * np.diff(s) * (k[1:] + k[:-1]))]
    mean = 0.5 * (yaw[1:] + yaw[:-1])
    x = np.r_[0.0, np.cumsum(np.diff(s) * np.cos(mean))]
    y = np.r_[0.0, np.cumsum(np.diff(s) * np.sin(mean))]
    a = np.gradient(speed, t)
    return Trajectory(*(column[::fine] for column in (t, x, y, yaw, speed, a, k)))


def lanes_along(path: Trajectory, width: float = 3.5, beyond: float = 60.0) -> Road:
    """One lane of the log along a path."""
    road = Road.along(
        np.column_stack([path.x, path.y]), width=width, speed_limit=15.0, beyond=beyond
    )
    return Road(road.lanes, default_speed_limit=15.0)


def track(
    ident: str, t: Sequence[float], x: Sequence[float], y: Sequence[float], **more: object
) -> dict[str, object]:
    return {"id": ident, "t": t, "x": x, "y": y, **more}


def tracks(*agents: dict[str, object]) -> Tracks:
    """Tracks of `track(...)`; without `vx`, `vy` the log has no velocities."""
    if not agents:
        return Tracks.empty()
    columns = {name: [np.asarray(agent[name], float) for agent in agents] for name in "txy"}
    sizes = [len(t) for t in columns["t"]]

    def column(name: str, default: float) -> FloatArray:
        values = [np.asarray(agent.get(name, default), float) for agent in agents]
        return np.concatenate(
            [np.broadcast_to(value, (n,)) for value, n in zip(values, sizes, strict=True)]
        )

    return Tracks(
        ids=tuple(str(agent["id"]) for agent in agents),
        kinds=tuple(agent.get("kind", AgentKind.CAR) for agent in agents),
        length=np.array([agent.get("length", 4.5) for agent in agents]),
        width=np.array([agent.get("width", 1.8) for agent in agents]),
        static=np.array([agent.get("static", False) for agent in agents]),
        offsets=np.r_[0, np.cumsum(sizes)],
        t=np.concatenate(columns["t"]),
        x=np.concatenate(columns["x"]),
        y=np.concatenate(columns["y"]),
        yaw=column("yaw", 0.0),
        vx=column("vx", np.nan),
        vy=column("vy", np.nan),
    )


def scenario(
    ego: Trajectory,
    *,
    agents: Tracks | None = None,
    road: Road | None = None,
    goal: Goal | None = None,
    duration: float | None = None,
    vehicle: VehicleParameters | None = None,
) -> Scenario:
    return Scenario(
        name="handmade",
        ego=ego,
        tracks=agents if agents is not None else Tracks.empty(),
        road=road if road is not None else lanes_along(ego),
        duration=float(ego.t[-1]) if duration is None else duration,
        goal=goal,
        vehicle=vehicle or VehicleParameters(),
        metadata={"generator": "test"},
    )


def crossing_without_a_map(top: float = 11.4, walks: float = 1.4) -> Scenario:
    """A recorded driver slows down for a pedestrian, who crosses 60 m ahead, and goes on behind
    them; no lanes.

    From `top` m/s down to 2 m/s at a crossing, and up again; a box of the pedestrian every 0.1 s,
    with `walks` m/s.
    """
    t = np.arange(0.0, 20.05, 0.1)
    v = np.interp(t, [0.0, 1.0, 5.5, 11.0, 15.0], [top, top, 2.0, 2.0, top])
    x = np.r_[0.0, np.cumsum(0.05 * (v[1:] + v[:-1]))]
    zero = np.zeros(len(t))
    ego = Trajectory(t, x, zero, zero, v, np.gradient(v, t), zero)
    there = np.arange(0.0, 12.05, 0.1)
    walker = track(
        "17",
        list(there),
        [60.0] * len(there),
        list(walks * (there - 6.3)),
        kind=AgentKind.PEDESTRIAN,
        length=0.5,
        width=0.5,
        yaw=np.pi / 2.0,
        vx=0.0,
        vy=walks,
    )
    path = Road.along(np.column_stack([x, zero]), speed_limit=13.89)
    return replace(scenario(ego, agents=tracks(walker), road=path), tags=("recorded",))


def square(x: float, y: float, half: float) -> FloatArray:
    return np.array(
        [[x - half, y - half], [x + half, y - half], [x + half, y + half], [x - half, y + half]]
    )


class Told:
    """Plans the piece of a given drive from the frame's time on, at `step` s."""

    drive: Trajectory
    step = 0.1

    def __init__(self, context: PlannerContext) -> None:
        self.context = context

    def plan(self, frame: Frame) -> Plan:
        ahead = np.arange(frame.t, min(frame.t + 6.0, self.drive.t[-1]), self.step)
        return Plan(self.drive.resampled(ahead if len(ahead) else np.array([frame.t])))
