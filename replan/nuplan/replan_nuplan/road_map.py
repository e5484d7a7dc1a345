"""The map that planners ask: the devkit's `AbstractMap` over the road of a drive.

Ids: a lane keeps its own if all lanes have one from 0 to `LARGEST_ID`, else they are numbered; then
come roadblocks, crosswalks, car parks and intersections, each in numbers of its own, since planners
mix layers. Planners ask for squares, call by keyword, and sort the answers in place: each answer is
a new list. A lane that a light controls is a connector, with those of its roadblock: planners look
for it there. Raster layers are not there.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import count
from typing import Any

import numpy as np
from nuplan.common.actor_state.state_representation import Point2D
from nuplan.common.maps.abstract_map import AbstractMap
from nuplan.common.maps.maps_datatypes import SemanticMapLayer
from shapely import STRtree
from shapely.geometry import Point, box

from .map_objects import (
    MapArea,
    NuPlanRoadBlock,
    NuPlanRoadBlockConnector,
    OfMap,
    RoadConnector,
    RoadLane,
)
from .nuplan_channel import Message, points

LARGEST_ID = 2_146_000_000
"""Planners hold ids of roadblocks as 32-bit integers; the rest of them is for other objects."""
JUNCTION = "intersection"


class RoadMap(OfMap, AbstractMap):
    """The map of a drive, from `hello.context`."""

    def __init__(self, context: Message) -> None:
        road = context["road"]
        rows = [lane for lane in road["lanes"] if lane["drivable"]]
        ids = [lane["id"] for lane in rows]
        keeps = all(0 <= i <= LARGEST_ID for i in ids)
        self.number: dict[int, int] = {i: i if keeps else k for k, i in enumerate(ids)}
        numbers = count(max(self.number.values(), default=0) + 1)
        lit = {lane for lanes in context["light_lanes"].values() for lane in lanes}
        self._lit_groups = {row["group"] for row in rows if row["id"] in lit}
        self.lanes: dict[int, Any] = {row["id"]: self._lane(row, road) for row in rows}
        for row in rows:
            self._link(row)
        for lanes in context["light_lanes"].values():
            for lane in lanes:
                if lane in self.lanes:
                    self.lanes[lane].has_light = True
        self.blocks: dict[int, NuPlanRoadBlock] = {}
        for name in dict.fromkeys(row["group"] for row in rows):
            members = _from_left([row for row in rows if row["group"] == name])
            lanes = [self.lanes[row["id"]] for row in members]
            kind = (
                NuPlanRoadBlockConnector if isinstance(lanes[0], RoadConnector) else NuPlanRoadBlock
            )
            self.blocks[name] = kind(str(next(numbers)), lanes)
        areas = {
            SemanticMapLayer.CROSSWALK: [walk["polygon"] for walk in road["crosswalks"]],
            SemanticMapLayer.CARPARK_AREA: road.get("car_parks", []),
            SemanticMapLayer.INTERSECTION: road.get("intersections", []),
        }
        self._layers: dict[SemanticMapLayer, dict[str, Any]] = {
            layer: _by_id(MapArea(str(next(numbers)), points(outline)) for outline in outlines)
            for layer, outlines in areas.items()
        }
        for layer, kind, objects in (
            (SemanticMapLayer.LANE, RoadLane, self.lanes.values()),
            (SemanticMapLayer.LANE_CONNECTOR, RoadConnector, self.lanes.values()),
            (SemanticMapLayer.ROADBLOCK, NuPlanRoadBlock, self.blocks.values()),
            (SemanticMapLayer.ROADBLOCK_CONNECTOR, NuPlanRoadBlockConnector, self.blocks.values()),
        ):
            self._layers[layer] = _by_id(item for item in objects if type(item) is kind)
        self._add_intersections(numbers)
        self._trees: dict[SemanticMapLayer, STRtree] = {}

    def _lane(self, row: Message, road: Message) -> Any:
        is_connector = JUNCTION in row["kind"].split("+") or row["group"] in self._lit_groups
        kind = RoadConnector if is_connector else RoadLane
        lane: Any = kind(str(self.number[row["id"]]))
        left, right, line = points(row["left"]), points(row["right"]), points(row["line"])
        stated = row["id"] not in road.get("assumed_limits", ()) and np.isfinite(row["speed_limit"])
        limit = float(row["speed_limit"]) if stated else None
        lane.fill(left, right, line if len(line) > 1 else 0.5 * (left + right), limit)
        return lane

    def _link(self, row: Message) -> None:
        lane = self.lanes[row["id"]]
        lane.after = [self.lanes[i] for i in row["successors"] if i in self.lanes]
        for after in lane.after:
            after.before.append(lane)
        beside = (row["left_neighbour"], row["right_neighbour"])
        lane.beside = tuple(self.lanes.get(i) for i in beside)

    def _add_intersections(self, numbers: Iterator[int]) -> None:
        """Areas of connectors, where the map has no intersections."""
        layer = self._layers[SemanticMapLayer.INTERSECTION]
        connectors = self._layers[SemanticMapLayer.ROADBLOCK_CONNECTOR].values()
        if not layer:
            outlines = [np.array(block.polygon.exterior.coords) for block in connectors]
            layer.update(_by_id(MapArea(str(next(numbers)), outline) for outline in outlines))
        for block in connectors:
            middle = block.polygon.representative_point()
            block.crossing = next((a for a in layer.values() if a.polygon.contains(middle)), None)

    @property
    def map_name(self) -> str:
        return "replan"

    def get_available_map_objects(self) -> list[SemanticMapLayer]:
        return list(self._layers)

    def get_map_object(self, object_id: str, layer: SemanticMapLayer) -> Any:
        return self._of(layer).get(str(object_id))

    def _get_roadblock(self, object_id: str) -> Any:
        """As of the devkit's own map, whose private method planners call."""
        return self.get_map_object(object_id, SemanticMapLayer.ROADBLOCK)

    def _get_roadblock_connector(self, object_id: str) -> Any:
        return self.get_map_object(object_id, SemanticMapLayer.ROADBLOCK_CONNECTOR)

    def get_all_map_objects(self, point: Point2D, layer: SemanticMapLayer) -> list[Any]:
        place = Point(point.x, point.y)
        return [item for item in self._near(place, layer) if item.polygon.intersects(place)]

    def get_one_map_object(self, point: Point2D, layer: SemanticMapLayer) -> Any:
        objects = self.get_all_map_objects(point, layer)
        assert len(objects) <= 1, "more than one object contains the point"
        return objects[0] if objects else None

    def is_in_layer(self, point: Point2D, layer: SemanticMapLayer) -> bool:
        return bool(self.get_all_map_objects(point, layer))

    def get_proximal_map_objects(
        self, point: Point2D, radius: float, layers: list[SemanticMapLayer]
    ) -> dict[SemanticMapLayer, list[Any]]:
        """The objects that a square of half side `radius` meets, by layer."""
        x, y = point.x, point.y
        square = box(x - radius, y - radius, x + radius, y + radius)
        return {
            layer: [item for item in self._near(square, layer) if item.polygon.intersects(square)]
            for layer in layers
        }

    def get_distance_to_nearest_map_object(self, point: Point2D, layer: SemanticMapLayer) -> Any:
        """Id and distance, m, of the nearest object; (None, NaN) if there is none."""
        objects = list(self._of(layer).values())
        if not objects:
            return None, np.nan
        place = Point(point.x, point.y)
        nearest = objects[int(self._tree(layer).nearest(place))]
        return nearest.id, float(nearest.polygon.distance(place))

    def _of(self, layer: SemanticMapLayer) -> dict[str, Any]:
        assert layer in self._layers, f"the map has no layer {layer.name}"
        return self._layers[layer]

    def _tree(self, layer: SemanticMapLayer) -> STRtree:
        if layer not in self._trees:
            self._trees[layer] = STRtree([item.polygon for item in self._of(layer).values()])
        return self._trees[layer]

    def _near(self, shape: Any, layer: SemanticMapLayer) -> list[Any]:
        objects = list(self._of(layer).values())
        return [objects[i] for i in sorted(self._tree(layer).query(shape).tolist())]

    def get_available_raster_layers(self) -> list[SemanticMapLayer]:
        return []

    def get_raster_map_layer(self, layer: SemanticMapLayer) -> Any:
        raise NotImplementedError("replan's map has no raster layers")

    def get_raster_map(self, layers: list[SemanticMapLayer]) -> Any:
        raise NotImplementedError("replan's map has no raster layers")

    def get_distance_to_nearest_raster_layer(
        self, point: Point2D, layer: SemanticMapLayer
    ) -> float:
        raise NotImplementedError("replan's map has no raster layers")

    def get_distances_matrix_to_nearest_map_object(self, *arguments: Any) -> Any:
        raise NotImplementedError("replan's map has no matrix of distances")

    def initialize_all_layers(self) -> None:
        """All layers are there."""


def _by_id(objects: Iterable[Any]) -> dict[str, Any]:
    return {item.id: item for item in objects}


def _from_left(rows: list[Message]) -> list[Message]:
    """The lanes of a group from left to right; those that no neighbour leads to come last."""
    by_id = {row["id"]: row for row in rows}
    ordered = [row for row in rows if row["left_neighbour"] not in by_id]
    for row in ordered:  # the list grows
        beside = by_id.get(row["right_neighbour"])
        if beside is not None and beside not in ordered:
            ordered.insert(ordered.index(row) + 1, beside)
    return ordered + [row for row in rows if row not in ordered]
