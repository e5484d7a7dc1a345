"""CommonRoad XML (versions 2018b and 2020a) as plain records, in the file's own coordinates and time steps.

Source of the format: CommonRoad, "XML format documentation", versions 2018b and 2020a. Nothing is judged here: what a
record means for a Scenario is decided by `commonroad.py`, `commonroad_road.py` and `commonroad_tracks.py`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from logs.errors import LogError
from logs.kernel import FloatArray, frozen

VERSIONS = ("2018b", "2020a")
MAX_SPEED_SIGNS = ("274", "274.1", "R2-1", "r301")
LARGEST = 1e9
"""Any larger number is no length, time or speed."""
_CIRCLE = 2.0 * np.pi * np.arange(24) / 24


@dataclass(frozen=True, eq=False)
class Lanelet:
    """One lanelet: boundaries `(n, 2)` as in the file (counts may differ), references, `speed` m/s or NaN."""

    id: int
    left: FloatArray
    right: FloatArray
    successors: tuple[int, ...]
    beside: tuple[tuple[int, bool] | None, tuple[int, bool] | None]
    markings: tuple[str, str]
    types: tuple[str, ...]
    users: tuple[str, ...]
    speed: float


@dataclass(frozen=True, eq=False)
class Obstacle:
    """One obstacle: its box and states `(n, 6)` of the box centre: step, x, y, yaw, v, a (NaN where not given)."""

    id: int
    type: str
    static: bool
    length: float
    width: float
    states: FloatArray


@dataclass(frozen=True, eq=False)
class GoalState:
    """One goal: regions `(k, 2)` or lanelets, and intervals or None; `step` in time steps."""

    regions: tuple[FloatArray, ...]
    lanelets: tuple[int, ...]
    step: tuple[float, float] | None
    v: tuple[float, float] | None
    yaw: tuple[float, float] | None


@dataclass(frozen=True, eq=False)
class Problem:
    """One planning problem: the initial state `(6,)` (`STATE_COLUMNS`), its yaw rate, the goals."""

    id: int
    start: FloatArray
    yaw_rate: float
    goals: tuple[GoalState, ...]


@dataclass(frozen=True, eq=False)
class Document:
    """A whole file; `dt` is the time step, s; `notes` name what the file holds and a Scenario does not."""

    benchmark: str
    version: str
    dt: float
    source: str
    author: str
    affiliation: str
    tags: tuple[str, ...]
    lanelets: tuple[Lanelet, ...]
    obstacles: tuple[Obstacle, ...]
    problems: tuple[Problem, ...]
    notes: tuple[str, ...]

    @property
    def country(self) -> str:
        """Three letters of the benchmark id ("C-DEU_..." -> "DEU"); "ZAM" is the format's no-man's-land."""
        return self.benchmark.removeprefix("C-")[:3]


def parse(path: Path) -> Document:
    """Read a file.

    Raises:
        LogError: Not XML, not CommonRoad, another version, or an element is missing or no number.
    """
    try:
        root = ElementTree.parse(path).getroot()
    except OSError as error:
        raise LogError(f"cannot be read: {error.strerror}", file=path, remedy="check the path") from error
    except (ElementTree.ParseError, ValueError) as error:
        raise LogError(f"is no complete XML: {error}", file=path, remedy="fetch the file again") from error
    try:
        return _document(root)
    except LogError as error:
        raise error.at(path) from error


def _document(root: Element) -> Document:
    if root.tag != "commonRoad":
        raise LogError(f"root element is <{root.tag}>", remedy="give a CommonRoad scenario (<commonRoad>)")
    version = root.get("commonRoadVersion", "?")
    if version not in VERSIONS:
        raise LogError(f"CommonRoad version {version}", remedy=f"save it as one of {', '.join(VERSIONS)}")
    dt = _number(root.get("timeStepSize"), "commonRoad@timeStepSize")
    if not dt > 0.0:
        raise LogError(f"time step of {dt} s", topic="commonRoad@timeStepSize", remedy="it must be positive")
    signs = _speed_signs(root)
    lanelets = tuple(_lanelet(e, signs) for e in root.findall("lanelet"))
    if not lanelets:
        raise LogError("no lanelet", remedy="a CommonRoad scenario without a road cannot be driven")
    obstacles = tuple(_obstacle(e) for tag in _OBSTACLE_TAGS for e in root.findall(tag))
    problems = tuple(_problem(e) for e in root.findall("planningProblem"))
    element = root.find("scenarioTags")
    tags = tuple(root.get("tags", "").split()) if element is None else tuple(e.tag for e in element)
    return Document(
        root.get("benchmarkID", ""),
        version,
        dt,
        root.get("source", ""),
        root.get("author", ""),
        root.get("affiliation", ""),
        tags,
        lanelets,
        obstacles,
        problems,
        tuple(_skipped(root)),
    )


_OBSTACLE_TAGS = ("obstacle", "staticObstacle", "dynamicObstacle")


def _skipped(root: Element) -> Iterator[str]:
    """What the file holds and a Scenario does not, one sentence each."""
    lights = len(root.findall("trafficLight"))
    if lights:
        yield f"{lights} traffic lights in the file are ignored"
    for tag in ("environmentObstacle", "phantomObstacle"):
        count = len(root.findall(tag))
        if count:
            yield f"{count} elements <{tag}> are ignored: they have no box on the road"
    sets = [e.get("id", "?") for e in root.findall("dynamicObstacle") if e.find("occupancySet") is not None]
    if sets:
        yield f"obstacles {', '.join(sets)} have an occupancy set: only their initial state is read"


def _number(text: str | None, place: str) -> float:
    try:
        value = float(text or "")
    except ValueError:
        raise LogError(f"{text!r} is no number", topic=place, remedy="correct the element") from None
    if not abs(value) < LARGEST:
        raise LogError(f"value is {value}", topic=place, remedy="correct the element")
    return value


def _integer(text: str | None, place: str) -> int:
    return int(_number(text, place))


def _child(parent: Element, path: str, place: str) -> Element:
    found = parent.find(path)
    if found is None:
        raise LogError(f"<{path}> is missing", topic=place, remedy="the format requires it")
    return found


def _interval(parent: Element, tag: str, place: str) -> tuple[float, float] | None:
    """Bounds of an exact value or an interval; None where the element is absent."""
    element = parent.find(tag)
    if element is None:
        return None
    exact = element.find("exact")
    if exact is not None:
        value = _number(exact.text, f"{place}/{tag}")
        return value, value
    ends = (_child(element, end, f"{place}/{tag}") for end in ("intervalStart", "intervalEnd"))
    low, high = (_number(end.text, f"{place}/{tag}") for end in ends)
    return low, high


def _middle(parent: Element, tag: str, place: str) -> float:
    """Exact value, or the middle of an interval; NaN where the element is absent."""
    bounds = _interval(parent, tag, place)
    return float("nan") if bounds is None else 0.5 * (bounds[0] + bounds[1])


def _point(element: Element, place: str) -> tuple[float, float]:
    x, y = (_number(_child(element, axis, place).text, f"{place}/{axis}") for axis in ("x", "y"))
    return x, y


def _points(element: Element, place: str) -> FloatArray:
    return np.array([_point(point, place) for point in element.findall("point")]).reshape(-1, 2)


def _speed_signs(root: Element) -> dict[str, float]:
    """Lowest speed limit per traffic sign, m/s, by its id."""
    found: dict[str, float] = {}
    for sign in root.findall("trafficSign"):
        name = sign.get("id", "?")
        for element in sign.findall("trafficSignElement"):
            value = element.find("additionalValue")
            if element.findtext("trafficSignID") in MAX_SPEED_SIGNS and value is not None:
                limit = _number(value.text, f"trafficSign {name}/additionalValue")
                found[name] = min(limit, found.get(name, limit))
    return found


def _lanelet(element: Element, signs: dict[str, float]) -> Lanelet:
    name = _integer(element.get("id"), "lanelet@id")
    place = f"lanelet {name}"
    left, right = (_child(element, bound, place) for bound in ("leftBound", "rightBound"))
    speeds = [signs[ref] for e in element.findall("trafficSignRef") if (ref := e.get("ref", "")) in signs]
    speeds += [_number(e.text, f"{place}/speedLimit") for e in element.findall("speedLimit")]
    return Lanelet(
        name,
        _points(left, f"{place}/leftBound"),
        _points(right, f"{place}/rightBound"),
        tuple(_integer(e.get("ref"), f"{place}/successor@ref") for e in element.findall("successor")),
        (_beside(element, "adjacentLeft", place), _beside(element, "adjacentRight", place)),
        (left.findtext("lineMarking", "").strip(), right.findtext("lineMarking", "").strip()),
        tuple((e.text or "").strip() for e in element.findall("laneletType")),
        tuple((e.text or "").strip() for tag in ("userOneWay", "userBidirectional") for e in element.findall(tag)),
        min(speeds, default=float("nan")),
    )


def _beside(element: Element, tag: str, place: str) -> tuple[int, bool] | None:
    """The lanelet beside and whether it is driven in the same direction."""
    found = element.find(tag)
    if found is None:
        return None
    return _integer(found.get("ref"), f"{place}/{tag}@ref"), found.get("drivingDir", "same") == "same"


def _outline(shape: Element, place: str) -> FloatArray:
    """Corners `(k, 2)` of a rectangle, circle (24 of them) or polygon in the frame that it is given in."""
    if shape.tag == "polygon":
        points = _points(shape, place)
        if len(points) > 1 and (points[0] == points[-1]).all():
            points = points[:-1]
        if len(points) < 3:
            raise LogError("a polygon of fewer than 3 points", topic=place, remedy="correct the element")
        return points
    center = np.array(_point(c, place) if (c := shape.find("center")) is not None else (0.0, 0.0))
    if shape.tag == "circle":
        radius = _number(_child(shape, "radius", place).text, f"{place}/radius")
        return center + radius * np.column_stack([np.cos(_CIRCLE), np.sin(_CIRCLE)])
    length, width, yaw = _rectangle(shape, place)
    corners = 0.5 * np.array([[length, width], [-length, width], [-length, -width], [length, -width]])
    return center + corners @ np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])


def _rectangle(shape: Element, place: str) -> tuple[float, float, float]:
    """Length, width (m) and orientation (rad) of a <rectangle>."""
    size = [_number(_child(shape, tag, place).text, f"{place}/{tag}") for tag in ("length", "width")]
    return size[0], size[1], _number(shape.findtext("orientation", "0"), f"{place}/orientation")


def _box(element: Element, place: str) -> tuple[float, float, float, float, float]:
    """An obstacle's box: length, width, and its pose (along, left, turn) in the obstacle's frame.

    A single rectangle is exact; everything else becomes its bounding box.
    """
    shapes = list(_child(element, "shape", place))
    if not shapes or any(shape.tag not in ("rectangle", "circle", "polygon") for shape in shapes):
        raise LogError("no rectangle, circle or polygon", topic=f"{place}/shape", remedy="correct the element")
    turn, outlines = 0.0, [_outline(shape, f"{place}/shape") for shape in shapes]
    low, high = np.vstack(outlines).min(axis=0), np.vstack(outlines).max(axis=0)
    length, width = high - low
    if len(shapes) == 1 and shapes[0].tag == "rectangle":
        length, width, turn = _rectangle(shapes[0], f"{place}/shape")
    if not (length > 0.0 and width > 0.0):
        raise LogError(f"a box of {length} x {width} m", topic=f"{place}/shape", remedy="sizes must be positive")
    center = 0.5 * (low + high)
    return float(length), float(width), float(center[0]), float(center[1]), turn


def _position(state: Element, place: str) -> tuple[float, float]:
    """A point, or the centre of the shape that bounds an uncertain position."""
    position = _child(state, "position", place)
    point = position.find("point")
    if point is not None:
        return _point(point, f"{place}/position")
    shapes = [e for e in position if e.tag in ("rectangle", "circle", "polygon")]
    if not shapes:
        raise LogError("neither point nor shape", topic=f"{place}/position", remedy="correct the element")
    outline = np.vstack([_outline(shape, f"{place}/position") for shape in shapes])
    x, y = 0.5 * (outline.min(axis=0) + outline.max(axis=0))
    return float(x), float(y)


def _state(element: Element, place: str, *, needs_yaw: bool) -> tuple[float, ...]:
    """One row of `STATE_COLUMNS`."""
    step = _middle(element, "time", place)
    yaw = _middle(element, "orientation", place)
    if step != step:
        raise LogError("<time> is missing", topic=place, remedy="the format requires it")
    if yaw != yaw:
        if needs_yaw:
            raise LogError("<orientation> is missing", topic=place, remedy="the format requires it")
        yaw = 0.0
    x, y = _position(element, place)
    return step, x, y, yaw, _middle(element, "velocity", place), _middle(element, "acceleration", place)


def _obstacle(element: Element) -> Obstacle:
    name = _integer(element.get("id"), f"{element.tag}@id")
    place = f"obstacle {name}"
    length, width, along, left, turn = _box(element, place)
    needs_yaw = element.find("shape/circle") is None
    rows = [_state(_child(element, "initialState", place), f"{place}/initialState", needs_yaw=needs_yaw)]
    for i, state in enumerate(element.findall("trajectory/state")):
        rows.append(_state(state, f"{place}/trajectory/state {i}", needs_yaw=needs_yaw))
    table = np.array(rows)
    table = table[np.unique(table[:, 0], return_index=True)[1]]
    c, s = np.cos(table[:, 3]), np.sin(table[:, 3])
    table[:, 1] += along * c - left * s
    table[:, 2] += along * s + left * c
    table[:, 3] = np.unwrap(table[:, 3] + turn)
    static = element.tag == "staticObstacle" or element.findtext("role", "").strip() == "static"
    kind = element.findtext("type", "unknown").strip()
    return Obstacle(name, kind, static, length, width, frozen(table[:1] if static else table))


def _problem(element: Element) -> Problem:
    name = _integer(element.get("id"), "planningProblem@id")
    place = f"planningProblem {name}"
    initial = _child(element, "initialState", place)
    start = np.array(_state(initial, f"{place}/initialState", needs_yaw=True))
    if start[4] != start[4]:
        raise LogError("<velocity> is missing", topic=f"{place}/initialState", remedy="the format requires it")
    goals = tuple(_goal(goal, f"{place}/goalState") for goal in element.findall("goalState"))
    return Problem(name, frozen(start), _middle(initial, "yawRate", f"{place}/initialState"), goals)


def _goal(element: Element, place: str) -> GoalState:
    position = element.find("position")
    shapes = [] if position is None else [e for e in position if e.tag in ("rectangle", "circle", "polygon")]
    lanelets = [] if position is None else position.findall("lanelet")
    return GoalState(
        tuple(frozen(_outline(shape, f"{place}/position")) for shape in shapes),
        tuple(_integer(e.get("ref"), f"{place}/position/lanelet@ref") for e in lanelets),
        _interval(element, "time", place),
        _interval(element, "velocity", place),
        _interval(element, "orientation", place),
    )
