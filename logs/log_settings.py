"""The settings of a run's [log] table, for readers of logs and maps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf
from typing import Any

from replan.core.errors import reading
from replan.logs.vehicle import VehicleParameters

SIZES = ("length", "width", "wheelbase", "rear_overhang")
"""Keys of `[log.car]`."""
EGO_POINTS = ("", "rear_axle", "centre")
"""Values of `ego_point`."""


@dataclass(frozen=True)
class LogSettings:
    """The `[log]` table of a run: data that logs lack, or where logs have them. Readers use the
    keys of their format.

    Attributes:
        ego: Id of the road user to use as the ego; "": the log's ego.
        problem: Planning problem of a CommonRoad file, by id or by number from 1; 0: the first.
        reader: The reader to try first: a format's name, or "module:NAME" of a reader of your own.
        map: Path of a map that replaces the log's (Lanelet2 .osm, 123D map.arrow, OpenDRIVE .xodr);
            "": the log's own.
        map_origin: Origin of that map's coordinates, if the map does not state it
            (`replan.logs.maps.projections.FORMS`).
        begin: Seconds after the log's first ego state at which the scenario begins.
        end: Seconds after the log's first ego state at which it ends; inf: with the log.
        clock: Times of messages: "log" for times of recording, "header" for stamps of the sender;
            "": chosen by the reader, with a note.
        topics: Topic or file by role ("ego", "speed", "acceleration", "agents", "lights", "goal",
            "plan", "steering" ...), to override the choice by type; "-": none.
        frames: Name of the log's frame by role: "map" and "base" (rear axle) of transforms.
        columns: Name of a table's column by replan's name ("x": "pos_east_m"; for one table
            "ego.x", "agents.x").
        car: Sizes of the ego, m, if the log has none: "length", "width", "wheelbase",
            "rear_overhang".
        repair: Whether to make tracks from raw detections: "auto" (if they are not tracks), "on",
            "off".
        ego_point: Point of the ego whose positions a table has: "rear_axle" or "centre" of its box;
            "": the rear axle, but the centre if the ego is a road user of a table of tracks.

    Raises:
        ValueError: A value is not one of those above, a size is not positive, or `end` is not after
            `begin`.
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
            raise ValueError(
                f"a log from {self.begin} s to {self.end} s is empty: end must be after begin, "
                "both >= 0"
            )
        if self.clock not in ("", "log", "header"):
            raise ValueError(f"clock is {self.clock!r}: log or header")
        if self.ego_point not in EGO_POINTS:
            raise ValueError(f"ego_point is {self.ego_point!r}: rear_axle or centre")
        if self.repair not in ("auto", "on", "off"):
            raise ValueError(f"repair is {self.repair!r}: auto, on or off")
        if not set(self.car) <= set(SIZES):
            raise ValueError(
                f"car has no {min(set(self.car) - set(SIZES))}: its keys are {', '.join(SIZES)}"
            )
        if not all(value > 0.0 for value in self.car.values()):
            raise ValueError("the sizes in car must be positive")

    def vehicle(self) -> VehicleParameters:
        """Return the default car with the sizes of `car`; LogError if the sizes do not fit each
        other.
        """
        sizes: dict[str, Any] = dict(self.car)
        with reading(topic="[log]"):
            return replace(VehicleParameters(), **sizes)

    def between(self, begin: float, end: float) -> LogSettings:
        """Return the settings for the part of the log from `begin` to `end`, s."""
        return replace(self, begin=begin, end=end)
