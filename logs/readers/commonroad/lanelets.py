"""Makes a road from CommonRoad lanelets, lights, signs and intersections: limits, stop lines, right
of way, lights.

Speed limits. A limit that the file does not give is assumed, and the scenario says so:

(1) by the kind of road: highway 130 km/h (USA: 65 mph), country 100, ramps 80, urban and all else
    50;
(2) raised to the 85th percentile of the speeds driven on those lanes at the start, rounded up to 10
    km/h, where that is more: the speed by which traffic engineers set limits (V85), so that a
    motorway which the map calls "urban" keeps its pace. Congested traffic never lowers (1); what
    comes later does not count: a planner would know it in advance;
(3) raised to the middle of the goal's speeds, but at most a quarter more than the least of them,
    rounded up to 10 km/h, where even that is more than (1) and (2) and the goal lies on such a
    lane: it disproves the assumption.

Stop lines. A lanelet's stop line lies where its points say, else at the lanelet's end; one without
the element has a stop line there if a light or a sign to give way is named on it (and no more on
the lanelet after it). A light applies to the turns of its direction: those of the intersection's
incoming, else by the change of heading on the successor. If several lights of a lanelet apply to
one turn, the one with the fewest turns decides; while it is dark (a green arrow that is not lit),
the next one decides. Signs are ignored if a light is active.

Right of way, between the lanes inside an intersection of two different incomings, where cars on
their two centre lines would touch (`CAR_WIDTH_M`). Inside ("inner") are the lanes that follow an
incoming and begin nearer to the middle than the farthest end of an incoming; a lane that both
incomings lead to lies behind their conflict. A lane waits

(4) if its sign ranks lower: stop or yield < none < priority road;
(5) else, where neither incoming has a light and their headings differ by 30 to 135 degrees: whose
    carriageway has fewer lanes, since multi-lane roads do not wait without a sign; else, where
    traffic keeps right, to whose right the other one comes from (Vienna Convention on Road Traffic,
    18.4 a). If no incoming has a sign, this is an assumption, with a note;
(6) else, if it turns left and the other one comes from opposite (more than 135 degrees) and goes
    straight or right; where traffic keeps left, left and right change places.

Between two lit incomings the lights decide instead of (4) and (5). Without signs, incomings that
merge at less than 30 degrees have no right of way.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import permutations, product
from math import atan2, ceil, radians

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.maps.strips import CAR_WIDTH_M, dense, resampled
from replan.logs.readers.commonroad.document import PRIORITY_SIGNS, STOP_SIGNS, YIELD_SIGNS
from replan.logs.readers.commonroad.document_records import (
    Document,
    Incoming,
    Lanelet,
    PlanningProblem,
)
from replan.logs.road import Lane, Road
from replan.logs.rules import Colour, Crosswalk, StopLine, TrafficLight
from replan.logs.states import wrap

NOT_DRIVABLE = {
    "sidewalk",
    "crosswalk",
    "bicycleLane",
    "shoulder",
    "busLane",
    "busStop",
    "border",
    "restricted",
}
NOT_CROSSABLE = {"solid", "broad_solid", "solid_solid", "curb"}
LEFT_HAND_COUNTRIES = frozenset(
    (  # noqa: SIM905
        "AUS BGD BHS BRB BRN BTN BWA CYP FJI GBR GUY HKG IDN IMN IND IRL JAM JPN KEN LKA LSO MAC "
        "MDV MLT MOZ MUS MWI MYS NAM NPL NZL PAK PNG SGP SUR SWZ SYC THA TLS TTO TZA UGA ZAF ZMB "
        "ZWE"
    ).split()
)
KPH = 1.0 / 3.6
_HIGHWAY = {"highway", "interstate", "mainCarriageWay"}
_DEFAULTS = {"country": 100.0 * KPH, "accessRamp": 80.0 * KPH, "exitRamp": 80.0 * KPH}
_URBAN = 50.0 * KPH
_ENOUGH = 5
"""Least number of vehicles for (2)."""
_PLAUSIBLE = (2.0, 45.0)
_MORE = 1.25
"""Upper bound of (3), as a factor of the goal's least speed."""


def road_of(
    document: Document,
    origin: tuple[float, float],
    driven: FloatArray,
    problem: PlanningProblem | None,
) -> tuple[Road, tuple[str, ...]]:
    """Make the road, `origin` subtracted from all points, m, and notes on assumptions.

    `driven` are positions and speeds of the traffic at the start `(m, 3)`, file coordinates, m and
    m/s, for (2); the goals of the `problem` may ask for a speed (3).
    """
    lanes, notes = {}, []
    for lanelet in document.lanelets:
        left, right = lanelet.left, lanelet.right
        keep = np.zeros(0, np.bool_)
        if min(len(left), len(right)) > 1:
            if len(left) != len(right):
                count = max(len(left), len(right))
                left, right = resampled(left, count), resampled(right, count)
            keep = np.r_[True, np.hypot(*np.diff(0.5 * (left + right), axis=0).T) > 1e-3]
        if keep.sum() < 2:
            notes.append(f"lanelet {lanelet.id} is dropped: its boundaries are no strip")
            continue
        on_left, on_right = lanelet.beside
        for_cars = not lanelet.users or {"car", "vehicle"} & set(lanelet.users)
        lanes[lanelet.id] = Lane(
            lanelet.id,
            left[keep] - origin,
            right[keep] - origin,
            successors=lanelet.successors,
            left_neighbour=on_left[0] if on_left and on_left[1] else None,
            right_neighbour=on_right[0] if on_right and on_right[1] else None,
            left_opposite=bool(on_left and not on_left[1]),
            right_opposite=bool(on_right and not on_right[1]),
            speed_limit=lanelet.speed,
            drivable=bool(for_cars) and not NOT_DRIVABLE & set(lanelet.types),
            left_crossable=_crossable(lanelet.markings[0], near=-1),
            right_crossable=_crossable(lanelet.markings[1], near=0),
            kind="+".join(lanelet.types) or "lane",
        )
    uneven = sum(len(lanelet.left) != len(lanelet.right) for lanelet in document.lanelets)
    if uneven:
        notes.append(
            f"{uneven} lanelets have boundaries of unequal point counts: resampled by arc length"
        )
    road = Road(lanes, drives_on_right=document.country not in LEFT_HAND_COUNTRIES)
    low, high = _PLAUSIBLE
    odd: defaultdict[float, int] = defaultdict(int)
    for lane in road.lanes.values():
        if lane.drivable and not (np.isnan(lane.speed_limit) or low <= lane.speed_limit <= high):
            odd[lane.speed_limit] += 1
    notes += [
        f"speed limit of {limit:g} m/s on {count} lanes is kept as given"
        for limit, count in odd.items()
    ]
    return _with_defaults(document, road, origin, driven - (*origin, 0.0), problem, notes), tuple(
        notes
    )


def _crossable(marking: str, *, near: int) -> bool:
    """Whether a marking may be crossed from the lane.

    Of a double line the near one counts ("solid_dashed").
    """
    parts = marking.split("_")
    if set(parts) == {"solid", "dashed"}:
        return parts[near] == "dashed"
    return marking not in NOT_CROSSABLE


def _with_defaults(
    document: Document,
    road: Road,
    origin: tuple[float, float],
    driven: FloatArray,
    problem: PlanningProblem | None,
    notes: list[str],
) -> Road:
    """The road with (1) to (3): the commonest default is the road's, others stand on their
    lanes.
    """
    missing: defaultdict[str, list[Lane]] = defaultdict(list)
    drivable = [lane for lane in road.lanes.values() if lane.drivable]
    for lane in drivable:
        if np.isnan(lane.speed_limit):
            # The scenario's own tag "highway" beats a lanelet's "urban"
            kinds = set(lane.kind.split("+"))
            usual = "highway" if _HIGHWAY & (kinds | set(document.tags)) else "urban"
            missing[next((kind for kind in _DEFAULTS if kind in kinds), usual)].append(lane)
    if not missing:
        return road
    goals = problem.goals if problem is not None else ()
    speeds = [goal.v for goal in goals if goal.v is not None]
    asks = bool(speeds) and len(speeds) == len(goals)  # for speeds between these, if all goals do
    least, most = min((v[0] for v in speeds), default=0.0), max((v[1] for v in speeds), default=0.0)
    on_goal = {i for goal in goals for i in goal.lanelets}
    for region in (region for goal in goals if asks for region in goal.regions):
        places = (
            np.vstack([region, 0.5 * (region + np.roll(region, 1, axis=0)), region.mean(axis=0)])
            - origin
        )
        on_goal |= {lane.id for x, y in places for lane in road.lanes_at(float(x), float(y))}
    assumed = {}
    for group, lanes in sorted(missing.items(), key=lambda item: (-len(item[1]), item[0])):
        ids, moving = {lane.id for lane in lanes}, driven[driven[:, 2] > 2.0]
        limit, why = _DEFAULTS.get(group, _URBAN), f"{group} default"  # (1)
        if group == "highway":
            limit = 65.0 * 1.609344 * KPH if document.country == "USA" else 130.0 * KPH
        pace = np.array(
            [v for x, y, v in moving if any(lane.id in ids for lane in road.lanes_at(x, y))]
        )
        if len(pace) >= _ENOUGH:
            typical = _rounded_up(float(np.percentile(pace, 85)))
            if typical > limit:  # (2)
                limit, why = (
                    typical,
                    f"85th percentile of the speeds at the start, above the {group} default,",
                )
        if asks and least > limit and ids & on_goal:  # (3)
            limit = _rounded_up(min(0.5 * (least + most), _MORE * least))
            why = f"the goal asks for {least:.0f} m/s, above the {why.rstrip(',')}:"
        assumed[group] = limit
        words = f"{limit:.2f} m/s ({limit / KPH:.0f} km/h)"
        notes.append(
            f"speed limit missing on {len(lanes)} of {len(drivable)} lanes: {why} {words} assumed"
        )
    default = next(iter(assumed.values()))
    changed = {
        lane.id: assumed[g]
        for g, lanes in missing.items()
        for lane in lanes
        if assumed[g] != default
    }
    by_id = {
        i: replace(lane, speed_limit=changed.get(i, lane.speed_limit))
        for i, lane in road.lanes.items()
    }
    return replace(
        road, lanes=by_id, default_speed_limit=default, assumed_limits=frozenset(changed)
    )


def _rounded_up(speed: float) -> float:
    return ceil(speed / (10.0 * KPH) - 1e-6) * 10.0 * KPH


# Lights, signs and intersections

MERGING, OPPOSITE, TURNING = radians(30.0), radians(135.0), radians(30.0)
SPACING_M = 0.5
UNSIGNED = 1

Turns = Mapping[tuple[int, int], str]
"""Turn by lanelet and successor."""
Heads = Mapping[int, tuple[int, ...]]
"""Light of the scenario -> lights of the file, of which the first that is not dark decides."""


@dataclass(frozen=True)
class _Approach:
    """An incoming: heading at its end (rad), lanes, rank of its signs (4), whether it is lit, turns
    by inner lane.
    """

    heading: float
    width: int
    rank: int
    lit: bool
    inner: Mapping[int, frozenset[str]]


@dataclass(frozen=True, eq=False)
class _Line:
    """A stop line before it has an id; `chain`: the file's lights that it obeys, in order of
    priority.
    """

    lane: int
    ends: FloatArray
    chain: tuple[int, ...] = ()
    must_stop: bool = False
    towards: tuple[int, ...] = ()


def with_rules(
    document: Document, road: Road, origin: tuple[float, float]
) -> tuple[Road, Heads, tuple[str, ...]]:
    """Add the rules to the road; return it, the file's lights of each of its lights, and notes."""
    turns = _turns(document, road)
    lines: list[_Line] = []
    for lanelet in document.lanelets:
        if lanelet.id in road.lanes:
            lines += _lines(document, lanelet, road.lanes[lanelet.id], turns, origin)
    # a light of the scenario for each chain: its first one's id, or beyond all ids where that is
    # taken
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
    lanes = {
        i: replace(lane, yields_to=tuple(sorted(waits.get(i, ()))))
        for i, lane in road.lanes.items()
    }
    crossings = {i for intersection in document.intersections for i in intersection.crossings}
    marked = (
        lane
        for lane in road.lanes.values()
        if lane.id in crossings or "crosswalk" in lane.kind.split("+")
    )
    walks = tuple(Crosswalk(lane.id, lane.polygon) for lane in marked)
    known = {light.id for light in document.lights}
    unused = known - {i for chain in names for i in chain}
    if unused:
        notes.append(
            f"traffic lights {_comma_list(unused)} are ignored: no lane that goes their way names "
            "them"
        )
    dark = {light.id for light in document.lights if light.active and not light.cycle}
    if dark:
        notes.append(f"traffic lights {_comma_list(dark)} have no cycle: they are taken as off")
    lost = {i for lanelet in document.lanelets for i in _lights_at(lanelet)} - known
    if lost:
        notes.append(
            f"traffic lights {_comma_list(lost)} are named by lanelets, but are not in the file"
        )
    ruled = replace(
        road, lanes=lanes, stop_lines=stop_lines, crosswalks=walks, assumed_priority=assumed
    )
    return ruled, {name: chain for chain, name in names.items()}, tuple(notes)


def _comma_list(names: Iterable[int]) -> str:
    return ", ".join(map(str, sorted(names)))


# turns


def _turns(document: Document, road: Road) -> dict[tuple[int, int], str]:
    """Return the turn by lanelet and successor: from the intersections, else by the change of
    heading.
    """
    turns: dict[tuple[int, int], str] = {}
    for intersection in document.intersections:
        for incoming in intersection.incomings:
            for lanelet, (successor, turn) in product(incoming.lanelets, incoming.successors):
                turns[lanelet, successor] = turn
    for lane in road.lanes.values():
        for successor in lane.successors:
            if successor in road.lanes:
                ahead = road.lanes[successor].center
                gained = wrap(_heading(ahead[-2:]) - _heading(ahead[:2]))
                turn = "left" if gained > 0.0 else "right"
                if abs(gained) < TURNING:
                    turn = "straight"
                turns.setdefault((lane.id, successor), turn)
    return turns


def _heading(points: FloatArray) -> float:
    return atan2(points[-1, 1] - points[0, 1], points[-1, 0] - points[0, 0])


# stop lines


def _lights_at(lanelet: Lanelet) -> tuple[int, ...]:
    return tuple(dict.fromkeys((*(lanelet.stop.lights if lanelet.stop else ()), *lanelet.lights)))


def _kinds_at(document: Document, lanelet: Lanelet, *, without: Collection[int] = ()) -> set[str]:
    names = {*lanelet.signs, *(lanelet.stop.signs if lanelet.stop else ())}.difference(without)
    return {kind for name in names for kind in document.signs.get(name, ())}


def _lines(
    document: Document, lanelet: Lanelet, lane: Lane, turns: Turns, origin: tuple[float, float]
) -> list[_Line]:
    """The stop lines of a lanelet: one for each light, else one for its sign."""
    names, stop = _lights_at(lanelet), lanelet.stop
    later = [
        other for other in document.lanelets if stop is None and other.id in lanelet.successors
    ]
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
    governed: dict[tuple[int, ...], list[int]] = (
        {} if successors else {(light.id,): [] for light in lights}
    )
    for successor, turn in successors:
        meant = sorted(
            (light for light in lights if turn in light.turns), key=lambda light: len(light.turns)
        )
        for first in (light for light in meant if len(light.turns) == len(meant[0].turns)):
            goes_dark = not first.active or any(colour is Colour.OFF for colour, _ in first.cycle)
            others = (
                light.id for light in meant if goes_dark and len(light.turns) > len(first.turns)
            )
            governed.setdefault((first.id, *others), []).append(successor)
    stop_lines = []
    for chain, controls in governed.items():
        towards = () if len(controls) == len(successors) else tuple(controls)
        stop_lines.append(_Line(lane.id, ends, chain, towards=towards))
    must_stop = bool(kinds & STOP_SIGNS) and not any(light.active for light in lights)
    if must_stop or not stop_lines:
        stop_lines.append(_Line(lane.id, ends, must_stop=must_stop))
    return stop_lines


def lights_of(
    document: Document, heads: Heads, start: float, duration: float
) -> tuple[TrafficLight, ...]:
    """The lights over the time of the log: t = 0 is step `start`; it lasts `duration` s."""
    last = start + duration / document.dt
    changes = {light.id: light.changes(start, last) for light in document.lights}
    lights = []
    for name, chain in heads.items():
        shown: list[tuple[float, Colour]] = []
        for step in sorted({step for i in chain for step, _ in changes[i]}):
            colours = [[colour for begin, colour in changes[i] if begin <= step][-1] for i in chain]
            colour = next((colour for colour in colours if colour is not Colour.OFF), Colour.OFF)
            if not shown or shown[-1][1] is not colour:
                shown.append((step, colour))
        t = np.round([(step - start) * document.dt for step, _ in shown], 9)
        lights.append(TrafficLight(name, t, tuple(colour for _, colour in shown)))
    return tuple(lights)


# right of way


def _right_of_way(
    document: Document, road: Road, turns: Turns
) -> tuple[dict[int, set[int]], frozenset[int], list[str]]:
    """Return the lanes with right of way by inner lane, the inner lanes that yield by assumption,
    and notes.
    """
    waits, by_assumption = dict[int, set[int]](), set[int]()
    assumed, total = 0, len(document.intersections)
    across = "left" if road.drives_on_right else "right"
    for intersection in document.intersections:
        # lanes inside begin nearer to the middle of the incomings' ends than the farthest end
        lanelets = (i for incoming in intersection.incomings for i in incoming.lanelets)
        leading = {i for i in lanelets if i in road.lanes}
        ends = np.array([road.lanes[i].center[-1] for i in leading]).reshape(-1, 2)
        middle = ends.mean(axis=0) if leading else np.zeros(2)
        radius = float(np.hypot(*(ends - middle).T).max(initial=0.0))
        later = (lane for lane in road.lanes.values() if lane.drivable and lane.id not in leading)
        zone = {lane.id for lane in later if np.hypot(*(lane.center[0] - middle)) < radius}
        sides = (
            _approach(document, road, incoming, turns, zone) for incoming in intersection.incomings
        )
        approaches = [approach for approach in sides if approach is not None]
        unsigned = False
        for side, other in permutations(approaches, 2):
            signed = side.rank != other.rank and not (side.lit and other.lit)
            angle = wrap(other.heading - side.heading)
            opposite, by_side = abs(angle) > OPPOSITE, False
            if not (side.lit or other.lit) and MERGING < abs(angle) <= OPPOSITE:  # (5)
                by_side = side.width < other.width or (
                    side.width == other.width and road.drives_on_right and angle > 0.0
                )
            own = {i: turns_to for i, turns_to in side.inner.items() if i not in other.inner}
            others = {i: turns_to for i, turns_to in other.inner.items() if i not in side.inner}
            for lane, first in product(own, others):
                turns_across = opposite and own[lane] == {across} and others[first] != {across}
                # (4), else (5) or (6)
                waits_here = side.rank < other.rank if signed else by_side or turns_across
                if waits_here and meet(road.lanes[lane].center, road.lanes[first].center):
                    waits.setdefault(lane, set()).add(first)
                    unsigned = unsigned or by_side
                    by_assumption |= {lane} if by_side and not signed else set()
        assumed += unsigned and all(approach.rank == UNSIGNED for approach in approaches)
    if not assumed:
        return waits, frozenset(by_assumption), []
    rule = "the road of more lanes goes first" + (
        ", else who comes from the right" if road.drives_on_right else ""
    )
    return (
        waits,
        frozenset(by_assumption),
        [f"no sign and no light at {assumed} of {total} intersections: it is assumed that {rule}"],
    )


def _approach(
    document: Document, road: Road, incoming: Incoming, turns: Turns, zone: Collection[int]
) -> _Approach | None:
    """Make an incoming's approach from its drivable lanes, or None.

    `zone`: the lanes inside the intersection.
    """
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
    # And those beside them in their direction
    carriageway, open_lanes = set[int](), [lane.id for lane in lanes]
    while open_lanes:
        i = open_lanes.pop()
        if i in drivable and i not in carriageway:
            carriageway.add(i)
            open_lanes += [
                j
                for j in (road.lanes[i].left_neighbour, road.lanes[i].right_neighbour)
                if j is not None
            ]
    inner: dict[int, set[str]] = {}
    ahead = [
        (i, turns[lane.id, i]) for lane in lanes for i in lane.successors if (lane.id, i) in turns
    ]
    ahead = [(i, turn) for i, turn in ahead if i in drivable]
    while ahead:
        i, turn = ahead.pop()
        if turn not in inner.setdefault(i, set()):
            inner[i].add(turn)
            ahead += [(after, turn) for after in road.lanes[i].successors if after in zone]
    rank = 2 if kinds & PRIORITY_SIGNS else UNSIGNED
    if kinds & (STOP_SIGNS | YIELD_SIGNS):
        rank = 0
    return _Approach(
        atan2(mean[1], mean[0]),
        len(carriageway),
        rank,
        any(i in active for lanelet in lanelets for i in _lights_at(lanelet)),
        {i: frozenset(turns_to) for i, turns_to in inner.items()},
    )


def meet(one: FloatArray, other: FloatArray) -> bool:
    """Whether cars on two centre lines `(n, 2)` would touch somewhere: their lines come nearer than
    a car is wide.
    """
    first, second = dense(one, SPACING_M), dense(other, SPACING_M)
    apart = np.hypot(*(first[:, None, :] - second[None, :, :]).transpose(2, 0, 1))
    return bool(apart.min() < CAR_WIDTH_M)
