"""The plans of a trace on common time grids."""

from __future__ import annotations

import numpy as np

from logs.frame_store import light, loaded
from logs.kernel import FloatArray, IntArray, kernel
from logs.states import TRAJECTORY_COLUMNS
from logs.trace import Trace
from metrics.metric import Unavailable
from metrics.once import last

STEP_S = 0.1  # Plans are compared at multiples of this after their frame's time
SHORT_M = 5.0  # Shorter plans (in their first 4 s) are those of a standing ego (NAVSIM)
PIECE = 1000  # So many plans are laid out at a time: all those of an hour are 80 MB
NO_PLANS = Unavailable("the drive has no plans")


def frame_times(trace: Trace) -> FloatArray:
    """Times `(f,)` of the frames, s."""
    return np.array([frame.t for frame in trace.frames])


def times_after(trace: Trace, first: int, last: int) -> FloatArray:
    """Times `(f, k)` at multiples `first` to `last` of `STEP_S` after each frame, s; whole nanoseconds, as in logs."""
    times = frame_times(trace)[:, None] + STEP_S * np.arange(first, last + 1)
    return np.asarray(np.rint(times * 1e9) / 1e9)


def plan_columns(trace: Trace, times: FloatArray, names: tuple[str, ...], which: IntArray | None = None) -> FloatArray:
    """Columns `(c, f, k)` of the plans of the frames `which` `(f,)` (all) at the times `(f, k)`.

    Linear between the plan's samples; NaN where it does not reach.
    """
    which = np.arange(len(trace.frames)) if which is None else which
    wanted = np.array([TRAJECTORY_COLUMNS.index(name) for name in names])
    out = np.empty((len(names), *times.shape))
    for begin in range(0, len(trace.frames), PIECE):
        some = (which >= begin) & (which < begin + PIECE)
        if some.any():
            out[:, some] = _at(*_rows(trace, begin), wanted, which[some] - begin, np.ascontiguousarray(times[some]))
    return out


def plan_way(x: FloatArray, y: FloatArray) -> FloatArray:
    """Distance along each row of positions `(f, k)` from its first, m; NaN from its first NaN on."""
    return np.concatenate([0.0 * x[:, :1], np.cumsum(np.hypot(np.diff(x), np.diff(y)), axis=1)], axis=1)


@last(1)  # of a drive of up to `PIECE` frames all are kept
def _rows(trace: Trace, begin: int) -> tuple[IntArray, FloatArray]:
    """`PIECE` plans from a frame on: `(f + 1,)` where each begins, and their `TRAJECTORY_COLUMNS` `(7, m)`."""
    plans = [loaded(frame.plan.trajectory) for frame in light(trace.frames)[begin : begin + PIECE]]
    rows = np.stack([np.concatenate([getattr(plan, name) for plan in plans]) for name in TRAJECTORY_COLUMNS])
    return np.cumsum([0, *map(len, plans)]), rows


@kernel
def _at(offsets: IntArray, rows: FloatArray, wanted: IntArray, which: IntArray, times: FloatArray) -> FloatArray:
    """`plan_columns` of the plans `which` `(f,)`: the rows `wanted`, each as `numpy.interp` has it."""
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
                    out[c, f, k] = (column[j + 1] - column[j]) / (t[j + 1] - t[j]) * (now - t[j]) + column[j]
    return out
