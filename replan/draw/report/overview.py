"""The overview of a run: its tables, as the sections of all reports need them.

result = load("results/run-001")
print_report(overview(result), Console(), result.path)

It contains no times of day, only the planning times of the run, and no path outside of the result
folder: the reports of a folder are the same, byte for byte, wherever the folder is.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from math import isfinite, nan
from pathlib import Path
from typing import Any

import pandas as pd
import tomli_w

from replan.core.files import read_toml
from replan.core.names import counted
from replan.draw.drawn_results import Results
from replan.draw.report.drive_table import (
    COLUMNS,
    DriveRow,
    MetricColumn,
    Values,
    drive_rows,
    marked,
)
from replan.draw.report.section import unit_suffix
from replan.metrics.comparison import Comparison
from replan.metrics.judge import outcomes
from replan.metrics.judge.aggregate import (
    BOTH,
    SUITE,
    LogLabels,
    membership,
    pass_shares,
    standings,
)
from replan.metrics.judge.deadline import judge_deadline
from replan.metrics.judge.gates import Outcome
from replan.results.tables import OUTCOMES

EXIT_WEIGHT = (2, 3, 1, 4, 0)
"""Exit codes by priority: several codes are combined into the first in this order (3 beats 1 beats
4).
"""
WORST = "worst"  # `over` of the gates that each log passes or fails by itself
MOST_FIRST = 3  # Number of drives that a report shows first
COUNTS = ("passed", "failed", "inconclusive", "missing")  # Columns of `pass_shares`
NOISE = 1e-9  # Smaller values are shown as 0


@dataclass(frozen=True)
class GateRow:
    """The verdict of a gate on one planner in one loop, over all logs or a group of them."""

    outcome: str  # "pass", "fail" or "inconclusive"
    rule: str  # "gap.min >= 0.5 [closed]"
    over: str  # The values that must pass: "worst" (every log), or an aggregate of the logs
    # In short: if it passes, the value nearest to the bound, otherwise the reason
    finding: str
    reason: str
    planner: str  # planner, mode: "" if there was no drive to judge
    mode: str
    group: str  # The group of logs, for a gate over groups; otherwise ""
    log: str  # The worst log; "" if there is none


ANSWERED: tuple[tuple[str, Callable[[list[float]], str]], ...] = (
    ("collision_at_fault.count", lambda values: f"{sum(values):.0f} collisions at fault"),
    ("goal.final", lambda values: f"{sum(values):.0f} of {counted(len(values), 'goal')}"),
    (
        "lon_accel.time_out_of_bounds",
        lambda values: f"{sum(values):.1f} s beyond -4.05 or 2.40 m/s2",
    ),
    ("nuplan_closed.score.final", lambda values: f"nuPlan's score {sum(values) / len(values):.2f}"),
)
"""Metric of the closed loop, and its values over the logs in words: the answer of a report."""


@dataclass(frozen=True, eq=False)
class Overview:
    """A finished run, with the tables that its reports show."""

    results: Results
    outcome: str  # outcome, exit_code: Those of `replan evaluate`
    exit_code: int
    config: str  # First 12 hex digits of the SHA-256 of the resolved configuration
    columns: Sequence[MetricColumn]  # The columns of the table of drives
    drives: Sequence[DriveRow]  # The worst first
    planners: Mapping[str, str]  # Names of the planners with their marks
    values: Values  # The available values
    over_logs: Mapping[tuple[str, str, str], list[float]]  # By planner, mode and metric
    timings: pd.DataFrame  # Times of the stages of planning
    verdicts: pd.DataFrame  # `log_outcomes`
    gates: Sequence[GateRow]  # Failed and inconclusive gates first
    standings: pd.DataFrame  # Rows of `replan.metrics.judge.aggregate.standings`
    # Rows of `replan.metrics.judge.aggregate.pass_shares`; empty for a shard, which is not judged
    shares: pd.DataFrame
    comparison: Comparison | None  # The comparison with a baseline, if there is one
    # The contents of diagnosis.json, if `replan diagnose` was run
    diagnosis: Mapping[str, Any] | None = None
    # Parts of reports that could not be made, a sentence each; known after they are written
    broken: Sequence[str] = ()

    @property
    def replan(self) -> str:
        """Version of replan that ran the drives."""
        return str(self.results.summary["replan"])

    @property
    def verdict(self) -> str:
        """The outcome in a sentence."""
        if self.shard:
            return f"{self.outcome.upper()}: a shard"
        counts = Counter(gate.outcome for gate in self.gates)
        failed, unclear = counts[Outcome.FAIL.value], counts[Outcome.INCONCLUSIVE.value]
        lost = len(self.results.summary["failures"])
        verdicts = f"{failed} of {counted(len(self.gates), 'verdict')} of gates fail"
        verdicts += f", {unclear} are inconclusive" if unclear else ""
        verdicts += f"; {counted(lost, 'failure')} to evaluate" if lost else ""
        return f"{self.outcome.upper()}: {verdicts}"

    @property
    def shard(self) -> str:
        """The part of a run that this is, which is not judged: "2/5"; "" for a whole run."""
        return str(self.results.summary.get("shard", ""))

    @property
    def first(self) -> list[DriveRow]:
        """The drives to look at first: the worst of those that do not pass, at most
        `MOST_FIRST`.
        """
        return [row for row in self.drives[:MOST_FIRST] if row.verdict != Outcome.PASS.value]

    @property
    def whole(self) -> pd.DataFrame:
        """The pass shares over all logs, one per planner: of both loops together where both were
        run.
        """
        shares = self.shares[self.shares["kind"] == SUITE]
        together = shares["mode"] == BOTH
        return shares[together | ~shares["planner"].isin(shares.loc[together, "planner"])]

    @property
    def grouped(self) -> pd.DataFrame:
        """The pass shares of groups of at least two logs, but not all, over the loops that were
        run, sorted.
        """
        modes = dict(self.whole[["planner", "mode"]].itertuples(index=False, name=None))
        is_run = self.shares["mode"] == self.shares["planner"].map(modes)
        is_group = self.shares["logs"].between(2, len(self.results.logs) - 1)
        return self.shares[is_run & is_group].sort_values("mean", kind="stable")

    @property
    def answers(self) -> list[tuple[str, str]]:
        """How each planner did, in one line: its pass share over the loops that were run, and
        `ANSWERED` where available.
        """
        shares = {row.planner: row for row in list[Any](self.whole.itertuples())}
        lines = []
        for planner, shown in self.planners.items():
            parts = [_share_of_all(shares[planner])] if planner in shares else []
            for metric, words in ANSWERED:
                if values := self.over_logs.get((planner, "closed", metric)):
                    parts.append(words(values))
            lines.append((shown, "; ".join(parts)))
        return lines


def overview(
    results: Results,
    comparison: Comparison | None = None,
    diagnosis: Mapping[str, Any] | None = None,
) -> Overview:
    """The overview of a finished run.

    `results`: the results, from `replan.draw.drawn_results.load`. `comparison`: the comparison with
    a baseline; outcome and exit code are then the worse of both. `diagnosis`: the contents of
    diagnosis.json of the run.
    """
    code = combined((results.exit_code, comparison.exit_code if comparison else 0))
    available = results.measured[results.measured["available"].astype(bool)]
    keys = available[["log", "planner", "mode", "metric"]].itertuples(index=False, name=None)
    values = dict(zip(keys, map(float, available["value"]), strict=True))
    over_logs: dict[tuple[str, str, str], list[float]] = {}
    for (_, planner, mode, metric), value in values.items():
        over_logs.setdefault((planner, mode, metric), []).append(value)
    modes = {mode.value for mode in results.run.modes}
    columns = [column for column in COLUMNS if column.mode in modes]
    verdicts = log_outcomes(results)
    labels = results.labels | dict.fromkeys(results.unread, LogLabels())
    crashed = [(row["log"], row["planner"], row["mode"]) for row in results.summary["failures"]]
    stand = standings(verdicts, results.drives, list(labels), results.run.drives, crashed)
    shares = pass_shares(stand, labels).astype(dict.fromkeys(COUNTS, "int64"))
    settings = read_toml(results.path / "run.toml")
    settings.pop("selection", None)  # the places of logs
    return Overview(
        results=results,
        outcome=str(results.summary["outcome"]) if code == results.exit_code else OUTCOMES[code],
        exit_code=code,
        config=sha256(tomli_w.dumps(settings).encode()).hexdigest()[:12],
        columns=columns,
        drives=drive_rows(results, values, verdicts, columns),
        planners={
            str(planner): marked(list(drives.itertuples()))
            for planner, drives in results.drives.groupby("planner", sort=False)
        },
        values=values,
        over_logs=over_logs,
        timings=results.timings,
        verdicts=verdicts,
        gates=_gate_rows(results, verdicts),
        standings=stand,
        shares=shares.head(0) if "shard" in results.summary else shares,
        comparison=comparison,
        diagnosis=diagnosis,
    )


def combined(codes: Iterable[int]) -> int:
    """Several exit codes as one."""
    return min(codes, key=EXIT_WEIGHT.index, default=0)


def log_outcomes(results: Results) -> pd.DataFrame:
    """The verdict of each gate on each log, `Results.verdicts`, and of the deadline, if there is
    one.
    """
    deadline_s = results.run.deadline_s
    late = judge_deadline(results.timings, deadline_s, results.labels) if deadline_s > 0.0 else ()
    tables = [results.verdicts, outcomes(late)] if late else [results.verdicts]
    return pd.concat(tables, ignore_index=True)


def without_folders(results: Results) -> Callable[[str], str]:
    """A function that removes the folders of the logs from a text."""
    paths = [Path(source) for source in results.logs["source"]]
    folders = {f"{path.parent}{os.sep}" for path in paths if path.is_absolute()}
    if not folders:
        return str
    longest_first = sorted(folders, key=len, reverse=True)
    return partial(re.compile("|".join(map(re.escape, longest_first))).sub, "")


def failure_lines(over: Overview) -> Iterator[tuple[tuple[str, str, str, str], str]]:
    """Each gate that fails on a log: (gate, log, planner, loop), and a line with log, rule, value,
    time and reason.
    """
    units = dict(zip(over.results.measured["metric"], over.results.measured["unit"], strict=True))
    short = without_folders(over.results)
    together = {gate.rule for gate in over.gates if gate.over != WORST}
    failed = over.verdicts[over.verdicts["outcome"] == Outcome.FAIL.value]
    for row in list[Any](failed[~failed["gate"].isin(together)].itertuples()):
        value = f"{row.value:.4g}{unit_suffix(units.get(row.metric, ''))}"
        time = f" at {row.time_s:.2f} s" if isfinite(row.time_s) else ""
        reason = f": {row.reason}" if row.reason else ""
        drive = f"{row.log} ({row.planner}, {row.mode} loop)"
        line = f"{drive}: {row.gate}: {value}{time}{reason}"
        yield (row.gate, row.log, row.planner, row.mode), short(line)


def share_words(row: Any) -> str:
    """A row of pass shares in words: "15 of 17 pass: 88%, 95% interval 66% to 97%"."""
    interval = f"{100.0 * row.low:.0f}% to {100.0 * row.high:.0f}%"
    return f"{row.passed} of {row.logs} pass: {100.0 * row.mean:.0f}%, 95% interval {interval}"


def _share_of_all(row: Any) -> str:
    lost = ((row.inconclusive, "inconclusive"), (row.missing, "could not be evaluated"))
    return ", ".join([share_words(row), *(f"{count} {word}" for count, word in lost if count)])


# gates --------------------------------------------------------------------------------------------


def _gate_rows(results: Results, verdicts: pd.DataFrame) -> list[GateRow]:
    """The verdicts of the gates, without those that apply to no log."""
    units = dict(zip(results.measured["metric"], results.measured["unit"], strict=True))
    judged: dict[tuple[str, str, str], dict[str, str]] = {}
    asked = verdicts[verdicts["outcome"] != Outcome.NOT_ASKED.value]
    names = ["gate", "planner", "mode", "log", "outcome"]
    for rule, planner, mode, log, outcome in asked[names].itertuples(index=False):
        judged.setdefault((rule, planner, mode), {})[log] = outcome
    members = {
        f"{kind} {group}": logs for (kind, group), logs in membership(results.labels).items()
    }
    short, rows = without_folders(results), []
    for verdict in results.summary["gates"]:
        gate = verdict["gate"]
        row = {
            name: str(verdict.get(name, ""))
            for name in ("outcome", "rule", "planner", "mode", "group", "log")
        }
        if row["outcome"] == Outcome.NOT_ASKED.value:
            continue
        reason = finding = short(verdict["reason"])
        if row["outcome"] == Outcome.PASS.value:
            by_log = judged.get((row["rule"], row["planner"], row["mode"]), {})
            logs = members.get(row["group"], by_log)
            passing = _passing(verdict, units.get(gate["metric"], ""))
            unclear = [by_log[log] for log in logs if log in by_log]
            finding = f"{', '.join(filter(None, (row['planner'], row['group'])))}: {passing}"
            if lacking := unclear.count(Outcome.INCONCLUSIVE.value):
                finding += f"; no evidence in {lacking} of {len(unclear)} logs"
        elif row["outcome"] == Outcome.FAIL.value and gate["reason"]:
            finding += f" (the gate: {gate['reason']})"
        rows.append(GateRow(over=str(gate["over"]), finding=finding, reason=reason, **row))
    return sorted(rows, key=lambda row: list(Outcome).index(Outcome(row.outcome)))


def _passing(verdict: Mapping[str, Any], unit: str) -> str:
    """The value of a gate that passes; if every log must pass, also the log nearest to the
    bound.
    """
    over = verdict["gate"]["over"]
    value = nan if verdict["value"] is None else float(verdict["value"])
    if over == "pass_share":
        return f"{100.0 * value:.3g}% of the logs"
    shown = 0.0 if abs(value) < NOISE else value
    number = f"{shown:.3g}" if abs(shown) < 1e3 else f"{shown:.0f}"
    log = f", on {verdict['log']}" if shown and over == "worst" else ""
    return f"{number}{unit_suffix(unit)}{log}"


# notes --------------------------------------------------------------------------------------------


def merged_notes(logs: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Every note once, with the number of logs, the commonest first; notes that differ only in
    numbers are merged.
    """
    count: Counter[str] = Counter()
    texts: dict[str, set[str]] = {}
    for log in logs:
        of_log = [*log["notes"], *(note for drive in log["drives"] for note in drive["notes"])]
        notes = {re.sub(r"[\d.]*\d", "#", note): note for note in of_log}
        count.update(notes.keys())
        for pattern, note in notes.items():
            texts.setdefault(pattern, set()).add(note)
    for pattern, concerned in count.most_common():
        first = min(texts[pattern]).rstrip(".")
        example = first if len(texts[pattern]) == 1 else f"for example: {first}"
        yield f"{example} ({concerned} of {counted(len(logs), 'log')})"
