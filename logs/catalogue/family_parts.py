"""Common parts of the families: road users, their walks and sample times, and the scenario of a driven scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil, copysign

import numpy as np

from logs.agents import AgentKind
from logs.arrays import FloatArray
from logs.catalogue.driver import SAMPLE_S
from logs.catalogue.roads import LANE_WIDTH_M, CurveSamples, curve, stretch
from logs.plan import DecisionKind
from logs.road import Goal, Road
from logs.scenario import Scenario
from logs.states import Trajectory
from logs.tracks import Tracks

CAR = (4.5, 1.8)
ADULT = (0.5, 0.6)
BICYCLE = (1.8, 0.6)
SMALL_CAR, LARGE_CAR = (4.316, 1.79), (4.418, 1.82)
"""Length and width of the cars of CPNCO, m."""
START_M = 10.0
SPARE_S = 10.0
"""Time that a planner may take longer than the logged driver, s."""
BEYOND_M = 150.0
HALF_LANE = 0.5 * LANE_WIDTH_M
SIDEWALK_M = 4.0
WAITS = (DecisionKind.YIELD, DecisionKind.STOP)
BESIDE_M, APART_M = 1.0, 1.0
"""CPNCO: from the ego's side to the cars'; from the small car's front to the child's line, and between the cars, m."""


@dataclass(frozen=True, eq=False)
class Agent:
    """One road user: size (length, width) m and samples `(n, 6)` of t, x, y, yaw, vx, vy at its box centre."""

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
    return (
        parked("small_car", small_front - 0.5 * SMALL_CAR[0], side - 0.5 * SMALL_CAR[1], size=SMALL_CAR),
        parked("large_car", large_front - 0.5 * LARGE_CAR[0], side - 0.5 * LARGE_CAR[1], size=LARGE_CAR),
    )


def moving(
    name: str, kind: AgentKind, size: tuple[float, float], t: FloatArray, x: FloatArray, y: FloatArray, *, yaw: float
) -> Agent:
    """A road user at positions `(n,)` at times `(n,)`, uniformly spaced.

    Velocities are backward differences: a sample does not depend on later positions. The heading is that of the
    velocity; it is `yaw` while the road user stands at the begin.
    """
    vx, vy = (np.r_[way[0], way] for way in (np.diff(x) / np.diff(t), np.diff(y) / np.diff(t)))
    heading, last = np.empty(len(t)), yaw
    for i in range(len(t)):
        last = float(np.arctan2(vy[i], vx[i])) if np.hypot(vx[i], vy[i]) > 0.05 else last
        heading[i] = last
    return Agent(name, kind, size, np.column_stack([t, x, y, np.unwrap(heading), vx, vy]))


def tracks(agents: Sequence[Agent]) -> Tracks:
    """The road users as Tracks."""
    if not agents:
        return Tracks.empty()
    ids, kinds = tuple(agent.id for agent in agents), tuple(agent.kind for agent in agents)
    length, width = np.array([agent.size for agent in agents]).T
    static = np.array([agent.static for agent in agents])
    offsets = np.cumsum([0, *(len(agent.samples) for agent in agents)])
    return Tracks(ids, kinds, length, width, static, offsets, *np.vstack([agent.samples for agent in agents]).T)


def grid(duration: float) -> FloatArray:
    """Sample times of the road users `(n,)`, to the end of the scenario, s."""
    return np.round(np.arange(0.0, duration + SPARE_S + 0.5 * SAMPLE_S, SAMPLE_S), 9)


def tenths(seconds: float) -> float:
    """The next multiple of the sample time, s."""
    return round(ceil(seconds / SAMPLE_S - 1e-9) * SAMPLE_S, 9)


def bypass(edge: float, clearance: float, width: float) -> float:
    """Lateral offset of a car's middle that keeps |clearance| from an obstacle's edge, m: left of it if positive."""
    return edge + copysign(abs(clearance) + 0.5 * width, clearance)


def walked(t: FloatArray, distance: float, speed: float, ramp: float = 0.4) -> FloatArray:
    """Share of a walk of `distance` m done at times `(n,)` after its start: speed ramps up and down in `ramp` s."""
    whole = distance / speed + ramp
    if whole < 2.0 * ramp:
        raise ValueError("the pedestrian's way is too short for its speed")
    up = np.clip(t, 0.0, ramp)
    down = np.clip(t - (whole - ramp), 0.0, ramp)
    even = np.clip(t - ramp, 0.0, whole - 2.0 * ramp)
    share: FloatArray = (0.5 * up**2 / ramp + even + down - 0.5 * down**2 / ramp) * speed / distance
    return share


def pedestrian_across(p: Mapping[str, float], x: float) -> tuple[Agent, float]:
    """A pedestrian who crosses the lane at `x` from the right, and the first sample at which they have left it, s."""
    y0, y1 = -(HALF_LANE + p["kerb_distance_m"]), HALF_LANE + p["rest_distance_m"]
    t = grid(p["duration_s"])
    y = y0 + (y1 - y0) * walked(t - p["walk_start_s"], y1 - y0, p["pedestrian_speed_mps"])
    agent = moving("pedestrian", AgentKind.PEDESTRIAN, ADULT, t, np.full(len(t), x), y, yaw=0.5 * np.pi)
    return agent, float(t[np.argmax(y > HALF_LANE + 0.5 * max(ADULT))])


def straight_path(speed: float, duration: float) -> CurveSamples:
    """A straight path along x that is long enough for a drive of `duration` s at `speed` m/s."""
    return curve((speed * (duration + SPARE_S) + BEYOND_M, 0.0, 0.0))


def finished(
    path: CurveSamples, driven: Trajectory, agents: Sequence[Agent], road: Road, duration: float, *,
    begin: float | None = None, edges: tuple[float, float] = (-HALF_LANE, HALF_LANE),
    metadata: Mapping[str, str] | None = None,
) -> Scenario:  # fmt: skip
    """The scenario of a drive, without a name.

    Args:
        path: Path on which the goal lies.
        driven: States of the logged driver.
        agents: The other road users.
        road: Road of the scene.
        duration: Duration of the drive, s; a planner has `SPARE_S` more.
        begin: Station at which the goal begins, m; None: 10 m before the x at which the drive ends.
        edges: Right and left edge of the goal, m to the left of the path.
        metadata: The accepted decisions, and further entries.
    """
    first = float(driven.x[-1]) - 10.0 if begin is None else begin
    goal = Goal((stretch(path, first, first + 40.0, right=edges[0], left=edges[1]),))
    return Scenario("", driven, tracks(agents), road, duration + SPARE_S, goal, metadata=dict(metadata or {}))
