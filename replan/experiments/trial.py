"""A trial: a scenario made for an experiment, driven in closed loop, and read from the tables of
its run.

one_planner, closed   the configuration with which trials are driven
drive_made            scenarios -> files -> `evaluate_logs` -> `Trial`, or the reason why there is
                      none
scratch_folder        a folder of results that are read once
write_table           a table of trials as Parquet and CSV
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from math import nan
from pathlib import Path
from typing import Any

import pandas as pd

from replan.config import RunConfig, RunMode
from replan.core.errors import ConfigError, LogError
from replan.draw.drawn_results import Results
from replan.logs.log_settings import LogSettings
from replan.logs.mcap import write_scenario
from replan.logs.scenario import Avoidability, Scenario
from replan.metrics.judge import CAREFUL, REFERENCE, worst
from replan.metrics.judge.gates import Outcome
from replan.metrics.reference_drivers import APPLIES, AVOIDS
from replan.results.tables import PARTIAL, write_csv, write_parquet
from replan.run import evaluate_logs

MODE: RunMode = "closed"


def one_planner(run: RunConfig, experiment: str) -> str:
    """The planner of an experiment ("a tuning"); ConfigError if the run has several."""
    if len(run.planners) != 1:
        raise ConfigError(f"{experiment} needs exactly one planner, got {', '.join(run.planners)}")
    return run.planners[0]


def closed(run: RunConfig, **changes: Any) -> RunConfig:
    """The run in closed loop, on logs that are read already, without what costs time and says
    nothing about one log.
    """
    bare = replace(run, mode=MODE, log=LogSettings(), deadline_s=0.0, ensemble=0)
    return replace(bare, **changes)


QUIET: Mapping[str, Any] = {
    "recording": False,
    "foxglove": False,
    "repeat_s": 0.0,
    "internals": "none",
}
"""Changes of a run whose files are not opened."""


@dataclass(frozen=True, eq=False)
class Trial:
    """The closed-loop drive of a planner on a log of a run."""

    results: Results
    log: str
    planner: str

    @cached_property
    def missing(self) -> str:
        """Why the log was not driven by all planners of the run; "" if it was."""
        rows = self.results.failures[self.results.failures["log"] == self.log]
        if len(rows):
            first = rows.iloc[0]
            drive = f" [{first.planner}, {first.mode} loop]" if first.planner else ""
            return f"{first.message}{drive}"
        return "" if len(self._own(self.results.drives)) else "not driven"

    @cached_property
    def drive(self) -> pd.Series:
        """The row of drives.parquet."""
        return self._own(self.results.drives).iloc[0]

    @cached_property
    def verdicts(self) -> pd.DataFrame:
        """The rows of verdicts.parquet."""
        return self._own(self.results.verdicts)

    @property
    def outcome(self) -> Outcome:
        """The worst outcome."""
        return worst(map(Outcome, self.verdicts["outcome"]))

    @cached_property
    def metrics(self) -> pd.DataFrame:
        """The rows of metrics.parquet that have a value, by metric: of the drive, and of the
        careful driver.
        """
        rows = self.results.measured
        of_planner = (rows["planner"] == self.planner) & (rows["mode"] == MODE)
        of_reference = (rows["planner"] == CAREFUL) & (rows["mode"] == REFERENCE)
        return rows[(rows["log"] == self.log) & (of_planner | of_reference) & rows["available"]]

    def values(self, planner: str = "") -> dict[str, float]:
        """The values of the metrics, of this planner or of the careful driver (`CAREFUL`)."""
        rows = self.metrics[self.metrics["planner"] == (planner or self.planner)]
        return dict(zip(rows["metric"], rows["value"].astype(float), strict=True))

    @property
    def careful(self) -> Avoidability:
        """Whether the careful driver of UN R157 avoids the contact of the drive."""
        applies, avoids = (
            self.values().get(f"reference_cc.{metric.name}", nan) for metric in (APPLIES, AVOIDS)
        )
        if not applies > 0.0:
            return Avoidability.NOT_APPLICABLE
        return Avoidability.AVOIDABLE if avoids > 0.0 else Avoidability.UNAVOIDABLE

    def _own(self, rows: pd.DataFrame) -> pd.DataFrame:
        return rows[(rows["log"] == self.log) & (rows["planner"] == self.planner)]


def drive_made(
    makes: Mapping[Path, Callable[[], Scenario]],
    run: RunConfig,
    out: Path,
    *,
    workers: int,
    resume: bool = False,
) -> list[Trial | str]:
    """Write scenarios, drive them, and return for each its trial, or the reason why it could not be
    made or driven.

    Args:
        makes: The function that makes the scenario of each file; it raises LogError if there is no
            such scenario.
        run: The configuration; the trials are of its first planner.
        out: The result folder.
        workers: Number of processes; 0: this process.
        resume: Continue an interrupted run in `out`, if there is one.
    """
    refused: dict[Path, str] = {}
    for path, make in makes.items():
        try:
            write_scenario(path, make())
        except LogError as error:
            refused[path] = str(error)
    logs = [path for path in makes if path not in refused]
    if not logs:
        return list(refused.values())
    resume = resume and (out / "run.toml").is_file()
    results = evaluate_logs(logs, run, out, workers=workers, resume=resume)
    names = dict(zip(results.logs["source"], results.logs["log"], strict=True))
    trials = {path: Trial(results, names[str(path)], run.planners[0]) for path in logs}
    return [refused.get(path) or trials[path].missing or trials[path] for path in makes]


@contextmanager
def scratch_folder(out: Path, name: str) -> Iterator[Path]:
    """The path of a folder in `out` that does not exist at first, and is removed at the end."""
    scratch = out / f"{PARTIAL}{name}"
    shutil.rmtree(scratch, ignore_errors=True)
    try:
        yield scratch
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def write_table(out: Path, name: str, table: pd.DataFrame) -> None:
    """Write a table as NAME.parquet and NAME.csv."""
    write_parquet(out / f"{name}.parquet", table)
    write_csv(out / f"{name}.csv", table)
