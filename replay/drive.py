"""One drive of a log: its key, its result, and the clock of its planner."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from time import perf_counter

from replan.logs.trace import Trace


class Mark(Enum):
    """What stands beside the planner's name of a drive in reports.

    Attributes:
        TRUSTED: The planner is not built in, and ran in the process that holds the log.
        BATCHED: Its frames were planned together with those of other logs.
        NOT_DETERMINISTIC: The drive's start differs when it is driven twice.
    """

    TRUSTED = "trusted"
    BATCHED = "batched"
    NOT_DETERMINISTIC = "not deterministic"


@dataclass(frozen=True, order=True)
class DriveKey:
    """Identifies one drive of a log; drives are run in the order of their keys.

    Attributes:
        member: Number in the ensemble; 0: the log itself.
        planner: Index of the planner in the run.
        mode: Index of the loop in the run.
        again: Whether it repeats the start of a drive, for comparison with the first
            (`replan.replay.loop.planning`).
    """

    member: int = 0
    planner: int = 0
    mode: int = 0
    again: bool = False


FIRST = DriveKey()


@dataclass(frozen=True, slots=True)
class StageTime:
    """The duration of one stage of a plan; the stage "total" is all of `plan()`.

    Attributes:
        t: The frame's time, s since the scenario's start.
        stage: Name that the planner passed to `lap(stage)`.
        seconds: Wall-clock time; laps with the same name within a frame are added.
    """

    t: float
    stage: str
    seconds: float


@dataclass(frozen=True, eq=False, slots=True)
class Drive:
    """A trace, the marks of its planner, and the planning times, which differ when the drive is
    repeated.
    """

    trace: Trace
    timings: tuple[StageTime, ...]
    marks: tuple[Mark, ...] = ()


class Stopwatch:
    """Measures how long a planner takes, in total and per stage. Its times do not go into the
    trace.

    It runs from `start` to `stop`; in between, the planner calls `lap` as `PlannerContext.lap`.
    """

    def __init__(self) -> None:
        self._times: list[StageTime] = []
        self._laps: dict[str, float] = {}
        self._begin = self._last = 0.0
        self._running = False

    def start(self) -> None:
        """Start to measure one plan."""
        self._laps = {}
        self._running = True
        self._begin = self._last = perf_counter()

    def lap(self, stage: str) -> None:
        """End a stage; ignored outside of planning (while the planner is built)."""
        if not self._running:
            return
        now = perf_counter()
        self._laps[stage] = self._laps.get(stage, 0.0) + now - self._last
        self._last = now

    def stop(self, t: float) -> None:
        """End the plan of the frame at `t`."""
        total = perf_counter() - self._begin
        self._running = False
        self._laps.pop("total", None)
        laps = {**self._laps, "total": total}
        self._times += [StageTime(t, stage, seconds) for stage, seconds in laps.items()]

    def took(self, stage: str, seconds: float) -> None:
        """Add the time of a stage that another process has measured."""
        self._laps[stage] = self._laps.get(stage, 0.0) + seconds

    def waited(self, seconds: float) -> None:
        """Exclude a time during which the plan was not computed."""
        self._begin += seconds
        self._last += seconds

    @property
    def laps(self) -> dict[str, float]:
        """The durations of the stages of the latest plan, s."""
        return self._laps

    @property
    def times(self) -> tuple[StageTime, ...]:
        """The times of all plans so far: stages in order of their first lap, then "total"."""
        return tuple(self._times)
