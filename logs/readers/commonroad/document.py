"""CommonRoad XML (versions 2018b and 2020a) as plain records, in the coordinates and time steps of
the file.

Source of the format: CommonRoad, "XML format documentation", versions 2018b and 2020a;
commonroad-io, `TrafficLight.get_state_at_time_step`. The other modules of this package decide what
a record means for a Scenario. A light repeats its cycle for ever, its first element beginning at
step `offset`:

(1) it shows the element that holds the phase (step - offset) mod (sum of the durations),
        each from its begin to before its end

Functions that read an element take its place in the file for the error, and raise LogError where a
value is missing or is no number.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from replan.core.arrays import FloatArray, frozen
from replan.core.errors import LogError, in_file
from replan.core.files import read_xml
from replan.logs.rules import Colour

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

LARGEST = 1e9
"""A larger number is not a valid length, time or speed."""


def number(text: str | None, place: str) -> float:
    """The number in a text; LogError where the text is not a number, or the number is
    implausible.
    """
    try:
        value = float(text or "")
    except ValueError:
        raise LogError(
            f"{text!r} is no number", topic=place, remedy="correct the element"
        ) from None
    if not abs(value) < LARGEST:
        raise LogError(f"value is {value}", topic=place, remedy="correct the element")
    return value


def integer(text: str | None, place: str) -> int:
    """The whole number in a text."""
    return int(number(text, place))


def child(parent: Element, path: str, place: str) -> Element:
    """Return a required child element; LogError if it is missing."""
    found = parent.find(path)
    if found is None:
        raise LogError(f"<{path}> is missing", topic=place, remedy="the format requires it")
    return found


def interval(parent: Element, tag: str, place: str) -> tuple[float, float] | None:
    """Bounds of an exact value or an interval; None where the element is absent."""
    element = parent.find(tag)
    if element is None:
        return None
    exact = element.find("exact")
    if exact is not None:
        value = number(exact.text, f"{place}/{tag}")
        return value, value
    ends = (child(element, end, f"{place}/{tag}") for end in ("intervalStart", "intervalEnd"))
    low, high = (number(end.text, f"{place}/{tag}") for end in ends)
    return low, high


def middle(parent: Element, tag: str, place: str) -> float:
    """Exact value, or the middle of an interval; NaN where the element is absent."""
    bounds = interval(parent, tag, place)
    return float("nan") if bounds is None else 0.5 * (bounds[0] + bounds[1])


def references(parent: Element, tag: str, place: str) -> tuple[int, ...]:
    """Return the ids to which the children with that tag refer."""
    return tuple(integer(e.get("ref"), f"{place}/{tag}@ref") for e in parent.findall(tag))


def point_in(element: Element, place: str) -> tuple[float, float]:
    """The point of an element with <x> and <y>, m."""
    x, y = (number(child(element, axis, place).text, f"{place}/{axis}") for axis in ("x", "y"))
    return x, y


def points_in(element: Element, place: str) -> FloatArray:
    """The points `(n, 2)` of an element, m."""
    return np.array([point_in(each, place) for each in element.findall("point")]).reshape(-1, 2)


VERSIONS = ("2018b", "2020a")
OBSTACLE_TAGS = ("obstacle", "staticObstacle", "dynamicObstacle")
SHAPE_TAGS = ("rectangle", "circle", "polygon")
COLOURS = {
    "red": Colour.RED,
    "redYellow": Colour.RED_YELLOW,
    "yellow": Colour.YELLOW,
    "green": Colour.GREEN,
    "inactive": Colour.OFF,
}
TURNS = ("left", "straight", "right")
DIRECTIONS = {
    "all": TURNS,
    "leftStraight": TURNS[:2],
    "straightRight": TURNS[1:],
    "leftRight": ("left", "right"),
}
DIRECTIONS |= {turn: (turn,) for turn in TURNS}
MAX_SPEED_SIGNS = ("274", "274.1", "R2-1", "r301")
STOP_SIGNS = frozenset({"206", "R1-1"})
YIELD_SIGNS = frozenset({"205", "R1-2"})
PRIORITY_SIGNS = frozenset({"301", "306"})
READ_SIGNS = STOP_SIGNS | YIELD_SIGNS | PRIORITY_SIGNS
"""Signs of Germany (and of the format's no-man's-land) and of the USA for priority."""


@dataclass(frozen=True)
class LightCycle:
    """A traffic light: its cycle of colours and durations (time steps), (1), and the turns that it
    is for.
    """

    id: int
    cycle: tuple[tuple[Colour, float], ...]  # colours with durations; empty if the file has none
    offset: float
    turns: frozenset[str]
    active: bool  # whether the light is in use; an inactive light is OFF

    def changes(self, first: float, last: float) -> list[tuple[float, Colour]]:
        """Steps and colours by (1), from `first` on: what it shows then, and each element that
        begins until `last`.
        """
        if not self.active or not self.cycle:
            return [(first, Colour.OFF)]
        ends = list(accumulate(duration for _, duration in self.cycle))
        phase = (first - self.offset) % ends[-1]
        index = next((i for i, end in enumerate(ends) if phase < end), 0)
        shown, step = [(first, self.cycle[index][0])], first + ends[index] - phase
        while step <= last:
            index = (index + 1) % len(self.cycle)
            colour, duration = self.cycle[index]
            shown.append((step, colour))
            step += duration
        return shown


@dataclass(frozen=True, eq=False)
class Stop:
    """A lanelet's stop line: its ends `(2, 2)`, m, or None (at the lanelet's end), and its lights
    and signs.
    """

    ends: FloatArray | None
    lights: tuple[int, ...]
    signs: tuple[int, ...]


@dataclass(frozen=True)
class Incoming:
    """Lanelets that lead into an intersection from one side, and their successors in it by turn."""

    lanelets: tuple[int, ...]
    successors: tuple[tuple[int, str], ...]


@dataclass(frozen=True)
class Intersection:
    """An intersection; `crossings` are lanelets on which pedestrians cross.

    The references "isLeftOf" are not read: files use them in both senses, so sides follow from the
    geometry.
    """

    incomings: tuple[Incoming, ...]
    crossings: tuple[int, ...]


class OccupiedSet(NamedTuple):
    """Outlines `(k, 2)` that a road user may occupy from one time step to another (an instant:
    until the next set).
    """

    first: float
    last: float
    outlines: tuple[FloatArray, ...]


@dataclass(frozen=True, eq=False)
class Lanelet:
    """One lanelet: boundaries `(n, 2)` as in the file (counts may differ), references, `speed` m/s
    or NaN.
    """

    id: int
    left: FloatArray
    right: FloatArray
    successors: tuple[int, ...]
    beside: tuple[tuple[int, bool] | None, tuple[int, bool] | None]
    markings: tuple[str, str]
    types: tuple[str, ...]
    users: tuple[str, ...]
    speed: float
    stop: Stop | None  # its stop line, or None
    lights: tuple[int, ...]  # traffic lights that it names itself; `signs` likewise
    signs: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Obstacle:
    """One obstacle: its box and states `(n, 6)` of the box centre: step, x, y, yaw, v, a (NaN where
    not given).
    """

    id: int
    type: str
    static: bool
    length: float
    width: float
    states: FloatArray
    # where it may be, if the file gives no states but the first: its occupancy set, that state
    # first
    sets: tuple[OccupiedSet, ...] = ()


@dataclass(frozen=True, eq=False)
class GoalState:
    """One goal: regions `(k, 2)` or lanelets, and intervals or None; `step` in time steps."""

    regions: tuple[FloatArray, ...]
    lanelets: tuple[int, ...]
    step: tuple[float, float] | None
    v: tuple[float, float] | None
    yaw: tuple[float, float] | None


@dataclass(frozen=True, eq=False)
class PlanningProblem:
    """One planning problem: the initial state `(6,)` (columns as in `Obstacle`), its yaw rate, the
    goals.
    """

    id: int
    start: FloatArray
    yaw_rate: float
    goals: tuple[GoalState, ...]


@dataclass(frozen=True, eq=False)
class Document:
    """A whole file; `dt` is the time step, s; `notes` name what the file holds and a Scenario does
    not.
    """

    benchmark: str
    version: str
    dt: float
    source: str
    author: str
    affiliation: str
    tags: tuple[str, ...]
    lanelets: tuple[Lanelet, ...]
    obstacles: tuple[Obstacle, ...]
    problems: tuple[PlanningProblem, ...]
    notes: tuple[str, ...]
    lights: tuple[LightCycle, ...]
    # Kinds of the traffic signs ("206", "R1-1", ...) by the sign's id
    signs: Mapping[int, frozenset[str]]
    intersections: tuple[Intersection, ...]

    @property
    def country(self) -> str:
        """Three letters of the benchmark id ("C-DEU_..." -> "DEU"); "ZAM" is the format's
        no-man's-land.
        """
        return self.benchmark.removeprefix("C-")[:3]


def parse(path: Path) -> Document:
    """Read a file; LogError if it is not CommonRoad or of another version, or an element is missing
    or no number.
    """
    with in_file(path):
        return _document(read_xml(path))


def _document(root: Element) -> Document:
    if root.tag != "commonRoad":
        raise LogError(
            f"root element is <{root.tag}>", remedy="give a CommonRoad scenario (<commonRoad>)"
        )
    version = root.get("commonRoadVersion", "?")
    if version not in VERSIONS:
        raise LogError(
            f"CommonRoad version {version}", remedy=f"save it as one of {', '.join(VERSIONS)}"
        )
    dt = number(root.get("timeStepSize"), "commonRoad@timeStepSize")
    if not dt > 0.0:
        raise LogError(
            f"time step of {dt} s", topic="commonRoad@timeStepSize", remedy="it must be positive"
        )
    signs: dict[int, frozenset[str]] = {}  # kinds and lowest speed limit, m/s, by the sign's id
    limits: dict[int, float] = {}
    for sign in root.findall("trafficSign"):
        name, kinds = integer(sign.get("id"), "trafficSign@id"), set[str]()
        for element in sign.findall("trafficSignElement"):
            kind, value = element.findtext("trafficSignID", ""), element.find("additionalValue")
            kinds.add(kind.strip())
            if kind in MAX_SPEED_SIGNS and value is not None:
                limit = number(value.text, f"trafficSign {name}/additionalValue")
                limits[name] = min(limit, limits.get(name, limit))
        signs[name] = frozenset(kinds - {""})
    notes = []
    unread = {kind for kinds in signs.values() for kind in kinds} - READ_SIGNS - {*MAX_SPEED_SIGNS}
    if unread:
        notes.append(f"traffic signs {', '.join(sorted(unread))} are ignored")
    for tag in ("environmentObstacle", "phantomObstacle"):
        count = len(root.findall(tag))
        if count:
            notes.append(f"{count} elements <{tag}> are ignored: they have no box on the road")
    sets = [
        e.get("id", "?")
        for e in root.findall("dynamicObstacle")
        if e.find("occupancySet") is not None
    ]
    if sets:
        notes.append(
            f"obstacles {', '.join(sets)} have an occupancy set: boxes that cover it stand where "
            "they may be"
        )
    lanelets = tuple(_lanelet(e, limits) for e in root.findall("lanelet"))
    if not lanelets:
        raise LogError("no lanelet", remedy="a CommonRoad scenario without a road cannot be driven")
    tags = root.find("scenarioTags")
    return Document(
        root.get("benchmarkID", ""),
        version,
        dt,
        root.get("source", ""),
        root.get("author", ""),
        root.get("affiliation", ""),
        tuple(root.get("tags", "").split()) if tags is None else tuple(e.tag for e in tags),
        lanelets,
        tuple(_obstacle(e) for tag in OBSTACLE_TAGS for e in root.findall(tag)),
        tuple(_problem(e) for e in root.findall("planningProblem")),
        tuple(notes),
        tuple(_light(e) for e in root.findall("trafficLight")),
        signs,
        tuple(_intersection(e) for e in root.findall("intersection")),
    )


def _light(element: Element) -> LightCycle:
    name = integer(element.get("id"), "trafficLight@id")
    place, cycle = f"trafficLight {name}", []
    for part in element.findall("cycle/cycleElement"):
        colour, steps = (
            part.findtext("color", "").strip(),
            number(part.findtext("duration"), f"{place}/duration"),
        )
        if colour not in COLOURS:
            raise LogError(
                f"no colour {colour!r}", topic=place, remedy=f"known are {', '.join(COLOURS)}"
            )
        if not steps >= 1.0:
            raise LogError(
                f"a duration of {steps:g} steps", topic=place, remedy="it lasts one step at least"
            )
        cycle.append((COLOURS[colour], steps))
    direction = element.findtext("direction", "all").strip() or "all"
    if direction not in DIRECTIONS:
        raise LogError(
            f"no direction {direction!r}", topic=place, remedy=f"known are {', '.join(DIRECTIONS)}"
        )
    offset = number(element.findtext("cycle/timeOffset", "0"), f"{place}/timeOffset")
    active = element.findtext("active", "").strip() != "false"
    return LightCycle(name, tuple(cycle), offset, frozenset(DIRECTIONS[direction]), active)


def _intersection(element: Element) -> Intersection:
    place, incomings = f"intersection {integer(element.get('id'), 'intersection@id')}", []
    for each in element.findall("incoming"):
        successors = [
            (i, turn)
            for turn in TURNS
            for i in references(each, f"successors{turn.title()}", place)
        ]
        incomings.append(Incoming(references(each, "incomingLanelet", place), tuple(successors)))
    crossings = tuple(
        i for e in element.findall("crossing") for i in references(e, "crossingLanelet", place)
    )
    return Intersection(tuple(incomings), crossings)


def _lanelet(element: Element, limits: Mapping[int, float]) -> Lanelet:
    name = integer(element.get("id"), "lanelet@id")
    place = f"lanelet {name}"
    left, right = (child(element, bound, place) for bound in ("leftBound", "rightBound"))
    signs = references(element, "trafficSignRef", place)
    speeds = [limits[i] for i in signs if i in limits]
    speeds += [number(e.text, f"{place}/speedLimit") for e in element.findall("speedLimit")]
    beside: list[tuple[int, bool] | None] = []
    for tag in ("adjacentLeft", "adjacentRight"):
        other = element.find(tag)
        beside.append(
            None
            if other is None
            else (
                integer(other.get("ref"), f"{place}/{tag}@ref"),
                other.get("drivingDir", "same") == "same",
            )
        )
    stop, line = None, element.find("stopLine")
    if line is not None:
        points = points_in(line, f"{place}/stopLine")
        if len(points) == 1:
            raise LogError(
                "a stop line of one point",
                topic=f"{place}/stopLine",
                remedy="give its two ends, or none",
            )
        its = (
            references(line, tag, f"{place}/stopLine")
            for tag in ("trafficLightRef", "trafficSignRef")
        )
        stop = Stop(points[[0, -1]] if len(points) else None, *its)
    return Lanelet(
        name,
        points_in(left, f"{place}/leftBound"),
        points_in(right, f"{place}/rightBound"),
        references(element, "successor", place),
        (beside[0], beside[1]),
        (left.findtext("lineMarking", "").strip(), right.findtext("lineMarking", "").strip()),
        tuple((e.text or "").strip() for e in element.findall("laneletType")),
        tuple(
            (e.text or "").strip()
            for tag in ("userOneWay", "userBidirectional")
            for e in element.findall(tag)
        ),
        min(speeds, default=float("nan")),
        stop,
        references(element, "trafficLightRef", place),
        signs,
    )


def _outline(shape: Element, place: str) -> FloatArray:
    """Corners `(k, 2)` of a rectangle, circle (24 of them) or polygon in the frame that it is given
    in.
    """
    if shape.tag == "polygon":
        points = points_in(shape, place)
        if len(points) > 1 and (points[0] == points[-1]).all():
            points = points[:-1]
        if len(points) < 3:
            raise LogError(
                "a polygon of fewer than 3 points", topic=place, remedy="correct the element"
            )
        return points
    center = np.array(point_in(c, place) if (c := shape.find("center")) is not None else (0.0, 0.0))
    if shape.tag == "circle":
        radius, angle = (
            number(child(shape, "radius", place).text, f"{place}/radius"),
            2.0 * np.pi * np.arange(24) / 24,
        )
        return center + radius * np.column_stack([np.cos(angle), np.sin(angle)])
    length, width, yaw = _rectangle(shape, place)
    corners = 0.5 * np.array(
        [[length, width], [-length, width], [-length, -width], [length, -width]]
    )
    return center + corners @ np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])


def _rectangle(shape: Element, place: str) -> tuple[float, float, float]:
    size = [number(child(shape, tag, place).text, f"{place}/{tag}") for tag in ("length", "width")]
    return size[0], size[1], number(shape.findtext("orientation", "0"), f"{place}/orientation")


def _state(element: Element, place: str, *, needs_yaw: bool) -> tuple[float, ...]:
    """One row of the states of an `Obstacle`.

    The shape that bounds an uncertain position counts by its centre.
    """
    step = middle(element, "time", place)
    yaw = middle(element, "orientation", place)
    if step != step:
        raise LogError("<time> is missing", topic=place, remedy="the format requires it")
    if yaw != yaw:
        if needs_yaw:
            raise LogError("<orientation> is missing", topic=place, remedy="the format requires it")
        yaw = 0.0
    position = child(element, "position", place)
    point, shapes = position.find("point"), [e for e in position if e.tag in SHAPE_TAGS]
    if point is not None:
        x, y = point_in(point, f"{place}/position")
    elif shapes:
        outline = np.vstack([_outline(shape, f"{place}/position") for shape in shapes])
        x, y = (0.5 * (outline.min(axis=0) + outline.max(axis=0))).tolist()
    else:
        raise LogError(
            "neither point nor shape", topic=f"{place}/position", remedy="correct the element"
        )
    return (
        step,
        x,
        y,
        yaw,
        middle(element, "velocity", place),
        middle(element, "acceleration", place),
    )


def _obstacle(element: Element) -> Obstacle:
    """An obstacle; a single rectangle is exact, everything else becomes its bounding box."""
    name = integer(element.get("id"), f"{element.tag}@id")
    place = f"obstacle {name}"
    shapes = list(child(element, "shape", place))
    if not shapes or any(shape.tag not in SHAPE_TAGS for shape in shapes):
        raise LogError(
            "no rectangle, circle or polygon", topic=f"{place}/shape", remedy="correct the element"
        )
    turn, outline = 0.0, np.vstack([_outline(shape, f"{place}/shape") for shape in shapes])
    low, high = outline.min(axis=0), outline.max(axis=0)
    (length, width), (along, left) = (high - low).tolist(), (0.5 * (low + high)).tolist()
    if len(shapes) == 1 and shapes[0].tag == "rectangle":
        length, width, turn = _rectangle(shapes[0], f"{place}/shape")
    if not (length > 0.0 and width > 0.0):
        raise LogError(
            f"a box of {length} x {width} m",
            topic=f"{place}/shape",
            remedy="sizes must be positive",
        )
    needs_yaw = element.find("shape/circle") is None
    rows = [
        _state(child(element, "initialState", place), f"{place}/initialState", needs_yaw=needs_yaw)
    ]
    for i, state in enumerate(element.findall("trajectory/state")):
        rows.append(_state(state, f"{place}/trajectory/state {i}", needs_yaw=needs_yaw))
    table = np.array(rows)
    table = table[np.unique(table[:, 0], return_index=True)[1]]
    c, s = np.cos(table[:, 3]), np.sin(table[:, 3])
    table[:, 1] += along * c - left * s
    table[:, 2] += along * s + left * c
    table[:, 3] = np.unwrap(table[:, 3] + turn)
    static = element.tag == "staticObstacle" or element.findtext("role", "").strip() == "static"
    sets = []
    for each in element.findall("occupancySet/occupancy"):
        steps = interval(each, "time", f"{place}/occupancySet")
        if steps is None:
            raise LogError(
                "<time> is missing", topic=f"{place}/occupancySet", remedy="the format requires it"
            )
        shapes = list(child(each, "shape", f"{place}/occupancySet"))
        sets.append(
            OccupiedSet(
                *steps, tuple(_outline(shape, f"{place}/occupancySet/shape") for shape in shapes)
            )
        )
    if sets and len(table) == 1:
        ahead = 0.5 * np.array([length * np.cos(table[0, 3]), length * np.sin(table[0, 3])])
        aside = 0.5 * np.array([-width * np.sin(table[0, 3]), width * np.cos(table[0, 3])])
        box = table[0, 1:3] + np.array(
            [ahead + aside, aside - ahead, -ahead - aside, ahead - aside]
        )
        sets.insert(0, OccupiedSet(table[0, 0], table[0, 0], (box,)))
    kind = element.findtext("type", "unknown").strip()
    return Obstacle(
        name, kind, static, length, width, frozen(table[:1] if static else table), tuple(sets)
    )


def _problem(element: Element) -> PlanningProblem:
    name = integer(element.get("id"), "planningProblem@id")
    place = f"planningProblem {name}"
    initial = child(element, "initialState", place)
    start = np.array(_state(initial, f"{place}/initialState", needs_yaw=True))
    if start[4] != start[4]:
        raise LogError(
            "<velocity> is missing", topic=f"{place}/initialState", remedy="the format requires it"
        )
    goals, at = [], f"{place}/goalState"
    for goal in element.findall("goalState"):
        position = goal.find("position")
        regions = (
            []
            if position is None
            else [_outline(e, f"{at}/position") for e in position if e.tag in SHAPE_TAGS]
        )
        lanelets = () if position is None else references(position, "lanelet", f"{at}/position")
        bounds = (interval(goal, tag, at) for tag in ("time", "velocity", "orientation"))
        goals.append(GoalState(tuple(map(frozen, regions)), lanelets, *bounds))
    return PlanningProblem(
        name, frozen(start), middle(initial, "yawRate", f"{place}/initialState"), tuple(goals)
    )
