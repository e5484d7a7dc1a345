"""A diagnosis: the failing drives of a run, driven again with one change.

    OUT/logs/                 the logs of the failing drives
    OUT/changes/NAME/         results with a change, as `replan compare` and `replan view` take
                              them; first "as_it_was"
    OUT/study.jsonl           the drives; `--resume` continues from it

and the files of `replan.experiments.findings`. The same run gives the same diagnosis at any number
of workers.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from math import inf, isfinite, nan
from pathlib import Path
from typing import Any

import numpy as np

from replan.config import RunConfig
from replan.core.errors import ConfigError, LogError, unknown_name
from replan.core.names import counted
from replan.draw.drawn_results import DriveResult, Results, load
from replan.experiments.changes import ChangedRun, TriedChange, cause_of, changed_runs, driven
from replan.experiments.drives import (
    DrivenLogs,
    as_driven,
    cut_short,
    drive_again,
    failed_gates,
    parting,
    passes,
    still_failing,
    worse_peak,
)
from replan.experiments.failure import (
    AHEAD_S,
    FORCED_MPS2,
    PROGRESS,
    REACTIONS,
    DriveDifference,
    DriveFailure,
    Foresight,
    GoalMiss,
    Wait,
    lane_change,
    waits,
)
from replan.experiments.findings import AS_IT_WAS, Diagnosis, Found
from replan.experiments.remedy import Remedy, smallest_change
from replan.experiments.space import Setting, Value, shown, with_values
from replan.experiments.trial import MODE, scratch_folder
from replan.explain.causes import accounts
from replan.explain.explanation import Explanation
from replan.logs.agents import AgentKind
from replan.logs.mcap import write_scenario
from replan.logs.scenario import Scenario
from replan.logs.trace import Mode, PlannedFrame
from replan.metrics.cut_in import made_way, unseen
from replan.metrics.route_gain import RoutePace
from replan.results.load import named_logs
from replan.run.claim import FolderContents, claimed_folder
from replan.run.ensemble import PERTURBATIONS, perturbed
from replan.run.output import scenario_of
from replan.run.resume import Study, study_head

KIND = "diagnose"
CONTENTS = FolderContents(KIND, ("diagnosis.*", "changes.csv", "changes", "logs"))
CONTROLS = ("tiny", "start", "noise")
"""Perturbations (`replan.run.ensemble`) with which a drive must also fail, so that a change is
conclusive.
"""


@dataclass(frozen=True, eq=False)
class DiagnosisQuestion:
    """The inputs of a diagnosis.

    Attributes:
        planner: The planner whose failing drives are diagnosed.
        logs: Names of logs; empty for all logs.
    """

    results: Results
    planner: str
    logs: tuple[str, ...]
    changes: tuple[TriedChange, ...]

    @property
    def run(self) -> RunConfig:
        """The run without a change."""
        return driven(self.results.run, self.planner)

    def failing(self, mode: str = MODE) -> Mapping[str, tuple[str, ...]]:
        """The logs whose drives fail gates in a loop, sorted, and these gates."""
        rows = self.results.verdicts
        mine = rows[
            (rows["planner"] == self.planner) & (rows["mode"] == mode) & (rows["outcome"] == "fail")
        ]
        gates = mine.groupby("log")["gate"].agg(tuple)
        return {
            str(log): gates[log] for log in sorted(gates.index) if not self.logs or log in self.logs
        }

    def head(self) -> dict[str, Any]:
        """The inputs that identify a diagnosis."""
        logs = self.results.logs[self.results.logs["log"].isin(self.failing())]
        inputs = {
            "planner": self.planner,
            "logs": sorted(zip(logs["log"], logs["sha256"], strict=True)),
            "changes": [asdict(change) for change in self.changes],
        }
        return study_head(KIND, self.run, inputs)


def question(
    results: Results, planner: str | None, logs: Sequence[str], changes: Sequence[TriedChange]
) -> DiagnosisQuestion:
    """The question, checked.

    Raises:
        ConfigError: There is no such planner or log in the run, the run has several planners and
            none is named, or it has no closed loop.
    """
    run = results.run
    if planner is None and len(run.planners) > 1:
        raise ConfigError(f"name the planner with --planner: {', '.join(run.planners)}")
    planner = planner or run.planners[0]
    if planner not in run.planners:
        raise unknown_name("planner (in the run)", planner, run.planners)
    if run.mode == "open":
        raise ConfigError(f"{results.path}: has no closed loop; only closed loops are diagnosed")
    named = dict.fromkeys(log for name in logs for log in named_logs(name, results.logs["log"]))
    return DiagnosisQuestion(results, planner, tuple(named), tuple(changes))


def diagnose(
    asked: DiagnosisQuestion,
    out: Path | None,
    settings: Sequence[Setting] = (),
    *,
    workers: int = 0,
    resume: bool = False,
    say: Callable[[str], None] = lambda line: None,
) -> Diagnosis:
    """Drive the failing drives of a run again with each change, and write the findings into `out`.

    `Diagnosis.not_driven` has the drives that cannot be driven again. For the first drive of each
    cluster, the smallest change of one of the `settings` with which it passes is searched. The
    other arguments are those of `replan.experiments`.

    Raises:
        ConfigError: The folder must not be written, or there is nothing to resume.
        PlannerError: The planner cannot be loaded.
    """
    runs, refused = changed_runs(asked.changes, asked.run)
    with claimed_folder(out, CONTENTS, resume=resume) as out:
        trials = _DiagnosisDrives(asked, out, Study(out, asked.head(), resume=resume), workers)
        lost = (
            f", {len(trials.not_driven)} more cannot be driven again" if trials.not_driven else ""
        )
        failing = trials.failing
        say(
            f"{counted(len(failing), 'failing drive')} of {asked.planner}{lost}, "
            f"{counted(len(runs), 'change')}"
        )
        for k, run in enumerate(runs if failing else ()):
            passing = sum(one["passes"] for one in trials.drive(run).values())
            say(f"{k + 1} of {len(runs)}: {run.change.name}: {passing} of {len(failing)} pass")
        gone = tuple(name for name in trials.files if name not in {*failing, *trials.not_driven})
        result = Diagnosis(
            out,
            asked.results.path,
            asked.planner,
            tuple(trials.found(name, runs) for name in failing),
            gone,
            trials.not_driven,
            runs,
            refused,
            trials.answers,
            open_loop=asked.failing(Mode.OPEN.value),
        )
        if settings:
            first = [some[0].log for some in result.clusters() if not some[0].cause.fragile]
            result = replace(
                result, remedies=tuple(trials.remedy(log, settings, say) for log in first)
            )
        result.write()
    return result


class _DiagnosisDrives:
    """The drives of a diagnosis, change by change; drives in the study file are not repeated."""

    def __init__(self, asked: DiagnosisQuestion, out: Path, study: Study, workers: int) -> None:
        self._asked, self._out, self._study, self._workers = asked, out, study, workers
        self._drives: dict[str, DriveResult] = {}
        self._logs = asked.results.logs.set_index("log")
        self.files = {name: self._file(name) for name in asked.failing()}
        if study.known(AS_IT_WAS) is None and self.files:
            lost: dict[str, dict[str, Any]] = {}
            (out / "logs").mkdir(exist_ok=True)
            for name, file in self.files.items():
                try:
                    scenario = self._scenario(name)
                except (ConfigError, LogError) as error:  # it was moved, or is damaged
                    lost[name] = {"gates": [], "lost": str(error)}
                    continue
                write_scenario(file, scenario)
                for control in CONTROLS:
                    member = list(PERTURBATIONS).index(control) + 1
                    write_scenario(_control(file, control), perturbed(scenario, member)[1])
            rows = {name: lost.get(name) or self._base_row(name) for name in self.files}
            study.add([{"key": AS_IT_WAS, "drives": rows}])
        self._base_rows: dict[str, Any] = (study.known(AS_IT_WAS) or {"drives": {}})["drives"]
        self.failing = [name for name, row in self._base_rows.items() if row["gates"]]
        self.not_driven = {
            name: row["lost"] for name, row in self._base_rows.items() if "lost" in row
        }
        self.answers: dict[str, dict[str, Any]] = {}

    def _file(self, name: str) -> Path:
        """The path of a written log, by its folder, which is unique.

        Names without special characters are not.
        """
        return self._out / "logs" / f"{self._logs['folder'].astype(str)[name]}.mcap"

    def _scenario(self, name: str) -> Scenario:
        results = self._asked.results
        return scenario_of(results.path, self._logs.loc[name].to_dict(), results.run.log)

    @cached_property
    def _base(self) -> DrivenLogs:
        """The drives without a change, and with perturbations that should change nothing."""
        place, planner = self._out / "changes" / AS_IT_WAS, self._asked.planner
        if self._study.known(AS_IT_WAS) is not None:
            return as_driven(load(place), planner)
        written = [file for file in self.files.values() if file.is_file()]
        files = [
            each
            for file in written
            for each in (file, *(_control(file, name) for name in CONTROLS))
        ]
        return drive_again(files, self._asked.run, planner, place, workers=self._workers)

    def _base_row(self, name: str) -> dict[str, Any]:
        made, file = self._base, self.files[name]
        rows = made.of(file)
        gates = failed_gates(rows)
        if rows.empty or file.name not in made.driven:
            return {"gates": [], "lost": made.ended(file)}
        if not gates:
            return {"gates": []}
        first, gate = rows[rows["gate"] == gates[0]].iloc[0], made.gates[gates[0]]
        time, beyond = float(first["time_s"]), -gate.margin(float(first["value"]))
        row = {
            "gates": list(gates),
            "metric": gate.metric,
            "about": made.about(file, gate.metric),
            "time_s": time if isfinite(time) else None,
            "beyond": beyond if isfinite(beyond) else None,
            "end": made.ended(file),
            "lasted": made.lasted(file),
            "avoidable": made.avoidable(file),
            "peaks": made.peaks(file, gates),
        }
        row["fragile"] = [
            one
            for one in CONTROLS
            for control in [_control(file, one)]
            if passes(gates, made.of(control)) and not _is_cut(row, made, control)
        ]
        return row

    def _drive_of(self, name: str) -> DriveResult:
        """The drive without a change; its trace is read once."""
        if name not in self._drives:
            self._drives[name] = self._base.drive(self.files[name])
        return self._drives[name]

    def drive(self, run: ChangedRun) -> dict[str, Any]:
        """Drive the failing drives with a change, and return the results by log, which are also
        kept in `answers`.
        """
        row = self._study.row(run.change.name, lambda: {"drives": self._drive_failing(run)})
        self.answers[run.change.name] = row["drives"]
        return self.answers[run.change.name]

    def _drive_failing(self, run: ChangedRun) -> dict[str, dict[str, Any]]:
        files, place = (
            [self.files[name] for name in self.failing],
            self._out / "changes" / run.change.name,
        )
        made = drive_again(files, run.run, self._asked.planner, place, workers=self._workers)
        answers: dict[str, dict[str, Any]] = {}
        for name, file in zip(self.failing, files, strict=True):
            against = self._against(name, made)
            answers[name] = {"passes": against == "", "gates": list(failed_gates(made.of(file)))}
            answers[name].update(against=against or "", end=made.ended(file), parts={})
            if answers[name]["passes"]:
                was, now, until = (
                    self._drive_of(name),
                    made.drive(file),
                    self._base_rows[name]["time_s"],
                )
                difference = DriveDifference.of(
                    was.trace, now.trace, inf if until is None else until
                )
                answers[name].update(parts=parting(was, now), difference=asdict(difference))
                if self._base_rows[name]["metric"].partition(".")[0] in PROGRESS:
                    answers[name]["pace"] = asdict(RoutePace.of(now.trace.ego, now.scenario))
        return answers

    def _against(self, name: str, made: DrivenLogs) -> str | None:
        """Why a drive is not mended by a change with which it fails none of its gates; "" if it is;
        else None.
        """
        base, file = self._base_rows[name], self.files[name]
        rows, who = made.of(file), base["about"].partition(" ")[2]
        if still_failing(base["gates"], rows):
            return None
        if _is_cut(base, made, file):
            return f"{made.ended(file)} at {made.lasted(file):.1f} s"
        if others := failed_gates(rows):
            return f"fails {others[0]}"
        if peak := worse_peak(base["peaks"], made.peaks(file, base["gates"], base["lasted"])):
            return f"{peak} is worse"
        was, now, until = self._drive_of(name), made.drive(file), base["time_s"] or base["lasted"]
        they, way = (
            was.scenario.short_names(base["about"]),
            made_way(was.trace, now.trace, who, until),
        )
        if way > FORCED_MPS2:
            return f"{they} brakes by {way:.1f} m/s² more"
        reacts = base["metric"].partition(".")[0] in REACTIONS
        mute = reacts and unseen(was.trace, now.trace, self._scenario(name).tracks, who, until)
        return f"{they} reacts to nothing" if mute else ""

    def _mended(self, name: str, made: DrivenLogs) -> bool:
        """Whether a failing drive passes with a change."""
        return self._against(name, made) == ""

    def found(self, name: str, runs: Sequence[ChangedRun]) -> Found:
        """The findings of all changes about a drive."""
        base, drive = self._base_rows[name], self._drive_of(name)
        answers = {run.change.name: self.answers[run.change.name][name] for run in runs}
        passing = tuple(change for change, answer in answers.items() if answer["passes"])
        almost = {
            change: str(answer["against"])
            for change, answer in answers.items()
            if answer["against"]
        }
        cause = cause_of(
            runs, passing, base["fragile"], avoidable=base["avoidable"] or bool(almost)
        )
        shows = answers[cause.changes[0]] if cause.changes else {"parts": {}}
        difference, parts = DriveDifference(**shows.get("difference", {})), shows["parts"]
        time, beyond = (nan if base[key] is None else base[key] for key in ("time_s", "beyond"))

        frames, last = drive.trace.frames, float(drive.trace.ego.t[-1])
        explained = list(accounts(drive.trace, drive.scenario, drive.result.run.drive_loop))
        at = parts.get("t_s", time)
        k = _frame_at(frames, at)
        because = (
            Explanation.of(frames[k], explained[k], bounds=False).because
            if frames and isfinite(at)
            else ()
        )
        late = base["metric"].partition(".")[0] in PROGRESS
        kind, _, agent = base["about"].partition(" ")
        known = kind in {one.value for one in AgentKind} and agent in drive.trace.agents.ids
        begun = (
            None
            if difference.brakes_s is None or not frames
            else explained[_frame_at(frames, difference.brakes_s)]
        )
        fails = time if isfinite(time) else last
        seen = (
            max(fails - AHEAD_S, frames[0].t if frames else 0.0)
            if difference.would_brake_s is None
            else difference.would_brake_s
        )
        failure = DriveFailure(
            base["gates"][0],
            base["metric"],
            drive.scenario.short_names(base["about"]) if known else "",
            lane_change(drive.trace, fails),
            difference,
            begun is not None and any(one.who == agent for one in begun.causes),
            Foresight.of(drive.trace, agent, seen) if known else Foresight(),
            GoalMiss.of(drive.trace, drive.scenario) if late else None,
        )
        first = drive.scenario.short_names(because[0]) if because else ""
        slow: list[Wait] = []
        pace = (
            RoutePace(**shows["pace"])
            if "pace" in shows
            else RoutePace.needed(drive.scenario)
            if late
            else None
        )
        if pace is not None:
            lost, wanted = pace.lost(drive.trace.ego, drive.scenario, [frame.t for frame in frames])
            loop = drive.result.run.drive_loop
            slow = waits(
                list(accounts(drive.trace, drive.scenario, loop, wanted=wanted)), lost.tolist()
            )
        slow = [replace(one, who=drive.scenario.short_names(one.who)) for one in slow]
        return Found(
            name,
            tuple(base["gates"]),
            time,
            beyond,
            cause,
            failure,
            parts,
            first,
            passing,
            tuple(slow),
            almost,
        )

    def remedy(self, name: str, settings: Sequence[Setting], say: Callable[[str], None]) -> Remedy:
        """The smallest change of a setting with which a drive passes, and its effect on the other
        drives.
        """
        file = self.files[name]

        def drives(setting: Setting, value: Value, files: Sequence[Path]) -> DrivenLogs:
            shutil.rmtree(scratch, ignore_errors=True)
            run = with_values(self._asked.run, {setting.path: value})
            return drive_again(files, run, self._asked.planner, scratch, workers=self._workers)

        def mends(setting: Setting, value: Value) -> bool:
            key = f"{name}: {setting.key} = {value!r}"
            row = self._study.row(
                key, lambda: {"passes": self._mended(name, drives(setting, value, [file]))}
            )
            say(
                f"{name}: {'passes' if row['passes'] else 'fails'} with {setting.key} = "
                f"{shown(value)}"
            )
            return bool(row["passes"])

        def everywhere(setting: Setting, value: Value) -> dict[str, Any]:
            """The effect of a change on the drives of the run that can be driven."""
            files = {}
            for log in map(str, self._logs.index[self._logs["sha256"] != ""]):
                place = self._file(log)
                try:
                    if not place.is_file():
                        write_scenario(place, self._scenario(log))
                except (ConfigError, LogError):
                    continue  # the log cannot be read
                if log not in self.not_driven:
                    files[log] = place
            made = drives(setting, value, list(files.values()))
            rows = {log: made.of(place) for log, place in files.items()}
            mended = [log for log in self.failing if log in files and self._mended(log, made)]
            lost = [log for log, mine in rows.items() if mine.empty or failed_gates(mine)]
            broken = [log for log in lost if log not in self.failing]
            return {"mended": sorted(mended), "broken": sorted(broken), "drives": len(files)}

        with scratch_folder(self._out, "remedy") as scratch:
            found = smallest_change(settings, mends)
            if found is None:
                return Remedy(name)
            setting, value, u = found
            row = self._study.row(
                f"all logs: {setting.key} = {value!r}", lambda: everywhere(setting, value)
            )
        mended, broken = tuple(row["mended"]), tuple(row["broken"])
        return Remedy(name, setting.key, setting.default, value, u, mended, broken, row["drives"])


def _is_cut(base: Mapping[str, Any], made: DrivenLogs, file: Path) -> bool:
    """Whether a drive ended too early to be compared with the failing one, of which `base` is the
    row.
    """
    until = base["lasted"] if base["time_s"] is None else base["time_s"]
    return cut_short(base["end"], until, made.ended(file), made.lasted(file))


def _control(file: Path, name: str) -> Path:
    """The log with a perturbation."""
    return file.with_suffix(f".{name}.mcap")


def _frame_at(frames: Sequence[PlannedFrame], at: float) -> int:
    """The index of the last frame that is not later than a time, at least 0."""
    return max(int(np.searchsorted([frame.t for frame in frames], at + 1e-6, side="right")) - 1, 0)
