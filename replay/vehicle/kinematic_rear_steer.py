"""The kinematic bicycle whose rear wheels steer as well: the paper's equation 1, corrected.

With front and rear wheel angles df and dr, speed v along the body, wheelbase L; no wheel slips sideways:

(1) v_lat = v tan(dr)                                     at the rear axle, the reference point
(2) dx/dt = v cos(yaw) - v_lat sin(yaw),  dy/dt = v sin(yaw) + v_lat cos(yaw)
(3) dyaw/dt = v (tan(df) - tan(dr)) / L
(4) dr = rear_ratio df                                    geared; negative: against each other, turns more tightly

At the centre of gravity (lf, lr to the axles) the same motion reads x' = V cos(yaw + beta), y' = V sin(yaw + beta),
yaw' = V cos(beta) (tan df - tan dr) / L with beta = atan((lf tan dr + lr tan df) / L), v = V cos(beta). The paper has
yaw = V (tan df + tan dr) / L: the dot, cos(beta) and the sign of the rear wheels are missing; its wheels would slip.

Otherwise as `replay.vehicle.kinematic_bicycle`, whose state and kernels these are.
"""

from __future__ import annotations

from math import atan, ceil, cos, tan

from logs.errors import ConfigError
from logs.states import Command, EgoState
from logs.vehicle import VehicleParameters
from replay.vehicle.kinematic_bicycle import MAX_SUBSTEP_S, SHORTEST_LAG_S, Geometry, State, advance, yaw_rate
from replay.vehicle.powertrain import PedalPowertrain, is_rolling, rolling_acceleration
from replay.vehicle.steering import Steering


class KinematicRearSteer:
    """The model above; see `replay.vehicle.base.Vehicle`.

    The state's curvature is that of a path driven with the wheels held where they are.

    Args:
        parameters: Of the ego.
        start: Where and how it moves at first; steering and pedals are set as that takes. Not driven in reverse.
        rear_ratio: Rear wheel angle per front wheel angle, from -1 to below 1.

    Raises:
        ConfigError: The ratio is out of its range.
    """

    def __init__(self, parameters: VehicleParameters, start: EgoState, *, rear_ratio: float = -0.2) -> None:
        if not -1.0 <= rear_ratio < 1.0:
            raise ConfigError(f"rear_ratio must be at least -1 and below 1, got {rear_ratio}")
        p = parameters
        self.powertrain = PedalPowertrain(p)
        self._geometry: Geometry = (float(p.wheelbase), float(rear_ratio))
        self._steering: Steering = (float(p.max_steer), float(p.max_steer_rate), max(p.steer_lag, SHORTEST_LAG_S))
        self._lags = (max(p.throttle_lag, SHORTEST_LAG_S), max(p.brake_lag, SHORTEST_LAG_S))
        self._limits = self.powertrain.limits
        self._substep = min(MAX_SUBSTEP_S, 0.5 * self._steering[2], 0.5 * min(self._lags))
        self._state = self._initial(start)
        self._t = start.t
        self.state = self._ego_state()

    @property
    def actuation(self) -> Command:
        """Steering and pedals as they are."""
        return Command(*self._state[4:])

    def step(self, command: Command, dt: float) -> EgoState:
        """Hold the command for `dt` s."""
        self._state = advance(
            self._state, (float(command.steer), float(command.throttle), float(command.brake)),
            self._geometry, self._steering, self._lags, self._limits, dt, ceil(dt / self._substep - 1e-9),
        )  # fmt: skip
        self._t = round((self._t + dt) * 1e9) / 1e9
        self.state = self._ego_state()
        return self.state

    def _initial(self, start: EgoState) -> State:
        v, train = max(float(start.v), 0.0), self.powertrain
        steer = atan(self._geometry[0] * start.kappa / (1.0 - self._geometry[1]))
        for _ in range(20):  # Newton from the small-angle solution
            slope = (self._kappa(steer + 1e-6) - self._kappa(steer - 1e-6)) / 2e-6
            steer = min(max(steer + (start.kappa - self._kappa(steer)) / slope, -self._steering[0]), self._steering[0])
        wanted = start.a - train.coasting(v)
        throttle = min(max(wanted / train.full_throttle(v), 0.0), 1.0)
        brake = min(max(-wanted / train.full_brake(v), 0.0), 1.0)
        return float(start.x), float(start.y), float(start.yaw), v, float(steer), float(throttle), float(brake)

    def _kappa(self, steer: float) -> float:
        return yaw_rate(1.0, steer, self._geometry) * cos(self._geometry[1] * steer)

    def _ego_state(self) -> EgoState:
        x, y, yaw, v, steer, throttle, brake = self._state
        rolling = is_rolling(v, throttle, brake, self._limits)
        a = rolling_acceleration(v, throttle, brake, self._limits) if rolling else 0.0
        v_lat = v * tan(self._geometry[1] * steer)
        rate = yaw_rate(v, steer, self._geometry)
        return EgoState(self._t, x, y, yaw, v, a, self._kappa(steer), steer, rate, v_lat)
