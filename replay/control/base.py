"""The controller's seam: one method; and the two halves of which most controllers are made.

A controller is built per drive as `factory(parameters, powertrain, period)` and is asked at the control rate. Its
memory (integrators, pedal in use, standstill) lives in the object. It may read the plan, the ego's state and the
numbers of the vehicle: not the world.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from logs.states import Command, EgoState
from logs.trace import Plan
from replay.control.tracking import Deviation, PlanPath


class Controller(Protocol):
    """Turns a plan into steering and pedals."""

    def control(self, state: EgoState, plan: Plan) -> Command:
        """The command to hold for one control period; throttle and brake never together."""
        ...


@runtime_checkable
class Telling(Protocol):
    """A controller that has something to tell of the drive, such as that it fell back to another."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user must know of the drive so far, one sentence each; goes into the trace."""
        ...


class LateralLaw(Protocol):
    """Steers (DLQR, pure pursuit, Stanley)."""

    def steer(self, state: EgoState, path: PlanPath, off: Deviation) -> float:
        """Front wheel angle to command, rad."""
        ...

    def rest(self) -> None:
        """The vehicle is held at a standstill: what the wheel does until it drives again is not known."""
        ...


class LongitudinalLaw(Protocol):
    """Drives and brakes (dual-loop PID)."""

    def accelerate(self, state: EgoState, path: PlanPath, off: Deviation) -> float:
        """Acceleration to command, m/s2."""
        ...

    def rest(self) -> None:
        """The vehicle is held at a standstill: forget what was integrated."""
        ...
