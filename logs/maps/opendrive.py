"""OpenDRIVE maps (.xodr), their geometry evaluated by pyxodr (extra `opendrive`): lanes, links, markings, limits.

Source: ASAM OpenDRIVE 1.8, chapters 10 and 11. Each lane of a lane section becomes one lane. If traffic keeps right,
lanes with negative ids run along the reference line and the others against it; if it keeps left, the reverse.
Signals, objects and junction priorities are not read.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, nan
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, ParseError, TreeBuilder, XMLParser

import numpy as np

from logs.errors import LogError
from logs.maps.base import MapFile, MapReader
from logs.road import Lane, Road

RESOLUTION_M = 0.1
"""Step of pyxodr along the reference line, m; its lanes end within a few cm of the begin of the next ones."""
KEPT = 5
"""Every fifth point of pyxodr's lines is kept."""
NARROWEST_M = 0.1
"""A lane section's lane that is nowhere wider has no area and is left out, m."""
LARGEST_BYTES, LONGEST_M = 1 << 28, 1e6
FARTHEST = 100.0
"""Largest reach of a polynomial over its length: pyxodr steps along it by `RESOLUTION_M`."""
_DRIVABLE = {"driving", "entry", "exit", "onRamp", "offRamp", "connectingRamp", "slipLane", "bidirectional"}
_CROSSABLE = {"none", "broken", "broken broken", "botts dots"}
_UNITS = {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704}


@dataclass(frozen=True, eq=False)
class _Piece:
    """A lane of a lane section: pyxodr's lane, and the road's and section's XML.

    Attributes:
        place: Its OpenDRIVE id: counted outwards, negative on the right of the reference line.
        on_right: Whether traffic keeps right on this road.
        against: Whether its traffic drives against the reference line.
        drivable: Whether cars may drive on it.
    """

    number: int
    lane: Any
    road: Element
    section: Element
    place: int
    on_right: bool
    against: bool
    drivable: bool


def read_opendrive(path: Path, settings: Mapping[str, str]) -> MapFile:
    """Read a map.

    Raises:
        LogError: pyxodr is not installed or cannot read the file, or the file is not OpenDRIVE or has no drivable lane.
    """
    root = _root(path)
    try:
        from pyxodr.road_objects.network import RoadNetwork
    except ImportError:
        raise LogError("OpenDRIVE needs pyxodr", file=path, remedy="pip install 'replan[opendrive]'") from None
    try:
        with np.errstate(all="ignore"):
            roads = RoadNetwork(str(path), resolution=RESOLUTION_M).get_roads()
            pieces = list(_pieces(roads, root))
            lanes = dict(_lanes(pieces))
    except Exception as error:  # the library may raise anything on an unexpected file
        raise LogError(f"pyxodr cannot read it: {type(error).__name__}: {error}", file=path) from error
    if not any(lane.drivable for lane in lanes.values()):
        raise LogError("no lane on which a car may drive", file=path, remedy="give a map with lanes of type driving")
    sides = Counter(piece.on_right for piece in pieces)
    road = Road(lanes, drives_on_right=sides[True] >= sides[False])
    notes = []
    for tag, words in (("signal", "signals and signs"), ("object", "objects"), ("priority", "priorities of junctions")):
        count = sum(1 for _ in root.iter(tag))
        notes += [f"{count} {words} are not read."] if count else []
    if root.find("header/offset") is not None:
        notes.append("The header's offset is not applied.")
    return MapFile(road, "as in the file", tuple(notes))


class _Tree(TreeBuilder):
    """Refuses a document type declaration, in which entities could grow without bound."""

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        raise LogError("it has a document type declaration, which maps do not need", remedy="remove the declaration")


def _root(path: Path) -> Element:
    """Return the file's XML after checks of its size and geometry."""
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise LogError(f"larger than {LARGEST_BYTES >> 20} MiB", remedy="cut the map")
        parser = XMLParser(target=_Tree())
        parser.feed(path.read_bytes())
        root = parser.close()
        if root.tag != "OpenDRIVE":
            raise LogError(f"root element is <{root.tag}>", remedy="give an OpenDRIVE map (<OpenDRIVE>)")
        lengths = [float(part.get("length", "nan")) for part in root.iter("geometry")]
        far = []
        for part, length in zip(root.iter("geometry"), lengths, strict=True):
            reach = 0.0  # upper bound of its polynomials, m: the sum of |a|, |b| p, |c| p^2, |d| p^3 at their end
            for curve in part:
                if curve.tag in ("poly3", "paramPoly3"):
                    whole = curve.tag == "paramPoly3" and curve.get("pRange", "normalized") == "normalized"
                    p = 1.0 if whole else length
                    keys = ((k, key) for k, one in enumerate("abcd") for key in (one, one + "U", one + "V"))
                    reach += sum(abs(float(curve.get(key, "0"))) * p**k for k, key in keys)
            if not reach <= FARTHEST * length:
                far.append(part)
    except OSError as error:
        raise LogError(f"cannot be read: {error.strerror}", file=path) from None
    except (ParseError, ValueError, LookupError) as error:
        raise LogError(f"is no OpenDRIVE: {error}", file=path, remedy="fetch the file again") from None
    except LogError as error:
        raise error.at(path) from None
    if not (all(length >= 0.0 for length in lengths) and sum(lengths) < LONGEST_M):
        raise LogError("its roads have no length, or more than 1000 km", file=path, remedy="cut the map")
    if far:
        what = f"the geometry at s = {far[0].get('s')} leads more than {FARTHEST:.0f} times its length away"
        raise LogError(what, file=path, remedy="mend its coefficients")
    return root


def _pieces(roads: Sequence[Any], root: Element) -> Iterator[_Piece]:
    """Yield the lanes that have an area, numbered from 1 in the file's order."""
    elements = {element.get("id"): element for element in root.findall("road")}
    number = 0
    for road in roads:
        element = elements[str(road.id)]
        for section, part in zip(road.lane_sections, element.findall("lanes/laneSection"), strict=True):
            for lane in sorted(section.lanes, key=lambda lane: -int(lane.id)):
                if lane.type is None:
                    continue
                width = np.hypot(*(lane.lane_reference_line[:, :2] - lane.boundary_line[:, :2]).T)
                if width.max() > NARROWEST_M:
                    number += 1
                    place, on_right = int(lane.id), bool(lane.traffic_orientation.name == "RIGHT")
                    against = (place < 0) != on_right
                    yield _Piece(number, lane, element, part, place, on_right, against, lane.type in _DRIVABLE)


def _lanes(pieces: Sequence[_Piece]) -> Iterator[tuple[int, Lane]]:
    by_lane = {piece.lane: piece for piece in pieces}
    by_place = {(id(piece.section), piece.place): piece for piece in pieces}
    for piece in pieces:
        inner, outer = piece.lane.lane_reference_line[:, :2], piece.lane.boundary_line[:, :2]
        rows = np.unique(np.r_[np.arange(0, len(inner), KEPT), len(inner) - 1])
        rows = rows[::-1] if piece.against else rows
        left, right = (inner, outer) if piece.on_right else (outer, inner)
        step = 1 if piece.place > 0 else -1
        beside = by_place.get((id(piece.section), piece.place + step))
        middle = by_place.get((id(piece.section), piece.place - step or -step))
        sides: list[tuple[int | None, bool]] = []  # the lane in the same direction; whether there is an opposite one
        for other in (middle, beside) if piece.on_right else (beside, middle):
            if other is None or not (piece.drivable and other.drivable):
                sides.append((None, False))
            else:
                same = other.against == piece.against
                sides.append((other.number if same else None, not same))
        near, far = _crossable(piece, inner=True), _crossable(piece, inner=False)
        ends = piece.lane.predecessor_data if piece.against else piece.lane.successor_data
        after = [(by_lane[lane], contact.name == "END") for lane, contact in ends if lane in by_lane]
        after = [(each, at_end) for each, at_end in after if each.drivable == piece.drivable]
        yield (
            piece.number,
            Lane(
                piece.number,
                left[rows],
                right[rows],
                successors=tuple(sorted(each.number for each, at_end in after if at_end == each.against)),
                left_neighbour=sides[0][0],
                right_neighbour=sides[1][0],
                left_opposite=sides[0][1],
                right_opposite=sides[1][1],
                speed_limit=_limit(piece),
                drivable=piece.drivable,
                left_crossable=near if piece.on_right else far,
                right_crossable=far if piece.on_right else near,
                kind=str(piece.lane.type),
            ),
        )


def _crossable(piece: _Piece, *, inner: bool) -> bool:
    """Return whether the lane's first marking on a side may be crossed; a double marking's near part decides."""
    step = 1 if piece.place > 0 else -1
    name = piece.place - step if inner else piece.place
    lane = next((e for e in piece.section.iter("lane") if e.get("id") == str(name)), None)
    mark = None if lane is None else lane.find("roadMark")
    kind = "none" if mark is None else mark.get("type", "none")
    parts = kind.split()
    if set(parts) == {"solid", "broken"}:  # named from the middle outwards; that of the middle from left to right
        own = 0 if (piece.place > 0 if name == 0 else not inner) else -1
        return parts[own] == "broken"
    return kind in _CROSSABLE


def _limit(piece: _Piece) -> float:
    """Return the speed limit at the lane's begin, m/s; NaN if there is none."""
    lane = next((e for e in piece.section.iter("lane") if e.get("id") == str(piece.place)), None)
    own = [] if lane is None else lane.findall("speed")
    start = float(piece.section.get("s", "0"))
    types = [each for each in piece.road.findall("type") if float(each.get("s", "0")) <= start + 1e-6]
    for element in (*own[:1], *(each for kind in types[-1:] for each in kind.findall("speed"))):
        try:
            speed = float(element.get("max", "")) * _UNITS.get(element.get("unit", "m/s"), nan)
        except ValueError:
            continue
        if isfinite(speed) and speed > 0.0:
            return speed
    return nan


READER = MapReader("OpenDRIVE", "*.xodr, with pyxodr", ".xodr", read_opendrive)
