"""A vehicle model: the kinematic bicycle with delayed commands."""

from collections import deque

from replan.replay.vehicle.kinematic_bicycle import KinematicBicycle


class Late:
    """A kinematic bicycle with delayed commands."""

    def __init__(self, parameters, start, *, delay_s: float = 0.05):
        self.car, self.delay_s = KinematicBicycle(parameters, start), delay_s
        self.waiting = deque()

    def __getattr__(self, name):  # state, actuation, powertrain ... are the bicycle's
        return getattr(self.car, name)

    def step(self, command, dt):
        """Drive `dt` seconds, with the command of `delay_s` ago."""
        self.waiting.append(command)
        late = (
            self.waiting.popleft() if len(self.waiting) * dt > self.delay_s else self.car.actuation
        )
        return self.car.step(late, dt)
