"""Lateral DLQR on the paper's four-state error model with the steering's lag, curvature and slip fed forward.

State x = (e_d m, e_d' m/s, e_phi rad, e_phi' rad/s, e_steer rad) at the rear axle, input u = commanded steer, each
minus that of exact following; the model is (2)-(3) of `replay.control.lateral_model` with (steer)' = (u - steer) / lag.

(1) x[k+1] = A x[k] + B u[k]          exact for an input held over a period (ZOH); other forms can be compared
(2) J = sum of x' Q x + u' R u,       R = steer_weight (1 + (v / v_0)^2)^2
(3) P = Q + A' P (I + B R^-1 B' P)^-1 A,   K = (R + B' P B)^-1 B' P A
(4) command = feed-forward - K x, both for when the command takes effect, where the steering is late (`LateSteering`)

R grows with the lateral acceleration that a steering angle makes: below v_0 the error decays over a distance, above it
over a time. K is tabulated over speed and interpolated; below the table's first speed, where one can hardly steer, its
first row holds.

(5) feed-forward = the command of exact following (`replay.control.exact`), read ahead on the path
(6) of exact following: heading e_phi = p_0 kappa, its rate r = v kappa + p_0 kappa', its wheel angle

With (6) in x, -K x holds the k_3 term of the feed-forward: on a constant curve all errors vanish. p and d take the slip
that the tyres have shown (`replay.control.slip`), so that they vanish for other tyres and loads too.
With rigid tyres the states e_d' and e_phi' follow from the others: then it is the DLQR of `dlqr_kinematic`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from logs.errors import ConfigError, unknown_name
from logs.kernel import FloatArray
from logs.states import EgoState
from logs.vehicle import VehicleParameters
from replay.control.dlqr_kinematic import SHORTEST_LAG_S, SPEED_STEP_MPS
from replay.control.exact import commanded, following_at, slip_table, steer_for, table_speeds
from replay.control.late import LateSteering, lateral_deviation
from replay.control.lateral_model import DISCRETISATIONS, at_rear_axle, error_model, with_steering
from replay.control.riccati import solve_riccati
from replay.control.slip import Slip
from replay.control.tracking import Deviation, PlanPath


@dataclass(frozen=True)
class DlqrConfig:
    """Weights of (2) and the form of (1).

    Attributes:
        lateral_weight: 1/m2.
        lateral_rate_weight: (s/m)2.
        heading_weight: 1/rad2.
        heading_rate_weight: (s/rad)2.
        steer_weight: Of u, 1/rad2.
        speed_mps: v_0 of (2).
        discretisation: Name in `replay.control.lateral_model.DISCRETISATIONS`.
    """

    lateral_weight: float = 1.0
    lateral_rate_weight: float = 0.0
    heading_weight: float = 1.0
    heading_rate_weight: float = 0.0
    steer_weight: float = 40.0
    speed_mps: float = 12.0
    discretisation: str = "zoh"

    def __post_init__(self) -> None:
        weights = (self.lateral_rate_weight, self.heading_weight, self.heading_rate_weight)
        if not (self.lateral_weight > 0.0 and min(weights) >= 0.0):
            raise ConfigError("DLQR: lateral_weight must be positive and no weight negative")
        if not (self.steer_weight > 0.0 and self.speed_mps > 0.0):
            raise ConfigError("DLQR: steer_weight and speed_mps must be positive")
        if self.discretisation not in DISCRETISATIONS:
            raise unknown_name("discretisation", self.discretisation, DISCRETISATIONS)


@dataclass(frozen=True, eq=False)
class Regulator:
    """A solved (1)-(3) at one speed: A `(n, n)`, B `(n, 1)`, Q, R, P, and the gain K `(1, n)`."""

    A: FloatArray
    B: FloatArray
    Q: FloatArray
    R: FloatArray
    P: FloatArray
    K: FloatArray


def regulator(v: float, p: VehicleParameters, period: float, config: DlqrConfig) -> Regulator:
    """Solve (1)-(3) at one speed, m/s.

    Raises:
        ConfigError: The weights, or a speed of 0, allow no stable gain.
    """
    if not v > 0.0:
        raise ConfigError(f"DLQR: no stable gain at {v} m/s")
    A, B, _ = at_rear_axle(error_model(v, p), v, p)
    A, B = with_steering(A, B, max(p.steer_lag, SHORTEST_LAG_S))
    A, B = DISCRETISATIONS[config.discretisation](A, B[:, None], period)
    weights = (config.lateral_weight, config.lateral_rate_weight, config.heading_weight, config.heading_rate_weight)
    Q = np.diag([*weights, 0.0])
    R = np.array([[config.steer_weight * (1.0 + (v / config.speed_mps) ** 2) ** 2]])
    P = solve_riccati(np.ascontiguousarray(A), np.ascontiguousarray(B), Q, R)
    if not np.isfinite(P).all():
        raise ConfigError(f"DLQR: no stable gain at {v} m/s with {config}")
    return Regulator(A, B, Q, R, P, np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A))


Row = tuple[float, float, float, float, float]
"""K."""


@lru_cache(maxsize=32)
def schedule(p: VehicleParameters, period: float, config: DlqrConfig) -> tuple[Row, ...]:
    """K at `exact.table_speeds`."""
    gains = [regulator(float(v), p, period, config).K[0] for v in table_speeds()]
    return tuple((float(k[0]), float(k[1]), float(k[2]), float(k[3]), float(k[4])) for k in gains)


class Dlqr:
    """(4)-(6) for a vehicle with tyres that slip; remembers how much. See `replay.control.base.LateralLaw`.

    Args:
        parameters: Of the ego.
        period: Between two commands, s.
        config: Weights.
        steering: Where another controller commands, and tells it; None: this one does.
    """

    def __init__(
        self,
        parameters: VehicleParameters,
        period: float,
        config: DlqrConfig | None = None,
        steering: LateSteering | None = None,
    ) -> None:
        self._max_steer = float(parameters.max_steer)
        self._wheelbase = float(parameters.wheelbase)
        self._period, self._lag = period, max(parameters.steer_lag, SHORTEST_LAG_S)
        self._gains = schedule(parameters, period, config or DlqrConfig())
        self._slips = slip_table(parameters)
        self._slip = Slip(parameters, period)
        self._commands = steering is None
        self._steering = steering or LateSteering(parameters, period)

    def gain(self, v: float) -> Row:
        """K at a speed, m/s, linear between the table's rows; the ends hold."""
        place = min(max(v / SPEED_STEP_MPS - 1.0, 0.0), len(self._gains) - 1.0)
        i = min(int(place), len(self._gains) - 2)
        u = place - i
        k1, k2, k3, k4, k5 = self._gains[i]
        m1, m2, m3, m4, m5 = self._gains[i + 1]
        return k1 + u * (m1 - k1), k2 + u * (m2 - k2), k3 + u * (m3 - k3), k4 + u * (m4 - k4), k5 + u * (m5 - k5)

    def rest(self) -> None:
        """Forget where the wheel is; how late it comes and how much the tyres slip stays known."""
        if self._commands:
            self._steering.rest()

    def steer(self, state: EgoState, path: PlanPath, off: Deviation) -> float:
        """Front wheel angle to command, rad."""
        if not self._commands:
            return self._command(state, path, off)
        self._steering.saw(state.steer)
        command = self._command(state, path, off)
        self._steering.sent(command)
        return command

    def _command(self, state: EgoState, path: PlanPath, off: Deviation) -> float:
        v, knots, steering = state.v, path.knots, self._steering
        self._slip.learn(state)
        slip, angle = following_at(self._slips, self._wheelbase, self._slip.ratios, v)
        y = lateral_deviation(state, off, knots, slip)
        lateral, side, heading, turn = steering.led(y, knots, off.foot, v, angle)
        foot = off.foot + v * steering.late
        k_lat, k_rate, k_yaw, k_turn, k_steer = self.gain(v)
        wheel = steering.wheel if steering.steps else state.steer
        command = (
            steer_for(knots, foot, v, commanded(angle, self._lag, self._period))
            - k_lat * lateral
            - k_rate * (side + v * heading)
            - k_yaw * heading
            - k_turn * turn
            - k_steer * (wheel - steer_for(knots, foot, v, angle))
        )
        return min(max(command, -self._max_steer), self._max_steer)
