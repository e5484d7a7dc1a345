"""The findings of a diagnosis as sentences, JSON, a page and tables.

OUT/diagnosis.json        causes by cluster and by drive, the sentences that are printed
OUT/diagnosis.md          the same as a page
OUT/diagnosis.csv         a row per failing drive; OUT/changes.csv one per drive and change
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping
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
from replan.experiments.failure import DriveFailure, Wait
from replan.experiments.remedy import Remedy
from replan.results.schema import read_json
from replan.results.tables import write_csv, write_json, write_text
from replan.results.version import replan_version

AS_IT_WAS = "as_it_was"
MOST = 3
"""Largest number of waits that are listed."""
MUCH = 0.5
"""A wait of this share of the longest one is long."""
MOST_KEYS = 4
"""Largest number of settings of a change in a sentence; diagnosis.json has all."""
DRIVES = (
    "log",
    "cause",
    "why",
    "happens",
    "gates",
    "about",
    "time_s",
    "parts_s",
    "parts_stage",
    "passes_with",
)
ANSWERS = (
    "log",
    "change",
    "cause",
    "rank",
    "passes",
    "fails",
    "against",
    "end",
    "parts_s",
    "parts_stage",
)


@dataclass(frozen=True)
class Found:
    """The findings about one failing drive.

    Attributes:
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
            return min(
                one.since_s for one in self.waits if one.seconds >= MUCH * self.waits[0].seconds
            )
        return (
            self.time_s
            if self.failure.missed is None
            else float(self.parts.get("t_s", self.time_s))
        )

    @property
    def place(self) -> str:
        """The time to look at, and what can be seen at it."""
        at = f" at {self.look_s:.1f} s" if isfinite(self.look_s) else ""
        parts = f"; it parts at {self.parts['what']}" if self.parts else ""
        because = f" {self.because}" if self.because else ""
        details = f": {self.failure.details}" if self.failure.details else ""
        slow = ", ".join(
            f"{one.seconds:.1f} s to {one.who} from {one.since_s:.1f} s on"
            for one in self.waits[:MOST]
        )
        went = f" Loses {slow}." if slow else ""
        return f"{self.log}{at}{details}{parts}.{because}{went}"


def settings_of(run: ChangedRun) -> str:
    """The settings that a change sets, with their values; of another planner, not its own ones."""
    other = any(key == "planners" for key, _ in run.keys)
    keys = [
        f"{key} = {value}"
        for key, value in sorted(run.keys)
        if not (other and key.startswith("planner."))
    ]
    return listed(keys, MOST_KEYS)


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
        answers: The result by change and log: passes, gates, end, parts.
        remedies: The smallest change of a setting for the first drive of each cluster, if settings
            are given.
        open_loop: Logs that fail gates in the open loop, which is not diagnosed, and these gates.
    """

    out: Path
    run: Path
    planner: str
    drives: tuple[Found, ...]
    not_failing: tuple[str, ...]
    not_driven: Mapping[str, str]
    runs: tuple[ChangedRun, ...]
    refused: Mapping[str, str]
    answers: Mapping[str, Mapping[str, Any]]
    remedies: tuple[Remedy, ...] = ()
    open_loop: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def exit_code(self) -> int:
        """3 if a drive could not be driven again, otherwise 0."""
        return 3 if self.not_driven else 0

    def clusters(self) -> list[tuple[Found, ...]]:
        """Groups of drives with the same cause, changes and failure: the largest first, in each the
        worst first.
        """
        found: dict[tuple[Any, ...], list[Found]] = {}
        for one in self.drives:
            found.setdefault((one.cause.name, one.cause.changes, one.failure.sentence), []).append(
                one
            )
        for some in found.values():
            some.sort(key=lambda one: (-one.beyond if isfinite(one.beyond) else 1.0, one.log))
        return sorted(map(tuple, found.values()), key=lambda some: (-len(some), some[0].log))

    def words_of(self, cause: FailureCause) -> str:
        """The evidence for a cause."""
        words = {run.change.name: f"{run.change.words} ({settings_of(run)})" for run in self.runs}
        if cause.fragile:
            return (
                "fragile: passes with a perturbation that should change nothing "
                f"({', '.join(cause.fragile)})"
            )
        if cause.changes:
            return f"passes {', '.join(words[name] for name in cause.changes)}"
        if cause.name == UNAVOIDABLE:
            return (
                "passes with no change, and the careful driver of UN R157 does not avoid the "
                "contact"
            )
        return f"passes with none of {counted(len(self.runs), 'change')}"

    def lines(self) -> list[str]:
        """The diagnosis in sentences."""
        said = []
        for some in self.clusters():
            first = some[0]
            share = f"{len(some)} of {counted(len(self.drives), 'failing drive')}"
            gates = ", ".join(dict.fromkeys(one.gates[0] for one in some))
            said.append(f"{share}: {first.failure.sentence}.")
            said.append(
                f"  Cause: {first.cause.name}; {self.words_of(first.cause)}; fails {gates}."
            )
            said.append(f"  Look first at {first.place}")
            if first.almost and not first.cause.changes:
                words = {run.change.name: run.change.words for run in self.runs}
                nearly = "; ".join(f"{words[name]}: {why}" for name, why in first.almost.items())
                said.append(f"  Holds these gates, but is no better: {nearly}.")
            if first.cause.name == NOT_FOUND and not first.cause.fragile:
                at = f" --at {first.look_s:.1f}" if isfinite(first.look_s) else ""
                look = f"replan explain {self.run} --log {first.log} -p {self.planner}{at}"
                said.append(
                    f"  Next: {look}; try its settings (--space FILE) or your own changes "
                    "(--changes FILE)."
                )
        if not self.drives and not self.not_driven:
            gone = f" ({counted(len(self.not_failing), 'drive')} of the run failed and passes now)"
            said.append(
                f"No closed-loop drive of {self.planner} fails{gone if self.not_failing else ''}."
            )
        elif self.not_failing:
            said.append(f"Fails no more, evaluate the run again: {', '.join(self.not_failing)}.")
        said += [
            f"Could not be driven again: {name}: {why}." for name, why in self.not_driven.items()
        ]
        said += [one.line() for one in self.remedies]
        said += [
            (
                f"Fails in the open loop, which is not diagnosed: {name}: {', '.join(gates)}; look "
                "at "
                "it: replan explain"
                f" {self.run} --log {name} --mode open"
            )
            for name, gates in self.open_loop.items()
        ]
        return [*said, *(f"Not tried: {name}: {why}." for name, why in self.refused.items())]

    def document(self) -> dict[str, Any]:
        """The diagnosis as JSON types; unknown numbers are null."""
        clusters = [
            {
                "cause": some[0].cause.name,
                "why": self.words_of(some[0].cause),
                "happens": some[0].failure.sentence,
                "about": some[0].failure.kind,
                "gates": sorted({one.gates[0] for one in some}),
                "drives": [one.log for one in some],
            }
            for some in self.clusters()
        ]
        drives = [{**asdict(one), "happens": one.failure.sentence} for one in self.drives]
        for row in drives:
            row.update({name: None for name in ("time_s", "beyond") if not isfinite(row[name])})
        return {
            "replan": replan_version(),
            "run": str(self.run),
            "planner": self.planner,
            "clusters": clusters,
            "drives": drives,
            "fails_no_more": list(self.not_failing),
            "open_loop": dict(self.open_loop),
            "not_driven": dict(self.not_driven),
            "changes": [
                {**asdict(run.change), "settings": dict(sorted(run.keys))} for run in self.runs
            ],
            "not_tried": dict(self.refused),
            "remedies": [asdict(one) for one in self.remedies],
            "said": self.lines(),
        }

    def write(self) -> None:
        """Write the files that the docstring of the module lists."""
        drives = [
            (
                one.log,
                one.cause.name,
                self.words_of(one.cause),
                one.failure.sentence,
                "; ".join(one.gates),
                one.failure.kind,
                one.time_s,
                one.parts.get("t_s"),
                one.parts.get("stage", ""),
                " ".join(one.passing),
            )
            for one in self.drives
        ]
        answers = [
            (
                found.log,
                run.change.name,
                run.change.cause,
                run.change.rank,
                one["passes"],
                "; ".join(one["gates"]),
                one["against"],
                one["end"],
                one["parts"].get("t_s"),
                one["parts"].get("stage", ""),
            )
            for found in self.drives
            for run in self.runs
            for one in [self.answers[run.change.name][found.log]]
        ]
        for name, rows, columns in (("diagnosis", drives, DRIVES), ("changes", answers, ANSWERS)):
            write_csv(self.out / f"{name}.csv", pd.DataFrame(rows, columns=list(columns)))
        write_json(self.out / "diagnosis.json", self.document())
        write_text(self.out / "diagnosis.md", "\n".join(self._page()) + "\n")

    def _page(self) -> Iterator[str]:
        """The diagnosis as Markdown."""
        yield f"# Why {self.planner} fails\n"
        yield from (
            f"- {line}" if not line.startswith(" ") else f"  {line.strip()}"
            for line in self.lines()
        )
        if not self.drives:
            return
        changes = [run.change for run in self.runs]
        yield "\n## With one thing changed\n"
        yield (
            "A drive that passes with a change is marked x. A cause is looked for from the left.\n"
        )
        yield f"| drive | cause | {' | '.join(change.name for change in changes)} |"
        yield "|---|---|" + "---|" * len(changes)
        for one in self.drives:
            marks = " | ".join("x" if change.name in one.passing else "" for change in changes)
            yield f"| {one.log} | {one.cause.name} | {marks} |"
        yield "\n## Look at it\n"
        for first, *_ in self.clusters():
            words = ["explain", str(self.run), "--log", first.log, "--planner", self.planner]
            yield f"- {first.cause.name}: `replan {shlex.join(words)}`"
            for run in self.runs:
                if run.change.name in first.cause.changes:
                    place = self.out / "changes"
                    words = ["compare", str(place / AS_IT_WAS), str(place / run.change.name)]
                    words += ["-p", self.planner, "-p", run.run.planners[0]]
                    yield f"  - {run.change.words}: `replan {shlex.join(words)}`"


class Cluster(msgspec.Struct):
    """A cluster in diagnosis.json, as far as reports need it."""

    cause: str
    why: str
    happens: str
    drives: list[str]


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
    if not file.exists():
        raise ConfigError(
            f"{file}: is not a diagnosis; `replan diagnose RUN -o {folder}` writes one"
        )
    found, card = read_json(file, DiagnosisSummary, f"`replan diagnose RUN -o {folder}` writes one")
    logs = {log for cluster in card.clusters for log in cluster.drives}
    if found["planner"] not in results.run.planners or not logs <= set(results.logs["log"]):
        raise ConfigError(f"{file}: is a diagnosis of another run than {results.path}")
    return found
