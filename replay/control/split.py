"""A controller made of two laws: one steers, the other drives; at a standstill neither does."""

from __future__ import annotations

from logs.states import Command, EgoState
from logs.trace import Plan
from replay.control.base import LateralLaw, LongitudinalLaw
from replay.control.pedals import Pedals, SoftStop, Standstill
from replay.control.tracking import Tracker
from replay.vehicle.base import Powertrain


class SplitController:
    """Steering by `lateral`, pedals by `longitudinal`. See `replay.control.base.Controller`.

    A stop ends softly; while the vehicle is held at a standstill, the brake is on and the steering stays where it is.
    """

    def __init__(
        self, lateral: LateralLaw, longitudinal: LongitudinalLaw, powertrain: Powertrain, period: float
    ) -> None:
        self._lateral = lateral
        self._longitudinal = longitudinal
        self._pedals = Pedals(powertrain)
        self._standstill, self._stop = Standstill(), SoftStop(powertrain, period)
        self._tracker = Tracker()

    def control(self, state: EgoState, plan: Plan) -> Command:
        """The command for the next control period."""
        path = self._tracker.path(plan)
        if self._standstill.holds(state.v, state.t, path):
            self._lateral.rest()
            self._longitudinal.rest()
            return Command(state.steer, *self._pedals.hold(state.v, state.a))
        off = path.deviation(state)
        steer = self._lateral.steer(state, path, off)
        acceleration = self._longitudinal.accelerate(state, path, off)
        eased = self._stop.eased(acceleration, state, path)
        return Command(steer, *self._pedals.press(eased, state.v))
