"""Why two planners drive differently: which change of the input of one makes it plan what the other
planned (`replan diagnose RUN --against BASELINE`).

The drives of the run, the suspect's, are driven again in this process, and the planner of the
baseline, the reference, is asked at each of their frames what it would have planned, with the same
input:

(1) no plan differs: the planners decide the same, the cause is a setting of the loop
(2) a change of the input (`replan.experiments.input_search`), or two of them, makes the reference
    plan the same to the bit: the cause is the suspect's input, or its predictions
(3) a setting of the reference does so: the cause is a decision, and its setting
(4) none of them: the cause is a decision, and the first stage of planning that differs although the
    input is the same; nothing more is claimed

A change is claimed if the plans that it does not explain are at most `UNEXPLAINED` of those that
differ without it.
"""

from __future__ import annotations

import shlex
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf, isfinite, nan
from typing import Any

import pandas as pd

from replan.compare_runs import NOT_INPUTS
from replan.config import RunConfig, dump_run
from replan.core.errors import ConfigError, unknown_name
from replan.core.names import counted
from replan.core.settings import flat, merged, nested, strict
from replan.draw.drawn_results import DriveResult, Results
from replan.experiments.input_search import InputSearch, TriedInput
from replan.experiments.reference_planner import Change, Reference, SettingChange, WatchedDrive
from replan.explain.changed_frames import limits_that_fit
from replan.explain.first_difference import FirstDifference, first_difference
from replan.explain.input_changes import InputChange
from replan.logs.frame import PlannerContext
from replan.logs.plan import PlanStatus
from replan.logs.scenario import Scenario
from replan.logs.trace import PlannedFrame, Trace
from replan.planners.base import Planner
from replan.replay.parts import PLANNER
from replan.replay.planner_process.coordinates import built
from replan.replay.planner_process.planner_config import is_foreign, planner_part
from replan.run.frame_dump import SAME_TIME_S, scenario_driven, watched_drive

DIFFERING, EQUAL = 4, 2
"""Drives that are looked at: those that differ most, and some in which nothing differs."""
READ = 7
"""Logs of either kind among which they are chosen, the worst first."""
UNEXPLAINED = 0.1
"""Share of the plans that differ which a change need not explain."""
FINALISTS = 6
"""Changes that are tried on all frames."""
FIRSTS = 2
"""Changes that are tried as the first one of two, and of those that explain the places that were
looked at, but not all frames, those whose values are corrected.
"""
SAME_AS_BEST = 5
"""Changes that explain as much as the best one and are named."""
CAUSES = {
    "loop.prediction": "prediction",
    "prediction": "prediction",
    "loop.perception": "perception",
    "loop.sensor": "perception",
    "perception": "perception",
    "loop.plan_": "latency",
    "loop.traffic": "traffic",
    "traffic": "traffic",
    "log": "reading of logs",
}
"""What a setting beside the planner's is about, by how its key begins; others: control."""
BROKEN = (PlanStatus.REFUSED, PlanStatus.CORRECTED)
"""How a plan is driven that breaks the contract."""
MOST_NOTES = 2
"""Notes that are printed."""
FEW = 3
"""Second changes that are refined together with the first one."""


@dataclass(frozen=True, eq=False)
class Attribution:
    """Why the planners drive differently.

    Attributes:
        planners: The suspect's and the reference's name.
        cause: "input", "prediction", "decision", "control", joined by " and ", or "".
        best: The changes that explain the suspect's plans; None if none do.
        others: Changes that explain them as well: no frame of these drives separates them.
        fit: The values of a limit that fit as well, m; NaN if there is no limit.
        frames: Number of frames, and of those that differ without a change.
        logs: The logs that were looked at, those that differ first.
        stage: The first difference that is left, if no change explains it.
        command: Plans the frame that differs most with the change; "" without a change.
        settings: Settings beside the planner's that explain the difference: key and both values.
        notes: What else the user should know, one sentence each.
    """

    planners: tuple[str, str]
    cause: str
    period_s: float
    frames: tuple[int, int]
    logs: tuple[str, ...]
    best: TriedInput | None = None
    others: tuple[TriedInput, ...] = ()
    fit: tuple[float, float] = (nan, nan)
    stage: FirstDifference | None = None
    command: str = ""
    settings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def lines(self) -> list[str]:
        """The attribution in sentences: what breaks the contract, then the cause."""
        return [*self.notes, *self._cause_lines()]

    def _cause_lines(self) -> Iterator[str]:
        suspect, reference = self.planners
        total, differing = self.frames
        logs = counted(len(self.logs), "drive")
        if self.best is not None:
            acts = ", and as if ".join(
                change.sentence(self.period_s) for change in self.best.changes
            )
            yield f"Cause: {self.cause}. {suspect} plans as if {acts}.{self._interval()}"
            yield (
                f"  With this change {reference} plans the same to the bit in {self.best.same} of "
                f"{total} frames of {logs}; without it {differing} differ."
            )
            if self.others:
                names = "; ".join(" + ".join(map(str, tried.changes)) for tried in self.others)
                yield (
                    f"  Not separated by these frames: {names}. A log in which they differ would "
                    "decide."
                )
            if self.command:
                yield f"  One frame of it: {self.command}"
        elif self.settings:
            yield f"Cause: {self.cause}. {'; '.join(self.settings)}."
            yield f"  With the same input they plan the same in all {total} frames of {logs}."
        elif self.stage is not None:
            yield (
                f"Cause: {self.cause}. With the same input the planners differ first at "
                f"{self.stage.what} ({reference} -> {suspect})."
            )
            yield (
                f"  No change of the input that was tried explains it: {differing} of {total} "
                f"frames of {logs} differ."
            )
        else:
            yield (
                f"No cause found: with the same input both planners plan the same in all {total} "
                f"frames of {logs}."
            )

    def _interval(self) -> str:
        low, high = self.fit
        if f"{low:.2f}" == f"{high:.2f}" or not low < high:
            return ""
        upper = f"to {high:.2f} m" if isfinite(high) else "m on"
        return f" (Any limit from {low:.2f} {upper} fits.)"

    def document(self) -> dict[str, Any]:
        """The attribution as JSON types."""
        return {
            "cause": self.cause,
            "changes": [str(change) for change in self.best.changes] if self.best else [],
            "not_separated": [[str(change) for change in item.changes] for item in self.others],
            "equal_frames": self.best.same if self.best else self.frames[0] - self.frames[1],
            "frames": self.frames[0],
            "differing_frames": self.frames[1],
            "logs": list(self.logs),
            "stage": self.stage.stage if self.stage else None,
            "settings": list(self.settings),
            "said": self.lines(),
        }


@dataclass(frozen=True)
class Pair:
    """The drives of two runs that are compared: those of the suspect, and of the reference."""

    run: Results
    baseline: Results
    suspect: str
    reference: str
    mode: str

    @classmethod
    def of(cls, run: Results, baseline: Results, planner: str | None = None) -> Pair:
        """The planners of two runs that belong together; ConfigError if they are not clear, or the
        reference is a program.
        """
        suspect = planner or _only(run)
        if suspect not in run.run.planners:
            raise unknown_name("planner (in the run)", suspect, run.run.planners)
        same = suspect in baseline.run.planners
        reference = suspect if same else _only(baseline)
        if is_foreign(reference) or reference in PLANNER.oracles:
            raise ConfigError(
                f"planner '{reference}': only a Python planner that is no oracle can be asked what "
                "it would have planned"
            )
        modes = [mode for mode in ("closed", "open") if _drives(run, suspect, mode)]
        mode = next((m for m in modes if _drives(baseline, reference, m)), None)
        if mode is None:
            raise ConfigError(f"{run.path} and {baseline.path} have no drives in the same loop")
        return cls(run, baseline, suspect, reference, mode)

    def logs(self, chosen: Sequence[str]) -> tuple[list[str], list[str]]:
        """The logs with a drive in both runs: those that differ in a verdict or a metric, the worst
        first, and the others; ConfigError if there are none.
        """
        sides = []
        for results, planner in ((self.run, self.suspect), (self.baseline, self.reference)):
            digest = results.logs.set_index("log")["sha256"]
            sides.append({log: digest[log] for log in _drives(results, planner, self.mode)})
        common = [log for log, digest in sides[0].items() if sides[1].get(log) == digest]
        common = [log for log in common if not chosen or log in chosen]
        if not common:
            raise ConfigError(
                f"{self.run.path} and {self.baseline.path} have no log in common"
                + (f" that is named {', '.join(chosen)}" if chosen else "")
            )
        flips = self._different("verdicts", "gate", "outcome")
        values = self._different("metrics", "metric", "value")
        differing = [log for log in common if flips.get(log, 0) + values.get(log, 0)]
        differing.sort(key=lambda log: (-flips.get(log, 0), -values.get(log, 0), log))
        return differing, [log for log in common if log not in differing]

    @property
    def planner_settings(self) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
        """The settings of the reference, with all defaults, and those that the suspect has of the
        same keys, by dotted keys.
        """
        tables = []
        for results, planner in ((self.baseline, self.reference), (self.run, self.suspect)):
            table = results.run.planner.get(planner, {})
            foreign = is_foreign(planner)
            tables.append(table if foreign else planner_part(planner, table).resolved())
        own, other = (dict(flat(table)) for table in tables)
        return own, {key: value for key, value in other.items() if key in own}

    def build_reference(self, context: PlannerContext, settings: Mapping[str, Any]) -> Planner:
        """The reference planner, with changes of its settings."""
        table = merged(self.baseline.run.planner.get(self.reference, {}), settings)
        return built(planner_part(self.reference, table).configured(), context)

    def loop_settings(self) -> dict[str, tuple[Any, Any]]:
        """The settings beside the planners' in which the runs differ: those of the run and of the
        baseline.
        """
        tables = [
            dict(flat(tomllib.loads(dump_run(side.run)))) for side in (self.run, self.baseline)
        ]
        return {
            key: (tables[0].get(key), tables[1].get(key))
            for key in sorted({*tables[0], *tables[1]})
            if key.split(".")[0] not in (*NOT_INPUTS, "planner")
            and tables[0].get(key) != tables[1].get(key)
        }

    def _different(self, table: str, name: str, column: str) -> dict[str, int]:
        """The number of rows of a table that differ, by log."""
        sides = []
        for results, planner in ((self.run, self.suspect), (self.baseline, self.reference)):
            rows = getattr(results, table)
            rows = rows[(rows["planner"] == planner) & (rows["mode"] == self.mode)]
            sides.append(rows.set_index(["log", name])[column])
        columns = [side[~side.index.duplicated()] for side in sides]
        both = pd.DataFrame(dict(zip(("run", "baseline"), columns, strict=True)))
        missing = both["run"].isna() & both["baseline"].isna()
        same = (both["run"] == both["baseline"]) | missing
        return dict(both[~same].groupby("log").size())


def _drives(results: Results, planner: str, mode: str) -> list[str]:
    """The logs that a planner drove in a loop."""
    rows = results.drives
    return list(rows.loc[(rows["planner"] == planner) & (rows["mode"] == mode), "log"])


def _only(results: Results) -> str:
    """The only planner of a run."""
    planners = results.run.planners
    if len(planners) != 1:
        raise ConfigError(f"name the planner with --planner: {', '.join(planners)}")
    return planners[0]


def attribute(
    pair: Pair, logs: Sequence[str] = (), say: Callable[[str], None] = lambda line: None
) -> Attribution:
    """Why the suspect drives differently (module docstring).

    Args:
        pair: The runs and planners.
        logs: Names of logs to look at; empty: those that differ most, and some others.
        say: Gets a line of progress at each step.

    Raises:
        ConfigError: No log is in both runs, or a log was moved or changed.
        LogError: A log cannot be read.
        PlannerError: A planner cannot be loaded.
    """
    differing, equal = pair.logs(logs)
    scenarios = {
        log: scenario_driven(pair.run.drive(log, pair.suspect, pair.mode))
        for log in (*differing[:READ], *equal[:READ])
    }
    first = _varied(differing[:READ], scenarios, DIFFERING)
    chosen = (*first, *_varied(equal[:READ], scenarios, DIFFERING + EQUAL - len(first)))
    drives: list[WatchedDrive] = []
    traces: list[Trace] = []
    notes: list[str] = []
    for log in chosen:
        drive = pair.run.drive(log, pair.suspect, pair.mode)
        watch, again = watched_drive(drive, scenarios[log], pair.run.run, inf)
        notes += [*other_drive(log, drive, again.trace), *refusals(log, again.trace)]
        plans = tuple(plan.recorded(keep=True) for plan in watch.answers)
        context, frames = replace(watch.context, lap=_no_clock), tuple(watch.frames[: len(plans)])
        drives.append(WatchedDrive(log, context, frames, plans))
        traces.append(again.trace)
    say(f"{counted(len(drives), 'drive')} driven again, {len(differing)} of the run differ")
    search = InputSearch.of(Reference(pair.build_reference), drives)
    result = _Attributing(pair, search, tuple(traces), say).result()
    return replace(result, notes=tuple(notes[:MOST_NOTES]))


def other_drive(log: str, drive: DriveResult, again: Trace) -> list[str]:
    """That a drive does not end as in the results, in a sentence; empty if it does."""
    ended, t_s = drive.info["end"], float(drive.info["t_end_s"])
    if again.end.value == ended and abs(float(again.ego.t[-1]) - t_s) < SAME_TIME_S:
        return []
    return [
        f"Driven again, {log} ends otherwise than in the results ({again.end.value} at "
        f"{again.ego.t[-1]:.2f} s, {ended} at {t_s:.2f} s): the planner is not deterministic, or "
        "has changed."
    ]


def refusals(log: str, trace: Trace) -> list[str]:
    """The plans of a drive that break the contract of planners, in a sentence; empty without."""
    refused = [frame for frame in trace.frames if frame.plan.status in BROKEN]
    if not refused:
        return []
    first = refused[0]
    return [
        f"Contract: {len(refused)} of {len(trace.frames)} plans of {log} are refused or corrected, "
        f"first at {first.t:.2f} s: {first.plan.reason}."
    ]


def _varied(logs: Sequence[str], scenarios: Mapping[str, Scenario], most: int) -> list[str]:
    """At most `most` logs: one after the other the first that adds most kinds of road users, or
    traffic lights, to those before it.
    """
    chosen: list[str] = []
    shown: set[object] = set()
    while len(chosen) < min(most, len(logs)):
        new = {
            log: {*scenarios[log].tracks.kinds, bool(scenarios[log].lights)} - shown
            for log in logs
            if log not in chosen
        }
        chosen.append(max(new, key=lambda log: len(new[log])))
        shown |= new[chosen[-1]]
    return chosen


def _no_clock(stage: str) -> None:
    """Ignore the end of a stage."""


@dataclass(frozen=True, eq=False)
class _Attributing:
    """One attribution: the search, and the traces of its drives."""

    pair: Pair
    search: InputSearch
    traces: tuple[Trace, ...]
    say: Callable[[str], None]
    _singles: list[TriedInput] = field(default_factory=list)

    def result(self) -> Attribution:
        """Why the suspect drives differently."""
        drives = self.search.drives
        self.say(f"{self._differing} of {self._total} plans differ")
        nothing = Attribution(
            (self.pair.suspect, self.pair.reference),
            "",
            drives[0].context.period,
            (self._total, self._differing),
            tuple(drive.log for drive in drives),
        )
        if not self._differing:
            settings = self._loop_settings()
            causes = dict.fromkeys(_cause_of_setting(key) for key in settings)
            words = tuple(
                f"{key} is {own!r}, in the baseline {other!r}"
                for key, (own, other) in settings.items()
            )
            return replace(nothing, cause=" and ".join(causes), settings=words)
        later = (self._two_changes, self._settings)
        if self.search.is_input_same:
            later = later[::-1]
        for tries in (self._given_settings, self._one_change, *later):
            claimed = self._claimed(tries())
            if claimed:
                return self._explained(nothing, claimed)
        stage = self._first_stage()
        return replace(nothing, cause="decision" if stage else "", stage=stage)

    @property
    def _total(self) -> int:
        return sum(len(drive.plans) for drive in self.search.drives)

    @property
    def _differing(self) -> int:
        return sum(map(len, self.search.differing))

    def _explained(self, nothing: Attribution, claimed: Sequence[TriedInput]) -> Attribution:
        best = claimed[0]
        causes = dict.fromkeys(change.row.cause for change in best.changes)
        frames = [drive.frames for drive in self.search.drives]
        limits = [
            limits_that_fit(frames, change)
            for change in best.changes
            if isinstance(change, InputChange) and change.row.measure is not None
        ]
        return replace(
            nothing,
            cause=" and ".join(causes),
            best=best,
            others=tuple(claimed[1 : 1 + SAME_AS_BEST]),
            fit=limits[0] if limits else (nan, nan),
            command=self._command(best.changes),
        )

    def _command(self, changes: Sequence[Change]) -> str:
        """Plans the frame that differs most with changes of the input."""
        pair, places = self.pair, self.search.places
        is_input = all(isinstance(change, InputChange) for change in changes)
        has_defaults = pair.planner_settings[0] == dict(
            flat(planner_part(pair.reference).resolved())
        )
        if not (is_input and places and has_defaults):  # frame builds it with its defaults
            return ""
        row, number = places[0]
        drive = self.search.drives[row]
        words = ["replan", "frame", str(pair.run.path), drive.log, "--planner", pair.suspect]
        words += ["--mode", pair.mode, "--at", f"{drive.frames[number].t:.2f}"]
        for change in changes:
            words += ["--change", str(change)]
        return shlex.join([*words, "--with", pair.reference])

    def _claimed(self, finalists: Sequence[Sequence[Change]]) -> list[TriedInput]:
        """Those that explain enough, the best first, and others only if they explain as much."""
        claimed: list[TriedInput] = []
        misses: float = UNEXPLAINED * self._differing
        corrections = FIRSTS
        for changes in finalists:
            tried = self.search.everywhere(changes, misses)
            if len(tried.missed) > misses and corrections and self.search.at(changes).is_exact:
                corrections -= 1
                tried = self.search.everywhere(self.search.corrected(tried), misses)
            if len(tried.missed) <= misses:
                misses = len(tried.missed)
                claimed.append(tried)
        best = [tried for tried in claimed if len(tried.missed) <= misses]
        best.sort(key=lambda tried: tried.order)
        names = [{(change.row.words, change.kinds) for change in item.changes} for item in best]
        return [item for i, item in enumerate(best) if names[i] not in names[:i]]

    def _loop_settings(self) -> dict[str, tuple[Any, Any]]:
        """The settings of the loop in which the runs differ; only the one, if one alone makes the
        first drive that differs the baseline's.
        """
        pair, differing = self.pair, self.pair.loop_settings()
        log = self.search.drives[0].log
        drive = pair.run.drive(log, pair.suspect, pair.mode)
        wanted = pair.baseline.drive(log, pair.reference, pair.mode).trace.ego
        scenario, table = scenario_driven(drive), tomllib.loads(dump_run(pair.run.run))
        for key, (_, other) in differing.items():
            section, _, rest = key.partition(".")
            values = {name: value for name, value in flat(table[section]) if name != rest}
            values |= {} if other is None else {rest: other}
            run = strict(RunConfig, {**table, section: nested(values)})
            ego = watched_drive(drive, scenario, run, inf)[1].trace.ego
            if len(ego.t) == len(wanted.t) and (ego.x == wanted.x).all():
                return {key: differing[key]}
        return differing

    def _given_settings(self) -> list[tuple[Change, ...]]:
        """The settings of the planner in which the runs differ, each alone."""
        own, other = self.pair.planner_settings
        numbers = {key: value for key, value in own.items() if _is_number(value)}
        return [
            (SettingChange(key, other[key], value),)
            for key, value in numbers.items()
            if _is_number(other.get(key)) and other[key] != value
        ]

    def _one_change(self) -> list[tuple[Change, ...]]:
        """One change of the input."""
        self._singles.extend(self.search.nearer(self.search.inputs()))
        return self.search.finalists(1, FINALISTS)

    def _two_changes(self) -> list[tuple[Change, ...]]:
        """Two changes of the input."""
        self.say("no single change explains them; two changes are tried")
        best_of_row: dict[str, TriedInput] = {}
        for tried in self._singles:
            best_of_row.setdefault(tried.changes[0].row.words, tried)
        firsts = [tried.changes for tried in list(best_of_row.values())[:FIRSTS]]
        firsts.append((InputChange("no previous plan"),))
        for first in dict.fromkeys(firsts):
            for tried in self.search.nearer(self.search.inputs(), first)[:FEW]:
                again = self.search.tried_anew(tried.changes, 0)
                self.search.refined(again.changes, 1)
        return self.search.finalists(2, FINALISTS)

    def _settings(self) -> list[tuple[Change, ...]]:
        """One setting of the reference, which may be hidden in the suspect."""
        self.say("no change of the input explains them; settings are tried")
        own, _ = self.pair.planner_settings
        numbers = [SettingChange(k, v, v) for k, v in own.items() if _is_number(v)]
        self.search.nearer(numbers, glance=1)
        return self.search.finalists(1, FINALISTS, SettingChange)

    def _first_stage(self) -> FirstDifference | None:
        """The first difference of the plans of the first drive with one."""
        for row, drive in enumerate(self.search.drives):
            if not self.search.differing[row]:
                continue
            trace, number = self.traces[row], self.search.differing[row][0]
            sides = []
            for plans in (self.search.reference.plans(drive, (), keep=True), drive.plans):
                frames = [
                    PlannedFrame.of(frame, plan)
                    for frame, plan in zip(drive.frames, plans, strict=True)
                    if plan is not None and frame.t >= drive.frames[number].t
                ]
                sides.append(replace(trace, frames=tuple(frames), commands=None))
            return first_difference(*sides)
        return None


def _cause_of_setting(key: str) -> str:
    """What a setting beside the planner's is about."""
    return next((cause for begin, cause in CAUSES.items() if key.startswith(begin)), "control")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
