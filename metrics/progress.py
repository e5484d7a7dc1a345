"""Closed loop: did the ego get on along its route, how fast, and did it arrive?

With the gain of a drive along the route (`route`), the whole log taken as the yardstick however short the drive was:

(1) route_progress(t) = gain(t) / gain of the log's driver at the log's end
    where the log has no drive: over the distance of the competent and careful driver (metadata `CAREFUL_M`);
    where that yardstick is below 2 m: 1, and 0 for a drive that went back more than 2 m
(2) progress = min(1, max(gain, c) / max(gain of the log's driver, c)), 0 where gain < -c;  c = 2 m      (nuPlan)
(3) completion = gain / length of the route, in 0 .. 1                                                   (CARLA)
    all three: 1 at least where the drive ended at the goal, unless more than 2 m of it were cut
(4) distance(t) = length of the path of the rear axle driven since the start
(5) speed_excess(t) = max(v - limit, 0),  speed_ratio(t) = v / limit - 1
    assumed_limit_excess(t) = max(v - 1.1 max(assumed limit, the fastest second of the log's driver), 0)
    where the log has no limit: an assumed one may be too low by a step of signs, and by what the driver knew
(6) speed_limit_compliance = max(0, 1 - integral of (5) dt / (2.23 m/s T)),  T the time on lanes with a limit  (nuPlan)
"""

from __future__ import annotations

from functools import partial

import numpy as np

from logs.kernel import FloatArray
from logs.road import RoadSource
from logs.scenario import Scenario
from logs.states import Trajectory
from logs.trace import EndReason, Mode, Trace
from metrics.lanes import drivable_lanes, limits_at
from metrics.metric import (
    FINAL,
    MAX,
    MEAN,
    Measured,
    Metric,
    Reduction,
    Series,
    Unavailable,
    holds,
    time_above,
    time_outside,
)
from metrics.others import ego_boxes
from metrics.route import Gain, gained, route_of

FLOOR_M = 2.0
EXCESS_MPS = 2.23
"""5 mph."""
OVER_MPS, OVER_RATIO = 1.0, 0.1
CAREFUL_M = "reference_cc.travelled_m"
"""Metadata entry: how far the competent and careful driver comes in the log's time, m."""
_ALONE = Unavailable("the log holds one ego state only: there is no drive to compare with")


def _driven(drive: Trajectory) -> FloatArray:
    return np.asarray(np.r_[0.0, np.cumsum(np.hypot(np.diff(drive.x), np.diff(drive.y)))])


def _distance(trace: Trace, scenario: Scenario) -> Measured:
    return Series(trace.ego.t, _driven(trace.ego))


def _route_progress(trace: Trace, scenario: Scenario) -> Measured:
    route = route_of(scenario)
    if len(scenario.ego) > 1:
        asked = float(gained(route, scenario.ego).metres[-1])
    elif CAREFUL_M in scenario.metadata:
        asked = float(scenario.metadata[CAREFUL_M])
    else:
        return Unavailable("the log holds one ego state only, and no reference driver's distance")
    gain = gained(route, trace.ego)
    if asked < FLOOR_M:
        return Series(trace.ego.t, np.where(gain.metres < -FLOOR_M, 0.0, 1.0))
    return Series(trace.ego.t, _arrived(trace, gain, gain.metres / asked))


def _progress(trace: Trace, scenario: Scenario) -> Measured:
    if len(scenario.ego) < 2:
        return _ALONE
    route = route_of(scenario)
    asked, gain = gained(route, scenario.ego).metres[-1], gained(route, trace.ego)
    ratio = np.minimum(np.maximum(gain.metres, FLOOR_M) / max(asked, FLOOR_M), 1.0)
    return Series(trace.ego.t, _arrived(trace, gain, np.where(gain.metres < -FLOOR_M, 0.0, ratio)))


def _completion(trace: Trace, scenario: Scenario) -> Measured:
    route = route_of(scenario)
    if not np.isfinite(route.length):
        return Unavailable("the log has neither a goal that lanes lead to nor a drive of 10 m")
    gain = gained(route, trace.ego)
    return Series(trace.ego.t, _arrived(trace, gain, np.clip(gain.metres / route.length, 0.0, 1.0)))


def _arrived(trace: Trace, gain: Gain, share: FloatArray) -> FloatArray:
    """A share `(n,)` that is 1 at least where the drive ended at the goal, unless more than 2 m of it were cut."""
    if trace.end is EndReason.GOAL and gain.cut <= FLOOR_M:
        share[-1] = max(share[-1], 1.0)
    return share


def _speed(trace: Trace, scenario: Scenario) -> Measured:
    return Series(trace.ego.t, trace.ego.v)


def _excess(trace: Trace, scenario: Scenario, *, ratio: bool = False) -> Measured:
    lanes = drivable_lanes(scenario.road)
    if scenario.road.source is RoadSource.DRIVEN_PATH or lanes is None or not np.isfinite(lanes.limit).any():
        return Unavailable("the log has no speed limits")
    speed, limit = np.abs(trace.ego.v), limits_at(lanes, *ego_boxes(trace.ego, scenario)[:2])
    if ratio:
        value = np.where(limit > 0.0, speed / np.where(limit > 0.0, limit, 1.0) - 1.0, np.nan)
    else:
        value = np.maximum(speed - limit, 0.0)
    return Series(trace.ego.t, value, missing="the ego is never on a lane with a speed limit")


def _assumed_excess(trace: Trace, scenario: Scenario) -> Measured:
    road, ego, logged = scenario.road, trace.ego, np.abs(scenario.ego.v)
    lanes, assumed = drivable_lanes(road), np.full(len(ego), True)
    if road.source is not RoadSource.DRIVEN_PATH and lanes is not None:
        x, y = ego_boxes(ego, scenario)[:2]
        on_lane = np.isfinite(limits_at(lanes._replace(limit=np.nan_to_num(lanes.limit)), x, y))
        assumed = on_lane & np.isnan(limits_at(lanes, x, y))
    if not assumed.any():
        return Unavailable("the ego is never on a lane without a speed limit")
    lasted = float(scenario.ego.t[-1] - scenario.ego.t[0])
    fastest = float(np.quantile(logged, max(1.0 - 1.0 / max(lasted, 1.0), 0.5), method="lower"))
    limit = (1.0 + OVER_RATIO) * max(road.default_speed_limit, fastest)
    label = f"assumed limit: {road.default_speed_limit:.1f} m/s, the log's driver {fastest:.1f} m/s"
    value = np.where(assumed, np.maximum(np.abs(ego.v) - limit, 0.0), np.nan)
    return Series(ego.t, value, (label,) * len(ego))


def compliance(series: Series) -> tuple[float, int]:
    """(6)."""
    span = holds(series.t)[series.known]
    over = float(np.sum(series.value[series.known] * span))
    return max(0.0, 1.0 - over / (EXCESS_MPS * float(span.sum()))) if span.sum() > 0.0 else float(not over), -1


def _share_over(series: Series) -> tuple[float, int]:
    span, over = holds(series.t) * series.known, series.value > OVER_MPS
    first = int(np.argmax(over)) if over.any() else -1
    return (float(np.sum(span[over]) / np.sum(span)) if span.sum() > 0.0 else float(over.any())), first


def _at_end(trace: Trace, *, good: bool) -> Series:
    label = ": ".join(filter(None, [trace.end.value, trace.detail]))
    return Series(trace.ego.t[-1:], np.array([float(good)]), (label,))


def _goal(trace: Trace, scenario: Scenario) -> Measured:
    if scenario.goal is None:
        return Unavailable("the log names no goal")
    return _at_end(trace, good=trace.end is EndReason.GOAL)


def _completed(trace: Trace, scenario: Scenario) -> Measured:
    return _at_end(trace, good=trace.end in (EndReason.GOAL, EndReason.END_OF_LOG))


_CLOSED = (Mode.CLOSED,)
_LIMITS = "lanes with speed limits under the ego"
DISTANCE = Metric(
    "distance", "m", "none", _CLOSED, _distance, (FINAL,), "Distance driven by the rear axle.",
    formula="sum of |p_k - p_(k-1)|",
)  # fmt: skip
ROUTE_PROGRESS = Metric(
    "route_progress", "1", "higher", _CLOSED, _route_progress, (FINAL,),
    "Gain along the route over that of the log's driver in the whole log, else of the careful driver; not capped.",
    formula="gain(t) / gain of the log's driver at the log's end; 1 where that is below 2 m, and at the goal",
    parameters=("floor 2 m", "a step counts at most 2 |v| dt, where it is more than 0.1 m above"),
    needs="a logged drive, else the careful driver's distance",
)  # fmt: skip
PROGRESS = Metric(
    "progress", "1", "higher", _CLOSED, _progress, (FINAL,),
    "Gain along the route over that of the log's driver in the whole log, capped at 1.",
    "nuPlan devkit e9241677, ego_progress_along_expert_route; along the driven path, 1 at the goal", 2,
    formula="min(1, max(gain, c) / max(gain of the log's driver, c)), 0 where gain < -c",
    parameters=("c 2 m",), needs="a logged drive",
)  # fmt: skip
COMPLETION = Metric(
    "completion", "1", "higher", _CLOSED, _completion, (FINAL,),
    "Share of the route that was driven: to the goal, else to the end of the log's drive.",
    "CARLA leaderboard 2.x, route completion, here in 0 .. 1",
    formula="gain(t) / length of the route, in 0 .. 1; 1 where the drive ended at the goal",
    needs="a goal that lanes or the log's path lead to, or a logged drive of 10 m",
)  # fmt: skip
SPEED = Metric(
    "speed", "m/s", "none", _CLOSED, _speed, (MEAN, MAX), "Speed of the rear axle, mean over the steps.", formula="v"
)
SPEED_EXCESS = Metric(
    "speed_excess", "m/s", "lower", _CLOSED, _excess,
    (
        MAX, MEAN, time_above(OVER_MPS, "time_above_1mps"),
        Reduction("share_above_1mps", _share_over, unit="1"),
        Reduction("compliance", compliance, unit="1", direction="higher"),
    ),
    "Speed above the limit of the lane under the ego's centre, the larger one where lanes overlap; compliance is"
    " nuPlan's score, share that of the time on lanes with a limit.",
    "compliance: nuPlan devkit e9241677, speed_limit_compliance", 2,
    formula="max(|v| - limit, 0); compliance = max(0, 1 - integral / (2.23 m/s T))",
    parameters=("2.23 m/s (5 mph)", f"over: {OVER_MPS:g} m/s"), needs=_LIMITS,
)  # fmt: skip
SPEED_RATIO = Metric(
    "speed_ratio", "1", "lower", _CLOSED, partial(_excess, ratio=True),
    (MAX, time_outside(-np.inf, OVER_RATIO, "time_above_10pct")), "Speed over the limit, less 1: 0.1 is 10 % too fast.",
    formula="|v| / limit - 1", parameters=("over: 0.1",), needs=_LIMITS,
)  # fmt: skip
ASSUMED_LIMIT_EXCESS = Metric(
    "assumed_limit_excess", "m/s", "lower", _CLOSED, _assumed_excess, (MAX, time_above(OVER_MPS, "time_above_1mps")),
    "Speed above 1.1 times the larger of the assumed limit and the log's driver's speed, where the log has no limit.",
    formula="max(|v| - 1.1 max(assumed limit, speed that the log's driver exceeds for 1 s in all), 0)",
    parameters=("margin 10 %", f"over: {OVER_MPS:g} m/s"), needs="lanes without a speed limit under the ego, or no map",
)  # fmt: skip
GOAL = Metric(
    "goal", "1", "higher", _CLOSED, _goal, (FINAL,), "1 if the drive ended at the goal.",
    formula="1 if it ended there, else 0", needs="a goal in the log",
)  # fmt: skip
COMPLETED = Metric(
    "completed", "1", "higher", _CLOSED, _completed, (FINAL,), "1 if the drive ended at the goal or the log's end.",
    formula="1 if it ended so, else 0",
)  # fmt: skip
