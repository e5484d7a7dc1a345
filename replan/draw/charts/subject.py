"""The subject of a drive's pictures: its tables, its trace, one moment in it, and the times at
which it broke gates.

Other drives of the same log may be shown beside it, at the same moment.

The moment and the broken gates are found in the tables of the run, without its trace.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf, isfinite, isnan
from typing import Any

import numpy as np

from replan.core.errors import ConfigError
from replan.draw.drawn_scene import decided
from replan.explain import Explanation, accounts
from replan.logs.mcap import read_moment, read_scenario
from replan.logs.plan import DecisionKind, PlanSummary
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.trace import Mode, PlannedFrame, Trace
from replan.metrics import GROUPS, METRICS
from replan.metrics.judge.gates import Outcome
from replan.results.load import StoredDrive

GRAVE = ("collision_at_fault", "safety", "rules", "progress")
"""Metrics and groups of metrics, the gravest first: their failed gates come before all others."""
NEAREST = (
    ("ttc.min", "least time to a collision"),
    ("gap.min", "least distance to another road user"),
)
"""Metrics that give the moment if no gate failed at a known time."""
MOST = 4  # Most drives in one picture: the eye does not tell more lines apart (`style.DRIVES`)
ASKED = "as asked"  # The reason for a moment that was asked for
NAMES: tuple[Callable[[StoredDrive], str], ...] = (
    lambda drive: drive.planner.rpartition(":")[2],
    lambda drive: drive.planner,
    lambda drive: f"{drive.planner} ({drive.mode})",
    lambda drive: f"{drive.result.path.name}: {drive.planner} ({drive.mode})",
)
"""Names of drives in legends: of these, the first that tells them apart."""
_GROUP = {metric.name: name for name, group in GROUPS.items() for metric in group}


@dataclass(frozen=True)
class Moment:
    """A time in a drive, s, and the reason to look at it, in a sentence."""

    t: float
    why: str
    about: str = ""  # What the reason is about ("car 12"); "" if it is not known


@dataclass(frozen=True, eq=False)
class Violation:
    """A gate that a drive broke."""

    gate: str
    series: str  # The series of its metric ("lon_accel")
    # Intervals in which its steps are out of bounds, s; without steps, the time of its value
    spans: tuple[tuple[float, float], ...]


def worst_moment(drive: StoredDrive) -> Moment:
    """The time of the worst failed gate, otherwise of the least TTC or gap, otherwise the middle of
    the drive.

    Gates of safety and rules are worse than others; among equals, the first in the file of gates.
    """
    failed = drive.verdicts[drive.verdicts["outcome"] == Outcome.FAIL.value]
    rows = [row for row in list[Any](failed.itertuples()) if isfinite(row.time_s)]
    if rows:
        worst = min(rows, key=lambda row: gravity(row.metric))
        about = f" ({worst.reason})" if worst.reason else ""
        why = f"{worst.gate} fails: {worst.value:.4g}{about}"
        return Moment(float(worst.time_s), why, str(worst.reason or ""))
    failure = "a gate fails, at no instant; " if len(failed) else "no gate of this loop fails; "
    timed = {
        row.metric: row
        for row in list[Any](drive.metrics.itertuples())
        if row.available and isfinite(row.time_s)
    }
    for name, words in NEAREST:
        if name in timed:
            near = timed[name]
            about = f" ({near.reason})" if near.reason else ""
            why = f"{failure}{words}: {near.value:.3g} {near.unit}{about}"
            return Moment(float(near.time_s), why, str(near.reason or ""))
    middle = 0.5 * float(drive.info["t_end_s"])
    return Moment(middle, f"{failure}no distance to others was measured: the middle of the drive")


def gravity(row: str) -> int:
    """The place of a gate in `GRAVE`, by the metric of the row that it judges, otherwise by the
    group of the metric.
    """
    metric = row.partition(".")[0]
    return next(
        (i for i, word in enumerate(GRAVE) if word in (metric, _GROUP.get(metric, ""))), len(GRAVE)
    )


def violations(drive: StoredDrive) -> list[Violation]:
    """The failed gates of a drive, and the times at which it broke them."""
    broken = list[Violation]()
    failed = drive.verdicts[drive.verdicts["outcome"] == Outcome.FAIL.value]
    for row in list[Any](failed.itertuples()):
        series, _, reduction = row.metric.rpartition(".")
        t, values = drive.steps(series)
        known = np.isfinite(values)
        t, values = t[known], values[known]
        # the bounds that steps break: those of the reduction, otherwise those of the rule; infinite
        # if there are none
        metric = METRICS.get(series.partition(".")[0])
        reductions = {item.name: item for item in metric.reductions} if metric else {}
        bounds = reductions[reduction].bounds if reduction in reductions else None
        low, high = -inf, inf
        if bounds is not None:
            low, high = bounds
        elif reduction in ("count", "rate"):
            high = 0.0
        elif reduction in ("min", "max", "max_abs"):
            low, high = -inf if isnan(row.low) else row.low, inf if isnan(row.high) else row.high
            low = -high if reduction == "max_abs" else low
        edge = np.diff(np.r_[False, (values < low) | (values > high), False].astype(np.int64))
        stretches = zip(np.flatnonzero(edge > 0), np.flatnonzero(edge < 0), strict=True)
        spans = tuple((float(t[first]), float(t[end - 1])) for first, end in stretches)
        if not spans and isfinite(row.time_s):
            spans = ((float(row.time_s), float(row.time_s)),)
        broken.append(Violation(str(row.gate), series, spans))
    return broken


@dataclass(frozen=True, eq=False)
class SceneSubject:
    """What a scene shows: a trace at a moment.

    Attributes:
        moment: The time to look at, and the reason.
        trace: The trace, with only the newest plan at the moment.
    """

    moment: Moment
    trace: Trace
    scenario: Scenario

    @property
    def drives(self) -> Mapping[str, SceneSubject]:
        """All drives in the scene by their names in legends: this one."""
        return {"": self}

    @property
    def named_agents(self) -> frozenset[str]:
        """The agents that the reason of the moment is about, and those with a decision."""
        agents, short = self.trace.agents.truth(self.moment.t), self.scenario.short_names
        words = {
            name: f"{kind.value} {short(name)}"
            for name, kind in zip(agents.ids, agents.kinds, strict=True)
        }
        about = f"{self.moment.about}:"
        named = {name for name, word in words.items() if about.startswith(f"{word}:")}
        decisions = {} if self.frame is None else decided(self.frame.plan)
        ignored = DecisionKind.IGNORE
        return frozenset(named | {name for name, x in decisions.items() if x.kind is not ignored})

    @property
    def frame(self) -> PlannedFrame | None:
        """The newest plan at the moment; None if there is no plan yet."""
        return self.trace.frames[0] if self.trace.frames else None


@dataclass(frozen=True, eq=False)
class Subject(SceneSubject):
    """A drive and the moment to look at.

    Attributes:
        plans: The summaries of all plans.
        beside: Other drives of the log at this moment, or at their end if it was earlier.
    """

    drive: StoredDrive
    plans: tuple[PlanSummary, ...]
    beside: tuple[Subject, ...] = ()

    @cached_property
    def drives(self) -> Mapping[str, Subject]:
        """All drives by their names in legends: the planner, and loop and run where these
        differ.
        """
        subjects = (self, *self.beside)
        for name in NAMES:
            named = {name(subject.drive): subject for subject in subjects}
            if len(named) == len(subjects):
                break
        return named

    @property
    def title(self) -> str:
        """Log, planners and loop in words."""
        if not self.beside:
            return self.drive.title
        modes = {subject.drive.mode for subject in self.beside}
        loop = f", {self.drive.mode} loop" if modes == {self.drive.mode} else ""
        return f"{self.drive.log}, {', '.join(self.drives)}{loop}"

    @property
    def says(self) -> str:
        """The moment, and the reason to look at it if it was not asked for."""
        return f"at {self.moment.t:.2f} s" + (
            "" if self.moment.why == ASKED else f": {self.moment.why}"
        )

    @cached_property
    def logged(self) -> Trajectory | None:
        """The log's own drive, which the traces of the open loop have; None without one."""
        run = self.drive.result
        is_open = (run.drives["log"] == self.drive.log) & (run.drives["mode"] == Mode.OPEN.value)
        files = (
            StoredDrive(run, self.drive.log, planner, Mode.OPEN.value).trace_file
            for planner in run.drives.loc[is_open, "planner"]
        )
        trace = next((file for file in files if file.is_file()), None)
        return None if trace is None else read_scenario(trace).ego

    @cached_property
    def violations(self) -> list[Violation]:
        """The gates that this drive broke, and the times at which it broke them."""
        return violations(self.drive)

    @cached_property
    def because(self) -> tuple[str, ...]:
        """The action of the plan at the moment, and its causes, in sentences.

        Empty if there is no plan.
        """
        if self.frame is None:
            return ()
        earlier = [plan.t for plan in self.plans if plan.t < self.frame.t]
        (account,) = accounts(self.trace, self.scenario, self.drive.result.run.drive_loop, earlier)
        plan = Explanation.of(self.frame, account, bounds=False)
        return (
            f"The plan at t = {plan.t:.2f} s: {plan.does}.",
            *map(self.scenario.short_names, plan.because),
        )

    @property
    def span(self) -> tuple[float, float]:
        """First and last time of the drive, s; never empty."""
        first, last = float(self.trace.ego.t[0]), float(self.trace.ego.t[-1])
        return first, max(last, first + 0.1)


def subject(
    drive: StoredDrive, at: float | None = None, beside: Sequence[StoredDrive] = ()
) -> Subject:
    """A drive at a time, or at its worst moment, and other drives of the same log beside it.

    ConfigError if `at` is outside the time span of the drive; a drive is of another log or given
    twice, or there are too many. LogError if a trace is damaged.
    """
    moment = worst_moment(drive) if at is None else Moment(at, ASKED)
    trace, scenario, plans = read_moment(drive.trace_file, moment.t)
    begin, end = float(trace.ego.t[0]), float(trace.ego.t[-1])
    if not (isfinite(moment.t) and begin - 1e-9 <= moment.t <= end + 1e-9):
        raise ConfigError(
            f"{drive.log}, {drive.planner}, {drive.mode} loop: --at {moment.t:g} is not in its "
            f"{begin:g} to {end:g} s"
        )
    for other in beside:
        if other.log != drive.log:
            raise ConfigError(
                f"{other.title}: one picture is of one log, and the first is of {drive.log}"
            )
    if len(beside) >= MOST:
        raise ConfigError(f"one picture shows at most {MOST} drives, got {1 + len(beside)}")
    others = (subject(other, min(moment.t, float(other.info["t_end_s"]))) for other in beside)
    seen = Subject(moment, trace, scenario, drive, plans, tuple(others))
    if len(seen.drives) <= len(beside):
        raise ConfigError(f"{drive.title}: the same drive is given twice")
    return seen
