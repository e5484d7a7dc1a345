"""The kinematic bicycle at the rear axle, with steering and pedals that lag; its rear wheels may
steer as well.

With front and rear wheel angles df and dr, speed v along the body, wheelbase L; no wheel slips
sideways:

(1) dx/dt   = v cos(yaw) - v_lat sin(yaw)
(2) dy/dt   = v sin(yaw) + v_lat cos(yaw),
        v_lat = v tan(dr) at the rear axle, the reference point
(3) dyaw/dt = v (tan(df) - tan(dr)) / L
(4) d(df)/dt                                      replan.replay.vehicle.drivetrain (7)
(5) dv/dt, d(throttle)/dt, d(brake)/dt            replan.replay.vehicle.pedal_map
(6) dr = rear_ratio df
        geared: 0 for a car; negative: against each other, turns more tightly
(7) kappa = cos(dr) (tan(df) - tan(dr)) / L
        of the path driven with the wheels held where they are

At the centre of gravity (lf, lr to the axles) the same motion reads x' = V cos(yaw + beta), y' = V
sin(yaw + beta), yaw' = V cos(beta) (tan df - tan dr) / L with beta = atan((lf tan dr + lr tan df) /
L), v = V cos(beta). That is the paper's equation 1, corrected: it has yaw = V (tan df + tan dr) /
L, where the dot, cos(beta) and the sign of the rear wheels are missing; its wheels would slip.

Wheels roll without slip (Rajamani, Vehicle Dynamics and Control, 2.2; without rear steering the
reference point at the rear axle makes its slip angle 0): there is no friction limit in it, so it
follows any curvature at any speed.

Integration: Runge-Kutta of order 4 in sub-steps of at most 10 ms and at most half the shortest lag.
Coming to a stand is an event within the sub-step: until then it rolls, from then on it stands.

The perfect vehicle is always at its plan's state, so that only planning is judged: the upper bound
for controllers. It is its own controller: it returns the command that a kinematic bicycle without
lags would need.
"""

from __future__ import annotations

from functools import partial
from math import atan, ceil, cos, sin, tan
from typing import Annotated, NamedTuple

from msgspec import Meta

from replan.core.errors import ConfigError
from replan.core.kernel import inner_kernel, kernel
from replan.logs.plan import Plan
from replan.logs.states import Command, EgoState
from replan.logs.vehicle import VehicleParameters
from replan.replay.vehicle.base import Controller, steady_pedals
from replan.replay.vehicle.drivetrain import SHORTEST_LAG_S, Steering, steer_rate
from replan.replay.vehicle.pedal_map import (
    Limits,
    PedalPowertrain,
    is_rolling,
    rolling_acceleration,
)
from replan.replay.vehicle.plan_path import PlanPath, Tracker, path_point
from replan.replay.vehicle.state_records import Motion, Plain, plain

RearRatio = Annotated[
    float, Meta(ge=-1.0, lt=1.0, description="Rear wheel angle per front wheel angle.")
]

MAX_SUBSTEP_S = 0.01
KAPPA_TOLERANCE_PM = 1e-12
"""Tolerance of the start's curvature, 1/m: rounding."""


class BicycleState(NamedTuple):
    """What (1)-(5) integrate: rear axle x, y m; yaw rad; v m/s; front wheel angle rad; throttle,
    brake 0 to 1.
    """

    x: float
    y: float
    yaw: float
    v: float
    steer: float
    throttle: float
    brake: float


class Kinematics(NamedTuple):
    """What the kernels take of a vehicle: wheelbase m, rear_ratio, actuators, drive, longest
    sub-step s.
    """

    wheelbase: float
    rear_ratio: float
    steering: Steering
    throttle_lag: float
    brake_lag: float
    limits: Limits
    substep: float


@kernel
def turn_per_metre(steer: float, car: Kinematics) -> float:
    """Return dyaw / (v dt) of (3), 1/m."""
    return (tan(steer) - tan(car.rear_ratio * steer)) / car.wheelbase


@kernel
def derivative(
    state: BicycleState, command: tuple[float, float, float], rolling: bool, car: Kinematics
) -> BicycleState:
    """(1)-(6): the state's rate; standing still where not `rolling`."""
    speed = state.v if rolling else 0.0
    v_lat = speed * tan(car.rear_ratio * state.steer)
    return BicycleState(
        speed * cos(state.yaw) - v_lat * sin(state.yaw),  # (1)
        speed * sin(state.yaw) + v_lat * cos(state.yaw),  # (2)
        speed * (tan(state.steer) - tan(car.rear_ratio * state.steer)) / car.wheelbase,  # (3)
        # (5)
        rolling_acceleration(state.v, state.throttle, state.brake, car.limits) if rolling else 0.0,
        steer_rate(state.steer, command[0], car.steering),  # (4)
        (command[1] - state.throttle) / car.throttle_lag,
        (command[2] - state.brake) / car.brake_lag,
    )


@inner_kernel
def moved(state: BicycleState, rate: BicycleState, h: float) -> BicycleState:
    """The state after `h` s at a constant rate."""
    return BicycleState(
        state.x + h * rate.x,
        state.y + h * rate.y,
        state.yaw + h * rate.yaw,
        state.v + h * rate.v,
        state.steer + h * rate.steer,
        state.throttle + h * rate.throttle,
        state.brake + h * rate.brake,
    )


@inner_kernel
def runge_kutta(
    state: BicycleState,
    command: tuple[float, float, float],
    rolling: bool,
    car: Kinematics,
    h: float,
) -> BicycleState:
    """One classical step of order 4 over `h` s."""
    k1 = derivative(state, command, rolling, car)
    k2 = derivative(moved(state, k1, 0.5 * h), command, rolling, car)
    k3 = derivative(moved(state, k2, 0.5 * h), command, rolling, car)
    k4 = derivative(moved(state, k3, h), command, rolling, car)
    return moved(moved(moved(moved(state, k1, h / 6.0), k2, h / 3.0), k3, h / 3.0), k4, h / 6.0)


@kernel
def advance(
    state: BicycleState, command: tuple[float, float, float], car: Kinematics, dt: float, steps: int
) -> BicycleState:
    """The state after holding `command` (steer, throttle, brake) for `dt` s, in `steps` equal
    sub-steps.
    """
    h = dt / steps
    for _ in range(steps):
        rolling = is_rolling(state.v, state.throttle, state.brake, car.limits)
        after = runge_kutta(state, command, rolling, car, h)
        if after.v < 0.0:
            until = h * state.v / (state.v - after.v)
            stop = runge_kutta(state, command, True, car, until)
            stop = BicycleState(
                stop.x, stop.y, stop.yaw, 0.0, stop.steer, stop.throttle, stop.brake
            )
            after = runge_kutta(stop, command, False, car, h - until)
        state = after
    return state


@inner_kernel
def state_of(ego: EgoState, actuation: Command) -> BicycleState:
    """The state of a bicycle by the records of its motion and of its actuators."""
    return BicycleState(
        ego.x, ego.y, ego.yaw, ego.v, actuation.steer, actuation.throttle, actuation.brake
    )


@kernel
def motion(s: BicycleState, t: float, car: Kinematics) -> Motion:
    """The ego's motion at `t`."""
    a = 0.0
    if is_rolling(s.v, s.throttle, s.brake, car.limits):
        a = rolling_acceleration(s.v, s.throttle, s.brake, car.limits)
    rear, turn = car.rear_ratio * s.steer, turn_per_metre(s.steer, car)
    kappa = turn * cos(rear)  # (7)
    return t, s.x, s.y, s.yaw, s.v, a, kappa, s.steer, s.v * turn, s.v * tan(rear)


@kernel
def step(
    state: BicycleState, command: tuple[float, float, float], car: Kinematics, t: float, dt: float
) -> tuple[BicycleState, Motion]:
    """State and motion after holding `command` for `dt` s from `t` on; the time is a whole
    nanosecond.
    """
    state = advance(state, command, car, dt, ceil(dt / car.substep - 1e-9))
    return state, motion(state, round((t + dt) * 1e9) / 1e9, car)


class KinematicBicycle:
    """A kinematic bicycle whose steering and pedals lag.

    A `replan.replay.vehicle.base.Vehicle`.

    Args:
        parameters: Of the ego.
        start: Initial motion; steering and pedals are set to match it. It is not driven in
            reverse: a negative speed is taken as 0.
        rear_ratio: As annotated.

    Attributes:
        model: The numbers of (1)-(7); `numbers` likewise, as plain tuples.
        inner: The state of (1)-(5).

    Raises:
        ConfigError: The ratio is out of its range.
    """

    has_rigid_tyres = True
    own_controller: Controller | None = None

    def __init__(
        self, parameters: VehicleParameters, start: EgoState, *, rear_ratio: RearRatio = 0.0
    ) -> None:
        if not -1.0 <= rear_ratio < 1.0:
            raise ConfigError(f"rear_ratio must be at least -1 and below 1, got {rear_ratio}")
        self.powertrain = PedalPowertrain(parameters)
        self.model = kinematics_of(parameters, rear_ratio)
        self.numbers: Plain = plain(self.model)
        v, most = max(float(start.v), 0.0), self.model.steering[0]
        steer = min(
            max(atan(self.model.wheelbase * start.kappa / (1.0 - self.model.rear_ratio)), -most),
            most,
        )
        # Newton from the small-angle solution, to the steering that gives the start's curvature
        for _ in range(20):
            missing = start.kappa - _kappa(steer, self.model)
            if abs(missing) < KAPPA_TOLERANCE_PM:
                break
            slope = (_kappa(steer + 1e-6, self.model) - _kappa(steer - 1e-6, self.model)) / 2e-6
            steer = min(max(steer + missing / slope, -most), most)
        pedals = map(float, steady_pedals(self.powertrain, start.a, v))
        self.inner = BicycleState(
            float(start.x), float(start.y), float(start.yaw), v, float(steer), *pedals
        )
        self.state = EgoState(*motion(self.inner, float(start.t), self.model))

    @property
    def actuation(self) -> Command:
        """Steering and pedals as they are."""
        return Command(self.inner.steer, self.inner.throttle, self.inner.brake)

    def step(self, command: Command, dt: float) -> EgoState:
        """Hold the command for `dt` s."""
        held = (float(command.steer), float(command.throttle), float(command.brake))
        self.inner, after = step(self.inner, held, self.model, self.state.t, dt)
        self.state = EgoState(*after)
        return self.state


REAR_RATIO = -0.2
"""Of "kinematic_rear_steer": the rear wheels turn against the front ones by a fifth.

Few real axles can.
"""
rear_steer = partial(KinematicBicycle, rear_ratio=REAR_RATIO)


def kinematics_of(p: VehicleParameters, rear_ratio: float = 0.0) -> Kinematics:
    """What the kernels take."""
    steering = (
        float(p.max_steer),
        float(p.max_steer_rate),
        max(float(p.steer_lag), SHORTEST_LAG_S),
    )
    lags = (max(float(p.throttle_lag), SHORTEST_LAG_S), max(float(p.brake_lag), SHORTEST_LAG_S))
    substep = min(MAX_SUBSTEP_S, 0.5 * steering[2], 0.5 * min(lags))
    return Kinematics(
        float(p.wheelbase), float(rear_ratio), steering, *lags, PedalPowertrain(p).limits, substep
    )


def _kappa(steer: float, car: Kinematics) -> float:
    return turn_per_metre(steer, car) * cos(car.rear_ratio * steer)  # (7)


class Perfect:
    """Moves exactly along its plan.

    Both a `replan.replay.vehicle.base.Vehicle` and a `replan.replay.vehicle.base.Controller`.

    Args:
        parameters: Of the ego; they limit nothing.
        start: Where it is until its first step.
    """

    has_rigid_tyres = True
    notes: tuple[str, ...] = ()

    def __init__(self, parameters: VehicleParameters, start: EgoState) -> None:
        self.powertrain = PedalPowertrain(parameters)
        self.state = start
        self.actuation = Command(start.steer, 0.0, 0.0)
        self._wheelbase = parameters.wheelbase
        self._tracker = Tracker()
        self._path: PlanPath | None = None

    @property
    def own_controller(self) -> Perfect:
        """Itself."""
        return self

    def control(self, state: EgoState, plan: Plan) -> Command:
        """Set the plan to follow; return the command that would drive it."""
        self._path = self._tracker.path(plan)
        planned = self._on_path(self._path, state.t)
        return Command(planned.steer, *steady_pedals(self.powertrain, planned.a, planned.v))

    def step(self, command: Command, dt: float) -> EgoState:
        """Move to the plan's state `dt` s later; the command has no effect.

        Raises:
            RuntimeError: It has no plan yet.
        """
        if self._path is None:
            raise RuntimeError("the perfect vehicle needs a plan (`control`) before its first step")
        self.state = self._on_path(self._path, round((self.state.t + dt) * 1e9) / 1e9)
        self.actuation = command
        return self.state

    def _on_path(self, path: PlanPath, t: float) -> EgoState:
        station, v, a = path.timed(t)
        x, y, yaw, kappa = path_point(path.knots, station)
        return EgoState(t, x, y, yaw, v, a, kappa, atan(self._wheelbase * kappa), v * kappa)
