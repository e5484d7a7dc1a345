"""The names of fields in a file: the name in code plus its unit."""

from __future__ import annotations

UNITS = {
    "log_time": "ns",
    "t": "s",
    "x": "m",
    "y": "m",
    "yaw": "rad",
    "v": "mps",
    "a": "mps2",
    "kappa": "per_m",
    "vx": "mps",
    "vy": "mps",
    "length": "m",
    "width": "m",
    "left_x": "m",
    "left_y": "m",
    "right_x": "m",
    "right_y": "m",
    "speed_limit": "mps",
    "default_speed_limit": "mps",
    "steer": "rad",
    "lateral": "m",
    "heading": "rad",
    "speed": "mps",
    "station": "m",
    "wheelbase": "m",
    "rear_overhang": "m",
    "mass": "kg",
    "yaw_inertia": "kgm2",
    "cog_to_front": "m",
    "cornering_front": "n_per_rad",
    "cornering_rear": "n_per_rad",
    "max_steer": "rad",
    "max_steer_rate": "radps",
    "steer_lag": "s",
    "max_accel": "mps2",
    "max_power": "w_per_kg",
    "max_decel": "mps2",
    "throttle_lag": "s",
    "brake_lag": "s",
    "drag": "per_m",
    "rolling": "mps2",
    "cog_height": "m",
    "brake_delay": "s",
    "wheel_radius": "m",
    "motor_speed": "radps",
    "motor_torque": "nm",
    "motor_overrun": "nm",
    "shift_time": "s",
    "begin": "s",
    "end": "s",
    "way": "m",
}
"""Unit of each name in code; a name that is not here has none."""


def serialised(name: str) -> str:
    """The name in the file: name in code plus unit."""
    return f"{name}_{UNITS[name]}" if name in UNITS else name
