"""A plan as a path with stations, and the ego's deviation from it, for controllers, perfect vehicle
and trace.

The path's station is the arc length driven forward; positions between two samples are cubic in the
station (Hermite, along their headings), headings and curvatures linear. Standing and measurement
noise do not increase the station:

(1) ds_i    = chord_i . heading_i * h / sin(h)          arc over a chord, h = half of the turn
(2) station = running maximum of the sum of ds_i
(3) foot:     (p - r(s)) . r'(s) = 0, by Newton from the nearest knot within WINDOW_M of
        where the plan is now
(4) lateral = (p - r(s)) x heading(s), positive left of the path
(5) station error = s - station(t);   speed error = v - v(t);   heading error = yaw - heading(s)

Before its first and after its last sample the path goes on straight, and in time at its last speed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import cos, sin
from typing import NamedTuple

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.kernel import inner_kernel, kernel
from replan.logs.plan import Plan
from replan.logs.states import EgoState, Trajectory, wrap

WINDOW_M = 20.0
"""Largest distance between the foot and where the plan is now, along the path, m."""
KNOT_SPACING_M = 0.05
"""Nearer knots are left out, m: at such distances the heading is more accurate than the
positions.
"""


class Deviation(NamedTuple):
    """The ego against its plan at one instant (3)-(5): m, rad, m/s; `foot` is the station of the
    ego's foot point.
    """

    lateral: float
    heading: float
    speed: float
    station: float
    foot: float


@inner_kernel
def plan_stations(x: FloatArray, y: FloatArray, yaw: FloatArray) -> FloatArray:
    """Stations `(n,)` of a plan's samples, m, not decreasing, from 0."""
    stations = np.zeros(len(x))
    total = 0.0
    for i in range(1, len(x)):
        mean, half = 0.5 * (yaw[i] + yaw[i - 1]), 0.5 * (yaw[i] - yaw[i - 1])
        along = (x[i] - x[i - 1]) * cos(mean) + (y[i] - y[i - 1]) * sin(mean)
        total += along * half / sin(half) if 1e-6 < abs(half) < 1.5 else along  # (1)
        stations[i] = max(stations[i - 1], total)  # (2)
    return stations


@kernel
def path_columns(
    t: FloatArray,
    x: FloatArray,
    y: FloatArray,
    yaw: FloatArray,
    v: FloatArray,
    a: FloatArray,
    kappa: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """`times` and `knots` of `PlanPath`, of a plan's columns `(n,)`.

    Knots are KNOT_SPACING_M apart at least.
    """
    station = plan_stations(x, y, yaw)
    times, knots = np.empty((len(t), 4)), np.empty((len(t), 5))
    count = 0
    for i in range(len(t)):
        times[i] = t[i], station[i], max(v[i], 0.0), a[i]
        if i == 0 or station[i] - knots[count - 1, 0] >= KNOT_SPACING_M:
            knots[count] = station[i], x[i], y[i], yaw[i], kappa[i]
            count += 1
    return times, knots[:count].copy()


@dataclass(frozen=True, eq=False, slots=True)
class PlanPath:
    """A plan as controllers use it.

    Attributes:
        times: `(n, 4)`: time s, station m, speed m/s, acceleration m/s2 of each sample.
        knots: `(m, 5)`, 1 <= m <= n: station, x, y, yaw, kappa; stations increase strictly.
    """

    times: FloatArray
    knots: FloatArray

    @classmethod
    def of(cls, plan: Trajectory) -> PlanPath:
        """The path and timing of a trajectory."""
        times, knots = path_columns(plan.t, plan.x, plan.y, plan.yaw, plan.v, plan.a, plan.kappa)
        times.flags.writeable = knots.flags.writeable = False
        return cls(times, knots)

    @property
    def columns(self) -> tuple[FloatArray, FloatArray]:
        """`times` and `knots`, for kernels."""
        return self.times, self.knots

    def deviation(self, state: EgoState) -> Deviation:
        """The ego against the plan at `state.t`."""
        return deviation(self.times, self.knots, state.t, state.x, state.y, state.yaw, state.v)

    def timed(self, t: float) -> tuple[float, float, float]:
        """Station m, speed m/s and acceleration m/s2 of the plan at `t`."""
        return timed(self.times, t)


@kernel
def timed(times: FloatArray, t: float) -> tuple[float, float, float]:
    """Station, m (cubic, by the speeds), speed and acceleration (linear) at `t`.

    Constant speed beyond the end.
    """
    last = len(times) - 1
    if t >= times[last, 0]:
        return times[last, 1] + times[last, 2] * (t - times[last, 0]), times[last, 2], 0.0
    i = max(int(np.searchsorted(times[:, 0], t, side="right")) - 1, 0)
    h = times[i + 1, 0] - times[i, 0]
    u = max((t - times[i, 0]) / h, 0.0)
    v = times[i, 2] + u * (times[i + 1, 2] - times[i, 2])
    a = times[i, 3] + u * (times[i + 1, 3] - times[i, 3])
    return hermite(times[i, 1], times[i + 1, 1], h * times[i, 2], h * times[i + 1, 2], u), v, a


@inner_kernel
def hermite(p0: float, p1: float, d0: float, d1: float, u: float) -> float:
    """The cubic with values p0, p1 and slopes d0, d1 at u = 0, 1."""
    w = 1.0 - u
    return p0 * (1.0 + 2.0 * u) * w * w + p1 * (1.0 + 2.0 * w) * u * u + u * w * (d0 * w - d1 * u)


@kernel
def path_point(knots: FloatArray, s: float) -> tuple[float, float, float, float]:
    """x, y, yaw, kappa at station `s`, m.

    Straight on beyond the ends (where the curvature is the end's).
    """
    last = len(knots) - 1
    if last == 0 or s <= knots[0, 0] or s >= knots[last, 0]:
        s0, x, y, yaw, kappa = knots[0 if last == 0 or s <= knots[0, 0] else last]
        return x + (s - s0) * cos(yaw), y + (s - s0) * sin(yaw), yaw, kappa
    i = int(np.searchsorted(knots[:, 0], s, side="right")) - 1
    s0, x0, y0, yaw0, kappa0 = knots[i]
    s1, x1, y1, yaw1, kappa1 = knots[i + 1]
    h = s1 - s0
    u = (s - s0) / h
    x = hermite(x0, x1, h * cos(yaw0), h * cos(yaw1), u)
    y = hermite(y0, y1, h * sin(yaw0), h * sin(yaw1), u)
    return x, y, yaw0 + u * (yaw1 - yaw0), kappa0 + u * (kappa1 - kappa0)


@inner_kernel
def path_kappa(knots: FloatArray, s: float) -> float:
    """Curvature at station `s`, 1/m."""
    _, _, _, kappa = path_point(knots, s)
    return kappa


@inner_kernel
def path_foot(knots: FloatArray, x: float, y: float, near: float) -> float:
    """Station of the foot of a point (3), m."""
    best, least = -1, 1e300
    for i in range(len(knots)):
        ahead = knots[i, 0] - near
        if ahead > WINDOW_M:
            break
        square = (knots[i, 1] - x) ** 2 + (knots[i, 2] - y) ** 2
        if ahead >= -WINDOW_M and square < least:
            best, least = i, square
    s = knots[best, 0] if best >= 0 else min(max(near, knots[0, 0]), knots[-1, 0])
    for _ in range(12):  # (3)
        rx, ry, yaw, kappa = path_point(knots, s)
        along = (x - rx) * cos(yaw) + (y - ry) * sin(yaw)
        left = (y - ry) * cos(yaw) - (x - rx) * sin(yaw)
        step = along / max(1.0 - kappa * left, 0.2)
        s += step
        if abs(step) < 1e-9:
            break
    return s


@kernel
def deviation(
    times: FloatArray, knots: FloatArray, t: float, x: float, y: float, yaw: float, v: float
) -> Deviation:
    """The ego against the plan at `t`."""
    station, speed, _ = timed(times, t)
    s = path_foot(knots, x, y, station)
    rx, ry, heading, _ = path_point(knots, s)
    lateral = (y - ry) * cos(heading) - (x - rx) * sin(heading)  # (4)
    return Deviation(lateral, wrap(yaw - heading), v - speed, s - station, s)  # (5)


class Tracker:
    """Keeps the path of the plan being driven, so that a plan is prepared once and not at each
    command.

    Args:
        prepare: Converts the planned trajectory to the one to follow.
    """

    def __init__(self, prepare: Callable[[Trajectory], Trajectory] | None = None) -> None:
        self._prepare = prepare
        self._plan: Plan | None = None
        self._path: PlanPath | None = None

    def path(self, plan: Plan) -> PlanPath:
        """The plan as a path."""
        if self._path is None or plan is not self._plan:
            prepare = self._prepare
            self._plan = plan
            self._path = PlanPath.of(prepare(plan.trajectory) if prepare else plan.trajectory)
        return self._path
