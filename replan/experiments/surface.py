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

import pandas as pd

from replan.config import RunConfig
from replan.core.names import counted
from replan.experiments.brackets import ERROR, Bracket, Cell, bisect_brackets, brackets
from replan.experiments.question import NAMED_DIGITS, SurfaceQuestion, check_agents
from replan.experiments.surface_figure import surface_figure
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
                f"{axis.name} {value:.4g}: "
                for axis, value in zip(self.question.axes[1:], edge.row, strict=True)
            )
            ends = f"{edge.low:.6g} ({edge.at_low}) and {edge.high:.6g} ({edge.at_high})"
            error = "" if edge.is_open else ", not narrower: an error between"
            lines.append(f"edge at {row}between {first.name} {ends}{error}")
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
    with claimed_folder(out, CONTENTS, resume=resume) as folder:
        Study(folder, study_head(CONTENTS.command, run, card), resume=resume)
        (folder / "logs").mkdir(exist_ok=True)
        write_json(folder / CARD, {"replan": replan_version(), **card})
        rounds = _Rounds(scenario, question, run, folder, workers, resume, say)
        cells = list(question.cells)
        outcomes = rounds.evaluate(cells, "grid")
        edges: tuple[Bracket, ...] = ()
        if not VARIATIONS[question.axes[0].name].is_choice:
            pairs = brackets(dict(zip(cells, outcomes, strict=True)))
            edges = bisect_brackets(pairs, rounds.between, question.resolution)
        result = VaryResult(folder, question, pd.DataFrame(rounds.rows), edges)
        _write(result, scenario, planner, rounds.deciding)
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
        self.rows: list[dict[str, str | float]] = []
        self.deciding: dict[str, str] = {}  # The metric of the first deciding gate, by log
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
        points = [self.question.values(cell) for cell in cells]
        logs = [_file_name(values) for values in points]
        makes = {
            self.out / "logs" / log: partial(varied, self.scenario, self.question.agents, values)
            for log, values in zip(logs, points, strict=True)
        }
        trials = drive_made(
            makes, self.run, self.out / part, workers=self.workers, resume=self.resume
        )
        verdicts = [CellVerdict.of(trial) for trial in trials]
        for trial, log in zip(trials, logs, strict=True):
            metrics = () if isinstance(trial, str) else deciding_verdicts(trial)["metric"]
            self.deciding[log] = next(iter(metrics), "")
        for values, verdict, log in zip(points, verdicts, logs, strict=True):
            self.rows.append({**values, "part": part, **asdict(verdict), "log": log})
        return [verdict.outcome for verdict in verdicts]


def deciding_verdicts(trial: Trial) -> pd.DataFrame:
    """The verdicts of the gates that decide the outcome of a trial; none if it passes."""
    verdicts, outcome = trial.verdicts, trial.outcome
    return verdicts[(verdicts["outcome"] == outcome.value) & (outcome is not Outcome.PASS)]


def _file_name(values: Mapping[str, float]) -> str:
    """A name that no other values have, also where it is shortened."""
    words = [f"{name}={value:.{NAMED_DIGITS}g}" for name, value in values.items()]
    return f"{safe_name(','.join(words))}.mcap"


@dataclass(frozen=True)
class CellVerdict:
    """The verdict of `replan evaluate` on a point.

    Attributes:
        outcome: As in the docstring of the module.
        gates: The gates that decide it, joined by "; "; `why` is the reason of the first one, or
            why the point could not be made or driven.
        end: How the drive ended.
        contact: What the ego touched at the end; "" if nothing. `contact_s` is the time, s.
        least_gap_m: Least gap to a road user, m; `least_gap_s` is its time, s.
        careful: Whether the careful driver avoids the contact; `careful_margin_m` is their least
            gap, m.
    """

    outcome: str
    gates: str = ""
    why: str = ""
    end: str = ""
    contact: str = ""
    contact_s: float = nan
    least_gap_m: float = nan
    least_gap_s: float = nan
    careful: str = ""
    careful_margin_m: float = nan

    @classmethod
    def of(cls, trial: Trial | str) -> CellVerdict:
        """The verdict on a trial, or on a point for which there is none, for a reason."""
        if isinstance(trial, str):
            return cls(ERROR, why=trial)
        outcome, values, drive = trial.outcome, trial.values(), trial.drive
        is_unavoidable = trial.careful is Avoidability.UNAVOIDABLE
        excused = outcome is Outcome.INCONCLUSIVE and is_unavoidable
        deciding = deciding_verdicts(trial)
        nearest = trial.metrics.loc[trial.metrics["metric"] == "gap.min", "time_s"]
        contact = drive.end in _CONTACTS
        return cls(
            UNAVOIDABLE if excused else outcome.value,
            "; ".join(deciding["gate"]),
            next(filter(None, deciding["reason"]), ""),
            drive.end,
            drive.detail if contact else "",
            drive.t_end_s if contact else nan,
            values.get("gap.min", nan),
            float(nearest.iloc[0]) if len(nearest) else nan,
            trial.careful.value,
            values.get(f"reference_cc.{MARGIN.name}", nan),
        )


# files --------------------------------------------------------------------------------------------


def _write(
    result: VaryResult, scenario: Scenario, planner: str, deciding: Mapping[str, str]
) -> None:
    folder, table, question = result.out, result.table, result.question
    write_table(folder, "surface", table)
    columns = [axis.name for axis in question.axes[1:]]
    columns += ["low", "high", "at_low", "at_high", "edge"]
    rows = [
        (*edge.row, edge.low, edge.high, edge.at_low, edge.at_high, edge.middle)
        for edge in result.edges
    ]
    write_csv(folder / "edges.csv", pd.DataFrame(rows, columns=columns))
    agents = ", ".join(map(scenario.short_names, question.agents))
    fixed = [f"{name} {VARIATIONS[name].shown(value)}" for name, value in question.fixed.items()]
    title = ", ".join([f"{scenario.name}: {planner}", *fixed])
    title += f"; varied: {agents}" if agents else ""
    figure = surface_figure(table, result.edges, question, deciding, title)
    figure.save(folder / "surface.png")
