"""The one clock: how long a planner takes, in all and per stage. Nothing that it reads goes into a trace."""

from __future__ import annotations

from time import perf_counter

from replay.drive import StageTime


class Stopwatch:
    """Runs from `start` to `stop`; in between, `lap` is given to the planner as `PlannerContext.lap`."""

    def __init__(self) -> None:
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

    def stop(self, t: float) -> tuple[StageTime, ...]:
        """End the plan of the frame at `t`: its stages in order of their first lap, then "total"."""
        total = perf_counter() - self._begin
        self._running = False
        stages = tuple(StageTime(t, stage, seconds) for stage, seconds in self._laps.items() if stage != "total")
        return (*stages, StageTime(t, "total", total))
