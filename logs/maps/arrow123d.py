"""123D maps, `.arrow` (`logs.readers.arrow123d.map`): of one log, or of a place."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from logs.maps.base import MapFile, MapReader

MAGIC = b"ARROW1"


def read_123d(path: Path, settings: Mapping[str, str]) -> MapFile:
    """All of a map; LogError where the file is none."""
    from logs.readers.arrow123d.map import road_of_map

    notes: list[str] = []
    return MapFile(road_of_map(path, notes=notes), "as in the 123D map", tuple(notes))


def _claims(path: Path) -> bool:
    try:
        if path.suffix.lower() != ".arrow":
            return False
        with path.open("rb") as stream:
            return stream.read(len(MAGIC)) == MAGIC
    except OSError:
        return False


READER = MapReader("123D", "*.arrow", _claims, read_123d)
