"""What the pictures of a drive are drawn from: its tables, its trace, and one moment in it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import isfinite

from logs.errors import ConfigError
from logs.mcap import read_moment
from logs.scenario import Scenario
from logs.trace import PlannedFrame, Said, Trace
from replay.draw.charts.moment import Moment, Violation, violations, worst_moment
from replay.explain import accounts, sentences
from replay.results.load import DriveResult


@dataclass(frozen=True, eq=False)
class Subject:
    """A drive and the moment that is looked at.

    Attributes:
        drive: Of the results.
        moment: When to look, and why.
        trace: As driven; of the plans only the one that was the newest at the moment.
        scenario: Road, goal, vehicle, lights.
        said: What each plan says of itself.
    """

    drive: DriveResult
    moment: Moment
    trace: Trace
    scenario: Scenario
    said: tuple[Said, ...]

    @cached_property
    def violations(self) -> list[Violation]:
        """The gates that this drive broke, and when."""
        return violations(self.drive)

    @cached_property
    def because(self) -> tuple[str, ...]:
        """What the plan does at the moment, and why, in sentences; empty where there is none."""
        if self.frame is None:
            return ()
        earlier = [one.t for one in self.said if one.t < self.frame.t]
        (account,) = accounts(self.trace, self.scenario, self.drive.result.run.drive_loop, earlier)
        return (
            f"The plan of t = {account.t:.2f} s: {account.course.action.value}.",
            *map(self.scenario.short_names, sentences(account)),
        )

    @property
    def span(self) -> tuple[float, float]:
        """First and last time of the drive, s; never empty."""
        first, last = float(self.trace.ego.t[0]), float(self.trace.ego.t[-1])
        return first, max(last, first + 0.1)

    @property
    def frame(self) -> PlannedFrame | None:
        """The plan that was the newest at the moment; None: there was none yet."""
        return self.trace.frames[0] if self.trace.frames else None


def subject(drive: DriveResult, at: float | None = None) -> Subject:
    """A drive at a time, or at its worst moment.

    Raises:
        ConfigError: The drive was over by then, or had not begun.
        LogError: Its trace is damaged.
    """
    moment = worst_moment(drive) if at is None else Moment(at, "as asked")
    trace, scenario, said = read_moment(drive.trace_file, moment.t)
    begin, end = float(trace.ego.t[0]), float(trace.ego.t[-1])
    if not (isfinite(moment.t) and begin - 1e-9 <= moment.t <= end + 1e-9):
        raise ConfigError(
            f"{drive.log}, {drive.planner}, {drive.mode} loop: --at {moment.t:g} is not in its {begin:g} to {end:g} s"
        )
    return Subject(drive, moment, trace, scenario, said)
