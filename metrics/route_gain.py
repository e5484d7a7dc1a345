"""The route of a scenario, and the gain of a drive along it.

(a) route = the path of the log's driver, then the lanes from its end towards the goal,
        else straight on; a smooth line. A log with one state has no path: its route begins with the
        lanes.
(b) station(t) = foot of the rear axle on the route, searched within 30 m of the previous foot;
        within less where the route comes back to itself in short laps: half of the way between two
        stations that are at most `BESIDE_M` apart, the least of those that are longer than the
        circle of that diameter
(c) gain(t) = sum over the steps of station_k - station_(k-1);
        a difference of more than reach + 0.1 m, forward or back,
    is cut to reach, reach = 2 max(|v_k|, |v_(k-1)|) dt

Circles and driving back gain nothing. A position that jumps, or a foot that jumps between two arms
of a route that comes near itself, gains or loses no more than the ego could have driven. The factor
2 allows for the inside of bends (station' = v / (1 - kappa l), kappa l up to 0.5), the 0.1 m for
noise in recorded positions.

(d) way = the gain from which on the goal's place counts: `Goal.way` if it is above 0; else,
        if the log's driver leaves the place and comes back, the middle between the gains where they
        leave and come (`counting_stay`); else 0
(e) lost(t_k) = t_(k+1) - t_k - what another drive takes from gain(t_k) to gain(t_(k+1)),
        with the times at which it is there for the last time
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import pi

import numpy as np

from replan.core.arrays import FloatArray, arc_lengths
from replan.core.once import last
from replan.logs.polylines import first_nearest, inside, thinned
from replan.logs.reference_line import ReferenceLine, line_project_many
from replan.logs.road import Goal, Road
from replan.logs.route import counting_stay, find_route, straight_on
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory

SPACING_M, WINDOW_M, BESIDE_M = 1.0, 30.0, 3.0
STRETCH, SLACK_M = 2.0, 0.1
JOIN_M, CHANGE_M = 10.0, 20.0  # Length of the transition to a lane, and to a neighbouring lane
# The line follows lanes for this distance beyond the path or goal, then goes straight
BEYOND_M = 200.0
AHEAD_M, BEYOND_END_M = 5.0, 1000.0
SAME_M, LAGS_MPS = 1e-6, 0.5
SHORTEST_M = 10.0  # A shorter drive defines no route


@dataclass(frozen=True, eq=False)
class ProgressLine:
    """The line (a) of a scenario, from its first state.

    `length`, m, ends where the line enters the goal, else at the end of the log's drive; NaN if
    there is neither. `goal_gain` is the gain from which on the goal counts (d), m. `far` ends where
    the line leaves the goal; inf: nowhere.
    """

    line: ReferenceLine
    length: float
    goal_gain: float = 0.0
    far: float = np.inf

    @cached_property
    def window(self) -> float:
        """Greatest distance of a foot from the previous one (b), m."""
        from scipy.spatial import cKDTree  # imported here: slow to load

        pairs = cKDTree(self.line.xy).query_pairs(BESIDE_M, output_type="ndarray")
        apart = np.abs(np.diff(self.line.s[pairs], axis=1))
        return 0.5 * float(np.min(apart, where=apart > pi * BESIDE_M, initial=2.0 * WINDOW_M))


@dataclass(frozen=True, eq=False)
class Gain:
    """Gain (c) of a drive at its steps `(n,)`, negative if it drove back; `cut`, the way forward
    not counted; m.

    `station` is that of the last step, m.
    """

    metres: FloatArray
    cut: float
    station: float = 0.0


def route_of(scenario: Scenario) -> ProgressLine:
    """The route of a scenario."""
    return _route(scenario.road, scenario.ego, scenario.goal, scenario.vehicle.axle_to_center)


@last(2)  # changes of metadata make new scenarios with the same road
def _route(road: Road, log: Trajectory, goal: Goal | None, axle_to_center: float) -> ProgressLine:
    path, end = thinned(np.column_stack([log.x, log.y]), SPACING_M), log.state(len(log) - 1)
    onward = np.array([end.ahead(JOIN_M)])  # straight on
    if road.lanes and len(points := _points_onward(road, log, goal)):
        onward = thinned(points, SPACING_M)
    line = ReferenceLine.through(np.vstack([path, onward]), SPACING_M)
    driven = float(np.hypot(*np.diff(path, axis=0).T).sum())
    regions = goal.regions if goal else ()
    goal_gain = way_of(goal, log, ProgressLine(line, np.nan), axle_to_center) if goal else 0.0
    enters = np.nan
    for s, (x, y) in (
        zip((line.s[1:] - axle_to_center).tolist(), line.xy[1:].tolist(), strict=True)
        if regions
        else ()
    ):
        within = any(inside(x, y, region) for region in regions)
        if np.isnan(enters):
            enters = s if within and s >= goal_gain else enters
        elif not within:
            return ProgressLine(line, max(enters, SPACING_M), goal_gain, s)
    if np.isfinite(enters):
        return ProgressLine(line, max(enters, SPACING_M), goal_gain)
    length = driven if driven >= SHORTEST_M else np.nan
    return ProgressLine(line, length, goal_gain, length)


def _points_onward(road: Road, log: Trajectory, goal: Goal | None) -> FloatArray:
    """Points `(k, 2)` of the centre lines of the route (a), which begin `JOIN_M` after the log's
    end.
    """
    end = log.state(len(log) - 1)
    lanes, beyond = list(find_route(road, end, goal)), 0.0
    while beyond < BEYOND_M and (after := straight_on(road, lanes[-1])) is not None:
        beyond += max(road.lanes[after].length, SPACING_M)
        lanes.append(after)
    points, skipped, begun = np.empty((0, 2)), JOIN_M, False
    for k, lane in enumerate(lanes):
        center = road.lanes[lane].center
        # A lane change: side by side
        if k + 1 < len(lanes) and lanes[k + 1] not in road.lanes[lane].successors:
            skipped = CHANGE_M
            continue
        if not begun:
            away = np.hypot(center[:, 0] - end.x, center[:, 1] - end.y)
            center = center[
                int(np.argmin(away)) if len(log) > 1 else first_nearest(center, end.x, end.y) :
            ]
        chord, begun = arc_lengths(*center.T), True
        points, skipped = (
            np.vstack([points, center[chord >= skipped]]),
            max(skipped - float(chord[-1]), 0.0),
        )
    return points


def way_of(goal: Goal, log: Trajectory, route: ProgressLine, axle_to_center: float) -> float:
    """Return the gain along a route from which on a goal counts (d), m."""
    if goal.way > 0.0 or (stay := counting_stay(goal, log, axle_to_center)) is None:
        return goal.way
    return max(float(gain_along(route, log).metres[list(stay)].mean()), 0.0)


@last(2)  # the log's drive and the one that is judged
def gain_along(route: ProgressLine, drive: Trajectory, begin: float = 0.0) -> Gain:
    """Return the gain (c) of a drive along a route.

    The search for its first station begins at `begin`, m.
    """
    # (b)
    station = line_project_many(
        route.line.s, route.line.coef, drive.x, drive.y, begin, route.window
    )[:, 0]
    step = np.diff(station)
    reach = STRETCH * np.maximum(np.abs(drive.v[1:]), np.abs(drive.v[:-1])) * np.diff(drive.t)
    counted = np.where(np.abs(step) > reach + SLACK_M, np.copysign(reach, step), step)  # (c)
    cut = float(np.maximum(step - counted, 0.0).sum())
    return Gain(np.r_[0.0, np.cumsum(counted)], cut, float(station[-1]))


@dataclass(frozen=True)
class RoutePace:
    """The time at which a drive is for the last time at a gain along the route: increasing, m and
    s.
    """

    gain: tuple[float, ...]
    t: tuple[float, ...]

    @classmethod
    def of(cls, drive: Trajectory, scenario: Scenario) -> RoutePace:
        """Return the pace of a drive; beyond its end it goes on as fast as on average."""
        gain = np.maximum.accumulate(gain_along(route_of(scenario), drive).metres)
        last = np.flatnonzero(np.r_[np.diff(gain) > SAME_M, True])
        last = last[np.unique(np.r_[np.arange(0, len(last), 10), len(last) - 1])]
        g, t = gain[last], drive.t[last]
        slope = (t[-1] - drive.t[0]) / max(float(g[-1]), SAME_M)
        rows = np.round(
            [np.r_[g, g[-1] + BEYOND_END_M], np.r_[t, t[-1] + BEYOND_END_M * slope]], 6
        ).tolist()
        return cls(tuple(rows[0]), tuple(rows[1]))

    @classmethod
    def needed(cls, scenario: Scenario) -> RoutePace | None:
        """Return the recorded driver's pace, else the steady one that reaches the goal; None if
        there is neither.
        """
        if len(scenario.ego) > 1:
            return cls.of(scenario.ego, scenario)
        length, goal = route_of(scenario).length, scenario.goal
        end = min(scenario.duration, goal.t[1] if goal is not None and goal.t else np.inf)
        return cls((0.0, length), (0.0, end)) if length > 0.0 and end > 0.0 else None

    def lost(
        self, drive: Trajectory, scenario: Scenario, frames: Sequence[float]
    ) -> tuple[FloatArray, FloatArray]:
        """Return the time (e) that a drive loses from each frame to the next, s, and the speed of
        this pace, m/s.

        The speed is NaN where the drive is not slower by `LAGS_MPS`.
        """
        t = np.r_[frames, drive.t[-1]]
        gain: FloatArray = np.asarray(
            np.interp(t, drive.t, gain_along(route_of(scenario), drive).metres)
        )
        taken = np.diff(np.interp(gain, self.gain, self.t))
        ahead = np.interp(gain[:-1] + AHEAD_M, self.gain, self.t) - np.interp(
            gain[:-1], self.gain, self.t
        )
        speed = AHEAD_M / np.maximum(ahead, SAME_M)
        return np.diff(t) - taken, np.where(
            speed - np.interp(frames, drive.t, drive.v) > LAGS_MPS, speed, np.nan
        )
