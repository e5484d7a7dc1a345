"""Parts that the families share: the careful driver, road users and their walks, the scenario of a
drive.

The driver of the ego logs is simple, smooth, and none of the planners. Its acceleration is the
least of these at each step, with bounded acceleration and jerk, so that log and poses agree:

(1) cruise    a = 0.8 (v_cruise - v)
(2) follow    a = 0.15 (gap - thw v) + 0.7 (v_lead - v)          gap bumper to bumper
(3) stop      a = -v^2 / (2 distance)
        constant braking to the stopping point

(4) |a| is eased out in time: a standstill or the cruising speed is reached with a = 0,
        since braking is at most sqrt(2 jerk v) and accelerating at most sqrt(2 jerk (v_cruise -
        v)), with 0.7 of the bound on jerk. A stopping point is met within 1 m.

The path is given; the rear axle drives on it, so that yaw rate = v kappa.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import ceil, copysign, sqrt

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind
from replan.logs.catalogue.roads import LANE_WIDTH_M, CurveSamples, curve, stretch, two_lanes
from replan.logs.plan import DecisionKind
from replan.logs.road import Goal, Road
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.tracks import Tracks

STEP_S = 0.02
START_M = 10.0
SAMPLE_S = 0.1
MAX_ACCEL, MAX_BRAKE, MAX_JERK = 1.5, 3.0, 2.0
_EASE = 0.7 * MAX_JERK


@dataclass(frozen=True, slots=True)
class Ahead:
    """The object that the driver reacts to: `gap` from the front bumper, m, its `speed`, whether to
    `stop` for it.
    """

    gap: float
    speed: float = 0.0
    stop: bool = False


Reaction = Callable[[float, float], Ahead | None]
"""Returns the object that a driver reacts to at time t, s, with the rear axle at station s, m; None
without one.
"""


def waiting(line: float, short: float, begin: float, end: float, front: float) -> Reaction:
    """The reaction of a driver who waits `short` m before station `line`, m, from time `begin` to
    `end`, s.

    `front` is the distance from the rear axle to the front bumper, m; a driver who is past the line
    does not wait.
    """

    def ahead(t: float, s: float) -> Ahead | None:
        gap = line - short - (s + front)
        return Ahead(gap, stop=True) if begin <= t < end and gap > -short else None

    return ahead


def drive(
    path: CurveSamples,
    *,
    speed: float,
    duration: float,
    cruise: float | Callable[[float], float] | None = None,
    ahead: Reaction = lambda t, s: None,
    start: float = START_M,
    thw: float = 1.6,
) -> Trajectory:
    """The ego log, sampled at 10 Hz.

    Args:
        path: Path of the rear axle.
        speed: Speed at t = 0, m/s.
        duration: Duration, s; a multiple of 0.1.
        cruise: Wanted speed, m/s; or a function of the rear axle's station. None: `speed`.
        ahead: Returns the object that the driver reacts to.
        start: Station of the rear axle at t = 0, m.
        thw: Wanted time headway, s.

    Raises:
        ValueError: The path is too short.
    """
    cruise = speed if cruise is None else cruise
    t, s, rows = 0.0, start, []
    v, a = speed, 0.0
    every = round(SAMPLE_S / STEP_S)
    for k in range(round(duration / STEP_S) + 1):
        if k % every == 0:
            rows.append((k * STEP_S, s, v, a))
        cruise_mps, obstacle = cruise(s) if callable(cruise) else cruise, ahead(t, s)
        wish = 0.8 * (cruise_mps - v)  # (1)
        if obstacle is not None and obstacle.stop:
            wish = min(wish, -v * v / (2.0 * max(obstacle.gap, 0.1)))  # (3)
        elif obstacle is not None:
            wish = min(wish, 0.15 * (obstacle.gap - thw * v) + 0.7 * (obstacle.speed - v))  # (2)
        low = max(-MAX_BRAKE, -sqrt(2.0 * _EASE * max(v, 0.0)))  # (4)
        high = min(MAX_ACCEL, sqrt(2.0 * _EASE * max(cruise_mps - v, 0.0)))
        jerk = min(max((min(max(wish, low), high) - a) / STEP_S, -MAX_JERK), MAX_JERK)
        s += (v + (0.5 * a + jerk * STEP_S / 6.0) * STEP_S) * STEP_S
        v += (a + 0.5 * jerk * STEP_S) * STEP_S
        a += jerk * STEP_S
        if v <= 0.0:
            v, a = 0.0, max(a, 0.0)
        t = (k + 1) * STEP_S
    times, stations, speeds, accelerations = np.array(rows).T
    if stations[-1] > path.length:
        raise ValueError(
            f"the drive of {stations[-1] - start:.0f} m leaves its path of {path.length:.0f} m"
        )
    x, y, yaw, kappa = path.at(stations)
    return Trajectory(np.round(times, 9), x, y, yaw, speeds, accelerations, kappa)


# Road users

CAR = (4.5, 1.8)
ADULT = (0.5, 0.6)
BICYCLE = (1.8, 0.6)
SMALL_CAR, LARGE_CAR = (4.316, 1.79), (4.418, 1.82)
"""Length and width of the cars of CPNCO, m."""
SPARE_S = 10.0
"""Time that a planner may take longer than the logged driver, s."""
BEYOND_M = 150.0
HALF_LANE = 0.5 * LANE_WIDTH_M
SIDEWALK_M = 4.0
WAITS = (DecisionKind.YIELD, DecisionKind.STOP)
BESIDE_M, APART_M = 1.0, 1.0
"""CPNCO: from the ego's side to the cars'.

From the small car's front to the child's line, and between the cars, m.
"""


@dataclass(frozen=True, eq=False)
class Agent:
    """One road user: size (length, width) m and samples `(n, 6)` of t, x, y, yaw, vx, vy at its box
    centre.
    """

    id: str
    kind: AgentKind
    size: tuple[float, float]
    samples: FloatArray
    static: bool = False


def parked(name: str, x: float, y: float, *, size: tuple[float, float] = CAR) -> Agent:
    """A car that stands along the x axis, its centre at (x, y)."""
    return Agent(name, AgentKind.CAR, size, np.array([[0.0, x, y, 0.0, 0.0, 0.0]]), static=True)


def obstruction(x: float, side: float) -> tuple[Agent, Agent]:
    """The two parked cars of CPNCO before the line x, their left sides at y = `side`, m."""
    small_front = x - APART_M
    large_front = small_front - SMALL_CAR[0] - APART_M
    small, large = (
        parked(name, front - 0.5 * length, side - 0.5 * width, size=(length, width))
        for name, front, (length, width) in (
            ("small_car", small_front, SMALL_CAR),
            ("large_car", large_front, LARGE_CAR),
        )
    )
    return small, large


def moving(
    name: str,
    kind: AgentKind,
    size: tuple[float, float],
    t: FloatArray,
    x: FloatArray | float,
    y: FloatArray | float,
    *,
    yaw: float,
) -> Agent:
    """A road user at positions `(n,)` (a number: it does not change) at times `(n,)`, uniformly
    spaced.

    Velocities are backward differences: a sample does not depend on later positions. The heading is
    that of the velocity; it is `yaw` while the road user stands at the begin.
    """
    x, y = np.broadcast_to(x, t.shape), np.broadcast_to(y, t.shape)
    vx, vy = (np.r_[rate[:1], rate] for rate in (np.diff(x) / np.diff(t), np.diff(y) / np.diff(t)))
    heading, last = np.empty(len(t)), yaw
    for i in range(len(t)):
        last = float(np.arctan2(vy[i], vx[i])) if np.hypot(vx[i], vy[i]) > 0.05 else last
        heading[i] = last
    return Agent(name, kind, size, np.column_stack([t, x, y, np.unwrap(heading), vx, vy]))


def tracks(agents: Sequence[Agent]) -> Tracks:
    """The road users as Tracks."""
    if not agents:
        return Tracks.empty()
    length, width = np.array([agent.size for agent in agents]).T
    return Tracks(
        tuple(agent.id for agent in agents),
        tuple(agent.kind for agent in agents),
        length,
        width,
        np.array([agent.static for agent in agents]),
        np.cumsum([0, *(len(agent.samples) for agent in agents)]),
        *np.vstack([agent.samples for agent in agents]).T,
    )


def grid(duration: float) -> FloatArray:
    """Sample times of the road users `(n,)`, to the end of the scenario, s."""
    return np.round(np.arange(0.0, duration + SPARE_S + 0.5 * SAMPLE_S, SAMPLE_S), 9)


def tenths(seconds: float) -> float:
    """The next multiple of the sample time, s."""
    return round(ceil(seconds / SAMPLE_S - 1e-9) * SAMPLE_S, 9)


def bypass(edge: float, clearance: float, width: float) -> float:
    """Lateral offset of a car's middle that keeps |clearance| from an obstacle's edge, m: left of
    it if positive.
    """
    return edge + copysign(abs(clearance) + 0.5 * width, clearance)


def walked(t: FloatArray, distance: float, speed: float, ramp: float = 0.4) -> FloatArray:
    """Share of a walk of `distance` m done at times `(n,)` after its start: speed ramps up and down
    in `ramp` s.
    """
    whole = distance / speed + ramp
    if whole < 2.0 * ramp:
        raise ValueError("the pedestrian's way is too short for its speed")
    up = np.clip(t, 0.0, ramp)
    down = np.clip(t - (whole - ramp), 0.0, ramp)
    even = np.clip(t - ramp, 0.0, whole - 2.0 * ramp)
    share: FloatArray = (0.5 * up**2 / ramp + even + down - 0.5 * down**2 / ramp) * speed / distance
    return share


def pedestrian_across(p: Mapping[str, float], x: float) -> tuple[Agent, float]:
    """A pedestrian who crosses the lane at `x` from the right, and the first sample at which they
    have left it, s.
    """
    y0, y1 = -(HALF_LANE + p["kerb_distance_m"]), HALF_LANE + p["rest_distance_m"]
    t = grid(p["duration_s"])
    y = y0 + (y1 - y0) * walked(t - p["walk_start_s"], y1 - y0, p["pedestrian_speed_mps"])
    agent = moving("pedestrian", AgentKind.PEDESTRIAN, ADULT, t, x, y, yaw=0.5 * np.pi)
    return agent, float(t[np.argmax(y > HALF_LANE + 0.5 * max(ADULT))])


def straight_path(speed: float, duration: float) -> CurveSamples:
    """A straight path along x that is long enough for a drive of `duration` s at `speed` m/s."""
    return curve((speed * (duration + SPARE_S) + BEYOND_M, 0.0, 0.0))


def past_parked_cars(
    path: CurveSamples,
    cars: Sequence[Agent],
    speed: float,
    duration: float,
    metadata: Mapping[str, str],
) -> Scenario:
    """The scenario of a drive at a constant speed past parked cars, on the right of two lanes."""
    driven = drive(path, speed=speed, duration=duration)
    straight = curve((path.length, 0.0, 0.0))
    road = two_lanes(straight, speed, ego_on_right=True)
    return finished(
        straight,
        driven,
        cars,
        road,
        duration,
        edges=(-HALF_LANE, 3.0 * HALF_LANE),
        metadata=metadata,
    )


def finished(
    path: CurveSamples,
    driven: Trajectory,
    agents: Sequence[Agent],
    road: Road,
    duration: float,
    *,
    begin: float | None = None,
    edges: tuple[float, float] = (-HALF_LANE, HALF_LANE),
    metadata: Mapping[str, str] | None = None,
) -> Scenario:
    """The scenario of a drive, without a name; a planner has `SPARE_S` more than the drive's
    `duration`, s.

    The goal lies on the `path`, from station `begin` (None: 10 m before the x at which the drive
    ends) and between the right and left `edges`, m to the left of the path. `metadata` has the
    accepted decisions, and further entries.
    """
    first = float(driven.x[-1]) - 10.0 if begin is None else begin
    goal = Goal((stretch(path, first, first + 40.0, right=edges[0], left=edges[1]),))
    return Scenario(
        "", driven, tracks(agents), road, duration + SPARE_S, goal, metadata=dict(metadata or {})
    )
