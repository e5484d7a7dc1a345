"""One drive of a log: which one it is, and what it gives back."""

from __future__ import annotations

from dataclasses import dataclass

from logs.trace import Trace

TRUSTED = "the planner was trusted: it ran in the process that holds the log"
"""The note of a drive whose planner was not kept apart and does not come with replan."""
BATCHED = "batched: the planner's process was shared with other logs, up to {} in all"
"""The note of a drive whose frames were planned together with those of other logs."""


@dataclass(frozen=True, order=True)
class DriveKey:
    """Which of a log's drives it is; they are driven in this order.

    Attributes:
        member: Of the ensemble; 0: the log itself.
        planner: Of the run's, by place.
        mode: Of its loops, by place.
        again: Whether it is the second drive of a start, which is compared with the first (`replay.loop.determinism`).
    """

    member: int = 0
    planner: int = 0
    mode: int = 0
    again: bool = False


FIRST = DriveKey()


@dataclass(frozen=True, slots=True)
class StageTime:
    """How long a stage of one plan took; stage "total" is the whole of `plan()`.

    Attributes:
        t: The frame's time, s since the scenario's start.
        stage: As the planner named it in `lap(stage)`.
        seconds: Wall time; laps of one name within a frame are added.
    """

    t: float
    stage: str
    seconds: float


@dataclass(frozen=True, eq=False, slots=True)
class Drive:
    """A trace, and apart from it what is not the same twice: how long planning took."""

    trace: Trace
    timings: tuple[StageTime, ...]
