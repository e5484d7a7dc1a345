"""How a plan is followed: a Plan and the ego's state give a Command.

CONTROLLERS    by name, each built as `factory(parameters, powertrain, period)`; adding one is one file and one
               line here; a lateral or longitudinal law alone is combined by `SplitController`
"""

from __future__ import annotations

from collections.abc import Callable

from logs.vehicle import VehicleParameters
from replay.control.base import Controller
from replay.control.dlqr import Dlqr
from replay.control.pedals import Pedals
from replay.control.pid import DualLoopPid
from replay.control.split import SplitController
from replay.vehicle.base import Powertrain

ControllerFactory = Callable[[VehicleParameters, Powertrain, float], Controller]


def dlqr_pid(parameters: VehicleParameters, powertrain: Powertrain, period: float) -> Controller:
    """Steering by DLQR, speed by the dual-loop PID; `period` between two commands, s."""
    return SplitController(Dlqr(parameters, period), DualLoopPid(powertrain, period), Pedals(powertrain))


CONTROLLERS: dict[str, ControllerFactory] = {
    "dlqr_pid": dlqr_pid,
}
