"""The frames of a drive, during and after it: the large parts of a long drive are stored in a temporary file.

A plan's trajectory, graphs and costs and the predictions are most of a frame (46 kB of 47 among thirty road users).
The first `WHOLE` frames are kept in memory; of later frames these parts go into an unnamed file and are read back at
each access, equal to the bit. Everything else that metrics read stays in memory (`light`).
"""

from __future__ import annotations

import pickle
import tempfile
import weakref
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import IO, overload

import numpy as np

from logs.errors import writing
from logs.kernel import FloatArray
from logs.states import TRAJECTORY_COLUMNS, Trajectory
from logs.trace import Candidates, CostTerms, Graph, PlannedFrame

WHOLE = 600
"""A minute at 10 Hz: 28 MB among thirty road users."""
_LARGE = (Graph, CostTerms, Candidates)
"""Artefacts that no metric reads."""
COLUMN = {name: row for row, name in enumerate(TRAJECTORY_COLUMNS)}


def _closed(file: IO[bytes]) -> None:
    with suppress(OSError):  # of a full disk, on which nothing of it is wanted any more
        file.close()


class Scratch:
    """An unnamed temporary file, removed together with this object."""

    def __init__(self) -> None:
        self._file: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  it goes with this
        self.close = weakref.finalize(self, _closed, self._file)
        self._end, self._reads = 0, False

    def put(self, data: bytes) -> int:
        """Append data and return their offset; OSError where the disk is full."""
        begin = self._end
        if self._reads:
            self._file.seek(begin)
        self._file.write(data)
        self._file.flush()  # a full disk is found here, and not where they are read
        self._end, self._reads = begin + len(data), False
        return begin

    def get(self, begin: int, size: int) -> bytes:
        """A number of bytes from a place in the file."""
        self._file.seek(begin)
        self._reads = True
        return self._file.read(size)


class Filed(Trajectory):
    """A trajectory whose columns are read from a file each time they are asked for."""

    __slots__ = ("_begin", "_file", "_size")
    _file: Scratch
    _begin: int
    _size: int

    @classmethod
    def put(cls, path: Trajectory, file: Scratch) -> Filed:
        """A trajectory, from now on in the file."""
        data = np.stack([getattr(path, name) for name in TRAJECTORY_COLUMNS]).tobytes()
        made = object.__new__(cls)
        for name, value in (("_file", file), ("_begin", file.put(data)), ("_size", len(data))):
            object.__setattr__(made, name, value)
        return made

    @property
    def loaded(self) -> Trajectory:
        """The same in memory."""
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
    """The trajectory in memory, for use of several of its columns."""
    return path.loaded if isinstance(path, Filed) else path


class FrameStore(Sequence[PlannedFrame]):
    """The frames so far, in order of time.

    Args:
        whole: Number of frames that are kept in memory.

    Raises:
        OutputError: (append) The file cannot be written.
    """

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
            path = Filed.put(frame.plan.trajectory, self._file)
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
        """The frames as they are in memory: later ones without graphs, costs, predictions ..., their plans `Filed`."""
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
    """The frames as they are in memory (`FrameStore.light`)."""
    return frames.light if isinstance(frames, FrameStore) else tuple(frames)
