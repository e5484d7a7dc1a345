"""Hand-made drives and scenarios for the tests of metrics: small builders, no numbers of their
own.
"""

from collections.abc import Callable, Sequence

import handmade
import numpy as np

from replan.logs.agents import AgentKind
from replan.logs.edit import transform
from replan.logs.plan import Plan
from replan.logs.road import Lane, Road
from replan.logs.scenario import Scenario
from replan.logs.states import Controls, Trajectory
from replan.logs.trace import EndReason, Mode, PlannedFrame, Trace
from replan.logs.tracks import Tracks
from replan.logs.vehicle import VehicleParameters

Agent = tuple[
    str,
    AgentKind,
    Sequence[float],
    Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]],
]
"""Id, kind, (length, width), motion: t -> x, y, yaw."""
CAR = (4.5, 1.8)
EGO = VehicleParameters()
NOSE = EGO.axle_to_front


def grid(seconds: float, step: float = 0.01) -> np.ndarray:
    return np.arange(round(seconds / step) + 1) * step


def along(
    t: np.ndarray, v: np.ndarray | float, *, x: float = 0.0, a: np.ndarray | float = 0.0
) -> Trajectory:
    """Straight on along x with speed v(t)."""
    v = np.broadcast_to(np.asarray(v, float), t.shape)
    zero = np.zeros(len(t))
    s = np.r_[0.0, np.cumsum(0.5 * np.diff(t) * (v[1:] + v[:-1]))]
    return Trajectory(t, x + s, zero, zero, v, np.broadcast_to(np.asarray(a, float), t.shape), zero)


def changing(
    t: np.ndarray, v: np.ndarray | float, begin: float, lasts: float = 2.0, to: float = 3.5
) -> Trajectory:
    """Along x with speed v(t), over to the offset `to` from `begin` on."""
    v = np.broadcast_to(np.asarray(v, float), t.shape)
    u = np.clip((t - begin) / lasts, 0.0, 1.0)
    x, y = np.r_[0.0, np.cumsum(0.5 * np.diff(t) * (v[1:] + v[:-1]))], to * u * u * (3.0 - 2.0 * u)
    yaw = np.arctan2(np.gradient(y, t), np.maximum(np.gradient(x, t), 0.1))
    return Trajectory(t, x, y, yaw, v, np.gradient(v, t), np.zeros(len(t)))


def moving(x: float, y: float, vx: float, vy: float, yaw: float | None = None) -> Callable:
    heading = np.arctan2(vy, vx) if yaw is None else yaw
    return lambda t: (x + vx * t, y + vy * t, np.full(len(t), heading))


def tracks(agents: Sequence[Agent], t: np.ndarray) -> Tracks:
    """All agents sampled at the times t; velocities left to differences."""
    made = []
    for name, kind, (length, width), motion in agents:
        x, y, yaw = motion(t)
        made.append(handmade.track(name, t, x, y, yaw=yaw, kind=kind, length=length, width=width))
    return handmade.tracks(*made)


def straight_road(
    *, half: float = 1.75, lanes: int = 1, limit: float = float("nan"), right: bool = True
) -> Road:
    """Lanes along x from -100 m to 500 m, the first centred on y = 0, the others to its left."""
    x = np.array([-100.0, 500.0])
    strips = [
        Lane(
            i,
            np.column_stack([x, np.full(2, (2 * i + 1) * half)]),
            np.column_stack([x, np.full(2, (2 * i - 1) * half)]),
            left_neighbour=i + 1 if i + 1 < lanes else None,
            right_neighbour=i - 1 if i else None,
            speed_limit=limit,
        )
        for i in range(lanes)
    ]
    return Road({lane.id: lane for lane in strips}, drives_on_right=right)


def scenario(ego: Trajectory, agents: Sequence[Agent] = (), **changes: object) -> Scenario:
    made = {
        "road": straight_road(),
        "duration": float(ego.t[-1]),
        "metadata": {"generator": "test"},
    }
    fields = made | changes
    return Scenario("test/log", ego, tracks(agents, ego.t), **fields)  # type: ignore[arg-type]


def car(
    x: float, y: float, vx: float, vy: float = 0.0, kind: AgentKind = AgentKind.CAR, **pose: float
) -> Agent:
    """Agent "7"; a pedestrian has the size of one."""
    return (
        "7",
        kind,
        CAR if kind is not AgentKind.PEDESTRIAN else (0.6, 0.6),
        moving(x, y, vx, vy, **pose),
    )


def world(v: float, *agents: Agent, seconds: float = 4.0, **changes: object) -> Scenario:
    """The ego drives along x at v m/s."""
    return scenario(along(grid(seconds), v), agents, **changes)


def drive(
    log: Scenario, ego: Trajectory | None = None, *, mode: Mode = Mode.CLOSED, **changes: object
) -> Trace:
    """A trace in which the ego drives as given (None: as logged) and the others as logged."""
    fields = {"frames": (), "end": EndReason.END_OF_LOG} | changes
    return Trace(log.name, "hand", mode, False, ego or log.ego, log.tracks, **fields)  # type: ignore[arg-type]


def plans(
    log: Trajectory, times: np.ndarray, horizon: float, bend: Callable | None = None
) -> tuple[PlannedFrame, ...]:
    """At each time, the log's next `horizon` seconds as the plan, bent by `bend(trajectory)`."""
    frames = []
    for t in times:
        plan = log.between(float(t) - 1e-9, float(t) + horizon + 1e-9)
        frames.append(PlannedFrame(float(t), Plan(bend(plan) if bend else plan)))
    return tuple(frames)


def controls(
    t: np.ndarray, throttle: np.ndarray, brake: np.ndarray, steer: np.ndarray | None = None
) -> Controls:
    return Controls(t, np.zeros(len(t)) if steer is None else steer, throttle, brake)


def moved(world: Scenario, turn: float, dx: float, dy: float, *, mirror: bool = False) -> Scenario:
    """The whole scene mirrored at the x axis (driving side too), then turned about the origin, then
    shifted.
    """
    return transform.moved(transform.mirrored(world) if mirror else world, dx, dy, turn)


def moved_ego(
    ego: Trajectory, turn: float, dx: float, dy: float, *, mirror: bool = False
) -> Trajectory:
    return transform.moved_trajectory(
        transform.mirrored_trajectory(ego) if mirror else ego, dx, dy, turn
    )
