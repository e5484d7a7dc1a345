"""Futures of road users that follow no lane: straight, along a circle; several hypotheses for each
pedestrian.

(1) constant velocity: p(t + tau) = p(t) + v(t) tau with constant heading
(2) constant turn rate and velocity: the velocity vector turns with the yaw rate w,
        so the motion in tau is a chord of
    length |v| tau sin(h) / h in the direction of v turned by h = w tau / 2;
        the heading turns by w tau

Pedestrians go on, stop, or turn back. The hypotheses and their probabilities depend on what the
pedestrian does and where (`SHARES`): walk on a lane, walk towards a lane that they reach within
`LOOK_S`, walk elsewhere, stand on a lane, stand elsewhere. A pedestrian slows if its acceleration
is below `SLOWING_MPS2` (backward difference). The shares are cautious assumptions, not fitted to
data: most pedestrians on the road go on; those who slow down at the kerb mostly wait there; those
who have just stopped may start again.

The hypotheses, with the speed v at the frame (walking: from `WALKING_MPS` on), the direction of the
velocity (or of the heading, if standing), and the time tau since the frame:

    goes on       at v; standing pedestrians start after `REACTION_S` at `START_MPS`
    stops         brakes with `BRAKE_MPS2`; on the way to a lane, stops `KERB_M` before it, if
                  braking allows
    turns back    stops as above, waits `PAUSE_S`, walks back at v, at least at `START_MPS`

(3) walked(tau) = v tau until tau_b = D / v - v / (2 b),
        then braking with b to a stop at the distance D
"""

from __future__ import annotations

from enum import Enum
from math import cos, pi, sin

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.kernel import inner_kernel
from replan.logs.agents import AgentKind, Agents, among
from replan.logs.frame import Predictions
from replan.replay.prediction.lane_map import LaneMap, road_ahead

COLUMNS = X, Y, YAW, VX, VY, RATE, WIDTH, ACCEL, COURSE = range(9)
"""Columns of road users in kernels: pose, velocity, yaw rate, width, acceleration, direction of the
velocity.
"""
SLOWEST_MPS = 1.0
"""Below this speed, changes of the heading are mostly noise: the turn rate is taken as zero."""
MAX_LATERAL_MPS2 = 5.0
"""Turn rates that need more than this lateral acceleration are noise, and are limited to it."""
MAX_KAPPA = 0.2
"""Greatest curvature of a vehicle's path, 1/m."""
ON_FOOT = among(AgentKind.PEDESTRIAN, AgentKind.OBJECT)
"""Whether a kind (by code) turns on the spot or not at all: its yaw rate does not predict its
path.
"""

WALKING_MPS = 0.3
SLOWING_MPS2 = -0.4
LOOK_S = 4.0
KERB_M = 0.3
BRAKE_MPS2 = 1.5
REACTION_S, START_MPS, PAUSE_S = 0.5, 1.2, 0.5


def constant_velocity(agents: Agents, t: FloatArray) -> Predictions:
    """Predict straight motion with the velocity vector (1): one hypothesis of probability 1 per
    agent.
    """
    ahead = t - t[0]
    n = len(agents)
    return Predictions(
        t=t,
        agent=np.arange(n),
        probability=np.ones(n),
        x=agents.x[:, None] + agents.vx[:, None] * ahead,
        y=agents.y[:, None] + agents.vy[:, None] * ahead,
        yaw=np.broadcast_to(agents.yaw[:, None], (n, len(t))),
        method="constant_velocity",
    )


@inner_kernel
def turn_rate(code: int, speed: float, yaw_rate: float) -> float:
    """Return the yaw rate to continue, rad/s: that of moving vehicles and bicycles, limited to what
    they can turn.
    """
    most = min(MAX_LATERAL_MPS2 / max(speed, SLOWEST_MPS), MAX_KAPPA * speed)
    return 0.0 if ON_FOOT[code] or speed < SLOWEST_MPS else min(max(yaw_rate, -most), most)


@inner_kernel
def turned(agent: FloatArray, ahead: FloatArray, poses: FloatArray) -> None:
    """Predict motion along a circle (2): rows x, y, yaw `(3, k)` in `poses` of a road user
    (`COLUMNS`).

    `ahead` `(k,)`: times from now, s.
    """
    speed = np.hypot(agent[VX], agent[VY])
    for k in range(len(ahead)):
        half = 0.5 * agent[RATE] * ahead[k]
        bent = pi * (half / pi)
        chord = speed * ahead[k] * (sin(bent) / bent if bent != 0.0 else 1.0)
        toward = agent[COURSE] + half
        poses[0, k] = agent[X] + chord * cos(toward)
        poses[1, k] = agent[Y] + chord * sin(toward)
        poses[2, k] = agent[YAW] + 2.0 * half


class PedestrianPlace(Enum):
    """What a pedestrian does, and where."""

    CROSSING = "walks on a lane"
    COMING = "walks towards a lane"
    AWAY = "walks elsewhere"
    STANDING_ON_ROAD = "stands on a lane"
    STANDING = "stands elsewhere"


SHARES: dict[tuple[PedestrianPlace, bool], tuple[float, float, float]] = {
    (PedestrianPlace.CROSSING, False): (0.85, 0.15, 0.0),
    (PedestrianPlace.CROSSING, True): (0.45, 0.40, 0.15),
    (PedestrianPlace.COMING, False): (0.65, 0.35, 0.0),
    (PedestrianPlace.COMING, True): (0.30, 0.70, 0.0),
    (PedestrianPlace.AWAY, False): (1.0, 0.0, 0.0),
    (PedestrianPlace.AWAY, True): (0.8, 0.2, 0.0),
    (PedestrianPlace.STANDING_ON_ROAD, False): (0.15, 0.70, 0.15),
    (PedestrianPlace.STANDING_ON_ROAD, True): (0.15, 0.70, 0.15),
    (PedestrianPlace.STANDING, False): (0.0, 1.0, 0.0),
    (PedestrianPlace.STANDING, True): (0.2, 0.8, 0.0),
}
"""Probabilities of going on, stopping (or staying) and turning back, by place and whether the
pedestrian slows.
"""


def walkers(agents: Agents, t: FloatArray, lanes: LaneMap) -> Predictions:
    """Predict only the pedestrians among `agents`, with their hypotheses (module docstring)."""
    ahead, still = t - t[0], np.zeros(len(t))
    agent, probability, poses = [], [], []
    # For each hypothesis: the distance walked, whether it has turned
    walks: tuple[tuple[FloatArray, FloatArray], ...]
    for i, kind in enumerate(agents.kinds):
        if kind is not AgentKind.PEDESTRIAN:
            continue
        vx, vy = float(agents.vx[i]), float(agents.vy[i])
        speed = float(np.hypot(vx, vy))
        toward = float(np.cos(agents.yaw[i])), float(np.sin(agents.yaw[i]))
        if speed >= WALKING_MPS:
            toward = vx / speed, vy / speed
        road = road_ahead(
            lanes.arrays, float(agents.x[i]), float(agents.y[i]), *toward, max(speed * LOOK_S, 0.0)
        )
        if speed < WALKING_MPS:
            started = START_MPS * np.maximum(ahead - REACTION_S, 0.0)
            place = PedestrianPlace.STANDING_ON_ROAD if road == 0.0 else PedestrianPlace.STANDING
            walks = (started, still), (still, still), (-started, (started > 0.0).astype(float))
        else:
            stop = 0.5 * speed**2 / BRAKE_MPS2
            place, halt = PedestrianPlace.AWAY, stop
            if road == 0.0:
                place = PedestrianPlace.CROSSING
            elif np.isfinite(road):
                place, halt = PedestrianPlace.COMING, max(stop, road - KERB_M)
            halted = walked(ahead, speed, halt)
            back = max(speed, START_MPS) * np.maximum(ahead - speed / BRAKE_MPS2 - PAUSE_S, 0.0)
            there_and_back = walked(ahead, speed, stop) - back, (back > 0.0).astype(float)
            walks = (speed * ahead, still), (halted, still), there_and_back
        shares = SHARES[place, bool(agents.accel[i] < SLOWING_MPS2)]
        for share, (distance, turned) in zip(shares, walks, strict=True):
            if share > 0.0:
                agent.append(i)
                probability.append(share)
                x, y = agents.x[i] + distance * toward[0], agents.y[i] + distance * toward[1]
                poses.append((x, y, agents.yaw[i] + np.pi * turned))
    x, y, yaw = np.array(poses).reshape(-1, 3, len(t)).transpose(1, 0, 2)
    return Predictions(t, np.array(agent, np.int64), np.array(probability), x, y, yaw, "pedestrian")


def walked(ahead: FloatArray, speed: float, distance: float) -> FloatArray:
    """Return the distance walked (3) at `speed` (m/s) with a stop after `distance` (m)."""
    begins = distance / speed - 0.5 * speed / BRAKE_MPS2
    braking = np.clip(ahead - begins, 0.0, speed / BRAKE_MPS2)
    return np.asarray(
        speed * np.minimum(ahead, begins) + speed * braking - 0.5 * BRAKE_MPS2 * braking**2
    )
