"""The past of frames between two processes: what the planner lacks, once.

A frame that was sent is a part of the past of later ones. What was before the first frame of a
drive is therefore sent with the first frames, and only to planners that ask for it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from operator import attrgetter

from replan.core.errors import PlannerError
from replan.logs import frame as nouns
from replan.logs.past import PAST_S, SAME_TIME_S, Earlier, Snapshot, forget
from replan.replay.parts import Factory
from replan.replay.planner_process import messages


def past_s_of(factory: Factory) -> float:
    """The length of the past that a planner's class asks for, s; PlannerError if it is no number
    from 0 to `PAST_S`.
    """
    asked = getattr(factory, "past_s", 0.0)
    if not isinstance(asked, int | float) or not 0.0 <= asked <= PAST_S:
        raise PlannerError(f"past_s = {asked!r} in its class is not from 0 to {PAST_S:g} s")
    return float(asked)


def _not_asked(times: Sequence[float]) -> Sequence[Snapshot]:
    raise RuntimeError(
        f"frame.past is read without being asked for: give the planner's class past_s = {PAST_S:g}"
    )


NOT_ASKED = Earlier(before=_not_asked)
"""The past of frames for planners that do not ask for it: it raises."""


class SentPast:
    """Makes the messages of one drive's frames, for a planner that asks for `past_s`."""

    def __init__(self, past_s: float) -> None:
        self._past_s = past_s
        self._sent: set[float] = set()

    def message(self, frame: nouns.Frame) -> messages.Frame:
        """The message of a frame, with the snapshots that the planner lacks."""
        message = messages.frame_message(frame)
        if self._past_s > 0.0:
            begin = frame.t - self._past_s - SAME_TIME_S
            lacking = [
                snapshot
                for snapshot in frame.earlier.known(frame.snapshot)
                if snapshot.t >= begin and snapshot.t not in self._sent
            ]
            message.earlier = list(map(messages.snapshot_message, lacking))
            self._sent |= {frame.t, *(snapshot.t for snapshot in lacking)}
        return message


class ReceivedPast:
    """Makes the frames of one drive's messages, with their past."""

    def __init__(self, past_s: float) -> None:
        self._past_s = past_s
        self._snapshots: deque[Snapshot] = deque()

    def frame(self, message: messages.Frame) -> nouns.Frame:
        """The frame of a message."""
        frame = messages.frame_of(message)
        if not self._past_s:
            return replace(frame, earlier=NOT_ASKED)
        known = [*self._snapshots, *map(messages.snapshot_of, message.earlier)]
        self._snapshots = deque(sorted(known, key=attrgetter("t")))
        forget(self._snapshots, frame.t)
        before = [item for item in self._snapshots if item.t < frame.t - SAME_TIME_S]
        self._snapshots.append(frame.snapshot)
        return replace(frame, earlier=Earlier(tuple(before)))
