"""A controller: it knows the plan, the ego's state, the vehicle's numbers and its powertrain, but
not the world.
"""

from math import atan, sin

from replan import Command


class Proportional:
    """Steers by curvature, lateral error and heading error.

    Brakes and accelerates in proportion.
    """

    notes = ()

    def __init__(self, parameters, powertrain, period, *, gain: float = 0.1):
        self.wheelbase, self.powertrain, self.gain = parameters.wheelbase, powertrain, gain

    def control(self, state, plan):
        """Return the command at the state's time."""
        want = plan.trajectory.at(state.t)
        left = (state.y - want.y) * sin(want.yaw + 1.5708) + (state.x - want.x) * sin(-want.yaw)
        steer = atan(self.wheelbase * want.kappa) - self.gain * left - (state.yaw - want.yaw)
        a = want.a + 2.0 * (want.v - state.v) - self.powertrain.coasting(state.v)
        pedal = a / (
            self.powertrain.full_throttle(state.v)
            if a > 0.0
            else self.powertrain.full_brake(state.v)
        )
        return Command(steer, min(max(pedal, 0.0), 1.0), min(max(-pedal, 0.0), 1.0))
