"""The road users around a span of time: of a long log, who is there then, so that a step does not go over all of it.

A part of some tracks answers what is asked of an instant in its span (`Tracks.perceived`, where a box is) as the whole
does, to the bit: of who is in it, it has all samples within the span, one beyond, and before it those of `BACK_S`, at
least `OWN`. `BACK_S` is longer than a sample stands for its agent (`logs.observed.MAX_GAP_S`) and trends reach back
(`logs.scenario.TREND_S`) together.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np

from logs.agents import AgentKind
from logs.kernel import BoolArray, FloatArray, IntArray, frozen
from logs.motion import Motion
from logs.observed import INTERVALS
from logs.scenario import Tracks

BACK_S = 15.0
OWN = INTERVALS + 3
SPAN_S = 10.0
"""A part is made for so long at least."""
FEW_SAMPLES = 20_000
"""Thirty road users for a minute at 10 Hz."""


class Spans:
    """Finds who is there, by the first and the last sample of each track.

    Args:
        tracks: Of which parts are taken.
    """

    def __init__(self, tracks: Tracks) -> None:
        self._tracks = tracks
        self._first, self._last = tracks.t[tracks.offsets[:-1]], tracks.t[tracks.offsets[1:] - 1]

    def within(self, first: float, last: float) -> tuple[IntArray, IntArray, IntArray]:
        """Who is in the part for the times from `first` to `last`, s, and from which to before which sample `(k,)`."""
        tracks = self._tracks
        there = (self._first <= last + 1e-6) & (self._last >= first - BACK_S)
        who = np.flatnonzero(there | tracks.static)
        begin, end = tracks.offsets[who], tracks.offsets[who + 1]
        low, high = begin.copy(), end.copy()
        for k in np.flatnonzero(~tracks.static[who]):
            t = tracks.t[begin[k] : end[k]]
            back, now, ahead = np.searchsorted(t, (first - BACK_S, first, last + 1e-6))
            low[k] = begin[k] + max(min(back, now - OWN), 0)
            high[k] = begin[k] + min(ahead + 1, len(t))
        return who, low, high


class NearbyTracks:
    """Parts of the tracks that are asked for, each kept for as long as it will do.

    Args:
        few: Tracks with no more samples than this are their own part.
    """

    def __init__(self, few: int = FEW_SAMPLES) -> None:
        self._few = few
        self._whole, self._part = Tracks.empty(), Tracks.empty()
        self._spans = Spans(self._whole)
        self._from, self._until = np.inf, -np.inf

    def of(self, tracks: Tracks, first: float, last: float) -> Tracks:
        """The tracks, or a part of them that answers for the times from `first` to `last`, s."""
        if len(tracks.t) <= self._few:
            return tracks
        if tracks is not self._whole:
            self._whole, self._spans, self._from = tracks, Spans(tracks), np.inf
        if not self._from <= first <= last <= self._until:
            self._from, self._until = first, max(last, first + SPAN_S)
            self._part = _part(tracks, *self._spans.within(self._from, self._until))
        return self._part


@dataclass(frozen=True, eq=False)
class Part(Tracks):
    """Samples of some tracks, with what can only be said of all of them.

    Attributes:
        source: The tracks.
        at: `(m,)` which of its samples.
    """

    source: Tracks = field(kw_only=True)
    at: IntArray = field(kw_only=True)

    @cached_property
    def patience(self) -> FloatArray:
        """As the tracks have it."""
        return frozen(self.source.patience[self.at])

    @cached_property
    def motion(self) -> Motion:
        """As the tracks have it."""
        moved = self.source.motion
        return Motion(*(column[self.at] for column in (moved.vx, moved.vy, moved.ax, moved.ay)))


@dataclass(frozen=True, eq=False)
class Recent(Tracks):
    """Tracks as they are around now.

    Attributes:
        all_of_them: Makes the whole that they are a part of.
    """

    all_of_them: Callable[[], Tracks] = field(kw_only=True)

    @property
    def whole(self) -> Tracks:
        """The tracks since the begin."""
        return self.all_of_them()

    def only(self, ids: Collection[str]) -> Tracks:
        """As `Tracks.only`, of the whole, too."""
        columns = (getattr(super(Recent, self).only(ids), each.name) for each in fields(Tracks))
        return Recent(*columns, all_of_them=lambda: self.whole.only(ids))


def _part(tracks: Tracks, who: IntArray, low: IntArray, high: IntArray) -> Tracks:
    """The samples from `low` to before `high` `(k,)` of the tracks `who`."""
    sizes = high - low
    if sizes.sum() == len(tracks.t):
        return tracks
    offsets = np.r_[0, np.cumsum(sizes)]
    at = np.repeat(low - offsets[:-1], sizes) + np.arange(offsets[-1])
    columns = (getattr(tracks, name)[at] for name in ("t", "x", "y", "yaw", "vx", "vy"))
    return Part(*heads(tracks, who), offsets, *columns, source=tracks, at=at)


def heads(
    tracks: Tracks, who: IntArray
) -> tuple[tuple[str, ...], tuple[AgentKind, ...], FloatArray, FloatArray, BoolArray]:
    """Ids, kinds, lengths, widths of the tracks `who` `(k,)`, and which never move."""
    ids, kinds = tuple(tracks.ids[i] for i in who), tuple(tracks.kinds[i] for i in who)
    return ids, kinds, tracks.length[who], tracks.width[who], tracks.static[who]
