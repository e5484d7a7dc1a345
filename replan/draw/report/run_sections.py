"""What a run found, as sections: the answer first. Terminal, Markdown and HTML render them in the
same way.

A new part of the reports is one function here.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from math import nan
from typing import Any

from replan.core.names import counted
from replan.draw.report.drive_table import JERK_S, DriveRow, MetricColumn, legend, percent
from replan.draw.report.overview import GateRow, Overview, merged_notes, without_folders
from replan.draw.report.section import (
    Cell,
    ReportColumn,
    ReportSection,
    number_cell,
    number_column,
    outcome_cell,
    text_column,
    with_contents,
)
from replan.logs.trace import Mode
from replan.metrics.judge.aggregate import SUITE
from replan.metrics.judge.discrimination import BLIND_FAILS
from replan.metrics.judge.gates import Outcome

BROKEN = "Charts that could not be drawn"
FRAGILE = "ensemble.fragile"  # Metric of a drive: its verdict changes under a perturbation


def run_sections(over: Overview) -> list[ReportSection]:
    """The sections of a run, in their order; those with nothing to say are left out."""
    failures, notes = _failures(over), list(merged_notes(over.results.summary["logs"]))
    sections = [
        ReportSection(
            f"Could not be evaluated ({len(failures)})", lines=failures, rest="summary.json"
        ),
        *_gates(over),
        *_diagnosis(over),
        *_shares(over),
        _drives(over),
        *_planners(over),
        ReportSection("Driven", lines=[*_coverage(over), *_interactions(over)], key="driven"),
        *_ensemble(over),
        ReportSection(BROKEN, lines=over.broken, most=12, rest="report.html"),
        ReportSection(counted(len(notes), "note"), lines=notes, folded=True, rest="summary.json"),
        _latency(over),
    ]
    return with_contents(sections)


def _failures(over: Overview) -> list[str]:
    short = without_folders(over.results)
    return [
        short(row["message"])
        + (f" [{row['planner']}, {row['mode']} loop]" if row["planner"] else "")
        for row in over.results.summary["failures"]
    ]


# gates --------------------------------------------------------------------------------------------


def _rule_cell(row: GateRow) -> Cell:
    loop = f" [{row.mode}]" if row.mode and f"[{row.mode}]" not in row.rule else ""
    return Cell(row.rule + loop, code=True)


def _finding_cell(row: GateRow) -> Cell:
    return Cell(row.finding, drives=((row.log, row.planner),) if row.log else ())


def _gate_line(row: GateRow) -> str:
    return f"{row.outcome.upper()}: {_rule_cell(row).text}: {row.finding}"


GATES = (
    ReportColumn("outcome", lambda row: outcome_cell(row.outcome)),
    ReportColumn("rule", _rule_cell),
    ReportColumn("what was found", _finding_cell),
)


def _gates(over: Overview) -> Iterator[ReportSection]:
    if over.shard:
        remark = f"Not judged: shard {over.shard}; `replan merge` judges all shards together."
        yield ReportSection("Gates", remarks=[remark])
        return
    good = [row for row in over.gates if row.outcome == Outcome.PASS.value]
    bad = [row for row in over.gates if row.outcome != Outcome.PASS.value]
    fine = [] if bad else ["No gate fails, none is inconclusive."]
    yield ReportSection(
        "Gates", GATES, bad, remarks=fine, rest="report.html", key="gates", as_line=_gate_line
    )
    title = f"{counted(len(good), 'verdict')} of gates: pass"
    yield ReportSection(title, GATES, good, folded=True, most=6, rest="report.html")
    lines = _not_asked(over)
    title = f"{counted(len(lines), 'gate')} not asked of some drives"
    yield ReportSection(title, lines=lines, folded=True, most=12, rest="report.html")


def _not_asked(over: Overview) -> list[str]:
    """The gates that do not apply to some drives, most drives first, with the commonest reason."""
    drives = over.verdicts["gate"].value_counts()
    is_unasked = over.verdicts["outcome"] == Outcome.NOT_ASKED.value
    by_gate = over.verdicts[is_unasked].groupby("gate", sort=True)["reason"]
    lines = []
    for gate, reasons in sorted(by_gate, key=lambda group: -len(group[1])):
        ((reason, _),) = Counter(reasons).most_common(1)
        of_all = f": in {len(reasons)} of {drives[gate]} drives" if drives[gate] > 1 else ""
        lines.append(f"{gate}{of_all} ({reason})")
    return lines


# why ----------------------------------------------------------------------------------------------


def _diagnosis(over: Overview) -> Iterator[ReportSection]:
    if over.diagnosis is None:
        return
    planner, clusters = over.diagnosis["planner"], over.diagnosis["clusters"]

    def field(name: str) -> Callable[[Any], Cell]:
        return lambda cluster: Cell(cluster.get(name, ""))

    def logs(cluster: Any) -> Cell:
        pairs = tuple((log, planner) for log in cluster["drives"])
        return Cell(", ".join(cluster["drives"]), drives=pairs)

    columns = (
        ReportColumn("drives", lambda row: number_cell(len(row["drives"])), is_number=True),
        ReportColumn("what happens", field("happens")),
        ReportColumn("cause", field("cause")),
        ReportColumn("because it", field("why")),
        ReportColumn("gates", lambda row: Cell(", ".join(row["gates"]))),
        ReportColumn("about", field("about")),
        ReportColumn("which", logs),
    )
    lines = [line.strip() for line in over.diagnosis["said"]]
    yield ReportSection(f"Why {planner} fails", columns, clusters, lines)


# the logs that pass -------------------------------------------------------------------------------


def group_name(row: Any) -> str:
    """The group of logs of a row of `pass_shares`, in words."""
    return "all logs" if row.kind == SUITE else f"{row.kind} {row.group}"


SHARES = (
    ReportColumn("logs", lambda row: Cell(group_name(row))),
    text_column("planner"),
    text_column("loop", "mode"),
    ReportColumn("pass", lambda row: Cell(f"{row.passed} of {row.logs}"), is_number=True),
    number_column("share", "mean", "{:.0%}".format),
    ReportColumn(
        "95 % interval",
        lambda row: Cell(f"{100.0 * row.low:.0f} to {100.0 * row.high:.0f}%"),
        is_number=True,
    ),
    number_column("fail", "failed", "{:.0f}".format),
    number_column("inconclusive", show="{:.0f}".format),
    number_column("not evaluated", "missing", "{:.0f}".format),
)


def _shares(over: Overview) -> Iterator[ReportSection]:
    remark = (
        "Shares of all logs: a log that is inconclusive or could not be evaluated does not pass."
    )
    whole, grouped = (list(table.itertuples()) for table in (over.whole, over.grouped))
    if whole:
        yield ReportSection("Logs that pass", SHARES, whole, remarks=[remark], key="shares")
    title = "Logs that pass, by family, tag and dataset"
    yield ReportSection(title, SHARES, grouped, folded=True, most=12, rest="groups.parquet")


# drives -------------------------------------------------------------------------------------------


def _log_cell(row: DriveRow) -> Cell:
    return Cell(row.log, drives=((row.log, row.planner),), file=row.file)


def _drives(over: Overview) -> ReportSection:
    modes = {column.mode for column in over.columns}

    def value_column(column: MetricColumn) -> ReportColumn:
        title = f"{column.words}, {column.mode}" if len(modes) > 1 else column.words
        return ReportColumn(title, column.cell, True, column.title, column.metric)

    columns = [ReportColumn("log", _log_cell)]
    columns += [text_column("planner", "shown")] if len(over.planners) > 1 else []
    columns += [ReportColumn("verdict", lambda row: outcome_cell(row.verdict, f" {row.asked}"))]
    columns += [value_column(column) for column in over.columns if column.mode == "open"]
    if "closed" in modes:
        end = ReportColumn(
            "closed loop ended by", lambda row: row.end, short="closed loop\nended by"
        )
        columns.append(end)
    columns += [value_column(column) for column in over.columns if column.mode == "closed"]
    return ReportSection(
        "Drives",
        columns,
        over.drives,
        remarks=legend(over.columns),
        most=8,
        rest="metrics.csv",
        key="drives",
    )


# planners -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ComparedMetric:
    """A row of the table of planners."""

    label: str
    mode: str
    metric: str
    combine: Callable[[list[float]], str]  # Its values over the logs, as one


def _sum(values: list[float]) -> str:
    return f"{sum(values):.0f}"


def _mean_percent(values: list[float]) -> str:
    return percent(sum(values) / len(values))


COMPARED = (
    ComparedMetric(
        "ADE over 3 s, mean [m] (open)",
        "open",
        "ade.3s.mean",
        lambda values: f"{sum(values) / len(values):.2f}",
    ),
    ComparedMetric("frames with fallback, mean (open)", "open", "fallback.rate", _mean_percent),
    ComparedMetric(
        "goal reached (closed)",
        "closed",
        "goal.final",
        lambda values: f"{sum(values):.0f} of {len(values)}",
    ),
    ComparedMetric("collisions at fault (closed)", "closed", "collision_at_fault.count", _sum),
    ComparedMetric(
        "least gap [m] (closed)", "closed", "gap.min", lambda values: f"{min(values):.2f}"
    ),
    ComparedMetric(
        "off plan, worst [m] (closed)",
        "closed",
        "tracking_lateral.max_abs",
        lambda values: f"{max(values):.2f}",
    ),
    ComparedMetric(
        "least TTC [s] (closed)", "closed", "ttc.min", lambda values: f"{min(values):.1f}"
    ),
    ComparedMetric("run into by the replay (closed)", "closed", "replay_contact.final", _sum),
    ComparedMetric(
        "jerk beyond 4.13 m/s3, worst [s] (closed)",
        "closed",
        JERK_S,
        lambda values: f"{max(values):.1f}",
    ),
    ComparedMetric("frames with fallback, mean (closed)", "closed", "fallback.rate", _mean_percent),
)


def _planners(over: Overview) -> Iterator[ReportSection]:
    if len(over.planners) < 2:
        return

    def value(planner: str, row: ComparedMetric) -> Cell:
        values = over.over_logs.get((planner, row.mode, row.metric))
        return Cell(row.combine(values)) if values else Cell()

    columns = [
        text_column("over all logs", "label"),
        *(ReportColumn(name, partial(value, key), True) for key, name in over.planners.items()),
    ]
    modes = [mode.value for mode in over.results.run.modes]
    yield ReportSection("Planners", columns, [row for row in COMPARED if row.mode in modes])


def _coverage(over: Overview) -> Iterator[str]:
    """The time and distance that were driven or planned along, by planner and loop."""
    pairs = over.results.drives[["planner", "mode"]].drop_duplicates()
    for planner, mode in pairs.itertuples(index=False, name=None):
        logged_s = over.over_logs.get((planner, mode, "coverage.log_s.final"), [])
        driven_s = over.over_logs.get((planner, mode, "coverage.driven_s.final"), [])
        distances_m = over.over_logs.get((planner, mode, "distance.final"), [])
        if logged_s:
            seconds = f"{sum(driven_s):.0f} of {sum(logged_s):.0f} s"
            verb = "planned along" if mode == Mode.OPEN.value else "driven"
            km = f", {sum(distances_m) / 1e3:.2f} km" if distances_m else ""
            logs = counted(len(logged_s), "log")
            yield f"{planner}, {mode} loop: {seconds} {verb} in {logs}{km}"


def _interactions(over: Overview) -> Iterator[str]:
    """The passes of each planner in the closed loop, and those of logs that the blind driver
    fails.
    """
    closed = over.standings[over.standings["mode"] == Mode.CLOSED.value]
    for planner, rows in closed.groupby("planner", sort=False):
        passed = rows.loc[rows["standing"] == "passed", "log"]
        keys = ((str(log), str(planner), "closed", BLIND_FAILS) for log in passed)
        in_the_way = sum(over.values.get(key) == 1.0 for key in keys)
        yield (
            f"{planner}: {in_the_way} of {counted(len(passed), 'pass')} rest on an interaction; "
            "a blind driver passes the others, too"
        )


def _ensemble(over: Overview) -> Iterator[ReportSection]:
    measured = over.results.measured
    tested = measured[(measured["metric"] == FRAGILE) & measured["available"].astype(bool)]
    fragile = [
        f"{row.log} [{row.planner}, {row.mode} loop]: {row.reason}"
        for row in list[Any](tested[tested["value"] > 0.0].itertuples())
    ]
    if len(tested):
        title = f"Ensemble: {len(fragile)} of {len(tested)} verdicts are fragile"
        yield ReportSection(title, lines=fragile or ["none"], rest="metrics.csv")


# time ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class StageTimes:
    """The time of a stage of planning over all frames of both loops."""

    planner: str
    stage: str
    p50_ms: float
    p95_ms: float
    p99_ms: float
    share: float  # Its part of the whole plan; NaN if no time passed


LATENCY = (
    text_column("planner"),
    text_column("stage"),
    number_column("p50 [ms]", "p50_ms", "{:.2f}".format),
    number_column("p95 [ms]", "p95_ms", "{:.2f}".format),
    number_column("p99 [ms]", "p99_ms", "{:.2f}".format),
    number_column("share", show="{:.0%}".format),
)


def _latency(over: Overview) -> ReportSection:
    timings, rows = over.timings, list[StageTimes]()
    for planner, of_planner in timings.groupby("planner", sort=False, observed=True):
        stages = dict(iter(of_planner.groupby("stage", sort=False, observed=True)["seconds"]))
        whole_s = float(stages["total"].sum()) if "total" in stages else 0.0
        for stage in sorted(stages, key="total".__eq__):  # the whole plan last
            seconds = stages[stage]
            p50_ms, p95_ms, p99_ms = 1e3 * seconds.quantile([0.5, 0.95, 0.99])
            share = float(seconds.sum()) / whole_s if whole_s > 0.0 else nan
            rows.append(StageTimes(str(planner), str(stage), p50_ms, p95_ms, p99_ms, share))
    frames = int((timings["stage"] == "total").sum())
    title = f"Planning time (wall clock, {counted(frames, 'plan')})"
    return ReportSection(title, LATENCY, rows, folded=True, rest="timings.parquet")
