"""Lanelet2 maps written by hand, and drives along their lanes, for the tests of maps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import count
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from logs import ReferenceLine, Road, Scenario, Tracks, Trajectory
from logs.kernel import FloatArray

Xy = Sequence[tuple[float, float]]


class MapWriter:
    """Collects nodes, ways and relations; nodes at the same place are one, as Lanelet2 wants it."""

    def __init__(self) -> None:
        self.ids = count(1)
        self.nodes: dict[tuple[float, float], int] = {}
        self.parts: list[str] = []

    def way(self, points: Xy, **tags: str) -> int:
        """A way through points, m; its id."""
        refs = [self.nodes.setdefault(point, next(self.ids)) for point in points]
        return self._add("way", "".join(f'<nd ref="{ref}"/>' for ref in refs), tags)

    def relation(self, members: Iterable[tuple[str, str, int]], **tags: str) -> int:
        """A relation of members (kind, role, id); its id."""
        inner = "".join(f'<member type="{kind}" role="{role}" ref="{ref}"/>' for kind, role, ref in members)
        return self._add("relation", inner, tags)

    def lanelet(self, left: int, right: int, rules: Iterable[int] = (), **tags: str) -> int:
        """A lanelet of two ways."""
        members = [("way", "left", left), ("way", "right", right), *(("relation", "regulatory_element", r) for r in rules)]
        return self.relation(members, **{"type": "lanelet", "subtype": "road", "one_way": "yes", **tags})

    def rule(self, subtype: str, members: Iterable[tuple[str, str, int]], **tags: str) -> int:
        """A regulatory element."""
        return self.relation(members, type="regulatory_element", subtype=subtype, **tags)

    def _add(self, kind: str, inner: str, tags: Mapping[str, str]) -> int:
        name = next(self.ids)
        said = "".join(f"<tag k={quoteattr(key.replace('__', ':'))} v={quoteattr(text)}/>" for key, text in tags.items())
        self.parts.append(f'<{kind} id="{name}">{inner}{said}</{kind}>')
        return name

    def text(self) -> str:
        """The file; every node has local_x and local_y."""
        nodes = (
            f'<node id="{name}"><tag k="local_x" v="{x!r}"/><tag k="local_y" v="{y!r}"/></node>'
            for (x, y), name in self.nodes.items()
        )
        return f"<?xml version='1.0'?>\n<osm version=\"0.6\">{''.join(nodes)}{''.join(self.parts)}</osm>\n"

    def write(self, path: Path) -> Path:
        """Write the file; its path."""
        path.write_text(self.text(), encoding="utf-8")
        return path


def driven_along(line: FloatArray, speed: float = 8.0, duration: float = 20.0, name: str = "drive") -> Scenario:
    """A drive along a line `(n, 2)` at one speed, 10 Hz, in a log without lanes."""
    smooth = ReferenceLine.through(line)
    t = np.arange(0.0, min(duration, smooth.length / speed) + 1e-9, 0.1)
    frames = np.array([smooth.frame(speed * at) for at in t])
    origin = np.round(frames[0, :2])
    x, y = (frames[:, :2] - origin).T
    ego = Trajectory(t, x, y, np.unwrap(frames[:, 2]), np.full(len(t), speed), np.zeros(len(t)), frames[:, 3])
    place = (float(origin[0]), float(origin[1]))
    return Scenario(name, ego, Tracks.empty(), Road({}), float(t[-1]), origin=place)


def through(road: Road, first: int, length: float, turn: int = 0) -> tuple[list[int], FloatArray]:
    """Lanes that follow on a lane for a length, m, taking the successor at place `turn`; their centre lines as one."""
    lanes = [first]
    while sum(road.lanes[i].length for i in lanes) < length and road.lanes[lanes[-1]].successors:
        after = road.lanes[lanes[-1]].successors
        lanes.append(after[turn % len(after)])
    line = np.vstack([road.lanes[i].center for i in lanes])
    return lanes, line[np.r_[True, np.hypot(*np.diff(line, axis=0).T) > 0.5]]
