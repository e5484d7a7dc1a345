"""The subject of a drive's pictures: its tables, its trace, and one moment in it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import isfinite

from logs.errors import ConfigError
from logs.mcap import read_moment
from logs.scenario import Scenario
from logs.trace import PlannedFrame, PlanSummary, Trace
from replay.draw.charts.moment import Moment, Violation, violations, worst_moment
from replay.explain import Explanation, accounts
from replay.results.load import DriveResult


@dataclass(frozen=True, eq=False)
class Subject:
    """A drive and the moment to look at.

    Attributes:
        drive: The drive in the results.
        moment: When to look, and why.
        trace: The trace; of the plans only the newest one at the moment.
        scenario: Road, goal, vehicle, lights.
        plans: The summaries of all plans.
    """

    drive: DriveResult
    moment: Moment
    trace: Trace
    scenario: Scenario
    plans: tuple[PlanSummary, ...]

    @cached_property
    def violations(self) -> list[Violation]:
        """The gates that this drive broke, and when."""
        return violations(self.drive)

    @cached_property
    def because(self) -> tuple[str, ...]:
        """What the plan does at the moment, and why, in sentences; empty if there is no plan."""
        if self.frame is None:
            return ()
        earlier = [one.t for one in self.plans if one.t < self.frame.t]
        (account,) = accounts(self.trace, self.scenario, self.drive.result.run.drive_loop, earlier)
        plan = Explanation.of(self.frame, account, bounds=False)
        return (f"The plan at t = {plan.t:.2f} s: {plan.does}.", *map(self.scenario.short_names, plan.because))

    @property
    def span(self) -> tuple[float, float]:
        """First and last time of the drive, s; never empty."""
        first, last = float(self.trace.ego.t[0]), float(self.trace.ego.t[-1])
        return first, max(last, first + 0.1)

    @property
    def frame(self) -> PlannedFrame | None:
        """The newest plan at the moment; None: there was none yet."""
        return self.trace.frames[0] if self.trace.frames else None


def subject(drive: DriveResult, at: float | None = None) -> Subject:
    """A drive at a time, or at its worst moment.

    Raises:
        ConfigError: The drive was over by then, or had not begun.
        LogError: Its trace is damaged.
    """
    moment = worst_moment(drive) if at is None else Moment(at, "as asked")
    trace, scenario, plans = read_moment(drive.trace_file, moment.t)
    begin, end = float(trace.ego.t[0]), float(trace.ego.t[-1])
    if not (isfinite(moment.t) and begin - 1e-9 <= moment.t <= end + 1e-9):
        raise ConfigError(
            f"{drive.log}, {drive.planner}, {drive.mode} loop: --at {moment.t:g} is not in its {begin:g} to {end:g} s"
        )
    return Subject(drive, moment, trace, scenario, plans)
