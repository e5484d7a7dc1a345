"""Cuts tracks to a time span, so that a step of a long log does not process all of them.

For every instant in its span, a part of the tracks gives the same results as the whole
(`Tracks.perceived`, positions of boxes), to the bit. A part holds the samples within the span, one
after it, and those of `BACK_S` before it, at least `OWN` of each track. `BACK_S` is longer than the
time for which a sample is valid (`replan.logs.observed.MAX_GAP_S`) plus the time over which trends
are computed (`replan.logs.tracks.TREND_S`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray, frozen
from replan.logs.agents import AgentKind
from replan.logs.motion import Motion
from replan.logs.observed import INTERVALS
from replan.logs.tracks import SAMPLE_COLUMNS, Tracks

BACK_S = 15.0
OWN = INTERVALS + 3
SPAN_S = 10.0
"""Shortest time span of a part, s."""
FEW_SAMPLES = 20_000
"""Tracks with at most this many samples are not cut: thirty road users for a minute at 10 Hz have
18,000.
"""


class Spans:
    """Finds the tracks that are present in a time span."""

    def __init__(self, tracks: Tracks) -> None:
        self._tracks = tracks
        self._first, self._last = tracks.t[tracks.offsets[:-1]], tracks.t[tracks.offsets[1:] - 1]

    def within(self, first: float, last: float) -> tuple[IntArray, IntArray, IntArray]:
        """Return the tracks `(k,)` present from `first` to `last`, s, and begin and end of their
        samples.
        """
        tracks = self._tracks
        is_present = (self._first <= last + 1e-6) & (self._last >= first - BACK_S)
        rows = np.flatnonzero(is_present | tracks.static)
        begin, end = tracks.offsets[rows], tracks.offsets[rows + 1]
        low, high = begin.copy(), end.copy()
        for k in np.flatnonzero(~tracks.static[rows]):
            t = tracks.t[begin[k] : end[k]]
            back, now, ahead = np.searchsorted(t, (first - BACK_S, first, last + 1e-6))
            low[k] = begin[k] + max(min(back, now - OWN), 0)
            high[k] = begin[k] + min(ahead + 1, len(t))
        return rows, low, high


class NearbyTracks:
    """Returns parts of tracks with more than `few` samples, and reuses the last part while it
    covers the span.
    """

    def __init__(self, few: int = FEW_SAMPLES) -> None:
        self._few = few
        self._whole, self._part = Tracks.empty(), Tracks.empty()
        self._spans = Spans(self._whole)
        self._from, self._until = np.inf, -np.inf

    def of(self, tracks: Tracks, first: float, last: float) -> Tracks:
        """Return the tracks, or a part of them that gives exact results from `first` to `last`,
        s.
        """
        if len(tracks.t) <= self._few:
            return tracks
        if tracks is not self._whole:
            self._whole, self._spans, self._from = tracks, Spans(tracks), np.inf
        if not self._from <= first <= last <= self._until:
            self._from, self._until = first, max(last, first + SPAN_S)
            rows, low, high = self._spans.within(self._from, self._until)
            sizes = high - low
            if sizes.sum() == len(tracks.t):
                self._part = tracks
                return tracks
            offsets = np.r_[0, np.cumsum(sizes)]
            samples = np.repeat(low - offsets[:-1], sizes) + np.arange(offsets[-1])
            columns = (getattr(tracks, name)[samples] for name in SAMPLE_COLUMNS)
            self._part = TrackSamples(
                *heads(tracks, rows), offsets, *columns, source=tracks, rows=samples
            )
        return self._part


@dataclass(frozen=True, eq=False)
class TrackSamples(Tracks):
    """Samples of some tracks, with the properties that depend on whole tracks."""

    source: Tracks = field(kw_only=True)  # the whole tracks
    rows: IntArray = field(kw_only=True)  # `(m,)` indices of the samples in `source`

    @cached_property
    def patience(self) -> FloatArray:
        """The patience of the samples in the whole tracks."""
        return frozen(self.source.patience[self.rows])

    @cached_property
    def motion(self) -> Motion:
        """The motion of the samples in the whole tracks."""
        whole = self.source.motion
        columns = whole.vx, whole.vy, whole.ax, whole.ay
        return Motion(*(column[self.rows] for column in columns))


@dataclass(frozen=True, eq=False)
class Recent(Tracks):
    """The recent part of tracks."""

    all_of_them: Callable[[], Tracks] = field(kw_only=True)  # function that builds the whole tracks

    @property
    def whole(self) -> Tracks:
        """The tracks from the beginning of the drive."""
        return self.all_of_them()

    def only(self, ids: Collection[str]) -> Tracks:
        """Return the tracks of these road users, as `Tracks.only`; `whole` is reduced as well."""
        columns = (getattr(super(Recent, self).only(ids), column.name) for column in fields(Tracks))
        return Recent(*columns, all_of_them=lambda: self.whole.only(ids))


def heads(
    tracks: Tracks, rows: IntArray
) -> tuple[tuple[str, ...], tuple[AgentKind, ...], FloatArray, FloatArray, BoolArray]:
    """Return ids, kinds, lengths and widths of the tracks `rows` `(k,)`, and which of them never
    move.
    """
    ids, kinds = tuple(tracks.ids[i] for i in rows), tuple(tracks.kinds[i] for i in rows)
    return ids, kinds, tracks.length[rows], tracks.width[rows], tracks.static[rows]
