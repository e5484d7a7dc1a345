"""Makes lanes from lanelets: paired boundaries, successors, neighbours, where cars may drive and
cross.

Source: Lanelet2, "LaneletAndAreaTagging.md", "LinestringTagging.md" and "GenericTrafficRules.cpp"
(Poggenhans et al., ITSC 2018); a `speed_limit` without a unit is in km/h. A lanelet's boundaries
are reversed if needed

(1) so that the right one begins beside the begin of the left one:
        |l_0 - r_0| + |l_n - r_m| <= |l_0 - r_m| + |l_n -
r_0| (2) and so that the left one is on the left: the outline (left forwards, right backwards) runs
    clockwise.

(3) Their points are paired in order, with the least sum of squared widths
        over all pairs (dynamic time warping): pairs lie across the lane also in bends, where one
        boundary is longer.

Lanelet B is a successor of A if both boundaries of A end where those of B begin; it is a neighbour
of A if they share a whole boundary. In Lanelet2, shared means the same point and the same way. As
many maps have separate points and ways, ends nearer than `SAME_M` are one point, and ways between
the same ends that differ by less than `ALIKE_M` are one way.

A painted marking may be crossed from its dashed side, or if `lane_change` allows it; a kerb, wall
or border may not be crossed; a virtual boundary, or one without a type, may be crossed, as the road
has no marking there.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import hypot, isfinite, nan

import numpy as np

from replan.core.arrays import FloatArray, IntArray, arc_lengths
from replan.core.errors import LogError
from replan.core.kernel import kernel
from replan.logs.maps.lanelet2_file import Element, Osm
from replan.logs.maps.strips import resampled
from replan.logs.road import IN_JUNCTION, Lane

SAME_M = 0.05
"""Ends nearer than this are one point, m: less than the distance of the two parts of a double
line.
"""
ALIKE_M = 0.2
LONGEST_PIECE_M, SHORTEST_PIECE_M = 2.0, 0.25
"""Longest piece of a boundary, and shortest piece of a centre line, m."""
LONGEST_M = 20_000.0
"""Largest extent of a lanelet, m: a larger one has a misplaced point."""
MOST_HERE = 100
"""The greatest number of lanelets that begin at one place or share a boundary."""
MOST = 1000
"""Greatest number of pieces of a boundary: time and memory of (3) grow with the product of both
sides' pieces.
"""
_DRIVABLE = frozenset({"road", "highway", "play_street", "exit"})
_OPEN = frozenset(
    {"", "virtual", "stop_line", "pedestrian_marking", "bike_marking", "zebra_marking", "keepout"}
)
_CAR = ("vehicle", "car")
_SPEED = re.compile(r"(\d+(?:\.\d+)?)\s*(km/h|kmh|kph|mph|m/s|mps)?")
_UNITS = {"mph": 0.44704, "m/s": 1.0, "mps": 1.0}
_KPH = 1.0 / 3.6
_SIGN_274 = re.compile(r".*274(?:\.\d)?-(\d+)")

Points = tuple[int, ...]
"""A boundary as row numbers of the map's points, in the direction of the lane."""


@dataclass(frozen=True)
class Bound:
    """A lanelet's boundary: its points, the way's tags, and whether the way runs against the
    lane.
    """

    points: Points
    tags: Mapping[str, str]
    against: bool

    def turned(self) -> Bound:
        """Return the boundary in the opposite direction."""
        return Bound(self.points[::-1], self.tags, not self.against)


@dataclass(frozen=True)
class DirectedLanelet:
    """A lanelet in its direction: its boundaries, its tags, and its regulatory elements."""

    id: int
    left: Bound
    right: Bound
    tags: Mapping[str, str]
    rules: tuple[int, ...]

    @property
    def drivable(self) -> bool:
        """Whether a car may drive on it."""
        named = {
            key.removeprefix("participant:"): v
            for key, v in self.tags.items()
            if key.startswith("participant:")
        }
        if named:
            ways = (":".join(_CAR), *_CAR)
            return next((named[way] in ("yes", "true", "1") for way in ways if way in named), False)
        return self.tags.get("subtype") in _DRIVABLE

    @property
    def two_way(self) -> bool:
        """Whether cars drive on it in both directions."""
        return self.drivable and self.tags.get("one_way") in ("no", "false", "0")

    def reverse(self, name: int) -> DirectedLanelet:
        """Return the lanelet in the opposite direction, with the id `name` and without rules."""
        return DirectedLanelet(name, self.right.turned(), self.left.turned(), self.tags, ())


def joined(xyz: FloatArray, ends: Sequence[int]) -> dict[int, int]:
    """Number the rows `ends` of points `(n, 3)`.

    Points nearer than `SAME_M` get the same number.
    """
    from scipy.sparse import coo_array  # imported late: slow to load
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    rows = sorted(set(ends))
    cells, cell = np.unique(np.round(5.0 / SAME_M * xyz[rows]), axis=0, return_inverse=True)
    tree = cKDTree(cells * (SAME_M / 5.0))
    if tree.count_neighbors(tree, SAME_M) > len(cells) * MOST_HERE:
        raise LogError(
            "ends of boundaries lie on top of each other by the hundreds", remedy="correct the map"
        )
    pairs = tree.query_pairs(SAME_M, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(len(cells), len(cells)))
    labels = connected_components(graph, directed=False)[1]
    return dict(zip(rows, labels[cell.ravel()].tolist(), strict=True))


def strips_of(
    osm: Osm, rows: Mapping[int, int], xy: FloatArray, notes: list[str]
) -> list[DirectedLanelet]:
    """Return the lanelets in the file's order, followed by reversed copies of those for both
    directions.
    """
    strips, broken = [], 0
    lanelets = [
        relation for relation in osm.relations.values() if relation.tags.get("type") == "lanelet"
    ]
    for lanelet in lanelets:
        bounds = []
        for side in ("left", "right"):
            ways = [osm.ways[ref] for ref in lanelet.named(side) if ref in osm.ways]
            if len(ways) == 1 and len(points := way_points(ways[0], rows)) > 1:
                bounds.append(Bound(points, ways[0].tags, against=False))
        if len(bounds) < 2:
            broken += 1
            continue
        rules = tuple(lanelet.named("regulatory_element", kind="relation"))
        strips.append(
            DirectedLanelet(lanelet.id, *oriented(bounds[0], bounds[1], xy), lanelet.tags, rules)
        )
    if broken:
        notes.append(
            f"{broken} of {len(lanelets)} lanelets are dropped: they lack a left or a right "
            "boundary."
        )
    free = 1 + max((strip.id for strip in strips), default=0)
    both = [strip for strip in strips if strip.two_way]
    if both:
        notes.append(
            f"{len(both)} lanelets are for both directions: each is two lanes on the same ground."
        )
    return strips + [strip.reverse(free + k) for k, strip in enumerate(both)]


def way_points(way: Element, rows: Mapping[int, int]) -> Points:
    """Return the points of a way that are in the file, without consecutive repetitions."""
    points = [rows[node] for node in way.nodes if node in rows]
    return tuple(row for k, row in enumerate(points) if k == 0 or row != points[k - 1])


def oriented(left: Bound, right: Bound, xy: FloatArray) -> tuple[Bound, Bound]:
    """Return the boundaries in the direction of the lane, by (1) and (2)."""
    l, r = xy[list(left.points)], xy[list(right.points)]
    if hypot(*(l[0] - r[0])) + hypot(*(l[-1] - r[-1])) > hypot(*(l[0] - r[-1])) + hypot(
        *(l[-1] - r[0])
    ):
        right, r = right.turned(), r[::-1]
    outline = np.vstack([l, r[::-1]]) - l[0]
    x, y = outline.T
    if float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) > 0.0:
        return left.turned(), right.turned()
    return left, right


def paired(left: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Resample boundaries `(n, 2)` and `(m, 2)` by (3), so that point i faces point i.

    Centre points are at least `SHORTEST_PIECE_M` apart; the first and last points are kept.
    """
    a, b = (divided(line, LONGEST_PIECE_M, MOST) for line in (left, right))
    i, j = _pairs(a, b)
    l, r = a[i], b[j]
    center, last, keep = 0.5 * (l + r), len(l) - 1, [0]
    for k in range(1, last + 1):
        if hypot(*(center[k] - center[keep[-1]])) >= SHORTEST_PIECE_M:
            keep.append(k)
    if keep[-1] != last and len(keep) > 1:
        keep[-1] = last
    elif keep[-1] != last and hypot(*(center[last] - center[0])) > 1e-3:
        keep.append(last)
    return l[keep], r[keep]


@kernel
def _pairs(a: FloatArray, b: FloatArray) -> tuple[IntArray, IntArray]:
    """Return the rows of two polylines that face each other: the cheapest sequence of pairs by
    (3).
    """
    n, m = len(a), len(b)
    cost = np.empty((n, m))
    for i in range(n):
        for j in range(m):
            dx, dy, before = a[i, 0] - b[j, 0], a[i, 1] - b[j, 1], 0.0 if i + j == 0 else np.inf
            if i > 0 and j > 0:
                before = cost[i - 1, j - 1]
            if i > 0:
                before = min(before, cost[i - 1, j])
            if j > 0:
                before = min(before, cost[i, j - 1])
            cost[i, j] = before + dx * dx + dy * dy
    rows, columns = np.empty(n + m, np.int64), np.empty(n + m, np.int64)
    i, j, count = n - 1, m - 1, 0
    rows[0], columns[0] = i, j
    while i > 0 or j > 0:
        both = cost[i - 1, j - 1] if i > 0 and j > 0 else np.inf
        first = cost[i - 1, j] if i > 0 else np.inf
        other = cost[i, j - 1] if j > 0 else np.inf
        if both <= first and both <= other:
            i, j = i - 1, j - 1
        elif first <= other:
            i -= 1
        else:
            j -= 1
        count += 1
        rows[count], columns[count] = i, j
    return rows[: count + 1][::-1].copy(), columns[: count + 1][::-1].copy()


def divided(line: FloatArray, longest: float, most: float) -> FloatArray:
    """Divide a polyline into pieces of at most `longest` m.

    If there are more than `most`, resample it evenly.
    """
    s = arc_lengths(*line.T)
    parts = np.maximum(1.0, np.ceil(np.diff(s) / longest))
    if parts.sum() > most:
        stations = np.linspace(0.0, s[-1], int(most))
    else:
        stations = np.r_[
            np.concatenate(
                [np.linspace(s[k], s[k + 1], int(n) + 1)[:-1] for k, n in enumerate(parts)]
            ),
            s[-1],
        ]
    return np.column_stack([np.interp(stations, s, line[:, 0]), np.interp(stations, s, line[:, 1])])


@dataclass(frozen=True, eq=False)
class _Beside:
    """Tables of the lanes that begin at an end, and that have a boundary between two ends on their
    left or right.
    """

    xy: FloatArray
    ends: Mapping[int, int]
    begins: defaultdict[tuple[int, int, bool], list[int]]
    left: defaultdict[tuple[int, int, bool], list[DirectedLanelet]]
    right: defaultdict[tuple[int, int, bool], list[DirectedLanelet]]

    @classmethod
    def of(cls, strips: Sequence[DirectedLanelet], xyz: FloatArray) -> _Beside:
        bounds = [bound.points for strip in strips for bound in (strip.left, strip.right)]
        ends = joined(xyz, [row for points in bounds for row in (points[0], points[-1])])
        index = cls(xyz[:, :2], ends, defaultdict(list), defaultdict(list), defaultdict(list))
        for strip in strips:
            left, right = strip.left.points, strip.right.points
            index.begins[ends[left[0]], ends[right[0]], strip.drivable].append(strip.id)
            index.left[ends[left[0]], ends[left[-1]], strip.drivable].append(strip)
            index.right[ends[right[0]], ends[right[-1]], strip.drivable].append(strip)
        for places in (index.begins, index.left, index.right):
            if max(map(len, places.values()), default=0) > MOST_HERE:
                raise LogError(
                    f"more than {MOST_HERE} lanelets begin at one place", remedy="correct the map"
                )
        return index

    def after(self, strip: DirectedLanelet) -> tuple[int, ...]:
        """Return the lanes that begin at the end of a lanelet."""
        key = self.ends[strip.left.points[-1]], self.ends[strip.right.points[-1]], strip.drivable
        return tuple(i for i in self.begins[key] if i != strip.id)

    def neighbour(self, strip: DirectedLanelet, side: str, *, same: bool) -> int | None:
        """Return the lane that shares a lanelet's boundary on a side, in the same or opposite
        direction.
        """
        bound = getattr(strip, side).points if same else getattr(strip, side).points[::-1]
        across = {"left": "right", "right": "left"}[side] if same else side
        key = self.ends[bound[0]], self.ends[bound[-1]], strip.drivable
        for other in getattr(self, across)[key]:
            points = getattr(other, across).points
            if other.id == strip.id:
                continue
            if points != bound:
                own, facing = (resampled(self.xy[list(line)], 9) for line in (points, bound))
                if not np.hypot(*(own - facing).T).max() < ALIKE_M:
                    continue
            return int(other.id)
        return None


def lanes_of(
    osm: Osm, strips: Sequence[DirectedLanelet], xyz: FloatArray, notes: list[str]
) -> dict[int, Lane]:
    """Make the lanes by id; `xyz`: the map's points `(n, 3)`."""
    unread: Counter[str] = Counter()
    beside, lanes = _Beside.of(strips, xyz), {}
    for strip in strips:
        left, right = (beside.xy[list(bound.points)] for bound in (strip.left, strip.right))
        left, right = paired(left, right)
        if len(left) < 2 or max(np.ptp(line, axis=0).max() for line in (left, right)) > LONGEST_M:
            unread[f"lanelets without length or longer than {LONGEST_M / 1000.0:g} km"] += 1
            continue
        texts: list[str] = []  # texts of the speed limit signs, else of the lanelet's tag
        for sign in (osm.relations[ref] for ref in strip.rules if ref in osm.relations):
            if sign.tags.get("subtype") == "speed_limit":
                ways = (osm.ways[ref].tags for ref in sign.named("refers") if ref in osm.ways)
                own = [sign.tags[key] for key in ("sign_type", "speed_limit") if key in sign.tags]
                texts += own or [tags["subtype"] for tags in ways if "subtype" in tags]
        texts = texts or [strip.tags[key] for key in _keys("speed_limit") if key in strip.tags][:1]
        limits = [speed_in(text) for text in texts]
        unread["speed limits that are no number with a unit"] += sum(
            not isfinite(limit) for limit in limits
        )
        lanes[strip.id] = Lane(
            strip.id,
            left,
            right,
            successors=beside.after(strip),
            left_neighbour=beside.neighbour(strip, "left", same=True),
            right_neighbour=beside.neighbour(strip, "right", same=True),
            left_opposite=strip.drivable
            and beside.neighbour(strip, "left", same=False) is not None,
            right_opposite=strip.drivable
            and beside.neighbour(strip, "right", same=False) is not None,
            speed_limit=min(filter(isfinite, limits), default=nan),
            drivable=strip.drivable,
            left_crossable=crossable(strip.left, near=-1),
            right_crossable=crossable(strip.right, near=0),
            kind=strip.tags.get("subtype", "lanelet")
            + f"+{IN_JUNCTION}" * ("intersection_area" in strip.tags),
        )
    notes += [f"{count} {ignored} are ignored." for ignored, count in sorted((+unread).items())]
    doubled = len(beside.ends) - len(set(beside.ends.values()))
    if doubled:
        notes.append(
            f"{doubled} ends of boundaries lie within {SAME_M} m of another one: they are taken as "
            "the same."
        )
    return lanes


def crossable(bound: Bound, *, near: int) -> bool:
    """Return whether a car on the lane may cross its boundary; `near`: index of a double marking's
    near part.
    """
    allowed = next((bound.tags[key] for key in _keys("lane_change") if key in bound.tags), None)
    if allowed is not None:
        return allowed in ("yes", "true", "1")
    parts = bound.tags.get("subtype", "").split("_")
    if bound.tags.get("type") in ("line_thin", "line_thick"):
        return (parts[::-1] if bound.against else parts)[near] == "dashed"
    return bound.tags.get("type", "") in _OPEN


def _keys(key: str) -> tuple[str, ...]:
    """Return the forms of a key for cars, for vehicles, and for all."""
    return f"{key}:vehicle:car", f"{key}:vehicle", key


def speed_in(text: str) -> float:
    """Parse a speed ("50", "30 mph", "8.3 m/s", "de274-60"), m/s; NaN if there is no positive
    speed.
    """
    sign = _SIGN_274.fullmatch(text)
    match = _SPEED.fullmatch(sign[1] if sign is not None else text.strip().lower())
    if match is None or float(match[1]) <= 0.0 or float(match[1]) >= 1e4:
        return nan
    return float(match[1]) * _UNITS.get(match[2] or "", _KPH)
