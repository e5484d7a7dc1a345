"""Arrival at a goal that names a time or a speed, or that lies beside the middle of the lane.

With the goal region from s_0 to s_1 along the lane, the ego at station s at time t, the goal's
times [t_0, t_1] and speeds up to v_1:

(1) v <= v_1 within the region
(2) v <= (s_1 - s) / (t_0 - t)
        where the fastest permitted driving would leave the region before t_0: too early
(3) in a hurry                     where it would not enter the region by t_1 - `HASTE_S`: too late

The fastest permitted driving is at the speed limit, reached with comfortable acceleration. (1) and
(2) hold with a reserve: `ROOM_MPS` of speed, a quarter of the region (`END_M` of the road) and
`ROOM_S`. (2) never demands less than `LEAST` of the limit: an ego much slower than the traffic is
in its way. In a hurry the ego keeps `HURRIED_GAP_S` to its leader instead of its usual time gap,
and the speed limit. Where a goal has a time but no region, s_1 is the end of the road, and an ego
that is too early stops before it.

(4) l_0(s) + m <= l <= l_1(s) - m
        where the region is from l_0 to l_1 beside the line at station s; m = `SIDE_M`
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.kernel import kernel
from replan.core.once import once
from replan.logs.road import Goal
from replan.logs.vehicle import VehicleParameters
from replan.planners.frenet.profiles import COMFORT
from replan.planners.frenet.reference_path import ReferencePath

LEAST = 0.3  # Share of the speed limit below which (2) does not slow the ego down
# The ego is in a hurry where it would arrive less than this before the last time (3), s
HASTE_S = 3.0
ROOM_MPS = 1.0  # Reserve to the goal's greatest speed (1), m/s
ROOM_S = 0.2  # Reserve to its first time (2), s
END_M = 3.0  # Reserve to the end of the road where a goal has no region, m
HURRIED_GAP_S = 0.8  # Time gap of an ego in a hurry, s
BESIDE_M = 8.0  # A region farther beside the line than this is not a goal of this lane, m
# Distance of the ego's middle to a region's sides, m; at most a quarter of the region's width
SIDE_M = 0.3
ALONG_M = 0.5  # Spacing of the stations at which a region's sides are measured, m ...
ROWS = 400  # ... and their greatest number.
STEPS = 32  # Number of steps in the integration of the time to a region
JOINED_M = 0.1  # Regions nearer to each other than this are one, m
# (4) does not apply where a region is narrower than this share of its greatest width: at its
# corners
NARROW = 0.5
NO_SIDES = np.empty((3, 0))  # (4) where there is no region


@dataclass(frozen=True, slots=True)
class SpeedTarget:
    """The demands of the goal on the speed now.

    A `cap`, m/s, up to the station `until`, m; whether the ego is `hurried`; how much too late it
    would be, s; the station that it must not pass yet, m.
    """

    cap: float = np.inf
    until: float = -np.inf
    hurried: bool = False
    missed_s: float = 0.0
    stop: float = np.inf


class GoalWindow:
    """The goal along one reference line, for a comfortable acceleration.

    Without a `goal` it demands nothing.
    """

    def __init__(
        self,
        goal: Goal | None,
        reference: ReferencePath,
        vehicle: VehicleParameters,
        accel_mps2: float = COMFORT.accel_mps2,
    ) -> None:
        self._goal, self._accel = goal, accel_mps2
        self._region, (self._begins, _) = (
            _region(goal, reference, beside) - vehicle.axle_to_center
            if goal
            else np.array([np.nan, np.nan])
            for beside in (BESIDE_M, np.inf)
        )
        self._limit = reference.line.s, reference.limit
        self._road_end = float(reference.line.s[-1]) - vehicle.axle_to_front
        self._sides = _sides(reference, goal) if goal else NO_SIDES

    @property
    def slow_zone(self) -> tuple[float, float, float] | None:
        """(1): stations, m, between which the rear axle keeps the goal's speed, and that speed,
        m/s; or None.
        """
        if self._goal is None or self._goal.v is None or not np.isfinite(self._region).all():
            return None
        fastest = max(self._goal.v[1], 0.0)
        begin = self._region[0] if fastest > ROOM_MPS else float(self._region.mean())
        return float(begin), float(self._region[1]), max(fastest - ROOM_MPS, 0.5 * fastest)  # (1)

    def sides(self, begin: float, end: float) -> FloatArray:
        """Rows station, least and greatest offset `(3, n)` of (4), m.

        Empty if there are none between two stations.
        """
        stations = self._sides[0]
        return (
            self._sides
            if len(stations) and stations[0] <= end and begin <= stations[-1]
            else NO_SIDES
        )

    def time_left(self, t: float) -> float:
        """Time left to reach the goal, s; inf where it names no time or the time has passed."""
        latest = self._goal.t[1] if self._goal is not None and self._goal.t is not None else -np.inf
        return latest - t if latest > t else np.inf

    def target(self, t: float, s: float, v: float) -> SpeedTarget:
        """The demands (2) and (3) on a rear axle at station `s` at time `t` with speed `v`."""
        goal, (begin, end) = self._goal, self._region
        if goal is None or goal.t is None:
            return SpeedTarget()
        earliest, latest = goal.t
        opens = earliest + min(ROOM_S, 0.5 * (latest - earliest))
        if not goal.regions:
            early = self._slow(t, s, v, self._road_end - END_M, self._road_end, opens)
            return replace(early, stop=self._road_end - END_M) if early.cap < np.inf else early
        if not np.isfinite(end):  # a lane far beside the goal's: it does not lead there sooner
            return SpeedTarget(missed_s=max(self._late(t, s, v, self._begins, latest), 0.0))
        if s > end:
            return SpeedTarget()
        early = self._slow(t, s, v, end - 0.25 * (end - begin), end, opens)
        if early.cap < np.inf:
            return early
        late = self._late(t, s, v, begin, latest)
        return SpeedTarget(hurried=late > -HASTE_S, missed_s=max(late, 0.0))  # (3)

    def _slow(
        self, t: float, s: float, v: float, inner: float, end: float, opens: float
    ) -> SpeedTarget:
        """(2), so that the ego is not beyond `inner` before `opens`."""
        if t + self._least_time(s, inner, v) >= opens:
            return SpeedTarget()
        slowly = LEAST * float(np.interp(s, *self._limit))
        return SpeedTarget(max((inner - s) / (opens - t), slowly), end)  # (2)

    def _late(self, t: float, s: float, v: float, begin: float, latest: float) -> float:
        """Lateness of the ego at station `begin` after `latest`, s; -inf if it is past `begin` or
        `latest` has passed.
        """
        return t + self._least_time(s, begin, v) - latest if s < begin and t < latest else -np.inf

    def _least_time(self, s: float, to: float, v: float) -> float:
        """Time of the fastest permitted driving from station to station, from the speed `v`, s."""
        return _least_time(*self._limit, s, max(to, s), v, self._accel)


@kernel
def _least_time(
    knots: FloatArray, limit: FloatArray, s: float, to: float, v: float, accel: float
) -> float:
    """Integrate the time, s, in equal steps; `limit` at knots `(n,)`, m/s.

    It adds in eight sums, as NumPy does.
    """
    step, last, sums = (to - s) / STEPS, len(knots) - 1, np.zeros(8)
    begin = s
    for i in range(STEPS):
        end = to if i == STEPS - 1 else (i + 1) * step + s
        middle = min(max(0.5 * (end + begin), knots[0]), knots[last])
        j = min(int(np.searchsorted(knots, middle, "right")) - 1, last - 1)
        slope = (limit[j + 1] - limit[j]) / (knots[j + 1] - knots[j])
        allowed = slope * (middle - knots[j]) + limit[j] if middle < knots[last] else limit[last]
        fast = min(allowed, sqrt(v * v + 2.0 * accel * (end - s)))
        sums[i % 8] += (end - begin) / max(fast, 0.5)
        begin = end
    count = len(sums)
    while count > 1:
        count //= 2
        for i in range(count):
            sums[i] = sums[2 * i] + sums[2 * i + 1]
    return sums[0]


def _region(goal: Goal, reference: ReferencePath, beside: float) -> FloatArray:
    """First and last station of the goal's regions, m; NaN where all are farther than `beside` from
    the line.
    """
    regions = [
        reference.line.project(float(x), float(y)) for region in goal.regions for x, y in region
    ]
    stations = [along for along, aside in regions if abs(aside) < beside]
    return np.array([min(stations), max(stations)] if stations else [np.nan, np.nan])


@once
def _sides(reference: ReferencePath, goal: Goal) -> FloatArray:
    """Rows station, least and greatest offset `(3, n)` of (4), NaN where there is no region.

    Of several regions it takes the one around the line, else the nearest one.
    """
    begin, end = _region(goal, reference, BESIDE_M)
    if not np.isfinite(end):
        return NO_SIDES
    step = max(ALONG_M, (end - begin) / ROWS)
    stations = np.arange(begin + 0.5 * step, end, step)
    pieces: list[list[tuple[float, float]]] = [[] for _ in stations]
    for region in goal.regions:
        first, last = _region(Goal((region,)), reference, np.inf)
        following = np.arange(1, len(region) + 1) % len(region)
        for k in np.flatnonzero((first <= stations) & (stations <= last)):
            x, y, yaw, _ = reference.line.frame(float(stations[k]))
            along = (region - (x, y)) @ (np.cos(yaw), np.sin(yaw))
            aside = (region - (x, y)) @ (-np.sin(yaw), np.cos(yaw))
            next_along, next_aside = along[following], aside[following]
            # Where the normal of the line runs through the region
            cut = (along > 0.0) != (next_along > 0.0)
            crossings = np.sort(
                aside[cut] + (next_aside - aside)[cut] * along[cut] / (along - next_along)[cut]
            )
            pieces[k] += [
                (float(low), float(high))
                for low, high in zip(crossings[::2], crossings[1::2], strict=True)
            ]
    across = []
    # Join pieces that touch; then take the one around the line, or nearest to it
    for row in pieces:
        joined: list[tuple[float, float]] = []
        for right, left in sorted(row):
            if joined and right <= joined[-1][1] + JOINED_M:
                joined[-1] = joined[-1][0], max(joined[-1][1], left)
            else:
                joined.append((right, left))
        near = [piece for piece in joined if piece[0] < BESIDE_M and piece[1] > -BESIDE_M]
        distances = [(max(right, -left, 0.0), left - right) for right, left in near]
        across.append(near[distances.index(min(distances))] if near else (np.nan, np.nan))
    low, high = np.array(across).reshape(-1, 2).T
    width = high - low
    narrow = ~(width >= NARROW * np.nanmax(width, initial=0.0))
    room = np.where(narrow, np.nan, np.minimum(SIDE_M, 0.25 * width))
    return np.vstack([stations, low + room, high - room])  # (4)
