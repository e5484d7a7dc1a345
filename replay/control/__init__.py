"""Follows a plan: a Plan and the ego's state give a Command.

A law that only steers or only drives is a half of `SplitController` (`split`). Speed control is a
dual-loop PID, except for "mpc" and "pid" (a single loop).
"""

from __future__ import annotations

from collections.abc import Callable

from replan.logs.vehicle import VehicleParameters
from replan.replay.control.estimation import SteeringDelay
from replan.replay.control.mpc import Mpc, MpcConfig
from replan.replay.control.split import (
    DLQR,
    DUAL_LOOP,
    KINEMATIC_DLQR,
    PURE_PURSUIT,
    SPEED_PID,
    STANLEY,
    STEERING_PID,
    SplitController,
    split_law,
)
from replan.replay.vehicle.base import Controller, Powertrain

ControllerFactory = Callable[..., Controller]


def split_controller(summary: str, steers: int, drives: int = DUAL_LOOP) -> ControllerFactory:
    """The factory of a controller of two laws (`split_law`); `replan list controllers` shows the
    summary.
    """

    def build(parameters: VehicleParameters, powertrain: Powertrain, period: float) -> Controller:
        return SplitController(split_law(steers, parameters, powertrain, period, drives=drives))

    build.__doc__ = summary
    return build


def mpc_or_dlqr(
    parameters: VehicleParameters,
    powertrain: Powertrain,
    period: float,
    *,
    config: MpcConfig | None = None,
) -> Controller:
    """Build the MPC for steering and speed, with `dlqr_pid` as fallback without a solution."""
    delay = SteeringDelay(parameters, period)
    fallback = SplitController(
        split_law(DLQR, parameters, powertrain, period, commands=False), delay
    )
    return Mpc(parameters, powertrain, period, fallback, delay, config)


dlqr_pid = split_controller(
    "Steering by DLQR on the dynamic model (the kinematic one where the tyres are rigid), speed by "
    "dual-loop PID.",
    DLQR,
)
dlqr_kinematic_pid = split_controller(
    "Steering by DLQR on the kinematic model, speed by dual-loop PID.", KINEMATIC_DLQR
)
pure_pursuit = split_controller("Steering by pure pursuit, speed by dual-loop PID.", PURE_PURSUIT)
stanley = split_controller("Steering by Stanley's law, speed by dual-loop PID.", STANLEY)
pid = split_controller(
    "A PID for the steering and a single-loop PID for the speed.", STEERING_PID, SPEED_PID
)
