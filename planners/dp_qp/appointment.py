"""Arriving when and as fast as the goal says, where it names a time or a speed.

With the goal region from s_0 to s_1 along the lane, the ego at station s at time t, the goal's times [t_0, t_1] and
speeds up to v_1:

(1) v <= v_1 within the region
(2) v <= (s_1 - s) / (t_0 - t)     where driving on as fast as it may would leave the region before t_0: too early
(3) in a hurry                     where it would not enter the region by t_1 - `HASTE_S`: too late

As fast as it may: at the speed limit, reached with `ACCEL_MPS2`. (1) and (2) hold with some room: `ROOM_MPS` of speed,
a quarter of the region and `ROOM_S`. (2) never asks for less than `LEAST` of the limit: who drives much slower than the
others is in their way. In a hurry the ego wants `HURRIED_GAP_S` to the one ahead instead of its usual time gap; it
drives no faster than the limit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.kernel import FloatArray
from logs.road import Goal
from logs.vehicle import VehicleParameters
from planners.dp_qp.reference_line import Course

LEAST = 0.3
HASTE_S = 3.0
ACCEL_MPS2 = 1.8
ROOM_MPS, ROOM_S = 1.0, 0.2
HURRIED_GAP_S = 0.8
BESIDE_M = 8.0
"""A region further beside the line is not its goal."""


@dataclass(frozen=True, slots=True)
class Pace:
    """What the goal asks of the speed now: a cap, m/s, up to a station, m; and whether the ego is late."""

    cap: float = np.inf
    until: float = -np.inf
    hurried: bool = False


class Appointment:
    """The goal along one reference line.

    Args:
        goal: None: nobody expects the ego.
        course: The line.
        vehicle: The ego.
    """

    def __init__(self, goal: Goal | None, course: Course, vehicle: VehicleParameters) -> None:
        self._goal = goal
        self._region = _region(goal, course) - vehicle.axle_to_center if goal else np.array([np.nan, np.nan])
        self._limit = np.column_stack([course.line.s, course.limit])

    def limit(self, s: FloatArray, limit: FloatArray, pace: Pace) -> FloatArray:
        """The speed limit `(m,)` at stations of the rear axle `(m,)` with (1) and (2) in it."""
        if self._goal is None or not np.isfinite(self._region).all():
            return limit
        out = np.where(s <= pace.until, np.minimum(limit, pace.cap), limit)
        if self._goal.v is not None:
            fastest = max(self._goal.v[1], 0.0)
            begin = self._region[0] if fastest > ROOM_MPS else float(self._region.mean())
            inside = (begin <= s) & (s <= self._region[1])
            out = np.where(inside, np.minimum(out, max(fastest - ROOM_MPS, 0.5 * fastest)), out)
        return out

    def pace(self, t: float, s: float, v: float) -> Pace:
        """What (2) and (3) ask of the rear axle at station `s` at time `t` with speed `v`."""
        goal, (begin, end) = self._goal, self._region
        if goal is None or goal.t is None or not np.isfinite(end) or s > end:
            return Pace()
        first, last = goal.t
        inner, opens = end - 0.25 * (end - begin), first + min(ROOM_S, 0.5 * (last - first))
        if t + self._least_time(s, inner, v) < opens:
            slowly = LEAST * float(np.interp(s, *self._limit.T))
            return Pace(max((inner - s) / (opens - t), slowly), end)
        late = s < begin and t < last and t + self._least_time(s, begin, v) > last - HASTE_S
        return Pace(hurried=late)

    def _least_time(self, s: float, to: float, v: float) -> float:
        """How long driving as fast as it may takes from station to station, from the speed `v`, s."""
        stations = np.linspace(s, max(to, s), 33)
        ahead = stations[1:] - s
        limit = np.interp(0.5 * (stations[1:] + stations[:-1]), *self._limit.T)
        fast = np.minimum(limit, np.sqrt(v * v + 2.0 * ACCEL_MPS2 * ahead))
        return float(np.sum(np.diff(stations) / np.maximum(fast, 0.5)))


def _region(goal: Goal, course: Course) -> FloatArray:
    """From where to where the goal's regions lie along the line, m; NaN where they do not lie along it."""
    found = [course.line.project(float(x), float(y)) for region in goal.regions for x, y in region]
    stations = [along for along, beside in found if abs(beside) < BESIDE_M]
    return np.array([min(stations), max(stations)] if stations else [np.nan, np.nan])
