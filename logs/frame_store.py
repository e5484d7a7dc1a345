"""Stores the frames of a long drive: after the first minute, the large parts of a plan are in a
file.

A plan's trajectories, graphs and costs, and the predictions, take most of its memory (46 of 47 kB
with thirty users). The first `WHOLE` frames are kept in memory; of later frames these parts go into
an unnamed file and are read back at each access, equal to the bit. Everything else that metrics
read stays in memory (`light`).
"""

from __future__ import annotations

import pickle
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import overload

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.errors import writing
from replan.core.memory import Scratch
from replan.logs.plan import Candidates, CostTerms, Graph
from replan.logs.states import TRAJECTORY_COLUMNS, Trajectory
from replan.logs.trace import PlannedFrame

WHOLE = 600
"""Number of frames that stay whole in memory: a minute at 10 Hz, 28 MB with thirty road users."""
_LARGE = (Graph, CostTerms, Candidates)
"""Artefacts that no metric reads."""
COLUMN = {name: row for row, name in enumerate(TRAJECTORY_COLUMNS)}


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
        spilled = object.__new__(cls)
        for name, value in (("_file", file), ("_begin", file.put(data)), ("_size", len(data))):
            object.__setattr__(spilled, name, value)
        return spilled

    @property
    def loaded(self) -> Trajectory:
        """The same trajectory in memory."""
        trajectory = object.__new__(Trajectory)
        for name, row in zip(TRAJECTORY_COLUMNS, self._rows(), strict=True):
            object.__setattr__(trajectory, name, row)
        return trajectory

    def _rows(self) -> FloatArray:
        return np.frombuffer(self._file.get(self._begin, self._size)).reshape(
            len(TRAJECTORY_COLUMNS), -1
        )

    def __getattr__(self, name: str) -> FloatArray:
        if name not in COLUMN:
            raise AttributeError(name)
        return np.asarray(self._rows()[COLUMN[name]])


def loaded(path: Trajectory) -> Trajectory:
    """Return the trajectory in memory, for code that reads several columns."""
    return path.loaded if isinstance(path, SpilledTrajectory) else path


class FrameStore(Sequence[PlannedFrame]):
    """The frames of a drive, in order of time; `whole` stay in memory.

    OutputError if the file cannot be written.
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
        data = pickle.dumps(
            (frame.plan.internals, frame.predictions, frame.visibility), pickle.HIGHEST_PROTOCOL
        )
        with writing(Path(tempfile.gettempdir())):
            self._file = self._file or Scratch()
            spill = partial(SpilledTrajectory.put, file=self._file)
            plan = frame.plan.changed(spill)
            self._places.append((self._file.put(data), len(data)))
        small = tuple(item for item in frame.plan.internals if not isinstance(item, _LARGE))
        plan = replace(plan, internals=small)
        self._frames.append(replace(frame, plan=plan, predictions=None, visibility=None))

    @property
    def frames(self) -> Sequence[PlannedFrame]:
        """This store, or a tuple where all frames are in memory."""
        return self if self._places else tuple(self._frames)

    @property
    def light(self) -> tuple[PlannedFrame, ...]:
        """The frames as they are in memory: after the first `whole`, without graphs, costs and
        predictions.
        """
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
        plan = replace(frame.plan.changed(loaded), internals=internals)
        return replace(frame, plan=plan, predictions=predictions, visibility=visibility)


def light(frames: Sequence[PlannedFrame]) -> tuple[PlannedFrame, ...]:
    """Return the frames as they are in memory (`FrameStore.light`)."""
    return frames.light if isinstance(frames, FrameStore) else tuple(frames)
