"""The oncoming lane: borrowed to pass who blocks the lane, where no one comes and the marking may
be crossed.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from followed import Drive, followed, gaps
from roads import strip, two_way
from scenes import Other, driving, reference, scene, standing

from replan.logs.agents import AgentKind
from replan.logs.plan import DecisionKind, PlanStatus
from replan.logs.road import Road
from replan.logs.states import EgoState
from replan.planners.dp_qp.path.bounds import CorridorConfig, standing_obstacles
from replan.planners.dp_qp.path.oncoming_lane import passed_by_oncoming_lane

EGO = EgoState(0.0, 0.0, 0.0, 0.0, 8.0)
THING = Other("thing", lambda t: (60.0, 0.0, 0.0, 0.0, 0.0), AgentKind.OBJECT, 5.0, 3.0)
PARKED = standing("parked", 60.0, 0.0, width=3.0)


def driven(road: Road, others: Sequence[Other], seconds: float = 20.0) -> Drive:
    drive = followed(road, EGO, others, seconds=seconds)
    assert all(plan.status is PlanStatus.PLANNED for _, plan in drive)
    assert min(gaps(drive, other.id).min() for other in others) > 0.5
    return drive


@pytest.mark.parametrize("right", [True, False])
def test_the_facing_lane_adjoins_where_its_marking_may_be_crossed(right: bool) -> None:
    found, shut = (
        reference(two_way(right=right, crossable=free), lane=0) for free in (True, False)
    )
    near, far = (
        (found.facing_left, found.facing_right)
        if right
        else (found.facing_right, found.facing_left)
    )
    assert near is not None and far is not None
    np.testing.assert_allclose(np.abs(near[:-1]), 5.25, atol=1e-6)
    np.testing.assert_allclose(np.abs(far), 1.75, atol=1e-6)
    np.testing.assert_allclose(np.abs(shut.facing_left), 1.75, atol=1e-6)
    np.testing.assert_allclose(np.abs(shut.facing_right), 1.75, atol=1e-6)


@pytest.mark.parametrize("right", [True, False])
def test_a_blocking_agent_is_passed_on_a_free_oncoming_lane(right: bool) -> None:
    drive = driven(two_way(right=right), [THING])
    y = np.array([now.ego.y for now, _ in drive]) * (1.0 if right else -1.0)
    assert drive[-1][0].ego.x > 120.0 and y.max() > 2.5 and abs(y[-1]) < 0.3


def test_a_solid_marking_is_not_crossed() -> None:
    drive = driven(two_way(crossable=False), [THING])
    assert drive[-1][0].ego.x < 55.0 and max(abs(now.ego.y) for now, _ in drive) < 0.2


def test_the_ego_waits_for_oncoming_traffic_and_passes_then() -> None:
    """Far enough behind the obstacle to steer round it, in its own lane as long as the other has
    not passed.
    """
    coming = driving("coming", 150.0, 3.5, -10.0)
    drive = driven(two_way(), [THING, coming], 26.0)
    waiting = [now.ego for now, _ in drive if now.t < 10.0]
    assert max(abs(ego.y) for ego in waiting) < 0.2 and min(now.ego.v for now, _ in drive) < 0.5
    assert drive[-1][0].ego.x > 100.0


def test_a_parked_car_is_passed_once_it_has_stood_for_long() -> None:
    drive = driven(two_way(), [PARKED])
    first = next(
        now.t
        for now, plan in drive
        if any(getattr(i, "kind", None) is DecisionKind.NUDGE_LEFT for i in plan.internals)
    )
    assert first >= 5.0 and drive[-1][0].ego.x > 100.0


@pytest.mark.parametrize("right", [True, False])
@pytest.mark.parametrize(("aside", "passes"), [(3.5, False), (4.9, True)])
def test_no_passing_where_the_oncoming_lane_is_blocked(
    right: bool, aside: float, passes: bool
) -> None:
    """Behind a car that stands there may be more that it hides.

    A narrow one at the edge leaves room between.
    """
    side = aside if right else -aside
    others = [standing("parked", 38.0, 0.0, width=3.0), standing("other", 25.0, side, width=0.9)]
    now = scene(reference(two_way(right=right), lane=0), EGO, others)
    boxes = tuple(box for box in standing_obstacles(now, 100.0) if box.agent == "parked")
    assert passed_by_oncoming_lane(now, boxes, CorridorConfig()) == (
        frozenset({"parked"}) if passes else frozenset()
    )


def test_a_queue_is_not_overtaken() -> None:
    drive = driven(two_way(), [PARKED, standing("first", 72.0, 0.0)])
    assert drive[-1][0].ego.x < 55.0 and max(abs(now.ego.y) for now, _ in drive) < 0.2


def test_an_agent_that_waits_before_a_junction_is_not_passed() -> None:
    """The same parked car, where 30 m further the road forks."""
    road = two_way()
    x = np.linspace(-50.0, 90.0, 71)[:, None] * [1.0, 0.0]
    fork = [
        strip(i, np.array([[90.0, 0.0], [150.0, 0.0], [260.0, side]]), speed_limit=10.0)
        for i, side in ((2, 0.0), (3, 9.0))
    ]
    stem = replace(
        road.lanes[0],
        left=x + np.array([0.0, 1.75]),
        right=x - np.array([0.0, 1.75]),
        successors=(2, 3),
    )
    forked = Road({**road.lanes, 0: stem, 2: fork[0], 3: fork[1]})
    assert reference(forked, lane=0).waits == pytest.approx((140.0,), abs=0.5)
    drive = driven(forked, [PARKED])
    assert drive[-1][0].ego.x < 55.0 and max(abs(now.ego.y) for now, _ in drive) < 0.2
