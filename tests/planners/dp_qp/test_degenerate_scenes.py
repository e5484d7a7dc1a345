"""Worlds at the edge: whatever they are like, a plan comes back that starts where it says and says
what it is.
"""

from collections.abc import Sequence

import numpy as np
import pytest
from followed import followed, gaps, planner
from hypothesis import assume, given, settings, strategies as st
from roads import along_x, curve, lanes, strip
from scenes import CAR, Other, driving, frame, standing

from replan.core.arrays import FloatArray
from replan.logs.frame import Frame
from replan.logs.plan import Decision, DecisionKind, Plan, PlanStatus
from replan.logs.road import Road
from replan.logs.states import EgoState

LOCK_SLACK = 1.05


def planned(road: Road, ego: EgoState, others: Sequence[Other] = ()) -> tuple[Frame, Plan]:
    now = frame(ego, others)
    return now, planner(road, ego).plan(now)


def assert_honest(now: Frame, plan: Plan) -> None:
    """It starts at the ego (up to the solver's tolerance), keeps the steering lock.

    A fallback has a reason.
    """
    way = plan.trajectory
    assert (way.t[0], way.x[0], way.y[0]) == pytest.approx((now.t, now.ego.x, now.ego.y), abs=2e-2)
    assert np.cos(way.yaw[0] - now.ego.yaw) == pytest.approx(1.0, abs=1e-3)
    assert (way.v >= 0.0).all() and way.t[-1] >= now.t + 3.0
    assert bool(plan.reason) or plan.status is PlanStatus.PLANNED
    if plan.status is PlanStatus.PLANNED:
        gone = np.r_[0.0, np.cumsum(np.hypot(np.diff(way.x), np.diff(way.y)))]
        assert np.abs(way.kappa[gone > 6.0]).max(initial=0.0) <= LOCK_SLACK * CAR.max_kappa + 0.01


def turn(radius: float, angle: float = 0.5 * np.pi) -> FloatArray:
    """A straight, an arc, a straight."""
    return curve((40.0, 0.0), (radius * angle, 1.0 / radius), (60.0, 0.0), step=0.5)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_loop_beyond_a_full_turn_is_driven_round(side: float) -> None:
    """One and a half turns: the line comes past itself, and the ego goes on along it and not
    across.
    """
    radius = 15.0
    points = curve((30.0, 0.0), (3.0 * np.pi * radius, side / radius), (60.0, 0.0))
    drive = followed(lanes(points), EgoState(0.0, 2.0, 0.0, 0.0, 6.0), seconds=24.0)
    yaw = np.unwrap([now.ego.yaw for now, _ in drive])
    assert all(plan.status is PlanStatus.PLANNED for _, plan in drive)
    assert side * yaw[-1] > 2.2 * np.pi and np.abs(np.diff(yaw)).max() < 0.1
    away = [np.hypot(*(points - (now.ego.x, now.ego.y)).T).min() for now, _ in drive]
    assert max(away) < 1.0


@given(st.floats(-100.0, 100.0), st.floats(0.0, 15.0), st.floats(3.0, 6.0))
@settings(max_examples=12)
def test_a_kinked_lane_is_driven_within_the_lock_or_not_at_all(
    angle: float, v: float, width: float
) -> None:
    """Where the lane cannot be driven the plan ends before it."""
    yaw, leg = np.radians(angle), np.arange(0.0, 60.0, 2.0)[:, None]
    points = np.vstack([leg * [1.0, 0.0], [60.0, 0.0] + leg * [np.cos(yaw), np.sin(yaw)]])
    road = Road({0: strip(0, points, 0.5 * width, -0.5 * width, speed_limit=13.89)})
    assert_honest(*planned(road, EgoState(0.0, 15.0, 0.0, 0.0, v)))


@pytest.mark.parametrize("radius", [6.0, 8.0, 12.0])
def test_an_obstacle_in_the_centre_of_the_turn_is_driven_round(radius: float) -> None:
    """All stations of the arc are equally near to it; it is not in the way."""
    centre = standing("column", 40.0, radius, length=0.6, width=0.6)
    drive = followed(
        lanes(turn(radius)), EgoState(0.0, 20.0, 0.0, 0.0, 4.0), [centre], seconds=12.0
    )
    for now, plan in drive:
        assert_honest(now, plan) if now.t == 0.0 else None
        assert plan.status is PlanStatus.PLANNED
    assert drive[-1][0].ego.yaw > 1.4 and gaps(drive, "column").min() > 1.0


@given(st.floats(-2.0, 2.0), st.floats(-60.0, 60.0), st.floats(0.0, 14.0), st.floats(-0.02, 0.02))
@settings(max_examples=40)
def test_an_ego_off_the_line_and_off_its_heading_comes_back(
    l: float, off: float, v: float, bend: float
) -> None:
    """From 2 m beside and 60 degrees across, at any speed.

    At walking pace it ends up along the line.
    """
    road = lanes(curve((200.0, bend), step=2.0), 2)
    now, plan = planned(road, EgoState(0.0, 1.0, l, np.radians(off), v))
    assert_honest(now, plan)
    assume(abs(off) < 20.0 and v < 8.0)
    assert plan.status is PlanStatus.PLANNED


@pytest.mark.slow
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_60_degrees_across_at_walking_pace_ends_along_the_lane(side: float) -> None:
    drive = followed(
        lanes(along_x(), 2), EgoState(0.0, 0.0, 1.0, side * np.radians(60.0), 2.0), seconds=15.0
    )
    assert all(plan.status is PlanStatus.PLANNED for _, plan in drive)
    assert abs(drive[-1][0].ego.yaw) < 0.15


@given(st.floats(0.0, 1.5), st.floats(1.0, 12.0))
@settings(max_examples=10)
def test_a_lane_without_width_is_driven_along_its_middle(width: float, v: float) -> None:
    """Markings are no walls: lanes taper to nothing on real maps."""
    road = Road({0: strip(0, along_x(), 0.5 * width, -0.5 * width, speed_limit=13.89)})
    now, plan = planned(road, EgoState(0.0, 0.0, 0.0, 0.0, v))
    assert_honest(now, plan)
    assert plan.status is PlanStatus.PLANNED and np.abs(plan.trajectory.y).max() < 0.1


@pytest.mark.slow
@given(st.floats(-0.1, 0.6), st.floats(-0.3, 0.3), st.floats(5.0, 9.0))
@settings(max_examples=6)
def test_a_gap_between_parked_cars_is_driven_through_or_stopped_before(
    spare: float, l: float, v: float
) -> None:
    """The gap is the ego's width and `spare` to each side: never a touch, and a stop is
    reported.
    """
    half = 0.5 * CAR.width + spare
    pair = [standing("left", 50.0, l + half + 0.9), standing("right", 50.0, l - half - 0.9)]
    drive = followed(
        lanes(along_x(), 1, width=7.0), EgoState(0.0, 0.0, 0.0, 0.0, v), pair, seconds=11.0
    )
    assert min(gaps(drive, name).min() for name in ("left", "right")) > 0.0
    assert all(plan.status is PlanStatus.PLANNED for _, plan in drive)
    last = drive[-1][0].ego
    made = {
        (item.agent, item.kind)
        for _, plan in drive
        for item in plan.internals
        if isinstance(item, Decision)
    }
    if last.x < 45.0 and last.v < 0.1:
        assert any(kind is DecisionKind.STOP for _, kind in made)
    if spare > 0.45 and abs(l) < 0.1:
        assert last.x > 55.0 or last.v > 0.5


@pytest.mark.parametrize("seed", range(4))
def test_a_scene_with_500_agents_is_planned(seed: int) -> None:
    """Anywhere, some of them on the ego, standing and driving."""
    rng = np.random.default_rng(seed)
    x, y, speed, yaw = (
        rng.uniform(-60.0, 160.0, 500),
        rng.uniform(-30.0, 30.0, 500),
        *rng.uniform(0.0, 12.0, (2, 500)),
    )
    others = [
        standing(str(i), x[i], y[i], yaw[i])
        if i % 2
        else driving(str(i), x[i], y[i], speed[i] * np.cos(yaw[i]), speed[i] * np.sin(yaw[i]))
        for i in range(500)
    ]
    now, plan = planned(lanes(along_x(), 3), EgoState(0.0, 0.0, 0.0, 0.0, 8.0), others)
    assert_honest(now, plan)
    assert plan.status.is_fallback or plan.trajectory.v[-1] < 8.0
