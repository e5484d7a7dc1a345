"""The ego and the others in the Frenet frame of the reference line, on the plan's time grid."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin, tan

import numpy as np

from logs.kernel import BoolArray, FloatArray, IntArray, kernel
from logs.road import line_frame, line_project
from logs.scenario import AgentKind
from logs.shapes import overlap
from logs.states import EgoState, wrap
from logs.vehicle import VehicleParameters
from planners.frenet.profiles import HORIZON_KNOTS, HORIZON_STEPS, STEP_S
from planners.frenet.scene import Scene, behind
from planners.lattice.config import LatticeConfig

STRIDE = 4
"""Samples of the plan per sample of the others' Frenet coordinates."""
NEAR_M = 30.0
"""Who stays farther than this from what the ego can reach is not in the scene."""


@dataclass(frozen=True, eq=False, slots=True)
class Ego:
    """The start in the Frenet frame.

    Attributes:
        s: Station, m.
        lateral: l, l', l''.
        speed: s_dot, m/s.
        accel: s_ddot, m/s2.
    """

    s: float
    lateral: tuple[float, float, float]
    speed: float
    accel: float


@dataclass(frozen=True, eq=False, slots=True)
class Futures:
    """The n predictions near the ego, on the plan's grid of `HORIZON_KNOTS` times.

    Attributes:
        agent: `(n,)` index into the frame's agents.
        pose: x, y, yaw `(3, n, HORIZON_KNOTS)`; beyond the predictions' horizon everybody stays.
        frenet: `futures_frenet` of every `STRIDE`-th time `(4, n, m)`.
        speed: Along the line at first `(n,)`, m/s.
        sizes: Length, width, margin `(3, n)`, m.
        behind: `(2, n)` those that the ego need not look at: keeping its track, and changing it.
    """

    agent: IntArray
    pose: FloatArray
    frenet: FloatArray
    speed: FloatArray
    sizes: FloatArray
    behind: BoolArray


def ego_frenet(scene: Scene) -> Ego:
    """The start in the Frenet frame: `polynomials.states` read backwards.

    Near standstill a deceleration that would soon be a reverse is not taken over.
    """
    line, start, s0, l0, lateral = scene.reference.line, scene.start, scene.s, scene.l, scene.frenet
    _, _, yaw_r, kappa_r = line.frame(s0)
    R, turn = 1.0 - kappa_r * l0, wrap(start.yaw - yaw_r)
    speed = max(start.v, 0.0) * cos(turn) / R
    dkappa_r = 2.0 * (line.frame(s0 + 0.25)[3] - line.frame(s0 - 0.25)[3])
    turning = R * tan(turn) * (start.kappa * R / cos(turn) - kappa_r) - (dkappa_r * l0 + kappa_r * lateral[1])
    accel = (start.a - speed**2 / cos(turn) * turning) * cos(turn) / R
    return Ego(s0, lateral, speed, max(accel, -6.0 * speed))


def futures_of(scene: Scene, ego: Ego, config: LatticeConfig) -> Futures:
    """The others of a scene as they are predicted."""
    frame, start, line = scene.frame, scene.start, scene.reference.line
    agents, futures = frame.agents, frame.predictions
    used = _near(scene, ego)
    agent = futures.agent[used]
    pose = _on_grid(futures.t - frame.t, np.stack([futures.x[used], futures.y[used], futures.yaw[used]]))
    sizes = np.vstack([agents.length[agent], agents.width[agent], np.zeros(len(agent))])
    for j, i in enumerate(agent):
        sizes[2, j] = _margin(start, agents.kinds[i], pose[:, j, 0], sizes[:, j], scene.vehicle, config)
    thin = [np.ascontiguousarray(rows[:, ::STRIDE]) for rows in pose]
    frenet = futures_frenet(line.s, line.coef, thin[0], thin[1], thin[2], sizes, ego.s)
    speed = (frenet[0, :, 1] - frenet[0, :, 0]) / (STRIDE * STEP_S)
    follow = [behind(scene, keeps_track=keeps) for keeps in (True, False)]
    return Futures(agent, pose, frenet, speed, sizes, np.array([rows[agent] for rows in follow]))


def _near(scene: Scene, ego: Ego) -> IntArray:
    """The predictions that come near the reference line as far as the ego can get."""
    line, futures, start = scene.reference.line, scene.frame.predictions, scene.start
    if not len(futures):
        return np.empty(0, np.int64)
    reach = HORIZON_STEPS * STEP_S * (ego.speed + 3.0) + NEAR_M
    way = np.vstack([line.xy[(line.s > ego.s - NEAR_M) & (line.s < ego.s + reach)], [[start.x, start.y]]])
    low, high = way.min(axis=0) - NEAR_M, way.max(axis=0) + NEAR_M
    near = (futures.x.max(axis=1) > low[0]) & (futures.x.min(axis=1) < high[0])
    near &= (futures.y.max(axis=1) > low[1]) & (futures.y.min(axis=1) < high[1])
    return np.flatnonzero(near)


def _on_grid(t: FloatArray, rows: FloatArray) -> FloatArray:
    """Rows `(3, n, k)` at times `t` `(k,)` from the frame, at `HORIZON_KNOTS` times every `STEP_S`; the ends hold."""
    at = np.clip(STEP_S * np.arange(HORIZON_KNOTS), t[0], t[-1])
    first = np.clip(np.searchsorted(t, at + 1e-9) - 1, 0, max(len(t) - 2, 0))
    after = np.minimum(first + 1, len(t) - 1)
    span = np.where(after > first, t[after] - t[first], 1.0)
    u = (at - t[first]) / span
    return np.ascontiguousarray(rows[:, :, first] + u * (rows[:, :, after] - rows[:, :, first]))


def _margin(
    start: EgoState, kind: AgentKind, pose: FloatArray, size: FloatArray, car: VehicleParameters, config: LatticeConfig
) -> float:
    """What is kept to an agent, m; nothing to one that is nearer already."""
    margin = config.vulnerable_margin_m if kind.is_vulnerable else config.margin_m
    x, y = start.x + car.axle_to_center * cos(start.yaw), start.y + car.axle_to_center * sin(start.yaw)
    length, width = car.length + 2.0 * margin, car.width + 2.0 * margin
    return 0.0 if overlap(x, y, start.yaw, length, width, pose[0], pose[1], pose[2], size[0], size[1]) else margin


@kernel
def futures_frenet(
    knots: FloatArray, coef: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray, sizes: FloatArray, s_ego: float
) -> FloatArray:
    """Predictions `(n, k)` in the Frenet frame: s, l, half length along s, half width along l `(4, n, k)`."""
    out = np.empty((4, x.shape[0], x.shape[1]))
    for i in range(len(x)):
        guess, window = s_ego, 150.0
        for k in range(x.shape[1]):
            s, l = line_project(knots, coef, x[i, k], y[i, k], guess, window)  # noqa: E741
            guess, window = s, 25.0
            turn = yaw[i, k] - line_frame(knots, coef, s)[2]
            c, d = abs(cos(turn)), abs(sin(turn))
            out[0, i, k], out[1, i, k] = s, l
            out[2, i, k] = 0.5 * (sizes[0, i] * c + sizes[1, i] * d)
            out[3, i, k] = 0.5 * (sizes[0, i] * d + sizes[1, i] * c)
    return out
