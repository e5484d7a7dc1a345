"""Failing drives, driven again with changes and judged by the gates of their run.

A drive passes with a change if no gate fails, no gate that it failed before is inconclusive, no
peak of a metric of the gates that it failed is worse (`worse_peak`: one that stays beyond a bound
for less time, but three times as far, is not mended), and it is not cut short (`cut_short`: what it
would have failed later is not known). The gates are the same for every change: a drive with the
true futures of road users is judged as any other, and another planner as the one that failed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from replan.config import RunConfig
from replan.core.arrays import TIE
from replan.core.errors import LogError
from replan.draw.drawn_results import DriveResult, Results
from replan.experiments.trial import MODE, Trial
from replan.explain.drive_events import GRAVE
from replan.explain.first_difference import first_difference
from replan.explain.planners_part import planners_part
from replan.logs.scenario import Avoidability
from replan.metrics import METRICS
from replan.metrics.judge import REFERENCE, Outcome, judge, outcomes
from replan.metrics.judge.added_rows import with_asked
from replan.metrics.judge.gates import Gate, Gates
from replan.metrics.metric import Direction
from replan.run.evaluate import evaluate_logs
from replan.run.judging import gates_of

INCONCLUSIVE = Outcome.INCONCLUSIVE.value
PEAKS: Mapping[str, Direction] = {"max": "higher", "max_abs": "higher", "min": "lower"}
"""Reductions that are extremes.

Of a metric for which this direction is better, an extreme is not a peak.
"""
WORSE = 0.1
"""A peak is worse if it is this share farther out."""
CUT = tuple(end.value for end in GRAVE)
"""Ends that leave open what the rest of a drive would have been."""
COLUMNS = ("drive", "gate", "outcome", "value", "time_s", "reason")
CONTROLS = ("tiny", "start", "noise")
"""Perturbations (`replan.run.ensemble`) with which a drive must also fail, so that a change is
conclusive.
"""


@dataclass(frozen=True, eq=False)
class DrivenLogs:
    """Logs that were driven by one planner.

    Attributes:
        names: Name of each log in the run, by its file's name.
        gates: The gates that judge them, by their rules as text.
        outcomes: A row per drive and gate: `COLUMNS`; `drive` is the name of the log's file.
    """

    results: Results
    names: Mapping[str, str]
    planner: str
    gates: Mapping[str, Gate]
    outcomes: pd.DataFrame

    def verdicts(self, file: Path) -> pd.DataFrame:
        """The rows of a drive."""
        return self.outcomes[self.outcomes["drive"] == file.name]

    @property
    def driven(self) -> set[str]:
        """Names of the files of the logs with a drive."""
        logs = set(self.results.drives["log"])
        return {file for file, name in self.names.items() if name in logs}

    def trial(self, file: Path) -> Trial:
        """The trial of a log's file."""
        return Trial(self.results, self.names[file.name], self.planner)

    def drive(self, file: Path) -> DriveResult:
        """The drive of a log's file; ConfigError if there is none."""
        return self.results.drive(self.names[file.name], self.planner, MODE)

    def ended(self, file: Path) -> str:
        """The end of a drive, or the reason why it was not driven."""
        name = self.names.get(file.name, file.name)
        rows = self.results.drives
        ends = rows.loc[(rows["log"] == name) & (rows["planner"] == self.planner), "end"]
        if len(ends):
            return str(ends.iloc[0])
        failures = self.results.failures
        messages = failures.loc[failures["log"].isin([name, str(file)]), "message"]
        return str(messages.iloc[0]) if len(messages) else "not driven"

    def lasted(self, file: Path) -> float:
        """The time at which a drive ended, s; 0 if it was not driven."""
        return float(self.trial(file).drive["t_end_s"]) if file.name in self.driven else 0.0

    def peaks(self, file: Path, gates: Sequence[str], until: float = inf) -> dict[str, float]:
        """The extreme values of the metrics of some gates, those whose excess is worse: `PEAKS`, by
        name.

        An extreme after `until`, s, is left out.
        """
        asked = {self.gates[gate].metric.partition(".")[0] for gate in gates}
        rows = self.trial(file).metrics
        rows = rows[(rows["planner"] == self.planner) & ~(rows["time_s"] > until + TIE)]
        peaks = {}
        for name, value in zip(rows["metric"], rows["value"].astype(float), strict=True):
            word, _, reduction = name.partition(".")
            metric = METRICS.get(word) if word in asked and isfinite(value) else None
            if metric is not None and PEAKS.get(reduction, metric.direction) != metric.direction:
                peaks[name] = value
        return peaks

    def about(self, file: Path, metric: str) -> str:
        """The road user or object that the value of a metric is about: "pedestrian 17"; "" if it is
        unknown.
        """
        rows = self.drive(file).metrics
        about = rows.loc[rows["metric"] == metric, "about"].dropna()
        return str(about.iloc[0]) if len(about) else ""

    def avoidable(self, file: Path) -> bool:
        """Whether the careful driver of UN R157 avoids the drive's contact, or there is none."""
        return self.trial(file).careful is not Avoidability.UNAVOIDABLE


def drive_again(
    files: Sequence[Path], run: RunConfig, planner: str, out: Path, *, workers: int
) -> DrivenLogs:
    """Drive logs, and judge them by the gates for `planner`; errors as `evaluate_logs`."""
    return as_driven(evaluate_logs(list(files), run, out, workers=workers), planner)


def as_driven(results: Results, planner: str) -> DrivenLogs:
    """Results of one planner, judged by the gates for `planner`."""
    run = results.run
    files = (Path(source).name for source in results.logs["source"])
    names = dict(zip(files, results.logs["log"], strict=True))
    gates = gates_of(run, run.gates_path)
    rules = tuple(
        replace(gate, planner=None) for gate in gates.gates if gate.planner in (None, planner)
    )
    outcomes = judged(results, names, replace(gates, gates=rules))
    by_rule = {str(gate): gate for gate in rules}
    return DrivenLogs(results, names, run.planners[0], by_rule, outcomes)


def judged(results: Results, names: Mapping[str, str], rules: Gates) -> pd.DataFrame:
    """The `DrivenLogs.outcomes` of a run of one planner, judged as if it were no oracle; `names` as
    in `DrivenLogs`.
    """
    planner = results.run.planners[0]
    crashes = results.failures.dropna(subset=["planner", "mode"])
    columns = (crashes[name].astype(str) for name in ("log", "planner", "mode", "message"))
    crashed = {tuple(drive): message for *drive, message in zip(*columns, strict=True)}
    table = with_asked(results.measured.assign(oracle=False), rules, results.labels)
    unread = dict.fromkeys(results.unread, "not read")
    rows = outcomes(judge(rules, table, results.labels, failed=unread, crashed=crashed))
    rows = rows[(rows["planner"] == planner) & (rows["mode"] != REFERENCE)]
    drive = rows["log"].map({name: file for file, name in names.items()})
    return rows.assign(drive=drive)[list(COLUMNS)]


def failed_gates(rows: pd.DataFrame) -> tuple[str, ...]:
    """The gates that a drive fails, in the order of the gates."""
    return tuple(rows.loc[rows["outcome"] == Outcome.FAIL.value, "gate"])


def still_failing(before: Sequence[str], rows: pd.DataFrame) -> tuple[str, ...]:
    """The gates of `before` that a drive fails, or that are inconclusive on it."""
    now = dict(zip(rows["gate"], rows["outcome"], strict=True))
    return tuple(
        gate for gate in before if now.get(gate, INCONCLUSIVE) in (INCONCLUSIVE, Outcome.FAIL.value)
    )


def passes(before: Sequence[str], rows: pd.DataFrame) -> bool:
    """Whether a drive fails no gate, and none of the gates that it failed before is
    inconclusive.
    """
    return not still_failing(before, rows) and not failed_gates(rows)


def worse_peak(before: Mapping[str, float], now: Mapping[str, float]) -> str:
    """The first peak (`DrivenLogs.peaks`) that is farther out than before by `WORSE` of it; "" if
    none is.
    """
    for name, value in before.items():
        outward = -1.0 if name.endswith(".min") else 1.0
        if name in now and outward * (now[name] - value) > WORSE * abs(value) + TIE:
            return name
    return ""


def cut_short(before: str, until: float, now: str, lasted: float) -> bool:
    """Whether a drive with a change, which ended at `lasted`, s, with `now`, ended too early
    (`CUT`) to be compared.

    The failing drive failed at `until`, s, and ended with `before`.
    """
    return now in CUT and (before not in CUT or lasted < until)


def parting(failing: DriveResult, passing: DriveResult) -> dict[str, Any]:
    """The first difference of two drives: time (s), stage and description.

    Empty if there is none.
    """
    part = first_difference if failing.planner == passing.planner else planners_part
    try:
        difference = part(failing.trace, passing.trace)
    except LogError as error:
        return {"stage": "not known", "what": f"a trace cannot be read: {error}"}
    if difference is None:
        return {}
    return {
        "t_s": float(np.round(difference.t, 9)),
        "stage": difference.stage,
        "what": difference.what,
    }


@dataclass(frozen=True)
class FailingDrive:
    """A drive that fails as it was: a row of the study.

    Attributes:
        gates: The gates that it fails; `metric` is that of the first one, `about` the road user or
            object that its value is about.
        time_s: Time at which it fails the first of them; None if unknown.
        beyond: Excess over the bound of that gate; None if unknown.
        end: How the drive ended; `lasted` is when, s.
        avoidable: Whether the careful driver avoids its contact, or there is none.
        peaks: `DrivenLogs.peaks` of the gates.
        fragile: The `CONTROLS` with which it passes.
    """

    gates: Sequence[str]
    metric: str
    about: str
    time_s: float | None
    beyond: float | None
    end: str
    lasted: float
    avoidable: bool
    peaks: Mapping[str, float]
    fragile: Sequence[str] = ()

    @classmethod
    def of(cls, driven: DrivenLogs, file: Path) -> FailingDrive | None:
        """The drive of a log's file, among which are those with the `CONTROLS`; None if it fails no
        gate.
        """
        rows = driven.verdicts(file)
        gates = failed_gates(rows)
        if not gates:
            return None
        first, gate = rows[rows["gate"] == gates[0]].iloc[0], driven.gates[gates[0]]
        time, beyond = float(first["time_s"]), -gate.margin(float(first["value"]))
        drive = cls(
            gates,
            gate.metric,
            driven.about(file, gate.metric),
            time if isfinite(time) else None,
            beyond if isfinite(beyond) else None,
            driven.ended(file),
            driven.lasted(file),
            driven.avoidable(file),
            driven.peaks(file, gates),
        )
        fragile = []
        for name in CONTROLS:
            control = control_file(file, name)
            if passes(gates, driven.verdicts(control)) and not drive.is_cut(driven, control):
                fragile.append(name)
        return replace(drive, fragile=fragile)

    def is_about(self, metrics: Sequence[str]) -> bool:
        """Whether the first gate is of one of these metrics."""
        return self.metric.partition(".")[0] in metrics

    def is_cut(self, driven: DrivenLogs, file: Path) -> bool:
        """Whether the drive of a file of the log ended too early to be compared with this one."""
        until = self.lasted if self.time_s is None else self.time_s
        return cut_short(self.end, until, driven.ended(file), driven.lasted(file))


@dataclass(frozen=True)
class ChangedDrive:
    """A failing drive that is driven with a change: a row of the study.

    Attributes:
        gates: The gates that it fails.
        against: Why it is not mended although it fails none of the gates that it failed before.
        parts: The first difference from the failing drive, if it passes (`parting`).
        difference: The fields of `replan.experiments.failure.DriveDifference`, if it passes.
        pace: The fields of `replan.metrics.route_gain.RoutePace`, if it passes and the gate is
            about progress.
    """

    passes: bool
    gates: Sequence[str]
    against: str
    end: str
    parts: Mapping[str, Any]
    difference: Mapping[str, Any] | None = None
    pace: Mapping[str, Any] | None = None


def control_file(file: Path, name: str) -> Path:
    """The log with a perturbation."""
    return file.with_suffix(f".{name}.mcap")
