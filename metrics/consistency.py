"""How much successive plans differ: a planner that cannot make up its mind flips between frames.

For successive frames i-1 and i, at the times t_i, t_i + 0.1 s, ..., t_i + 1 s, as far as both plans reach:

(1) plan_change(t_i) = mean |p_i - p_(i-1)|
(2) plan_change_lateral(t_i) = max |component of p_i - p_(i-1) across the heading of plan i-1|

In open loop plans start at the log's states, so that a plan which the log did not follow shows as a change too.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from logs.scenario import Scenario
from logs.trace import Mode, Trace
from metrics.metric import MAX, MEAN, P95, Measured, Metric, Series, Unavailable
from metrics.plans import plan_poses, times_after


def _change(trace: Trace, scenario: Scenario, *, lateral: bool) -> Measured:
    if len(trace.frames) < 2:
        return Unavailable("fewer than two plans")
    times = times_after(trace, 0, 10)[1:]
    now, before = plan_poses(trace.frames[1:], times), plan_poses(trace.frames[:-1], times)
    dx, dy = now[0] - before[0], now[1] - before[1]
    size = np.abs(dy * np.cos(before[2]) - dx * np.sin(before[2])) if lateral else np.hypot(dx, dy)
    both = np.isfinite(size)
    count, size = both.sum(axis=1), np.where(both, size, 0.0)
    change = size.max(axis=1) if lateral else size.sum(axis=1) / np.maximum(count, 1)
    return Series(times[:, 0], np.where(count > 0, change, np.nan), missing="successive plans never overlap")


_BOTH = (Mode.OPEN, Mode.CLOSED)
PLAN_CHANGE = Metric(
    "plan_change", "m", "lower", _BOTH, partial(_change, lateral=False), (MEAN, P95, MAX),
    "Mean distance of successive plans at the same times, first second.", "after NAVSIM's extended comfort",
)  # fmt: skip
PLAN_CHANGE_LATERAL = Metric(
    "plan_change_lateral", "m", "lower", _BOTH, partial(_change, lateral=True), (MEAN, P95, MAX),
    "Largest lateral distance of successive plans at the same times, first second.", "after Autoware's stability",
)  # fmt: skip
