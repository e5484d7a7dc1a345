"""Makes stop lines, crosswalks, right of way and lights over time from CommonRoad lights, signs and intersections.

Stop lines. A lanelet's stop line lies where its points say, else at the lanelet's end; one without the element has a
stop line there if a light or a sign to give way is named on it (and no more on the lanelet after it). A light applies
to the turns of its direction: those of the intersection's incoming, else by the change of heading on the successor. If
several lights of a lanelet apply to one turn, the one with the fewest turns decides; while it is dark (a green arrow
that is not lit), the next one decides. Signs are ignored if a light is active.

Right of way, between the lanes inside an intersection of two different incomings, where cars on their two centre lines
would touch (`CAR_WIDTH_M`). Inside ("inner") are the lanes that follow an incoming and begin nearer to the middle
than the farthest end of an incoming; a lane that both incomings lead to lies behind their conflict. A lane waits

(1) if its sign ranks lower: stop or yield < none < priority road;
(2) else, where neither incoming has a light and their headings differ by 30 to 135 degrees: whose carriageway has fewer
    lanes, since multi-lane roads do not wait without a sign; else, where traffic keeps right, to whose right the
    other one comes from (Vienna Convention on Road Traffic, 18.4 a). If no incoming has a sign, this is an
    assumption, with a note;
(3) else, if it turns left and the other one comes from opposite (more than 135 degrees) and goes straight or right;
    where traffic keeps left, left and right change places.

Between two lit incomings the lights decide instead of (1) and (2). Without signs, incomings that merge at less than
30 degrees have no right of way.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import permutations, product
from math import atan2, radians

import numpy as np

from logs.arrays import FloatArray
from logs.maps.strips import CAR_WIDTH_M, dense
from logs.readers.commonroad.document import PRIORITY_SIGNS, STOP_SIGNS, YIELD_SIGNS, Document, Incoming, Lanelet
from logs.road import Lane, Road
from logs.rules import Colour, Crosswalk, StopLine, TrafficLight
from logs.states import wrap

MERGING, OPPOSITE, TURNING = radians(30.0), radians(135.0), radians(30.0)
SPACING_M = 0.5
UNSIGNED = 1

Turns = Mapping[tuple[int, int], str]
"""Turn by lanelet and successor."""
Heads = Mapping[int, tuple[int, ...]]
"""Light of the scenario -> lights of the file, of which the first that is not dark decides."""


@dataclass(frozen=True)
class _Approach:
    """An incoming: heading at its end (rad), lanes, rank of its signs (1), whether it is lit, turns by inner lane."""

    heading: float
    width: int
    rank: int
    lit: bool
    inner: Mapping[int, frozenset[str]]


@dataclass(frozen=True, eq=False)
class _Line:
    """A stop line before it has an id; `chain`: the file's lights that it obeys, in order of priority."""

    lane: int
    ends: FloatArray
    chain: tuple[int, ...] = ()
    must_stop: bool = False
    towards: tuple[int, ...] = ()


def with_rules(document: Document, road: Road, origin: tuple[float, float]) -> tuple[Road, Heads, tuple[str, ...]]:
    """Add the rules to the road; return it, the file's lights of each of its lights, and notes."""
    turns = _turns(document, road)
    lines: list[_Line] = []
    for lanelet in document.lanelets:
        if lanelet.id in road.lanes:
            lines += _lines(document, lanelet, road.lanes[lanelet.id], turns, origin)
    # a light of the scenario for each chain: its first one's id, or beyond all ids where that is taken
    names: dict[tuple[int, ...], int] = {}
    free = 1 + max((light.id for light in document.lights), default=0)
    for chain in dict.fromkeys(line.chain for line in lines if line.chain):
        taken = chain[0] in names.values()
        names[chain] = free if taken else chain[0]
        free += taken
    stop_lines = tuple(
        StopLine(number, line.lane, line.ends, names.get(line.chain), line.must_stop, line.towards)
        for number, line in enumerate(lines, start=1)
    )
    waits, assumed, notes = _right_of_way(document, road, turns)
    lanes = {i: replace(lane, yields_to=tuple(sorted(waits.get(i, ())))) for i, lane in road.lanes.items()}
    crossings = {i for intersection in document.intersections for i in intersection.crossings}
    marked = (lane for lane in road.lanes.values() if lane.id in crossings or "crosswalk" in lane.kind.split("+"))
    walks = tuple(Crosswalk(lane.id, lane.polygon) for lane in marked)
    known = {light.id for light in document.lights}
    unused = known - {i for chain in names for i in chain}
    if unused:
        notes.append(f"traffic lights {_comma_list(unused)} are ignored: no lane that goes their way names them")
    dark = {light.id for light in document.lights if light.active and not light.cycle}
    if dark:
        notes.append(f"traffic lights {_comma_list(dark)} have no cycle: they are taken as off")
    lost = {i for lanelet in document.lanelets for i in _lights_at(lanelet)} - known
    if lost:
        notes.append(f"traffic lights {_comma_list(lost)} are named by lanelets, but are not in the file")
    ruled = replace(road, lanes=lanes, stop_lines=stop_lines, crosswalks=walks, assumed_priority=assumed)
    return ruled, {name: chain for chain, name in names.items()}, tuple(notes)


def _comma_list(names: Iterable[int]) -> str:
    return ", ".join(map(str, sorted(names)))


# turns


def _turns(document: Document, road: Road) -> dict[tuple[int, int], str]:
    """Return the turn by lanelet and successor: from the intersections, else by the change of heading."""
    found = {
        (lanelet, successor): turn
        for intersection in document.intersections
        for incoming in intersection.incomings
        for lanelet in incoming.lanelets
        for successor, turn in incoming.successors
    }
    for lane in road.lanes.values():
        for successor in lane.successors:
            if successor in road.lanes:
                ahead = road.lanes[successor].center
                gained = wrap(_heading(ahead[-2:]) - _heading(ahead[:2]))
                turn = "straight" if abs(gained) < TURNING else "left" if gained > 0.0 else "right"
                found.setdefault((lane.id, successor), turn)
    return found


def _heading(points: FloatArray) -> float:
    """Direction from the first to the last point, rad."""
    return atan2(points[-1, 1] - points[0, 1], points[-1, 0] - points[0, 0])


# stop lines


def _lights_at(lanelet: Lanelet) -> tuple[int, ...]:
    return tuple(dict.fromkeys((*(lanelet.stop.lights if lanelet.stop else ()), *lanelet.lights)))


def _kinds_at(document: Document, lanelet: Lanelet, *, without: Collection[int] = ()) -> set[str]:
    names = {*lanelet.signs, *(lanelet.stop.signs if lanelet.stop else ())}.difference(without)
    return {kind for name in names for kind in document.signs.get(name, ())}


def _lines(document: Document, lanelet: Lanelet, lane: Lane, turns: Turns, origin: tuple[float, float]) -> list[_Line]:
    """The stop lines of a lanelet: one for each light, else one for its sign."""
    names, stop = _lights_at(lanelet), lanelet.stop
    later = [other for other in document.lanelets if stop is None and other.id in lanelet.successors]
    on_them = {i for other in later for i in (*_lights_at(other), *other.signs)}
    lights = [light for light in document.lights if light.id in names and light.id not in on_them]
    kinds = _kinds_at(document, lanelet, without=on_them)
    if stop is None and not lights and not kinds & (STOP_SIGNS | YIELD_SIGNS):
        return []
    ends = np.vstack([lane.right[-1], lane.left[-1]])
    if stop is not None and stop.ends is not None:
        ends = stop.ends - origin
    successors = [(i, turns[lane.id, i]) for i in lane.successors if (lane.id, i) in turns]
    # lights, those that count while the ones before are dark behind them -> successors (empty: all)
    governed: dict[tuple[int, ...], list[int]] = {} if successors else {(light.id,): [] for light in lights}
    for successor, turn in successors:
        meant = sorted((light for light in lights if turn in light.turns), key=lambda light: len(light.turns))
        for first in (light for light in meant if len(light.turns) == len(meant[0].turns)):
            goes_dark = not first.active or any(colour is Colour.OFF for colour, _ in first.cycle)
            others = (each.id for each in meant if goes_dark and len(each.turns) > len(first.turns))
            governed.setdefault((first.id, *others), []).append(successor)
    out = []
    for chain, some in governed.items():
        towards = () if len(some) == len(successors) else tuple(some)
        out.append(_Line(lane.id, ends, chain, towards=towards))
    must_stop = bool(kinds & STOP_SIGNS) and not any(light.active for light in lights)
    return out if out and not must_stop else [*out, _Line(lane.id, ends, must_stop=must_stop)]


def lights_of(document: Document, heads: Heads, start: float, duration: float) -> tuple[TrafficLight, ...]:
    """The lights over the time of the log: t = 0 is step `start`; it lasts `duration` s."""
    last = start + duration / document.dt
    changes = {light.id: light.changes(start, last) for light in document.lights}
    out = []
    for name, chain in heads.items():
        shown: list[tuple[float, Colour]] = []
        for step in sorted({step for i in chain for step, _ in changes[i]}):
            colours = [[each for begin, each in changes[i] if begin <= step][-1] for i in chain]
            colour = next((each for each in colours if each is not Colour.OFF), Colour.OFF)
            if not shown or shown[-1][1] is not colour:
                shown.append((step, colour))
        t = np.round([(step - start) * document.dt for step, _ in shown], 9)
        out.append(TrafficLight(name, t, tuple(colour for _, colour in shown)))
    return tuple(out)


# right of way


def _right_of_way(
    document: Document, road: Road, turns: Turns
) -> tuple[dict[int, set[int]], frozenset[int], list[str]]:
    """Return the lanes with right of way by inner lane, the inner lanes that yield by assumption, and notes."""
    waits, by_assumption = dict[int, set[int]](), set[int]()
    assumed, total = 0, len(document.intersections)
    across = "left" if road.drives_on_right else "right"
    for intersection in document.intersections:
        # lanes inside begin nearer to the middle of the incomings' ends than the farthest end
        leading = {i for incoming in intersection.incomings for i in incoming.lanelets if i in road.lanes}
        ends = np.array([road.lanes[i].center[-1] for i in leading]).reshape(-1, 2)
        middle = ends.mean(axis=0) if leading else np.zeros(2)
        radius = float(np.hypot(*(ends - middle).T).max(initial=0.0))
        later = (lane for lane in road.lanes.values() if lane.drivable and lane.id not in leading)
        zone = {lane.id for lane in later if np.hypot(*(lane.center[0] - middle)) < radius}
        found = (_approach(document, road, incoming, turns, zone) for incoming in intersection.incomings)
        approaches = [approach for approach in found if approach is not None]
        unsigned = False
        for one, other in permutations(approaches, 2):
            signed = one.rank != other.rank and not (one.lit and other.lit)
            angle = wrap(other.heading - one.heading)
            opposite, by_side = abs(angle) > OPPOSITE, False
            if not (one.lit or other.lit) and MERGING < abs(angle) <= OPPOSITE:  # (2)
                by_side = one.width < other.width or (one.width == other.width and road.drives_on_right and angle > 0.0)
            own = {i: some for i, some in one.inner.items() if i not in other.inner}
            others = {i: some for i, some in other.inner.items() if i not in one.inner}
            for lane, first in product(own, others):
                turns_across = opposite and own[lane] == {across} and others[first] != {across}
                waits_here = one.rank < other.rank if signed else by_side or turns_across  # (1), else (2) or (3)
                if waits_here and meet(road.lanes[lane].center, road.lanes[first].center):
                    waits.setdefault(lane, set()).add(first)
                    unsigned = unsigned or by_side
                    by_assumption |= {lane} if by_side and not signed else set()
        assumed += unsigned and all(approach.rank == UNSIGNED for approach in approaches)
    if not assumed:
        return waits, frozenset(by_assumption), []
    rule = "the road of more lanes goes first" + (", else who comes from the right" if road.drives_on_right else "")
    return (
        waits,
        frozenset(by_assumption),
        [f"no sign and no light at {assumed} of {total} intersections: it is assumed that {rule}"],
    )


def _approach(
    document: Document, road: Road, incoming: Incoming, turns: Turns, zone: Collection[int]
) -> _Approach | None:
    """Make an incoming's approach from its drivable lanes, or None. `zone`: the lanes inside the intersection."""
    drivable = {lane.id for lane in road.lanes.values() if lane.drivable}
    lanes = [road.lanes[i] for i in incoming.lanelets if i in drivable]
    if not lanes:
        return None
    names = frozenset(lane.id for lane in lanes)
    lanelets = [lanelet for lanelet in document.lanelets if lanelet.id in names]
    kinds = {kind for lanelet in lanelets for kind in _kinds_at(document, lanelet)}
    active = {light.id for light in document.lights if light.active}
    ends = [lane.center[-1] - lane.center[-2] for lane in lanes]
    mean = np.sum([step / np.hypot(*step) for step in ends], axis=0)
    carriageway, open_lanes = set[int](), [lane.id for lane in lanes]  # and those beside them in their direction
    while open_lanes:
        i = open_lanes.pop()
        if i in drivable and i not in carriageway:
            carriageway.add(i)
            open_lanes += [j for j in (road.lanes[i].left_neighbour, road.lanes[i].right_neighbour) if j is not None]
    inner: dict[int, set[str]] = {}
    ahead = [(i, turns[lane.id, i]) for lane in lanes for i in lane.successors if (lane.id, i) in turns]
    ahead = [(i, turn) for i, turn in ahead if i in drivable]
    while ahead:
        i, turn = ahead.pop()
        if turn not in inner.setdefault(i, set()):
            inner[i].add(turn)
            ahead += [(after, turn) for after in road.lanes[i].successors if after in zone]
    return _Approach(
        atan2(mean[1], mean[0]),
        len(carriageway),
        0 if kinds & (STOP_SIGNS | YIELD_SIGNS) else 2 if kinds & PRIORITY_SIGNS else UNSIGNED,
        any(i in active for lanelet in lanelets for i in _lights_at(lanelet)),
        {i: frozenset(some) for i, some in inner.items()},
    )


def meet(one: FloatArray, other: FloatArray) -> bool:
    """Whether cars on two centre lines `(n, 2)` would touch somewhere: their lines come nearer than a car is wide."""
    first, second = dense(one, SPACING_M), dense(other, SPACING_M)
    apart = np.hypot(*(first[:, None, :] - second[None, :, :]).transpose(2, 0, 1))
    return bool(apart.min() < CAR_WIDTH_M)
