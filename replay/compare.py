"""Two runs compared: result folders, or a baseline in a file, with where their drives part.

A baseline is one Parquet file: the rows of metrics.parquet (without the metrics' sources), and in its metadata what
they were made with, as JSON. It holds what judging and comparing need and no traces; equal results give equal bytes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import nan
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from logs.errors import ConfigError, LogError, unknown_name
from logs.files import check_named, read_toml
from logs.mcap import read_trace
from logs.mcap.container import read_container
from logs.remote import Near
from metrics import COLUMNS, METRICS, Metric, load_metric
from metrics.compare import DRIVE, PARTING_COLUMNS, Comparison, Side, compare
from metrics.compare.rules import Rule, judged, load_rules
from metrics.judge import REFERENCE
from metrics.judge.gates import load_gates
from replay.explain.first_difference import first_difference
from replay.results.load import RECORDINGS, Results, loaded
from replay.results.schema import SCHEMA_VERSION
from replay.results.tables import LOG_CARD, write_file

MOST_PARTINGS = 20
"""In more drives it is not looked for where they part: the worst first."""
BASELINE = b"replan_baseline"
"""Key of the metadata of a baseline's file."""
NOT_INPUTS = (
    "recording", "foxglove", "internals", "gates", "planners", "mode", "metrics", "charts", "deadline_s", "ensemble",
    "repeat_s",
)  # fmt: skip
"""Keys of a run that change no drive, or whose change shows in what was driven."""
UNKNOWN = "not known"
"""Stage where a trace cannot be read."""


@dataclass(frozen=True, eq=False)
class Opened:
    """A run to compare: its tables, and its folder; None for a baseline's file, which has no traces."""

    side: Side
    results: Results | None
    metrics: tuple[str, ...] = ()

    @property
    def planners(self) -> tuple[str, ...]:
        """Who was driven."""
        table = self.side.table
        return tuple(dict.fromkeys(table.loc[table["mode"] != REFERENCE, "planner"]))


def opened(path: Path | str) -> Opened:
    """The run in a result folder, or in a file that `write_baseline` wrote; either may be a URL.

    Raises:
        ConfigError: There is none, or of another version.
        LogError: It is damaged.
    """
    near = Near(path, RECORDINGS)
    path = near.path
    check_named(path)
    if path.is_file():
        return _baseline(path)
    results = loaded(near)
    try:
        side = Side(path.name, results.metrics, _logs(results), _facts(results), _failed(results), _crashed(results))
        return Opened(side, results, tuple(read_toml(path / "run.toml").get("metrics", ())))
    except (OSError, ValueError, KeyError) as error:
        raise LogError(f"cannot be read as results: {error}", file=path) from None


def _logs(results: Results) -> pd.DataFrame:
    """`Side.logs`; what an older version did not write is empty."""
    table = results.logs
    text = table[["log", "sha256", "family", "dataset"]].astype(object)
    text = text.where(text.notna(), "")
    text["tags"] = [list(tags) if isinstance(tags, list) else [] for tags in table["tags"]]
    text["vehicle"] = [_vehicle(results, log.get("drives", ())) for log in results.summary["logs"]]
    return text


def _vehicle(results: Results, drives: Sequence[Mapping[str, Any]]) -> str:
    """Hash of the vehicle as a trace says it; "" where there is none."""
    for drive in drives:
        for file in drive["files"]:
            if file.endswith(".mcap") and (results.path / file).is_file():
                stream = read_container(results.path / file).streams.get("/vehicle")
                return hashlib.sha256(stream.payloads[0]).hexdigest()[:12] if stream else ""
    return ""


def _facts(results: Results) -> dict[str, str]:
    """What it was made with, key by key."""
    facts = {"replan": str(results.summary.get("replan", "")), "Python": str(results.summary.get("python", ""))}
    cards = (results.path / str(folder) / LOG_CARD for folder in results.logs["folder"] if folder)
    card = next((card for card in cards if card.is_file()), None)
    if card is not None:
        facts["code (SHA-256)"] = str(json.loads(card.read_text(encoding="utf-8")).get("code", ""))[:12]
    run = read_toml(results.path / "run.toml")
    return facts | dict(_flat({key: value for key, value in run.items() if key not in NOT_INPUTS}))


def _flat(table: Mapping[str, Any], where: str = "") -> Iterator[tuple[str, str]]:
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{where}{key}.")
        else:
            yield f"{where}{key}", str(value)


def _failed(results: Results) -> dict[str, str]:
    unread = set(results.logs.loc[results.logs["sha256"] == "", "log"])
    said = {row.log: str(row.message) for row in results.failures.itertuples()}
    return {log: said.get(log, "not evaluated") for log in sorted(unread)}


def _crashed(results: Results) -> tuple[tuple[str, str, str], ...]:
    rows = results.failures[["log", "planner", "mode"]].dropna().drop_duplicates()
    return tuple(rows.itertuples(index=False, name=None))


# the file ---------------------------------------------------------------------------------------------------------


def write_baseline(run: Opened, path: Path) -> None:
    """A run as one file: the same results give the same bytes."""
    side = run.side
    head = {
        "schema_version": SCHEMA_VERSION,
        "facts": dict(side.facts),
        "logs": side.logs.to_dict("records"),
        "failed": dict(side.failed),
        "crashed": [list(drive) for drive in side.crashed],
        "metrics": list(run.metrics),
    }
    table = pa.Table.from_pandas(side.table.drop(columns="source"), preserve_index=False)
    table = table.replace_schema_metadata({BASELINE: json.dumps(head, ensure_ascii=False, sort_keys=True)})
    write_file(path, lambda partial: pq.write_table(table, partial, compression="zstd", compression_level=19))


def _baseline(path: Path) -> Opened:
    try:
        table = pq.read_table(path)
        head = json.loads((table.schema.metadata or {})[BASELINE])
    except KeyError:
        raise ConfigError(f"{path}: is no baseline; `replan baseline RESULTS -o {path.name}` writes one") from None
    except (OSError, pa.ArrowException, ValueError, RecursionError) as error:
        raise LogError(f"cannot be read as a baseline: {error}", file=path) from None
    try:
        if head["schema_version"] != SCHEMA_VERSION:
            raise ConfigError(f"{path}: of version {head['schema_version']}, this replan reads {SCHEMA_VERSION}")
        rows = table.replace_schema_metadata(None).to_pandas()
        rows = rows.assign(source="", about=rows.get("about"))[list(COLUMNS)]
        logs = pd.DataFrame(head["logs"], columns=["log", "sha256", "family", "dataset", "tags", "vehicle"])
        crashed = tuple(tuple(drive) for drive in head.get("crashed", ()))
        side = Side(path.name, rows, logs, head["facts"], head["failed"], crashed)
        return Opened(side, None, tuple(head["metrics"]))
    except (KeyError, TypeError) as error:
        raise LogError(f"cannot be read as a baseline: something is missing in it: {error}", file=path) from None


# comparing --------------------------------------------------------------------------------------------------------


def compare_runs(
    baseline: Opened,
    candidate: Opened,
    planners: tuple[str, ...] = (),
    *,
    gates: Path | None = None,
    more: tuple[Rule, ...] = (),
    partings: int = MOST_PARTINGS,
) -> Comparison:
    """Two runs compared, and judged by the rules of comparison.

    Args:
        baseline: What was.
        candidate: What is.
        planners: One: only this planner of both. Two: the first of the baseline with the second of the candidate.
        gates: A file of gates and rules; None: the packaged ones.
        more: Rules beside those of the file.
        partings: In so many drives, the worst first, it is looked for where they part.

    Raises:
        ConfigError: A planner is not in its run, or the gates cannot be read.
    """
    pair = (planners[0], planners[-1]) if planners else None
    sides = _sides(baseline, candidate, pair)
    known = _metrics((*baseline.metrics, *candidate.metrics))
    rules = (*load_rules(gates, metrics=known), *more)
    comparison = compare(*sides, load_gates(gates, metrics=known), {rule.metric for rule in rules} - {""})
    comparison = judged(rules, comparison, sides[0].labels | sides[1].labels)
    if baseline.results is None or candidate.results is None or not partings:
        return comparison
    both = (baseline.results, candidate.results)
    return _with_partings(comparison, both, pair, partings)


def _metrics(named: Sequence[str]) -> dict[str, Metric]:
    """The built-in metrics and those of the runs' own."""
    own = (load_metric(spec) for spec in dict.fromkeys(named))
    return {**METRICS, **{metric.name: metric for metric in own}}


def _sides(baseline: Opened, candidate: Opened, pair: tuple[str, str] | None) -> tuple[Side, Side]:
    """The tables of the planners asked for; those that only one of the runs configured are no difference of inputs."""
    one, two = baseline.side, candidate.side
    if one.label == two.label and pair is not None:
        one, two = replace(one, label=f"{one.label}: {pair[0]}"), replace(two, label=f"{two.label}: {pair[1]}")
    if pair is not None:
        name = pair[0] if pair[0] == pair[1] else " -> ".join(pair)
        one, two = _only(baseline, one, pair[0], name), _only(candidate, two, pair[1], name)
    kept = {pair[0]} & {pair[1]} if pair else set(baseline.planners) & set(candidate.planners)
    return _without(one, kept), _without(two, kept)


def _only(run: Opened, side: Side, planner: str, name: str) -> Side:
    """The rows of one planner, under a name that both sides share, and judged whether it is an oracle or not."""
    if planner not in run.planners:
        raise unknown_name("planner (in the run)", planner, run.planners)
    table = side.table
    mine = table[table["planner"] == planner].assign(planner=name)
    mine = mine if name == planner else mine.assign(oracle=False)
    references = table[table["mode"] == REFERENCE]
    crashed = tuple((log, name, mode) for log, driven, mode in side.crashed if driven == planner)
    return replace(side, table=pd.concat([mine, references], ignore_index=True), crashed=crashed)


def _without(side: Side, planners: set[str]) -> Side:
    """The side with the settings of these planners only."""

    def asked(key: str) -> bool:
        return not key.startswith("planner.") or any(key.startswith(f"planner.{name}.") for name in planners)

    return replace(side, facts={key: value for key, value in side.facts.items() if asked(key)})


def _with_partings(
    comparison: Comparison, both: tuple[Results, Results], pair: tuple[str, str] | None, most: int
) -> Comparison:
    """Drives with flips first, then those with the worst regressions."""
    order = pd.concat([comparison.flips[DRIVE], comparison.pairs[DRIVE]]).drop_duplicates()
    rows: list[tuple[Any, ...]] = []
    looked = 0
    for log, planner, mode in order.itertuples(index=False, name=None):
        names = pair or (planner, planner)
        files = [results.drive(log, name, mode).trace_file for results, name in zip(both, names, strict=True)]
        if all(file.is_file() for file in files) and files[0].read_bytes() == files[1].read_bytes():
            continue
        looked += 1
        if looked <= most:
            rows += [(log, planner, mode, *found) for found in _parted(files)]
    kinds = {"t_s": float}
    table = pd.DataFrame(rows, columns=list(PARTING_COLUMNS)).astype(kinds)
    return replace(comparison, partings=table, not_looked_at=max(looked - most, 0))


def watched(run: Opened, log: str, planner: str, mode: str) -> str:
    """The command that shows a drive; "" where it is not at hand. Of "a -> b" it is b's."""
    if run.results is None:
        return ""
    drive = run.results.drive(log, planner.split(" -> ")[-1], mode)
    recording = drive.trace_file.with_suffix(".rrd")
    return f"replan view {recording if recording.is_file() else drive.trace_file}"


def _parted(files: Sequence[Path]) -> Iterator[tuple[float, str, str]]:
    try:
        found = first_difference(*(read_trace(file)[0] for file in files))
    except LogError as error:
        yield nan, UNKNOWN, f"a trace cannot be read: {error}"
        return
    if found is not None:
        yield found.t, found.stage, found.what
