"""Routes, groups of lanes and lanes of lights: for every road, and connected."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from replan.logs.catalogue import CATALOGUE
from replan.logs.lane_groups import connectors, connectors_of, lane_groups, lanes_of_lights
from replan.logs.lane_route import BEYOND_M, RouteSource, lane_route
from replan.logs.road import IN_JUNCTION, Goal, Lane, Road
from replan.logs.scenario import Scenario
from replan.metrics.arrival import goal_of

LOGS = {
    name: CATALOGUE[f"everyday/{name}"].scenario()
    for name in ("junction", "traffic_light", "cut_in")
}


def assert_connected(road: Road, lanes: tuple[int, ...]) -> None:
    for lane, after in pairwise(lanes):
        assert after in (*road.lanes[lane].successors, *road.lanes[lane].sideways)


@pytest.mark.parametrize("scenario", LOGS.values(), ids=LOGS)
def test_a_route_begins_under_the_ego_is_connected_and_holds_the_goal(scenario: Scenario) -> None:
    road, start, goal = scenario.road, scenario.ego.state(0), goal_of(scenario)[0]
    route = lane_route(road, start, goal, scenario.ego)
    assert route.lanes[0] in {lane.id for lane in road.lanes_at(start.x, start.y)}
    assert_connected(road, route.lanes)
    assert route.source is RouteSource.GOAL


def test_a_route_without_a_goal_follows_the_drive_and_says_so() -> None:
    scenario = LOGS["junction"]
    route = lane_route(scenario.road, scenario.ego.state(0), None, scenario.ego)
    assert route.source is RouteSource.DRIVE
    under = {
        lane.id
        for x, y in zip(scenario.ego.x, scenario.ego.y, strict=True)
        for lane in scenario.road.lanes_at(x, y)
    }
    assert set(route.lanes) & under
    far = Goal.around(1e5, 1e5, 0.0)
    assert lane_route(scenario.road, scenario.ego.state(0), far, scenario.ego) == route


def test_lanes_that_the_log_names_come_before_the_goal() -> None:
    scenario = LOGS["junction"]
    goal = goal_of(scenario)[0]
    start = scenario.ego.state(0)
    lanes = lane_route(scenario.road, start, goal, scenario.ego).lanes
    named = replace(scenario.road, route=lanes[:2])
    route = lane_route(named, start, None, scenario.ego)
    assert route.source is RouteSource.LOG
    assert route.lanes[:2] == lanes[:2]
    elsewhere = replace(scenario.road, route=(10**6,))
    assert lane_route(elsewhere, start, goal, scenario.ego).source is RouteSource.GOAL


def test_a_route_goes_on_where_the_road_does() -> None:
    scenario = LOGS["cut_in"]
    route = lane_route(scenario.road, scenario.ego.state(0), goal_of(scenario)[0], scenario.ego)
    last = scenario.road.lanes[route.lanes[-1]]
    length = sum(scenario.road.lanes[lane].length for lane in route.lanes)
    assert length > BEYOND_M or not last.successors


def test_neighbours_are_one_group_and_stated_groups_count() -> None:
    road = LOGS["cut_in"].road
    groups = lane_groups(road)
    assert set(groups) == {lane.id for lane in road.lanes.values() if lane.drivable}
    for lane in road.lanes.values():
        for beside in (lane.left_neighbour, lane.right_neighbour):
            if beside in groups and lane.id in groups:
                assert groups[beside] == groups[lane.id]
    stated = {i: replace(lane, group=7) for i, lane in road.lanes.items()}
    assert set(lane_groups(replace(road, lanes=stated)).values()) == {7}


def straight_lane(name: int, begin: float, y: float, end_y: float, **more: object) -> Lane:
    """A lane 20 m long that goes from one lateral offset, m, to another one."""
    left = np.array([[begin, y + 1.5], [begin + 20.0, end_y + 1.5]])
    return replace(Lane(name, left, left - [0.0, 3.0]), **more)


def fork() -> Road:
    """Lanes 1 and 2 side by side; 1 leads through 3 to 5 and 2 through 4 to 6 beside it; 2 also
    turns through 7 to 8. The connectors have no neighbours.
    """
    junction = {"kind": f"urban+{IN_JUNCTION}"}
    lanes = (
        straight_lane(1, 0.0, 3.0, 3.0, successors=(3,), right_neighbour=2),
        straight_lane(2, 0.0, 0.0, 0.0, successors=(4, 7), left_neighbour=1),
        straight_lane(3, 20.0, 3.0, 3.0, successors=(5,), **junction),
        straight_lane(4, 20.0, 0.0, 0.0, successors=(6,), **junction),
        straight_lane(5, 40.0, 3.0, 3.0, right_neighbour=6),
        straight_lane(6, 40.0, 0.0, 0.0, left_neighbour=5),
        straight_lane(7, 20.0, 0.0, -15.0, successors=(8,), **junction),
        straight_lane(8, 40.0, -15.0, -30.0),
    )
    return Road({lane.id: lane for lane in lanes})


def test_connectors_between_the_same_groups_are_one_group() -> None:
    assert lane_groups(fork()) == {1: 1, 2: 1, 3: 3, 4: 3, 5: 5, 6: 5, 7: 7, 8: 8}


def test_connectors_at_the_end_of_the_road_are_grouped_as_neighbours() -> None:
    road = fork()
    ends = {i: replace(road.lanes[i], successors=()) for i in (3, 4)}
    without_ends = replace(road, lanes=dict(road.lanes) | ends)
    assert lane_groups(without_ends)[3] != lane_groups(without_ends)[4]
    beside = {3: replace(ends[3], right_neighbour=4), 4: replace(ends[4], left_neighbour=3)}
    assert lane_groups(replace(road, lanes=dict(road.lanes) | beside))[4] == 3


def test_a_lane_beside_a_connector_is_one() -> None:
    road = fork()
    changed = {
        3: replace(road.lanes[3], right_neighbour=4, kind="urban"),
        4: replace(road.lanes[4], left_neighbour=3),
    }
    assert connectors_of(replace(road, lanes=dict(road.lanes) | changed)) == {3, 4, 7}


@pytest.mark.parametrize("name", [name for name in CATALOGUE if name.startswith("everyday/")])
def test_a_group_lies_in_a_junction_or_outside(name: str) -> None:
    road = CATALOGUE[name].scenario().road
    groups, inside = lane_groups(road), connectors_of(road)
    kinds: dict[int, set[bool]] = {}
    for lane, group in groups.items():
        kinds.setdefault(group, set()).add(lane in inside)
    assert all(len(kind) == 1 for kind in kinds.values())


def test_a_light_controls_the_lanes_behind_its_line() -> None:
    road = LOGS["traffic_light"].road
    (line,) = (line for line in road.stop_lines if line.light is not None)
    assert lanes_of_lights(road)[line.light] == road.lanes[line.lane].successors
    towards = replace(road, stop_lines=(replace(line, towards=(line.lane,)),))
    assert lanes_of_lights(towards) == {line.light: (line.lane,)}


def test_lanes_that_cross_are_connectors() -> None:
    road = LOGS["junction"].road
    lanes = tuple(road.lanes.values())
    crossing = connectors(lanes)
    assert any(crossing)
    others = [lane for lane, is_crossing in zip(lanes, crossing, strict=True) if not is_crossing]
    assert not any(connectors(others))
