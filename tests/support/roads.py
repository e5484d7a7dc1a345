"""Small roads for the tests of planners: polylines, and lanes along them."""

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.road import Lane, Road


def curve(*pieces: tuple[float, float], step: float = 1.0) -> FloatArray:
    """Points `(n, 2)` of arcs `(length, curvature)` from the origin along x."""
    kappa = np.concatenate([np.full(round(length / step), k) for length, k in pieces])
    yaw = np.r_[0.0, np.cumsum(kappa * step)]
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    return np.vstack(
        [[0.0, 0.0], np.cumsum(step * np.column_stack([np.cos(middle), np.sin(middle)]), axis=0)]
    )


def along_x(begin: float = -50.0, end: float = 400.0) -> FloatArray:
    x = np.arange(begin, end + 1.0, 2.0)
    return np.column_stack([x, np.zeros(len(x))])


def beside(points: FloatArray, left: float) -> FloatArray:
    """The polyline `left` m to the left of another."""
    tangent = np.gradient(points, axis=0)
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]]) / np.hypot(*tangent.T)[:, None]
    return points + left * normal


def strip(
    lane_id: int, points: FloatArray, left: float = 1.75, right: float = -1.75, **more: object
) -> Lane:
    """A lane along a polyline, from `right` to `left` of it."""
    return Lane(lane_id, beside(points, left), beside(points, right), **more)  # type: ignore[arg-type]


def lanes(
    points: FloatArray,
    count: int = 1,
    *,
    width: float = 3.5,
    limit: float = 13.89,
    right: bool = True,
) -> Road:
    """Lanes 0, 1, ... in one direction, the first on the polyline, the others to its left."""
    found = [
        strip(
            i,
            points,
            width * (i + 0.5),
            width * (i - 0.5),
            speed_limit=limit,
            left_neighbour=i + 1 if i + 1 < count else None,
            right_neighbour=i - 1 if i else None,
        )
        for i in range(count)
    ]
    return Road({lane.id: lane for lane in found}, drives_on_right=right)


def two_way(*, crossable: bool = True, right: bool = True) -> Road:
    """A lane along x and one back to its left (to its right where traffic drives on the left)."""
    side = 1.0 if right else -1.0
    marks = {"left_opposite": right, "right_opposite": not right, "speed_limit": 10.0}
    marks["left_crossable" if right else "right_crossable"] = crossable
    there, back = along_x(), along_x()[::-1] + np.array([0.0, side * 3.5])
    return Road({0: strip(0, there, **marks), 1: strip(1, back, **marks)}, drives_on_right=right)
