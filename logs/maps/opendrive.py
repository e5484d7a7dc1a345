"""OpenDRIVE maps (.xodr), their geometry evaluated by pyxodr (extra `opendrive`): lanes, links,
markings, limits.

Source: ASAM OpenDRIVE 1.8, chapters 9 to 11. Each lane of a lane section becomes one lane. If
traffic keeps right, lanes with negative ids run along the reference line and the others against it;
if it keeps left, the reverse. The lanes of a junction's roads are in an intersection. Signals,
objects and junction priorities are not read.

Roads are read one by one; one that cannot be read is left out and named. Before, each is brought
into the form that pyxodr knows (`_normalise`). In particular, with the length L of a geometry,

(1) a spiral is an arc of its mean curvature if |curvEnd - curvStart| L^2 / 12 < SLIGHT_M, and
(2) an arc is a line if |curvature| L^2 / 2 < SLIGHT_M:
        the largest distances between the two curves.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite, nan
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from replan.core.errors import LogError
from replan.core.files import read_xml
from replan.logs.maps.base import MapFile, MapReader
from replan.logs.road import IN_JUNCTION, Lane, Road

RESOLUTION_M = 0.1
"""Step of pyxodr along the reference line, m.

Its lanes end within a few cm of the begin of the next ones.
"""
PER_SECTION, STEP_RAD, MOST_POINTS = 3, 0.06, 100_000
"""The step is shorter where a section has fewer points or a step turns by more, down to this many
points of a road.
"""
SLIGHT_M = 1e-5
"""A curve that is nearer to a simpler one is read as that one, m: pyxodr divides by what makes the
difference.
"""
NAMED = 5
"""Roads or lanes that a note names; the others are counted."""
KEPT = 5
"""Every fifth point of pyxodr's lines is kept."""
NARROWEST_M = 0.1
"""A lane section's lane that is nowhere wider has no area and is left out, m."""
LARGEST_BYTES, LONGEST_M = 268_435_456, 1e6
FARTHEST = 100.0
"""Largest reach of a polynomial over its length: pyxodr steps along it by `RESOLUTION_M`."""
_DRIVABLE = {
    "driving",
    "entry",
    "exit",
    "onRamp",
    "offRamp",
    "connectingRamp",
    "slipLane",
    "bidirectional",
}
_SHAPES = ("line", "arc", "spiral", "poly3", "paramPoly3")
_CROSSABLE = {"none", "broken", "broken broken", "botts dots"}
_LEFT_OUT = {
    "signal": "signals and signs",
    "object": "objects",
    "priority": "priorities of junctions",
}
_UNITS = {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704}


@dataclass(frozen=True, eq=False)
class _Piece:
    """A lane of a lane section: pyxodr's lane, and the road's and section's XML."""

    number: int
    lane: Any
    road: Element
    section: Element
    index: int  # place of the section in its road, from 0
    place: int  # its OpenDRIVE id: counted outwards, negative on the right of the reference line
    on_right: bool  # whether traffic keeps right on this road
    against: bool  # whether its traffic drives against the reference line
    drivable: bool  # whether cars may drive on it


def read_opendrive(path: Path, settings: Mapping[str, str]) -> MapFile:
    """Read a map; LogError without pyxodr, or if the file is no OpenDRIVE or has no drivable
    lane.
    """
    root = _root(path)
    try:
        from pyxodr.road_objects.road import Road as Geometry
    except ImportError:
        raise LogError(
            "OpenDRIVE needs pyxodr", file=path, remedy="pip install 'replan[opendrive]'"
        ) from None
    left_out = [(tag, sum(1 for _ in root.iter(tag))) for tag in _LEFT_OUT]
    pieces, lines = list[_Piece](), dict[str, Any]()
    unread, lacking = list[str](), list[str]()
    for element in root.findall("road"):
        name = element.get("id", "")
        try:
            if not name or name in lines:
                raise LogError("another road has its id" if name else "it has no id")
            lacks = _normalise(element)
            with np.errstate(all="ignore"):
                geometry = Geometry(element, resolution=_resolution(element))
                pieces += list(_pieces(geometry, len(pieces)))
            lines[name], lacking = geometry.reference_line, lacking + lacks
        except Exception as error:  # the library may raise anything on an unexpected road
            unread.append(f"road {name}: {_fault(element, error, Geometry)}")
            root.remove(element)
    joints, loose = _joints(pieces, root, lines)
    lanes = dict(_lanes(pieces, joints))
    if not any(lane.drivable for lane in lanes.values()):
        why = f"; {_some(unread, 'road cannot be read', 'roads cannot be read')}" if unread else ""
        remedy = "give a map with lanes of type driving"
        raise LogError(f"no lane on which a car may drive{why}", file=path, remedy=remedy)
    sides = Counter(piece.on_right for piece in pieces)
    road = Road(lanes, drives_on_right=sides[True] >= sides[False])
    parts = (
        (unread, "road cannot be read", "roads cannot be read"),
        (lacking, "lane is incomplete", "lanes are incomplete"),
        (loose, "link of lanes leads nowhere", "links of lanes lead nowhere"),
    )
    notes = [f"{_some(*part)}." for part in parts if part[0]]
    notes += [f"{count} {_LEFT_OUT[tag]} are not read." for tag, count in left_out if count]
    if root.find("header/offset") is not None:
        notes.append("The header's offset is not applied.")
    return MapFile(road, "as in the file", tuple(notes))


def _root(path: Path) -> Element:
    root: Element = read_xml(path, "OpenDRIVE", largest=LARGEST_BYTES)
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]  # without the namespace of ASAM's schema
    if root.tag != "OpenDRIVE":
        raise LogError(
            f"root element is <{root.tag}>", file=path, remedy="give an OpenDRIVE map (<OpenDRIVE>)"
        )
    if (
        not sum(max(_number(part, "length", 0.0), 0.0) for part in root.iter("geometry"))
        < LONGEST_M
    ):
        raise LogError("its roads are longer than 1000 km", file=path, remedy="cut the map")
    return root


def _number(element: Element, key: str, default: float = nan) -> float:
    try:
        return float(element.get(key, ""))
    except ValueError:
        return default


def _station(element: Element) -> float:
    return _number(element, "s", _number(element, "sOffset", 0.0))


def _some(found: Sequence[str], one: str, many: str) -> str:
    more = [f"and {len(found) - NAMED} more"] if len(found) > NAMED else []
    return f"{len(found)} {one if len(found) == 1 else many}: {'; '.join([*found[:NAMED], *more])}"


def _normalise(road: Element) -> list[str]:
    """Bring a road into the form that pyxodr reads; returns the lanes that lack what they should
    have, and what.

    Elements are put in the order of s; geometries and lane sections without length go; of a lane's
    width and border, the width counts (chapter 11.6). Heights are left out: they are not needed.

    Raises:
        LogError: It has no lanes or no length, or a geometry is of no known shape or leads far
            away.
    """
    for parent in (road, *road.iter("planView"), *road.iter("lanes"), *road.iter("lane")):
        parent[:] = sorted(parent, key=_station)
    for heights in road.findall("elevationProfile"):
        road.remove(heights)
    for plan in road.findall("planView"):
        for part in plan.findall("geometry"):
            if float(part.get("length", "nan")) == 0.0:
                plan.remove(part)
            else:
                _simplify(part)
    ends = [_station(section) for section in road.findall("lanes/laneSection")[1:]] + [
        _length(road)
    ]
    if not road.findall("lanes/laneSection") or not ends[-1] > 0.0:
        raise LogError(
            "it has no length" if ends[:-1] or road.find("lanes/laneSection") else "it has no lanes"
        )
    least = PER_SECTION * min(RESOLUTION_M, _length(road) / MOST_POINTS)
    for section, end in zip(road.findall("lanes/laneSection"), ends, strict=True):
        if end - _station(section) < least:
            _remove_section(road, section)
    lacking = []
    for lane in (
        lane
        for side in ("left", "right")
        for lane in road.findall(f"lanes/laneSection/{side}/lane")
    ):
        lacks = [key for key in ("type",) if key not in lane.attrib]
        lane.attrib.setdefault("type", "none")
        widths, borders = lane.findall("width"), lane.findall("border")
        for border in borders if widths else ():
            lane.remove(border)
        if not widths and not borders:
            SubElement(lane, "width", dict.fromkeys(("sOffset", *"abcd"), "0"))
            lacks += ["width"] if lane.get("type") in _DRIVABLE else []
        lacking += [f"lane {lane.get('id')} of road {road.get('id')} has no {key}" for key in lacks]
    return lacking


def _simplify(part: Element) -> None:
    """Replace a curve by a simpler one that is as good, (1) and (2); LogError if it is none or
    leads far away.
    """
    length, place = float(part.get("length", "nan")), f"its geometry at s = {part.get('s')}"
    curve = next((child for child in part if child.tag in _SHAPES), None)
    if curve is None:
        raise LogError(f"{place} is none of {', '.join(_SHAPES)}")
    if not length > 0.0:
        raise LogError(f"{place} has the length {length:g} m")
    if curve.tag == "spiral":
        first, last = (float(curve.get(key, "nan")) for key in ("curvStart", "curvEnd"))
        if abs(last - first) * length**2 / 12.0 < SLIGHT_M:  # (1)
            curve.tag, curve.attrib = "arc", {"curvature": repr(0.5 * (first + last))}
    # (2)
    if (
        curve.tag == "arc"
        and abs(float(curve.get("curvature", "nan"))) * length**2 / 2.0 < SLIGHT_M
    ):
        curve.tag, curve.attrib = "line", {}
    if curve.tag in ("poly3", "paramPoly3"):
        whole = curve.tag == "paramPoly3" and curve.get("pRange", "normalized") == "normalized"
        p = 1.0 if whole else length
        keys = (
            (k, key)
            for k, letter in enumerate("abcd")
            for key in (letter, letter + "U", letter + "V")
        )
        # Upper bound at its end, m
        reach = sum(abs(float(curve.get(key, "0"))) * p**k for k, key in keys)
        if not reach <= FARTHEST * length:
            raise LogError(f"{place} leads more than {FARTHEST:.0f} times its length away")


def _remove_section(road: Element, section: Element) -> None:
    """Remove a lane section without length; the links of the sections beside it lead through it."""
    lanes = next(iter(road.findall("lanes")))
    sections = lanes.findall("laneSection")
    k = sections.index(section)
    if k == 0 and len(sections) > 1:
        sections[1].set("s", section.get("s", "0"))
    for beside, tag in (
        (sections[k - 1 : k], "successor"),
        (sections[k + 1 : k + 2], "predecessor"),
    ):
        onward = {lane.get("id"): lane.findall(f"link/{tag}") for lane in section.iter("lane")}
        for link in (link for road in beside for link in road.iter("link")):
            through = [
                next_one
                for element in link.findall(tag)
                for next_one in onward.get(element.get("id"), ())
            ]
            link[:] = [*(element for element in link if element.tag != tag), *through]
    lanes.remove(section)


def _length(road: Element) -> float:
    return sum(float(part.get("length", "nan")) for part in road.findall("planView/geometry"))


def _resolution(road: Element) -> float:
    """Return the step along the reference line, m, that short lane sections and tight curves
    need.
    """
    length = _length(road)
    stations = [*map(_station, road.findall("lanes/laneSection")), length]
    bends = [_number(arc, "curvature") for arc in road.iter("arc")]
    bends += [
        _number(spiral, key) for spiral in road.iter("spiral") for key in ("curvStart", "curvEnd")
    ]
    bend = max(map(abs, bends), default=0.0)
    needed = min(np.diff(stations).min() / PER_SECTION, STEP_RAD / bend if bend else inf)
    return float(min(RESOLUTION_M, max(needed, length / MOST_POINTS)))


def _fault(road: Element, error: Exception, geometry: Callable[..., Any]) -> str:
    """Describe why a road cannot be read.

    The first geometry that cannot be evaluated by itself is named.
    """
    if isinstance(error, LogError):
        return error.what
    for part in road.findall("planView/geometry"):
        alone = Element("road")
        SubElement(alone, "planView").append(part)
        try:
            with np.errstate(all="ignore"):
                finite = np.isfinite(geometry(alone).reference_line).all()
        except Exception as again:  # as where it was raised first
            return f"its geometry at s = {part.get('s')}: {type(again).__name__}: {again}"
        if not finite:
            return f"its geometry at s = {part.get('s')} is not finite"
    return f"{type(error).__name__}: {error}"


def _pieces(road: Any, before: int) -> Iterator[_Piece]:
    """Yield a road's lanes that have an area, numbered on from `before`, in the file's order."""
    number = before
    for index, section in enumerate(road.lane_sections):
        for lane in sorted(section.lanes, key=lambda lane: -int(lane.id)):
            lines = lane.lane_reference_line[:, :2], lane.boundary_line[:, :2]
            if not np.isfinite(lines).all():
                raise LogError(
                    f"its lane {lane.id} at s = {section.lane_section_xml.get('s')} is not finite"
                )
            if lane.type is not None and np.hypot(*(lines[0] - lines[1]).T).max() > NARROWEST_M:
                number += 1
                place, on_right = int(lane.id), bool(lane.traffic_orientation.name == "RIGHT")
                against, drivable = (place < 0) != on_right, lane.type in _DRIVABLE
                part = section.lane_section_xml
                yield _Piece(
                    number, lane, road.road_xml, part, index, place, on_right, against, drivable
                )


Joints = Mapping[tuple[int, bool], set[tuple[int, bool]]]
"""What touches an end of a lane: number of the lane, and whether it is the end in the direction of
s.
"""


def _joints(
    pieces: Sequence[_Piece], root: Element, lines: Mapping[str, Any]
) -> tuple[Joints, list[str]]:
    """Return what the links join, in both directions, and the links that lead to no lane of a road
    that was read.

    A link to a road without `contactPoint` is one to its nearer end.
    """
    sections = {
        road.get("id", ""): road.findall("lanes/laneSection") for road in root.findall("road")
    }
    by_place = {
        (piece.road.get("id", ""), piece.index, piece.place): piece.number for piece in pieces
    }
    linked = set()
    for name, of in sections.items():
        linked |= {
            (name, k, lane.get("id"))
            for k, section in enumerate(of)
            for lane in section.iter("lane")
        }
    joints: dict[tuple[int, bool], set[tuple[int, bool]]] = defaultdict(set)
    loose = []
    for piece in pieces:
        own = piece.road.get("id", "")
        for tag, at_end in (("predecessor", False), ("successor", True)):
            name, index, contact = own, piece.index + (1 if at_end else -1), not at_end
            if not 0 <= index < len(sections[own]):
                link = piece.road.find(f"link/{tag}")
                if link is None or link.get("elementType", "road") != "road":
                    continue
                name = link.get("elementId", "")
                contact = link.get("contactPoint") == "end"
                if name in lines and link.get("contactPoint") not in ("start", "end"):
                    away = np.hypot(
                        *(lines[name][[0, -1], :2] - lines[own][-1 if at_end else 0, :2]).T
                    )
                    contact = bool(away[1] < away[0])
                index = len(sections.get(name, ())) - 1 if contact else 0
            for place in (
                element.get("id", "") for element in piece.lane.lane_xml.findall(f"link/{tag}")
            ):
                if (name, index, place) not in linked:
                    loose.append(
                        f"from lane {piece.place} of road {own} to lane {place} of road {name}"
                    )
                elif (name, index, int(place)) in by_place:
                    other = by_place[name, index, int(place)]
                    joints[piece.number, at_end].add((other, contact))
                    joints[other, contact].add((piece.number, at_end))
    return joints, loose


def _lanes(pieces: Sequence[_Piece], joints: Joints) -> Iterator[tuple[int, Lane]]:
    by_number = {piece.number: piece for piece in pieces}
    by_place = {(id(piece.section), piece.place): piece for piece in pieces}
    for piece in pieces:
        inner, outer = piece.lane.lane_reference_line[:, :2], piece.lane.boundary_line[:, :2]
        rows = np.unique(np.r_[np.arange(0, len(inner), KEPT), len(inner) - 1])
        rows = rows[::-1] if piece.against else rows
        left, right = (inner, outer) if piece.on_right else (outer, inner)
        step = 1 if piece.place > 0 else -1
        beside = by_place.get((id(piece.section), piece.place + step))
        middle = by_place.get((id(piece.section), piece.place - step or -step))
        # The lane in the same direction; whether there is an opposite one
        sides: list[tuple[int | None, bool]] = []
        for other in (middle, beside) if piece.on_right else (beside, middle):
            if other is None or not (piece.drivable and other.drivable):
                sides.append((None, False))
            else:
                same = other.against == piece.against
                sides.append((other.number if same else None, not same))
        near, far = _crossable(piece, inner=True), _crossable(piece, inner=False)
        ends = joints.get((piece.number, not piece.against), ())
        after = [(by_number[number], at_end) for number, at_end in ends]
        after = [
            (following, at_end)
            for following, at_end in after
            if following.drivable == piece.drivable
        ]
        yield (
            piece.number,
            Lane(
                piece.number,
                left[rows],
                right[rows],
                successors=tuple(
                    sorted(
                        following.number
                        for following, at_end in after
                        if at_end == following.against
                    )
                ),
                left_neighbour=sides[0][0],
                right_neighbour=sides[1][0],
                left_opposite=sides[0][1],
                right_opposite=sides[1][1],
                speed_limit=_limit(piece),
                drivable=piece.drivable,
                left_crossable=near if piece.on_right else far,
                right_crossable=far if piece.on_right else near,
                kind=f"{piece.lane.type}"
                + f"+{IN_JUNCTION}" * (piece.road.get("junction", "-1") != "-1"),
            ),
        )


def _crossable(piece: _Piece, *, inner: bool) -> bool:
    """Return whether the lane's first marking on a side may be crossed.

    A double marking's near part decides.
    """
    step = 1 if piece.place > 0 else -1
    name = piece.place - step if inner else piece.place
    lane = next((e for e in piece.section.iter("lane") if e.get("id") == str(name)), None)
    mark = None if lane is None else lane.find("roadMark")
    kind = "none" if mark is None else mark.get("type", "none")
    parts = kind.split()
    # Named from the middle outwards; that of the middle from left to right
    if set(parts) == {"solid", "broken"}:
        is_first = piece.place > 0 if name == 0 else not inner
        return parts[0 if is_first else -1] == "broken"
    return kind in _CROSSABLE


def _limit(piece: _Piece) -> float:
    """Return the speed limit at the lane's begin, m/s; NaN if there is none."""
    lane = next((e for e in piece.section.iter("lane") if e.get("id") == str(piece.place)), None)
    own = [] if lane is None else lane.findall("speed")
    start = float(piece.section.get("s", "0"))
    types = [
        kind_at
        for kind_at in piece.road.findall("type")
        if float(kind_at.get("s", "0")) <= start + 1e-6
    ]
    for element in (
        *own[:1],
        *(kind_at for kind in types[-1:] for kind_at in kind.findall("speed")),
    ):
        try:
            speed = float(element.get("max", "")) * _UNITS.get(element.get("unit", "m/s"), nan)
        except ValueError:
            continue
        if isfinite(speed) and speed > 0.0:
            return speed
    return nan


READER = MapReader("OpenDRIVE", "*.xodr, with pyxodr", ".xodr", read_opendrive)
