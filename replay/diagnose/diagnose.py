"""A diagnosis: the failing drives of a run, driven again with one thing changed, and its files.

    OUT/diagnosis.json        causes by cluster and by drive, the sentences that are printed
    OUT/diagnosis.md          the same as a page
    OUT/diagnosis.csv         a row per failing drive; OUT/changes.csv one per drive and change
    OUT/logs/                 the logs of the failing drives
    OUT/changes/NAME/         results with a change, as `replan compare` and `replan view` take them; first "as_it_was"
    OUT/study.jsonl           what was driven; `--resume` goes on from it

The same run gives the same diagnosis at any number of workers.
"""

from __future__ import annotations

import json
import shlex
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from math import isfinite, nan
from pathlib import Path
from typing import Any

import pandas as pd

from logs.errors import ConfigError, LogError, unknown_name
from logs.mcap import write_scenario
from logs.names import counted
from replay.config import RunConfig, dump_run
from replay.diagnose.causes import UNAVOIDABLE, Cause, cause_of
from replay.diagnose.changes import Change, ChangedRun, changed_runs, driven
from replay.diagnose.drives import MODE, Driven, as_driven, drive_again, failed_gates, parting, passes
from replay.diagnose.remedy import Remedy, smallest_change
from replay.explain.explanation import explained
from replay.results.load import DriveResult, Results, load
from replay.results.tables import PARTIAL, write_file, write_json, write_text
from replay.results.version import replan_version
from replay.run.lock import held
from replay.run.origin import scenario_of
from replay.run.perturb import PERTURBATIONS, perturbed
from replay.run.resume import stamp_of
from replay.search.space import Setting, Value, shown, with_values
from replay.search.study import Study

KIND, AS_IT_WAS = "diagnose", "as_it_was"
CONTROLS = ("tiny", "start", "noise")
"""Perturbations (`replay.run.perturb`) with which a drive must fail, too, before a change shows anything."""


@dataclass(frozen=True, eq=False)
class Question:
    """What is asked for.

    Attributes:
        results: The run.
        planner: Whose failing drives.
        logs: Names of logs; empty: all.
        changes: What is changed.
    """

    results: Results
    planner: str
    logs: tuple[str, ...]
    changes: tuple[Change, ...]

    @property
    def run(self) -> RunConfig:
        """What is driven without a change."""
        return driven(self.results.run, self.planner)

    def failing(self) -> tuple[str, ...]:
        """Names of the logs whose drives fail a gate, sorted."""
        rows = self.results.verdicts
        mine = rows[(rows["planner"] == self.planner) & (rows["mode"] == MODE) & (rows["outcome"] == "fail")]
        names = set(mine["log"])
        return tuple(sorted(names & set(self.logs) if self.logs else names))

    def head(self) -> dict[str, Any]:
        """What makes two diagnoses the same."""
        stamp = stamp_of(self.run)
        logs = self.results.logs[self.results.logs["log"].isin(self.failing())]
        return {
            "study": KIND, "replan": stamp.replan, "code": stamp.code[:12], "planner": self.planner,
            "logs": sorted(zip(logs["log"], logs["sha256"], strict=True)), "run": dump_run(self.run),
            "changes": [asdict(change) for change in self.changes],
        }  # fmt: skip


def question(results: Results, planner: str | None, logs: Sequence[str], changes: Sequence[Change]) -> Question:
    """The question, checked.

    Raises:
        ConfigError: There is no such planner or log in the run, no planner is named of several, or the run has no
            closed loop.
    """
    run = results.run
    if planner is None and len(run.planners) > 1:
        raise ConfigError(f"name the planner with --planner: {', '.join(run.planners)}")
    planner = planner or run.planners[0]
    if planner not in run.planners:
        raise unknown_name("planner (in the run)", planner, run.planners)
    if run.mode == "open":
        raise ConfigError(f"{results.path}: has no closed loop; only closed loops are diagnosed")
    for log in logs:
        if log not in set(results.logs["log"]):
            raise unknown_name("log", log, list(results.logs["log"]))
    return Question(results, planner, tuple(logs), tuple(changes))


@dataclass(frozen=True)
class Found:
    """What was found of a failing drive.

    Attributes:
        log: Its name in the run.
        gates: The gates that it fails.
        about: The kind of road user that the first of them is about; "": none.
        time_s: When; NaN: not known.
        beyond: How far beyond its bound the first of them is; NaN likewise.
        cause: The cause.
        parts: Where the drive with the change that points to the cause parts from it: t_s, stage, what.
        because: Why the planner slowed down there, in its explanation's words.
        passing: Names of all changes with which it passes.
    """

    log: str
    gates: tuple[str, ...]
    about: str
    time_s: float
    beyond: float
    cause: Cause
    parts: Mapping[str, Any]
    because: str
    passing: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The end of a diagnosis.

    Attributes:
        out: The folder.
        question: What was asked for.
        drives: A row per failing drive.
        not_failing: Logs whose drives fail no more.
        runs: The changes that were driven.
        refused: Changes that cannot be applied to the run, and why.
        table: A row per drive and change.
        remedies: The smallest change of a setting for the first drive of each cluster, where settings are given.
    """

    out: Path
    question: Question
    drives: tuple[Found, ...]
    not_failing: tuple[str, ...]
    runs: tuple[ChangedRun, ...]
    refused: Mapping[str, str]
    table: pd.DataFrame
    remedies: tuple[Remedy, ...] = ()

    def clusters(self) -> list[tuple[Found, ...]]:
        """Drives of one cause, change and kind of road user: most drives first, the worst ahead."""
        found: dict[tuple[Any, ...], list[Found]] = {}
        for one in self.drives:
            found.setdefault((one.cause.name, one.cause.changes, one.about), []).append(one)
        ordered = (sorted(some, key=lambda one: (-_number(one.beyond), one.log)) for some in found.values())
        return sorted(map(tuple, ordered), key=lambda some: (-len(some), some[0].log))

    def words_of(self, cause: Cause) -> str:
        """Why a cause is named."""
        words = {run.change.name: run.change.words for run in self.runs}
        if cause.fragile:
            return f"fragile: passes with a perturbation that should change nothing ({', '.join(cause.fragile)})"
        if cause.changes:
            return f"passes {', '.join(words[name] for name in cause.changes)}"
        if cause.name == UNAVOIDABLE:
            return "passes with no change, and the careful driver of UN R157 does not avoid the contact"
        return f"passes with none of {counted(len(self.runs), 'change')}"

    def lines(self) -> list[str]:
        """The diagnosis in sentences."""
        if not self.drives:
            gone = f" ({counted(len(self.not_failing), 'drive')} of the run failed and passes now)"
            return [f"No drive of {self.question.planner} fails{gone if self.not_failing else ''}."]
        said = []
        for some in self.clusters():
            first = some[0]
            who = f" ({first.about})" if first.about else ""
            share = f"{len(some)} of {counted(len(self.drives), 'failing drive')}"
            gates = ", ".join(dict.fromkeys(one.gates[0] for one in some))
            said.append(f"{share}: {first.cause.name}; {self.words_of(first.cause)}; fails {gates}{who}.")
            said.append(f"  Look first at {self._place(first)}")
        if self.not_failing:
            said.append(f"Fails no more, evaluate the run again: {', '.join(self.not_failing)}.")
        said += [one.line() for one in self.remedies]
        return [*said, *(f"Not tried: {name}: {why}." for name, why in self.refused.items())]

    def _place(self, one: Found) -> str:
        at = f" at {one.time_s:.1f} s" if isfinite(one.time_s) else ""
        parts = f"; it parts at {one.parts['what']}" if one.parts else ""
        because = f" {one.because}" if one.because else ""
        return f"{one.log}{at}{parts}.{because}"

    def document(self) -> dict[str, Any]:
        """All of it as JSON has it."""
        clusters = [
            {"cause": some[0].cause.name, "why": self.words_of(some[0].cause), "about": some[0].about,
             "gates": sorted({one.gates[0] for one in some}), "drives": [one.log for one in some]}
            for some in self.clusters()
        ]  # fmt: skip
        return {
            "replan": replan_version(), "run": str(self.question.results.path), "planner": self.question.planner,
            "clusters": clusters, "drives": [_record(one) for one in self.drives],
            "fails_no_more": list(self.not_failing), "changes": [asdict(run.change) for run in self.runs],
            "not_tried": dict(self.refused), "remedies": [asdict(one) for one in self.remedies], "said": self.lines(),
        }  # fmt: skip


def _record(one: Found) -> dict[str, Any]:
    """A drive as JSON has it: null where a number is not known."""
    return {**asdict(one), "time_s": _finite(one.time_s), "beyond": _finite(one.beyond)}


def diagnose(
    asked: Question,
    out: Path,
    settings: Sequence[Setting] = (),
    *,
    workers: int = 0,
    resume: bool = False,
    say: Callable[[str], None] = lambda line: None,
) -> Diagnosis:
    """Drive the failing drives of a run again with each change, and write what that shows into `out`.

    Args:
        asked: What is asked for.
        out: A folder that is new, empty, or holds an earlier diagnosis, which is replaced or resumed.
        settings: For the first drive of each cluster, the smallest change of one of these with which it passes.
        workers: Processes; 0: this one.
        resume: Go on with the diagnosis that `out` holds.
        say: Called with a line after each change.

    Raises:
        ConfigError: A folder that is not ours to write, nothing to resume, a log is not where it was, or another.
        LogError: A log cannot be read.
        PlannerError: The planner cannot be loaded.
    """
    runs, refused = changed_runs(asked.changes, asked.run)
    with held(out):
        trials = _Trials(asked, out, Study(out, asked.head(), resume=resume), workers)
        failing = [name for name in trials.files if trials.base_gates(name)]
        say(f"{counted(len(failing), 'failing drive')} of {asked.planner}, {counted(len(runs), 'change')}")
        for k, run in enumerate(runs):
            row = trials.drive(run, failing)
            passing = sum(one["passes"] for one in row["drives"].values())
            say(f"{k + 1} of {len(runs)}: {run.change.name}: {passing} of {len(failing)} pass")
        found = tuple(trials.found(name, runs) for name in failing)
        gone = tuple(name for name in trials.files if name not in failing)
        result = Diagnosis(out, asked, found, gone, runs, refused, trials.table(runs, failing))
        if settings:
            first = [some[0].log for some in result.clusters() if not some[0].cause.fragile]
            result = replace(result, remedies=tuple(trials.remedy(log, settings, say) for log in first))
        _write(result)
    return result


class _Trials:
    """The drives of a diagnosis, change by change; what the study holds is not driven again."""

    def __init__(self, asked: Question, out: Path, study: Study, workers: int) -> None:
        self._asked, self._out, self._study, self._workers = asked, out, study, workers
        self._drives: dict[str, DriveResult] = {}
        self._folders = dict(zip(asked.results.logs["log"], asked.results.logs["folder"], strict=True))
        self.files = {name: self._file(name) for name in asked.failing()}
        if study.known(AS_IT_WAS) is None and self.files:
            self._write_logs()
            rows = {name: self._base_row(file) for name, file in self.files.items()}
            study.add([{"key": AS_IT_WAS, "drives": rows}])
        self._base_rows = (study.known(AS_IT_WAS) or {"drives": {}})["drives"]

    def _file(self, name: str) -> Path:
        """Where the log is written; folders of logs are unique, names without their special characters are not."""
        return self._out / "logs" / f"{self._folders[name]}.mcap"

    def base_gates(self, name: str) -> tuple[str, ...]:
        """The gates that the drive fails without a change."""
        return tuple(self._base_rows[name]["gates"])

    def drive(self, run: ChangedRun, failing: Sequence[str]) -> dict[str, Any]:
        """The row of a change."""
        known = self._study.known(run.change.name)
        if known is not None or not failing:
            return known or {"drives": {}}
        files = [self.files[name] for name in failing]
        place = self._out / "changes" / run.change.name
        made = drive_again(files, run.run, self._asked.planner, place, workers=self._workers)
        rows = {name: self._answer(name, made) for name in failing}
        self._study.add([{"key": run.change.name, "drives": rows}])
        return {"drives": rows}

    def found(self, name: str, runs: Sequence[ChangedRun]) -> Found:
        """What all changes show of a drive."""
        base = self._base_rows[name]
        answers = {run.change.name: self.drive(run, ())["drives"][name] for run in runs}
        passing = tuple(change for change, answer in answers.items() if answer["passes"])
        cause = cause_of(runs, passing, base["fragile"], avoidable=base["avoidable"])
        parts = answers[cause.changes[0]]["parts"] if cause.changes else {}
        time, beyond = (nan if base[key] is None else base[key] for key in ("time_s", "beyond"))
        because = self._because(name, parts.get("t_s", time))
        return Found(name, tuple(base["gates"]), base["about"], time, beyond, cause, parts, because, passing)

    def table(self, runs: Sequence[ChangedRun], failing: Sequence[str]) -> pd.DataFrame:
        """A row per drive and change."""
        rows = [
            {"log": name, "change": run.change.name, "cause": run.change.cause, "rank": run.change.rank,
             "passes": one["passes"], "fails": "; ".join(one["gates"]), "end": one["end"],
             "parts_s": one["parts"].get("t_s"), "parts_stage": one["parts"].get("stage", "")}
            for name in failing
            for run in runs
            for one in [self.drive(run, ())["drives"][name]]
        ]  # fmt: skip
        columns = ["log", "change", "cause", "rank", "passes", "fails", "end", "parts_s", "parts_stage"]
        return pd.DataFrame(rows, columns=columns)

    def _write_logs(self) -> None:
        results = self._asked.results
        logs = results.logs.set_index("log")
        (self._out / "logs").mkdir(exist_ok=True)
        for name, file in self.files.items():
            scenario = scenario_of(results.path, logs.loc[name].to_dict(), results.run.log)
            write_scenario(file, scenario)
            for control in CONTROLS:
                member = list(PERTURBATIONS).index(control) + 1
                write_scenario(_control(file, control), perturbed(scenario, member)[1])

    @cached_property
    def _base(self) -> Driven:
        """The drives without a change, and with perturbations that should change nothing."""
        place, planner = self._out / "changes" / AS_IT_WAS, self._asked.planner
        if self._study.known(AS_IT_WAS) is not None:
            return as_driven(load(place), planner)
        files = [each for file in self.files.values() for each in (file, *(_control(file, c) for c in CONTROLS))]
        return drive_again(files, self._asked.run, planner, place, workers=self._workers)

    def remedy(self, name: str, settings: Sequence[Setting], say: Callable[[str], None]) -> Remedy:
        """The smallest change of a setting with which a drive passes, and what it does to the others."""
        file, before, scratch = self.files[name], self.base_gates(name), self._out / f"{PARTIAL}remedy"

        def drives(setting: Setting, value: Value, files: Sequence[Path]) -> Driven:
            shutil.rmtree(scratch, ignore_errors=True)
            run = with_values(self._asked.run, {setting.path: value})
            return drive_again(files, run, self._asked.planner, scratch, workers=self._workers)

        def mends(setting: Setting, value: Value) -> bool:
            passed = passes(before, drives(setting, value, [file]).of(file))
            say(f"{name}: {'passes' if passed else 'fails'} with {setting.key} = {shown(value)}")
            return passed

        try:
            found = smallest_change(settings, mends)
            if found is None:
                return Remedy(name)
            setting, value, u = found
            files = self._all_files()
            made = drives(setting, value, list(files.values()))
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
        passing = {
            log for log, place in files.items() if log in self.files and passes(self.base_gates(log), made.of(place))
        }
        lost = {log for log, place in files.items() if made.of(place).empty or failed_gates(made.of(place))}
        failing = {log for log in self.files if self.base_gates(log)}
        mended, broken = tuple(sorted(failing & passing)), tuple(sorted(lost - failing))
        return Remedy(name, setting.key, setting.default, value, u, mended, broken, len(files))

    def _all_files(self) -> dict[str, Path]:
        """The logs of the whole run."""
        results = self._asked.results
        logs = results.logs[results.logs["sha256"] != ""].set_index("log")
        files = {str(name): self._file(str(name)) for name in logs.index}
        for name, file in files.items():
            if not file.is_file():
                write_scenario(file, scenario_of(results.path, logs.loc[name].to_dict(), results.run.log))
        return files

    def _drive_of(self, name: str) -> DriveResult:
        """The drive without a change; its trace is read once."""
        if name not in self._drives:
            self._drives[name] = self._base.drive(self.files[name])
        return self._drives[name]

    def _base_row(self, file: Path) -> dict[str, Any]:
        made = self._base
        rows = made.of(file)
        gates = failed_gates(rows)
        if rows.empty or file.name not in made.driven:
            raise LogError(f"could not be driven again: {made.ended(file)}", file=file)
        if not gates:
            return {"gates": []}
        first, gate = rows[rows["gate"] == gates[0]].iloc[0], made.gates[gates[0]]
        return {
            "gates": list(gates),
            "about": made.about(file, gate.metric),
            "time_s": _finite(float(first["time_s"])),
            "beyond": _finite(-gate.margin(float(first["value"]))),
            "avoidable": made.avoidable(file),
            "fragile": [one for one in CONTROLS if passes(gates, made.of(_control(file, one)))],
        }

    def _answer(self, name: str, made: Driven) -> dict[str, Any]:
        file = self.files[name]
        rows = made.of(file)
        passed = passes(self.base_gates(name), rows)
        parts = parting(self._drive_of(name), made.drive(file)) if passed else {}
        return {"passes": passed, "gates": list(failed_gates(rows)), "end": made.ended(file), "parts": parts}

    def _because(self, name: str, at: float) -> str:
        """Why the planner slows down at a time (NaN: nothing is asked); "" where it does not."""
        drive = self._drive_of(name)
        frames = drive.trace.frames
        if not isfinite(at) or not frames:
            return ""
        last = float(drive.trace.ego.t[-1])
        because = [line for one in explained(drive, min(max(at, frames[0].t), last)) for line in one.because]
        return because[0] if because else ""


def _control(file: Path, name: str) -> Path:
    """The log with a perturbation."""
    return file.with_suffix(f".{name}.mcap")


def _finite(value: float) -> float | None:
    return value if isfinite(value) else None


def _number(value: float) -> float:
    return value if isfinite(value) else -1.0


# the files --------------------------------------------------------------------------------------------------------


def _write(result: Diagnosis) -> None:
    out = result.out
    rows = [
        {"log": one.log, "cause": one.cause.name, "why": result.words_of(one.cause), "gates": "; ".join(one.gates),
         "about": one.about, "time_s": one.time_s, "parts_s": one.parts.get("t_s"),
         "parts_stage": one.parts.get("stage", ""), "passes_with": " ".join(one.passing)}
        for one in result.drives
    ]  # fmt: skip
    columns = [
        "log", "cause", "why", "gates", "about", "time_s", "parts_s", "parts_stage", "passes_with",
    ]  # fmt: skip
    for name, table in (("diagnosis", pd.DataFrame(rows, columns=columns)), ("changes", result.table)):
        write_file(out / f"{name}.csv", partial(table.to_csv, index=False, lineterminator="\n"))
    write_json(out / "diagnosis.json", result.document())
    write_text(out / "diagnosis.md", "\n".join(_page(result)) + "\n")


def read_diagnosis(folder: Path, results: Results) -> dict[str, Any]:
    """What diagnosis.json in a folder holds, for `replay.draw.report`.

    Raises:
        ConfigError: There is none, it cannot be read, or it is of another run.
    """
    file = folder / "diagnosis.json"
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
        found = {name: found[name] for name in ("planner", "clusters", "said")}
        logs = {log for cluster in found["clusters"] for log in cluster["drives"]}
    except (OSError, ValueError, KeyError, TypeError):
        raise ConfigError(f"{file}: is no diagnosis; `replan diagnose RUN -o {folder}` writes one") from None
    if found["planner"] not in results.run.planners or not logs <= set(results.logs["log"]):
        raise ConfigError(f"{file}: is a diagnosis of another run than {results.path}")
    return found


def _page(result: Diagnosis) -> Iterator[str]:
    """The diagnosis as Markdown."""
    asked, runs = result.question, [run.change for run in result.runs]
    yield f"# Why {asked.planner} fails\n"
    yield from (f"- {line}" if not line.startswith(" ") else f"  {line.strip()}" for line in result.lines())
    if not result.drives:
        return
    yield "\n## With one thing changed\n"
    yield "A drive that passes with a change is marked x. A cause is looked for from the left.\n"
    yield f"| drive | cause | {' | '.join(change.name for change in runs)} |"
    yield "|---|---|" + "---|" * len(runs)
    for one in result.drives:
        marks = " | ".join("x" if change.name in one.passing else "" for change in runs)
        yield f"| {one.log} | {one.cause.name} | {marks} |"
    yield "\n## Look at it\n"
    for some in result.clusters():
        name = some[0].log
        words = ["explain", str(asked.results.path), "--log", name, "--planner", asked.planner]
        yield f"- {some[0].cause.name}: `replan {shlex.join(words)}`"
        for run in result.runs:
            if run.change.name in some[0].cause.changes:
                place = result.out / "changes"
                words = ["compare", str(place / AS_IT_WAS), str(place / run.change.name)]
                words += ["-p", asked.planner, "-p", run.run.planners[0]]
                yield f"  - {run.change.words}: `replan {shlex.join(words)}`"
