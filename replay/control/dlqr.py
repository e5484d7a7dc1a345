"""Lateral DLQR on the paper's four-state error model with the steering's lag, curvature and slip fed forward.

State x = (e_d m, e_d' m/s, e_phi rad, e_phi' rad/s, e_steer rad) at the rear axle, input u = commanded steer, each
minus that of exact following; the model is (2)-(3) of `replay.control.lateral_model` with (steer)' = (u - steer) / lag.

(1) x[k+1] = A x[k] + B u[k]          exact for an input held over a period (ZOH); other forms can be compared
(2) command = feed-forward - K x, both for when the command takes effect, where the steering is late (`steering_delay`);
    the gain K is that of `replay.control.regulator`, tabulated over speed
(3) feed-forward = the command of exact following (`replay.control.feedforward`), read ahead on the path
(4) of exact following: heading e_phi = p_0 kappa, its rate r = v kappa + p_0 kappa', its wheel angle

With (4) in x, -K x holds the k_3 term of the feed-forward: on a constant curve all errors vanish. p and d take the slip
that the tyres have shown (`replay.control.slip`), so that they vanish for other tyres and loads too.
With rigid tyres the states e_d' and e_phi' follow from the others: then it is the DLQR of `dlqr_kinematic`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from logs.errors import ConfigError, unknown_name
from logs.kernel import FloatArray, frozen, inner_kernel
from logs.vehicle import VehicleParameters
from replay.control.feedforward import commanded, following_at, slip_table, steer_for
from replay.control.lateral_model import DISCRETISATIONS, at_rear_axle, error_model, with_steering
from replay.control.regulator import (
    SHORTEST_LAG_S,
    Regulator,
    gain,
    solve_regulator,
    table_speeds,
)
from replay.control.slip import NOTHING_LEARNED, SlipModel, SlipState, learned, slip_model
from replay.control.steering_delay import (
    DelayModel,
    DelayState,
    delay_model,
    lateral_deviation,
    nothing_known,
    observed,
    periods,
    predicted,
    record,
    settled_wheel,
)
from replay.vehicle.base import Motion
from replay.vehicle.plan_path import Deviation


@dataclass(frozen=True)
class DlqrConfig:
    """Weights of the regulator and the form of (1).

    Attributes:
        lateral_weight: 1/m2.
        lateral_rate_weight: (s/m)2.
        heading_weight: 1/rad2.
        heading_rate_weight: (s/rad)2.
        steer_weight: Of u, 1/rad2.
        speed_mps: v_0 of the regulator's R.
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


def regulator(v: float, p: VehicleParameters, period: float, config: DlqrConfig) -> Regulator:
    """The regulator of (1) at one speed, m/s.

    Raises:
        ConfigError: The weights, or a speed of 0, allow no stable gain.
    """
    if not v > 0.0:
        raise ConfigError(f"DLQR: no stable gain at {v} m/s")
    A, B, _ = at_rear_axle(error_model(v, p), v, p)
    A, B = with_steering(A, B, max(p.steer_lag, SHORTEST_LAG_S))
    A, B = DISCRETISATIONS[config.discretisation](A, B[:, None], period)  # (1)
    weights = (config.lateral_weight, config.lateral_rate_weight, config.heading_weight, config.heading_rate_weight)
    return solve_regulator(A, B, (*weights, 0.0), config.steer_weight, v, config.speed_mps)


@lru_cache(maxsize=32)
def schedule(p: VehicleParameters, period: float, config: DlqrConfig) -> FloatArray:
    """K `(n, 5)` at `table_speeds`."""
    return frozen(np.array([regulator(float(v), p, period, config).K[0] for v in table_speeds()]))


class DlqrLaw(NamedTuple):
    """The numbers of (2)-(4) for a vehicle with tyres that slip.

    Attributes:
        gains: From `schedule`.
        slips: From `slip_table`.
        slip: What the slip is learned by.
        delay: What the steering's delay is learned by.
        wheelbase: m.
        max_steer: rad.
        lag: Of the steering, s.
        commands: Whether what this law asks for is what is commanded; else another tells of the steering.
    """

    gains: FloatArray
    slips: FloatArray
    slip: SlipModel
    delay: DelayModel
    wheelbase: float
    max_steer: float
    lag: float
    commands: bool


class DlqrState(NamedTuple):
    """What is known of the tyres and of the steering."""

    slip: SlipState
    delay: DelayState


def dlqr_law(
    p: VehicleParameters, period: float, config: DlqrConfig | None = None, *, commands: bool = True
) -> DlqrLaw:
    """The law for a vehicle whose tyres slip."""
    return DlqrLaw(
        schedule(p, period, config or DlqrConfig()), slip_table(p), slip_model(p, period), delay_model(p, period),
        float(p.wheelbase), float(p.max_steer), max(float(p.steer_lag), SHORTEST_LAG_S), commands,
    )  # fmt: skip


def dlqr_start(period: float) -> DlqrState:
    """Nothing is known yet."""
    return DlqrState(NOTHING_LEARNED, nothing_known(period))


@inner_kernel
def steer_slipping(
    law: DlqrLaw, state: DlqrState, now: Motion, off: Deviation, knots: FloatArray
) -> tuple[float, DlqrState]:
    """Front wheel angle to command, rad, and what is known then."""
    v, delay, model = now.v, state.delay, law.delay
    if law.commands:
        delay = observed(delay, model, now.steer)
    slip = learned(state.slip, law.slip, now)
    rear, angle = following_at(law.slips, law.wheelbase, (slip.front, slip.rear), v)  # (4)
    y = lateral_deviation(now, off, knots, rear)
    lateral, side, heading, turn = predicted(y, delay, model, knots, off.foot, v, angle)
    foot = off.foot + v * delay.delay
    wheel = settled_wheel(delay) if periods(delay, model) else now.steer
    command = (
        steer_for(knots, foot, v, commanded(angle, law.lag, model.period))  # (3)
        - gain(law.gains, v, 0) * lateral
        - gain(law.gains, v, 1) * (side + v * heading)
        - gain(law.gains, v, 2) * heading
        - gain(law.gains, v, 3) * turn
        - gain(law.gains, v, 4) * (wheel - steer_for(knots, foot, v, angle))  # (2)
    )
    command = min(max(command, -law.max_steer), law.max_steer)
    if law.commands:
        record(delay, model, command)
    return command, DlqrState(slip, delay)
