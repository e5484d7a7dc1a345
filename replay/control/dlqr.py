"""Lateral DLQR: the regulator, its gains over speed, and the two laws that steer by it.

(1) J = sum of x' Q x + u' R u,       R = steer_weight (1 + (v / v_0)^2)^2
(2) P = Q + A' P (I + G P)^-1 A,      G = B R^-1 B'
(3) K = (R + B' P B)^-1 B' P A,       u = -K x
(4) A <- A (I + G H)^-1 A
    G <- G + A (I + G H)^-1 G A'
    H <- H + A' H (I + G H)^-1 A      from H = Q; H -> P, its error squared in each round

R grows with the lateral acceleration that a steering angle makes: below v_0 the error decays over a
distance, above it over a time. K is tabulated over speed and interpolated; below the first speed of
the table, where steering has little effect, its first row is used.

(4) is structured doubling: Chu, Fan, Lin, Wang, Structure-preserving algorithms for periodic
discrete-time algebraic Riccati equations, Int. J. Control 77 (2004), section 3. All speeds are
solved at once, because library solvers for one equation take a hundred times longer when the
threads of their linear algebra compete for busy cores.

Where the tyres slip, the model is the paper's four-state error model with the steering's lag: state
x = (e_d m, e_d' m/s, e_phi rad, e_phi' rad/s, e_steer rad) at the rear axle, input u = commanded
steer, each minus that of exact following; (2)-(3) of `replan.replay.control.lateral_model` with
(steer)' = (u - steer) / lag.

(5) x[k+1] = A x[k] + B u[k]
        exact for an input held over a period (ZOH); other forms can be compared
(6) command = feed-forward - K x, both for when the command takes effect,
        where the steering is late (`estimation`)
(7) feed-forward = the command of exact following (`lateral_model` (6)-(7)), read ahead on the path
(8) of exact following: heading e_phi = p_0 kappa, its rate r = v kappa + p_0 kappa',
        its wheel angle

With (8) in x, -K x holds the k_3 term of the feed-forward: on a constant curve all errors vanish. p
and d take the slip that the tyres have shown (`estimation`), so that they vanish for other tyres
and loads too.

With rigid tyres, e_d' and e_phi' follow from the others: x = (e_lat, e_yaw, e_steer); wheelbase L,
steering lag T (Rajamani, Vehicle Dynamics and Control, 2.5; the lag added):

(9)  d(e_lat)/dt = v e_yaw,   d(e_yaw)/dt = v / L e_steer,   d(e_steer)/dt = (u - e_steer) / T
(10) exact for an input held over dt (ZOH), (9) integrated from the last up:
     r = exp(-dt / T),  e_steer+ = r e_steer + (1 - r) u
     e_yaw+ = e_yaw + v / L (i e_steer + (dt - i) u)                             i = T (1 - r)
     e_lat+ = e_lat + v dt e_yaw + v^2 / L (j e_steer + (dt^2 / 2 - j) u)        j = T (dt - i)
(11) steer command = atan(L kappa(s + v (T + dt / 2))) - K x
     The curvature is read ahead by the steering's lag and half a period of the hold: to first
     order, the wheel then has the angle of the path at the foot point s, and on a constant curve
     every error is 0 in the steady state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import atan, exp
from typing import NamedTuple

import numpy as np

from replan.core.arrays import FloatArray, frozen
from replan.core.errors import ConfigError, unknown_name
from replan.core.kernel import inner_kernel, kernel
from replan.core.settings import Config, NotNegative, Positive
from replan.logs.states import EgoState
from replan.logs.vehicle import VehicleParameters
from replan.replay.control import estimation
from replan.replay.control.estimation import DelayMemory, DelayModel, SlipMemory, SlipModel
from replan.replay.control.lateral_model import (
    DISCRETISATIONS,
    at_rear_axle,
    at_speed,
    command_series,
    error_model,
    following_at,
    has_rigid_tyres,
    slip_table,
    steer_for,
    table_speeds,
    with_rigid_tyres,
    with_steering,
)
from replan.replay.vehicle.drivetrain import SHORTEST_LAG_S
from replan.replay.vehicle.plan_path import Deviation, path_kappa

MAX_ROUNDS = 60


@dataclass(frozen=True)
class DlqrConfig(Config):
    """Weights of the regulator and the form of (5); with rigid tyres, the rates have no weight."""

    lateral_weight: Positive = 1.0
    """1/m2."""
    lateral_rate_weight: NotNegative = 0.0
    """(s/m)2."""
    heading_weight: NotNegative = 1.0
    """1/rad2."""
    heading_rate_weight: NotNegative = 0.0
    """(s/rad)2."""
    steer_weight: Positive = 40.0
    """Of u, 1/rad2."""
    speed_mps: Positive = 12.0
    """v_0 of the regulator's R."""
    discretisation: str = "zoh"
    """Name in `replan.replay.control.lateral_model.DISCRETISATIONS`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.discretisation not in DISCRETISATIONS:
            raise unknown_name("discretisation", self.discretisation, DISCRETISATIONS)


class Regulators(NamedTuple):
    """A solved (1)-(3) at each of k speeds: A `(k, n, n)`, B `(k, n, 1)`, Q, R, P, and the gain K
    `(k, 1, n)`.
    """

    A: FloatArray
    B: FloatArray
    Q: FloatArray
    R: FloatArray
    P: FloatArray
    K: FloatArray


def regulators(
    speeds: Sequence[float], p: VehicleParameters, period: float, config: DlqrConfig
) -> Regulators:
    """The regulators (1)-(3) of a vehicle at speeds `(k,)`, m/s: five states, or three where its
    tyres are rigid.

    Raises:
        ConfigError: The weights, or a speed of 0, allow no stable gain.
    """
    if not min(speeds) > 0.0:
        raise ConfigError(f"DLQR: no stable gain at {min(speeds)} m/s")
    lag, weights = (
        max(float(p.steer_lag), SHORTEST_LAG_S),
        [config.lateral_weight, config.heading_weight],
    )
    if has_rigid_tyres(p):
        models = [rolling_model(v, p.wheelbase, lag, period) for v in speeds]  # (10)
    else:
        weights = [weights[0], config.lateral_rate_weight, weights[1], config.heading_rate_weight]
        models = [_slipping_model(v, p, lag, period, config) for v in speeds]
    A, B = np.stack([model[0] for model in models]), np.stack([model[1] for model in models])
    v = np.asarray(speeds, np.float64)[:, None, None]
    # (1)
    Q, R = np.diag([*weights, 0.0]), config.steer_weight * (1.0 + (v / config.speed_mps) ** 2) ** 2
    P = solve_riccati(A, B, Q, R)  # (2)
    unstable = ~np.isfinite(P).all(axis=(1, 2))
    if unstable.any():
        weighed = f"the weights {(*weights, 0.0)} and steer_weight {config.steer_weight:g}"
        raise ConfigError(f"DLQR: no stable gain at {float(v[unstable][0, 0])} m/s with {weighed}")
    # (3)
    K = [
        np.linalg.solve(r + b.T @ s @ b, b.T @ s @ a)
        for (a, b), r, s in zip(models, R, P, strict=True)
    ]
    return Regulators(A, B, np.broadcast_to(Q, A.shape), R, P, np.stack(K))


def _slipping_model(
    v: float, p: VehicleParameters, lag: float, period: float, config: DlqrConfig
) -> tuple[FloatArray, FloatArray]:
    """A `(5, 5)` and B `(5, 1)` of (5)."""
    A, B, _ = at_rear_axle(error_model(v, p), v, p)
    A, B = with_steering(A, B, lag)
    return DISCRETISATIONS[config.discretisation](A, B[:, None], period)


def rolling_model(
    v: float, wheelbase: float, lag: float, period: float
) -> tuple[FloatArray, FloatArray]:
    """A `(3, 3)` and B `(3, 1)` of (10)."""
    turn, decay = v / wheelbase, exp(-period / lag)
    once = lag * (1.0 - decay)
    twice = lag * (period - once)
    # (10)
    A = np.array([[1.0, v * period, v * turn * twice], [0.0, 1.0, turn * once], [0.0, 0.0, decay]])
    B = np.array([[v * turn * (0.5 * period**2 - twice)], [turn * (period - once)], [1.0 - decay]])
    return A, B


def solve_riccati(A: FloatArray, B: FloatArray, Q: FloatArray, R: FloatArray) -> FloatArray:
    """The stabilising P `(k, n, n)` of k equations (2): A like P, B `(k, n, m)`, Q `(n, n)` >= 0, R
    `(k, m, m)` > 0.

    All NaN where the rounds do not converge: (A, B) cannot be stabilised, or Q does not see an
    unstable mode.
    """
    solutions, left, eye = np.full_like(A, np.nan), np.arange(len(A)), np.eye(A.shape[-1])
    G, H = B @ np.linalg.solve(R, np.ascontiguousarray(B.mT)), np.broadcast_to(Q, A.shape)
    with np.errstate(over="ignore", invalid="ignore"):  # H that grows without end is no solution
        for _ in range(MAX_ROUNDS):
            W = np.linalg.solve(eye + G @ H, np.broadcast_to(eye, A.shape))
            WA, At = W @ A, np.ascontiguousarray(A.mT)
            more = At @ (H @ WA)
            G = G + A @ (W @ G) @ At
            A = A @ WA
            H = H + more
            H, G = 0.5 * (H + H.mT), 0.5 * (G + G.mT)
            is_finite = np.isfinite(H).all(axis=(1, 2))
            solved = is_finite & (
                np.abs(more).max(axis=(1, 2)) <= 1e-13 * np.abs(H).max(axis=(1, 2))
            )
            solutions[left[solved]] = H[solved]
            goes_on = is_finite & ~solved
            left, A = left[goes_on], A[goes_on]
            G, H = G[goes_on], H[goes_on]
            if not len(left):
                break
    return solutions


@lru_cache(maxsize=32)
def gain_table(p: VehicleParameters, period: float, config: DlqrConfig) -> FloatArray:
    """K `(n, 5)`, with rigid tyres `(n, 3)`, at `table_speeds`."""
    return frozen(regulators(table_speeds().tolist(), p, period, config).K[:, 0])


@kernel
def gain(gains: FloatArray, v: float, column: int) -> float:
    """Return an entry of K at a speed, m/s, linear between the table's rows, constant beyond its
    ends.
    """
    i, u = at_speed(gains, v)
    return gains[i, column] + u * (gains[i + 1, column] - gains[i, column])


class DlqrLaw(NamedTuple):
    """The numbers of (6)-(8) for a vehicle with tyres that slip.

    Attributes:
        slip: Model that estimates the slip.
        delay: Model that estimates the steering's delay.
        gains: From `gain_table`.
        slips: From `slip_table`.
        wheelbase: m.
        max_steer: rad.
        lag: Of the steering, s.
        commands: Whether this law's output is the command; otherwise another controller reports the
            steering.
    """

    slip: SlipModel
    delay: DelayModel
    gains: FloatArray
    slips: FloatArray
    wheelbase: float
    max_steer: float
    lag: float
    commands: bool


def dlqr_law(
    p: VehicleParameters, period: float, config: DlqrConfig | None = None, *, commands: bool = True
) -> DlqrLaw:
    """The law for a vehicle whose tyres slip."""
    return DlqrLaw(
        estimation.slip_model(p, period),
        estimation.delay_model(p, period),
        gain_table(p, period, config or DlqrConfig()),
        slip_table(p),
        float(p.wheelbase),
        float(p.max_steer),
        max(float(p.steer_lag), SHORTEST_LAG_S),
        commands,
    )


@inner_kernel
def steer_slipping(
    law: DlqrLaw,
    slip: SlipMemory,
    delay: DelayMemory,
    wheel: FloatArray,
    now: EgoState,
    off: Deviation,
    knots: FloatArray,
) -> float:
    """Front wheel angle to command, rad; `wheel` as in `DelayMemory`."""
    v, model = now.v, law.delay
    if law.commands:
        estimation.observe(delay, wheel, model, now.steer)
    estimation.learn(slip, law.slip, now)
    rear, angle = following_at(law.slips, law.wheelbase, (slip.front, slip.rear), v)  # (8)
    y = estimation.lateral_deviation(now, off, knots, rear)
    lateral, side, heading, turn = estimation.predicted(
        y, delay, wheel, model, knots, off.foot, v, angle
    )
    foot = off.foot + v * delay.delay
    is_late = estimation.periods(delay, model) > 0
    steer = estimation.settled_wheel(delay, wheel) if is_late else now.steer
    command = (
        steer_for(knots, foot, v, command_series(angle, law.lag, model.period))  # (7)
        - gain(law.gains, v, 0) * lateral
        - gain(law.gains, v, 1) * (side + v * heading)
        - gain(law.gains, v, 2) * heading
        - gain(law.gains, v, 3) * turn
        - gain(law.gains, v, 4) * (steer - steer_for(knots, foot, v, angle))  # (6)
    )
    command = min(max(command, -law.max_steer), law.max_steer)
    if law.commands:
        estimation.record(wheel, model, command)
    return command


class KinematicLaw(NamedTuple):
    """The numbers of (11): K over speed, wheelbase m, max_steer rad, T + dt / 2 s."""

    gains: FloatArray
    wheelbase: float
    max_steer: float
    preview: float


def kinematic_law(
    p: VehicleParameters, period: float, config: DlqrConfig | None = None
) -> KinematicLaw:
    """The law for a vehicle with rigid tyres."""
    lag = max(float(p.steer_lag), SHORTEST_LAG_S)
    gains = gain_table(with_rigid_tyres(p), period, config or DlqrConfig())
    return KinematicLaw(gains, float(p.wheelbase), float(p.max_steer), lag + 0.5 * period)


@inner_kernel
def steer_rolling(law: KinematicLaw, now: EgoState, off: Deviation, knots: FloatArray) -> float:
    """Front wheel angle to command, rad."""
    present = atan(law.wheelbase * path_kappa(knots, off.foot))
    ahead = atan(law.wheelbase * path_kappa(knots, off.foot + now.v * law.preview))
    command = (
        ahead
        - gain(law.gains, now.v, 0) * off.lateral
        - gain(law.gains, now.v, 1) * off.heading
        - gain(law.gains, now.v, 2) * (now.steer - present)  # (11)
    )
    return min(max(command, -law.max_steer), law.max_steer)
