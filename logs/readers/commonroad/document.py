"""Parses CommonRoad XML (versions 2018b and 2020a) into records, in the coordinates and time steps
of the file.

Source of the format: CommonRoad, "XML format documentation", versions 2018b and 2020a. The other
modules of this package decide what a record means for a Scenario.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from replan.core.arrays import FloatArray, frozen
from replan.core.errors import LogError, in_file
from replan.core.files import read_xml
from replan.logs.readers.commonroad.document_records import (
    PRIORITY_SIGNS,
    STOP_SIGNS,
    YIELD_SIGNS,
    Document,
    GoalState,
    Incoming,
    Intersection,
    Lanelet,
    LightCycle,
    Obstacle,
    OccupiedSet,
    PlanningProblem,
    Stop,
)
from replan.logs.readers.commonroad.elements import (
    child,
    integer,
    interval,
    middle,
    missing,
    number,
    point_in,
    points_in,
    references,
)
from replan.logs.rules import Colour

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

VERSIONS = ("2018b", "2020a")
OBSTACLE_TAGS = ("obstacle", "staticObstacle", "dynamicObstacle")
CIRCLE_CORNERS = 24
"""Number of corners of the outline of a circle."""
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
READ_SIGNS = STOP_SIGNS | YIELD_SIGNS | PRIORITY_SIGNS


def parse(path: Path) -> Document:
    """Read a file; LogError if it is not CommonRoad or of another version, or an element is missing
    or no number.
    """
    with in_file(path):
        return _document(read_xml(path))


def _document(root: Element) -> Document:
    if root.tag != "commonRoad":
        problem, remedy = (
            f"root element is <{root.tag}>",
            "give a CommonRoad scenario (<commonRoad>)",
        )
        raise LogError(problem, remedy=remedy)
    version = root.get("commonRoadVersion", "?")
    if version not in VERSIONS:
        remedy = f"save it as one of {', '.join(VERSIONS)}"
        raise LogError(f"CommonRoad version {version}", remedy=remedy)
    step_place = "commonRoad@timeStepSize"
    dt = number(root.get("timeStepSize"), step_place)
    if not dt > 0.0:
        raise LogError(f"time step of {dt} s", topic=step_place, remedy="it must be positive")
    signs, limits = _signs(root)
    lanelets = tuple(_lanelet(element, limits) for element in root.findall("lanelet"))
    if not lanelets:
        raise LogError("no lanelet", remedy="a CommonRoad scenario without a road cannot be driven")
    tags = root.find("scenarioTags")
    obstacles = (element for tag in OBSTACLE_TAGS for element in root.findall(tag))
    return Document(
        root.get("benchmarkID", ""),
        version,
        dt,
        root.get("source", ""),
        root.get("author", ""),
        root.get("affiliation", ""),
        tuple(root.get("tags", "").split() if tags is None else (tag.tag for tag in tags)),
        lanelets,
        tuple(map(_obstacle, obstacles)),
        tuple(map(_problem, root.findall("planningProblem"))),
        tuple(_notes(root, signs)),
        tuple(map(_light, root.findall("trafficLight"))),
        signs,
        tuple(map(_intersection, root.findall("intersection"))),
    )


def _signs(root: Element) -> tuple[dict[int, frozenset[str]], dict[int, float]]:
    """Return the kinds of the traffic signs, and their lowest speed limits, m/s, by the sign's
    id.
    """
    signs: dict[int, frozenset[str]] = {}
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
    return signs, limits


def _notes(root: Element, signs: Mapping[int, frozenset[str]]) -> Iterator[str]:
    """Yield what the file holds and a Scenario does not."""
    unread = frozenset[str]().union(*signs.values()) - READ_SIGNS - {*MAX_SPEED_SIGNS}
    if unread:
        yield f"traffic signs {', '.join(sorted(unread))} are ignored"
    for tag in ("environmentObstacle", "phantomObstacle"):
        count = len(root.findall(tag))
        if count:
            yield f"{count} elements <{tag}> are ignored: they have no box on the road"
    ids = [
        obstacle.get("id", "?")
        for obstacle in root.findall("dynamicObstacle")
        if obstacle.find("occupancySet") is not None
    ]
    if ids:
        yield (
            f"obstacles {', '.join(ids)} have an occupancy set: boxes that cover it stand where "
            "they may be"
        )


def _light(element: Element) -> LightCycle:
    name = integer(element.get("id"), "trafficLight@id")
    place, cycle = f"trafficLight {name}", []
    for part in element.findall("cycle/cycleElement"):
        colour = part.findtext("color", "").strip()
        steps = number(part.findtext("duration"), f"{place}/duration")
        if colour not in COLOURS:
            remedy = f"known are {', '.join(COLOURS)}"
            raise LogError(f"no colour {colour!r}", topic=place, remedy=remedy)
        if not steps >= 1.0:
            problem = f"a duration of {steps:g} steps"
            raise LogError(problem, topic=place, remedy="it lasts one step at least")
        cycle.append((COLOURS[colour], steps))
    direction = element.findtext("direction", "all").strip() or "all"
    if direction not in DIRECTIONS:
        remedy = f"known are {', '.join(DIRECTIONS)}"
        raise LogError(f"no direction {direction!r}", topic=place, remedy=remedy)
    offset = number(element.findtext("cycle/timeOffset", "0"), f"{place}/timeOffset")
    active = element.findtext("active", "").strip() != "false"
    return LightCycle(name, tuple(cycle), offset, frozenset(DIRECTIONS[direction]), active)


def _intersection(element: Element) -> Intersection:
    place, incomings = f"intersection {integer(element.get('id'), 'intersection@id')}", []
    for incoming in element.findall("incoming"):
        successors = tuple(
            (lanelet, turn)
            for turn in TURNS
            for lanelet in references(incoming, f"successors{turn.title()}", place)
        )
        incomings.append(Incoming(references(incoming, "incomingLanelet", place), successors))
    crossings = tuple(
        lanelet
        for crossing in element.findall("crossing")
        for lanelet in references(crossing, "crossingLanelet", place)
    )
    return Intersection(tuple(incomings), crossings)


def _lanelet(element: Element, limits: Mapping[int, float]) -> Lanelet:
    name = integer(element.get("id"), "lanelet@id")
    place = f"lanelet {name}"
    left, right = (child(element, bound, place) for bound in ("leftBound", "rightBound"))
    signs = references(element, "trafficSignRef", place)
    speeds = [limits[sign] for sign in signs if sign in limits]
    speeds += [number(limit.text, f"{place}/speedLimit") for limit in element.findall("speedLimit")]
    return Lanelet(
        name,
        points_in(left, f"{place}/leftBound"),
        points_in(right, f"{place}/rightBound"),
        references(element, "successor", place),
        (_neighbour(element, "adjacentLeft", place), _neighbour(element, "adjacentRight", place)),
        (left.findtext("lineMarking", "").strip(), right.findtext("lineMarking", "").strip()),
        _texts(element, "laneletType"),
        (*_texts(element, "userOneWay"), *_texts(element, "userBidirectional")),
        min(speeds, default=float("nan")),
        _stop(element, place),
        references(element, "trafficLightRef", place),
        signs,
    )


def _texts(element: Element, tag: str) -> tuple[str, ...]:
    return tuple((part.text or "").strip() for part in element.findall(tag))


def _neighbour(element: Element, tag: str, place: str) -> tuple[int, bool] | None:
    """Return the id of a lanelet beside, and whether it leads in the same direction."""
    neighbour = element.find(tag)
    if neighbour is None:
        return None
    name = integer(neighbour.get("ref"), f"{place}/{tag}@ref")
    return name, neighbour.get("drivingDir", "same") == "same"


def _stop(element: Element, place: str) -> Stop | None:
    """Return a lanelet's stop line; None if it has none."""
    line, place = element.find("stopLine"), f"{place}/stopLine"
    if line is None:
        return None
    points = points_in(line, place)
    if len(points) == 1:
        remedy = "give its two ends, or none"
        raise LogError("a stop line of one point", topic=place, remedy=remedy)
    lights = references(line, "trafficLightRef", place)
    signs = references(line, "trafficSignRef", place)
    return Stop(points[[0, -1]] if len(points) else None, lights, signs)


def _outline(shape: Element, place: str) -> FloatArray:
    """Corners `(k, 2)` of a rectangle, circle (`CIRCLE_CORNERS`) or polygon in the frame of its
    coordinates.
    """
    if shape.tag == "polygon":
        points = points_in(shape, place)
        if len(points) > 1 and (points[0] == points[-1]).all():
            points = points[:-1]
        if len(points) < 3:
            raise _incorrect("a polygon of fewer than 3 points", place)
        return points
    element = shape.find("center")
    center = np.array((0.0, 0.0) if element is None else point_in(element, place))
    if shape.tag == "circle":
        radius = number(child(shape, "radius", place).text, f"{place}/radius")
        angle = 2.0 * np.pi * np.arange(CIRCLE_CORNERS) / CIRCLE_CORNERS
        return center + radius * np.column_stack([np.cos(angle), np.sin(angle)])
    length, width, yaw = _rectangle(shape, place)
    corners = 0.5 * np.array(
        [[length, width], [-length, width], [-length, -width], [length, -width]]
    )
    return center + corners @ np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])


def _incorrect(problem: str, place: str) -> LogError:
    return LogError(problem, topic=place, remedy="correct the element")


def _rectangle(shape: Element, place: str) -> tuple[float, float, float]:
    length = number(child(shape, "length", place).text, f"{place}/length")
    width = number(child(shape, "width", place).text, f"{place}/width")
    return length, width, number(shape.findtext("orientation", "0"), f"{place}/orientation")


def _state(element: Element, place: str, *, needs_yaw: bool) -> tuple[float, ...]:
    """One row of the states of an `Obstacle`.

    The shape that bounds an uncertain position counts by its centre.
    """
    step = middle(element, "time", place)
    yaw = middle(element, "orientation", place)
    if isnan(step):
        raise missing("time", place)
    if isnan(yaw):
        if needs_yaw:
            raise missing("orientation", place)
        yaw = 0.0
    position = child(element, "position", place)
    point = position.find("point")
    if point is not None:
        x, y = point_in(point, f"{place}/position")
    else:
        x, y = _middle_of(_shapes(position), f"{place}/position")
    v, a = middle(element, "velocity", place), middle(element, "acceleration", place)
    return step, x, y, yaw, v, a


def _shapes(element: Element | None) -> list[Element]:
    return [] if element is None else [part for part in element if part.tag in SHAPE_TAGS]


def _middle_of(shapes: list[Element], place: str) -> tuple[float, float]:
    """Return the middle of the bounds of shapes, m; LogError without a shape."""
    if not shapes:
        raise _incorrect("neither point nor shape", place)
    outline = np.vstack([_outline(shape, place) for shape in shapes])
    x, y = (0.5 * (outline.min(axis=0) + outline.max(axis=0))).tolist()
    return x, y


def _obstacle(element: Element) -> Obstacle:
    """An obstacle; a single rectangle is exact, everything else becomes its bounding box."""
    name = integer(element.get("id"), f"{element.tag}@id")
    place = f"obstacle {name}"
    shapes = list(child(element, "shape", place))
    if not shapes or any(shape.tag not in SHAPE_TAGS for shape in shapes):
        raise _incorrect("no rectangle, circle or polygon", f"{place}/shape")
    turn, outline = 0.0, np.vstack([_outline(shape, f"{place}/shape") for shape in shapes])
    low, high = outline.min(axis=0), outline.max(axis=0)
    (length, width), center = (high - low).tolist(), (0.5 * (low + high)).tolist()
    if len(shapes) == 1 and shapes[0].tag == "rectangle":
        length, width, turn = _rectangle(shapes[0], f"{place}/shape")
    if not (length > 0.0 and width > 0.0):
        problem = f"a box of {length} x {width} m"
        raise LogError(problem, topic=f"{place}/shape", remedy="sizes must be positive")
    states = _states(element, place, center, turn)
    is_static = element.tag == "staticObstacle" or element.findtext("role", "").strip() == "static"
    sets = _sets(element, f"{place}/occupancySet")
    if sets and len(states) == 1:
        step, x, y, yaw, *_ = states[0]
        ahead = 0.5 * np.array([length * np.cos(yaw), length * np.sin(yaw)])
        aside = 0.5 * np.array([-width * np.sin(yaw), width * np.cos(yaw)])
        corners = np.array([ahead + aside, aside - ahead, -ahead - aside, ahead - aside])
        sets.insert(0, OccupiedSet(step, step, (np.array([x, y]) + corners,)))
    kind = element.findtext("type", "unknown").strip()
    states = frozen(states[:1] if is_static else states)
    return Obstacle(name, kind, is_static, length, width, states, tuple(sets))


def _states(element: Element, place: str, center: list[float], turn: float) -> FloatArray:
    """Return the states of an obstacle's box, of which `center` is the middle in the frame of the
    states, m, and `turn` the heading in it, rad.
    """
    needs_yaw = element.find("shape/circle") is None
    initial = child(element, "initialState", place)
    rows = [_state(initial, f"{place}/initialState", needs_yaw=needs_yaw)]
    for i, state in enumerate(element.findall("trajectory/state")):
        rows.append(_state(state, f"{place}/trajectory/state {i}", needs_yaw=needs_yaw))
    states = np.array(rows)
    states = states[np.unique(states[:, 0], return_index=True)[1]]
    along, left = center
    _, x, y, yaw, *_ = states.T  # views
    c, s = np.cos(yaw), np.sin(yaw)
    x += along * c - left * s
    y += along * s + left * c
    yaw[:] = np.unwrap(yaw + turn)
    return states


def _sets(element: Element, place: str) -> list[OccupiedSet]:
    """Return the occupancy set of an obstacle; empty if it has none."""
    sets = []
    for occupancy in element.findall("occupancySet/occupancy"):
        steps = interval(occupancy, "time", place)
        if steps is None:
            raise missing("time", place)
        shapes = child(occupancy, "shape", place)
        outlines = tuple(_outline(shape, f"{place}/shape") for shape in shapes)
        sets.append(OccupiedSet(*steps, outlines))
    return sets


def _problem(element: Element) -> PlanningProblem:
    name = integer(element.get("id"), "planningProblem@id")
    place = f"planningProblem {name}"
    initial = child(element, "initialState", place)
    start = _state(initial, f"{place}/initialState", needs_yaw=True)
    *_, v, _ = start
    if isnan(v):
        raise missing("velocity", f"{place}/initialState")
    yaw_rate = middle(initial, "yawRate", f"{place}/initialState")
    goals = tuple(_goal(goal, f"{place}/goalState") for goal in element.findall("goalState"))
    return PlanningProblem(name, frozen(np.array(start)), yaw_rate, goals)


def _goal(element: Element, place: str) -> GoalState:
    position = element.find("position")
    regions = tuple(frozen(_outline(shape, f"{place}/position")) for shape in _shapes(position))
    lanelets = () if position is None else references(position, "lanelet", f"{place}/position")
    bounds = (interval(element, tag, place) for tag in ("time", "velocity", "orientation"))
    return GoalState(regions, lanelets, *bounds)
