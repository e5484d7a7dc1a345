"""The reference line and its Frenet frame.

A reference line is a C2 cubic spline r(s) through points at arc-length stations, so that |r'| = 1
up to the spline's error and the frame is smooth. Frenet coordinates (s, l), l to the left (Werling
et al., ICRA 2010):

(1) p = r(s) + l n(s),  with  (p - r(s)) . r'(s) = 0        n = r' turned left by 90 degrees
(2) kappa = (x' y'' - y' x'') / |r'|^3
(3) The frame is regular where 1 - kappa l > 0;
        a foot point with 1 - kappa l <= 0 is a maximum of the distance, not the nearest point.

Projection is windowed by a guess of s: a line that comes near itself (a loop, a roundabout) has
several feet.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import atan2, floor, inf, sqrt

import numpy as np

from replan.core.arrays import TIE, FloatArray, arc_lengths, frozen
from replan.core.kernel import inner_kernel, kernel

X3, X2, X1, X0, Y3, Y2, Y1, Y0 = range(8)
"""Columns of the coefficients of a spline: those of x, then of y, with the powers of s."""
FARTHEST_M = 1e4
"""A foot beyond the ends of a line is at most this far from them, m."""


@inner_kernel
def line_point(
    knots: FloatArray, coef: FloatArray, s: float
) -> tuple[float, float, float, float, float, float]:
    """r, r', r'' of the spline at station `s` (m): x, y, x', y', x'', y''.

    Args:
        knots: Stations `(n,)`, uniformly spaced.
        coef: `(n-1, 8)`: cubic coefficients of x then y, highest power first.
        s: Station; outside the stations, the line continues straight.
    """
    h = knots[1] - knots[0]
    last = len(knots) - 1
    clipped = min(max(s, knots[0]), knots[last])
    i = min(max(int((clipped - knots[0]) / h), 0), last - 1)
    u = clipped - knots[i]
    c = coef[i]
    x = ((c[X3] * u + c[X2]) * u + c[X1]) * u + c[X0]
    y = ((c[Y3] * u + c[Y2]) * u + c[Y1]) * u + c[Y0]
    dx = (3.0 * c[X3] * u + 2.0 * c[X2]) * u + c[X1]
    dy = (3.0 * c[Y3] * u + 2.0 * c[Y2]) * u + c[Y1]
    if s != clipped:
        return x + (s - clipped) * dx, y + (s - clipped) * dy, dx, dy, 0.0, 0.0
    return x, y, dx, dy, 6.0 * c[X3] * u + 2.0 * c[X2], 6.0 * c[Y3] * u + 2.0 * c[Y2]


@kernel
def line_frame(knots: FloatArray, coef: FloatArray, s: float) -> tuple[float, float, float, float]:
    """x, y, yaw, kappa (2) of the line at station `s`."""
    x, y, dx, dy, ddx, ddy = line_point(knots, coef, s)
    speed = sqrt(dx * dx + dy * dy)
    return x, y, atan2(dy, dx), (dx * ddy - dy * ddx) / (speed * speed * speed)


@kernel
def line_frames(knots: FloatArray, coef: FloatArray) -> FloatArray:
    """Rows x, y, yaw, kappa `(4, n)` of the line at its stations."""
    frames = np.empty((4, len(knots)))
    for i in range(len(knots)):
        x, y, yaw, kappa = line_frame(knots, coef, knots[i])
        frames[0, i], frames[1, i] = x, y
        frames[2, i], frames[3, i] = yaw, kappa
    return frames


@inner_kernel
def line_curvature(knots: FloatArray, coef: FloatArray, s: float) -> float:
    """Kappa (2) of the line at station `s`, 1/m."""
    _, _, dx, dy, ddx, ddy = line_point(knots, coef, s)
    speed = sqrt(dx * dx + dy * dy)
    return (dx * ddy - dy * ddx) / (speed * speed * speed)


@kernel
def line_project(
    knots: FloatArray, coef: FloatArray, x: float, y: float, s_guess: float, window: float
) -> tuple[float, float]:
    """Frenet coordinates (1) of a point: `(s, l)`, with the foot within `window` m of `s_guess`.

    A coarse search finds the nearest knot of the window; Newton's method then solves (p - r) . r' =
    0 between the knots beside it. Of equally near knots, the one with the smaller s is taken. Exact
    to 1e-9 m where the frame is regular.
    """
    h = knots[1] - knots[0]
    last = len(knots) - 1
    low = max(0, min(last, int((s_guess - window - knots[0]) / h)))
    high = max(0, min(last, int((s_guess + window - knots[0]) / h) + 1))
    best, nearest = low, inf
    for i in range(low, high + 1):
        px, py = (
            (coef[i, X0], coef[i, Y0]) if i < last else line_point(knots, coef, knots[last])[:2]
        )
        square = (px - x) ** 2 + (py - y) ** 2
        if square < nearest:
            best, nearest = i, square
    s = knots[best]
    s_low = s - (h if best > 0 else FARTHEST_M)
    s_high = s + (h if best < last else FARTHEST_M)
    for _ in range(30):
        rx, ry, dx, dy, ddx, ddy = line_point(knots, coef, s)
        slope = (x - rx) * dx + (y - ry) * dy
        if slope > 0.0:
            s_low = s
        else:
            s_high = s
        curvature = dx * dx + dy * dy - (x - rx) * ddx - (y - ry) * ddy
        step = slope / curvature if curvature > 1e-9 else 0.5 * (s_low + s_high) - s
        if not s_low <= s + step <= s_high:
            step = 0.5 * (s_low + s_high) - s
        s += step
        if abs(step) < 1e-11:
            break
    rx, ry, dx, dy, ddx, ddy = line_point(knots, coef, s)
    return s, ((y - ry) * dx - (x - rx) * dy) / sqrt(dx * dx + dy * dy)


@kernel
def line_project_many(
    knots: FloatArray, coef: FloatArray, x: FloatArray, y: FloatArray, s_guess: float, window: float
) -> FloatArray:
    """Frenet coordinates `(n, 2)` of points `(n,)`.

    Each search starts at the previous point's foot.
    """
    feet = np.empty((len(x), 2))
    for i in range(len(x)):
        feet[i] = line_project(knots, coef, x[i], y[i], s_guess, window)
        s_guess = feet[i, 0]
    return feet


@dataclass(frozen=True, eq=False)
class ReferenceLine:
    """A smooth directed line with its Frenet frame (module docstring).

    Attributes:
        s: Stations `(n,)`, uniform, from 0, m.
        coef: Spline coefficients `(n-1, 8)`, see `line_point`.
    """

    s: FloatArray
    coef: FloatArray
    yaw: FloatArray = field(init=False)
    kappa: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "s", frozen(self.s))
        object.__setattr__(self, "coef", frozen(self.coef))
        _, _, yaw, kappa = line_frames(self.s, self.coef)
        object.__setattr__(self, "yaw", frozen(np.unwrap(yaw)))
        object.__setattr__(self, "kappa", frozen(kappa))

    @classmethod
    def through(cls, points: FloatArray, spacing: float = 1.0) -> ReferenceLine:
        """The spline through a polyline `(n, 2)`, resampled to equal arc length of about `spacing`
        m.

        The parameter is the chord length first, and twice more the arc length of the spline before:
        |r'| is 1 within about 1e-5 on arcs, 1e-3 on noisy points, and some 1e-2 at a sharp kink.

        Raises:
            ValueError: Fewer than two distinct points, or a point that is not finite.
        """
        points = np.asarray(points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
            raise ValueError("a reference line needs finite points (n, 2)")
        points = points[np.r_[True, np.hypot(*np.diff(points, axis=0).T) > 1e-6]]
        if len(points) < 2:
            raise ValueError("a reference line needs two distinct points")
        # Imported late: SciPy takes as long to load as all of `logs`
        from scipy.interpolate import CubicSpline

        for _ in range(3):
            chord = arc_lengths(*points.T)
            spline = CubicSpline(chord, points)
            fine = np.linspace(0.0, chord[-1], 8 * len(points))
            speed = np.hypot(*spline(fine, 1).T)
            arc = np.r_[0.0, np.cumsum(0.5 * np.diff(fine) * (speed[1:] + speed[:-1]))]
            count = max(2, floor(arc[-1] / spacing + 0.5 - TIE)) + 1
            points = spline(np.interp(np.linspace(0.0, arc[-1], count), arc, fine))
        stations = np.linspace(0.0, arc[-1], len(points))
        spline = CubicSpline(stations, points)
        return cls(stations, np.hstack([spline.c[:, :, 0].T, spline.c[:, :, 1].T]))

    @property
    def length(self) -> float:
        """Length of the line, m."""
        return float(self.s[-1])

    @cached_property
    def xy(self) -> FloatArray:
        """Points `(n, 2)` at the stations, m."""
        return frozen(line_frames(self.s, self.coef)[:2].T)

    def frame(self, s: float) -> tuple[float, float, float, float]:
        """Return x, y, yaw, kappa at station `s`; beyond its ends, the line continues straight."""
        return line_frame(self.s, self.coef, float(s))

    def project(
        self, x: float, y: float, near: float | None = None, window: float = 30.0
    ) -> tuple[float, float]:
        """Return Frenet coordinates (s, l) of a point.

        The foot lies within `window` m of `near` (None: anywhere).
        """
        if near is None:
            near, window = 0.5 * self.length, self.length
        return line_project(self.s, self.coef, float(x), float(y), float(near), float(window))

    def point(self, s: float, l: float) -> tuple[float, float]:
        """World point of Frenet coordinates (1)."""
        x, y, yaw, _ = self.frame(s)
        return float(x - l * np.sin(yaw)), float(y + l * np.cos(yaw))
