"""Argoverse 2's vector map (log_map_archive_*.json) -> Road: lane segments with markings, pedestrian crossings.

The map has no speed limits, stop lines, traffic lights or right of way. Drivable areas have no place in a Road.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from logs.errors import LogError
from logs.kernel import FloatArray
from logs.mcap.complete import ASSUMED, assumed_limit, road_along
from logs.readers.recorded.strips import LARGEST_M, Strip, lanes_of
from logs.readers.recorded.tables import reading
from logs.road import Road
from logs.rules import Crosswalk
from logs.states import Trajectory

KINDS = {"VEHICLE": "surface_street", "BIKE": "bike_lane", "BUS": "bus_lane"}
"""As 123D calls them."""


def map_beside(folder: Path, name: str = "*") -> Path | None:
    """The map of a log, in its folder or the folder `map` in it; None: there is none."""
    found = sorted((*folder.glob(f"map/log_map_archive_{name}.json"), *folder.glob(f"log_map_archive_{name}.json")))
    return found[0] if found else None


def road_for(path: Path | None, origin: FloatArray, ego: Trajectory, notes: list[str]) -> Road:
    """The road in a map, with an assumed speed limit; along the driven path where there is no map."""
    if path is None:
        return road_along(ego, notes)
    road = road_of_json(path, origin, notes)
    limit = assumed_limit(ego)
    notes.append(f"The lanes have no speed limits: {limit:.1f} m/s is assumed ({ASSUMED}).")
    return replace(road, default_speed_limit=limit)


def road_of_json(path: Path, origin: FloatArray, notes: list[str]) -> Road:
    """The road in a map file, relative to `origin` `(2,)`; LogError where it is no such map or has no lanes."""
    with reading(path):
        found = msgspec.json.decode(path.read_bytes())
        lanes, keeps_right = lanes_of([_strip(each, origin) for each in found["lane_segments"].values()], notes)
        if not lanes:
            raise LogError("the map has no lanes that can be used")
        walks = [_crosswalk(each, origin) for each in found.get("pedestrian_crossings", {}).values()]
        notes.append("The map has no right of way, stop lines or traffic lights: who goes first is not known.")
        return Road(lanes, drives_on_right=keeps_right, crosswalks=tuple(walk for walk in walks if walk is not None))


def _strip(lane: Mapping[str, Any], origin: FloatArray) -> Strip:
    kind = KINDS.get(lane["lane_type"], "undefined")
    return Strip(
        int(lane["id"]),
        _points(lane["left_lane_boundary"]) - origin,
        _points(lane["right_lane_boundary"]) - origin,
        successors=tuple(dict.fromkeys(int(i) for i in lane["successors"])),
        beside=(lane["left_neighbor_id"], lane["right_neighbor_id"]),
        kind=kind,
        marks=(str(lane["left_lane_mark_type"]), str(lane["right_lane_mark_type"])),
        drivable=kind not in ("bike_lane", "bus_lane"),
    )


def _points(points: list[Mapping[str, float]]) -> FloatArray:
    return np.array([(p["x"], p["y"]) for p in points], dtype=np.float64).reshape(-1, 2)


def _crosswalk(walk: Mapping[str, Any], origin: FloatArray) -> Crosswalk | None:
    """The ground between the two edges; None where they are no edges."""
    one, other = (_points(walk[name]) - origin for name in ("edge1", "edge2"))
    if min(len(one), len(other)) < 2 or not (np.abs(np.vstack([one, other])) < LARGEST_M).all():
        return None
    if (other[-1] - other[0]) @ (one[-1] - one[0]) > 0.0:
        other = other[::-1]
    return Crosswalk(int(walk["id"]), np.vstack([one, other]))
