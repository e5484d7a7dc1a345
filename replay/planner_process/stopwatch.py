"""The one clock: how long a planner takes, in all and per stage. Nothing that it reads goes into a trace."""

from __future__ import annotations

from time import perf_counter

from replay.drive import StageTime


class Stopwatch:
    """Runs from `start` to `stop`; in between, `lap` is given to the planner as `PlannerContext.lap`."""

    def __init__(self) -> None:
        self._times: list[StageTime] = []
        self._laps: dict[str, float] = {}
        self._begin = self._last = 0.0
        self._running = False

    def start(self) -> None:
        """Begin to measure one plan."""
        self._laps = {}
        self._running = True
        self._begin = self._last = perf_counter()

    def lap(self, stage: str) -> None:
        """A stage has ended; ignored while no plan is being made (a planner under construction)."""
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
        """A stage that another process has measured."""
        self._laps[stage] = self._laps.get(stage, 0.0) + seconds

    def waited(self, seconds: float) -> None:
        """The plan was not being made for so long: it is not counted."""
        self._begin += seconds
        self._last += seconds

    @property
    def laps(self) -> dict[str, float]:
        """The stages of the plan made last, s."""
        return self._laps

    @property
    def times(self) -> tuple[StageTime, ...]:
        """Of all plans so far: their stages in order of their first lap, then "total"."""
        return tuple(self._times)
