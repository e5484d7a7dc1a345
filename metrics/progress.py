"""Progress, closed loop: how far and how fast the ego drives along its route.

With the gain of a drive along the route (`route_gain`); the yardstick is the whole log, even if the
drive was shorter:

(1) route_progress(t) = gain(t) / gain of the log's driver at the log's end
    where the log has no drive: over the gain of the route follower (`Scenario.references`);
    unavailable if that yardstick is below 2 m: then it is unknown how far a planner should drive;
    below 5 m where the log has no lanes: its lane is then not what was driven
    (`replan.logs.complete`)
(2) progress = min(1, max(gain, c) / max(gain of the log's driver, c)), 0 where gain < -c;  c = 2 m
        (nuPlan)
(3) completion = gain / length of the route, in 0 .. 1
        (CARLA) all three: at least 1 if the drive ended in the goal's region, unless more than 2 m
        of its gain were cut, or (5) is below LEAST_COVERED
(4) distance(t) = length of the path of the rear axle driven since the start
(5) covered = max(duration of the drive / duration of the log, gain
        / gain of the log's driver, without a logged drive of 2 m: gain / length of the route) of a
        drive that ended at a goal that is a place; 1 where it ended with the log, or at a goal
        without a place
"""

from __future__ import annotations

from functools import partial

import numpy as np

from replan.core.arrays import FloatArray, arc_lengths
from replan.logs.complete import MIN_PATH
from replan.logs.road import Goal, RoadSource
from replan.logs.scenario import Scenario
from replan.logs.trace import EndReason, Trace
from replan.metrics.metric import Measured, Series, Unavailable, metric, where_followed
from replan.metrics.reductions import FINAL, MAX, MEAN
from replan.metrics.route_gain import Gain, gain_along, route_of

FLOOR_M = 2.0  # c of (2); a logged drive that gains less is no yardstick
LEAST_COVERED = 0.2  # A drive that covers less of its log shows almost nothing
_ALONE = Unavailable("the log holds one ego state only: there is no drive to compare with")
_share_metric = partial(metric, unit="1", better="higher", reductions=(FINAL,))


@_share_metric(needs="a drive that ended at the goal or with the log")
def covered(trace: Trace, scenario: Scenario) -> Measured:
    """Share of the log that the drive covers, by time or by distance, whichever is more; 1 where it
    ended with the log.

    Formula: max(duration / duration of the log, gain / gain of the log's driver, else / length of
    the route)
    """
    share = covered_share(trace, scenario)
    if share is None:
        return Unavailable(f"the drive ended early: {trace.end.value}")
    label = "" if share == 1.0 else f"the goal is reached after {share:.0%} of the log"
    return Series(trace.ego.t[-1:], np.array([share]), (label,))


def covered_share(trace: Trace, scenario: Scenario) -> float | None:
    """Return the share (5) of the log that a drive covers; None if it ended neither at the goal nor
    with the log.
    """
    if trace.end is not EndReason.GOAL:
        return 1.0 if trace.end is EndReason.END_OF_LOG else None
    if scenario.goal is not None and not scenario.goal.regions:
        return 1.0
    route, first = route_of(scenario), float(trace.ego.t[0])
    logged = float(gain_along(route, scenario.ego).metres[-1])
    whole = logged if logged >= FLOOR_M else route.length
    time = (float(trace.ego.t[-1]) - first) / max(scenario.duration - first, 1e-9)
    distance = float(gain_along(route, trace.ego).metres[-1]) / whole
    return float(np.clip(np.nanmax([time, distance]), 0.0, 1.0))


@metric(unit="m", better="none", reductions=(FINAL,))
def distance(trace: Trace, scenario: Scenario) -> Measured:
    """Distance driven by the rear axle.

    Formula: sum of |p_k - p_(k-1)|
    """
    return Series(trace.ego.t, arc_lengths(trace.ego.x, trace.ego.y))  # (4)


@_share_metric(
    parameters=(
        "floor 2 m",
        "5 m without lanes",
        "a step counts at most 2 |v| dt, where it is more than 0.1 m above",
    ),
    needs="a logged drive, else the route follower's, of 2 m; without lanes 5 m, on a path that "
    "the vehicle can follow",
    version=2,
)
@where_followed
def route_progress(trace: Trace, scenario: Scenario) -> Measured:
    """Gain along the route over that of the log's driver in the whole log, else of the route
    follower; not capped.

    Formula: gain(t) / gain of the log's driver at the log's end, else of the route follower; 1 at
    the goal
    """
    route = route_of(scenario)
    if len(scenario.ego) > 1:
        # Compare over the same time
        in_time = trace.end is EndReason.GOAL and is_time_only(scenario.goal)
        until = trace.ego.t[-1] if in_time else scenario.ego.t[-1]
        logged = gain_along(route, scenario.ego).metres
        yardstick, driver = float(np.interp(until, scenario.ego.t, logged)), "the log's driver"
    elif scenario.references.follower_gain is not None:
        yardstick, driver = scenario.references.follower_gain, "the route follower"
    else:
        return Unavailable("the log holds one ego state only, and no route follower was driven")
    if yardstick < (FLOOR_M if scenario.road.source is RoadSource.LANES else MIN_PATH):
        return Unavailable(
            f"{driver} gets {yardstick:.1f} m along the route: no yardstick for progress"
        )
    gain = gain_along(route, trace.ego)
    return Series(trace.ego.t, _full_at_goal(trace, scenario, gain, gain.metres / yardstick))  # (1)


@_share_metric(
    parameters=("c 2 m",),
    needs="a logged drive",
    source="nuPlan devkit e9241677, ego_progress_along_expert_route; along the driven path, 1 at "
    "the goal",
    version=2,
)
def progress(trace: Trace, scenario: Scenario) -> Measured:
    """Gain along the route over that of the log's driver in the whole log, capped at 1.

    Formula: min(1, max(gain, c) / max(gain of the log's driver, c)), 0 where gain < -c
    """
    if len(scenario.ego) < 2:
        return _ALONE
    route = route_of(scenario)
    yardstick, gain = gain_along(route, scenario.ego).metres[-1], gain_along(route, trace.ego)
    ratio = np.minimum(np.maximum(gain.metres, FLOOR_M) / max(yardstick, FLOOR_M), 1.0)  # (2)
    share = np.where(gain.metres < -FLOOR_M, 0.0, ratio)
    return Series(trace.ego.t, _full_at_goal(trace, scenario, gain, share))


@_share_metric(
    needs="a goal that lanes or the log's path lead to, or a logged drive of 10 m",
    source="CARLA leaderboard 2.x, route completion, here in 0 .. 1",
)
def completion(trace: Trace, scenario: Scenario) -> Measured:
    """Share of the route that was driven: to the goal, else to the end of the log's drive.

    Formula: gain(t) / length of the route, in 0 .. 1; 1 where the drive ended at the goal
    """
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
    if trace.end is EndReason.GOAL and gain.cut <= FLOOR_M and not is_time_only(scenario.goal):
        covered_part = covered_share(trace, scenario)
        if covered_part is not None and covered_part >= LEAST_COVERED:
            share[-1] = max(share[-1], 1.0)
    return share


def is_time_only(goal: Goal | None) -> bool:
    """Return whether a goal asks for a time, and for nothing else."""
    return goal is not None and not goal.regions and goal.v is None and goal.yaw is None


@metric(unit="m/s", better="none", reductions=(MEAN, MAX))
def speed(trace: Trace, scenario: Scenario) -> Measured:
    """Speed of the rear axle, mean over the steps.

    Formula: v
    """
    return Series(trace.ego.t, trace.ego.v)
