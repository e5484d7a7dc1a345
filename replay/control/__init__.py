"""How a plan is followed: a Plan and the ego's state give a Command.

CONTROLLERS    by name, each built as `factory(parameters, powertrain, period, **settings)`; adding one is one file and
               one line here; a law that only steers or only drives is a part of `SplitController` (`split`)
CONTROLLER     finds those, and users' own
"""

from __future__ import annotations

from collections.abc import Callable

from logs.extension import Kind
from logs.vehicle import VehicleParameters
from replay.control.mpc import Mpc, MpcConfig
from replay.control.split import (
    DLQR,
    KINEMATIC_DLQR,
    PURE_PURSUIT,
    SPEED_PID,
    STANLEY,
    STEERING_PID,
    SplitController,
    split_law,
)
from replay.control.steering_delay import SteeringDelay
from replay.vehicle.base import Controller, Powertrain

ControllerFactory = Callable[..., Controller]


def dlqr_pid(parameters: VehicleParameters, powertrain: Powertrain, period: float) -> Controller:
    """Steering by DLQR on the dynamic model (the kinematic one where the tyres are rigid), speed by dual-loop PID."""
    return SplitController(split_law(DLQR, parameters, powertrain, period))


def dlqr_kinematic_pid(parameters: VehicleParameters, powertrain: Powertrain, period: float) -> Controller:
    """Steering by DLQR on the kinematic model, speed by dual-loop PID."""
    return SplitController(split_law(KINEMATIC_DLQR, parameters, powertrain, period))


def mpc_or_dlqr(
    parameters: VehicleParameters, powertrain: Powertrain, period: float, *, config: MpcConfig | None = None
) -> Controller:
    """Steering and speed by MPC; where that has no solution, as `dlqr_pid`."""
    delay = SteeringDelay(parameters, period)
    fallback = SplitController(split_law(DLQR, parameters, powertrain, period, commands=False), delay)
    return Mpc(parameters, powertrain, period, fallback, delay, config)


def pure_pursuit_pid(parameters: VehicleParameters, powertrain: Powertrain, period: float) -> Controller:
    """Steering by pure pursuit, speed by dual-loop PID."""
    return SplitController(split_law(PURE_PURSUIT, parameters, powertrain, period))


def stanley_pid(parameters: VehicleParameters, powertrain: Powertrain, period: float) -> Controller:
    """Steering by Stanley's law, speed by dual-loop PID."""
    return SplitController(split_law(STANLEY, parameters, powertrain, period))


def pid_pid(parameters: VehicleParameters, powertrain: Powertrain, period: float) -> Controller:
    """A PID for the steering and a single-loop PID for the speed."""
    return SplitController(split_law(STEERING_PID, parameters, powertrain, period, drives=SPEED_PID))


CONTROLLERS: dict[str, ControllerFactory] = {
    "dlqr_pid": dlqr_pid,
    "dlqr_kinematic_pid": dlqr_kinematic_pid,
    "mpc": mpc_or_dlqr,
    "pure_pursuit": pure_pursuit_pid,
    "stanley": stanley_pid,
    "pid": pid_pid,
}

CONTROLLER: Kind[ControllerFactory] = Kind("controller", "controllers", CONTROLLERS)
