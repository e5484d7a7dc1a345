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
from dataclasses import asdict, dataclass, replace
from functools import partial
from math import isfinite, isinf
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pandas as pd

from replan.config import RunConfig, dump_run
from replan.core.errors import ConfigError, LogError, ReplanError, described
from replan.core.kernel import is_cache_cold
from replan.core.names import counted, told_apart
from replan.draw.markers import Marker
from replan.logs.road import RoadSource
from replan.logs.scenario import Scenario
from replan.metrics import health
from replan.metrics.judge.discrimination import BAD_DRIVERS
from replan.metrics.metric import Unavailable
from replan.mine.driven_log import DrivenLog, Event, EventKind
from replan.mine.ego_and_road import crosses_others, in_roundabout, stays
from replan.mine.event_page import PAGE, PICTURES, draw_events, write_events_page
from replan.mine.kinds import EVENT_KIND, KINDS
from replan.mine.plan_kinds import PlanKind, plan_events
from replan.replay.loop.reference_drives import discriminate
from replan.results.schema import names_of, read_json, read_table, typed
from replan.results.tables import write_json, write_parquet, write_text
from replan.results.version import replan_version
from replan.run.claim import FolderContents, claimed_folder
from replan.run.evaluate import longest_first
from replan.run.log_source import LogSource, log_hash
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
BREAKS = tuple(f"{driver}_breaks" for driver in BAD_DRIVERS)
CURVE_KAPPA = 1.0 / 150.0
"""A road with more curvature than this is a curve, 1/m."""
JUNCTION_M = 8.0
"""The ego is at a junction if lanes cross within this distance on its path."""
SPEEDS = (
    (0.5, "standing"),
    (30.0 / 3.6, "to 30 km/h"),
    (50.0 / 3.6, "to 50 km/h"),
    (90.0 / 3.6, "to 90 km/h"),
)
FASTER = "above 90 km/h"
ROADS = ("roundabout", "junction", "curve", "straight", "no lanes")
ALONE = "none"
"""The value of `agent_kind` for an event of the ego alone."""
PLACES = ("location", "place", "city", "country")
WEATHERS = ("weather", "time_of_day", "environment")
"""Entries of a log's metadata with the place and the weather."""


@dataclass(frozen=True, eq=False)
class MinedLog:
    """The result of one log.

    Attributes:
        name: Name of the log; the label of its source if it could not be read.
        row: Its row of logs.parquet, as JSON types; a number that there is not is None.
        events: Its rows of events.parquet; `health` are its rows of health.parquet.
        failures: The failures, one line each.
    """

    name: str
    row: dict[str, Any]
    events: Sequence[dict[str, Any]] = ()
    health: Sequence[dict[str, Any]] = ()
    failures: tuple[str, ...] = ()

    def with_name(self, name: str) -> MinedLog:
        """The log under another name, also in its rows."""
        events, health = (
            [{**row, "log": name} for row in rows] for rows in (self.events, self.health)
        )
        row = {**self.row, "log": name}
        return replace(self, name=name, row=row, events=events, health=health)


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
    _load_kinds(kinds)
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
            outcome = _not_mined(label, f"{label}: not mined: {outcome.reason}")
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


def mine_log(
    source: LogSource,
    run: RunConfig,
    kinds: tuple[str, ...],
    planners: tuple[str, ...],
    pictures: Path | None = None,
) -> MinedLog:
    """Mine one log, and draw its events into a folder; errors are part of the result."""
    try:
        with source.fetched() as near:
            scenario = near.read()
            digest = "" if near.path is None else log_hash(near.path, near.settings)
    except ReplanError as error:
        return _not_mined(source.label, str(error))
    except Exception as error:
        return _not_mined(source.label, f"{source.label}: {described(error)}")
    not_asked, failures, rows = list[str](), list[str](), list[dict[str, Any]]()
    log = DrivenLog(scenario) if len(scenario.ego) > 1 else None
    for kind in _load_kinds(kinds):
        if log is None:
            not_asked.append(f"{kind.name}: the log holds one ego state only: there is no drive")
            continue
        try:
            events = _events_of(kind, log)
        except Exception as error:
            why = described(error, of=kind.find)
            failures.append(f"{scenario.name}: event kind '{kind.name}': {why}")
            continue
        if isinstance(events, Unavailable):
            not_asked.append(f"{kind.name}: {events.reason}")
        else:
            rows += [_row(log, kind, event, "") for event in events]
    for planner in planners if log is not None else ():
        try:
            assert log is not None
            planned = plan_events(log, planner, run)
            rows += [_row(log, kind, event, planner) for kind, event in planned]
        except ReplanError as error:
            failures.append(f"{scenario.name}: {error} [{planner}]")
    metadata, apart = scenario.metadata, dict[str, str]()
    if log is not None:
        breaks = discriminate(scenario, run.drive_loop)
        apart = {f"{driven.driver}_breaks": str(driven.breaks or "") for driven in breaks}
    row = {
        "log": scenario.name,
        "source": source.label,
        "sha256": digest,
        "duration_s": float(scenario.duration),
        "driven_m": float(np.hypot(np.diff(scenario.ego.x), np.diff(scenario.ego.y)).sum()),
        "agents": len(scenario.tracks),
        "lanes": scenario.road.source is RoadSource.LANES,
        "family": scenario.family,
        "dataset": scenario.dataset,
        "tags": list(scenario.tags),
        "place": next((metadata[key] for key in PLACES if metadata.get(key)), ""),
        "weather": next((metadata[key] for key in WEATHERS if metadata.get(key)), ""),
        "not_asked": not_asked,
        "error": "",
        **dict.fromkeys(BREAKS, ""),
        **apart,
    }
    if pictures is not None:
        draw_events(pictures, scenario, digest, rows)
    findings = health.table(scenario.name, health.findings(scenario)).to_dict("records")
    return MinedLog(
        scenario.name, _plain(row), [*map(_plain, rows)], [*map(_plain, findings)], tuple(failures)
    )


def _events_of(kind: EventKind, log: DrivenLog) -> list[Event] | Unavailable:
    """The events of a kind in a log; ValueError if one is not valid."""
    events = kind.find(log)
    if isinstance(events, Unavailable):
        return events
    events = list(events)
    for event in events:
        is_event = isinstance(event, Event) and isfinite(event.begin) and not isinf(event.value)
        if not is_event or not event.begin <= event.end < np.inf:
            raise ValueError(
                f"{event!r} is not an Event with a finite value that begins before it ends"
            )
    return events


def markers(scenario: Scenario) -> tuple[Marker, ...]:
    """The events of the built-in kinds in a log, for its recording.

    A log without a drive has none.
    """
    if len(scenario.ego) < 2:
        return ()
    log, drawn = DrivenLog(scenario), list[Marker]()
    for kind in KINDS.values():
        events = kind.find(log)
        for event in () if isinstance(events, Unavailable) else events:
            unit = "" if kind.unit == "1" else f" {kind.unit}"
            value = f"{event.value:.3g}{unit}" if isfinite(event.value) else ""
            doubt = f"in doubt: {event.doubt}" if event.doubt else ""
            details = ", ".join(filter(None, (event.what, value, doubt)))
            agents = ", ".join(map(scenario.short_names, event.agents))
            text = " ".join(filter(None, (agents, f"({details})" if details else "")))
            drawn.append(Marker(event.begin, event.end, kind.name, text))
    return tuple(drawn)


def _plain(row: Mapping[Any, Any]) -> dict[str, Any]:
    """A row as JSON types."""
    return {
        str(key): None if isinstance(cell, float) and not isfinite(cell) else cell
        for key, cell in row.items()
    }


def _load_kinds(kinds: Sequence[str]) -> tuple[EventKind, ...]:
    """The built-in kinds and the named ones; ConfigError if one is unknown, or has the name of
    another.
    """
    return (*KINDS.values(), *(EVENT_KIND.find(name) for name in kinds if name not in KINDS))


def _row(log: DrivenLog, kind: EventKind | PlanKind, event: Event, planner: str) -> dict[str, Any]:
    """A row of events.parquet."""
    tracks = log.scenario.tracks
    begin, middle = np.searchsorted(
        log.t, (event.begin - 1e-6, 0.5 * (event.begin + event.end))
    ).clip(max=len(log.t) - 1)
    main = event.agents[0] if event.agents else ""
    v = float(abs(log.ego.v[begin]))
    return {
        "log": log.scenario.name,
        "kind": kind.name,
        "t_from_s": event.begin,
        "t_to_s": event.end,
        "agents": list(event.agents),
        "agent_kind": tracks.kinds[tracks.ids.index(main)].value if main in tracks.ids else ALONE,
        "road": _kind_of_road(log, int(middle)),
        "speed": next((name for bound, name in SPEEDS if v < bound), FASTER),
        "v_mps": v,
        "x_m": float(log.ego.x[begin]),
        "y_m": float(log.ego.y[begin]),
        "value": float(event.value),
        "unit": kind.unit,
        "what": event.what,
        "doubt": event.doubt,
        "planner": planner,
    }


def _kind_of_road(log: DrivenLog, step: int) -> str:
    """One of `ROADS`, where the ego is at a step."""
    road, station = log.scenario.road, float(log.station[step])
    if road.source is not RoadSource.LANES:
        return "no lanes"
    lanes = [stay.lane for stay in stays(log) if stay.first <= step <= stay.last]
    if any(in_roundabout(road, lane) for lane in lanes):
        return "roundabout"
    around = [log.path.frame(station + ahead)[:2] for ahead in (-JUNCTION_M, 0.0, JUNCTION_M)]
    if any(crosses_others(road, x, y) for x, y in around):
        return "junction"
    *_, kappa = log.path.frame(station)
    return "curve" if abs(kappa) > CURVE_KAPPA else "straight"


def _not_mined(label: str, line: str) -> MinedLog:
    words = ("sha256", "family", "dataset", "place", "weather", *BREAKS)
    row: dict[str, Any] = {
        "log": label,
        "source": label,
        "agents": 0,
        "lanes": False,
        "error": line,
        **dict.fromkeys(("duration_s", "driven_m")),
        **dict.fromkeys(words, ""),
        "tags": [],
        "not_asked": [],
    }
    return MinedLog(label, row, failures=(line,))


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
