"""Reads Lanelet2 maps: makes a road from lanelets (`lanelet2_lanes`) and regulatory elements.

Source of stop lines, crosswalks and right of way: Lanelet2, "RegulatoryElementTagging.md";
autoware_lanelet2_extension, "extra_regulatory_elements.md".

A stop line (role ref_line; without one: at the lanelet's end) lies across the lanelet that names
the element. If it is at that lanelet's begin, as in junctions of Autoware's maps, it lies across
the preceding lanelets and applies to the way into this one. An element that no lanelet names
belongs to the lanelets whose centre line its line crosses in the second half. The light of a stop
line has the id of the regulatory element, as in Autoware's messages; other ids that logs may use
(its ways, `traffic_light_id`) are its aliases.

Drivable ground beside the lanelets: areas (multipolygons) of the subtypes parking and freespace
without holes, and Autoware's parking lots and intersection areas. A lanelet that names an
intersection area is in an intersection.

A lanelet that yields waits for the lanelets with right of way that it meets; if the element names
lanelets before the junction, the rule applies to their successors.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, product
from pathlib import Path

import numpy as np

from replan.core.arrays import FloatArray, foot_on, station_on
from replan.core.errors import LogError, in_file, reading
from replan.logs.maps.base import MapFile, MapReader
from replan.logs.maps.lanelet2_file import PROJECTOR_INFO, Element, Osm, placed_points, read_osm
from replan.logs.maps.lanelet2_lanes import (
    LONGEST_M,
    DirectedLanelet,
    divided,
    lanes_of,
    strips_of,
    way_points,
)
from replan.logs.maps.strips import CAR_WIDTH_M
from replan.logs.road import Lane, Road, predecessors
from replan.logs.rules import Crosswalk, StopLine

AT_BEGIN_M = 1.5
"""A stop line nearer to a lane's begin lies across the preceding lanes, m."""
SPACING_M = 0.5
ASIDE_M = 1.0
"""For lines that no lanelet names, lines (on each side) and lanes (at the end) are extended by
this, m.
"""
_STOP = ("stop", "stop_sign", "de206", "206", "usR1-1", "R1-1")
_YIELD = ("yield", "give_way", "de205", "205", "usR1-2", "R1-2")
_GROUND, _AREAS = ("parking_lot", "intersection_area"), ("parking", "freespace")
_READ = (
    "traffic_light",
    "traffic_sign",
    "right_of_way",
    "all_way_stop",
    "speed_limit",
    "crosswalk",
    "road_marking",
)


def read_lanelet2(path: Path, settings: Mapping[str, str]) -> MapFile:
    """Read a map; LogError if it is none, has no drivable lane, or its points have no
    coordinates.
    """
    osm, notes = read_osm(path), list[str]()
    with in_file(path), reading((ValueError, OverflowError)):
        nodes, frame, xy = placed_points(osm, path, settings)
        rows = {node.id: k for k, node in enumerate(nodes)}
        strips = strips_of(osm, rows, xy, notes)
        xyz = np.column_stack([xy, [_height(node) for node in nodes]])
        lanes = lanes_of(osm, strips, xyz, notes)
        if not any(lane.drivable for lane in lanes.values()):
            raise LogError(
                "no lanelet on which a car may drive",
                remedy="give a map of lanelets with subtype road",
            )
        rules = rules_of(osm, strips, lanes, rows, xy, notes)
        areas = {
            i: _outline(osm, relation, rows)
            for i, relation in osm.relations.items()
            if relation.tags.get("type") == "multipolygon"
            and relation.tags.get("subtype") in _AREAS
        }
        ground: dict[str, list[FloatArray]] = {word: [] for word in (*_GROUND, *_AREAS)}
        shapes = ((way.tags.get("type"), way_points(way, rows)) for way in osm.ways.values())
        outlines = ((osm.relations[i].tags["subtype"], line) for i, line in areas.items())
        for word, line in chain(shapes, outlines):
            ring = line[:-1] if len(line) > 1 and line[0] == line[-1] else line
            if word in ground and len(ring) > 2:
                ground[word].append(xy[list(ring)])
        # traffic drives on the right if more lanes have the opposite direction on their left
        votes = [
            lane.left_opposite
            for lane in lanes.values()
            if lane.left_opposite != lane.right_opposite
        ]
        road = Road(
            {i: replace(lane, yields_to=rules.yields.get(i, ())) for i, lane in lanes.items()},
            drives_on_right=sum(votes) * 2 >= len(votes),
            stop_lines=rules.stop_lines,
            crosswalks=rules.crosswalks,
            areas=(*ground["intersection_area"], *ground["freespace"]),
            car_parks=(*ground["parking_lot"], *ground["parking"]),
            intersections=tuple(ground["intersection_area"]),
        )
        for key, count in sorted(osm.blanks.items()):
            notes.append(f"{count} tags have blanks around the key '{key}': it is read without.")
        drawn = sum(1 for relation in osm.relations.values() for _ in relation.named("centerline"))
        if drawn:
            notes.append(
                f"{drawn} drawn centre lines are not read: the middle between the boundaries "
                "counts."
            )
        unread = (relation for name, relation in osm.relations.items() if not areas.get(name))
        others = Counter(relation.tags.get("type", "without type") for relation in unread)
        for kind in ("lanelet", "regulatory_element"):
            del others[kind]
        if others:
            listed = ", ".join(f"{count} {kind}" for kind, count in sorted(others.items()))
            notes.append(f"Relations that are not read: {listed}.")
        points = {s.id: xyz[[*s.left.points, *s.right.points]] for s in strips if s.id in lanes}
        return MapFile(road, frame, tuple(notes), rules.aliases, points, bool(votes))


def _outline(osm: Osm, area: Element, rows: Mapping[int, int]) -> Sequence[int]:
    """Return the closed outline of a multipolygon.

    Empty if it has a hole, or its ways do not join.
    """
    ways = [list(way_points(osm.ways[ref], rows)) for ref in area.named("outer") if ref in osm.ways]
    if not ways or not all(ways) or any(True for _ in area.named("inner")):
        return ()
    ring = ways[0] if len(ways) < 2 or ways[0][-1] in (ways[1][0], ways[1][-1]) else ways[0][::-1]
    for way in ways[1:]:
        if ring[-1] not in (way[0], way[-1]):
            return ()
        ring = ring + (way if way[0] == ring[-1] else way[::-1])[1:]
    return ring if len(ring) > 3 and ring[0] == ring[-1] else ()


def _height(node: Element) -> float:
    """Return a point's height, m; 0 if it has none."""
    try:
        height = float(node.tags.get("ele", "0"))
    except ValueError:
        return 0.0
    return height if abs(height) < 1e5 else 0.0


@dataclass(frozen=True, eq=False)
class Rules:
    """The rules of the regulatory elements; `yields` has the lanes with right of way by the
    yielding lane.
    """

    stop_lines: tuple[StopLine, ...]
    crosswalks: tuple[Crosswalk, ...]
    yields: Mapping[int, tuple[int, ...]]
    aliases: Mapping[int, tuple[int, ...]]


@dataclass(frozen=True, eq=False)
class _Map:
    """The map on which the elements are placed; `by_rule`: the lanes that name an element."""

    osm: Osm
    rows: Mapping[int, int]
    xy: FloatArray
    lanes: Mapping[int, Lane]
    before: Mapping[int, Sequence[int]]
    by_rule: Mapping[int, Sequence[int]]

    def line(self, way: int) -> FloatArray | None:
        """Return the points `(n, 2)` of a way; None if it has fewer than two."""
        points = way_points(self.osm.ways[way], self.rows) if way in self.osm.ways else ()
        return self.xy[list(points)] if len(points) > 1 else None

    def tag(self, way: int, key: str) -> str:
        return self.osm.ways[way].tags.get(key, "") if way in self.osm.ways else ""

    def lanelets(self, element: Element, *roles: str) -> list[int]:
        return [ref for ref in element.named(*roles, kind="relation") if ref in self.lanes]


def rules_of(
    osm: Osm,
    strips: Sequence[DirectedLanelet],
    lanes: Mapping[int, Lane],
    rows: Mapping[int, int],
    xy: FloatArray,
    notes: list[str],
) -> Rules:
    """Make the rules of a map; `rows` are the rows of `xy` by node, `xy` the map's points."""
    before, by_rule = predecessors(lanes), defaultdict[int, list[int]](list)
    for strip in strips:
        for rule in strip.rules:
            if strip.id in lanes:
                by_rule[rule].append(strip.id)
    held = _Map(osm, rows, xy, lanes, before, by_rule)
    elements = [
        relation
        for relation in osm.relations.values()
        if relation.tags.get("type") == "regulatory_element"
    ]
    unread = Counter(e.tags.get("subtype", "without subtype") for e in elements)
    for subtype in _READ:
        del unread[subtype]
    stop_lines: list[StopLine] = []
    lost = unnamed = 0
    for element in elements:
        for owners, ways, light, must_stop in _demands(held, element):
            placed = list(_stop_lines_of(held, owners, ways))
            unnamed += not owners
            lost += not placed
            for number, line in enumerate(placed, start=len(stop_lines) + 1):
                stop_lines.append(replace(line, id=number, light=light, must_stop=must_stop))
    if unnamed:
        notes.append(
            f"{unnamed} regulatory elements with a stop line are named by no lanelet: placed by "
            "their lines."
        )
    if lost:
        notes.append(f"{lost} stop lines of regulatory elements lie across no lane: left out.")
    if unread:
        listed = ", ".join(f"{count} {name}" for name, count in sorted(unread.items()))
        notes.append(f"Regulatory elements that are not read: {listed}.")
    by_kind = defaultdict[str, list[Element]](list)
    for element in elements:
        by_kind[element.tags.get("subtype", "")].append(element)
    yields = defaultdict[int, set[int]](set)
    for element in by_kind["right_of_way"]:
        for yielding, first in product(
            held.lanelets(element, "yield"), held.lanelets(element, "right_of_way")
        ):
            if meet(lanes[yielding], lanes[first]):
                yields[yielding].add(first)
                continue
            # What follows on the two
            for lane, other in product(lanes[yielding].successors, lanes[first].successors):
                if (
                    lane != other
                    and lane in lanes
                    and other in lanes
                    and meet(lanes[lane], lanes[other])
                ):
                    yields[lane].add(other)
    aliases = {}
    for element in by_kind["traffic_light"]:
        ways = list(element.named("refers", "ref_line", "light_bulbs"))
        tags = (held.tag(ref, "traffic_light_id")[:18] for ref in ways)
        aliases[element.id] = tuple(
            dict.fromkeys([*ways, *(int(text) for text in tags if text.isdecimal())])
        )
    outlines = {lane.id: lane.polygon for lane in lanes.values() if lane.kind == "crosswalk"}
    # The drawn outline of an Autoware crosswalk, if there is one
    for element in by_kind["crosswalk"]:
        drawn = [
            points
            for ref in element.named("crosswalk_polygon")
            if (points := held.line(ref)) is not None
        ]
        refers = [lane for lane in held.lanelets(element, "refers") if lane in outlines]
        if len(drawn) == 1 and len(drawn[0]) > 2 and len(refers) == 1:
            outlines[refers[0]] = drawn[0]
    crosswalks = tuple(Crosswalk(name, outline) for name, outline in outlines.items())
    waiting = {lane: tuple(sorted(others)) for lane, others in yields.items()}
    return Rules(tuple(stop_lines), crosswalks, waiting, aliases)


def _demands(
    held: _Map, element: Element
) -> Iterator[tuple[Sequence[int], list[int], int | None, bool]]:
    """Yield the demands of an element: the lanes that name it, its stop lines, its light, whether
    all must stop.
    """
    subtype, lines = element.tags.get("subtype"), list(element.named("ref_line"))
    owners = held.by_rule.get(element.id, ())
    if subtype == "traffic_light":
        yield owners, lines, element.id, False
    elif subtype == "traffic_sign":
        kinds = {element.tags.get("sign_type", "")}
        kinds |= {held.tag(ref, "subtype") for ref in element.named("refers")}
        if kinds & {*_STOP, *_YIELD}:
            yield owners, lines, None, bool(kinds & {*_STOP})
    elif subtype == "right_of_way" and lines:
        yield held.lanelets(element, "yield"), lines, None, False
    elif subtype == "all_way_stop":
        yield held.lanelets(element, "yield") or owners, lines, None, True
    elif subtype == "crosswalk" and lines and owners:
        yield owners, lines, None, False
    elif subtype == "road_marking":
        marks = [ref for ref in element.named("refers") if held.tag(ref, "type") == "stop_line"]
        if marks and owners:
            yield owners, marks, None, True


def _stop_lines_of(held: _Map, owners: Sequence[int], ways: Sequence[int]) -> Iterator[StopLine]:
    """Yield the stop lines of an element, without light and sign."""
    lines = [line[[0, -1]] for line in map(held.line, ways) if line is not None]
    if not lines:
        for owner in owners:
            yield StopLine(
                0, owner, np.array([held.lanes[owner].left[-1], held.lanes[owner].right[-1]])
            )
        return
    # Without owners: drivable lanes whose centre line a line crosses in the second half
    crossed = []
    for line, lane in product(lines, () if owners else held.lanes.values()):
        along = (line[1] - line[0]) / max(float(np.hypot(*(line[1] - line[0]))), 1e-9) * ASIDE_M
        ahead = lane.center[-1] - lane.center[max(0, len(lane.center) - 4)]
        beyond = lane.center[-1] + ahead / max(float(np.hypot(*ahead)), 1e-9) * ASIDE_M
        half = np.vstack([lane.center[(len(lane.center) - 1) // 2 :], beyond])
        if lane.drivable and len(crossings(line[0] - along, line[1] + along, half)):
            crossed.append(lane.id)
    towards: defaultdict[tuple[int, int], list[int]] = defaultdict(list)
    for owner in owners or crossed:
        center, middles = held.lanes[owner].center, [line.mean(axis=0) for line in lines]
        k = int(np.argmin([np.hypot(*(foot_on(center, middle)[1] - middle)) for middle in middles]))
        begins = station_on(center, middles[k]) < AT_BEGIN_M
        for on in (held.before.get(owner, ()) if begins else ()) or (owner,):
            towards[k, on] += [owner] if on != owner and owners else []
    for (k, on), after in towards.items():
        yield StopLine(0, on, clipped(held.lanes[on], lines[k]), towards=tuple(sorted(set(after))))


def clipped(lane: Lane, line: FloatArray) -> FloatArray:
    """Return the part `(2, 2)` of a line between a lane's boundaries.

    The whole line if it does not cross both.
    """
    first, last = line
    cuts = [crossings(first, last, bound) for bound in (lane.left, lane.right)]
    if not len(cuts[0]) or not len(cuts[1]) or abs(cuts[0][0] - cuts[1][0]) < 1e-9:
        return line
    ends = sorted((float(cuts[0][0]), float(cuts[1][0])))
    return np.array([first + u * (last - first) for u in ends])


def crossings(first: FloatArray, last: FloatArray, line: FloatArray) -> FloatArray:
    """Return where the segment between two points crosses a polyline `(n, 2)`, as parts of the
    segment, 0 to 1.
    """
    along, piece, gap = last - first, np.diff(line, axis=0), line[:-1] - first
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = along[0] * piece[:, 1] - along[1] * piece[:, 0]
        u = (gap[:, 0] * piece[:, 1] - gap[:, 1] * piece[:, 0]) / turn
        w = (gap[:, 0] * along[1] - gap[:, 1] * along[0]) / turn
        return u[(np.minimum(u, w) >= -1e-9) & (np.maximum(u, w) <= 1.0 + 1e-9)]


def meet(one: Lane, other: Lane) -> bool:
    """Return whether cars on the centre lines of two lanes would touch somewhere."""
    from scipy.spatial import cKDTree  # here: it takes long to load

    lines = (divided(lane.center, SPACING_M, LONGEST_M / SPACING_M) for lane in (one, other))
    away = np.asarray(cKDTree(next(lines)).query(next(lines))[0])
    return bool(away.min() < CAR_WIDTH_M)


READER = MapReader(
    "Lanelet2", "*.osm", ".osm", read_lanelet2, beside=(PROJECTOR_INFO,), settings=("map_origin",)
)
