"""The steering actuator: a first-order lag with a rate limit.

(1) d(steer)/dt = clip((command - steer) / lag, -max_rate, max_rate)      |command| <= max_steer
"""

from __future__ import annotations

from logs.kernel import kernel

Steering = tuple[float, float, float]
"""max_steer rad, max_steer_rate rad/s, steer_lag s of VehicleParameters: what the kernel takes."""


@kernel
def steer_rate(steer: float, command: float, steering: Steering) -> float:
    """Rate of the front wheel angle, rad/s."""
    max_steer, max_rate, lag = steering
    wanted = (min(max(command, -max_steer), max_steer) - steer) / lag
    return min(max(wanted, -max_rate), max_rate)  # (1)
