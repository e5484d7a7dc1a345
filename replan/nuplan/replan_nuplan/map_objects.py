"""Lanes, connectors, roadblocks, polylines and areas as the devkit's planners ask for them.

Sources: `nuplan.common.maps.abstract_map_objects` and its implementation `nuplan_map` (devkit
1.2.2). Polylines have a pose every `SPACING_M`, as nuPlan's maps: planners count poses. Ids are
texts of numbers, one namespace over all objects. A roadblock of connectors is called
`NuPlanRoadBlockConnector`, since planners compare the name of its class.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from nuplan.common.actor_state.state_representation import Point2D, StateSE2
from nuplan.common.maps.abstract_map_objects import (
    Lane,
    LaneConnector,
    PolygonMapObject,
    PolylineMapObject,
    RoadBlockGraphEdgeMapObject,
)
from nuplan.common.maps.maps_datatypes import LaneConnectorType
from shapely.geometry import LineString, Point, Polygon
from shapely.ops import unary_union

SPACING_M = 0.25
SLIT_M = 0.01
"""Gaps between the lanes of a roadblock up to twice this are closed."""


def polygon_of(outline: NDArray[np.float64]) -> Polygon:
    """The valid polygon of an outline `(k, 2)`: the largest part of one that crosses itself."""
    return _largest(Polygon(outline).buffer(0.0), outline)


def joined_polygon(polygons: list[Polygon]) -> Polygon:
    """One polygon of several; the convex hull if they do not touch."""
    whole = unary_union([polygon.buffer(SLIT_M) for polygon in polygons])
    return whole if whole.geom_type == "Polygon" else whole.convex_hull


def _largest(shape: Any, outline: NDArray[np.float64]) -> Polygon:
    if shape.geom_type == "Polygon" and not shape.is_empty:
        return shape
    parts = [part for part in getattr(shape, "geoms", ()) if part.geom_type == "Polygon"]
    if not parts:
        return LineString(outline).buffer(0.1)
    return max(parts, key=lambda part: part.area)


class OfMap:
    """A part of the map, which does not change: copies of a planner share it."""

    def __deepcopy__(self, memo: dict[int, Any]) -> Any:
        return self


class NuplanPolyline(OfMap, PolylineMapObject):
    """A line `(n, 2)` in driving direction."""

    def __init__(self, path_id: str, line: NDArray[np.float64]) -> None:
        super().__init__(path_id)
        moved = np.r_[True, np.hypot(*np.diff(line, axis=0).T) > 1e-6]
        self._line = line[moved]
        self._path: list[StateSE2] | None = None
        self._shape = LineString(self._line)

    @property
    def linestring(self) -> LineString:
        return self._shape

    @property
    def length(self) -> float:
        return float(self._shape.length)

    @property
    def discrete_path(self) -> list[StateSE2]:
        """A pose every `SPACING_M`, and at the end."""
        if self._path is None:
            steps = np.diff(self._line, axis=0)
            stations = np.r_[0.0, np.cumsum(np.hypot(*steps.T))]
            inner = np.arange(0.0, stations[-1] - 1e-3, SPACING_M)
            wanted: NDArray[np.float64] = np.append(inner, stations[-1])
            x, y = (np.interp(wanted, stations, self._line[:, axis]) for axis in (0, 1))
            places = np.clip(np.searchsorted(stations, wanted, side="right") - 1, 0, len(steps) - 1)
            heading = np.arctan2(steps[places, 1], steps[places, 0])
            self._path = [StateSE2(*pose) for pose in zip(x.tolist(), y.tolist(), heading.tolist())]
        return self._path

    def get_nearest_arc_length_from_position(self, point: Point2D) -> float:
        return float(self._shape.project(Point(point.x, point.y)))

    def get_nearest_pose_from_position(self, point: Point2D) -> StateSE2:
        path = self.discrete_path
        nearest = int(self.get_nearest_arc_length_from_position(point) / SPACING_M)
        return path[min(nearest, len(path) - 1)]

    def get_curvature_at_arc_length(self, arc_length: float) -> float:
        path = self.discrete_path
        place = min(max(int(arc_length / SPACING_M), 1), len(path) - 2) if len(path) > 2 else 0
        if not place:
            return 0.0
        turn = path[place + 1].heading - path[place - 1].heading
        return float((turn + np.pi) % (2.0 * np.pi) - np.pi) / (2.0 * SPACING_M)


class MapArea(OfMap, PolygonMapObject):
    """A crosswalk, car park or intersection."""

    def __init__(self, object_id: str, outline: NDArray[np.float64]) -> None:
        super().__init__(object_id)
        self._polygon = polygon_of(outline)

    @property
    def polygon(self) -> Polygon:
        return self._polygon


class _LaneLike(OfMap):
    """What lanes and connectors share; the map links them."""

    id: str

    def fill(
        self,
        left: NDArray[np.float64],
        right: NDArray[np.float64],
        line: NDArray[np.float64],
        limit: float | None,
    ) -> None:
        """Set what does not depend on other lanes: boundaries `(n, 2)`, the centre line `(k, 2)`,
        and the speed limit, m/s; None: not stated.
        """
        self._left, self._right = NuplanPolyline(self.id, left), NuplanPolyline(self.id, right)
        self._line, self._limit = NuplanPolyline(self.id, line), limit
        self._polygon = polygon_of(np.vstack([left, right[::-1]]))
        self.before: list[Any] = []
        self.after: list[Any] = []
        self.beside: tuple[Any, Any] = (None, None)
        self.block: Any = None
        self.has_light = False

    @property
    def baseline_path(self) -> NuplanPolyline:
        return self._line

    @property
    def left_boundary(self) -> NuplanPolyline:
        return self._left

    @property
    def right_boundary(self) -> NuplanPolyline:
        return self._right

    @property
    def polygon(self) -> Polygon:
        return self._polygon

    @property
    def speed_limit_mps(self) -> float | None:
        return self._limit

    @property
    def incoming_edges(self) -> list[Any]:
        return self.before

    @property
    def outgoing_edges(self) -> list[Any]:
        return self.after

    @property
    def parallel_edges(self) -> list[Any]:
        return [lane for lane in self.block.interior_edges if lane is not self]

    @property
    def parent(self) -> Any:
        return self.block

    @property
    def stop_lines(self) -> list[Any]:
        return []

    @property
    def index(self) -> int:
        return int(self.block.interior_edges.index(self)) + 1

    def get_roadblock_id(self) -> str:
        return str(self.block.id)

    def has_traffic_lights(self) -> bool:
        return self.has_light

    def is_left_of(self, other: Any) -> bool:
        return bool(self.index < other.index)

    def is_right_of(self, other: Any) -> bool:
        return bool(self.index > other.index)

    def get_width_left_right(
        self, point: Point2D, include_outside: bool = False
    ) -> tuple[float, float]:
        place = Point(point.x, point.y)
        return self._left.linestring.distance(place), self._right.linestring.distance(place)

    def oriented_distance(self, point: Point2D) -> float:
        nearest = self._line.get_nearest_pose_from_position(point)
        dx, dy = point.x - nearest.x, point.y - nearest.y
        return float(np.cos(nearest.heading) * dy - np.sin(nearest.heading) * dx)


class RoadLane(_LaneLike, Lane):
    """A lane outside of junctions."""

    @property
    def adjacent_edges(self) -> tuple[Any, Any]:
        return self.beside


class RoadConnector(_LaneLike, LaneConnector):
    """A lane in a junction."""

    @property
    def adjacent_edges(self) -> tuple[Any, Any]:
        return None, None

    @property
    def turn_type(self) -> LaneConnectorType:
        return LaneConnectorType.UNKNOWN


class NuPlanRoadBlock(OfMap, RoadBlockGraphEdgeMapObject):
    """Lanes beside each other, from left to right."""

    def __init__(self, block_id: str, lanes: list[Any]) -> None:
        super().__init__(block_id)
        self._lanes = lanes
        self._polygon: Polygon | None = None
        self.crossing: MapArea | None = None
        for lane in lanes:
            lane.block = self

    @property
    def interior_edges(self) -> list[Any]:
        return self._lanes

    @property
    def polygon(self) -> Polygon:
        if self._polygon is None:
            self._polygon = joined_polygon([lane.polygon for lane in self._lanes])
        return self._polygon

    @property
    def incoming_edges(self) -> list[Any]:
        return _blocks([before for lane in self._lanes for before in lane.incoming_edges], self)

    @property
    def outgoing_edges(self) -> list[Any]:
        return _blocks([after for lane in self._lanes for after in lane.outgoing_edges], self)

    @property
    def parallel_edges(self) -> list[Any]:
        return []

    @property
    def children_stop_lines(self) -> list[Any]:
        return []

    @property
    def intersection(self) -> MapArea | None:
        return self.crossing


class NuPlanRoadBlockConnector(NuPlanRoadBlock):
    """Connectors of one roadblock to another one."""


def _blocks(lanes: list[Any], own: NuPlanRoadBlock) -> list[Any]:
    return [block for block in dict.fromkeys(lane.block for lane in lanes) if block is not own]
