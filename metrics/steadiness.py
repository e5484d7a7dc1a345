"""Faults that no single event shows, closed loop, every 0.1 s: a driver who is off the middle, restless, or too fast.

The reasons of the ego are those of `needless`; each measure leaves out the steps at which there is one.

(1) lane_offset(t) = distance l of the ego's centre from the middle of its lane, positive to the left; not judged in a
    curve, at rest, while a road user beside or ahead is to be passed and `KEPT_S` after that, and at first for
    `SETTLES_S` and |l_0| / `RETURN_MPS`, in which an offset of the start goes.
    kept: the largest d so that |l| >= d on one side in three quarters of the judged time
(2) swing(t) = 1 where a fall of the speed by `FALL_MPS` or more ends, between two turning points; "needless": where it
    had no reason to slow down all the time. per_minute: of the time of the drive, or of that without a reason; at least
    `LEAST_S`
(3) needless_lane_change(t) = 1 where the ego's centre crosses from a lane into the one beside it, if in the last
    `CALLED_S` no road user was in its way ahead, and the route neither lies on that side nor crosses to it further on
(4) braked_behind(t) = least deceleration that keeps a vehicle behind the ego from hitting it (`cut_in`, (2)) from the
    begin of a fall (2) on, less what it would be if the ego kept its speed
(5) curve_accel(t) = |mean of v^2 kappa over (t - 1 s, t]|: a curve, and no swerve
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from logs.arrays import FloatArray
from logs.scenario import Scenario
from logs.trace import Mode, Trace
from metrics.boxes import GRID_S, ego_boxes, grid_of
from metrics.comfort import lat_accel
from metrics.cut_in import HORIZON_S, IN_M, MOST_MPS2, REACT_S, CutInStay, followers, needed_deceleration, worst_forced
from metrics.lanes import LaneArrays, mapped_lanes, under
from metrics.metric import COUNT, MAX, MAX_ABS, Measured, Metric, Reduction, Series, Unavailable, durations, first_of
from metrics.needless import AFTER_S, FALL_MPS, STANDS_MPS, falls, reasons, turning_points
from metrics.progress import gain_along, route_of
from metrics.traffic_rules import NO_LANES

SETTLES_S, KEPT_S, JUDGED_S, RETURN_MPS = 4.0, 10.0, 8.0, 0.1
LEAST_S = 20.0
CALLED_S, CROSSED = 6.0, 0.7
MEAN_S = 1.0


def _lane_offset(trace: Trace, scenario: Scenario) -> Measured:
    if (lanes := mapped_lanes(scenario.road)) is None:
        return NO_LANES
    ego, found = grid_of(trace), reasons(trace, scenario)
    left = under(lanes, *ego_boxes(ego, scenario)[:3]).left
    settled = ego.t - ego.t[0] >= max(SETTLES_S, np.nan_to_num(abs(left[0])) / RETURN_MPS)
    passed = ego.t - np.maximum.accumulate(np.where(found.beside, ego.t, -np.inf)) > KEPT_S
    judged = settled & passed & ~found.steer & (np.abs(ego.v) >= STANDS_MPS) & np.isfinite(left)
    if judged.sum() * GRID_S < JUDGED_S:
        return Unavailable(f"less than {JUDGED_S:g} s on a lane without a reason to leave its middle")
    return Series(ego.t, np.where(judged, left, np.nan))


def _kept(series: Series) -> tuple[float, int]:
    """Return the offset that is kept for three quarters of the time, on one side; 0 if there is none."""
    low, high = np.quantile(series.value[series.known], [0.25, 0.75]).tolist()
    return max(low, -high, 0.0), -1


def _swing(trace: Trace, scenario: Scenario) -> Mapping[str, Measured]:
    found = reasons(trace, scenario)
    free, every = np.where(found.slow, np.nan, 0.0), np.zeros(len(found.t))
    for a, b in pairwise(turning_points(found.v, FALL_MPS)):
        every[b] = found.v[b] < found.v[a]
    for _, end in falls(trace, scenario):
        free[np.searchsorted(found.t, end - 1e-9)] = 1.0
    missing = "something called for slowing down all the time"
    return {"all": Series(found.t, every), "needless": Series(found.t, free, missing=missing)}


def _per_minute(series: Series) -> tuple[float, int]:
    free = float(durations(series.t)[series.known].sum())
    return 60.0 * float(np.nansum(series.value)) / max(free, LEAST_S), first_of(series.value > 0.0)


def _lane_change(trace: Trace, scenario: Scenario) -> Measured:
    if (lanes := mapped_lanes(scenario.road)) is None:
        return NO_LANES
    ego, found, line = grid_of(trace), reasons(trace, scenario), route_of(scenario).line
    s, counts = gain_along(route_of(scenario), ego).metres, np.zeros(len(ego.t))
    route = [(line.s[k], side) for k, side in _crossings(lanes, line.xy[:, 0], line.xy[:, 1], line.yaw)]
    x, y, yaw = ego_boxes(ego, scenario)[:3]
    for k, side in _crossings(lanes, x, y, yaw):
        called = found.change[(ego.t >= ego.t[k] - CALLED_S) & (ego.t <= ego.t[k])].any()
        towards = found.l[k] * side < 0.0 or any(one == side and at > s[k] for at, one in route)
        counts[k] = not called and not towards
    return Series(ego.t, counts)


def _crossings(lanes: LaneArrays, x: FloatArray, y: FloatArray, yaw: FloatArray) -> list[tuple[int, float]]:
    """Return where a drive crosses into the lane beside: the first step in it, and the side, 1 left, -1 right."""
    found = under(lanes, np.ascontiguousarray(x), np.ascontiguousarray(y), np.ascontiguousarray(yaw))
    share = np.nan_to_num(found.left / found.half)
    steps = np.flatnonzero((share[:-1] * share[1:] < 0.0) & (np.minimum(abs(share[:-1]), abs(share[1:])) > CROSSED))
    return [(k + 1, float(np.sign(share[k]))) for k in steps.tolist()]


def _braked_behind(trace: Trace, scenario: Scenario) -> Measured:
    if len(trace.ego) < 2:
        return Unavailable("the drive holds one ego state only")
    stays, spans = [], falls(trace, scenario)
    for seen in followers(trace.ego, trace.agents, scenario) if spans else ():
        for begin, end in spans:
            first, last = np.searchsorted(seen.ego.t, [begin - 1e-6, end + HORIZON_S]).tolist()
            if first < len(seen.ego) and seen.ahead[first] and seen.deep[first] >= IN_M:
                forced, t = seen.needed(first, min(last, len(seen.ego)) - 1), np.arange(0.0, HORIZON_S, GRID_S)
                kept = seen.rear[first] - seen.front[first] + float(seen.ego.v[first]) * t
                anyway = needed_deceleration(t, kept, float(seen.u[first]))
                stays.append(CutInStay(begin, end + AFTER_S, seen.agent, max(forced - anyway, 0.0)))
    missing = "the ego never slowed down without a reason before a follower"
    return worst_forced(trace, stays, scenario, "the ego slowed down before it without a reason", missing)


def _curve_accel(trace: Trace, scenario: Scenario) -> Measured:
    t, accel = trace.ego.t, lat_accel(trace.ego)
    total = np.r_[0.0, np.cumsum(0.5 * np.diff(t) * (accel[1:] + accel[:-1]))]
    mean = (total - np.interp(t - MEAN_S, t, total)) / MEAN_S
    return Series(t, np.where(t - MEAN_S >= t[0] - 1e-9, np.abs(mean), np.nan), missing="the drive is shorter than 1 s")


_CLOSED, _LANES = (Mode.CLOSED,), "lanes in the log"
LANE_OFFSET = Metric(
    "lane_offset", "m", "lower", _CLOSED, _lane_offset, (Reduction("kept", _kept), MAX_ABS),
    "Offset from the middle of the lane that the ego keeps while nothing calls for it.",
    "NAVSIM's lane keeping (EPDMS): 0.5 m for 2 s",
    formula="the largest d with |l| >= d on one side in three quarters of the judged time", needs=_LANES,
    parameters=(f"judged for {JUDGED_S:g} s", f"an offset of the start goes with {RETURN_MPS} m/s"),
)  # fmt: skip
SPEED_SWING = Metric(
    "speed_swing", "count", "lower", _CLOSED, _swing,
    (Reduction("per_minute", _per_minute, "1/min", empty=0.0), COUNT),
    "Falls of the ego's speed by 0.5 m/s or more: all of them, and those while nothing called for slowing down.",
    formula="sum of the falls; per minute, of the time without a reason for the needless ones",
    parameters=(f"fall {FALL_MPS} m/s", f"at least {LEAST_S:g} s"), parts=("all", "needless"),
)  # fmt: skip
NEEDLESS_LANE_CHANGE = Metric(
    "needless_lane_change", "count", "lower", _CLOSED, _lane_change, (COUNT,),
    "Lane changes of the ego away from its route while no road user was in its way.",
    formula="sum of the crossings of a line between lanes that nothing called for",
    parameters=(f"a road user in the way in the last {CALLED_S:g} s",), needs=_LANES,
)  # fmt: skip
BRAKED_BEHIND = Metric(
    "braked_behind", "m/s2", "lower", _CLOSED, _braked_behind, (MAX,),
    "Deceleration that the ego forces on a follower by slowing down without a reason.",
    "UN R79, 5.6.4.7: 3 m/s2; UN R157, 5.2.5.2 for the reaction time",
    formula="as forced_braking, from the begin of each needless fall of speed_swing",
    parameters=(f"reaction {REACT_S} s", f"horizon {HORIZON_S:g} s", f"at most {MOST_MPS2} m/s2"),
    needs="a fall of the speed by 0.5 m/s without a reason, and a follower",
)  # fmt: skip
CURVE_ACCEL = Metric(
    "curve_accel", "m/s2", "lower", _CLOSED, _curve_accel, (MAX,),
    "Lateral acceleration that lasts: its mean over 1 s.", "UN R79, 5.6.2.1.3 and ISO 11270: 3 m/s2",
    formula="|mean of v^2 kappa over 1 s|", parameters=(f"mean over {MEAN_S:g} s",), needs="a drive of 1 s",
)  # fmt: skip
STEADINESS = (LANE_OFFSET, SPEED_SWING, NEEDLESS_LANE_CHANGE, BRAKED_BEHIND, CURVE_ACCEL)
