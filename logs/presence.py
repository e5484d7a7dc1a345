"""How long a track is there after a sample: one rule for what planners are shown and for what judges count.

(1) patience_k = 2 median(t_k - t_{k-1}, t_{k-1} - t_{k-2}, ... up to `INTERVALS`), within [MAX_AGE_S, MAX_GAP_S], s

Of a track's first sample the intervals are those of the whole log up to then (its distinct sample times); at the log's
very first time there are none, and the patience is `MAX_GAP_S`. Nothing later than the sample goes in.

An agent is shown until its last sample is older than its patience. Two samples further apart than the first one's
patience are a gap: from the one to the other the agent is not in the scene, for anybody.
"""

from __future__ import annotations

import numpy as np

from logs.kernel import BoolArray, FloatArray, IntArray

MAX_AGE_S = 0.5
"""An agent that is sampled often is no longer assumed to be there when it was not seen for longer than this."""
MAX_GAP_S = 1.5
"""Nor is any agent after this: half as much again as the interval of logs at 1 Hz, the rarest that hold driving."""
MISSED = 2.0
"""Ages up to this many intervals: one sample may be missing, or all may come at 0.6 to 1 s as they like."""
INTERVALS = 9
"""Intervals whose median is a track's own: odd, and few, as the rate may change."""


def patience(offsets: IntArray, static: BoolArray, t: FloatArray) -> FloatArray:
    """(1) `(m,)`, s; `MAX_AGE_S` wherever the next sample comes within that anyway."""
    out = np.full(len(t), MAX_AGE_S)
    apart = np.diff(t, append=np.inf)
    apart[offsets[1:] - 1] = np.inf
    asked = np.flatnonzero((apart > MAX_AGE_S) & ~np.repeat(static, np.diff(offsets)))
    first = np.repeat(offsets[:-1], np.diff(offsets))[asked]
    alone = asked[first == asked]
    if len(alone):
        times = np.unique(t[~np.repeat(static, np.diff(offsets))])
        out[alone] = _after(times, np.zeros(len(alone), np.int64), np.searchsorted(times, t[alone]))
    rest = first < asked
    out[asked[rest]] = _after(t, first[rest], asked[rest])
    return out


def _after(t: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """(1) of the samples `last` `(k,)` of tracks that begin at `first`; `MAX_GAP_S` where there is no interval."""
    count = np.minimum(last - first, INTERVALS)
    back = np.arange(INTERVALS)
    end = last[:, None] - np.where(back < count[:, None], back, 0)
    steps = np.sort(np.where(back < count[:, None], t[end] - t[end - 1], np.inf), axis=1)
    row = np.arange(len(last))
    median = (steps[row, np.maximum(count - 1, 0) // 2] + steps[row, count // 2]) / 2.0
    return np.clip(MISSED * median, MAX_AGE_S, MAX_GAP_S)
