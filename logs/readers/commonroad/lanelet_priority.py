"""Right of way between the lanes inside a CommonRoad intersection, from its signs, lights and
geometry.

It holds between lanes of two different incomings, where cars on their two centre lines would touch
(`CAR_WIDTH_M`). Inside ("inner") are the lanes that follow an incoming and begin nearer to the
middle than the farthest end of an incoming; a lane that both incomings lead to lies behind their
conflict. A lane waits

(1) if its sign ranks lower: stop or yield < none < priority road;
(2) else, where neither incoming has a light and their headings differ by 30 to 135 degrees: whose
    carriageway has fewer lanes, since multi-lane roads do not wait without a sign; else, where
    traffic keeps right, to whose right the other one comes from (Vienna Convention on Road Traffic,
    18.4 a). If no incoming has a sign, this is an assumption, with a note;
(3) else, if it turns left and the other one comes from opposite (more than 135 degrees) and goes
    straight or right; where traffic keeps left, left and right change places.

Between two lit incomings the lights decide instead of (1) and (2). Without signs, incomings that
merge at less than 30 degrees have no right of way.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from itertools import permutations, product
from math import atan2, radians

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.maps.strips import CAR_WIDTH_M, dense
from replan.logs.readers.commonroad.document_records import (
    PRIORITY_SIGNS,
    STOP_SIGNS,
    YIELD_SIGNS,
    Document,
    Incoming,
    Intersection,
)
from replan.logs.readers.commonroad.lanelet_turns import Turns
from replan.logs.road import Lane, Road
from replan.logs.states import wrap

MERGING = radians(30.0)
"""Incomings whose headings differ by less merge, rad."""
OPPOSITE = radians(135.0)
"""Incomings whose headings differ by more are opposite, rad."""
SPACING_M = 0.5
"""Spacing of the points of two centre lines whose distance is looked up, m."""
GIVES_WAY, UNSIGNED, PRIORITY = range(3)
"""Ranks (1) of the signs of an incoming."""


@dataclass(frozen=True)
class Approach:
    """An incoming: heading at its end (rad), lanes, rank of its signs (1), whether it is lit, turns
    by inner lane.
    """

    heading: float
    width: int
    rank: int
    lit: bool
    inner: Mapping[int, frozenset[str]]


@dataclass(frozen=True)
class RightOfWay:
    """The lanes with right of way by inner lane, the inner lanes that yield by assumption, and
    notes.
    """

    yields_to: Mapping[int, set[int]]
    assumed: frozenset[int]
    notes: list[str]


def right_of_way(document: Document, road: Road, turns: Turns) -> RightOfWay:
    """Return who has right of way inside the intersections, by (1) to (3)."""
    yields_to, by_assumption = defaultdict[int, set[int]](set), set[int]()
    assumed = 0
    for intersection in document.intersections:
        approaches = _approaches(document, road, intersection, turns)
        unsigned = False
        for own, other in permutations(approaches, 2):
            signed = own.rank != other.rank and not (own.lit and other.lit)
            by_side = _waits_by_side(own, other, road)
            for lane, first in _crossing_lanes(own, other):
                turns_across = _turns_across(own, other, lane, first, road)
                waits = by_side or turns_across
                if signed:  # (1); else (2) or (3)
                    waits = own.rank < other.rank
                if waits and meet(road.lanes[lane].center, road.lanes[first].center):
                    yields_to[lane].add(first)
                    unsigned = unsigned or by_side
                    if by_side and not signed:
                        by_assumption.add(lane)
        assumed += unsigned and all(approach.rank == UNSIGNED for approach in approaches)
    notes = []
    if assumed:
        rule = "the road of more lanes goes first" + (
            ", else who comes from the right" if road.drives_on_right else ""
        )
        notes.append(
            f"no sign and no light at {assumed} of {len(document.intersections)} intersections: "
            f"it is assumed that {rule}"
        )
    return RightOfWay(yields_to, frozenset(by_assumption), notes)


def _waits_by_side(own: Approach, other: Approach, road: Road) -> bool:
    """Whether an approach waits for another one by (2)."""
    angle = wrap(other.heading - own.heading)
    if own.lit or other.lit or not MERGING < abs(angle) <= OPPOSITE:
        return False
    from_right = road.drives_on_right and angle > 0.0
    return own.width < other.width or (own.width == other.width and from_right)


def _turns_across(own: Approach, other: Approach, lane: int, first: int, road: Road) -> bool:
    """Whether a lane turns across one of the opposite approach, (3)."""
    across = {"left" if road.drives_on_right else "right"}
    opposite = abs(wrap(other.heading - own.heading)) > OPPOSITE
    return opposite and own.inner[lane] == across and other.inner[first] != across


def _crossing_lanes(own: Approach, other: Approach) -> product[tuple[int, int]]:
    """Pairs of inner lanes to which only one of two approaches leads."""
    return product(
        [lane for lane in own.inner if lane not in other.inner],
        [lane for lane in other.inner if lane not in own.inner],
    )


def _approaches(
    document: Document, road: Road, intersection: Intersection, turns: Turns
) -> list[Approach]:
    """The approaches of an intersection that have drivable lanes."""
    lanelets = (i for incoming in intersection.incomings for i in incoming.lanelets)
    leading = {i for i in lanelets if i in road.lanes}
    ends = np.array([road.lanes[i].center[-1] for i in leading]).reshape(-1, 2)
    middle = ends.mean(axis=0) if leading else np.zeros(2)
    radius = float(np.hypot(*(ends - middle).T).max(initial=0.0))
    later = (lane for lane in road.lanes.values() if lane.drivable and lane.id not in leading)
    zone = {lane.id for lane in later if np.hypot(*(lane.center[0] - middle)) < radius}
    approaches = (
        approach_of(document, road, incoming, turns, zone) for incoming in intersection.incomings
    )
    return [approach for approach in approaches if approach is not None]


def approach_of(
    document: Document, road: Road, incoming: Incoming, turns: Turns, zone: Collection[int]
) -> Approach | None:
    """Make an incoming's approach from its drivable lanes, or None.

    `zone`: the lanes inside the intersection.
    """
    drivable = {lane.id for lane in road.lanes.values() if lane.drivable}
    lanes = [road.lanes[i] for i in incoming.lanelets if i in drivable]
    if not lanes:
        return None
    names = frozenset(lane.id for lane in lanes)
    lanelets = [lanelet for lanelet in document.lanelets if lanelet.id in names]
    kinds = {kind for lanelet in lanelets for kind in document.sign_kinds(lanelet)}
    active = {light.id for light in document.lights if light.active}
    ends = [lane.center[-1] - lane.center[-2] for lane in lanes]
    mean = np.sum([step / np.hypot(*step) for step in ends], axis=0)
    inner = _inner_lanes(road, lanes, turns, drivable, zone)
    rank = PRIORITY if kinds & PRIORITY_SIGNS else UNSIGNED
    if kinds & (STOP_SIGNS | YIELD_SIGNS):
        rank = GIVES_WAY
    return Approach(
        heading=atan2(mean[1], mean[0]),
        width=_carriageway_width(road, names, drivable),
        rank=rank,
        lit=any(i in active for lanelet in lanelets for i in lanelet.lights_here),
        inner=inner,
    )


def _carriageway_width(road: Road, names: Collection[int], drivable: Collection[int]) -> int:
    """The number of drivable lanes of an incoming, with those beside them in their direction."""
    carriageway, open_lanes = set[int](), list(names)
    while open_lanes:
        i = open_lanes.pop()
        if i in drivable and i not in carriageway:
            carriageway.add(i)
            neighbours = (road.lanes[i].left_neighbour, road.lanes[i].right_neighbour)
            open_lanes += [j for j in neighbours if j is not None]
    return len(carriageway)


def _inner_lanes(
    road: Road,
    lanes: list[Lane],
    turns: Turns,
    drivable: Collection[int],
    zone: Collection[int],
) -> dict[int, frozenset[str]]:
    """The turns to which the inner lanes behind an incoming's lanes belong."""
    inner: dict[int, set[str]] = {}
    links = ((lane.id, i) for lane in lanes for i in lane.successors)
    ahead = [(link[1], turns[link]) for link in links if link in turns and link[1] in drivable]
    while ahead:
        i, turn = ahead.pop()
        if turn not in inner.setdefault(i, set()):
            inner[i].add(turn)
            ahead += [(after, turn) for after in road.lanes[i].successors if after in zone]
    return {i: frozenset(turns_to) for i, turns_to in inner.items()}


def meet(line: FloatArray, other_line: FloatArray) -> bool:
    """Whether cars on two centre lines `(n, 2)` would touch somewhere: their lines come nearer than
    a car is wide.
    """
    first, second = dense(line, SPACING_M), dense(other_line, SPACING_M)
    apart = np.hypot(*(first[:, None, :] - second[None, :, :]).transpose(2, 0, 1))
    return bool(apart.min() < CAR_WIDTH_M)
