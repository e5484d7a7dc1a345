"""Controllers in closed loop, and the tracking errors that they see."""

from dataclasses import replace

import numpy as np
import pytest
from followed import controlled
from handmade import drive, s_curve
from hypothesis import given, strategies as st

from replan.logs.states import EgoState, Trajectory
from replan.logs.vehicle import VehicleParameters
from replan.replay.control.pid import PidMemory, SpeedLaw, accelerate_dual_loop
from replan.replay.vehicle.pedal_map import PedalPowertrain
from replan.replay.vehicle.plan_path import PlanPath
from replan.replay.vehicle.state_records import ego_record, new_record

CAR = VehicleParameters()
TRAIN = PedalPowertrain(CAR)
PERIOD = 0.01


def follow(plan: Trajectory, start: EgoState, seconds: float) -> dict[str, np.ndarray]:
    """The columns of a plan followed to its end, without replanning."""
    commands, states, errors = controlled(plan, "dlqr_pid", "kinematic_bicycle", seconds, start)
    rows = [
        (one.steer, one.throttle, one.brake, state.v)
        for one, state in zip(commands, states, strict=False)
    ]
    names = ("lateral", "heading", "speed", "station", "foot", "steer", "throttle", "brake", "v")
    return dict(zip(names, np.column_stack([errors, rows]).T, strict=True))


@pytest.mark.parametrize("v", [0.1, 0.5, 2.0, 5.0, 12.0, 25.0, 40.0])
def test_closed_loop_comes_back_to_a_straight_plan(v: float) -> None:
    seconds = max(8.0, 25.0 / v)
    plan = drive(np.zeros_like, v, seconds + 1.0)
    seen = follow(plan, EgoState(0.0, 0.0, 0.3, 0.02, v), seconds)
    assert np.abs(seen["lateral"]).max() < 0.5
    assert abs(seen["lateral"][-1]) < 0.05
    assert np.abs(seen["lateral"][-len(seen["lateral"]) // 5 :]).max() < 0.06
    assert np.abs(seen["speed"]).max() < 0.2


@pytest.mark.parametrize(("radius", "v"), [(10.0, 4.0), (-30.0, 8.0), (50.0, 12.0), (400.0, 30.0)])
def test_steady_lateral_error_on_a_constant_curve_vanishes(radius: float, v: float) -> None:
    seconds = max(8.0, 70.0 / v)
    plan = drive(lambda s: np.full_like(s, 1.0 / radius), v, seconds + 1.0)
    seen = follow(plan, EgoState(0.0, 0.0, 0.0, 0.0, v), seconds)
    assert np.abs(seen["lateral"]).max() > 1e-3  # it starts with straight wheels
    assert abs(seen["lateral"][-1]) < 2e-4
    assert abs(seen["heading"][-1]) < 1e-3


@given(st.floats(0.5, 11.0), st.floats(-1.5, 1.5), st.floats(-0.3, 0.3), st.floats(-1.0, 1.0))
def test_errors_are_those_that_were_put_in(
    t: float, lateral: float, heading: float, speed: float
) -> None:
    fine = drive(s_curve, 12.0, 12.0, step=0.01)
    truth = fine.at(t)
    ego = EgoState(
        t,
        truth.x - lateral * np.sin(truth.yaw),
        truth.y + lateral * np.cos(truth.yaw),
        truth.yaw + heading,
        truth.v + speed,
    )
    off = PlanPath.of(drive(s_curve, 12.0, 12.0)).deviation(ego)
    assert off.lateral == pytest.approx(lateral, abs=2e-3)
    assert off.heading == pytest.approx(heading, abs=2e-3)
    assert off.speed == pytest.approx(speed, abs=1e-6)
    assert off.station == pytest.approx(0.0, abs=2e-2)


def test_station_error_is_ahead_positive_and_beyond_the_ends_straight() -> None:
    path = PlanPath.of(drive(np.zeros_like, 10.0, 4.0))
    assert path.deviation(EgoState(2.0, 23.0, 0.5, 0.0, 10.0)).station == pytest.approx(3.0)
    assert path.deviation(EgoState(0.0, -2.0, 0.5, 0.0, 10.0))[:4] == pytest.approx(
        (0.5, 0.0, 0.0, -2.0)
    )
    assert path.deviation(EgoState(4.5, 46.0, -0.5, 0.0, 10.0))[:4] == pytest.approx(
        (-0.5, 0.0, 0.0, 1.0)
    )


def test_standing_plans_and_noise_have_no_station() -> None:
    t = np.arange(0.0, 5.0, 0.1)
    rng = np.random.default_rng(1)
    x, y = rng.normal(0.0, 0.01, (2, len(t)))
    still = PlanPath.of(
        Trajectory(t, x, y, np.zeros_like(t), np.zeros_like(t), np.zeros_like(t), np.zeros_like(t))
    )
    assert still.times[-1, 1] < 0.06
    off = still.deviation(EgoState(2.0, 0.0, 0.2, 0.1, 0.0))
    assert off.lateral == pytest.approx(0.2, abs=0.03) and off.heading == pytest.approx(
        0.1, abs=1e-9
    )
    single = PlanPath.of(drive(np.zeros_like, 10.0, 1.0).between(0.0, 0.0))
    assert single.deviation(EgoState(0.5, 5.0, 0.1, 0.0, 10.0))[:4] == pytest.approx(
        (0.1, 0.0, 0.0, 0.0)
    )


def test_a_loop_is_followed_where_the_plan_is_and_not_where_it_crosses_itself() -> None:
    """A circle driven twice has two feet for each point."""
    plan = drive(lambda s: np.full_like(s, 0.1), 10.0, 2 * 2 * np.pi)
    path = PlanPath.of(plan)
    late = replace(plan.at(10.0), t=10.0)
    assert path.deviation(late).station == pytest.approx(0.0, abs=0.05)
    assert path.deviation(late).foot > 95.0


def test_the_integral_does_not_wind_up() -> None:
    """Ten seconds of an unreachable plan leave no more integral than the first of them."""
    plan = PlanPath.of(drive(np.zeros_like, 40.0, 12.0))
    law, memory = SpeedLaw(PERIOD), new_record(PidMemory)
    for k in range(1000):
        state = EgoState(k * PERIOD, 0.0, 0.0, 0.0, 5.0)
        off = plan.deviation(state)
        wanted = accelerate_dual_loop(
            law, memory, TRAIN.pedal_map, ego_record(state), off, plan.times
        )
    assert wanted == pytest.approx(TRAIN.coasting(5.0) + TRAIN.full_throttle(5.0))
    calm = EgoState(10.0, 400.0, 0.0, 0.0, 40.0)
    off = plan.deviation(calm)
    wanted = accelerate_dual_loop(law, memory, TRAIN.pedal_map, ego_record(calm), off, plan.times)
    assert abs(wanted) < 0.1


def stop_and_go(t: np.ndarray) -> np.ndarray:
    return np.interp(t, [0.0, 1.0, 6.0, 9.0, 15.0], [10.0, 10.0, 0.0, 0.0, 9.0])


def test_a_stop_is_held_without_creep_and_left_again() -> None:
    seen = follow(drive(s_curve, stop_and_go, 16.0), EgoState(0.0, 0.0, 0.0, 0.0, 10.0), 15.5)
    t = PERIOD * np.arange(len(seen["v"]))
    held = (t > 6.5) & (t < 8.5)
    assert (seen["v"][held] == 0.0).all()
    assert (seen["throttle"][(t > 6.5) & (t < 7.9)] == 0.0).all()
    assert (seen["brake"][(t > 6.5) & (t < 7.9)] > 0.0).all()
    assert seen["v"][-1] > 8.0
    assert np.abs(seen["station"]).max() < 0.2
    assert np.abs(seen["lateral"]).max() < 0.02
    assert not (seen["throttle"] * seen["brake"]).any()
    pedal = np.sign(seen["throttle"]) - np.sign(seen["brake"])
    assert np.count_nonzero(np.diff(pedal[pedal != 0.0])) <= 3
