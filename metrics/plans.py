"""Plans, in both loops: their samples, their horizon, and the differences of successive plans.

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
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from replan.core.arrays import FloatArray, IntArray
from replan.core.kernel import kernel
from replan.core.once import last, once
from replan.logs.frame import PLAN_HORIZON_S
from replan.logs.frame_store import light, loaded
from replan.logs.scenario import Scenario
from replan.logs.states import TRAJECTORY_COLUMNS, Trajectory
from replan.logs.trace import Trace
from replan.metrics.metric import BOTH_LOOPS, Measured, Series, Unavailable, metric, where_followed
from replan.metrics.reductions import MAX, MEAN, MIN, P95, RATE, share_beyond

STEP_S = 0.1  # Plans are compared at multiples of this after their frame, s
SHORT_M = 5.0  # A plan that is shorter in its first 4 s is that of a standing ego (NAVSIM), m
PIECE = 1000  # Plans that are joined at a time: all plans of an hour take 80 MB
NO_PLANS = Unavailable("the drive has no plans")
APART_S, COMPARED_S = 0.5, 4.0
# (3), SI
EC_BOUNDS = (("acceleration", 0.7), ("jerk", 0.5), ("yaw rate", 0.1), ("yaw acceleration", 0.1))


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
    trace: Trace, times: FloatArray, names: tuple[str, ...], frames: IntArray | None = None
) -> FloatArray:
    """Return columns `(c, f, k)` of the plans of the frames `which` `(f,)` (None: all) at the times
    `(f, k)`.

    Values are linear between the plan's samples, NaN outside the plan.
    """
    frames = np.arange(len(trace.frames)) if frames is None else frames
    rows = np.array([TRAJECTORY_COLUMNS.index(name) for name in names])
    columns = np.empty((len(names), *times.shape))
    for begin in range(0, len(trace.frames), PIECE):
        in_piece = (frames >= begin) & (frames < begin + PIECE)
        if in_piece.any():
            columns[:, in_piece] = _interpolate(
                *_plan_rows(trace, begin),
                rows,
                frames[in_piece] - begin,
                np.ascontiguousarray(times[in_piece]),
            )
    return columns


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
    return _joined([frame.plan.trajectory for frame in light(trace.frames)[begin : begin + PIECE]])


def _joined(trajectories: Sequence[Trajectory]) -> tuple[IntArray, FloatArray]:
    """Return the offsets `(f + 1,)` and `TRAJECTORY_COLUMNS` `(7, m)` of trajectories."""
    whole = [loaded(trajectory) for trajectory in trajectories]
    rows = np.stack(
        [np.concatenate([getattr(item, name) for item in whole]) for name in TRAJECTORY_COLUMNS]
    )
    return np.cumsum([0, *map(len, whole)]), rows


def columns_at(
    trajectories: Sequence[Trajectory], times: FloatArray, names: tuple[str, ...]
) -> FloatArray:
    """Return columns `(c, r, k)` of r trajectories at the times `(r, k)`, as `plan_columns`."""
    rows = np.array([TRAJECTORY_COLUMNS.index(name) for name in names])
    everyone = np.arange(len(trajectories))
    return _interpolate(*_joined(trajectories), rows, everyone, np.ascontiguousarray(times))


@kernel
def _interpolate(
    offsets: IntArray, rows: FloatArray, names: IntArray, frames: IntArray, times: FloatArray
) -> FloatArray:
    """Return `plan_columns` of the plans `which` `(f,)`: the rows `wanted`, each as by
    `numpy.interp`.
    """
    columns = np.full((len(names), *times.shape), np.nan)
    for f in range(len(times)):
        first, end = offsets[frames[f]], offsets[frames[f] + 1]
        t = rows[0, first:end]
        for k in range(times.shape[1]):
            if times[f, k] < t[0] - 1e-6 or times[f, k] > t[-1] + 1e-6:
                continue
            now = min(max(times[f, k], t[0]), t[-1])
            j = np.searchsorted(t, now, side="right") - 1
            for c in range(len(names)):
                column = rows[names[c], first:end]
                columns[c, f, k] = column[j]
                if t[j] < now:
                    columns[c, f, k] = (column[j + 1] - column[j]) / (t[j + 1] - t[j]) * (
                        now - t[j]
                    ) + column[j]
    return columns


_change_metric = partial(
    metric,
    unit="m",
    better="lower",
    modes=BOTH_LOOPS,
    reductions=(MEAN, P95, MAX, share_beyond(1.0, "share_beyond_1m")),
    parameters=(
        f"compared {COMPARED_S:g} s",
        f"step {STEP_S:g} s",
        f"not of plans up to {SHORT_M:g} m",
    ),
    needs="two successive plans that overlap in time",
    version=2,
)


@_change_metric(source="after NAVSIM's extended comfort")
def plan_change(trace: Trace, scenario: Scenario) -> Measured:
    """Mean distance of successive plans at the same times.

    Formula: mean |p_i - p_(i-1)| over t_i .. t_i + 4 s
    """
    return _plan_change(trace, scenario, lateral=False)


@_change_metric(source="after Autoware's stability")
def plan_change_lateral(trace: Trace, scenario: Scenario) -> Measured:
    """Largest lateral distance of successive plans at the same times.

    Formula: max |(p_i - p_(i-1)) across the heading of plan i-1| over t_i .. t_i + 4 s
    """
    return _plan_change(trace, scenario, lateral=True)


@where_followed
def _plan_change(trace: Trace, scenario: Scenario, *, lateral: bool) -> Measured:
    if len(trace.frames) < 2:
        return Unavailable("fewer than two plans")
    change, change_lateral = _differences(trace)
    return Series(
        frame_times(trace)[1:],
        change_lateral if lateral else change,
        missing=f"successive plans never overlap, or are never longer than {SHORT_M:g} m",
    )


@once
def _differences(trace: Trace) -> tuple[FloatArray, FloatArray]:
    """Return (1) and (2) `(f - 1,)`; NaN where the plans do not overlap, or both are of a standing
    ego.
    """
    times = times_after(trace, 0, round(COMPARED_S / STEP_S))[1:]
    indices = np.arange(len(trace.frames))
    now, before = (
        plan_columns(trace, times, ("x", "y", "yaw"), frames)
        for frames in (indices[1:], indices[:-1])
    )
    dx, dy = now[:2] - before[:2]
    length = np.fmax.reduce([np.fmax.reduce(plan_way(*plan[:2]), axis=1) for plan in (now, before)])
    both = np.isfinite(dx) & (length > SHORT_M)[:, None]
    change = np.where(both, np.hypot(dx, dy), 0.0).sum(axis=1) / np.maximum(both.sum(axis=1), 1)
    aside = np.abs(dy * np.cos(before[2]) - dx * np.sin(before[2]))
    known = both.any(axis=1)
    return np.where(known, change, np.nan), np.where(
        known, np.fmax.reduce(np.where(both, aside, 0.0), axis=1), np.nan
    )


@metric(
    unit="1",
    better="lower",
    modes=BOTH_LOOPS,
    reductions=(MEAN, P95, MAX),
    parameters=(
        *(f"bound of {name} {bound:g}" for name, bound in EC_BOUNDS),
        "compared 4 s",
        "step 0.1 s",
    ),
    needs="two plans 0.5 s apart that overlap in time",
    source="NAVSIM 0a380a90, extended comfort of EPDMS; there of filtered signals and of one pair",
)
def extended_comfort(trace: Trace, scenario: Scenario) -> Measured:
    """Difference of two plans 0.5 s apart as one would feel it, over its bound: the worst of four;
    above 1 is a change of mind.

    Formula: max over q of rms(q_i - q_j) / bound(q), t_i - t_j = 0.5 s, q = |A|, d|A|/dt, yaw rate,
    yaw acceleration
    """
    t = frame_times(trace)
    earlier = np.searchsorted(t, t - APART_S - 1e-6)
    lasts = t >= APART_S + t[:1] - 1e-6
    later = np.flatnonzero(lasts & (np.abs(t[earlier] - (t - APART_S)) < 1e-6))
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
    worst = np.where(known, ratio.max(axis=0), np.nan)
    return Series(times[:, 0], worst, labels, "plans 0.5 s apart never overlap")


def _comfort_quantities(trace: Trace, which: IntArray, times: FloatArray) -> FloatArray:
    """Return the four quantities of (3) `(4, f, k)`; NaN beyond a plan's end and before its
    start.
    """
    back = np.concatenate([times[:, :1] - 2.0 * STEP_S, times[:, :1] - STEP_S, times], axis=1)
    yaw, v, a, kappa = plan_columns(trace, back, ("yaw", "v", "a", "kappa"), which)
    size = np.hypot(a, v**2 * kappa)
    jerk, yaw_rate = (np.diff(column, axis=1)[:, 1:] / STEP_S for column in (size, yaw))
    return np.stack([size[:, 2:], jerk, yaw_rate, np.diff(yaw, 2, axis=1) / STEP_S**2])


@metric(unit="s", better="higher", modes=BOTH_LOOPS, reductions=(MIN, MEAN), needs="plans")
def plan_horizon(trace: Trace, scenario: Scenario) -> Measured:
    """How far the plans reach after their frames.

    Formula: t_last - t_i
    """
    if not trace.frames:
        return NO_PLANS
    return Series(frame_times(trace), _horizons(trace))


@metric(
    unit="1",
    better="higher",
    modes=BOTH_LOOPS,
    reductions=(replace(RATE, empty=None),),
    parameters=(f"least {PLAN_HORIZON_S:g} s",),
    needs="plans, and a logged drive of 3 s after some frame or none at all",
)
def plan_complete(trace: Trace, scenario: Scenario) -> Measured:
    """Share of the frames whose plan reaches 3 s at least, where the log lasts so long after them.

    Formula: 1 where t_last - t_i >= 3 s, else 0
    """
    if not trace.frames:
        return NO_PLANS
    t, log = frame_times(trace), scenario.ego
    lasts = (t + PLAN_HORIZON_S <= log.t[-1] + 1e-6) | (len(log) < 2)
    if not lasts.any():
        return Unavailable(f"the log ends less than {PLAN_HORIZON_S:g} s after every frame")
    complete = _horizons(trace)[lasts] >= PLAN_HORIZON_S - 1e-6
    return Series(t[lasts], np.where(complete, 1.0, 0.0))


def _horizons(trace: Trace) -> FloatArray:
    return np.array([frame.plan.trajectory.t[-1] - frame.t for frame in trace.frames])
