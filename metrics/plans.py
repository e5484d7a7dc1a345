"""The plans of a trace on common time grids."""

from __future__ import annotations

import numpy as np

from logs.kernel import FloatArray
from logs.trace import PlannedFrame, Trace

STEP_S = 0.1
"""Plans are compared at multiples of this after their frame's time."""


def frame_times(trace: Trace) -> FloatArray:
    """Times `(f,)` of the frames, s."""
    return np.array([frame.t for frame in trace.frames])


def times_after(trace: Trace, first: int, last: int) -> FloatArray:
    """Times `(f, k)` at multiples `first` to `last` of `STEP_S` after each frame, s; whole nanoseconds, as in logs."""
    times = frame_times(trace)[:, None] + STEP_S * np.arange(first, last + 1)
    return np.asarray(np.rint(times * 1e9) / 1e9)


def plan_columns(frames: tuple[PlannedFrame, ...], times: FloatArray, names: tuple[str, ...]) -> FloatArray:
    """Columns `(c, f, k)` of each frame's plan at the times `(f, k)`; NaN where the plan does not reach."""
    out = np.full((len(names), *times.shape), np.nan)
    for i, frame in enumerate(frames):
        plan = frame.plan.trajectory
        for j, name in enumerate(names):
            out[j, i] = np.interp(times[i], plan.t, getattr(plan, name))
        out[:, i, (times[i] < plan.t[0] - 1e-6) | (times[i] > plan.t[-1] + 1e-6)] = np.nan
    return out


def plan_poses(frames: tuple[PlannedFrame, ...], times: FloatArray) -> FloatArray:
    """x, y, yaw `(3, f, k)` of each frame's plan at the times `(f, k)`; NaN where the plan does not reach."""
    return plan_columns(frames, times, ("x", "y", "yaw"))
