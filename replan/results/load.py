"""The tables of a run in its result folder, and the traces of its drives
(`replan.draw.drawn_results` adds pictures).

A table is read when it is first used. All tables about drives have the columns log, planner and
mode; docs/results.md describes each column. `SCHEMA_VERSION` increases when a column changes its
meaning or is removed.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from math import isfinite
from pathlib import Path
from typing import Any, Literal, TypeVar

import msgspec
import numpy as np
import pandas as pd

from replan.config import RunConfig, load_run
from replan.core.arrays import FloatArray
from replan.core.errors import ConfigError, unknown_name
from replan.core.names import counted
from replan.core.urls import Near
from replan.logs.mcap import read_trace
from replan.logs.plan import Decision, Plan
from replan.logs.scenario import Scenario
from replan.logs.trace import PlannedFrame, Trace
from replan.metrics.judge import REFERENCE
from replan.metrics.judge.aggregate import LogLabels
from replan.metrics.judge.gates import Outcome
from replan.results.log_result import Failure, LogCard
from replan.results.schema import AGAIN, names_of, read_json, read_table

Run = TypeVar("Run", bound="StoredRun")
RECORDINGS = (".rrd",)
MODES = {"open", "closed"}
TIMING_WORDS = ("log", "planner", "mode", "stage")


class GateCard(msgspec.Struct):
    """A verdict in summary.json."""

    rule: str
    outcome: Outcome
    reason: str
    planner: str
    mode: str
    value: float | None
    log: str
    time_s: float | None
    group: str = ""


class Summary(msgspec.Struct):
    """The contents of summary.json."""

    exit_code: Literal[0, 1, 2, 3, 4]
    outcome: str
    logs: tuple[LogCard, ...]
    gates: tuple[GateCard, ...]
    failures: tuple[Failure, ...]
    replan: str
    python: str
    logs_left_out: tuple[str, ...] = ()


def stored(near: Near, kind: type[Run]) -> Run:
    """The results of a run in a folder that is here, or has been fetched.

    ConfigError if the path is not a result folder, or is of another version.
    """
    folder = near.path
    file = folder / "summary.json"
    if not file.exists():
        hint = "see --out"
        if (folder / "mined.json").is_file():
            hint = "it has mined logs: replan query reads them"
        elif (folder / "run.toml").is_file():
            hint = "it was interrupted: `--resume` finishes it"
        raise ConfigError(
            f"{near.place}: no results of a finished run (no summary.json in it; {hint})"
        )
    summary, card = read_json(file, Summary)
    names = [log.log for log in card.logs]
    drives_of_logs = [(log.log, drive) for log in card.logs for drive in log.drives]
    drives = [drive for _, drive in drives_of_logs]
    keys = {(log, drive.planner, drive.mode) for log, drive in drives_of_logs if log == drive.log}
    if len(set(names)) < len(names) or len(keys) < len(drives):
        raise ConfigError(
            f"{file}: names a log or a drive twice, or a drive with the name of another log; "
            f"{AGAIN}"
        )
    whole = {"logs": card.logs, "failures": card.failures}  # with defaults
    results = kind(folder, summary | msgspec.json.decode(msgspec.json.encode(whole)), near)
    other = {drive.planner for drive in drives} - {*results.run.planners} | {
        drive.mode for drive in drives
    } - MODES
    if other:
        raise ConfigError(
            f"{file}: has drives of {min(other)}, which the run in run.toml has not; {AGAIN}"
        )
    return results


@dataclass(frozen=True, eq=False, repr=False)
class StoredRun:
    """The tables of a run, each read when it is first asked for.

    Attributes:
        path: The result folder.
        summary: The contents of summary.json: version, outcome, exit code, logs, gates, failures.
        resumed: Number of logs that `evaluate_logs` kept from an interrupted run; 0 for loaded
            results.
    """

    path: Path
    summary: dict[str, Any] = field(repr=False)  # megabytes of a large run
    _near: Near | None = field(default=None, repr=False)
    resumed: int = 0

    @cached_property
    def run(self) -> RunConfig:
        """The resolved configuration."""
        return load_run(self.path / "run.toml")

    @property
    def exit_code(self) -> int:
        """The exit code of `replan evaluate`."""
        return int(self.summary["exit_code"])

    @property
    def outcome(self) -> str:
        """The exit code in words: "pass", "fail", "inconclusive", ...; "not judged" for a shard."""
        return str(self.summary["outcome"])

    @cached_property
    def metrics(self) -> pd.DataFrame:
        """A row per log, planner, mode and metric, of the planners of the run."""
        rows = self.measured
        return rows[rows["mode"] != REFERENCE].reset_index(drop=True)

    @cached_property
    def references(self) -> pd.DataFrame:
        """Rows like those of `metrics`, of the reference drives: `planner` is the driver."""
        rows = self.measured
        return rows[rows["mode"] == REFERENCE].reset_index(drop=True)

    @cached_property
    def measured(self) -> pd.DataFrame:
        """All rows of metrics.parquet: `metrics` and `references`, for judging and comparing."""
        return self._table("metrics.parquet").drop(columns="schema_version")

    @cached_property
    def _metric_rows(self) -> dict[Any, Any]:
        """Indices in `measured` of the metrics of each drive."""
        return dict(self.measured.groupby(["log", "planner", "mode"], sort=False).indices)

    @cached_property
    def verdicts(self) -> pd.DataFrame:
        """A row per gate, log, planner and mode: the outcome of the gate on this log."""
        return self._table("verdicts.parquet")

    @cached_property
    def groups(self) -> pd.DataFrame:
        """A row per group of logs, planner, mode and metric (`replan.metrics.judge.aggregate`);
        "pass": how many logs pass.
        """
        return self._table("groups.parquet")

    @cached_property
    def gates(self) -> pd.DataFrame:
        """A row per gate, planner, mode and group: the outcome over all logs; `gate` is its rule as
        text.
        """
        rows = [
            {"group": "", **verdict, "gate": verdict["rule"]} for verdict in self.summary["gates"]
        ]
        table = pd.DataFrame(rows, columns=names_of("gates"))
        return table.astype({"value": "float64", "time_s": "float64"})

    @cached_property
    def logs(self) -> pd.DataFrame:
        """A row per log: where it comes from, hash, tags (a list), its folder; "" if it could not
        be read.
        """
        return pd.DataFrame(self.summary["logs"], columns=names_of("logs"))

    @cached_property
    def labels(self) -> dict[str, LogLabels]:
        """Family, dataset and tags of each log that could be read."""
        logs = [log for log in self.summary["logs"] if log["sha256"]]
        return {
            log["log"]: LogLabels(log["family"], log["dataset"], tuple(log["tags"])) for log in logs
        }

    @property
    def unread(self) -> tuple[str, ...]:
        """Logs that could not be read; `failures` has the reasons."""
        return tuple(log["log"] for log in self.summary["logs"] if not log["sha256"])

    @cached_property
    def drives(self) -> pd.DataFrame:
        """A row per log, planner and mode: why the drive ended, and its files (a list, relative to
        the folder).
        """
        rows = [drive for log in self.summary["logs"] for drive in log["drives"]]
        return pd.DataFrame(rows, columns=names_of("drives"))

    @cached_property
    def failures(self) -> pd.DataFrame:
        """Logs and drives that could not be evaluated."""
        return pd.DataFrame(self.summary["failures"], columns=names_of("failures"))

    @cached_property
    def timings(self) -> pd.DataFrame:
        """The duration of each stage of each plan, s."""
        return self._table("timings.parquet", words=TIMING_WORDS)

    @cached_property
    def health(self) -> pd.DataFrame:
        """The findings about the health of the logs."""
        return self._table("health.parquet")

    @cached_property
    def frames(self) -> pd.DataFrame:
        """Every metric step by step, of all drives: a large table."""
        pairs = zip(self.logs["log"], self.logs["folder"], strict=True)
        parts = [self._steps(log, folder) for log, folder in pairs if folder]
        return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()

    @cached_property
    def decisions(self) -> pd.DataFrame:
        """A row per frame and decision, of all drives: reads every trace."""
        rows = []
        for key in self.drives[["log", "planner", "mode"]].itertuples(index=False, name=None):
            drive = StoredDrive(self, *key)
            for frame in drive.trace.frames:
                for item in frame.plan.internals:
                    if isinstance(item, Decision):
                        where = drive.log, drive.planner, drive.mode, frame.t
                        rows.append((*where, item.agent, item.kind.value, item.stage, item.reason))
        return pd.DataFrame(rows, columns=names_of("decisions"))

    def key_of(self, log: str, planner: str | None, mode: str) -> tuple[str, str, str]:
        """Log, planner and mode of one drive; ConfigError if there is none, or several."""
        table = self.drives
        drives = table[(table["log"] == log) & (table["mode"] == mode)]
        if planner is not None:
            drives = drives[drives["planner"] == planner]
        if len(drives) == 1:
            row = drives.iloc[0]
            return row["log"], row["planner"], row["mode"]
        if log not in set(table["log"]):
            raise unknown_name("log", log, list(dict.fromkeys(table["log"])))
        of_log = table[table["log"] == log]
        listed_drives = ", ".join(
            f"{p} ({m} loop)" for p, m in zip(of_log["planner"], of_log["mode"], strict=True)
        )
        problem = (
            "name a planner of"
            if len(drives)
            else f"no {mode} loop of {planner or 'any planner'}; there are"
        )
        raise ConfigError(f"{self.path}: {log}: {problem} {listed_drives}")

    def __repr__(self) -> str:
        counts = self.gates["outcome"].value_counts()
        gates = ", ".join(
            f"{counts[name]} {name}" for name in ("fail", "inconclusive", "pass") if name in counts
        )
        return (
            f"<{self.path}: {self.outcome}; {counted(len(self.drives), 'drive')}; gates: "
            f"{gates or 'none'}>"
        )

    def _repr_html_(self) -> str:
        """The results in a notebook: the gates that do not pass, else all."""
        rows = self.gates[self.gates["outcome"] != "pass"]
        table = (rows if len(rows) else self.gates)[
            ["outcome", "gate", "planner", "mode", "value", "log", "reason"]
        ]
        return f"<p>{escape(repr(self))}</p>{table.to_html(index=False, na_rep='')}"

    def _table(self, name: str, words: Sequence[str] = ()) -> pd.DataFrame:
        """A table, checked; LogError if it is missing or damaged."""
        table: pd.DataFrame = read_table(self.path / name, words=words).to_pandas()
        return table

    def _steps(self, log: str, folder: str) -> pd.DataFrame:
        name = f"{folder}/frames.parquet"
        is_there = (self.path / name).is_file()
        table = self._table(name) if is_there else pd.DataFrame(columns=["planner", "mode", "t_s"])
        table.insert(0, "log", log)
        return table


@dataclass(frozen=True, eq=False, repr=False)
class StoredDrive:
    """One drive of a run: its rows of the tables, and the trace with its plans.

    Attributes:
        result: The run.
        log: Name of the log; `planner` and `mode` likewise.
    """

    result: StoredRun
    log: str
    planner: str
    mode: str

    @cached_property
    def metrics(self) -> pd.DataFrame:
        """Its rows of `StoredRun.metrics`."""
        rows = self.result._metric_rows.get((self.log, self.planner, self.mode), [])
        return self.result.measured.take(rows).reset_index(drop=True)

    @cached_property
    def verdicts(self) -> pd.DataFrame:
        """Its rows of `StoredRun.verdicts`."""
        return self._mine(self.result.verdicts)

    @cached_property
    def series(self) -> pd.DataFrame:
        """Its metrics step by step: index t_s, a column per metric; NaN if a step has no value."""
        rows = self._mine(self.result._steps(self.log, str(self._row(self.result.logs)["folder"])))
        return rows.pivot(index="t_s", columns="metric", values="value")

    def steps(self, metric: str) -> tuple[FloatArray, FloatArray]:
        """One metric step by step, t (s) and value `(n,)`; empty if it was not measured."""
        t, values, rows = self._by_metric
        rows_of_metric = rows.get(metric, slice(0, 0))
        return t[rows_of_metric], values[rows_of_metric]

    @cached_property
    def _by_metric(self) -> tuple[FloatArray, FloatArray, dict[str, slice]]:
        """The steps sorted by metric, then by time, and the slice of each metric."""
        file = self.result.path / str(self._row(self.result.logs)["folder"]) / "frames.parquet"
        if not file.is_file():
            return np.empty(0), np.empty(0), {}
        words = ["planner", "mode", "metric"]
        table = read_table(file, words=words).combine_chunks()
        planner, mode, metric = (table[name].chunk(0) for name in words)
        codes = [column.dictionary.to_pylist() for column in (planner, mode, metric)]
        of_drive = np.full(len(table), self.planner in codes[0] and self.mode in codes[1])
        for column, known, name in ((planner, codes[0], self.planner), (mode, codes[1], self.mode)):
            of_drive &= column.indices.to_numpy() == (known.index(name) if name in known else -1)
        of = metric.indices.to_numpy()[of_drive]
        order = np.argsort(of, kind="stable")
        ends = np.cumsum(np.bincount(of, minlength=len(codes[2])))
        rows = {
            name: slice(int(b), int(e))
            for name, b, e in zip(codes[2], [0, *ends[:-1]], ends, strict=True)
        }
        t, values = (table[name].to_numpy()[of_drive][order] for name in ("t_s", "value"))
        return t, values, rows

    @cached_property
    def info(self) -> pd.Series[Any]:
        """Its row of `StoredRun.drives`."""
        return self._mine(self.result.drives).iloc[0]

    @property
    def trace_file(self) -> Path:
        """Its MCAP file; its recording has the same name with the suffix .rrd."""
        return next(
            self.result.path / file for file in self.info["files"] if str(file).endswith(".mcap")
        )

    @cached_property
    def _read(self) -> tuple[Trace, Scenario]:
        return read_trace(self.trace_file)

    @property
    def trace(self) -> Trace:
        """The drive: ego, road users, plans with the internals that were kept; LogError if it is
        damaged.
        """
        return self._read[0]

    @property
    def scenario(self) -> Scenario:
        """Road, goal and vehicle, with the ego as it was driven."""
        return self._read[1]

    def frame(self, at: float) -> PlannedFrame:
        """The last frame not later than `at`, s since the scenario's start.

        ConfigError if there is no such frame, or the drive had ended.
        """
        if at > self.trace.ego.t[-1] + 1e-6 and isfinite(at):
            ended = f"it ended at {self.trace.ego.t[-1]:.2f} s: {self.trace.end.value}"
            raise ConfigError(f"{self.title}: no plan at {at:g} s; {ended}")
        t = np.array([frame.t for frame in self.trace.frames])
        index = int(np.searchsorted(t, at + 1e-9, side="right")) - 1
        if index < 0 or not isfinite(at):
            first = f"its first is at {t[0]:.2f} s" if len(t) else "it has none"
            raise ConfigError(f"{self.title}: no plan at {at:g} s; {first}")
        return self.trace.frames[index]

    def plan(self, at: float) -> Plan:
        """The plan that was the newest at a time, as `frame`."""
        return self.frame(at).plan

    @property
    def title(self) -> str:
        """Log, planner and loop in words."""
        return f"{self.log}, {self.planner}, {self.mode} loop"

    def __repr__(self) -> str:
        info, failed = self.info, self.verdicts[self.verdicts["outcome"] == "fail"]
        gates = f"; fails {', '.join(failed['gate'])}" if len(failed) else ""
        return f"<{self.title}: {info['end']} after {info['t_end_s']:.2f} s{gates}>"

    def _mine(self, table: pd.DataFrame) -> pd.DataFrame:
        of_drive = (
            (table["log"] == self.log)
            & (table["planner"] == self.planner)
            & (table["mode"] == self.mode)
        )
        return table[of_drive].reset_index(drop=True)

    def _row(self, table: pd.DataFrame) -> pd.Series[Any]:
        return table[table["log"] == self.log].iloc[0]


def named_logs(name: str, logs: Iterable[str]) -> list[str]:
    """The logs of a run that a name means: the log of this name, otherwise those with it in their
    names.

    Names are compared as words of letters and digits, so that the name of a log's folder also fits.
    ConfigError if there is none.
    """
    known = list(dict.fromkeys(logs))
    if name in known:
        return [name]
    words = re.compile(r"[^0-9A-Za-z]+")
    matches = [log for log in known if words.sub("_", name) in words.sub("_", log)]
    if not matches:
        raise unknown_name("log (in the run)", name, known)
    return matches
