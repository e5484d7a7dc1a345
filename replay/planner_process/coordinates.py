"""Planners that plan in the coordinates of the log's map.

Readers subtract a point from all positions of a log, `Scenario.origin`, so that the world begins
near the ego's start. A planner with a map of its own (a race line, a Lanelet2 map) has points in
the map's coordinates:

(1) p_map = p_world + origin

It may convert its map once, with `PlannerContext.origin`, or declare `coordinates = "map"` in its
class. Then all that it is shown (context and frames) and all that it plans is in the map's
coordinates. Plans alone are not enough: a planner that looks up the ego on its race line needs the
ego in the race line's coordinates, and one that mixes both sees agents hundreds of metres away.
Only the planner sees the map's coordinates: what is recorded and judged is in the world's. In them
`PlannerContext.origin` is (0, 0), so that code which converts its map works in both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import Any, Literal, TypeVar, get_args

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.errors import PlannerError
from replan.logs.agents import Agents
from replan.logs.edit.transform import placed_road
from replan.logs.frame import Frame, PlannerContext, Predictions, Visibility
from replan.logs.plan import Plan
from replan.logs.states import EgoState, Trajectory
from replan.planners.base import Planner
from replan.replay.parts import Factory

Coordinates = Literal["world", "map"]
"""Values of `coordinates`; a planner without it plans in the world's."""
Offset = tuple[float, float]
Placed = TypeVar("Placed", Agents, EgoState, Predictions, Trajectory, Visibility)


def coordinates_of(factory: Factory) -> Coordinates:
    """The coordinates that a factory of planners declares; PlannerError if they are not known.

    An attribute of this name that is no text is the planner's own.
    """
    while isinstance(factory, partial):
        factory = factory.func
    declared = getattr(factory, "coordinates", "world")
    if isinstance(declared, str) and declared not in get_args(Coordinates):
        raise PlannerError(f'coordinates = "{declared}" in its class is not "world" or "map"')
    return "map" if isinstance(declared, str) and declared == "map" else "world"


def built(
    factory: Factory,
    context: PlannerContext,
    more: tuple[Any, ...] = (),
    settings: Mapping[str, Any] = MappingProxyType({}),
) -> Planner:
    """Build a planner, which then plans in the world's coordinates, whichever it declares.

    `more` are its arguments after the context, and `settings` its keywords.
    """
    in_map = coordinates_of(factory) == "map"
    shown = context_in_map(context) if in_map else context
    planner: Planner = factory(shown, *more, **settings)
    return InMap(planner, context.origin) if in_map else planner


def context_in_map(context: PlannerContext) -> PlannerContext:
    """The context in the map's coordinates."""
    offset, goal = np.array(context.origin), context.goal

    def moved(points: FloatArray) -> FloatArray:
        return points + offset

    return replace(
        context,
        road=placed_road(context.road, moved),
        goal=goal
        and goal.changed(lambda part: replace(part, regions=tuple(map(moved, part.regions)))),
        start=_moved(context.start, context.origin),
        origin=(0.0, 0.0),
    )


def frame_in_map(frame: Frame, origin: Offset) -> Frame:
    """The frame of the world in the map's coordinates."""
    seen = frame.visibility
    if seen is not None:
        seen = replace(_moved(seen, origin), shadows=seen.shadows + np.array(origin))
    return replace(
        frame,
        ego=_moved(frame.ego, origin),
        agents=_moved(frame.agents, origin),
        predictions=_moved(frame.predictions, origin),
        previous=frame.previous and _moved_plan(frame.previous, origin),
        visibility=seen,
        earlier=replace(frame.earlier, offset=origin),
    )


def plan_in_world(plan: Any, origin: Offset) -> Any:
    """The plan of a map in the world's coordinates; an answer that is no plan is returned as it
    is.
    """
    return _moved_plan(plan, (-origin[0], -origin[1])) if isinstance(plan, Plan) else plan


class InMap:
    """A planner that plans in the map's coordinates, as one that plans in the world's.

    Args:
        planner: The planner, which was built from `context_in_map`.
        origin: `PlannerContext.origin` of the world.
    """

    def __init__(self, planner: Planner, origin: Offset) -> None:
        self.planner, self._origin = planner, origin

    def plan(self, frame: Frame) -> Plan:
        """The plan for a frame of the world."""
        plan: Plan = plan_in_world(
            self.planner.plan(frame_in_map(frame, self._origin)), self._origin
        )
        return plan


def _moved(noun: Placed, offset: Offset) -> Placed:
    return replace(noun, x=noun.x + offset[0], y=noun.y + offset[1])  # (1)


def _moved_plan(plan: Plan, offset: Offset) -> Plan:
    return plan.changed(partial(_moved, offset=offset))
