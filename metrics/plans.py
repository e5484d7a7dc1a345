"""Plans: their horizon, the differences of successive plans, and their distance from the log's
drive.

For successive frames i-1 and i, at the times t_i, t_i + 0.1 s, ..., t_i + 4 s, for as long as both
plans last:

(1) plan_change(t_i) = mean |p_i - p_(i-1)|
(2) plan_change_lateral(t_i) = max |component of p_i - p_(i-1) across the heading of plan i-1|

if at least one of the two plans is longer than 5 m (`plans.SHORT_M`); the plans of a standing ego
hardly differ.

For the frame i and the frame j 0.5 s before it, at t_i, t_i + 0.1 s, ... for as long as both plans
last, at most 4 s:

(3) extended_comfort(t_i) = max over q of rms(q_i - q_j) / bound(q),
        q = |A|, d|A|/dt, yaw rate, yaw acceleration

with A = (a, v^2 kappa) of the plans and backward differences over 0.1 s; 1 and below is comfortable
(NAVSIM's EC).

(4) plan_horizon(t_i) = last time of plan i - t_i,
        plan_complete(t_i) = 1 if that is at least 3 s, else 0, at the frames after which the log's
        drive lasts 3 s, since an oracle cannot plan beyond its end

In open loop, plans start at the log's states, so a plan that the log did not follow also shows as a
change.

Accuracy, open loop: at each frame of time t_i, plan and log are compared at t_i + 0.1 s, t_i + 0.2
s, ..., up to a horizon h:

(5) e_k = p_plan(t_i + 0.1 k) - p_log(t_i + 0.1 k),  k = 1 .. 10 h
        k = 0 is left out: both are equal
(6) ADE = mean_k |e_k|,  FDE = |e_10h|
(7) AHE, FHE: the same of |wrap(yaw_plan - yaw_log)|
(8) along, cross: components of e_10h along and left of the log's heading there
(9) miss = 1 where max_k |e_k| > bound(h), else 0

Positions are those of the rear axle (nuPlan compares centres). Frames after which the log does not
last to the horizon are left out. A frame whose plan does not reach the horizon has no value;
`share` is the share of frames with a value. If the log has no lanes, the planner receives the
driven path as its road; then (7) and the error across in (8) are unavailable.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType

import numpy as np

from replan.core.arrays import FloatArray, IntArray
from replan.core.kernel import kernel
from replan.core.once import last, once
from replan.logs.frame import PLAN_HORIZON_S
from replan.logs.frame_store import light, loaded
from replan.logs.road import RoadSource
from replan.logs.scenario import Scenario
from replan.logs.states import TRAJECTORY_COLUMNS, wrapped
from replan.logs.trace import Mode, Trace
from replan.metrics import metric
from replan.metrics.metric import Measured, Metric, Series, Unavailable, where_followed

STEP_S = 0.1  # Plans are compared at multiples of this after their frame, s
SHORT_M = 5.0  # A plan that is shorter in its first 4 s is that of a standing ego (NAVSIM), m
PIECE = 1000  # Plans that are joined at a time: all plans of an hour take 80 MB
NO_PLANS = Unavailable("the drive has no plans")
APART_S, COMPARED_S = 0.5, 4.0
# (3), SI
EC_BOUNDS = (("acceleration", 0.7), ("jerk", 0.5), ("yaw rate", 0.1), ("yaw acceleration", 0.1))
_STANDS = f"successive plans never overlap, or are never longer than {SHORT_M:g} m"


def frame_times(trace: Trace) -> FloatArray:
    """Return the times `(f,)` of the frames, s."""
    return np.array([frame.t for frame in trace.frames])


def times_after(trace: Trace, first: int, last: int) -> FloatArray:
    """Return times `(f, k)` at multiples `first` to `last` of `STEP_S` after each frame, s, in
    whole nanoseconds.
    """
    times = frame_times(trace)[:, None] + STEP_S * np.arange(first, last + 1)
    return np.asarray(np.rint(times * 1e9) / 1e9)


def plan_columns(
    trace: Trace, times: FloatArray, names: tuple[str, ...], which: IntArray | None = None
) -> FloatArray:
    """Return columns `(c, f, k)` of the plans of the frames `which` `(f,)` (None: all) at the times
    `(f, k)`.

    Values are linear between the plan's samples, NaN outside the plan.
    """
    which = np.arange(len(trace.frames)) if which is None else which
    wanted = np.array([TRAJECTORY_COLUMNS.index(name) for name in names])
    out = np.empty((len(names), *times.shape))
    for begin in range(0, len(trace.frames), PIECE):
        some = (which >= begin) & (which < begin + PIECE)
        if some.any():
            out[:, some] = _interpolate(
                *_plan_rows(trace, begin),
                wanted,
                which[some] - begin,
                np.ascontiguousarray(times[some]),
            )
    return out


def plan_way(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the distance along each row of positions `(f, k)` from its first, m; NaN from its
    first NaN on.
    """
    return np.concatenate(
        [0.0 * x[:, :1], np.cumsum(np.hypot(np.diff(x), np.diff(y)), axis=1)], axis=1
    )


@last(1)  # for a drive of up to `PIECE` frames, this caches all
def _plan_rows(trace: Trace, begin: int) -> tuple[IntArray, FloatArray]:
    """Return the offsets `(f + 1,)` and `TRAJECTORY_COLUMNS` `(7, m)` of `PIECE` plans, beginning
    at a frame.
    """
    plans = [loaded(frame.plan.trajectory) for frame in light(trace.frames)[begin : begin + PIECE]]
    rows = np.stack(
        [np.concatenate([getattr(plan, name) for plan in plans]) for name in TRAJECTORY_COLUMNS]
    )
    return np.cumsum([0, *map(len, plans)]), rows


@kernel
def _interpolate(
    offsets: IntArray, rows: FloatArray, wanted: IntArray, which: IntArray, times: FloatArray
) -> FloatArray:
    """Return `plan_columns` of the plans `which` `(f,)`: the rows `wanted`, each as by
    `numpy.interp`.
    """
    out = np.full((len(wanted), *times.shape), np.nan)
    for f in range(len(times)):
        first, end = offsets[which[f]], offsets[which[f] + 1]
        t = rows[0, first:end]
        for k in range(times.shape[1]):
            if times[f, k] < t[0] - 1e-6 or times[f, k] > t[-1] + 1e-6:
                continue
            now = min(max(times[f, k], t[0]), t[-1])
            j = np.searchsorted(t, now, side="right") - 1
            for c in range(len(wanted)):
                column = rows[wanted[c], first:end]
                out[c, f, k] = column[j]
                if t[j] < now:
                    out[c, f, k] = (column[j + 1] - column[j]) / (t[j + 1] - t[j]) * (
                        now - t[j]
                    ) + column[j]
    return out


@where_followed
def _plan_change(trace: Trace, scenario: Scenario, *, which: int) -> Measured:
    if len(trace.frames) < 2:
        return Unavailable("fewer than two plans")
    return Series(frame_times(trace)[1:], _differences(trace)[which], missing=_STANDS)


@once
def _differences(trace: Trace) -> tuple[FloatArray, FloatArray]:
    """Return (1) and (2) `(f - 1,)`; NaN where the plans do not overlap, or both are of a standing
    ego.
    """
    times = times_after(trace, 0, round(COMPARED_S / STEP_S))[1:]
    all_ = np.arange(len(trace.frames))
    now, before = (
        plan_columns(trace, times, ("x", "y", "yaw"), some) for some in (all_[1:], all_[:-1])
    )
    dx, dy = now[:2] - before[:2]
    way = np.fmax.reduce([np.fmax.reduce(plan_way(*plan[:2]), axis=1) for plan in (now, before)])
    both = np.isfinite(dx) & (way > SHORT_M)[:, None]
    change = np.where(both, np.hypot(dx, dy), 0.0).sum(axis=1) / np.maximum(both.sum(axis=1), 1)
    aside = np.abs(dy * np.cos(before[2]) - dx * np.sin(before[2]))
    known = both.any(axis=1)
    return np.where(known, change, np.nan), np.where(
        known, np.fmax.reduce(np.where(both, aside, 0.0), axis=1), np.nan
    )


def _endpoint_errors(trace: Trace, scenario: Scenario) -> Measured:
    """Measure (3) at the frames that have another frame 0.5 s before them."""
    t = frame_times(trace)
    earlier = np.searchsorted(t, t - APART_S - 1e-6)
    later = np.flatnonzero(
        (t >= APART_S + t[:1] - 1e-6) & (np.abs(t[earlier] - (t - APART_S)) < 1e-6)
    )
    if not len(later):
        return Unavailable(f"no two plans are {APART_S} s apart")
    times = times_after(trace, 0, round(COMPARED_S / STEP_S))[later]
    difference = _comfort_quantities(trace, later, times) - _comfort_quantities(
        trace, earlier[later], times
    )
    both, bounds = np.isfinite(difference), np.array([[bound] for _, bound in EC_BOUNDS])
    count = both.sum(axis=2)
    mean = (np.where(both, difference, 0.0) ** 2).sum(axis=2) / np.maximum(count, 1)
    ratio = np.where(count > 0, np.sqrt(mean), np.nan) / bounds
    known = np.isfinite(ratio).all(axis=0)
    labels = tuple(EC_BOUNDS[q][0] for q in np.argmax(np.where(known, ratio, 0.0), axis=0))
    return Series(
        times[:, 0],
        np.where(known, ratio.max(axis=0), np.nan),
        labels,
        "plans 0.5 s apart never overlap",
    )


def _comfort_quantities(trace: Trace, which: IntArray, times: FloatArray) -> FloatArray:
    """Return the four quantities of (3) `(4, f, k)`; NaN beyond a plan's end and before its
    start.
    """
    back = np.concatenate([times[:, :1] - 2.0 * STEP_S, times[:, :1] - STEP_S, times], axis=1)
    yaw, v, a, kappa = plan_columns(trace, back, ("yaw", "v", "a", "kappa"), which)
    size = np.hypot(a, v**2 * kappa)
    jerk, yaw_rate = (np.diff(column, axis=1)[:, 1:] / STEP_S for column in (size, yaw))
    return np.stack([size[:, 2:], jerk, yaw_rate, np.diff(yaw, 2, axis=1) / STEP_S**2])


def _horizon(trace: Trace, scenario: Scenario) -> Measured:
    if not trace.frames:
        return NO_PLANS
    return Series(
        frame_times(trace),
        np.array([frame.plan.trajectory.t[-1] - frame.t for frame in trace.frames]),
    )


def _complete(trace: Trace, scenario: Scenario) -> Measured:
    reach, log = _horizon(trace, scenario), scenario.ego
    if isinstance(reach, Unavailable):
        return reach
    covered = (reach.t + PLAN_HORIZON_S <= log.t[-1] + 1e-6) | (len(log) < 2)
    if not covered.any():
        return Unavailable(f"the log ends less than {PLAN_HORIZON_S:g} s after every frame")
    return Series(
        reach.t[covered], np.where(reach.value[covered] >= PLAN_HORIZON_S - 1e-6, 1.0, 0.0)
    )


_BOTH = (Mode.OPEN, Mode.CLOSED)
_COMPARED = (
    f"compared {COMPARED_S:g} s",
    f"step {STEP_S:g} s",
    f"not of plans up to {SHORT_M:g} m",
)
PLAN_CHANGE, PLAN_CHANGE_LATERAL = (
    Metric(
        name,
        "m",
        "lower",
        _BOTH,
        partial(_plan_change, which=which),
        (metric.MEAN, metric.P95, metric.MAX, metric.share_beyond(1.0, "share_beyond_1m")),
        meaning,
        source,
        2,
        formula=formula,
        parameters=_COMPARED,
        needs="two successive plans that overlap in time",
    )
    for which, (name, source, meaning, formula) in enumerate(
        (
            (
                "plan_change",
                "after NAVSIM's extended comfort",
                "Mean distance of successive plans at the same times.",
                "mean |p_i - p_(i-1)| over t_i .. t_i + 4 s",
            ),
            (
                "plan_change_lateral",
                "after Autoware's stability",
                "Largest lateral distance of successive plans at the same times.",
                "max |(p_i - p_(i-1)) across the heading of plan i-1| over t_i .. t_i + 4 s",
            ),
        )
    )
)
EXTENDED_COMFORT = Metric(
    "extended_comfort",
    "1",
    "lower",
    _BOTH,
    _endpoint_errors,
    (metric.MEAN, metric.P95, metric.MAX),
    "Difference of two plans 0.5 s apart as one would feel it, over its bound: the worst of four; "
    "above 1 is a change"
    " of mind.",
    "NAVSIM 0a380a90, extended comfort of EPDMS; there of filtered signals and of one pair",
    formula=(
        "max over q of rms(q_i - q_j) / bound(q), t_i - t_j = 0.5 s, q = |A|, d|A|/dt, yaw "
        "rate, yaw acceleration"
    ),
    parameters=(
        *(f"bound of {name} {bound:g}" for name, bound in EC_BOUNDS),
        "compared 4 s",
        "step 0.1 s",
    ),
    needs="two plans 0.5 s apart that overlap in time",
)
PLAN_HORIZON = Metric(
    "plan_horizon",
    "s",
    "higher",
    _BOTH,
    _horizon,
    (metric.MIN, metric.MEAN),
    "How far the plans reach after their frames.",
    formula="t_last - t_i",
    needs="plans",
)
PLAN_COMPLETE = Metric(
    "plan_complete",
    "1",
    "higher",
    _BOTH,
    _complete,
    (replace(metric.RATE, empty=None),),
    "Share of the frames whose plan reaches 3 s at least, where the log lasts so long after them.",
    formula="1 where t_last - t_i >= 3 s, else 0",
    parameters=(f"least {PLAN_HORIZON_S:g} s",),
    needs="plans, and a logged drive of 3 s after some frame or none at all",
)


HORIZONS_S = (1, 3, 5, 8)
# (9), m by s; nuPlan's from 3 s on
MISS_M = MappingProxyType({1: 2.0, 2: 4.0, 3: 6.0, 5: 8.0, 8: 16.0})
# Returns the value of each frame from its errors `(f, k)` up to a horizon
Pick = Callable[[FloatArray], FloatArray]
_ACROSS = (1, 3)  # Indices in `_errors` of the errors across the path: lateral and heading


@once
def _errors(
    trace: Trace, scenario: Scenario
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return errors along and across (m), |e| (m), |heading error| (rad), each `(f, 10 h)` for the
    longest horizon.
    """
    log = scenario.ego
    times = times_after(trace, 1, round(max(HORIZONS_S) / STEP_S))
    x, y, yaw = plan_columns(trace, times, ("x", "y", "yaw"))
    beyond = (times < log.t[0] - 1e-6) | (times > log.t[-1] + 1e-6)
    log_x, log_y, log_yaw = (np.interp(times, log.t, column) for column in (log.x, log.y, log.yaw))
    dx, dy = np.where(beyond, np.nan, x - log_x), np.where(beyond, np.nan, y - log_y)
    along, cross = (
        dx * np.cos(log_yaw) + dy * np.sin(log_yaw),
        dy * np.cos(log_yaw) - dx * np.sin(log_yaw),
    )
    return along, cross, np.hypot(dx, dy), np.abs(wrapped(np.where(beyond, np.nan, yaw - log_yaw)))


def _per_horizon(
    pick: Pick, which: int, horizons: tuple[int, ...], trace: Trace, scenario: Scenario
) -> Mapping[str, Measured] | Unavailable:
    if len(scenario.ego) < 2:
        return Unavailable("the log holds one ego state only: there is no drive to compare with")
    if not trace.frames:
        return NO_PLANS
    if which in _ACROSS and scenario.road.source is RoadSource.DRIVEN_PATH:
        return Unavailable(
            "the log has no lanes: the road is the driven path, which the planner is given"
        )
    errors, t = _errors(trace, scenario)[which], frame_times(trace)
    found: dict[str, Measured] = {}
    for h in horizons:
        covered, missing = t + h <= scenario.ego.t[-1] + 1e-6, f"every plan ends before {h} s"
        found[f"{h}s"] = Unavailable(f"the log ends less than {h} s after every frame")
        if covered.any():
            found[f"{h}s"] = Series(
                t[covered], pick(errors[covered, : round(h / STEP_S)]), missing=missing
            )
    return found


_average: Pick = lambda errors: np.asarray(errors.mean(axis=1))  # noqa: E731
_at_end: Pick = lambda errors: np.abs(errors[:, -1])  # noqa: E731


def _missed_frames(errors: FloatArray) -> FloatArray:
    farthest, bound = errors.max(axis=1), MISS_M[round(errors.shape[1] * STEP_S)]
    return np.where(np.isfinite(farthest), farthest > bound, np.nan)


_NEEDS = "a logged drive that lasts to the horizon after some frame, and plans that reach it"
ADE, FDE, AHE, FHE, ALONG, CROSS = (
    Metric(
        name,
        unit,
        "lower",
        (Mode.OPEN,),
        partial(_per_horizon, pick, which, HORIZONS_S),
        (metric.MEAN, metric.MAX, metric.SHARE) if name == "ade" else (metric.MEAN, metric.MAX),
        f"{meaning}, at the rear axle, up to the horizon.",
        "nuPlan open loop, at 10 Hz instead of 1 Hz",
        2,
        parts=tuple(f"{h}s" for h in HORIZONS_S),
        formula=formula,
        parameters=(f"horizons {', '.join(map(str, HORIZONS_S))} s", f"step {STEP_S} s"),
        needs=_NEEDS,
    )
    for name, unit, pick, which, meaning, formula in (
        ("ade", "m", _average, 2, "Mean distance of plan and log", "mean_k |e_k|, k = 1 .. 10 h"),
        ("fde", "m", _at_end, 2, "Final distance of plan and log", "|e_10h|"),
        (
            "ahe",
            "rad",
            _average,
            3,
            "Mean heading difference of plan and log, principal value",
            "mean_k |wrap(yaw_plan - yaw_log)|",
        ),
        (
            "fhe",
            "rad",
            _at_end,
            3,
            "Final heading difference of plan and log, principal value",
            "|wrap(yaw_plan - yaw_log)| at h",
        ),
        (
            "along_error",
            "m",
            _at_end,
            0,
            "Final distance of plan and log along the log's heading",
            "|e_10h . (cos, sin)|",
        ),
        (
            "cross_error",
            "m",
            _at_end,
            1,
            "Final distance of plan and log across the log's heading",
            "|e_10h . (-sin, cos)|",
        ),
    )
)
MISS = Metric(
    "miss",
    "1",
    "lower",
    (Mode.OPEN,),
    partial(_per_horizon, _missed_frames, 2, tuple(MISS_M)),
    (replace(metric.RATE, empty=None), metric.SHARE),
    "Share of the frames whose plan is anywhere up to the horizon farther from the log than the "
    "bound.",
    "nuPlan devkit e9241677, planner_miss_rate_within_bound (3, 5, 8 s), at 10 Hz and at the rear "
    "axle",
    parts=tuple(f"{h}s" for h in MISS_M),
    formula="1 where max_k |e_k| > bound, else 0",
    needs=_NEEDS,
    parameters=tuple(f"bound at {h} s: {bound:g} m" for h, bound in MISS_M.items()),
)
