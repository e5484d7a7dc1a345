"""Accuracy of plans, open loop: their distance from the log's drive.

At each frame of time t_i, plan and log are compared at t_i + 0.1 s, t_i + 0.2 s, ..., up to a
horizon h:

(1) e_k = p_plan(t_i + 0.1 k) - p_log(t_i + 0.1 k),  k = 1 .. 10 h
        k = 0 is left out: both are equal
(2) ADE = mean_k |e_k|,  FDE = |e_10h|
(3) AHE, FHE: the same of |wrap(yaw_plan - yaw_log)|
(4) along, cross: components of e_10h along and left of the log's heading there
(5) miss = 1 where max_k |e_k| > bound(h), else 0

Positions are those of the rear axle (nuPlan compares centres). Frames after which the log does not
last to the horizon are left out. A frame whose plan does not reach the horizon has no value;
`share` is the share of frames with a value. If the log has no lanes, the planner receives the
driven path as its road; then (3) and the error across in (4) are unavailable.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.once import once
from replan.logs.road import RoadSource
from replan.logs.scenario import Scenario
from replan.logs.states import wrapped
from replan.logs.trace import Mode, Trace
from replan.metrics.metric import Measured, Parts, Series, Unavailable, metric
from replan.metrics.plans import NO_PLANS, STEP_S, frame_times, plan_columns, times_after
from replan.metrics.reductions import MAX, MEAN, RATE, SHARE

HORIZONS_S = (1, 3, 5, 8)
# (5), m by s; nuPlan's from 3 s on
MISS_M = MappingProxyType({1: 2.0, 2: 4.0, 3: 6.0, 5: 8.0, 8: 16.0})
# Returns the value of each frame from its errors `(f, k)` up to a horizon
Pick = Callable[[FloatArray], FloatArray]

_accuracy_metric = partial(
    metric,
    better="lower",
    modes=(Mode.OPEN,),
    needs="a logged drive that lasts to the horizon after some frame, and plans that reach it",
)
_error_metric = partial(
    _accuracy_metric,
    reductions=(MEAN, MAX),
    parts=tuple(f"{h}s" for h in HORIZONS_S),
    parameters=(f"horizons {', '.join(map(str, HORIZONS_S))} s", f"step {STEP_S} s"),
    source="nuPlan open loop, at 10 Hz instead of 1 Hz",
    version=2,
)


class _Errors(NamedTuple):
    """Differences of plans and log, `(f, 10 h)` each for the longest horizon."""

    along: FloatArray  # m, along the log's heading; `across`, m, left of it
    across: FloatArray
    distance: FloatArray  # m
    heading: FloatArray  # rad, absolute


@once
def _errors(trace: Trace, scenario: Scenario) -> _Errors:
    log = scenario.ego
    times = times_after(trace, 1, round(max(HORIZONS_S) / STEP_S))
    x, y, yaw = plan_columns(trace, times, ("x", "y", "yaw"))
    beyond = (times < log.t[0] - 1e-6) | (times > log.t[-1] + 1e-6)
    log_x, log_y, log_yaw = (np.interp(times, log.t, column) for column in (log.x, log.y, log.yaw))
    dx, dy = np.where(beyond, np.nan, x - log_x), np.where(beyond, np.nan, y - log_y)
    turn = np.where(beyond, np.nan, yaw - log_yaw)
    return _Errors(
        dx * np.cos(log_yaw) + dy * np.sin(log_yaw),
        dy * np.cos(log_yaw) - dx * np.sin(log_yaw),
        np.hypot(dx, dy),
        np.abs(wrapped(turn)),
    )


def _lacking(trace: Trace, scenario: Scenario, *, across: bool = False) -> Unavailable | None:
    """Return why plans and log cannot be compared; `across`: across the path, or in heading."""
    if len(scenario.ego) < 2:
        return Unavailable("the log holds one ego state only: there is no drive to compare with")
    if not trace.frames:
        return NO_PLANS
    if across and scenario.road.source is RoadSource.DRIVEN_PATH:
        return Unavailable(
            "the log has no lanes: the road is the driven path, which the planner is given"
        )
    return None


def _by_horizon(
    errors: FloatArray, pick: Pick, trace: Trace, scenario: Scenario, horizons: Iterable[int]
) -> Parts:
    """Return the values of the frames by horizon, from their errors `(f, k)`."""
    t = frame_times(trace)
    parts: dict[str, Measured] = {}
    for h in horizons:
        lasts = t + h <= scenario.ego.t[-1] + 1e-6
        if lasts.any():
            values = pick(errors[lasts, : round(h / STEP_S)])
            parts[f"{h}s"] = Series(t[lasts], values, missing=f"every plan ends before {h} s")
        else:
            parts[f"{h}s"] = Unavailable(f"the log ends less than {h} s after every frame")
    return parts


def _average(errors: FloatArray) -> FloatArray:
    return np.asarray(errors.mean(axis=1))


def _final(errors: FloatArray) -> FloatArray:
    return np.abs(errors[:, -1])


@_error_metric(unit="m", reductions=(MEAN, MAX, SHARE))
def ade(trace: Trace, scenario: Scenario) -> Parts | Unavailable:
    """Mean distance of plan and log, at the rear axle, up to the horizon.

    Formula: mean_k |e_k|, k = 1 .. 10 h
    """
    return _lacking(trace, scenario) or _by_horizon(
        _errors(trace, scenario).distance, _average, trace, scenario, HORIZONS_S
    )


@_error_metric(unit="m")
def fde(trace: Trace, scenario: Scenario) -> Parts | Unavailable:
    """Final distance of plan and log, at the rear axle, up to the horizon.

    Formula: |e_10h|
    """
    return _lacking(trace, scenario) or _by_horizon(
        _errors(trace, scenario).distance, _final, trace, scenario, HORIZONS_S
    )


@_error_metric(unit="rad")
def ahe(trace: Trace, scenario: Scenario) -> Parts | Unavailable:
    """Mean heading difference of plan and log, principal value, at the rear axle, up to the
    horizon.

    Formula: mean_k |wrap(yaw_plan - yaw_log)|
    """
    return _lacking(trace, scenario, across=True) or _by_horizon(
        _errors(trace, scenario).heading, _average, trace, scenario, HORIZONS_S
    )


@_error_metric(unit="rad")
def fhe(trace: Trace, scenario: Scenario) -> Parts | Unavailable:
    """Final heading difference of plan and log, principal value, at the rear axle, up to the
    horizon.

    Formula: |wrap(yaw_plan - yaw_log)| at h
    """
    return _lacking(trace, scenario, across=True) or _by_horizon(
        _errors(trace, scenario).heading, _final, trace, scenario, HORIZONS_S
    )


@_error_metric(unit="m")
def along_error(trace: Trace, scenario: Scenario) -> Parts | Unavailable:
    """Final distance of plan and log along the log's heading, at the rear axle, up to the horizon.

    Formula: |e_10h . (cos, sin)|
    """
    return _lacking(trace, scenario) or _by_horizon(
        _errors(trace, scenario).along, _final, trace, scenario, HORIZONS_S
    )


@_error_metric(unit="m")
def cross_error(trace: Trace, scenario: Scenario) -> Parts | Unavailable:
    """Final distance of plan and log across the log's heading, at the rear axle, up to the horizon.

    Formula: |e_10h . (-sin, cos)|
    """
    return _lacking(trace, scenario, across=True) or _by_horizon(
        _errors(trace, scenario).across, _final, trace, scenario, HORIZONS_S
    )


@_accuracy_metric(
    unit="1",
    reductions=(replace(RATE, empty=None), SHARE),
    parts=tuple(f"{h}s" for h in MISS_M),
    parameters=tuple(f"bound at {h} s: {bound:g} m" for h, bound in MISS_M.items()),
    source="nuPlan devkit e9241677, planner_miss_rate_within_bound (3, 5, 8 s), at 10 Hz and at "
    "the rear axle",
)
def miss(trace: Trace, scenario: Scenario) -> Parts | Unavailable:
    """Share of the frames whose plan is anywhere up to the horizon farther from the log than the
    bound.

    Formula: 1 where max_k |e_k| > bound, else 0
    """
    return _lacking(trace, scenario) or _by_horizon(
        _errors(trace, scenario).distance, _missed_frames, trace, scenario, MISS_M
    )


def _missed_frames(errors: FloatArray) -> FloatArray:
    farthest, bound = errors.max(axis=1), MISS_M[round(errors.shape[1] * STEP_S)]
    return np.where(np.isfinite(farthest), farthest > bound, np.nan)
