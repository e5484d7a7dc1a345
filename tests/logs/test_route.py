"""Route: the cheapest way through the lane graph, as brute force finds it."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from roads import along_x, curve, lanes, strip
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from replan.logs.readers.commonroad import read_commonroad
from replan.logs.road import Goal, Lane, Road
from replan.logs.route import (
    LANE_CHANGE_M,
    costs_to_go,
    find_route,
    goal_lanes,
    start_lanes,
    straight_on,
)
from replan.logs.states import EgoState

EGO = EgoState(0.0, 0.0, 0.0, 0.0, 5.0)


def steps(road: Road, lane: Lane) -> Iterator[tuple[int, float]]:
    for after in lane.successors:
        yield after, lane.length
    if lane.left_crossable and lane.left_neighbour is not None:
        yield lane.left_neighbour, LANE_CHANGE_M
    if lane.right_crossable and lane.right_neighbour is not None:
        yield lane.right_neighbour, LANE_CHANGE_M


def ways(road: Road, path: tuple[int, ...], cost: float, target: int) -> Iterator[float]:
    """The costs of all ways to a lane that visit no lane twice."""
    if path[-1] == target:
        yield cost
        return
    for after, price in steps(road, road.lanes[path[-1]]):
        if after in road.lanes and after not in path and road.lanes[after].drivable:
            yield from ways(road, (*path, after), cost + price, target)


@st.composite
def graphs(draw: st.DrawFn) -> Road:
    """Lanes 0 .. 6 of random lengths side by side, 100 m apart, with random successors and
    neighbours.
    """
    ids = st.integers(0, 7)
    found = {}
    for i in range(7):
        length = draw(st.floats(5.0, 150.0))
        points = np.array([[0.0, 100.0 * i], [0.5 * length, 100.0 * i], [length, 100.0 * i]])
        found[i] = strip(
            i,
            points,
            successors=tuple(draw(st.lists(ids, max_size=3, unique=True))),
            left_neighbour=draw(st.none() | ids),
            right_neighbour=draw(st.none() | ids),
            left_crossable=draw(st.booleans()),
            drivable=i == 0 or draw(st.integers(0, 5)) > 0,
        )
    return Road(found)


def square(x: float, y: float, half: float) -> np.ndarray:
    return np.array(
        [[x - half, y - half], [x + half, y - half], [x + half, y + half], [x - half, y + half]]
    )


@given(graphs(), st.integers(0, 6))
def test_the_route_costs_what_brute_force_finds(road: Road, target: int) -> None:
    goal = Goal((square(2.5, 100.0 * target, 1.0),))
    route, to_go = find_route(road, EGO, goal), costs_to_go(road, goal)
    costs = list(ways(road, (0,), 0.0, target)) if road.lanes[target].drivable else []
    assert (route[0] in to_go) == bool(costs)
    if not costs:
        assert route == (0,)
        return
    assert to_go[route[0]].cost == pytest.approx(min(costs))
    paid = 0.0
    for now, after in pairwise(route):
        paid += min(price for step, price in steps(road, road.lanes[now]) if step == after)
    assert route[0] == 0 and route[-1] == target and paid == pytest.approx(min(costs))


def test_without_a_goal_the_route_is_the_lane_under_the_ego() -> None:
    assert find_route(lanes(along_x(), 3), replace(EGO, y=3.5), None) == (1,)


def test_a_goal_across_two_lanes_asks_for_no_lane_change() -> None:
    """Its middle lies on the marking between them: neither a rounding nor a mirror may decide."""
    road = lanes(along_x(), 2)
    goal = Goal((np.array([[100.0, -1.75], [140.0, -1.75], [140.0, 5.25], [100.0, 5.25]]),))
    assert goal_lanes(road, goal) == {0, 1}
    assert find_route(road, EGO, goal) == (0,)
    assert find_route(road, replace(EGO, y=3.5), goal) == (1,)


def test_a_goal_beside_the_centre_line_belongs_to_the_lane_under_its_middle() -> None:
    assert goal_lanes(lanes(along_x(), 2), Goal((square(100.0, 1.2, 0.4),))) == {0}


def test_a_goal_between_two_far_points_of_a_lane_is_found() -> None:
    road = Road({0: strip(0, np.array([[0.0, 0.0], [200.0, 0.0]]))})
    assert goal_lanes(road, Goal((square(57.0, 0.0, 1.0),))) == {0}


def test_a_goal_off_the_road_has_no_lane() -> None:
    assert goal_lanes(lanes(along_x()), Goal((square(0.0, 50.0, 1.0),))) == frozenset()
    assert goal_lanes(lanes(along_x()), None) == frozenset()


def test_the_ego_starts_on_the_lane_that_runs_its_way() -> None:
    road = lanes(along_x())
    back = strip(9, along_x()[::-1])
    both = Road({9: back, **road.lanes})
    assert start_lanes(both, EGO) == (0,)
    assert start_lanes(both, replace(EGO, yaw=3.1)) == (9,)


def test_off_the_road_the_nearest_lane_is_taken() -> None:
    assert start_lanes(lanes(along_x(), 2), replace(EGO, y=9.0)) == (1,)


def test_a_sidewalk_is_no_way() -> None:
    road = lanes(along_x())
    walk = strip(5, along_x(), 4.0, 1.75, drivable=False)
    assert start_lanes(Road({5: walk, **road.lanes}), replace(EGO, y=2.0)) == (0,)


def test_straight_on_is_the_successor_that_turns_least() -> None:
    first = strip(0, curve((20.0, 0.0)), successors=(1, 2, 3))
    onward = [
        strip(i, curve((20.0, 0.0), (15.0, k))[20:]) for i, k in ((1, 0.1), (2, -0.01), (3, -0.1))
    ]
    road = Road({lane.id: lane for lane in (first, *onward)})
    assert straight_on(road, 0) == 2
    assert straight_on(road, 2) is None


def known_distances(road: Road, targets: frozenset[int]) -> dict[int, float]:
    """The least cost from each lane to the targets, by scipy's shortest paths.

    Those that have one.
    """
    ids = sorted(i for i, lane in road.lanes.items() if lane.drivable)
    at = {lane: k for k, lane in enumerate(ids)}
    price: dict[tuple[int, int], float] = {}
    for lane in ids:
        for after, cost in steps(road, road.lanes[lane]):
            if after in at:
                back = at[after], at[lane]
                price[back] = min(cost, price.get(back, np.inf))
    rows, columns = ([pair[k] for pair in price] for k in (0, 1))
    graph = sparse.csr_matrix((list(price.values()), (rows, columns)), (len(ids), len(ids)))
    sources = [at[lane] for lane in targets]
    if not sources:
        return {}
    found = dijkstra(graph, indices=sources, min_only=True)
    return {lane: float(found[k]) for lane, k in at.items() if np.isfinite(found[k])}


def assert_agrees(road: Road, ego: EgoState, goal: Goal | None) -> None:
    known = known_distances(road, goal_lanes(road, goal))
    to_go = costs_to_go(road, goal)
    assert to_go.keys() == known.keys()
    for lane, cost in known.items():
        assert to_go[lane].cost == pytest.approx(cost, rel=1e-9, abs=1e-9)
    route = find_route(road, ego, goal)
    starts = [known[lane] for lane in start_lanes(road, ego) if lane in known]
    assert (route[0] in to_go) == bool(starts)
    if starts:
        assert to_go[route[0]].cost == pytest.approx(min(starts), rel=1e-9, abs=1e-9)
        driven = [
            min(price for lane, price in steps(road, road.lanes[now]) if lane == after)
            for now, after in pairwise(route)
        ]
        assert sum(driven) == pytest.approx(to_go[route[0]].cost, rel=1e-9, abs=1e-9)
        assert route[-1] in goal_lanes(road, goal)


@pytest.mark.parametrize("stride", [8, pytest.param(1, marks=pytest.mark.slow)])
def test_on_real_lane_graphs_too(shared_data: Path, stride: int) -> None:
    """Recorded maps, each from its own start to its own goal; some of them need a lane change."""
    changes = []
    for file in sorted((shared_data / "commonroad").glob("*.xml"))[::stride]:
        scenario = read_commonroad(file)
        road, ego = scenario.road, scenario.ego.state(0)
        assert_agrees(road, ego, scenario.goal)
        to_go = costs_to_go(road, scenario.goal)
        changes += [to_go[lane].changes for lane in start_lanes(road, ego) if lane in to_go]
    assert len(changes) > 30 / stride and max(changes) >= 1


@given(graphs(), st.integers(0, 6))
def test_the_route_costs_what_an_independent_library_finds(road: Road, target: int) -> None:
    assert_agrees(road, EGO, Goal((square(2.5, 100.0 * target, 1.0),)))
