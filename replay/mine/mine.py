"""`replan mine`: finds events in logs, without a planner, and writes them as tables.

A log that cannot be read is left out: its row of logs.parquet has the reason. If the log has no drive, or lacks data
that a kind needs (lanes, crosswalks, lights), the kind is not searched, and logs.parquet names it, because "not found"
differs from "not searched". The tables do not depend on the number of workers.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import isfinite, nan
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from logs.errors import ConfigError, LogError, PlannerError, ReplanError, of_users, raised
from logs.kernel import is_cache_cold
from logs.names import counted
from logs.road import RoadSource
from metrics import health
from metrics.judge import load_gates
from metrics.judge.discrimination import BAD_DRIVERS
from metrics.metric import Unavailable
from replay.config import RunConfig, dump_run
from replay.loop.reference_drives import discriminate
from replay.mine.driven_log import DrivenLog, Event, EventKind
from replay.mine.ego_and_road import crosses_others, in_roundabout, stays
from replay.mine.kinds import EVENT_KIND, KINDS, PLAN_KINDS, plan_events
from replay.results.schema import names_of
from replay.results.tables import clear_folder, joined, next_free, write_json, write_parquet, write_text
from replay.results.version import replan_version
from replay.run.engine import longest_first
from replay.run.output import held, write_origin
from replay.run.pool import WorkerLost, run_all
from replay.run.sources import LogSource, Selection, log_hash

EVENTS, LOGS, HEALTH, CARD = "events.parquet", "logs.parquet", "health.parquet", "mined.json"
BREAKS = tuple(f"{driver}_breaks" for driver in BAD_DRIVERS)
CURVE_KAPPA = 1.0 / 150.0
"""A road with more curvature than this is a curve, 1/m."""
JUNCTION_M = 8.0
"""The ego is at a junction if lanes cross within this distance on its path."""
SPEEDS = ((0.5, "standing"), (30.0 / 3.6, "to 30 km/h"), (50.0 / 3.6, "to 50 km/h"), (90.0 / 3.6, "to 90 km/h"))
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
        row: Its row of logs.parquet.
        events: Its rows of events.parquet; `health` are its rows of health.parquet.
        failures: The failures, one line each.
    """

    name: str
    row: dict[str, Any]
    events: pd.DataFrame = field(default_factory=pd.DataFrame)
    health: pd.DataFrame = field(default_factory=pd.DataFrame)
    failures: tuple[str, ...] = ()


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
    on_log: Callable[[MinedLog], None] = lambda log: None,
) -> Mined:
    """Find events in logs.

    Args:
        selection: The logs.
        run: Settings for reading logs, and of the planners.
        kinds: "module:NAME" of kinds of your own, beside the built-in ones.
        planners: Planners that plan open loop over each log: the kinds of `replay.mine.kinds`.
        workers: Number of child processes; 0: this process.
        on_log: Called when each log ends, in order of ending.

    Raises:
        ConfigError: A kind or planner is unknown.
    """
    _load_kinds(kinds)
    job = partial(mine_log, run=run, kinds=tuple(kinds), planners=tuple(planners))
    sources = selection.sources
    if workers == 0:
        ended: Iterator[tuple[int, MinedLog | WorkerLost]] = ((i, job(one)) for i, one in enumerate(sources))
    else:
        drive = partial(run_all, job, workers=min(workers, len(sources)), one_first=is_cache_cold())
        ended = longest_first(sources, drive, lambda source: source.expected_s)
    found: dict[int, MinedLog] = {}
    for index, one in ended:
        label = sources[index].label
        found[index] = _not_mined(label, f"{label}: not mined: {one.reason}") if isinstance(one, WorkerLost) else one
        on_log(found[index])
    logs = [found[index] for index in sorted(found)]
    names = Counter(log.name for log in logs)
    for place, log in enumerate(logs, 1):  # logs that share a name get the hash of their content, or their index
        if names[log.name] > 1:
            name = f"{log.name}@{str(log.row['sha256'])[:8] or place}"
            events, findings = (table.assign(log=name) if len(table) else table for table in (log.events, log.health))
            logs[place - 1] = MinedLog(name, {**log.row, "log": name}, events, findings, log.failures)
    rows = pd.DataFrame([log.row for log in logs], columns=names_of(LOGS)).sort_values("log", ignore_index=True)
    events = joined([log.events for log in logs], ["log", "t_from_s", "kind", "t_to_s"], names_of(EVENTS))
    findings = joined([log.health for log in logs], ["log", "t_from_s", "kind"], names_of(HEALTH))
    return Mined(events, rows, findings, tuple(line for log in logs for line in log.failures))


def write(mined: Mined, run: RunConfig, kinds: Sequence[str], planners: Sequence[str], out: Path | None) -> Path:
    """Write the tables into a result folder, which is emptied first; the folder (None: the next free one).

    Raises:
        ConfigError: The folder contains other files, or another run writes into it.
        OutputError: The disk is full.
    """
    out = next_free() if out is None else out
    with held(out):
        clear_folder(out)
        write_text(out / "run.toml", dump_run(run))
        write_origin(out)
        write_parquet(out / EVENTS, mined.events)
        write_parquet(out / LOGS, mined.logs)
        write_parquet(out / HEALTH, mined.health)
        counts = Counter(mined.events["kind"])
        card = {
            "replan": replan_version(), "kinds": [*KINDS, *kinds], "planners": list(planners),
            "logs": len(mined.logs), "events": dict(sorted(counts.items())), "failures": list(mined.failures),
        }  # fmt: skip
        write_json(out / CARD, card)
    return out


def mine_log(source: LogSource, run: RunConfig, kinds: tuple[str, ...], planners: tuple[str, ...]) -> MinedLog:
    """Mine one log; errors are part of the result."""
    try:
        with source.fetched() as near:
            scenario = near.read()
            digest = "" if near.path is None else log_hash(near.path, near.settings)
    except ReplanError as error:
        return _not_mined(source.label, str(error))
    except Exception as error:
        return _not_mined(source.label, f"{source.label}: a bug in replan: {raised(error)}")
    not_asked, failures, rows = [], [], []
    log = DrivenLog(scenario) if len(scenario.ego) > 1 else None
    for kind in _load_kinds(kinds):
        if log is None:
            not_asked.append(f"{kind.name}: the log holds one ego state only: there is no drive")
            continue
        try:
            found = kind.find(log)
            events = [] if isinstance(found, Unavailable) else list(found)
            for event in events:
                if not (isinstance(event, Event) and isfinite(event.begin) and event.begin <= event.end < np.inf):
                    raise ValueError(f"{event!r} is not an Event that begins before it ends")
        except Exception as error:
            whose = "raised by code that the run names" if of_users(error) else "a bug in replan"
            failures.append(f"{scenario.name}: event kind '{kind.name}': {whose}: {raised(error, of=kind.find)}")
            continue
        rows += [_row(log, kind, event, "") for event in events]
        if isinstance(found, Unavailable):
            not_asked.append(f"{kind.name}: {found.reason}")
    for planner in planners if log is not None else ():
        try:
            assert log is not None
            rows += [_row(log, PLAN_KINDS[name], event, planner) for name, event in plan_events(log, planner, run)]
        except PlannerError as error:
            failures.append(f"{scenario.name}: {error} [{planner}]")
    about, apart = scenario.metadata, dict[str, str]()
    if log is not None:
        breaks = discriminate(scenario, run.drive_loop, load_gates(None))
        apart = {f"{one.driver}_breaks": str(one.breaks or "") for one in breaks}
    row = {
        "log": scenario.name, "source": source.label, "sha256": digest, "duration_s": float(scenario.duration),
        "driven_m": float(np.hypot(np.diff(scenario.ego.x), np.diff(scenario.ego.y)).sum()),
        "agents": len(scenario.tracks), "lanes": scenario.road.source is RoadSource.LANES,
        "family": scenario.family, "dataset": scenario.dataset, "tags": list(scenario.tags),
        "place": next((about[key] for key in PLACES if about.get(key)), ""),
        "weather": next((about[key] for key in WEATHERS if about.get(key)), ""), "not_asked": not_asked,
        "error": "", **dict.fromkeys(BREAKS, ""), **apart,
    }  # fmt: skip
    findings = health.table(scenario.name, health.findings(scenario))
    return MinedLog(scenario.name, row, pd.DataFrame(rows, columns=names_of(EVENTS)), findings, tuple(failures))


def _load_kinds(kinds: Sequence[str]) -> tuple[EventKind, ...]:
    """The built-in kinds and the named ones; ConfigError if one is unknown, or has the name of another."""
    return (*KINDS.values(), *(EVENT_KIND.find(name) for name in kinds if name not in KINDS))


def _row(log: DrivenLog, kind: EventKind, event: Event, planner: str) -> dict[str, Any]:
    """A row of events.parquet."""
    tracks = log.scenario.tracks
    k = int(np.clip(np.searchsorted(log.t, event.begin - 1e-6), 0, len(log.t) - 1))
    middle = int(np.clip(np.searchsorted(log.t, 0.5 * (event.begin + event.end)), 0, len(log.t) - 1))
    main = event.agents[0] if event.agents else ""
    v = float(abs(log.ego.v[k]))
    here = log.scenario.road
    around = (log.path.frame(float(log.station[middle]) + away)[:2] for away in (-JUNCTION_M, 0.0, JUNCTION_M))
    if here.source is not RoadSource.LANES:
        road = "no lanes"
    elif any(in_roundabout(here, stay.lane) for stay in stays(log) if stay.first <= middle <= stay.last):
        road = "roundabout"
    elif any(crosses_others(here, x, y) for x, y in around):
        road = "junction"
    else:
        road = "curve" if abs(log.path.frame(float(log.station[middle]))[3]) > CURVE_KAPPA else "straight"
    return {
        "log": log.scenario.name, "kind": kind.name, "t_from_s": event.begin, "t_to_s": event.end,
        "agents": list(event.agents),
        "agent_kind": tracks.kinds[tracks.ids.index(main)].value if main in tracks.ids else ALONE,
        "road": road, "speed": next((name for bound, name in SPEEDS if v < bound), FASTER),
        "v_mps": v, "x_m": float(log.ego.x[k]), "y_m": float(log.ego.y[k]), "value": float(event.value),
        "unit": kind.unit, "what": event.what, "planner": planner,
    }  # fmt: skip


def _not_mined(label: str, line: str) -> MinedLog:
    numbers = dict.fromkeys(("duration_s", "driven_m"), nan)
    words = dict.fromkeys(("sha256", "family", "dataset", "place", "weather", *BREAKS), "")
    lists: dict[str, Any] = {"tags": [], "not_asked": []}
    row = {"log": label, "source": label, "agents": 0, "lanes": False, "error": line, **numbers, **words, **lists}
    return MinedLog(label, row, failures=(line,))


def summary(mined: Mined) -> list[str]:
    """The events and failures in words, a line each."""
    read = mined.logs[mined.logs["error"] == ""]
    hours = float(read["duration_s"].sum()) / 3600.0
    lines = [f"{counted(len(read), 'log')}, {hours:.2f} h: {counted(len(mined.events), 'event')}"]
    counts = mined.events.groupby("kind").agg(events=("log", "size"), logs=("log", "nunique"))
    width = max((len(kind) for kind in counts.index), default=0)
    for kind, (events, logs) in counts.sort_values(["events"], ascending=False, kind="stable").iterrows():
        lines.append(f"    {kind!s:{width}}  {events:5d} in {counted(int(logs), 'log')}")
    reasons = Counter(line for row in read["not_asked"] for line in row)
    by_reason: dict[tuple[str, int], list[str]] = {}
    for line, number in reasons.items():
        kind, _, reason = line.partition(": ")
        by_reason.setdefault((reason, number), []).append(kind)
    for (reason, number), kinds in by_reason.items():
        kinds = ["all kinds"] if set(kinds) >= set(KINDS) else kinds
        lines.append(f"    not looked for in {counted(number, 'log')} ({reason}): {', '.join(kinds)}")
    return lines


def read_mined(folder: Path) -> Mined:
    """The tables that `replan mine` wrote.

    Raises:
        ConfigError: The folder is not the result of `replan mine`.
        LogError: A table is damaged.
    """
    if not (folder / CARD).is_file():
        raise ConfigError(f"{folder}: holds no mined logs (no {CARD} in it): replan mine LOGS -o {folder}")
    try:
        events, logs, findings = (pd.read_parquet(folder / name) for name in (EVENTS, LOGS, HEALTH))
    except (OSError, ValueError) as error:
        raise LogError(f"cannot be read: {error}", file=folder) from None
    missing = sorted(set(names_of(LOGS)) - set(logs))
    if missing:
        what = f"{LOGS} has no column {', '.join(missing)}: another version of replan mined it"
        raise LogError(what, file=folder, remedy=f"mine again: replan mine LOGS -o {folder}")
    return Mined(events, logs, findings, tuple(line for line in logs["error"] if line))
