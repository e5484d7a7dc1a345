"""The objects in a 123D map (map.arrow), by layer.

Layers: lanes (0) with successors, neighbours and speed limits; of their groups (1) whether they are
in an intersection; crosswalks (3); car parks (5) and other drivable areas (6); stop zones (7); road
lines (9). Walkways, speed bumps and the outlines of intersections are not read.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from replan.core.arrays import FloatArray
from replan.core.arrow_tables import COPY_AGAIN, array_of, ipc_table, metadata_of, reading, whole
from replan.core.errors import LogError
from replan.logs.maps.strips import LARGEST_M

LANE, LANE_GROUP, INTERSECTION = 0, 1, 2
CROSSWALK, CAR_PARK, DRIVABLE = 3, 5, 6
STOP_ZONE, ROAD_LINE = 7, 9
REACH_M = 300.0  # Lanes up to this distance around the requested places are read, m


class MapObject(NamedTuple):
    """A row of a map: its id, its properties by name, and its shape as EWKB."""

    id: int
    features: Mapping[Any, Any]
    geometry: bytes

    def is_near(self, name: str, places: FloatArray | None) -> bool:
        """Return whether a line or outline of the object, if it has it, comes near places
        (`is_near`).
        """
        points = self.features.get(name)
        return points is None or is_near(array_of(points)[:, :2], places)

    def ring(self, origin: FloatArray) -> FloatArray:
        """Return the outline `(k, 2)` without its repeated last point; empty if it is invalid."""
        ring = array_of(self.features["outline"])[:, :2]
        if len(ring) < 4 or not (np.abs(ring) < LARGEST_M).all():
            return np.empty((0, 2))
        return np.asarray((ring[:-1] if (ring[0] == ring[-1]).all() else ring) - origin)

    def id_in(self, name: str) -> int | None:
        """Return the id of another object in a property."""
        value = self.features.get(name)
        return value if _is_id(value) else None

    def ids_in(self, name: str) -> list[int]:
        """Return the ids of other objects in a property."""
        return [value for value in self.features.get(name) or () if _is_id(value)]


def _is_id(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def is_near(line: FloatArray, places: FloatArray | None) -> bool:
    """Return whether a line `(n, 2)` comes within `REACH_M` of the bounding box of places `(k, 2)`;
    None: all do.
    """
    if places is None:
        return True
    low, high = places.min(axis=0) - REACH_M, places.max(axis=0) + REACH_M
    return bool((line.max(axis=0) >= low).all() and (line.min(axis=0) <= high).all())


@dataclass(frozen=True, eq=False)
class MapObjects:
    """The rows of a map by layer, and its metadata."""

    layers: Mapping[int, Sequence[MapObject]]
    about: Mapping[Any, Any] = field(default_factory=dict)

    def of(self, layer: int) -> Sequence[MapObject]:
        """Return the objects of a layer."""
        return self.layers.get(layer, ())

    def text(self, name: str) -> str:
        """Return an entry of the metadata as text; "" if it is not there."""
        return str(self.about.get(name) or "")

    def rings(
        self, layer: int, places: FloatArray | None, origin: FloatArray
    ) -> list[tuple[int, FloatArray]]:
        """Return id and outline of the valid objects of a layer near places."""
        near = [item for item in self.of(layer) if item.is_near("outline", places)]
        rings = [(item.id, item.ring(origin)) for item in near]
        return [(number, ring) for number, ring in rings if len(ring) >= 3]


def read_objects(path: Path) -> MapObjects:
    """Read all rows of a map file; LogError if it is not a map."""
    table = ipc_table(path, ("object_id", "map_layer", "features", "wkb"))
    with reading(path):
        layers: dict[int, list[MapObject]] = {}
        rows = zip(
            whole(table, "object_id").tolist(),
            whole(table, "map_layer").tolist(),
            table["features"].to_pylist(),
            table["wkb"].to_pylist(),
            strict=True,
        )
        for number, layer, features, geometry in rows:
            properties = msgspec.msgpack.decode(features)
            if not isinstance(properties, dict):
                raise LogError(
                    f"object {number} of layer {layer} has no features", remedy=COPY_AGAIN
                )
            layers.setdefault(layer, []).append(MapObject(number, properties, geometry))
        for layer, members in layers.items():
            if len({member.id for member in members}) < len(members):
                raise LogError(f"two objects of layer {layer} have the same id", remedy=COPY_AGAIN)
        return MapObjects(layers, metadata_of(table))
