"""Lanelet2 maps written by hand, and drives along their lanes, for the tests of maps."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import count
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.reference_line import ReferenceLine
from replan.logs.road import Road
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.tracks import Tracks

NORTH, EAST = 110_574.27582, 111_319.49079
"""Metres of a degree at latitude 0, longitude 0."""
Xy = Sequence[tuple[float, float]]


class MapWriter:
    """Collects nodes, ways and relations; nodes at the same place are one, as Lanelet2 wants it."""

    def __init__(self) -> None:
        self.ids = count(1)
        self.nodes: dict[tuple[float, float], int] = {}
        self.heights: dict[tuple[float, float], float] = {}
        self.parts: list[str] = []

    def way(self, points: Xy, **tags: str) -> int:
        """A way through points, m; its id."""
        refs = [self.nodes.setdefault(point, next(self.ids)) for point in points]
        return self._add("way", "".join(f'<nd ref="{ref}"/>' for ref in refs), tags)

    def way_at(self, z: float, points: Xy) -> int:
        """A way through points at a height, m; its id."""
        self.heights.update(dict.fromkeys(points, z))
        return self.way(points)

    def relation(self, members: Iterable[tuple[str, str, int]], **tags: str) -> int:
        """A relation of members (kind, role, id); its id."""
        inner = "".join(
            f'<member type="{kind}" role="{role}" ref="{ref}"/>' for kind, role, ref in members
        )
        return self._add("relation", inner, tags)

    def lanelet(self, left: int, right: int, rules: Iterable[int] = (), **tags: str) -> int:
        """A lanelet of two ways."""
        members = [
            ("way", "left", left),
            ("way", "right", right),
            *(("relation", "regulatory_element", r) for r in rules),
        ]
        return self.relation(
            members, **{"type": "lanelet", "subtype": "road", "one_way": "yes", **tags}
        )

    def rule(self, subtype: str, members: Iterable[tuple[str, str, int]], **tags: str) -> int:
        """A regulatory element."""
        return self.relation(members, type="regulatory_element", subtype=subtype, **tags)

    def _add(self, kind: str, inner: str, tags: Mapping[str, str]) -> int:
        name = next(self.ids)
        said = "".join(
            f"<tag k={quoteattr(key.replace('__', ':'))} v={quoteattr(text)}/>"
            for key, text in tags.items()
        )
        self.parts.append(f'<{kind} id="{name}">{inner}{said}</{kind}>')
        return name

    def text(self) -> str:
        """The file; every node has local_x and local_y, and latitude and longitude near 0."""
        nodes = (
            f'<node id="{name}" lat="{y / NORTH!r}" lon="{x / EAST!r}">'
            f'<tag k="local_x" v="{x!r}"/><tag k="local_y" v="{y!r}"/>{self._height((x, y))}</node>'
            for (x, y), name in self.nodes.items()
        )
        return (
            "<?xml version='1.0'?>\n<osm "
            f'version="0.6">{"".join(nodes)}{"".join(self.parts)}</osm>\n'
        )

    def _height(self, place: tuple[float, float]) -> str:
        return f'<tag k="ele" v="{self.heights[place]!r}"/>' if place in self.heights else ""

    def write(self, path: Path) -> Path:
        """Write the file; its path."""
        path.write_text(self.text(), encoding="utf-8")
        return path


def driven_along(
    line: FloatArray, speed: float = 8.0, duration: float = 20.0, name: str = "drive"
) -> Scenario:
    """A drive along a line `(n, 2)` at one speed, 10 Hz, in a log without lanes."""
    smooth = ReferenceLine.through(line)
    t = np.arange(0.0, min(duration, smooth.length / speed) + 1e-9, 0.1)
    frames = np.array([smooth.frame(speed * at) for at in t])
    origin = np.round(frames[0, :2])
    x, y = (frames[:, :2] - origin).T
    ego = Trajectory(
        t, x, y, np.unwrap(frames[:, 2]), np.full(len(t), speed), np.zeros(len(t)), frames[:, 3]
    )
    place = (float(origin[0]), float(origin[1]))
    return Scenario(name, ego, Tracks.empty(), Road({}), float(t[-1]), origin=place)


def through(road: Road, first: int, length: float, turn: int = 0) -> tuple[list[int], FloatArray]:
    """Lanes that follow on a lane for a length, m, taking the successor at place `turn`.

    Their centre lines as one.
    """
    lanes = [first]
    while sum(road.lanes[i].length for i in lanes) < length and road.lanes[lanes[-1]].successors:
        after = road.lanes[lanes[-1]].successors
        lanes.append(after[turn % len(after)])
    line = np.vstack([road.lanes[i].center for i in lanes])
    return lanes, line[np.r_[True, np.hypot(*np.diff(line, axis=0).T) > 0.5]]


def crossroads() -> tuple[MapWriter, dict[str, int]]:
    """A road to the east with two lanes that way and one back, a side road from the south that
    yields, and rules.

    Lanes by name: "west 1" (left) and "west 2" (right) lead from x = 0 to 60 into "inner 1" and
    "inner 2" to 72 and "east 1" and "east 2" to 150; "back" comes from x = 150 to 72; "side" comes
    from y = -60 to -8 and "turn" leads from it into "east 2". "walk" is a crosswalk over x = 130 to
    134, "bikes" a bicycle lane beside "east 2". A car park of 10 m by 10 m is at (85, 15); "turn"
    lies in an intersection area of 12 m by 12 m at (66, -2).
    """
    m, lanes = MapWriter(), {}
    rows = {y: f"{y}" for y in (8.0, 4.0, 0.0, -4.0)}
    parts = {"west": (0.0, 60.0), "inner": (60.0, 72.0), "east": (72.0, 150.0)}
    tags = {
        8.0: {"type": "curbstone", "subtype": "high"},
        4.0: {"type": "line_thin", "subtype": "solid_dashed"},
        0.0: {"type": "line_thin", "subtype": "dashed"},
        -4.0: {"type": "road_border"},
    }
    ways = {
        (part, y): m.way([(x0, y), (0.5 * (x0 + x1), y), (x1, y)], **tags[y])
        for part, (x0, x1) in parts.items()
        for y in rows
    }
    light_way = m.way([(60.0, 9.0), (60.0, 9.5)], type="traffic_light", subtype="red_yellow_green")
    stop = m.way([(59.0, 4.0), (59.0, -4.0)], type="stop_line")
    light = m.rule("traffic_light", [("way", "refers", light_way), ("way", "ref_line", stop)])
    sign = m.rule("speed_limit", [], sign_type="de274-30")
    lanes["light"], lanes["light way"] = light, light_way
    lanes["west 1"] = m.lanelet(ways["west", 4.0], ways["west", 0.0], [light], speed_limit="50")
    lanes["west 2"] = m.lanelet(
        ways["west", 0.0], ways["west", -4.0], [light], speed_limit="30 mph"
    )
    lanes["inner 1"] = m.lanelet(ways["inner", 4.0], ways["inner", 0.0], speed_limit="10 m/s")
    lanes["inner 2"] = m.lanelet(ways["inner", 0.0], ways["inner", -4.0])
    lanes["east 1"] = m.lanelet(ways["east", 4.0], ways["east", 0.0], [sign], speed_limit="50 km/h")
    lanes["east 2"] = m.lanelet(ways["east", 0.0], ways["east", -4.0], speed_limit="fast")
    lanes["back"] = m.lanelet(ways["east", 4.0], ways["east", 8.0])  # its ways run against it
    left, right = m.way([(64.0, -60.0), (64.0, -8.0)]), m.way([(68.0, -60.0), (68.0, -8.0)])
    first, second = (
        m.way([(64.0, -8.0), (66.0, -2.0), (72.0, 0.0)]),
        m.way([(68.0, -8.0), (69.0, -5.0), (72.0, -4.0)]),
    )
    waiting = m.way([(64.0, -9.0), (68.0, -9.0)], type="stop_line")
    yields = m.way([(70.0, -9.0), (70.5, -9.0)], type="traffic_sign", subtype="de205")
    m_yield = m.rule("traffic_sign", [("way", "refers", yields), ("way", "ref_line", waiting)])
    lanes["side"] = m.lanelet(left, right, [m_yield])
    middle = m.way(
        [(60.0, -8.0), (72.0, -8.0), (72.0, 4.0), (60.0, 4.0)], type="intersection_area", area="yes"
    )
    lanes["turn"] = m.lanelet(first, second, intersection_area=str(middle))
    lanes["way"] = m.rule(
        "right_of_way",
        [("relation", "right_of_way", lanes[name]) for name in ("west 1", "west 2")]
        + [("relation", "yield", lanes["side"])],
    )
    over = m.way([(130.0, -6.0), (130.0, 9.0)]), m.way([(134.0, -6.0), (134.0, 9.0)])
    lanes["walk"] = m.lanelet(*over, subtype="crosswalk", participant__pedestrian="yes")
    beside = m.way([(72.0, -6.0), (150.0, -6.0)])
    lanes["bikes"] = m.lanelet(ways["east", -4.0], beside, subtype="bicycle_lane")
    m.rule("detection_area", [])
    m.relation([], type="multipolygon", subtype="building")
    corners = [(80.0, 10.0), (90.0, 10.0), (90.0, 20.0), (80.0, 20.0)]
    # One runs around it, one against that
    sides = m.way(corners[:3]), m.way([corners[0], corners[3], corners[2]])
    m.relation([("way", "outer", side) for side in sides], type="multipolygon", subtype="parking")
    return m, lanes
