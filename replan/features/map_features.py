"""Features of the map: pieces of lanes, crosswalks, and the line of the route.

A lane of length L is cut into ceil(L / `piece_m`) pieces of equal length, whose points are equally
far apart on the middle of the lane; so a piece does not depend on where the ego is.

The line of a route is the spline through the middles of its lanes. Of lanes beside each other it
has the last: the one after a change of lanes. It begins beside the ego, at the nearest point that
leads within a right angle of the ego's heading.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replan.core.arrays import TIE, BoolArray, FloatArray, IntArray, arc_lengths
from replan.core.once import once
from replan.features.form import LIGHT_CODES, ROUTE_COLUMNS, FeatureSizes, mask, padded
from replan.logs.frame import Frame, PlannerContext
from replan.logs.polylines import along_line, points_inside, thinned
from replan.logs.reference_line import ReferenceLine
from replan.logs.road import IN_JUNCTION, Lane, Road
from replan.logs.rules import RED, Colour, StopLine
from replan.logs.states import EgoState, wrapped

SPACING_M = 1.0  # Least distance between the points that the line of a route goes through, m
DEMANDS = slice(ROUTE_COLUMNS.index("red"), ROUTE_COLUMNS.index("must_stop") + 1)
LATERAL_M = 2.5  # A stop line whose middle is farther from the line of a route is of other lanes, m


@dataclass(frozen=True, eq=False, slots=True)
class LanePieces:
    """The pieces of all drivable lanes of a road, in the order of its lanes.

    Attributes:
        points: `(m, P, 6)` middle, left and right boundary, world, m.
        lane: `(m,)` the lane of each.
    """

    points: FloatArray
    lane: IntArray


@once
def lane_pieces(road: Road, count: int, piece_m: float) -> LanePieces:
    """Return the pieces of the drivable lanes, of `count` points and at most `piece_m` m."""
    pieces, owners = list[FloatArray](), list[int]()
    for lane in road.lanes.values():
        if lane.drivable and lane.length > TIE:
            number = max(1, ceil(lane.length / piece_m - TIE))
            pieces += np.split(_resampled(lane, number, count), number)
            owners += [lane.id] * number
    return LanePieces(np.reshape(pieces, (-1, count, 6)), np.array(owners, np.int64))


def _resampled(lane: Lane, pieces: int, count: int) -> FloatArray:
    """Return the points of the pieces of a lane one after the other `(pieces * count, 6)`."""
    chord = arc_lengths(*lane.center.T)
    ends = np.linspace(0.0, chord[-1], pieces + 1)
    stations = np.concatenate([np.linspace(a, b, count) for a, b in pairwise(ends)])
    columns = np.hstack([lane.center, lane.left, lane.right]).T
    return np.column_stack([np.interp(stations, chord, column) for column in columns])


def lane_features(
    frame: Frame, context: PlannerContext, sizes: FeatureSizes
) -> dict[str, NDArray[Any]]:
    """Return the arrays `lanes` and `lanes_...` of `Features`."""
    road, ego, count = context.road, frame.ego, sizes.lanes
    pieces = lane_pieces(road, sizes.lane_points, sizes.piece_m)
    away = np.hypot(pieces.points[..., 0] - ego.x, pieces.points[..., 1] - ego.y).min(axis=1)
    rows = _nearest_rows(away, sizes.radius_m, count)
    ids = pieces.lane[rows].tolist()
    order = {lane: place for place, lane in enumerate(context.route.lanes)}
    colours = lane_colours(frame, context)
    columns = {
        "lanes_id": (np.array(ids, np.int64), -1),
        "lanes_route": (np.array([order.get(lane, -1) for lane in ids], np.int64), -1),
        "lanes_limit": (np.array([road.limit(lane) for lane in ids]), 0),
        "lanes_limit_stated": (np.isfinite([road.stated_limit(lane) for lane in ids]), 0),
        "lanes_light": (np.array([LIGHT_CODES[colours[lane]] for lane in ids], np.int64), -1),
        "lanes_junction": (np.array([_in_junction(road, lane) for lane in ids], np.bool_), 0),
    }
    return {
        "lanes": padded(_in_ego_frame(ego, pieces.points[rows]), count),
        "lanes_mask": mask(len(rows), count),
        **{name: padded(values, count, fill) for name, (values, fill) in columns.items()},
    }


def lane_colours(frame: Frame, context: PlannerContext) -> Mapping[int, Colour]:
    """Return the colour of the light that controls each lane: of several, the strictest."""
    colours = dict.fromkeys(context.road.lanes, Colour.OFF)
    for light, lanes in context.light_lanes.items():
        colour = frame.lights.get(light, Colour.OFF)
        for lane in lanes:
            before = colours.get(lane, Colour.OFF)
            colours[lane] = max(before, colour, key=LIGHT_CODES.__getitem__)
    return colours


def _in_junction(road: Road, lane: int) -> bool:
    return IN_JUNCTION in road.lanes[lane].kind.split("+")


def _nearest_rows(away: FloatArray, radius: float, count: int) -> IntArray:
    """Return the `count` rows within the radius that are nearest, the nearest first."""
    rows = np.flatnonzero(away <= radius)
    return rows[np.argsort(np.rint(away[rows] / TIE), kind="stable")][:count]


def _in_ego_frame(ego: EgoState, points: FloatArray) -> FloatArray:
    """Return pieces `(n, P, 6)` of the world as `LANE_COLUMNS` `(n, P, 8)`."""
    middle, left, right = (np.stack(ego.offset_of(*p.T)).T for p in np.split(points, 3, axis=-1))
    steps = np.diff(middle, axis=1)
    steps = np.concatenate([steps, steps[:, -1:]], axis=1)
    along = steps / np.maximum(np.linalg.norm(steps, axis=-1, keepdims=True), TIE)
    return np.concatenate([middle, along, left - middle, right - middle], axis=-1)


def crosswalk_features(
    frame: Frame, context: PlannerContext, sizes: FeatureSizes
) -> dict[str, NDArray[Any]]:
    """Return the arrays `crosswalks` and `crosswalks_mask` of `Features`."""
    outlines = _outlines(context.road, sizes.crosswalk_points)
    ego, count = frame.ego, sizes.crosswalks
    away = np.hypot(outlines[..., 0] - ego.x, outlines[..., 1] - ego.y).min(axis=1)
    rows = _nearest_rows(away, sizes.radius_m, count)
    points = np.stack(ego.offset_of(*outlines[rows].T)).T
    return {"crosswalks": padded(points, count), "crosswalks_mask": mask(len(rows), count)}


@once
def _outlines(road: Road, count: int) -> FloatArray:
    """Return `count` equally spaced points along the outline of each crosswalk `(n, count, 2)`."""
    outlines = []
    for crosswalk in road.crosswalks:
        closed = np.vstack([crosswalk.polygon, crosswalk.polygon[:1]])
        chord = arc_lengths(*closed.T)
        stations = np.linspace(0.0, chord[-1], count, endpoint=False)
        outlines.append(np.column_stack([np.interp(stations, chord, c) for c in closed.T]))
    return np.reshape(outlines, (-1, count, 2))


@dataclass(frozen=True, eq=False, slots=True)
class RouteLine:
    """The line of a route, and what lies on it.

    Attributes:
        line: The line; its station is 0 at the first lane's begin.
        sides: `(n, 3)` at each of its points: speed limit, m/s, and distance to the left and to the
            right boundary of the lane, m.
        on_crosswalk: Which of its points are on a crosswalk.
        yields: Which of its points are on a lane that gives way to another.
        stops: The stop lines on it, with their stations, m.
    """

    line: ReferenceLine
    sides: FloatArray
    on_crosswalk: BoolArray
    yields: BoolArray
    stops: tuple[tuple[StopLine, float], ...]


@once
def route_line(road: Road, lanes: tuple[int, ...]) -> RouteLine | None:
    """Return the line through the lanes of a route; None if they have no two points."""
    used = _followed(road, lanes)
    middles = [lane.center for lane in used]
    points = thinned(np.vstack(middles), SPACING_M) if middles else np.empty((0, 2))
    if len(points) < 2:
        return None
    line = ReferenceLine.through(points)
    begins = np.cumsum([0.0, *(lane.length for lane in used)])
    place = np.clip(np.searchsorted(begins, line.s) - 1, 0, len(used) - 1)
    yields = np.array([bool(lane.yields_to) for lane in used])[place]
    sides = np.zeros((len(line.s), 3))
    for k, lane in enumerate(used):
        rows = place == k
        sides[rows, 0] = road.limit(lane.id)
        chord = arc_lengths(*lane.center.T)
        half = np.hypot(*(lane.left - lane.right).T) / 2.0
        sides[rows, 1:] = np.interp(line.s[rows] - begins[k], chord, half)[:, None]
    on_crosswalk = np.zeros(len(line.s), np.bool_)
    for crosswalk in road.crosswalks:
        on_crosswalk |= points_inside(crosswalk.polygon, *np.ascontiguousarray(line.xy.T))
    stops = _stops_on(road, [lane.id for lane in used], line)
    return RouteLine(line, sides, on_crosswalk, yields, stops)


def _followed(road: Road, lanes: tuple[int, ...]) -> list[Lane]:
    """Return the lanes of a route that lead to the next one, and the last."""
    pairs = pairwise(lanes)
    leading = [lane for lane, after in pairs if after in road.lanes[lane].successors]
    return [road.lanes[lane] for lane in (*leading, *lanes[-1:])]


def _stops_on(
    road: Road, lanes: list[int], line: ReferenceLine
) -> tuple[tuple[StopLine, float], ...]:
    """Return the stop lines with a light or a stop sign that hold for the line, and where."""
    stops = []
    for stop in road.stop_lines:
        applies = not stop.towards or bool(set(stop.towards) & set(lanes))
        if stop.lane in lanes and applies and (stop.must_stop or stop.light is not None):
            x, y = stop.points.mean(axis=0)
            (station,), (away,) = along_line(line.xy, np.array([x]), np.array([y]))
            if away <= LATERAL_M:
                stops.append((stop, float(station)))
    return tuple(stops)


def route_features(
    frame: Frame, context: PlannerContext, sizes: FeatureSizes
) -> dict[str, NDArray[Any]]:
    """Return the arrays `route` and `route_mask` of `Features`; without a route they are empty."""
    count, step = sizes.route_points, sizes.route_step_m
    rows = np.zeros((count, len(ROUTE_COLUMNS)))
    route = route_line(context.road, context.route.lanes)
    if route is None:
        return {"route": rows, "route_mask": mask(0, count)}
    line, ego = route.line, frame.ego
    stations = _beside(line, ego) + step * np.arange(count)  # the first is on the line
    used = int((stations <= line.s[-1] + TIE).sum())
    stations = stations[:used]
    points = np.column_stack([np.interp(stations, line.s, column) for column in line.xy.T])
    turn = np.interp(stations, line.s, line.yaw) - ego.yaw
    nearest = np.minimum(np.rint(stations / line.s[1]).astype(np.int64), len(line.s) - 1)
    pose = (*ego.offset_of(*points.T), np.cos(turn), np.sin(turn))
    rows[:used, :8] = np.column_stack([*pose, line.kappa[nearest], route.sides[nearest]])
    rows[:used, ROUTE_COLUMNS.index("crosswalk")] = route.on_crosswalk[nearest]
    rows[:used, ROUTE_COLUMNS.index("yields")] = route.yields[nearest]
    for stop, station in route.stops:
        k, share = divmod((station - stations[0]) / step, 1.0)
        for row, weight in ((int(k), 1.0 - share), (int(k) + 1, share)):
            if k >= 0.0 and row < used:
                rows[row, DEMANDS] = np.maximum(rows[row, DEMANDS], weight * _demands(stop, frame))
    return {"route": rows, "route_mask": mask(used, count)}


def _demands(stop: StopLine, frame: Frame) -> FloatArray:
    """Return red, yellow and must_stop of a stop line, 0 or 1."""
    colour = None if stop.light is None else frame.lights.get(stop.light)
    return np.array([colour in RED, colour is Colour.YELLOW, stop.must_stop], np.float64)


def _beside(line: ReferenceLine, ego: EgoState) -> float:
    """Return the station of the line beside the ego (module docstring), m."""
    x, y = line.xy.T
    away = np.hypot(x - ego.x, y - ego.y)
    onward = np.abs(wrapped(line.yaw - ego.yaw)) <= 0.5 * np.pi
    if onward.any():
        away = np.where(onward, away, np.inf)
    near = int(np.argmin(away))
    ahead = ego.offset_of(x[near], y[near])
    turn = line.yaw[near] - ego.yaw
    # From the nearest point along the line's heading to the foot of the ego
    back = float(ahead[0]) * np.cos(turn) + float(ahead[1]) * np.sin(turn)
    return float(np.clip(line.s[near] - back, 0.0, line.s[-1]))
