"""The table of the drives of a run: a row per log and planner with both loops, the worst first.

This is the one ranking of all reports, of `replan view` and of pictures of a run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from math import nan
from typing import Any

import pandas as pd

from replan.draw.charts.subject import GRAVE, gravity
from replan.draw.drawn_results import Results
from replan.draw.report.section import Cell, number_cell
from replan.logs.trace import EndReason
from replan.metrics.judge import worst
from replan.metrics.judge.discrimination import BLIND_FAILS
from replan.metrics.judge.gates import Outcome
from replan.replay.drive import Mark

Values = Mapping[tuple[str, str, str, str], float]
"""Values by log, planner, mode and metric."""


@dataclass(frozen=True)
class MetricColumn:
    """One metric of the table of drives."""

    title: str
    metric: str
    mode: str  # Loop in which it was measured
    show: Callable[[float], str]
    bad: Callable[[float], bool] = lambda value: False  # Whether a value is marked

    @property
    def words(self) -> str:
        """The title on one line."""
        return self.title.replace("fall\nback", "fallback").replace("\n", " ")

    def cell(self, row: DriveRow) -> Cell:
        """The value of a drive."""
        value = row.values[self]
        return Cell(number_cell(value, self.show).text, value, self.bad(value))


def percent(share: float) -> str:
    """A share as "12%"; "<1%" if it is small but not zero."""
    return f"{100.0 * share:.0f}%" if share == 0.0 or share >= 0.01 else "<1%"


def _route_share(share: float) -> str:
    return percent(share) if share < 1.005 else ">100%"


def _reached(value: float) -> str:
    return "yes" if value else "no"


def _above(limit: float) -> Callable[[float], bool]:
    return lambda value: value > limit


def _below(limit: float) -> Callable[[float], bool]:
    return lambda value: value < limit


JERK_S = "lon_jerk_nuplan.time_out_of_bounds"
COLUMNS = (
    MetricColumn("ADE\n3 s\n[m]", "ade.3s.mean", "open", "{:.2f}".format),
    MetricColumn("fall\nback", "fallback.rate", "open", percent, _above(0.0)),
    MetricColumn("route\ndone", "route_progress.final", "closed", _route_share, _below(0.5)),
    MetricColumn("goal", "goal.final", "closed", _reached, _below(1.0)),
    MetricColumn(
        "hits\nat\nfault", "collision_at_fault.count", "closed", "{:.0f}".format, _above(0.0)
    ),
    MetricColumn("least\ngap\n[m]", "gap.min", "closed", "{:.2f}".format, _below(0.2)),
    MetricColumn("off\nplan\n[m]", "tracking_lateral.max_abs", "closed", "{:.2f}".format),
    MetricColumn("TTC\n[s]", "ttc.min", "closed", "{:.1f}".format, _below(0.95)),
    MetricColumn("jerk\n[s]", JERK_S, "closed", "{:.1f}".format, _above(1.0)),
    MetricColumn("fall\nback", "fallback.rate", "closed", percent, _above(0.0)),
)
"""Columns of the open loop first.

The end of the closed loop is shown before the columns of the closed loop.
"""

FREE = "*"  # Mark of a pass without an interaction (`replan.metrics.judge.discrimination`)
LEGEND = (
    (
        "open",
        "open loop: the log drives, plans are compared with it; ADE 3 s: mean distance of plan and "
        "log over 3 s.",
    ),
    (
        "closed",
        f"{FREE}: no interaction: a blind driver passes this log, too, as nothing was in the way.",
    ),
    (
        "closed",
        "closed loop: the planner drives; route done: of what the log's driver (else the route "
        "follower) does in all;",
    ),
    (
        "closed",
        "TTC: least time to a collision; off plan: largest lateral distance; jerk: s beyond 4.13 "
        "m/s3, filtered.",
    ),
    (
        "",
        "verdict: the worst outcome of the gates, and how many of them were asked; inconclusive: "
        "no evidence.",
    ),
    (
        "",
        "fall back: share of frames in which the planner could not plan.  - : not available (why: "
        "metrics.csv).",
    ),
)
"""The loop ("": either) and the text of each line."""


def legend(columns: Iterable[MetricColumn]) -> list[str]:
    """The lines that explain some columns, and the columns beside them."""
    modes = {"", *(column.mode for column in columns)}
    return [line for mode, line in LEGEND if mode in modes]


GOOD_ENDS = (EndReason.GOAL.value, EndReason.END_OF_LOG.value)
CONTACTS = (EndReason.COLLISION.value, EndReason.REPLAY_CONTACT.value)
SHORT_ENDS = {
    EndReason.GOAL.value: "goal",
    EndReason.END_OF_LOG.value: "end of log",
    EndReason.REPLAY_CONTACT.value: "run into",
    EndReason.OFF_ROAD.value: "off the road",
    EndReason.PLANNER_FAILURE.value: "planner failed",
}
WORST_FIRST = (Outcome.FAIL.value, Outcome.INCONCLUSIVE.value, "", Outcome.PASS.value)
"""Outcomes of a drive; "": no gate applies to it."""


@dataclass(frozen=True)
class DriveRow:
    """A log and a planner, both loops."""

    log: str
    planner: str
    runs: Mapping[str, Any]  # Rows of `Results.drives` by loop
    verdict: str  # The worst outcome of the gates on this log; "" if no gate applies
    # The place of its gravest failed gate among the rules by harm; their number if none fails
    gravity: int
    # The number of gates that apply, of all: "24/41", with a mark where nothing was in the way
    asked: str
    values: Mapping[MetricColumn, float]  # Values of the table's columns; NaN: not available

    @property
    def shown(self) -> str:
        """The name of the planner with its marks: oracle, trusted, batched, not deterministic."""
        return marked(list(self.runs.values()))

    @property
    def end(self) -> Cell:
        """The end of the closed loop."""
        run = self.runs.get("closed")
        if run is None:
            return Cell()
        agent = f": {run.detail}" if run.end in CONTACTS else ""
        words = f"{SHORT_ENDS.get(run.end, run.end)}{agent}"
        return Cell(words, float(run.t_end_s), run.end not in GOOD_ENDS)

    @property
    def rank(self) -> tuple[int, int, int, str, str]:
        """Sort key, the worst drive first: verdict, gravest failed gate, most marked cells, name of
        log and planner.
        """
        marks = self.end.bad + sum(column.bad(value) for column, value in self.values.items())
        return WORST_FIRST.index(self.verdict), self.gravity, -marks, self.log, self.planner

    @property
    def files(self) -> list[str]:
        """Traces and recordings, relative to the result folder, sorted."""
        return sorted(chain.from_iterable(run.files for run in self.runs.values()))

    @property
    def recording(self) -> str:
        """The recording of the closed loop, otherwise of the open one; "" if there is none."""
        return next((file for file in self.files if file.endswith(".rrd")), "")

    @property
    def file(self) -> str:
        """What to open: the recording, otherwise the first trace."""
        return self.recording or next(iter(self.files), "")


def marked(drives: Sequence[Any]) -> str:
    """The name of the planner of drives, with marks: oracle, trusted, batched, not
    deterministic.
    """
    marks = ["oracle"] if any(drive.oracle for drive in drives) else []
    marks += [mark.value for mark in Mark if any(mark.value in drive.marks for drive in drives)]
    return " ".join([str(drives[0].planner), *(f"({mark})" for mark in marks)])


def drive_rows(
    results: Results, values: Values, verdicts: pd.DataFrame, columns: Sequence[MetricColumn]
) -> list[DriveRow]:
    """The drives of a run, the worst first."""
    gates: dict[tuple[str, str], list[tuple[Outcome, str]]] = {}
    names = ["log", "planner", "outcome", "metric"]
    for log, planner, outcome, metric in verdicts[names].itertuples(index=False):
        gates.setdefault((log, planner), []).append((Outcome(outcome), metric))
    runs: dict[tuple[str, str], dict[str, Any]] = {}
    for drive in list[Any](results.drives.itertuples()):
        runs.setdefault((str(drive.log), str(drive.planner)), {})[drive.mode] = drive
    rows = []
    for (log, planner), by_mode in runs.items():
        judged = gates.get((log, planner), [])
        outcomes = [outcome for outcome, _ in judged]
        failed = [gravity(metric) for outcome, metric in judged if outcome is Outcome.FAIL]
        verdict = worst(outcomes).value if judged else ""
        asked = len(judged) - outcomes.count(Outcome.NOT_ASKED)
        nothing_in_the_way = values.get((log, planner, "closed", BLIND_FAILS)) == 0.0
        mark = FREE if nothing_in_the_way and verdict == Outcome.PASS.value else ""
        row = DriveRow(
            log,
            planner,
            by_mode,
            verdict,
            gravity=min(failed, default=len(GRAVE)),
            asked=f"{asked}/{len(judged)}{mark}" if judged else "",
            values={
                column: values.get((log, planner, column.mode, column.metric), nan)
                for column in columns
            },
        )
        rows.append(row)
    return sorted(rows, key=lambda row: row.rank)
