"""A planner of nuPlan's interface for tests: goes straight on, looking at all that it is given."""

from __future__ import annotations

from math import cos, sin
from typing import Any

from nuplan.common.actor_state.ego_state import EgoState
from nuplan.common.actor_state.state_representation import StateSE2, StateVector2D, TimePoint
from nuplan.common.maps.maps_datatypes import SemanticMapLayer
from nuplan.planning.simulation.observation.observation_type import DetectionsTracks
from nuplan.planning.simulation.planner.abstract_planner import AbstractPlanner
from nuplan.planning.simulation.trajectory.interpolated_trajectory import InterpolatedTrajectory

ENTRIES, STEP_US = 22, 100_000


class GoesStraight(AbstractPlanner):
    """Drives straight on at its speed; `aside`: along a line that is that far to the left of where
    the ego was first, m, and begins at the ego's projection on it, as PDM does; `fails`: the call
    in which it raises; `tires`: the share of its speed that it loses with each plan, which it
    remembers.
    """

    def __init__(self, aside: float = 0.0, fails: str = "", tires: float = 0.0) -> None:
        if fails == "constructor":
            raise ValueError("no such size of a network")
        self._aside, self._fails, self._tires = aside, fails, tires
        self._share = 1.0
        self._first: StateSE2 | None = None

    def name(self) -> str:
        return "goes straight"

    def observation_type(self) -> Any:
        return DetectionsTracks

    def initialize(self, initialization: Any) -> None:
        if self._fails == "initialize":
            raise ValueError("no checkpoint")
        self._map, self._route = initialization.map_api, initialization.route_roadblock_ids
        assert self._route, "a route is never empty"
        for block in self._route:
            assert self._block(block).interior_edges, "a block has lanes"

    def _block(self, number: str) -> Any:
        block = self._map.get_map_object(number, SemanticMapLayer.ROADBLOCK)
        return block or self._map.get_map_object(number, SemanticMapLayer.ROADBLOCK_CONNECTOR)

    def compute_planner_trajectory(self, current_input: Any) -> Any:
        if self._fails == "compute":
            raise ValueError("no plan")
        history = current_input.history
        ego, observation = history.current_state
        times = [state.time_us for state in history.ego_states]
        assert len(times) == ENTRIES and times == sorted(times)
        self._share *= 1.0 - self._tires
        assert type(observation) is DetectionsTracks
        point = ego.rear_axle.point
        layers = [SemanticMapLayer.LANE, SemanticMapLayer.LANE_CONNECTOR]
        near = self._map.get_proximal_map_objects(point=point, radius=50.0, layers=layers)
        assert set(near) == set(layers)
        for light in current_input.traffic_light_data:
            number = str(light.lane_connector_id)
            assert self._map.get_map_object(number, SemanticMapLayer.LANE_CONNECTOR)
        return InterpolatedTrajectory([self._state(ego, k) for k in range(81)])

    def _state(self, ego: EgoState, k: int) -> EgoState:
        way = self._share * ego.dynamic_car_state.speed * 0.1 * k
        axle = ego.rear_axle
        self._first = self._first or axle
        heading = self._first.heading if self._aside else axle.heading
        dx, dy = axle.x - self._first.x, axle.y - self._first.y
        gone = cos(heading) * dy - sin(heading) * dx
        left = self._aside - gone if self._aside else 0.0
        x = axle.x + way * cos(heading) - left * sin(heading)
        y = axle.y + way * sin(heading) + left * cos(heading)
        return EgoState.build_from_rear_axle(
            StateSE2(x, y, heading),
            StateVector2D(0.0, 0.0),
            StateVector2D(0.0, 0.0),
            0.0,
            TimePoint(ego.time_us + STEP_US * k),
            ego.car_footprint.vehicle_parameters,
        )


class NeedsScenario(GoesStraight):
    """Asks for nuPlan's scenario, as planners do that choose by its type."""

    requires_scenario = True

    def __init__(self, scenario: Any) -> None:
        super().__init__()
        assert scenario.scenario_type == "unknown"
