"""Speed limits, closed loop: speed above those of the log, and above assumed ones.

(1) speed_excess(t) = max(v - max(limit, held(t)), 0),  speed_ratio(t) = v / limit - 1
    held(t) = v_0 - EASE_MPS2 max(t - t_0 - SETTLE_S, 0) if the drive begins above the limit,
        else 0: an initial excess that the ego reduces comfortably is not counted
    assumed_limit_excess(t) = max(v - 1.1 max(assumed limit, the fastest second of the log's
        driver), 0) where the log has no limit: the assumed limit may be one step of signs too low,
        and the driver may have known it
(2) speed_limit_compliance = max(0, 1 - integral of (1) dt / (2.23 m/s T)),
        T the time on lanes with a limit  (nuPlan)
"""

from __future__ import annotations

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.scenario import Scenario
from replan.logs.trace import Trace
from replan.metrics.boxes import ego_boxes
from replan.metrics.lanes import drivable_lanes, limits_at, stated_lanes
from replan.metrics.metric import Measured, Reduction, Series, Unavailable, metric
from replan.metrics.reductions import MAX, MEAN, durations, first_of, time_above, time_outside

EXCESS_MPS = 2.23  # 5 mph: the mean excess at which (2) is 0
OVER_MPS, OVER_RATIO = 1.0, 0.1  # Faster than the limit by more is over it
EASE_MPS2, SETTLE_S = 1.0, 1.0  # Comfortable deceleration, and a driver's reaction time


def compliance(series: Series) -> tuple[float, int]:
    """The compliance with speed limits (2), 0 to 1, of a series of (1)."""
    span = durations(series.t)[series.known]
    over = float(np.sum(series.value[series.known] * span))
    return max(0.0, 1.0 - over / (EXCESS_MPS * float(span.sum()))) if span.sum() > 0.0 else float(
        not over
    ), -1


def _share_over(series: Series) -> tuple[float, int]:
    span, over = durations(series.t) * series.known, series.value > OVER_MPS
    share = float(np.sum(span[over]) / np.sum(span)) if span.sum() > 0.0 else float(over.any())
    return share, first_of(over)


_NEEDS = "lanes with speed limits under the ego"


@metric(
    unit="m/s",
    better="lower",
    reductions=(
        MAX,
        MEAN,
        time_above(OVER_MPS, "time_above_1mps"),
        Reduction("share_above_1mps", _share_over, unit="1"),
        Reduction("compliance", compliance, unit="1", direction="higher"),
    ),
    parameters=(
        "2.23 m/s (5 mph)",
        f"over: {OVER_MPS:g} m/s",
        f"comfortable deceleration {EASE_MPS2:g} m/s2",
        f"reaction {SETTLE_S:g} s",
    ),
    needs=_NEEDS,
    source="compliance: nuPlan devkit e9241677, speed_limit_compliance",
    version=3,
)
def speed_excess(trace: Trace, scenario: Scenario) -> Measured:
    """Speed above the limit of the lane under the ego's centre, the larger one where lanes overlap,
    less what the drive began with and brings down; compliance is like nuPlan's, share that of the
    time on lanes with a limit.

    Formula: max(|v| - max(limit, held), 0), held = v_0 - 1 m/s2 (t - t_0 - 1 s) after a start above
    the limit, else 0; compliance = max(0, 1 - integral / (2.23 m/s T))
    """
    limit = _limits(trace, scenario)
    if isinstance(limit, Unavailable):
        return limit
    t, speed = trace.ego.t, np.abs(trace.ego.v)
    held = 0.0 * limit
    if speed[0] > limit[0]:
        held = speed[0] - EASE_MPS2 * np.maximum(t - t[0] - SETTLE_S, 0.0)
    excess = np.maximum(speed - np.maximum(limit, held), 0.0) + 0.0 * limit  # (1)
    return Series(t, excess, missing=_NEVER)


@metric(
    unit="1",
    better="lower",
    reductions=(MAX, time_outside(-np.inf, OVER_RATIO, "time_above_10pct")),
    parameters=("over: 0.1",),
    needs=_NEEDS,
)
def speed_ratio(trace: Trace, scenario: Scenario) -> Measured:
    """Speed over the limit, less 1: 0.1 is 10 % too fast.

    Formula: |v| / limit - 1
    """
    limit = _limits(trace, scenario)
    if isinstance(limit, Unavailable):
        return limit
    ratio = np.abs(trace.ego.v) / np.where(limit > 0.0, limit, 1.0) - 1.0  # (1)
    return Series(trace.ego.t, np.where(limit > 0.0, ratio, np.nan), missing=_NEVER)


_NEVER = "the ego is never on a lane with a speed limit"


def _limits(trace: Trace, scenario: Scenario) -> FloatArray | Unavailable:
    """Return the stated limit under the ego's centre at each step `(n,)`, m/s; NaN without one."""
    lanes = stated_lanes(scenario.road)
    if lanes is None or not np.isfinite(lanes.limit).any():
        return Unavailable("the log has no speed limits")
    return limits_at(lanes, *ego_boxes(trace.ego, scenario)[:2])


@metric(
    unit="m/s",
    better="lower",
    reductions=(MAX, time_above(OVER_MPS, "time_above_1mps")),
    parameters=("margin 10 %", f"over: {OVER_MPS:g} m/s"),
    needs="lanes without a speed limit under the ego, or no map",
)
def assumed_limit_excess(trace: Trace, scenario: Scenario) -> Measured:
    """Speed above 1.1 times the larger of the assumed limit and the log's driver's speed, where the
    log has no limit.

    Formula: max(|v| - 1.1 max(assumed limit, speed that the log's driver exceeds for 1 s in all),
    0)
    """
    road, ego, logged = scenario.road, trace.ego, np.abs(scenario.ego.v)
    lanes, stated = drivable_lanes(road), stated_lanes(road)
    limit = np.full(len(ego), road.default_speed_limit)
    assumed = np.full(len(ego), True)
    if lanes is not None and stated is not None:
        x, y = ego_boxes(ego, scenario)[:2]
        filled = np.where(np.isfinite(lanes.limit), lanes.limit, road.default_speed_limit)
        limit = limits_at(lanes._replace(limit=filled), x, y)
        assumed = np.isfinite(limit) & np.isnan(limits_at(stated, x, y))
    if not assumed.any():
        return Unavailable("the ego is never on a lane without a speed limit")
    duration = float(scenario.ego.t[-1] - scenario.ego.t[0])
    quantile = max(1.0 - 1.0 / max(duration, 1.0), 0.5)
    fastest = float(np.quantile(logged, quantile, method="lower"))
    over = np.abs(ego.v) - (1.0 + OVER_RATIO) * np.maximum(limit, fastest)
    labels = tuple(
        f"assumed limit: {limit_mps:.1f} m/s, the log's driver {fastest:.1f} m/s"
        for limit_mps in limit.tolist()
    )
    return Series(ego.t, np.where(assumed, np.maximum(over, 0.0), np.nan), labels)
