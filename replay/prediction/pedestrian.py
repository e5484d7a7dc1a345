"""Pedestrians go on, stop, or turn back: several hypotheses each.

Which and how probable depends on what the pedestrian does and where (`SHARES`): walks on a lane, walks towards one
that it reaches within `LOOK_S`, walks elsewhere, stands on a lane, stands elsewhere; slowing is an acceleration below
`SLOWING_MPS2` (backward difference). The shares are cautious assumptions, not fitted to data: most pedestrians on the
road go on; one who comes to the kerb and slows mostly waits there; one who has just stopped may start again.

The hypotheses, with the speed v at the frame (walking: from `WALKING_MPS` on), the direction of the velocity (of the
heading, of one who stands), and time tau from the frame:

    goes on       at v; one who stands starts after `REACTION_S` at `START_MPS`
    stops         brakes with `BRAKE_MPS2`; one who comes to a lane stops `KERB_M` before it, if that is not sooner
    turns back    stops as above, waits `PAUSE_S`, walks back at v, at least at `START_MPS`

(1) walked(tau) = v tau until tau_b = D / v - v / (2 b), then braking with b to a stop at the distance D
"""

from __future__ import annotations

from enum import Enum

import numpy as np

from logs.frame import Predictions
from logs.kernel import FloatArray
from logs.scenario import AgentKind, Agents
from replay.prediction.lane_map import LaneMap, road_ahead

WALKING_MPS = 0.3
SLOWING_MPS2 = -0.4
LOOK_S = 4.0
KERB_M = 0.3
BRAKE_MPS2 = 1.5
REACTION_S, START_MPS, PAUSE_S = 0.5, 1.2, 0.5


class Place(Enum):
    """What a pedestrian does, and where."""

    CROSSING = "walks on a lane"
    COMING = "walks towards a lane"
    AWAY = "walks elsewhere"
    STANDING_ON_ROAD = "stands on a lane"
    STANDING = "stands elsewhere"


SHARES: dict[tuple[Place, bool], tuple[float, float, float]] = {
    (Place.CROSSING, False): (0.85, 0.15, 0.0),
    (Place.CROSSING, True): (0.45, 0.40, 0.15),
    (Place.COMING, False): (0.65, 0.35, 0.0),
    (Place.COMING, True): (0.30, 0.70, 0.0),
    (Place.AWAY, False): (1.0, 0.0, 0.0),
    (Place.AWAY, True): (0.8, 0.2, 0.0),
    (Place.STANDING_ON_ROAD, False): (0.15, 0.70, 0.15),
    (Place.STANDING_ON_ROAD, True): (0.15, 0.70, 0.15),
    (Place.STANDING, False): (0.0, 1.0, 0.0),
    (Place.STANDING, True): (0.2, 0.8, 0.0),
}
"""Probability of going on, stopping (standing on) and turning back, by what it does where, and whether it slows."""


def walkers(agents: Agents, t: FloatArray, lanes: LaneMap) -> Predictions:
    """The hypotheses of the pedestrians among `agents`, and of no other agents (module docstring)."""
    ahead = t - t[0]
    agent, probability, way = [], [], []
    for i, kind in enumerate(agents.kinds):
        if kind is not AgentKind.PEDESTRIAN:
            continue
        shares, walked = _futures(agents, i, ahead, lanes)
        toward, _ = _direction(agents, i)
        for share, (distance, turned) in zip(shares, walked, strict=True):
            if share > 0.0:
                agent.append(i)
                probability.append(share)
                yaw = agents.yaw[i] + np.pi * turned
                way.append((agents.x[i] + distance * toward[0], agents.y[i] + distance * toward[1], yaw))
    x, y, yaw = np.array(way).reshape(-1, 3, len(t)).transpose(1, 0, 2)
    return Predictions(t, np.array(agent, np.int64), np.array(probability), x, y, yaw, "pedestrian")


def _direction(agents: Agents, i: int) -> tuple[tuple[float, float], float]:
    """Unit vector in which a pedestrian walks, or would, and its speed, m/s."""
    vx, vy = float(agents.vx[i]), float(agents.vy[i])
    speed = float(np.hypot(vx, vy))
    if speed < WALKING_MPS:
        return (float(np.cos(agents.yaw[i])), float(np.sin(agents.yaw[i]))), speed
    return (vx / speed, vy / speed), speed


def _futures(
    agents: Agents, i: int, ahead: FloatArray, lanes: LaneMap
) -> tuple[tuple[float, float, float], tuple[tuple[FloatArray, FloatArray], ...]]:
    """The shares of a pedestrian's hypotheses, and of each the distance walked and whether it has turned `(k,)`."""
    toward, speed = _direction(agents, i)
    road = road_ahead(lanes.arrays, float(agents.x[i]), float(agents.y[i]), *toward, max(speed * LOOK_S, 0.0))
    slowing = bool(agents.accel[i] < SLOWING_MPS2)
    still = np.zeros(len(ahead))
    if speed < WALKING_MPS:
        started = START_MPS * np.maximum(ahead - REACTION_S, 0.0)
        place = Place.STANDING_ON_ROAD if road == 0.0 else Place.STANDING
        return SHARES[place, slowing], ((started, still), (still, still), (-started, (started > 0.0).astype(float)))
    place = Place.CROSSING if road == 0.0 else Place.COMING if np.isfinite(road) else Place.AWAY
    stop = 0.5 * speed**2 / BRAKE_MPS2
    halted = walked(ahead, speed, max(stop, road - KERB_M) if place is Place.COMING else stop)
    back = max(speed, START_MPS) * np.maximum(ahead - speed / BRAKE_MPS2 - PAUSE_S, 0.0)
    return SHARES[place, slowing], (
        (speed * ahead, still),
        (halted, still),
        (walked(ahead, speed, stop) - back, (back > 0.0).astype(float)),
    )


def walked(ahead: FloatArray, speed: float, distance: float) -> FloatArray:
    """Distance walked at `speed` (m/s) with a stop after `distance` (m) (1)."""
    begins = distance / speed - 0.5 * speed / BRAKE_MPS2
    braking = np.clip(ahead - begins, 0.0, speed / BRAKE_MPS2)
    return np.asarray(speed * np.minimum(ahead, begins) + speed * braking - 0.5 * BRAKE_MPS2 * braking**2)
