"""Reads maps that replace a log's own road (`--map`, `[log] map`), with a table of readers tried in
order.

A new format needs one file with a `MapReader` and one line in `BUILTIN`.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from replan.core.errors import LogError
from replan.core.files import check_regular
from replan.logs.log_settings import LogSettings
from replan.logs.maps import arrow123d_map, lanelet2, opendrive
from replan.logs.maps.base import MapFile, MapReader, on_map
from replan.logs.scenario import Scenario

__all__ = ["BUILTIN", "MapFile", "MapReader", "map_files", "map_reader_of", "read_map", "with_map"]


BUILTIN = (lanelet2.READER, opendrive.READER, arrow123d_map.READER)
"""The map readers in the order in which they are tried."""


def map_reader_of(path: Path) -> MapReader:
    """Return the reader that claims a map; LogError if there is none."""
    check_regular(path)
    if not path.is_file():
        raise LogError("no such map", file=path)
    reader = next((reader for reader in BUILTIN if reader.claims(path)), None)
    if reader is None:
        known = ", ".join(f"{reader.name} ({reader.looks_for})" for reader in BUILTIN)
        raise LogError("not a map that replan reads", file=path, remedy=f"known are {known}")
    return reader


def map_files(path: Path) -> tuple[Path, ...]:
    """Return the files of a map, in a fixed order; LogError if no reader recognises it."""
    return map_reader_of(path).files(path)


def read_map(path: Path, settings: LogSettings | None = None) -> MapFile:
    """Read a map of any format, in its own coordinates; LogError, and nothing else, if it is none
    or damaged.
    """
    reader = map_reader_of(path)
    settings = settings or LogSettings()
    stamps = tuple(
        (file, file.stat().st_mtime_ns, file.stat().st_size) for file in reader.files(path)
    )
    return _read(
        reader, path, stamps, tuple((key, str(getattr(settings, key))) for key in reader.settings)
    )


@lru_cache(maxsize=2)
def _read(
    reader: MapReader,
    path: Path,
    stamps: tuple[tuple[Path, int, int], ...],
    settings: tuple[tuple[str, str], ...],
) -> MapFile:
    """Read the map once for all logs and windows, as long as its files and the settings do not
    change.
    """
    return reader.read(path, dict(settings))


def with_map(scenario: Scenario, settings: LogSettings) -> Scenario:
    """Put the scenario on the map that the settings name; LogError if it cannot be read or does not
    fit the drive.
    """
    path = Path(settings.map)
    return on_map(scenario, read_map(path, settings), path, map_reader_of(path).name)
