"""Routes, groups of lanes and lanes of lights: for every road, and connected."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest

from replan.logs.catalogue import CATALOGUE
from replan.logs.lane_groups import connectors, lane_groups, lanes_of_lights
from replan.logs.lane_route import BEYOND_M, RouteSource, lane_route
from replan.logs.road import Goal, Road
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
