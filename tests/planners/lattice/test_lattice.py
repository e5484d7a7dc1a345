"""Lattice: its polynomials, the states that they stand for, and what a chosen plan may not do."""

import numpy as np
import pytest
from followed import Drive, decided, followed, gaps
from hypothesis import given, settings, strategies as st
from roads import along_x, curve, lanes
from scenes import CAR, Other, driving, frame, reference, scene, standing

from replan.logs.frame import Frame, PlannerContext
from replan.logs.plan import Candidates, CostTerms, DecisionKind, Plan, PlanStatus, SlGraph, StGraph
from replan.logs.road import Goal, Road
from replan.logs.states import EgoState
from replan.planners.frenet.profiles import HORIZON_STEPS, STEP_S, meets
from replan.planners.lattice import Lattice, LatticeConfig
from replan.planners.lattice.candidates import (
    LEAST_M,
    REST_MPS,
    evaluate_polynomial,
    headway,
    keep_speed,
    lateral_costs,
    lateral_polynomial,
    reach_point,
    sample_polynomials,
    states,
    third_square,
)
from replan.planners.lattice.planner import ego_frenet

SPEED = st.floats(0.0, 30.0)
ACCEL = st.floats(-4.0, 3.0)


def lattice(road: Road, ego: EgoState, goal: Goal | None = None) -> Lattice:
    return Lattice(PlannerContext(road, goal, CAR, 0.1, ego))


def drives(road: Road, ego: EgoState, *others: Other, seconds: float) -> Drive:
    return followed(road, ego, others, seconds=seconds, build=lattice)


def candidates(plan: Plan) -> Candidates:
    return next(item for item in plan.internals if isinstance(item, Candidates))


@given(SPEED, ACCEL, SPEED, st.floats(0.5, 8.0))
def test_a_kept_speed_is_reached_without_acceleration(
    v0: float, a0: float, v1: float, T: float
) -> None:
    c = np.array([0.0, v0, 0.5 * a0, *keep_speed(v0, a0, v1, T)])
    assert c[5] == 0.0
    assert evaluate_polynomial(c, T, 0.0) == pytest.approx((0.0, v0, a0))
    assert evaluate_polynomial(c, T, T)[1:] == pytest.approx((v1, 0.0), abs=1e-9)
    assert evaluate_polynomial(c, T, T + 2.0)[0] - evaluate_polynomial(c, T, T)[0] == pytest.approx(
        2.0 * v1, abs=1e-9
    )


@given(SPEED, ACCEL, st.floats(-10.0, 200.0), SPEED, st.floats(0.5, 8.0))
def test_a_point_is_reached_with_its_speed(
    v0: float, a0: float, s1: float, v1: float, T: float
) -> None:
    c = np.array([0.0, v0, 0.5 * a0, *reach_point(v0, a0, s1, v1, T)])
    assert evaluate_polynomial(c, T, 0.0) == pytest.approx((0.0, v0, a0))
    np.testing.assert_allclose(evaluate_polynomial(c, T, T), (s1, v1, 0.0), atol=1e-6)


@given(
    st.floats(-4.0, 4.0),
    st.floats(-0.5, 0.5),
    st.floats(-0.1, 0.1),
    st.floats(-4.0, 4.0),
    st.floats(8.0, 150.0),
)
def test_an_offset_is_reached_and_kept(
    l0: float, dl0: float, ddl0: float, l1: float, D: float
) -> None:
    c = lateral_polynomial(np.array([l0, dl0, ddl0]), l1, D)
    assert evaluate_polynomial(c, D, 0.0) == pytest.approx((l0, dl0, ddl0), abs=1e-12)
    for s in (D, D + 40.0):
        np.testing.assert_allclose(evaluate_polynomial(c, D, s), (l1, 0.0, 0.0), atol=1e-6)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3), st.floats(0.5, 8.0))
def test_the_integral_of_the_squared_jerk(c: tuple[float, float, float], T: float) -> None:
    x, weight = np.polynomial.legendre.leggauss(6)
    u = 0.5 * T * (x + 1.0)
    third = 6.0 * c[0] + 24.0 * c[1] * u + 60.0 * c[2] * u * u
    assert third_square(*c, T) == pytest.approx(
        0.5 * T * float(weight @ third**2), rel=1e-9, abs=1e-12
    )


@given(st.floats(-3.0, 3.0), st.floats(3.0, 25.0))
def test_at_constant_speed_the_lateral_jerk_is_that_of_the_quintic_in_time(
    l1: float, v: float
) -> None:
    """From rest: 720 l1^2 / T^5 (Werling)."""
    motion = sample_polynomials(
        np.array([[0.0, v, 0.0, 0.0, 0.0, 0.0]]), np.array([8.0]), HORIZON_STEPS
    )
    cost, length = lateral_costs(
        motion, np.zeros(3), l1, np.array([4.0]), np.array([1.0, 0.0, 0.0])
    )
    assert length[0, 0] == pytest.approx(max(4.0 * v, LEAST_M))
    assert cost[0, 0] == pytest.approx(720.0 * l1**2 / 4.0**5, rel=1e-9, abs=1e-12)


COURSE = reference(
    curve(*((0.5, 0.025 * np.sin(s / 25.0)) for s in np.arange(0.0, 240.0, 0.5)), step=0.5)
)
LINE = COURSE.line
"""Its curvature changes smoothly, so that differences are near to derivatives."""


@settings(max_examples=25)
@given(
    st.floats(5.0, 80.0),
    st.floats(-2.0, 2.0),
    st.floats(-0.1, 0.1),
    st.floats(3.0, 12.0),
    st.floats(0.0, 12.0),
)
def test_states_are_those_of_a_moving_point(
    s0: float, l0: float, dl0: float, v0: float, v1: float
) -> None:
    """Heading, curvature, speed and acceleration are the derivatives of the position."""
    lon = np.array([[0.0, v0, 0.0, *keep_speed(v0, 0.0, v1, 6.0)]])
    motion = sample_polynomials(lon, np.array([6.0]), 60)[0]
    lateral = lateral_polynomial(np.array([l0, dl0, 0.0]), 0.5, 50.0)
    x, y, yaw, v, a, kappa, l = states(LINE.s, LINE.coef, s0, lateral, 50.0, motion)[:7]
    moved = v > 1.0
    vx, vy, t = np.gradient(x, STEP_S), np.gradient(y, STEP_S), slice(2, -2)
    np.testing.assert_allclose(np.hypot(vx, vy)[t], v[t], atol=0.02)
    np.testing.assert_allclose(np.gradient(v, STEP_S)[t], a[t], atol=0.06)
    np.testing.assert_allclose(np.cos(yaw - np.arctan2(vy, vx))[t][moved[t]], 1.0, atol=1e-4)
    turning = np.gradient(yaw, STEP_S)
    np.testing.assert_allclose(
        (turning / np.maximum(v, 1e-6))[t][moved[t]], kappa[t][moved[t]], atol=4e-3
    )
    assert np.abs(l).max() < 4.0


@settings(max_examples=25)
@given(
    st.floats(45.0, 95.0),
    st.floats(-2.0, 2.0),
    st.floats(-0.3, 0.3),
    st.floats(0.5, 12.0),
    st.floats(-2.0, 2.0),
)
def test_the_frenet_start_is_the_inverse_of_the_states(
    s0: float, l0: float, turn: float, v: float, a: float
) -> None:
    x, y, yaw, _ = LINE.frame(s0)
    start = EgoState(
        0.0,
        float(x - l0 * np.sin(yaw)),
        float(y + l0 * np.cos(yaw)),
        float(yaw + turn),
        v,
        max(a, -v),
        0.03,
    )
    ego = ego_frenet(scene(COURSE, start))
    assert ego.s == pytest.approx(s0, abs=1e-6)
    motion = np.array([[0.0], [ego.speed], [ego.accel]])
    lateral = lateral_polynomial(np.array(ego.lateral), 0.0, 30.0)
    found = states(LINE.s, LINE.coef, s0, lateral, 30.0, motion)[:6, 0]
    np.testing.assert_allclose(found[:4], (start.x, start.y, start.yaw, start.v), atol=1e-6)
    np.testing.assert_allclose(found[4:], (start.a, start.kappa), atol=1e-6)


def test_headway_is_the_missing_share_of_the_wanted_gap() -> None:
    motion = sample_polynomials(
        np.array([[0.0, 10.0, 0.0, 0.0, 0.0, 0.0]]), np.array([8.0]), HORIZON_STEPS
    )
    s = 40.0 + 10.0 * 4 * STEP_S * np.arange(21)  # the gap stays
    others = np.array([[s], [np.zeros(21)], [np.full(21, 2.0)], [np.full(21, 1.0)]])
    box, speed, unmet = np.array([3.5, 1.0, 0.9]), np.array([10.0]), np.zeros((2, 1), bool)
    gap, wanted = 40.0 - 2.0 - 3.5, 50.0

    def missing(l1: float) -> float:
        return float(
            headway(motion, 0.0, others, speed, unmet, l1, box, np.array([0.0, 5.0]), False)[0]
        )

    assert missing(0.0) == pytest.approx((1.0 - gap / wanted) ** 2)
    assert missing(3.0) == 0.0, "another track"


def check(plan: Plan, now: Frame, road_half: float = 1.75) -> None:
    """Neither touches an agent nor breaks a bound, and every candidate is accounted for."""
    way, counted = plan.trajectory, candidates(plan)
    planned = plan.status is PlanStatus.PLANNED
    assert counted.considered == sum(count for _, count in counted.rejected) + planned
    assert all(count > 0 for _, count in counted.rejected)
    if not planned:
        assert plan.reason.startswith("no candidate can be driven: ")
        return
    config = LatticeConfig()
    moving = way.t[way.v > REST_MPS]  # who drives into an ego that stands is not avoided by a plan
    assert not len(moving) or not meets(way.between(now.t, moving[-1]), now, CAR)
    assert np.abs(way.kappa).max() <= CAR.max_kappa
    assert (way.v**2 * np.abs(way.kappa)).max() <= config.lat_accel_mps2 + 1e-6
    assert (way.v >= -0.05).all()
    assert way.a.max() <= config.accel_mps2 + 0.3
    assert way.a.min() >= -config.decel_mps2 - 0.3
    assert np.abs(way.y).max() <= road_half - 0.5 * CAR.width


OTHER = st.tuples(
    st.floats(8.0, 90.0), st.floats(-4.0, 4.0), st.floats(-3.0, 12.0), st.floats(-2.0, 2.0)
)


@settings(max_examples=60)
@given(st.lists(OTHER, max_size=6), st.floats(0.0, 13.0))
def test_the_chosen_pair_touches_no_agent_and_keeps_bounds(
    others: list[tuple[float, float, float, float]], v: float
) -> None:
    ego = EgoState(0.0, 0.0, 0.0, 0.0, v)
    made = [driving(str(i), x, y, vx + 1e-3, vy) for i, (x, y, vx, vy) in enumerate(others)]
    now = frame(ego, made)
    plan = lattice(lanes(along_x()), ego).plan(now)
    if plan.status is PlanStatus.PLANNED or candidates(plan):
        check(plan, now)


@pytest.mark.slow
def test_a_parked_car_is_passed_with_room_and_stopped_for_without() -> None:
    parked = standing("parked", 80.0, -1.2)
    wide = drives(lanes(along_x(), 2), EgoState(0.0, 0.0, 0.0, 0.0, 10.0), parked, seconds=14.0)
    assert gaps(wide, "parked").min() > 0.25
    assert wide[-1][0].ego.x > 90.0
    assert any(decided(plan, "parked", "path") is DecisionKind.NUDGE_LEFT for _, plan in wide)
    narrow = drives(lanes(along_x()), EgoState(0.0, 0.0, 0.0, 0.0, 10.0), parked, seconds=20.0)
    assert 0.25 < gaps(narrow, "parked")[-1] < 6.0
    assert narrow[-1][0].ego.v < 0.7, (
        "each frame plans its durations anew, so that the last metres are slow"
    )
    assert any(decided(plan, "parked", "speed") is DecisionKind.STOP for _, plan in narrow)


def test_without_a_feasible_pair_the_ego_brakes_hard_and_counts_reasons() -> None:
    ego = EgoState(0.0, 0.0, 0.0, 0.0, 14.0)
    now = frame(ego, [standing("wall", 12.0, 0.0, width=10.0)])
    plan = lattice(lanes(along_x()), ego).plan(now)
    assert plan.status is PlanStatus.HARD_STOP
    assert "meets a road user" in plan.reason
    assert candidates(plan).considered == sum(count for _, count in candidates(plan).rejected)


def test_a_plan_shows_the_chosen_pair_and_counts_the_rejected() -> None:
    ego = EgoState(0.0, 0.0, 0.0, 0.0, 10.0)
    plan = lattice(lanes(along_x()), ego).plan(frame(ego, [standing("parked", 25.0, 0.0)]))
    kinds = {type(item) for item in plan.internals}
    assert {SlGraph, StGraph, CostTerms, Candidates} <= kinds
    reasons = dict(candidates(plan).rejected)
    assert reasons["meets a road user"] > 0
    assert reasons["dearer than the chosen one"] > 0
