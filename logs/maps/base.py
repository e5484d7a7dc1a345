"""The reader of a map format, one value `MapReader` per file, and what it reads, a `MapFile`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from logs.readers.base import itself
from logs.road import Road


@dataclass(frozen=True, eq=False)
class MapFile:
    """A map in its own world coordinates.

    Attributes:
        road: Its lanes, m; lanes without a speed limit have NaN, the road's default counts for nothing.
        frame: How its coordinates came about, in words.
        notes: What was assumed or left out in reading, one sentence each.
        aliases: Other numbers under which logs may know a light of the road's stop lines, by its id.
        side_known: Whether the map says on which side traffic drives.
    """

    road: Road
    frame: str
    notes: tuple[str, ...] = ()
    aliases: Mapping[int, tuple[int, ...]] = field(default_factory=dict)
    side_known: bool = True


@dataclass(frozen=True)
class MapReader:
    """One format of maps.

    Attributes:
        name: In messages and notes ("Lanelet2").
        looks_for: Of its files, in words ("*.osm").
        claims: Whether a path is a map of this format; cheap, raises nothing on any bytes.
        read: The map in a file, given what `settings` say; raises LogError, and nothing else, on any bytes.
        files: The files that a map is read from: what its identity is hashed from.
        settings: The keys of `LogSettings` that it reads; they hold texts.
    """

    name: str
    looks_for: str
    claims: Callable[[Path], bool]
    read: Callable[[Path, Mapping[str, str]], MapFile]
    files: Callable[[Path], tuple[Path, ...]] = itself
    settings: tuple[str, ...] = ()
