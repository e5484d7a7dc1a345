"""Compares two runs, as result folders or baseline files, and finds the first differences of their
drives.

A baseline is one Parquet file: the rows of metrics.parquet (without the metrics' sources), and in
its metadata the settings and versions of the run, as JSON. It holds all that judging and comparing
need, but no traces; equal results give equal bytes.
"""

from __future__ import annotations

import hashlib
import json
import shlex
from dataclasses import replace
from math import nan
from pathlib import Path
from typing import Any

import msgspec
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from replan.core.errors import ConfigError, LogError, unknown_name
from replan.core.files import check_named, read_toml
from replan.core.settings import flat
from replan.core.urls import Near
from replan.draw.drawn_results import Results, loaded
from replan.explain.first_difference import first_difference
from replan.explain.planners_part import planners_part
from replan.logs.mcap import read_trace
from replan.logs.mcap.container import read_container
from replan.logs.scenario import Scenario
from replan.logs.trace import Trace
from replan.metrics import COLUMNS, METRICS, load_metric
from replan.metrics.comparison import PARTING_COLUMNS, PARTING_NUMBERS, Comparison, Side, compare
from replan.metrics.comparison_rules import judge_rules
from replan.metrics.judge import REFERENCE
from replan.metrics.judge.gates import GateRule, load_gates, load_rules
from replan.metrics.judge.verdicts import DRIVE
from replan.results.load import RECORDINGS
from replan.results.log_result import LogFileCard
from replan.results.schema import SCHEMA_VERSION, check_table, checked, read_json
from replan.results.tables import LOG_CARD, write_file

MOST_PARTINGS = 60
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
NO_AGENT: dict[str, Any] = {"agent": "", "kind": "", "ahead_m": nan, "left_m": nan, "lights": ""}
"""Fields of a first difference that is about no agent."""
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
    before, after = side_of(baseline), side_of(candidate)
    pair = (planners[0], planners[-1]) if planners else _only_pair(before, after)
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
    unpaired = "" if pair is not None else _pairing_command((baseline, before), (candidate, after))
    comparison = replace(comparison, unpaired=unpaired)
    if not (isinstance(baseline, Results) and isinstance(candidate, Results) and partings):
        return comparison
    return _with_first_differences(comparison, (baseline, candidate), pair, partings)


def _driven_planners(side: Side) -> tuple[str, ...]:
    return tuple(dict.fromkeys(side.driven["planner"]))


def _only_pair(before: Side, after: Side) -> tuple[str, str] | None:
    """Return the planners of two runs of one planner each, if they have other names."""
    names = [
        list(dict.fromkeys([*_driven_planners(side), *(planner for _, planner, _ in side.crashed)]))
        for side in (before, after)
    ]
    is_pair = [len(planners) for planners in names] == [1, 1] and names[0] != names[1]
    return (names[0][0], names[1][0]) if is_pair else None


def _pairing_command(before: tuple[Run, Side], after: tuple[Run, Side]) -> str:
    """Return the command that pairs planners that only one of the runs has; "" if there is none."""
    names = [_driven_planners(side) for _, side in (before, after)]
    alone = [
        next((planner for planner in own if planner not in others), "")
        for own, others in (names, names[::-1])
    ]
    if not all(alone):
        return ""
    runs = [str(run.path) if isinstance(run, Results) else run.label for run, _ in (before, after)]
    return shlex.join(["replan", "compare", *runs, "-p", alone[0], "-p", alone[1]])


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
    rows: list[dict[str, Any]] = []
    differing = equal = 0
    for log, planner, mode in order.itertuples(index=False, name=None):
        names = pair or (planner, planner)
        files = [
            results.drive(log, name, mode).trace_file
            for results, name in zip(runs, names, strict=True)
        ]
        row = {"log": log, "planner": planner, "mode": mode, **NO_AGENT}
        try:
            if _are_equal(files):
                equal += 1
                continue
            differing += 1
            if differing <= limit:
                rows += [row | fields for fields in _parting(files, two_planners=len({*names}) > 1)]
        except LogError as error:
            differing += 1
            reason = f"a trace cannot be read: {error}"
            rows.append({**row, "t_s": nan, "stage": UNKNOWN, "what": reason})
    table = pd.DataFrame(rows, columns=list(PARTING_COLUMNS))
    table = table.astype(dict.fromkeys(PARTING_NUMBERS, float))
    return replace(
        comparison,
        partings=table,
        equal_drives=equal,
        not_looked_at=max(differing - limit, 0),
    )


def _are_equal(files: list[Path]) -> bool:
    """Return whether two traces have the same messages; a planner's name is none of them."""
    if all(file.is_file() for file in files) and files[0].read_bytes() == files[1].read_bytes():
        return True
    first, second = (read_container(file).streams for file in files)
    return first.keys() == second.keys() and all(
        stream.times == second[topic].times and stream.payloads == second[topic].payloads
        for topic, stream in first.items()
    )


def _parting(files: list[Path], *, two_planners: bool) -> list[dict[str, Any]]:
    """Return the row of the first difference; none if it is below the tolerance.

    For two planners, it is the time at which their drives differ.
    """
    (first, scenario), (second, _) = map(read_trace, files)
    difference = first_difference(first, second)
    if difference is None:
        return []
    parted = planners_part(first, second) if two_planners else None
    t, sentence = difference.t, difference.what
    place = _agent_place(first, t, difference.agent)
    if parted is not None:
        t, sentence = parted.t, f"{parted.what}; first difference: {sentence}"
    lights = _light_colours(scenario, difference.t)
    return [{"t_s": t, "stage": difference.stage, "what": sentence, **place, "lights": lights}]


def _agent_place(trace: Trace, t: float, agent: str) -> dict[str, Any]:
    """Return the agent with its kind and its place in the ego's frame, if it is in the log."""
    agents, ego = trace.agents.perceived(t), trace.ego.at(t)
    if agent not in agents.ids:
        return NO_AGENT | {"agent": agent}
    row = agents.ids.index(agent)
    ahead_m, left_m = ego.offset_of(agents.x, agents.y)
    kind = agents.kinds[row].value
    return {"agent": agent, "kind": kind, "ahead_m": ahead_m[row], "left_m": left_m[row]}


def _light_colours(scenario: Scenario, t: float) -> str:
    """Return the colours that lights show at a time, as text."""
    rows = [(light, int(light.t.searchsorted(t, side="right")) - 1) for light in scenario.lights]
    return ", ".join(sorted({light.colours[row].value for light, row in rows if row >= 0}))


def look_commands(run: Run, log: str, planner: str, mode: str) -> dict[str, str]:
    """Return the commands that show and explain a drive, by purpose; none for a baseline file.

    For planners "a -> b", they are about the drive of b.
    """
    if isinstance(run, Side):
        return {}
    driven = planner.split(" -> ")[-1]
    drive = run.drive(log, driven, mode)
    recording = drive.trace_file.with_suffix(".rrd")
    file = recording if recording.is_file() else drive.trace_file
    options = [str(run.path), log, "-p", driven, "--mode", mode]
    return {
        "Look at the worst regression": shlex.join(["replan", "view", str(file)]),
        "Why": shlex.join(["replan", "explain", *options]),
    }
