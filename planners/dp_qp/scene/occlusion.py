"""A speed from which the ego can stop for who may step out of ground that it cannot see.

Beside each point of the path the nearest hidden ground is looked for: in the shadow of agents that do not drive, but
not where an agent is. Who walks out of it with speed w needs (d - r) / w to the ego's side, d from the side to the
hidden point, r the radius of a person. The ego with its front x before them passes first, or it stops:

(1) x / v <= (d - r) / w                       (2) v T + v^2 / (2 b) <= x              T: reaction, b: deceleration

There is an x at which it can do neither where the greatest x of (1) is less than the least of (2), so that

(3) v <= 2 b ((d - r) / w - T)

keeps the ego safe wherever they step out. It holds for the front at that point; before it, the road's speed limit is
lowered so that (3) is reached comfortably (`profiles.limit_profile`). At `LEAST_MPS` the ego creeps past in any case.
Beyond the sensor's range nothing is seen: there (2) alone limits the speed, with x its range.

w is `CautionConfig.walk_mps`: UN R157 asks that pedestrians of up to 5 km/h are avoided. The ground is judged as it is
seen now: on coming nearer more is seen, and the limit rises.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, pi, sqrt

import numpy as np

from logs.frame import Visibility
from logs.kernel import BoolArray, FloatArray, kernel
from logs.scenario import Agents
from logs.vehicle import VehicleParameters
from planners.dp_qp.scene.caps import PathView, SpeedCap
from planners.frenet.path import Path

PERSON_M = 0.3
"""r, m."""
REACTION_S = 0.5
"""T, s, until the brake bites: a frame, the sensor's latency, the brake's dead time and lag."""
LEAST_MPS = 2.5
"""The ego creeps past with this in any case, m/s."""
LOOK_M = 60.0
"""So far ahead hidden ground is looked for, m ..."""
STEP_M = 1.0
"""... in steps of this, m."""
SIDE_M = 0.25 * np.arange(1, 15)
"""Distances from the ego's side at which ground is looked at, m; beyond the last it does not limit a car's speed."""


@dataclass(frozen=True, slots=True)
class Hidden:
    """Hidden ground beside the path: `s` m along it, `d` m from the ego's side, and the speed (3)."""

    s: float
    d: float
    v: float


def caps(view: PathView) -> tuple[SpeedCap, ...]:
    """(3) beside the hidden ground, up to the first who is in the way and sees beyond; and the sensor's range."""
    seen, scene = view.scene.frame.visibility, view.scene
    if seen is None:
        return ()
    until, front = view.taken.first + scene.vehicle.axle_to_front, scene.vehicle.axle_to_front
    hidden = hidden_beside(
        view.path, seen, scene.frame.agents, scene.vehicle, min(until, LOOK_M), view.hard_mps2, view.caution.walk_mps
    )
    ground = [
        SpeedCap(
            one.s - front - STEP_M,
            one.s - front,
            one.v,
            "hidden ground",
            f"who steps out of the hidden ground {one.s - front:.0f} m ahead, {one.d:.1f} m beside, "
            f"could be avoided at {one.v:.1f} m/s",
        )
        for one in hidden
    ]
    return (SpeedCap(-inf, inf, stopping_speed(seen.range, view.hard_mps2)), *ground)


def avoidable_speed(d: float, w: float, decel: float) -> float:
    """(3): the speed at which the ego passes first or stops for who comes with `w` m/s from `d` m aside, m/s."""
    return max(2.0 * decel * (d / w - REACTION_S), LEAST_MPS)  # (3)


def stopping_speed(x: float, decel: float) -> float:
    """The speed of which (2) needs just `x` m, m/s."""
    return decel * (sqrt(REACTION_S**2 + 2.0 * x / decel) - REACTION_S) if x < inf else inf  # (2)


def hidden_beside(
    path: Path, view: Visibility, agents: Agents, vehicle: VehicleParameters, until: float, decel: float,
    walk: float,
) -> list[Hidden]:  # fmt: skip
    """The nearest hidden ground on either side of the path, at most one per point, from the front to `until` m."""
    shadows = view.shadows[~_cast_by_movers(view.shadows, agents, walk)]
    if not len(shadows):
        return []
    ahead = np.arange(vehicle.axle_to_front, until, STEP_M)
    at = np.searchsorted(path.sigma, ahead[ahead < path.length])
    side = 0.5 * vehicle.width + np.r_[SIDE_M, SIDE_M]
    side[len(SIDE_M) :] *= -1.0
    x = path.x[at, None] - side * np.sin(path.yaw[at, None])
    y = path.y[at, None] + side * np.cos(path.yaw[at, None])
    points = np.column_stack([x.ravel(), y.ravel()])
    everywhere = replace(view, range=inf, field_of_view=2.0 * pi, shadows=shadows)
    boxes = np.column_stack([agents.x, agents.y, agents.yaw, 0.5 * agents.length, 0.5 * agents.width])
    hides = (everywhere.hides(points) & ~_occupied(points, boxes)).reshape(x.shape)
    found = []
    for i, row in enumerate(hides):
        if row.any():
            d = float(np.abs(side[row]).min() - 0.5 * vehicle.width)
            v = avoidable_speed(d - PERSON_M, walk, decel)
            found.append(Hidden(float(path.sigma[at[i]]), d, v))
    return found


def _cast_by_movers(shadows: FloatArray, agents: Agents, walk: float) -> BoolArray:
    """Which shadows `(n, 4, 2)` are cast by agents faster than `walk`, m/s: pedestrians do not come out behind them."""
    if not len(agents):
        return np.zeros(len(shadows), np.bool_)
    near = 0.5 * (shadows[:, 0] + shadows[:, 3])
    away = np.hypot(near[:, :1] - agents.x, near[:, 1:] - agents.y)
    caster = np.argmin(away, axis=1)
    return np.asarray((agents.speed[caster] > walk) & (away.min(axis=1) < agents.length[caster]))


@kernel
def _occupied(points: FloatArray, boxes: FloatArray) -> BoolArray:
    """Which of the points `(k, 2)` lie in a box `(n, 5)`: x, y, yaw, half length, half width."""
    out = np.zeros(len(points), np.bool_)
    for i in range(len(boxes)):
        c, s = np.cos(boxes[i, 2]), np.sin(boxes[i, 2])
        for k in range(len(points)):
            dx, dy = points[k, 0] - boxes[i, 0], points[k, 1] - boxes[i, 1]
            inside = abs(c * dx + s * dy) <= boxes[i, 3] and abs(c * dy - s * dx) <= boxes[i, 4]
            out[k] = out[k] or inside
    return out
