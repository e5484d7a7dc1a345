"""The frames of a drive, and the context of a planner, with changes of the input
(`replan.explain.input_changes`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import inf, nan

import numpy as np

from replan.explain.input_changes import InputChange
from replan.explain.input_edits import ChangedInput
from replan.logs.frame import Frame, PlannerContext
from replan.logs.past import Snapshot


class ChangedFrames(Sequence[Frame]):
    """The frames of a drive with a change; each is made when it is asked for."""

    def __init__(self, frames: Sequence[Frame], change: InputChange) -> None:
        self._frames, self._change = frames, change
        self._made: dict[int, Frame] = {}

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> Frame:  # type: ignore[override]
        if index not in self._made:
            self._made[index] = self._make(index)
        return self._made[index]

    def _make(self, index: int) -> Frame:
        edit = self._change.row.edit
        if edit is None:
            return self._frames[index]
        frame = edit(self.input_at(index))
        snapshots = ChangedSnapshots(self, index, frame.earlier.snapshots)
        return replace(frame, earlier=replace(frame.earlier, snapshots=snapshots))

    def input_at(self, index: int) -> ChangedInput:
        """What the edit of a frame gets."""
        frame, kinds = self._frames[index], self._change.kinds
        about = [not kinds or kind in kinds for kind in frame.agents.kinds]
        return ChangedInput(
            frame,
            lambda count: self._frames[max(0, index - count)],
            self._change.value,
            np.array(about, dtype=np.bool_),
        )


class ChangedSnapshots(Sequence[Snapshot]):
    """What was shown before a changed frame, changed likewise, if a planner asks for its past.

    Args:
        frames: The changed frames.
        index: The frame.
        given: What was shown before it, unchanged; the last ones are those of the frames before.
    """

    def __init__(self, frames: ChangedFrames, index: int, given: Sequence[Snapshot]) -> None:
        self._frames, self._given = frames, given
        self._first = index - len(given)

    def __len__(self) -> int:
        return len(self._given)

    def __getitem__(self, index: int) -> Snapshot:  # type: ignore[override]
        place = self._first + range(len(self))[index]
        return self._frames[place].snapshot if place >= 0 else self._given[index]


def limits_that_fit(drives: Sequence[Sequence[Frame]], change: InputChange) -> tuple[float, float]:
    """The interval of values that change the frames of some drives as the value of `change` does,
    m; NaN if its value is no limit.
    """
    measure = change.row.measure
    if measure is None:
        return nan, nan
    low, high = 0.0, inf
    for frames in drives:
        inputs = ChangedFrames(frames, change)
        for index in range(len(frames)):
            of_frame = inputs.input_at(index)
            values = measure(of_frame)[of_frame.agents]
            low = max(low, float(values[values <= change.value].max(initial=0.0)))
            high = min(high, float(values[values > change.value].min(initial=inf)))
    return low, high


def changed(frames: Sequence[Frame], changes: Sequence[InputChange]) -> Sequence[Frame]:
    """The frames of a drive, in order of time, with changes, one after the other."""
    for change in changes:
        frames = ChangedFrames(frames, change)
    return frames


def changed_context(context: PlannerContext, changes: Sequence[InputChange]) -> PlannerContext:
    """The context with the changes that are of the context."""
    for change in changes:
        if change.row.of_context is not None:
            context = change.row.of_context(context, change.value)
    return context
