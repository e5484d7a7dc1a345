"""The interfaces of vehicle models and controllers: one method each.

A vehicle owns its hidden state (actuators, slip) and is built per drive as
`Class(parameters, start)`, already moving as `start` does. Its longitudinal plant is a
`Powertrain`, which controllers may invert. The loop also needs two properties: whether its tyres
slip, and whether it follows plans by itself.
"""

from __future__ import annotations

from typing import Protocol

from replan.logs.plan import Plan
from replan.logs.states import Command, EgoState
from replan.replay.vehicle.pedal_map import PedalMap


class Powertrain(Protocol):
    """Pedals to acceleration, steady state: what a controller may know of the drive train."""

    @property
    def pedal_map(self) -> PedalMap:
        """The same for kernels, with lags and dead time."""
        ...

    def coasting(self, v: float) -> float:
        """Acceleration at `v` (m/s) without pedals, m/s2, not positive."""
        ...

    def full_throttle(self, v: float) -> float:
        """What full throttle adds to coasting at `v`, m/s2; in proportion to the pedal."""
        ...

    def full_brake(self, v: float) -> float:
        """What full brake takes from coasting at `v`, m/s2, positive.

        In proportion to the pedal.
        """
        ...


def steady_pedals(train: Powertrain, acceleration: float, v: float) -> tuple[float, float]:
    """Throttle and brake that give an acceleration, m/s2, at a speed, m/s, within their range."""
    beyond = acceleration - train.coasting(v)
    throttle = min(max(beyond / max(train.full_throttle(v), 1e-3), 0.0), 1.0)
    return throttle, min(max(-beyond / train.full_brake(v), 0.0), 1.0)


class Vehicle(Protocol):
    """Moves the ego."""

    @property
    def state(self) -> EgoState:
        """Where the ego is now."""
        ...

    @property
    def actuation(self) -> Command:
        """What the actuators do now: they lag behind the command."""
        ...

    @property
    def powertrain(self) -> Powertrain:
        """The longitudinal plant."""
        ...

    @property
    def has_rigid_tyres(self) -> bool:
        """Whether its wheels roll without slip."""
        ...

    @property
    def own_controller(self) -> Controller | None:
        """Its own controller, if it follows plans by itself; None: it needs a controller."""
        ...

    def step(self, command: Command, dt: float) -> EgoState:
        """Hold the command for `dt` (s, positive).

        The state after that, its time a whole nanosecond.
        """
        ...


class Controller(Protocol):
    """Turns a plan into steering and pedals.

    A controller is built per drive as `factory(parameters, powertrain, period)` and is called at
    the control rate. Its memory (integrators, pedal in use, standstill) lives in the object. It may
    read the plan, the ego's state and the numbers of the vehicle: not the world.
    """

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the trace about the drive so far, such as that a fallback controller took
        over.
        """
        ...

    def control(self, state: EgoState, plan: Plan) -> Command:
        """The command to hold for one control period; throttle and brake never together."""
        ...
