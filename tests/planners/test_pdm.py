"""PDM-Closed: its driver, its tracker, its score, and how it drives."""

from dataclasses import replace

import numpy as np
import pytest
from followed import Drive, followed, gaps
from hypothesis import given, strategies as st
from roads import along_x, lanes, two_way
from scenes import CAR, Other, driving, frame, path_of, reference, scene, standing

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind
from replan.logs.frame import PlannerContext
from replan.logs.plan import Candidates, CostTerms, SlGraph, StGraph
from replan.logs.road import Goal, Road
from replan.logs.states import EgoState
from replan.planners.frenet.profiles import HORIZON_KNOTS, STEP_S
from replan.planners.pdm import Pdm, PdmConfig
from replan.planners.pdm.idm_drivers import Driver, drive_track, idm_acceleration
from replan.planners.pdm.lqr_tracker import track_proposal
from replan.planners.pdm.proposal_score import FACTORS, TERMS, Scores, comfortable, scores
from replan.replay.planner_process.planner_config import planner_part

C = PdmConfig()
DRIVER = Driver(C.accel_mps2, C.decel_mps2, C.headway_s, C.min_gap_m, C.exponent)
NONE = np.empty((0, 1))
SPEED = st.floats(0.0, 25.0)
PART_NAMES = [part.name for part in FACTORS + TERMS]


def pdm(road: Road, ego: EgoState, goal: Goal | None = None) -> Pdm:
    return Pdm(PlannerContext(road, goal, CAR, 0.1, ego))


def drives(road: Road, ego: EgoState, *others: Other, seconds: float) -> Drive:
    return followed(road, ego, others, seconds=seconds, build=pdm)


def at_speed(
    v: float, *others: Other, l: float = 0.0, road: Road | None = None, a: float = 0.0
) -> Scores:
    """The score of going on straight, 4 s with a constant acceleration until it stands."""
    ego = EgoState(0.0, 0.0, l, 0.0, v, a)
    now = scene(reference(road or lanes(along_x())), ego, others)
    t = STEP_S * np.arange(41)
    speed = np.maximum(v + a * t, 0.0)
    x = np.r_[0.0, np.cumsum(0.5 * STEP_S * (speed[1:] + speed[:-1]))]
    rows = np.array([x, np.full(41, l), np.zeros(41), speed, np.full(41, a), np.zeros(41)])
    return scores(rows[None], now, np.arange(len(others)), (5.0, 5.0, 2.0))


def part(found: Scores, name: str) -> float:
    return float(found.parts[PART_NAMES.index(name), 0])


@given(st.floats(0.0, 0.98), st.floats(2.0, 40.0))
def test_in_equilibrium_nothing_accelerates(share: float, v0: float) -> None:
    v = share * v0
    gap = (C.min_gap_m + v * C.headway_s) / np.sqrt(1.0 - share**10)
    assert idm_acceleration(v, v0, gap, v, DRIVER) == pytest.approx(0.0, abs=1e-9)


@given(SPEED, st.floats(2.0, 40.0), st.floats(0.0, 200.0), SPEED, st.floats(0.01, 20.0))
def test_less_room_or_a_slower_leader_never_accelerate(
    v: float, v0: float, gap: float, lead: float, more: float
) -> None:
    here = idm_acceleration(v, v0, gap, lead, DRIVER)
    assert -C.decel_mps2 <= here <= C.accel_mps2
    assert idm_acceleration(v, v0 + more, gap, lead, DRIVER) >= here
    # The wanted gap is one
    if v * C.headway_s + v * (v - lead - more) / (2.0 * np.sqrt(4.5)) >= -C.min_gap_m:
        assert idm_acceleration(v, v0, gap + more, lead + more, DRIVER) >= here - 1e-9


@given(SPEED, st.lists(st.floats(1.0, 30.0), min_size=2, max_size=6), st.floats(5.0, 120.0), SPEED)
def test_a_higher_wanted_speed_never_falls_behind(
    v: float, speeds: list[float], gap: float, lead: float
) -> None:
    """More speed limit never reorders the proposals of a track, with and without a leader."""
    t = np.arange(0.0, 8.01, 0.2)
    lower = gap + lead * t[None]
    for some in (
        (lower, lower + 6.0, np.array([lead])),
        (np.empty((0, len(t))), np.empty((0, len(t))), np.empty(0)),
    ):
        found = drive_track(np.sort(speeds), t, *some, v, 1.4, DRIVER)
        assert (np.diff(found[:, 0], axis=0) >= -1e-6).all()
        assert (found[:, 1] >= 0.0).all()


@given(st.floats(-1.5, 1.5), st.floats(-0.1, 0.1), st.floats(3.0, 25.0))
def test_an_offset_is_undone(l: float, yaw: float, v: float) -> None:
    path = path_of(np.zeros(600), 0.5)
    profile = np.array([v * STEP_S * np.arange(HORIZON_KNOTS), np.full(HORIZON_KNOTS, v)])
    way = track_proposal(path, profile, EgoState(0.0, 0.0, l, yaw, v), CAR, HORIZON_KNOTS)
    assert abs(way[1, -1]) < 0.1 + 0.2 * abs(l)


@given(st.floats(-1.5, 1.5), st.floats(-0.2, 0.2), SPEED, st.floats(-3.0, 1.5), SPEED)
def test_simulated_proposals_are_drivable_and_mirror_with_the_world(
    l: float,
    yaw: float,
    v: float,
    a: float,
    wanted: float,
) -> None:
    path = path_of(0.02 * np.sin(np.arange(600) / 30.0), 0.5)
    profile = drive_track(
        np.array([max(wanted, 0.5)]),
        np.arange(0.0, 8.1, 0.2),
        NONE[:, :0],
        NONE[:, :0],
        np.empty(0),
        v,
        1.4,
        DRIVER,
    )[0]
    one = track_proposal(path, profile, EgoState(0.0, 0.0, l, yaw, v, a), CAR, HORIZON_KNOTS)
    assert (one[3] >= 0.0).all()
    assert np.abs(one[5]).max() <= np.tan(CAR.max_steer) / CAR.wheelbase + 1e-9
    np.testing.assert_allclose(
        np.hypot(np.diff(one[0]), np.diff(one[1])), 0.05 * (one[3, 1:] + one[3, :-1]), atol=1e-9
    )
    other = replace(path, y=-path.y, yaw=-path.yaw, kappa=-path.kappa)
    two = track_proposal(other, profile, EgoState(0.0, 0.0, -l, -yaw, v, a), CAR, HORIZON_KNOTS)
    np.testing.assert_allclose(one * np.array([[1], [-1], [-1], [1], [1], [-1]]), two, atol=1e-9)


def test_a_free_drive_has_the_full_score() -> None:
    found = at_speed(10.0)
    assert found.total[0] == pytest.approx(1.0)
    assert np.isinf(found.contact[0])
    assert found.agent[0] == -1


@given(st.floats(3.0, 20.0), st.floats(8.0, 60.0))
def test_a_contact_in_front_is_the_egos_fault_when_the_boxes_touch(v: float, x: float) -> None:
    found = at_speed(v, standing("parked", x, 0.0))
    until = (x - 2.25 - CAR.axle_to_front) / v
    assert (part(found, "no collision") == 0.0) == (until <= 4.0 - 1e-9) or until == pytest.approx(
        4.0, abs=0.1
    )
    if until < 3.9:
        assert found.contact[0] == pytest.approx(until, abs=0.1)
        assert found.agent[0] == 0
        assert found.total[0] == 0.0


def test_contacts_from_behind_or_at_the_start_are_not_at_fault() -> None:
    for other in (driving("follower", -12.0, 0.0, 20.0), standing("here", 2.0, 1.0)):
        found = at_speed(5.0, other)
        assert part(found, "no collision") == 1.0
        assert part(found, "time to collision") == 1.0


def test_an_object_counts_half_and_the_side_only_out_of_the_lane() -> None:
    cone = standing("cone", 20.0, 0.0, kind=AgentKind.OBJECT, length=0.5, width=0.5)
    assert part(at_speed(10.0, cone), "no collision") == 0.5
    beside = driving("beside", 0.0, 8.0, 8.0, -1.8)
    assert part(at_speed(8.0, beside), "no collision") == 1.0
    assert part(at_speed(8.0, beside, l=1.5, road=lanes(along_x(), 2)), "no collision") == 0.0


def test_one_second_to_a_contact_is_too_close() -> None:
    gap = 10.0 * 4.0 + CAR.axle_to_front + 2.25
    assert part(at_speed(10.0, standing("far", gap + 9.5, 0.0)), "time to collision") == 1.0
    assert part(at_speed(10.0, standing("near", gap + 8.5, 0.0)), "time to collision") == 0.0


def test_leaving_the_road_and_driving_against_traffic_lower_the_score() -> None:
    rows = np.zeros((2, 6, 41))
    rows[:, 0] = 8.0 * STEP_S * np.arange(41)
    rows[:, 3] = 8.0
    cases = (
        (-1.6, two_way(), (1.0, 0.0)),
        (3.5, two_way(), (0.0, 1.0)),
        (3.5, lanes(along_x(), 2), (1.0, 1.0)),
    )
    for end, road, expected in cases:
        rows[1, 1] = np.linspace(0.0, end, 41)
        rows[1, 2] = np.arctan2(end / 40, 0.8)
        now = scene(reference(road), EgoState(0.0, 0.0, 0.0, 0.0, 8.0))
        found = scores(rows, now, np.empty(0, np.int64), (5.0, 5.0, 2.0))
        _, direction, drivable, *_ = found.parts
        assert (direction[1], drivable[1]) == expected
        assert direction[0] == drivable[0] == 1.0


def test_comfort_is_nuplans() -> None:
    t = STEP_S * np.arange(41)

    def row(a: FloatArray, v: float = 10.0, kappa: float = 0.0) -> FloatArray:
        speed = v + np.r_[0.0, np.cumsum(0.1 * a[1:])]
        return np.array(
            [
                np.zeros(41),
                np.zeros(41),
                speed * kappa * STEP_S * np.arange(41),
                speed,
                a,
                np.full(41, kappa),
            ]
        )

    t = STEP_S * np.arange(41)
    gentle, sudden = (
        row(-2.0 * np.minimum(t, 1.0)),
        row(np.where(t < 2.0, 0.0, -12.0 * (t - 2.0)), 20.0),
    )
    found = comfortable(
        np.array([gentle, sudden, row(0.0 * t, 10.0, 0.05), row(0.0 * t, 10.0, 0.04)])
    )
    assert found.tolist() == [True, False, False, True]


def test_the_predictions_of_the_loop_do_not_change_a_plan() -> None:
    """It carries the others on itself."""
    ego = EgoState(0.0, 0.0, 0.0, 0.0, 10.0)
    now = frame(ego, [driving("lead", 40.0, 0.0, 6.0), driving("walker", 60.0, -6.0, 0.0, 1.2)])
    other = replace(now, predictions=replace(now.predictions, x=now.predictions.x + 7.0))
    one, two = (pdm(lanes(along_x()), ego).plan(each).trajectory for each in (now, other))
    np.testing.assert_array_equal(one.x, two.x)


def test_a_parked_car_is_passed_at_an_offset() -> None:
    drive = drives(
        lanes(along_x()),
        EgoState(0.0, 0.0, 0.0, 0.0, 8.0),
        standing("parked", 70.0, -2.0),
        seconds=14.0,
    )
    assert gaps(drive, "parked").min() > 0.05
    assert drive[-1][0].ego.x > 80.0


def test_a_slow_ego_brakes_before_a_contact() -> None:
    ego = EgoState(0.0, 0.0, 0.0, 0.0, 4.5)
    now = frame(ego, [standing("wall", CAR.axle_to_front + 3.0, 0.0, length=1.0, width=6.0)])
    plan = pdm(lanes(along_x()), ego).plan(now)
    assert plan.reason.startswith("emergency brake: the best proposal meets car wall in 0.")
    assert plan.trajectory.a.min() == pytest.approx(-C.brake_mps2, abs=0.1)


def test_all_proposals_and_their_scores_are_in_the_plan() -> None:
    ego = EgoState(0.0, 0.0, 0.0, 0.0, 10.0)
    plan = pdm(lanes(along_x()), ego).plan(frame(ego, [standing("parked", 30.0, 0.0)]))
    costs = [item for item in plan.internals if isinstance(item, CostTerms)]
    assert len(costs) == 15
    assert costs[0].stage.startswith("taken: ")
    total = [sum(value for _, value in each.terms) for each in costs]
    assert total[0] == pytest.approx(max(total))
    counted = next(item for item in plan.internals if isinstance(item, Candidates))
    assert counted.considered == 15 == 1 + sum(count for _, count in counted.rejected)
    assert {SlGraph, StGraph} <= {type(item) for item in plan.internals}


def test_settings() -> None:
    keywords = planner_part("pdm", {"offsets_m": [0.5], "horizon_s": 3.0}).keywords()
    assert keywords["config"] == PdmConfig(offsets_m=(0.5,), horizon_s=3.0)
