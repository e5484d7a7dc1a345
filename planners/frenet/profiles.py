"""Speed profiles along a path: the limit with its curves, driving at it, and braking; and the plan
when a stage fails.

(1) v(sigma) = min(limit, sqrt(a_lat / |kappa|)),
        lowered so that it can be reached with a comfortable deceleration b:
    v(sigma)^2 <= v(sigma + d)^2 + 2 b d
(2) cruising: the speed follows (1) with bounded acceleration and jerk, with no other road user in
    the way
(3) braking: jerk-limited to a deceleration, held, and released before standstill:  b^2 <= 2 jerk v

When a stage fails, the plan is

1. the rest of the previous plan, if it lasts `MIN_REST_S` without a collision
2. a stop along its path (or straight on where there is none) with comfortable limits, if that is
free of collisions
3. a stop with the hardest braking
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import sqrt
from typing import NamedTuple

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.kernel import kernel
from replan.core.settings import Config, Positive
from replan.logs.frame import Frame
from replan.logs.plan import Artefact, Plan, PlanStart, PlanStatus
from replan.logs.shapes import overlap
from replan.logs.states import EgoState, Trajectory
from replan.logs.vehicle import VehicleParameters
from replan.planners.frenet.path import Path, path_through, states_on_path

STEP_S = 0.1  # Time between two knots of a speed profile, and between two samples of a plan, s


class KnotLimits(NamedTuple):
    """`SpeedLimits` in the form that kernels take: m/s2, m/s3."""

    accel: float
    decel: float
    jerk: float


@dataclass(frozen=True)
class SpeedLimits(Config):
    """Acceleration and jerk that a profile may use."""

    accel_mps2: Positive
    """Greatest acceleration."""
    decel_mps2: Positive
    """Greatest deceleration, positive."""
    jerk_mps3: Positive
    """Greatest jerk, in both directions."""

    @cached_property
    def columns(self) -> KnotLimits:
        """The limits in the form that kernels take."""
        return KnotLimits(self.accel_mps2, self.decel_mps2, self.jerk_mps3)

    def braking(self, start: tuple[float, float], knots: int, *, share: float = 1.0) -> FloatArray:
        """Rows s, v, a `(3, knots)` of braking with a share of these limits."""
        return braking(
            start[0], start[1], share * self.decel_mps2, share * self.jerk_mps3, STEP_S, knots
        )


COMFORT = SpeedLimits(1.8, 3.0, 3.0)  # Limits of a comfortable profile
EMERGENCY = SpeedLimits(1.8, 7.5, 15.0)  # Limits of a profile that must brake harder
HORIZON_STEPS = 80  # Steps of a plan: 8 s
HORIZON_KNOTS = HORIZON_STEPS + 1  # Knots of a profile


@kernel
def limit_profile(
    sigma: FloatArray, kappa: FloatArray, limit: FloatArray, curve_accel: float, ease: float
) -> FloatArray:
    """The speed limit (1) along a path `(m,)`."""
    limits = np.empty(len(sigma))
    for i in range(len(sigma) - 1, -1, -1):
        limits[i] = min(limit[i], sqrt(curve_accel / max(abs(kappa[i]), 1e-9)))  # (1)
        if i < len(sigma) - 1:
            limits[i] = min(
                limits[i], sqrt(limits[i + 1] ** 2 + 2.0 * ease * (sigma[i + 1] - sigma[i]))
            )
    return limits


@kernel
def braking(v0: float, a0: float, decel: float, jerk: float, step: float, knots: int) -> FloatArray:
    """Rows s, v, a `(3, knots)` of braking to a stop: jerk-limited to `-decel`, then held, then
    standing.

    The stop itself is eased: the next deceleration b is not more than the jerk can release before
    standstill, b^2 <= 2 jerk v' with the speed v' = v + step (a - b) / 2 that it leaves.
    """
    profile = np.zeros((3, knots))
    s, v = 0.0, v0
    a, half = a0, 0.5 * jerk * step
    for i in range(knots):
        profile[0, i], profile[1, i], profile[2, i] = s, v, a
        # (3)
        wanted = -min(decel, sqrt(half * half + 2.0 * jerk * max(v + 0.5 * step * a, 0.0)) - half)
        a_next = max(wanted, a - jerk * step) if wanted < a else min(wanted, a + jerk * step)
        v_next = v + 0.5 * step * (a + a_next)
        if v_next <= 1e-6:
            s += min(v * v / max(-(a + a_next), 1e-6), v * step) if v > 0.0 else 0.0
            v, a = 0.0, 0.0
            continue
        s += step * v + step * step * (a / 3.0 + a_next / 6.0)
        v, a = v_next, a_next
    return profile


@kernel
def cruising(
    sigma: FloatArray,
    limit: FloatArray,
    v0: float,
    a0: float,
    accel: float,
    decel: float,
    jerk: float,
    step: float,
    knots: int,
) -> FloatArray:
    """Rows s, v `(2, knots)` of driving at the limit `(m,)` along the path, on a free road."""
    profile = np.zeros((2, knots))
    s, v = 0.0, v0
    a, i = a0, 0
    for k in range(knots):
        profile[0, k], profile[1, k] = s, v
        while i < len(sigma) - 2 and sigma[i + 1] < s:
            i += 1
        falling = min(0.0, v * (limit[i + 1] - limit[i]) / (sigma[i + 1] - sigma[i]))
        wanted = min(max(falling + (limit[i] - v) / 0.6, -decel), accel)  # (2)
        a += min(max(wanted - a, -jerk * step), jerk * step)
        v_next = max(0.0, v + a * step)
        s += 0.5 * step * (v + v_next)
        v = v_next
    return profile


MIN_REST_S = 3.0  # The ego drives the rest of the previous plan if it lasts at least this long, s


def trajectory_along(path: Path, profile: FloatArray, t: float) -> Trajectory:
    """The trajectory of a speed profile, rows s, v, a `(3, n)` every 0.1 s from time `t`, along a
    path.
    """
    pose = states_on_path(
        path.sigma, path.x, path.y, path.yaw, path.kappa, np.ascontiguousarray(profile[0])
    )
    times = t + STEP_S * np.arange(profile.shape[1])
    return Trajectory.of_rows(np.vstack([times, pose[:3], profile[1:], pose[3:]]))


class Stops(NamedTuple):
    """Limits of a comfortable and of the hardest stop, and the number of steps of `STEP_S` in the
    plan of a stop.
    """

    comfortable: SpeedLimits = COMFORT
    hardest: SpeedLimits = EMERGENCY
    knots: int = HORIZON_KNOTS


USUAL_STOPS = Stops()


def fall_back(
    frame: Frame,
    start: EgoState,
    start_kind: PlanStart,
    path: Path | None,
    reason: str,
    artefacts: Sequence[Artefact],
    vehicle: VehicleParameters,
    stops: Stops = USUAL_STOPS,
) -> Plan:
    """The fallback ladder of the module docstring; `path` is that of this frame, if there is
    one.
    """
    rest, old = None, frame.previous.trajectory if frame.previous is not None else None
    if old is not None and old.t[-1] - frame.t >= MIN_REST_S and old.t[0] <= frame.t:
        rest = old.resampled(np.r_[frame.t, old.t[old.t > frame.t + 1e-6]])
    if rest is not None and not meets(rest, frame, vehicle):
        return Plan(rest, PlanStatus.PREVIOUS, reason, PlanStart.PREVIOUS_PLAN, artefacts)
    stitched = rest is not None and start_kind is PlanStart.PREVIOUS_PLAN and rest.v[0] > 0.5
    if path is None and rest is not None and stitched:
        previous_path = path_through(rest.x, rest.y, rest.yaw, rest.kappa)
        path = previous_path if len(previous_path.sigma) > 1 else None
    if path is None:
        sigma, still = np.linspace(0.0, 200.0, 201), np.zeros(201)
        x, y = start.x + sigma * np.cos(start.yaw), start.y + sigma * np.sin(start.yaw)
        path = Path(sigma, x, y, still + start.yaw, still, sigma)
    status = PlanStatus.COMFORTABLE_STOP
    for limits in (stops.comfortable, stops.hardest):
        profile = braking(
            max(start.v, 0.0), start.a, limits.decel_mps2, limits.jerk_mps3, STEP_S, stops.knots
        )
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
    ego = np.array(
        [
            np.interp(t, trajectory.t, column)
            for column in (trajectory.x, trajectory.y, trajectory.yaw)
        ]
    )
    sizes = np.vstack([frame.agents.length[futures.agent], frame.agents.width[futures.agent]])
    car = np.array([vehicle.axle_to_center, vehicle.length, vehicle.width])
    return _meets(ego, futures.x, futures.y, futures.yaw, sizes, car)


@kernel
def _meets(
    ego: FloatArray,
    x: FloatArray,
    y: FloatArray,
    yaw: FloatArray,
    sizes: FloatArray,
    car: FloatArray,
) -> bool:
    for k in range(ego.shape[1]):
        cx, cy = ego[0, k] + car[0] * np.cos(ego[2, k]), ego[1, k] + car[0] * np.sin(ego[2, k])
        for i in range(len(x)):
            if overlap(
                cx,
                cy,
                ego[2, k],
                car[1],
                car[2],
                x[i, k],
                y[i, k],
                yaw[i, k],
                sizes[0, i],
                sizes[1, i],
            ):
                return True
    return False
