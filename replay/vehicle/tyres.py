"""Tyres: the lateral force of an axle over slip and load, its reduction by braking and driving, and
tyre use.

With slip angle alpha (positive where the wheel moves to its left), axle load F, static load F0,
cornering stiffness C0 at F0, peak friction mu, load sensitivity q:

(1) grip = 1 - q (F / F0 - 1)                       not below MIN_GRIP
(2) C = C0 F / F0 grip,   D = mu F grip             stiffness and peak, both by the load
(3) linear    Fy = -C alpha                         without friction limit: for analysis
(4) fiala     Fy = -C z + C^2 / (3 D) |z| z - C^3 / (27 D^2) z^3
        z = tan(alpha), |z| < 3 D / C; else -D sign(z)
(5) pacejka   Fy = -D sin(S atan(B alpha - E (B alpha - atan(B alpha))))
        B = C / (S D), shape S, curvature E
(6) |Fx| <= share D
        anti-lock brakes and traction control hold the rest; less at the rear (REAR_SHARE,
        FRONT_SHARE), so that the front slides first
(7) Fy <- Fy sqrt(1 - (Fx / D)^2)                   friction circle; (6)-(7) not for the linear tyre

How the tyres are used, from the motion of a drive at the control rate:

(8)  a_rear  = course - yaw
         of the rear axle, where the ego's reference point is; rad
(9)  a_front = atan(tan a_rear + L r / v) - steer      r = v kappa, L the wheelbase; rad
(10) use     = sqrt(a^2 + (v^2 kappa)^2) / (mu g)
         1: the tyres can give no more (friction circle)

The course is that of the positions (central differences: a simulated drive has no noise). Below
`SLOWEST_MPS` slip angles are meaningless: NaN.

Sources: (4) Fiala 1954 as in Pacejka, Tire and Vehicle Dynamics, 3.2.2, a brush tyre with parabolic
pressure; (5) Pacejka, ibid. 4.3.1, pure lateral slip without camber, by which an axle's two wheels
are one; (8)-(9) Rajamani, Vehicle Dynamics and Control, 2.3.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan, sin, sqrt
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta

from replan.core.arrays import FloatArray
from replan.core.errors import ConfigError, unknown_name
from replan.core.kernel import kernel
from replan.logs.states import Controls, Trajectory
from replan.logs.vehicle import VehicleParameters

TyreStiffness = Annotated[float, Meta(gt=0.0, description="Factor on the cornering stiffness.")]

GRAVITY = 9.81
LINEAR, FIALA, PACEJKA = 0, 1, 2
TYRES: dict[str, int] = {"linear": LINEAR, "fiala": FIALA, "pacejka": PACEJKA}
MIN_GRIP = 0.2
FRONT_SHARE, REAR_SHARE = 0.95, 0.8
SLOWEST_MPS = 2.0


class Tyre(NamedTuple):
    """The tyres of one axle, as the kernels take them.

    Attributes:
        kind: Value of TYRES.
        cornering: C0, N/rad.
        load: F0, N.
        friction: mu.
        sensitivity: q.
        shape: S.
        curvature: E.
        share: Of (6).
    """

    kind: int
    cornering: float
    load: float
    friction: float
    sensitivity: float
    shape: float
    curvature: float
    share: float


@kernel
def grip_and_peak(load: float, tyre: Tyre) -> tuple[float, float]:
    """C (N/rad) and D (N) at a load, N; both 0 where the axle is off the ground."""
    ratio = max(load, 0.0) / tyre.load
    grip = max(1.0 - tyre.sensitivity * (ratio - 1.0), MIN_GRIP)  # (1)
    return tyre.cornering * ratio * grip, tyre.friction * tyre.load * ratio * grip  # (2)


@kernel
def lateral_force(slip: float, load: float, tyre: Tyre) -> float:
    """Fy of pure lateral slip, N, positive to the left; `slip` is tan(alpha)."""
    stiffness, peak = grip_and_peak(load, tyre)
    if tyre.kind == LINEAR:
        return -stiffness * atan(slip)  # (3)
    if peak <= 0.0:
        return 0.0
    if tyre.kind == FIALA:
        part = stiffness * abs(slip) / (3.0 * peak)
        if part >= 1.0:
            return -peak if slip > 0.0 else peak
        return -stiffness * slip * (1.0 - part + part * part / 3.0)  # (4)
    x = stiffness / (tyre.shape * peak) * atan(slip)
    return -peak * sin(tyre.shape * atan(x - tyre.curvature * (x - atan(x))))  # (5)


@kernel
def axle_force(slip: float, load: float, wanted: float, tyre: Tyre) -> tuple[float, float]:
    """Fx and Fy, N, where brakes and drive want `wanted` N along the wheel."""
    side = lateral_force(slip, load, tyre)
    if tyre.kind == LINEAR:
        return wanted, side
    _, peak = grip_and_peak(load, tyre)
    if peak <= 0.0:
        return 0.0, 0.0
    along = min(max(wanted, -tyre.share * peak), tyre.share * peak)  # (6)
    return along, side * sqrt(1.0 - (along / peak) ** 2)  # (7)


def axle_tyres(parameters: VehicleParameters, kind: str, stiffness: float) -> tuple[Tyre, Tyre]:
    """Front and rear tyres; cornering stiffness times `stiffness`.

    Raises:
        ConfigError: No tyre has this name, or the stiffness is not positive.
    """
    if kind not in TYRES:
        raise unknown_name("tyre", kind, TYRES)
    if not stiffness > 0.0:
        raise ConfigError(f"tyre_stiffness must be positive, got {stiffness}")
    p = parameters
    weight = p.mass * GRAVITY / p.wheelbase
    numbers = (
        float(p.tyre_friction),
        float(p.tyre_load_sensitivity),
        float(p.tyre_shape),
        float(p.tyre_curvature),
    )
    return (
        Tyre(
            TYRES[kind],
            float(stiffness * p.cornering_front),
            float(weight * p.cog_to_rear),
            *numbers,
            FRONT_SHARE,
        ),
        Tyre(
            TYRES[kind],
            float(stiffness * p.cornering_rear),
            float(weight * p.cog_to_front),
            *numbers,
            REAR_SHARE,
        ),
    )


def slip_for(force: float, load: float, tyre: Tyre) -> float:
    """tan(alpha) that gives a lateral force, N, at a load, N: `lateral_force` inverted on its
    rising side.

    Forces beyond 0.95 of the peak are taken as that; an axle off the ground has no slip.
    """
    stiffness, peak = grip_and_peak(load, tyre)
    wanted = abs(force) if tyre.kind == LINEAR else min(abs(force), 0.95 * peak)
    if wanted <= 0.0:
        return 0.0
    low, high = 0.0, max(wanted / stiffness, 1e-9)
    while -lateral_force(high, load, tyre) < wanted:
        low, high = high, 1.1 * high
    for _ in range(60):
        mid = 0.5 * (low + high)
        low, high = (mid, high) if -lateral_force(mid, load, tyre) < wanted else (low, mid)
    return -high if force > 0.0 else high


@dataclass(frozen=True, eq=False)
class TyreUse:
    """`(n,)` each, at the times of the drive: slip angles, rad, positive where a wheel moves to its
    left; (10).
    """

    front: FloatArray
    rear: FloatArray
    friction: FloatArray


def tyre_use(ego: Trajectory, done: Controls, car: VehicleParameters) -> TyreUse:
    """Tyre use of a drive of at least two states, from its motion and actuation at the same
    times.
    """
    vx, vy = np.gradient(ego.x, ego.t), np.gradient(ego.y, ego.t)
    rear = np.angle(np.exp(1j * (np.arctan2(vy, vx) - ego.yaw)))  # (8)
    rear = np.where(ego.v >= SLOWEST_MPS, rear, np.nan)
    front = np.arctan(np.tan(rear) + car.wheelbase * ego.kappa) - done.steer  # (9): r / v is kappa
    # (10)
    return TyreUse(
        front, rear, np.hypot(ego.a, ego.v**2 * ego.kappa) / (car.tyre_friction * GRAVITY)
    )
