"""Open loop: how far the plan is from what the log's driver did.

At each frame of time t_i, plan and log are compared at t_i + 0.1 s, t_i + 0.2 s, ..., up to a horizon h:

(1) e_k = p_plan(t_i + 0.1 k) - p_log(t_i + 0.1 k),  k = 1 .. 10 h        k = 0, where both are the same, is left out
(2) ADE = mean_k |e_k|,  FDE = |e_10h|
(3) AHE, FHE: the same of |wrap(yaw_plan - yaw_log)|
(4) along, cross: components of e_10h along and left of the log's heading there
(5) miss = 1 where max_k |e_k| > bound(h), else 0

Positions are those of the rear axle (nuPlan compares centres). Frames after which the log does not last to the horizon
are left out; one whose plan does not reach it has no value, and `share` is the share of those that have. Where the log
has no lanes, the planner is given the driven path as its road: (3) and the error across in (4) are not available.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType

import numpy as np

from logs.kernel import FloatArray
from logs.road import RoadSource
from logs.scenario import Scenario
from logs.states import wrapped
from logs.trace import Mode, Trace
from metrics.metric import MAX, MEAN, RATE, SHARE, Measured, Metric, Series, Unavailable
from metrics.once import once
from metrics.plans import NO_PLANS, STEP_S, frame_times, plan_columns, times_after

HORIZONS_S = (1, 3, 5, 8)
MISS_M = MappingProxyType({1: 2.0, 2: 4.0, 3: 6.0, 5: 8.0, 8: 16.0})  # (5), m by s; nuPlan's from 3 s on
Pick = Callable[[FloatArray], FloatArray]  # Value per frame of errors `(f, k)` up to a horizon
_ACROSS = (1, 3)  # Which of `_errors` are made across the path: the cross error and that of the heading


@once
def _errors(trace: Trace, scenario: Scenario) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Errors along and cross (m), |e| (m), |heading error| (rad): each `(f, 10 h)` for the longest horizon."""
    log = scenario.ego
    times = times_after(trace, 1, round(max(HORIZONS_S) / STEP_S))
    x, y, yaw = plan_columns(trace, times, ("x", "y", "yaw"))
    beyond = (times < log.t[0] - 1e-6) | (times > log.t[-1] + 1e-6)
    log_x, log_y, log_yaw = (np.interp(times, log.t, column) for column in (log.x, log.y, log.yaw))
    dx, dy = np.where(beyond, np.nan, x - log_x), np.where(beyond, np.nan, y - log_y)
    along, cross = dx * np.cos(log_yaw) + dy * np.sin(log_yaw), dy * np.cos(log_yaw) - dx * np.sin(log_yaw)
    return along, cross, np.hypot(dx, dy), np.abs(wrapped(np.where(beyond, np.nan, yaw - log_yaw)))


def _per_horizon(
    pick: Pick, which: int, horizons: tuple[int, ...], trace: Trace, scenario: Scenario
) -> Mapping[str, Measured] | Unavailable:
    if len(scenario.ego) < 2:
        return Unavailable("the log holds one ego state only: there is no drive to compare with")
    if not trace.frames:
        return NO_PLANS
    if which in _ACROSS and scenario.road.source is RoadSource.DRIVEN_PATH:
        return Unavailable("the log has no lanes: the road is the driven path, which the planner is given")
    errors, t = _errors(trace, scenario)[which], frame_times(trace)
    found: dict[str, Measured] = {}
    for h in horizons:
        asked, missing = t + h <= scenario.ego.t[-1] + 1e-6, f"every plan ends before {h} s"
        found[f"{h}s"] = Unavailable(f"the log ends less than {h} s after every frame")
        if asked.any():
            found[f"{h}s"] = Series(t[asked], pick(errors[asked, : round(h / STEP_S)]), missing=missing)
    return found


_average: Pick = lambda errors: np.asarray(errors.mean(axis=1))  # noqa: E731
_at_end: Pick = lambda errors: np.abs(errors[:, -1])  # noqa: E731


def _missed(errors: FloatArray) -> FloatArray:
    farthest, bound = errors.max(axis=1), MISS_M[round(errors.shape[1] * STEP_S)]
    return np.where(np.isfinite(farthest), farthest > bound, np.nan)


_NEEDS = "a logged drive that lasts to the horizon after some frame, and plans that reach it"
ADE, FDE, AHE, FHE, ALONG, CROSS = (
    Metric(
        name, unit, "lower", (Mode.OPEN,), partial(_per_horizon, pick, which, HORIZONS_S),
        (MEAN, MAX, SHARE) if name == "ade" else (MEAN, MAX),
        f"{meaning}, at the rear axle, up to the horizon.", "nuPlan open loop, at 10 Hz instead of 1 Hz", 2,
        parts=tuple(f"{h}s" for h in HORIZONS_S), formula=formula,
        parameters=(f"horizons {', '.join(map(str, HORIZONS_S))} s", f"step {STEP_S} s"), needs=_NEEDS,
    )
    for name, unit, pick, which, meaning, formula in (
        ("ade", "m", _average, 2, "Mean distance of plan and log", "mean_k |e_k|, k = 1 .. 10 h"),
        ("fde", "m", _at_end, 2, "Final distance of plan and log", "|e_10h|"),
        ("ahe", "rad", _average, 3, "Mean heading difference of plan and log, principal value",
         "mean_k |wrap(yaw_plan - yaw_log)|"),
        ("fhe", "rad", _at_end, 3, "Final heading difference of plan and log, principal value",
         "|wrap(yaw_plan - yaw_log)| at h"),
        ("along_error", "m", _at_end, 0, "Final distance of plan and log along the log's heading",
         "|e_10h . (cos, sin)|"),
        ("cross_error", "m", _at_end, 1, "Final distance of plan and log across the log's heading",
         "|e_10h . (-sin, cos)|"),
    )
)  # fmt: skip
MISS = Metric(
    "miss", "1", "lower", (Mode.OPEN,), partial(_per_horizon, _missed, 2, tuple(MISS_M)),
    (replace(RATE, empty=None), SHARE),
    "Share of the frames whose plan is anywhere up to the horizon farther from the log than the bound.",
    "nuPlan devkit e9241677, planner_miss_rate_within_bound (3, 5, 8 s), at 10 Hz and at the rear axle",
    parts=tuple(f"{h}s" for h in MISS_M), formula="1 where max_k |e_k| > bound, else 0", needs=_NEEDS,
    parameters=tuple(f"bound at {h} s: {bound:g} m" for h, bound in MISS_M.items()),
)  # fmt: skip
