"""The controller's seam: one method, and what it has to say of the drive.

A controller is built per drive as `factory(parameters, powertrain, period)` and is asked at the control rate. Its
memory (integrators, pedal in use, standstill) lives in the object. It may read the plan, the ego's state and the
numbers of the vehicle: not the world.
"""

from __future__ import annotations

from typing import Protocol

from logs.states import Command, EgoState
from logs.trace import Plan


class Controller(Protocol):
    """Turns a plan into steering and pedals."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user must know of the drive so far, such as that another had to take over; goes into the trace."""
        ...

    def control(self, state: EgoState, plan: Plan) -> Command:
        """The command to hold for one control period; throttle and brake never together."""
        ...
