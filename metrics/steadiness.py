"""Steadiness, closed loop, every 0.1 s: a driver who is off the middle, restless, or too fast,
which no single event shows.

Each of these measures leaves out the steps at which there is a reason (`reasons`).

(1) lane_offset(t) = distance l of the ego's centre from the middle of its lane,
        positive to the left; not judged in a curve, at rest, while a road user beside or ahead is
        to be passed and `KEPT_S` after that, and at first for `SETTLES_S` and |l_0| / `RETURN_MPS`,
        in which an offset of the start goes.
    kept: the largest d so that |l| >= d on one side in three quarters of the judged time
(2) swing(t) = 1 where a fall of the speed by `FALL_MPS` or more ends, between two turning points;
        "needless": where it had no reason to slow down all the time. per_minute: of the time of the
        drive, or of that without a reason; at least `LEAST_S`
(3) needless_lane_change(t) = 1 where the ego's centre crosses from a lane into the one beside it,
        if in the last `CALLED_S` no road user was in its way ahead, and the route neither lies on
        that side nor crosses to it further on
(4) braked_behind(t) = least deceleration that keeps a vehicle behind the ego from hitting it
        (`cut_in`, (2)) from the begin of a fall (2) on, less what it would be if the ego kept its
        speed
(5) curve_accel(t) = |mean of v^2 kappa over (t - 1 s, t]|: a curve, and no swerve
"""

from __future__ import annotations

from functools import partial
from itertools import pairwise

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.once import once
from replan.logs.lane_arrays import LaneArrays
from replan.logs.scenario import Scenario
from replan.logs.trace import Trace
from replan.metrics.boxes import GRID_S, ego_boxes, grid_of
from replan.metrics.comfort import lateral_acceleration
from replan.metrics.cut_in import (
    HORIZON_S,
    IN_M,
    MOST_MPS2,
    REACT_S,
    CutInStay,
    Follower,
    followers,
    needed_deceleration,
    worst_forced,
)
from replan.metrics.lanes import NO_LANES, mapped_lanes, under
from replan.metrics.metric import Measured, Parts, Reduction, Series, Unavailable, metric
from replan.metrics.needless import turning_points
from replan.metrics.reasons import AFTER_S, SLACK_MPS, STANDS_MPS, reasons
from replan.metrics.reductions import COUNT, MAX, MAX_ABS, durations, first_of
from replan.metrics.route_gain import gain_along, route_of

FALL_MPS = 0.5
SETTLES_S, RETURN_MPS = 4.0, 0.1
KEPT_S, JUDGED_S = 10.0, 8.0
LEAST_S = 20.0
CALLED_S, CROSSED = 6.0, 0.7
MEAN_S = 1.0


def _kept(series: Series) -> tuple[float, int]:
    """Return the offset that is kept for three quarters of the time, on one side; 0 if there is
    none.
    """
    low, high = np.quantile(series.value[series.known], [0.25, 0.75]).tolist()
    return max(low, -high, 0.0), -1


def _per_minute(series: Series) -> tuple[float, int]:
    free = float(durations(series.t)[series.known].sum())
    return 60.0 * float(np.nansum(series.value)) / max(free, LEAST_S), first_of(series.value > 0.0)


_lane_metric = partial(metric, better="lower", needs="lanes in the log")


@_lane_metric(
    unit="m",
    reductions=(Reduction("kept", _kept), MAX_ABS),
    parameters=(f"judged for {JUDGED_S:g} s", f"an offset of the start goes with {RETURN_MPS} m/s"),
    source="NAVSIM's lane keeping (EPDMS): 0.5 m for 2 s",
)
def lane_offset(trace: Trace, scenario: Scenario) -> Measured:
    """Offset from the middle of the lane that the ego keeps while nothing calls for it.

    Formula: the largest d with |l| >= d on one side in three quarters of the judged time
    """
    lanes = mapped_lanes(scenario.road)
    if lanes is None:
        return NO_LANES
    ego, cause = grid_of(trace), reasons(trace, scenario)
    left = under(lanes, *ego_boxes(ego, scenario)[:3]).left
    settled = ego.t - ego.t[0] >= max(SETTLES_S, np.nan_to_num(abs(left[0])) / RETURN_MPS)
    passed = ego.t - np.maximum.accumulate(np.where(cause.beside, ego.t, -np.inf)) > KEPT_S
    judged = settled & passed & ~cause.steer & (np.abs(ego.v) >= STANDS_MPS) & np.isfinite(left)
    if judged.sum() * GRID_S < JUDGED_S:
        return Unavailable(
            f"less than {JUDGED_S:g} s on a lane without a reason to leave its middle"
        )
    return Series(ego.t, np.where(judged, left, np.nan))


@metric(
    unit="count",
    better="lower",
    reductions=(Reduction("per_minute", _per_minute, "1/min", empty=0.0), COUNT),
    parts=("all", "needless"),
    parameters=(f"fall {FALL_MPS} m/s", f"at least {LEAST_S:g} s"),
)
def speed_swing(trace: Trace, scenario: Scenario) -> Parts:
    """Falls of the ego's speed by 0.5 m/s or more: all of them, and those while nothing called for
    slowing down.

    Formula: sum of the falls; per minute, of the time without a reason for the needless ones
    """
    ego = reasons(trace, scenario)
    free, every = np.where(ego.slow, np.nan, 0.0), np.zeros(len(ego.t))
    for first, last in pairwise(turning_points(ego.v, FALL_MPS)):
        every[last] = ego.v[last] < ego.v[first]
    for _, end in falls(trace, scenario):
        free[np.searchsorted(ego.t, end - 1e-9)] = 1.0
    missing = "something called for slowing down all the time"
    return {"all": Series(ego.t, every), "needless": Series(ego.t, free, missing=missing)}


@once
def falls(trace: Trace, scenario: Scenario) -> tuple[tuple[float, float], ...]:
    """Return the falls of the speed by `FALL_MPS` or more without a reason, between two turning
    points: s from, to.
    """
    ego, spans = reasons(trace, scenario), []
    for steps in np.split(np.arange(len(ego.t)), np.flatnonzero(np.diff(ego.slow)) + 1):
        v = ego.v[steps]
        for a, b in pairwise(turning_points(v, FALL_MPS)) if not ego.slow[steps[0]] else ():
            if v[b] < v[a]:
                begin = a + np.flatnonzero(v[a : b + 1] >= v[a] - SLACK_MPS)[-1]
                spans.append((float(ego.t[steps[begin]]), float(ego.t[steps[b]])))
    return tuple(spans)


@_lane_metric(
    unit="count",
    reductions=(COUNT,),
    parameters=(f"a road user in the way in the last {CALLED_S:g} s",),
)
def needless_lane_change(trace: Trace, scenario: Scenario) -> Measured:
    """Lane changes of the ego away from its route while no road user was in its way.

    Formula: sum of the crossings of a line between lanes that nothing called for
    """
    lanes = mapped_lanes(scenario.road)
    if lanes is None:
        return NO_LANES
    ego, cause, line = grid_of(trace), reasons(trace, scenario), route_of(scenario).line
    s, counts = gain_along(route_of(scenario), ego).metres, np.zeros(len(ego.t))
    route = [
        (line.s[k], side) for k, side in _crossings(lanes, line.xy[:, 0], line.xy[:, 1], line.yaw)
    ]
    x, y, yaw = ego_boxes(ego, scenario)[:3]
    for k, side in _crossings(lanes, x, y, yaw):
        recent = (ego.t >= ego.t[k] - CALLED_S) & (ego.t <= ego.t[k])
        follows = any(route_side == side and station > s[k] for station, route_side in route)
        towards = cause.l[k] * side < 0.0 or follows
        counts[k] = not cause.change[recent].any() and not towards
    return Series(ego.t, counts)


def _crossings(
    lanes: LaneArrays, x: FloatArray, y: FloatArray, yaw: FloatArray
) -> list[tuple[int, float]]:
    """Return where a drive crosses into the lane beside: the first step in it, and the side, 1
    left, -1 right.
    """
    lane = under(lanes, np.ascontiguousarray(x), np.ascontiguousarray(y), np.ascontiguousarray(yaw))
    share = np.nan_to_num(lane.left / lane.half)
    steps = np.flatnonzero(
        (share[:-1] * share[1:] < 0.0) & (np.minimum(abs(share[:-1]), abs(share[1:])) > CROSSED)
    )
    return [(k + 1, float(np.sign(share[k]))) for k in steps.tolist()]


@metric(
    unit="m/s2",
    better="lower",
    reductions=(MAX,),
    parameters=(f"reaction {REACT_S} s", f"horizon {HORIZON_S:g} s", f"at most {MOST_MPS2} m/s2"),
    needs="a fall of the speed by 0.5 m/s without a reason, and a follower",
    source="UN R79, 5.6.4.7: 3 m/s2; UN R157, 5.2.5.2 for the reaction time",
)
def braked_behind(trace: Trace, scenario: Scenario) -> Measured:
    """Deceleration that the ego forces on a follower by slowing down without a reason.

    Formula: as forced_braking, from the begin of each needless fall of speed_swing
    """
    if len(trace.ego) < 2:
        return Unavailable("the drive holds one ego state only")
    spans = falls(trace, scenario)
    stays: list[CutInStay] = []
    for follower in followers(trace.ego, trace.agents, scenario) if spans else ():
        for begin, end in spans:
            first, last = np.searchsorted(follower.ego.t, [begin - 1e-6, end + HORIZON_S]).tolist()
            in_path = first < len(follower.ego) and follower.ahead[first]
            if in_path and follower.deep[first] >= IN_M:
                forced = follower.needed(first, min(last, len(follower.ego)) - 1)
                more = max(forced - _needed_anyway(follower, first), 0.0)
                stays.append(CutInStay(begin, end + AFTER_S, follower.agent, more))
    missing = "the ego never slowed down without a reason before a follower"
    return worst_forced(
        trace, stays, scenario, "the ego slowed down before it without a reason", missing
    )


def _needed_anyway(follower: Follower, step: int) -> float:
    """Return the deceleration (`cut_in`, (2)) if the ego keeps its speed from a step on, m/s2."""
    t = np.arange(0.0, HORIZON_S, GRID_S)
    gap_m = follower.rear[step] - follower.front[step] + float(follower.ego.v[step]) * t
    return needed_deceleration(t, gap_m, float(follower.u[step]))


@metric(
    unit="m/s2",
    better="lower",
    reductions=(MAX,),
    parameters=(f"mean over {MEAN_S:g} s",),
    needs="a drive of 1 s",
    source="UN R79, 5.6.2.1.3 and ISO 11270: 3 m/s2",
)
def curve_accel(trace: Trace, scenario: Scenario) -> Measured:
    """Lateral acceleration that lasts: its mean over 1 s.

    Formula: |mean of v^2 kappa over 1 s|
    """
    t, accel = trace.ego.t, lateral_acceleration(trace.ego)
    total = np.r_[0.0, np.cumsum(0.5 * np.diff(t) * (accel[1:] + accel[:-1]))]
    mean = (total - np.interp(t - MEAN_S, t, total)) / MEAN_S
    known = t - MEAN_S >= t[0] - 1e-9
    return Series(t, np.where(known, np.abs(mean), np.nan), missing="the drive is shorter than 1 s")
