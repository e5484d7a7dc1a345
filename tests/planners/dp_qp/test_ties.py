"""Rounding decides nothing: errors of 1e-9 on everything move a plan by less than 1e-6, round
figures or not.
"""

from dataclasses import replace

import numpy as np
import pytest
from drives import along, grid, moving, scenario
from followed import PERIOD_S
from hypothesis import example, given, settings, strategies as st
from roads import along_x, lanes, strip

from replan.logs.agents import AgentKind
from replan.logs.catalogue import CATALOGUE
from replan.logs.edit.transform import jittered, rotated
from replan.logs.frame import Frame, PlannerContext
from replan.logs.plan import Plan
from replan.logs.polylines import nearest, thinned
from replan.logs.reference_line import ReferenceLine
from replan.logs.road import Goal, Road
from replan.logs.route import find_route, goal_lanes, start_lanes, straight_on
from replan.logs.scenario import Scenario
from replan.logs.states import EgoState
from replan.planners.dp_qp import DpQp
from replan.planners.dp_qp.path.dp import PathDpConfig, path_dp
from replan.planners.frenet.reference_path import make_reference_path
from replan.replay.prediction import predict

TINY, SAME = 1e-9, 1e-6


def parted(one: Plan, two: Plan, turn: float = 0.0) -> float:
    """Largest difference of two plans in place and speed; `two` was made in a world turned by
    `turn`.
    """
    a, b = one.trajectory, two.trajectory
    assert (one.status, one.start, len(a)) == (two.status, two.start, len(b))
    x, y = np.cos(turn) * b.x + np.sin(turn) * b.y, np.cos(turn) * b.y - np.sin(turn) * b.x
    return float(max(np.hypot(a.x - x, a.y - y).max(), np.abs(a.v - b.v).max()))


def plans_of(log: Scenario, times: tuple[float, ...]) -> list[Plan]:
    """Plans from the logged states, each with fresh memory."""
    driver = DpQp(PlannerContext(log.road, log.goal, log.vehicle, PERIOD_S, log.ego.state(0)))
    known = [(log.ego.at(t), log.tracks.perceived(t)) for t in times]
    return [
        driver.plan(Frame(t, ego, now, predict(now, t)))
        for t, (ego, now) in zip(times, known, strict=True)
    ]


@pytest.mark.parametrize("name", CATALOGUE)
def test_plans_of_the_catalogue_do_not_depend_on_rounding(name: str) -> None:
    log = CATALOGUE[name].scenario()
    times = (0.0, 2.7)
    here = plans_of(log, times)
    for there, turn in ((jittered(rotated(log, 1e-12), TINY), 1e-12), (rotated(log, 0.5), 0.5)):
        for one, two in zip(here, plans_of(there, times), strict=True):
            assert parted(one, two, turn) < SAME


_ROUND = st.tuples(
    st.sampled_from([-20.0, -10.0, 8.0, 10.0, 15.0, 25.25, 40.0, 60.0]),
    st.sampled_from([-1.75, 0.0, 0.5, 1.75, 3.5, 7.0]),
    st.sampled_from([0.0, 0.0, 2.0, 5.0, 10.0]),
)


@pytest.mark.slow
@settings(max_examples=60)
@given(
    st.integers(1, 3), st.sampled_from([0.0, 5.0, 6.0, 10.0, 12.5]), st.lists(_ROUND, max_size=5)
)
@example(1, 0.0, [(8.0, -1.75, 0.0)])  # a bound of the speed QP lies on the optimum without bounds
def test_worlds_of_round_figures_are_like_their_neighbours(
    count: int, v: float, others: list[tuple[float, float, float]]
) -> None:
    """Others at x, y with a speed along x: on markings, beside the ego, at the ends of the
    grids.
    """
    cars = [
        (f"{i}", AgentKind.CAR, (4.5, 1.8), moving(x, y, speed, 0.0, 0.0))
        for i, (x, y, speed) in enumerate(others)
    ]
    log = scenario(along(grid(8.0, 0.1), v), cars, road=lanes(along_x(), count))
    (here,) = plans_of(log, (1.0,))
    for there, turn in (
        (jittered(log, TINY), 0.0),
        (rotated(log, 1e-12), 1e-12),
        (rotated(log, 0.5), 0.5),
    ):
        assert parted(here, *plans_of(there, (1.0,)), turn) < 1e-5


@settings(max_examples=25)
@given(st.integers(20, 300), st.sampled_from([0.5, 1.0, 2.0]), st.floats(-TINY, TINY))
def test_lines_with_round_spacings_keep_their_points(
    count: int, spacing: float, off: float
) -> None:
    points = np.column_stack([spacing * np.arange(count), np.zeros(count)])
    near = points * (1.0 + off / 100.0)
    np.testing.assert_allclose(thinned(near, 1.0), thinned(points, 1.0), atol=SAME)
    np.testing.assert_allclose(
        ReferenceLine.through(near).s, ReferenceLine.through(points).s, atol=SAME
    )
    assert nearest(near, spacing * 7.5, 0.0) == nearest(points, spacing * 7.5, 0.0) == 7


def test_two_sides_that_cost_the_same_are_passed_on_the_passing_side() -> None:
    config = PathDpConfig()
    stations, wide = 6.0 * np.arange(1, 11), np.full((10, 10), 4.0)
    for left in (True, False):
        rows = config.offsets(passes_left=left)
        for off in (-TINY, 0.0, TINY):
            box = np.array([[25.0, 35.0, -1.0 + off, 1.0 + off, 0.0]])
            start = np.array([0.0, off, 0.0, 0.0])
            _, chosen = path_dp(stations, rows, start, box, -wide, wide, config.weights)
            assert (rows[chosen[4]] > 0.0) == left


def test_a_lane_that_only_touches_the_goal_does_not_lead_there() -> None:
    """Lanes end where a goal made of lanes begins: which of them hold it must not be left to
    rounding.
    """
    x = along_x(0.0, 40.0)
    road = Road({i: strip(i, x + np.array([40.0 * i, 0.0]), successors=(i + 1,)) for i in range(3)})
    for off in (-TINY, 0.0, TINY):
        goal = Goal((np.array([[40.0, -1.75], [80.0, -1.75], [80.0, 1.75], [40.0, 1.75]]) + off,))
        assert goal_lanes(road, goal) == {1}


def test_a_course_is_as_wide_at_its_ends_as_beside() -> None:
    left = strip(1, along_x(), 5.25, 1.75, right_neighbour=0)
    for off in (-TINY, 0.0, TINY):
        shift = np.array([off, 0.0])
        other = replace(left, left=left.left + shift, right=left.right + shift)
        road = Road({0: strip(0, along_x(), left_neighbour=1), 1: other})
        reference = make_reference_path(road, (0,), EgoState(0.0, 0.0, 0.0, 0.0, 5.0))
        np.testing.assert_allclose(reference.road_left, 5.25, atol=1e-4)


@pytest.mark.parametrize("off", [-1e-12, 0.0, 1e-12])
def test_a_fork_as_sharp_to_both_sides_goes_to_the_lane_with_the_lower_id(off: float) -> None:
    bend = np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 3.0]])
    end = np.array([400.0, 0.0])
    up, down = strip(1, bend + end), strip(2, bend * [1.0, -1.0 - off] + end)
    road = Road({0: strip(0, along_x(), successors=(2, 1)), 1: up, 2: down})
    assert straight_on(road, 0) == 1
    goal = Goal((np.array([[418.0, -9.0], [421.0, -9.0], [421.0, 9.0], [418.0, 9.0]]),))
    assert find_route(road, EgoState(0.0, 0.0, 0.0, 0.0, 5.0), goal) == (0, 1)


def test_an_agent_at_a_lanes_end_is_on_the_next_lane() -> None:
    end = np.array([400.0, 0.0])
    road = Road({0: strip(0, along_x(), successors=(1,)), 1: strip(1, along_x(0.0, 40.0) + end)})
    assert {
        start_lanes(road, EgoState(0.0, 400.0 + off, 0.0, 0.0, 5.0)) for off in (-TINY, 0.0, TINY)
    } == {(1,)}
