"""When the other road users of a log were observed, and how long a track is present after a sample.

Spans of observation are in s since the scenario's start. After the last span a world without traffic is driven, in
which no contact is possible: a verdict on safety needs to know that. A log states its spans where it can
(`Scenario.traffic`):

- a stream of detections was observed at the times of its messages, empty ones included (`of_stream`);
- a synthesised log holds its whole world from begin to end;
- a CommonRoad file holds all its obstacles from the first step on, so that only the end is inferred; without a moving
  obstacle it describes a world without traffic.

Where a log states nothing, the spans are inferred from its tracks (`inferred`). The begin is the first sample of a
moving road user. The end is

(1) the earliest time T at which at least `TOGETHER` moving road users have their last sample, more than half of those
    who are there at T, where none begins later: cars leave a scene one by one, a recording ends for most at once;
(2) else the last sample of any moving road user.

By (1) a straggler that outlives nine who vanish together does not stand for the traffic. Its price: where most of the
last few leave the view at the very same sample, the recording seems to end then. Standing obstacles are there at all
times, so their samples say nothing about the end; a log with no other road user than these is observed throughout.

Presence is one rule for what planners are shown and for what judges count. An agent is shown until its last sample is
older than its patience:

(3) patience_k = 2 median(t_k - t_{k-1}, t_{k-1} - t_{k-2}, ... up to `INTERVALS`), within [MAX_AGE_S, MAX_GAP_S], s

Of a track's first sample the intervals are those of the whole log up to then (its distinct sample times). At the log's
very first time there are none, and the patience is `MAX_GAP_S`. No later sample enters. Two samples further apart than
the first one's patience are a gap: between them the agent is not in the scene, for planners and judges alike.
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
    """(3) `(m,)`, s; `MAX_AGE_S` wherever the next sample comes within that anyway."""
    out = np.full(len(t), MAX_AGE_S)
    apart = np.diff(t, append=np.inf)
    apart[offsets[1:] - 1] = np.inf
    rare = np.flatnonzero((apart > MAX_AGE_S) & ~np.repeat(static, np.diff(offsets)))
    first = np.repeat(offsets[:-1], np.diff(offsets))[rare]
    alone = rare[first == rare]
    if len(alone):
        times = np.unique(t[~np.repeat(static, np.diff(offsets))])
        out[alone] = _after(times, np.zeros(len(alone), np.int64), np.searchsorted(times, t[alone]))
    rest = first < rare
    out[rare[rest]] = _after(t, first[rest], rare[rest])
    return out


def _after(t: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    """(3) of the samples `last` `(k,)` of tracks that begin at `first`; `MAX_GAP_S` where there is no interval."""
    count = np.minimum(last - first, INTERVALS)
    back = np.arange(INTERVALS)
    end = last[:, None] - np.where(back < count[:, None], back, 0)
    steps = np.sort(np.where(back < count[:, None], t[end] - t[end - 1], np.inf), axis=1)
    row = np.arange(len(last))
    median = (steps[row, np.maximum(count - 1, 0) // 2] + steps[row, count // 2]) / 2.0
    return np.clip(MISSED * median, MAX_AGE_S, MAX_GAP_S)


Spans = tuple[tuple[float, float], ...]
"""Disjoint times from which to which something was observed, in order."""
TOGETHER = 3
"""Two people who leave the view side by side are no end of a recording."""
ENOUGH = 0.8
"""Share of a log's time below which its traffic is too little for a verdict on safety."""
_ROUNDING_S = 1e-6


def of_stream(t: FloatArray) -> Spans:
    """The spans of a stream with messages at the times `t` `(n,)`: it breaks where a message is overdue.

    A message is overdue after twice the usual interval (median), within the bounds of `logs.observed`.
    """
    if not len(t):
        return ()
    t = np.unique(t)
    apart = np.diff(t)
    usual = float(np.median(apart)) if len(apart) else 0.0
    breaks = np.flatnonzero(apart > min(max(MISSED * usual, MAX_AGE_S), MAX_GAP_S))
    return tuple(zip(t[np.r_[0, breaks + 1]].tolist(), t[np.r_[breaks, len(t) - 1]].tolist(), strict=True))


def inferred(offsets: IntArray, static: BoolArray, t: FloatArray) -> Spans:
    """The span of ragged tracks (`logs.scenario.Tracks`) by (1) and (2); empty where none of them moves."""
    moving = np.flatnonzero(~static)
    if not len(moving):
        return ()
    first, last = np.sort(t[offsets[moving]]), np.sort(t[offsets[moving + 1] - 1])
    apart = np.diff(t)
    apart[offsets[1:-1] - 1] = np.nan
    usual = float(np.nanmedian(apart)) if np.isfinite(apart).any() else 0.0
    same = 0.5 * usual + _ROUNDING_S
    ended = np.searchsorted(last, last + same) - np.searchsorted(last, last - same)
    there = np.searchsorted(first, last + same) - np.searchsorted(last, last - same)
    together = (ended >= TOGETHER) & (2 * ended > there) & (first[-1] <= last + same)
    end = last[np.argmax(together)] + same if together.any() else last[-1]
    return ((float(first[0]), float(last[last <= end][-1])),)


def clipped(spans: Spans, begin: float, end: float) -> Spans:
    """The parts of the spans between two times, with `begin` as the new zero."""
    parts = ((max(first, begin) - begin, min(last, end) - begin) for first, last in spans)
    return tuple(part for part in parts if part[0] <= part[1])


def observed_until(spans: Spans, t: float) -> float:
    """The end of the span that holds the time `t`; `t` itself where none does."""
    return next((last for first, last in spans if first <= t + _ROUNDING_S and t <= last), t)


def within(spans: Spans, t: FloatArray) -> BoolArray:
    """Which of the times `t` `(n,)` lie in a span."""
    found = np.zeros(len(t), np.bool_)
    for first, last in spans:
        found |= (t >= first - _ROUNDING_S) & (t <= last + _ROUNDING_S)
    return found


def described(spans: Spans) -> str:
    """The spans in words: "until 0.1 s", "from 2.0 s to 5.0 s and from 7.0 s to 9.0 s"."""
    if not spans:
        return "at no time"
    if len(spans) == 1 and spans[0][0] <= _ROUNDING_S:
        return f"until {spans[0][1]:.1f} s"
    return " and ".join(f"from {first:.1f} s to {last:.1f} s" for first, last in spans)
