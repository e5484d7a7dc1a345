"""The plan when a stage fails: the previous plan, else a comfortable stop, else a hard stop.

1. the rest of the previous plan, if it lasts `MIN_REST_S` without a collision
2. a stop along its path (or straight on where there is none) with comfortable limits, if that is free of collisions
3. a stop with the hardest braking
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from logs.arrays import FloatArray
from logs.frame import Frame
from logs.kernel import kernel
from logs.plan import Artefact, Plan, PlanStart, PlanStatus
from logs.shapes import overlap
from logs.states import EgoState, Trajectory
from logs.vehicle import VehicleParameters
from planners.frenet.path import Path, path_through, states_on_path
from planners.frenet.profiles import COMFORT, EMERGENCY, HORIZON_KNOTS, STEP_S, SpeedLimits, braking

MIN_REST_S = 3.0  # The ego drives the rest of the previous plan if it lasts at least this long, s


def trajectory_along(path: Path, profile: FloatArray, t: float) -> Trajectory:
    """The trajectory of a speed profile, rows s, v, a `(3, n)` every 0.1 s from time `t`, along a path."""
    rows = _trajectory_rows(path.sigma, path.x, path.y, path.yaw, path.kappa, np.ascontiguousarray(profile), t)
    return Trajectory.of_rows(rows)


@kernel
def _trajectory_rows(
    sigma: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray, kappa: FloatArray, profile: FloatArray, t: float
) -> FloatArray:
    """`trajectory_along` as rows t, x, y, yaw, v, a, kappa `(7, n)`."""
    out = np.empty((7, profile.shape[1]))
    where = states_on_path(sigma, x, y, yaw, kappa, profile[0])
    out[1:4], out[6] = where[:3], where[3]
    out[4:6] = profile[1:]
    for k in range(out.shape[1]):
        out[0, k] = t + STEP_S * k
    return out


class Stops(NamedTuple):
    """Limits of a comfortable and of the hardest stop, and the number of steps of `STEP_S` in the plan of a stop."""

    comfortable: SpeedLimits = COMFORT
    hardest: SpeedLimits = EMERGENCY
    knots: int = HORIZON_KNOTS


USUAL_STOPS = Stops()


def fall_back(
    frame: Frame, start: EgoState, start_kind: PlanStart, path: Path | None, reason: str,
    artefacts: Sequence[Artefact], vehicle: VehicleParameters, stops: Stops = USUAL_STOPS,
) -> Plan:  # fmt: skip
    """The fallback ladder of the module docstring; `path` is that of this frame, if there is one."""
    rest, old = None, frame.previous.trajectory if frame.previous is not None else None
    if old is not None and old.t[-1] - frame.t >= MIN_REST_S and old.t[0] <= frame.t:
        rest = old.resampled(np.r_[frame.t, old.t[old.t > frame.t + 1e-6]])
    if rest is not None and not meets(rest, frame, vehicle):
        return Plan(rest, PlanStatus.PREVIOUS, reason, PlanStart.PREVIOUS_PLAN, artefacts)
    stitched = rest is not None and start_kind is PlanStart.PREVIOUS_PLAN and rest.v[0] > 0.5
    if path is None and rest is not None and stitched:
        kept = path_through(rest.x, rest.y, rest.yaw, rest.kappa)
        path = kept if len(kept.sigma) > 1 else None
    if path is None:
        sigma, still = np.linspace(0.0, 200.0, 201), np.zeros(201)
        x, y = start.x + sigma * np.cos(start.yaw), start.y + sigma * np.sin(start.yaw)
        path = Path(sigma, x, y, still + start.yaw, still, sigma)
    status = PlanStatus.COMFORTABLE_STOP
    for limits in (stops.comfortable, stops.hardest):
        profile = braking(max(start.v, 0.0), start.a, limits.decel_mps2, limits.jerk_mps3, STEP_S, stops.knots)
        stop = trajectory_along(path, profile, frame.t)
        if limits is stops.hardest or not meets(stop, frame, vehicle):
            break
        status = PlanStatus.HARD_STOP
    return Plan(stop, status, reason, start_kind, artefacts)


def meets(trajectory: Trajectory, frame: Frame, vehicle: VehicleParameters) -> bool:
    """Whether the ego on this trajectory would touch a predicted agent."""
    futures = frame.predictions
    if not len(futures):
        return False
    t = futures.t[(futures.t >= trajectory.t[0]) & (futures.t <= trajectory.t[-1])]
    ego = np.array([np.interp(t, trajectory.t, column) for column in (trajectory.x, trajectory.y, trajectory.yaw)])
    sizes = np.vstack([frame.agents.length[futures.agent], frame.agents.width[futures.agent]])
    car = np.array([vehicle.axle_to_center, vehicle.length, vehicle.width])
    return _meets(ego, futures.x, futures.y, futures.yaw, sizes, car)


@kernel
def _meets(ego: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray, sizes: FloatArray, car: FloatArray) -> bool:
    for k in range(ego.shape[1]):
        cx, cy = ego[0, k] + car[0] * np.cos(ego[2, k]), ego[1, k] + car[0] * np.sin(ego[2, k])
        for i in range(len(x)):
            if overlap(cx, cy, ego[2, k], car[1], car[2], x[i, k], y[i, k], yaw[i, k], sizes[0, i], sizes[1, i]):
                return True
    return False
