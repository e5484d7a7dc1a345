"""Lanelet2 maps (.osm): where their points are, and the road that they make (`lanelet2_lanes`).

Plane coordinates, the first of these that the map and the settings give:

(1) `[log] map_origin`: latitudes and longitudes projected as it says (`logs.maps.projections`);
(2) `local_x` and `local_y` on every point, as Autoware's maps have them;
(3) `map_projector_info.yaml` beside the map, as Autoware has it;
(4) within `NEAR_NULL_DEG` of latitude 0, longitude 0, as the towns of CARLA are: transverse Mercator about that place;
(5) else the MGRS square of the first point, Autoware's default.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from logs.errors import LogError
from logs.kernel import FloatArray
from logs.maps.base import MapFile, MapReader
from logs.maps.lanelet2_lanes import lanes_of, rules_of, strips_of
from logs.maps.osm import Element, Osm, read_osm, real
from logs.maps.projections import UTM_SCALE, Projection, on_earth, projection_named
from logs.road import Road

PROJECTOR_INFO = "map_projector_info.yaml"
NEAR_NULL_DEG = 0.1
LARGEST_M = 1e9
_AUTOWARE = {"LocalCartesianUTM": "utm", "TransverseMercator": "tmerc", "LocalCartesian": "enu"}
_LOCAL = ("local_x", "local_y")


def read_lanelet2(path: Path, settings: Mapping[str, str]) -> MapFile:
    """Read a map.

    Raises:
        LogError: It is no such map, has no lane, or its points have no place.
    """
    osm, notes = read_osm(path), list[str]()
    try:
        nodes, frame, xy = _placed(osm, path, settings)
        rows = {node.id: k for k, node in enumerate(nodes)}
        strips = strips_of(osm, rows, xy, notes)
        lanes = lanes_of(osm, strips, np.column_stack([xy, [_height(node) for node in nodes]]), notes)
        if not any(lane.drivable for lane in lanes.values()):
            raise LogError("no lanelet on which a car may drive", remedy="give a map of lanelets with subtype road")
        rules = rules_of(osm, strips, lanes, rows, xy, notes)
        # one drives on the right where more lanes have the opposite direction on their left
        votes = [lane.left_opposite for lane in lanes.values() if lane.left_opposite != lane.right_opposite]
        road = Road(
            {i: replace(lane, yields_to=rules.yields.get(i, ())) for i, lane in lanes.items()},
            drives_on_right=sum(votes) * 2 >= len(votes),
            stop_lines=rules.stop_lines,
            crosswalks=rules.crosswalks,
        )
        return MapFile(road, frame, (*notes, *_left_out(osm)), rules.aliases, bool(votes))
    except LogError as error:
        raise error if error.file is not None else error.at(path) from None
    except (ValueError, OverflowError) as error:
        raise LogError(str(error), file=path) from None


def _placed(osm: Osm, path: Path, settings: Mapping[str, str]) -> tuple[list[Element], str, FloatArray]:
    """The points that boundaries and lines use, how they came about, and where they are `(n, 2)`, m."""
    used = dict.fromkeys(node for way in osm.ways.values() for node in way.nodes if node in osm.nodes)
    nodes = [osm.nodes[node] for node in used]
    if len(nodes) < 4:
        raise LogError("its ways have less than four points", remedy="give a Lanelet2 map")
    local = all(key in node.tags for node in nodes for key in _LOCAL)
    if local and not settings.get("map_origin"):
        texts = ((node.tags[key] for key in _LOCAL) for node in nodes)
        return nodes, "local_x and local_y", np.array([[real(text, "local_x") for text in row] for row in texts])
    places = [node.place for node in nodes if node.place is not None]
    if len(places) < len(nodes):
        raise LogError(
            f"{len(nodes) - len(places)} of {len(nodes)} points have neither local_x and local_y nor lat and lon",
            remedy="give every point its place",
        )
    (lat, lon), info = places[0], path.with_name(PROJECTOR_INFO)
    if settings.get("map_origin"):
        projection, why = projection_named(settings["map_origin"]), "as [log] map_origin says"
    elif info.is_file():
        projection, why = _projector_info(info), f"as {info.name} says"
    elif abs(lat) < NEAR_NULL_DEG and abs(lon) < NEAR_NULL_DEG:
        projection, why = Projection("tmerc", (0.0, 0.0)), "assumed"
    else:
        projection, why = Projection("mgrs"), "assumed: the map does not say"
    xy = projection(np.array([on_earth(*place) for place in places]))
    if not (np.abs(xy) < LARGEST_M).all():
        raise LogError(f"points have no place under {projection}", topic="[log] map_origin", remedy="name its origin")
    return nodes, f"{projection} ({why})", xy


def _projector_info(path: Path) -> Projection:
    """What Autoware's file says; LogError where that cannot be read."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise LogError(f"cannot be read: {error}", file=path) from None
    pairs = (line.split("#")[0].partition(":") for line in lines)
    values = {key.strip(): value.strip(" '\"\t") for key, _, value in pairs}
    kind = values.get("projector_type", "")
    if kind == "MGRS":
        return projection_named(values.get("mgrs_grid", "") or "mgrs")
    if kind not in _AUTOWARE:
        remedy = f"known are MGRS, {', '.join(_AUTOWARE)}; or set [log] map_origin"
        what = f"projector_type is {kind!r}, and the points have no local_x and local_y"
        raise LogError(what, file=path, remedy=remedy)
    place = on_earth(*(real(values.get(key, ""), key) for key in ("latitude", "longitude")))
    scale = real(values.get("scale_factor", str(UTM_SCALE)), "scale_factor")
    return Projection(_AUTOWARE[kind], place, scale=scale)


def _height(node: Element) -> float:
    """A point's height, m; 0 where it has none."""
    try:
        height = float(node.tags.get("ele", "0"))
    except ValueError:
        return 0.0
    return height if abs(height) < 1e5 else 0.0


def _left_out(osm: Osm) -> Iterator[str]:
    """What was put right or left out, one sentence each."""
    for key, count in sorted(osm.blanks.items()):
        yield f"{count} tags have blanks around the key '{key}': it is read without."
    drawn = sum(1 for each in osm.relations.values() for _ in each.named("centerline"))
    if drawn:
        yield f"{drawn} drawn centre lines are not read: the middle between the boundaries counts."
    others = Counter(each.tags.get("type", "without type") for each in osm.relations.values())
    for kind in ("lanelet", "regulatory_element"):
        del others[kind]
    if others:
        listed = ", ".join(f"{count} {kind}" for kind, count in sorted(others.items()))
        yield f"Relations that are not read: {listed}."


def _claims(path: Path) -> bool:
    return path.suffix.lower() == ".osm"


def _files(path: Path) -> tuple[Path, ...]:
    info = path.with_name(PROJECTOR_INFO)
    return (path, info) if info.is_file() else (path,)


READER = MapReader("Lanelet2", "*.osm", _claims, read_lanelet2, _files, ("map_origin",))
