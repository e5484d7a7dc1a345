"""The settings of a run's [log] table, for readers of logs and maps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from math import inf, pi

from replan.core.errors import LogError
from replan.logs.agents import AgentKind
from replan.logs.driving import NAMES as DRIVERS
from replan.logs.vehicle import VehicleParameters, assumed_car

SIZES = ("length", "width", "wheelbase", "rear_overhang")
"""Keys of `[log.car]`."""
POINTS = ("rear_axle", "centre", "front", "rear")
"""Values of `ego_point` and `agents_point`: rear axle, centre of the box, middles of its front and
rear."""
HEADINGS: Mapping[str, tuple[float, float]] = {
    "degrees": (pi / 180.0, 0.0),
    "degrees clockwise from north": (-pi / 180.0, 0.5 * pi),
    "rad clockwise from north": (-1.0, 0.5 * pi),
    "rad clockwise from x": (-1.0, 0.0),
    "degrees clockwise from x": (-pi / 180.0, 0.0),
    "rad from north": (1.0, 0.5 * pi),
    "degrees from north": (pi / 180.0, 0.5 * pi),
}
"""Conventions of headings: factor and offset, rad, to rad counter-clockwise from x."""
KMH = 1.0 / 3.6
AXES: Mapping[str, tuple[bool, float, float]] = {
    "world": (False, 1.0, 1.0),
    "own": (True, 1.0, 1.0),
    "own, y to the right": (True, 1.0, -1.0),
    "own, x to the rear": (True, -1.0, 1.0),
    "world, y reversed": (False, 1.0, -1.0),
    "world, x reversed": (False, -1.0, 1.0),
    "world, both reversed": (False, -1.0, -1.0),
    "world, in km/h": (False, KMH, KMH),
    "own, in km/h": (True, KMH, KMH),
}
"""Axes and units of velocities: whether x points along the heading, and the factors of vx and
vy.
"""
CHOICES: Mapping[str, Iterable[str]] = {
    "ego_point": POINTS,
    "agents_point": POINTS,
    "ego_heading": HEADINGS,
    "agents_heading": HEADINGS,
    "ego_axes": AXES,
    "agents_axes": AXES,
}
"""Values of the settings that choose a convention; "" leaves the choice to replan."""


FIELD = "field"
"""Key of `driver` that names a field."""


@dataclass(frozen=True)
class LogSettings:
    """The `[log]` table of a run: data that logs lack, or where logs have them. Readers use the
    keys of their format.

    Raises:
        ValueError: A value is not one of those above, a size is not positive, or `end` is not after
            `begin`.
    """

    ego: str = ""
    """Id of the road user to use as the ego; "": the log's ego."""
    problem: int = 0
    """Planning problem of a CommonRoad file, by id or by number from 1; 0: the first."""
    reader: str = ""
    """The reader to try first: a format's name, or "module:NAME" of a reader of your own."""
    map: str = ""
    """Path of a map that replaces the log's (Lanelet2 .osm, 123D map.arrow, OpenDRIVE .xodr); "":
    the log's own.
    """
    map_origin: str = ""
    """Origin of that map's coordinates, if the map does not state it
    (`replan.logs.maps.projections.FORMS`).
    """
    begin: float = 0.0
    """Seconds after the log's first ego state at which the scenario begins."""
    end: float = inf
    """Seconds after the log's first ego state at which it ends; inf: with the log."""
    clock: str = ""
    """Times of messages: "log" for times of recording, "header" for stamps of the sender; "":
    chosen by the reader, with a note.
    """
    topics: Mapping[str, str] = field(default_factory=dict)
    """Topic or file by role ("ego", "speed", "acceleration", "agents", "lights", "goal", "plan",
    "alternatives", "steering" ...), to override the choice by type; "-": none.
    """
    frames: Mapping[str, str] = field(default_factory=dict)
    """Name of the log's frame by role: "map" and "base" (rear axle) of transforms."""
    columns: Mapping[str, str] = field(default_factory=dict)
    """Name of a table's column by replan's name ("x": "pos_east_m"; for one table "ego.x",
    "agents.x").
    """
    car: Mapping[str, float] = field(default_factory=dict)
    """Sizes of the ego, m, if the log has none: "length", "width", "wheelbase", "rear_overhang"."""
    repair: str = "auto"
    """Whether to make tracks from raw detections: "auto" (if they are not tracks), "on", "off"."""
    ego_point: str = ""
    """Point of the ego whose positions a table has, of `POINTS`: "rear_axle", "centre", "front" or
    "rear" of its box; "": the rear axle, but the centre if the ego is a road user of a table of
    tracks.
    """
    agents_point: str = ""
    """Point of the agents whose positions a table has, of `POINTS`; "": the centre."""
    ego_heading: str = ""
    """Convention of a table's headings of the ego, of `HEADINGS`; "": rad, counter-clockwise from
    x. With a unit in the table, name the convention in rad.
    """
    agents_heading: str = ""
    """Convention of a table's headings of the agents."""
    ego_axes: str = ""
    """Axes of the ego's velocity in a bag's odometry, of `AXES`; "": its own, but others if it fits
    its motion in these alone.
    """
    agents_axes: str = ""
    """Axes of the agents' velocities, of `AXES`; "": those of the format, but others if they fit
    the motion in these alone.
    """
    kinds: Mapping[str, str] = field(default_factory=dict)
    """replan's kind by the log's word for it ("Tram": "bus"), for words that are not known."""
    driver: Mapping[str, str] = field(default_factory=dict)
    """Who drives (`replan.logs.driving.NAMES`) by the value of a column or of a topic ("2":
    "autonomous"), for values that are not known; "field": the field of the topic's messages.
    """
    clock_ahead_s: float = inf
    """Time by which the agents' clock is ahead of the ego's, s; inf: found by the times
    (`replan.logs.clock_offset`).
    """

    def __post_init__(self) -> None:
        if not 0.0 <= self.begin < self.end:
            raise ValueError(
                f"a log from {self.begin} s to {self.end} s is empty: end must be after begin, "
                "both >= 0"
            )
        if self.clock not in ("", "log", "header"):
            raise ValueError(f"clock is {self.clock!r}: log or header")
        for key, known in CHOICES.items():
            value = getattr(self, key)
            if value not in ("", *known):
                raise ValueError(f"{key} is {value!r}: {' or '.join(known)}")
        unknown = set(self.kinds.values()) - {kind.value for kind in AgentKind}
        if unknown:
            known_kinds = ", ".join(kind.value for kind in AgentKind)
            raise ValueError(f"kinds has {min(unknown)!r}: known are {known_kinds}")
        modes = {mode for value, mode in self.driver.items() if value != FIELD}
        if not modes <= set(DRIVERS):
            refused = min(modes - set(DRIVERS))
            raise ValueError(f"driver has {refused!r}: known are {', '.join(DRIVERS)}")
        if self.repair not in ("auto", "on", "off"):
            raise ValueError(f"repair is {self.repair!r}: auto, on or off")
        if not set(self.car) <= set(SIZES):
            raise ValueError(
                f"car has no {min(set(self.car) - set(SIZES))}: its keys are {', '.join(SIZES)}"
            )
        if not all(value > 0.0 for value in self.car.values()):
            raise ValueError("the sizes in car must be positive")

    def vehicle(self, notes: list[str]) -> VehicleParameters | None:
        """Return a vehicle with the sizes of `car`, and the others as usual for its length, with a
        note (`assumed_car`); None without sizes.

        LogError if the sizes do not fit each other.
        """
        if not self.car:
            return None
        vehicle = assumed_car(self.car, notes)
        odd = {size for size, value in self.car.items() if getattr(vehicle, size) != value}
        if odd:
            sentence = (
                f"car: a {min(odd)} of {self.car[min(odd)]:g} m does not fit a length of "
                f"{vehicle.length:g} m"
            )
            raise LogError(sentence, topic="[log]", remedy="correct the sizes, or state all four")
        return vehicle

    def between(self, begin: float, end: float) -> LogSettings:
        """Return the settings for the part of the log from `begin` to `end`, s."""
        return replace(self, begin=begin, end=end)
