"""The class of log readers, one instance per format, and the settings of all readers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path
from typing import Any

from logs.errors import LogError
from logs.files import special_kind
from logs.scenario import Scenario
from logs.vehicle import VehicleParameters

SIZES = ("length", "width", "wheelbase", "rear_overhang")
"""Keys of `[log.car]`."""
EGO_POINTS = ("", "rear_axle", "centre")


@dataclass(frozen=True)
class LogSettings:
    """The `[log]` table of a run: data that logs lack, or where logs have them. Readers use the keys of their format.

    Attributes:
        ego: Id of the road user to use as the ego; "": the log's ego.
        ego_point: Point of the ego whose positions a table has: "rear_axle" or "centre" of its box; "": the rear axle,
            for a road user of a table of tracks the centre.
        problem: Planning problem of a CommonRoad file, by id or by number from 1; 0: the first.
        reader: The reader to try first: a format's name, or "module:NAME" of a reader of your own.
        map: Path of a map that replaces the log's (Lanelet2 .osm, 123D map.arrow, OpenDRIVE .xodr); "": the log's own.
        map_origin: Origin of that map's coordinates, if the map does not state it (`logs.maps.projections.FORMS`).
        begin: Seconds after the log's first ego state at which the scenario begins.
        end: Seconds after the log's first ego state at which it ends; inf: with the log.
        clock: Times of messages: "log" for times of recording, "header" for stamps of the sender; "": chosen by the
            reader, with a note.
        topics: Topic or file by role ("ego", "speed", "acceleration", "agents", "lights", "goal", "plan", "steering"
            ...), to override the choice by type; "-": none.
        frames: Name of the log's frame by role: "map" and "base" (rear axle) of transforms.
        columns: Name of a table's column by replan's name ("x": "pos_east_m"; for one table "ego.x", "agents.x").
        car: Sizes of the ego, m, if the log has none: "length", "width", "wheelbase", "rear_overhang".
        repair: Whether to make tracks from raw detections: "auto" (if they are not tracks), "on", "off".
    """

    ego: str = ""
    problem: int = 0
    reader: str = ""
    map: str = ""
    map_origin: str = ""
    begin: float = 0.0
    end: float = inf
    clock: str = ""
    topics: Mapping[str, str] = field(default_factory=dict)
    frames: Mapping[str, str] = field(default_factory=dict)
    columns: Mapping[str, str] = field(default_factory=dict)
    car: Mapping[str, float] = field(default_factory=dict)
    repair: str = "auto"
    ego_point: str = ""

    def __post_init__(self) -> None:
        if not 0.0 <= self.begin < self.end:
            raise ValueError(f"a log from {self.begin} s to {self.end} s is empty: end must be after begin, both >= 0")
        if self.clock not in ("", "log", "header"):
            raise ValueError(f"clock is {self.clock!r}: log or header")
        if self.ego_point not in EGO_POINTS:
            raise ValueError(f"ego_point is {self.ego_point!r}: rear_axle or centre")
        if self.repair not in ("auto", "on", "off"):
            raise ValueError(f"repair is {self.repair!r}: auto, on or off")
        if not set(self.car) <= set(SIZES):
            raise ValueError(f"car has no {min(set(self.car) - set(SIZES))}: its keys are {', '.join(SIZES)}")
        if not all(value > 0.0 for value in self.car.values()):
            raise ValueError("the sizes in car must be positive")

    def vehicle(self) -> VehicleParameters:
        """Return the default car with the sizes of `car`.

        Raises:
            LogError: The sizes do not fit each other.
        """
        sizes: dict[str, Any] = dict(self.car)
        try:
            return replace(VehicleParameters(), **sizes)
        except ValueError as error:
            raise LogError(str(error), topic="[log]") from None

    def between(self, begin: float, end: float) -> LogSettings:
        """Return the settings for another part of the log."""
        return replace(self, begin=begin, end=end)


def beside(folder: Path, names: Sequence[str]) -> Path | None:
    """Return the optional file of a log's folder that has one of the `names`; None if there is none.

    Raises:
        LogError: The entry is not a file, several of the names exist, or a name differs from these by case only (its
            content would silently be left out).
    """
    try:
        held = {entry.name for entry in folder.iterdir()}
    except OSError as error:
        raise LogError(f"the folder cannot be read: {error.strerror}", file=folder) from None
    found = [name for name in names if name in held]
    known = {name.casefold(): name for name in names}
    for name in sorted(held - set(names)):
        if name.casefold() in known:
            meant = known[name.casefold()]
            what = f"{name} is not read: the file's name is {meant}"
            raise LogError(what, topic=name, remedy=f"rename it to {meant}")
    if len(found) > 1:
        raise LogError(f"{' and '.join(found)} are both there", topic=found[0], remedy="keep one of them")
    if not found:
        return None
    path = folder / found[0]
    if not path.is_file():
        remedy = "put a file there, or remove it if there is none"
        raise LogError(f"{path.name} is {special_kind(path) or 'a folder'}, not a file", topic=path.name, remedy=remedy)
    return path


@dataclass(frozen=True)
class TopicSummary:
    """One topic or table: schema, encoding, number of messages, first and last log time (ns; None without messages)."""

    topic: str
    schema: str
    encoding: str
    schema_encoding: str
    messages: int
    first_ns: int | None
    last_ns: int | None


@dataclass(frozen=True)
class LogContents:
    """The content of a log for `replan inspect`: its format in words ("": the reader's summary) and its topics."""

    profile: str = ""
    topics: tuple[TopicSummary, ...] = ()


def _nothing(path: Path) -> LogContents:
    return LogContents()


def files_named(suffix: str) -> Callable[[Path], bool]:
    """Return a function that claims all files with a suffix."""

    def claims(path: Path) -> bool:
        return path.suffix.lower() == suffix and path.is_file()

    return claims


def itself(path: Path) -> tuple[Path, ...]:
    """Return the files of a log that is a single file."""
    return (path,)


def _never(path: Path, settings: LogSettings) -> bool:
    return False


def _unknown_span(path: Path) -> tuple[float, float] | None:
    return None


@dataclass(frozen=True)
class Reader:
    """The reader of one log format.

    Attributes:
        name: Its name in `replan convert NAME` and in messages.
        summary: The format in one line.
        looks_for: The files that it reads, in words ("*.bag").
        suffixes: Suffixes of its files (".bag"): a file with such a suffix that no reader claims is reported.
        claims: Whether a path, file or folder, is a log of this format; fast, and raises nothing on any bytes.
        read: Reads the scenario; raises only LogError on any bytes.
        files: The files of a log, in a fixed order: the log's identity is their hash.
        span: First and last time of the log, s, if they can be found quickly; else None.
        contents: The topics that can be read; raises nothing.
        settings: The keys of `LogSettings` that it uses, besides `begin`, `end` and `repair`, which apply to all.
        cuts: Whether it reads only the surroundings of the part from `begin` to `end`, in times of the whole log.
        claims_with: Whether a path that it does not claim is a log of this format by the settings (names of columns).
    """

    name: str
    summary: str
    looks_for: str
    suffixes: tuple[str, ...]
    claims: Callable[[Path], bool]
    read: Callable[[Path, LogSettings], Scenario]
    files: Callable[[Path], tuple[Path, ...]] = itself
    span: Callable[[Path], tuple[float, float] | None] = _unknown_span
    contents: Callable[[Path], LogContents] = _nothing
    settings: tuple[str, ...] = ()
    cuts: bool = False
    claims_with: Callable[[Path, LogSettings], bool] = _never
