"""What a vehicle model is, and the controller that drives it: one method each.

A vehicle owns its hidden state (actuators, slip) and is built per drive as `Class(parameters, start)`, already moving
as `start` does. Its longitudinal plant is a `Powertrain`, which controllers may invert. What else the loop must know of
it are two capabilities: whether its tyres slip, and whether it follows plans by itself.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

from logs.states import Command, EgoState
from logs.trace import Plan
from replay.vehicle.pedal_map import PedalMap

Plain = tuple[Any, ...]
"""Named tuples as plain ones: a named one costs a microsecond each time that it goes into a kernel or comes out."""


def plain(named: Any) -> Any:
    """Named tuples, and those within them, as plain ones; what is none of them as it is."""
    return tuple(plain(item) for item in named) if isinstance(named, tuple) else named


class Motion(NamedTuple):
    """`logs.states.EgoState` as kernels take it, and as it stands in the rows of a trace."""

    t: float
    x: float
    y: float
    yaw: float
    v: float
    a: float
    kappa: float
    steer: float
    yaw_rate: float
    v_lat: float


def motion_of(state: EgoState) -> Motion:
    """A state for kernels."""
    return Motion(
        state.t, state.x, state.y, state.yaw, state.v, state.a, state.kappa, state.steer, state.yaw_rate, state.v_lat
    )


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
        """What full brake takes from coasting at `v`, m/s2, positive; in proportion to the pedal."""
        ...


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
        """What controls it where it follows plans by itself; None: it needs a controller."""
        ...

    def step(self, command: Command, dt: float) -> EgoState:
        """Hold the command for `dt` (s, positive); the state after that, its time a whole nanosecond."""
        ...


class Controller(Protocol):
    """Turns a plan into steering and pedals.

    A controller is built per drive as `factory(parameters, powertrain, period)` and is asked at the control rate. Its
    memory (integrators, pedal in use, standstill) lives in the object. It may read the plan, the ego's state and the
    numbers of the vehicle: not the world.
    """

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user must know of the drive so far, such as that another had to take over; goes into the trace."""
        ...

    def control(self, state: EgoState, plan: Plan) -> Command:
        """The command to hold for one control period; throttle and brake never together."""
        ...
