"""Reads logs of all formats: the first reader in a table that claims a path reads it.

A new format needs one file with a `Reader` and one line in `BUILTIN`. A reader of your own is named
by `reader = "my_module:READER"` in a run's [log] table, or by an entry point of the group
`replan.readers`:

    [project.entry-points."replan.readers"]
    mine = "my_package.reader:READER"
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import cache
from math import inf
from pathlib import Path

import numpy as np

from replan.core.errors import ConfigError, LogError, unknown_name
from replan.core.extension import ExtensionKind, an_instance
from replan.core.files import check_regular, special_kind
from replan.core.urls import local_path
from replan.logs.comparisons import COMPARISONS
from replan.logs.edit.cut import cut, in_nanoseconds
from replan.logs.edit.reach import within_reach
from replan.logs.log_checks import passed
from replan.logs.log_settings import LogSettings
from replan.logs.maps import with_map
from replan.logs.readers import (
    argoverse2,
    arrow123d,
    comma2k19,
    commonroad,
    own_mcap,
    pose_file,
    ros,
    table,
)
from replan.logs.readers.admission import CHECKS, CLOCKS, ROAD_CHECKS
from replan.logs.readers.base import Reader
from replan.logs.readers.foreign import FORMATS, foreign, known_format
from replan.logs.readers.repaired import named, repaired
from replan.logs.scenario import Scenario

BUILTIN = (
    commonroad.READER,
    own_mcap.OSI_READER,
    comma2k19.READER,
    table.READER,
    ros.READER,
    arrow123d.READER,
    argoverse2.READER,
    pose_file.READER,
    own_mcap.READER,
)
"""The built-in readers, in the order in which they are tried."""
READER: ExtensionKind[Reader] = ExtensionKind(
    "reader",
    "readers",
    {reader.name: reader for reader in BUILTIN},
    an_instance(Reader, "replan.Reader"),
)
"""Finds readers by name: the built-in ones and those of users."""
CHOICES = (
    "ego",
    "problem",
    "ego_point",
    "agents_point",
    "ego_heading",
    "agents_heading",
    "ego_axes",
    "kinds",
    "driver",
)
"""Settings that are refused if the format has no choice of them."""
LONGEST_S = 7 * 86400.0
"""Longest duration of a log, s: times beyond a week have another unit (and time grids would fill
the memory).
"""

__all__ = [
    "BUILTIN",
    "FORMATS",
    "READER",
    "LogSettings",
    "Reader",
    "foreign",
    "known_format",
    "logs_in",
    "read_log",
    "reader_called",
    "reader_of",
    "readers",
    "with_tracks",
]


@cache
def readers(first: str = "") -> tuple[Reader, ...]:
    """Return all readers in the order in which they are tried: `first`, those of entry points, the
    built-in ones.

    ConfigError if one cannot be loaded or is not a `Reader`, or two have the same name.
    """
    ordered = (*READER.installed().values(), *BUILTIN)
    ordered = (*([READER.find(first)] if ":" in first else []), *ordered)
    names = [reader.name for reader in ordered]
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise ConfigError(f"there are two readers called '{min(twice)}'; rename or uninstall one")
    if first and ":" not in first:
        table = dict(zip(names, ordered, strict=True))
        if first not in table:
            raise unknown_name("reader", first, table)
        ordered = (table[first], *(reader for reader in ordered if reader.name != first))
    return ordered


def reader_called(name: str) -> Reader:
    """Return a reader by its name or "module:NAME"; ConfigError if there is none."""
    return readers(name)[0]


def reader_of(path: Path, settings: LogSettings | None = None) -> Reader | None:
    """Return the reader that claims a file or folder, or None.

    Pipes, sockets and devices have no reader.
    """
    if special_kind(path):
        return None
    known = readers(settings.reader if settings else "")
    for reader in known:
        if reader.claims(path):
            return reader
    for reader in known:
        if settings and reader.claims_with(path, settings):
            return reader
    return None


def read_log(
    path: Path | str, settings: LogSettings | None = None, reader: Reader | None = None
) -> Scenario:
    """Read the scenario in a log of any format; `path` is local, `reader` None is the one that
    claims it.

    Raises:
        LogError: The log is damaged, unknown, or lacks required data; no other exception is raised
            for any bytes.
    """
    path, settings = local_path(path), settings or LogSettings()
    check_regular(path)
    reader = reader or reader_of(path, settings)
    if reader is None:
        raise foreign(path)
    try:
        for key in CHOICES:
            asked = getattr(settings, key)
            if asked and key not in reader.settings:
                problem = (
                    f"{key} {asked} is asked for, but the format {reader.name} has no choice of it"
                )
                raise LogError(problem, topic="[log]", remedy=f"leave {key} out")
        check_regular(*(reader.files(path) if path.exists() else ()))
        with np.errstate(all="ignore"):  # absurd numbers are refused as such
            is_table = "ego_heading" in reader.settings
            whole = reader.read(path, settings)
            whole = passed(whole, COMPARISONS, settings, is_table=is_table)
            whole = within_reach(whole)
            scenario = repaired(whole, settings.repair)
            if not reader.cuts or settings.between(0.0, inf) == settings:
                scenario = passed(scenario, CLOCKS)
            scenario = cut(scenario, settings.begin, settings.end)
            is_named = scenario.repair is whole.repair
            scenario = in_nanoseconds(scenario)
            scenario = scenario if is_named else named(scenario)
            if scenario.duration > LONGEST_S:
                remedy = "a drive lasts less than a week: check the units of the times"
                raise LogError(f"the log lasts {scenario.duration:g} s", remedy=remedy)
            scenario = passed(scenario, CHECKS)
            if settings.map:
                scenario = with_map(scenario, settings)
            return passed(scenario, ROAD_CHECKS)
    except LogError as error:
        raise error if error.file is not None else error.at(path) from None
    except Exception as error:
        if reader in BUILTIN:
            raise
        problem = f"the reader {reader.name} raised {type(error).__name__}: {error}"
        raise LogError(
            problem, file=path, remedy="its author: raise LogError for a log that cannot be read"
        ) from error


def with_tracks(scenario: Scenario, settings: LogSettings) -> Scenario:
    """Check a scenario without a file (`replan.logs.comparisons`), make tracks from its detections,
    and cut the part between the settings' begin and end.
    """
    scenario = passed(scenario, COMPARISONS, settings)
    tracked = repaired(scenario, settings.repair)
    part = cut(tracked, settings.begin, settings.end)
    part = part if part is tracked else in_nanoseconds(part)
    return part if tracked.repair is scenario.repair else named(part)


def logs_in(
    folder: Path, settings: LogSettings | None = None
) -> Iterator[tuple[Path, Reader | None]]:
    """Yield the logs under a folder, sorted, with their readers; None for files that only have a
    log's suffix.

    A claimed folder is one log and is not searched.
    """
    for root, folders, files in os.walk(folder):
        readers_of_paths = {
            Path(root, name): reader_of(Path(root, name), settings) for name in (*folders, *files)
        }
        folders[:] = sorted(name for name in folders if readers_of_paths[Path(root, name)] is None)
        suffixes = {
            suffix
            for reader in readers(settings.reader if settings else "")
            for suffix in reader.suffixes
        }
        for path in sorted(readers_of_paths):
            if readers_of_paths[path] is not None or (
                path.name not in folders and path.suffix.lower() in suffixes
            ):
                yield path, readers_of_paths[path]


def windows(
    path: Path, settings: LogSettings, length: float, every: float | None = None
) -> tuple[LogSettings, ...]:
    """Split a log from `begin` to `end` into parts of `length` s, one every `every` s (by default
    `length`).

    Parts shorter than half of `length` are left out.
    """
    reader = reader_of(path, settings)
    if reader is not None:
        check_regular(*reader.files(path))
    span = reader.span(path) if reader is not None else None
    if span is None and settings.end == inf:
        scenario = read_log(path, settings)
        span = settings.begin, settings.begin + scenario.duration
    end = settings.end if span is None else min(settings.end, span[1])
    every = length if every is None else every
    count = max(1, int((end - settings.begin - 0.5 * length) / every) + 1)
    starts = [settings.begin + k * every for k in range(count)]
    ends = [min(settings.begin + k * every + length, end) for k in range(count)]
    return tuple(map(settings.between, starts, ends))
