"""How far the speed stage believes a row, and what it does for one that it doubts."""

from dataclasses import replace

import numpy as np
import pytest
from followed import planner
from hypothesis import given, strategies as st
from roads import along_x, lanes
from scenes import Other, driving, frame as frame_of, path_of, reference, scene, standing

from replan.logs.agents import AgentKind
from replan.logs.frame import Frame
from replan.logs.states import EgoState
from replan.planners.dp_qp.speed.doubt import (
    CERTAIN,
    ERROR_MPS2,
    SURE,
    extend_braking,
    from_beside,
    relax_rows,
    weights,
)
from replan.planners.frenet.path import Path
from replan.planners.frenet.scene import Scene, behind
from replan.planners.frenet.st_boundaries import StBoundaries, StGraphConfig, st_boundaries

EGO = EgoState(0.0, 0.0, 0.0, 0.0, 10.0)
ROAD, PATH = reference(along_x()), path_of(np.zeros(301), 0.4)


def seen(other: Other, **known: float) -> tuple[Scene, StBoundaries]:
    """A scene with one other of whom this is known, and their rows."""
    now = scene(ROAD, EGO, [other])
    agents = replace(now.frame.agents, **{name: np.array([value]) for name, value in known.items()})
    now = replace(now, frame=replace(now.frame, agents=agents))
    return now, st_boundaries(now, PATH, np.zeros(1, np.bool_), frozenset(), StGraphConfig())


def weight(other: Other, **known: float) -> float:
    now, rows = seen(other, **known)
    return float(weights(now, PATH, rows)[0, 0])


def walker(v: float, ahead: float = 30.0, away: float = 6.0) -> Other:
    moving = driving("it", ahead, -away, 0.0, v)
    return replace(moving, kind=AgentKind.PEDESTRIAN, length=0.5, width=0.6)


@given(st.floats(0.0, 5.0), st.floats(0.0, 1.0), st.floats(4.0, 12.0))
def test_the_weight_falls_with_time_unseen_and_grows_with_age(
    age: float, unseen: float, v: float
) -> None:
    crossing = driving("it", 30.0, -20.0, 0.0, v)
    p = weight(crossing, age=age, unseen=unseen)
    assert (
        0.0
        <= p
        <= weight(crossing, age=age + 0.2, unseen=unseen) + 1e-12
        <= weight(crossing) + 2e-12
    )
    assert weight(crossing, age=age, unseen=unseen) == p, "alone, nobody was seen later"


def test_a_late_sample_is_doubted_relative_to_the_other_agents() -> None:
    now = scene(ROAD, EGO, [driving("it", 30.0, -20.0, 0.0, 8.0), standing("other", 60.0, 9.0)])
    rows = st_boundaries(now, PATH, np.zeros(2, np.bool_), frozenset(), StGraphConfig())
    for unseen, certain in (((0.4, 0.4), True), ((0.0, 0.4), True), ((0.4, 0.0), False)):
        agents = replace(now.frame.agents, unseen=np.array(unseen))
        ((p,), _) = weights(replace(now, frame=replace(now.frame, agents=agents)), PATH, rows)
        assert bool(p >= CERTAIN) is certain, unseen


@given(st.floats(8.0, 15.0), st.floats(0.0, 3.0), st.floats(0.1, 1.0))
def test_an_agent_from_the_side_may_turn_before_it_is_near(
    v: float, to: float, more: float
) -> None:
    near, far = (weights(*crossing(v, left))[:, 0] for left in (to, to + more))
    assert far[1] <= near[1] <= near[0] and near[0] >= SURE
    assert near[1] >= SURE or to > 0.5, "soon"
    assert near[1] < SURE or to < 3.0, "in some seconds"


def crossing(v: float, left: float) -> tuple[Scene, Path, StBoundaries]:
    """Who comes from the right and enters the path after this time, s."""
    now, rows = seen(driving("it", 30.0, -(6.0 + v * left), 0.0, v))
    return now, PATH, rows


@given(st.floats(0.3, 2.9), st.floats(0.0, 0.3))
def test_a_pedestrian_towards_the_path_is_certain_at_first_sight(v: float, age: float) -> None:
    assert weight(walker(v, away=3.0), age=age, unseen=0.0) == 1.0


@given(st.floats(-14.0, 14.0), st.floats(0.0, 0.1))
def test_an_agent_on_the_path_is_never_doubted(v: float, age: float) -> None:
    assert weight(driving("it", 30.0, 0.5, v), age=age, unseen=0.5) >= CERTAIN


@pytest.mark.parametrize(("drift", "certain"), [(0.3, False), (0.6, False), (1.5, True)])
def test_an_oncoming_car_beside_the_lane_is_doubted_while_it_hardly_drifts(
    drift: float, *, certain: bool
) -> None:
    assert (weight(driving("it", 60.0, 3.5, -8.0, -drift)) >= CERTAIN) is certain
    assert weight(driving("it", 60.0, 3.5, -8.0, -drift), velocity_sigma=3.0) < CERTAIN


@given(st.floats(3.0, 12.0), st.floats(0.0, 6.0), st.floats(0.0, 2.0))
def test_harder_braking_before_the_path_is_doubted_more(
    v: float, brakes: float, more: float
) -> None:
    crossing = driving("it", 30.0, -4.0 * v, 0.0, v)
    assert (
        weight(crossing, accel=-brakes - more)
        <= weight(crossing, accel=-brakes) + 1e-12
        <= weight(crossing) + 2e-12
    )
    stop = v**2 / (2.0 * max(brakes - ERROR_MPS2, 1e-9))
    if stop < 4.0 * v - 4.0:  # it stands before the lane, which it reaches with its front
        assert weight(crossing, accel=-brakes) < CERTAIN


@given(st.floats(6.0, 14.0), st.floats(-12.0, 12.0).filter(lambda vy: abs(vy) > 3.0))
def test_mirrored_weights_are_the_same(vx: float, vy: float) -> None:
    one, other = (driving("it", 20.0, -2.0 * side * vy, vx, side * vy) for side in (1.0, -1.0))
    assert weight(one, age=0.3, unseen=0.0) == pytest.approx(
        weight(other, age=0.3, unseen=0.0), abs=1e-9
    )


@given(st.floats(3.0, 14.0), st.floats(0.0, 8.0), st.sampled_from([0.0, -5.0]))
def test_a_braking_leader_is_expected_to_stop_and_no_further(
    v: float, brakes: float, y: float
) -> None:
    crosses = y != 0.0
    now, rows = seen(
        driving("it", 25.0, y, 0.0, v) if crosses else driving("it", 25.0, 0.0, v), accel=-brakes
    )
    found, there = extend_braking(now, rows), np.isfinite(rows.lower)
    assert np.isnan(found.lower[~there]).all() and (found.lower[there] <= rows.lower[there]).all()
    if crosses or brakes <= ERROR_MPS2:
        np.testing.assert_array_equal(found.lower, rows.lower)
    else:
        stop = v * v / (2.0 * (brakes - ERROR_MPS2))
        assert np.nanmax(found.lower) - rows.lower[0, 0] <= stop + 1e-9


def test_relaxed_rows_are_those_that_a_comfortable_stop_cannot_keep() -> None:
    _, rows = seen(driving("it", 30.0, -8.0, 0.0, 8.0))
    stop = np.linspace(0.0, 40.0, len(rows.t))
    eased = relax_rows(rows, np.array([True]), stop, 1.0)
    there = np.isfinite(rows.lower)
    np.testing.assert_array_equal(eased.lower[there], np.maximum(rows.lower, stop + 1.0)[there])
    assert (eased.upper >= eased.lower)[there].all() and np.isnan(eased.lower[~there]).all()
    same = relax_rows(rows, np.array([False]), stop, 1.0)
    np.testing.assert_array_equal(same.lower, rows.lower)


def test_an_agent_from_beside_is_no_pedestrian_and_no_leader() -> None:
    for other, expected in (
        (driving("it", 20.0, -9.0, 0.0, 6.0), True),
        (driving("it", 60.0, 3.5, -8.0, -1.0), True),
        (driving("it", 12.0, 3.5, 6.0, -1.0), False),
        (walker(1.5), False),
        (driving("it", 30.0, 0.0, -5.0), False),
    ):
        now, rows = seen(other)
        assert from_beside(now, rows).tolist() == [expected], other


def test_an_overtaking_agent_is_behind_for_every_heading_of_its_box() -> None:
    follower = driving("it", -15.0, 0.0, 14.0)
    turned = replace(follower, at=lambda t: (-15.0 + 14.0 * t, 0.0, np.pi, 14.0, 0.0))
    for other in (follower, turned):
        assert behind(scene(ROAD, EGO, [other]), keeps_track=True).tolist() == [True]


def crossing_car(age: float) -> Frame:
    """A car that crosses so near that only hard braking avoids it."""
    now = frame_of(EGO, [driving("it", 16.0, 12.0, 0.0, -8.0)])
    return replace(now, agents=replace(now.agents, age=np.array([age]), unseen=np.zeros(1)))


@pytest.mark.parametrize(("age", "hardest"), [(0.1, 3.05), (2.0, 9.0)])
def test_for_a_car_that_is_new_the_brakes_are_used_comfortably(age: float, hardest: float) -> None:
    plan = planner(lanes(along_x()), EGO).plan(crossing_car(age))
    braked = -float(plan.trajectory.a.min())
    assert 2.0 < braked <= hardest and (braked > 3.5) is (age > 1.0)
