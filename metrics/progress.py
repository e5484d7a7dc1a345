"""Closed loop: how far and how fast the ego drives along its route, and whether it arrives.

The route, and the gain of a drive along it:

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

With the gain of a drive along the route; the yardstick is the whole log, even if the drive was
shorter:

(1) route_progress(t) = gain(t) / gain of the log's driver at the log's end
    where the log has no drive: over the gain of the route follower (`Scenario.references`);
    unavailable if that yardstick is below 2 m: then it is unknown how far a planner should drive;
    below 5 m where the log has no lanes: its lane is then not what was driven
    (`replan.logs.complete`)
(2) progress = min(1, max(gain, c) / max(gain of the log's driver, c)), 0 where gain < -c;  c = 2 m
        (nuPlan)
(3) completion = gain / length of the route, in 0 .. 1
        (CARLA) all three: at least 1 if the drive ended in the goal's region, unless more than 2 m
        of its gain were cut, or (8) is below LEAST_COVERED
(4) distance(t) = length of the path of the rear axle driven since the start
(5) speed_excess(t) = max(v - max(limit, held(t)), 0),  speed_ratio(t) = v / limit - 1
    held(t) = v_0 - EASE_MPS2 max(t - t_0 - SETTLE_S, 0) if the drive begins above the limit,
        else 0: an initial excess that the ego reduces comfortably is not counted
    assumed_limit_excess(t) = max(v - 1.1 max(assumed limit, the fastest second of the log's
        driver), 0) where the log has no limit: the assumed limit may be one step of signs too low,
        and the driver may have known it
(6) speed_limit_compliance = max(0, 1 - integral of (5) dt / (2.23 m/s T)),
        T the time on lanes with a limit  (nuPlan)
(7) a goal is unreachable if it is farther than a vehicle drives in the time, accelerating at 9.81
    m/s2 up to 70 m/s
(8) covered = max(duration of the drive / duration of the log, gain
        / gain of the log's driver, without a logged drive of 2 m: gain / length of the route) of a
        drive that ended at a goal that is a place; 1 where it ended with the log, or at a goal
        without a place
(9) lost(t_k) = t_(k+1) - t_k - what another drive takes from gain(t_k) to gain(t_(k+1)),
        with the times at which it is there for the last time
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from math import pi

import numpy as np

from replan.core.arrays import FloatArray, arc_lengths
from replan.core.once import last
from replan.logs.complete import MIN_PATH
from replan.logs.polylines import first_nearest, thinned
from replan.logs.reference_line import ReferenceLine, line_project_many
from replan.logs.road import Goal, Road, RoadSource, inside
from replan.logs.route import counting_stay, find_route, straight_on
from replan.logs.scenario import Scenario
from replan.logs.shapes import point_segment
from replan.logs.states import Trajectory
from replan.logs.trace import EndReason, Mode, Trace
from replan.metrics import metric
from replan.metrics.boxes import ego_boxes
from replan.metrics.lanes import drivable_lanes, limits_at, stated_lanes
from replan.metrics.metric import Measured, Metric, Reduction, Series, Unavailable, where_followed

SPACING_M, WINDOW_M, BESIDE_M = 1.0, 30.0, 3.0
STRETCH, SLACK_M = 2.0, 0.1
JOIN_M, CHANGE_M = 10.0, 20.0  # Length of the transition to a lane, and to a neighbouring lane
# The line follows lanes for this distance beyond the path or goal, then goes straight
BEYOND_M = 200.0
AHEAD_M, BEYOND_END_M, SAME_M, LAGS_MPS = 5.0, 1000.0, 1e-6, 0.5
SHORTEST_M = 10.0  # A shorter drive defines no route


@dataclass(frozen=True, eq=False)
class ProgressLine:
    """The line (a) of a scenario, from its first state.

    `length`, m, ends where the line enters the goal, else at the end of the log's drive; NaN if
    there is neither. `way` is the gain from which on the goal counts (d), m. `far` ends where the
    line leaves the goal; inf: nowhere.
    """

    line: ReferenceLine
    length: float
    way: float = 0.0
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
    way = way_of(goal, log, ProgressLine(line, np.nan), axle_to_center) if goal else 0.0
    enters = np.nan
    for s, (x, y) in (
        zip((line.s[1:] - axle_to_center).tolist(), line.xy[1:].tolist(), strict=True)
        if regions
        else ()
    ):
        within = any(inside(x, y, region) for region in regions)
        if np.isnan(enters):
            enters = s if within and s >= way else enters
        elif not within:
            return ProgressLine(line, max(enters, SPACING_M), way, s)
    if np.isfinite(enters):
        return ProgressLine(line, max(enters, SPACING_M), way)
    length = driven if driven >= SHORTEST_M else np.nan
    return ProgressLine(line, length, way, length)


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
        way, goal = route_of(scenario).length, scenario.goal
        end = min(scenario.duration, goal.t[1] if goal is not None and goal.t else np.inf)
        return cls((0.0, way), (0.0, end)) if way > 0.0 and end > 0.0 else None

    def lost(
        self, drive: Trajectory, scenario: Scenario, frames: Sequence[float]
    ) -> tuple[FloatArray, FloatArray]:
        """Return the time (9) that a drive loses from each frame to the next, s, and the speed of
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


FLOOR_M = 2.0  # c of (2); a logged drive that gains less is no yardstick
MISSED_STEPS = 500  # Steps of a drive that are looked at for what it missed
LEAST_COVERED = 0.2  # A drive that covers less of its log shows almost nothing
EXCESS_MPS = 2.23  # 5 mph: the mean excess at which (6) is 0
OVER_MPS, OVER_RATIO = 1.0, 0.1  # Faster than the limit by more is over it
REACH_MPS2, REACH_MPS = 9.81, 70.0  # No road vehicle exceeds these (adhesion of 1 g)
EASE_MPS2, SETTLE_S = 1.0, 1.0  # Comfortable deceleration, and a driver's reaction time
_ALONE = Unavailable("the log holds one ego state only: there is no drive to compare with")


def _distance(trace: Trace, scenario: Scenario) -> Measured:
    return Series(trace.ego.t, arc_lengths(trace.ego.x, trace.ego.y))  # (4)


@where_followed
def _route_progress(trace: Trace, scenario: Scenario) -> Measured:
    route = route_of(scenario)
    if len(scenario.ego) > 1:
        # Compare over the same time
        in_time = trace.end is EndReason.GOAL and _is_time_only(scenario.goal)
        until = trace.ego.t[-1] if in_time else scenario.ego.t[-1]
        logged = gain_along(route, scenario.ego).metres
        yardstick, who = float(np.interp(until, scenario.ego.t, logged)), "the log's driver"
    elif scenario.references.follower_gain is not None:
        yardstick, who = scenario.references.follower_gain, "the route follower"
    else:
        return Unavailable("the log holds one ego state only, and no route follower was driven")
    if yardstick < (FLOOR_M if scenario.road.source is RoadSource.LANES else MIN_PATH):
        return Unavailable(
            f"{who} gets {yardstick:.1f} m along the route: no yardstick for progress"
        )
    gain = gain_along(route, trace.ego)
    return Series(trace.ego.t, _full_at_goal(trace, scenario, gain, gain.metres / yardstick))  # (1)


def _is_time_only(goal: Goal | None) -> bool:
    return goal is not None and not goal.regions and goal.v is None and goal.yaw is None


def _progress(trace: Trace, scenario: Scenario) -> Measured:
    if len(scenario.ego) < 2:
        return _ALONE
    route = route_of(scenario)
    yardstick, gain = gain_along(route, scenario.ego).metres[-1], gain_along(route, trace.ego)
    ratio = np.minimum(np.maximum(gain.metres, FLOOR_M) / max(yardstick, FLOOR_M), 1.0)  # (2)
    return Series(
        trace.ego.t,
        _full_at_goal(trace, scenario, gain, np.where(gain.metres < -FLOOR_M, 0.0, ratio)),
    )


def _completion(trace: Trace, scenario: Scenario) -> Measured:
    route = route_of(scenario)
    if not np.isfinite(route.length):
        return Unavailable("the log has neither a goal that lanes lead to nor a drive of 10 m")
    gain = gain_along(route, trace.ego)
    share = np.clip(gain.metres / route.length, 0.0, 1.0)  # (3)
    return Series(trace.ego.t, _full_at_goal(trace, scenario, gain, share))


def _full_at_goal(trace: Trace, scenario: Scenario, gain: Gain, share: FloatArray) -> FloatArray:
    """Raise the last share `(n,)` to 1 if the drive ended in the goal's region, except as the
    module docstring says.
    """
    if trace.end is EndReason.GOAL and gain.cut <= FLOOR_M and not _is_time_only(scenario.goal):
        share[-1] = max(share[-1], 1.0) if covered(trace, scenario) >= LEAST_COVERED else share[-1]
    return share


def covered(trace: Trace, scenario: Scenario) -> float:
    """Return the share (8) of the log that a drive covers; NaN if it ended neither at the goal nor
    with the log.
    """
    if trace.end is not EndReason.GOAL:
        return 1.0 if trace.end is EndReason.END_OF_LOG else np.nan
    if scenario.goal is not None and not scenario.goal.regions:
        return 1.0
    route, first = route_of(scenario), float(trace.ego.t[0])
    logged = float(gain_along(route, scenario.ego).metres[-1])
    whole = logged if logged >= FLOOR_M else route.length
    time = (float(trace.ego.t[-1]) - first) / max(scenario.duration - first, 1e-9)
    distance = float(gain_along(route, trace.ego).metres[-1]) / whole
    return float(np.clip(np.nanmax([time, distance]), 0.0, 1.0))


def _covered(trace: Trace, scenario: Scenario) -> Measured:
    share = covered(trace, scenario)
    if np.isnan(share):
        return Unavailable(f"the drive ended early: {trace.end.value}")
    label = "" if share == 1.0 else f"the goal is reached after {share:.0%} of the log"
    return Series(trace.ego.t[-1:], np.array([share]), (label,))


def excess(trace: Trace, scenario: Scenario, *, ratio: bool = False) -> Measured:
    """Speed above the limit of the lane under the ego (5), m/s.

    With `ratio`, relative to the limit.
    """
    lanes = stated_lanes(scenario.road)
    if lanes is None or not np.isfinite(lanes.limit).any():
        return Unavailable("the log has no speed limits")
    speed, limit = np.abs(trace.ego.v), limits_at(lanes, *ego_boxes(trace.ego, scenario)[:2])
    if ratio:
        # (5)
        value = np.where(limit > 0.0, speed / np.where(limit > 0.0, limit, 1.0) - 1.0, np.nan)
    else:
        held = 0.0 * limit
        if speed[0] > limit[0]:
            held = speed[0] - EASE_MPS2 * np.maximum(trace.ego.t - trace.ego.t[0] - SETTLE_S, 0.0)
        # (5); NaN without a limit
        value = np.maximum(speed - np.maximum(limit, held), 0.0) + 0.0 * limit
    return Series(trace.ego.t, value, missing="the ego is never on a lane with a speed limit")


def _assumed_excess(trace: Trace, scenario: Scenario) -> Measured:
    road, ego, logged = scenario.road, trace.ego, np.abs(scenario.ego.v)
    lanes, stated = drivable_lanes(road), stated_lanes(road)
    assumed, there = np.full(len(ego), True), np.full(len(ego), road.default_speed_limit)
    if lanes is not None and stated is not None:
        x, y = ego_boxes(ego, scenario)[:2]
        known = np.where(np.isfinite(lanes.limit), lanes.limit, road.default_speed_limit)
        there = limits_at(lanes._replace(limit=known), x, y)
        assumed = np.isfinite(there) & np.isnan(limits_at(stated, x, y))
    if not assumed.any():
        return Unavailable("the ego is never on a lane without a speed limit")
    lasted = float(scenario.ego.t[-1] - scenario.ego.t[0])
    fastest = float(np.quantile(logged, max(1.0 - 1.0 / max(lasted, 1.0), 0.5), method="lower"))
    over = np.abs(ego.v) - (1.0 + OVER_RATIO) * np.maximum(there, fastest)
    labels = tuple(
        f"assumed limit: {limit:.1f} m/s, the log's driver {fastest:.1f} m/s"
        for limit in there.tolist()
    )
    return Series(ego.t, np.where(assumed, np.maximum(over, 0.0), np.nan), labels)


def compliance(series: Series) -> tuple[float, int]:
    """The compliance with speed limits (6), 0 to 1, of a series of (5)."""
    span = metric.durations(series.t)[series.known]
    over = float(np.sum(series.value[series.known] * span))
    return max(0.0, 1.0 - over / (EXCESS_MPS * float(span.sum()))) if span.sum() > 0.0 else float(
        not over
    ), -1


def _share_over(series: Series) -> tuple[float, int]:
    span, over = metric.durations(series.t) * series.known, series.value > OVER_MPS
    share = float(np.sum(span[over]) / np.sum(span)) if span.sum() > 0.0 else float(over.any())
    return share, metric.first_of(over)


def _at_end(trace: Trace, *, good: bool) -> Series:
    label = ": ".join(filter(None, [trace.end.value, trace.detail]))
    return Series(trace.ego.t[-1:], np.array([float(good)]), (label,))


def _missed(trace: Trace, scenario: Scenario, goal: Goal) -> Series:
    """Return 0, and what the drive missed of the goal at the step at which it missed the fewest
    conditions.
    """
    x, y = ego_boxes(trace.ego, scenario)[:2]
    steps = np.unique(np.linspace(0, len(x) - 1, MISSED_STEPS).round().astype(int))
    states = np.stack([trace.ego.t, x, y, trace.ego.yaw, trace.ego.v], axis=1)[steps]
    missed = min(
        (goal.unmet(*state) for state in states.tolist()),
        key=lambda names: (len(names), "place" in names),
    )
    label = f"{trace.end.value}: {' and '.join(missed) or 'the way to it'} of the goal missed"
    return Series(trace.ego.t[-1:], np.zeros(1), (label,))


def _goal(trace: Trace, scenario: Scenario) -> Measured:
    if scenario.goal is None:
        return Unavailable("the log names no goal")
    if _is_time_only(scenario.goal):
        return Unavailable("the goal is a time only: progress along the route is asked instead")
    if trace.end is EndReason.GOAL:
        return _at_end(trace, good=True)
    goal, start, first = scenario.goal, scenario.ego.state(0), float(scenario.ego.t[0])
    last = min(scenario.duration, goal.t[1] if goal.t else scenario.duration)
    if goal.t and goal.t[0] > scenario.duration:
        return Unavailable(
            f"the log ends at {scenario.duration:.1f} s, and the goal begins at {goal.t[0]:.1f} s"
        )
    x, y = start.ahead(scenario.vehicle.axle_to_center)
    if not goal.regions or goal.holds_place(x, y):
        return _missed(trace, scenario, goal)
    edges = [
        (a, b)
        for region in goal.regions
        for a, b in zip(region, np.roll(region, -1, axis=0), strict=True)
    ]
    away = min(point_segment(x, y, *a, *b) for a, b in edges)
    top, time = max(start.v, REACH_MPS), last - first
    faster = min(time, (top - start.v) / REACH_MPS2)
    reach = start.v * faster + 0.5 * REACH_MPS2 * faster**2 + top * (time - faster)  # (7)
    if away <= reach:
        return _missed(trace, scenario, goal)
    return Unavailable(
        f"no vehicle reaches the goal: {away:.0f} m in {time:.1f} s from {start.v:.1f} m/s"
    )


_CLOSED = (Mode.CLOSED,)
COVERED = Metric(
    "covered",
    "1",
    "higher",
    _CLOSED,
    _covered,
    (metric.FINAL,),
    "Share of the log that the drive covers, by time or by distance, whichever is more; 1 where it "
    "ended with the log.",
    formula=(
        "max(duration / duration of the log, gain / gain of the log's driver, else / length of "
        "the route)"
    ),
    needs="a drive that ended at the goal or with the log",
)
_LIMITS = "lanes with speed limits under the ego"
DISTANCE = Metric(
    "distance",
    "m",
    "none",
    _CLOSED,
    _distance,
    (metric.FINAL,),
    "Distance driven by the rear axle.",
    formula="sum of |p_k - p_(k-1)|",
)
ROUTE_PROGRESS = Metric(
    "route_progress",
    "1",
    "higher",
    _CLOSED,
    _route_progress,
    (metric.FINAL,),
    "Gain along the route over that of the log's driver in the whole log, else of the route "
    "follower; not capped.",
    version=2,
    formula=(
        "gain(t) / gain of the log's driver at the log's end, else of the route follower; 1 at "
        "the goal"
    ),
    parameters=(
        "floor 2 m",
        "5 m without lanes",
        "a step counts at most 2 |v| dt, where it is more than 0.1 m above",
    ),
    needs=(
        "a logged drive, else the route follower's, of 2 m; without lanes 5 m, on a path that "
        "the vehicle can follow"
    ),
)
PROGRESS = Metric(
    "progress",
    "1",
    "higher",
    _CLOSED,
    _progress,
    (metric.FINAL,),
    "Gain along the route over that of the log's driver in the whole log, capped at 1.",
    "nuPlan devkit e9241677, ego_progress_along_expert_route; along the driven path, 1 at the goal",
    2,
    formula="min(1, max(gain, c) / max(gain of the log's driver, c)), 0 where gain < -c",
    parameters=("c 2 m",),
    needs="a logged drive",
)
COMPLETION = Metric(
    "completion",
    "1",
    "higher",
    _CLOSED,
    _completion,
    (metric.FINAL,),
    "Share of the route that was driven: to the goal, else to the end of the log's drive.",
    "CARLA leaderboard 2.x, route completion, here in 0 .. 1",
    formula="gain(t) / length of the route, in 0 .. 1; 1 where the drive ended at the goal",
    needs="a goal that lanes or the log's path lead to, or a logged drive of 10 m",
)
SPEED = Metric(
    "speed",
    "m/s",
    "none",
    _CLOSED,
    lambda trace, scenario: Series(trace.ego.t, trace.ego.v),
    (metric.MEAN, metric.MAX),
    "Speed of the rear axle, mean over the steps.",
    formula="v",
)
SPEED_EXCESS = Metric(
    "speed_excess",
    "m/s",
    "lower",
    _CLOSED,
    excess,
    (
        metric.MAX,
        metric.MEAN,
        metric.time_above(OVER_MPS, "time_above_1mps"),
        Reduction("share_above_1mps", _share_over, unit="1"),
        Reduction("compliance", compliance, unit="1", direction="higher"),
    ),
    "Speed above the limit of the lane under the ego's centre, the larger one where lanes overlap, "
    "less what the drive"
    " began with and brings down; compliance is like nuPlan's, share that of the time on lanes "
    "with a limit.",
    "compliance: nuPlan devkit e9241677, speed_limit_compliance",
    3,
    formula=(
        "max(|v| - max(limit, held), 0), held = v_0 - 1 m/s2 (t - t_0 - 1 s) after a start "
        "above the limit, else 0;"
        " compliance = max(0, 1 - integral / (2.23 m/s T))"
    ),
    parameters=(
        "2.23 m/s (5 mph)",
        f"over: {OVER_MPS:g} m/s",
        f"comfortable deceleration {EASE_MPS2:g} m/s2",
        f"reaction {SETTLE_S:g} s",
    ),
    needs=_LIMITS,
)
SPEED_RATIO = Metric(
    "speed_ratio",
    "1",
    "lower",
    _CLOSED,
    partial(excess, ratio=True),
    (metric.MAX, metric.time_outside(-np.inf, OVER_RATIO, "time_above_10pct")),
    "Speed over the limit, less 1: 0.1 is 10 % too fast.",
    formula="|v| / limit - 1",
    parameters=("over: 0.1",),
    needs=_LIMITS,
)
ASSUMED_LIMIT_EXCESS = Metric(
    "assumed_limit_excess",
    "m/s",
    "lower",
    _CLOSED,
    _assumed_excess,
    (metric.MAX, metric.time_above(OVER_MPS, "time_above_1mps")),
    "Speed above 1.1 times the larger of the assumed limit and the log's driver's speed, where the "
    "log has no limit.",
    formula=(
        "max(|v| - 1.1 max(assumed limit, speed that the log's driver exceeds for 1 s in all), 0)"
    ),
    parameters=("margin 10 %", f"over: {OVER_MPS:g} m/s"),
    needs="lanes without a speed limit under the ego, or no map",
)
GOAL = Metric(
    "goal",
    "1",
    "higher",
    _CLOSED,
    _goal,
    (metric.FINAL,),
    "1 if the drive ended at the goal.",
    version=2,
    formula="1 if it ended there, else 0",
    parameters=(f"reach {REACH_MPS2} m/s2 up to {REACH_MPS:g} m/s",),
    needs="a goal that is a place, and that a vehicle can reach in the time",
)
COMPLETED = Metric(
    "completed",
    "1",
    "higher",
    _CLOSED,
    lambda trace, scenario: _at_end(
        trace, good=trace.end in (EndReason.GOAL, EndReason.END_OF_LOG)
    ),
    (metric.FINAL,),
    "1 if the drive ended at the goal or the log's end.",
    formula="1 if it ended so, else 0",
)
