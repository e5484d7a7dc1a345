"""Position in the lane, closed loop: driving against the direction of a lane, and off its centre
line.

The lanes are those under the centre of the ego's box (`lanes.under`); where lanes cross, and beside
the road, nothing is judged. With the angle between the velocity vector and the best aligned lane
there:

(1) wrong_way(t) = max(-v cos(angle), 0)                        speed against the lane, m/s
(2) worst_1s = max over t of the integral of (1) over (t - 1 s, t]
(3) lane_keeping(t) = distance from the nearest centre line, positive left of it, m
(4) lane_line(t) = |(3)| + half of the ego's width - half of the lane's width there:
        distance of its box beyond the lane's line, m; measured every 0.1 s while no road user and
        no curve is a reason to leave the centre line (`reasons`)

nuPlan and NAVSIM judge (2): below 2 m is compliant, below 6 m half. Lanes that lie over each other
and lead both ways (a single-track road) may be driven either way.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.once import once
from replan.logs.scenario import Scenario
from replan.logs.trace import Trace
from replan.metrics.boxes import ego_boxes, grid_of
from replan.metrics.lanes import NO_LANES, Under, mapped_lanes, under
from replan.metrics.metric import Measured, Reduction, Series, metric
from replan.metrics.reasons import reasons
from replan.metrics.reductions import MAX, MAX_ABS, durations, time_above, worst_episode

WRONG_WAY_S = 1.0
AGAINST_MPS = 0.1  # Slower motion is not driving against a lane: equal to the speed of a stop
KEEPING_M, OVER_M = 0.5, 0.3
_NEVER = "the ego is never on a lane, or only where lanes cross"
_CROSS = "lanes cross above 30 degrees"


@once
def _under(trace: Trace, scenario: Scenario) -> Under | None:
    lanes = mapped_lanes(scenario.road)
    return None if lanes is None else under(lanes, *ego_boxes(trace.ego, scenario)[:3])


def _metres(series: Series) -> FloatArray:
    """Return the metres driven against the lanes in each step `(n,)`."""
    return np.where(series.known, series.value, 0.0) * durations(series.t)


def worst_metres(series: Series) -> tuple[float, int]:
    """Return (2) and the step at which its window ends."""
    total = np.r_[0.0, np.cumsum(_metres(series))]
    start = np.searchsorted(series.t, series.t - WRONG_WAY_S + 1e-9)
    within = total[1:] - total[start]
    step = int(np.argmax(within))
    return float(within[step]), step


def _all_metres(series: Series) -> tuple[float, int]:
    return float(_metres(series).sum()), -1


_lane_metric = partial(metric, better="lower", needs="lanes in the log")


@_lane_metric(
    unit="m/s",
    reductions=(
        Reduction("worst_1s", worst_metres, unit="m", empty=0.0),
        Reduction("distance", _all_metres, unit="m", empty=0.0),
        time_above(AGAINST_MPS, "time"),
        worst_episode(-AGAINST_MPS, AGAINST_MPS),
    ),
    parameters=(f"window {WRONG_WAY_S:g} s", f"against above {AGAINST_MPS} m/s", _CROSS),
    source="nuPlan devkit e9241677, driving_direction_compliance (below 2 m: 1, below 6 m: 0.5); "
    "there along the route",
)
def wrong_way(trace: Trace, scenario: Scenario) -> Measured:
    """Speed against the direction of the lane under the ego's centre; worst_1s are the most metres
    within 1 s.

    Formula: max(-v cos(angle to the best aligned lane), 0); worst_1s = max over t of its integral
    over (t - 1 s, t]
    """
    lane = _under(trace, scenario)
    if lane is None:
        return NO_LANES
    # (1); the reference point moves along the ego's heading
    against = np.maximum(-trace.ego.v * lane.along, 0.0)
    return Series(trace.ego.t, against, missing=_NEVER)


@_lane_metric(
    unit="m",
    reductions=(
        MAX_ABS,
        time_above(KEEPING_M, "time_beyond_50cm"),
        worst_episode(-KEEPING_M, KEEPING_M),
    ),
    parameters=(f"beyond {KEEPING_M} m", _CROSS),
    source="NAVSIM 0a380a90, lane keeping of EPDMS: an episode of 2 s is a failure",
)
def lane_keeping(trace: Trace, scenario: Scenario) -> Measured:
    """Distance of the ego's centre from the nearest centre line of a lane under it; changing lanes
    counts too.

    Formula: signed distance from the centre line; worst_episode: the longest stretch beyond 0.5 m
    """
    lane = _under(trace, scenario)
    return NO_LANES if lane is None else Series(trace.ego.t, lane.left, missing=_NEVER)


@_lane_metric(
    unit="m",
    reductions=(MAX, worst_episode(-np.inf, OVER_M)),
    parameters=(f"over by {OVER_M} m",),
)
def lane_line(trace: Trace, scenario: Scenario) -> Measured:
    """How far the ego's box is over the line of its lane while nothing calls for it.

    Formula: |distance from the centre line| + half of the ego's width - half of the lane's width
    """
    lanes = mapped_lanes(scenario.road)
    if lanes is None:
        return NO_LANES
    ego = grid_of(trace)
    lane = under(lanes, *ego_boxes(ego, scenario)[:3])
    over = np.abs(lane.left) + 0.5 * scenario.vehicle.width - lane.half  # (4)
    judged = np.where(reasons(trace, scenario).steer, np.nan, over)
    return Series(ego.t, judged, missing=f"{_NEVER}, or something called for leaving the middle")
