"""Finds which point of the ego the positions of a log are, from the drive itself.

The rear axle moves along the heading; a point d before it also moves sideways. In each window:

(1) sideways = d 2 sin(turn / 2)

A delay of the headings gives the same with d in proportion to the speed.
"""

from __future__ import annotations

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.ego_columns import Windows

TURNS_RAD = 0.5
"""Sum of turns that a drive needs to show which point its positions are, rad."""


def place_ahead(
    t: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray
) -> tuple[float, float]:
    """Return how far positions `(n,)` are before the rear axle, m, and the share of their sideways
    motion that this explains, 0 to 1; (0, 0) if the drive does not show it.

    It is (0, 0), too, if a delay of the headings explains more than (1).
    """
    windows, yaw = Windows.of(t), np.unwrap(yaw)
    middle = 0.5 * (yaw[windows.first] + yaw[windows.last])
    dx, dy = windows.change(x), windows.change(y)
    sideways = dy * np.cos(middle) - dx * np.sin(middle)
    along = dx * np.cos(middle) + dy * np.sin(middle)
    turn = 2.0 * np.sin(0.5 * windows.change(yaw))
    if np.abs(turn).sum() < TURNS_RAD:
        return 0.0, 0.0
    ahead, explained = _explained(sideways, turn)
    _, by_delay = _explained(sideways, turn * along / windows.change(t))
    return (ahead, explained) if explained >= by_delay else (0.0, 0.0)


def _explained(values: FloatArray, cause: FloatArray) -> tuple[float, float]:
    """Return the factor of a cause `(k,)` that fits the values best, and the share of their squares
    that it explains.
    """
    size, total = float((cause**2).sum()), float((values**2).sum())
    if not size > 0.0 or not total > 0.0:
        return 0.0, 0.0
    factor = float((values * cause).sum()) / size
    return factor, 1.0 - float(((values - factor * cause) ** 2).sum()) / total
