"""The contents of a report as plain words and numbers, and the columns of its table of drives.

`replan.draw.report.overview` makes them from the results of a run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, nan
from typing import Any

import pandas as pd

from replan.core.names import counted
from replan.metrics.comparison import Comparison
from replan.metrics.judge.aggregate import BOTH, SUITE
from replan.metrics.judge.gates import Outcome

NOTHING = "-"
BROKEN = "Charts that could not be drawn"


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


def percent(value: float) -> str:
    """A share as "12%"; "<1%" if it is small but not zero."""
    return f"{100.0 * value:.0f}%" if value == 0.0 or value >= 0.01 else "<1%"


JERK_S = "lon_jerk_nuplan.time_out_of_bounds"
COLUMNS = (
    MetricColumn("ADE\n3 s\n[m]", "ade.3s.mean", "open", "{:.2f}".format),
    MetricColumn("fall\nback", "fallback.rate", "open", percent, lambda value: value > 0.0),
    MetricColumn(
        "route\ndone",
        "route_progress.final",
        "closed",
        lambda value: percent(value) if value < 1.005 else ">100%",
        lambda value: value < 0.5,
    ),
    MetricColumn(
        "goal",
        "goal.final",
        "closed",
        lambda value: "yes" if value else "no",
        lambda value: value == 0.0,
    ),
    MetricColumn(
        "hits\nat\nfault",
        "collision_at_fault.count",
        "closed",
        "{:.0f}".format,
        lambda value: value > 0.0,
    ),
    MetricColumn(
        "least\ngap\n[m]", "gap.min", "closed", "{:.2f}".format, lambda value: value < 0.2
    ),
    MetricColumn("off\nplan\n[m]", "tracking_lateral.max_abs", "closed", "{:.2f}".format),
    MetricColumn("TTC\n[s]", "ttc.min", "closed", "{:.1f}".format, lambda value: value < 0.95),
    MetricColumn("jerk\n[s]", JERK_S, "closed", "{:.1f}".format, lambda value: value > 1.0),
    MetricColumn("fall\nback", "fallback.rate", "closed", percent, lambda value: value > 0.0),
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


def legend(columns: Sequence[MetricColumn]) -> list[str]:
    """The lines that explain some columns, and the columns beside them."""
    loops = {"", *(column.mode for column in columns)}
    return [line for loop, line in LEGEND if loop in loops]


def _sum(values: list[float]) -> str:
    return f"{sum(values):.0f}"


def _mean_percent(values: list[float]) -> str:
    return percent(sum(values) / len(values))


COMPARED: tuple[tuple[str, str, str, Callable[[list[float]], str]], ...] = (
    ("ADE over 3 s, mean [m] (open)", "open", "ade.3s.mean", lambda v: f"{sum(v) / len(v):.2f}"),
    ("frames with fallback, mean (open)", "open", "fallback.rate", _mean_percent),
    ("goal reached (closed)", "closed", "goal.final", lambda v: f"{sum(v):.0f} of {len(v)}"),
    ("collisions at fault (closed)", "closed", "collision_at_fault.count", _sum),
    ("least gap [m] (closed)", "closed", "gap.min", lambda v: f"{min(v):.2f}"),
    (
        "off plan, worst [m] (closed)",
        "closed",
        "tracking_lateral.max_abs",
        lambda v: f"{max(v):.2f}",
    ),
    ("least TTC [s] (closed)", "closed", "ttc.min", lambda v: f"{min(v):.1f}"),
    ("run into by the replay (closed)", "closed", "replay_contact.final", _sum),
    ("jerk beyond 4.13 m/s3, worst [s] (closed)", "closed", JERK_S, lambda v: f"{max(v):.1f}"),
    ("frames with fallback, mean (closed)", "closed", "fallback.rate", _mean_percent),
)
"""Label, loop, metric, and how its values over the logs are combined."""

ANSWERED: tuple[tuple[str, Callable[[list[float]], str]], ...] = (
    ("collision_at_fault.count", lambda v: f"{sum(v):.0f} collisions at fault"),
    ("goal.final", lambda v: f"{sum(v):.0f} of {counted(len(v), 'goal')}"),
    ("lon_accel.time_out_of_bounds", lambda v: f"{sum(v):.1f} s beyond -4.05 or 2.40 m/s2"),
    ("nuplan_closed.score.final", lambda v: f"nuPlan's score {sum(v) / len(v):.2f}"),
)
"""Metric of the closed loop, and its values over the logs in words: the answer of a report."""
MOST_FIRST = 3  # Number of drives that a report shows first


@dataclass(frozen=True)
class Cell:
    """A cell of a table."""

    text: str = NOTHING  # The value as text
    value: float = nan  # The value as a number; NaN: there is none
    bad: bool = False  # Whether it is marked
    outcome: str = ""  # The outcome that it states; "" if it states none
    # Logs and planners of the drives that it names, or of the one that it is about
    drives: tuple[tuple[str, str], ...] = ()
    code: bool = False  # Whether it is a rule or a command
    file: str = ""  # The file that shows it, relative to the result folder

    @property
    def is_list(self) -> bool:
        """Whether its text is the names of its drives."""
        return bool(self.drives) and self.text == ", ".join(log for log, _ in self.drives)


WEIGHT: Mapping[str, int] = {
    Outcome.FAIL.value: 0,
    Outcome.INCONCLUSIVE.value: 1,
    "": 2,
    Outcome.PASS.value: 3,
}


@dataclass(frozen=True)
class DriveRow:
    """A log and a planner, both loops."""

    log: str
    planner: str
    # The name of the planner with its marks: oracle, trusted, batched, not deterministic
    shown: str
    verdict: str  # The worst outcome of the gates on this log; "" if no gate applies
    # The place of its gravest failed gate among the rules by harm; their number if none fails
    gravity: int
    # The number of gates that apply, of all: "24/41", with a mark where nothing was in the way
    asked: str
    end: Cell
    cells: tuple[Cell, ...]  # One per column of `Overview.columns`
    files: tuple[str, ...]  # Traces and recordings, relative to the result folder
    folder: str  # Folder of the log, relative to the result folder

    @property
    def rank(self) -> tuple[int, int, int, str, str]:
        """Sort key, the worst drive first: verdict, gravest failed gate, most marked cells, name of
        log and planner.
        """
        marked = self.end.bad + sum(cell.bad for cell in self.cells)
        return WEIGHT[self.verdict], self.gravity, -marked, self.log, self.planner

    @property
    def recording(self) -> str:
        """The recording of the closed loop, otherwise of the open one; "" if there is none."""
        return next(iter(sorted(file for file in self.files if file.endswith(".rrd"))), "")

    @property
    def file(self) -> str:
        """What to open: the recording, otherwise the first trace."""
        return self.recording or next(iter(sorted(self.files)), "")


@dataclass(frozen=True)
class GateRow:
    """The verdict of a gate on one planner in one loop."""

    outcome: str  # "pass", "fail" or "inconclusive"
    rule: str  # "gap.min >= 0.5 [closed]"
    over: str  # The values that must pass: "worst" (every log), or an aggregate of the logs
    found: str  # In short: if it passes, the value nearest to the bound, otherwise the reason
    reason: str
    why: str
    planner: str  # planner, mode: "" if there was no drive to judge
    mode: str
    group: str  # The group of logs, for a gate over groups; otherwise ""
    log: str  # The worst log; "" if there is none
    value: float  # The judged value; NaN if there is none
    unit: str
    time_s: float  # When it occurred; NaN if it has no time


@dataclass(frozen=True)
class PassShare:
    """The number of logs of a group that pass, with the 95 % interval of the share
    (`replan.metrics.judge.aggregate`).
    """

    kind: str  # "suite", "family", "tag" or "dataset"; `group` is its name, "" for the suite
    group: str
    planner: str
    mode: str  # "open", "closed", or "both" together
    logs: int
    passed: int
    failed: int
    inconclusive: int
    missing: int  # Logs that could not be evaluated; like inconclusive logs, they do not pass
    share: float
    low: float
    high: float

    @property
    def name(self) -> str:
        """The group in words."""
        return "all logs" if self.kind == SUITE else f"{self.kind} {self.group}"

    @property
    def text(self) -> str:
        """The share in words: "15 of 17 pass: 88%, 95% interval 66% to 97%"."""
        interval = f"{100.0 * self.low:.0f}% to {100.0 * self.high:.0f}%"
        return (
            f"{self.passed} of {self.logs} pass: {100.0 * self.share:.0f}%, 95% interval {interval}"
        )


def over_all_logs(shares: Iterable[PassShare]) -> tuple[PassShare, ...]:
    """The pass shares over all logs, one per planner: of both loops together where both were
    run.
    """
    mine = [share for share in shares if share.kind == SUITE]
    together = {share.planner for share in mine if share.mode == BOTH}
    return tuple(share for share in mine if share.mode == BOTH or share.planner not in together)


@dataclass(frozen=True)
class Answer:
    """How a planner did: the logs that it passes, and `ANSWERED` in the closed loop."""

    planner: str
    share: PassShare | None  # The logs that it passes; None where nothing was judged
    values: tuple[str, ...]

    @property
    def text(self) -> str:
        """One line, without the planner."""
        share, counts = self.share, list[str]()
        if share is not None:
            lost = ((share.inconclusive, "inconclusive"), (share.missing, "could not be evaluated"))
            counts = [
                ", ".join([share.text, *(f"{count} {word}" for count, word in lost if count)])
            ]
        return "; ".join([*counts, *self.values])


@dataclass(frozen=True)
class Coverage:
    """The time and distance that were driven or planned along; `km` is NaN in open loop, where
    nothing is driven.
    """

    planner: str
    mode: str
    logs: int
    driven_s: float
    logged_s: float
    km: float

    @property
    def text(self) -> str:
        """One line."""
        word = "planned along" if self.mode == "open" else "driven"
        km = f", {self.km:.2f} km" if isfinite(self.km) else ""
        seconds = f"{self.driven_s:.0f} of {self.logged_s:.0f} s"
        return (
            f"{self.planner}, {self.mode} loop: {seconds} {word} in {counted(self.logs, 'log')}{km}"
        )


@dataclass(frozen=True)
class Interactions:
    """The logs that a planner passes in the closed loop, and in how many of them something was in
    its way.
    """

    planner: str
    passed: int
    in_the_way: int

    @property
    def text(self) -> str:
        """One line."""
        return (
            f"{self.planner}: {self.in_the_way} of {counted(self.passed, 'pass')} rest on an "
            "interaction;"
            " a blind driver passes the others, too"
        )


def worst_flips(comparison: Comparison) -> pd.DataFrame:
    """The verdicts that changed: new failures first, then gates that no longer fail.

    The closed loop first.
    """
    flips = comparison.flips
    rank = (
        4
        - 4 * (flips["after"] == "fail")
        - 2 * (flips["before"] == "fail")
        + (flips["mode"] == "open")
    )
    return flips.loc[rank.sort_values(kind="stable").index]


@dataclass(frozen=True)
class StageQuantiles:
    """The time of a stage: quantiles over all frames of both loops, ms, and its share of the whole
    plan.
    """

    planner: str
    stage: str
    p50_ms: float
    p95_ms: float
    p99_ms: float
    share: float


@dataclass(frozen=True)
class Overview:
    """The contents of a report, in its order."""

    outcome: str  # outcome, exit_code: Those of `replan evaluate`
    exit_code: int
    shard: str  # "2/5": the part of a run that this is, which is not judged; otherwise ""
    replan: str  # Version of replan that ran the drives
    config: str  # First 12 hex digits of the SHA-256 of the resolved configuration
    logs: int
    columns: tuple[MetricColumn, ...]
    # The drives in the order of the run; `columns` are the columns of their table
    drives: tuple[DriveRow, ...]
    planners: tuple[str, ...]  # Names of the planners, with marks; `answers` has a line about each
    answers: tuple[Answer, ...]
    compared: tuple[tuple[str, tuple[str, ...]], ...]
    frames: int  # The number of plans behind the latencies
    latency: tuple[StageQuantiles, ...]  # Stage times by planner and stage, the whole plan last
    # Failed and inconclusive gates first, without gates that apply to no log
    gates: tuple[GateRow, ...]
    # The gates that do not apply to some logs, with the commonest reason, a line each
    not_asked: tuple[str, ...]
    shares: tuple[PassShare, ...]  # Pass shares of the suite, families, tags and datasets
    coverage: tuple[Coverage, ...]  # The time and distance driven, by planner and loop
    # The passes that rest on an interaction, by planner; empty without a closed loop
    interactions: tuple[Interactions, ...]
    ensembles: int  # The number of verdicts that were tested with perturbed runs
    fragile: tuple[str, ...]  # The verdicts that changed, a sentence each
    notes: tuple[str, ...]  # Assumptions, with the number of logs, the commonest first
    failures: tuple[str, ...]  # Logs and planners that could not be evaluated
    comparison: Comparison | None  # The comparison with a baseline, if there is one
    # The contents of diagnosis.json, if `replan diagnose` was run
    diagnosis: Mapping[str, Any] | None = None
    # Charts that could not be drawn, a sentence each; known after the page is written
    broken: tuple[str, ...] = ()

    @property
    def ranked(self) -> tuple[DriveRow, ...]:
        """The drives, the worst first: the one ranking of all reports, of `replan view` and of
        pictures of a run.
        """
        return tuple(sorted(self.drives, key=lambda row: row.rank))

    @property
    def worst(self) -> DriveRow | None:
        """The drive to look at first."""
        return min(self.drives, key=lambda row: row.rank, default=None)

    @property
    def first(self) -> tuple[DriveRow, ...]:
        """The drives to look at first: the worst of those that do not pass, at most
        `MOST_FIRST`.
        """
        return tuple(row for row in self.ranked[:MOST_FIRST] if row.verdict != Outcome.PASS.value)

    @property
    def driven(self) -> tuple[str, ...]:
        """The time and distance driven, and the passes that rest on an interaction, a line each."""
        return (*(each.text for each in self.coverage), *(each.text for each in self.interactions))

    @property
    def first_closed(self) -> int:
        """The index of the first column of the closed loop.

        The end of its drive comes before it.
        """
        return next(
            (i for i, column in enumerate(self.columns) if column.mode == "closed"),
            len(self.columns),
        )

    @property
    def whole(self) -> tuple[PassShare, ...]:
        """The pass shares over all logs, one per planner, over the loops that were run."""
        return over_all_logs(self.shares)

    @property
    def grouped(self) -> tuple[PassShare, ...]:
        """The pass shares of groups of at least two logs, but not all, over the loops that were
        run, sorted.
        """
        modes = {share.planner: share.mode for share in self.whole}
        mine = [
            share
            for share in self.shares
            if 1 < share.logs < self.logs and share.mode == modes[share.planner]
        ]
        return tuple(sorted(mine, key=lambda share: share.share))
