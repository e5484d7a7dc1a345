"""The kinematic bicycle at the rear axle, with steering and pedals that lag.

(1) dx/dt   = v cos(yaw) - v_lat sin(yaw)
(2) dy/dt   = v sin(yaw) + v_lat cos(yaw),        v_lat = v tan(rear)
(3) dyaw/dt = v (tan(steer) - tan(rear)) / wheelbase
(4) d(steer)/dt                                   replay.vehicle.steering
(5) dv/dt, d(throttle)/dt, d(brake)/dt            replay.vehicle.powertrain

The rear wheel angle is rear = rear_ratio steer: 0 here, so that v_lat = 0 and dyaw/dt = v tan(steer) / wheelbase =
v kappa; not 0 in `replay.vehicle.kinematic_rear_steer`, which the kernels serve as well.

Wheels roll without slip (Rajamani, Vehicle Dynamics and Control, 2.2; the reference point at the rear axle makes its
slip angle 0): there is no friction limit in it, so it follows any curvature at any speed.

Integration: Runge-Kutta of order 4 in sub-steps of at most 10 ms and at most half the shortest lag. Coming to a stand
is an event within the sub-step: until then it rolls, from then on it stands.
"""

from __future__ import annotations

from math import atan, ceil, cos, sin, tan

from logs.kernel import kernel
from logs.states import Command, EgoState
from logs.vehicle import VehicleParameters
from replay.vehicle.powertrain import Limits, PedalPowertrain, is_rolling, rolling_acceleration
from replay.vehicle.steering import Steering, steer_rate

MAX_SUBSTEP_S = 0.01
SHORTEST_LAG_S = 1e-3
"""A lag of zero is driven as this."""

State = tuple[float, float, float, float, float, float, float]
"""x, y, yaw, v, steer, throttle, brake."""
Geometry = tuple[float, float]
"""Wheelbase m, rear_ratio."""


@kernel
def yaw_rate(v: float, steer: float, geometry: Geometry) -> float:
    """(3), rad/s."""
    return v * (tan(steer) - tan(geometry[1] * steer)) / geometry[0]


@kernel
def derivative(
    state: State, command: tuple[float, float, float], rolling: bool, geometry: Geometry, steering: Steering,
    lags: tuple[float, float], limits: Limits,
) -> State:  # fmt: skip
    """(1)-(5): the state's rate; standing still where not `rolling`."""
    _, _, yaw, v, steer, throttle, brake = state
    speed = v if rolling else 0.0
    v_lat = speed * tan(geometry[1] * steer)
    return (
        speed * cos(yaw) - v_lat * sin(yaw),
        speed * sin(yaw) + v_lat * cos(yaw),
        yaw_rate(speed, steer, geometry),
        rolling_acceleration(v, throttle, brake, limits) if rolling else 0.0,
        steer_rate(steer, command[0], steering),
        (command[1] - throttle) / lags[0],
        (command[2] - brake) / lags[1],
    )


@kernel
def moved(state: State, rate: State, h: float) -> State:
    """The state after `h` s at a constant rate."""
    return (
        state[0] + h * rate[0], state[1] + h * rate[1], state[2] + h * rate[2], state[3] + h * rate[3],
        state[4] + h * rate[4], state[5] + h * rate[5], state[6] + h * rate[6],
    )  # fmt: skip


@kernel
def runge_kutta(
    state: State, command: tuple[float, float, float], rolling: bool, geometry: Geometry, steering: Steering,
    lags: tuple[float, float], limits: Limits, h: float,
) -> State:  # fmt: skip
    """One classical step of order 4 over `h` s."""
    k1 = derivative(state, command, rolling, geometry, steering, lags, limits)
    k2 = derivative(moved(state, k1, 0.5 * h), command, rolling, geometry, steering, lags, limits)
    k3 = derivative(moved(state, k2, 0.5 * h), command, rolling, geometry, steering, lags, limits)
    k4 = derivative(moved(state, k3, h), command, rolling, geometry, steering, lags, limits)
    return moved(moved(moved(moved(state, k1, h / 6.0), k2, h / 3.0), k3, h / 3.0), k4, h / 6.0)


@kernel
def advance(
    state: State, command: tuple[float, float, float], geometry: Geometry, steering: Steering,
    lags: tuple[float, float], limits: Limits, dt: float, steps: int,
) -> State:  # fmt: skip
    """The state after holding `command` (steer, throttle, brake) for `dt` s, in `steps` equal sub-steps."""
    h = dt / steps
    for _ in range(steps):
        rolling = is_rolling(state[3], state[5], state[6], limits)
        after = runge_kutta(state, command, rolling, geometry, steering, lags, limits, h)
        if after[3] < 0.0:
            until = h * state[3] / (state[3] - after[3])
            stop = runge_kutta(state, command, True, geometry, steering, lags, limits, until)
            stop = (stop[0], stop[1], stop[2], 0.0, stop[4], stop[5], stop[6])
            after = runge_kutta(stop, command, False, geometry, steering, lags, limits, h - until)
        state = after
    return state


class KinematicBicycle:
    """The model above; see `replay.vehicle.base.Vehicle`.

    Args:
        parameters: Of the ego.
        start: Where and how it moves at first; steering and pedals are set as that takes. It is not driven in
            reverse: a negative speed is taken as 0.
    """

    def __init__(self, parameters: VehicleParameters, start: EgoState) -> None:
        p = parameters
        self.powertrain = PedalPowertrain(p)
        self._geometry: Geometry = (float(p.wheelbase), 0.0)
        self._steering: Steering = (float(p.max_steer), float(p.max_steer_rate), max(p.steer_lag, SHORTEST_LAG_S))
        self._lags = (max(p.throttle_lag, SHORTEST_LAG_S), max(p.brake_lag, SHORTEST_LAG_S))
        self._limits = self.powertrain.limits
        self._substep = min(MAX_SUBSTEP_S, 0.5 * self._steering[2], 0.5 * min(self._lags))
        self._state = _initial(p, self.powertrain, start)
        self._t = start.t
        self.state = self._ego_state()

    @property
    def actuation(self) -> Command:
        """Steering and pedals as they are."""
        return Command(*self._state[4:])

    def step(self, command: Command, dt: float) -> EgoState:
        """Hold the command for `dt` s."""
        steps = ceil(dt / self._substep - 1e-9)
        self._state = advance(
            self._state, (float(command.steer), float(command.throttle), float(command.brake)),
            self._geometry, self._steering, self._lags, self._limits, dt, steps,
        )  # fmt: skip
        self._t = round((self._t + dt) * 1e9) / 1e9
        self.state = self._ego_state()
        return self.state

    def _ego_state(self) -> EgoState:
        x, y, yaw, v, steer, throttle, brake = self._state
        rolling = is_rolling(v, throttle, brake, self._limits)
        a = rolling_acceleration(v, throttle, brake, self._limits) if rolling else 0.0
        kappa = tan(steer) / self._geometry[0]
        return EgoState(self._t, x, y, yaw, v, a, kappa, steer, v * kappa, 0.0)


def _initial(p: VehicleParameters, train: PedalPowertrain, start: EgoState) -> State:
    """Steering that gives the start's curvature, pedals that give its acceleration, within their limits."""
    v = max(start.v, 0.0)
    steer = min(max(atan(p.wheelbase * start.kappa), -p.max_steer), p.max_steer)
    wanted = start.a - train.coasting(v)
    throttle = min(max(wanted / train.full_throttle(v), 0.0), 1.0)
    brake = min(max(-wanted / train.full_brake(v), 0.0), 1.0)
    return float(start.x), float(start.y), float(start.yaw), float(v), float(steer), float(throttle), float(brake)
