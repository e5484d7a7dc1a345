"""The overview of a run, as plain words and numbers; terminal, Markdown and HTML render it, and
nothing else.

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
from hashlib import sha256
from math import isfinite, nan
from pathlib import Path
from typing import Any

import pandas as pd
import tomli_w

from replan.core.files import read_toml
from replan.core.names import counted
from replan.draw.charts.subject import GRAVE, gravity
from replan.draw.drawn_results import Results
from replan.draw.report.contents import (
    ANSWERED,
    COLUMNS,
    COMPARED,
    FREE,
    NOTHING,
    WEIGHT,
    Answer,
    Cell,
    Coverage,
    DriveRow,
    GateRow,
    Interactions,
    MetricColumn,
    Overview,
    PassShare,
    StageQuantiles,
    over_all_logs,
)
from replan.logs.trace import EndReason, Mode
from replan.metrics.comparison import Comparison
from replan.metrics.judge import outcomes, worst
from replan.metrics.judge.aggregate import LogLabels, membership, pass_shares, standings
from replan.metrics.judge.discrimination import BLIND_FAILS
from replan.metrics.judge.gates import Outcome
from replan.metrics.judge.verdicts import judge_deadline
from replan.replay.drive import Mark
from replan.results.tables import OUTCOMES

EXIT_WEIGHT = (2, 3, 1, 4, 0)
"""Exit codes by priority: several codes are combined into the first in this order (3 beats 1 beats
4).
"""

Key = tuple[str, str]  # Log and planner


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
    found = results.measured[results.measured["available"].astype(bool)]
    ensemble = found[found["metric"] == "ensemble.fragile"]
    keys = zip(found["log"], found["planner"], found["mode"], found["metric"], strict=True)
    values = dict(zip(keys, map(float, found["value"]), strict=True))
    over_logs: dict[tuple[str, str, str], list[float]] = {}
    for (_, planner, mode, metric), value in values.items():
        over_logs.setdefault((planner, mode, metric), []).append(value)
    verdicts = log_outcomes(results)
    columns = tuple(
        column for column in COLUMNS if column.mode in [mode.value for mode in results.run.modes]
    )
    drives = _drives(results, values, columns, verdicts)
    gates, not_asked = _gates(results, verdicts)
    planners = {
        name: marked(list(mine.itertuples()))
        for name, mine in results.drives.groupby("planner", sort=False)
    }
    compared, latency, coverage = _of_planners(results, over_logs, [*map(str, planners)])
    labels = results.labels | dict.fromkeys(results.unread, LogLabels())
    crashed = [(row["log"], row["planner"], row["mode"]) for row in results.summary["failures"]]
    stand = standings(verdicts, results.drives, list(labels), results.run.drives, crashed)
    names = [
        "kind",
        "group",
        "planner",
        "mode",
        "logs",
        "passed",
        "failed",
        "inconclusive",
        "missing",
        "mean",
    ]
    rows = pass_shares(stand, labels)[[*names, "low", "high"]].itertuples(index=False)
    shares = [PassShare(*row[:4], *(int(count) for count in row[4:9]), *row[9:]) for row in rows]
    shares = [] if "shard" in results.summary else shares
    failures = (
        f"{row['message']} [{row['planner']}, {row['mode']} loop]"
        if row["planner"]
        else str(row["message"])
        for row in results.summary["failures"]
    )
    settings = read_toml(results.path / "run.toml")
    settings.pop("selection", None)  # the places of logs
    return Overview(
        outcome=str(results.summary["outcome"]) if code == results.exit_code else OUTCOMES[code],
        exit_code=code,
        shard=str(results.summary.get("shard", "")),
        replan=str(results.summary["replan"]),
        config=sha256(tomli_w.dumps(settings).encode()).hexdigest()[:12],
        logs=len(results.logs),
        columns=columns,
        drives=drives,
        planners=tuple(planners.values()),
        answers=tuple(_answers(planners, shares, over_logs)),
        compared=tuple(compared),
        frames=int((results.timings["stage"] == "total").sum()),
        latency=tuple(latency),
        gates=gates,
        not_asked=tuple(not_asked),
        shares=tuple(shares),
        coverage=tuple(coverage),
        interactions=tuple(_interactions(stand, values)),
        ensembles=len(ensemble),
        fragile=tuple(
            f"{row.log} [{row.planner}, {row.mode} loop]: {row.reason}"
            for row in ensemble[ensemble["value"] > 0.0].itertuples()
        ),
        notes=tuple(_notes(results.summary["logs"])),
        failures=tuple(map(without_folders(results), failures)),
        comparison=comparison,
        diagnosis=diagnosis,
    )


def log_outcomes(results: Results) -> pd.DataFrame:
    """The verdict of each gate on each log, `Results.verdicts`, and of the deadline, if there is
    one.
    """
    deadline_s = results.run.deadline_s
    late = judge_deadline(results.timings, deadline_s, results.labels) if deadline_s > 0.0 else ()
    return (
        pd.concat([results.verdicts, outcomes(late)], ignore_index=True)
        if late
        else results.verdicts
    )


def without_folders(results: Results) -> Callable[[str], str]:
    """A function that removes the folders of the logs from a text."""
    labels = [Path(label) for label in results.logs["source"]]
    folders = sorted(
        {f"{path.parent}{os.sep}" for path in labels if path.is_absolute()}, key=len, reverse=True
    )

    def short(text: str) -> str:
        for folder in folders:
            text = text.replace(folder, "")
        return text

    return short


def combined(codes: Iterable[int]) -> int:
    """Several exit codes as one."""
    return min(codes, key=EXIT_WEIGHT.index, default=0)


def marked(drives: Sequence[Any]) -> str:
    """The name of the planner of drives, with marks: oracle, trusted, batched, not
    deterministic.
    """
    marks = ["oracle"] if any(drive.oracle for drive in drives) else []
    marks += [mark.value for mark in Mark if any(mark.value in drive.marks for drive in drives)]
    return " ".join([str(drives[0].planner), *(f"({mark})" for mark in marks)])


Values = Mapping[tuple[str, str, str, str], float]  # Values by log, planner, mode and metric
# The values of all logs by planner, mode and metric
OverLogs = Mapping[tuple[str, str, str], list[float]]


# drives -------------------------------------------------------------------------------------------


def _drives(
    results: Results, values: Values, columns: Sequence[MetricColumn], verdicts: pd.DataFrame
) -> tuple[DriveRow, ...]:
    judged: dict[Key, list[Outcome]] = {}
    broken: dict[Key, list[int]] = {}
    columns_of = (verdicts[name] for name in ("log", "planner", "outcome", "metric"))
    for log, planner, outcome, metric in zip(*columns_of, strict=True):
        judged.setdefault((log, planner), []).append(Outcome(outcome))
        if outcome == Outcome.FAIL.value:
            broken.setdefault((log, planner), []).append(gravity(metric))
    grouped: dict[Key, list[Any]] = {}
    for drive in results.drives.itertuples():
        grouped.setdefault((str(drive.log), str(drive.planner)), []).append(drive)
    folders = dict(zip(results.logs["log"], results.logs["folder"], strict=True))
    rows = []
    for (log, planner), mine in grouped.items():
        each = judged.get((log, planner), [])
        verdict = worst(each).value if each else ""
        asked = (
            f"{sum(outcome is not Outcome.NOT_ASKED for outcome in each)}/{len(each)}"
            if each
            else ""
        )
        if (
            verdict == Outcome.PASS.value
            and values.get((log, planner, "closed", BLIND_FAILS), 1.0) == 0.0
        ):
            asked += FREE
        found = [
            (column, values.get((log, planner, column.mode, column.metric), nan))
            for column in columns
        ]
        cells = (
            Cell(c.show(value), value, c.bad(value)) if isfinite(value) else Cell()
            for c, value in found
        )
        end = Cell()
        for drive in mine:
            if drive.mode == "closed":
                about = f": {drive.detail}" if drive.end in CONTACTS else ""
                end = Cell(
                    f"{SHORT.get(drive.end, drive.end)}{about}",
                    float(drive.t_end_s),
                    drive.end not in GOOD,
                )
        files = tuple(file for drive in mine for file in drive.files)
        grave = min(broken.get((log, planner), ()), default=len(GRAVE))
        name = marked(mine)
        rows.append(
            DriveRow(
                log, planner, name, verdict, grave, asked, end, tuple(cells), files, folders[log]
            )
        )
    return tuple(rows)


GOOD = (EndReason.GOAL.value, EndReason.END_OF_LOG.value)
CONTACTS = (EndReason.COLLISION.value, EndReason.REPLAY_CONTACT.value)
SHORT = {
    EndReason.GOAL.value: "goal",
    EndReason.END_OF_LOG.value: "end of log",
    EndReason.REPLAY_CONTACT.value: "run into",
    EndReason.OFF_ROAD.value: "off the road",
    EndReason.PLANNER_FAILURE.value: "planner failed",
}


def _of_planners(
    results: Results, over_logs: OverLogs, planners: Sequence[str]
) -> tuple[list[tuple[str, tuple[str, ...]]], list[StageQuantiles], list[Coverage]]:
    """All drives of each planner: the metrics of `COMPARED`, the times of the stages, and the
    coverage.
    """
    compared = [
        (
            label,
            tuple(
                combine(some) if (some := over_logs.get((p, loop, metric))) else NOTHING
                for p in planners
            ),
        )
        for label, loop, metric, combine in COMPARED
        if loop in [mode.value for mode in results.run.modes]
    ]
    latency, coverage = list[StageQuantiles](), list[Coverage]()
    for planner, rows in results.timings.groupby("planner", sort=False, observed=True):
        whole = float(rows.loc[rows["stage"] == "total", "seconds"].sum())
        by_stage = rows.groupby("stage", sort=False, observed=True)["seconds"]
        for stage, times in sorted(by_stage, key=lambda one: one[0] == "total"):
            p50, p95, p99 = (1e3 * float(times.quantile(q)) for q in (0.5, 0.95, 0.99))
            share = float(times.sum()) / whole if whole > 0.0 else nan
            latency.append(StageQuantiles(str(planner), str(stage), p50, p95, p99, share))
    names = ("coverage.log_s.final", "coverage.driven_s.final", "distance.final")
    for planner, mode in dict.fromkeys(
        zip(results.drives["planner"], results.drives["mode"], strict=True)
    ):
        logged, driven, metres = (over_logs.get((planner, mode, name), []) for name in names)
        if logged:
            km = sum(metres) / 1e3 if metres else nan
            coverage.append(Coverage(planner, mode, len(logged), sum(driven), sum(logged), km))
    return compared, latency, coverage


def _answers(
    planners: Mapping[Any, str], shares: Sequence[PassShare], over_logs: OverLogs
) -> Iterator[Answer]:
    """The answer of each planner: its pass share over the loops that were run, and `ANSWERED` where
    available.
    """
    share_of = {share.planner: share for share in over_all_logs(shares)}
    for planner, shown in planners.items():
        found = ((over_logs.get((planner, "closed", metric)), words) for metric, words in ANSWERED)
        yield Answer(
            shown, share_of.get(planner), tuple(words(values) for values, words in found if values)
        )


def _interactions(stand: pd.DataFrame, values: Values) -> Iterator[Interactions]:
    """The passes of each planner in the closed loop, and those of logs that the blind driver
    fails.
    """
    closed = stand[stand["mode"] == Mode.CLOSED.value]
    for planner, mine in closed.groupby("planner", sort=False):
        passed = [str(log) for log in mine.loc[mine["standing"] == "passed", "log"]]
        kept = [
            log
            for log in passed
            if values.get((log, str(planner), "closed", BLIND_FAILS), nan) == 1.0
        ]
        yield Interactions(str(planner), len(passed), len(kept))


# gates --------------------------------------------------------------------------------------------


def _gates(results: Results, verdicts: pd.DataFrame) -> tuple[tuple[GateRow, ...], list[str]]:
    """The verdicts, and the gates that do not apply to some drives, most drives first, with the
    commonest reason.
    """
    units = dict(zip(results.measured["metric"], results.measured["unit"], strict=True))
    found: dict[tuple[str, str, str], dict[str, str]] = {}
    names = ["gate", "log", "planner", "mode", "outcome"]
    for gate, log, planner, mode, outcome in verdicts[names].itertuples(index=False):
        found.setdefault((gate, planner, mode), {})[log] = outcome
    members = {
        f"{kind} {group}": set(logs) for (kind, group), logs in membership(results.labels).items()
    }
    rows, short = [], without_folders(results)
    for verdict in results.summary["gates"]:
        if verdict["outcome"] == Outcome.NOT_ASKED.value:
            continue
        unit = (
            ""
            if verdict["gate"]["over"] == "pass_share"
            else units.get(verdict["gate"]["metric"], "")
        )
        each = found.get((verdict["rule"], verdict["planner"], verdict["mode"]), {})
        mine = [
            outcome
            for log, outcome in each.items()
            if log in members.get(verdict.get("group"), each)
        ]
        mine = [outcome for outcome in mine if outcome != Outcome.NOT_ASKED.value]
        value, time_s = (
            nan if verdict[name] is None else float(verdict[name]) for name in ("value", "time_s")
        )
        outcome, why, log = (
            str(verdict["outcome"]),
            str(verdict["gate"]["reason"]),
            str(verdict["log"]),
        )
        planner, mode, group = (
            str(verdict["planner"]),
            str(verdict["mode"]),
            str(verdict.get("group", "")),
        )
        rule, over, reason = (
            str(verdict["rule"]),
            str(verdict["gate"]["over"]),
            short(verdict["reason"]),
        )
        # The value; if every log must pass, also the log nearest to the bound
        if outcome == Outcome.PASS.value:
            shown, lacking = (
                0.0 if abs(value) < 1e-9 else value,
                mine.count(Outcome.INCONCLUSIVE.value),
            )
            near = f"{shown:.3g}" if abs(shown) < 1e3 else f"{shown:.0f}"
            near += f" {unit}" if unit not in ("", "1", "count") else ""
            near += f", on {log}" if shown and over == "worst" else ""
            near = f"{100.0 * value:.3g}% of the logs" if over == "pass_share" else near
            aside = f"; no evidence in {lacking} of {len(mine)} logs" if lacking else ""
            about = f"{', '.join(filter(None, (planner, group)))}: {near}{aside}"
        else:
            about = reason + (
                f" (the gate: {why})" if why and outcome == Outcome.FAIL.value else ""
            )
        rows.append(
            GateRow(
                outcome,
                rule,
                over,
                about,
                reason,
                why,
                planner,
                mode,
                group,
                log,
                value,
                unit,
                time_s,
            )
        )
    drives, not_asked = verdicts.groupby("gate")["log"].count(), []
    unasked = verdicts[verdicts["outcome"] == Outcome.NOT_ASKED.value].groupby("gate", sort=True)[
        "reason"
    ]
    for asked, reasons in sorted(unasked, key=lambda one: (-len(one[1]), one[0])):
        common, number = Counter(reasons).most_common(1)[0][0], int(drives[asked])
        where = f": in {len(reasons)} of {counted(number, 'drive')}" if number > 1 else ""
        not_asked.append(f"{asked}{where} ({common})")
    return tuple(sorted(rows, key=lambda row: WEIGHT[row.outcome])), not_asked


# notes --------------------------------------------------------------------------------------------


def _notes(logs: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Every note once, with the number of logs; notes that differ only in numbers are merged."""
    count: Counter[str] = Counter()
    texts: dict[str, set[str]] = {}
    for log in logs:
        own = [*log["notes"], *(note for drive in log["drives"] for note in drive["notes"])]
        notes = {re.sub(r"[\d.]*\d", "#", note): note for note in own}
        count.update(notes.keys())
        for key, note in notes.items():
            texts.setdefault(key, set()).add(note)
    for key, concerned in count.most_common():
        first = min(texts[key]).rstrip(".")
        example = first if len(texts[key]) == 1 else f"for example: {first}"
        yield f"{example} ({concerned} of {counted(len(logs), 'log')})"
