"""The end of a run: judges its logs by the gates, and writes its tables and its summary.

run.toml is the resolved configuration of a run, each setting with its meaning from the code, as in
`replan list NAME`: entries of docstrings. Settings of parts that are not built in have none, as
their modules may only be loaded where they run.
"""

from __future__ import annotations

import os
import platform
import tempfile
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, is_dataclass, replace
from enum import Enum
from itertools import starmap
from math import isfinite
from pathlib import Path
from typing import Any, get_type_hints

import pandas as pd
import tomli_w

from replan.config import HEADER, IN_MEMORY, RunConfig, dump_run
from replan.core.names import told_apart
from replan.core.settings import dotted, meaning
from replan.core.urls import url_of
from replan.draw.drawn_results import Results, load
from replan.logs.vehicle import VehicleParameters
from replan.metrics import COLUMNS, health
from replan.metrics.judge import Verdict, judge, outcomes
from replan.metrics.judge.added_rows import with_asked, with_ensemble
from replan.metrics.judge.aggregate import LogLabels, groups, standings
from replan.metrics.judge.deadline import LATE, judge_deadline
from replan.metrics.judge.discrimination import with_discrimination
from replan.metrics.judge.gates import PACKAGED, Gates, Outcome, load_gates
from replan.replay.parts import PARTS, config_class
from replan.results.load import TIMING_WORDS
from replan.results.log_result import (
    HEALTH,
    MEMBERS,
    METRICS,
    TIMINGS,
    Failure,
    LogResult,
    table_of,
    timings_of,
)
from replan.results.schema import read_table
from replan.results.tables import (
    KEYS,
    OUTCOMES,
    joined,
    write_json,
    write_metrics,
    write_parquet,
    write_timings,
)
from replan.results.version import replan_version
from replan.run.log_source import LogSource
from replan.run.one_log import all_metrics
from replan.run.sources import Selection


def gates_of(run: RunConfig, path: Path | None) -> Gates:
    """The gates in a file, or the packaged gates for the loops of the run; ConfigError as
    `load_gates`.
    """
    gates = load_gates(path, metrics=all_metrics(run))
    return gates.asked_of(mode.value for mode in run.modes) if path is None else gates


def judge_and_write(
    out: Path,
    run: RunConfig,
    selection: Selection,
    results: Sequence[LogResult],
    gates: Gates,
    failures: Sequence[Failure],
    *,
    resumed: int = 0,
    shard: str = "",
) -> Results:
    """Judge the results of a run (those of a shard are not judged), and write its tables.

    `out`: the result folder, which contains the folders of the logs; the tables are written into
    it. `results`: the result of each log, in the order of the selection. `failures`: failures that
    are not about a log. `resumed`: number of logs whose results are from an interrupted run.
    `shard`: the part of the run; "" for the whole run.
    """
    selection, results = _without_twins(selection, results)
    names = told_apart([result.name for result in results], [result.digest for result in results])
    results = tuple(starmap(_renamed, zip(results, names, strict=True)))
    table = joined([table_of(out, results, METRICS)], KEYS, COLUMNS).astype(
        {"value": float, "time_s": float}
    )
    labels = {log.name: LogLabels(log.family, log.dataset, log.tags) for log in results}
    read = {log.name: labels[log.name] for log in results if log.digest}
    members = joined([table_of(out, results, MEMBERS)], KEYS, COLUMNS)
    table = with_discrimination(with_ensemble(table, members, gates, read), gates, read)
    table = with_asked(table, gates, read)
    sorted_ = sorted(
        (result for result in results if result.folder), key=lambda result: result.name
    )
    write_timings(out / TIMINGS, (timings_of(out, result) for result in sorted_))
    verdicts: tuple[Verdict, ...] = ()
    errors = [failure for result in results for failure in result.failures]
    if not shard:
        unread = {result.name: "see the errors" for result in results if not result.digest}
        crashed = {
            (failure.log, failure.planner, failure.mode): failure.message
            for failure in errors
            if failure.planner and failure.mode
        }
        verdicts = tuple(judge(gates, table, read, failed=unread, crashed=crashed))
        if run.deadline_s > 0.0:
            verdicts += tuple(
                judge_deadline(
                    read_table(out / TIMINGS, words=TIMING_WORDS).to_pandas(), run.deadline_s, read
                )
            )
    errors = [*failures, *errors]
    write_metrics(out, table)
    findings = table_of(out, results, HEALTH)
    write_parquet(out / HEALTH, findings if len(findings) else health.table("", ()))
    rows = outcomes([verdict for verdict in verdicts if verdict.gate.metric != LATE])
    write_parquet(out / "verdicts.parquet", rows)
    records = [asdict(drive) for result in results for drive in result.drives]
    drives = pd.DataFrame(records, columns=["log", "planner", "mode", "oracle"])
    stand = standings(
        rows,
        drives,
        list(labels),
        run.drives,
        [(failure.log, failure.planner, failure.mode) for failure in errors],
    )
    write_parquet(out / "groups.parquet", groups(table, stand, labels))
    _write_summary(out, selection, results, verdicts, errors, shard)
    return replace(load(out), resumed=resumed)


def _renamed(result: LogResult, name: str) -> LogResult:
    if name == result.name:
        return result
    drives = tuple(replace(drive, log=name) for drive in result.drives)
    failures = tuple(replace(failure, log=name) for failure in result.failures)
    return replace(result, name=name, drives=drives, failures=failures)


def _without_twins(
    selection: Selection, results: Sequence[LogResult]
) -> tuple[Selection, tuple[LogResult, ...]]:
    """Leave out logs whose folder is that of an earlier one: their content is the same, and one was
    driven for both.
    """
    driven = {result.folder: result for result in results if not result.twin}
    first: dict[str, str] = {}
    first_results, sources, dropped = list[LogResult](), list[LogSource](), list(selection.dropped)
    for source, result in zip(selection.sources, results, strict=True):
        if result.folder in first:
            dropped.append(f"{source.label}: the same log as {first[result.folder]}")
            continue
        if result.folder:
            first[result.folder] = source.label
            result = replace(driven.get(result.folder, result), source=source.label)
        first_results.append(result)
        sources.append(source)
    return Selection(tuple(sources), tuple(dropped)), tuple(first_results)


def _write_summary(
    out: Path,
    selection: Selection,
    results: Sequence[LogResult],
    verdicts: Sequence[Verdict],
    errors: Sequence[Failure],
    shard: str,
) -> None:
    """Write summary.json.

    Its verdicts have no rows by log, which are in verdicts.parquet; NaN is null.
    """
    code = exit_code_of(errors, None if shard else [verdict.outcome for verdict in verdicts])
    gates: list[dict[str, Any]] = []
    for verdict in verdicts:
        gates.append({"rule": str(verdict.gate)})
        for key, value in asdict(verdict).items():
            if key != "logs":
                plain = value.value if isinstance(value, Enum) else value
                gates[-1][key] = None if isinstance(plain, float) and not isfinite(plain) else plain
    summary = {
        "replan": replan_version(),
        "python": platform.python_version(),
        **({"shard": shard} if shard else {}),
        "outcome": "not judged" if shard and code == 0 else OUTCOMES[code],
        "exit_code": code,
        "logs_left_out": list(selection.dropped),
        "logs": [log.record() for log in results],
        "gates": gates,
        "failures": [asdict(failure) for failure in errors],
    }
    write_json(out / "summary.json", summary)


def exit_code_of(failures: Iterable[Failure], outcomes: Iterable[Outcome] | None) -> int:
    """Exit code of a run: 0 pass, 1 a gate failed, 2 configuration, 3 not all could be evaluated, 4
    inconclusive.

    `failures`: logs and drives that could not be evaluated. `outcomes`: outcomes of the gates;
    None: the run is not judged, and 0 means that it is complete.
    """
    codes = {failure.exit_code for failure in failures}
    if codes:
        return 2 if 2 in codes else 3
    if outcomes is None:
        return 0
    relevant = set(outcomes) - {Outcome.NOT_ASKED}
    if Outcome.FAIL in relevant:
        return 1
    return 4 if Outcome.INCONCLUSIVE in relevant or not relevant else 0


def explained(run: RunConfig, folder: Path) -> str:
    """The text of run.toml in a folder; `load_run` reads it as that of `dump_run`, with the
    selection of logs: paths of gates and logs begin there.
    """
    if run.gates not in PACKAGED:
        run = replace(run, gates=os.path.relpath(run.gates, folder))
    table, chosen = tomllib.loads(dump_run(run)), asdict(run.selection)
    chosen["logs"] = {_path_from(folder, log): digest for log, digest in chosen["logs"].items()}
    if stated := {key: value for key, value in chosen.items() if value}:
        table["selection"] = stated
    return f"{HEADER}{chr(10).join(_lines(table, RunConfig, ''))}\n"


def _path_from(folder: Path, log: str) -> str:
    """The path of a log from a folder; absolute where they are hardly moved together: they have
    only the root in common, or the folder of temporary files (results that go to a URL).
    """
    if url_of(log) or log.startswith(IN_MEMORY):
        return log
    path = Path(os.path.normpath(Path(log).absolute()))
    path, beside = Path(os.path.realpath(path.parent), path.name), Path(os.path.realpath(folder))
    apart = {beside.anchor, os.path.realpath(tempfile.gettempdir())}
    is_near = path.anchor == beside.anchor and os.path.commonpath([path, beside]) not in apart
    return Path(os.path.relpath(path, beside) if is_near else path).as_posix()


def _lines(table: Mapping[str, Any], of: Any, where: str) -> Iterator[str]:
    """The lines of a table, whose keys are fields of a dataclass or keywords of a factory; None:
    they are not known.
    """
    for key, value in table.items():
        if not isinstance(value, Mapping):
            line = tomli_w.dumps({key: value}).rstrip("\n")
            about = "" if of is None else meaning(of, key)
            if not about:
                yield line
            else:
                yield f"# {about}\n{line}" if "\n" in line else f"{line}  # {about}"
    for key, value in table.items():
        if isinstance(value, Mapping):
            table_name = dotted(where, key)
            if not value or not all(isinstance(item, Mapping) for item in value.values()):
                yield f"\n[{table_name}]"
            yield from _lines(value, _described(of, key, where), table_name)


def _described(of: Any, key: str, where: str) -> Any:
    """The dataclass or factory that describes a table in a table; None: there is none."""
    if of is RunConfig and key == "vehicle":
        return VehicleParameters
    kinds = {kind.table: kind for kind in PARTS.values()}
    if where in kinds:
        factory = kinds[where].builtin.get(key)
        return None if factory is None else config_class(factory) or factory
    hint = get_type_hints(of).get(key) if isinstance(of, type) and is_dataclass(of) else None
    return hint if isinstance(hint, type) and is_dataclass(hint) else None
