"""A prediction: all agents brake."""

import numpy as np

from replan import Predictions


def stopping(agents, t, lanes, *, decel_mps2: float = 2.0):
    """All agents brake."""
    speed, dt = np.hypot(agents.vx, agents.vy)[:, None], (t - t[0])[None, :]
    dt = np.minimum(dt, speed / decel_mps2)
    share = dt - 0.5 * decel_mps2 * dt**2 / np.maximum(speed, 1e-9)
    x, y = (
        agents.x[:, None] + share * agents.vx[:, None],
        agents.y[:, None] + share * agents.vy[:, None],
    )
    yaw = np.repeat(agents.yaw[:, None], len(t), axis=1)
    return Predictions(t, np.arange(len(agents)), np.ones(len(agents)), x, y, yaw, "stopping")
