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
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from math import isfinite, nan
from pathlib import Path
from typing import Any

import pandas as pd

from replan.config import RunConfig
from replan.core.errors import ConfigError, LogError
from replan.core.names import counted
from replan.experiments.falsify_figure import falsify_figure
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
PASS, FAIL, INCONCLUSIVE = "pass", "fail", "inconclusive"
BOTH, ERROR = "both fail", "error"
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
        others = () if self.against == CAREFUL else (self.against,)
        return closed(self.run, planners=(*self.run.planners, *others), **QUIET)

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
    verdicts, outcome = trial.verdicts, trial.outcome
    failed = verdicts[verdicts["outcome"] == Outcome.FAIL.value]
    counting = _counting(trial, gates, tuple(failed["gate"]), against)
    cited_gates = counting or tuple(failed["gate"])
    cited = verdicts["gate"].isin(cited_gates) & (verdicts["outcome"] == Outcome.FAIL.value)
    rows = verdicts[cited if cited_gates else verdicts["outcome"] == outcome.value]
    kind = outcome.value
    if counting:
        kind = FAIL
    elif len(failed):
        kind = BOTH
    why = next(filter(None, rows["reason"]), "") if outcome is not Outcome.PASS else ""
    value = float(rows["value"].iloc[0]) if len(rows) else nan
    margin = robustness(gates, trial.values())
    return TriedPoint(kind, cited_gates, why, str(trial.drive.end), margin, value)


def _counting(
    trial: Trial, gates: Sequence[Gate], failed: tuple[str, ...], against: str
) -> tuple[str, ...]:
    """The failed gates that the reference driver keeps."""
    if against != CAREFUL:
        verdicts = replace(trial, planner=against).verdicts
        fails = (verdicts["outcome"] == Outcome.FAIL.value).any()
        return failed if len(verdicts) and not fails else ()
    if trial.careful is Avoidability.UNAVOIDABLE:
        return ()
    values = trial.values(CAREFUL)
    broken = {str(gate) for gate in gates if gate.margin(values.get(gate.metric, nan)) < 0.0}
    return tuple(gate for gate in failed if gate not in broken)


def robustness(gates: Sequence[Gate], values: Mapping[str, float]) -> float:
    """The value of (5) for a drive's values by metric; NaN if no gate has a value."""
    margins = [_bounds_within(gate, values) for gate in gates]
    nearness = [(1.0 + margin) ** -POWER for margin in margins if isfinite(margin)]
    if not nearness:
        return nan
    return 1.0 - float((sum(nearness) / len(nearness)) ** (1.0 / POWER))


def _bounds_within(gate: Gate, values: Mapping[str, float]) -> float:
    """M of (5); NaN if the gate is left out."""
    bound = gate.max if gate.min is None else gate.min
    assert bound is not None
    if bound != 0.0:
        value = values.get(gate.metric, nan)
        return max(gate.margin(value) / abs(bound), 0.0) if isfinite(value) else nan
    name, _, reduced = gate.metric.rpartition(".")
    metric = METRICS.get(name.partition(".")[0])
    reductions = () if metric is None else metric.reductions
    bounds = next((part.bounds for part in reductions if part.name == reduced), None)
    if bounds is None:
        return nan
    least, most = bounds
    if isfinite(least):
        bound, within = least, values.get(f"{name}.min", nan) - least
    else:
        bound, within = most, most - values.get(f"{name}.max", nan)
    return max(within / abs(bound), 0.0) if bound else nan


@dataclass(frozen=True, eq=False)
class Falsified:
    """The end of a falsification.

    Attributes:
        table: A row per trial.
        case: The row of the mildest case; empty if there is none.
    """

    out: Path
    question: FalsifyQuestion
    mildest: Mildest
    table: pd.DataFrame
    case: Mapping[str, Any]

    @property
    def exit_code(self) -> int:
        """1 if a case was found, otherwise 0."""
        return 0 if self.mildest.point is None else 1

    def lines(self) -> list[str]:
        """The result in sentences."""
        question = self.question
        counts = Counter(self.table["outcome"]).most_common()
        drives = ", ".join(f"{number} {WORDS.get(name, name)}" for name, number in counts)
        tried = f"{counted(len(self.table), 'drive')}: {drives}."
        if self.mildest.is_spent:
            tried += (
                f" The budget of {counted(question.budget, 'drive')} ended the search: --budget "
                "N --resume goes on."
            )
        if self.mildest.point is None:
            ranges = [f"{axis.name} {axis.low:g} to {axis.high:g}" for axis in question.axes]
            return [
                f"No case found in which {question.planner} fails and "
                f"{asked_of(question.against)} does not ({', '.join(ranges)}).",
                tried,
            ]
        return [*self._case_lines(self.mildest.point), tried]

    def _case_lines(self, point: Point) -> Iterator[str]:
        """The mildest case in sentences."""
        question, distance, passes = self.question, self.mildest.distance, self.mildest.passes
        axes = zip(question.axes, point, strict=True)
        moved = [axis.shown(self.case[axis.name]) for axis, u in axes if u]
        place = f"at {', '.join(moved)}" if moved else "as recorded"
        yield (
            f"{question.planner} fails at distance {distance:.3f} from {question.subject.name}, "
            f"{place}, and {asked_of(question.against)} does not: {self.case['gates']}."
        )
        value, why = self.case["value"], self.case["why"]
        measured = "" if value is None or not isfinite(value) else f"the value is {value:.4g}"
        if measured or why:
            yield f"Of the first gate: {'; '.join(filter(None, (measured, why)))}."
        if isfinite(passes):
            nearer = f"at distance {passes:.3f} ({distance - passes:.3f} less)"
            yield f"On the line to the recorded case it does not fail so {nearer}."

    def next_steps(self) -> list[str]:
        """Commands that show the case; empty if there is none."""
        if self.mildest.point is None:
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
    with claimed_folder(out, CONTENTS, resume=resume) as folder:
        study = Study(folder, question.head(), resume=resume)
        trials = SearchDrives(question, folder, study, workers, say)
        mildest = search(
            box_of(question.axes),
            trials,
            budget=question.budget,
            seed=question.seed,
            resolution=question.resolution,
        )
        table = pd.DataFrame(trials.rows).drop(columns="key")
        table = table.astype({"robustness": float, "value": float})
        result = Falsified(folder, question, mildest, table, trials.row_of(mildest.point))
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
        self._question, self._out, self._study = question, out, study
        self._workers, self._say = workers, say
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
        distances = [row["distance"] for row in self.rows if row["outcome"] == FAIL]
        best = "no failure that counts yet"
        if distances:
            best = f"mildest failure at distance {min(distances):.3f}"
        most = counted(self._question.budget, "drive")
        self._say(f"{part}: {len(self.rows)} of at most {most}, {best}")
        return [ScoredPoint(row["score"], row["outcome"] == FAIL) for row in rows]

    def row_of(self, point: Point | None) -> Mapping[str, Any]:
        """The row of a point; empty for None."""
        return {} if point is None else next(row for row in self.rows if row["key"] == _key(point))

    def _drive_points(self, points: Sequence[Point]) -> list[TriedPoint]:
        """Drive points, and return their cases."""
        question = self._question
        with scratch_folder(self._out, "batch") as scratch:
            (scratch / "logs").mkdir(parents=True)
            makes = {}
            for number, point in enumerate(points):
                values = values_at(question.axes, point)
                file = scratch / "logs" / f"{number}.mcap"
                makes[file] = partial(question.subject.at, question.axes, values)
            results = scratch / "results"
            trials = drive_made(makes, question.driven, results, workers=self._workers)
            return [
                TriedPoint(ERROR, why=trial)
                if isinstance(trial, str)
                else judged(trial, self._gates, question.against)
                for trial in trials
            ]


def _key(point: Point) -> str:
    return " ".join(f"{u:.10g}" for u in point)


def _write(result: Falsified, workers: int) -> None:
    folder, question, mildest = result.out, result.question, result.mildest
    write_table(folder, "trials", result.table)
    title = f"{question.subject.name}: {question.planner}"
    falsify_figure(result.table, question.axes, result.case, title).save(folder / "falsify.png")
    for name in ("case.mcap", "case"):
        old = folder / name
        shutil.rmtree(old) if old.is_dir() else old.unlink(missing_ok=True)
    if mildest.point is not None:
        values = values_at(question.axes, mildest.point)
        write_scenario(folder / "case.mcap", question.subject.at(question.axes, values))
        run = replace(question.driven, recording=True, internals="summary")
        evaluate_logs([folder / "case.mcap"], run, folder / "case", workers=min(workers, 1))
    case = {axis.name: result.case[axis.name] for axis in question.axes} if result.case else None
    card = {
        "replan": replan_version(),
        **question.inputs,
        "planner": question.planner,
        "budget": question.budget,
        "resolution": question.resolution,
        "falsified": mildest.point is not None,
        "distance": mildest.distance if isfinite(mildest.distance) else None,
        "passes_at": mildest.passes if isfinite(mildest.passes) else None,
        "case": case,
        "gates": result.case.get("gates", "").split("; ") if result.case else [],
        "drives": len(result.table),
        "budget_spent": mildest.is_spent,
        "outcomes": dict(Counter(result.table["outcome"])),
        "said": result.lines(),
        "exit_code": result.exit_code,
    }
    write_json(folder / "falsify.json", card)
