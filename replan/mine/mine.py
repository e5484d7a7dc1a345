"""`replan mine`: finds events in logs, without a planner, and writes them as tables.

A log that cannot be read is left out: its row of logs.parquet has the reason. If the log has no
drive, or lacks data that a kind needs (lanes, crosswalks, lights), the kind is not searched, and
logs.parquet names it, because "not found" differs from "not searched". The tables do not depend on
the number of workers. What is found in a log is added to study.jsonl as the log ends, so that
`--resume` mines the others only.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import pandas as pd

from replan.config import RunConfig, dump_run
from replan.core.errors import ConfigError, LogError
from replan.core.kernel import is_cache_cold
from replan.core.names import counted, told_apart
from replan.mine.event_page import PAGE, PICTURES, write_events_page
from replan.mine.kinds import EVENT_KIND, KINDS
from replan.mine.mined_log import MinedLog, load_kinds, mine_log, not_mined
from replan.results.schema import names_of, read_json, read_table, typed
from replan.results.tables import write_json, write_parquet, write_text
from replan.results.version import replan_version
from replan.run.claim import FolderContents, claimed_folder
from replan.run.evaluate import longest_first
from replan.run.log_source import LogSource
from replan.run.output import write_origin
from replan.run.pool import WorkerLost, run_all
from replan.run.resume import Study, identity_of, stamp_of
from replan.run.sources import Selection

EVENTS, LOGS, HEALTH = "events.parquet", "logs.parquet", "health.parquet"
CARD = "mined.json"
CONTENTS = FolderContents(
    "mine",
    (
        "run.toml",
        "origin.json",
        EVENTS,
        LOGS,
        HEALTH,
        CARD,
        PAGE,
        PICTURES,
        "coverage.csv",
        "coverage.png",
    ),
)


@dataclass(frozen=True, eq=False)
class Mined:
    """The tables of a set of logs.

    Attributes:
        events: A row per event (docs/results.md).
        logs: A row per log.
        health: A row per finding.
        failures: The failures, one line each.
    """

    events: pd.DataFrame
    logs: pd.DataFrame
    health: pd.DataFrame
    failures: tuple[str, ...]


def mine(
    selection: Selection,
    run: RunConfig,
    *,
    kinds: Sequence[str] = (),
    planners: Sequence[str] = (),
    workers: int = 0,
    study: Study | None = None,
    pictures: Path | None = None,
    on_log: Callable[[MinedLog], None] = lambda log: None,
) -> Mined:
    """Find events in logs.

    Args:
        selection: The logs.
        run: Settings for reading logs, and of the planners.
        kinds: "module:NAME" of kinds of your own, beside the built-in ones.
        planners: Planners that plan open loop over each log: `replan.mine.plan_kinds`.
        workers: Number of child processes; 0: this process.
        study: Has what is found in logs that need not be mined again, and gets what is found in the
            others.
        pictures: Folder for pictures of events; None: none are drawn.
        on_log: Called when each log ends, in order of ending.

    Raises:
        ConfigError: A kind or planner is unknown.
    """
    load_kinds(kinds)
    job = partial(
        mine_log, run=run, kinds=tuple(kinds), planners=tuple(planners), pictures=pictures
    )
    keys = [] if study is None else [identity_of(source) for source in selection.sources]
    logs: dict[int, MinedLog] = {}
    for i, key in enumerate(keys):
        row = None if study is None else study.known(key)
        if row is not None:
            logs[i] = MinedLog(**row["mined"])
            on_log(logs[i])
    sources = {i: source for i, source in enumerate(selection.sources) if i not in logs}
    for i, outcome in _mine_each(job, sources, workers):
        label = sources[i].label
        if isinstance(outcome, WorkerLost):
            outcome = not_mined(label, f"{label}: not mined: {outcome.reason}")
        logs[i] = outcome
        if study is not None and not outcome.failures:
            study.add([{"key": keys[i], "mined": asdict(outcome)}])
        on_log(outcome)
    if study is not None:
        study.keep(key for key in keys if study.known(key) is not None)
    named = _with_names([logs[i] for i in sorted(logs)])
    events = [row for log in named for row in log.events]
    findings = [row for log in named for row in log.health]
    return Mined(
        _table(EVENTS, events, ["log", "t_from_s", "kind", "t_to_s"]),
        _table(LOGS, [log.row for log in named], ["log"]),
        _table(HEALTH, findings, ["log", "t_from_s", "kind"]),
        tuple(line for log in named for line in log.failures),
    )


def _mine_each(
    job: Callable[[LogSource], MinedLog], sources: Mapping[int, LogSource], workers: int
) -> Iterator[tuple[int, MinedLog | WorkerLost]]:
    """The outcome of each source, by its index, as they end."""
    if workers == 0:
        yield from ((i, job(source)) for i, source in sources.items())
        return
    drive = partial(
        run_all, job, workers=max(1, min(workers, len(sources))), one_first=is_cache_cold()
    )
    indices = list(sources)
    ended = longest_first(list(sources.values()), drive, lambda source: source.expected_s)
    yield from ((indices[place], outcome) for place, outcome in ended)


def _with_names(logs: Sequence[MinedLog]) -> list[MinedLog]:
    """The logs with names that tell them apart, also in their rows."""
    names = told_apart([log.name for log in logs], [str(log.row["sha256"]) for log in logs])
    return [log.with_name(name) for log, name in zip(logs, names, strict=True)]


def _table(name: str, rows: Sequence[dict[str, Any]], keys: list[str]) -> pd.DataFrame:
    """The rows of a table, sorted."""
    return typed(name, pd.DataFrame(list(rows), columns=names_of(name))).sort_values(
        keys, kind="stable", ignore_index=True
    )


def mine_into(
    out: Path | None,
    selection: Selection,
    run: RunConfig,
    *,
    kinds: Sequence[str] = (),
    planners: Sequence[str] = (),
    workers: int = 0,
    resume: bool = False,
    on_log: Callable[[MinedLog], None] = lambda log: None,
) -> tuple[Path, Mined]:
    """Find events in logs, as `mine`, and write the tables into a folder of their own (None: the
    next free one).

    Raises:
        ConfigError: A kind or planner is unknown, the folder must not be written, or there is
            nothing to resume.
        OutputError: The disk is full.
    """
    stamp = stamp_of(run, [(EVENT_KIND, name) for name in kinds])
    head = {
        "study": CONTENTS.command,
        "replan": stamp.replan,
        "code": stamp.code[:12],
        "kinds": list(kinds),
        "planners": list(planners),
        "run": dump_run(run),
    }
    with claimed_folder(out, CONTENTS, resume=resume) as folder:
        study = Study(folder, head, resume=resume)
        write_text(folder / "run.toml", dump_run(run))
        write_origin(folder)
        mined = mine(
            selection,
            run,
            kinds=kinds,
            planners=planners,
            workers=workers,
            study=study,
            pictures=folder,
            on_log=on_log,
        )
        for name, table in ((EVENTS, mined.events), (LOGS, mined.logs), (HEALTH, mined.health)):
            write_parquet(folder / name, table)
        write_events_page(folder, mined.events, mined.logs)
        card = {
            "replan": replan_version(),
            "kinds": [*KINDS, *kinds],
            "planners": list(planners),
            "logs": len(mined.logs),
            "events": dict(sorted(Counter(mined.events["kind"]).items())),
            "failures": list(mined.failures),
        }
        write_json(folder / CARD, card)
    return folder, mined


def summary(mined: Mined) -> list[str]:
    """The events and failures in words, a line each."""
    read = mined.logs[mined.logs["error"] == ""]
    hours = float(read["duration_s"].sum()) / 3600.0
    lines = [f"{counted(len(read), 'log')}, {hours:.2f} h: {counted(len(mined.events), 'event')}"]
    counts = mined.events.groupby("kind").agg(events=("log", "size"), logs=("log", "nunique"))
    width = max((len(kind) for kind in counts.index), default=0)
    for kind, (events, logs) in counts.sort_values(
        ["events"], ascending=False, kind="stable"
    ).iterrows():
        lines.append(f"    {kind!s:{width}}  {events:5d} in {counted(int(logs), 'log')}")
    reasons = Counter(line for row in read["not_asked"] for line in row)
    by_reason = defaultdict(list)
    for line, number in reasons.items():
        kind, _, reason = line.partition(": ")
        by_reason[reason, number].append(kind)
    for (reason, number), kinds in by_reason.items():
        kinds = ["all kinds"] if set(kinds) >= set(KINDS) else kinds
        lines.append(
            f"    not looked for in {counted(number, 'log')} ({reason}): {', '.join(kinds)}"
        )
    return lines


def read_mined(folder: Path) -> Mined:
    """The tables that `replan mine` wrote.

    Raises:
        ConfigError: The folder is not the result of `replan mine`.
        LogError: A table is damaged.
    """
    if not (folder / CARD).is_file():
        raise ConfigError(
            f"{folder}: holds no mined logs (no {CARD} in it): replan mine LOGS -o {folder}"
        )
    again = f"mine again: replan mine LOGS -o {folder}"
    read_json(folder / CARD, MinedSummary, again)
    events, logs, findings = (
        read_table(folder / name, again=again).to_pandas() for name in (EVENTS, LOGS, HEALTH)
    )
    if logs["log"].duplicated().any() or not {*events["log"], *findings["log"]} <= {*logs["log"]}:
        raise LogError(
            "has not one row for each log of the other tables", file=folder / LOGS, remedy=again
        )
    return Mined(events, logs, findings, tuple(line for line in logs["error"] if line))


class MinedSummary(msgspec.Struct):
    """The contents of mined.json."""

    replan: str
    kinds: list[str]
    planners: list[str]
    logs: int
    events: dict[str, int]
    failures: list[str]
