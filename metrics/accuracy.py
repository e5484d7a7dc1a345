"""Open loop: how far the plan is from what the log's driver did.

At each frame of time t_i, plan and log are compared at t_i + 0.1 s, t_i + 0.2 s, ..., up to a horizon h:

(1) e_k = p_plan(t_i + 0.1 k) - p_log(t_i + 0.1 k),  k = 1 .. 10 h        k = 0, where both are the same, is left out
(2) ADE = mean_k |e_k|,  FDE = |e_10h|
(3) AHE, FHE: the same of |wrap(yaw_plan - yaw_log)|
(4) along, cross: components of e_10h along and left of the log's heading there

Positions are those of the rear axle (nuPlan compares centres). A frame after which plan or log does not reach the
horizon is excluded, and counted. A metric is the mean over the frames. Where the log has no lanes, the driven path is
the road that the planner is given: (3) and the error across in (4) then say nothing, and are not available.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from logs.kernel import FloatArray
from logs.road import RoadSource
from logs.scenario import Scenario
from logs.states import wrapped
from logs.trace import Mode, Trace
from metrics.metric import EXCLUDED, MAX, MEAN, Measured, Metric, Series, Unavailable
from metrics.plans import STEP_S, frame_times, plan_poses, times_after

HORIZONS_S = (1, 3, 5, 8)
_ACROSS = (1, 3)
"""Which of `_errors` are made across the path: the cross error and that of the heading."""


def _errors(trace: Trace, scenario: Scenario) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Errors along and cross (m), |e| (m), |heading error| (rad): each `(f, 10 h)` for the longest horizon."""
    log = scenario.ego
    times = times_after(trace, 1, round(max(HORIZONS_S) / STEP_S))
    x, y, yaw = plan_poses(trace.frames, times)
    beyond = (times < log.t[0] - 1e-6) | (times > log.t[-1] + 1e-6)
    log_x, log_y, log_yaw = (np.interp(times, log.t, column) for column in (log.x, log.y, log.yaw))
    dx, dy = np.where(beyond, np.nan, x - log_x), np.where(beyond, np.nan, y - log_y)
    along, cross = dx * np.cos(log_yaw) + dy * np.sin(log_yaw), dy * np.cos(log_yaw) - dx * np.sin(log_yaw)
    return along, cross, np.hypot(dx, dy), np.abs(wrapped(np.where(beyond, np.nan, yaw - log_yaw)))


def _per_horizon(
    pick: Callable[[FloatArray, int], FloatArray], which: int, trace: Trace, scenario: Scenario
) -> Mapping[str, Measured] | Unavailable:
    if len(scenario.ego) < 2:
        return Unavailable("the log holds one ego state only: there is no drive to compare with")
    if not trace.frames:
        return Unavailable("the drive has no plans")
    if which in _ACROSS and scenario.road.source is RoadSource.DRIVEN_PATH:
        return Unavailable("the log has no lanes: the road is the driven path, which the planner is given")
    errors, t = _errors(trace, scenario)[which], frame_times(trace)
    return {
        f"{h}s": Series(t, pick(errors, 10 * h), missing=f"plan or log ends less than {h} s after every frame")
        for h in HORIZONS_S
    }


def _average(errors: FloatArray, count: int) -> FloatArray:
    return np.asarray(errors[:, :count].mean(axis=1))


def _at_end(errors: FloatArray, count: int) -> FloatArray:
    return np.abs(errors[:, count - 1])


def _metric(name: str, unit: str, pick: Callable[[FloatArray, int], FloatArray], which: int, meaning: str) -> Metric:
    return Metric(
        name, unit, "lower", (Mode.OPEN,), partial(_per_horizon, pick, which),
        (MEAN, MAX, EXCLUDED) if name == "ade" else (MEAN, MAX),
        f"{meaning}, at the rear axle, up to the horizon.", "nuPlan open loop, at 10 Hz instead of 1 Hz",
        parts=tuple(f"{h}s" for h in HORIZONS_S),
    )  # fmt: skip


ADE = _metric("ade", "m", _average, 2, "Mean distance of plan and log")
FDE = _metric("fde", "m", _at_end, 2, "Final distance of plan and log")
AHE = _metric("ahe", "rad", _average, 3, "Mean heading difference of plan and log, principal value")
FHE = _metric("fhe", "rad", _at_end, 3, "Final heading difference of plan and log, principal value")
ALONG = _metric("along_error", "m", _at_end, 0, "Final distance of plan and log along the log's heading")
CROSS = _metric("cross_error", "m", _at_end, 1, "Final distance of plan and log across the log's heading")
