"""Reads a result folder: every table of a run as a tidy frame, every drive with its plans
(`replan.load`).

result = load("results/run-001")
result.metrics                                   # one row per log, planner, mode and metric
result.references                                # likewise, of the reference drives
result.drive("paper/free_road").plan(at=6.5)     # the plan that was driven at 6.5 s, with its
                                                 internals as arrays
result.drive("paper/free_road").plot(at=6.5)     # its picture
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from replan.core.urls import Near
from replan.results.load import RECORDINGS, StoredDrive, StoredRun, stored

if TYPE_CHECKING:
    from replan.draw.charts.chart import Chart


def load(path: Path | str) -> Results:
    """The results of a run.

    Args:
        path: The result folder, or its URL: its files except recordings are fetched, and kept as
            long as the results.

    Raises:
        ConfigError: The path is not a result folder, or is of another version.
        LogError: It cannot be fetched.
    """
    return loaded(Near(path, RECORDINGS))


def loaded(near: Near) -> Results:
    """`load` of a folder that is here, or has been fetched."""
    return stored(near, Results)


class Results(StoredRun):
    """The tables of a run, each read when it is first asked for.

    Attributes:
        path: The result folder.
        summary: The contents of summary.json: version, outcome, exit code, logs, gates, failures.
        resumed: Number of logs that `evaluate_logs` kept from an interrupted run; 0 for loaded
            results.
    """

    def drive(self, log: str, planner: str | None = None, mode: str = "closed") -> DriveResult:
        """One drive.

        Args:
            log: Name of the log.
            planner: Name of the planner; None: the only one of the run.
            mode: "open" or "closed".

        Raises:
            ConfigError: There is no such drive, or several.
        """
        return DriveResult(self, *self.key_of(log, planner, mode))


class DriveResult(StoredDrive):
    """One drive of a run: its rows of the tables, and the trace with its plans.

    Attributes:
        result: The run.
        log: Name of the log; `planner` and `mode` likewise.
    """

    def plot(
        self,
        at: float | None = None,
        chart: str = "all",
        width: int = 1400,
        *,
        beside: Sequence[DriveResult] = (),
    ) -> Chart:
        """A picture of the drive, which shows itself in a notebook; `str(chart.alone("light"))` is
        SVG.

        Args:
            at: Time, s since the scenario's start; None: the worst moment.
            chart: What is drawn, as `replan plot --chart`.
            width: Pixels.
            beside: Other drives of the log to show in the same picture, at the same moment.

        Raises:
            ConfigError: There is no such chart, or no plan at this time; or the others are of
                another log, or too many.
        """
        # here: the tables are read sooner without
        from replan.draw.charts.layout import charts_of, together
        from replan.draw.charts.subject import subject

        seen = subject(self, at, beside)
        return together(charts_of(seen, chart, width), seen.title, seen.says, width)

    def _repr_html_(self) -> str:
        """The drive in a notebook: its worst moment."""
        return self.plot()._repr_html_()
