"""Evaluates a surface, the outcome of a drive over a grid of parameters (cells), and the edges
where it changes.

    OUT/vary.json              the question
    OUT/logs/                  the varied logs: `replan evaluate --mode closed` of one gives the
                               outcome of its cell
    OUT/grid/, OUT/edge-1/ ... results of the cells, and of the points between them, as `replan evaluate` leaves them
    OUT/surface.parquet, .csv  a row per point: parameters, outcome, gates, least gap, contact,
                               careful driver
    OUT/edges.csv              where rows change from pass to another outcome
    OUT/surface.png            the picture

The outcome of a point is the worst outcome of the gates on its log: "pass", "fail" or
"inconclusive". An inconclusive point where the careful driver of UN R157 collides is "unavoidable";
"error" is a point that could not be made or driven. Points without a log, and logs that cannot be
driven, do not stop the others.

The change of a row from pass to another outcome is found by bisection between two cells, in all
rows at once, so that the points of a round are evaluated in parallel.
"""  # noqa: E501

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from math import nan
from pathlib import Path
from typing import Any

import pandas as pd

from replan.config import RunConfig
from replan.core.names import counted
from replan.experiments.brackets import ERROR, Bracket, Cell, bisect_brackets, brackets
from replan.experiments.experiment_figures import surface_figure
from replan.experiments.question import NAMED_DIGITS, SurfaceQuestion, check_agents
from replan.experiments.trial import Trial, closed, drive_made, one_planner, write_table
from replan.logs.edit.variations import VARIATIONS, varied
from replan.logs.scenario import Avoidability, Scenario
from replan.logs.trace import EndReason
from replan.metrics.judge.gates import Outcome
from replan.metrics.reference_drivers import MARGIN
from replan.results.tables import safe_name, write_csv, write_json
from replan.results.version import replan_version
from replan.run.claim import FolderContents, claimed_folder
from replan.run.resume import Study, study_head

UNAVOIDABLE = "unavoidable"
CARD = "vary.json"
"""The file of the question."""
CONTENTS = FolderContents("vary", (CARD, "logs", "grid", "edge-*", "surface.*", "edges.csv"))
_CONTACTS = (EndReason.COLLISION.value, EndReason.REPLAY_CONTACT.value)


# surface ------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class VaryResult:
    """The result of a surface.

    Attributes:
        table: A row per point that was evaluated: the grid first, then the points between.
        edges: The brackets in which rows change, to the resolution of the question.
    """

    out: Path
    question: SurfaceQuestion
    table: pd.DataFrame
    edges: tuple[Bracket, ...]

    @property
    def exit_code(self) -> int:
        """3 if a point could not be evaluated, otherwise 0."""
        return 3 if (self.table["outcome"] == ERROR).any() else 0

    def lines(self) -> list[str]:
        """The result as text."""
        first = self.question.axes[0]
        counts = self.table.loc[self.table["part"] == "grid", "outcome"].value_counts()
        lines = [f"cells: {', '.join(f'{n} {name}' for name, n in counts.items())}"]
        for edge in self.edges:
            row = "".join(
                f"{axis.name} {v:.4g}: "
                for axis, v in zip(self.question.axes[1:], edge.row, strict=True)
            )
            between = (
                f"{first.name} {edge.low:.6g} ({edge.at_low}) and {edge.high:.6g} ({edge.at_high})"
            )
            lines.append(
                f"edge at {row}between "
                f"{between}{'' if edge.is_open else ', not narrower: an error between'}"
            )
        broken = self.table[self.table["outcome"] == ERROR]
        lines += [
            f"error: {name}: {why}" for name, why in zip(broken["log"], broken["why"], strict=True)
        ]
        return [*lines, f"written to {self.out}"]


def vary(
    scenario: Scenario,
    question: SurfaceQuestion,
    run: RunConfig,
    out: Path | None,
    *,
    workers: int = 0,
    resume: bool = False,
    say: Callable[[str], None] = lambda line: None,
) -> VaryResult:
    """Evaluate a surface of a scenario, which is `prepared`, and write it into `out`.

    Only the closed loop of one planner is run, and log settings are not applied again. The
    arguments are those of `replan.experiments`.

    Raises:
        ConfigError: A wrong setting, an unknown agent, a folder with foreign files, or in use.
    """
    planner, run = one_planner(run, "a surface"), closed(run)
    inserted = (VARIATIONS[name].inserts for name in question.values(next(question.cells)))
    check_agents(
        question.agents, [*scenario.tracks.ids, *inserted], required=question.varies_agents
    )
    card = {
        "log": scenario.name,
        "planner": planner,
        "axes": [asdict(axis) for axis in question.axes],
        "fixed": dict(question.fixed),
        "agents": list(question.agents),
        "resolution": question.resolution,
    }
    with claimed_folder(out, CONTENTS, resume=resume) as out:
        Study(out, study_head(CONTENTS.command, run, card), resume=resume)
        (out / "logs").mkdir(exist_ok=True)
        write_json(out / CARD, {"replan": replan_version(), **card})
        rounds = _Rounds(scenario, question, run, out, workers, resume, say)
        rounds.evaluate(list(question.cells), "grid")
        edges: tuple[Bracket, ...] = ()
        if not VARIATIONS[question.axes[0].name].is_choice:
            found = brackets({row["cell"]: row["outcome"] for row in rounds.rows})
            edges = bisect_brackets(found, rounds.between, question.resolution)
        table = pd.DataFrame([{**row, "cell": None} for row in rounds.rows]).drop(columns="cell")
        result = VaryResult(out, question, table, edges)
        _write(result, scenario, planner)
        return result


# points -------------------------------------------------------------------------------------------


@dataclass
class _Rounds:
    """Evaluates points round by round, and keeps their rows."""

    scenario: Scenario
    question: SurfaceQuestion
    run: RunConfig
    out: Path
    workers: int
    resume: bool
    say: Callable[[str], None]

    def __post_init__(self) -> None:
        self.rows: list[dict[str, Any]] = []
        self.count = 0

    def between(self, cells: Sequence[Cell]) -> list[str]:
        """Evaluate a round of points between cells in a folder of its own.

        Return their outcomes.
        """
        self.count += 1
        return self.evaluate(cells, f"edge-{self.count}")

    def evaluate(self, cells: Sequence[Cell], part: str) -> list[str]:
        """Drive a round of points, add their rows, and return their outcomes."""
        self.say(f"{part}: {counted(len(cells), 'point')}")
        makes = {}
        for cell in cells:
            values = self.question.values(cell)
            makes[self.out / "logs" / _file_name(values)] = partial(
                varied, self.scenario, self.question.agents, values
            )
        trials = drive_made(
            makes, self.run, self.out / part, workers=self.workers, resume=self.resume
        )
        for cell, trial in zip(cells, trials, strict=True):
            outcome = _error_row(trial) if isinstance(trial, str) else _judge_cell(trial)
            log = _file_name(self.question.values(cell))
            self.rows.append(
                {"cell": cell, **self.question.values(cell), "part": part, **outcome, "log": log}
            )
        return [row["outcome"] for row in self.rows[-len(cells) :]]


def _file_name(values: Mapping[str, float]) -> str:
    """A name that no other values have, also where it is shortened."""
    words = [f"{name}={value:.{NAMED_DIGITS}g}" for name, value in values.items()]
    return f"{safe_name(','.join(words))}.mcap"


def _error_row(why: str) -> dict[str, Any]:
    return {
        "outcome": ERROR,
        "gates": "",
        "why": why,
        "end": "",
        "contact": "",
        "contact_s": nan,
        "least_gap_m": nan,
        "least_gap_s": nan,
        "careful": "",
        "careful_margin_m": nan,
    }


def _judge_cell(trial: Trial) -> dict[str, Any]:
    """The verdict of `replan evaluate` on a trial, in one row."""
    outcome, careful, values, drive = trial.outcome, trial.careful, trial.values(), trial.drive
    excused = outcome is Outcome.INCONCLUSIVE and careful is Avoidability.UNAVOIDABLE
    verdicts = trial.verdicts
    blamed = verdicts[(verdicts["outcome"] == outcome.value) & (outcome is not Outcome.PASS)]
    nearest = trial.metrics.loc[trial.metrics["metric"] == "gap.min", "time_s"]
    contact = drive.end in _CONTACTS
    return {
        "outcome": UNAVOIDABLE if excused else outcome.value,
        "gates": "; ".join(blamed["gate"]),
        "why": next(filter(None, blamed["reason"]), ""),
        "end": drive.end,
        "contact": drive.detail if contact else "",
        "contact_s": drive.t_end_s if contact else nan,
        "least_gap_m": values.get("gap.min", nan),
        "least_gap_s": float(nearest.iloc[0]) if len(nearest) else nan,
        "careful": careful.value,
        "careful_margin_m": values.get(f"reference_cc.{MARGIN.name}", nan),
    }


# files --------------------------------------------------------------------------------------------


def _write(result: VaryResult, scenario: Scenario, planner: str) -> None:
    out, table, question = result.out, result.table, result.question
    write_table(out, "surface", table)
    columns = [
        *(axis.name for axis in question.axes[1:]),
        "low",
        "high",
        "at_low",
        "at_high",
        "edge",
    ]
    rows = [
        (*one.row, one.low, one.high, one.at_low, one.at_high, one.middle) for one in result.edges
    ]
    write_csv(out / "edges.csv", pd.DataFrame(rows, columns=columns))
    about = (
        f"; varied: {', '.join(map(scenario.short_names, question.agents))}"
        if question.agents
        else ""
    )
    fixed = "".join(
        f", {name} {VARIATIONS[name].shown(value)}" for name, value in question.fixed.items()
    )
    title = f"{scenario.name}: {planner}{fixed}{about}"
    surface_figure(table, result.edges, question, title).save(out / "surface.png")
