"""The interfaces of vehicle models and controllers: one method each.

A vehicle owns its hidden state (actuators, slip) and is built per drive as
`Class(parameters, start)`, already moving as `start` does. Its longitudinal plant is a
`Powertrain`, which controllers may invert. The loop also needs two properties: whether its tyres
slip, and whether it follows plans by itself.

A trace has one row per control step, which kernels and recorder share: the ego's motion and the
actuation at its time, what is commanded from then on, and the errors against the plan that is
driven then.
"""

from __future__ import annotations

from math import nan
from typing import Any, NamedTuple, Protocol

from replan.core.arrays import FloatArray
from replan.core.kernel import inner_kernel
from replan.logs.plan import Plan
from replan.logs.states import Command, EgoState
from replan.replay.vehicle.pedal_map import PedalMap
from replan.replay.vehicle.plan_path import Deviation

Plain = tuple[Any, ...]
"""Named tuples as plain ones: a named one costs a microsecond each time that it goes into a kernel
or comes out.
"""


def plain(named: Any) -> Any:
    """Named tuples, also nested ones, as plain tuples; any other value as it is."""
    return tuple(plain(item) for item in named) if isinstance(named, tuple) else named


class MotionState(NamedTuple):
    """`replan.logs.states.EgoState` as kernels take it, and as the rows of a trace store it."""

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


def motion_of(state: EgoState) -> MotionState:
    """A state for kernels."""
    return MotionState(
        state.t,
        state.x,
        state.y,
        state.yaw,
        state.v,
        state.a,
        state.kappa,
        state.steer,
        state.yaw_rate,
        state.v_lat,
    )


MOTION, COMMAND, ACTUATION, ERRORS = slice(0, 10), slice(10, 13), slice(13, 16), slice(16, 20)
"""Columns of a trace's row: `MotionState`.

Steer, throttle, brake twice; lateral to station of `Deviation`.
"""
COLUMNS = 20


@inner_kernel
def motion_at(rows: FloatArray, k: int) -> MotionState:
    """The ego's motion at row k."""
    row = rows[k]
    return MotionState(
        row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9]
    )


@inner_kernel
def write_motion(
    row: FloatArray, now: MotionState, steer: float, throttle: float, brake: float
) -> None:
    """Write motion and actuation."""
    row[0], row[1], row[2], row[3], row[4] = now.t, now.x, now.y, now.yaw, now.v
    row[5], row[6], row[7], row[8], row[9] = now.a, now.kappa, now.steer, now.yaw_rate, now.v_lat
    row[13], row[14], row[15] = steer, throttle, brake


@inner_kernel
def write_command(
    row: FloatArray, steer: float, throttle: float, brake: float, off: Deviation
) -> None:
    """Write command and errors."""
    row[10], row[11], row[12] = steer, throttle, brake
    row[16], row[17], row[18], row[19] = off.lateral, off.heading, off.speed, off.station


def write_state(rows: FloatArray, k: int, state: EgoState, actuation: Command) -> None:
    """Write motion and actuation of row k; what is commanded there is not known yet."""
    does = actuation.steer, actuation.throttle, actuation.brake
    rows[k] = (*motion_of(state), nan, nan, nan, *does, nan, nan, nan, nan)


def state_at(rows: FloatArray, k: int) -> EgoState:
    """The ego at row k."""
    return EgoState(*rows[k, MOTION].tolist())


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
