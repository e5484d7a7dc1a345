"""OpenStreetMap XML as Lanelet2 uses it (.osm): nodes, ways and relations as plain records, in the file's own terms.

The file is read as a stream: no tree is built, so that its depth costs nothing. A document type declaration, which such
files do not have and in which entities could grow without bound, is refused before anything in it is expanded.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import ParseError, XMLParser

from logs.errors import LogError

LARGEST_BYTES = 1 << 30
"""A larger file is refused: the maps of whole cities have some 100 MB."""
_CHUNK_BYTES = 1 << 16
NEW_ID = 10**12
"""Editors number what is new -1, -2 ...: such ids become this and one, two ... more, as replan's are not negative."""


@dataclass(frozen=True)
class Member:
    """A relation's member: its kind ("way", "relation", "node"), its role, and its id."""

    kind: str
    role: str
    ref: int


@dataclass
class Element:
    """A node, way or relation.

    Attributes:
        id: Unique among its kind.
        tags: By key, without blanks around it.
        place: Latitude and longitude of a node, degrees; None where it has none.
        nodes: Of a way; `members` of a relation.
    """

    id: int
    tags: dict[str, str] = field(default_factory=dict)
    place: tuple[float, float] | None = None
    nodes: list[int] = field(default_factory=list)
    members: list[Member] = field(default_factory=list)

    def named(self, *roles: str, kind: str = "way") -> Iterator[int]:
        """Ids of its members of a kind in one of these roles, in the file's order."""
        return (member.ref for member in self.members if member.kind == kind and member.role in roles)


@dataclass
class Osm:
    """A whole file, by id; `blanks` counts the keys that had blanks around them."""

    nodes: dict[int, Element] = field(default_factory=dict)
    ways: dict[int, Element] = field(default_factory=dict)
    relations: dict[int, Element] = field(default_factory=dict)
    blanks: dict[str, int] = field(default_factory=dict)


class _Target:
    """What the XML parser calls: fills an `Osm`."""

    def __init__(self) -> None:
        self.osm = Osm()
        self.open: Element | None = None
        self.root = ""
        self.kinds = {"node": self.osm.nodes, "way": self.osm.ways, "relation": self.osm.relations}

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        raise LogError("it has a document type declaration, which maps do not need", remedy="remove the declaration")

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
                raise LogError(f"two elements <{tag}> have the id {self.open.id}", remedy="number them anew")
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
    """Read a file.

    Raises:
        LogError: It cannot be read, is not OSM XML, has a document type declaration, or a number cannot be parsed.
    """
    parser = XMLParser(target=_Target())
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise LogError(f"larger than {LARGEST_BYTES >> 20} MiB", file=path, remedy="cut the map")
        with path.open("rb") as stream:
            while chunk := stream.read(_CHUNK_BYTES):
                parser.feed(chunk)
        osm = parser.close()
    except OSError as error:
        raise LogError(f"cannot be read: {error.strerror}", file=path, remedy="check the path") from None
    except (ParseError, ValueError, LookupError) as error:
        raise LogError(f"is no complete XML: {error}", file=path, remedy="fetch the file again") from None
    except LogError as error:
        raise error.at(path) from None
    assert isinstance(osm, Osm)
    return osm


def whole(text: str | None, place: str) -> int:
    """The id in a text; LogError where it is not a whole number of 62 bits."""
    try:
        value = int(text or "")
    except ValueError:
        value = 1 << 62
    if abs(value) >= 1 << 62:
        raise LogError(f"{(text or '')[:40]!r} is no id", topic=place, remedy="correct the element")
    return value if value >= 0 else NEW_ID - value


def real(text: str, place: str) -> float:
    """The number in a text; LogError where it cannot be parsed or cannot be a coordinate."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) < 1e9:
        raise LogError(f"{text[:40]!r} is no coordinate", topic=place, remedy="correct the element")
    return value
