"""`replan repair`: a log of raw detections as a log of tracks, with the table of what was changed and why."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import astuple, fields, replace
from io import StringIO
from pathlib import Path

from logs.agents import Change
from logs.errors import ConfigError, writing
from logs.mcap import write_scenario
from logs.readers import LogSettings, read_log, reader_of
from logs.scenario import Scenario

COLUMNS = tuple({"begin": "t_from_s", "end": "t_to_s"}.get(each.name, each.name) for each in fields(Change))
"""Of the table: those of `logs.agents.Change`."""


def repair_log(log: Path, target: Path, table: Path | None, settings: LogSettings) -> Scenario:
    """Read a log, write it as native MCAP, and its changes as CSV; the scenario, whose `repair` may be None.

    Raises:
        ConfigError: There is no such log, or a file of it would be overwritten. Nothing was written then.
        LogError: The log cannot be read.
        OutputError: A file cannot be written.
    """
    if not log.exists():
        raise ConfigError(f"{log}: no such file or folder")
    reader = reader_of(log, settings)
    inputs = {file.resolve() for file in (reader.files(log) if reader is not None else (log,))}
    places = [place for place in (target, table) if place is not None]
    for place in places:
        if place.resolve() in inputs:
            raise ConfigError(f"{place} is the log itself and would be overwritten; give another place")
    if len({place.resolve() for place in places}) < len(places):
        raise ConfigError(f"{target} is to be the log and the table: give two places")
    scenario = read_log(log, settings, reader)
    for place in places:
        with writing(place):
            place.parent.mkdir(parents=True, exist_ok=True)
    write_scenario(target, scenario)
    if table is not None:
        from replay.results.tables import write_text

        write_text(table, as_csv(scenario))
    return scenario


def as_csv(scenario: Scenario) -> str:
    """The changes of a scenario, a row each; the header alone where it was not repaired."""
    out = StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    for change in changes(scenario):
        *values, sources = astuple(change)
        writer.writerow((*values, " ".join(sources)))
    return out.getvalue()


def changes(scenario: Scenario) -> tuple[Change, ...]:
    """What was changed."""
    return () if scenario.repair is None else scenario.repair.changes


def lines(scenario: Scenario) -> Iterator[str]:
    """The changes as text, one line each."""
    if scenario.repair is None:
        yield "    not repaired: the log's road users are tracks already (--repair on does it all the same)"
    width = max((len(change.agent) for change in changes(scenario)), default=0)
    for change in changes(scenario):
        yield f"    {change.what:10} {change.agent:{width}} {change.begin:7.2f} to {change.end:7.2f} s  {change.why}"


def before(log: Path, settings: LogSettings, scenario: Scenario) -> Scenario | None:
    """The log of a repaired scenario without the repair; None where the log does not hold it so."""
    if scenario.repair is None:
        return None
    raw = read_log(log, replace(settings, repair="off"))
    return raw if raw.repair is None and len(raw.tracks) else None
