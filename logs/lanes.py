"""Where a drive is with respect to lanes and stop lines: what judges, traffic and whoever else asks agree on.

A point with a heading is on a lane, and drives along it, where it lies in the lane's outline and its heading is within
`ASKEW_RAD` of the piece of the centre line whose middle is nearest.
"""

from __future__ import annotations

from math import atan2, hypot, inf, pi

import numpy as np

from logs.kernel import BoolArray, FloatArray, kernel
from logs.road import Lane, inside
from logs.states import wrap

ASKEW_RAD = 0.25 * pi
"""Who drives along a lane is askew to it by less than this."""
ASIDE_M = 0.5
"""A stop line is crossed up to this far beside its ends."""
BEHIND_M = 40.0
"""So far behind a stop line the way is looked at, to tell whether the line counts for it."""


def on_lane(lane: Lane, x: FloatArray, y: FloatArray, yaw: FloatArray) -> BoolArray:
    """Which points `(k,)` with a heading are on a lane and drive along it (module docstring)."""
    return _on_lane(lane.center, lane.polygon, *(np.ascontiguousarray(column, np.float64) for column in (x, y, yaw)))


@kernel
def _on_lane(center: FloatArray, polygon: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray) -> BoolArray:
    out = np.zeros(len(x), np.bool_)
    low_x, high_x = polygon[:, 0].min(), polygon[:, 0].max()
    low_y, high_y = polygon[:, 1].min(), polygon[:, 1].max()
    for k in range(len(x)):
        if not (low_x <= x[k] <= high_x and low_y <= y[k] <= high_y) or not inside(x[k], y[k], polygon):
            continue
        nearest, heading = inf, 0.0
        for i in range(len(center) - 1):
            middle_x, middle_y = 0.5 * (center[i + 1, 0] + center[i, 0]), 0.5 * (center[i + 1, 1] + center[i, 1])
            away = hypot(middle_x - x[k], middle_y - y[k])
            if away < nearest:
                nearest, heading = away, atan2(center[i + 1, 1] - center[i, 1], center[i + 1, 0] - center[i, 0])
        out[k] = abs(wrap(yaw[k] - heading)) < ASKEW_RAD
    return out
