"""Reads the road of a 123D map (map.arrow)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.arrow_tables import array_of, reading
from replan.core.errors import LogError
from replan.logs.maps.arrow123d_marks import Side, marks_of
from replan.logs.maps.arrow123d_objects import (
    CAR_PARK,
    CROSSWALK,
    DRIVABLE,
    INTERSECTION,
    LANE,
    LANE_GROUP,
    REACH_M,
    STOP_ZONE,
    MapObject,
    MapObjects,
    read_objects,
)
from replan.logs.maps.arrow123d_stop_lines import stop_lines
from replan.logs.maps.base import MapFile, MapReader
from replan.logs.maps.strips import LaneStrip, lanes_of
from replan.logs.road import IN_JUNCTION, NO_LINE, Road
from replan.logs.rules import Crosswalk

LANE_TYPES = ("undefined", "freeway", "surface_street", "bike_lane", "bus_lane")
"""Types of lanes; the index is their number."""
NOT_DRIVABLE = ("bike_lane", "bus_lane")
# First version with correct predecessors and successors of nuPlan's lanes inside junctions
CONNECTORS_RIGHT = (0, 5)
KEEPS_LEFT = ("sg-", "singapore")
"""How the names of places begin where traffic drives on the left."""


def road_of_map(
    path: Path,
    origin: tuple[float, float] = (0.0, 0.0),
    near: FloatArray | None = None,
    notes: list[str] | None = None,
    route: Sequence[int] = (),
) -> Road:
    """Read the road of a map file, `origin` subtracted from all points, m; with notes.

    Objects farther than `REACH_M` outside the bounding box of the places `near` `(k, 2)`, in the
    map's coordinates, are left out. `route` are the ids of the groups of lanes that the log's route
    leads through.

    Raises:
        LogError: The file is no such map, or has no lanes that can be used.
    """
    notes = notes if notes is not None else []
    objects, zero = read_objects(path), np.asarray(origin, dtype=np.float64)
    every = objects.of(LANE)
    if not every:
        raise LogError("the map has no lanes", topic=path.name, remedy="choose another map")
    with reading(path):
        members = [lane for lane in every if lane.is_near("left_boundary", near)]
        if len(members) < len(every):
            notes.append(
                f"Of the map's {len(every)} lanes those within {REACH_M:.0f} m are "
                f"read: {len(members)}."
            )
        marks = marks_of(objects, members, near, notes)
        strips = _strips(objects, members, marks, zero, notes)
        lanes, keeps_right = lanes_of(strips, notes)
        if not lanes:
            raise LogError(
                "the map has no lanes here that can be used", remedy="choose another map"
            )
        if objects.text("location").lower().startswith(KEEPS_LEFT):
            keeps_right = False
            notes.append("Traffic drives on the left in Singapore.")
        walks = [Crosswalk(*walk) for walk in objects.rings(CROSSWALK, near, zero)]
        areas, car_parks, intersections = (
            tuple(ring for _, ring in objects.rings(layer, near, zero))
            for layer in (DRIVABLE, CAR_PARK, INTERSECTION)
        )
        zones = [zone for zone in objects.of(STOP_ZONE) if zone.is_near("outline", near)]
        lines = stop_lines([(zone, zone.ring(zero)) for zone in zones], lanes, notes)
        if any(len(lane.successors) > 1 for lane in lanes.values()):
            notes.append("The map has no right of way: priority where lanes meet is not known.")
        return Road(
            lanes,
            drives_on_right=keeps_right,
            stop_lines=lines,
            crosswalks=tuple(walks),
            areas=areas,
            car_parks=car_parks,
            intersections=intersections,
            route=tuple(
                lane.id
                for group in route
                for lane in members
                if lane.id in lanes and lane.features.get("lane_group_id") == group
            ),
        )


def _strips(
    objects: MapObjects,
    members: Sequence[MapObject],
    marks: Mapping[Side, str],
    origin: FloatArray,
    notes: list[str],
) -> list[LaneStrip]:
    """Return the lanes as the map has them."""
    version = tuple(int(n) for n in objects.text("version").split(".")[:2] if n.isdigit())
    is_nuplan = objects.text("dataset").startswith("nuplan")
    swapped = is_nuplan and () < version < CONNECTORS_RIGHT
    if swapped:
        notes.append(
            "Lanes inside crossings have predecessors and successors swapped before py123d "
            "0.5.0: put right."
        )
    crossing = {
        group.id for group in objects.of(LANE_GROUP) if group.id_in("intersection_id") is not None
    }
    strips = []
    for lane in members:
        number, limit = lane.features.get("lane_type"), lane.features.get("speed_limit_mps")
        kind = LANE_TYPES[0]
        if isinstance(number, int) and 0 <= number < len(LANE_TYPES):
            kind = LANE_TYPES[number]
        onward = lane.ids_in("predecessor_ids" if swapped and number == 0 else "successor_ids")
        in_junction = lane.features.get("lane_group_id") in crossing
        left, right = (
            array_of(lane.features[f"{side}_boundary"])[:, :2] - origin
            for side in ("left", "right")
        )
        strips.append(
            LaneStrip(
                lane.id,
                left,
                right,
                successors=tuple(dict.fromkeys(onward)),
                beside=(lane.id_in("left_lane_id"), lane.id_in("right_lane_id")),
                kind=f"{kind}+{IN_JUNCTION}" if in_junction else kind,
                marks=(marks.get((lane.id, "left"), ""), marks.get((lane.id, "right"), "")),
                drivable=kind not in NOT_DRIVABLE,
                speed_limit=float(limit) if isinstance(limit, int | float) else float("nan"),
                group=lane.id_in("lane_group_id"),
                line=_line(lane, origin),
            )
        )
    return strips


def _line(lane: MapObject, origin: FloatArray) -> FloatArray:
    """Return the centre line of a lane, if the map has a valid one."""
    if lane.features.get("centerline") is None:
        return NO_LINE
    points = array_of(lane.features["centerline"])[:, :2] - origin
    return points if np.isfinite(points).all() else NO_LINE


def _read(path: Path, settings: Mapping[str, str]) -> MapFile:
    notes: list[str] = []
    return MapFile(road_of_map(path, notes=notes), "as in the 123D map", tuple(notes))


READER = MapReader("123D", "*.arrow", ".arrow", _read, begin=b"ARROW1")
