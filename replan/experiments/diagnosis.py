"""The findings of a diagnosis as sentences, JSON, a page and tables.

OUT/diagnosis.json        causes by cluster and by drive, the sentences that are printed
OUT/diagnosis.md          the same as a page
OUT/diagnosis.csv         a row per failing drive; OUT/changes.csv one per drive and change
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from math import isfinite
from pathlib import Path
from typing import Any

import msgspec
import pandas as pd

from replan.core.errors import ConfigError
from replan.core.names import counted, listed
from replan.draw.drawn_results import Results
from replan.experiments.changes import NOT_FOUND, UNAVOIDABLE, ChangedRun, FailureCause
from replan.experiments.drives import ChangedDrive
from replan.experiments.failure import DriveFailure, Wait
from replan.experiments.remedy import Remedy
from replan.results.schema import read_json
from replan.results.tables import write_csv, write_json, write_text
from replan.results.version import replan_version

AS_IT_WAS = "as_it_was"
MOST_WAITS = 3
"""Largest number of waits that are listed."""
MUCH = 0.5
"""A wait of this share of the longest one is long."""
MOST_KEYS = 4
"""Largest number of settings of a change in a sentence; diagnosis.json has all."""


@dataclass(frozen=True)
class DriveFinding:
    """The findings about one failing drive.

    Attributes:
        gates: The gates that it fails.
        time_s: Time at which it fails the first of them; NaN if unknown.
        beyond: Excess over the bound of that gate; NaN if unknown.
        parts: First difference of the drive with the change that points to the cause: t_s, stage,
            what.
        because: The reason why the planner slowed down there, from its explanation.
        passing: Names of all changes with which it passes.
        waits: The time lost by cause, if it gets too little far.
        almost: Changes with which it fails none of these gates and is not mended, and why.
    """

    log: str
    gates: tuple[str, ...]
    time_s: float
    beyond: float
    cause: FailureCause
    failure: DriveFailure
    parts: Mapping[str, Any]
    because: str
    passing: tuple[str, ...]
    waits: tuple[Wait, ...] = ()
    almost: Mapping[str, str] = field(default_factory=dict)

    @property
    def look_s(self) -> float:
        """The time to look at first: of a drive that gets too little far, when it first loses much
        time, or parts.
        """
        if self.waits:
            much = MUCH * self.waits[0].seconds
            return min(wait.since_s for wait in self.waits if wait.seconds >= much)
        if self.failure.missed is None:
            return self.time_s
        return float(self.parts.get("t_s", self.time_s))

    @property
    def place(self) -> str:
        """The time to look at, and what can be seen at it."""
        time = f" at {self.look_s:.1f} s" if isfinite(self.look_s) else ""
        details = f": {self.failure.details}" if self.failure.details else ""
        parts = f"; it parts at {self.parts['what']}" if self.parts else ""
        because = f" {self.because}" if self.because else ""
        lost = ", ".join(
            f"{wait.seconds:.1f} s to {wait.who} from {wait.since_s:.1f} s on"
            for wait in self.waits[:MOST_WAITS]
        )
        loses = f" Loses {lost}." if lost else ""
        return f"{self.log}{time}{details}{parts}.{because}{loses}"


def settings_of(run: ChangedRun) -> str:
    """The settings that a change sets, with their values."""
    return listed([f"{key} = {value}" for key, value in sorted(run.keys)], MOST_KEYS)


class Cluster(msgspec.Struct, frozen=True):
    """Drives with the same cause, changes and failure, as in diagnosis.json.

    Attributes:
        why: The evidence for the cause.
        happens: The failure.
        about: The kind of the road user that it is about.
        gates: The first gate that each drive fails.
        drives: Their logs, the worst first.
    """

    cause: str
    why: str
    happens: str
    about: str
    gates: list[str]
    drives: list[str]


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The end of a diagnosis.

    Attributes:
        run: The result folder of the run.
        drives: A row per failing drive.
        not_failing: Logs whose drives no longer fail.
        not_driven: Logs that could not be driven again, with the reasons.
        runs: The changes that were driven.
        refused: Changes that cannot be applied to the run, with the reasons.
        changed: The drives by change and log.
        remedies: The smallest change of a setting for the first drive of each cluster, if settings
            are given.
        open_loop: Logs that fail gates in the open loop, which is not diagnosed, and these gates.
    """

    out: Path
    run: Path
    planner: str
    drives: tuple[DriveFinding, ...]
    not_failing: tuple[str, ...]
    not_driven: Mapping[str, str]
    runs: tuple[ChangedRun, ...]
    refused: Mapping[str, str]
    changed: Mapping[str, Mapping[str, ChangedDrive]]
    remedies: tuple[Remedy, ...] = ()
    open_loop: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def exit_code(self) -> int:
        """3 if a drive could not be driven again, otherwise 0."""
        return 3 if self.not_driven else 0

    def clusters(self) -> list[tuple[DriveFinding, ...]]:
        """Groups of drives with the same cause, changes and failure: the largest first, in each the
        worst first.
        """
        groups: dict[tuple[Any, ...], list[DriveFinding]] = {}
        for drive in sorted(self.drives, key=_order_of_drives):
            key = drive.cause.name, drive.cause.changes, drive.failure.sentence
            groups.setdefault(key, []).append(drive)
        return sorted(map(tuple, groups.values()), key=lambda group: (-len(group), group[0].log))

    def evidence(self, cause: FailureCause) -> str:
        """The evidence for a cause."""
        if cause.fragile:
            return (
                "fragile: passes with a perturbation that should change nothing "
                f"({', '.join(cause.fragile)})"
            )
        if cause.changes:
            words = {
                run.change.name: f"{run.change.words} ({settings_of(run)})" for run in self.runs
            }
            return f"passes {', '.join(words[name] for name in cause.changes)}"
        if cause.name == UNAVOIDABLE:
            return (
                "passes with no change, and the careful driver of UN R157 does not avoid the "
                "contact"
            )
        return f"passes with none of {counted(len(self.runs), 'change')}"

    def lines(self) -> list[str]:
        """The diagnosis in sentences."""
        lines = [line for group in self.clusters() for line in self._cluster_lines(group)]
        if not self.drives and not self.not_driven:
            number = counted(len(self.not_failing), "drive")
            passes = f" ({number} of the run failed and passes now)" if self.not_failing else ""
            lines.append(f"No closed-loop drive of {self.planner} fails{passes}.")
        elif self.not_failing:
            lines.append(f"Fails no more, evaluate the run again: {', '.join(self.not_failing)}.")
        for log, why in self.not_driven.items():
            lines.append(f"Could not be driven again: {log}: {why}.")
        lines += [remedy.line() for remedy in self.remedies]
        for log, gates in self.open_loop.items():
            lines.append(
                f"Fails in the open loop, which is not diagnosed: {log}: {', '.join(gates)}; look "
                f"at it: replan explain {self.run} --log {log} --mode open"
            )
        return [*lines, *(f"Not tried: {name}: {why}." for name, why in self.refused.items())]

    def _cluster_lines(self, group: Sequence[DriveFinding]) -> Iterator[str]:
        """A cluster in sentences."""
        first = group[0]
        share = f"{len(group)} of {counted(len(self.drives), 'failing drive')}"
        gates = ", ".join(dict.fromkeys(drive.gates[0] for drive in group))
        yield f"{share}: {first.failure.sentence}."
        points = f"Points to {first.cause.name}" if first.cause.changes else first.cause.name
        yield f"  {points[0].upper()}{points[1:]}: {self.evidence(first.cause)}; fails {gates}."
        yield f"  Look first at {first.place}"
        if first.almost and not first.cause.changes:
            words = {run.change.name: run.change.words for run in self.runs}
            nearly = "; ".join(f"{words[name]}: {why}" for name, why in first.almost.items())
            yield f"  Holds these gates, but is no better: {nearly}."
        if first.cause.name == NOT_FOUND and not first.cause.fragile:
            time = f" --at {first.look_s:.1f}" if isfinite(first.look_s) else ""
            explain = f"replan explain {self.run} --log {first.log} -p {self.planner}{time}"
            yield (
                f"  Next: {explain}; against a run that passes, replan diagnose {self.run} "
                "--against BASELINE; settings (--space FILE) or your own changes (--changes FILE)."
            )

    def document(self) -> dict[str, Any]:
        """The diagnosis as JSON types; unknown numbers are null."""
        clusters = [
            Cluster(
                group[0].cause.name,
                self.evidence(group[0].cause),
                group[0].failure.sentence,
                group[0].failure.kind,
                sorted({drive.gates[0] for drive in group}),
                [drive.log for drive in group],
            )
            for group in self.clusters()
        ]
        drives = [{**asdict(drive), "happens": drive.failure.sentence} for drive in self.drives]
        for row in drives:
            row.update({name: None for name in ("time_s", "beyond") if not isfinite(row[name])})
        return {
            "replan": replan_version(),
            "run": str(self.run),
            "planner": self.planner,
            "clusters": [msgspec.structs.asdict(cluster) for cluster in clusters],
            "drives": drives,
            "fails_no_more": list(self.not_failing),
            "open_loop": dict(self.open_loop),
            "not_driven": dict(self.not_driven),
            "changes": [
                {**asdict(run.change), "settings": dict(sorted(run.keys))} for run in self.runs
            ],
            "not_tried": dict(self.refused),
            "remedies": [asdict(remedy) for remedy in self.remedies],
            "said": self.lines(),
        }

    def write(self) -> None:
        """Write the files that the docstring of the module lists."""
        for name, table in (("diagnosis", self._drive_table()), ("changes", self._change_table())):
            write_csv(self.out / f"{name}.csv", table)
        write_json(self.out / "diagnosis.json", self.document())
        write_text(self.out / "diagnosis.md", "\n".join(self._page()) + "\n")

    def _drive_table(self) -> pd.DataFrame:
        drives = self.drives
        columns = {
            "log": [drive.log for drive in drives],
            "cause": [drive.cause.name for drive in drives],
            "why": [self.evidence(drive.cause) for drive in drives],
            "happens": [drive.failure.sentence for drive in drives],
            "gates": ["; ".join(drive.gates) for drive in drives],
            "about": [drive.failure.kind for drive in drives],
            "time_s": [drive.time_s for drive in drives],
            "parts_s": [drive.parts.get("t_s") for drive in drives],
            "parts_stage": [drive.parts.get("stage", "") for drive in drives],
            "passes_with": [" ".join(drive.passing) for drive in drives],
        }
        return pd.DataFrame(columns)

    def _change_table(self) -> pd.DataFrame:
        pairs = [(drive.log, run.change) for drive in self.drives for run in self.runs]
        changed = [self.changed[change.name][log] for log, change in pairs]
        columns = {
            "log": [log for log, _ in pairs],
            "change": [change.name for _, change in pairs],
            "cause": [change.cause for _, change in pairs],
            "rank": [change.rank for _, change in pairs],
            "passes": [drive.passes for drive in changed],
            "fails": ["; ".join(drive.gates) for drive in changed],
            "against": [drive.against for drive in changed],
            "end": [drive.end for drive in changed],
            "parts_s": [drive.parts.get("t_s") for drive in changed],
            "parts_stage": [drive.parts.get("stage", "") for drive in changed],
        }
        return pd.DataFrame(columns)

    def _page(self) -> Iterator[str]:
        """The diagnosis as Markdown."""
        yield f"# Why {self.planner} fails\n"
        for line in self.lines():
            yield f"  {line.strip()}" if line.startswith(" ") else f"- {line}"
        if not self.drives:
            return
        changes = [run.change.name for run in self.runs]
        yield "\n## With one thing changed\n"
        yield (
            "A drive that passes with a change is marked x. A cause is looked for from the left.\n"
        )
        yield f"| drive | cause | {' | '.join(changes)} |"
        yield "|---|---|" + "---|" * len(changes)
        for drive in self.drives:
            marks = " | ".join("x" if change in drive.passing else "" for change in changes)
            yield f"| {drive.log} | {drive.cause.name} | {marks} |"
        yield "\n## Look at it\n"
        for first, *_ in self.clusters():
            words = ["explain", str(self.run), "--log", first.log, "--planner", self.planner]
            yield f"- {first.cause.name}: `replan {shlex.join(words)}`"
            for run in self.runs:
                if run.change.name in first.cause.changes:
                    folder = self.out / "changes"
                    words = ["compare", str(folder / AS_IT_WAS), str(folder / run.change.name)]
                    words += ["-p", self.planner, "-p", run.run.planners[0]]
                    yield f"  - {run.change.words}: `replan {shlex.join(words)}`"


def _order_of_drives(drive: DriveFinding) -> tuple[float, str]:
    """The drive that is farthest beyond its gate first; unknown ones last."""
    return -drive.beyond if isfinite(drive.beyond) else 1.0, drive.log


class DiagnosisSummary(msgspec.Struct):
    """The contents of diagnosis.json, as far as reports need them."""

    planner: str
    clusters: list[Cluster]
    said: list[str]


def read_diagnosis(folder: Path, results: Results) -> dict[str, Any]:
    """The contents of diagnosis.json in a folder, for `replan.draw.report`.

    Raises:
        ConfigError: The file is missing or unreadable, or it is of another run.
    """
    file = folder / "diagnosis.json"
    again = f"`replan diagnose RUN -o {folder}` writes one"
    if not file.exists():
        raise ConfigError(f"{file}: is not a diagnosis; {again}")
    document, summary = read_json(file, DiagnosisSummary, again)
    logs = {log for cluster in summary.clusters for log in cluster.drives}
    if summary.planner not in results.run.planners or not logs <= set(results.logs["log"]):
        raise ConfigError(f"{file}: is a diagnosis of another run than {results.path}")
    return document
