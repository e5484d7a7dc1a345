"""A vehicle model from scratch: an electric car with one-pedal driving.

    replan evaluate LOG --vehicle electric_car:Electric --controller mpc

The protocol is `replan.replay.vehicle.base.Vehicle`. SI units; the state is that of the rear axle.
"""

from math import cos, sin, tan

import numpy as np

from replan import Command, EgoState
from replan.replay.vehicle.pedal_map import SPEED_STEP_MPS, coasting, full_throttle, pedal_map


class Motor:
    """The powertrain: 25 W/kg, at most 3 m/s2; without throttle it brakes by up to 0.5 m/s2
    (one-pedal driving).

    The functions are made of the `pedal_map`, which compiled controllers read: so both agree.
    """

    def __init__(self, parameters):
        v = SPEED_STEP_MPS * np.arange(240)  # m/s; the last entry holds beyond
        # m/s2
        most, overrun = np.minimum(3.0, 25.0 / np.maximum(v, 1e-3)), np.minimum(0.5, 0.1 * v)
        # rolling, drag, brakes and lags: the parameters'
        self.pedal_map = pedal_map(parameters, most, overrun, 0.0)

    def coasting(self, v):
        """Acceleration without pedals at the speed v."""
        return coasting(self.pedal_map, v)

    def full_throttle(self, v):
        """What full throttle adds to it."""
        return full_throttle(self.pedal_map, v)

    def full_brake(self, v):
        """What the full brake takes from it."""
        return self.pedal_map.max_decel


class Electric:
    """A bicycle without lag; one Euler step per call."""

    has_rigid_tyres, own_controller = True, None

    def __init__(self, parameters, start):
        self.parameters, self.powertrain = parameters, Motor(parameters)
        self.state, self.actuation = start, Command(start.steer, 0.0, 0.0)

    def step(self, command, dt):
        """The state after dt with this command."""
        now, car, motor = self.state, self.parameters, self.powertrain
        steer = min(max(command.steer, -car.max_steer), car.max_steer)
        pedals = command.throttle * motor.full_throttle(now.v) - command.brake * motor.full_brake(
            now.v
        )
        v = max(now.v + (motor.coasting(now.v) + pedals) * dt, 0.0)
        a, kappa = (v - now.v) / dt, tan(steer) / car.wheelbase
        x, y, yaw = (
            now.x + v * cos(now.yaw) * dt,
            now.y + v * sin(now.yaw) * dt,
            now.yaw + v * kappa * dt,
        )
        t = round((now.t + dt) * 1e9) / 1e9  # a whole nanosecond
        self.actuation = Command(steer, command.throttle, command.brake)
        self.state = EgoState(t, x, y, yaw, v, a, kappa, steer, v * kappa)
        return self.state
