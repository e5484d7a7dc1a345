"""How far plans reach, and how much successive ones differ: a planner that cannot make up its mind flips.

For successive frames i-1 and i, at the times t_i, t_i + 0.1 s, ..., t_i + 4 s, as far as both plans reach:

(1) plan_change(t_i) = mean |p_i - p_(i-1)|
(2) plan_change_lateral(t_i) = max |component of p_i - p_(i-1) across the heading of plan i-1|

where one of the two plans is longer than 5 m (`plans.SHORT_M`): the plans of a standing ego cannot differ.

For the frame i and the frame j that is 0.5 s before it, at t_i, t_i + 0.1 s, ... as far as both reach, at most 4 s:

(3) extended_comfort(t_i) = max over q of rms(q_i - q_j) / bound(q),  q = |A|, d|A|/dt, yaw rate, yaw acceleration

with A = (a, v^2 kappa) of the plans and backward differences over 0.1 s; 1 and below is comfortable (NAVSIM's EC).

(4) plan_horizon(t_i) = last time of plan i - t_i,  plan_complete(t_i) = 1 where that is 3 s at least, else 0, at the
    frames after which the log's drive lasts so long: an oracle knows no more

In open loop plans start at the log's states, so that a plan which the log did not follow shows as a change too.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from logs.frame import PLAN_HORIZON_S
from logs.kernel import FloatArray, IntArray
from logs.scenario import Scenario
from logs.trace import Mode, Trace
from metrics.metric import MAX, MEAN, MIN, P95, RATE, Measured, Metric, Series, Unavailable, share_beyond
from metrics.once import once
from metrics.plans import NO_PLANS, SHORT_M, STEP_S, frame_times, plan_columns, plan_way, times_after

APART_S, COMPARED_S = 0.5, 4.0
EC_BOUNDS = (("acceleration", 0.7), ("jerk", 0.5), ("yaw rate", 0.1), ("yaw acceleration", 0.1))  # (3), SI
_STANDS = f"successive plans never overlap, or are never longer than {SHORT_M:g} m"


def _change(trace: Trace, scenario: Scenario, *, which: int) -> Measured:
    if len(trace.frames) < 2:
        return Unavailable("fewer than two plans")
    return Series(frame_times(trace)[1:], _changes(trace)[which], missing=_STANDS)


@once
def _changes(trace: Trace) -> tuple[FloatArray, FloatArray]:
    """(1) and (2) `(f - 1,)`; NaN where the plans do not overlap, or both are of a standing ego."""
    times = times_after(trace, 0, round(COMPARED_S / STEP_S))[1:]
    all_ = np.arange(len(trace.frames))
    now, before = (plan_columns(trace, times, ("x", "y", "yaw"), some) for some in (all_[1:], all_[:-1]))
    dx, dy = now[:2] - before[:2]
    way = np.fmax.reduce([np.fmax.reduce(plan_way(*plan[:2]), axis=1) for plan in (now, before)])
    both = np.isfinite(dx) & (way > SHORT_M)[:, None]
    change = np.where(both, np.hypot(dx, dy), 0.0).sum(axis=1) / np.maximum(both.sum(axis=1), 1)
    aside = np.abs(dy * np.cos(before[2]) - dx * np.sin(before[2]))
    known = both.any(axis=1)
    return np.where(known, change, np.nan), np.where(known, np.fmax.reduce(np.where(both, aside, 0.0), axis=1), np.nan)


def _extended(trace: Trace, scenario: Scenario) -> Measured:
    """(3), at the frames with another 0.5 s before them."""
    t = frame_times(trace)
    earlier = np.searchsorted(t, t - APART_S - 1e-6)
    later = np.flatnonzero((t >= APART_S + t[:1] - 1e-6) & (np.abs(t[earlier] - (t - APART_S)) < 1e-6))
    if not len(later):
        return Unavailable(f"no two plans are {APART_S} s apart")
    times = times_after(trace, 0, round(COMPARED_S / STEP_S))[later]
    difference = _felt(trace, later, times) - _felt(trace, earlier[later], times)
    both, bounds = np.isfinite(difference), np.array([[bound] for _, bound in EC_BOUNDS])
    count = both.sum(axis=2)
    mean = (np.where(both, difference, 0.0) ** 2).sum(axis=2) / np.maximum(count, 1)
    ratio = np.where(count > 0, np.sqrt(mean), np.nan) / bounds
    known = np.isfinite(ratio).all(axis=0)
    labels = tuple(EC_BOUNDS[q][0] for q in np.argmax(np.where(known, ratio, 0.0), axis=0))
    return Series(times[:, 0], np.where(known, ratio.max(axis=0), np.nan), labels, "plans 0.5 s apart never overlap")


def _felt(trace: Trace, which: IntArray, times: FloatArray) -> FloatArray:
    """The four quantities of (3) `(4, f, k)`; NaN where a plan does not reach, or did not begin yet."""
    back = np.concatenate([times[:, :1] - 2.0 * STEP_S, times[:, :1] - STEP_S, times], axis=1)
    yaw, v, a, kappa = plan_columns(trace, back, ("yaw", "v", "a", "kappa"), which)
    size = np.hypot(a, v**2 * kappa)
    jerk, yaw_rate = (np.diff(column, axis=1)[:, 1:] / STEP_S for column in (size, yaw))
    return np.stack([size[:, 2:], jerk, yaw_rate, np.diff(yaw, 2, axis=1) / STEP_S**2])


def _horizon(trace: Trace, scenario: Scenario) -> Measured:
    if not trace.frames:
        return NO_PLANS
    return Series(frame_times(trace), np.array([frame.plan.trajectory.t[-1] - frame.t for frame in trace.frames]))


def _complete(trace: Trace, scenario: Scenario) -> Measured:
    reach, log = _horizon(trace, scenario), scenario.ego
    if isinstance(reach, Unavailable):
        return reach
    asked = (reach.t + PLAN_HORIZON_S <= log.t[-1] + 1e-6) | (len(log) < 2)
    if not asked.any():
        return Unavailable(f"the log ends less than {PLAN_HORIZON_S:g} s after every frame")
    return Series(reach.t[asked], np.where(reach.value[asked] >= PLAN_HORIZON_S - 1e-6, 1.0, 0.0))


_BOTH = (Mode.OPEN, Mode.CLOSED)
_COMPARED = (f"compared {COMPARED_S:g} s", f"step {STEP_S:g} s", f"not of plans up to {SHORT_M:g} m")
PLAN_CHANGE, PLAN_CHANGE_LATERAL = (
    Metric(
        name, "m", "lower", _BOTH, partial(_change, which=which),
        (MEAN, P95, MAX, share_beyond(1.0, "share_beyond_1m")), meaning, source, 2, formula=formula,
        parameters=_COMPARED, needs="two successive plans that overlap in time",
    )
    for which, (name, source, meaning, formula) in enumerate((
        ("plan_change", "after NAVSIM's extended comfort", "Mean distance of successive plans at the same times.",
         "mean |p_i - p_(i-1)| over t_i .. t_i + 4 s"),
        ("plan_change_lateral", "after Autoware's stability",
         "Largest lateral distance of successive plans at the same times.",
         "max |(p_i - p_(i-1)) across the heading of plan i-1| over t_i .. t_i + 4 s"),
    ))
)  # fmt: skip
EXTENDED_COMFORT = Metric(
    "extended_comfort", "1", "lower", _BOTH, _extended, (MEAN, P95, MAX),
    "Difference of two plans 0.5 s apart as one would feel it, over its bound: the worst of four; above 1 is a change"
    " of mind.", "NAVSIM 0a380a90, extended comfort of EPDMS; there of filtered signals and of one pair",
    formula="max over q of rms(q_i - q_j) / bound(q), t_i - t_j = 0.5 s, q = |A|, d|A|/dt, yaw rate, yaw acceleration",
    parameters=(*(f"bound of {name} {bound:g}" for name, bound in EC_BOUNDS), "compared 4 s", "step 0.1 s"),
    needs="two plans 0.5 s apart that overlap in time",
)  # fmt: skip
PLAN_HORIZON = Metric(
    "plan_horizon", "s", "higher", _BOTH, _horizon, (MIN, MEAN), "How far the plans reach after their frames.",
    formula="t_last - t_i", needs="plans",
)  # fmt: skip
PLAN_COMPLETE = Metric(
    "plan_complete", "1", "higher", _BOTH, _complete, (replace(RATE, empty=None),),
    "Share of the frames whose plan reaches 3 s at least, where the log lasts so long after them.",
    formula="1 where t_last - t_i >= 3 s, else 0", parameters=(f"least {PLAN_HORIZON_S:g} s",),
    needs="plans, and a logged drive of 3 s after some frame or none at all",
)  # fmt: skip
