"""How a plan is followed: a Plan and the ego's state give a Command.

CONTROLLERS    by name, each built as `factory(parameters, powertrain, period, **settings)`; adding one is one file and
               one line here; a law that only steers or only drives is a part of `SplitController` (`split`). Speed is
               by dual-loop PID, except with "mpc" and "pid" (a single loop)
CONTROLLER     finds those, and users' own
"""

from __future__ import annotations

from collections.abc import Callable

from logs.extension import Kind
from logs.vehicle import VehicleParameters
from replay.control.estimation import SteeringDelay
from replay.control.mpc import Mpc, MpcConfig
from replay.control.split import (
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
from replay.vehicle.base import Controller, Powertrain

ControllerFactory = Callable[..., Controller]


def split_controller(steers: int, drives: int = DUAL_LOOP) -> ControllerFactory:
    """The factory of a controller of two laws (`split_law`)."""

    def build(parameters: VehicleParameters, powertrain: Powertrain, period: float) -> Controller:
        return SplitController(split_law(steers, parameters, powertrain, period, drives=drives))

    return build


def mpc_or_dlqr(
    parameters: VehicleParameters, powertrain: Powertrain, period: float, *, config: MpcConfig | None = None
) -> Controller:
    """Steering and speed by MPC; where that has no solution, as `dlqr_pid`."""
    delay = SteeringDelay(parameters, period)
    fallback = SplitController(split_law(DLQR, parameters, powertrain, period, commands=False), delay)
    return Mpc(parameters, powertrain, period, fallback, delay, config)


CONTROLLERS: dict[str, ControllerFactory] = {
    "dlqr_pid": split_controller(DLQR),
    "dlqr_kinematic_pid": split_controller(KINEMATIC_DLQR),
    "mpc": mpc_or_dlqr,
    "pure_pursuit": split_controller(PURE_PURSUIT),
    "stanley": split_controller(STANLEY),
    "pid": split_controller(STEERING_PID, SPEED_PID),
}

CONTROLLER: Kind[ControllerFactory] = Kind("controller", "controllers", CONTROLLERS)
