"""Reads Lanelet2 files (.osm): OpenStreetMap XML as plain records, and the coordinates of their
points.

The file is read as a stream: no tree is built, so that its depth is harmless. A document type
declaration, which such files do not have and in which entities could grow without bound, is refused
before anything in it is expanded.

Plane coordinates, the first of these that the map and the settings give:

(1) `[log] map_origin`: latitudes and longitudes in this projection
    (`replan.logs.maps.projections`);
(2) `local_x` and `local_y` of every point, as in Autoware's maps;
(3) the projection in `map_projector_info.yaml` beside the map, as in Autoware;
(4) within `NEAR_NULL_DEG` of latitude 0, longitude 0, as in CARLA's towns: transverse Mercator
    about that place;
(5) else the MGRS square of the first point, Autoware's default.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.errors import LogError
from replan.core.files import read_xml, refuse_doctype
from replan.logs.maps.projections import UTM_SCALE, Projection, check_on_earth, parse_projection

NEW_ID = 10**12
"""Editors number new elements -1, -2 ....

Such an id i becomes `NEW_ID` - i, as replan's ids are not negative.
"""
PROJECTOR_INFO = "map_projector_info.yaml"
NEAR_NULL_DEG = 0.1
LARGEST_M = 1e9
_AUTOWARE = {"LocalCartesianUTM": "utm", "TransverseMercator": "tmerc", "LocalCartesian": "enu"}
_LOCAL = ("local_x", "local_y")


@dataclass(frozen=True)
class Member:
    """A relation's member: its kind ("way", "relation", "node"), its role, and its id."""

    kind: str
    role: str
    ref: int


@dataclass
class Element:
    """A node, way or relation."""

    id: int  # unique among its kind
    tags: dict[str, str] = field(default_factory=dict)  # values by key, without surrounding blanks
    place: tuple[float, float] | None = None  # latitude and longitude of a node, degrees, or None
    nodes: list[int] = field(default_factory=list)  # node ids of a way
    members: list[Member] = field(default_factory=list)  # members of a relation

    def named(self, *roles: str, kind: str = "way") -> Iterator[int]:
        """Yield the ids of members of a kind in one of these roles, in the file's order."""
        return (
            member.ref for member in self.members if member.kind == kind and member.role in roles
        )


@dataclass
class Osm:
    """The elements of a file by id; `blanks` counts keys with surrounding blanks."""

    nodes: dict[int, Element] = field(default_factory=dict)
    ways: dict[int, Element] = field(default_factory=dict)
    relations: dict[int, Element] = field(default_factory=dict)
    blanks: dict[str, int] = field(default_factory=dict)


class _Target:
    def __init__(self) -> None:
        self.osm = Osm()
        self.open: Element | None = None
        self.root = ""
        self.kinds = {"node": self.osm.nodes, "way": self.osm.ways, "relation": self.osm.relations}

    doctype = refuse_doctype

    def start(self, tag: str, attrib: dict[str, str]) -> None:
        if not self.root:
            self.root = tag
            if tag != "osm":
                raise LogError(f"root element is <{tag}>", remedy="give a Lanelet2 map (<osm>)")
        if tag in self.kinds:
            self.open = Element(whole(attrib.get("id"), f"{tag}@id"))
            if attrib.get("action") == "delete" or attrib.get("visible") == "false":
                return
            if self.open.id in self.kinds[tag]:
                raise LogError(
                    f"two elements <{tag}> have the id {self.open.id}", remedy="number them anew"
                )
            if "lat" in attrib and "lon" in attrib:
                place = f"{tag} {self.open.id}"
                self.open.place = real(attrib["lat"], place), real(attrib["lon"], place)
            self.kinds[tag][self.open.id] = self.open
        elif self.open is None:
            return
        elif tag == "tag":
            key, text = attrib.get("k", ""), attrib.get("v", "").strip()
            if key != key.strip():
                self.osm.blanks[key.strip()] = self.osm.blanks.get(key.strip(), 0) + 1
            self.open.tags[key.strip()] = text
        elif tag == "nd":
            self.open.nodes.append(whole(attrib.get("ref"), "nd@ref"))
        elif tag == "member":
            ref = whole(attrib.get("ref"), "member@ref")
            self.open.members.append(Member(attrib.get("type", ""), attrib.get("role", ""), ref))

    def end(self, tag: str) -> None:
        if tag in self.kinds:
            self.open = None

    def data(self, text: str) -> None:
        pass

    def close(self) -> Osm:
        return self.osm


def read_osm(path: Path) -> Osm:
    """Read a file; LogError if it is no OSM XML (`read_xml`), or a number cannot be parsed."""
    osm: Osm = read_xml(path, target=_Target())
    return osm


def whole(text: str | None, place: str) -> int:
    """Parse an id; LogError if it is not an integer of at most 62 bits."""
    try:
        value = int(text or "")
    except ValueError:
        value = None
    if value is None or abs(value) >= 2**62:
        raise LogError(f"{(text or '')[:40]!r} is no id", topic=place, remedy="correct the element")
    return value if value >= 0 else NEW_ID - value


def real(text: str, place: str) -> float:
    """Parse a number; LogError if it is not a number or cannot be a coordinate."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) < 1e9:
        raise LogError(f"{text[:40]!r} is no coordinate", topic=place, remedy="correct the element")
    return value


def placed_points(
    osm: Osm, path: Path, settings: Mapping[str, str]
) -> tuple[list[Element], str, FloatArray]:
    """Return the points of all ways, the origin of their coordinates in words, and the coordinates
    `(n, 2)`, m.
    """
    used = dict.fromkeys(chain.from_iterable(way.nodes for way in osm.ways.values()))
    nodes = [osm.nodes[node] for node in used if node in osm.nodes]
    if len(nodes) < 4:
        raise LogError("its ways have less than four points", remedy="give a Lanelet2 map")
    local = all(key in node.tags for node in nodes for key in _LOCAL)
    if local and not settings.get("map_origin"):
        texts = ((node.tags[key] for key in _LOCAL) for node in nodes)
        return (
            nodes,
            "local_x and local_y",
            np.array([[real(text, "local_x") for text in row] for row in texts]),
        )
    places = [node.place for node in nodes if node.place is not None]
    if len(places) < len(nodes):
        raise LogError(
            f"{len(nodes) - len(places)} of {len(nodes)} points have neither local_x and local_y "
            "nor lat and lon",
            remedy="give every point its place",
        )
    (lat, lon), info = places[0], path.with_name(PROJECTOR_INFO)
    if settings.get("map_origin"):
        projection, why = parse_projection(settings["map_origin"]), "as [log] map_origin says"
    elif info.is_file():
        projection, why = _projector_info(info), f"as {info.name} says"
    elif abs(lat) < NEAR_NULL_DEG and abs(lon) < NEAR_NULL_DEG:
        projection, why = Projection("tmerc", (0.0, 0.0)), "assumed"
    else:
        projection, why = Projection("mgrs"), "assumed: the map does not say"
    xy = projection(np.array([check_on_earth(*place) for place in places]))
    if not (np.abs(xy) < LARGEST_M).all():
        raise LogError(
            f"points have no place under {projection}",
            topic="[log] map_origin",
            remedy="name its origin",
        )
    return nodes, f"{projection} ({why})", xy


def _projector_info(path: Path) -> Projection:
    """Return the projection in Autoware's file; LogError if it cannot be read."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise LogError(f"cannot be read: {error}", file=path) from None
    pairs = (line.split("#")[0].partition(":") for line in lines)
    values = {key.strip(): value.strip(" '\"\t") for key, _, value in pairs}
    kind = values.get("projector_type", "")
    if kind == "MGRS":
        return parse_projection(values.get("mgrs_grid", "") or "mgrs")
    if kind not in _AUTOWARE:
        remedy = f"known are MGRS, {', '.join(_AUTOWARE)}; or set [log] map_origin"
        problem = f"projector_type is {kind!r}, and the points have no local_x and local_y"
        raise LogError(problem, file=path, remedy=remedy)
    place = check_on_earth(*(real(values.get(key, ""), key) for key in ("latitude", "longitude")))
    scale = real(values.get("scale_factor", str(UTM_SCALE)), "scale_factor")
    return Projection(_AUTOWARE[kind], place, scale=scale)
