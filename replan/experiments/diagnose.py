"""A diagnosis: the failing drives of a run, driven again with one change.

    OUT/logs/                 the logs of the failing drives
    OUT/changes/NAME/         results with a change, as `replan compare` and `replan view` take
                              them; first "as_it_was"
    OUT/study.jsonl           the drives; `--resume` continues from it

and the files of `replan.experiments.diagnosis`. The same run gives the same diagnosis at any number
of workers.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np

from replan.config import RunConfig
from replan.core.errors import ConfigError, LogError, unknown_name
from replan.core.names import counted
from replan.draw.drawn_results import DriveResult, Results, load
from replan.experiments.changes import ChangedRun, TriedChange, cause_of, changed_runs, driven
from replan.experiments.diagnosis import AS_IT_WAS, Diagnosis, DriveFinding
from replan.experiments.drives import (
    CONTROLS,
    ChangedDrive,
    DrivenLogs,
    FailingDrive,
    as_driven,
    control_file,
    drive_again,
    failed_gates,
    parting,
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
from replan.experiments.remedy import Remedy, smallest_change
from replan.experiments.space import Setting, Value, shown, with_values
from replan.experiments.trial import MODE, scratch_folder
from replan.explain.causes import Account, accounts
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
        rows = rows[
            (rows["planner"] == self.planner) & (rows["mode"] == mode) & (rows["outcome"] == "fail")
        ]
        gates = rows.groupby("log")["gate"].agg(tuple)
        names = [log for log in sorted(gates.index) if not self.logs or log in self.logs]
        return {str(log): gates[log] for log in names}

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
    with claimed_folder(out, CONTENTS, resume=resume) as folder:
        study = Study(folder, asked.head(), resume=resume)
        drives = _DiagnosisDrives(asked, folder, study, workers)
        failing = drives.failing
        lost = ""
        if drives.not_driven:
            lost = f", {len(drives.not_driven)} more cannot be driven again"
        say(
            f"{counted(len(failing), 'failing drive')} of {asked.planner}{lost}, "
            f"{counted(len(runs), 'change')}"
        )
        for number, run in enumerate(runs if failing else (), 1):
            passing = sum(drive.passes for drive in drives.drive(run).values())
            say(f"{number} of {len(runs)}: {run.change.name}: {passing} of {len(failing)} pass")
        result = Diagnosis(
            folder,
            asked.results.path,
            asked.planner,
            tuple(drives.finding(log, runs) for log in failing),
            tuple(log for log in drives.files if log not in {*failing, *drives.not_driven}),
            drives.not_driven,
            runs,
            refused,
            drives.changed,
            open_loop=asked.failing(Mode.OPEN.value),
        )
        if settings:
            worst = [cluster[0] for cluster in result.clusters()]
            logs = [finding.log for finding in worst if not finding.cause.fragile]
            remedies = tuple(drives.remedy(log, settings, say) for log in logs)
            result = replace(result, remedies=remedies)
        result.write()
    return result


class _DiagnosisDrives:
    """The drives of a diagnosis, change by change; drives in the study file are not repeated.

    Attributes:
        files: The written log of each drive that fails in the run.
        failing: The drives that fail again; `not_driven` are those that cannot be driven, with the
            reasons.
        changed: The drives by change and log.
    """

    def __init__(self, asked: DiagnosisQuestion, out: Path, study: Study, workers: int) -> None:
        self._asked, self._out = asked, out
        self._study, self._workers = study, workers
        self._traced: dict[str, DriveResult] = {}
        self._logs = asked.results.logs.set_index("log")
        self.files = {log: self._file(log) for log in asked.failing()}
        if study.known(AS_IT_WAS) is None and self.files:
            lost = self._write_logs()
            rows = {log: lost.get(log) or self._drive_as_it_was(log) for log in self.files}
            study.add([{"key": AS_IT_WAS, "drives": rows}])
        rows = (study.known(AS_IT_WAS) or {"drives": {}})["drives"]
        self.failing = {log: FailingDrive(**row) for log, row in rows.items() if "gates" in row}
        self.not_driven = {log: row["lost"] for log, row in rows.items() if "lost" in row}
        self.changed: dict[str, dict[str, ChangedDrive]] = {}

    def _file(self, log: str) -> Path:
        """The path of a written log, by its folder, which is unique.

        Names without special characters are not.
        """
        return self._out / "logs" / f"{self._logs['folder'].astype(str)[log]}.mcap"

    def _scenario(self, log: str) -> Scenario:
        results = self._asked.results
        return scenario_of(results.path, self._logs.loc[log].to_dict(), results.run.log)

    def _write_logs(self) -> dict[str, dict[str, Any]]:
        """Write the logs, each with its perturbations; return the rows of those that cannot be
        read.
        """
        lost: dict[str, dict[str, Any]] = {}
        (self._out / "logs").mkdir(exist_ok=True)
        for log, file in self.files.items():
            try:
                scenario = self._scenario(log)
            except (ConfigError, LogError) as error:  # it was moved, or is damaged
                lost[log] = {"lost": str(error)}
                continue
            write_scenario(file, scenario)
            for control in CONTROLS:
                member = list(PERTURBATIONS).index(control) + 1
                write_scenario(control_file(file, control), perturbed(scenario, member)[1])
        return lost

    @cached_property
    def _base(self) -> DrivenLogs:
        """The drives without a change, and with perturbations that should change nothing."""
        folder, planner = self._out / "changes" / AS_IT_WAS, self._asked.planner
        if self._study.known(AS_IT_WAS) is not None:
            return as_driven(load(folder), planner)
        files: list[Path] = []
        for file in self.files.values():
            if file.is_file():
                files += [file, *(control_file(file, name) for name in CONTROLS)]
        return drive_again(files, self._asked.run, planner, folder, workers=self._workers)

    def _drive_as_it_was(self, log: str) -> dict[str, Any]:
        """The row of a drive without a change; empty if it fails no more."""
        base, file = self._base, self.files[log]
        if base.verdicts(file).empty or file.name not in base.driven:
            return {"lost": base.ended(file)}
        drive = FailingDrive.of(base, file)
        return {} if drive is None else asdict(drive)

    def _traced_drive(self, log: str) -> DriveResult:
        """The drive without a change; its trace is read once."""
        if log not in self._traced:
            self._traced[log] = self._base.drive(self.files[log])
        return self._traced[log]

    def drive(self, run: ChangedRun) -> Mapping[str, ChangedDrive]:
        """Drive the failing drives with a change, and return them by log; they are also kept in
        `changed`.
        """
        name = run.change.name
        row = self._study.row(name, lambda: {"drives": self._drive_failing(run)})
        self.changed[name] = {log: ChangedDrive(**drive) for log, drive in row["drives"].items()}
        return self.changed[name]

    def _drive_failing(self, run: ChangedRun) -> dict[str, dict[str, Any]]:
        files = [self.files[log] for log in self.failing]
        folder = self._out / "changes" / run.change.name
        changed = drive_again(files, run.run, self._asked.planner, folder, workers=self._workers)
        return {log: asdict(self._changed_drive(log, changed)) for log in self.failing}

    def _changed_drive(self, log: str, changed: DrivenLogs) -> ChangedDrive:
        """A failing drive among those with a change."""
        base, file = self.failing[log], self.files[log]
        against = self._against(log, changed)
        gates, end = failed_gates(changed.verdicts(file)), changed.ended(file)
        drive = ChangedDrive(against == "", gates, against or "", end, {})
        if not drive.passes:
            return drive
        was, now = self._traced_drive(log), changed.drive(file)
        until = inf if base.time_s is None else base.time_s
        pace = RoutePace.of(now.trace.ego, now.scenario) if base.is_about(PROGRESS) else None
        return replace(
            drive,
            parts=parting(was, now),
            difference=asdict(DriveDifference.of(was.trace, now.trace, until)),
            pace=None if pace is None else asdict(pace),
        )

    def _against(self, log: str, changed: DrivenLogs) -> str | None:
        """Why a drive is not mended by a change with which it fails none of its gates; "" if it is;
        None if it fails one of them.
        """
        base, file = self.failing[log], self.files[log]
        rows, agent = changed.verdicts(file), base.about.partition(" ")[2]
        if still_failing(base.gates, rows):
            return None
        if base.is_cut(changed, file):
            return f"{changed.ended(file)} at {changed.lasted(file):.1f} s"
        if others := failed_gates(rows):
            return f"fails {others[0]}"
        if peak := worse_peak(base.peaks, changed.peaks(file, base.gates, base.lasted)):
            return f"{peak} is worse"
        was, now, until = self._traced_drive(log), changed.drive(file), base.time_s or base.lasted
        name = was.scenario.short_names(base.about)
        harder_mps2 = made_way(was.trace, now.trace, agent, until)
        if harder_mps2 > FORCED_MPS2:
            return f"{name} brakes by {harder_mps2:.1f} m/s² more"
        if base.is_about(REACTIONS):
            tracks = self._scenario(log).tracks
            if unseen(was.trace, now.trace, tracks, agent, until):
                return f"{name} reacts to nothing"
        return ""

    def finding(self, log: str, runs: Sequence[ChangedRun]) -> DriveFinding:
        """The findings of all changes about a drive."""
        base, drive = self.failing[log], self._traced_drive(log)
        changed = {run.change.name: self.changed[run.change.name][log] for run in runs}
        passing = tuple(name for name, answer in changed.items() if answer.passes)
        almost = {name: answer.against for name, answer in changed.items() if answer.against}
        cause = cause_of(runs, passing, base.fragile, avoidable=base.avoidable or bool(almost))
        shows = changed[cause.changes[0]] if cause.changes else None
        parts = {} if shows is None else shows.parts
        explained = list(accounts(drive.trace, drive.scenario, drive.result.run.drive_loop))
        return DriveFinding(
            log,
            tuple(base.gates),
            nan if base.time_s is None else base.time_s,
            nan if base.beyond is None else base.beyond,
            cause,
            _failure(base, drive, shows, explained),
            parts,
            _reason_to_slow(drive, parts.get("t_s", base.time_s), explained),
            passing,
            _waits(base, drive, shows),
            almost,
        )

    def remedy(self, log: str, settings: Sequence[Setting], say: Callable[[str], None]) -> Remedy:
        """The smallest change of a setting with which a drive passes, and its effect on the other
        drives.
        """
        file = self.files[log]

        def drive_with(setting: Setting, value: Value, files: Sequence[Path]) -> DrivenLogs:
            shutil.rmtree(scratch, ignore_errors=True)
            run = with_values(self._asked.run, {setting.path: value})
            return drive_again(files, run, self._asked.planner, scratch, workers=self._workers)

        def passes(setting: Setting, value: Value) -> bool:
            def row() -> dict[str, Any]:
                return {"passes": self._against(log, drive_with(setting, value, [file])) == ""}

            mended: bool = self._study.row(f"{log}: {setting.key} = {value!r}", row)["passes"]
            outcome = "passes" if mended else "fails"
            say(f"{log}: {outcome} with {setting.key} = {shown(value)}")
            return mended

        with scratch_folder(self._out, "remedy") as scratch:
            change = smallest_change(settings, passes)
            if change is None:
                return Remedy(log)
            setting, value, u = change

            def effect() -> dict[str, Any]:
                files = self._drivable_files()
                return self._effect(drive_with(setting, value, list(files.values())), files)

            row = self._study.row(f"all logs: {setting.key} = {value!r}", effect)
        mended, broken = tuple(row["mended"]), tuple(row["broken"])
        return Remedy(log, setting.key, setting.default, value, u, mended, broken, row["drives"])

    def _drivable_files(self) -> dict[str, Path]:
        """The files of the logs of the run that can be driven, written where they are not yet."""
        files = {}
        for log in map(str, self._logs.index[self._logs["sha256"] != ""]):
            file = self._file(log)
            try:
                if not file.is_file():
                    write_scenario(file, self._scenario(log))
            except (ConfigError, LogError):
                continue  # the log cannot be read
            if log not in self.not_driven:
                files[log] = file
        return files

    def _effect(self, changed: DrivenLogs, files: Mapping[str, Path]) -> dict[str, Any]:
        """The effect of a change on the drives of the run."""
        mended = [log for log in self.failing if log in files and self._against(log, changed) == ""]
        broken = []
        for log, file in files.items():
            rows = changed.verdicts(file)
            if log not in self.failing and (rows.empty or failed_gates(rows)):
                broken.append(log)
        return {"mended": sorted(mended), "broken": sorted(broken), "drives": len(files)}


def _failure(
    base: FailingDrive,
    drive: DriveResult,
    shows: ChangedDrive | None,
    explained: Sequence[Account],
) -> DriveFailure:
    """The failure of a drive.

    `shows` is the passing drive that points to the cause, `explained` the account of each frame.
    """
    trace, scenario = drive.trace, drive.scenario
    difference = DriveDifference()
    if shows is not None and shows.difference is not None:
        difference = DriveDifference(**shows.difference)
    fails = float(trace.ego.t[-1]) if base.time_s is None else base.time_s
    kind, _, agent = base.about.partition(" ")
    kinds = {agent_kind.value for agent_kind in AgentKind}
    is_agent = kind in kinds and agent in trace.agents.ids
    brakes_for = False
    if difference.brakes_s is not None and trace.frames:
        causes = explained[_frame_at(trace.frames, difference.brakes_s)].causes
        brakes_for = any(cause.who == agent for cause in causes)
    looks = difference.would_brake_s
    if looks is None:
        looks = max(fails - AHEAD_S, trace.frames[0].t if trace.frames else 0.0)
    return DriveFailure(
        base.gates[0],
        base.metric,
        scenario.short_names(base.about) if is_agent else "",
        lane_change(trace, fails),
        difference,
        brakes_for,
        Foresight.of(trace, agent, looks) if is_agent else Foresight(),
        GoalMiss.of(trace, scenario) if base.is_about(PROGRESS) else None,
    )


def _reason_to_slow(drive: DriveResult, time: float | None, explained: Sequence[Account]) -> str:
    """Why the plan at a time is not as fast as it could be; "" if unknown."""
    frames = drive.trace.frames
    if not frames or time is None:
        return ""
    k = _frame_at(frames, time)
    because = Explanation.of(frames[k], explained[k], bounds=False).because
    return drive.scenario.short_names(because[0]) if because else ""


def _waits(base: FailingDrive, drive: DriveResult, shows: ChangedDrive | None) -> tuple[Wait, ...]:
    """The time that a drive loses, by cause, if it gets too little far."""
    trace, scenario = drive.trace, drive.scenario
    pace = RoutePace.needed(scenario) if base.is_about(PROGRESS) else None
    if shows is not None and shows.pace is not None:
        pace = RoutePace(**shows.pace)
    if pace is None:
        return ()
    lost, speeds = pace.lost(trace.ego, scenario, [frame.t for frame in trace.frames])
    loop = drive.result.run.drive_loop
    by_cause = waits(list(accounts(trace, scenario, loop, wanted=speeds)), lost.tolist())
    return tuple(replace(wait, who=scenario.short_names(wait.who)) for wait in by_cause)


def _frame_at(frames: Sequence[PlannedFrame], time: float) -> int:
    """The index of the last frame that is not later than a time, at least 0."""
    times = [frame.t for frame in frames]
    return max(int(np.searchsorted(times, time + 1e-6, side="right")) - 1, 0)
