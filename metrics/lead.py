"""The path ahead of the ego, and the lead in it.

All metrics use this definition of the lead, in closed loop. The path leads from the rear axle along
the circle of the ego's curvature at that step, for at most `LOOK_M` and a quarter of a turn; s in m
along it, l in m to its left. It needs neither lanes nor later steps of the drive. For a point at
(x, y) ahead and to the left of the rear axle:

(1) s = atan2(kappa x, 1 - kappa y) / kappa,  x where kappa = 0
    l = (2 y - kappa (x^2 + y^2)) / (1 + hypot(1 - kappa y, kappa x))

Band: |l| <= half of the ego's width, the area that its box sweeps. Lead: of all agents whose boxes
reach into the band, the one whose part in it begins nearest ahead of the middle of the ego's box.
Agents that approach the ego at more than `COMING_MPS` are no leads (TTC and RSS cover them);
crossing agents are leads while in the band. An ego in reverse has no lead. Each edge of a box is
divided into `PIECES` pieces: exact to 0.1 m for a truck on the tightest curve.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, hypot, pi, sin

import numpy as np

from replan.core.arrays import FloatArray, IntArray
from replan.core.kernel import inner_kernel, kernel
from replan.core.once import once
from replan.logs.scenario import Scenario
from replan.logs.shapes import corners
from replan.logs.trace import Trace
from replan.metrics.boxes import STANDING_MPS, EgoOutline, OtherBoxes, car_of, grid_of, nearest

LOOK_M = 150.0
COMING_MPS = 0.5
PIECES = 4


@dataclass(frozen=True, eq=False, slots=True)
class EgoAndLead:
    """The ego and its lead over k steps; NaN without a lead."""

    t: FloatArray  # s since the scenario's start
    v: FloatArray  # The ego's speed, m/s; `a` its acceleration, m/s2
    a: FloatArray
    agent: IntArray  # Index of the lead's track, -1: none
    # Along the path from the ego's front bumper to the lead's nearest part in the band, m; 0 where
    # they touch
    gap: FloatArray
    u: FloatArray  # The lead's speed along the path, m/s; `w` across it, positive to the left
    w: FloatArray
    decel: FloatArray  # The lead's deceleration along the path, m/s2; 0 if it does not brake
    low: FloatArray  # The lead's rightmost l, m; `high` its leftmost
    high: FloatArray
    facing: FloatArray  # Cosine of the angle between the lead's heading and the path


@once
def ahead_of(trace: Trace, scenario: Scenario) -> EgoAndLead:
    """Return the lead at each step of `grid_of(trace)`."""
    ego, car = grid_of(trace), car_of(scenario)
    states = np.stack([ego.x, ego.y, ego.yaw, ego.v, ego.kappa])
    rows, agent = nearest(
        trace.agents, ego.t, lambda k, seen, others: _leads(states[:, k], car, others)
    )
    return EgoAndLead(ego.t, ego.v, ego.a, agent, *rows)


@inner_kernel
def arc_point(kappa: float, x: float, y: float) -> tuple[float, float]:
    """Return s and l (1) of a point in the frame of the rear axle."""
    side, up = 1.0 - kappa * y, kappa * x
    s = atan2(up, side) / kappa if kappa != 0.0 else x
    return s, (2.0 * y - kappa * (x * x + y * y)) / (1.0 + hypot(side, up))


@inner_kernel
def _least_s_within(s0: float, l0: float, s1: float, l1: float, half: float) -> float:
    """Return the least s of the part of a segment within |l| <= half; inf if no part is."""
    if max(l0, l1) < -half or min(l0, l1) > half:
        return np.inf
    least = np.inf
    if abs(l0) <= half:
        least = s0
    if abs(l1) <= half:
        least = min(least, s1)
    if l0 != l1:
        for edge in (-half, half):
            u = (edge - l0) / (l1 - l0)
            if 0.0 <= u <= 1.0:
                least = min(least, s0 + u * (s1 - s0))
    return least


@inner_kernel
def extent(
    x: float, y: float, yaw: float, kappa: float, half: float, outline: FloatArray
) -> tuple[float, float, float, float, float]:
    """Return for a box with corners `outline` `(4, 2)`: least s in the band (inf: none), ranges of
    s and l (1).
    """
    c, s = cos(yaw), sin(yaw)
    near = np.inf
    s_low, s_high = np.inf, -np.inf
    l_low, l_high = np.inf, -np.inf
    before = np.zeros(2)
    for i in range(4 * PIECES + 1):
        corner, u = (i // PIECES) % 4, (i % PIECES) / PIECES
        dx = (1.0 - u) * outline[corner, 0] + u * outline[(corner + 1) % 4, 0] - x
        dy = (1.0 - u) * outline[corner, 1] + u * outline[(corner + 1) % 4, 1] - y
        along, left = arc_point(kappa, c * dx + s * dy, c * dy - s * dx)
        s_low, s_high = min(s_low, along), max(s_high, along)
        l_low, l_high = min(l_low, left), max(l_high, left)
        if i > 0 and abs(kappa * (along - before[0])) < pi:
            near = min(near, _least_s_within(before[0], before[1], along, left, half))
        before[0], before[1] = along, left
    return near, s_low, s_high, l_low, l_high


@inner_kernel
def within_look(
    x: float, y: float, yaw: float, kappa: float, other_x: float, other_y: float, reach: float
) -> bool:
    """Return whether a box of half diagonal `reach` may lie along the path: near, and not past the
    circle's centre.
    """
    dx, dy = other_x - x, other_y - y
    return hypot(dx, dy) <= LOOK_M + reach and kappa * (dy * cos(yaw) - dx * sin(yaw)) < 1.0


@kernel
def _leads(ego: FloatArray, car: EgoOutline, others: OtherBoxes) -> tuple[FloatArray, IntArray]:
    """Return rows gap to facing of `EgoAndLead` `(7, k)`, agent `(k,)`; `ego`: x, y, yaw, v, kappa
    of the rear axle.
    """
    pose, size, steps = others.pose, others.size, others.there.shape[1]
    half, front = 0.5 * car.width, car.axle + 0.5 * car.length
    rows, agent = np.full((7, steps), np.nan), np.full(steps, -1, np.int64)
    for k in range(steps):
        x, y, yaw = ego[0, k], ego[1, k], ego[2, k]
        kappa, best = ego[4, k], np.inf
        if ego[3, k] < -STANDING_MPS:
            continue
        for i in range(len(size)):
            reach = 0.5 * hypot(size[i, 0], size[i, 1])
            if not others.there[i, k] or not within_look(
                x, y, yaw, kappa, pose[0, i, k], pose[1, i, k], reach
            ):
                continue
            dx, dy = pose[0, i, k] - x, pose[1, i, k] - y
            ahead, left = dx * cos(yaw) + dy * sin(yaw), dy * cos(yaw) - dx * sin(yaw)
            if abs(arc_point(kappa, ahead, left)[1]) > half + reach:
                continue
            outline = corners(pose[0, i, k], pose[1, i, k], pose[2, i, k], size[i, 0], size[i, 1])
            near, _, _, low, high = extent(x, y, yaw, kappa, half, outline)
            if not car.axle < near < min(best, front + LOOK_M) or abs(kappa * near) > 0.5 * pi:
                continue
            path, vx, vy = yaw + kappa * near, pose[3, i, k], pose[4, i, k]
            u, w, speed = (
                vx * cos(path) + vy * sin(path),
                vy * cos(path) - vx * sin(path),
                hypot(vx, vy),
            )
            if u < -COMING_MPS:
                continue
            best, agent[k] = near, i
            rows[0, k], rows[1, k], rows[2, k] = max(near - front, 0.0), u, w
            accel = others.accel[i, k] if np.isfinite(others.accel[i, k]) else 0.0
            rows[3, k] = max(-accel * u / speed, 0.0) if speed > STANDING_MPS else 0.0
            rows[4, k], rows[5, k], rows[6, k] = low, high, cos(pose[2, i, k] - path)
    return rows, agent
