"""Reads the road of a 123D log (map.arrow) and its traffic lights over time.

Layers of a map: lanes (0) with successors, neighbours and speed limits; of their groups (1) whether
they are in an intersection; crosswalks (3); car parks (5) and other drivable areas (6); stop zones
(7); road lines (9). Walkways, speed bumps and the outlines of intersections are not read.

Markings. If the road lines are the boundaries of the lanes themselves, as in Argoverse 2, a
boundary has the type of its line; else the type of the road lines within `MARK_M` of it.

Stop lines. A stop zone names lanes, and lies on them or on their predecessors. The stop line is at
the point where the centre line enters the zone. For a zone at the begin of a lane in a junction, it
lies at the ends of that lane's predecessors, and applies to the way onto the lane. A zone of a
traffic light identifies the light by its lane.

Lights. A light has the id of the lane that it controls. For a light without a stop zone, the stop
line is at the ends of that lane's predecessors.

Route. nuPlan's logs name the groups of lanes (roadblocks) of their route in `custom.scenario`:
`Road.route`.

Maps. The log's own map is preferred to the map of its place in the data root,
`maps/<dataset>/<dataset>_<location>.arrow` in a folder above the log.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from replan.core.arrays import FloatArray, arc_lengths
from replan.core.arrow_tables import (
    COPY_AGAIN,
    Lists,
    array_of,
    ipc_table,
    metadata_of,
    reading,
    whole,
)
from replan.core.errors import LogError
from replan.core.files import beside
from replan.logs.complete import road_along, with_limit
from replan.logs.maps.base import MapFile, MapReader
from replan.logs.maps.strips import LARGEST_M, LONGEST_M, LaneStrip, dense, lanes_of
from replan.logs.polylines import inside
from replan.logs.road import IN_JUNCTION, Lane, Road, predecessors
from replan.logs.rules import Colour, Crosswalk, StopLine, TrafficLight
from replan.logs.states import Trajectory

LANE, LANE_GROUP = 0, 1
CROSSWALK, CAR_PARK, DRIVABLE = 3, 5, 6
STOP_ZONE, ROAD_LINE = 7, 9
LANE_TYPES = ("undefined", "freeway", "surface_street", "bike_lane", "bus_lane")
NOT_DRIVABLE = ("bike_lane", "bus_lane")
MARKS = (
    "NONE",
    "UNKNOWN",
    "DASH_SOLID_YELLOW",
    "DASH_SOLID_WHITE",
    "DASHED_WHITE",
    "DASHED_YELLOW",
    "DOUBLE_SOLID_YELLOW",
    "DOUBLE_SOLID_WHITE",
    "DOUBLE_DASH_YELLOW",
    "DOUBLE_DASH_WHITE",
    "SOLID_YELLOW",
    "SOLID_WHITE",
    "SOLID_DASH_WHITE",
    "SOLID_DASH_YELLOW",
    "SOLID_BLUE",
)
"""Types of road lines; the index is their number."""
ZONE_LIGHT, ZONE_STOP = 1, 2
REACH_M = 300.0
"""Lanes up to this distance around the requested places are read, m."""
MARK_M = 0.35
STEP_M = 0.5
CONNECTORS_RIGHT = (0, 5)
"""First version with correct predecessors and successors of nuPlan's lanes inside junctions."""
KEEPS_LEFT = ("sg-", "singapore")


@dataclass(frozen=True, eq=False)
class MapObjects:
    """The rows of a map by layer (id, features, geometry), and its metadata."""

    layers: Mapping[int, Sequence[tuple[int, dict[Any, Any], bytes]]]
    about: Mapping[Any, Any] = field(default_factory=dict)

    def of(self, layer: int) -> Sequence[tuple[int, dict[Any, Any], bytes]]:
        """Return the objects of a layer."""
        return self.layers.get(layer, ())


def road_of_map(
    path: Path,
    origin: tuple[float, float] = (0.0, 0.0),
    near: FloatArray | None = None,
    notes: list[str] | None = None,
    route: Sequence[int] = (),
) -> Road:
    """Read the road of a map file (module docstring), `origin` subtracted from all points, m; with
    notes.

    Objects farther than `REACH_M` outside the bounding box of the places `near` `(k, 2)`, in the
    map's coordinates, are left out. `route` are the ids of the groups of lanes that the log's route
    leads through.

    Raises:
        LogError: The file is no such map, or has no lanes that can be used.
    """
    notes = notes if notes is not None else []
    objects, zero = read_objects(path), np.asarray(origin, dtype=np.float64)
    if not objects.of(LANE):
        raise LogError("the map has no lanes", topic=path.name, remedy="choose another map")
    with reading(path):
        chosen = [(i, f) for i, f, _ in objects.of(LANE) if _is_near(f.get("left_boundary"), near)]
        if len(chosen) < len(objects.of(LANE)):
            notes.append(
                f"Of the map's {len(objects.of(LANE))} lanes those within {REACH_M:.0f} m are "
                f"read: {len(chosen)}."
            )
        marks = _marks(objects, chosen, near, notes)
        version = tuple(
            int(n) for n in str(objects.about.get("version") or "").split(".")[:2] if n.isdigit()
        )
        swapped = (
            str(objects.about.get("dataset") or "").startswith("nuplan")
            and () < version < CONNECTORS_RIGHT
        )
        if swapped:
            notes.append(
                "Lanes inside crossings have predecessors and successors swapped before py123d "
                "0.5.0: put right."
            )
        crossing = {
            i
            for i, group, _ in objects.of(LANE_GROUP)
            if _id(group.get("intersection_id")) is not None
        }
        strips = []
        for i, f in chosen:
            kind, limit = f.get("lane_type"), f.get("speed_limit_mps")
            word = (
                LANE_TYPES[kind]
                if isinstance(kind, int) and 0 <= kind < len(LANE_TYPES)
                else "undefined"
            )
            onward = f.get("predecessor_ids" if swapped and kind == 0 else "successor_ids")
            left, right = (array_of(f[name])[:, :2] for name in ("left_boundary", "right_boundary"))
            strips.append(
                LaneStrip(
                    i,
                    left - zero,
                    right - zero,
                    successors=tuple(dict.fromkeys(_ids(onward))),
                    beside=(_id(f.get("left_lane_id")), _id(f.get("right_lane_id"))),
                    kind=f"{word}+{IN_JUNCTION}" if f.get("lane_group_id") in crossing else word,
                    marks=(marks.get((i, "left"), ""), marks.get((i, "right"), "")),
                    drivable=word not in NOT_DRIVABLE,
                    speed_limit=float(limit) if isinstance(limit, int | float) else float("nan"),
                )
            )
        lanes, keeps_right = lanes_of(strips, notes)
        if not lanes:
            raise LogError(
                "the map has no lanes here that can be used", remedy="choose another map"
            )
        if str(objects.about.get("location") or "").lower().startswith(KEEPS_LEFT):
            keeps_right = False
            notes.append("Traffic drives on the left in Singapore.")
        outlines = (
            (i, _ring(f, zero))
            for i, f, _ in objects.of(CROSSWALK)
            if _is_near(f.get("outline"), near)
        )
        walks = tuple(Crosswalk(i, ring) for i, ring in outlines if len(ring) >= 3)
        ground = (
            _ring(f, zero)
            for _, f, _ in chain(objects.of(CAR_PARK), objects.of(DRIVABLE))
            if _is_near(f.get("outline"), near)
        )
        areas = tuple(ring for ring in ground if len(ring) >= 3)
        zones = [
            (f, _ring(f, zero))
            for _, f, _ in objects.of(STOP_ZONE)
            if _is_near(f.get("outline"), near)
        ]
        lines = stop_lines(zones, lanes, notes)
        if any(len(lane.successors) > 1 for lane in lanes.values()):
            notes.append("The map has no right of way: priority where lanes meet is not known.")
        grouped = [(f.get("lane_group_id"), i) for i, f in chosen if i in lanes]
        lanes_of_groups: dict[Any, list[int]] = {}
        for group, i in grouped:
            lanes_of_groups.setdefault(group, []).append(i)
        route_lanes = tuple(i for group in route for i in lanes_of_groups.get(group, ()))
        return Road(
            lanes,
            drives_on_right=keeps_right,
            stop_lines=lines,
            crosswalks=walks,
            areas=areas,
            route=route_lanes,
        )


def read_objects(path: Path) -> MapObjects:
    """Read all rows of a map file; LogError if it is not a map."""
    table = ipc_table(path, ("object_id", "map_layer", "features", "wkb"))
    with reading(path):
        layers: dict[int, list[tuple[int, dict[Any, Any], bytes]]] = {}
        columns = table["features"].to_pylist(), table["wkb"].to_pylist()
        rows = zip(
            whole(table, "object_id").tolist(),
            whole(table, "map_layer").tolist(),
            *columns,
            strict=True,
        )
        for i, layer, features, geometry in rows:
            properties = msgspec.msgpack.decode(features)
            if not isinstance(properties, dict):
                raise LogError(f"object {i} of layer {layer} has no features", remedy=COPY_AGAIN)
            layers.setdefault(layer, []).append((i, properties, geometry))
        for layer, members in layers.items():
            if len({i for i, _, _ in members}) < len(members):
                raise LogError(f"two objects of layer {layer} have the same id", remedy=COPY_AGAIN)
        return MapObjects(layers, metadata_of(table))


def _is_near(points: Any, near: FloatArray | None) -> bool:
    """Return whether a line or outline comes within `REACH_M` of the bounding box of places."""
    if near is None or points is None:
        return True
    line, near = array_of(points)[:, :2], np.asarray(near)
    low, high = near.min(axis=0) - REACH_M, near.max(axis=0) + REACH_M
    return bool((line.max(axis=0) >= low).all() and (line.min(axis=0) <= high).all())


def _id(value: Any) -> int | None:
    return value if isinstance(value, int) and not isinstance(value, bool) else None


def _ids(values: Any) -> list[int]:
    return [i for i in values or () if _id(i) is not None]


def _ring(f: Mapping[str, Any], origin: FloatArray) -> FloatArray:
    """Return an outline `(k, 2)` without its repeated last point; empty if it is invalid."""
    ring = array_of(f["outline"])[:, :2]
    if len(ring) < 4 or not (np.abs(ring) < LARGEST_M).all():
        return np.empty((0, 2))
    return np.asarray((ring[:-1] if (ring[0] == ring[-1]).all() else ring) - origin)


# Markings


def line_of_wkb(geometry: bytes) -> FloatArray:
    """Return the points `(n, 2)` of a little-endian EWKB line, 2D or 3D."""
    kind, count = (int.from_bytes(geometry[offset : offset + 4], "little") for offset in (1, 5))
    if geometry[:1] != b"\x01" or kind not in (2, 0x80000002):
        raise ValueError(f"a road line has the geometry type {kind:#x}")
    size = 2 if kind == 2 else 3
    return np.frombuffer(geometry, "<f8", count * size, offset=9).reshape(count, size)[:, :2].copy()


def _marks(
    objects: MapObjects,
    lanes: Sequence[tuple[int, Mapping[str, Any]]],
    near: FloatArray | None,
    notes: list[str],
) -> dict[Any, str]:
    """Return the marking by (lane, side): that of the boundary's own line, else the commonest along
    most of it.
    """
    lines = [
        (line_of_wkb(g), int(f.get("road_line_type") or 0)) for _, f, g in objects.of(ROAD_LINE)
    ]
    lines = [
        (line, kind)
        for line, kind in lines
        if _is_line(line) and 0 <= kind < len(MARKS) and _is_near(line, near)
    ]
    if not lines:
        notes.append(
            "The map has no road lines: all markings are taken as such that may be crossed."
        )
        return {}
    exact: dict[bytes, int] = {}
    for line, kind in lines:
        key = line.tobytes()
        exact[key] = max(exact.get(key, 0), kind)
    sides = {
        (i, side): np.ascontiguousarray(array_of(f[f"{side}_boundary"])[:, :2])
        for i, f in lanes
        for side in ("left", "right")
    }
    known = {
        key: MARKS[exact[line.tobytes()]] for key, line in sides.items() if line.tobytes() in exact
    }
    if len({sides[key].tobytes() for key in known}) >= 0.5 * len(exact):
        return known
    notes.append(
        f"Lanes have the markings of the map's road lines within {MARK_M} m of their edges."
    )
    from scipy.spatial import cKDTree

    close = [(dense(line, STEP_M), kind) for line, kind in lines]
    tree = cKDTree(np.vstack([line for line, _ in close]))
    kinds = np.concatenate([np.full(len(line), kind) for line, kind in close])
    marks = {}
    for edge, side in sides.items():
        if _is_line(side):
            points = dense(side, STEP_M)
            away, nearest = tree.query(points, distance_upper_bound=MARK_M)
            beside = kinds[np.asarray(nearest)[np.isfinite(away)]]
            if 2 * len(beside) >= len(points):
                marks[edge] = MARKS[Counter(beside.tolist()).most_common(1)[0][0]]
    return marks


def _is_line(points: FloatArray) -> bool:
    if len(points) < 2 or not (np.abs(points) < LARGEST_M).all():
        return False
    return bool(np.hypot(*np.diff(points, axis=0).T).sum() < LONGEST_M)


# Stop lines


def ends_at(lane: Lane, part: float) -> FloatArray:
    """Return the ends `(2, 2)` of a line across a lane at a relative length of 0 to 1."""
    shares = arc_lengths(*lane.center.T) / lane.length
    return np.array(
        [[np.interp(part, shares, side[:, k]) for k in (0, 1)] for side in (lane.left, lane.right)]
    )


def stop_lines(
    zones: Sequence[tuple[Mapping[str, Any], FloatArray]],
    lanes: Mapping[int, Lane],
    notes: list[str],
) -> tuple[StopLine, ...]:
    """Return the stop lines of stop zones (module docstring).

    A zone that lies on none of its lanes is left out.
    """
    feeding, lines, lost = predecessors(lanes), list[StopLine](), 0
    for f, ring in zones:
        named = [lanes[i] for i in _ids(f.get("lane_ids")) if i in lanes]
        # lane, relative length, lanes that it applies to
        placed = list[tuple[int, float, tuple[int, ...]]]()
        for lane in named if len(ring) > 2 else ():
            ahead, part = (
                [lanes[i] for i in feeding.get(lane.id, ())],
                _entry_into_outline(lane, ring),
            )
            if part is not None and (part * lane.length > STEP_M or not ahead):
                placed.append((lane.id, part, ()))
                continue
            for lane_ahead in ahead:
                entry = _entry_into_outline(lane_ahead, ring)
                if entry is not None or part is not None:
                    placed.append((lane_ahead.id, 1.0 if entry is None else entry, (lane.id,)))
        lost += not placed
        kind = f.get("stop_zone_type")
        for across, part, towards in placed:
            lights: list[tuple[int | None, tuple[int, ...]]] = [(None, towards)]
            if kind == ZONE_LIGHT:  # a light has the id of its lane
                lights = [(after, (after,)) for after in towards or lanes[across].successors] or [
                    (across, ())
                ]
            for light, ways in lights:
                ends = ends_at(lanes[across], part)
                lines.append(StopLine(len(lines), across, ends, light, kind == ZONE_STOP, ways))
    if lost:
        notes.append(
            f"{lost} of {len(zones)} stop zones lie on none of the lanes that they name and are "
            "left out."
        )
    joined: dict[Any, StopLine] = {}  # equal lines at the same place are merged
    for line in lines:
        key = (line.lane, line.points.tobytes(), line.light, line.must_stop)
        known = joined.setdefault(
            key, replace(line, id=len(joined), towards=tuple(dict.fromkeys(line.towards)))
        )
        ways = (*known.towards, *line.towards) if known.towards and line.towards else ()
        joined[key] = replace(known, towards=tuple(dict.fromkeys(ways)))
    return tuple(joined.values())


def _entry_into_outline(lane: Lane, ring: FloatArray) -> float | None:
    """Return the relative length at which a lane's centre line enters an outline; None if it does
    not.
    """
    points = dense(lane.center, STEP_M)
    within = [inside(x, y, ring) for x, y in points]
    return within.index(True) / (len(points) - 1) if any(within) else None


LIGHTS, SCENARIO = "traffic_light_detections", "custom.scenario.arrow"
COLOURS = (Colour.GREEN, Colour.YELLOW, Colour.RED, Colour.OFF)
UNKNOWN = 4
UP = 6
"""Number of folders above a log in which the maps of places are searched."""


def map_of(folder: Path, about: Mapping[Any, Any]) -> Path | None:
    """Return the log's own map, else that of its place in the data root above it, or None; LogError
    as in `beside`.
    """
    own = beside(folder, ("map.arrow",))
    if own is not None:
        return own
    dataset, place = str(about.get("dataset") or ""), str(about.get("location") or "")
    if (
        not dataset
        or not place
        or {"/", "\\", "\0"} & set(dataset + place)
        or dataset.startswith(".")
    ):
        return None
    above = [
        parent / "maps" / dataset / f"{dataset}_{place}.arrow"
        for parent in folder.resolve().parents[:UP]
    ]
    return next((path for path in above if path.is_file()), None)


def _route_of(folder: Path) -> tuple[int, ...]:
    """Return the groups of lanes of the route that nuPlan's logs name.

    Empty where there is none.
    """
    path = folder / SCENARIO
    if not path.is_file():
        return ()
    table = ipc_table(path, (f"{path.stem}.data",))
    with reading(path):
        content = (
            msgspec.msgpack.decode(table[f"{path.stem}.data"][0].as_py()) if len(table) else {}
        )
        names = content.get("route_roadblock_ids") if isinstance(content, dict) else None
        return tuple(
            int(name) for name in map(str, names or ()) if name.isdecimal() and len(name) < 19
        )


def road_of(
    folder: Path,
    about: Mapping[Any, Any],
    ego: Trajectory,
    origin: tuple[float, float],
    start_us: int,
    notes: list[str],
) -> tuple[Road, tuple[TrafficLight, ...]]:
    """Read the road and the lights of a log, t = 0 at `start_us`.

    Without lanes, the road is the driven path.
    """
    lights = _observed_lights(folder, start_us, notes)
    path, road = map_of(folder, about), None
    if path is not None:
        try:
            near = np.column_stack([ego.x, ego.y]) + origin
            road = road_of_map(path, origin, near, notes, _route_of(folder))
        except LogError as error:
            if "lanes" not in error.what:
                raise
            notes.append(f"The map beside the log cannot be used: {error.what}.")
    if road is None:
        if lights:
            notes.append(
                f"The log's {len(lights)} traffic lights are left out, as there are no lanes that "
                "they are for."
            )
        return road_along(ego, notes), ()
    lacking = sum(
        lane.drivable and not np.isfinite(lane.speed_limit) for lane in road.lanes.values()
    )
    if lacking:
        road = with_limit(
            road, ego, f"{lacking} of {len(road.lanes)} lanes have no speed limit", notes
        )
    # a light without a stop zone gets a stop line at the ends of its lane's predecessors
    named, feeding = {line.light for line in road.stop_lines}, predecessors(road.lanes)
    lines, lost = list(road.stop_lines), 0
    number = max((line.id for line in lines), default=-1) + 1
    for light in lights:
        if light.id in named or light.id not in road.lanes:
            lost += light.id not in road.lanes
            continue
        own = [line for line in road.stop_lines if line.lane == light.id]
        places: list[tuple[int, FloatArray, tuple[int, ...]]] = [
            (line.lane, line.points, ()) for line in own[:1]
        ]
        places = places or [
            (i, ends_at(road.lanes[i], 1.0), (light.id,)) for i in feeding.get(light.id, ())
        ]
        places = places or [(light.id, ends_at(road.lanes[light.id], 0.0), ())]
        for across, ends, towards in places:
            lines.append(StopLine(number, across, ends, light.id, towards=towards))
            number += 1
    if lost:
        notes.append(
            f"{lost} of {len(lights)} traffic lights are for lanes that are not in the map and are "
            "left out."
        )
    if lights:
        notes.append(
            "A light stands where the lanes end that lead to its lane, or at the stop zone that "
            "lies on them."
        )
    wanted = {line.light for line in lines}
    return replace(road, stop_lines=tuple(lines)), tuple(
        light for light in lights if light.id in wanted
    )


def _observed_lights(folder: Path, start_us: int, notes: list[str]) -> tuple[TrafficLight, ...]:
    """Read the lights of the log; each has the id of the lane that it controls."""
    path = beside(folder, (f"{LIGHTS}.arrow",))
    if path is None:
        return ()
    columns = [f"{LIGHTS}.{name}" for name in ("timestamp_us", "lane_id", "status")]
    table = ipc_table(path, columns)
    with reading(path):
        lists = Lists(table, columns[1])
        lane, status = lists.numbers(columns[1]), lists.numbers(columns[2])
        t = (whole(table, columns[0]) - start_us)[lists.row] / 1e6
        unknown = status >= UNKNOWN
        if unknown.any():
            notes.append(
                f"{unknown.sum()} of {len(status)} observations of traffic lights are of no "
                "colour: taken as off."
            )
        colours = [COLOURS[s] if 0 <= s < len(COLOURS) else Colour.OFF for s in status]
        lights = []
        for i in np.unique(lane):
            rows = np.flatnonzero(lane == i)
            rows = rows[np.unique(t[rows], return_index=True)[1]]
            changes = [
                k for n, k in enumerate(rows) if n == 0 or colours[k] is not colours[rows[n - 1]]
            ]
            lights.append(TrafficLight(int(i), t[changes], tuple(colours[k] for k in changes)))
        return tuple(lights)


def _read(path: Path, settings: Mapping[str, str]) -> MapFile:
    notes: list[str] = []
    return MapFile(road_of_map(path, notes=notes), "as in the 123D map", tuple(notes))


READER = MapReader("123D", "*.arrow", ".arrow", _read, begin=b"ARROW1")
