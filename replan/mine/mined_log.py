"""Mines one log: the events of all kinds in it, as rows of tables and as markers of a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite, isinf
from pathlib import Path
from typing import Any

import numpy as np

from replan.config import RunConfig
from replan.core.errors import ReplanError, described
from replan.draw.markers import Marker
from replan.logs.road import RoadSource
from replan.logs.scenario import Scenario
from replan.metrics import health
from replan.metrics.judge.discrimination import BAD_DRIVERS
from replan.metrics.metric import Unavailable
from replan.mine.driven_log import DrivenLog, Event, EventKind
from replan.mine.ego_and_road import crosses_others, in_roundabout, stays
from replan.mine.event_page import draw_events
from replan.mine.kinds import EVENT_KIND, KINDS
from replan.mine.plan_kinds import PlanKind, plan_events
from replan.replay.loop.reference_drives import discriminate
from replan.run.log_source import LogSource, log_hash

BREAKS = tuple(f"{driver}_breaks" for driver in BAD_DRIVERS)
CURVE_KAPPA = 1.0 / 150.0
"""A road with more curvature than this is a curve, 1/m."""
JUNCTION_M = 8.0
"""The ego is at a junction if lanes cross within this distance on its path."""
# Upper bounds of the speed of the ego, m/s, and the name below each
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
"""Entries of a log's metadata with the place."""
WEATHERS = ("weather", "time_of_day", "environment")
"""Entries of a log's metadata with the weather."""


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
        return not_mined(source.label, str(error))
    except Exception as error:
        return not_mined(source.label, f"{source.label}: {described(error)}")
    log = DrivenLog(scenario) if len(scenario.ego) > 1 else None
    rows, not_asked, failures = _rows(scenario, log, kinds)
    for planner in planners if log is not None else ():
        try:
            assert log is not None
            planned = plan_events(log, planner, run)
            rows += [_row(log, kind, event, planner) for kind, event in planned]
        except ReplanError as error:
            failures.append(f"{scenario.name}: {error} [{planner}]")
    row = _log_row(scenario, source.label, digest) | {"not_asked": not_asked}
    if log is not None:
        for driven in discriminate(scenario, run.drive_loop):
            row[f"{driven.driver}_breaks"] = str(driven.breaks or "")
    if pictures is not None:
        draw_events(pictures, scenario, digest, rows)
    findings = health.table(scenario.name, health.findings(scenario)).to_dict("records")
    return MinedLog(
        scenario.name, _plain(row), [*map(_plain, rows)], [*map(_plain, findings)], tuple(failures)
    )


def _rows(
    scenario: Scenario, log: DrivenLog | None, kinds: Sequence[str]
) -> tuple[list[dict[str, Any]], list[str], list[str]]:
    """The rows of the events of all kinds, the kinds that were not searched, and the failures;
    `log`: None if there is no drive.
    """
    rows, not_asked, failures = list[dict[str, Any]](), list[str](), list[str]()
    for kind in load_kinds(kinds):
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
    return rows, not_asked, failures


def _log_row(scenario: Scenario, label: str, digest: str) -> dict[str, Any]:
    """The row of logs.parquet of a log in which nothing was found yet."""
    metadata = scenario.metadata
    return {
        "log": scenario.name,
        "source": label,
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
        "not_asked": [],
        "error": "",
        **dict.fromkeys(BREAKS, ""),
    }


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


def load_kinds(kinds: Sequence[str]) -> tuple[EventKind, ...]:
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


def not_mined(label: str, line: str) -> MinedLog:
    """The result of a log that cannot be read; `line` says why."""
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
