"""Compares two runs, as result folders or baseline files, and finds the first differences of their
drives.

A baseline is one Parquet file: the rows of metrics.parquet (without the metrics' sources), and in
its metadata the settings and versions of the run, as JSON. It holds all that judging and comparing
need, but no traces; equal results give equal bytes.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from math import nan
from pathlib import Path
from typing import Any

import msgspec
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from replan.core.errors import ConfigError, LogError, unknown_name
from replan.core.files import Near, check_named, read_toml
from replan.core.settings import flat
from replan.draw.drawn_results import Results, loaded
from replan.explain.first_difference import first_difference, planners_part
from replan.logs.mcap import read_trace
from replan.logs.mcap.container import read_container
from replan.metrics import COLUMNS, METRICS, load_metric
from replan.metrics.comparison import PARTING_COLUMNS, Comparison, Side, compare
from replan.metrics.comparison_rules import judge_rules
from replan.metrics.judge import REFERENCE
from replan.metrics.judge.gates import GateRule, load_gates, load_rules
from replan.metrics.judge.verdicts import DRIVE
from replan.results.load import RECORDINGS
from replan.results.log_result import LogFileCard
from replan.results.schema import SCHEMA_VERSION, check_table, checked, read_json
from replan.results.tables import LOG_CARD, write_file

MOST_PARTINGS = 20
"""The first difference is searched in at most this many drives, the worst first."""
BASELINE = b"replan_baseline"
"""Key of the metadata of a baseline's file."""
NOT_INPUTS = (
    "recording",
    "foxglove",
    "internals",
    "gates",
    "planners",
    "mode",
    "metrics",
    "charts",
    "deadline_s",
    "ensemble",
    "repeat_s",
    "selection",
)
"""Keys of a run that change no drive, or whose changes are visible in the set of drives."""
UNKNOWN = "not known"
"""Stage of the first difference if a trace cannot be read."""


NOT_IN_BASELINE = ("schema_version", "source", "about")
"""Columns of metrics.parquet that a baseline may lack."""


class BaselineLog(msgspec.Struct):
    """A log in the head of a baseline."""

    log: str
    sha256: str
    family: str
    dataset: str
    tags: list[str]
    vehicle: str


class Head(msgspec.Struct):
    """The head of a baseline."""

    facts: dict[str, str]
    logs: list[BaselineLog]
    failed: dict[str, str]
    metrics: tuple[str, ...]
    crashed: tuple[tuple[str, str, str], ...] = ()


Run = Results | Side
"""A run to compare: a result folder, or a baseline's file, which holds the tables and no traces."""


def read_run(path: Path | str) -> Run:
    """Read a run from a result folder, or from a file of `write_baseline`; either may be a URL.

    Raises:
        ConfigError: It does not exist, or has another version.
        LogError: It is damaged.
    """
    near = Near(path, RECORDINGS)
    check_named(near.path)
    if not near.path.is_file():
        return loaded(near)
    path = near.path
    again = f"`replan baseline RESULTS -o {path.name}` writes one"
    try:
        table = pq.read_table(path, partitioning=None)
        content = (table.schema.metadata or {})[BASELINE]
        raw = msgspec.json.decode(content)
    except KeyError:
        raise ConfigError(f"{path}: is not a baseline; {again}") from None
    except (OSError, pa.ArrowException, ValueError, RecursionError) as error:
        raise LogError(f"cannot be read as a baseline: {error}", file=path) from None
    head = checked(path, raw, Head, again)[1]
    table = table.replace_schema_metadata(None)
    check_table(table, path, "metrics.parquet", NOT_IN_BASELINE, again)
    rows = table.to_pandas()
    rows = rows.assign(source="", about=rows.get("about"))[list(COLUMNS)]
    logs = pd.DataFrame(msgspec.to_builtins(head.logs), columns=list(BaselineLog.__struct_fields__))
    if logs["log"].duplicated().any() or not {*rows["log"]} <= {*logs["log"]}:
        raise LogError("its head has not one row for each log", file=path, remedy=again)
    return Side(path.name, rows, logs, head.facts, head.failed, head.crashed, head.metrics)


def side_of(run: Run) -> Side:
    """Return the tables of a run for `replan.metrics.comparison`; LogError if they are damaged."""
    if isinstance(run, Side):
        return run
    try:
        table = run.logs
        logs = table[["log", "sha256", "family", "dataset", "tags"]].copy()
        # For each log, the hash of the vehicle in a trace of its drives; "" without a trace
        vehicles = []
        for log in run.summary["logs"]:
            named = (run.path / file for drive in log.get("drives", ()) for file in drive["files"])
            trace = next(
                (file for file in named if file.suffix == ".mcap" and file.is_file()), None
            )
            stream = read_container(trace).streams.get("/vehicle") if trace else None
            vehicles.append(hashlib.sha256(stream.payloads[0]).hexdigest()[:12] if stream else "")
        logs["vehicle"] = vehicles
        messages = {row.log: str(row.message) for row in run.failures.itertuples()}
        failed = {log: messages.get(log, "not evaluated") for log in sorted(run.unread)}
        rows = run.failures[["log", "planner", "mode"]].dropna().drop_duplicates()
        crashed = tuple(rows.itertuples(index=False, name=None))
        facts = {
            "replan": str(run.summary.get("replan", "")),
            "Python": str(run.summary.get("python", "")),
        }
        cards = (run.path / str(folder) / LOG_CARD for folder in table["folder"] if folder)
        if (card := next((card for card in cards if card.is_file()), None)) is not None:
            facts["code (SHA-256)"] = read_json(card, LogFileCard)[1].code[:12]
        settings = read_toml(run.path / "run.toml")
        inputs = {key: value for key, value in settings.items() if key not in NOT_INPUTS}
        facts |= {key: str(value) for key, value in flat(inputs)}
        own = tuple(settings.get("metrics", ()))
        return Side(run.path.name, run.measured, logs, facts, failed, crashed, own)
    except (OSError, ValueError, KeyError) as error:
        raise LogError(f"cannot be read as results: {error}", file=run.path) from None


# the file -----------------------------------------------------------------------------------------


def is_baseline(path: Path) -> bool:
    """Return whether a file is a baseline; ValueError or OSError if it is no Parquet file."""
    return BASELINE in (pq.read_schema(path).metadata or {})


def write_baseline(run: Run, path: Path) -> None:
    """Write a run as one file; equal results give equal bytes."""
    side = side_of(run)
    head = {
        "schema_version": SCHEMA_VERSION,
        "facts": dict(side.facts),
        "logs": side.logs.to_dict("records"),
        "failed": dict(side.failed),
        "crashed": [list(drive) for drive in side.crashed],
        "metrics": list(side.metrics),
    }
    table = pa.Table.from_pandas(side.table.drop(columns="source"), preserve_index=False)
    table = table.replace_schema_metadata(
        {BASELINE: json.dumps(head, ensure_ascii=False, sort_keys=True)}
    )
    write_file(
        path,
        lambda partial: pq.write_table(table, partial, compression="zstd", compression_level=19),
    )


# comparing ----------------------------------------------------------------------------------------


def compare_runs(
    baseline: Run,
    candidate: Run,
    planners: tuple[str, ...] = (),
    *,
    gates: Path | None = None,
    more: tuple[GateRule, ...] = (),
    partings: int = MOST_PARTINGS,
) -> Comparison:
    """Compare two runs, and judge the comparison by the rules.

    Args:
        baseline: The run before.
        candidate: The run after.
        planners: One: only this planner of both. Two: the first of the baseline with the second of
            the candidate.
        gates: A file of gates and rules; None: the packaged ones.
        more: Rules beside those of the file.
        partings: The first difference is searched in at most this many drives, the worst first.

    Raises:
        ConfigError: A planner is not in its run, or the gates cannot be read.
        LogError: The tables of a run are damaged.
    """
    pair = (planners[0], planners[-1]) if planners else None
    before, after = side_of(baseline), side_of(candidate)
    own = (load_metric(spec) for spec in dict.fromkeys((*before.metrics, *after.metrics)))
    metrics = {**METRICS, **{metric.name: metric for metric in own}}
    common = set(_driven_planners(before)) & set(_driven_planners(after))
    if pair is not None:  # under one name that both sides share
        if before.label == after.label:
            before, after = (
                replace(before, label=f"{before.label}: {pair[0]}"),
                replace(after, label=f"{after.label}: {pair[1]}"),
            )
        name = pair[0] if pair[0] == pair[1] else " -> ".join(pair)
        before, after = (
            _select_planner(before, pair[0], name),
            _select_planner(after, pair[1], name),
        )
        common = {pair[0]} & {pair[1]}
    # Without settings of planners of only one side
    settings = tuple(f"planner.{planner}." for planner in common)
    before, after = (
        replace(
            side,
            facts={
                key: value
                for key, value in side.facts.items()
                if not key.startswith("planner.") or key.startswith(settings)
            },
        )
        for side in (before, after)
    )
    rules = (*load_rules(gates, metrics=metrics), *more)
    comparison = compare(
        before, after, load_gates(gates, metrics=metrics), {rule.metric for rule in rules} - {""}
    )
    comparison = judge_rules(rules, comparison, before.labels | after.labels)
    if not (isinstance(baseline, Results) and isinstance(candidate, Results) and partings):
        return comparison
    return _with_first_differences(comparison, (baseline, candidate), pair, partings)


def _driven_planners(side: Side) -> tuple[str, ...]:
    return tuple(dict.fromkeys(side.driven["planner"]))


def _select_planner(side: Side, planner: str, name: str) -> Side:
    """Return the rows of one planner under a name that both sides share.

    If it is renamed, it is not an oracle.
    """
    if planner not in _driven_planners(side):
        raise unknown_name("planner (in the run)", planner, _driven_planners(side))
    table = side.table
    rows = table[table["planner"] == planner].assign(planner=name)
    rows = rows if name == planner else rows.assign(oracle=False)
    references = table[table["mode"] == REFERENCE]
    crashed = tuple((log, name, mode) for log, driven, mode in side.crashed if driven == planner)
    return replace(side, table=pd.concat([rows, references], ignore_index=True), crashed=crashed)


def _with_first_differences(
    comparison: Comparison, runs: tuple[Results, Results], pair: tuple[str, str] | None, limit: int
) -> Comparison:
    """Add first differences to the comparison: of drives with flips first, then of the worst
    regressions.
    """
    order = pd.concat([comparison.flips[DRIVE], comparison.pairs[DRIVE]]).drop_duplicates()
    rows: list[tuple[Any, ...]] = []
    looked = 0
    for log, planner, mode in order.itertuples(index=False, name=None):
        names = pair or (planner, planner)
        files = [
            results.drive(log, name, mode).trace_file
            for results, name in zip(runs, names, strict=True)
        ]
        if all(file.is_file() for file in files) and files[0].read_bytes() == files[1].read_bytes():
            continue
        looked += 1
        if looked > limit:
            continue
        try:
            first, second = (read_trace(file)[0] for file in files)
        except LogError as error:
            rows.append((log, planner, mode, nan, UNKNOWN, f"a trace cannot be read: {error}"))
            continue
        difference, parted = (
            first_difference(first, second),
            planners_part(first, second) if names[0] != names[1] else None,
        )
        if difference is not None:  # for two planners, at the time at which their drives differ
            time, description = (
                (parted.t, f"{parted.what}; first difference: {difference.what}")
                if parted
                else (difference.t, difference.what)
            )
            rows.append((log, planner, mode, time, difference.stage, description))
    table = pd.DataFrame(rows, columns=list(PARTING_COLUMNS)).astype({"t_s": float})
    return replace(comparison, partings=table, not_looked_at=max(looked - limit, 0))


def view_command(run: Run, log: str, planner: str, mode: str) -> str:
    """Return the command that shows a drive; "" for a baseline file.

    For planners "a -> b", it shows the drive of b.
    """
    if isinstance(run, Side):
        return ""
    drive = run.drive(log, planner.split(" -> ")[-1], mode)
    recording = drive.trace_file.with_suffix(".rrd")
    return f"replan view {recording if recording.is_file() else drive.trace_file}"
