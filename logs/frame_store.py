"""The frames of a drive while it is driven and after: of a long one, what is large waits in a file.

A plan's graphs and the predictions are most of a frame (40 kB of 46 among thirty road users). The first `WHOLE` frames
are kept as they are; of later ones these go into a file without a name and are read back each time they are asked for,
equal to the bit. What metrics look at stays in memory (`light`).
"""

from __future__ import annotations

import pickle
import tempfile
import weakref
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import IO, overload

from logs.errors import writing
from logs.trace import Graph, PlannedFrame

WHOLE = 600
"""A minute at 10 Hz: 28 MB among thirty road users."""


class FrameStore(Sequence[PlannedFrame]):
    """The frames so far, in order of time.

    Args:
        whole: So many are kept in memory as they are.

    Raises:
        OutputError: (append) The file cannot be written.
    """

    def __init__(self, whole: int = WHOLE) -> None:
        self._whole = whole
        self._frames: list[PlannedFrame] = []
        self._places: list[tuple[int, int]] = []
        self._file: IO[bytes] | None = None

    def append(self, frame: PlannedFrame) -> None:
        """One more."""
        if len(self._frames) < self._whole:
            self._frames.append(frame)
            return
        data = pickle.dumps((frame.plan.internals, frame.predictions, frame.visibility), pickle.HIGHEST_PROTOCOL)
        with writing(Path(tempfile.gettempdir())):
            if self._file is None:
                self._file = tempfile.TemporaryFile()  # noqa: SIM115  it goes with this
                weakref.finalize(self, self._file.close)
            begin = self._file.seek(0, 2)
            self._file.write(data)
        self._places.append((begin, len(data)))
        small = tuple(item for item in frame.plan.internals if not isinstance(item, Graph))
        self._frames.append(
            replace(frame, plan=replace(frame.plan, internals=small), predictions=None, visibility=None)
        )

    @property
    def frames(self) -> Sequence[PlannedFrame]:
        """These, or a tuple where all are in memory."""
        return self if self._places else tuple(self._frames)

    @property
    def light(self) -> tuple[PlannedFrame, ...]:
        """The frames without graphs, predictions and visibility, where these are in the file."""
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
        begin, size = self._places[index - self._whole]
        self._file.seek(begin)
        internals, predictions, visibility = pickle.loads(self._file.read(size))
        plan = replace(frame.plan, internals=internals)
        return replace(frame, plan=plan, predictions=predictions, visibility=visibility)


def light(frames: Sequence[PlannedFrame]) -> tuple[PlannedFrame, ...]:
    """The frames as they are in memory (`FrameStore.light`)."""
    return frames.light if isinstance(frames, FrameStore) else tuple(frames)
