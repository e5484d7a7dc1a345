"""Limits the memory of a long drive: stores frames in a file, cuts tracks to a time span, returns free memory.

Frames. A plan's trajectory, graphs and costs, and the predictions, take most of its memory (46 of 47 kB with thirty
users). The first `WHOLE` frames are kept in memory; of later frames these parts go into an unnamed file and are read
back at each access, equal to the bit. Everything else that metrics read stays in memory (`light`).

Road users. For every instant in its span, a part of the tracks gives the same results as the whole (`Tracks.perceived`,
positions of boxes), to the bit, so that a step of a long log does not process all tracks. A part holds the samples
within the span, one after it, and those of `BACK_S` before it, at least `OWN` of each track. `BACK_S` is longer than
the time for which a sample is valid (`logs.observed.MAX_GAP_S`) plus the time over which trends are computed
(`logs.tracks.TREND_S`).

Free memory. After a stage of a run, the C library keeps fragmented free memory, and Arrow keeps a pool. For a drive of
an hour both take 100 to 200 MB, in addition to the memory of the next stage.
"""

from __future__ import annotations

import ctypes
import pickle
import tempfile
import weakref
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import IO, overload

import numpy as np

from logs.agents import AgentKind
from logs.arrays import BoolArray, FloatArray, IntArray, frozen
from logs.errors import writing
from logs.motion import Motion
from logs.observed import INTERVALS
from logs.plan import Candidates, CostTerms, Graph
from logs.states import TRAJECTORY_COLUMNS, Trajectory
from logs.trace import PlannedFrame
from logs.tracks import SAMPLE_COLUMNS, Tracks

WHOLE = 600
"""Number of frames that stay whole in memory: a minute at 10 Hz, 28 MB with thirty road users."""
_LARGE = (Graph, CostTerms, Candidates)
"""Artefacts that no metric reads."""
COLUMN = {name: row for row, name in enumerate(TRAJECTORY_COLUMNS)}
BACK_S = 15.0
OWN = INTERVALS + 3
SPAN_S = 10.0
"""Shortest time span of a part, s."""
FEW_SAMPLES = 20_000
"""Tracks with at most this many samples are not cut: thirty road users for a minute at 10 Hz have 18,000."""


def _closed(file: IO[bytes]) -> None:
    with suppress(OSError):  # the disk is full, and the content is no longer needed
        file.close()


class Scratch:
    """An unnamed temporary file, removed together with this object."""

    def __init__(self) -> None:
        self._file: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  `close` removes it
        self.close = weakref.finalize(self, _closed, self._file)
        self._end, self._reads = 0, False

    def put(self, data: bytes) -> int:
        """Append data and return their offset; OSError where the disk is full."""
        begin = self._end
        if self._reads:
            self._file.seek(begin)
        self._file.write(data)
        self._file.flush()  # a full disk raises here, not when the data are read
        self._end, self._reads = begin + len(data), False
        return begin

    def get(self, begin: int, size: int) -> bytes:
        """Return `size` bytes from the offset `begin`."""
        self._file.seek(begin)
        self._reads = True
        return self._file.read(size)


class SpilledTrajectory(Trajectory):
    """A trajectory whose columns are read from a file at each access."""

    __slots__ = ("_begin", "_file", "_size")
    _file: Scratch
    _begin: int
    _size: int

    @classmethod
    def put(cls, path: Trajectory, file: Scratch) -> SpilledTrajectory:
        """Write a trajectory to the file and return the one that reads from it."""
        data = np.stack([getattr(path, name) for name in TRAJECTORY_COLUMNS]).tobytes()
        made = object.__new__(cls)
        for name, value in (("_file", file), ("_begin", file.put(data)), ("_size", len(data))):
            object.__setattr__(made, name, value)
        return made

    @property
    def loaded(self) -> Trajectory:
        """The same trajectory in memory."""
        made = object.__new__(Trajectory)
        for name, row in zip(TRAJECTORY_COLUMNS, self._rows(), strict=True):
            object.__setattr__(made, name, row)
        return made

    def _rows(self) -> FloatArray:
        return np.frombuffer(self._file.get(self._begin, self._size)).reshape(len(TRAJECTORY_COLUMNS), -1)

    def __getattr__(self, name: str) -> FloatArray:
        if name not in COLUMN:
            raise AttributeError(name)
        return np.asarray(self._rows()[COLUMN[name]])


def loaded(path: Trajectory) -> Trajectory:
    """Return the trajectory in memory, for code that reads several columns."""
    return path.loaded if isinstance(path, SpilledTrajectory) else path


class FrameStore(Sequence[PlannedFrame]):
    """The frames of a drive, in order of time; `whole` stay in memory. OutputError if the file cannot be written."""

    def __init__(self, whole: int = WHOLE) -> None:
        self._whole = whole
        self._frames: list[PlannedFrame] = []
        self._places: list[tuple[int, int]] = []
        self._file: Scratch | None = None

    def append(self, frame: PlannedFrame) -> None:
        """Add a frame."""
        if len(self._frames) < self._whole:
            self._frames.append(frame)
            return
        data = pickle.dumps((frame.plan.internals, frame.predictions, frame.visibility), pickle.HIGHEST_PROTOCOL)
        with writing(Path(tempfile.gettempdir())):
            self._file = self._file or Scratch()
            path = SpilledTrajectory.put(frame.plan.trajectory, self._file)
            self._places.append((self._file.put(data), len(data)))
        small = tuple(item for item in frame.plan.internals if not isinstance(item, _LARGE))
        plan = replace(frame.plan, trajectory=path, internals=small)
        self._frames.append(replace(frame, plan=plan, predictions=None, visibility=None))

    @property
    def frames(self) -> Sequence[PlannedFrame]:
        """This store, or a tuple where all frames are in memory."""
        return self if self._places else tuple(self._frames)

    @property
    def light(self) -> tuple[PlannedFrame, ...]:
        """The frames as they are in memory: after the first `whole`, without graphs, costs and predictions."""
        return tuple(self._frames)

    def __len__(self) -> int:
        return len(self._frames)

    def __iter__(self) -> Iterator[PlannedFrame]:
        return (self[index] for index in range(len(self)))

    @overload
    def __getitem__(self, index: int) -> PlannedFrame: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[PlannedFrame, ...]: ...

    def __getitem__(self, index: int | slice) -> PlannedFrame | tuple[PlannedFrame, ...]:
        if isinstance(index, slice):
            return tuple(self[i] for i in range(*index.indices(len(self))))
        index = range(len(self))[index]
        frame = self._frames[index]
        if index < self._whole or self._file is None:
            return frame
        place = self._places[index - self._whole]
        internals, predictions, visibility = pickle.loads(self._file.get(*place))
        plan = replace(frame.plan, trajectory=loaded(frame.plan.trajectory), internals=internals)
        return replace(frame, plan=plan, predictions=predictions, visibility=visibility)


def light(frames: Sequence[PlannedFrame]) -> tuple[PlannedFrame, ...]:
    """Return the frames as they are in memory (`FrameStore.light`)."""
    return frames.light if isinstance(frames, FrameStore) else tuple(frames)


class Spans:
    """Finds the tracks that are present in a time span."""

    def __init__(self, tracks: Tracks) -> None:
        self._tracks = tracks
        self._first, self._last = tracks.t[tracks.offsets[:-1]], tracks.t[tracks.offsets[1:] - 1]

    def within(self, first: float, last: float) -> tuple[IntArray, IntArray, IntArray]:
        """Return the tracks `(k,)` present from `first` to `last`, s, and begin and end of their samples."""
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
    """Returns parts of tracks with more than `few` samples, and reuses the last part while it covers the span."""

    def __init__(self, few: int = FEW_SAMPLES) -> None:
        self._few = few
        self._whole, self._part = Tracks.empty(), Tracks.empty()
        self._spans = Spans(self._whole)
        self._from, self._until = np.inf, -np.inf

    def of(self, tracks: Tracks, first: float, last: float) -> Tracks:
        """Return the tracks, or a part of them that gives exact results from `first` to `last`, s."""
        if len(tracks.t) <= self._few:
            return tracks
        if tracks is not self._whole:
            self._whole, self._spans, self._from = tracks, Spans(tracks), np.inf
        if not self._from <= first <= last <= self._until:
            self._from, self._until = first, max(last, first + SPAN_S)
            who, low, high = self._spans.within(self._from, self._until)
            sizes = high - low
            if sizes.sum() == len(tracks.t):
                self._part = tracks
                return tracks
            offsets = np.r_[0, np.cumsum(sizes)]
            at = np.repeat(low - offsets[:-1], sizes) + np.arange(offsets[-1])
            columns = (getattr(tracks, name)[at] for name in SAMPLE_COLUMNS)
            self._part = TrackSamples(*heads(tracks, who), offsets, *columns, source=tracks, at=at)
        return self._part


@dataclass(frozen=True, eq=False)
class TrackSamples(Tracks):
    """Samples of some tracks, with the properties that depend on whole tracks."""

    source: Tracks = field(kw_only=True)  # the whole tracks
    at: IntArray = field(kw_only=True)  # `(m,)` indices of the samples in `source`

    @cached_property
    def patience(self) -> FloatArray:
        """The patience of the samples in the whole tracks."""
        return frozen(self.source.patience[self.at])

    @cached_property
    def motion(self) -> Motion:
        """The motion of the samples in the whole tracks."""
        moved = self.source.motion
        return Motion(*(column[self.at] for column in (moved.vx, moved.vy, moved.ax, moved.ay)))


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
        columns = (getattr(super(Recent, self).only(ids), each.name) for each in fields(Tracks))
        return Recent(*columns, all_of_them=lambda: self.whole.only(ids))


def heads(
    tracks: Tracks, who: IntArray
) -> tuple[tuple[str, ...], tuple[AgentKind, ...], FloatArray, FloatArray, BoolArray]:
    """Return ids, kinds, lengths and widths of the tracks `who` `(k,)`, and which of them never move."""
    ids, kinds = tuple(tracks.ids[i] for i in who), tuple(tracks.kinds[i] for i in who)
    return ids, kinds, tracks.length[who], tracks.width[who], tracks.static[who]


def trim_memory() -> None:
    """Return free memory to the system, where the system can take it (glibc)."""
    import pyarrow as pa  # imported late: reading a trace does not need Arrow

    pa.default_memory_pool().release_unused()
    with suppress(AttributeError, OSError, TypeError):  # another C library
        ctypes.CDLL(None).malloc_trim(0)
