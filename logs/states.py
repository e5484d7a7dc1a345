"""Data classes of motion: ego state, trajectories and actuation.

World frame W, SI units, time in seconds since the scenario's start. The ego's reference point is
its rear axle.

    t      s       x, y   m       yaw    rad, counter-clockwise from x
    v      m/s     along the body, negative in reverse
    a      m/s2    dv/dt
    kappa  1/m     curvature of the path of the reference point, positive to the left
    steer  rad     front wheel angle, positive to the left
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from math import cos, floor, nan, pi, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replan.core.arrays import FloatArray, frozen
from replan.core.kernel import kernel


@kernel
def wrap(angle: float) -> float:
    """Wrap an angle to [-pi, pi); all code uses this function."""
    return angle - 2.0 * pi * floor((angle + pi) / (2.0 * pi))


def wrapped(angles: FloatArray) -> FloatArray:
    """`wrap` of each angle of an array; NaN stays NaN."""
    return np.asarray(angles - 2.0 * pi * np.floor((angles + pi) / (2.0 * pi)))


@dataclass(frozen=True, slots=True)
class EgoState:
    """The ego at one instant, at the rear axle.

    Attributes:
        t: s since the scenario's start.
        x: World, m; `y` likewise.
        yaw: rad, counter-clockwise from x.
        v: Along the body, m/s, negative in reverse.
        a: Rate of v, m/s2.
        kappa: Curvature of the path of the rear axle, 1/m, positive to the left.
        steer: Front wheel angle, rad, positive to the left.
        yaw_rate: rad/s.
        v_lat: Lateral speed of the rear axle, m/s.
    """

    t: float
    x: float
    y: float
    yaw: float
    v: float
    a: float = 0.0
    kappa: float = 0.0
    steer: float = 0.0
    yaw_rate: float = 0.0
    v_lat: float = 0.0

    def ahead(self, way: float) -> tuple[float, float]:
        """Return the point `way` m before the rear axle along the body, world, m."""
        return self.x + way * cos(self.yaw), self.y + way * sin(self.yaw)

    def later(self, t: float) -> EgoState:
        """Return the state at `t`, also an earlier time, on the arc of its curvature at its speed.

        (x, y) moves by v dt sinc(turn / 2) along yaw + turn / 2,  turn = kappa v dt
        """
        way = self.v * (t - self.t)
        turn = self.kappa * way
        chord = way * float(np.sinc(0.5 * turn / pi))
        x, y = (
            self.x + chord * cos(self.yaw + 0.5 * turn),
            self.y + chord * sin(self.yaw + 0.5 * turn),
        )
        return replace(self, t=t, x=x, y=y, yaw=self.yaw + turn)

    def offset_of(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return how far ahead of the rear axle and how far to its left points `(n,)`, world, m,
        are.
        """
        dx, dy = x - self.x, y - self.y
        c, s = cos(self.yaw), sin(self.yaw)
        return c * dx + s * dy, c * dy - s * dx


@dataclass(frozen=True, slots=True)
class Command:
    """The command of a controller to the vehicle.

    Attributes:
        steer: Front wheel angle, rad.
        throttle: Pedal, 0 to 1.
        brake: Pedal, 0 to 1; brake and throttle are never both positive.
    """

    steer: float
    throttle: float
    brake: float


@dataclass(frozen=True, eq=False, slots=True)
class Trajectory:
    """States over time, struct of arrays: each column `(n,)` float64, read-only, n >= 1.

    `yaw` is continuous (unwrapped). `t` increases strictly. All values are finite.

    Raises:
        ValueError: Columns differ in length, a value is not finite, time does not increase, or a
            heading is beyond `MOST_RAD`.
    """

    t: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    v: FloatArray
    a: FloatArray
    kappa: FloatArray

    def __post_init__(self) -> None:
        columns = [np.asarray(getattr(self, name), dtype=np.float64) for name in TRAJECTORY_COLUMNS]
        for name, column in zip(TRAJECTORY_COLUMNS, columns, strict=True):
            if column.shape != (len(columns[0]),) or not len(column):
                raise ValueError(
                    f"{name} has shape {column.shape}, expected ({len(columns[0])},) and not empty"
                )
        self._keep(np.array(columns))

    @classmethod
    def of_rows(cls, rows: FloatArray) -> Trajectory:
        """Make a trajectory whose columns are the rows `(7, n)`, n >= 1.

        Raises:
            ValueError: A value is not finite, or time does not increase.
        """
        trajectory = object.__new__(cls)
        trajectory._keep(rows)
        return trajectory

    def _keep(self, rows: FloatArray) -> None:
        """Check the rows `(7, n)` and store a copy of them."""
        turns, not_finite, still = _looked_through(rows)
        if not_finite >= 0:
            name, index = (
                TRAJECTORY_COLUMNS[not_finite // rows.shape[1]],
                not_finite % rows.shape[1],
            )
            raise ValueError(f"{name} is not finite at index {index} (t = {rows[0, index]:g} s)")
        if still >= 0:
            raise ValueError(f"time does not increase after {rows[0, still]} s")
        if turns:
            k = int(np.argmax(np.abs(rows[YAW_ROW])))
            if not abs(rows[YAW_ROW, k]) <= MOST_RAD:  # unwrapping would turn it into any angle
                where = f"at index {k} (t = {rows[0, k]:g} s)"
                raise ValueError(
                    f"yaw is {rows[YAW_ROW, k]:g} rad {where}, beyond {MOST_RAD:g} rad"
                )
            rows[YAW_ROW] = np.unwrap(rows[YAW_ROW])
        for name, row in zip(TRAJECTORY_COLUMNS, frozen(rows), strict=True):
            object.__setattr__(self, name, row)

    def __len__(self) -> int:
        return len(self.t)

    def state(self, index: int) -> EgoState:
        """The sample at `index`."""
        return EgoState(*[column.item(index) for column in self._columns()])

    def at(self, t: float) -> EgoState:
        """Return the state at time `t`, linearly interpolated; outside the span, the first or last
        state.

        Only for plans and ground truth: between two samples, the result depends on the later one.
        """
        i = int(self.t.searchsorted(t, side="right")) - 1
        if i < 0 or i >= len(self.t) - 1:
            return EgoState(t, *[column.item(max(i, 0)) for column in self._columns()[1:]])
        begin, step = self.t.item(i), self.t.item(i + 1) - self.t.item(i)
        pairs = [(column.item(i), column.item(i + 1)) for column in self._columns()[1:]]
        return EgoState(
            t, *[(after - before) / step * (t - begin) + before for before, after in pairs]
        )

    def _columns(self) -> tuple[FloatArray, ...]:
        return self.t, self.x, self.y, self.yaw, self.v, self.a, self.kappa

    def resampled(self, t: FloatArray) -> Trajectory:
        """Interpolate linearly at the times `t` `(m,)`, which increase and lie within the span."""
        return Trajectory(
            t, *(np.interp(t, self.t, getattr(self, name)) for name in TRAJECTORY_COLUMNS[1:])
        )

    def between(self, t_from: float, t_to: float) -> Trajectory:
        """Return the samples with `t_from <= t <= t_to`; ValueError if there is no such sample."""
        return self.taken((self.t >= t_from) & (self.t <= t_to))

    def taken(self, rows: slice | NDArray[Any]) -> Trajectory:
        """Return these samples; ValueError if there is none."""
        return Trajectory(*(getattr(self, name)[rows] for name in TRAJECTORY_COLUMNS))


def joined(first: Trajectory, second: Trajectory) -> Trajectory:
    """Return the samples of two trajectories, one after the other; ValueError if they overlap."""
    return Trajectory(
        *(np.r_[getattr(first, name), getattr(second, name)] for name in TRAJECTORY_COLUMNS)
    )


TRAJECTORY_COLUMNS = tuple(field.name for field in fields(Trajectory))
YAW_ROW = TRAJECTORY_COLUMNS.index("yaw")

MOST_RAD = 1e9
"""Greatest heading, rad: beyond it a double resolves an angle no finer than 1e-7 rad."""


@kernel
def _looked_through(rows: FloatArray) -> tuple[bool, int, int]:
    """Return whether the yaw jumps, and the flat indices of the first value that is not finite and
    of the first bad t.

    A time t is bad if it is not below the next. An index is -1 if there is no such value; `rows`
    are the columns `(7, n)`. The search stops at the first fault.
    """
    turns, count = False, rows.shape[1]
    for i in range(rows.shape[0]):
        for k in range(count):
            if not np.isfinite(rows[i, k]):
                return turns, i * count + k, -1
    for k in range(count - 1):
        turns = turns or not abs(rows[YAW_ROW, k + 1] - rows[YAW_ROW, k]) < pi
        if not rows[0, k + 1] > rows[0, k]:
            return turns, -1, k
    return turns, -1, -1


@dataclass(frozen=True, eq=False, slots=True)
class Controls:
    """Actuation over time, `(n,)` each: steer rad, throttle and brake 0 to 1; NaN where unknown."""

    t: FloatArray
    steer: FloatArray
    throttle: FloatArray
    brake: FloatArray

    def __post_init__(self) -> None:
        for field in fields(self):
            column = frozen(getattr(self, field.name))
            if column.shape != (len(self.t),):
                raise ValueError(
                    f"{field.name} has shape {column.shape}, expected ({len(self.t)},)"
                )
            object.__setattr__(self, field.name, column)

    def __len__(self) -> int:
        return len(self.t)


@dataclass(frozen=True, eq=False, slots=True)
class Alternative:
    """One of the trajectories among which a planner chose.

    Attributes:
        trajectory: States of the rear axle, from the plan's time on.
        score: Higher is better; NaN: it has no score. The planner chose the one with the highest.
        name: What produced it ("keep", "diffusion_planner"), or empty.
    """

    trajectory: Trajectory
    score: float = nan
    name: str = ""

    def changed(self, change: Callable[[Trajectory], Trajectory]) -> Alternative:
        """Return it with its trajectory changed."""
        return replace(self, trajectory=change(self.trajectory))


@dataclass(frozen=True, eq=False, slots=True)
class OnboardPlan:
    """A plan that the on-board planner made during the recording.

    Attributes:
        known: Time from which the plan was available, s since the scenario's start.
        trajectory: The planned trajectory, in the scenario's time and world.
        alternatives: The trajectories among which it was chosen, where the log has them.
    """

    known: float
    trajectory: Trajectory
    alternatives: tuple[Alternative, ...] = ()

    def changed(self, change: Callable[[Trajectory], Trajectory]) -> OnboardPlan:
        """Return it with all its trajectories changed."""
        others = tuple(alternative.changed(change) for alternative in self.alternatives)
        return replace(self, trajectory=change(self.trajectory), alternatives=others)
