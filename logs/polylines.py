"""Polylines and polygons: nearest points, fewer or more points, points inside."""

from __future__ import annotations

from math import hypot, inf

import numpy as np

from replan.core.arrays import TIE, BoolArray, FloatArray, IntArray, arc_lengths
from replan.core.kernel import kernel
from replan.logs.shapes import point_segment

LAP_M = 1.0
"""Two laps of a lane that are this far apart, or less, are one place, m."""


def nearest(points: FloatArray, x: float, y: float) -> int:
    """Return the index of the point `(n, 2)` nearest to (x, y).

    Of equally near points, the first.
    """
    away = np.hypot(points[:, 0] - x, points[:, 1] - y)
    return int(np.argmax(away <= away.min() + TIE))


def thinned(points: FloatArray, spacing: float) -> FloatArray:
    """Drop points of the polyline `(n, 2)` nearer than `spacing` m to the last kept one; keep the
    first and last point.

    Only consecutive points are compared, so closed loops remain. A line shorter than `spacing`
    becomes one point.
    """
    rows = _far_apart(np.ascontiguousarray(points, np.float64), spacing).tolist()
    left_over = hypot(*(points[-1] - points[rows[-1]]))
    if len(rows) > 1 and 0.0 < left_over < 0.5 * spacing - TIE:
        rows[-1] = len(points) - 1
    elif len(rows) > 1 and left_over > 0.0:
        rows.append(len(points) - 1)
    return np.asarray(points[rows])


def paired(left: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Resample both lines at the union of their relative arc lengths: corners remain, and point i
    faces point i.
    """
    lines = left, right
    chords = [arc_lengths(*line.T) for line in lines]
    shares = [chord / chord[-1] for chord in chords]
    union = np.union1d(*(np.round(share, 9) for share in shares))
    new_left, new_right = (
        np.column_stack([np.interp(union, share, column) for column in line.T])
        for share, line in zip(shares, lines, strict=True)
    )
    return new_left, new_right


@kernel
def _far_apart(points: FloatArray, spacing: float) -> IntArray:
    """Return the indices of the first point `(n, 2)`, and of each at least `spacing` from the last
    chosen one.
    """
    rows, count = np.zeros(len(points), np.int64), 1
    for i in range(1, len(points)):
        last = rows[count - 1]
        if hypot(points[i, 0] - points[last, 0], points[i, 1] - points[last, 1]) >= spacing - TIE:
            rows[count] = i
            count += 1
    return rows[:count]


def sampled(line: FloatArray) -> FloatArray:
    """Return a line `(n, 2)` with further points, so that there is one every 1 m."""
    chord = arc_lengths(*line.T)
    stations = np.union1d(chord, np.arange(0.0, chord[-1], 1.0))
    return np.column_stack([np.interp(stations, chord, column) for column in line.T])


def first_nearest(line: FloatArray, x: float, y: float) -> int:
    """Return the index of the point of a line `(n, 2)` nearest to (x, y).

    Of several laps, on the first one.
    """
    away = np.hypot(line[:, 0] - x, line[:, 1] - y)
    near = away <= away.min() + LAP_M
    first = int(np.argmax(near))
    end = first + int(np.argmin(near[first:])) if not near[first:].all() else len(line)
    return first + int(np.argmin(away[first:end]))


def bounds(points: FloatArray) -> tuple[float, float, float, float]:
    """Return least x, y, greatest x, y of points `(n, 2)`."""
    return (*points.min(axis=0).tolist(), *points.max(axis=0).tolist())


@kernel
def inside(x: float, y: float, polygon: FloatArray) -> bool:
    """Whether a point lies in a simple polygon `(n, 2)` (even-odd rule)."""
    is_inside = False
    j = len(polygon) - 1
    for i in range(len(polygon)):
        xi, yi = polygon[i, 0], polygon[i, 1]
        xj, yj = polygon[j, 0], polygon[j, 1]
        if (yi > y) != (yj > y) and x < (xj - xi) * (y - yi) / (yj - yi) + xi:
            is_inside = not is_inside
        j = i
    return is_inside


def points_inside(polygon: FloatArray, x: FloatArray, y: FloatArray) -> BoolArray:
    """Return which points `(n,)` lie in a polygon `(k, 2)`.

    Its bounding box excludes most points early.
    """
    x_lo, y_lo, x_hi, y_hi = bounds(polygon)
    within = (x >= x_lo) & (x <= x_hi) & (y >= y_lo) & (y <= y_hi)
    points = zip(x[within].tolist(), y[within].tolist(), strict=True)
    within[within] = [inside(*point, polygon) for point in points]
    return np.asarray(within)


@kernel
def along_line(line: FloatArray, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the station of the nearest point of a polyline `(n, 2)` to each point `(k,)`, and the
    distance, m.
    """
    stations, distances = np.zeros(len(x)), np.full(len(x), inf)
    for k in range(len(x)):
        begin = 0.0
        for j in range(len(line) - 1):
            ax, ay = line[j, 0], line[j, 1]
            bx, by = line[j + 1, 0], line[j + 1, 1]
            length = hypot(bx - ax, by - ay)
            distance = point_segment(x[k], y[k], ax, ay, bx, by)
            if distance < distances[k] and length > 0.0:
                along = ((x[k] - ax) * (bx - ax) + (y[k] - ay) * (by - ay)) / length
                distances[k], stations[k] = distance, begin + min(max(along, 0.0), length)
            begin += length
    return stations, distances
