"""`replan convert | repair`: logs of any format to native MCAP, the list of formats, and the table of repairs."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import astuple, fields, replace
from io import StringIO
from pathlib import Path
from typing import Any

from logs.errors import ConfigError, LogError
from logs.mcap import is_written_here, write_scenario
from logs.mcap.writer import Entry
from logs.readers import READER, LogSettings, Reader, logs_in, read_log, reader_called, reader_of, readers
from logs.repair.detections import TrackChange
from logs.scenario import Scenario
from replay.results.tables import write_text
from replay.run.claim import claimed_file, claimed_files

CHANGE_COLUMNS = tuple({"begin": "t_from_s", "end": "t_to_s"}.get(each.name, each.name) for each in fields(TrackChange))
"""Columns of the table: the fields of `logs.repair.detections.TrackChange`."""
CHANGES_HEADER = ",".join(CHANGE_COLUMNS) + "\n"


def _has_changes(file: Path) -> bool:
    with file.open(encoding="utf-8") as stream:
        return stream.readline() == CHANGES_HEADER


def listing() -> Iterator[str]:
    """The lines of the formats, and how a format is added."""
    width = max(len(reader.name) for reader in readers())
    for reader in readers():
        keys = f"; [log] {', '.join(reader.settings)}" if reader.settings else ""
        yield f"{reader.name:{width}}  {reader.summary} ({reader.looks_for}{keys})"
    yield f"Yours: a replan.Reader, as module:NAME or by an entry point of the group {READER.group}; docs/extend.md."


def table() -> list[dict[str, Any]]:
    """The content of `listing`, as data."""
    keys = ("name", "summary", "looks_for", "suffixes", "settings")
    return [{key: getattr(reader, key) for key in keys} for reader in readers()]


def convert_all(
    logs: Sequence[Path],
    out: Path,
    settings: LogSettings,
    *,
    foxglove: bool = False,
    say: Callable[[str], None],
    say_error: Callable[[str], None],
) -> bool:
    """Write logs as native MCAP, into `out` if its suffix is .mcap, else into that folder; return whether all are read.

    With `foxglove` they get channels that Foxglove draws.
    If the first name is not a path but the name of a reader, that reader reads all files, whatever their names.

    Raises:
        ConfigError: A path does not exist, there is nothing to convert, several logs are to go into one file, a log
            would be written over itself or another, or the package for Foxglove is not installed. Nothing has been
            written in these cases.
        OutputError: A log cannot be written.
    """
    reader = None
    first = str(logs[0])
    if not logs[0].exists() and (":" in first or first in {each.name for each in readers()}):
        reader, logs = reader_called(first), logs[1:]
    found = [log for path in logs for log in _logs_at(path, reader, settings, say)]
    if not found:
        raise ConfigError("no logs to convert; `replan convert --formats` lists what replan reads")
    if out.suffix == ".mcap" and len(found) > 1:
        raise ConfigError(f"{len(found)} logs do not go into one log: give a folder with -o")
    names = [f"{log.name if log.is_dir() else log.stem.removesuffix('.cr')}.mcap" for log in found]
    last = dict(zip(names, found, strict=True))
    for name, log in zip(names, found, strict=True):
        if last[name] != log:
            raise ConfigError(f"{log} and {last[name]} would both become {out / name}; convert them into two folders")
    channels = _channels(foxglove=foxglove)
    all_read = True
    with claimed_files(out, (".mcap",), _is_ours((log, reader_of(log, settings)) for log in found)) as place:
        targets = [place(name) for name in names]
        for log, target in zip(found, targets, strict=True):
            try:
                scenario = read_log(log, settings, reader)
                write_scenario(target, scenario, beside=channels(scenario))
            except LogError as error:
                say_error(str(error))
                all_read = False
                continue
            say("\n".join([str(target), *(f"    note: {note}" for note in scenario.notes)]))
    return all_read


def _channels(*, foxglove: bool) -> Callable[[Scenario], Iterable[Entry]]:
    """What is written beside a log: nothing, or what Foxglove draws; ConfigError if its package is not installed."""
    if not foxglove:
        return lambda scenario: ()
    from replay.draw.foxglove import scenario_channels
    from replay.mine.mine import markers

    return lambda scenario: scenario_channels(scenario, markers(scenario))


def _logs_at(path: Path, asked: Reader | None, settings: LogSettings, say: Callable[[str], None]) -> Iterator[Path]:
    """The log, or those of a folder; files named like logs that no reader claims are named as left out."""
    if not path.exists():
        raise ConfigError(f"{path}: no such file or folder")
    if asked is not None or not path.is_dir() or reader_of(path, settings) is not None:
        yield path
        return
    for log, reader in logs_in(path, settings):
        if reader is None:
            say(f"left out {log}: no reader recognises it")
        else:
            yield log


def _is_ours(logs: Iterable[tuple[Path, Reader | None]]) -> Callable[[Path], bool]:
    """Whether an earlier file is a log of replan, and none of these logs, which are read."""
    read = {
        os.path.realpath(file) for log, reader in logs for file in ((log,) if reader is None else reader.files(log))
    }
    return lambda file: os.path.realpath(file) not in read and is_written_here(file)


def repair_log(log: Path, target: Path, table: Path | None, settings: LogSettings) -> Scenario:
    """Read a log, write it as native MCAP, and its changes as CSV; the scenario, whose `repair` may be None.

    Raises:
        ConfigError: There is no such log, or a file of it would be overwritten. Nothing has been written then.
        LogError: The log cannot be read.
        OutputError: A file cannot be written.
    """
    if not log.exists():
        raise ConfigError(f"{log}: no such file or folder")
    reader = reader_of(log, settings)
    with ExitStack() as claims:
        claims.enter_context(claimed_file(target, (".mcap",), _is_ours([(log, reader)])))
        if table is not None:
            claims.enter_context(claimed_file(table, (".csv",), _has_changes))
        scenario = read_log(log, settings, reader)
        write_scenario(target, scenario)
        if table is not None:
            rows = (astuple(change) for change in changes(scenario))
            text = StringIO(CHANGES_HEADER)
            text.seek(0, 2)
            csv.writer(text, lineterminator="\n").writerows((*values, " ".join(sources)) for *values, sources in rows)
            write_text(table, text.getvalue())
    return scenario


def changes(scenario: Scenario) -> tuple[TrackChange, ...]:
    """The changes of the repair; empty if there was none."""
    return () if scenario.repair is None else scenario.repair.changes


def changes_as_text(scenario: Scenario) -> Iterator[str]:
    """The changes as text, one line each."""
    if scenario.repair is None:
        yield "    not repaired: the log's road users are tracks already (--repair on does it all the same)"
    width = max((len(change.agent) for change in changes(scenario)), default=0)
    for change in changes(scenario):
        yield f"    {change.what:10} {change.agent:{width}} {change.begin:7.2f} to {change.end:7.2f} s  {change.why}"


def unrepaired(log: Path, settings: LogSettings, scenario: Scenario) -> Scenario | None:
    """The log of a repaired scenario as it was before the repair; None if the log has no tracks of its own."""
    if scenario.repair is None:
        return None
    raw = read_log(log, replace(settings, repair="off"))
    return raw if raw.repair is None and len(raw.tracks) else None
