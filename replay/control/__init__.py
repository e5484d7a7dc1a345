"""How a plan is followed: a Plan and the ego's state give a Command.

CONTROLLERS    by name, each built as `factory(parameters, powertrain, period)`; adding one is one file and one
               line here; a lateral or longitudinal law alone is combined by `SplitController`
"""

from __future__ import annotations

from collections.abc import Callable

from logs.vehicle import VehicleParameters
from replay.control.base import Controller, LateralLaw, LongitudinalLaw
from replay.control.dlqr import Dlqr
from replay.control.dlqr_kinematic import KinematicDlqr
from replay.control.late import LateSteering
from replay.control.lateral_model import has_rigid_tyres
from replay.control.mpc import Mpc
from replay.control.pid import DualLoopPid
from replay.control.pure_pursuit import PurePursuit
from replay.control.single_pid import SpeedPid, SteeringPid
from replay.control.split import SplitController
from replay.control.stanley import Stanley
from replay.vehicle.base import Powertrain

ControllerFactory = Callable[[VehicleParameters, Powertrain, float], Controller]


def dlqr_pid(parameters: VehicleParameters, powertrain: Powertrain, period: float) -> Controller:
    """Steering by DLQR on the dynamic model (the kinematic one where the tyres are rigid), speed by dual-loop PID."""
    return _dlqr_pid(parameters, powertrain, period)


def dlqr_kinematic_pid(parameters: VehicleParameters, powertrain: Powertrain, period: float) -> Controller:
    """Steering by DLQR on the kinematic model, speed by dual-loop PID."""
    return _split(KinematicDlqr(parameters, period), powertrain, period)


def mpc_or_dlqr(parameters: VehicleParameters, powertrain: Powertrain, period: float) -> Controller:
    """Steering and speed by MPC; where that has no solution, `dlqr_pid`."""
    steering = LateSteering(parameters, period)
    return Mpc(parameters, powertrain, period, _dlqr_pid(parameters, powertrain, period, steering), steering)


def pure_pursuit_pid(parameters: VehicleParameters, powertrain: Powertrain, period: float) -> Controller:
    """Steering by pure pursuit, speed by dual-loop PID."""
    return _split(PurePursuit(parameters), powertrain, period)


def stanley_pid(parameters: VehicleParameters, powertrain: Powertrain, period: float) -> Controller:
    """Steering by Stanley's law, speed by dual-loop PID."""
    return _split(Stanley(parameters), powertrain, period)


def pid_pid(parameters: VehicleParameters, powertrain: Powertrain, period: float) -> Controller:
    """A PID for the steering and a single-loop PID for the speed."""
    return _split(SteeringPid(parameters, period), powertrain, period, SpeedPid(powertrain, period))


def _dlqr_pid(
    parameters: VehicleParameters, powertrain: Powertrain, period: float, steering: LateSteering | None = None
) -> Controller:
    rigid = has_rigid_tyres(parameters)
    lateral = KinematicDlqr(parameters, period) if rigid else Dlqr(parameters, period, steering=steering)
    return _split(lateral, powertrain, period)


def _split(
    lateral: LateralLaw, powertrain: Powertrain, period: float, longitudinal: LongitudinalLaw | None = None
) -> Controller:
    return SplitController(lateral, longitudinal or DualLoopPid(powertrain, period), powertrain, period)


CONTROLLERS: dict[str, ControllerFactory] = {
    "dlqr_pid": dlqr_pid,
    "dlqr_kinematic_pid": dlqr_kinematic_pid,
    "mpc": mpc_or_dlqr,
    "pure_pursuit": pure_pursuit_pid,
    "stanley": stanley_pid,
    "pid": pid_pid,
}
