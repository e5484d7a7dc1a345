"""Spans in which the other road users of a log were observed, and how long a track is present after
a sample.

Spans of observation are in s since the scenario's start. After the last span, the ego drives in a
world without traffic, in which no contact is possible: verdicts on safety depend on this. A log
states its spans where it can (`Scenario.traffic`):

- a stream of detections was observed at the times of its messages, empty ones included
(`of_stream`);
- a synthesised log holds its whole world from begin to end;
- a CommonRoad file holds all its obstacles from the first step on, so that only the end is
  inferred; without a moving obstacle, it describes a world without traffic.

If a log states no spans, the spans are inferred from its tracks (`inferred`). The begin is the
first sample of a moving road user. The end is

(1) the earliest time T at which at least `TOGETHER` moving road users, and more than half of those
    present, have their last sample, and after which no track begins: cars leave a scene one by one,
    but a recording ends for most at once;
(2) else the last sample of any moving road user.

By (1), one track that lasts longer than nine which end together does not extend the recording. The
drawback: if most of the last few road users leave the view at the same sample, the recording seems
to end at that time. Static obstacles are present at all times, so their samples do not show the
end; a log with only static obstacles is observed throughout.

One rule of presence holds for planners and for metrics. An agent is present until its last sample
is older than its patience:

(3) patience_k = 2 median(t_k - t_{k-1}, t_{k-1} - t_{k-2}, ... up to `INTERVALS`),
        within [MAX_AGE_S, MAX_GAP_S], s

For a track's first sample, the intervals are those between the distinct sample times of the whole
log up to it. At the log's first time there is no interval, and the patience is `MAX_GAP_S`. Later
samples are not used. Two samples further apart than the patience of the first are a gap: between
them the agent is absent, for planners and metrics.
"""

from __future__ import annotations

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray

MAX_AGE_S = 0.5
"""A frequently sampled agent is absent once it was not seen for longer than this, s."""
MAX_GAP_S = 1.5
"""Any agent is absent after this, s: 1.5 times the interval of logs at 1 Hz, the lowest rate of
driving logs.
"""
MISSED = 2.0
"""Patience in intervals: one sample may be missing, or the intervals may vary between 0.6 and 1
s.
"""
INTERVALS = 9
"""Number of intervals whose median is a track's interval: odd, and small because the rate may
change.
"""


def patience(offsets: IntArray, static: BoolArray, t: FloatArray) -> FloatArray:
    """Return the patience (3) of each sample `(m,)`, s; `MAX_AGE_S` if the next sample follows
    within that time.
    """
    patiences = np.full(len(t), MAX_AGE_S)
    apart = np.diff(t, append=np.inf)
    apart[offsets[1:] - 1] = np.inf
    rare = np.flatnonzero((apart > MAX_AGE_S) & ~np.repeat(static, np.diff(offsets)))
    first = np.repeat(offsets[:-1], np.diff(offsets))[rare]
    alone = rare[first == rare]
    if len(alone):
        times = np.unique(t[~np.repeat(static, np.diff(offsets))])
        patiences[alone] = _after(
            times, np.zeros(len(alone), np.int64), np.searchsorted(times, t[alone])
        )
    not_first = first < rare
    patiences[rare[not_first]] = _after(t, first[not_first], rare[not_first])
    return patiences


def _after(t: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """Return (3) for the samples `last` `(k,)` of tracks that begin at `first`; `MAX_GAP_S` without
    an interval.
    """
    count = np.minimum(last - first, INTERVALS)
    back = np.arange(INTERVALS)
    end = last[:, None] - np.where(back < count[:, None], back, 0)
    steps = np.sort(np.where(back < count[:, None], t[end] - t[end - 1], np.inf), axis=1)
    row = np.arange(len(last))
    median = (steps[row, np.maximum(count - 1, 0) // 2] + steps[row, count // 2]) / 2.0
    return np.clip(MISSED * median, MAX_AGE_S, MAX_GAP_S)


Spans = tuple[tuple[float, float], ...]
"""Disjoint spans of observation (begin, end), s, in order."""
TOGETHER = 3
"""Least number of tracks whose common end is the end of a recording: two people may leave side by
side.
"""
ENOUGH = 0.8
"""Least share of a log's time with observed traffic for a verdict on safety."""
_ROUNDING_S = 1e-6


def of_stream(t: FloatArray) -> Spans:
    """Return the spans of a stream with messages at the times `t` `(n,)`: a span ends where a
    message is overdue.

    A message is overdue after twice the usual interval (median), within the bounds of
    `replan.logs.observed`.
    """
    if not len(t):
        return ()
    t = np.unique(t)
    apart = np.diff(t)
    usual = float(np.median(apart)) if len(apart) else 0.0
    breaks = np.flatnonzero(apart > min(max(MISSED * usual, MAX_AGE_S), MAX_GAP_S))
    return tuple(
        zip(t[np.r_[0, breaks + 1]].tolist(), t[np.r_[breaks, len(t) - 1]].tolist(), strict=True)
    )


def inferred(offsets: IntArray, static: BoolArray, t: FloatArray) -> Spans:
    """Return the span of ragged tracks (`replan.logs.tracks.Tracks`) by (1) and (2).

    Empty if no track moves.
    """
    moving = np.flatnonzero(~static)
    if not len(moving):
        return ()
    first, last = np.sort(t[offsets[moving]]), np.sort(t[offsets[moving + 1] - 1])
    apart = np.diff(t)
    apart[offsets[1:-1] - 1] = np.nan
    step_s = float(np.nanmedian(apart)) if np.isfinite(apart).any() else 0.0
    tolerance = 0.5 * step_s + _ROUNDING_S
    ended = np.searchsorted(last, last + tolerance) - np.searchsorted(last, last - tolerance)
    present = np.searchsorted(first, last + tolerance) - np.searchsorted(last, last - tolerance)
    together = (ended >= TOGETHER) & (2 * ended > present) & (first[-1] <= last + tolerance)
    end = last[np.argmax(together)] + tolerance if together.any() else last[-1]
    return ((float(first[0]), float(last[last <= end][-1])),)


def clipped(spans: Spans, begin: float, end: float) -> Spans:
    """Return the parts of the spans between two times, relative to `begin`."""
    parts = ((max(first, begin) - begin, min(last, end) - begin) for first, last in spans)
    return tuple(part for part in parts if part[0] <= part[1])


def observed_until(spans: Spans, t: float) -> float:
    """Return the end of the span that contains the time `t`; `t` itself if no span does."""
    return next((last for first, last in spans if first <= t + _ROUNDING_S and t <= last), t)


def within(spans: Spans, t: FloatArray) -> BoolArray:
    """Return which of the times `t` `(n,)` lie in a span."""
    is_within = np.zeros(len(t), np.bool_)
    for first, last in spans:
        is_within |= (t >= first - _ROUNDING_S) & (t <= last + _ROUNDING_S)
    return is_within


def described(spans: Spans) -> str:
    """Describe the spans in words: "until 0.1 s", "from 2.0 s to 5.0 s and from 7.0 s to 9.0 s"."""
    if not spans:
        return "at no time"
    if len(spans) == 1 and spans[0][0] <= _ROUNDING_S:
        return f"until {spans[0][1]:.1f} s"
    return " and ".join(f"from {first:.1f} s to {last:.1f} s" for first, last in spans)
