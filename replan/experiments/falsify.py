"""A falsification: the mildest variation in which a planner fails and the reference driver does
not, and its files.

    OUT/falsify.json         the question, the result, and the printed sentences
    OUT/study.jsonl          the trials, a line each; `--resume` goes on from it
    OUT/trials.parquet, .csv the same as a table
    OUT/falsify.png          the trials over the two axes that the case moves most
    OUT/case.mcap            the mildest failing case as a native log; OUT/case/ its results with a
                             recording

The same subject, configuration and seed give the same bytes at any number of workers (the folder
`case` holds times).

A point counts if the planner fails a gate (FAIL of `replan.metrics.judge`, which excludes excused
values) that the reference driver keeps:

    the careful driver of UN R157   has no contact that it does not avoid (`reference_cc`), and its
                                    own drive holds the bound of the gate, where it is measured on
                                    it (safety, progress, comfort)
    another planner                 fails no gate at all, and drives the log to an end

(1) score = distance / D
        where the point counts; D is the distance of the box's farthest corner
(2) score = 1 + robustness               where the planner passes, or is judged inconclusive
(3) score = 2 + distance / D             where the reference driver fails, too
(4) score = 3 + distance / D             where there is no such scenario, or it could not be driven
(5) robustness = 1 - (mean over the gates of (1 + m)^-4)^(1/4)
    m = how far the value is within the bound, in bounds, 0 where it is not within;
        of a gate that allows no time beyond
    a bound (`ttc.time_below_950ms <= 0`) the extreme value and that bound
        are taken (`ttc.min`, 0.95 s); gates without a value, or with a bound of 0 that is of a
        count, are left out
"""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from math import inf, isfinite, nan
from pathlib import Path
from typing import Any

import pandas as pd

from replan.config import RunConfig
from replan.core.errors import ConfigError, LogError
from replan.core.names import counted
from replan.experiments.experiment_figures import falsify_figure
from replan.experiments.mildest import Mildest, Point, ScoredPoint, cma_class, norm, search
from replan.experiments.search_subject import SearchAxis, SearchSubject, box_of, values_at
from replan.experiments.trial import (
    QUIET,
    Trial,
    closed,
    drive_made,
    one_planner,
    scratch_folder,
    write_table,
)
from replan.logs.mcap import write_scenario
from replan.logs.scenario import Avoidability
from replan.metrics import METRICS
from replan.metrics.judge import CAREFUL
from replan.metrics.judge.gates import Gate, Outcome
from replan.results.tables import write_json
from replan.results.version import replan_version
from replan.run import evaluate_logs
from replan.run.checks import checked
from replan.run.claim import FolderContents, claimed_folder
from replan.run.judging import gates_of
from replan.run.resume import Study, study_head

KIND = "falsify"
CONTENTS = FolderContents(KIND, ("falsify.*", "trials.*", "case", "case.mcap"))
RESOLUTION = 0.02
"""Default resolution of the distance: a fiftieth of a scale."""
BUDGET = 200
POWER = 4.0
"""The exponent of (5)."""
FAIL, PASS, INCONCLUSIVE, BOTH, ERROR = "fail", "pass", "inconclusive", "both fail", "error"
"""Outcomes of a point; `BOTH`: the reference driver fails, too."""
WORDS = {
    FAIL: "fail",
    BOTH: "fail, as does the reference driver",
    ERROR: "cannot be made or driven",
}


@dataclass(frozen=True, eq=False)
class FalsifyQuestion:
    """The inputs of a falsification.

    Attributes:
        run: Planner (one) and settings; only the closed loop is run.
        against: "careful", or another planner.
        budget: Largest number of drives of the search.
        resolution: Resolution of the distance.
    """

    subject: SearchSubject
    axes: tuple[SearchAxis, ...]
    run: RunConfig
    against: str = CAREFUL
    budget: int = BUDGET
    seed: int = 0
    resolution: float = RESOLUTION

    @property
    def planner(self) -> str:
        """The planner that is searched."""
        return self.run.planners[0]

    @cached_property
    def driven(self) -> RunConfig:
        """The configuration of the run of each case."""
        planners = (
            self.run.planners if self.against == CAREFUL else (*self.run.planners, self.against)
        )
        return closed(self.run, planners=planners, **QUIET)

    @property
    def inputs(self) -> dict[str, Any]:
        """The inputs that identify a falsification with its run, except the budget and the
        resolution.
        """
        return {
            "log": self.subject.name,
            "agents": list(self.subject.agents),
            "against": self.against,
            "seed": self.seed,
            "axes": [asdict(axis) for axis in self.axes],
        }

    def head(self) -> dict[str, Any]:
        """The head of the study."""
        return study_head(KIND, self.driven, self.inputs)


@dataclass(frozen=True, slots=True)
class TriedPoint:
    """The result of one drive.

    Attributes:
        outcome: One of the outcomes above; "fail" is a point that counts.
        gates: The failed gates that count; if the point does not count, all gates that the planner
            fails.
        why: The reason of the first of them, otherwise the reason why there is no verdict.
        end: How the planner's drive ended.
        robustness: The value of (5); NaN if no gate has a value.
        value: The value of the first of these gates, in its unit; NaN if it has none.
    """

    outcome: str
    gates: tuple[str, ...] = ()
    why: str = ""
    end: str = ""
    robustness: float = nan
    value: float = nan

    def score(self, distance: float) -> float:
        """(1) to (4), the distance in parts of D."""
        if self.outcome == FAIL:
            return distance
        if self.outcome in (PASS, INCONCLUSIVE):
            return 1.0 + (self.robustness if isfinite(self.robustness) else 1.0)
        return (2.0 if self.outcome == BOTH else 3.0) + distance


def judged(trial: Trial, gates: Sequence[Gate], against: str) -> TriedPoint:
    """The case of a trial in a run of the planner and of `against`, unless that is "careful"."""
    verdicts, outcome, own, careful = (
        trial.verdicts,
        trial.outcome,
        trial.values(),
        trial.values(CAREFUL),
    )
    failed = verdicts[verdicts["outcome"] == Outcome.FAIL.value]
    if against != CAREFUL:
        other = replace(trial, planner=against).verdicts
        holds = len(other) and not (other["outcome"] == Outcome.FAIL.value).any()
        counts = tuple(failed["gate"]) if holds else ()
    elif trial.careful is Avoidability.UNAVOIDABLE:
        counts = ()
    else:
        known_gates = {str(gate): gate for gate in gates}
        breaks = {
            rule
            for rule, gate in known_gates.items()
            if gate.margin(careful.get(gate.metric, nan)) < 0.0
        }
        counts = tuple(rule for rule in failed["gate"] if rule not in breaks)
    shown = counts or tuple(failed["gate"])
    about = (
        failed[failed["gate"].isin(shown)]
        if shown
        else verdicts[verdicts["outcome"] == outcome.value]
    )
    why = next(filter(None, about["reason"]), "") if outcome is not Outcome.PASS else ""
    kind = FAIL if counts else BOTH if len(failed) else outcome.value
    value = float(about["value"].iloc[0]) if len(about) else nan
    return TriedPoint(kind, shown, why, str(trial.drive.end), robustness(gates, own), value)


def robustness(gates: Sequence[Gate], values: Mapping[str, float]) -> float:
    """The value of (5) for a drive's values by metric; NaN if no gate has a value."""
    near = []
    for gate in gates:
        value, bound = values.get(gate.metric, nan), gate.max if gate.min is None else gate.min
        assert bound is not None
        if bound == 0.0:
            name, _, reduced = gate.metric.rpartition(".")
            metric = METRICS.get(name.partition(".")[0])
            bounds = (
                next((one.bounds for one in metric.reductions if one.name == reduced), None)
                if metric
                else None
            )
            if bounds is None:
                continue  # there is no m: the gate is left out
            below = isfinite(bounds[0])
            bound, value = (
                bounds[0 if below else 1],
                values.get(f"{name}.{'min' if below else 'max'}", nan),
            )
            within = (
                max((value - bound if below else bound - value) / abs(bound), 0.0) if bound else nan
            )
        else:
            within = max(gate.margin(value) / abs(bound), 0.0) if isfinite(value) else nan
        if isfinite(within):
            near.append((1.0 + within) ** -POWER)
    return 1.0 - float((sum(near) / len(near)) ** (1.0 / POWER)) if near else nan


@dataclass(frozen=True, eq=False)
class Falsified:
    """The end of a falsification.

    Attributes:
        table: A row per trial.
        case: The row of the mildest case; empty if there is none.
    """

    out: Path
    question: FalsifyQuestion
    found: Mildest
    table: pd.DataFrame
    case: Mapping[str, Any]

    @property
    def exit_code(self) -> int:
        """1 if a case was found, otherwise 0."""
        return 0 if self.found.point is None else 1

    def lines(self) -> list[str]:
        """The result in sentences."""
        asked, found = self.question, self.found
        counts = Counter(self.table["outcome"])
        drives = ", ".join(f"{n} {WORDS.get(name, name)}" for name, n in counts.most_common())
        tried = f"{counted(len(self.table), 'drive')}: {drives}."
        if found.is_spent:
            tried += (
                f" The budget of {counted(asked.budget, 'drive')} ended the search: --budget "
                "N --resume goes on."
            )
        if found.point is None:
            over = ", ".join(f"{axis.name} {axis.low:g} to {axis.high:g}" for axis in asked.axes)
            return [
                f"No case found in which {asked.planner} fails and {asked_of(asked.against)} does "
                f"not ({over}).",
                tried,
            ]
        moved = [
            axis.shown(self.case[axis.name])
            for axis, u in zip(asked.axes, found.point, strict=True)
            if u
        ]
        place = f"at {', '.join(moved)}" if moved else "as recorded"
        said = [
            f"{asked.planner} fails at distance {found.distance:.3f} from {asked.subject.name}, "
            f"{place}, and"
            f" {asked_of(asked.against)} does not: {self.case['gates']}."
        ]
        value, why = self.case["value"], self.case["why"]
        measured = "" if value is None or not isfinite(value) else f"the value is {value:.4g}"
        if measured or why:
            said.append(f"Of the first gate: {'; '.join(filter(None, (measured, why)))}.")
        if isfinite(found.passes):
            gap = found.distance - found.passes
            less = f"at distance {found.passes:.3f} ({gap:.3f} less)"
            said.append(f"On the line to the recorded case it does not fail so {less}.")
        return [*said, tried]

    def next_steps(self) -> list[str]:
        """Commands that show the case; empty if there is none."""
        if self.found.point is None:
            return []
        again = (
            f"replan evaluate {self.out / 'case.mcap'} --config {self.out / 'case' / 'run.toml'}"
        )
        return [f"drive it again: {again}", f"look at it: replan view {self.out / 'case'}"]


def asked_of(against: str) -> str:
    """The reference driver in words."""
    return "the careful driver" if against == CAREFUL else against


def falsify(
    question: FalsifyQuestion,
    out: Path | None,
    *,
    workers: int = 0,
    resume: bool = False,
    say: Callable[[str], None] = lambda line: None,
) -> Falsified:
    """Search, and write the result into `out`; the arguments are those of `replan.experiments`.

    Raises:
        ConfigError: A wrong setting, a folder that must not be written, nothing to resume, or cmaes
            is not installed.
        LogError: The recorded case could not be driven.
        PlannerError: The planner cannot be loaded.
    """
    one_planner(question.run, "a falsification")
    if question.against == question.planner:
        raise ConfigError(f"--against {question.against}: is the planner itself")
    cma_class(question.budget)
    _, failures = checked(question.driven)
    if failures:
        raise ConfigError(failures[0].message)
    with claimed_folder(out, CONTENTS, resume=resume) as out:
        study = Study(out, question.head(), resume=resume)
        trials = SearchDrives(question, out, study, workers, say)
        found = search(
            box_of(question.axes),
            trials,
            budget=question.budget,
            seed=question.seed,
            resolution=question.resolution,
        )
        table = (
            pd.DataFrame(trials.rows)
            .drop(columns="key")
            .astype({"robustness": float, "value": float})
        )
        result = Falsified(out, question, found, table, trials.row_of(found.point))
        _write(result, workers)
    return result


class SearchDrives:
    """Evaluates points batch by batch (`replan.experiments.mildest.Evaluate`), and keeps their
    rows.
    """

    def __init__(
        self,
        question: FalsifyQuestion,
        out: Path,
        study: Study,
        workers: int,
        say: Callable[[str], None],
    ) -> None:
        self._question, self._out, self._study, self._workers, self._say = (
            question,
            out,
            study,
            workers,
            say,
        )
        self._gates = gates_of(question.driven, question.driven.gates_path).gates
        self._farthest = norm(abs(box_of(question.axes)).max(axis=0))
        self.rows: list[dict[str, Any]] = []

    def __call__(self, points: Sequence[Point], part: str) -> list[ScoredPoint]:
        """As `replan.experiments.mildest.Evaluate`.

        Points in the study file are not driven again.
        """
        new = [point for point in points if self._study.known(_key(point)) is None]
        if new:
            cases = zip(new, self._drive_points(new), strict=True)
            self._study.add(
                {
                    "key": _key(point),
                    "part": part,
                    **values_at(self._question.axes, point),
                    "distance": norm(point),
                    "outcome": case.outcome,
                    "score": case.score(norm(point) / self._farthest),
                    "robustness": case.robustness if isfinite(case.robustness) else None,
                    "gates": "; ".join(case.gates),
                    "value": case.value if isfinite(case.value) else None,
                    "why": case.why,
                    "end": case.end,
                }
                for point, case in cases
            )
        rows = [self._study.known(_key(point)) or {} for point in points]
        self.rows += [{"trial": len(self.rows) + k, **row} for k, row in enumerate(rows)]
        first = self.rows[0]
        if first["outcome"] == ERROR:
            raise LogError(
                f"the recorded case could not be driven: {first['why']}",
                file=self._question.subject.name,
            )
        least = min((row["distance"] for row in self.rows if row["outcome"] == FAIL), default=inf)
        best = (
            f"mildest failure at distance {least:.3f}"
            if least < inf
            else "no failure that counts yet"
        )
        self._say(
            f"{part}: {len(self.rows)} of at most {counted(self._question.budget, 'drive')}, {best}"
        )
        return [ScoredPoint(row["score"], row["outcome"] == FAIL) for row in rows]

    def row_of(self, point: Point | None) -> Mapping[str, Any]:
        """The row of a point; empty for None."""
        return {} if point is None else next(row for row in self.rows if row["key"] == _key(point))

    def _drive_points(self, points: Sequence[Point]) -> list[TriedPoint]:
        """Drive points, and return their cases."""
        asked = self._question
        with scratch_folder(self._out, "batch") as scratch:
            (scratch / "logs").mkdir(parents=True)
            makes = {
                scratch / "logs" / f"{k}.mcap": partial(
                    asked.subject.at, asked.axes, values_at(asked.axes, point)
                )
                for k, point in enumerate(points)
            }
            found = drive_made(makes, asked.driven, scratch / "results", workers=self._workers)
            return [
                TriedPoint(ERROR, why=one)
                if isinstance(one, str)
                else judged(one, self._gates, asked.against)
                for one in found
            ]


def _key(point: Point) -> str:
    return " ".join(f"{u:.10g}" for u in point)


def _write(result: Falsified, workers: int) -> None:
    out, asked, found = result.out, result.question, result.found
    write_table(out, "trials", result.table)
    title = f"{asked.subject.name}: {asked.planner}"
    falsify_figure(result.table, asked.axes, result.case, title).save(out / "falsify.png")
    for old in ("case.mcap", "case"):
        path = out / old
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    if found.point is not None:
        write_scenario(
            out / "case.mcap", asked.subject.at(asked.axes, values_at(asked.axes, found.point))
        )
        shown = replace(asked.driven, recording=True, internals="summary")
        evaluate_logs([out / "case.mcap"], shown, out / "case", workers=min(workers, 1))
    card = {
        "replan": replan_version(),
        **asked.inputs,
        "planner": asked.planner,
        "budget": asked.budget,
        "resolution": asked.resolution,
        "falsified": found.point is not None,
        "distance": found.distance if isfinite(found.distance) else None,
        "passes_at": found.passes if isfinite(found.passes) else None,
        "case": {axis.name: result.case[axis.name] for axis in asked.axes} if result.case else None,
        "gates": result.case.get("gates", "").split("; ") if result.case else [],
        "drives": len(result.table),
        "budget_spent": result.found.is_spent,
        "outcomes": dict(Counter(result.table["outcome"])),
        "said": result.lines(),
        "exit_code": result.exit_code,
    }
    write_json(out / "falsify.json", card)
