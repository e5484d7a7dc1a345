"""The pace of a run: how many logs a minute, how much time is left, and when to print it."""

from __future__ import annotations

from dataclasses import dataclass

from replan.core.names import counted

LEAST_S, MOST_S = 5.0, 60.0
"""A line is printed after each tenth of the logs, at least 5 s apart, and at least each minute."""


@dataclass
class Pace:
    """Decides when to print the progress of a run, and makes the line."""

    total: int
    # Time at which the first log was started, s; later by the time in which kernels were compiled
    begin: float
    left: float  # Expected time of the logs that have not ended, s, or another cost of all logs
    ended_logs: int = 0  # Number of logs that have ended
    driven: int = 0  # Number of them that were driven in this run
    spent: float = 0.0  # Expected cost of the logs that were driven, in the unit of `left`
    ended: float = 0.0  # Time at which the last log ended, s
    last: float = 0.0  # Time at which the last line was printed, s
    tenth: int = 0  # Number of tenths that were done at that time

    def __post_init__(self) -> None:
        self.last = self.ended = self.begin

    def step(
        self, now: float, *, driven: bool, cost: float = 1.0, compiled: bool = False
    ) -> str | None:
        """Count a log that ended at `now`, s; return the line to print, if any. The last log has
        none.

        `cost`: the expected cost of the log, in the unit of `left`.

        The time since the last log counts for nothing if kernels were `compiled` in it: others do
        not need it again.
        """
        if compiled:
            self.begin, driven = self.begin + now - self.ended, False
        self.ended = now
        self.ended_logs += 1
        self.driven += driven
        self.left = max(self.left - cost, 0.0)
        self.spent += cost * driven
        tenth = 10 * self.ended_logs // self.total
        due = now - self.last >= (LEAST_S if tenth > self.tenth else MOST_S)
        if not due or self.ended_logs == self.total or not self.driven:
            return None
        self.last, self.tenth = now, tenth
        return f"{self.ended_logs} of {counted(self.total, 'log')}, {self.rest(now)}"

    def rest(self, now: float) -> str:
        """Rate and remaining time, by expected costs as the longest logs come first; "" before a
        log was driven.
        """
        if not self.spent:
            return ""
        elapsed = max(now - self.begin, 1e-9)
        rest_s = elapsed * self.left / self.spent
        when = f"{rest_s:.0f} s" if rest_s < 90.0 else f"{rest_s / 60.0:.0f} min"
        return f"{60.0 * self.driven / elapsed:.3g} logs/min, about {when} left"
