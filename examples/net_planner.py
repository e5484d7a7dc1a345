"""A planner whose model is loaded once per worker, and which plans the frames of several logs in
one pass.

    replan evaluate LOG LOG --planner net_planner:Net --set loop.apart.batch=2

The network is random: it shows where yours goes (docs/bring_planner.md).
"""

import numpy as np

from replan import Plan, Trajectory


class Net:
    """Drives straight on with the acceleration of a network."""

    weights = ()

    @classmethod
    def prepare(cls, *, seed: int = 0):
        """Load the model, once before any drive: read your file here, on the CPU, and close it."""
        random = np.random.default_rng(seed)
        cls.weights = (random.normal(size=(3, 16)), random.normal(size=16))

    def __init__(self, context, *, seed: int = 0):
        self.t = np.linspace(0.0, context.horizon, 81)

    def plan(self, frame):
        """One frame is a batch of one."""
        return self.plan_batch([frame], [self])[0]

    @classmethod
    def plan_batch(cls, frames, planners):
        """The plans of the frames of all logs, in one pass."""
        first, last = cls.weights
        seen = np.array([[frame.ego.v, frame.ego.a, len(frame.agents.ids)] for frame in frames])
        accel = np.tanh(np.tanh(0.1 * seen @ first) @ last)
        return [
            planner.rolled(frame, a)
            for planner, frame, a in zip(planners, frames, accel, strict=True)
        ]

    def rolled(self, frame, accel):
        """The plan with a constant acceleration, m/s2, until the ego stands."""
        ego, t, still = frame.ego, self.t, np.zeros(len(self.t))
        v = np.maximum(ego.v + accel * t, 0.0)
        s = np.r_[0.0, np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t))]
        x, y = ego.x + s * np.cos(ego.yaw), ego.y + s * np.sin(ego.yaw)
        return Plan(
            Trajectory(frame.t + t, x, y, still + ego.yaw, v, np.where(v > 0.0, accel, 0.0), still)
        )
